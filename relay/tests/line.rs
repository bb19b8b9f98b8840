//! Line events and deadlines of both kinds of endpoint, without ports.

use std::time::Duration;

use mavlink_commsec::{AesGcm, Credential, SenderId, hx};
use mavlink_signing::{
    Frame, Header, Hmac, MessageId, ReplayGuard, SigningKey, Stamp, Stamper, Timestamp, Window,
    crc::checksum, sign_frame,
};
use mavseal_relay::{
    Direction, Endpoint, Event, ForwardMode, IDLE, LineEvent, RejectReason, Relay, Side,
    sealed::{
        HighWaterMarks, Radio, STATUS_INTERVAL, SealedEndpoint, SealedEvent, SealedRejectReason,
    },
};
use mavseal_store::{
    Region,
    model::{Flash, PAGE_SIZE},
};

const NOW: u64 = 37_555_200_000_000;
const LINK_OUT: u8 = 1;
const LINK_IN: u8 = 2;
const FAULTS: [LineEvent; 3] = [
    LineEvent::Overrun,
    LineEvent::FramingError,
    LineEvent::Noise,
];

fn at(ticks: u64) -> Timestamp {
    Timestamp::from_ticks(ticks).expect("48 bits")
}

fn key() -> SigningKey<Hmac> {
    SigningKey::new(&[7; 32]).expect("a key")
}

fn unsigned(payload: &[u8]) -> Frame {
    let header = Header {
        compat_flags: 0,
        sequence: 9,
        system_id: 1,
        component_id: 1,
        message_id: MessageId::from(0),
    };
    Frame::new(header, payload).expect("a frame")
}

fn signed(payload: &[u8], ticks: u64) -> Frame {
    let mut frame = unsigned(payload);
    let stamp = Stamp {
        link_id: LINK_IN,
        timestamp: at(ticks),
    };
    sign_frame(&mut frame, &key(), stamp).expect("unsigned");
    frame
}

/// An endpoint, the time, and all that it told.
struct Bench<E: Endpoint> {
    end: E,
    now: u64,
    events: Vec<E::Event>,
}

fn relay() -> Bench<Relay<Hmac>> {
    let replay = ReplayGuard::new(LINK_IN, Window::ONE_MINUTE);
    let stamper = Stamper::new(LINK_OUT);
    let end = Relay::new(key(), stamper, replay, ForwardMode::StripSignature).expect("two links");
    Bench::of(end)
}

impl<E: Endpoint> Bench<E> {
    fn of(end: E) -> Self {
        Self {
            end,
            now: NOW,
            events: Vec::new(),
        }
    }

    fn input(&mut self, side: Side, bytes: &[u8]) -> usize {
        let mut observe = |event| self.events.push(event);
        self.end
            .received(side, bytes, &mut at(self.now), &mut observe)
    }

    fn event(&mut self, side: Side, event: LineEvent) {
        let mut observe = |event| self.events.push(event);
        self.end
            .line_event(side, event, &mut at(self.now), &mut observe);
    }

    fn poll_at(&mut self, now: u64) {
        self.now = now;
        let mut observe = |event| self.events.push(event);
        self.end.poll(&mut at(now), &mut observe);
    }

    fn output(&mut self, side: Side) -> Vec<u8> {
        let mut buffer = [0; 2000];
        let mut observe = |event| self.events.push(event);
        let count = self
            .end
            .transmit(side, &mut buffer, &mut at(self.now), &mut observe);
        buffer[..count].to_vec()
    }
}

