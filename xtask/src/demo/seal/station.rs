//! A ground station on this machine: its commands sealed, the vehicle's packages opened.

use std::time::Duration;

use anyhow::{Context, Result};
use mavlink::MavHeader;
use mavlink::dialects::ardupilotmega::{COMMAND_LONG_DATA, HEARTBEAT_DATA, MavCmd, MavMessage};
use mavlink_commsec::{OpenError, Opener, Packer, Plaintext, Sealer, SealingKey, SenderId};
use mavseal_keys::SenderKeys;

use super::air::{Air, Arrived};
use crate::demo::Row;

/// A package, and the packets in it.
#[derive(Clone, Debug)]
pub(super) struct Sealed {
    pub(super) sender: u32,
    pub(super) counter: u32,
    pub(super) package: Vec<u8>,
    pub(super) packets: Vec<u8>,
}

/// A key, prepared.
pub(super) fn key(sender: &SenderKeys) -> Result<SealingKey> {
    Ok(SealingKey::new(&*sender.key, sender.salt)?)
}

/// A ground station.
pub(super) struct Station {
    pub(super) id: u32,
    sealer: Sealer,
    packer: Packer,
    opener: Opener<1>,
    sequence: u8,
    /// The way from the vehicle, and the way to it
    pub(super) down: Air,
    pub(super) up: Air,
}

impl Station {
    pub(super) fn new(own: &SenderKeys, vehicle: &SenderKeys, seed: u64) -> Result<Self> {
        let id = own.id;
        let mut opener = Opener::new();
        opener.permit(key(vehicle)?, &[SenderId(vehicle.id)])?;
        Ok(Self {
            id,
            sealer: Sealer::new(key(own)?, SenderId(id)),
            packer: Packer::new(Duration::from_millis(50)),
            opener,
            sequence: 0,
            down: Air::new(seed, 2 * u64::from(id)),
            up: Air::new(seed, 2 * u64::from(id) + 1),
        })
    }

    /// `count` commands, each sealed with a heartbeat.
    pub(super) fn commands(&mut self, count: usize) -> Result<Vec<Sealed>> {
        (0..count).map(|at| self.command(at as f32)).collect()
    }

    fn command(&mut self, param: f32) -> Result<Sealed> {
        let command = MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            param1: param,
            param7: 1.0,
            command: MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
            target_system: 1,
            target_component: 1,
            ..Default::default()
        });
        let heartbeat = MavMessage::HEARTBEAT(HEARTBEAT_DATA::default());
        let mut packets = Vec::new();
        for message in [command, heartbeat] {
            let header = MavHeader {
                system_id: 250 + self.id,
                component_id: 190,
                sequence: self.sequence,
            };
            self.sequence = self.sequence.wrapping_add(1);
            let mut packet = Vec::new();
            mavlink::write_v2_msg(&mut packet, header, &message)?;
            let full = self.packer.push(&packet, Duration::ZERO)?;
            anyhow::ensure!(full.is_none(), "a command and a heartbeat are one message");
            packets.extend(packet);
        }
        let message = self.packer.poll(Duration::ZERO);
        let message = message.context("a heartbeat does not wait")?;
        self.seal(&message, packets)
    }

    fn seal(&mut self, message: &Plaintext, packets: Vec<u8>) -> Result<Sealed> {
        let counter = self.sealer.next_counter().context("a fresh key")?;
        let package = self.sealer.seal(message)?;
        Ok(Sealed {
            sender: self.id,
            counter,
            package: package.as_bytes().to_vec(),
            packets,
        })
    }

    /// Opens what the vehicle has sent and the air has let through; each package once, in order.
    pub(super) fn listen(
        &mut self,
        name: &str,
        sent: &[Sealed],
        faults: &mut Vec<String>,
    ) -> Row<6> {
        let Arrived {
            packages,
            lost,
            doubled,
        } = self.down.carry(sent);
        let mut last = self.opener.senders().map(|(_, last)| last).max();
        let (mut accepted, mut rejected) = (0, 0);
        for Sealed {
            counter,
            package,
            packets,
            ..
        } in &packages
        {
            let fresh = last.is_none_or(|last| *counter > last);
            match self.opener.open(package) {
                Ok(opened) if fresh => {
                    let came: Vec<&[u8]> = opened.packets().filter_map(Result::ok).collect();
                    if came.concat() == *packets {
                        accepted += 1;
                    }
                    last = Some(*counter);
                }
                Err(OpenError::Stale { .. }) if !fresh => rejected += 1,
                other => faults.push(format!("station {}: {counter}: {other:?}", self.id)),
            }
        }
        if accepted + rejected != packages.len() {
            faults.push(format!("station {}: other packets came out", self.id));
        }
        Row {
            name: name.to_owned(),
            counts: [
                sent.len(),
                lost,
                doubled,
                packages.len(),
                accepted,
                rejected,
            ],
            because: if rejected > 0 { "stale" } else { "" }.to_owned(),
        }
    }

    /// Hands the station packages that it must reject for this reason.
    pub(super) fn reject(
        &mut self,
        name: &str,
        packages: &[Vec<u8>],
        because: &str,
        faults: &mut Vec<String>,
    ) -> Row<6> {
        let mut rejected = 0;
        for package in packages {
            match self.opener.open(package) {
                Err(error) if reason(&error) == because => rejected += 1,
                other => faults.push(format!("station {}: {name}: {other:?}", self.id)),
            }
        }
        let sent = packages.len();
        Row {
            name: name.to_owned(),
            counts: [sent, 0, 0, sent, sent - rejected, rejected],
            because: because.to_owned(),
        }
    }
}

fn reason(error: &OpenError) -> &'static str {
    match error {
        OpenError::WrongLength(_) => "wrong length",
        OpenError::UnknownSender(_) => "unknown sender",
        OpenError::Stale { .. } => "stale",
        OpenError::BadTag => "bad tag",
        _ => "another reason",
    }
}
