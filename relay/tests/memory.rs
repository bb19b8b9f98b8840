//! What the relay remembers: its mark, its keys, and SETUP_SIGNING from the local side.

use std::{cell::Cell, collections::VecDeque, convert::Infallible, error::Error};

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavlink_signing::{
    Frame, FrameRef, Header, Hmac, KEY_SIZE, KeyChange, KeyChangeError, KeyError, KeyRing,
    KeyStore, LinkClock, MessageId, NotStored, RESERVATION, ReplayGuard, RolloverState,
    SetupSigning, SignError, SigningKey, Stamp, Stamper, SyncState, TimeSource, Timestamp,
    VerifyError, Window, sign_frame,
};
use mavseal_relay::{
    FIRST_RESERVATION, FlashKeyStore, ForwardMode, PersistentClock, PersistentClockError,
    RejectReason, Relay, TimeBehindMark, adapter,
};
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

/// Polls a relay with these inputs until it rests; what came out, plain then secure, and the rejections from
/// the link side.
fn run<K: LinkClock>(
    relay: &mut Relay<Hmac>,
    clock: &mut K,
    local: &[&Frame],
    link: &[&Frame],
) -> (usize, Vec<u64>, Vec<RejectReason>) {
    let (mut local_line, mut link_line) = (Line::default(), Line::default());
    for frame in local {
        local_line.input.extend(frame.as_bytes());
    }
    for frame in link {
        link_line.input.extend(frame.as_bytes());
    }
    let mut rejected = Vec::new();
    let mut observe = |event| {
        if let mavseal_relay::Event::Rejected(_, rejection) = event {
            rejected.push(rejection);
        }
    };
    while adapter::poll(relay, &mut local_line, &mut link_line, clock, &mut observe).moved() {}
    let mut stamps = Vec::new();
    let mut rest = &link_line.output[..];
    while let Ok(frame) = FrameRef::parse(rest) {
        let signature = frame.signature().expect("signed");
        stamps.push(signature.stamp.timestamp.ticks());
        rest = &rest[frame.as_bytes().len()..];
    }
    (local_line.output.len() / 13, stamps, rejected)
}

fn relay<F, T>(kept: &PersistentClock<F, T>) -> Relay<Hmac>
where
    F: embedded_storage::nor_flash::NorFlash,
    T: FnMut() -> u64,
{
    let key = SigningKey::new(&KEY).expect("a key");
    let receiver = ReplayGuard::resume(LINK_IN, Window::ONE_MINUTE, kept.floor());
    Relay::new(
        key,
        kept.stamper(LINK_OUT),
        receiver,
        ForwardMode::StripSignature,
    )
    .expect("two links")
}

#[test]
fn a_clock_that_leaps_is_no_silence() {
    let mut kept = PersistentClock::new(Flash::<2>::default(), REGION, || 1000).expect("a flash");
    let mut relay = relay(&kept);
    let (mut local, mut link) = (Line::default(), Line::default());
    let packet = Frame::new(header(), &[1]).expect("a heartbeat");
    let (first, second) = packet.as_bytes().split_at(6);
    let from_the_peer = signed(NOW);
    let mut turn = |from_local: &[u8], from_link: &[u8]| {
        local.input.extend(from_local);
        link.input.extend(from_link);
        while adapter::poll(&mut relay, &mut local, &mut link, &mut kept, &mut |_| ()).moved() {}
        relay.outbound().passed()
    };
    assert_eq!(turn(first, &[]), 0);
    assert_eq!(turn(&[], from_the_peer.as_bytes()), 0);
    assert_eq!(turn(second, &[]), 1);
    assert!(kept.now() > at(NOW / 2), "the frame has told the time");
    let shown = format!("{kept:?}");
    assert!(
        shown.starts_with("PersistentClock { clock: Clock {"),
        "{shown}"
    );
}

