//! Target: one end of a link in time, with its clock and a mark for each of its keys, over restarts.

use std::cell::Cell;
use std::collections::BTreeMap;

use arbitrary::Arbitrary;
use mavlink_signing::{
    Authenticate, Clock, FrameRef, Hmac, KeyRing, KeySlot, LinkClock, RESERVATION, ReplayGuard,
    RolloverState, SigningKey, Stamp, Stamper, SyncState, TimeSource, Timestamp, VerifyError,
    Window, system_time,
};
use mavseal_proofs::keys::{self, Model};
use mavseal_relay::{PersistentClock, RejectReason};
use mavseal_store::model::{Flash, PAGE_SIZE};
use mavseal_store::{Binding, HighWaterMark, Region};

use crate::input::Moment;
use crate::repair::signed;
use crate::senders::{jump, move_by};

const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};
/// No whole page.
const NOWHERE: Region = Region { start: 8, ..REGION };
/// The link that this end signs for, and the one that it hears.
const LINK_IDS: [u8; 2] = [1, 2];
const MINUTE: Window = Window::ONE_MINUTE;

/// Something that happens at the end.
#[derive(Arbitrary, Clone, Copy, Debug)]
pub struct Happening {
    /// Ticks since what happened before: none, or 2^(n - 1), n counted round 40 of them.
    pub wait: u8,
    /// Modulo 12: 0 nothing; 1 a trusted source tells the time; 2 another one does; 3 SYSTEM_TIME; 4 a
    /// frame is sent; 5 one arrives; 6 the last accepted arrives again; 7 the end starts anew; 8 it is given a new key;
    /// 9 it retires the old one, if it may; 10 and 11 as 5 and 6, with the key that it does not sign with.
    pub kind: u8,
    /// How far from the clock the time is that is told or stamped: as far as an arrival's clock jumps,
    /// then so many ticks.
    pub jump: i8,
    /// See `jump`. With a start: after how many writes the power fails, if that is not 0.
    pub after: i16,
}

/// An end of a link, and what happens to it.
#[derive(Arbitrary, Clone, Debug)]
pub struct End {
    /// How wrong its timer may be.
    pub drift: u8,
    /// What the mark begins with.
    pub mark: Moment,
    /// What is left of words in which the power fails.
    pub chance: u16,
    /// In order.
    pub happenings: Vec<Happening>,
}

/// What has been used with one key, over all starts.
#[derive(Clone, Copy, Default)]
struct Used {
    given: Option<Timestamp>,
    accepted: Option<Timestamp>,
}

/// What outlives a restart, but for the marks: the keys, and what the test knows of each.
struct Lasting {
    keys: KeyRing<Hmac>,
    /// The number of the key in each slot.
    numbers: [u8; 2],
    memory: Model,
    used: BTreeMap<u8, Used>,
}

/// The first key's number.
const FIRST: u8 = 1;

fn key(number: u8) -> SigningKey<Hmac> {
    SigningKey::new(&keys::bytes(number)).expect("neither 0 nor 255")
}

/// An end over its restarts: under no key is a stamp given twice (T1, T2) or a frame accepted twice (R3), and each key
/// has a mark of its own. What is rejected changes no receiver and moves no clock; what is not trusted moves it by a
/// second at most; a frame of a former key does not move it. A clock that knows the time accepts nothing outside of the
/// window; one that does not follows none beyond the ceiling. A new key starts it anew only if it does not know the
/// time.
pub fn kept_link(input: End) {
    let timer = Cell::new(0);
    let flashes = [input.chance, !input.chance].map(|chance| Flash::new(chance.into()));
    let mut lasting = Lasting {
        keys: key(FIRST).into(),
        numbers: [FIRST, 0],
        memory: Model::new(),
        used: BTreeMap::new(),
    };
    if input.happenings.is_empty() {
        assert!(PersistentClock::provision(flashes, NOWHERE, &lasting.keys, || 0).is_err());
        return;
    }
    let kept = PersistentClock::provision(flashes, REGION, &lasting.keys, || 0).expect("power");
    let mut flashes = kept
        .into_flashes()
        .map(|flash| flash.expect("it has not failed"));
    if input.mark.timestamp() != Timestamp::ZERO {
        begin_at(&mut flashes[0], input.mark.timestamp(), &mut lasting);
    }
    let mut happenings = input.happenings.iter();
    loop {
        let [a, b] = &flashes;
        let spare = [a.clone(), b.clone()];
        let kept = PersistentClock::open(flashes, REGION, &lasting.keys, || timer.get());
        let kept = kept
            .expect("a mark for each key")
            .drifting(input.drift.into());
        for slot in [KeySlot::A, KeySlot::B] {
            if lasting.keys.key(slot).is_some() {
                let used = lasting.used(slot);
                for last in [used.given, used.accepted].into_iter().flatten() {
                    // When all are used up there is no floor above, and none is given.
                    let over = last == Timestamp::MAX;
                    assert!(over || kept.floor(slot) > last, "used before");
                }
            }
        }
        // Neither knows of the mark.
        let fresh = |_| ReplayGuard::new(LINK_IDS[1], MINUTE);
        let slots = [KeySlot::A, KeySlot::B];
        let mut end = Run {
            stampers: slots.map(|slot| Stamper::new(LINK_IDS[0]).in_slot(slot)),
            receivers: slots.map(fresh),
            kept,
            bounded: 0,
        };
        let start = loop {
            let Some(happening) = happenings.next() else {
                return;
            };
            let wait = match happening.wait % 40 {
                0 => 0,
                n => 1 << (n - 1),
            };
            timer.set(timer.get() + wait);
            if happening.kind % 12 == 7 {
                break happening;
            }
            end.happens(happening, &mut lasting);
        };
        let [a, b] = end.kept.into_flashes();
        let [was_a, was_b] = spare;
        flashes = [a.unwrap_or(was_a), b.unwrap_or(was_b)];
        for flash in &mut flashes {
            flash.restart();
            if start.after > 0 {
                flash.cut_after(u32::from(start.after.unsigned_abs()) - 1);
            }
        }
    }
}

