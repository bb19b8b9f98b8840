//! Both ends of a sealed link on the host, over ports in memory and flash that forgets nothing.

mod ports;

use std::time::Duration;

use embedded_storage::nor_flash::NorFlash;
use mavlink_commsec::radio::{Request, Status};
use mavlink_commsec::{
    AesGcm, Credential, OpenError, Opener, PermitError, SealError, Sealer, SealingKey,
    SealingKeyError, SenderId, hx, packets,
};
use mavlink_signing::{Timestamp, crc::checksum};
use mavseal_relay::sealed::{
    ACCEPTED_KIND, HighWaterMarks, MarksError, Pace, Radio, SENT_KIND, STATUS_INTERVAL,
    SealedCounters, SealedEndpoint, SealedEndpointError, SealedEvent, SealedRejectReason,
};
use mavseal_relay::{
    Direction,
    adapter::{self, Polled, PortError},
};
use mavseal_store::{
    Binding, HighWaterMark, Region,
    model::{Flash, PAGE_SIZE},
};
use ports::{Broken, Line};

const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};
const MAX_DELAY: Duration = Duration::from_millis(50);
/// The same in ticks.
const PATIENT: u64 = 5000;
const VEHICLE: Credential = credential(7, 1);
const STATION: Credential = credential(5, 2);
const OTHER: Credential = credential(6, 3);
const HEARTBEAT: [u8; 17] = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];
const STATUS: Status = Status {
    rssi: 1,
    noise: 2,
    received: 3,
    remote_rssi: 4,
    remote_noise: 5,
    remote_received: 6,
    tx_errors: 7,
    rx_errors: 8,
    serial_tx_overflow: 9,
    serial_rx_overflow: 10,
    ecc_errors: 11,
    ecc_packets: 12,
    serial_tx_ok: 13,
    serial_rx_ok: 14,
};

const fn credential(id: u32, byte: u8) -> Credential {
    Credential {
        id: SenderId(id),
        key: [byte; 16],
        salt: 0x0102_0304 * byte as u32,
    }
}

/// A packet of MAVLink 2 with so many bytes: TUNNEL, of which any length is right that ends not in zero.
fn packet(bytes: usize) -> Vec<u8> {
    let length = bytes - 12;
    let mut packet = vec![0xFD, length as u8, 0, 0, 3, 1, 1, 0x81, 0x01, 0];
    packet.extend(vec![0x55; length]);
    let sum = checksum(&packet[1..], 147);
    packet.extend(sum.to_le_bytes());
    packet
}

/// An end of a link, its ports and its clock.
struct Bench<F, const N: usize> {
    end: SealedEndpoint<F, N>,
    local: Line,
    air: Line,
    now: u64,
    events: Vec<SealedEvent>,
}

type Vehicle = Bench<Flash<2>, 2>;

/// The marks in these flashes, provisioned if they are blank.
fn marks<F: NorFlash, const N: usize>(
    own: &Credential,
    peers: &[Credential; N],
    mut sent: F,
    mut accepted: [F; N],
) -> HighWaterMarks<F, N> {
    let places = accepted.each_mut().map(|flash| (flash, REGION));
    let opened = HighWaterMarks::open::<AesGcm>(own, peers, (&mut sent, REGION), places);
    let blank = opened.err() == Some(MarksError::NotProvisioned);
    let place = |flash| (flash, REGION);
    let (sent, accepted) = (place(sent), accepted.map(place));
    let marks = if blank {
        HighWaterMarks::provision::<AesGcm>(own, peers, sent, accepted)
    } else {
        HighWaterMarks::open::<AesGcm>(own, peers, sent, accepted)
    };
    marks.expect("marks")
}

/// Flashes with the marks of a vehicle that was never used.
fn provisioned() -> [Flash<2>; 3] {
    let mut flashes = [Flash::default(), Flash::default(), Flash::default()];
    let [sent, accepted @ ..] = flashes.each_mut();
    marks(&VEHICLE, &[STATION, OTHER], sent, accepted);
    flashes
}

/// What the marks of a sender are bound to.
fn binding(kind: u8, of: &Credential) -> Binding {
    let key = of.prepare::<AesGcm>().expect("a key");
    Binding::new(kind, key.fingerprint(of.id).expect("AES does not fail"))
}

