//! What a signature costs: SHA-256 compressions, counted.

use std::cell::Cell;

use crate::common::*;
use hmac::digest::block_api::{
    Block, BlockSizeUser, Buffer, BufferKindUser, Eager, FixedOutputCore, OutputSizeUser,
    UpdateCore,
};
use hmac::digest::typenum::{U32, U64};
use hmac::digest::{HashMarker, Output};
use mavlink_signing::{FrameRef, Hmac, SigningKey, Stamp, authenticate, sign_frame};
use sha2::block_api::compress256;

thread_local!(static COMPRESSIONS: Cell<u32> = const { Cell::new(0) });

/// SHA-256 that counts: every block goes through sha2's own compression function.
#[derive(Clone)]
struct CountingCore {
    state: [u32; 8],
    blocks: u64,
}

impl CountingCore {
    fn compress(&mut self, blocks: &[Block<Self>]) {
        for block in blocks {
            COMPRESSIONS.set(COMPRESSIONS.get() + 1);
            compress256(&mut self.state, &[(*block).into()]);
        }
    }
}

impl Default for CountingCore {
    /// FIPS 180-4, section 5.3.3.
    fn default() -> Self {
        Self {
            state: [
                0x6a09_e667,
                0xbb67_ae85,
                0x3c6e_f372,
                0xa54f_f53a,
                0x510e_527f,
                0x9b05_688c,
                0x1f83_d9ab,
                0x5be0_cd19,
            ],
            blocks: 0,
        }
    }
}

impl HashMarker for CountingCore {}

impl BlockSizeUser for CountingCore {
    type BlockSize = U64;
}

impl BufferKindUser for CountingCore {
    type BufferKind = Eager;
}

impl OutputSizeUser for CountingCore {
    type OutputSize = U32;
}

impl UpdateCore for CountingCore {
    fn update_blocks(&mut self, blocks: &[Block<Self>]) {
        self.blocks += blocks.len() as u64;
        self.compress(blocks);
    }
}

impl FixedOutputCore for CountingCore {
    fn finalize_fixed_core(&mut self, buffer: &mut Buffer<Self>, out: &mut Output<Self>) {
        let bits = 8 * (64 * self.blocks + buffer.get_pos() as u64);
        buffer.len64_padding_be(bits, |block| self.compress(std::slice::from_ref(block)));
        for (bytes, word) in out.chunks_exact_mut(4).zip(self.state) {
            bytes.copy_from_slice(&word.to_be_bytes());
        }
    }
}

hmac::digest::buffer_fixed!(
    struct Counting(CountingCore);
    impl: BaseFixedTraits Default Clone HashMarker;
);

/// Compressions that `work` takes.
fn count<T>(work: impl FnOnce() -> T) -> (T, u32) {
    let before = COMPRESSIONS.get();
    let result = work();
    (result, COMPRESSIONS.get() - before)
}

#[test]
fn a_key_is_absorbed_once_and_a_short_tag_costs_two() {
    let (counting, set_up) = count(|| SigningKey::<Hmac<Counting>>::new(&KEY).expect("a key"));
    assert_eq!(set_up, 2, "the inner and the outer key block");

    let stamp = Stamp {
        link_id: LINK_ID,
        timestamp: at(NOW),
    };
    let mut frame = unsigned(0, &[1, 2, 3]);
    let (signed_frame, sign) = count(|| sign_frame(&mut frame, &counting, stamp));
    signed_frame.expect("signed");
    assert_eq!(frame, signed(&[1, 2, 3], NOW), "the count changes no tag");

    let received = FrameRef::parse(frame.as_bytes()).expect("a frame");
    let (authentic, verify) = count(|| authenticate(received, &counting));
    authentic.expect("authentic");
    assert_eq!(sign + verify, 4);
}

#[test]
fn longer_frames_cost_one_more_for_each_64_bytes() {
    let counting = SigningKey::<Hmac<Counting>>::new(&KEY).expect("a key");
    for length in 0..=255 {
        let frame = signed(&vec![7; length], NOW);
        let received = FrameRef::parse(frame.as_bytes()).expect("a frame");
        let (authentic, verify) = count(|| authenticate(received, &counting));
        authentic.expect("authentic");
        // Header, payload, checksum, link id and timestamp; padding of at least 9 bytes.
        let covered = 10 + length + 2 + 1 + 6;
        assert_eq!(verify as usize, (covered + 9).div_ceil(64) + 1);
    }
}
