//! Stand-ins for the two costly functions, so that a proof can range over every frame.

use core::cell::Cell;

use mavlink_signing::{
    Header, KEY_SIZE, MessageId, Profile, ReplayGuard, Tag, Timestamp, Window, ZeroizeOnDrop,
};

/// The header of a HEARTBEAT, which every dialect has; no two fields alike.
pub(crate) const HEARTBEAT: Header = Header {
    compat_flags: 2,
    sequence: 3,
    system_id: 4,
    component_id: 5,
    message_id: MessageId::from_le_bytes([0, 0, 0]),
};

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
            first: any_timestamp(),
        }
    }
}

/// A profile whose tag is the first 6 bytes of the key, whatever is covered.
///
/// For a key of any value that is any tag at all, among them the one that a real hash would give. It
/// over-approximates every profile. It says nothing about which bytes are covered.
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

/// The checksum that the harnesses see.
#[cfg(kani)]
pub(crate) use oracle::{any_checksum, checksum_calls};

/// Stands for [`mavlink_signing::crc::checksum`]: equal results for equal questions, and any for others.
#[cfg(kani)]
mod oracle {
    use core::sync::atomic::{AtomicU16, AtomicUsize, Ordering::Relaxed};

    /// The place whose byte tells one question from another; any, and the same for all questions of a run.
    static PLACE: AtomicUsize = AtomicUsize::new(0);
    static CALLS: AtomicUsize = AtomicUsize::new(0);
    /// The questions that were asked; 0 is none.
    static FIRST: AtomicUsize = AtomicUsize::new(0);
    static SECOND: AtomicUsize = AtomicUsize::new(0);
    /// What was answered.
    static ANSWERS: [AtomicU16; 2] = [AtomicU16::new(0), AtomicU16::new(0)];

    /// A question is told by its length, its CRC_EXTRA and the byte at a place that may be any. Two
    /// different ones differ there for some place, and their answers are then free of each other. So of
    /// two questions, the checksum is any function at all. A third is not taken.
    pub(crate) fn any_checksum(covered: &[u8], crc_extra: u8) -> u16 {
        if CALLS.load(Relaxed) == 0 {
            PLACE.store(kani::any(), Relaxed);
        }
        CALLS.store(CALLS.load(Relaxed) + 1, Relaxed);
        let byte = covered.get(PLACE.load(Relaxed)).copied().unwrap_or(0);
        let question =
            covered.len() << 17 | usize::from(crc_extra) << 9 | usize::from(byte) << 1 | 1;
        answer_of(&FIRST, question, 0)
            .or_else(|| answer_of(&SECOND, question, 1))
            .expect("at most two questions")
    }

    /// The answer, if `slot` is free or holds this question.
    fn answer_of(slot: &AtomicUsize, question: usize, index: usize) -> Option<u16> {
        match slot.load(Relaxed) {
            0 => {
                slot.store(question, Relaxed);
                ANSWERS[index].store(kani::any(), Relaxed);
            }
            held if held == question => {}
            _ => return None,
        }
        Some(ANSWERS[index].load(Relaxed))
    }

    /// How often it was asked.
    pub(crate) fn checksum_calls() -> usize {
        CALLS.load(Relaxed)
    }
}

/// The first bytes of `all`, any number of them. As good as any slice where the bytes are any bytes,
/// and easier to reason about: it begins at a place that is known.
#[cfg(kani)]
pub(crate) fn any_prefix(all: &[u8]) -> &[u8] {
    let length = kani::any();
    kani::assume(length <= all.len());
    &all[..length]
}

/// Any timestamp there is.
#[cfg(kani)]
pub(crate) fn any_timestamp() -> Timestamp {
    Timestamp::from_wire(kani::any())
}

/// Either place for a key.
#[cfg(kani)]
pub(crate) fn any_slot() -> mavlink_signing::KeySlot {
    if kani::any() {
        mavlink_signing::KeySlot::A
    } else {
        mavlink_signing::KeySlot::B
    }
}

/// Any link and any timestamp.
#[cfg(kani)]
pub(crate) fn any_stamp() -> mavlink_signing::Stamp {
    mavlink_signing::Stamp {
        link_id: kani::any(),
        timestamp: any_timestamp(),
    }
}

/// Any key but one of zeros, of the profile whose tag is its beginning.
#[cfg(kani)]
pub(crate) fn any_key() -> mavlink_signing::SigningKey<AnyTag> {
    let mut secret: [u8; KEY_SIZE] = kani::any();
    secret[31] = 1;
    mavlink_signing::SigningKey::new(&secret).expect("not zeros")
}

/// One harness for each payload length, with a bound on its loops: what is copied has then a length
/// that the solver knows, or nearly.
#[cfg(kani)]
macro_rules! for_payload_lengths {
    ($check:ident: $($name:ident $length:literal unwind $unwind:literal,)*) => {
        $(
            #[kani::proof]
            #[kani::unwind($unwind)]
            #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
            fn $name() {
                $check::<$length>();
            }
        )*
    };
}
#[cfg(kani)]
pub(crate) use for_payload_lengths;
