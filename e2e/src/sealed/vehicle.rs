//! The vehicle of a sealed link, as its autopilot, its radio and the stations see it.

use std::collections::BTreeMap;

use anyhow::{Context, Result, ensure};
use mavlink_commsec::{Opener, SenderId, hx, radio};
use mavseal_keys::KeyFile;

use super::{
    air::Air,
    station::{Heard, Sealed, Station, key},
};
use crate::{
    scenario::{Counts, Device, Sending, Side},
    wire,
};

/// How far the firmware's first marks are ahead. Each next one is at most twice as far ahead as the one before, so
/// that a mark is no further ahead than this and all that was used: `relay/src/sealed/paced.rs`.
const SENT_RESERVATION: u32 = 256;
const ACCEPTED_RESERVATION: u32 = 8;
/// CRC_EXTRA of VEHICLE_RADIO.
const CRC_EXTRA: u8 = 238;

/// What the vehicle's radio says of the link.
pub(super) const STATUS: radio::Status = radio::Status {
    rssi: 201,
    noise: 41,
    received: 0x1234,
    remote_rssi: 199,
    remote_noise: 43,
    remote_received: 0x5678,
    tx_errors: 0x0102,
    rx_errors: 3,
    serial_tx_overflow: 4,
    serial_rx_overflow: 5,
    ecc_errors: 0x0607,
    ecc_packets: 8,
    serial_tx_ok: 9,
    serial_rx_ok: 10,
};

/// What the vehicle has been seen to do, and everybody else.
pub(super) struct Vehicle {
    pub(super) id: u32,
    pub(super) stations: Vec<Station>,
    pub(super) attacker: Air,
    decoder: hx::Decoder,
    /// Opens every package as it leaves the vehicle
    witness: Opener<1>,
    /// Every package of the vehicle, and how many of them the stations have heard
    pub(super) sent: Vec<Sealed>,
    pub(super) heard: usize,
    /// Packages that the vehicle must have accepted
    pub(super) accepted: Vec<Sealed>,
    /// What it must have opened of each sender
    opened: BTreeMap<u32, Heard>,
    /// Since the start, so many of each sender
    accepted_of: BTreeMap<u32, usize>,
    /// Since the start: packages from the vehicle, and packets that tell of its radio
    packages: usize,
    radio_told: usize,
    pub(super) radio_told_ever: usize,
    /// How many of those ever must have come before the next step
    radio_told_due: usize,
    /// Where the vehicle goes on, as it says, and above which counter it hears each sender
    next: Option<u32>,
    above: BTreeMap<u32, u32>,
}

impl Vehicle {
    pub(super) fn new(keys: &KeyFile, seed: u64) -> Result<Self> {
        let own = keys.vehicle();
        let stations = keys.stations().iter();
        let stations = stations.map(|station| Station::new(station, own, seed));
        let mut witness = Opener::new();
        witness.permit(key(own)?, &[SenderId(own.id)])?;
        Ok(Self {
            id: own.id,
            stations: stations.collect::<Result<_>>()?,
            attacker: Air::new(seed, 0),
            decoder: hx::Decoder::new(),
            witness,
            sent: Vec::new(),
            heard: 0,
            accepted: Vec::new(),
            opened: BTreeMap::new(),
            accepted_of: BTreeMap::new(),
            packages: 0,
            radio_told: 0,
            radio_told_ever: 0,
            radio_told_due: 0,
            next: None,
            above: BTreeMap::new(),
        })
    }

    /// Waits until the radio has answered once more: it is not asked again within a second.
    pub(super) fn radio_answers(&mut self, _: &mut Sending) -> Result<()> {
        self.radio_told_due = self.radio_told_ever + 1;
        Ok(())
    }

    /// Whether the vehicle must accept a package that comes to it now.
    pub(super) fn accepts(&mut self, sealed: &Sealed) -> bool {
        let opened = self.opened.entry(sealed.sender).or_default();
        let opens = opened.opens(sealed.counter);
        if opens {
            *self.accepted_of.entry(sealed.sender).or_default() += 1;
            self.accepted.push(sealed.clone());
        }
        opens
    }

    /// Where it goes on after a start: above all that it has used and accepted, and not far above.
    fn check_start(&mut self, next: u32) -> Result<()> {
        let sent = self.sent.last().map_or(0, |sealed| sealed.counter);
        let ahead = next.checked_sub(sent + 1);
        // A fresh key begins with the first counter.
        let most = if sent == 0 {
            0
        } else {
            sent + SENT_RESERVATION
        };
        let right = ahead.is_some_and(|ahead| ahead <= most);
        ensure!(right, "after counter {sent} the vehicle goes on at {next}");
        for station in &self.stations {
            let opened = self.opened.entry(station.id).or_default();
            let (last, above) = (opened.last(), self.above.get(&station.id));
            let above = *above.context("every sender is told")?;
            let ahead = above.checked_sub(last);
            let most = if last == 0 {
                0
            } else {
                last + ACCEPTED_RESERVATION
            };
            let right = ahead.is_some_and(|ahead| ahead <= most);
            ensure!(
                right,
                "sender {} was heard up to {last}, and is heard above {above}",
                station.id
            );
            *opened = Heard::above(above);
        }
        Ok(())
    }

