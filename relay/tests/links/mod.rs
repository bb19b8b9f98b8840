//! Ends of sealed links for tests: keys, marks in flash, and an end that is driven.

#![allow(dead_code, reason = "not every test uses all of it")]

use std::time::Duration;

use embedded_storage::nor_flash::NorFlash;
use mavlink_commsec::{AesGcm, Credential, Sealer, SenderId, hx};
use mavlink_signing::{LinkClock, Timestamp, crc::checksum};
use mavseal_relay::adapter;
use mavseal_relay::sealed::{
    HighWaterMarks, MarksError, Radio, SealedEndpoint, SealedEvent, SealedRejectReason,
};
use mavseal_store::{
    Binding, Region,
    model::{Flash, PAGE_SIZE},
};

use crate::ports::Line;

pub const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};
pub const VEHICLE: Credential = credential(7, 1);
pub const STATION: Credential = credential(5, 2);
pub const OTHER: Credential = credential(6, 3);
pub const RADIO: Radio = Radio::Vehicle {
    system_id: 1,
    component_id: 68,
};
/// A second, in ticks.
pub const SECOND: u64 = 100_000;

pub const fn credential(id: u32, byte: u8) -> Credential {
    Credential {
        id: SenderId(id),
        key: [byte; 16],
        salt: 0x0102_0304 * byte as u32,
    }
}

/// The timer of an end, and what its clock says.
pub struct Time {
    pub timer: u64,
    pub clock: u64,
}

impl LinkClock for Time {
    fn now(&mut self) -> Timestamp {
        Timestamp::from_ticks(self.clock).expect("48 bits")
    }

    fn monotonic(&mut self) -> u64 {
        self.timer
    }
}

impl Time {
    pub fn pass(&mut self, ticks: u64) {
        self.timer += ticks;
        self.clock += ticks;
    }
}

/// A HEARTBEAT of MAVLink 1, which leaves at once.
pub fn heartbeat(custom: u32) -> Vec<u8> {
    let mut packet = vec![0xFE, 9, 78, 1, 1, 0];
    packet.extend(custom.to_le_bytes());
    packet.extend([2, 3, 81, 4, 3]);
    let sum = checksum(&packet[1..], 50);
    packet.extend(sum.to_le_bytes());
    packet
}

/// What the marks of a sender are bound to.
pub fn binding(kind: u8, of: &Credential) -> Binding {
    let key = of.prepare::<AesGcm>().expect("a key");
    Binding::new(kind, key.fingerprint(of.id).expect("AES does not fail"))
}

/// Flashes with marks that were never used.
pub fn provisioned<const N: usize>(
    own: &Credential,
    peers: &[Credential; N],
) -> (Flash<2>, [Flash<2>; N]) {
    let mut sent = Flash::default();
    let mut accepted = [(); N].map(|()| Flash::default());
    let places = accepted.each_mut().map(|flash| (flash, REGION));
    HighWaterMarks::provision::<AesGcm>(own, peers, (&mut sent, REGION), places)
        .map(drop)
        .expect("blank flashes");
    (sent, accepted)
}

/// The marks in these flashes.
pub fn open<F: NorFlash, const N: usize>(
    own: &Credential,
    peers: &[Credential; N],
    sent: F,
    accepted: [F; N],
) -> Result<HighWaterMarks<F, N>, MarksError> {
    let places = accepted.map(|flash| (flash, REGION));
    HighWaterMarks::open::<AesGcm>(own, peers, (sent, REGION), places)
}

/// An end, its lines, and all that it told.
pub struct Driven<const N: usize> {
    pub end: SealedEndpoint<Flash<2>, N>,
    pub local: Line,
    pub air: Line,
    pub events: Vec<SealedEvent>,
}

impl<const N: usize> Driven<N> {
    pub fn new(
        own: &Credential,
        peers: &[Credential; N],
        (sent, accepted): (Flash<2>, [Flash<2>; N]),
        radio: Radio,
    ) -> Self {
        let marks = open(own, peers, sent, accepted).expect("marks");
        let max_delay = Duration::from_millis(50);
        let end = SealedEndpoint::new(own, peers, marks, radio, max_delay);
        Self {
            end: end.expect("keys"),
            local: Line::new(),
            air: Line::new(),
            events: Vec::new(),
        }
    }

    pub fn clocked(mut self, origin: u64) -> Self {
        let origin = Timestamp::from_ticks(origin).expect("48 bits");
        self.end = self.end.clocked(origin);
        self
    }

    pub fn run(&mut self, time: &mut Time) {
        let Self {
            end,
            local,
            air,
            events,
        } = self;
        while adapter::poll(end, local, air, time, &mut |event| events.push(event)).moved() {}
    }

    /// The package of a heartbeat, if it was sealed.
    pub fn seal(&mut self, custom: u32, time: &mut Time) -> Option<Vec<u8>> {
        self.local.input.extend(heartbeat(custom));
        self.run(time);
        let mut packages = self.packages();
        assert!(packages.len() <= 1);
        packages.pop()
    }

    /// The packages that have left since this was last asked.
    pub fn packages(&mut self) -> Vec<Vec<u8>> {
        let mut decoder = hx::Decoder::new();
        let mut packages = Vec::new();
        for byte in self.air.output.drain(..) {
            let Some(Ok(frame)) = decoder.push(byte) else {
                continue;
            };
            if frame.kind() == hx::FrameKind::AirData {
                packages.push(frame.payload().to_vec());
            }
        }
        packages
    }

    /// What becomes of a frame of the radio: why it was rejected, if it was.
    pub fn take(
        &mut self,
        kind: hx::FrameKind,
        payload: &[u8],
        time: &mut Time,
    ) -> Option<SealedRejectReason> {
        let frame = hx::Frame::new(kind, payload).expect("a frame");
        self.air.input.extend(frame.encode());
        let before = self.events.len();
        self.run(time);
        self.events[before..].iter().find_map(|event| match event {
            SealedEvent::Rejected(_, reason) => Some(*reason),
            _ => None,
        })
    }

    /// What becomes of a package.
    pub fn open(&mut self, package: &[u8], time: &mut Time) -> Option<SealedRejectReason> {
        self.take(hx::FrameKind::AirData, package, time)
    }

    pub fn into_flashes(self) -> (Flash<2>, [Flash<2>; N]) {
        self.end.into_flashes()
    }
}

pub fn counter(package: &[u8]) -> u32 {
    u32::from_be_bytes(package[4..8].try_into().expect("4 bytes"))
}

/// A peer that seals with any counter.
pub fn sealer(of: &Credential, first: u32) -> Sealer {
    Sealer::resume(of.prepare().expect("a key"), of.id, first)
}
