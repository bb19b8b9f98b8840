//! The in-line signer on the host, over ports in memory.

mod ports;

use mavlink_signing::{
    AllowRadioStatus, AntiReplay, Frame, FrameRef, Header, Hmac, KeySlot, Links, MessageId, Packet,
    RejectUnsigned, ReplayGuard, SetupSigning, SigningKey, Stamp, Stamper, StreamTable, Timestamp,
    UnsignedPolicy, VerifyError, Window, crc::checksum, sign_frame,
};
use mavseal_relay::{
    Counters, Direction, Endpoint, Event, ForwardMode, IDLE, Presence, RejectReason,
    RejectedPacket, Relay, SameLinkId, Senders, Signer, Verifier,
    adapter::{self, Polled, PortError},
};
use ports::{Broken, Line};

const KEY: [u8; 32] = *b"a key for tests, known to anyone";
const LINK_OUT: u8 = 1;
const LINK_IN: u8 = 2;
const NOW: u64 = 37_555_200_000_000;
/// 100 milliseconds in ticks of 10 microseconds: the silence that ends a packet.
const SILENCE: u64 = 10_000;
/// More turns than any test needs.
const MANY: u32 = 100_000;

/// A relay, its two lines and its clock.
struct Bench<R = ReplayGuard, U = RejectUnsigned> {
    relay: Relay<Hmac, R, U>,
    local: Line,
    link: Line,
    now: u64,
    events: Vec<Event>,
}

impl Bench {
    fn new() -> Self {
        Self::with(Stamper::new(LINK_OUT), ForwardMode::StripSignature)
    }

    fn with(stamper: Stamper, forward: ForwardMode) -> Self {
        let replay = ReplayGuard::new(LINK_IN, Window::STRICT);
        Self::of(Relay::new(key(), stamper, replay, forward).expect("different links"))
    }
}

impl<R: AntiReplay, U: UnsignedPolicy> Bench<R, U> {
    fn of(relay: Relay<Hmac, R, U>) -> Self {
        Self {
            relay,
            local: Line::new(),
            link: Line::new(),
            now: NOW,
            events: Vec::new(),
        }
    }

    /// Polls until nothing moves.
    fn run(&mut self) {
        let mut turns = 0..MANY;
        while self.poll().moved() {
            assert!(turns.next().is_some(), "the relay does not come to rest");
        }
    }

    fn poll(&mut self) -> Polled<Broken, Broken> {
        let mut observe = |event| self.events.push(event);
        adapter::poll(
            &mut self.relay,
            &mut self.local,
            &mut self.link,
            &mut at(self.now),
            &mut observe,
        )
    }

    fn local_in(&mut self, bytes: &[u8]) {
        self.local.input.extend(bytes);
        self.run();
    }

    /// The lines are silent for so long that a deaf side hears again.
    fn silence(&mut self) {
        self.now += SILENCE + 1;
        self.run();
    }

    fn link_in(&mut self, bytes: &[u8]) {
        self.link.input.extend(bytes);
        self.run();
    }
}

fn key() -> SigningKey<Hmac> {
    SigningKey::new(&KEY).expect("a key")
}

fn at(ticks: u64) -> Timestamp {
    Timestamp::from_ticks(ticks).expect("48 bits")
}

fn header() -> Header {
    Header {
        compat_flags: 0x40,
        sequence: 9,
        system_id: 1,
        component_id: 1,
        message_id: MessageId::from(0),
    }
}

fn unsigned(payload: &[u8]) -> Frame {
    Frame::new(header(), payload).expect("a frame")
}

fn signed(payload: &[u8], link_id: u8, ticks: u64) -> Frame {
    let mut frame = unsigned(payload);
    let stamp = Stamp {
        link_id,
        timestamp: at(ticks),
    };
    sign_frame(&mut frame, &key(), stamp).expect("signed");
    frame
}

/// Every reason that has been counted, and how often.
fn rejections(counters: &Counters) -> Vec<(RejectReason, u32)> {
    let counted: Vec<_> = counters.rejections().collect();
    let asked = RejectReason::ALL.iter();
    let asked: Vec<_> = asked
        .map(|&reason| (reason, counters.rejected(reason)))
        .collect();
    assert_eq!(counted, asked);
    counted
        .into_iter()
        .filter(|(_, count)| *count > 0)
        .collect()
}

/// `bytes` with the bits of `flip` changed at `offset`.
fn damaged(bytes: &[u8], offset: usize, flip: u8) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    bytes[offset] ^= flip;
    bytes
}

