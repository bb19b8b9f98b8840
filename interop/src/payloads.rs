//! Payloads of a message: random ones and those at the edges.

use mavlink_signing::{field::MAX_PAYLOAD_SIZE, without_trailing_zeros};
use rand::{Rng, rngs::SmallRng};

use crate::messages::Message;

/// What a payload is, apart from what it says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Zeros only: one byte is left when they are cut.
    Zeros,
    /// 0xFF only: fields at their greatest, or -1, or not a number.
    Ones,
    Random,
    /// Random, its extensions zero: as long as before there were any, or shorter.
    WithoutExtensions,
    /// Random, its second half zero.
    HalfZeros,
    /// Random with zeros at its end that were not cut.
    Uncut,
    /// No byte at all.
    Empty,
    /// 255 bytes: more fields than are known here, from a later definition.
    Longest,
}

impl Kind {
    /// What every sender can say.
    pub(crate) const SENT: [Self; 5] = [
        Self::Zeros,
        Self::Ones,
        Self::Random,
        Self::WithoutExtensions,
        Self::HalfZeros,
    ];
    /// What a receiver must understand.
    pub(crate) const RECEIVED: [Self; 8] = [
        Self::Zeros,
        Self::Ones,
        Self::Random,
        Self::WithoutExtensions,
        Self::HalfZeros,
        Self::Uncut,
        Self::Empty,
        Self::Longest,
    ];

    /// What a receiver is asked about, in the list of differences.
    pub(crate) const fn scenario(self) -> &'static str {
        match self {
            Self::Zeros => "a payload of zeros, cut",
            Self::Ones => "a payload of ones",
            Self::Random => "a random payload",
            Self::WithoutExtensions => "a payload without extensions",
            Self::HalfZeros => "a payload with zeros at its end, cut",
            Self::Uncut => "a payload with zeros at its end, not cut",
            Self::Empty => "an empty payload",
            Self::Longest => "a payload of 255 bytes",
        }
    }

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Zeros => "zeros",
            Self::Ones => "ones",
            Self::Random => "random",
            Self::WithoutExtensions => "without-extensions",
            Self::HalfZeros => "half-zeros",
            Self::Uncut => "uncut",
            Self::Empty => "empty",
            Self::Longest => "longest",
        }
    }

    /// A whole payload of `message`, zeros at its end included.
    pub(crate) fn payload(self, message: &Message, random: &mut SmallRng) -> Vec<u8> {
        let mut payload = vec![0; message.size];
        let said = match self {
            Self::Zeros => 0,
            Self::Ones => {
                payload.fill(0xFF);
                0
            }
            Self::Random => message.size,
            Self::WithoutExtensions => message.base_size,
            Self::HalfZeros | Self::Uncut => message.size / 2,
            Self::Empty => {
                payload.clear();
                0
            }
            Self::Longest => {
                payload.resize(MAX_PAYLOAD_SIZE, 0);
                MAX_PAYLOAD_SIZE
            }
        };
        random.fill_bytes(&mut payload[..said]);
        if let Some(last) = payload[..said].last_mut() {
            // As long as it says it is.
            *last |= 1;
        }
        payload
    }

    /// What of it a sender here puts into a frame.
    pub(crate) fn on_the_wire(self, payload: &[u8]) -> &[u8] {
        match self {
            Self::Uncut | Self::Empty => payload,
            _ => without_trailing_zeros(payload),
        }
    }
}