#[test]
fn after_a_restart_nothing_is_used_or_accepted_again() {
    let mut flash = Flash::<2>::default();
    let heartbeat = Frame::new(header(), &[1]).expect("a heartbeat");
    let frames = [signed(NOW), signed(NOW + 5)];
    let frames = frames.each_ref();
    let mut last = 0;
    for restart in 0..3 {
        let mut kept = PersistentClock::new(&mut flash, REGION, || 0).expect("fits");
        kept.update(TimeSource::Trusted, at(NOW + 5))
            .expect("ahead");
        let mut relay = relay(&kept);
        let local = [&heartbeat, &heartbeat];
        let (passed, stamps, rejected) = run(&mut relay, &mut kept, &local, &frames);
        assert_eq!(stamps.len(), 2);
        assert!(stamps[0] > last && stamps[1] > stamps[0]);
        last = stamps[1];
        if restart == 0 {
            assert_eq!((passed, rejected), (2, vec![]));
        } else {
            assert_eq!((passed, rejected), (0, vec![RejectReason::Replayed; 2]));
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
        let mut kept = PersistentClock::new(&mut flash, REGION, || timer.get()).expect("fits");
        timer.set(running);
        let floor = kept.floor();
        kept.reserve(floor).expect("stored");
        let kept = PersistentClock::new(&mut flash, REGION, || 0).expect("fits");
        assert_eq!(kept.floor(), floor.saturating_add(ahead));
    }
}

#[test]
fn what_cannot_be_remembered_is_rejected() {
    let mut flash = Flash::<2>::default();
    flash.fail(255);
    let mut kept = PersistentClock::new(&mut flash, REGION, || 0).expect("fits");
    kept.update(TimeSource::Trusted, at(NOW)).expect("ahead");
    let mut relay = relay(&kept);
    let heartbeat = Frame::new(header(), &[1]).expect("a heartbeat");
    let (passed, stamps, rejected) = run(&mut relay, &mut kept, &[&heartbeat], &[&signed(NOW)]);
    // One write in 256 succeeds, and none of these.
    assert_eq!((passed, stamps.len()), (0, 0));
    assert_eq!(rejected, [RejectReason::NotStored; 2]);
}

#[test]
fn the_end_of_time_is_told() {
    let mut flash = Flash::<2>::default();
    let mut kept = PersistentClock::new(&mut flash, REGION, || 0).expect("fits");
    kept.reserve(Timestamp::MAX).expect("stored");
    let error = PersistentClock::new(&mut flash, REGION, || 0).err();
    assert_eq!(error, Some(PersistentClockError::Exhausted));
    assert_eq!(
        PersistentClockError::Exhausted.to_string(),
        "all timestamps are used up"
    );
    assert!(PersistentClockError::Exhausted.source().is_none());
    let nowhere = Region {
        page_size: 1,
        ..REGION
    };
    let error = PersistentClock::new(&mut flash, nowhere, || 0).expect_err("no region");
    let source = error.source().expect("the flash's own");
    assert_eq!(source.to_string(), error.to_string());
}

#[test]
fn the_reservation_does_not_end_time() {
    let mut flash = Flash::<2>::default();
    let last = at(Timestamp::MAX.ticks() - 1);
    let mut kept = PersistentClock::new(&mut flash, REGION, || 0).expect("fits");
    kept.reserve(last).expect("stored");
    let kept = PersistentClock::new(&mut flash, REGION, || 0).expect("one is left");
    assert_eq!(kept.floor(), Timestamp::MAX);
}

#[test]
fn a_clock_without_battery_is_not_believed() {
    let mut flash = Flash::<2>::default();
    let mut kept = PersistentClock::new(&mut flash, REGION, || 0).expect("fits");
    kept.reserve(at(NOW)).expect("stored");
    let least = NOW + FIRST_RESERVATION - RESERVATION - Window::ONE_MINUTE.ahead;
    let before = kept.now();
    let told = kept.update(TimeSource::Trusted, at(least - 1));
    assert_eq!(told, Err(TimeBehindMark));
    assert_eq!(
        TimeBehindMark.to_string(),
        "the time told has passed: later timestamps have been used"
    );
    assert_eq!((kept.sync(), kept.now()), (SyncState::Unsynced, before));
    assert_eq!(kept.update(TimeSource::Bounded, at(least - 1)), Ok(100_000));
    assert_eq!(kept.update(TimeSource::Trusted, Timestamp::ZERO), Ok(0));
    kept.update(TimeSource::Trusted, at(least))
        .expect("it may be so");
    assert_eq!((kept.sync(), kept.now()), (SyncState::Synced, at(least)));
}

#[test]
fn below_the_floor_nothing_is_used_whoever_asks() {
    let mut flash = Flash::<2>::default();
    let mut kept = PersistentClock::new(&mut flash, REGION, || 0).expect("fits");
    kept.reserve(at(NOW)).expect("stored");
    let mut kept = PersistentClock::new(&mut flash, REGION, || 5).expect("fits");
    assert_eq!(kept.monotonic(), 5);
    let floor = kept.floor();
    assert_eq!(kept.reserve(at(floor.ticks() - 1)), Err(NotStored));
    kept.reserve(floor).expect("stored");
    // A stamper and a receiver that were not made for it: what it heard before is not accepted again.
    let frame = signed(NOW);
    let frame = FrameRef::parse(frame.as_bytes()).expect("whole");
    let key = SigningKey::<Hmac>::new(&KEY).expect("a key");
    let authentic = mavlink_signing::authenticate(frame, &key).expect("signed");
    let mut receiver = ReplayGuard::new(LINK_IN, Window::ONE_MINUTE);
    let verdict = kept.admit(&mut receiver, authentic).map(drop);
    assert_eq!(verdict, Err(VerifyError::NotStored));
    let stamp = kept.stamp(&mut Stamper::new(LINK_OUT));
    assert_eq!(stamp, Err(SignError::NotStored));
}

#[test]
fn a_key_that_cannot_be_read_is_not_taken_for_none() {
    let mut flash = Flash::<2>::default();
    let (mut slots, _) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
    slots.provision::<Hmac>(&[1; KEY_SIZE]).expect("stored");
    assert!(!slots.is_empty());
    flash.spoil(PAGE_SIZE + WORD_SIZE);
    let (slots, keys) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
    assert!(keys.is_none() && !slots.is_empty());
}

#[test]
fn without_a_new_key_there_is_no_change_to_store() {
    let mut flash = Flash::<2>::default();
    let (mut slots, _) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
    slots.provision::<Hmac>(&[1; KEY_SIZE]).expect("stored");
    for change in [KeyChange::Confirm, KeyChange::Retire, KeyChange::Withdraw] {
        assert_eq!(slots.store(change), Err(NotStored), "{change:?}");
    }
    let (_, keys) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
    assert_eq!(
        keys.map(|keys| keys.rollover_state()),
        Some(RolloverState::Settled)
    );
}

#[test]
fn every_start_stores_the_keys_again() {
    let mut flash = Flash::<2>::default();
    let (mut slots, _) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
    slots.provision::<Hmac>(&[1; KEY_SIZE]).expect("stored");
    let (writes, erases) = (flash.writes(), flash.erases());
    for start in 1..=100 {
        let (_, keys) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
        assert!(keys.is_some());
        assert_eq!(flash.writes() - writes, start * 10);
    }
    // A page takes 25; then the other is erased, and this one.
    assert_eq!(flash.erases() - erases, 8);
    // Lost for one start if nothing can be stored: what cannot be relied on is not used.
    flash.fail(255);
    let (slots, keys) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
    assert!(keys.is_none() && !slots.is_empty());
}

#[test]
fn a_key_that_was_given_up_is_gone_after_a_cut_and_a_start() {
    for chance in 0..40 {
        for cut in 0..14 {
            let mut flash = Flash::<2>::new(chance);
            let (mut slots, _) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
            slots.provision::<Hmac>(&[1; KEY_SIZE]).expect("stored");
            let (mut slots, keys) = FlashKeyStore::open(&mut flash, REGION).expect("fits");
            let mut keys: KeyRing<Hmac> = keys.expect("stored");
            keys.apply(&[2; KEY_SIZE], &mut slots).expect("stored");
            flash.cut_after(cut);
            let retired = slots_of(&mut flash, |slots| {
                slots.store(mavlink_signing::KeyChange::Withdraw)
            });
            flash.restart();
            let (_, keys) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
            let keys = keys.expect("one or the other");
            assert!(retired.is_err() || keys.rollover_state() == RolloverState::Settled);
            let given_up = flash.holds(&[2; WORD_SIZE]);
            assert_eq!(
                given_up,
                keys.rollover_state() == RolloverState::Applied,
                "{chance} {cut}"
            );
        }
    }
}

#[test]
fn a_failed_erase_does_not_hold_up_a_change() {
    let mut left = 0;
    for chance in 0..300 {
        let mut flash = Flash::<2>::new(chance);
        let (mut slots, _) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
        slots.provision::<Hmac>(&[1; KEY_SIZE]).expect("stored");
        flash.fail(20);
        let (mut slots, keys) = FlashKeyStore::open::<Hmac>(flash, REGION).expect("fits");
        let Some(mut keys) = keys else { continue };
        let two = [2; KEY_SIZE];
        if keys.offer(&two, &mut slots).is_err() || keys.withdraw(&mut slots).is_err() {
            continue;
        }
        let next = keys.offer(&[3; KEY_SIZE], &mut slots);
        assert!([Ok(()), Err(KeyChangeError::NotStored)].contains(&next));
        let mut flash = slots.into_flash();
        left += u32::from(flash.holds(&[2; WORD_SIZE]));
        flash.fail(0);
        let (mut slots, keys) = FlashKeyStore::open::<Hmac>(flash, REGION).expect("fits");
        let mut keys = keys.expect("stored");
        if next.is_ok() {
            keys.withdraw(&mut slots).expect("stored");
        }
        let (slots, _) = FlashKeyStore::open::<Hmac>(slots.into_flash(), REGION).expect("fits");
        assert!(!slots.into_flash().holds(&[2; WORD_SIZE]));
    }
    assert!(left > 0, "an erase failed after the key was given up");
}

/// What `act` does with the slots in `flash`, found as they are.
fn slots_of<T>(
    flash: &mut Flash<2>,
    act: impl FnOnce(&mut FlashKeyStore<&mut Flash<2>>) -> T,
) -> T {
    let (mut slots, _) = FlashKeyStore::open::<Hmac>(flash, REGION).expect("fits");
    act(&mut slots)
}

#[test]
fn keys_in_flash_are_not_shown() {
    let mut flash = Flash::<2>::default();
    let (mut slots, _) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
    slots.provision::<Hmac>(&[0xA7; KEY_SIZE]).expect("stored");
    let shown = format!("{slots:?}");
    assert!(
        shown.contains("Journal") && !shown.contains("167"),
        "{shown}"
    );
}

#[test]
fn setup_signing_is_taken_on_the_local_side_alone_and_by_its_target() {
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
    let kept = PersistentClock::new(&mut flash, REGION, || 0).expect("fits");
    let (ours, other) = (frame(25, 9), frame(26, 8));

    let mut deaf = relay(&kept);
    run(&mut deaf, &mut clock, &[&ours], &[]);
    assert!(deaf.take_setup().is_none(), "it was not told to");

    let mut relay = relay(&kept);
    relay.keep_setup(1, 25);
    let (passed, stamps, rejected) = run(&mut relay, &mut clock, &[&ours, &other], &[&ours]);
    assert_eq!((passed, stamps.len()), (0, 0));
    assert_eq!(rejected, [RejectReason::SetupSigning; 3]);
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
        let (_, keys) = FlashKeyStore::open::<Hmac>(flash, REGION).expect("fits");
        keys.map(|keys| (keys.rollover_state(), keys.signing().fingerprint()))
    };
    let print = |number| SigningKey::<Hmac>::new(&[number; KEY_SIZE]).map(|key| key.fingerprint());
    assert_eq!(open(&mut flash), None, "nothing is signed without a key");
    {
        let (mut slots, _) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
        assert!(slots.is_empty());
        let zero = slots.provision::<Hmac>(&[0; KEY_SIZE]).err();
        assert_eq!(zero, Some(KeyChangeError::Key(KeyError::AllZero)));
        slots.provision::<Hmac>(&[1; KEY_SIZE]).expect("stored");
    }
    assert_eq!(
        open(&mut flash),
        print(1).ok().map(|print| (RolloverState::Settled, print))
    );
    {
        let (mut slots, keys) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
        assert!(!slots.is_empty());
        let mut keys: KeyRing<Hmac> = keys.expect("stored");
        keys.apply(&[2; KEY_SIZE], &mut slots).expect("stored");
    }
    assert!(words.iter().all(|word| flash.holds(word)), "both are kept");
    assert_eq!(
        open(&mut flash),
        print(2).ok().map(|print| (RolloverState::Applied, print))
    );
    {
        let (mut slots, keys) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
        keys.expect("stored")
            .apply(&[1; KEY_SIZE], &mut slots)
            .expect("stored");
    }
    assert_eq!(
        open(&mut flash),
        print(1).ok().map(|print| (RolloverState::Settled, print))
    );
    assert!(
        flash.holds(&words[0]) && !flash.holds(&words[1]),
        "given up"
    );
}
