//! Where fuzzing begins: inputs named by what they are, `cargo xtask fuzz seeds`.

mod ends;
mod memory;
mod packets;
mod sealed;
mod senders;
mod streams;
mod time;
mod unsigned;
mod values;

use mavlink_signing::{Frame, Header, MessageId};

use crate::input::{Input, NOW};
use crate::repair;

/// A file of `fuzz/seeds/<target>/<name>`.
#[derive(Clone, Debug)]
pub struct Seed {
    /// The target that reads it.
    pub target: &'static str,
    /// What it is.
    pub name: String,
    /// What it holds.
    pub bytes: Vec<u8>,
}

/// HEARTBEAT, TIMESYNC, SETUP_SIGNING; the last two have an id of more than one byte or payload to cut.
const HEARTBEAT: u32 = 0;
const TIMESYNC: u32 = 111;
const SETUP_SIGNING: u32 = 256;
/// An id that no dialect gives to a message.
const UNKNOWN: u32 = 0x7F_FFFE;
/// A HEARTBEAT of MAVLink 1.
const MAVLINK1: [u8; 17] = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];
/// The payload of a HEARTBEAT.
const BEAT: [u8; 9] = [5, 0, 0, 0, 2, 3, 81, 4, 3];
/// Ticks of 10 seconds.
const TEN_SECONDS: i64 = 1_000_000;

/// Every seed. `telemetry` are recorded frames, unsigned.
#[must_use]
pub fn all(telemetry: &[Vec<u8>]) -> Vec<Seed> {
    let mut seeds = Seeds(Vec::new());
    seeds.any_bytes(telemetry);
    seeds.packets(telemetry);
    seeds.changes();
    seeds.signed();
    seeds.streams(telemetry);
    seeds.histories();
    seeds.pipes(telemetry);
    seeds.ports();
    seeds.senders();
    seeds.unsigned(telemetry);
    seeds.values();
    seeds.foreign();
    seeds.memory();
    seeds.time();
    seeds.sealed();
    seeds.ends();
    seeds.0
}

/// An unsigned frame.
fn unsigned(id: u32, payload: &[u8]) -> Vec<u8> {
    let header = Header {
        compat_flags: 0,
        sequence: 17,
        system_id: 1,
        component_id: 190,
        message_id: MessageId::new(id).expect("24 bits"),
    };
    let frame = Frame::new(header, payload).expect("a known message");
    frame.as_bytes().to_vec()
}

/// The same, signed for `link_id` so many ticks after [`NOW`].
fn signed(id: u32, payload: &[u8], link_id: u8, after: i64) -> Vec<u8> {
    let mut frame = unsigned(id, payload);
    frame[2] = 1;
    frame.push(link_id);
    frame.extend(&NOW.wrapping_add_signed(after).to_le_bytes()[..6]);
    frame.extend([0; 6]);
    let parts = repair::parts(&frame).expect("a frame");
    parts.repair_checksum(&mut frame);
    parts.repair_tag(&mut frame);
    frame
}

fn changed(mut frame: Vec<u8>, at: usize) -> Vec<u8> {
    frame[at] ^= 0x40;
    frame
}

/// The first recorded frame of each of some messages.
fn recorded(telemetry: &[Vec<u8>]) -> Vec<(String, &[u8])> {
    let mut found: Vec<(String, &[u8])> = Vec::new();
    for frame in telemetry {
        let id = u32::from_le_bytes([frame[7], frame[8], frame[9], 0]);
        let name = format!("telemetry_message_{id}");
        if found.len() < 8 && found.iter().all(|(known, _)| *known != name) {
            found.push((name, frame));
        }
    }
    found
}

struct Seeds(Vec<Seed>);

impl Seeds {
    fn bytes(&mut self, target: &'static str, name: &str, bytes: Vec<u8>) {
        let name = name.to_owned();
        self.0.push(Seed {
            target,
            name,
            bytes,
        });
    }

    fn add(&mut self, target: &'static str, name: &str, input: &impl Input) {
        self.bytes(target, name, input.file());
    }
}
