//! The whole verdict on a frame, over replay state that interrupts and threads share.

use core::cell::Cell;

use critical_section::Mutex;

use crate::anti_replay::{ReplayGuard, ReplayState};
use crate::error::VerifyError;
use crate::frame::FrameRef;
use crate::key::SigningKey;
use crate::profile::Profile;
use crate::time::Timestamp;
use crate::verify::{Authentic, Verified, authenticate};

/// Replay state that interrupts and threads share; `const`, so it can be a `static`.
///
/// ```
/// use mavlink_signing::{MavLinkState, ReplayGuard, Window};
///
/// static UPLINK: MavLinkState = MavLinkState::new(ReplayGuard::new(7, Window::STRICT));
/// assert_eq!(UPLINK.last(), None);
/// ```
#[derive(Debug)]
pub struct MavLinkState(Mutex<Cell<ReplayState>>);

impl MavLinkState {
    /// Shares `replay`.
    #[must_use]
    pub const fn new(replay: ReplayGuard) -> Self {
        Self(Mutex::new(Cell::new(replay.into_state())))
    }

    /// The timestamp up to which everything is rejected; `None` at the start.
    #[must_use]
    pub fn last(&self) -> Option<Timestamp> {
        let state = critical_section::with(|token| self.0.borrow(token).get());
        ReplayGuard::from_state(state).last()
    }

    /// [`ReplayGuard::admit`] in one critical section: two frames with one stamp cannot both pass.
    fn admit<'a>(&self, frame: Authentic<'a>, now: Timestamp) -> Result<Verified<'a>, VerifyError> {
        critical_section::with(|token| {
            let shared = self.0.borrow(token);
            let mut replay = ReplayGuard::from_state(shared.get());
            let verified = replay.admit(frame, now)?;
            shared.set(replay.into_state());
            Ok(verified)
        })
    }
}

/// [`authenticate`], then [`ReplayGuard::admit`] in a critical section: the whole verdict on a frame.
///
/// The hash is computed outside the critical section. On every error `state` is untouched.
///
/// # Errors
///
/// Those of [`authenticate`], then [`VerifyError::WrongLink`], [`VerifyError::FromFuture`],
/// [`VerifyError::TooOld`], [`VerifyError::Replayed`].
pub fn verify_frame<'a, P: Profile>(
    frame: FrameRef<'a>,
    key: &SigningKey<P>,
    now: Timestamp,
    state: &MavLinkState,
) -> Result<Verified<'a>, VerifyError> {
    state.admit(authenticate(frame, key)?, now)
}
