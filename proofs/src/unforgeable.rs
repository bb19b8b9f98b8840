//! V2: what is rejected leaves no trace, and what is accepted was made by the checks alone.
//!
//! That [`Authentic`](mavlink_signing::Authentic) and [`Verified`](mavlink_signing::Verified) come from
//! nowhere else is a matter of types, which the compiler checks; each of these programs must not
//! compile, and differs in one line from this one, which does:
//!
//! ```
//! use mavlink_signing::{Authentic, FrameRef, ReplayGuard, Timestamp, Verified, VerifyError};
//! fn admitted<'a>(authentic: Authentic<'a>, replay: &mut ReplayGuard) -> Result<Verified<'a>, VerifyError> {
//!     replay.admit(authentic, Timestamp::ZERO)
//! }
//! ```
//!
//! A frame that was only parsed is not admitted:
//!
//! ```compile_fail
//! use mavlink_signing::{Authentic, FrameRef, ReplayGuard, Timestamp, Verified, VerifyError};
//! fn admitted<'a>(authentic: FrameRef<'a>, replay: &mut ReplayGuard) -> Result<Verified<'a>, VerifyError> {
//!     replay.admit(authentic, Timestamp::ZERO)
//! }
//! ```
//!
//! `Verified` is not made from an authentic frame by hand:
//!
//! ```compile_fail
//! use mavlink_signing::{Authentic, FrameRef, ReplayGuard, Timestamp, Verified, VerifyError};
//! fn admitted<'a>(authentic: Authentic<'a>, replay: &mut ReplayGuard) -> Result<Verified<'a>, VerifyError> {
//!     Ok(Verified::new(authentic))
//! }
//! ```
//!
//! ```compile_fail
//! use mavlink_signing::{Authentic, FrameRef, ReplayGuard, Timestamp, Verified, VerifyError};
//! fn admitted<'a>(authentic: Authentic<'a>, replay: &mut ReplayGuard) -> Result<Verified<'a>, VerifyError> {
//!     Ok(Verified(authentic))
//! }
//! ```
//!
//! Nor is it made from one that a policy accepted, which in turn is made by
//! [`accept_unsigned`](mavlink_signing::accept_unsigned) alone:
//!
//! ```compile_fail
//! use mavlink_signing::{ReplayGuard, Timestamp, Unsigned, Verified, VerifyError};
//! fn admitted<'a>(unsigned: Unsigned<'a>, replay: &mut ReplayGuard) -> Result<Verified<'a>, VerifyError> {
//!     replay.admit(unsigned, Timestamp::ZERO)
//! }
//! ```
//!
//! ```compile_fail
//! use mavlink_signing::{FrameRef, Unsigned};
//! fn accepted(frame: FrameRef<'_>) -> Unsigned<'_> { Unsigned { frame, crc_extra: 0 } }
//! ```
//!
//! ```
//! use mavlink_signing::{FrameRef, AllowRadioStatus, Unsigned, accept_unsigned};
//! fn accepted(frame: FrameRef<'_>) -> Unsigned<'_> { accept_unsigned(frame, 1, &AllowRadioStatus).unwrap() }
//! ```
//!
//! A frame that was not verified hands out no payload; one that was does:
//!
//! ```
//! fn act(frame: &mavlink_signing::Verified<'_>) -> usize { frame.payload().len() }
//! ```
//!
//! ```compile_fail
//! fn act(frame: &mavlink_signing::Authentic<'_>) -> usize { frame.payload().len() }
//! ```
//!
//! ```compile_fail
//! fn act(frame: &mavlink_signing::FrameRef<'_>) -> usize { frame.payload().len() }
//! ```
//!
//! What counts once is not copied: a verified frame, an authentic one, a receiver's memory, and a
//! sender's stamps. A frame that was only parsed may be:
//!
//! ```
//! fn twice<'a>(x: mavlink_signing::FrameRef<'a>) -> [mavlink_signing::FrameRef<'a>; 2] { [x.clone(), x] }
//! ```
//!
//! ```compile_fail
//! fn twice<'a>(x: mavlink_signing::Verified<'a>) -> [mavlink_signing::Verified<'a>; 2] { [x.clone(), x] }
//! ```
//!
//! ```compile_fail
//! fn twice<'a>(x: mavlink_signing::Authentic<'a>) -> [mavlink_signing::Authentic<'a>; 2] { [x.clone(), x] }
//! ```
//!
//! ```compile_fail
//! fn twice(x: mavlink_signing::ReplayGuard) -> [mavlink_signing::ReplayGuard; 2] { [x.clone(), x] }
//! ```
//!
//! ```compile_fail
//! fn twice(x: mavlink_signing::StreamTable<1>) -> [mavlink_signing::StreamTable<1>; 2] { [x.clone(), x] }
//! ```
//!
//! ```compile_fail
//! fn twice(x: mavlink_signing::Stamper) -> [mavlink_signing::Stamper; 2] { [x.clone(), x] }
//! ```

