//! What targets are fed with: typed inputs, made from bytes by `arbitrary`, and back.
//!
//! libFuzzer changes bytes. Every input keeps what must be near something else (a stamp near the
//! clock, a message of the table) in a few bytes, so that a changed byte is still a sensible input.

use std::fmt::Debug;
use std::sync::LazyLock;

use arbitrary::{Arbitrary, Unstructured};
use mavlink_signing::{Header, MessageId, Stamp, Timestamp, Window, dialect};
use mavseal_proofs::history::Step;
use mavseal_proofs::keys::{Event, Side};
use mavseal_proofs::link::Step as LinkStep;
use mavseal_proofs::mark::Cut;
use mavseal_proofs::model::Resumed;
use mavseal_proofs::pipes::Turn;
use mavseal_proofs::tamper::Change;

/// The bytes that `arbitrary` makes a value from: how seeds are written.
pub trait Encode {
    /// Appends them to `bytes`.
    fn encode(&self, bytes: &mut Vec<u8>);
}

/// The input in `bytes`; `None` if there are too few of them.
#[must_use]
pub fn decode<'a, T: Arbitrary<'a>>(bytes: &'a [u8]) -> Option<T> {
    T::arbitrary_take_rest(Unstructured::new(bytes)).ok()
}

/// A part of an input, from the front of its bytes: as `arbitrary` reads it, without the price of its
/// guard against recursion, which a target that is run a million times a second feels.
pub trait Take<'input>: Sized {
    /// The part; what was read is taken off.
    ///
    /// # Errors
    ///
    /// There are too few bytes.
    fn take(bytes: &mut Unstructured<'input>) -> arbitrary::Result<Self>;
}

/// What `input!` defines.
pub trait Input: Encode + Debug {
    /// How the input in `bytes` shows itself.
    fn shown(bytes: &[u8]) -> Option<String>;

    /// The file that this input is read from.
    ///
    /// # Panics
    ///
    /// If it is read as something else.
    fn file(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.encode(&mut bytes);
        assert_eq!(Self::shown(&bytes), Some(format!("{self:?}")));
        bytes
    }
}

/// Reads and writes a value as `arbitrary` does numbers: least significant byte first.
macro_rules! numbers {
    ($($number:ty),*) => {$(
        impl<'input> Take<'input> for $number {
            fn take(bytes: &mut Unstructured<'input>) -> arbitrary::Result<Self> {
                let taken = bytes.bytes(size_of::<Self>())?;
                Ok(Self::from_le_bytes(taken.try_into().expect("as many")))
            }
        }

        impl Encode for $number {
            fn encode(&self, bytes: &mut Vec<u8>) {
                bytes.extend(self.to_le_bytes());
            }
        }
    )*};
}
numbers!(i8, u8, i16, u16, i64);

impl<'input> Take<'input> for bool {
    fn take(bytes: &mut Unstructured<'input>) -> arbitrary::Result<Self> {
        Ok(u8::take(bytes)? & 1 == 1)
    }
}

impl Encode for bool {
    fn encode(&self, bytes: &mut Vec<u8>) {
        bytes.push((*self).into());
    }
}

impl<'input, T: Take<'input> + Copy + Default, const N: usize> Take<'input> for [T; N] {
    fn take(bytes: &mut Unstructured<'input>) -> arbitrary::Result<Self> {
        let mut items = [T::default(); N];
        for item in &mut items {
            *item = T::take(bytes)?;
        }
        Ok(items)
    }
}

impl<T: Encode, const N: usize> Encode for [T; N] {
    fn encode(&self, bytes: &mut Vec<u8>) {
        self.iter().for_each(|item| item.encode(bytes));
    }
}

impl<'input, T: Arbitrary<'input>> Take<'input> for Vec<T> {
    fn take(bytes: &mut Unstructured<'input>) -> arbitrary::Result<Self> {
        Self::arbitrary(bytes)
    }
}

/// Each item after a byte that says that there is one.
impl<T: Encode> Encode for Vec<T> {
    fn encode(&self, bytes: &mut Vec<u8>) {
        for item in self {
            true.encode(bytes);
            item.encode(bytes);
        }
        false.encode(bytes);
    }
}

/// Only as the last field: all the rest.
impl<'input: 'a, 'a> Take<'input> for &'a [u8] {
    fn take(bytes: &mut Unstructured<'input>) -> arbitrary::Result<Self> {
        bytes.bytes(bytes.len())
    }
}

