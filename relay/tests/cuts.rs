//! What becomes of bytes depends neither on how they are cut into calls, nor on how what goes out is taken.

use std::fmt::Debug;
use std::time::Duration;

use mavlink_commsec::{AesGcm, Credential, Sealer, SenderId, hx, radio::Status};
use mavlink_signing::{
    Frame, Header, Hmac, MessageId, ReplayGuard, SigningKey, Stamp, Stamper, Timestamp, Window,
    crc::checksum, sign_frame,
};
use mavseal_relay::{
    Direction, Endpoint, Event, ForwardMode, LineEvent, Relay, Side,
    sealed::{HighWaterMarks, Radio, SealedEndpoint, SealedEvent},
};
use mavseal_store::{
    Region,
    model::{Flash, PAGE_SIZE},
};
use proptest::prelude::*;

const NOW: u64 = 37_555_200_000_000;
const LINK_OUT: u8 = 1;
const LINK_IN: u8 = 2;

fn at(ticks: u64) -> Timestamp {
    Timestamp::from_ticks(ticks).expect("48 bits")
}

/// What a line brings.
#[derive(Clone, Debug)]
enum Input {
    Bytes(Vec<u8>),
    Event(LineEvent),
}

/// How calls are cut.
#[derive(Clone, Debug)]
enum Cuts {
    /// As much as possible in each.
    Whole,
    /// Pieces of these sizes, again and again.
    Pieces(Vec<usize>),
}

/// What an endpoint did: bytes on both sides, and events.
#[derive(Debug, PartialEq, Eq)]
struct Done<T> {
    local: Vec<u8>,
    link: Vec<u8>,
    events: Vec<T>,
}

/// An endpoint that is being driven.
struct Driver<'a, E: Endpoint> {
    endpoint: &'a mut E,
    clock: Timestamp,
    sizes: Box<dyn Iterator<Item = usize> + 'a>,
    done: Done<E::Event>,
}

impl<E: Endpoint> Driver<'_, E> {
    fn size(&mut self) -> usize {
        self.sizes.next().expect("without end")
    }

    /// Takes some of what goes out on `side`; whether there was anything.
    fn take(&mut self, side: Side) -> bool {
        let size = self.size();
        let Self {
            endpoint,
            clock,
            done,
            ..
        } = self;
        let mut observe = |event| done.events.push(event);
        let taken = if size.is_multiple_of(2) {
            let mut buffer = vec![0; size.min(1000)];
            let count = endpoint.transmit(side, &mut buffer, clock, &mut observe);
            buffer.truncate(count);
            buffer
        } else {
            let pending = endpoint.pending(side);
            let taken = pending[..pending.len().min(size)].to_vec();
            endpoint.sent(side, taken.len(), clock, &mut observe);
            taken
        };
        let line = match side {
            Side::Local => &mut self.done.local,
            Side::Link => &mut self.done.link,
        };
        line.extend(&taken);
        !taken.is_empty()
    }

    fn drain(&mut self) {
        while self.take(Side::Local) | self.take(Side::Link) {}
        assert!(self.endpoint.pending(Side::Local).is_empty());
        assert!(self.endpoint.pending(Side::Link).is_empty());
    }

    fn poll(&mut self) {
        let mut observe = |event| self.done.events.push(event);
        self.endpoint.poll(&mut self.clock, &mut observe);
    }

    fn input(&mut self, side: Side, input: &Input) {
        match input {
            Input::Event(event) => {
                let mut observe = |event| self.done.events.push(event);
                self.endpoint
                    .line_event(side, *event, &mut self.clock, &mut observe);
            }
            Input::Bytes(bytes) => {
                let mut rest = &bytes[..];
                while !rest.is_empty() {
                    let size = self.size().min(rest.len());
                    let room = self.endpoint.room(side);
                    let mut observe = |event| self.done.events.push(event);
                    let taken =
                        self.endpoint
                            .received(side, &rest[..size], &mut self.clock, &mut observe);
                    assert!(taken >= size.min(room), "there was room");
                    rest = &rest[taken..];
                    let moved = self.take(side.other());
                    assert!(taken > 0 || moved, "it takes nothing and gives nothing");
                }
            }
        }
    }
}