    /// Opens a package as it leaves the vehicle; adds the packets in it to `out`, but for those that tell of the
    /// radio.
    fn check_package(&mut self, package: &[u8], out: &mut Vec<u8>) -> Result<()> {
        let opened = self.witness.open(package);
        let opened = opened.map_err(|error| anyhow::anyhow!("from the vehicle: {error}"))?;
        let mut packets = Vec::new();
        for packet in opened.packets() {
            let packet = packet?;
            if packet[0] == 0xFD {
                out.extend(packet);
            } else {
                let radio = packet == vehicle_radio(self.radio_told as u8);
                ensure!(radio, "a strange packet from the vehicle: {packet:02X?}");
                self.radio_told += 1;
                self.radio_told_ever += 1;
            }
            packets.extend(packet);
        }
        self.packages += 1;
        self.sent.push(Sealed {
            sender: self.id,
            counter: opened.counter(),
            package: package.to_vec(),
            packets,
        });
        Ok(())
    }
}

impl Device for Vehicle {
    const PASSED: [&'static str; 2] = ["sealed", "accepted"];

    fn started(&mut self, line: &str) -> Result<bool> {
        if let Some((_, next)) = line.split_once(" goes on at ") {
            self.next = Some(next.parse()?);
        } else if let Some((sender, last)) = line
            .strip_prefix("[INFO ] Sender ")
            .and_then(|rest| rest.split_once(" is heard above "))
        {
            self.above.insert(sender.parse()?, last.parse()?);
        }
        match self.next {
            Some(next) if self.above.len() == self.stations.len() => {
                self.check_start(next)?;
                Ok(true)
            }
            _ => Ok(false),
        }
    }

    fn open(
        &mut self,
        side: Side,
        bytes: &[u8],
        out: &mut Vec<u8>,
        reply: &mut Vec<u8>,
    ) -> Result<()> {
        if side == Side::Local {
            out.extend(bytes);
            return Ok(());
        }
        for byte in bytes {
            let Some(frame) = self.decoder.push(*byte) else {
                continue;
            };
            let frame = frame.context("the radio gets no frame")?;
            match (frame.kind(), frame.payload().to_vec()) {
                (hx::FrameKind::AirData, package) => self.check_package(&package, out)?,
                (hx::FrameKind::Radio, bytes) => {
                    let request = radio::Request::from_wire(&bytes);
                    let status = request == Some(radio::Request::Status);
                    ensure!(status, "asked of the radio: {bytes:02X?}");
                    reply.extend(frame_of(hx::FrameKind::Radio, &STATUS.to_wire())?);
                }
            }
        }
        Ok(())
    }

    fn is_ready(&self) -> bool {
        self.radio_told_ever >= self.radio_told_due
    }

    fn counters(&self, [down, up]: [Counts; 2]) -> Vec<String> {
        let packages = [self.packages, up.passed];
        let packets = [down.passed + self.radio_told, 2 * up.passed];
        let rejected = [down.rejected, up.rejected];
        let directions = ["sealed", "opened"].iter().enumerate();
        let counters = directions.map(|(at, name)| {
            format!(
                "[INFO ] {name}: {} packages, {} packets, rejected: {}, bytes of no packet: 0",
                packages[at], packets[at], rejected[at]
            )
        });
        let stations = self.stations.iter().map(|station| {
            let count = self.accepted_of.get(&station.id).unwrap_or(&0);
            format!("[INFO ] opened of sender {}: {count}", station.id)
        });
        counters.chain(stations).collect()
    }

    fn reset(&mut self) -> [Vec<u8>; 2] {
        Default::default()
    }

    fn was_reset(&mut self) {
        self.next = None;
        self.above.clear();
        self.accepted_of.clear();
        (self.packages, self.radio_told) = (0, 0);
        self.decoder = hx::Decoder::new();
    }
}

/// The bytes of a frame on the line.
pub(super) fn frame_of(kind: hx::FrameKind, payload: &[u8]) -> Result<Vec<u8>> {
    Ok(hx::Frame::new(kind, payload)?.encode().collect())
}

/// VEHICLE_RADIO of SMACCMPilot's dialect, message 174 of MAVLink 1, as [`STATUS`] makes it.
fn vehicle_radio(sequence: u8) -> Vec<u8> {
    let mut packet = vec![0xFE, 9, sequence, 1, 68, 174];
    packet.extend(STATUS.tx_errors.to_le_bytes());
    packet.extend(STATUS.ecc_errors.to_le_bytes());
    packet.extend([
        STATUS.rssi,
        STATUS.remote_rssi,
        STATUS.serial_rx_overflow as u8,
    ]);
    packet.extend([STATUS.noise, STATUS.remote_noise]);
    packet.extend(wire::checksum(&packet, CRC_EXTRA));
    packet
}
