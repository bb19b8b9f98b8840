//! Keys with their salts, and who uses them.

use core::fmt;
use core::marker::PhantomData;

use zeroize::Zeroizing;

use crate::cipher::{AesGcm, Cipher, CipherError, Nonce, PackageTag, Plaintext};
use crate::field::{KEY_SIZE, PLAINTEXT_SIZE, SALT_SIZE};
use crate::header::{HeaderFormat, PackageHeader, Sender};
use crate::sender::SenderId;

/// Bytes of a key's [fingerprint](SealingKey::fingerprint).
pub const FINGERPRINT_SIZE: usize = 4;

/// A key and its salt, prepared for use.
///
/// It is a key for packages with the header `H`, and for no others: under one key, the two formats would
/// use nonces twice. Nothing here can see that the same 16 bytes are also made a key of the other format. A
/// key file has one header for all its keys.
///
/// There is no way to read them back, [`Debug`] does not show them, and they are not copied. Their memory
/// is wiped when they are dropped. What their preparation leaves on the stack is not.
pub struct SealingKey<C = AesGcm, H = PackageHeader> {
    cipher: C,
    salt: Zeroizing<[u8; SALT_SIZE]>,
    header: PhantomData<H>,
}

impl<C: Cipher, H: HeaderFormat> SealingKey<C, H> {
    /// The key in `bytes`, which should come from a random generator, and its salt.
    ///
    /// The caller wipes its own copies.
    ///
    /// # Errors
    ///
    /// [`SealingKeyError::WrongLength`] unless there are 16 bytes; [`SealingKeyError::AllZero`] and [`SealingKeyError::Erased`] for
    /// storage that nobody has written a key to.
    pub fn new(bytes: &[u8], salt: u32) -> Result<Self, SealingKeyError> {
        let key: &[u8; KEY_SIZE] = bytes
            .try_into()
            .map_err(|_| SealingKeyError::WrongLength(bytes.len()))?;
        // Looks at every byte, so that time says nothing about where the first other one is.
        if key.iter().fold(0, |all, byte| all | byte) == 0 {
            return Err(SealingKeyError::AllZero);
        }
        if key.iter().fold(0xFF, |all, byte| all & byte) == 0xFF {
            return Err(SealingKeyError::Erased);
        }
        Ok(Self {
            cipher: C::new(key),
            salt: Zeroizing::new(salt.to_be_bytes()),
            header: PhantomData,
        })
    }

    pub(crate) fn seal(
        &self,
        header: H,
        message: &mut Plaintext,
    ) -> Result<PackageTag, CipherError> {
        self.cipher.seal(&self.nonce(header), message)
    }

    pub(crate) fn open(
        &self,
        header: H,
        message: &mut Plaintext,
        tag: &PackageTag,
    ) -> Result<(), CipherError> {
        self.cipher.open(&self.nonce(header), message, tag)
    }

    /// 4 bytes that depend on key, salt and `sender`, for marks in this device's own storage: with them a mark of
    /// another key or sender is told apart. Not a secret in itself, but keep it in the device.
    ///
    /// It is the front of the tag of 80 zeros, sealed under the sequence number that no sender uses: 2^32 - 1, with
    /// epochs the same of epoch 65,535. No nonce is used twice so, as nothing is ever sealed under that one but these
    /// zeros. No package can be made with it, as receivers look at no tag under that number. To whoever has neither
    /// key nor storage the bytes are those of a random function. Two keys have the same ones with one chance in 2^32.
    ///
    /// # Errors
    ///
    /// A hardware unit failed.
    pub fn fingerprint(&self, sender: H::Id) -> Result<[u8; FINGERPRINT_SIZE], CipherError> {
        let mut zeros = Zeroizing::new([0; PLAINTEXT_SIZE]);
        let [a, b, c, d, ..] = self.seal(H::new(sender, H::NEVER_USED), &mut zeros)?;
        Ok([a, b, c, d])
    }

    /// The salt, then the header as it is sent. So the header is under the tag without being
    /// associated data.
    fn nonce(&self, header: H) -> Zeroizing<Nonce> {
        let [a, b, c, d] = *self.salt;
        let [e, f, g, h, i, j, k, l] = header.to_wire();
        Zeroizing::new([a, b, c, d, e, f, g, h, i, j, k, l])
    }
}

impl<C, H> fmt::Debug for SealingKey<C, H> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(redacted)")
    }
}

/// What the key file says of one sender, as a constant of firmware: `mavseal-keys` writes it there.
///
/// The type of the id says which header the packages have.
///
/// [`Debug`] shows the id alone. It lies in the image, so nothing wipes it. Anybody who can read the image
/// has the key.
pub struct Credential<I = SenderId> {
    /// Who seals with the key.
    pub id: I,
    /// The key.
    pub key: [u8; KEY_SIZE],
    /// The part of the nonce that is never sent.
    pub salt: u32,
}

impl<I: Sender> Credential<I> {
    /// The key, prepared for use: once for one [`Sealer`](crate::Sealer) of the whole device, however many
    /// lines it has. Two sealers of one credential would use every nonce twice, and no type can see it.
    ///
    /// # Errors
    ///
    /// [`SealingKeyError::AllZero`], [`SealingKeyError::Erased`].
    pub fn prepare<C: Cipher>(&self) -> Result<SealingKey<C, I::PackageHeader>, SealingKeyError> {
        SealingKey::new(&self.key, self.salt)
    }

    /// Whether two senders seal with one key and salt.
    pub(crate) fn shares_key_with(&self, other: &Self) -> bool {
        self.key == other.key && self.salt == other.salt
    }
}

impl<I: fmt::Debug> fmt::Debug for Credential<I> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Credential")
            .field("id", &self.id)
            .finish_non_exhaustive()
    }
}

/// Why bytes are not a key. The caller is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SealingKeyError {
    /// Not 16 bytes, but this many.
    WrongLength(usize),
    /// All bytes are zero: what memory that was never written reads as.
    AllZero,
    /// All bytes are 0xFF: what erased flash reads as.
    Erased,
}

impl fmt::Display for SealingKeyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WrongLength(length) => {
                write!(f, "a key has {KEY_SIZE} bytes, this one has {length}")
            }
            Self::AllZero => f.write_str("a key of zeros only is no key"),
            Self::Erased => f.write_str("a key of 0xFF only is erased flash"),
        }
    }
}

impl core::error::Error for SealingKeyError {}
