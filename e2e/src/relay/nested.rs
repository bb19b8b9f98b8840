//! Packets inside payloads: whoever chooses a payload wants them signed, or obeyed.

use anyhow::Result;

use super::{EACH, FEW, Relay, SYSTEM, same};
use crate::{
    scenario::{
        Sending,
        Side::{Link, Local},
    },
    wire::{self, Frame},
};

/// Message ids.
const HEARTBEAT: u32 = 0;
const COMMAND_LONG: u32 = 76;
const SETUP_SIGNING: u32 = 256;
const TUNNEL: u32 = 385;
/// MAV_CMD_COMPONENT_ARM_DISARM
const ARM: u16 = 400;
/// The component that takes a key: `chips/qemu-m7/src/bin/relay.rs`.
const COMPONENT: u8 = 25;
/// A station, and what it is of that.
const STATION: [u8; 2] = [255, 190];

/// The key that somebody without a key would like to be in use.
pub(super) const KEY: [u8; 32] = *b"chosen by somebody far away.....";

/// A frame that is not signed.
fn frame([system, component]: [u8; 2], message: u32, payload: &[u8]) -> Frame {
    let mut frame = vec![0xFD, payload.len() as u8, 0, 0, 0, system, component];
    frame.extend(&message.to_le_bytes()[..3]);
    frame.extend(payload);
    frame.extend([0; 2]);
    wire::repair(&mut frame);
    frame
}

/// SETUP_SIGNING with `key` for the firmware, and the time.
pub(super) fn setup_signing(key: &[u8]) -> Frame {
    let time = super::ticks_now().to_le_bytes();
    frame(
        STATION,
        SETUP_SIGNING,
        &[&time, &[SYSTEM, COMPONENT][..], key].concat(),
    )
}

/// An order of the station to arm.
fn arm() -> Frame {
    let mut payload = [&1_f32.to_le_bytes()[..], &[0; 24], &ARM.to_le_bytes()].concat();
    payload.extend([SYSTEM, 1, 0, 1]);
    frame(STATION, COMMAND_LONG, &payload)
}

/// A packet of the vehicle whose payload is `inside` and a byte of its own.
fn tunnel(inside: &[u8]) -> Frame {
    let header = [0, 0, SYSTEM, 1, inside.len() as u8];
    frame([SYSTEM, 1], TUNNEL, &[&header, inside, &[1]].concat())
}

impl Relay {
    /// Packets inside TUNNELs. Whole TUNNELs are telemetry like any other. Behind a packet that has lost a byte, one is
    /// searched for nothing: what is inside is neither obeyed nor signed.
    pub(super) fn nested(&mut self, sending: &mut Sending) -> Result<()> {
        let heartbeat = frame([SYSTEM, 1], HEARTBEAT, &[0, 0, 0, 0, 2, 3, 81, 4, 3]);
        let mut lost = heartbeat.clone();
        lost.remove(12);
        for (inside, whole, behind_lost, behind_noise) in [
            (
                setup_signing(&KEY),
                "TUNNEL that holds SETUP_SIGNING",
                "the same behind a lost byte",
                "the same behind a strange byte",
            ),
            (
                arm(),
                "TUNNEL that holds COMMAND_LONG",
                "the same behind a lost byte",
                "the same behind a strange byte",
            ),
        ] {
            let tunnel = tunnel(&inside);
            sending.passes(Local, whole, same(std::slice::from_ref(&tunnel)));
            let bytes = [&lost[..], &tunnel].concat();
            sending.unreadable(behind_lost, "bad checksum", vec![bytes; FEW]);
            // Like the beginning of MAVLink 1, which announces 261 bytes: they are waited for.
            let bytes = [vec![0xFE], tunnel.repeat(5)].concat();
            sending.unreadable(behind_noise, "bad checksum", vec![bytes; FEW]);
        }
        // Nobody's key has changed, on the way out or in.
        sending.passes(Local, "HEARTBEAT", same(&vec![heartbeat; EACH]));
        let arm = wire::sign(&arm(), &KEY, super::LINK_IN, super::ticks_now());
        let name = "COMMAND_LONG, signed with that key";
        sending.rejected(Link, name, "bad tag", [arm]);
        Ok(())
    }
}
