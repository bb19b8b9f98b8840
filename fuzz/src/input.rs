//! What targets are fed with: parts of inputs that `arbitrary` makes from bytes.
//!
//! libFuzzer changes bytes. What must be near something else (a stamp near the clock, a message of the
//! table) takes few of them, so that a changed byte is still a sensible input.

use std::sync::LazyLock;

use arbitrary::Arbitrary;
use mavlink_signing::{Header, MessageId, Stamp, Timestamp, Window, dialect};
use mavseal_proofs::model::Resumed;

/// A moment in 2026, in ticks.
pub const NOW: u64 = 37_555_200_000_000;

/// A moment: two of one era are so close that every verdict on time is likely.
#[derive(Arbitrary, Clone, Copy, Debug, Default)]
pub struct Moment {
    /// 0 the beginning of time, 1 the year 2026, 2 the end of time, 3 anywhere; modulo 4.
    pub era: u8,
    /// Ticks from the beginning, around noon of a day, or before the end; 2^32 of them anywhere.
    pub offset: u16,
}

impl Moment {
    /// The moment.
    ///
    /// # Panics
    ///
    /// Never: none of them is beyond 48 bits.
    #[must_use]
    pub fn timestamp(self) -> Timestamp {
        let offset = u64::from(self.offset);
        let ticks = match self.era % 4 {
            0 => offset,
            1 => NOW + offset - 0x8000,
            2 => Timestamp::MAX.ticks() - offset,
            _ => offset << 32,
        };
        Timestamp::from_ticks(ticks).expect("48 bits")
    }
}

/// A stamp: link and moment.
#[derive(Arbitrary, Clone, Copy, Debug, Default)]
pub struct Stamped {
    /// The link.
    pub link_id: u8,
    /// The moment.
    pub moment: Moment,
}

impl From<Stamped> for Stamp {
    fn from(Stamped { link_id, moment }: Stamped) -> Self {
        let timestamp = moment.timestamp();
        Self { link_id, timestamp }
    }
}

/// A receiver in the state that it was resumed in.
#[derive(Arbitrary, Clone, Copy, Debug, Default)]
pub struct Receiver {
    /// Its link.
    pub link_id: u8,
    /// Its window in ticks, past and ahead; the largest number stands for all time.
    pub window: [u16; 2],
    /// Its mark.
    pub first: Moment,
}

impl From<Receiver> for Resumed {
    fn from(receiver: Receiver) -> Self {
        let [past, ahead] = receiver.window.map(|ticks| match ticks {
            u16::MAX => u64::MAX,
            ticks => ticks.into(),
        });
        Self {
            link_id: receiver.link_id,
            window: Window { past, ahead },
            first: receiver.first.timestamp(),
        }
    }
}

/// A message: a row of the table in 16 bits or, with the highest of all bits set, the id in the other 23.
#[derive(Arbitrary, Clone, Copy, Debug, Default)]
pub struct Message([u8; 3]);

impl Message {
    /// Its id.
    #[must_use]
    pub fn id(self) -> MessageId {
        static TABLE: LazyLock<Vec<MessageId>> =
            LazyLock::new(|| dialect::messages().map(|(id, _)| id).collect());
        let [low, high, highest] = self.0;
        if highest & 0x80 == 0 {
            TABLE[usize::from(u16::from_le_bytes([low, high])) % TABLE.len()]
        } else {
            MessageId::from_le_bytes([low, high, highest & 0x7F])
        }
    }
}

/// A header.
#[derive(Arbitrary, Clone, Copy, Debug, Default)]
pub struct Head {
    /// Compatibility flags, sequence number, system id, component id.
    pub fields: [u8; 4],
    /// The message.
    pub message: Message,
}

impl From<Head> for Header {
    fn from(head: Head) -> Self {
        let [compat_flags, sequence, system_id, component_id] = head.fields;
        let message_id = head.message.id();
        Self {
            compat_flags,
            sequence,
            system_id,
            component_id,
            message_id,
        }
    }
}