/// Plays `script`: ticks that pass, then what comes in on a side. Where they are 0, what goes out may stay in the
/// endpoint over several inputs.
fn play<E: Endpoint>(
    mut endpoint: E,
    script: &[(u64, Side, Input)],
    cuts: &Cuts,
    stands: bool,
) -> Done<E::Event> {
    let sizes: Box<dyn Iterator<Item = usize>> = match cuts {
        Cuts::Whole => Box::new(std::iter::repeat(usize::MAX - 1)),
        Cuts::Pieces(sizes) => Box::new(sizes.iter().copied().cycle()),
    };
    let mut driver = Driver {
        endpoint: &mut endpoint,
        clock: at(NOW),
        sizes,
        done: Done {
            local: Vec::new(),
            link: Vec::new(),
            events: Vec::new(),
        },
    };
    for (ticks, side, input) in script {
        if !stands {
            driver.drain();
            driver.clock = driver.clock.saturating_add(*ticks);
            driver.poll();
            driver.drain();
        }
        driver.input(*side, input);
    }
    driver.drain();
    driver.clock = driver.clock.saturating_add(1_000_000);
    driver.poll();
    driver.drain();
    assert_eq!(driver.endpoint.room(Side::Link).min(1), 1);
    driver.done
}

fn relay() -> Relay<Hmac> {
    Relay::new(
        key(),
        Stamper::new(LINK_OUT),
        ReplayGuard::new(LINK_IN, Window::ONE_MINUTE),
        ForwardMode::StripSignature,
    )
    .expect("two links")
}

fn key() -> SigningKey<Hmac> {
    SigningKey::new(&[7; 32]).expect("a key")
}

const STATION: Credential = credential(5);
const VEHICLE: Credential = credential(7);

const fn credential(id: u32) -> Credential {
    Credential {
        id: SenderId(id),
        key: [id as u8; 16],
        salt: 1,
    }
}

fn station() -> SealedEndpoint<Flash<2>, 1> {
    let region = Region {
        start: 0,
        page_size: PAGE_SIZE as u32,
    };
    let place = || (Flash::default(), region);
    let marks = HighWaterMarks::provision::<AesGcm>(&STATION, &[VEHICLE], place(), [place()]);
    let marks = marks.expect("blank flashes");
    let max_delay = Duration::from_millis(50);
    SealedEndpoint::new(&STATION, &[VEHICLE], marks, Radio::Station, max_delay).expect("keys")
}

fn frame(payload: &[u8]) -> Frame {
    let header = Header {
        compat_flags: 0,
        sequence: 9,
        system_id: 1,
        component_id: 1,
        message_id: MessageId::from(0),
    };
    Frame::new(header, payload).expect("a frame")
}

fn signed(payload: &[u8], ticks: u64) -> Vec<u8> {
    let mut frame = frame(payload);
    let stamp = Stamp {
        link_id: LINK_IN,
        timestamp: at(NOW + ticks),
    };
    sign_frame(&mut frame, &key(), stamp).expect("unsigned");
    frame.as_bytes().to_vec()
}

/// TUNNEL with so many bytes.
fn tunnel(length: u8) -> Vec<u8> {
    let mut packet = vec![0xFD, length, 0, 0, 3, 1, 1, 0x81, 0x01, 0];
    packet.extend(vec![0x55; length.into()]);
    packet.extend(checksum(&packet[1..], 147).to_le_bytes());
    packet
}

fn package(counter: u32, packets: &[u8]) -> Vec<u8> {
    let key = VEHICLE.prepare().expect("a key");
    let mut sealer: Sealer = Sealer::resume(key, VEHICLE.id, counter);
    let mut plaintext = [0; 80];
    plaintext[..packets.len()].copy_from_slice(packets);
    let package = sealer.seal(&plaintext).expect("counters");
    hx::Frame::from(&package).encode().collect()
}