/// Brings the mark of the first key above `last`, as if that had been used.
fn begin_at(flash: &mut Flash<2>, last: Timestamp, lasting: &mut Lasting) {
    let binding = Binding::new(1, key(FIRST).fingerprint().0);
    let mut mark = HighWaterMark::open(flash, REGION, binding).expect("it was provided");
    mark.reserve(last.ticks(), 0).expect("stored");
    lasting.used_mut(KeySlot::A).given = Some(last);
}

impl Lasting {
    fn used_mut(&mut self, slot: KeySlot) -> &mut Used {
        self.used.entry(*slot.of(&self.numbers)).or_default()
    }

    fn used(&mut self, slot: KeySlot) -> Used {
        *self.used_mut(slot)
    }
}

/// The end between two starts.
struct Run<T> {
    kept: PersistentClock<Flash<2>, T>,
    stampers: [Stamper; 2],
    receivers: [ReplayGuard; 2],
    /// Ticks that sources have moved it that are not trusted, since it was set or began.
    bounded: u64,
}

impl<T: FnMut() -> u64> Run<T> {
    fn happens(&mut self, happening: &Happening, lasting: &mut Lasting) {
        let before = self.kept.now();
        let time = move_by(jump(before, happening.jump), happening.after.into());
        let signing = lasting.keys.signing_slot();
        let kind = happening.kind % 12;
        let slot = if kind < 10 { signing } else { signing.other() };
        match kind {
            1 => self.told(before, time),
            2 => self.moved(before, time),
            3 => {
                shown(time);
                self.moved(before, time);
            }
            4 => self.sends(before, lasting),
            5 | 10 => self.hears(slot, before, time, lasting),
            6 | 11 => {
                let again = lasting.used(slot).accepted.unwrap_or(time);
                self.hears(slot, before, again, lasting);
            }
            8 => self.is_given_a_key(before, time, lasting),
            9 => {
                let Lasting { keys, memory, .. } = lasting;
                let _ = keys.confirm(memory);
                let _ = keys.retire(memory);
            }
            _ => {}
        }
    }

    fn told(&mut self, before: Timestamp, time: Timestamp) {
        let told = self.kept.update(TimeSource::Trusted, time);
        assert!(told.is_err() || time <= Clock::CEILING);
        if told.is_err() || time == Timestamp::ZERO {
            assert_eq!(self.kept.now(), before);
            return;
        }
        assert_eq!(told, Ok(time.ticks_since(before)));
        let after = (self.kept.now(), self.kept.sync());
        assert_eq!(after, (time, SyncState::Synced));
        self.bounded = 0;
    }

    fn moved(&mut self, before: Timestamp, time: Timestamp) {
        let sync = self.kept.sync();
        let step = self.kept.update(TimeSource::Bounded, time);
        let step = step.expect("never rejected");
        assert_eq!(self.kept.now(), before.saturating_add(step));
        assert_eq!(self.kept.sync(), sync);
        assert!(step <= time.ticks_since(before));
        assert!(step == 0 || time <= Clock::CEILING);
        self.bounded += step;
        assert!(self.bounded <= Clock::MAX_BOUNDED_STEP);
    }

    fn sends(&mut self, before: Timestamp, lasting: &mut Lasting) {
        let slot = lasting.keys.signing_slot();
        let floor = self.kept.floor(slot);
        let stamp = self.kept.stamp(slot.of_mut(&mut self.stampers));
        let reason = stamp.err().map(RejectReason::from);
        assert_ne!(reason, Some(RejectReason::Other));
        let Ok(Stamp { link_id, timestamp }) = stamp else {
            return;
        };
        assert_eq!(link_id, LINK_IDS[0]);
        assert!(timestamp >= before.max(floor));
        let last = lasting.used_mut(slot).given.replace(timestamp);
        assert!(last.is_none_or(|last| timestamp > last), "given twice");
    }

