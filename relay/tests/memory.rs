//! What the relay remembers: its mark, its keys, and SETUP_SIGNING from the plain side.

use std::{cell::Cell, collections::VecDeque, convert::Infallible};

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavlink_signing::{
    Frame, FrameRef, Header, Hmac, KEY_SIZE, KeyChangeError, KeyError, Keys, MessageId, Phase,
    RESERVATION, Replay, SetupSigning, SigningKey, Source, Stamp, Timestamp, Window, sign_frame,
};
use mavseal_relay::{Clock, FIRST_RESERVATION, Forward, Kept, KeptError, KeySlots, Refusal, Relay};
use mavseal_store::{
    Region,
    model::{Flash, PAGE_SIZE, WORD_SIZE},
};

const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};
const NOW: u64 = 37_555_200_000_000;
const LINK_OUT: u8 = 1;
const LINK_IN: u8 = 2;
const KEY: [u8; KEY_SIZE] = [7; KEY_SIZE];

/// A port that gives what was put into it and takes everything.
#[derive(Default)]
struct Line {
    input: VecDeque<u8>,
    output: Vec<u8>,
}

impl ErrorType for Line {
    type Error = Infallible;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.input.is_empty())
    }
}

impl Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        Ok(std::io::Read::read(&mut self.input, buffer).expect("memory"))
    }
}