use mavlink_signing::{FrameRef, Profile, SigningKey, Timestamp, VerifyError, authenticate};

use crate::model::Resumed;

/// V2: whatever is rejected, and for whatever reason, leaves the receiver as it was; what is accepted
/// is all that it remembers.
///
/// # Errors
///
/// The rejection.
///
/// # Panics
///
/// If the property does not hold.
pub fn rejection_leaves_no_trace<P: Profile>(
    bytes: &[u8],
    key: &SigningKey<P>,
    before: Resumed,
    now: Timestamp,
) -> Result<(), VerifyError> {
    let mut after = before.replay();
    let verdict = FrameRef::parse(bytes)
        .map_err(VerifyError::from)
        .and_then(|frame| authenticate(frame, key))
        .and_then(|authentic| after.admit(authentic, now))
        .map(|verified| verified.stamp().timestamp);
    match verdict {
        Ok(stamp) => {
            assert!(after != before.replay());
            assert_eq!(after.last(), Some(stamp));
        }
        Err(_) => assert_eq!(after, before.replay()),
    }
    verdict.map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use mavlink_signing::{Frame, Hmac, MavLinkState, Stamp, Window, sign_frame, verify_frame};

    /// Every kind of rejection, and an acceptance; the shared state gives the same verdicts.
    #[test]
    fn v2_every_rejection() {
        let at = |ticks| Timestamp::from_ticks(ticks).expect("48 bits");
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let signed = |link_id, ticks| {
            let mut frame = Frame::new(HEARTBEAT, &[1, 2, 3]).expect("a frame");
            let timestamp = at(ticks);
            sign_frame(&mut frame, &key, Stamp { link_id, timestamp }).expect("signed");
            frame.as_bytes().to_vec()
        };
        let damaged = |offset: usize| {
            let mut bytes = signed(1, 100);
            bytes[offset] ^= 0x80;
            bytes
        };
        let unsigned = Frame::new(HEARTBEAT, &[])
            .expect("a frame")
            .as_bytes()
            .to_vec();
        let before = Resumed {
            link_id: 1,
            window: Window {
                past: 20,
                ahead: 20,
            },
            first: at(95),
        };
        let cases = [
            (signed(1, 100), true),
            (signed(1, 94), false),
            (signed(1, 79), false),
            (signed(1, 121), false),
            (signed(2, 100), false),
            (damaged(0), false),
            (damaged(2), false),
            (damaged(9), false),
            (damaged(10), false),
            (damaged(27), false),
            (signed(1, 100)[..27].to_vec(), false),
            (unsigned, false),
        ];
        for (bytes, accepted) in cases {
            let verdict = rejection_leaves_no_trace(&bytes, &key, before, at(100));
            assert_eq!(verdict.is_ok(), accepted, "{verdict:?}");

            let state = MavLinkState::new(before.replay());
            let last = state.last();
            let shared = FrameRef::parse(&bytes)
                .map_err(VerifyError::from)
                .and_then(|frame| verify_frame(frame, &key, at(100), &state));
            assert_eq!(shared.map(drop), verdict);
            assert_eq!(state.last() != last, accepted);
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::any_timestamp;
    use crate::model::{AnyTag, any_prefix};
    use mavlink_signing::field::MAX_FRAME_SIZE;

    #[kani::proof]
    #[kani::unwind(33)]
    #[kani::stub(mavlink_signing::crc::checksum, crate::model::any_checksum)]
    fn v2_rejection_leaves_no_trace() {
        let bytes: [u8; MAX_FRAME_SIZE] = kani::any();
        let bytes = any_prefix(&bytes);
        let mut secret: [u8; 32] = kani::any();
        secret[31] = 1;
        let key = SigningKey::<AnyTag>::new(&secret).expect("not zero");
        let verdict = rejection_leaves_no_trace(bytes, &key, Resumed::any(), any_timestamp());
        kani::cover!(verdict.is_ok(), "accepted");
        kani::cover!(verdict == Err(VerifyError::BadTag), "bad tag");
        kani::cover!(verdict == Err(VerifyError::Replayed), "replayed");
        kani::cover!(verdict == Err(VerifyError::TooOld), "too old");
        kani::cover!(verdict == Err(VerifyError::FromFuture), "from the future");
    }
}