impl<F: NorFlash, const N: usize> Bench<F, N> {
    fn new(own: &Credential, peers: &[Credential; N], sent: F, accepted: [F; N]) -> Self {
        let radio = Radio::Vehicle {
            system_id: 1,
            component_id: 68,
        };
        let marks = marks(own, peers, sent, accepted);
        let end = SealedEndpoint::new(own, peers, marks, radio, MAX_DELAY);
        Self::of(end.expect("keys"))
    }

    fn of(end: SealedEndpoint<F, N>) -> Self {
        let mut bench = Self {
            end,
            local: Line::new(),
            air: Line::new(),
            now: 0,
            events: Vec::new(),
        };
        // It begins with a question to its radio.
        bench.run();
        assert_eq!(
            frames(&bench.air.output),
            [(hx::FrameKind::Radio, b"B\r".to_vec())]
        );
        bench.air.output.clear();
        bench
    }

    fn run(&mut self) {
        let mut turns = 0..100_000;
        while self.poll().moved() {
            assert!(turns.next().is_some(), "the end does not come to rest");
        }
    }

    fn poll(&mut self) -> Polled<Broken, Broken> {
        let Self {
            end,
            local,
            air,
            now,
            events,
        } = self;
        let mut clock = Timestamp::from_ticks(*now).expect("48 bits");
        adapter::poll(end, local, air, &mut clock, &mut |event| events.push(event))
    }

    fn local_in(&mut self, bytes: &[u8]) {
        self.local.input.extend(bytes);
        self.run();
    }

    fn air_in(&mut self, tag: hx::FrameKind, payload: &[u8]) {
        let frame = hx::Frame::new(tag, payload).expect("a frame");
        self.air.input.extend(frame.encode());
        self.run();
    }

    /// The packages that have left since this was last asked.
    fn packages(&mut self) -> Vec<Vec<u8>> {
        let frames = frames(&std::mem::take(&mut self.air.output));
        let air = frames
            .into_iter()
            .filter(|(tag, _)| *tag == hx::FrameKind::AirData);
        air.map(|(_, payload)| payload).collect()
    }

    /// The package that a packet becomes.
    fn seal(&mut self, packet: &[u8]) -> Vec<u8> {
        self.local_in(packet);
        self.now += PATIENT;
        self.run();
        let mut packages = self.packages();
        assert_eq!(packages.len(), 1);
        packages.remove(0)
    }
}

fn vehicle() -> Vehicle {
    let flashes = [Flash::default(), Flash::default()];
    Bench::new(&VEHICLE, &[STATION, OTHER], Flash::default(), flashes)
}

fn station() -> Bench<Flash<2>, 1> {
    let peers = [VEHICLE];
    let marks = marks(&STATION, &peers, Flash::default(), [Flash::default()]);
    let end = SealedEndpoint::new(&STATION, &peers, marks, Radio::Station, MAX_DELAY);
    Bench::of(end.expect("keys"))
}

/// A station that only seals, with any counter.
fn sealer(of: &Credential, first: u32) -> Sealer {
    Sealer::resume(of.prepare().expect("a key"), of.id, first)
}

fn seal(sealer: &mut Sealer, packet: &[u8]) -> Vec<u8> {
    let mut message = [0; 80];
    message[..packet.len()].copy_from_slice(packet);
    sealer.seal(&message).expect("counters").as_bytes().to_vec()
}

fn frames(bytes: &[u8]) -> Vec<(hx::FrameKind, Vec<u8>)> {
    let mut decoder = hx::Decoder::new();
    let mut frames = Vec::new();
    for byte in bytes {
        if let Some(frame) = decoder.push(*byte) {
            let frame = frame.expect("whole frames");
            frames.push((frame.kind(), frame.payload().to_vec()));
        }
    }
    frames
}

fn counter(package: &[u8]) -> u32 {
    u32::from_be_bytes(package[4..8].try_into().expect("4 bytes"))
}

/// Every reason that has been counted, and how often.
fn rejections(counters: &SealedCounters) -> Vec<(SealedRejectReason, u32)> {
    for (reason, count) in counters.rejections() {
        assert_eq!(counters.rejected(reason), count);
    }
    let counted = counters.rejections().filter(|(_, count)| *count > 0);
    counted.collect()
}