const MAVLINK1: [u8; 17] = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];

#[test]
fn signs_what_comes_from_the_local_side() {
    let mut bench = Bench::new();
    for length in [0, 1, 9, 255] {
        bench.local_in(unsigned(&vec![7; length]).as_bytes());
        bench.now += 100;
    }
    let mut expected = Vec::new();
    for (i, length) in [0, 1, 9, 255].into_iter().enumerate() {
        let frame = signed(&vec![7; length], LINK_OUT, NOW + 100 * i as u64);
        let (covered, tag) = frame.as_bytes().split_at(frame.as_bytes().len() - 6);
        assert_eq!(tag, &hmac_sha256::HMAC::mac(covered, KEY)[..6]);
        expected.extend(frame.as_bytes());
    }
    assert_eq!(bench.link.output, expected);
    assert!(bench.local.output.is_empty());
    assert_eq!(bench.relay.outbound().passed(), 4);
    assert_eq!(bench.events, [Event::Passed(Direction::Outbound); 4]);
}

#[test]
fn what_must_not_be_signed_is_rejected_and_counted() {
    let mut bench = Bench::new();
    let frame = unsigned(&[1, 2, 3]);
    bench.local_in(&MAVLINK1);
    bench.local_in(signed(&[1, 2, 3], LINK_OUT, NOW).as_bytes());
    for (offset, flip) in [(10, 4), (9, 0x80), (2, 0x20)] {
        bench.local_in(&damaged(frame.as_bytes(), offset, flip));
        // What follows may lie within a payload, for all that is known.
        bench.local_in(frame.as_bytes());
        bench.silence();
    }
    bench.local_in(b"noise");
    bench.local_in(frame.as_bytes());
    bench.silence();
    assert!(bench.link.output.is_empty());
    assert_eq!(
        rejections(bench.relay.outbound()),
        [
            (RejectReason::Mavlink1, 1),
            (RejectReason::UnknownIncompatFlags, 1),
            (RejectReason::UnknownMessage, 1),
            (RejectReason::BadChecksum, 1),
            (RejectReason::AlreadySigned, 1),
        ]
    );
    assert_eq!(rejections(bench.relay.inbound()), []);
    let rejected = Event::Rejected(Direction::Outbound, RejectReason::Mavlink1);
    assert_eq!(bench.events.first(), Some(&rejected));
    assert_eq!(bench.relay.outbound().dropped(), 7 * 15 + 5);

    bench.local_in(frame.as_bytes());
    assert_eq!(bench.relay.outbound().passed(), 1);
}

#[test]
fn verified_frames_leave_unsigned_or_whole() {
    let frame = signed(&[1, 2, 3], LINK_IN, NOW);
    let mut bench = Bench::new();
    bench.link_in(frame.as_bytes());
    assert_eq!(bench.local.output, unsigned(&[1, 2, 3]).as_bytes());

    let mut bench = Bench::with(Stamper::new(LINK_OUT), ForwardMode::KeepSignature);
    bench.link_in(frame.as_bytes());
    assert_eq!(bench.local.output, frame.as_bytes());
}

#[test]
fn everything_else_from_the_link_side_is_rejected_and_counted() {
    let mut bench = Bench::new();
    let good = signed(&[1, 2, 3], LINK_IN, NOW);
    bench.link_in(good.as_bytes());
    bench.local.output.clear();

    bench.link_in(good.as_bytes());
    bench.link_in(unsigned(&[1]).as_bytes());
    bench.link_in(signed(&[1], LINK_OUT, NOW + 1).as_bytes());
    bench.link_in(signed(&[1], LINK_IN, NOW + 1).as_bytes());
    bench.link_in(signed(&[1], LINK_IN, NOW - 1_000_001).as_bytes());
    let tag_at = good.as_bytes().len() - 1;
    bench.link_in(&damaged(good.as_bytes(), tag_at, 1));
    bench.link_in(&damaged(good.as_bytes(), 10, 4));
    bench.link_in(&damaged(good.as_bytes(), 9, 0x80));
    bench.link_in(&damaged(good.as_bytes(), 2, 0x20));
    bench.link_in(&MAVLINK1);

    assert!(bench.local.output.is_empty());
    assert!(bench.link.output.is_empty());
    assert_eq!(
        rejections(bench.relay.inbound()),
        [
            (RejectReason::Mavlink1, 1),
            (RejectReason::UnknownIncompatFlags, 1),
            (RejectReason::UnknownMessage, 1),
            (RejectReason::BadChecksum, 1),
            (RejectReason::NotSigned, 1),
            (RejectReason::BadTag, 1),
            (RejectReason::WrongLink, 1),
            (RejectReason::FromFuture, 1),
            (RejectReason::TooOld, 1),
            (RejectReason::Replayed, 1),
        ]
    );
    assert_eq!(rejections(bench.relay.outbound()), []);
}