/// Only as the last field: all the rest.
impl Encode for &[u8] {
    fn encode(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(self);
    }
}

/// Which of `count` variants of an enumeration follows, as what `arbitrary` derives reads it.
fn encode_variant(number: u64, count: u64, bytes: &mut Vec<u8>) {
    let first = (number << 32).div_ceil(count);
    bytes.extend(&first.to_le_bytes()[..4]);
}

/// Writes an enumeration of `mavseal-proofs`, its variants in the order of its definition.
macro_rules! encode_variants {
    ($kind:ident, $count:literal: $($number:literal $variant:ident { $($field:ident),* })*) => {
        impl Encode for $kind {
            fn encode(&self, bytes: &mut Vec<u8>) {
                match self {
                    $(Self::$variant { $($field),* } => {
                        encode_variant($number, $count, bytes);
                        $($field.encode(bytes);)*
                    })*
                }
            }
        }
    };
}
encode_variants!(Change, 3:
    0 Flip { at, bits }
    1 Insert { at, byte }
    2 Remove { at }
);
encode_variants!(Step, 5:
    0 Sign { payload_length }
    1 Deliver { back }
    2 Damage { back, bit }
    3 SenderClock { ticks }
    4 ReceiverClock { ticks }
);

encode_variants!(LinkStep, 5:
    0 Send { from }
    1 Deliver { back }
    2 Damage { back, bit }
    3 Noise { byte }
    4 Restart { end, ahead }
);

impl Encode for Side {
    fn encode(&self, bytes: &mut Vec<u8>) {
        encode_variant(u64::from(*self == Self::Responder), 2, bytes);
    }
}

/// Its variants in the order of its definition.
impl Encode for Event {
    fn encode(&self, bytes: &mut Vec<u8>) {
        let mut variant = |number| encode_variant(number, 9, bytes);
        match self {
            Self::Offer => variant(0),
            Self::Setup(back) => {
                variant(1);
                back.encode(bytes);
            }
            Self::Send(side) => {
                variant(2);
                side.encode(bytes);
            }
            Self::Hear(side, back) => {
                variant(3);
                side.encode(bytes);
                back.encode(bytes);
            }
            Self::Confirm(side) => {
                variant(4);
                side.encode(bytes);
            }
            Self::Retire(side) => {
                variant(5);
                side.encode(bytes);
            }
            Self::Withdraw => variant(6),
            Self::Restart(side) => {
                variant(7);
                side.encode(bytes);
            }
            Self::Fail(side, trace) => {
                variant(8);
                side.encode(bytes);
                trace.encode(bytes);
            }
        }
    }
}

impl Encode for Cut {
    fn encode(&self, bytes: &mut Vec<u8>) {
        self.after.encode(bytes);
        self.left.encode(bytes);
    }
}

impl Encode for Turn {
    fn encode(&self, bytes: &mut Vec<u8>) {
        self.arrive.encode(bytes);
        self.room.encode(bytes);
    }
}