#[test]
fn packets_arrive_whole_and_in_order_both_ways() {
    let (mut vehicle, mut station) = (vehicle(), station());
    let sent = [
        packet(12),
        packet(80),
        HEARTBEAT.to_vec(),
        packet(40),
        packet(41),
    ];
    vehicle.local_in(&sent.concat());
    vehicle.now += PATIENT;
    vehicle.run();
    let packages = vehicle.packages();
    // 12 and 80 do not fit together, nor 80 and 17; 17 leaves at once; 40 and 41 do not fit together.
    assert_eq!(packages.len(), 5);
    for package in &packages {
        assert_eq!(package.len(), 96);
        station.air_in(hx::FrameKind::AirData, package);
    }
    assert_eq!(station.local.output, sent.concat());
    assert_eq!(
        (
            vehicle.end.sealed().packages(),
            vehicle.end.sealed().packets()
        ),
        (5, 5)
    );
    assert_eq!(
        (
            station.end.opened().packages(),
            station.end.opened().packets()
        ),
        (5, 5)
    );
    assert_eq!(
        vehicle
            .events
            .iter()
            .filter(|event| **event == SealedEvent::Packed)
            .count(),
        5
    );
    let opened = [1, 2, 3, 4, 5].map(|counter| SealedEvent::Opened(SenderId(7), counter));
    assert_eq!(station.events, opened);

    let package = station.seal(&packet(30));
    vehicle.air_in(hx::FrameKind::AirData, &package);
    assert_eq!(vehicle.local.output, packet(30));
    assert_eq!(
        vehicle.events.last(),
        Some(&SealedEvent::Opened(SenderId(5), 1))
    );
    assert!(rejections(vehicle.end.opened()).is_empty());
    let none = [0; SealedRejectReason::ALL.len()];
    assert_eq!(
        format!("{:?}", vehicle.end),
        format!(
            "SealedEndpoint {{ sealed: SealedCounters {{ packages: 5, packets: 5, rejected: {none:?}, dropped: 0 }}, \
             opened: SealedCounters {{ packages: 1, packets: 1, rejected: {none:?}, dropped: 0 }}, .. }}"
        )
    );
}

#[test]
fn a_packet_waits_for_others_but_not_for_long() {
    let mut vehicle = vehicle();
    vehicle.local_in(&packet(20));
    vehicle.now += PATIENT - 1;
    vehicle.local_in(&packet(21));
    assert!(vehicle.packages().is_empty());
    vehicle.now += 1;
    vehicle.run();
    let packages = vehicle.packages();
    assert_eq!(packages.len(), 1);
    let mut opener = Opener::<1>::new();
    let key: SealingKey = VEHICLE.prepare().expect("a key");
    opener.permit(key, &[SenderId(7)]).expect("room");
    let opened = opener.open(&packages[0]).expect("a package");
    let held: Vec<_> = packets(opened.plaintext()).collect();
    assert_eq!(held, [Ok(&packet(20)[..]), Ok(&packet(21)[..])]);
}

#[test]
fn what_cannot_be_sealed_is_rejected_and_counted() {
    let mut vehicle = vehicle();
    let mut damaged = packet(30);
    damaged[20] ^= 1;
    let mut unknown = packet(30);
    unknown[7..10].fill(0xF0);
    let mut flags = packet(30);
    flags[2] = 0x40;
    for bytes in [packet(81), packet(267), damaged, unknown, flags] {
        vehicle.local_in(&bytes);
        // After what it cannot follow, it hears nothing before the line is silent.
        vehicle.now += mavseal_relay::IDLE + 1;
        vehicle.run();
    }
    assert!(vehicle.packages().is_empty());
    assert_eq!(
        rejections(vehicle.end.sealed()),
        [
            (SealedRejectReason::UnknownIncompatFlags, 1),
            (SealedRejectReason::UnknownMessage, 1),
            (SealedRejectReason::BadChecksum, 1),
            (SealedRejectReason::TooLong, 2),
        ]
    );
    let too_long = SealedEvent::Rejected(Direction::Outbound, SealedRejectReason::TooLong);
    assert_eq!(vehicle.events[..2], [too_long; 2]);
    // A packet that has begun goes on after any pause.
    vehicle.local_in(&packet(60)[..30]);
    vehicle.now += 9 * mavseal_relay::IDLE;
    vehicle.run();
    assert_eq!(vehicle.seal(&packet(60)[30..]).len(), 96);
}