#[test]
fn own_frames_reflected_are_rejected() {
    let mut bench = Bench::new();
    bench.local_in(unsigned(&[1, 2, 3]).as_bytes());
    let reflected = bench.link.output.clone();
    bench.link_in(&reflected);
    assert!(bench.local.output.is_empty());
    assert_eq!(bench.relay.inbound().rejected(RejectReason::WrongLink), 1);
}

#[test]
fn one_link_id_for_both_directions_is_rejected() {
    let replay = ReplayGuard::new(5, Window::STRICT);
    let relay = Relay::new(key(), Stamper::new(5), replay, ForwardMode::StripSignature);
    assert_eq!(relay.expect_err("the same").0, 5);
}

#[test]
fn a_stalled_direction_loses_nothing_and_stalls_nothing() {
    let mut bench = Bench::new();
    bench.local.room = 10;
    let mut expected = Vec::new();
    for i in 0..20 {
        let frame = signed(&[i; 100], LINK_IN, NOW + u64::from(i));
        bench.link.input.extend(frame.as_bytes());
        expected.extend_from_slice(unsigned(&[i; 100]).as_bytes());
    }
    bench.now += 20;
    bench.run();
    assert_eq!(bench.local.output, expected[..10]);
    assert!(!bench.link.input.is_empty(), "memory is bounded");

    // The other direction goes on.
    bench.local_in(unsigned(&[1, 2, 3]).as_bytes());
    assert_eq!(bench.relay.outbound().passed(), 1);

    // One byte at a time.
    bench.local.at_once = 1;
    for _ in 0..2 * expected.len() {
        bench.local.room = 1;
        let _ = bench.poll();
    }
    assert_eq!(bench.local.output, expected);
}

#[test]
fn a_broken_port_does_not_stop_the_other_direction() {
    let mut bench = Bench::new();
    bench.local.broken = true;
    bench
        .link
        .input
        .extend(signed(&[1], LINK_IN, NOW).as_bytes());
    for _ in 0..10 {
        let polled = bench.poll();
        assert_eq!(polled.outbound, Err(PortError::Input(Broken)));
    }
    assert_eq!(bench.relay.inbound().passed(), 1);

    bench.local.broken = false;
    bench.local_in(unsigned(&[1]).as_bytes());
    assert_eq!(bench.relay.outbound().passed(), 1);
}

#[test]
fn a_port_that_takes_nothing_is_closed() {
    let mut bench = Bench::new();
    bench.link.at_once = 0;
    bench.local.input.extend(unsigned(&[1]).as_bytes());
    let error = (0..10).find_map(|_| bench.poll().outbound.err());
    assert_eq!(error, Some(PortError::OutputClosed));

    // The frame is still there.
    bench.link.at_once = 280;
    bench.run();
    assert_eq!(bench.link.output, signed(&[1], LINK_OUT, NOW).as_bytes());
}

#[test]
fn noise_that_announces_much_is_given_up_in_time() {
    // From the link side the packet behind the noise is found, when the noise's own would have come.
    let mut bench = Bench::new();
    bench.link.input.extend([0xFD, 255, 0]);
    bench.link_in(signed(&[1, 2, 3], LINK_IN, NOW).as_bytes());
    assert!(bench.local.output.is_empty());
    let due = bench.relay.poll_at().expect("it is waited for");
    assert!(
        due > NOW + SILENCE && due < NOW + 2 * SILENCE,
        "{}",
        due - NOW
    );
    bench.now = due - 1;
    bench.run();
    assert!(bench.local.output.is_empty(), "not yet");
    bench.now = due;
    bench.run();
    assert_eq!(bench.relay.inbound().passed(), 1);

    // On the local side it may be the packet that it announces: its bytes are waited for, and then it is none.
    let mut bench = Bench::new();
    let frame = unsigned(&[1, 2, 3]);
    bench.local.input.extend([0xFD, 255, 0]);
    for _ in 0..17 {
        bench.local_in(frame.as_bytes());
        bench.silence();
    }
    assert!(bench.link.output.is_empty());
    bench.local_in(frame.as_bytes());
    bench.silence();
    let rejected = rejections(bench.relay.outbound());
    assert_eq!(rejected, [(RejectReason::UnknownMessage, 1)]);
    assert_eq!(bench.relay.outbound().dropped(), 3 + 18 * 15);
    bench.local_in(frame.as_bytes());
    assert_eq!(bench.relay.outbound().passed(), 1);
}