    /// A frame that is signed with the key in `slot`, if there is one.
    fn hears(
        &mut self,
        slot: KeySlot,
        before: Timestamp,
        timestamp: Timestamp,
        lasting: &mut Lasting,
    ) {
        let link_id = LINK_IDS[1];
        if lasting.keys.key(slot).is_none() {
            return;
        }
        let key = key(*slot.of(&lasting.numbers));
        let frame = signed(&key, Stamp { link_id, timestamp });
        let frame = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
        let authentic = lasting.keys.authenticate(frame).expect("one of its keys");
        let used = authentic.key();
        assert_eq!(used.slot, slot);
        assert_eq!(used.former, slot != lasting.keys.signing_slot());
        let (sync, floor) = (self.kept.sync(), self.kept.floor(slot));
        let lasts = |run: &Self| run.receivers.each_ref().map(ReplayGuard::last);
        let untouched = lasts(self);
        let receiver = slot.of_mut(&mut self.receivers);
        let verdict = self.kept.admit(receiver, authentic);
        let reason = verdict
            .as_ref()
            .err()
            .map(|error| RejectReason::from(*error));
        assert_ne!(reason, Some(RejectReason::Other));
        let after = self.kept.now();
        let off = before.ticks().abs_diff(timestamp.ticks());
        if let Ok(verified) = &verdict {
            lasting.keys.on_accepted(verified);
            assert!(timestamp >= floor);
            let last = lasting.used_mut(slot).accepted.replace(timestamp);
            assert!(last.is_none_or(|last| timestamp > last), "accepted twice");
            let behind = after.ticks().abs_diff(timestamp.ticks());
            match sync {
                _ if used.former => assert!(after == before && off <= MINUTE.past),
                SyncState::Synced => assert!(off <= MINUTE.past),
                SyncState::Unsynced => {
                    assert!(behind <= RESERVATION);
                    assert!(timestamp <= Clock::CEILING.saturating_add(MINUTE.ahead));
                }
            }
        } else {
            assert_eq!((lasts(self), after), (untouched, before));
        }
        assert_eq!(self.kept.sync(), sync);
        if (sync == SyncState::Synced || used.former) && off > MINUTE.past {
            let rejected = [VerifyError::FromFuture, VerifyError::TooOld];
            assert!(verdict.is_err_and(|error| rejected.contains(&error)));
        }
    }

    /// Takes over a new key, as a relay does with one that came in: its order of stamps begins at `initial`, if that may
    /// be right. So does a clock that does not know the time.
    fn is_given_a_key(&mut self, before: Timestamp, initial: Timestamp, lasting: &mut Lasting) {
        let number = lasting
            .numbers
            .into_iter()
            .max()
            .map_or(FIRST, |last| last + 1);
        if lasting.keys.rollover_state() != RolloverState::Settled || number > 200 {
            return;
        }
        let new = key(number);
        let slot = lasting.keys.slot_for(&new).expect("another key");
        let (sync, kept) = (self.kept.sync(), self.kept.floor(slot.other()));
        let begun = self.kept.begin_key(slot, new.fingerprint(), initial);
        assert_eq!(self.kept.floor(slot.other()), kept, "the other key's");
        assert_eq!(self.kept.sync(), sync);
        let Ok(first) = begun else {
            assert_eq!(self.kept.now(), before);
            return;
        };
        assert_eq!(self.kept.floor(slot), first);
        let plausible = (Clock::RELEASE..=Clock::CEILING).contains(&initial);
        let anew = plausible && sync == SyncState::Unsynced;
        assert_eq!(self.kept.now(), if anew { initial } else { before });
        self.bounded = if anew { 0 } else { self.bounded };
        *slot.of_mut(&mut self.stampers) = Stamper::resume(LINK_IDS[0], first).in_slot(slot);
        *slot.of_mut(&mut self.receivers) = ReplayGuard::resume(LINK_IDS[1], MINUTE, first);
        *slot.of_mut(&mut lasting.numbers) = number;
        let Lasting { keys, memory, .. } = lasting;
        keys.apply(&keys::bytes(number), memory).expect("stored");
    }
}

/// A SYSTEM_TIME that tells `time` is read as that, however many of its zeros are cut.
fn shown(time: Timestamp) {
    let mut payload = [0; 13];
    payload[..8].copy_from_slice(&time.unix_micros().to_le_bytes());
    for length in 8..=12 {
        assert_eq!(system_time(&payload[..length]), Some(time));
    }
    assert_eq!(system_time(&payload), None);
    assert_eq!(system_time(&[]), None);
}