#[test]
fn each_package_is_opened_once_and_what_is_none_never() {
    let mut vehicle = vehicle();
    let mut from_station = sealer(&STATION, 1);
    let package = seal(&mut from_station, &packet(20));
    let newer = seal(&mut from_station, &packet(21));
    // The older one was overtaken.
    for package in [&newer, &newer, &package, &package] {
        vehicle.air_in(hx::FrameKind::AirData, package);
    }
    assert_eq!(vehicle.local.output, [packet(21), packet(20)].concat());
    let mut forged = seal(&mut from_station, &packet(22));
    forged[50] ^= 1;
    vehicle.air_in(hx::FrameKind::AirData, &forged);
    let unknown = seal(&mut sealer(&credential(9, 2), 1), &packet(22));
    vehicle.air_in(hx::FrameKind::AirData, &unknown);
    let mut last = package.clone();
    last[4..8].fill(0xFF);
    vehicle.air_in(hx::FrameKind::AirData, &last);
    let own = vehicle.seal(&packet(20));
    vehicle.air_in(hx::FrameKind::AirData, &own);
    vehicle.air_in(hx::FrameKind::AirData, &newer[..95]);
    let no_packets = seal(&mut from_station, &[1, 2, 3]);
    vehicle.air_in(hx::FrameKind::AirData, &no_packets);
    let after = [packet(20), vec![0xFD, 200]].concat();
    let half = seal(&mut from_station, &after);
    vehicle.air_in(hx::FrameKind::AirData, &half);
    let opened = [packet(21), packet(20), packet(20)].concat();
    assert_eq!(vehicle.local.output, opened);
    assert_eq!(
        rejections(vehicle.end.opened()),
        [
            (SealedRejectReason::WrongLength, 1),
            (SealedRejectReason::UnknownSender, 2),
            (SealedRejectReason::NoCounter, 1),
            (SealedRejectReason::Stale, 2),
            (SealedRejectReason::BadTag, 1),
            (SealedRejectReason::NoPacket, 2),
        ]
    );
    // Nothing of it stands in the way of the other station.
    let package = seal(&mut sealer(&OTHER, 1), &packet(23));
    vehicle.air_in(hx::FrameKind::AirData, &package);
    assert!(vehicle.local.output.ends_with(&packet(23)));
}

#[test]
fn what_is_no_frame_is_rejected_and_the_next_frame_found() {
    let mut vehicle = vehicle();
    let package = seal(&mut sealer(&STATION, 1), &packet(20));
    let good: Vec<u8> = hx::Frame::new(hx::FrameKind::AirData, &package)
        .expect("a frame")
        .encode()
        .collect();
    let mut long = vec![0x7E, 0];
    long.extend([1; 101]);
    let bad: [&[u8]; 4] = [
        &[0x7E, 0, 0x7E],
        &[0x7E, 9, 1],
        &[0x7E, 0, 1, 0x7C, 0x7E],
        &long,
    ];
    for bytes in bad {
        vehicle.air.input.extend(bytes);
    }
    vehicle.air.input.extend(good);
    vehicle.run();
    assert_eq!(vehicle.local.output, packet(20));
    assert_eq!(
        rejections(vehicle.end.opened()),
        [
            (SealedRejectReason::EmptyFrame, 1),
            (SealedRejectReason::LongFrame, 1),
            (SealedRejectReason::TruncatedEscape, 1),
            (SealedRejectReason::UnknownKind, 1),
        ]
    );
}