/// Few bytes hold nobody up: whoever adds a byte now and then delays a frame by no more than a packet takes.
#[test]
fn a_few_bytes_a_second_hold_up_nothing() {
    for (honest, every) in [(1, 90), (5, 90), (10, 490), (1, 490)] {
        let mut bench = Bench::new();
        let head = [0xFD, 255, 1, 0, 0, 1, 1, 0, 0, 0];
        let (mut sent, mut worst, mut passed) = (0_u64, 0, 0);
        let mut waiting = None;
        // Steps of 10 milliseconds.
        for step in 0..12_000_u64 {
            bench.now = NOW + step * 1000;
            if step % (every / 10) == 0 {
                let byte = (step / (every / 10)) as usize % 280;
                bench.link.input.push_back(*head.get(byte).unwrap_or(&0x55));
            }
            if step % (honest * 100) == 50 {
                let frame = signed(&[1; 33], LINK_IN, bench.now);
                bench.link.input.extend(frame.as_bytes());
                sent += 1;
                waiting = Some(bench.now);
            }
            bench.run();
            if bench.relay.inbound().passed() > passed {
                passed += 1;
                worst = worst.max(bench.now - waiting.take().expect("one was sent"));
            }
        }
        assert_eq!(u64::from(passed), sent, "every {every} ms a byte");
        assert!(worst < 20_000, "200 milliseconds: {worst}");
    }
}

#[test]
fn a_used_up_clock_signs_nothing() {
    let stamper = Stamper::resume(LINK_OUT, Timestamp::MAX);
    let mut bench = Bench::with(stamper, ForwardMode::StripSignature);
    bench.local_in(unsigned(&[1]).as_bytes());
    bench.link.output.clear();
    bench.local_in(unsigned(&[1]).as_bytes());
    assert!(bench.link.output.is_empty());
    assert_eq!(
        rejections(bench.relay.outbound()),
        [(RejectReason::TimestampsExhausted, 1)]
    );
}

#[test]
fn rejected_frames_use_up_no_stamp() {
    let mut bench = Bench::new();
    bench.local_in(signed(&[1], LINK_OUT, NOW).as_bytes());
    bench.local_in(&damaged(unsigned(&[1]).as_bytes(), 10, 4));
    bench.silence();
    bench.now = NOW;
    bench.local_in(unsigned(&[1]).as_bytes());
    assert_eq!(bench.link.output, signed(&[1], LINK_OUT, NOW).as_bytes());
}

#[test]
fn both_directions_at_once_in_pieces() {
    for size in [1, 3, 64, 65, 1000] {
        let mut bench = Bench::new();
        let (mut local, mut link) = (Vec::new(), Vec::new());
        let (mut signed_out, mut stripped) = (Vec::new(), Vec::new());
        for i in 0..60_u8 {
            let payload = vec![i; usize::from(i) * 4];
            local.extend(unsigned(&payload).as_bytes());
            signed_out.extend_from_slice(signed(&payload, LINK_OUT, NOW + u64::from(i)).as_bytes());
            link.extend(signed(&payload, LINK_IN, NOW - 60 + u64::from(i)).as_bytes());
            stripped.extend_from_slice(unsigned(&payload).as_bytes());
        }
        let (mut local, mut link) = (local.chunks(size), link.chunks(size));
        loop {
            let next = (local.next(), link.next());
            bench.local.input.extend(next.0.unwrap_or_default());
            bench.link.input.extend(next.1.unwrap_or_default());
            bench.run();
            if next == (None, None) {
                break;
            }
        }
        assert_eq!(bench.link.output, signed_out, "pieces of {size}");
        assert_eq!(bench.local.output, stripped, "pieces of {size}");
    }
}

#[test]
fn a_stall_is_no_silence() {
    let mut bench = Bench::new();
    let (first, second) = (unsigned(&[1; 50]), unsigned(&[2; 50]));
    bench.link.room = 10;
    let (begun, held_back) = second.as_bytes().split_at(20);
    bench.local.input.extend(first.as_bytes());
    bench.local_in(begun);
    for _ in 0..10 {
        bench.now += SILENCE;
        bench.run();
    }
    bench.link.room = usize::MAX;
    bench.run();
    bench.local_in(held_back);
    assert_eq!(bench.relay.outbound().passed(), 2);
    assert_eq!(bench.relay.outbound().dropped(), 0);
}

