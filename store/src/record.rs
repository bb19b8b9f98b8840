//! One record as its bytes: contents, sequence number, and a checksum that knows what the record is for.

#[cfg(not(kani))]
use crc::{CRC_32_ISO_HDLC, Crc, NoTable};

/// Bytes of a record's sequence number, little-endian.
const SEQUENCE_SIZE: usize = 4;
/// Bytes of a record's checksum, little-endian: CRC-32 over binding, contents and sequence number.
const CHECKSUM_SIZE: usize = 4;
/// Bytes of a record after its contents: 8.
pub(crate) const TRAILER_SIZE: usize = SEQUENCE_SIZE + CHECKSUM_SIZE;
/// Most bytes of a record, so that it fits into a buffer on the stack. For proofs, those of a mark, as
/// every loop over it is unwound.
pub(crate) const MAX_RECORD_SIZE: usize = if cfg!(kani) { 16 } else { 128 };
/// What every byte of erased flash reads as.
pub(crate) const ERASED: u8 = 0xFF;

/// Where a record is read to, or written from.
pub(crate) type Buffer = [u8; MAX_RECORD_SIZE];

/// What records are, and which key they belong to. A record of anything else is none.
///
/// It takes no bytes in flash: the checksum of each record covers it. Another kind alone, or another key alone,
/// is always noticed; both at once but for one pair in 2^32.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Binding {
    kind: u8,
    key: [u8; 4],
}

impl Binding {
    /// Records of this `kind`, a number of the caller's, that belong to the key with the fingerprint `key`;
    /// `[0; 4]` if they belong to none. Whoever reads the flash can tell whether a fingerprint fits: it must
    /// not tell the key.
    #[must_use]
    pub const fn new(kind: u8, key: [u8; 4]) -> Self {
        Self { kind, key }
    }
}

/// What one record's place holds.
pub(crate) enum Found<'a> {
    Blank,
    /// A torn write, a word with a bad ECC, half an erase, or a record of something else.
    Garbage,
    /// Its contents and its sequence number.
    Record(&'a [u8], u32),
}

/// CRC-32 without table: 16 bytes are checked every few seconds.
#[cfg(not(kani))]
fn checksum(binding: Binding, covered: &[u8]) -> u32 {
    let crc = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);
    let mut digest = crc.digest();
    digest.update(&[binding.kind]);
    digest.update(&binding.key);
    digest.update(covered);
    digest.finalize()
}

/// For proofs, as Kani 0.67 does not compile the crate `crc`. It depends on every byte and on its place.
#[cfg(kani)]
#[cfg_attr(test, mutants::skip)]
fn checksum(binding: Binding, covered: &[u8]) -> u32 {
    let key = u32::from_le_bytes(binding.key).rotate_left(13) ^ u32::from(binding.kind);
    let sum = covered
        .iter()
        .fold(!0, |sum: u32, byte| sum.rotate_left(5) ^ u32::from(*byte));
    sum ^ key
}

pub(crate) fn copy(to: &mut [u8], from: &[u8]) {
    for (slot, byte) in to.iter_mut().zip(from) {
        *slot = *byte;
    }
}

/// Writes the record of `contents`.
pub(crate) fn emit(record: &mut [u8], binding: Binding, contents: &[u8], sequence: u32) {
    if let Some((covered, sum)) = record.split_last_chunk_mut::<CHECKSUM_SIZE>() {
        if let Some((part, number)) = covered.split_last_chunk_mut::<SEQUENCE_SIZE>() {
            copy(part, contents);
            *number = sequence.to_le_bytes();
        }
        *sum = checksum(binding, covered).to_le_bytes();
    }
}

pub(crate) fn parse(record: &[u8], binding: Binding) -> Found<'_> {
    if record.iter().all(|byte| *byte == ERASED) {
        return Found::Blank;
    }
    if let Some((covered, sum)) = record.split_last_chunk::<CHECKSUM_SIZE>()
        && let Some((contents, sequence)) = covered.split_last_chunk::<SEQUENCE_SIZE>()
        && checksum(binding, covered) == u32::from_le_bytes(*sum)
    {
        return Found::Record(contents, u32::from_le_bytes(*sequence));
    }
    Found::Garbage
}
