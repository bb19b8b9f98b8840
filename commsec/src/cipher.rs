//! The authenticated cipher behind a key: AES-128-GCM with 8-byte tags, or a unit that has it.

use core::fmt;

use aes_gcm::aead::AeadInOut;
use aes_gcm::aes::Aes128;
use aes_gcm::aes::cipher::consts::{U8, U12};
use aes_gcm::{KeyInit, Nonce as GcmNonce, Tag as GcmTag};
use zeroize::ZeroizeOnDrop;

use crate::field::{KEY_SIZE, NONCE_SIZE, PLAINTEXT_SIZE, TAG_SIZE};

/// What a package holds when it is open: 80 bytes, whole MAVLink packets and zeros after them.
pub type Plaintext = [u8; PLAINTEXT_SIZE];

/// What one package alone is sealed with: salt, sender id and counter, 12 bytes.
pub type Nonce = [u8; NONCE_SIZE];

/// The first 8 of the 16 bytes of the cipher's tag.
pub type PackageTag = [u8; TAG_SIZE];

/// The cipher failed: a tag is wrong, or a hardware unit failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CipherError;

impl fmt::Display for CipherError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the cipher rejected")
    }
}

impl core::error::Error for CipherError {}

/// AES-128-GCM with one key, no associated data, and tags cut to 8 bytes.
///
/// A value holds what is prepared once from the key, and must not show it. It wipes itself when dropped,
/// which [`ZeroizeOnDrop`] promises. A part with an AES unit implements this trait.
pub trait Cipher: ZeroizeOnDrop {
    /// Prepares `key` for use.
    fn new(key: &[u8; KEY_SIZE]) -> Self;

    /// Encrypts `message` in place, and returns its tag.
    ///
    /// # Errors
    ///
    /// A hardware unit failed. What is left in `message` must not be sent.
    fn seal(&self, nonce: &Nonce, message: &mut Plaintext) -> Result<PackageTag, CipherError>;

    /// Decrypts `message` in place, if `tag` is its tag: all 8 bytes, compared in constant time.
    ///
    /// # Errors
    ///
    /// The tag is wrong, or a hardware unit failed, which counts as a wrong tag. What is left in `message`
    /// must not be used.
    fn open(
        &self,
        nonce: &Nonce,
        message: &mut Plaintext,
        tag: &PackageTag,
    ) -> Result<(), CipherError>;
}

/// AES-128-GCM (NIST SP 800-38D) in software, with a 96-bit nonce and a 64-bit tag.
///
/// The tag is compared in constant time and before anything is decrypted. Neither AES nor GHASH looks up
/// tables by secrets. Both take constant time where the processor multiplies in constant time.
pub struct AesGcm(aes_gcm::AesGcm<Aes128, U12, U8>);

// The one field wipes itself.
impl ZeroizeOnDrop for AesGcm {}

impl Cipher for AesGcm {
    fn new(key: &[u8; KEY_SIZE]) -> Self {
        Self(KeyInit::new(key.into()))
    }

    fn seal(&self, nonce: &Nonce, message: &mut Plaintext) -> Result<PackageTag, CipherError> {
        let nonce: &GcmNonce<U12> = nonce.into();
        let sealed = self
            .0
            .encrypt_inout_detached(nonce, &[], message.as_mut_slice().into());
        sealed.map(Into::into).map_err(|_| CipherError)
    }

    fn open(
        &self,
        nonce: &Nonce,
        message: &mut Plaintext,
        tag: &PackageTag,
    ) -> Result<(), CipherError> {
        let (nonce, tag): (&GcmNonce<U12>, &GcmTag<U8>) = (nonce.into(), tag.into());
        self.0
            .decrypt_inout_detached(nonce, &[], message.as_mut_slice().into(), tag)
            .map_err(|_| CipherError)
    }
}

/// The compiler checks the promise of [`ZeroizeOnDrop`] for what the cipher is made of.
const _: () = {
    const fn wipes_itself<T: ZeroizeOnDrop>() {}
    wipes_itself::<aes_gcm::AesGcm<Aes128, U12, U8>>();
};

impl fmt::Debug for AesGcm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("AesGcm(redacted)")
    }
}
