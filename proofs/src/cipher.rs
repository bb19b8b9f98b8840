//! A stand-in for AES-GCM that tells what it was asked about.

use mavlink_commsec::field::{HEADER_SIZE, KEY_SIZE, SALT_SIZE};
use mavlink_commsec::{
    Cipher, CipherError, EpochCounter, EpochHeader, EpochSenderId, HeaderFormat, Nonce, OpenError,
    PackageHeader, PackageTag, Plaintext, SenderId, ZeroizeOnDrop,
};

/// What a [`Told`] cipher says of tags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// All are right.
    Right,
    /// All are wrong, and what they are about has been decrypted by then.
    Wrong,
    /// The hardware fails.
    Fails,
}

/// A cipher whose output is its input with every bit turned over, and nonce and tag mixed in. The output
/// tells what was asked. Its verdict is chosen with the key.
///
/// It decrypts before it looks at the tag, as an implementation may. With any verdict it is any cipher
/// as far as acceptance goes: it over-approximates. It keeps nothing secret.
#[derive(Debug)]
pub struct Told(Verdict);

impl Told {
    /// The key of a cipher with this verdict.
    #[must_use]
    pub const fn key(verdict: Verdict) -> [u8; KEY_SIZE] {
        let mut key = [1; KEY_SIZE];
        key[0] = verdict as u8;
        key
    }

    /// The byte at `index` of what comes out of `message`, either way.
    #[must_use]
    pub fn byte(nonce: &Nonce, message: &Plaintext, tag: &PackageTag, index: usize) -> u8 {
        let mixed = match index {
            0..12 => nonce[index],
            12..20 => tag[index - 12],
            _ => 0,
        };
        !message[index] ^ mixed
    }

    fn turn(nonce: &Nonce, message: &mut Plaintext, tag: &PackageTag) {
        let before = *message;
        for (index, byte) in message.iter_mut().enumerate() {
            *byte = Self::byte(nonce, &before, tag, index);
        }
    }

    /// The tag that it gives to everything under `nonce`.
    #[must_use]
    pub fn tag(nonce: &Nonce) -> PackageTag {
        let [.., a, b, c, d, e, f, g, h] = *nonce;
        [h, g, f, e, d, c, b, a]
    }
}

impl ZeroizeOnDrop for Told {}

impl Cipher for Told {
    fn new(key: &[u8; KEY_SIZE]) -> Self {
        Self(match key[0] {
            0 => Verdict::Right,
            1 => Verdict::Wrong,
            _ => Verdict::Fails,
        })
    }

    fn seal(&self, nonce: &Nonce, message: &mut Plaintext) -> Result<PackageTag, CipherError> {
        let tag = Self::tag(nonce);
        Self::turn(nonce, message, &tag);
        match self.0 {
            Verdict::Fails => Err(CipherError),
            _ => Ok(tag),
        }
    }

    fn open(
        &self,
        nonce: &Nonce,
        message: &mut Plaintext,
        tag: &PackageTag,
    ) -> Result<(), CipherError> {
        Self::turn(nonce, message, tag);
        match self.0 {
            Verdict::Right => Ok(()),
            _ => Err(CipherError),
        }
    }
}

/// A header by the definition, apart from the core's: which number lies where.
pub trait Specified: HeaderFormat {
    /// The id with the low bits of `number` that the header has room for.
    fn id(number: u32) -> Self::Id;

    /// The place with this counter, and with this epoch where there are any.
    fn place_of(epoch: u16, counter: u32) -> Self::Sequence;

    /// What 8 bytes on the wire say.
    fn read(wire: [u8; HEADER_SIZE]) -> (Self::Id, Self::Sequence);

    /// The 8 bytes on the wire.
    fn write(id: Self::Id, sequence: Self::Sequence) -> [u8; HEADER_SIZE];

    /// Whether no sender uses `sequence`, since nothing would be after it.
    fn never_used(sequence: Self::Sequence) -> bool;

    /// Whether `sequence` is after `last`.
    fn is_newer(sequence: Self::Sequence, last: Self::Sequence) -> bool;

    /// That `sequence` was accepted before or is too old, where `newest` was accepted.
    fn stale_error(sequence: Self::Sequence, newest: Self::Sequence) -> OpenError;