fn noise() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![any::<u8>(), Just(0xFD), Just(0xFE), Just(0x7E), Just(0x7C)];
    proptest::collection::vec(byte, 0..40)
}

fn line_event() -> impl Strategy<Value = Input> {
    prop_oneof![
        1 => Just(LineEvent::Overrun),
        1 => Just(LineEvent::FramingError),
        1 => Just(LineEvent::Noise),
        3 => Just(LineEvent::Idle),
    ]
    .prop_map(Input::Event)
}

/// Whole packets and parts of them, noise and events, on both sides.
fn script(
    local: impl Strategy<Value = Vec<u8>> + 'static,
    link: impl Strategy<Value = Vec<u8>> + 'static,
) -> impl Strategy<Value = Vec<(u64, Side, Input)>> {
    let of = |side, packet: BoxedStrategy<Vec<u8>>| {
        let cut = (packet.clone(), any::<prop::sample::Index>()).prop_map(|(mut packet, at)| {
            packet.truncate(at.index(packet.len()));
            packet
        });
        let bytes = prop_oneof![5 => packet, 1 => cut, 1 => noise()];
        let bytes = proptest::collection::vec(bytes, 1..5).prop_map(|parts| parts.concat());
        let input = prop_oneof![6 => bytes.prop_map(Input::Bytes), 1 => line_event()];
        (0..20_000_u64, Just(side), input)
    };
    proptest::collection::vec(
        prop_oneof![of(Side::Local, local.boxed()), of(Side::Link, link.boxed())],
        1..10,
    )
}

fn pieces() -> impl Strategy<Value = Cuts> {
    proptest::collection::vec(1..80_usize, 1..20).prop_map(Cuts::Pieces)
}

/// Both directions are apart, and so are their events.
fn by_direction<T: Copy + PartialEq + Debug>(
    done: Done<T>,
    is_outbound: impl Fn(&T) -> bool,
) -> (Vec<u8>, Vec<u8>, Vec<T>, Vec<T>) {
    let (outbound, inbound) = done.events.iter().partition(|event| is_outbound(event));
    (done.local, done.link, outbound, inbound)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn what_the_relay_does_depends_on_no_cut(
        script in script(
            proptest::collection::vec(any::<u8>(), 0..255)
                .prop_map(|payload| frame(&payload).as_bytes().to_vec()),
            (proptest::collection::vec(any::<u8>(), 0..255), 0..2000_u64)
                .prop_map(|(payload, ticks)| signed(&payload, ticks)),
        ),
        cuts in pieces(),
        stands: bool,
    ) {
        let is_outbound = |event: &Event| matches!(
            event,
            Event::Passed(Direction::Outbound) | Event::Rejected(Direction::Outbound, _)
        );
        let [whole, cut] = [&Cuts::Whole, &cuts]
            .map(|cuts| by_direction(play(relay(), &script, cuts, stands), is_outbound));
        prop_assert_eq!(whole, cut);
    }

    #[test]
    fn what_a_sealed_end_does_depends_on_no_cut(
        script in script(
            (1..68_u8).prop_map(tunnel),
            prop_oneof![
                4 => (1..20_u32, 1..68_u8).prop_map(|(counter, length)| package(counter, &tunnel(length))),
                1 => Just(hx::Frame::new(hx::FrameKind::Radio, &Status::default().to_wire())
                    .expect("a frame")
                    .encode()
                    .collect()),
            ],
        ),
        cuts in pieces(),
        stands: bool,
    ) {
        let is_outbound = |event: &SealedEvent| matches!(
            event,
            SealedEvent::Packed
                | SealedEvent::Sealed(_)
                | SealedEvent::Rejected(Direction::Outbound, _)
        );
        let [whole, cut] = [&Cuts::Whole, &cuts]
            .map(|cuts| by_direction(play(station(), &script, cuts, stands), is_outbound));
        prop_assert_eq!(whole, cut);
    }
}
