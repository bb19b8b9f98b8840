//! What the tests of frames share.

use mavlink_signing::{
    Frame, FrameRef, Header, Hmac, MavLinkState, MessageId, ReplayGuard, SigningKey, Stamp,
    Timestamp, Verified, VerifyError, Window, sign_frame, verify_frame,
};

pub const KEY: [u8; 32] = *b"a key for tests, known to anyone";
pub const LINK_ID: u8 = 3;
/// A moment in 2026, in ticks.
pub const NOW: u64 = 37_555_200_000_000;

/// An id that no dialect gives to a message.
pub const UNKNOWN: u32 = 0xFF_FFFE;

pub fn key() -> SigningKey<Hmac> {
    SigningKey::new(&KEY).expect("a key")
}

pub fn at(ticks: u64) -> Timestamp {
    Timestamp::from_ticks(ticks).expect("48 bits")
}

pub fn header(id: u32) -> Header {
    Header {
        compat_flags: 0,
        sequence: 17,
        system_id: 1,
        component_id: 190,
        message_id: MessageId::new(id).expect("24 bits"),
    }
}

/// A frame with message `id`.
pub fn unsigned(id: u32, payload: &[u8]) -> Frame {
    Frame::new(header(id), payload).expect("a frame")
}

/// A HEARTBEAT signed at `ticks`.
pub fn signed(payload: &[u8], ticks: u64) -> Frame {
    let mut frame = unsigned(0, payload);
    let stamp = Stamp {
        link_id: LINK_ID,
        timestamp: at(ticks),
    };
    sign_frame(&mut frame, &key(), stamp).expect("signed");
    frame
}

/// A receiver that has accepted nothing.
pub fn fresh() -> MavLinkState {
    MavLinkState::new(ReplayGuard::new(LINK_ID, Window::STRICT))
}

/// What a receiver with the test's key says of `bytes` at `ticks`.
pub fn receive<'a>(
    bytes: &'a [u8],
    ticks: u64,
    state: &MavLinkState,
) -> Result<Verified<'a>, VerifyError> {
    verify_frame(FrameRef::parse(bytes)?, &key(), at(ticks), state)
}

/// Asserts that `bytes` are rejected with `error` and that the receiver does not remember them.
pub fn assert_rejected(bytes: &[u8], ticks: u64, state: &MavLinkState, error: VerifyError) {
    let before = state.last();
    assert_eq!(receive(bytes, ticks, state).expect_err("rejected"), error);
    assert_eq!(state.last(), before, "state after {error}");
}
