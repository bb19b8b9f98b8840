//! S3: the profile `Hmac` is HMAC-SHA256, `Standard` SHA-256 of key and frame, down to the calls of the
//! compression function.

use mavlink_signing::{KEY_SIZE, Tag};

/// FIPS 180-4, section 5.3.3.
const INITIAL: [u32; 8] = [
    0x6a09_e667,
    0xbb67_ae85,
    0x3c6e_f372,
    0xa54f_f53a,
    0x510e_527f,
    0x9b05_688c,
    0x1f83_d9ab,
    0x5be0_cd19,
];

/// One look at one call of the compression function: a byte of its block and a word of the state
/// that it was given.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// The number of the call, from 0.
    pub call: usize,
    /// Which byte of the block, and the byte.
    pub byte: (usize, u8),
    /// Which word of the state, and the word.
    pub word: (usize, u32),
}

/// Calls that a key and a tag over `length` bytes take: two for the key, the message with its
/// padding, one outer.
#[must_use]
pub const fn calls(length: usize) -> usize {
    2 + (length + 9).div_ceil(64) + 1
}

/// S3: what was looked at is what RFC 2104 and FIPS 180-4 say. The key comes first, under ipad and opad.
/// The message follows the inner key block, with padding and length. Its digest follows the outer key
/// block, with padding and length. Each call goes on from the right state. `outputs` are the states that
/// the calls gave, whatever the compression function is.
///
/// # Panics
///
/// If the property does not hold.
pub fn call_is_rfc2104(key: &[u8; KEY_SIZE], message: &[u8], outputs: &[[u32; 8]], look: Look) {
    assert_eq!(outputs.len(), calls(message.len()));
    let outer = outputs.len() - 1;
    let (index, byte) = look.byte;
    let key_byte = if index < KEY_SIZE { key[index] } else { 0 };
    let (state, expected) = match look.call {
        0 => (INITIAL, key_byte ^ 0x36),
        1 => (INITIAL, key_byte ^ 0x5C),
        call if call == outer => {
            let digest = outputs[outer - 1];
            let expected = match index {
                0..32 => digest[index / 4].to_be_bytes()[index % 4],
                _ => padding(index, 32, 64 + 32),
            };
            (outputs[1], expected)
        }
        call => {
            let at = 64 * (call - 2) + index;
            let expected = if at < message.len() {
                message[at]
            } else {
                padding(at, message.len(), 64 + message.len())
            };
            (outputs[if call == 2 { 0 } else { call - 1 }], expected)
        }
    };
    assert_eq!(byte, expected);
    assert_eq!(look.word.1, state[look.word.0]);
}

/// Calls that a tag over `length` bytes takes under the profile Standard: key and message with their
/// padding.
#[must_use]
pub const fn standard_calls(length: usize) -> usize {
    (KEY_SIZE + length + 9).div_ceil(64)
}

/// S3 for the profile Standard: what was looked at is what FIPS 180-4 says of the key and then the
/// message, with padding and length. Each call goes on from the state before. `outputs` as above.
///
/// # Panics
///
/// If the property does not hold.
pub fn call_is_sha256(key: &[u8; KEY_SIZE], message: &[u8], outputs: &[[u32; 8]], look: Look) {
    assert_eq!(outputs.len(), standard_calls(message.len()));
    let (index, byte) = look.byte;
    let at = 64 * look.call + index;
    let hashed = KEY_SIZE + message.len();
    let expected = if at < KEY_SIZE {
        key[at]
    } else if at < hashed {
        message[at - KEY_SIZE]
    } else {
        padding(at, hashed, hashed)
    };
    let state = if look.call == 0 {
        INITIAL
    } else {
        outputs[look.call - 1]
    };
    assert_eq!(byte, expected);
    assert_eq!(look.word.1, state[look.word.0]);
}

/// S3: the tag is the first 6 bytes of the last state, most significant byte of each word first.
///
/// # Panics
///
/// If the property does not hold.
pub fn tag_is_cut(outputs: &[[u32; 8]], tag: Tag) {
    let last = outputs[outputs.len() - 1];
    let [a, b, c, d] = last[0].to_be_bytes();
    let [e, f, ..] = last[1].to_be_bytes();
    assert_eq!(tag, [a, b, c, d, e, f]);
}