impl WriteReady for Line {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(true)
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.output.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

fn at(ticks: u64) -> Timestamp {
    Timestamp::from_ticks(ticks).expect("48 bits")
}

fn header() -> Header {
    Header {
        compat_flags: 0,
        sequence: 0,
        system_id: 1,
        component_id: 1,
        message_id: MessageId::from(0),
    }
}

fn signed(ticks: u64) -> Frame {
    let mut frame = Frame::new(header(), &[1]).expect("a heartbeat");
    let stamp = Stamp {
        link_id: LINK_IN,
        timestamp: at(ticks),
    };
    let key = SigningKey::<Hmac>::new(&KEY).expect("a key");
    sign_frame(&mut frame, &key, stamp).expect("unsigned");
    frame
}

/// Polls a relay with these inputs until it rests; what came out, plain then secure, and the refusals from
/// the secure side.
fn run<K: Clock>(
    relay: &mut Relay<Hmac>,
    clock: &mut K,
    plain: &[&Frame],
    secure: &[&Frame],
) -> (usize, Vec<u64>, Vec<Refusal>) {
    let (mut plain_line, mut secure_line) = (Line::default(), Line::default());
    for frame in plain {
        plain_line.input.extend(frame.as_bytes());
    }
    for frame in secure {
        secure_line.input.extend(frame.as_bytes());
    }
    let mut refused = Vec::new();
    let mut observe = |event| {
        if let mavseal_relay::Event::Refused(_, refusal) = event {
            refused.push(refusal);
        }
    };
    while relay
        .poll(&mut plain_line, &mut secure_line, clock, &mut observe)
        .moved()
    {}
    let mut stamps = Vec::new();
    let mut rest = &secure_line.output[..];
    while let Ok(frame) = FrameRef::parse(rest) {
        let signature = frame.signature().expect("signed");
        stamps.push(signature.stamp.timestamp.ticks());
        rest = &rest[frame.as_bytes().len()..];
    }
    (plain_line.output.len() / 13, stamps, refused)
}

fn relay<F, T>(kept: &Kept<F, T>) -> Relay<Hmac>
where
    F: embedded_storage::nor_flash::NorFlash,
    T: FnMut() -> u64,
{
    let key = SigningKey::new(&KEY).expect("a key");
    let receiver = Replay::resume(LINK_IN, Window::LINK, kept.floor());
    Relay::new(key, kept.stamper(LINK_OUT), receiver, Forward::Stripped).expect("two links")
}

#[test]
fn after_a_restart_nothing_is_used_or_accepted_again() {
    let mut flash = Flash::<2>::default();
    let heartbeat = Frame::new(header(), &[1]).expect("a heartbeat");
    let frames = [signed(NOW), signed(NOW + 5)];
    let frames = frames.each_ref();
    let mut last = 0;
    for restart in 0..3 {
        let mut kept = Kept::new(&mut flash, REGION, || 0).expect("fits");
        kept.tell(Source::Trusted, at(NOW + 5));
        let mut relay = relay(&kept);
        let plain = [&heartbeat, &heartbeat];
        let (passed, stamps, refused) = run(&mut relay, &mut kept, &plain, &frames);
        assert_eq!(stamps.len(), 2);
        assert!(stamps[0] > last && stamps[1] > stamps[0]);
        last = stamps[1];
        if restart == 0 {
            assert_eq!((passed, refused), (2, vec![]));
        } else {
            assert_eq!((passed, refused), (0, vec![Refusal::Replayed; 2]));
        }
    }
}

#[test]
fn reservations_grow_with_the_time_since_the_restart() {
    let mut flash = Flash::<2>::default();
    for (running, ahead) in [
        (0, FIRST_RESERVATION),
        (800_000, 100_000),
        (u64::MAX, RESERVATION),
    ] {
        let timer = Cell::new(0);
        let mut kept = Kept::new(&mut flash, REGION, || timer.get()).expect("fits");
        timer.set(running);
        let floor = kept.floor();
        kept.reserve(floor).expect("stored");
        let kept = Kept::new(&mut flash, REGION, || 0).expect("fits");
        assert_eq!(kept.floor(), floor.saturating_add(ahead));
    }
}

#[test]
fn what_cannot_be_remembered_is_refused() {
    let mut flash = Flash::<2>::default();
    flash.fail(255);
    let mut kept = Kept::new(&mut flash, REGION, || 0).expect("fits");
    kept.tell(Source::Trusted, at(NOW));
    let mut relay = relay(&kept);
    let heartbeat = Frame::new(header(), &[1]).expect("a heartbeat");
    let (passed, stamps, refused) = run(&mut relay, &mut kept, &[&heartbeat], &[&signed(NOW)]);
    // One write in 256 succeeds, and none of these.
    assert_eq!((passed, stamps.len()), (0, 0));
    assert_eq!(refused, [Refusal::NotStored; 2]);
}

#[test]
fn the_end_of_time_is_told() {
    let mut flash = Flash::<2>::default();
    let mut kept = Kept::new(&mut flash, REGION, || 0).expect("fits");
    kept.reserve(Timestamp::MAX).expect("stored");
    let error = Kept::new(&mut flash, REGION, || 0).err();
    assert_eq!(error, Some(KeptError::Exhausted));
    assert_eq!(
        KeptError::Exhausted.to_string(),
        "all timestamps are used up"
    );
}

#[test]
fn setup_signing_is_taken_on_the_plain_side_alone_and_by_its_target() {
    let setup = |target_component, first| SetupSigning {
        target_system: 1,
        target_component,
        secret_key: [first; KEY_SIZE],
        initial_timestamp: at(NOW),
    };
    let frame = |target_component, first| {
        let frame = setup(target_component, first).to_frame(header());
        frame.expect("in the dialect")
    };
    let mut clock = at(NOW);
    let mut flash = Flash::<2>::default();
    let kept = Kept::new(&mut flash, REGION, || 0).expect("fits");
    let (ours, other) = (frame(25, 9), frame(26, 8));

    let mut deaf = relay(&kept);
    run(&mut deaf, &mut clock, &[&ours], &[]);
    assert!(deaf.take_setup().is_none(), "it was not told to");

    let mut relay = relay(&kept).taking_setup(1, 25);
    let (passed, stamps, refused) = run(&mut relay, &mut clock, &[&ours, &other], &[&ours]);
    assert_eq!((passed, stamps.len()), (0, 0));
    assert_eq!(refused, [Refusal::SetupSigning; 3]);
    let came = relay.take_setup().expect("it was told to");
    assert_eq!((came.target_system, came.target_component), (1, 25));
    assert_eq!(came.secret_key, [9; KEY_SIZE]);
    assert_eq!(came.initial_timestamp, at(NOW));
    assert!(relay.take_setup().is_none(), "once");
    run(&mut relay, &mut clock, &[], &[&ours]);
    assert!(relay.take_setup().is_none(), "not from the radio");
}

#[test]
fn keys_outlast_a_restart_and_retired_ones_are_erased() {
    let mut flash = Flash::<2>::default();
    let words = [1, 2].map(|number: u8| [number; WORD_SIZE]);
    let open = |flash: &mut Flash<2>| {
        let (_, keys) = KeySlots::open::<Hmac>(flash, REGION).expect("fits");
        keys.map(|keys| (keys.phase(), keys.signing().fingerprint()))
    };
    let print = |number| SigningKey::<Hmac>::new(&[number; KEY_SIZE]).map(|key| key.fingerprint());
    assert_eq!(open(&mut flash), None, "nothing is signed without a key");
    {
        let (mut slots, _) = KeySlots::open::<Hmac>(&mut flash, REGION).expect("fits");
        assert!(slots.is_empty());
        let zero = slots.provision::<Hmac>(&[0; KEY_SIZE]).err();
        assert_eq!(zero, Some(KeyChangeError::Key(KeyError::AllZero)));
        slots.provision::<Hmac>(&[1; KEY_SIZE]).expect("stored");
    }
    assert_eq!(
        open(&mut flash),
        print(1).ok().map(|print| (Phase::Settled, print))
    );
    {
        let (mut slots, keys) = KeySlots::open::<Hmac>(&mut flash, REGION).expect("fits");
        assert!(!slots.is_empty());
        let mut keys: Keys<Hmac> = keys.expect("stored");
        keys.apply(&[2; KEY_SIZE], &mut slots).expect("stored");
    }
    assert!(words.iter().all(|word| flash.holds(word)), "both are kept");
    assert_eq!(
        open(&mut flash),
        print(2).ok().map(|print| (Phase::Applied, print))
    );
    {
        let (mut slots, keys) = KeySlots::open::<Hmac>(&mut flash, REGION).expect("fits");
        keys.expect("stored")
            .apply(&[1; KEY_SIZE], &mut slots)
            .expect("stored");
    }
    assert_eq!(
        open(&mut flash),
        print(1).ok().map(|print| (Phase::Settled, print))
    );
    assert!(
        flash.holds(&words[0]) && !flash.holds(&words[1]),
        "given up"
    );
}