#[test]
fn the_radio_is_asked_every_second_and_its_status_told() {
    let (mut vehicle, mut station) = (vehicle(), station());
    vehicle.air_in(hx::FrameKind::Radio, &STATUS.to_wire());
    vehicle.now += PATIENT;
    vehicle.run();
    let packages = vehicle.packages();
    assert_eq!(packages.len(), 1);
    station.air_in(hx::FrameKind::AirData, &packages[0]);
    assert_eq!(station.local.output, STATUS.vehicle_radio(0, 1, 68));
    station.local.output.clear();
    station.air_in(
        hx::FrameKind::Radio,
        &STATUS.to_wire_with(&Default::default()),
    );
    assert_eq!(station.local.output, STATUS.gcs_radio(0));
    assert_eq!(station.events.last(), Some(&SealedEvent::Radio(STATUS)));

    // One answer for each question.
    vehicle.air_in(hx::FrameKind::Radio, &STATUS.to_wire());
    vehicle.air_in(hx::FrameKind::Radio, b"OK");
    assert_eq!(
        rejections(vehicle.end.opened()),
        [
            (SealedRejectReason::NoStatus, 1),
            (SealedRejectReason::NotAsked, 1)
        ]
    );
    let asked = |bench: &mut Vehicle, now| {
        bench.now = now;
        bench.run();
        frames(&std::mem::take(&mut bench.air.output))
            == [(hx::FrameKind::Radio, Request::Status.to_wire().to_vec())]
    };
    assert!(!asked(&mut vehicle, STATUS_INTERVAL - 1));
    assert!(asked(&mut vehicle, STATUS_INTERVAL));
    assert!(asked(&mut vehicle, 2 * STATUS_INTERVAL));
    // Of two questions one is open, however many were not answered.
    for _ in 0..2 {
        vehicle.air_in(hx::FrameKind::Radio, &STATUS.to_wire());
    }
    assert_eq!(
        vehicle.end.opened().rejected(SealedRejectReason::NotAsked),
        2
    );
    vehicle.now += PATIENT;
    vehicle.run();
    station.local.output.clear();
    for package in vehicle.packages() {
        station.air_in(hx::FrameKind::AirData, &package);
    }
    // The next has another sequence number.
    assert_eq!(station.local.output, STATUS.vehicle_radio(1, 1, 68));
}

/// Where the end cannot ask, as its line is blocked, the answer to the last question comes too late all the same.
#[test]
fn an_answer_is_taken_until_the_next_question_is_due() {
    for (late, taken) in [(STATUS_INTERVAL - 1, true), (STATUS_INTERVAL, false)] {
        let mut vehicle = vehicle();
        vehicle.air.room = 0;
        vehicle.local_in(&HEARTBEAT);
        vehicle.now = late;
        vehicle.air_in(hx::FrameKind::Radio, &STATUS.to_wire());
        let told = vehicle.events.contains(&SealedEvent::Radio(STATUS));
        assert_eq!(told, taken);
    }
}

#[test]
fn slow_ports_lose_nothing() {
    let (mut vehicle, mut station) = (vehicle(), station());
    vehicle.air.room = 0;
    let sent: Vec<Vec<u8>> = (20..60).map(packet).collect();
    vehicle.local_in(&sent.concat());
    assert!(
        !vehicle.local.input.is_empty(),
        "it holds one message and one frame, no more"
    );
    while !vehicle.local.input.is_empty() || vehicle.end.sealed().packets() < 40 {
        vehicle.air.room = 7;
        vehicle.now += mavseal_relay::IDLE;
        vehicle.run();
    }
    vehicle.air.room = usize::MAX;
    vehicle.now += PATIENT;
    vehicle.run();
    station.air.input.extend(vehicle.air.output.drain(..));
    while !station.air.input.is_empty() || station.end.opened().packets() < 40 {
        station.local.room = 3;
        station.run();
    }
    station.local.room = usize::MAX;
    station.run();
    assert_eq!(station.local.output, sent.concat());
    assert!(
        rejections(station.end.opened())
            .iter()
            .all(|(reason, _)| *reason == SealedRejectReason::NoStatus)
    );
}

#[test]
fn a_radio_that_takes_nothing_is_no_silence() {
    let mut vehicle = vehicle();
    vehicle.air.room = 0;
    let last = packet(20);
    // The two that do not fit into one message, and the front of another with them.
    vehicle.local_in(&[packet(60), packet(60), last[..8].to_vec()].concat());
    assert!(vehicle.local.input.is_empty());
    vehicle.now += 2 * mavseal_relay::IDLE;
    vehicle.run();
    vehicle.air.room = usize::MAX;
    vehicle.run();
    vehicle.local_in(&last[8..]);
    assert_eq!(vehicle.end.sealed().packets(), 3);
    assert_eq!(vehicle.end.sealed().dropped(), 0);
}