/// Defines an input whose fields are written in the order in which they are read.
macro_rules! input {
    (
        $(#[$about:meta])*
        pub struct $name:ident $(<$life:lifetime>)? {
            $($(#[$doc:meta])* pub $field:ident: $kind:ty,)*
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Debug)]
        pub struct $name $(<$life>)? {
            $($(#[$doc])* pub $field: $kind,)*
        }

        impl<'input $(: $life, $life)?> $crate::input::Take<'input> for $name $(<$life>)? {
            fn take(bytes: &mut arbitrary::Unstructured<'input>) -> arbitrary::Result<Self> {
                Ok(Self { $($field: $crate::input::Take::take(bytes)?,)* })
            }
        }

        impl<'input $(: $life, $life)?> arbitrary::Arbitrary<'input> for $name $(<$life>)? {
            fn arbitrary(bytes: &mut arbitrary::Unstructured<'input>) -> arbitrary::Result<Self> {
                $crate::input::Take::take(bytes)
            }
        }

        impl $(<$life>)? $crate::input::Encode for $name $(<$life>)? {
            fn encode(&self, bytes: &mut Vec<u8>) {
                $($crate::input::Encode::encode(&self.$field, bytes);)*
            }
        }

        impl $(<$life>)? $crate::input::Input for $name $(<$life>)? {
            fn shown(bytes: &[u8]) -> Option<String> {
                $crate::input::decode::<$name>(bytes).map(|input| format!("{input:?}"))
            }
        }
    };
}
pub(crate) use input;

/// A moment in 2026, in ticks.
pub const NOW: u64 = 37_555_200_000_000;

input! {
    /// A moment: two of one era are so close that every verdict on time is likely.
    #[derive(Copy, Default)]
    pub struct Moment {
        /// 0 the beginning of time, 1 the year 2026, 2 the end of time, 3 anywhere; modulo 4.
        pub era: u8,
        /// Ticks from the beginning, around noon of a day, or before the end; 2^32 of them anywhere.
        pub offset: u16,
    }
}

impl Moment {
    /// `offset` ticks after a moment in 2026.
    #[must_use]
    pub const fn after_now(offset: i16) -> Self {
        Self {
            era: 1,
            offset: offset.wrapping_sub(i16::MIN) as u16,
        }
    }

    /// `ticks` before the last one of all.
    #[must_use]
    pub const fn before_the_end(ticks: u16) -> Self {
        Self {
            era: 2,
            offset: ticks,
        }
    }

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

input! {
    /// A stamp.
    #[derive(Copy, Default)]
    pub struct Stamped {
        /// The link.
        pub link_id: u8,
        /// The moment.
        pub moment: Moment,
    }
}

impl From<Stamped> for Stamp {
    fn from(Stamped { link_id, moment }: Stamped) -> Self {
        let timestamp = moment.timestamp();
        Self { link_id, timestamp }
    }
}

input! {
    /// A receiver in the state that it was resumed in.
    #[derive(Copy, Default)]
    pub struct Receiver {
        /// Its link.
        pub link_id: u8,
        /// Its window in ticks; the largest number stands for all time.
        pub past: u16,
        /// As `past`.
        pub ahead: u16,
        /// Its mark.
        pub first: Moment,
    }
}

impl From<Receiver> for Resumed {
    fn from(receiver: Receiver) -> Self {
        let ticks = |ticks| match ticks {
            u16::MAX => u64::MAX,
            ticks => ticks.into(),
        };
        Self {
            link_id: receiver.link_id,
            window: Window {
                past: ticks(receiver.past),
                ahead: ticks(receiver.ahead),
            },
            first: receiver.first.timestamp(),
        }
    }
}

/// Every message of the dialect.
pub static MESSAGES: LazyLock<Vec<MessageId>> =
    LazyLock::new(|| dialect::messages().map(|(id, _)| id).collect());

input! {
    /// A message: of the table, or any at all.
    #[derive(Copy, Default)]
    pub struct Message {
        /// A row of the table in 16 bits; with the highest of all bits set, the id in the other 23.
        pub id: [u8; 3],
    }
}

impl Message {
    /// The message with this id, in the table.
    ///
    /// # Panics
    ///
    /// If there is none.
    #[must_use]
    pub fn known(id: u32) -> Self {
        let row = MESSAGES.iter().position(|known| known.get() == id);
        let [low, high, ..] = row.expect("in the table").to_le_bytes();
        Self { id: [low, high, 0] }
    }

    /// The message with this id of up to 23 bits, in the table or not.
    #[must_use]
    pub const fn any(id: u32) -> Self {
        let [low, high, highest, _] = id.to_le_bytes();
        Self {
            id: [low, high, highest | 0x80],
        }
    }

    /// Its id.
    #[must_use]
    pub fn id(self) -> MessageId {
        let [low, high, highest] = self.id;
        if highest & 0x80 == 0 {
            let row = usize::from(u16::from_le_bytes([low, high]));
            MESSAGES[row % MESSAGES.len()]
        } else {
            MessageId::from_le_bytes([low, high, highest & 0x7F])
        }
    }
}

input! {
    /// A header.
    #[derive(Copy, Default)]
    pub struct Head {
        /// Compatibility flags, sequence number, system id, component id.
        pub fields: [u8; 4],
        /// The message.
        pub message: Message,
    }
}

impl From<Head> for Header {
    fn from(head: Head) -> Self {
        let [compat_flags, sequence, system_id, component_id] = head.fields;
        Self {
            compat_flags,
            sequence,
            system_id,
            component_id,
            message_id: head.message.id(),
        }
    }
}
