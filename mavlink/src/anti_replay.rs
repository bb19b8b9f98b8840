//! Replay protection: the link, the window and the last accepted timestamp of one stream.

use crate::error::VerifyError;
use crate::frame::FrameRef;
use crate::time::{Fresh, Timestamp, Window};
use crate::verify::{Authentic, Verified};

/// Decides whether an authentic frame comes in time and in order: [`ReplayGuard`] for one stream,
/// [`StreamTable`](crate::StreamTable) for several.
pub trait AntiReplay {
    /// Accepts `frame`, or says why not. A rejected frame changes nothing.
    ///
    /// # Errors
    ///
    /// Those of [`ReplayGuard::admit`], and [`VerifyError::Reflected`].
    fn admit<'a>(
        &mut self,
        frame: Authentic<'a>,
        now: Timestamp,
    ) -> Result<Verified<'a>, VerifyError>;

    /// The verdict that [`AntiReplay::admit`] would give; nothing changes.
    ///
    /// # Errors
    ///
    /// As [`AntiReplay::admit`].
    fn check(&self, frame: &Authentic<'_>, now: Timestamp) -> Result<(), VerifyError>;

    /// Remembers a frame that this end has signed and sends, so that its reflection is rejected.
    fn record_sent(&mut self, frame: FrameRef<'_>);

    /// A receiver of the same link and window for another key: it has accepted nothing, and accepts nothing stamped
    /// before `first`.
    #[must_use]
    fn renewed(&self, first: Timestamp) -> Self
    where
        Self: Sized;

    /// Whether a frame that this end sends for `link_id`, and [records](AntiReplay::record_sent), is
    /// rejected when it comes back.
    fn rejects_own(&self, link_id: u8) -> bool;
}

impl AntiReplay for ReplayGuard {
    fn admit<'a>(
        &mut self,
        frame: Authentic<'a>,
        now: Timestamp,
    ) -> Result<Verified<'a>, VerifyError> {
        Self::admit(self, frame, now)
    }

    fn check(&self, frame: &Authentic<'_>, now: Timestamp) -> Result<(), VerifyError> {
        Self::check(self, frame, now)
    }

    fn record_sent(&mut self, _frame: FrameRef<'_>) {}

    fn renewed(&self, first: Timestamp) -> Self {
        Self::resume(self.link_id(), self.window(), first)
    }

    fn rejects_own(&self, link_id: u8) -> bool {
        link_id != self.link_id()
    }
}

/// What a receiver remembers of one stream of frames. It is not copied: a copy would accept again
/// what the original has accepted.
///
/// A link carries one stream: all frames of one sender under one link id. Give each direction of a link an
/// id of its own. The tag covers the id, so a sender's own frames, reflected, are
/// [`VerifyError::WrongLink`].
#[derive(Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ReplayGuard(ReplayState);

/// A [`ReplayGuard`]'s contents, for the cell that shares it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct ReplayState {
    link_id: u8,
    window: Window,
    fresh: Fresh,
}

impl ReplayGuard {
    /// A stream on `link_id` of which nothing has been accepted yet.
    #[must_use]
    pub const fn new(link_id: u8, window: Window) -> Self {
        Self::resume(link_id, window, Timestamp::ZERO)
    }

    /// A stream on `link_id` that accepts no frame stamped before `first`: for a receiver that kept a
    /// high-water mark over a restart.
    #[must_use]
    pub const fn resume(link_id: u8, window: Window, first: Timestamp) -> Self {
        Self(ReplayState {
            link_id,
            window,
            fresh: Fresh::from(first),
        })
    }

    pub(crate) const fn from_state(state: ReplayState) -> Self {
        Self(state)
    }

    pub(crate) const fn into_state(self) -> ReplayState {
        self.0
    }

    /// The link that frames must be made for.
    #[must_use]
    pub const fn link_id(&self) -> u8 {
        self.0.link_id
    }

    /// How far from the clock frames may be stamped.
    #[must_use]
    pub const fn window(&self) -> Window {
        self.0.window
    }

    /// The timestamp up to which everything is rejected; `None` at the start.
    #[must_use]
    pub const fn last(&self) -> Option<Timestamp> {
        self.0.fresh.used()
    }

    /// Accepts `frame` if it was made for this link, lies in the window around `now`, and is newer than
    /// every frame accepted before. Then remembers it.
    ///
    /// # Errors
    ///
    /// [`VerifyError::WrongLink`], [`VerifyError::FromFuture`], [`VerifyError::TooOld`],
    /// [`VerifyError::Replayed`], looked for in this order. Nothing has changed then.
    pub fn admit<'a>(
        &mut self,
        frame: Authentic<'a>,
        now: Timestamp,
    ) -> Result<Verified<'a>, VerifyError> {
        self.check(&frame, now)?;
        self.0.fresh = Fresh::after(frame.stamp().timestamp);
        Ok(Verified::new(frame))
    }

    /// The verdict that [`ReplayGuard::admit`] would give; nothing changes.
    ///
    /// # Errors
    ///
    /// As [`ReplayGuard::admit`].
    pub fn check(&self, frame: &Authentic<'_>, now: Timestamp) -> Result<(), VerifyError> {
        let stamp = frame.stamp();
        if stamp.link_id != self.0.link_id {
            return Err(VerifyError::WrongLink(stamp.link_id));
        }
        self.0.window.check(stamp.timestamp, now)?;
        if !self.0.fresh.contains(stamp.timestamp) {
            return Err(VerifyError::Replayed);
        }
        Ok(())
    }
}
