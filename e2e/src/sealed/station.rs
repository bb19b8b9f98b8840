//! A ground station on this machine: its commands sealed, the vehicle's packages opened.

use std::{collections::BTreeSet, time::Duration};

use anyhow::{Context, Result, bail, ensure};
use mavlink::{
    MavHeader,
    dialects::ardupilotmega::{COMMAND_LONG_DATA, HEARTBEAT_DATA, MavCmd, MavMessage},
};
use mavlink_commsec::{OpenError, Opener, Packer, Sealer, SealingKey, SenderId};
use mavseal_keys::SenderKeys;

use super::air::Air;
use crate::scenario::Row;

/// A package, and the packets in it.
#[derive(Clone, Debug)]
pub(super) struct Sealed {
    pub(super) sender: u32,
    pub(super) counter: u32,
    pub(super) package: Vec<u8>,
    pub(super) packets: Vec<u8>,
}

/// How far behind the newest a package may be: `commsec/src/seen.rs`.
const REORDERED: u32 = 64;

/// What was opened of a sender since the start: each package once, those that others have overtaken too.
#[derive(Clone, Debug, Default)]
pub(super) struct Heard {
    /// Nothing up to this counter is opened.
    pub(super) above: u32,
    counters: BTreeSet<u32>,
}

impl Heard {
    /// After a start.
    pub(super) fn above(above: u32) -> Self {
        let counters = BTreeSet::new();
        Self { above, counters }
    }

    /// The last counter that is known.
    pub(super) fn last(&self) -> u32 {
        self.counters.last().map_or(self.above, |last| *last)
    }

    /// Whether a package with this counter must be opened now.
    pub(super) fn opens(&mut self, counter: u32) -> bool {
        let late = self.last().saturating_sub(counter) > REORDERED;
        counter > self.above && !late && self.counters.insert(counter)
    }
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
    heard: Heard,
    sequence: u8,
    /// The way from the vehicle, and the way to it
    down: Air,
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
            heard: Heard::default(),
            sequence: 0,
            down: Air::new(seed, 2 * u64::from(id)),
            up: Air::new(seed, 2 * u64::from(id) + 1),
        })
    }

    /// The next commands, each sealed with a heartbeat.
    pub(super) fn commands(&mut self, count: usize) -> Result<Vec<Sealed>> {
        (0..count).map(|_| self.command()).collect()
    }

    fn command(&mut self) -> Result<Sealed> {
        let command = MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            param1: f32::from(self.sequence),
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
            ensure!(
                full.is_none(),
                "a command and a heartbeat fit into one package"
            );
            packets.extend(packet);
        }
        let plaintext = self.packer.poll(Duration::ZERO);
        let plaintext = plaintext.context("a heartbeat does not wait")?;
        let counter = self.sealer.next_counter().context("a fresh key")?;
        let package = self.sealer.seal(&plaintext)?;
        Ok(Sealed {
            sender: self.id,
            counter,
            package: package.as_bytes().to_vec(),
            packets,
        })
    }

    /// Opens what the vehicle has sent and the air has let through; each package once.
    pub(super) fn listen(&mut self, name: &str, sent: &[Sealed]) -> Result<Row> {
        let (packages, air) = self.down.carry(sent);
        let mut row = self.row(name, "stale");
        row.air = Some(air);
        for sealed in packages {
            let counter = sealed.counter;
            let opens = self.heard.opens(counter);
            match self.opener.open(&sealed.package) {
                Ok(opened) if opens => {
                    let came: Vec<&[u8]> = opened.packets().filter_map(Result::ok).collect();
                    ensure!(
                        came.concat() == sealed.packets,
                        "{}: other packets",
                        row.name
                    );
                    row.counts.passed += 1;
                }
                Err(OpenError::Stale { .. }) if !opens => row.counts.rejected += 1,
                other => bail!("{}: {counter:?}: {other:?}", row.name),
            }
        }
        Ok(row)
    }

    /// Hands the station packages that it must reject for this reason.
    pub(super) fn reject(
        &mut self,
        name: &str,
        packages: &[Vec<u8>],
        because: &'static str,
    ) -> Result<Row> {
        let mut row = self.row(name, because);
        for package in packages {
            let reason = match self.opener.open(package) {
                Err(OpenError::UnknownSender(_)) => "unknown sender",
                Err(OpenError::Stale { .. }) => "stale",
                Err(OpenError::BadTag) => "bad tag",
                other => bail!("{}: {other:?}", row.name),
            };
            ensure!(reason == because, "{}: {reason}, not {because}", row.name);
            row.counts.rejected += 1;
        }
        Ok(row)
    }

    fn row(&self, name: &str, because: &'static str) -> Row {
        Row {
            to: "station",
            because,
            ..Row::new(format!("station {}: {name}", self.id))
        }
    }
}
