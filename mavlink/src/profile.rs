//! How a tag is computed: the profile that both ends of a link must share.

use core::marker::PhantomData;
use core::mem;

use hmac::block_api::HmacCore;
use hmac::digest::array::{Array, ArraySize};
use hmac::digest::block_api::{Buffer, FixedOutputCore, UpdateCore};
use hmac::digest::block_buffer::{BlockSizes, EagerBuffer};
use hmac::digest::{Output, common::Key};
use hmac::{EagerHash, KeyInit};
use sha2::Sha256;
use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing, optimization_barrier};

use crate::field::{KEY_SIZE, TAG_SIZE};
use crate::frame::Tag;

/// A way to compute tags from a 32-byte key.
///
/// A value holds whatever the profile prepares once from the key, and must not show it. It wipes
/// itself when dropped, which [`ZeroizeOnDrop`] promises.
pub trait Profile: ZeroizeOnDrop {
    /// Prepares `key` for use.
    fn new(key: &[u8; KEY_SIZE]) -> Self;

    /// The 6-byte tag over `covered`, which is a frame from the magic byte to the timestamp.
    fn tag(&self, covered: &[u8]) -> Tag;
}

/// HMAC-SHA256 (RFC 2104) cut to its first 48 bits: mavseal's own profile.
///
/// **Not** the signature of the MAVLink standard: ArduPilot, PX4, QGroundControl, MAVProxy and
/// pymavlink use the plain SHA-256 of key and frame. The two do not understand each other.
///
/// The two compressions that absorb the key are done once for each key. A tag of a frame with up to 36
/// bytes of payload then costs two, each further 64 bytes one more. `H` is the hash: a part with a hash
/// unit can use its own.
pub struct Hmac<H: EagerHash = Sha256>
where
    H::Core: ZeroizeOnDrop,
{
    keyed: HmacCore<H>,
}

// `keyed` is two states of the hash's core, which wipe themselves.
impl<H: EagerHash> ZeroizeOnDrop for Hmac<H> where H::Core: ZeroizeOnDrop {}

impl<H: EagerHash> Profile for Hmac<H>
where
    H::Core: ZeroizeOnDrop,
{
    fn new(key: &[u8; KEY_SIZE]) -> Self {
        // RFC 2104 fills a short key with zeros to the hash's block. Doing it here leaves no length that
        // could be wrong.
        let mut block = Key::<HmacCore<H>>::default();
        for (slot, byte) in block.iter_mut().zip(key) {
            *slot = *byte;
        }
        let keyed = HmacCore::new(&block);
        block.as_mut_slice().zeroize();
        Self { keyed }
    }

    fn tag(&self, covered: &[u8]) -> Tag {
        // Block by block rather than by `Mac`. Its `finalize` takes and wipes a copy of states and buffer:
        // 150 bytes of a stack that may be small.
        let mut keyed = self.keyed.clone();
        let mut buffer = Buffer::<HmacCore<H>>::default();
        buffer.digest_blocks(covered, |blocks| keyed.update_blocks(blocks));
        let mut whole = Output::<HmacCore<H>>::default();
        keyed.finalize_fixed_core(&mut buffer, &mut whole);
        wipe(&mut buffer);
        mem::forget(buffer);
        cut(&mut whole)
    }
}

/// SHA-256 of key and frame, cut to its first 48 bits: the signature of the MAVLink standard.
///
/// What ArduPilot, PX4, QGroundControl, MAVProxy and pymavlink speak (MAVLink guide, "Message
/// Signing", Signature). [`Hmac`] does not understand it, nor it [`Hmac`].
///
/// A tag of a frame with up to 4 bytes of payload costs one compression, each further 64 bytes one more.
/// Whole digests with a secret prefix would give away the tags of longer frames. This does not, as only 48
/// of the digest's 256 bits are sent.
pub struct Standard<H: EagerHash = Sha256>
where
    H::Core: ZeroizeOnDrop,
{
    key: Zeroizing<[u8; KEY_SIZE]>,
    hash: PhantomData<H>,
}

// `key` wipes itself, and so does the hash's core, which takes it in.
impl<H: EagerHash> ZeroizeOnDrop for Standard<H> where H::Core: ZeroizeOnDrop {}

impl<H: EagerHash> Profile for Standard<H>
where
    H::Core: ZeroizeOnDrop,
{
    fn new(key: &[u8; KEY_SIZE]) -> Self {
        Self {
            key: Zeroizing::new(*key),
            hash: PhantomData,
        }
    }

    fn tag(&self, covered: &[u8]) -> Tag {
        let mut hash = H::Core::default();
        let mut buffer = Buffer::<H::Core>::default();
        buffer.digest_blocks(self.key.as_slice(), |blocks| hash.update_blocks(blocks));
        buffer.digest_blocks(covered, |blocks| hash.update_blocks(blocks));
        let mut whole = Output::<H::Core>::default();
        hash.finalize_fixed_core(&mut buffer, &mut whole);
        wipe(&mut buffer);
        mem::forget(buffer);
        cut(&mut whole)
    }
}

/// Wipes by words. The type's own `Drop` wipes bytewise and takes 20 % of a short tag, so call
/// `mem::forget` afterwards.
fn wipe<BlockSize: BlockSizes>(buffer: &mut EagerBuffer<BlockSize>) {
    buffer.set(Array::default(), 0);
    optimization_barrier(buffer);
}

/// The first 48 bits of a digest, which is wiped. The whole one would give away tags of longer frames.
fn cut<Size: ArraySize>(digest: &mut Array<u8, Size>) -> Tag {
    let mut tag = [0; TAG_SIZE];
    for (slot, byte) in tag.iter_mut().zip(digest.iter()) {
        *slot = *byte;
    }
    *digest = Array::default();
    optimization_barrier(digest);
    tag
}
