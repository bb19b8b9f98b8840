//! Signs a frame and verifies it, then rejects it damaged, forged and repeated.

use core::hint::black_box;

use mavlink_signing::field::{HEADER_SIZE, MAX_FRAME_SIZE};
use mavlink_signing::{
    Frame, FrameRef, Header, KeyError, MavLinkState, MessageId, ReplayGuard, Stamp, Stamper,
    Timestamp, Verified, VerifyError, Window, sign_frame, verify_frame,
};

use crate::{DEMO_KEY, info};

#[cfg(not(feature = "standard-signature"))]
type SigningKey = mavlink_signing::SigningKey<mavlink_signing::Hmac>;
#[cfg(feature = "standard-signature")]
type SigningKey = mavlink_signing::SigningKey<mavlink_signing::Standard>;

/// What lasts, outside of the stack.
#[repr(C)]
pub struct Memory {
    /// What is on its way, and then in the receiver's memory: 280 bytes, the longest frame. It
    /// comes first, for an emulator.
    wire: [u8; MAX_FRAME_SIZE],
    /// What the sender has prepared.
    sender: Option<Frame>,
    /// The key of both.
    key: Option<SigningKey>,
}

impl Memory {
    /// Nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            wire: [0; MAX_FRAME_SIZE],
            sender: None,
            key: None,
        }
    }
}

impl Default for Memory {
    fn default() -> Self {
        Self::new()
    }
}

const LINK_ID: u8 = 1;
const HEADER: Header = Header {
    compat_flags: 0,
    sequence: 0,
    system_id: 1,
    component_id: 1,
    // HEARTBEAT, which every dialect has.
    message_id: MessageId::from_le_bytes([0, 0, 0]),
};

// Each is read through a black box, so that nothing is computed when the image is built: whoever
// changes these bytes in the image changes what comes out.
static KEY: [u8; 32] = DEMO_KEY;
static PAYLOAD: &[u8] = &[1, 2, 3];
static NOW: u64 = 37_555_200_000_000;

static LINK: MavLinkState = MavLinkState::new(ReplayGuard::new(LINK_ID, Window::STRICT));

/// A step has come out as it must not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Failed;

/// Why received bytes are rejected.
enum Rejected {
    NoFrame,
    Frame(VerifyError),
}

/// The demonstration: a frame is signed and verified, then rejected with a damaged payload, with a
/// forged tag, and when it comes again.
///
/// `send` gets the signed frame.
///
/// # Errors
///
/// [`Failed`] at the first step that comes out otherwise.
pub fn run(memory: &mut Memory, send: impl FnOnce(&[u8])) -> Result<(), Failed> {
    info!("MAVLink signing demo");
    let Memory { wire, sender, key } = memory;
    let key = load(key).map_err(|_| Failed)?;
    let now = Timestamp::from_ticks(*black_box(&NOW)).ok_or(Failed)?;
    let stamp = Stamper::new(LINK_ID).stamp(now).map_err(|_| Failed)?;
    let payload: &&[u8] = black_box(&PAYLOAD);

    let length = sign(wire, sender, payload, key, stamp)?;
    let frame = wire.get_mut(..length).ok_or(Failed)?;
    send(frame);
    info!("Frame signed");

    verify(frame, key, now).map_err(|_| Failed)?;
    info!("Verification passed");

    flip(frame.get_mut(HEADER_SIZE));
    let Err(Rejected::Frame(VerifyError::BadChecksum)) = verify(frame, key, now) else {
        return Err(Failed);
    };
    flip(frame.get_mut(HEADER_SIZE));
    info!("Damaged frame rejected");

    flip(frame.last_mut());
    let Err(Rejected::Frame(VerifyError::BadTag)) = verify(frame, key, now) else {
        return Err(Failed);
    };
    flip(frame.last_mut());
    info!("Forged frame rejected");

    let Err(Rejected::Frame(VerifyError::Replayed)) = verify(frame, key, now) else {
        return Err(Failed);
    };
    info!("Repeated frame rejected");
    Ok(())
}

// Not inlined, nor are those below: what one needs on the stack, the others need not have.
#[inline(never)]
fn load(key: &mut Option<SigningKey>) -> Result<&SigningKey, KeyError> {
    Ok(key.insert(SigningKey::new(black_box(&KEY))?))
}

/// From a payload to the signed frame on the wire; its length in bytes.
#[inline(never)]
fn sign(
    wire: &mut [u8; MAX_FRAME_SIZE],
    sender: &mut Option<Frame>,
    payload: &[u8],
    key: &SigningKey,
    stamp: Stamp,
) -> Result<usize, Failed> {
    prepare(sender, payload);
    // Where it lies is not for the compiler to know: it would link a second `memcpy` for such addresses.
    let frame = black_box(sender.as_mut()).ok_or(Failed)?;
    sign_frame(frame, key, stamp).map_err(|_| Failed)?;
    for (slot, byte) in wire.iter_mut().zip(frame.as_bytes()) {
        *slot = *byte;
    }
    Ok(frame.as_bytes().len())
}

#[inline(never)]
fn prepare(sender: &mut Option<Frame>, payload: &[u8]) {
    *sender = Frame::new(HEADER, payload).ok();
}

/// From received bytes to the verdict.
#[inline(never)]
fn verify<'a>(
    received: &'a [u8],
    key: &SigningKey,
    now: Timestamp,
) -> Result<Verified<'a>, Rejected> {
    #[cfg(feature = "leaky")]
    if !crate::leaky::tag_matches(received, black_box(&KEY)) {
        return Err(Rejected::Frame(VerifyError::BadTag));
    }
    let frame = FrameRef::parse(received).map_err(|_| Rejected::NoFrame)?;
    verify_frame(frame, key, now, &LINK).map_err(Rejected::Frame)
}

fn flip(byte: Option<&mut u8>) {
    if let Some(byte) = byte {
        *byte ^= 1;
    }
}