    /// How many counters `high` is above `low`, if it is by 1 to 2^32 - 1 in one epoch.
    fn above(low: Self::Sequence, high: Self::Sequence) -> Option<u64>;

    /// How many counters are passed over from `last` to `sequence`, each new epoch counted as 65,536.
    fn jump(last: Self::Sequence, sequence: Self::Sequence) -> u64;
}

impl Specified for PackageHeader {
    fn id(number: u32) -> SenderId {
        SenderId(number)
    }

    fn place_of(_: u16, counter: u32) -> u32 {
        counter
    }

    fn read([a, b, c, d, e, f, g, h]: [u8; HEADER_SIZE]) -> (SenderId, u32) {
        let id = u32::from_be_bytes([a, b, c, d]);
        (SenderId(id), u32::from_be_bytes([e, f, g, h]))
    }

    fn write(id: SenderId, counter: u32) -> [u8; HEADER_SIZE] {
        (u64::from(id.0) << 32 | u64::from(counter)).to_be_bytes()
    }

    fn never_used(counter: u32) -> bool {
        counter == 0xFFFF_FFFF
    }

    fn is_newer(counter: u32, last: u32) -> bool {
        counter > last
    }

    fn stale_error(counter: u32, last: u32) -> OpenError {
        OpenError::Stale { counter, last }
    }

    fn above(low: u32, high: u32) -> Option<u64> {
        (high > low).then(|| u64::from(high - low))
    }

    fn jump(last: u32, counter: u32) -> u64 {
        Self::above(last, counter).map_or(0, |above| above - 1)
    }
}

impl Specified for EpochHeader {
    fn id(number: u32) -> EpochSenderId {
        EpochSenderId(number as u16)
    }

    fn place_of(epoch: u16, counter: u32) -> EpochCounter {
        EpochCounter { epoch, counter }
    }

    fn read([a, b, c, d, e, f, g, h]: [u8; HEADER_SIZE]) -> (EpochSenderId, EpochCounter) {
        let counter = u32::from_be_bytes([a, b, c, d]);
        let epoch = u16::from_be_bytes([e, f]);
        let id = u16::from_be_bytes([g, h]);
        (EpochSenderId(id), EpochCounter { epoch, counter })
    }

    fn write(id: EpochSenderId, sequence: EpochCounter) -> [u8; HEADER_SIZE] {
        let counter = u64::from(sequence.counter) << 32;
        let epoch = u64::from(sequence.epoch) << 16;
        (counter | epoch | u64::from(id.0)).to_be_bytes()
    }

    fn never_used(EpochCounter { epoch, counter }: EpochCounter) -> bool {
        epoch == 0xFFFF || counter == 0xFFFF_FFFF
    }

    fn is_newer(sequence: EpochCounter, last: EpochCounter) -> bool {
        sequence.epoch > last.epoch
            || (sequence.epoch == last.epoch && sequence.counter > last.counter)
    }

    fn stale_error(sequence: EpochCounter, last: EpochCounter) -> OpenError {
        OpenError::StaleInEpoch { sequence, last }
    }

    fn above(low: EpochCounter, high: EpochCounter) -> Option<u64> {
        let above = low.epoch == high.epoch && high.counter > low.counter;
        above.then(|| u64::from(high.counter - low.counter))
    }

    fn jump(last: EpochCounter, sequence: EpochCounter) -> u64 {
        if sequence.epoch > last.epoch {
            let epochs = u64::from(sequence.epoch - last.epoch);
            epochs * 65_536 + u64::from(sequence.counter.max(1) - 1)
        } else {
            Self::above(last, sequence).map_or(0, |above| above - 1)
        }
    }
}

/// The nonce of a package, by the definition: the salt, then the header as it is sent.
#[must_use]
pub fn nonce_of<H: Specified>(salt: u32, id: H::Id, sequence: H::Sequence) -> Nonce {
    let mut nonce = [0; SALT_SIZE + HEADER_SIZE];
    nonce[..4].copy_from_slice(&salt.to_be_bytes());
    nonce[4..].copy_from_slice(&H::write(id, sequence));
    nonce
}