#[test]
fn a_port_that_fails_is_told_and_does_not_stop_the_other_direction() {
    let mut vehicle = vehicle();
    vehicle.local.broken = true;
    let package = seal(&mut sealer(&STATION, 1), &packet(20));
    vehicle.air_in(hx::FrameKind::AirData, &package);
    let polled = vehicle.poll();
    assert_eq!(polled.outbound, Err(PortError::Input(Broken)));
    assert_eq!(vehicle.local.output, packet(20));
    vehicle.local.broken = false;
    vehicle.air.ended = true;
    assert_eq!(vehicle.poll().inbound, Err(PortError::InputClosed));
}

/// Runs a vehicle with these flashes, at 58 packages a second: counters it seals with, counters it accepts of the
/// station that begins at 1, and the flashes again.
fn life(flashes: [Flash<2>; 3], packages: u32) -> (Vec<u32>, Vec<u32>, [Flash<2>; 3]) {
    let [sent, a, b] = flashes;
    let mut vehicle: Vehicle = Bench::new(&VEHICLE, &[STATION, OTHER], sent, [a, b]);
    let mut from_station = sealer(&STATION, 1);
    let (mut used, mut accepted) = (Vec::new(), Vec::new());
    for at in 1..=packages {
        vehicle.now += 100_000 / 58;
        vehicle.local_in(&HEARTBEAT);
        used.extend(vehicle.packages().iter().map(|package| counter(package)));
        let package = seal(&mut from_station, &packet(20));
        let before = vehicle.end.opened().packages();
        vehicle.air_in(hx::FrameKind::AirData, &package);
        if vehicle.end.opened().packages() > before {
            accepted.push(at);
        }
    }
    let opened = vehicle.local.output.len() / 20;
    assert_eq!(opened, accepted.len());
    let (sent, [a, b]) = vehicle.end.into_flashes();
    (used, accepted, [sent, a, b])
}

#[test]
fn no_counter_is_used_or_accepted_twice_whenever_the_power_fails() {
    for cut in 0..60 {
        for at in 0..2 {
            let mut flashes = provisioned();
            flashes[at].cut_after(cut);
            let (used, accepted, mut flashes) = life(flashes, 100);
            flashes[at].restart();
            // The same packages come again.
            let (used_then, accepted_then, _) = life(flashes, 260);
            let last = used.last().copied().unwrap_or(0);
            let first = *used_then.first().expect("it goes on");
            assert!(first > last, "cut {cut} of {at}: {first} after {last}");
            assert!(u64::from(first - last) <= 1 + Pace::SENT.least);
            let last = accepted.last().copied().unwrap_or(0);
            let first = *accepted_then.first().expect("it goes on");
            assert!(
                first > last,
                "cut {cut} of {at}: {first} accepted after {last}"
            );
            // The fourth mark is 64 ahead.
            assert!(u64::from(first - last) <= 1 + 8 * Pace::ACCEPTED.least);
        }
    }
}

#[test]
fn what_cannot_be_remembered_is_rejected() {
    let mut flashes = provisioned();
    flashes[0].cut_after(0);
    flashes[1].cut_after(0);
    let [sent, a, b] = flashes;
    let mut vehicle: Vehicle = Bench::new(&VEHICLE, &[STATION, OTHER], sent, [a, b]);
    vehicle.local_in(&HEARTBEAT);
    assert!(vehicle.packages().is_empty());
    assert_eq!(
        rejections(vehicle.end.sealed()),
        [(SealedRejectReason::NotStored, 1)]
    );
    let mut from_station = sealer(&STATION, 1);
    let package = seal(&mut from_station, &packet(20));
    vehicle.air_in(hx::FrameKind::AirData, &package);
    assert!(vehicle.local.output.is_empty());
    assert_eq!(
        rejections(vehicle.end.opened()),
        [(SealedRejectReason::NotStored, 1)]
    );
    // The other station's mark is in another place.
    let package = seal(&mut sealer(&OTHER, 1), &packet(20));
    vehicle.air_in(hx::FrameKind::AirData, &package);
    assert_eq!(vehicle.local.output, packet(20));
}

