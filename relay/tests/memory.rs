//! What the relay remembers: its mark, its keys, and SETUP_SIGNING from the local side.

use std::{cell::Cell, collections::VecDeque, convert::Infallible};

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavlink_signing::{
    Frame, FrameRef, Header, Hmac, KEY_SIZE, KeyChange, KeyChangeError, KeyError, KeyRing, KeySlot,
    KeyStore, LinkClock, MessageId, NotStored, RESERVATION, ReplayGuard, RolloverState,
    SetupSigning, SignError, SigningKey, Stamp, Stamper, SyncState, TimeSource, Timestamp,
    VerifyError, Window, sign_frame,
};
use mavseal_relay::{
    FIRST_RESERVATION, FirstKey, FlashKeyStore, ForwardMode, LinkFlash, LinkMemory,
    LinkMemoryError, PersistentClock, Presence, RejectReason, Relay, TimeError, adapter,
};
use mavseal_store::{
    MarkError, Region,
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

fn keys() -> KeyRing<Hmac> {
    SigningKey::new(&KEY).expect("a key").into()
}

/// The flashes of both marks.
type Marks = [Flash<2>; 2];

fn first_start<T: FnMut() -> u64>(
    flashes: &mut Marks,
    timer: T,
) -> PersistentClock<&mut Flash<2>, T> {
    PersistentClock::provision(flashes.each_mut(), REGION, &keys(), timer).expect("fits")
}

fn start<T: FnMut() -> u64>(flashes: &mut Marks, timer: T) -> PersistentClock<&mut Flash<2>, T> {
    PersistentClock::open(flashes.each_mut(), REGION, &keys(), timer).expect("a mark")
}

fn relay() -> Relay<Hmac> {
    let receiver = ReplayGuard::new(LINK_IN, Window::ONE_MINUTE);
    let mode = ForwardMode::StripSignature;
    Relay::new(keys(), Stamper::new(LINK_OUT), receiver, mode).expect("two links")
}

#[test]
fn a_clock_that_leaps_is_no_silence() {
    let mut flashes = Marks::default();
    let mut kept = first_start(&mut flashes, || 1000);
    let mut relay = relay();
    let (mut local, mut link) = (Line::default(), Line::default());
    let (mine, theirs) = (signed(NOW), signed(NOW + 7));
    let (first, second) = theirs.as_bytes().split_at(6);
    let mut turn = |from_link: &[u8]| {
        link.input.extend(from_link);
        while adapter::poll(&mut relay, &mut local, &mut link, &mut kept, &mut |_| ()).moved() {}
        relay.inbound().passed()
    };
    assert_eq!(turn(&[mine.as_bytes(), first].concat()), 1);
    assert_eq!(turn(second), 2);
    assert!(kept.now() > at(NOW / 2), "the frame has told the time");
    let shown = format!("{kept:?}");
    assert!(
        shown.starts_with("PersistentClock { clock: Clock {"),
        "{shown}"
    );
}

#[test]
fn after_a_restart_nothing_is_used_or_accepted_again() {
    let mut flashes = Marks::default();
    let heartbeat = Frame::new(header(), &[1]).expect("a heartbeat");
    let frames = [signed(NOW), signed(NOW + 5)];
    let frames = frames.each_ref();
    let mut last = 0;
    for restart in 0..3 {
        if restart == 0 {
            let _ = first_start(&mut flashes, || 0);
        }
        let mut kept = start(&mut flashes, || 0);
        kept.update(TimeSource::Trusted, at(NOW + 5))
            .expect("ahead");
        let local = [&heartbeat, &heartbeat];
        let (passed, stamps, rejected) = run(&mut relay(), &mut kept, &local, &frames);
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
    let mut flashes = Marks::default();
    let _ = first_start(&mut flashes, || 0);
    for (running, ahead) in [
        (0, FIRST_RESERVATION),
        (800_000, 100_000),
        (u64::MAX, RESERVATION),
    ] {
        let timer = Cell::new(0);
        let mut kept = start(&mut flashes, || timer.get());
        timer.set(running);
        let floor = kept.floor(KeySlot::A);
        kept.reserve(KeySlot::A, floor).expect("stored");
        let kept = start(&mut flashes, || 0);
        assert_eq!(kept.floor(KeySlot::A), floor.saturating_add(ahead));
        assert_eq!(kept.floor(KeySlot::B), Timestamp::MAX, "no key, no stamp");
    }
}

#[test]
fn what_cannot_be_remembered_is_rejected() {
    let mut flashes = Marks::default();
    let _ = first_start(&mut flashes, || 0);
    flashes[0].fail(255);
    let mut kept = start(&mut flashes, || 0);
    kept.update(TimeSource::Trusted, at(NOW)).expect("ahead");
    let heartbeat = Frame::new(header(), &[1]).expect("a heartbeat");
    let (passed, stamps, rejected) = run(&mut relay(), &mut kept, &[&heartbeat], &[&signed(NOW)]);
    // One write in 256 succeeds, and none of these.
    assert_eq!((passed, stamps.len()), (0, 0));
    assert_eq!(rejected, [RejectReason::NotStored; 2]);
}

/// A key whose stamps are used up signs nothing; it starts all the same, so that it can be given a new one.
#[test]
fn the_end_of_time_ends_a_key_and_not_the_board() {
    let mut flashes = Marks::default();
    let mut kept = first_start(&mut flashes, || 0);
    kept.reserve(KeySlot::A, Timestamp::MAX).expect("stored");
    let mut kept = start(&mut flashes, || 0);
    let stamp = kept.stamp(&mut Stamper::new(LINK_OUT));
    assert_eq!(stamp, Err(SignError::NotStored));
    let print = SigningKey::<Hmac>::new(&[9; KEY_SIZE]).expect("a key");
    let first = kept.begin_key(KeySlot::B, print.fingerprint(), at(NOW));
    assert_eq!(first, Ok(at(NOW)));
    let stamp = kept.stamp(&mut Stamper::new(LINK_OUT).in_slot(KeySlot::B));
    assert_eq!(stamp.map(|stamp| stamp.timestamp), Ok(at(NOW)));
}

#[test]
fn the_reservation_does_not_end_time() {
    let mut flashes = Marks::default();
    let last = at(Timestamp::MAX.ticks() - 1);
    let mut kept = first_start(&mut flashes, || 0);
    kept.reserve(KeySlot::A, last).expect("stored");
    let kept = start(&mut flashes, || 0);
    assert_eq!(kept.floor(KeySlot::A), Timestamp::MAX);
}

#[test]
fn a_clock_without_battery_is_not_believed() {
    let mut flashes = Marks::default();
    let mut kept = first_start(&mut flashes, || 0);
    kept.reserve(KeySlot::A, at(NOW)).expect("stored");
    let least = NOW + FIRST_RESERVATION - RESERVATION - Window::ONE_MINUTE.ahead;
    let before = kept.now();
    let told = kept.update(TimeSource::Trusted, at(least - 1));
    assert_eq!(told, Err(TimeError::BehindMark));
    assert_eq!(
        TimeError::BehindMark.to_string(),
        "the time told has passed: later timestamps have been used"
    );
    let told = kept.update(TimeSource::Trusted, Timestamp::MAX);
    assert_eq!(told, Err(TimeError::BeyondCeiling));
    assert_eq!(
        TimeError::BeyondCeiling.to_string(),
        "the time told is too far ahead to be right"
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
    let mut flashes = Marks::default();
    let mut kept = first_start(&mut flashes, || 0);
    kept.reserve(KeySlot::A, at(NOW)).expect("stored");
    let mut kept = start(&mut flashes, || 5);
    assert_eq!(kept.monotonic(), 5);
    let floor = kept.floor(KeySlot::A);
    let below = at(floor.ticks() - 1);
    assert_eq!(kept.reserve(KeySlot::A, below), Err(NotStored));
    assert_eq!(kept.reserve(KeySlot::B, floor), Err(NotStored), "no key");
    kept.reserve(KeySlot::A, floor).expect("stored");
    // A stamper and a receiver that know nothing of it: what it heard before is not accepted again.
    let frame = signed(NOW);
    let frame = FrameRef::parse(frame.as_bytes()).expect("whole");
    let key = SigningKey::<Hmac>::new(&KEY).expect("a key");
    let authentic = mavlink_signing::authenticate(frame, &key).expect("signed");
    let mut receiver = ReplayGuard::new(LINK_IN, Window::ONE_MINUTE);
    let verdict = kept.admit(&mut receiver, authentic).map(drop);
    assert_eq!(verdict, Err(VerifyError::Replayed));
    let stamp = kept.stamp(&mut Stamper::new(LINK_OUT));
    assert_eq!(stamp.map(|stamp| stamp.timestamp), Ok(floor));
}

/// The whole of a device's flash.
fn flash(flashes: &mut [Flash<2>; 3]) -> LinkFlash<&mut Flash<2>> {
    let [keys, a, b] = flashes.each_mut();
    LinkFlash {
        keys,
        marks: [a, b],
        region: REGION,
    }
}

fn open(
    flashes: &mut [Flash<2>; 3],
    first: FirstKey<'_>,
) -> Result<RolloverState, LinkMemoryError> {
    let opened = LinkMemory::open::<Hmac>(flash(flashes), first, || 0);
    opened.map(|(keys, _)| keys.rollover_state())
}

/// The power fails inside any write of the first start, and again at the next ones: then it starts.
#[test]
fn a_cut_in_the_first_provisioning_leaves_a_device_that_starts() {
    let mut cuts = 0;
    for chance in 0..6 {
        for cut in 0..100 {
            let mut flashes = [chance, !chance, chance / 2].map(Flash::<2>::new);
            let which = cut % 3;
            for again in 0..3 {
                flashes[which].cut_after((cut / 3 / (1 << again)) as u32);
                let _ = open(&mut flashes, FirstKey::Own(&KEY));
                cuts += u32::from(!flashes[which].has_power());
                flashes.iter_mut().for_each(Flash::restart);
            }
            let opened = open(&mut flashes, FirstKey::Own(&KEY));
            assert_eq!(opened, Ok(RolloverState::Settled), "{chance} {cut}");
        }
    }
    assert!(cuts > 600, "{cuts}");
}

/// What was lost is not made anew in silence.
#[test]
fn what_a_device_has_lost_it_says() {
    let mut flashes = [1, 2, 3].map(Flash::<2>::new);
    assert_eq!(
        open(&mut flashes, FirstKey::None),
        Err(LinkMemoryError::NoKey)
    );
    let published = *b"mavseal demo key, not a secret!!";
    let refused = open(&mut flashes, FirstKey::Own(&published));
    let reason = KeyChangeError::Key(KeyError::Published);
    assert_eq!(refused, Err(LinkMemoryError::Key(reason)));
    for none in [
        [0; KEY_SIZE],
        [0xFF; KEY_SIZE],
        mavlink_signing::passphrase_key(""),
    ] {
        assert!(open(&mut flashes, FirstKey::Demonstration(&none)).is_err());
    }
    let demonstration = FirstKey::Demonstration(&published);
    assert_eq!(
        open(&mut flashes, demonstration),
        Ok(RolloverState::Settled)
    );
    let kept = flashes.clone();

    // Its keys were erased, or cannot be read; its mark is blank, cannot be read, or is the other key's.
    flashes[0] = Flash::new(1);
    let erased = open(&mut flashes, demonstration);
    assert_eq!(erased, Err(LinkMemoryError::KeysLost));
    flashes = kept.clone();
    (0..2 * PAGE_SIZE)
        .step_by(WORD_SIZE)
        .for_each(|word| flashes[0].spoil(word));
    let unreadable = open(&mut flashes, demonstration);
    assert_eq!(unreadable, Err(LinkMemoryError::KeysUnreadable));
    flashes = kept.clone();
    flashes[1] = Flash::new(1);
    let blank = open(&mut flashes, demonstration);
    assert_eq!(blank, Err(LinkMemoryError::Mark(MarkError::NotProvisioned)));
    flashes = kept.clone();
    flashes.swap(1, 2);
    let swapped = open(&mut flashes, demonstration);
    assert_eq!(
        swapped,
        Err(LinkMemoryError::Mark(MarkError::NotProvisioned))
    );
    flashes = kept.clone();
    flashes[1] = kept[0].clone();
    let foreign = open(&mut flashes, demonstration);
    assert_eq!(foreign, Err(LinkMemoryError::Mark(MarkError::Unreadable)));

    // Somebody gives it a key.
    let given = LinkMemory::provision::<Hmac>(flash(&mut flashes), &[5; KEY_SIZE], || 0);
    assert!(given.is_ok());
    assert_eq!(
        open(&mut flashes, FirstKey::None),
        Ok(RolloverState::Settled)
    );
    assert!(!flashes[0].holds(b"mavseal "), "the old one is gone");
}

/// Whoever has the old key, or led the clock away with it, spoils nothing of the new one.
#[test]
fn a_new_key_begins_anew() {
    const NEW: [u8; KEY_SIZE] = [9; KEY_SIZE];
    const DAY: u64 = 24 * 3600 * 100_000;
    let by = |secret: &[u8; KEY_SIZE], payload: u8, ticks| {
        let mut frame = Frame::new(header(), &[payload]).expect("a heartbeat");
        let key = SigningKey::<Hmac>::new(secret).expect("a key");
        let stamp = Stamp {
            link_id: LINK_IN,
            timestamp: at(ticks),
        };
        sign_frame(&mut frame, &key, stamp).expect("unsigned");
        frame
    };
    let mut flashes = [1, 2, 3].map(Flash::<2>::new);
    let opened = LinkMemory::open(flash(&mut flashes), FirstKey::Own(&KEY), || 0);
    let (keys, memory) = opened.expect("a key");
    let LinkMemory {
        mut store,
        clock: mut kept,
    } = memory;
    let receiver = ReplayGuard::new(LINK_IN, Window::ONE_MINUTE);
    let mode = ForwardMode::StripSignature;
    let mut relay = Relay::new(keys, Stamper::new(LINK_OUT), receiver, mode).expect("two links");
    let heartbeat = Frame::new(header(), &[1]).expect("a heartbeat");
    // A former friend leads the clock away, as far as one can.
    assert!(hears(&mut relay, &mut kept, &by(&KEY, 1, NOW)));
    assert!(hears(&mut relay, &mut kept, &by(&KEY, 2, NOW + 364 * DAY)));
    assert!(hears(
        &mut relay,
        &mut kept,
        &by(&KEY, 3, NOW + 2 * 364 * DAY)
    ));
    assert!(!hears(&mut relay, &mut kept, &by(&KEY, 4, NOW + 9)));
    let setup = SetupSigning {
        target_system: 1,
        target_component: 25,
        secret_key: NEW,
        initial_timestamp: at(NOW + 10),
    };
    let applied = relay.apply_setup(&setup, &mut kept, &mut store);
    assert_eq!(applied, Ok(()));
    // The station, with the right time: under the old key, then under the new one. Its stamps are near.
    assert!(hears(&mut relay, &mut kept, &by(&NEW, 5, NOW + 20)));
    let (_, stamps, _) = run(&mut relay, &mut kept, &[&heartbeat], &[]);
    assert!(stamps[0] >= NOW + 10 && stamps[0] < NOW + 100);
    // With the old one, nothing is moved any more, confirmed or not.
    assert!(!hears(&mut relay, &mut kept, &by(&KEY, 6, NOW + 365 * DAY)));
    assert_eq!(relay.confirm_key(&mut store), Ok(()));
    assert!(!hears(&mut relay, &mut kept, &by(&KEY, 7, NOW + 365 * DAY)));
    assert!(hears(&mut relay, &mut kept, &by(&NEW, 8, NOW + 30)));
    assert_eq!(relay.retire_key(&mut store), Ok(()));
    assert!(hears(&mut relay, &mut kept, &by(&NEW, 9, NOW + 40)));
    // The same over a restart; what was accepted is not accepted again.
    let opened = LinkMemory::open(flash(&mut flashes), FirstKey::None, || 0);
    let (keys, mut memory) = opened.expect("a key");
    let receiver = ReplayGuard::new(LINK_IN, Window::ONE_MINUTE);
    let mut relay = Relay::new(keys, Stamper::new(LINK_OUT), receiver, mode).expect("two links");
    assert!(!hears(
        &mut relay,
        &mut memory.clock,
        &by(&NEW, 9, NOW + 40)
    ));
    assert!(hears(
        &mut relay,
        &mut memory.clock,
        &by(&NEW, 10, NOW + RESERVATION)
    ));
    assert!(!flashes[0].holds(&[7; WORD_SIZE]), "the old key is gone");
}

fn hears(relay: &mut Relay<Hmac>, kept: &mut impl LinkClock, frame: &Frame) -> bool {
    run(relay, kept, &[], &[frame]).0 == 1
}

/// A timestamp that cannot be right, or comes with the key in use, does nothing.
#[test]
fn the_time_of_a_key_sets_no_clock_that_knows_better() {
    for (initial, synced) in [
        (Timestamp::MAX, true),
        (at(123_456_789), true),
        (at(NOW - 5), true),
        (Timestamp::MAX, false),
    ] {
        let mut flashes = [1, 2, 3].map(Flash::<2>::new);
        let opened = LinkMemory::open(flash(&mut flashes), FirstKey::Own(&KEY), || 0);
        let (keys, memory) = opened.expect("a key");
        let LinkMemory {
            mut store,
            clock: mut kept,
        } = memory;
        if synced {
            kept.update(TimeSource::Trusted, at(NOW)).expect("told");
        }
        let before = kept.now();
        let receiver = ReplayGuard::new(LINK_IN, Window::ONE_MINUTE);
        let mode = ForwardMode::StripSignature;
        let mut relay =
            Relay::new(keys, Stamper::new(LINK_OUT), receiver, mode).expect("two links");
        for secret_key in [[9; KEY_SIZE], [9; KEY_SIZE]] {
            let setup = SetupSigning {
                target_system: 1,
                target_component: 25,
                secret_key,
                initial_timestamp: initial,
            };
            assert_eq!(relay.apply_setup(&setup, &mut kept, &mut store), Ok(()));
            assert_eq!(kept.now(), before);
        }
        let heartbeat = Frame::new(header(), &[1]).expect("a heartbeat");
        let (_, stamps, rejected) = run(&mut relay, &mut kept, &[&heartbeat], &[]);
        assert_eq!((stamps.len(), rejected), (1, vec![]));
        assert!(stamps[0] < before.ticks() + 10 * RESERVATION);
    }
}

#[test]
fn a_key_that_cannot_be_read_is_not_taken_for_none() {
    let mut flash = Flash::<2>::default();
    let (mut slots, _) = FlashKeyStore::open::<Hmac>(&mut flash, REGION).expect("fits");
    slots.provision::<Hmac>(&[1; KEY_SIZE]).expect("stored");
    assert!(!slots.is_empty());
    (0..PAGE_SIZE)
        .step_by(WORD_SIZE)
        .for_each(|word| flash.spoil(word));
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
        // Twice ten words, and again where the copies would be in two pages.
        assert!((start * 20..start * 25).contains(&(flash.writes() - writes)));
    }
    // A page takes 12 pairs; then the other is erased, and this one.
    assert!(flash.erases() - erases <= 18);
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
        let told = slots.retired_key_remains();
        let mut flash = slots.into_flash();
        let remains = flash.holds(&[2; WORD_SIZE]);
        assert!(!remains || told, "a key that is still there is told of");
        left += u32::from(told);
        flash.fail(0);
        let (mut slots, keys) = FlashKeyStore::open::<Hmac>(flash, REGION).expect("fits");
        let mut keys = keys.expect("stored");
        if next.is_ok() {
            keys.withdraw(&mut slots).expect("stored");
        }
        let (slots, _) = FlashKeyStore::open::<Hmac>(slots.into_flash(), REGION).expect("fits");
        assert!(!slots.into_flash().holds(&[2; WORD_SIZE]));
    }
    assert!(left > 0, "neither erased nor overwritten");
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
    let (ours, other) = (frame(25, 9), frame(26, 8));

    let mut deaf = relay();
    deaf.set_presence(Presence::Shown);
    run(&mut deaf, &mut clock, &[&ours], &[]);
    assert!(deaf.take_setup().is_none(), "it was not told to");

    let mut relay = relay();
    relay.keep_setup(1, 25);
    relay.set_presence(Presence::Shown);
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