#[test]
fn silence_is_as_long_as_one_says() {
    let mut bench = Bench::new();
    bench.relay = {
        let replay = ReplayGuard::new(LINK_IN, Window::STRICT);
        let relay = Relay::new(
            key(),
            Stamper::new(LINK_OUT),
            replay,
            ForwardMode::StripSignature,
        );
        relay.expect("different links").idle(10 * SILENCE)
    };
    // It ends deafness, and nothing else.
    let frame = unsigned(&[1, 2, 3]);
    for (waited, passed) in [(10 * SILENCE, 0), (10 * SILENCE + 1, 1)] {
        bench.local_in(b"noise");
        bench.now += waited;
        bench.run();
        bench.local_in(frame.as_bytes());
        assert_eq!(bench.relay.outbound().passed(), passed);
    }
    let (begun, rest) = frame.as_bytes().split_at(5);
    bench.local_in(begun);
    bench.now += 1000 * SILENCE;
    bench.run();
    bench.local_in(rest);
    assert_eq!(bench.relay.outbound().passed(), 2);
}

#[test]
fn signs_in_the_name_of_its_own_alone() {
    let from = |system_id, component_id, id: u8| {
        let header = Header {
            compat_flags: 0,
            sequence: 0,
            system_id,
            component_id,
            message_id: MessageId::from(id),
        };
        Frame::new(header, &[1, 2, 3]).expect("a frame")
    };
    let relay = |senders| {
        let replay = ReplayGuard::new(LINK_IN, Window::STRICT);
        let mode = ForwardMode::StripSignature;
        let relay = Relay::new(key(), Stamper::new(LINK_OUT), replay, mode);
        Bench::of(relay.expect("different links").senders(senders))
    };
    let signs = |bench: &mut Bench, (system_id, component_id, id): (u8, u8, u8)| {
        let before = bench.relay.outbound().passed();
        bench.local_in(from(system_id, component_id, id).as_bytes());
        bench.relay.outbound().passed() > before
    };
    // COMMAND_LONG in the name of the station; the vehicle's HEARTBEAT; again; what is the vehicle's own.
    let mut learning = relay(Senders::default());
    let tried = [
        (255, 190, 76),
        (1, 1, 30),
        (1, 1, 0),
        (255, 190, 76),
        (255, 190, 0),
        (1, 25, 30),
    ];
    let signed = tried.map(|sender| signs(&mut learning, sender));
    assert_eq!(signed, [false, false, true, false, false, true]);
    let rejected = rejections(learning.relay.outbound());
    assert_eq!(rejected, [(RejectReason::ForeignSender, 4)]);
    for (senders, expected) in [
        (Senders::System(1), [false, true, true, false, false, true]),
        (
            Senders::Listed(&[(255, 190), (1, 25)]),
            [true, false, false, true, true, true],
        ),
        (Senders::Any, [true; 6]),
    ] {
        let mut bench = relay(senders);
        assert_eq!(tried.map(|sender| signs(&mut bench, sender)), expected);
    }
}

