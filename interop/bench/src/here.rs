//! The core, as a sender and as a receiver.

use mavlink_signing::{
    AntiReplay, Frame, FrameRef, Links, Profile, ReplayGuard, SigningKey, Stamper, StreamTable,
    Window, authenticate, sign_frame,
};

use crate::messages::{KEY, LINK, Message, clock};

/// The key, prepared for a profile.
#[must_use]
pub fn key<P: Profile>() -> SigningKey<P> {
    SigningKey::new(&KEY).expect("a key")
}

/// A sender that has sent nothing yet.
#[must_use]
pub fn sender() -> Stamper {
    Stamper::new(LINK)
}

/// A receiver of one stream that has accepted nothing yet.
#[must_use]
pub fn one_stream() -> ReplayGuard {
    ReplayGuard::new(LINK, Window::STRICT)
}

/// A receiver of up to 16 streams that has accepted nothing yet.
#[must_use]
pub fn streams() -> StreamTable<16> {
    StreamTable::new(Links::Only(LINK), Window::STRICT)
}

/// From header and payload to the frame on the wire.
#[must_use]
pub fn sign<P: Profile>(
    message: &Message,
    payload: &[u8],
    key: &SigningKey<P>,
    sender: &mut Stamper,
) -> Frame {
    let mut frame = Frame::new(message.header(0), payload).expect("a message");
    let stamp = sender.stamp(clock()).expect("before 2104");
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    frame
}

/// From received bytes to the bytes to act on: how many there are.
pub fn verify<P: Profile>(
    bytes: &[u8],
    key: &SigningKey<P>,
    receiver: &mut impl AntiReplay,
) -> usize {
    let frame = FrameRef::parse(bytes).expect("a frame");
    let authentic = authenticate(frame, key).expect("signed with the key");
    let verified = receiver.admit(authentic, clock()).expect("in order");
    verified.payload().len()
}