/// The byte at `at` of the padding that begins at `start`, of `hashed` bytes in all. The padding is a
/// one bit, zeros, and the number of bits in the last 8 bytes of a block (FIPS 180-4, section 5.1.1).
fn padding(at: usize, start: usize, hashed: usize) -> u8 {
    let end = (start + 9).div_ceil(64) * 64;
    if at == start {
        0x80
    } else if at >= end - 8 {
        (8 * hashed as u64).to_be_bytes()[at - (end - 8)]
    } else {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    use hmac::digest::block_api::{
        Block, BlockSizeUser, Buffer, BufferKindUser, Eager, FixedOutputCore, OutputSizeUser,
        UpdateCore,
    };
    use hmac::digest::typenum::{U32, U64};
    use hmac::digest::{HashMarker, Output};
    use mavlink_signing::{
        Frame, FrameRef, Hmac, Profile, SigningKey, Stamp, Standard, Timestamp, ZeroizeOnDrop,
        authenticate, sign_frame,
    };
    use sha2::block_api::compress256;

    /// State before, block, state after.
    type Call = ([u32; 8], [u8; 64], [u32; 8]);

    thread_local!(static CALLS: RefCell<Vec<Call>> = const { RefCell::new(Vec::new()) });

    /// SHA-256 that remembers every call of sha2's compression function.
    #[derive(Clone)]
    struct RecordingCore {
        state: [u32; 8],
        blocks: u64,
    }

    impl RecordingCore {
        fn compress(&mut self, blocks: &[Block<Self>]) {
            for block in blocks {
                let (before, block) = (self.state, (*block).into());
                compress256(&mut self.state, &[block]);
                CALLS.with_borrow_mut(|calls| calls.push((before, block, self.state)));
            }
        }
    }

    impl Default for RecordingCore {
        fn default() -> Self {
            Self {
                state: INITIAL,
                blocks: 0,
            }
        }
    }

    impl HashMarker for RecordingCore {}

    /// A promise that is not kept: it is a test's, and holds no secret.
    impl ZeroizeOnDrop for RecordingCore {}

    impl BlockSizeUser for RecordingCore {
        type BlockSize = U64;
    }

    impl BufferKindUser for RecordingCore {
        type BufferKind = Eager;
    }

    impl OutputSizeUser for RecordingCore {
        type OutputSize = U32;
    }

    impl UpdateCore for RecordingCore {
        fn update_blocks(&mut self, blocks: &[Block<Self>]) {
            self.blocks += blocks.len() as u64;
            self.compress(blocks);
        }
    }

    impl FixedOutputCore for RecordingCore {
        fn finalize_fixed_core(&mut self, buffer: &mut Buffer<Self>, out: &mut Output<Self>) {
            let bits = 8 * (64 * self.blocks + buffer.get_pos() as u64);
            buffer.len64_padding_be(bits, |block| self.compress(std::slice::from_ref(block)));
            for (bytes, word) in out.chunks_exact_mut(4).zip(self.state) {
                bytes.copy_from_slice(&word.to_be_bytes());
            }
        }
    }

    hmac::digest::buffer_fixed!(
        struct Recording(RecordingCore);
        impl: BaseFixedTraits Default Clone HashMarker;
    );

    impl ZeroizeOnDrop for Recording {}

    type CallCheck = fn(&[u8; KEY_SIZE], &[u8], &[[u32; 8]], Look);

    /// Every length that a frame's tag covers, 19 to 274 bytes, and shorter ones: all block edges.
    #[test]
    fn s3_every_length() {
        every_length::<Hmac<Recording>, Hmac>(call_is_rfc2104);
        every_length::<Standard<Recording>, Standard>(call_is_sha256);
    }

    fn every_length<Recorded: Profile, Real: Profile>(check: CallCheck) {
        let key: [u8; KEY_SIZE] = core::array::from_fn(|i| i as u8 * 7 + 1);
        for length in 0..=274 {
            let message: Vec<u8> = (0..length).map(|i| (i * 5) as u8).collect();
            CALLS.take();
            let tag = Recorded::new(&key).tag(&message);
            assert_eq!(tag, Real::new(&key).tag(&message), "sha2's own core");
            let calls = CALLS.take();
            let outputs: Vec<[u32; 8]> = calls.iter().map(|(_, _, after)| *after).collect();
            tag_is_cut(&outputs, tag);
            for (call, (before, block, _)) in calls.iter().enumerate() {
                for (at, byte) in block.iter().enumerate() {
                    let word = at % 8;
                    let look = Look {
                        call,
                        byte: (at, *byte),
                        word: (word, before[word]),
                    };
                    check(&key, &message, &outputs, look);
                }
            }
        }
    }

    /// The key of Hmac is absorbed once, when it is loaded. A frame of 3 bytes then costs two
    /// compressions to sign and two to verify. With Standard it is one and one. A longer frame costs
    /// what its length says.
    #[test]
    fn s3_compressions() {
        compressions::<Hmac<Recording>>(2, 4, |covered| calls(covered) - 2);
        compressions::<Standard<Recording>>(0, 2, standard_calls);
    }

    fn compressions<P: Profile>(load: usize, short: usize, each: impl Fn(usize) -> usize) {
        let key = SigningKey::<P>::new(&[7; KEY_SIZE]).expect("a key");
        assert_eq!(CALLS.take().len(), load);
        let stamp = Stamp {
            link_id: 1,
            timestamp: Timestamp::ZERO,
        };
        for length in 0..=255 {
            let mut frame = Frame::new(crate::model::HEARTBEAT, &vec![7; length]).expect("a frame");
            sign_frame(&mut frame, &key, stamp).expect("signed");
            let to_sign = CALLS.take().len();
            let received = FrameRef::parse(frame.as_bytes()).expect("a frame");
            authenticate(received, &key).expect("authentic");
            let to_verify = CALLS.take().len();
            assert_eq!(to_sign, each(received.as_bytes().len() - 6));
            assert_eq!(to_verify, to_sign);
            if length == 3 {
                assert_eq!(to_sign + to_verify, short);
            }
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use core::sync::atomic::{AtomicU8, AtomicU32, AtomicUsize, Ordering::Relaxed};
    use mavlink_signing::{Hmac, Profile, Standard};

    /// Most calls that a frame's tag takes.
    const MOST: usize = calls(274);

    static NUMBER: AtomicUsize = AtomicUsize::new(0);
    static STATES: [[AtomicU32; 8]; MOST] = [const { [const { AtomicU32::new(0) }; 8] }; MOST];
    static BLOCKS: [[AtomicU8; 64]; MOST] = [const { [const { AtomicU8::new(0) }; 64] }; MOST];
    static OUTPUTS: [[AtomicU32; 8]; MOST] = [const { [const { AtomicU32::new(0) }; 8] }; MOST];

    /// Stands for sha2's compression function: gives any state at all, and remembers what it was
    /// given and what it gave. An over-approximation.
    #[expect(dead_code, reason = "named in an attribute alone")]
    fn any_compression(state: &mut [u32; 8], blocks: &[[u8; 64]]) {
        for block in blocks {
            let number = NUMBER.load(Relaxed);
            for i in 0..64 {
                BLOCKS[number][i].store(block[i], Relaxed);
            }
            for i in 0..8 {
                STATES[number][i].store(state[i], Relaxed);
                state[i] = kani::any();
                OUTPUTS[number][i].store(state[i], Relaxed);
            }
            NUMBER.store(number + 1, Relaxed);
        }
    }

    /// Stands for what keeps a compiler from leaving out the wiping of a buffer: it is inline assembly
    /// without instructions, which Kani does not read.
    #[expect(dead_code, reason = "named in an attribute alone")]
    const fn no_barrier<T: ?Sized>(_wiped: &T) {}

    /// Every byte of every block and every word of every state, at places that the solver knows.
    fn wiring<P: Profile, const LENGTH: usize>(
        calls: usize,
        check: impl Fn(&[u8; KEY_SIZE], &[u8], &[[u32; 8]], Look),
    ) {
        let key: [u8; KEY_SIZE] = kani::any();
        let message: [u8; LENGTH] = kani::any();
        let tag = P::new(&key).tag(&message);

        assert_eq!(NUMBER.load(Relaxed), calls);
        let mut outputs = [[0; 8]; MOST];
        for call in 0..calls {
            for i in 0..8 {
                outputs[call][i] = OUTPUTS[call][i].load(Relaxed);
            }
        }
        let outputs = &outputs[..calls];
        tag_is_cut(outputs, tag);
        for call in 0..calls {
            for i in 0..64 {
                let look = Look {
                    call,
                    byte: (i, BLOCKS[call][i].load(Relaxed)),
                    word: (i % 8, STATES[call][i % 8].load(Relaxed)),
                };
                check(&key, &message, outputs, look);
            }
        }
        kani::cover!(tag == [0; 6], "a tag");
        kani::cover!(tag == [0xFF; 6], "another");
    }

    macro_rules! for_lengths {
        ($profile:ty, $calls:ident, $check:ident: $($name:ident $length:literal,)*) => {
            $(
                #[kani::proof]
                #[kani::unwind(66)]
                #[kani::stub(sha2::block_api::compress256, any_compression)]
                #[kani::stub(zeroize::optimization_barrier, no_barrier)]
                fn $name() {
                    wiring::<$profile, $length>($calls($length), $check);
                }
            )*
        };
    }

    // A HEARTBEAT; the edge between one inner block and two; the longest frame.
    for_lengths! { Hmac, calls, call_is_rfc2104:
        s3_wiring_28 28,
        s3_wiring_55 55,
        s3_wiring_56 56,
        s3_wiring_274 274,
    }

    // The edge between one block and two; a HEARTBEAT; the longest frame.
    for_lengths! { Standard, standard_calls, call_is_sha256:
        s3_standard_23 23,
        s3_standard_24 24,
        s3_standard_28 28,
        s3_standard_274 274,
    }
}