/// A key is taken from somebody who is there, or who has the one in use, and from nobody else.
#[test]
fn a_key_is_taken_with_presence_or_proof() {
    let setup = |component_id| SetupSigning {
        target_system: 1,
        target_component: component_id,
        secret_key: [9; 32],
        initial_timestamp: at(NOW),
    };
    let frame = |component_id| setup(component_id).to_frame(header());
    let unsigned_setup = frame(25).expect("in the dialect");
    let signed_at = |secret: [u8; 32], ticks| {
        let mut frame = unsigned_setup.clone();
        let stamp = Stamp {
            link_id: 0,
            timestamp: at(ticks),
        };
        let key = SigningKey::<Hmac>::new(&secret).expect("a key");
        sign_frame(&mut frame, &key, stamp).expect("not signed yet");
        frame
    };
    let mut bench = Bench::new();
    bench.relay.keep_setup(1, 25);
    let takes = |bench: &mut Bench, frame: &Frame| {
        bench.local_in(frame.as_bytes());
        let setup = bench.relay.take_setup();
        setup.is_some_and(|setup| setup.secret_key == [9; 32])
    };
    assert!(!takes(&mut bench, &unsigned_setup), "nobody is there");
    let rejected = rejections(bench.relay.outbound());
    assert_eq!(rejected, [(RejectReason::NoPresence, 1)]);
    bench.relay.set_presence(Presence::Shown);
    assert!(takes(&mut bench, &unsigned_setup));
    assert!(
        !takes(&mut bench, &frame(26).expect("in the dialect")),
        "another's"
    );
    bench.relay.set_presence(Presence::Absent);
    assert!(!takes(&mut bench, &unsigned_setup));

    // Proof: the key in use, and later than before.
    assert!(takes(&mut bench, &signed_at(KEY, NOW)));
    assert!(!takes(&mut bench, &signed_at(KEY, NOW)), "a recording");
    assert!(!takes(&mut bench, &signed_at(KEY, NOW - 1)), "an old one");
    assert!(
        !takes(&mut bench, &signed_at([8; 32], NOW + 9)),
        "another key"
    );
    assert!(takes(&mut bench, &signed_at(KEY, NOW + 1)));
    // From the radio, everybody reads it.
    bench.link_in(signed_at(KEY, NOW + 2).as_bytes());
    assert!(bench.relay.take_setup().is_none());

    // After it was switched on, until anything else comes: noise, or a packet.
    for other in [&b"noise"[..], unsigned(&[1]).as_bytes(), &MAVLINK1] {
        bench.silence();
        bench.relay.set_presence(Presence::AtStart);
        assert!(takes(&mut bench, &unsigned_setup));
        assert!(takes(&mut bench, &unsigned_setup));
        bench.local_in(other);
        bench.silence();
        assert!(!takes(&mut bench, &unsigned_setup));
    }
}

#[test]
fn a_payload_of_the_local_side_is_not_signed_for_a_packet() {
    let inner = unsigned(&[1, 2, 3]);
    let mut outer = unsigned(inner.as_bytes()).as_bytes().to_vec();
    outer[7..10].copy_from_slice(&[0xF0; 3]);
    let mut bench = Bench::new();
    bench.local_in(&outer);
    assert!(bench.link.output.is_empty());
    let rejected = rejections(bench.relay.outbound());
    assert_eq!(rejected, [(RejectReason::UnknownMessage, 1)]);
}

#[test]
fn setup_signing_passes_in_no_direction() {
    let header = Header {
        compat_flags: 0,
        sequence: 0,
        system_id: 255,
        component_id: 190,
        message_id: MessageId::new(256).expect("24 bits"),
    };
    let mut frame = Frame::new(header, &[7; 42]).expect("a frame");
    let mut bench = Bench::new();
    bench.local_in(frame.as_bytes());
    let stamp = Stamp {
        link_id: LINK_IN,
        timestamp: at(NOW),
    };
    sign_frame(&mut frame, &key(), stamp).expect("signed");
    bench.link_in(frame.as_bytes());
    assert!(bench.local.output.is_empty() && bench.link.output.is_empty());
    let expected = [(RejectReason::SetupSigning, 1)];
    assert_eq!(rejections(bench.relay.outbound()), expected);
    assert_eq!(rejections(bench.relay.inbound()), expected);
}

#[test]
fn a_port_that_gives_nothing_has_ended() {
    let mut bench = Bench::new();
    bench.local.ended = true;
    let polled = bench.poll();
    assert_eq!(polled.outbound, Err(PortError::InputClosed));
    assert_eq!(polled.inbound, Ok(false));
}

/// A shell may have a table of its own, which knows other messages than the core's.
#[test]
fn what_the_cores_table_does_not_know_is_rejected() {
    fn packet(bytes: &[u8]) -> Packet<'_> {
        Packet::parse(bytes, |_| Some(0)).expect("a packet")
    }
    for (id, reason) in [
        (0, RejectReason::BadChecksum),
        (0xF0, RejectReason::UnknownMessage),
    ] {
        let mut local = unsigned(&[1]).as_bytes().to_vec();
        let mut link = signed(&[1], LINK_IN, NOW).as_bytes().to_vec();
        for bytes in [&mut local, &mut link] {
            bytes[7..10].fill(id);
            let repaired = checksum(&bytes[1..11], 0).to_le_bytes();
            bytes[11..13].copy_from_slice(&repaired);
        }
        let mut signer = Signer::new(Stamper::new(LINK_OUT)).for_senders(Senders::Any);
        let rejected = signer.sign(packet(&local), &key().into(), &mut at(NOW));
        assert_eq!(rejected, Err(reason));
        let replay = ReplayGuard::new(LINK_IN, Window::STRICT);
        let mut verifier = Verifier::new(KeySlot::A, replay, ForwardMode::StripSignature);
        let rejected = verifier.verify(packet(&link), &mut &key(), &mut at(NOW));
        assert_eq!(rejected, Err(reason));
    }
}