#[test]
fn the_last_counter_is_used_once_and_nothing_follows() {
    let [mut flash, one, two] = provisioned();
    let binding = binding(SENT_KIND, &VEHICLE);
    let mut mark = HighWaterMark::open(&mut flash, REGION, binding).expect("a mark");
    mark.reserve(u64::from(u32::MAX) - 3, 0).expect("stored");
    let flashes = [one, two];
    let mut vehicle = Bench::new(&VEHICLE, &[STATION, OTHER], flash, flashes);
    assert_eq!(vehicle.end.next_counter(), Some(u32::MAX - 2));
    for expected in [u32::MAX - 2, u32::MAX - 1] {
        vehicle.local_in(&HEARTBEAT);
        assert_eq!(counter(&vehicle.packages()[0]), expected);
    }
    vehicle.local_in(&HEARTBEAT);
    assert!(vehicle.packages().is_empty());
    assert_eq!(
        rejections(vehicle.end.sealed()),
        [(SealedRejectReason::CounterExhausted, 1)]
    );
    // Nor after a restart, with a mark behind all counters.
    let (flash, flashes) = vehicle.end.into_flashes();
    let mut vehicle = Bench::new(&VEHICLE, &[STATION, OTHER], flash, flashes);
    assert_eq!(vehicle.end.next_counter(), None);
    vehicle.local_in(&HEARTBEAT);
    assert!(vehicle.packages().is_empty());
}

#[test]
fn peers_are_heard_above_their_marks() {
    let mut flashes = provisioned();
    let binding = binding(ACCEPTED_KIND, &OTHER);
    let mut mark = HighWaterMark::open(&mut flashes[2], REGION, binding).expect("a mark");
    mark.reserve(40, 9).expect("stored");
    let [sent, a, b] = flashes;
    let mut vehicle: Vehicle = Bench::new(&VEHICLE, &[STATION, OTHER], sent, [a, b]);
    let peers: Vec<_> = vehicle.end.peers().collect();
    assert_eq!(peers, [(SenderId(5), 0), (SenderId(6), 48)]);
    let mut other = sealer(&OTHER, 48);
    for _ in 0..2 {
        let package = seal(&mut other, &packet(20));
        vehicle.air_in(hx::FrameKind::AirData, &package);
    }
    assert_eq!(
        rejections(vehicle.end.opened()),
        [(SealedRejectReason::Stale, 1)]
    );
    assert_eq!(vehicle.end.opened().packages(), 1);
}

#[test]
fn keys_that_are_none_are_told() {
    let provision = |own: &Credential, peers: &[Credential; 1]| {
        let place = || (Flash::<2>::default(), REGION);
        HighWaterMarks::provision::<AesGcm>(own, peers, place(), [place()]).err()
    };
    let zero = credential(1, 0);
    let all_zero = Some(MarksError::Key(SealingKeyError::AllZero));
    assert_eq!(provision(&zero, &[STATION]), all_zero);
    assert_eq!(provision(&STATION, &[zero]), all_zero);
    // Two peers with one id are permitted twice.
    let peers = [STATION, credential(5, 4)];
    let marks = marks(
        &VEHICLE,
        &peers,
        Flash::<2>::default(),
        [(); 2].map(|()| Flash::default()),
    );
    let end = SealedEndpoint::<_, 2>::new(&VEHICLE, &peers, marks, Radio::Station, MAX_DELAY);
    let twice = PermitError::DuplicateSender(SenderId(5));
    assert_eq!(end.err(), Some(SealedEndpointError::Permit(twice)));
}

#[test]
fn every_error_is_told_apart() {
    for (error, rejection) in [
        (
            OpenError::IntegrityLimitReached,
            SealedRejectReason::IntegrityLimitReached,
        ),
        (OpenError::BadTag, SealedRejectReason::BadTag),
        (
            OpenError::JumpTooFar(SenderId(5)),
            SealedRejectReason::JumpTooFar,
        ),
        (OpenError::WrongLength(95), SealedRejectReason::WrongLength),
    ] {
        assert_eq!(SealedRejectReason::from(error), rejection);
    }
    assert_eq!(
        SealedRejectReason::from(SealError::CounterExhausted),
        SealedRejectReason::CounterExhausted
    );
    assert_eq!(
        SealedRejectReason::from(SealError::Cipher),
        SealedRejectReason::CipherFailed
    );
}

#[test]
fn every_reason_has_words_of_its_own() {
    let mut words: Vec<_> = SealedRejectReason::ALL
        .iter()
        .map(ToString::to_string)
        .collect();
    let same = |reason: &SealedRejectReason| reason.to_string() == reason.as_str();
    assert!(SealedRejectReason::ALL.iter().all(same));
    words.sort();
    words.dedup();
    assert_eq!(words.len(), SealedRejectReason::ALL.len());
}
