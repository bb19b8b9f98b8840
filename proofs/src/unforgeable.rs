//! V2: what is refused leaves no trace, and what is accepted was made by the checks alone.
//!
//! That an error leaves the replay state as it was is part of [V1](crate::verify::accepted_iff) and
//! [R1](crate::replay::step). That [`Authentic`](mavlink_signing::Authentic) and
//! [`Verified`](mavlink_signing::Verified) come from nowhere else is a matter of types, which the
//! compiler checks; each of these programs must not compile, and differs in one line from this one,
//! which does:
//!
//! ```
//! use mavlink_signing::{Authentic, FrameRef, Replay, Timestamp, Verified, VerifyError};
//! fn admitted<'a>(authentic: Authentic<'a>, replay: &mut Replay) -> Result<Verified<'a>, VerifyError> {
//!     replay.admit(authentic, Timestamp::ZERO)
//! }
//! ```
//!
//! A frame that was only parsed is not admitted:
//!
//! ```compile_fail
//! use mavlink_signing::{Authentic, FrameRef, Replay, Timestamp, Verified, VerifyError};
//! fn admitted<'a>(authentic: FrameRef<'a>, replay: &mut Replay) -> Result<Verified<'a>, VerifyError> {
//!     replay.admit(authentic, Timestamp::ZERO)
//! }
//! ```
//!
//! `Verified` is not made from an authentic frame by hand:
//!
//! ```compile_fail
//! use mavlink_signing::{Authentic, FrameRef, Replay, Timestamp, Verified, VerifyError};
//! fn admitted<'a>(authentic: Authentic<'a>, replay: &mut Replay) -> Result<Verified<'a>, VerifyError> {
//!     Ok(Verified::new(authentic))
//! }
//! ```
//!
//! ```compile_fail
//! use mavlink_signing::{Authentic, FrameRef, Replay, Timestamp, Verified, VerifyError};
//! fn admitted<'a>(authentic: Authentic<'a>, replay: &mut Replay) -> Result<Verified<'a>, VerifyError> {
//!     Ok(Verified(authentic))
//! }
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
//! fn twice(x: mavlink_signing::Replay) -> [mavlink_signing::Replay; 2] { [x.clone(), x] }
//! ```
//!
//! ```compile_fail
//! fn twice(x: mavlink_signing::Stamper) -> [mavlink_signing::Stamper; 2] { [x.clone(), x] }
//! ```