/// A shell that calls the core itself counts with the same reasons.
#[test]
fn errors_of_the_core_are_reasons() {
    let mut frame = signed(&[1], LINK_IN, NOW);
    let flags = damaged(frame.as_bytes(), 2, 0x20);
    let error = FrameRef::parse(&flags).expect_err("unknown flags");
    let reason = RejectReason::from(VerifyError::from(error));
    assert_eq!(reason, RejectReason::UnknownIncompatFlags);

    let stamp = Stamp {
        link_id: LINK_IN,
        timestamp: at(NOW),
    };
    let error = sign_frame(&mut frame, &key(), stamp).expect_err("signed twice");
    assert_eq!(RejectReason::from(error), RejectReason::AlreadySigned);
    assert_eq!(
        RejectReason::from(VerifyError::Signed),
        RejectReason::AlreadySigned
    );
}

#[test]
fn what_is_wrong_is_said() {
    let words: Vec<_> = RejectReason::ALL.iter().map(ToString::to_string).collect();
    let same = |reason: &RejectReason| reason.to_string() == reason.as_str();
    assert!(RejectReason::ALL.iter().all(same));
    assert_eq!(
        words,
        [
            "MAVLink 1",
            "SETUP_SIGNING",
            "no presence",
            "foreign sender",
            "unknown flags",
            "unknown message",
            "bad checksum",
            "already signed",
            "clock exhausted",
            "not signed",
            "bad tag",
            "wrong link",
            "from the future",
            "too old",
            "replayed",
            "reflected",
            "not stored",
            "line closed",
            "other",
        ]
    );
    assert_eq!(SameLinkId(5).to_string(), "both directions have link id 5");
    let errors: [PortError<Broken, Broken>; 4] = [
        PortError::Input(Broken),
        PortError::Output(Broken),
        PortError::InputClosed,
        PortError::OutputClosed,
    ];
    assert_eq!(
        errors.map(|error| error.to_string()),
        [
            "cannot read: broken",
            "cannot write: broken",
            "the port gives no more bytes",
            "the port takes no more bytes",
        ]
    );
}

/// Logs say how a relay is, and nothing of its key.
#[test]
fn a_relay_is_shown_by_its_counters() {
    let mut bench = Bench::new();
    bench.local_in(unsigned(&[1]).as_bytes());
    let shown = format!("{:?}", bench.relay);
    let (out, back) = (bench.relay.outbound(), bench.relay.inbound());
    assert_eq!(
        shown,
        format!("Relay {{ outbound: {out:?}, inbound: {back:?}, .. }}")
    );
    assert_eq!((out.passed(), back.passed()), (1, 0));
}

#[test]
fn a_policy_lets_unsigned_frames_through_as_they_are() {
    let (stamper, replay) = (
        Stamper::new(LINK_OUT),
        ReplayGuard::new(LINK_IN, Window::STRICT),
    );
    let relay =
        Relay::new(key(), stamper, replay, ForwardMode::StripSignature).expect("different links");
    let mut bench = Bench::of(relay.accepting(AllowRadioStatus));
    let radio_status = Header {
        compat_flags: 0,
        sequence: 1,
        system_id: 51,
        component_id: 68,
        message_id: MessageId::from(109),
    };
    let radio_status = Frame::new(radio_status, &[0, 0, 1]).expect("a frame");
    bench.link_in(radio_status.as_bytes());
    bench.link_in(unsigned(&[1, 2, 3]).as_bytes());
    let verified = signed(&[1, 2, 3], LINK_IN, NOW);
    bench.link_in(verified.as_bytes());

    let passed = Event::Passed(Direction::Inbound);
    let rejected = Event::Rejected(Direction::Inbound, RejectReason::NotSigned);
    assert_eq!(bench.events, [Event::Unsigned, rejected, passed]);
    let expected = [radio_status.as_bytes(), unsigned(&[1, 2, 3]).as_bytes()].concat();
    assert_eq!(bench.local.output, expected);
    let counters = bench.relay.inbound();
    assert_eq!((counters.passed(), counters.unsigned()), (1, 1));
    assert_eq!(bench.relay.outbound().unsigned(), 0);
}

