//! Target: one end of a link in time, with its clock and its mark, over restarts.

use std::cell::Cell;

use arbitrary::Arbitrary;
use crc::{CRC_32_ISO_HDLC, Crc};
use embedded_storage::nor_flash::NorFlash;
use mavlink_signing::{
    Clock, FrameRef, LinkClock, RESERVATION, ReplayGuard, Stamp, Stamper, SyncState, TimeSource,
    Timestamp, VerifyError, Window, authenticate, system_time,
};
use mavseal_relay::{PersistentClock, PersistentClockError, RejectReason};
use mavseal_store::model::{Flash, PAGE_SIZE};
use mavseal_store::{HighWaterMark, Region, ReserveError, StoreError};

use crate::input::Moment;
use crate::repair::{KEY, signed};
use crate::senders::{jump, move_by};

const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};
/// No whole page.
const NOWHERE: Region = Region { start: 8, ..REGION };
/// The link that this end signs for, and the one that it hears.
const LINK_IDS: [u8; 2] = [1, 2];

/// Something that happens at the end.
#[derive(Arbitrary, Clone, Copy, Debug)]
pub struct Happening {
    /// Ticks since what happened before: none, or 2^(n - 1), n counted round 40 of them.
    pub wait: u8,
    /// Modulo 8: 0 nothing; 1 a trusted source tells the time; 2 another one does; 3 SYSTEM_TIME; 4 a
    /// frame is sent; 5 one arrives; 6 the last accepted arrives again; 7 the end starts anew.
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
    /// How many records the flash takes before its numbers of records are used up; 0 for all of them.
    pub records: u8,
    /// What is left of words in which the power fails.
    pub chance: u16,
    /// In order.
    pub happenings: Vec<Happening>,
}

/// What has been used, over all starts.
#[derive(Default)]
struct Used {
    given: Option<Timestamp>,
    accepted: Option<Timestamp>,
}

/// An end over its restarts: no stamp is given twice (T1, T2), no frame accepted twice (R3); what is rejected
/// changes no receiver and moves no clock, what is not trusted moves it by a second at most, and a clock that
/// knows the time accepts nothing outside of the window.
pub fn kept_link(input: End) {
    let timer = Cell::new(0);
    let mut flash = Flash::new(input.chance.into());
    let mut used = Used::default();
    if input.happenings.is_empty() {
        assert!(PersistentClock::new(flash, NOWHERE, || 0).is_err());
        return;
    }
    if input.records > 0 {
        write_record(&mut flash, u32::MAX - u32::from(input.records));
    }
    if input.mark.timestamp() != Timestamp::ZERO {
        flash = begin_at(flash, input.mark.timestamp(), &mut used);
    }
    let mut happenings = input.happenings.iter();
    loop {
        let kept = match PersistentClock::new(flash, REGION, || timer.get()) {
            Ok(kept) => kept.drifting(input.drift.into()),
            Err(error) => {
                assert_eq!(error, PersistentClockError::Exhausted);
                return;
            }
        };
        for last in [used.given, used.accepted].into_iter().flatten() {
            assert!(kept.floor() > last, "used before");
        }
        let mut end = Run {
            stamper: kept.stamper(LINK_IDS[0]),
            receiver: ReplayGuard::resume(LINK_IDS[1], Window::ONE_MINUTE, kept.floor()),
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
            if happening.kind % 8 == 7 {
                break happening;
            }
            end.happens(happening, &mut used);
        };
        flash = end.kept.into_flash();
        flash.restart();
        if start.after > 0 {
            flash.cut_after(u32::from(start.after.unsigned_abs()) - 1);
        }
    }
}

/// A flash whose mark lies above `last`, as if that had been used.
fn begin_at(flash: Flash<2>, last: Timestamp, used: &mut Used) -> Flash<2> {
    let mut mark = HighWaterMark::open(flash, REGION).expect("the region fits");
    match mark.reserve(last.ticks(), 0) {
        Ok(()) => used.given = Some(last),
        Err(error) => assert_eq!(error, ReserveError::Store(StoreError::Exhausted)),
    }
    mark.into_flash()
}

/// Writes a mark of 0 into the first place, as the record with this number.
fn write_record(flash: &mut Flash<2>, number: u32) {
    let mut record = [0; 16];
    record[8..12].copy_from_slice(&number.to_le_bytes());
    let checksum = Crc::<u32>::new(&CRC_32_ISO_HDLC).checksum(&record[..12]);
    record[12..].copy_from_slice(&checksum.to_le_bytes());
    flash.write(0, &record).expect("the flash is new");
}

/// The end between two starts.
struct Run<T> {
    kept: PersistentClock<Flash<2>, T>,
    stamper: Stamper,
    receiver: ReplayGuard,
    /// Ticks that sources have moved it that are not trusted, since one was that is.
    bounded: u64,
}

impl<T: FnMut() -> u64> Run<T> {
    fn happens(&mut self, happening: &Happening, used: &mut Used) {
        let before = self.kept.now();
        let time = move_by(jump(before, happening.jump), happening.after.into());
        match happening.kind % 8 {
            1 => self.told(before, time),
            2 => self.moved(before, time),
            3 => {
                shown(time);
                self.moved(before, time);
            }
            4 => self.sends(before, used),
            5 => self.hears(before, time, used),
            6 => self.hears(before, used.accepted.unwrap_or(time), used),
            _ => {}
        }
    }

    fn told(&mut self, before: Timestamp, time: Timestamp) {
        let told = self.kept.update(TimeSource::Trusted, time);
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
        self.bounded += step;
        assert!(self.bounded <= Clock::MAX_BOUNDED_STEP);
    }

    fn sends(&mut self, before: Timestamp, used: &mut Used) {
        let stamp = self.kept.stamp(&mut self.stamper);
        let reason = stamp.err().map(RejectReason::from);
        assert_ne!(reason, Some(RejectReason::Other));
        let Ok(Stamp { link_id, timestamp }) = stamp else {
            return;
        };
        assert_eq!(link_id, LINK_IDS[0]);
        assert!(timestamp >= before);
        let last = used.given.replace(timestamp);
        assert!(last.is_none_or(|last| timestamp > last), "given twice");
    }

    fn hears(&mut self, before: Timestamp, timestamp: Timestamp, used: &mut Used) {
        let link_id = LINK_IDS[1];
        let frame = signed(&KEY, Stamp { link_id, timestamp });
        let frame = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
        let authentic = authenticate(frame, &*KEY).expect("signed with this key");
        let (sync, last, minute) = (self.kept.sync(), self.receiver.last(), Window::ONE_MINUTE);
        let verdict = self.kept.admit(&mut self.receiver, authentic).map(drop);
        let reason = verdict.err().map(RejectReason::from);
        assert_ne!(reason, Some(RejectReason::Other));
        let after = self.kept.now();
        let off = before.ticks().abs_diff(timestamp.ticks());
        if verdict.is_err() {
            assert_eq!((self.receiver.last(), after), (last, before));
        } else {
            let last = used.accepted.replace(timestamp);
            assert!(last.is_none_or(|last| timestamp > last), "accepted twice");
            let behind = after.ticks().abs_diff(timestamp.ticks());
            match sync {
                SyncState::Synced => assert!(off <= minute.past.max(minute.ahead)),
                SyncState::Unsynced => assert!(behind <= RESERVATION),
            }
        }
        assert_eq!(self.kept.sync(), sync);
        if sync == SyncState::Synced && off > minute.past {
            let rejected = [VerifyError::FromFuture, VerifyError::TooOld];
            assert!(verdict.is_err_and(|error| rejected.contains(&error)));
        }
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