/// A command inside a payload, of which the outer packet's front is lost.
#[test]
fn after_a_fault_the_local_side_is_deaf_until_the_line_is_silent() {
    let inner = unsigned(&[1, 2, 3]);
    for fault in FAULTS {
        let mut bench = relay();
        bench.input(Side::Local, &unsigned(&[9; 40]).as_bytes()[..12]);
        bench.event(Side::Local, fault);
        // As long as bytes come it hears nothing.
        for _ in 0..3 {
            bench.poll_at(bench.now + IDLE);
            assert_eq!(
                bench.input(Side::Local, inner.as_bytes()),
                inner.as_bytes().len()
            );
            bench.event(Side::Local, fault);
        }
        assert_eq!(bench.end.poll_at(), Some(bench.now + IDLE + 1));
        bench.poll_at(bench.now + IDLE);
        bench.input(Side::Local, &inner.as_bytes()[..5]);
        bench.poll_at(bench.now + IDLE + 1);
        assert_eq!(bench.end.poll_at(), None);
        assert!(bench.end.pending(Side::Link).is_empty());
        let dropped = 12 + 3 * inner.as_bytes().len() + 5;
        assert_eq!(bench.end.outbound().dropped() as usize, dropped);

        bench.input(Side::Local, inner.as_bytes());
        assert_eq!(bench.events, [Event::Passed(Direction::Outbound)]);
        assert!(!bench.output(Side::Link).is_empty());
    }
}

#[test]
fn an_idle_line_is_heard_at_once() {
    let mut bench = relay();
    bench.event(Side::Local, LineEvent::Overrun);
    bench.input(Side::Local, &[1, 2, 3]);
    bench.event(Side::Local, LineEvent::Idle);
    assert_eq!(bench.end.poll_at(), None);
    let frame = unsigned(&[1]);
    bench.input(Side::Local, frame.as_bytes());
    assert_eq!(bench.end.outbound().passed(), 1);
    assert_eq!(bench.end.outbound().dropped(), 3);
    bench.output(Side::Link);
    // A pause within a packet is no end of it.
    for cut in 1..frame.as_bytes().len() {
        let (begin, end) = frame.as_bytes().split_at(cut);
        bench.input(Side::Local, begin);
        bench.event(Side::Local, LineEvent::Idle);
        bench.poll_at(bench.now + 100 * IDLE);
        bench.input(Side::Local, end);
        assert!(!bench.output(Side::Link).is_empty(), "cut at {cut}");
    }
    assert_eq!(bench.end.outbound().dropped(), 3);
}

#[test]
fn after_a_fault_the_link_side_searches_what_has_begun() {
    for fault in FAULTS {
        let mut bench = relay();
        bench.input(Side::Link, &[0xFD, 255, 0]);
        bench.input(Side::Link, signed(&[1, 2, 3], NOW).as_bytes());
        assert!(bench.end.pending(Side::Local).is_empty());
        bench.event(Side::Link, fault);
        assert_eq!(bench.output(Side::Local), unsigned(&[1, 2, 3]).as_bytes());
        // It is not deaf.
        bench.input(Side::Link, signed(&[4], NOW + 1).as_bytes());
        assert_eq!(bench.output(Side::Local), unsigned(&[4]).as_bytes());
    }
}

/// A fault while a frame waits to go out: whole packets from before it still go on, what had begun does not, and
/// what comes after it is not joined to it.
#[test]
fn a_fault_behind_a_frame_that_waits() {
    let (first, second) = (unsigned(&[1; 20]), unsigned(&[2; 20]));
    let third = unsigned(&[3; 20]);
    let (begun, rest) = third.as_bytes().split_at(10);
    let mut bench = relay();
    let all = [first.as_bytes(), second.as_bytes(), begun].concat();
    assert_eq!(bench.input(Side::Local, &all), all.len());
    bench.event(Side::Local, LineEvent::Overrun);
    bench.event(Side::Local, LineEvent::Idle);
    assert_eq!(bench.end.room(Side::Local), 0);
    assert_eq!(bench.input(Side::Local, rest), 0);
    let output = bench.output(Side::Link);
    assert_eq!(
        output.len(),
        first.as_bytes().len() + second.as_bytes().len() + 26
    );
    assert_eq!(bench.input(Side::Local, rest), rest.len());
    bench.event(Side::Local, LineEvent::Idle);
    assert_eq!(bench.end.outbound().passed(), 2);
    assert_eq!(bench.end.outbound().dropped(), 30 + 2);
}