#[test]
fn several_peers_each_have_their_order() {
    let streams = StreamTable::<2>::new(Links::Any, Window::STRICT);
    let relay = Relay::new(
        key(),
        Stamper::new(LINK_OUT),
        streams,
        ForwardMode::KeepSignature,
    );
    let mut bench = Bench::of(relay.expect("different links"));
    for (link_id, ticks) in [(2, NOW), (3, NOW - 5), (2, NOW), (3, NOW - 4), (4, NOW)] {
        bench.link_in(signed(&[1, 2, 3], link_id, ticks).as_bytes());
    }
    let counters = bench.relay.inbound();
    // The third stream takes the row of the one with the oldest stamp, which is heard again when it has come after.
    assert_eq!(counters.passed(), 4);
    assert_eq!(rejections(counters), [(RejectReason::Replayed, 1)]);
    bench.link_in(signed(&[1, 2, 3], 3, NOW - 4).as_bytes());
    let rejected = RejectedPacket {
        system_id: 1,
        component_id: 1,
        link_id: Some(3),
        message_id: MessageId::from(0),
        rejection: RejectReason::Replayed,
    };
    assert_eq!(bench.relay.inbound().last_rejected(), Some(rejected));
    bench.link_in(signed(&[1, 2, 3], 3, NOW - 3).as_bytes());
    assert_eq!(bench.relay.inbound().passed(), 5);
}

/// A peer may sign for the link id that the relay signs for: what the relay signed is rejected all the
/// same when it comes back.
#[test]
fn own_frames_are_rejected_on_a_shared_link_id() {
    let streams = StreamTable::<2>::new(Links::Any, Window::STRICT);
    let relay = Relay::new(
        key(),
        Stamper::new(LINK_OUT),
        streams,
        ForwardMode::KeepSignature,
    );
    let mut bench = Bench::of(relay.expect("streams remember what is sent"));
    for payload in [[1, 2, 3], [4, 5, 6]] {
        bench.local_in(unsigned(&payload).as_bytes());
    }
    let own: Vec<u8> = bench.link.output.drain(..).collect();
    // Two frames within a tick were stamped with this one and the next.
    bench.now = NOW + 2;
    bench.link_in(&own);
    let counters = bench.relay.inbound();
    assert_eq!(
        (
            counters.passed(),
            counters.rejected(RejectReason::Reflected)
        ),
        (0, 2)
    );

    // Of another system: what it signs is its own.
    let header = Header {
        system_id: 255,
        ..header()
    };
    let mut peer = Frame::new(header, &[7, 8, 9]).expect("a frame");
    let stamp = Stamp {
        link_id: LINK_OUT,
        timestamp: at(NOW + 2),
    };
    sign_frame(&mut peer, &key(), stamp).expect("not signed yet");
    bench.link_in(peer.as_bytes());
    assert_eq!(bench.relay.inbound().passed(), 1);
    assert_eq!(bench.local.output, peer.as_bytes());
}

/// What is rejected says who it is from, also in MAVLink 1.
#[test]
fn the_last_offender_is_named() {
    let mut bench = Bench::new();
    // A heartbeat of system 7, component 9.
    let mut heartbeat = vec![0xFE, 9, 78, 7, 9, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3];
    heartbeat.extend(checksum(&heartbeat[1..], 50).to_le_bytes());
    bench.local_in(&heartbeat);
    let rejected = RejectedPacket {
        system_id: 7,
        component_id: 9,
        link_id: None,
        message_id: MessageId::from(0),
        rejection: RejectReason::Mavlink1,
    };
    let counters = bench.relay.outbound();
    assert_eq!(counters.last_rejected(), Some(rejected));
}

/// While the output holds a frame back, what is behind it on the input may be held back too: a packet of
/// which the first half has come is not given up for that.
#[test]
fn a_held_back_output_is_no_silence_of_the_input() {
    let mut bench = Bench::new();
    let (first, second) = (unsigned(&[1, 2, 3]), unsigned(&[4, 5, 6]));
    let (begin, end) = second.as_bytes().split_at(7);
    bench.link.room = 0;
    bench.local_in(&[first.as_bytes(), begin].concat());
    for _ in 0..3 {
        bench.now += IDLE;
        bench.run();
    }
    bench.link.room = usize::MAX;
    bench.now += IDLE;
    bench.run();
    bench.local_in(end);
    assert_eq!(bench.relay.outbound().passed(), 2);
    assert_eq!(bench.relay.outbound().dropped(), 0);
}
