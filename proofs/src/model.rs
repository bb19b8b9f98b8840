//! Stand-ins for the two costly functions, so that a proof can range over every frame.

use core::cell::Cell;
use core::sync::atomic::{AtomicU16, AtomicUsize, Ordering};

use mavlink_signing::{KEY_SIZE, Profile, ReplayGuard, Tag, Timestamp, Window, ZeroizeOnDrop};

/// A state that a receiver can be resumed in. Unlike the receiver it can be copied, so that what comes
/// after a step can be compared with what was before.
#[derive(Clone, Copy, Debug)]
pub struct Resumed {
    /// The link that frames must be made for.
    pub link_id: u8,
    /// How far from the clock frames may be stamped.
    pub window: Window,
    /// The first timestamp that is not rejected as a replay.
    pub first: Timestamp,
}

impl Resumed {
    /// The receiver.
    #[must_use]
    pub const fn replay(self) -> ReplayGuard {
        ReplayGuard::resume(self.link_id, self.window, self.first)
    }
}

#[cfg(kani)]
impl Resumed {
    /// Any such state.
    pub(crate) fn any() -> Self {
        Self {
            link_id: kani::any(),
            window: Window {
                past: kani::any(),
                ahead: kani::any(),
            },
            first: crate::replay::any_timestamp(),
        }
    }
}

/// A profile whose tag is the first 6 bytes of the key, whatever is covered.
///
/// For a key of any value that is any tag at all, which includes the one a real hash would give:
/// an over-approximation of every profile. It says nothing about which bytes are covered.
#[derive(Debug)]
pub struct AnyTag(Tag);

impl ZeroizeOnDrop for AnyTag {}

impl Profile for AnyTag {
    fn new(key: &[u8; KEY_SIZE]) -> Self {
        let [a, b, c, d, e, f, ..] = *key;
        Self([a, b, c, d, e, f])
    }

    fn tag(&self, _covered: &[u8]) -> Tag {
        self.0
    }
}

/// A profile whose tag tells what it was asked about: how often, how many bytes, and the byte at an
/// index that the key chooses.
///
/// If tags agree for every index, the bytes under them agree.
#[derive(Debug)]
pub struct Witness {
    index: usize,
    calls: Cell<u8>,
}

impl Witness {
    /// The key that chooses `index`.
    #[must_use]
    pub fn key(index: u16) -> [u8; KEY_SIZE] {
        let mut key = [0xFF; KEY_SIZE];
        [key[0], key[1]] = index.to_le_bytes();
        key
    }

    /// The tag that the first call with `covered` gives.
    #[must_use]
    pub fn first_tag(index: u16, covered: &[u8]) -> Tag {
        Self::new(&Self::key(index)).tag(covered)
    }
}

impl ZeroizeOnDrop for Witness {}

impl Profile for Witness {
    fn new(key: &[u8; KEY_SIZE]) -> Self {
        Self {
            index: u16::from_le_bytes([key[0], key[1]]).into(),
            calls: Cell::new(0),
        }
    }

    fn tag(&self, covered: &[u8]) -> Tag {
        self.calls.set(self.calls.get() + 1);
        let [low, high] = (covered.len() as u16).to_le_bytes();
        let (there, byte) = match covered.get(self.index) {
            Some(byte) => (1, *byte),
            None => (0, 0),
        };
        [self.calls.get(), low, high, there, byte, 0]
    }
}

/// What [`any_checksum`] returns.
static CHECKSUM: AtomicU16 = AtomicU16::new(0);

/// Sets what [`any_checksum`] returns from now on.
pub fn set_checksum(checksum: u16) {
    CHECKSUM.store(checksum, Ordering::Relaxed);
}

/// Stands for [`mavlink_signing::crc::checksum`]: one value, the same at every call.
///
/// For any value that has been set it is any checksum at all, an over-approximation; the code and
/// the property see the same one.
#[must_use]
pub fn any_checksum(_covered: &[u8], _crc_extra: u8) -> u16 {
    CHECKSUM.load(Ordering::Relaxed)
}

/// Calls of [`one_checksum`], and where the bytes of the first began and how many they were.
static CALLS: AtomicUsize = AtomicUsize::new(0);
static START: AtomicUsize = AtomicUsize::new(0);
static LENGTH: AtomicUsize = AtomicUsize::new(0);
static EXTRA: AtomicUsize = AtomicUsize::new(0);

/// Like [`any_checksum`], and asserts that every call of a run is about the same bytes, at the same
/// place, with the same CRC_EXTRA.
///
/// # Panics
///
/// If they are not.
#[must_use]
pub fn one_checksum(covered: &[u8], crc_extra: u8) -> u16 {
    let (start, length) = (covered.as_ptr() as usize, covered.len());
    if checksum_calls() == 0 {
        START.store(start, Ordering::Relaxed);
        LENGTH.store(length, Ordering::Relaxed);
        EXTRA.store(crc_extra.into(), Ordering::Relaxed);
    } else {
        assert_eq!(START.load(Ordering::Relaxed), start);
        assert_eq!(LENGTH.load(Ordering::Relaxed), length);
        assert_eq!(EXTRA.load(Ordering::Relaxed), usize::from(crc_extra));
    }
    CALLS.store(checksum_calls() + 1, Ordering::Relaxed);
    any_checksum(covered, crc_extra)
}

/// How often [`one_checksum`] was called.
#[must_use]
pub fn checksum_calls() -> usize {
    CALLS.load(Ordering::Relaxed)
}

/// The first bytes of `all`, any number of them. As good as any slice where the bytes are any bytes,
/// and easier to reason about: it begins at a place that is known.
#[cfg(kani)]
pub(crate) fn any_prefix(all: &[u8]) -> &[u8] {
    let length = kani::any();
    kani::assume(length <= all.len());
    &all[..length]
}