#[test]
fn what_a_closed_line_was_to_take_is_dropped_and_counted() {
    let mut bench = relay();
    bench.input(Side::Local, unsigned(&[1]).as_bytes());
    bench.input(Side::Local, unsigned(&[2]).as_bytes());
    bench.input(Side::Link, signed(&[1], NOW).as_bytes());
    bench.input(Side::Link, &[0xFD, 255, 0]);
    bench.event(Side::Link, LineEvent::Closed);
    let passed = |direction| Event::Passed(direction);
    let dropped = Event::Rejected(Direction::Outbound, RejectReason::LineClosed);
    assert_eq!(
        bench.events,
        [
            passed(Direction::Outbound),
            passed(Direction::Inbound),
            dropped,
            passed(Direction::Outbound)
        ]
    );
    assert_eq!(bench.end.outbound().rejected(RejectReason::LineClosed), 1);
    // The packet behind it is the next, and so is the one behind what had begun on the link side.
    let signed_second = bench.output(Side::Link);
    assert_eq!(signed_second[10], 2);
    assert_eq!(bench.output(Side::Local), unsigned(&[1]).as_bytes());
    bench.input(Side::Link, signed(&[3], NOW + 1).as_bytes());
    assert_eq!(bench.output(Side::Local), unsigned(&[3]).as_bytes());

    // A local side that is plugged in again may begin within a packet.
    bench.event(Side::Local, LineEvent::Closed);
    bench.input(Side::Local, unsigned(&[1]).as_bytes());
    assert!(bench.output(Side::Link).is_empty());
    bench.poll_at(bench.now + IDLE + 1);
    bench.input(Side::Local, unsigned(&[1]).as_bytes());
    assert!(!bench.output(Side::Link).is_empty());
    assert_eq!(bench.end.inbound().rejected(RejectReason::LineClosed), 0);
}

#[test]
fn a_relay_waits_for_time_only_where_it_changes_something() {
    let mut bench = relay();
    assert_eq!(bench.end.poll_at(), None);
    // On the link side for what has begun, longer the more it announces.
    bench.input(Side::Link, &[0xFD]);
    let longest = bench.end.poll_at().expect("a time");
    bench.input(Side::Link, &[0, 0]);
    let shortest = bench.end.poll_at().expect("a time");
    assert!(NOW + IDLE < shortest && shortest < longest);
    // 280 bytes and 12, with 5,760 a second.
    assert!((longest - shortest).abs_diff((280 - 12) * 4862 / 280) <= 1);
    bench.poll_at(shortest - 1);
    assert_eq!(bench.end.inbound().dropped(), 0);
    bench.poll_at(shortest);
    assert_eq!(
        (bench.end.poll_at(), bench.end.inbound().dropped()),
        (None, 3)
    );
    // On the local side for silence, and not for what has begun.
    bench.input(Side::Local, &[0xFD]);
    assert_eq!(bench.end.poll_at(), None);
    bench.event(Side::Local, LineEvent::Noise);
    assert_eq!(bench.end.poll_at(), Some(bench.now + IDLE + 1));
    bench.event(Side::Local, LineEvent::Idle);
    // While a frame waits to go out, its direction waits for nothing else.
    bench.input(Side::Link, signed(&[1], NOW).as_bytes());
    bench.input(Side::Link, &[0xFD]);
    assert_eq!(bench.end.poll_at(), None);
    bench.now += 7;
    bench.output(Side::Local);
    assert_eq!(bench.end.poll_at(), Some(bench.now + longest - NOW));
}

const STATION: Credential = credential(5);
const VEHICLE: Credential = credential(7);
/// 50 milliseconds.
const MAX_DELAY: u64 = 5000;

const fn credential(id: u32) -> Credential {
    Credential {
        id: SenderId(id),
        key: [id as u8; 16],
        salt: 1,
    }
}

fn sealed(own: &Credential, peer: Credential) -> Bench<SealedEndpoint<Flash<2>, 1>> {
    let region = Region {
        start: 0,
        page_size: PAGE_SIZE as u32,
    };
    let place = || (Flash::default(), region);
    let peers = [peer];
    let marks = HighWaterMarks::provision::<AesGcm>(own, &peers, place(), [place()]);
    let marks = marks.expect("blank flashes");
    let max_delay = Duration::from_millis(50);
    let end = SealedEndpoint::new(own, &peers, marks, Radio::Station, max_delay).expect("keys");
    let mut bench = Bench::of(end);
    // It begins with a question to its radio.
    assert_eq!(bench.end.poll_at(), Some(0));
    bench.poll_at(NOW);
    assert_eq!(bench.output(Side::Link), [0x7E, 1, b'B', b'\r', 0x7E]);
    assert_eq!(bench.end.poll_at(), Some(NOW + STATUS_INTERVAL));
    bench
}

/// TUNNEL in so many bytes.
fn packet(bytes: usize) -> Vec<u8> {
    let length = bytes - 12;
    let mut packet = vec![0xFD, length as u8, 0, 0, 3, 1, 1, 0x81, 0x01, 0];
    packet.extend(vec![0x55; length]);
    packet.extend(checksum(&packet[1..], 147).to_le_bytes());
    packet
}

#[test]
fn a_sealed_end_tells_when_a_package_is_due() {
    let mut bench = sealed(&STATION, VEHICLE);
    bench.input(Side::Local, &packet(20));
    assert_eq!(bench.end.poll_at(), Some(NOW + MAX_DELAY));
    bench.poll_at(NOW + MAX_DELAY - 1);
    assert!(bench.output(Side::Link).is_empty());
    bench.poll_at(NOW + MAX_DELAY);
    assert_eq!(bench.end.poll_at(), None);
    assert!(bench.output(Side::Link).len() >= 99);
    assert_eq!(bench.end.poll_at(), Some(NOW + STATUS_INTERVAL));
}

#[test]
fn a_sealed_end_is_deaf_after_a_fault_on_its_local_side() {
    let mut bench = sealed(&STATION, VEHICLE);
    bench.input(Side::Local, &packet(40)[..12]);
    bench.event(Side::Local, LineEvent::FramingError);
    bench.input(Side::Local, &packet(20));
    bench.event(Side::Local, LineEvent::Idle);
    bench.input(Side::Local, &packet(21));
    assert_eq!(bench.events, [SealedEvent::Packed]);
    assert_eq!(bench.end.sealed().dropped(), 12 + 20);
}

/// A frame that was damaged on its way from the radio is given up before its tag is looked at.
#[test]
fn a_sealed_end_gives_up_a_frame_with_a_fault() {
    let mut vehicle = sealed(&VEHICLE, STATION);
    vehicle.input(Side::Local, &packet(20));
    vehicle.poll_at(NOW + MAX_DELAY);
    let frame = vehicle.output(Side::Link);
    let mut bench = sealed(&STATION, VEHICLE);
    let (begin, end) = frame.split_at(30);
    bench.input(Side::Link, begin);
    bench.event(Side::Link, LineEvent::Overrun);
    bench.input(Side::Link, &end[1..]);
    assert_eq!(bench.events, []);
    // Its silence is none.
    bench.input(Side::Link, begin);
    bench.event(Side::Link, LineEvent::Idle);
    bench.input(Side::Link, end);
    assert_eq!(bench.events, [SealedEvent::Opened(SenderId(7), 1)]);

    // It takes nothing more before its packets have left, or can leave no more.
    assert_eq!(bench.end.room(Side::Link), 0);
    assert_eq!(bench.input(Side::Link, &[hx::FLAG]), 0);
    bench.event(Side::Local, LineEvent::Closed);
    assert_eq!(bench.input(Side::Link, &[hx::FLAG]), 1);
    let dropped = SealedRejectReason::LineClosed;
    assert_eq!(bench.end.opened().rejected(dropped), 1);
    assert_eq!(
        bench.events.last(),
        Some(&SealedEvent::Rejected(Direction::Inbound, dropped))
    );
    assert!(bench.output(Side::Local).is_empty());

    vehicle.input(Side::Local, &packet(20));
    vehicle.poll_at(NOW + 2 * MAX_DELAY);
    vehicle.event(Side::Link, LineEvent::Closed);
    assert!(vehicle.output(Side::Link).is_empty());
    assert_eq!(vehicle.end.sealed().rejected(dropped), 1);
}
