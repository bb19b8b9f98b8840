//! Replay protection for several senders on one link: one timestamp for each stream.

use heapless::Vec;

use crate::anti_replay::AntiReplay;
use crate::error::VerifyError;
use crate::frame::FrameRef;
use crate::header::Header;
use crate::time::{Fresh, Stamp, Timestamp, Window};
use crate::verify::{Authentic, Verified};

/// Whose frames: a link id, a system and a component (MAVLink guide, "Message Signing", Timestamp
/// Handling: "the (SystemID, ComponentID, LinkID) tuple").
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Stream {
    /// The link id that the sender signs for.
    pub link_id: u8,
    /// The sending vehicle or station.
    pub system_id: u8,
    /// The sending part of it.
    pub component_id: u8,
}

impl Stream {
    const fn new(header: Header, stamp: Stamp) -> Self {
        Self {
            link_id: stamp.link_id,
            system_id: header.system_id,
            component_id: header.component_id,
        }
    }
}

/// The link ids whose frames a receiver accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Links {
    /// All. A frame recorded on one link is then authentic on another. While it lies in the window, it is
    /// accepted there as the first of its stream.
    Any,
    /// This one alone: a frame recorded on another link is rejected.
    Only(u8),
}

impl Links {
    /// Whether frames of `link_id` are accepted.
    #[must_use]
    pub const fn take(self, link_id: u8) -> bool {
        match self {
            Self::Any => true,
            Self::Only(taken) => link_id == taken,
        }
    }
}

/// What a receiver remembers of up to `N` streams. It is not copied: a copy would accept again what
/// the original has accepted.
///
/// Only an accepted frame takes a row, or one that this end [sent](StreamTable::record_sent). No row is
/// given up: when all are taken, further streams are rejected. Only somebody with the key can fill the
/// table. What this end sends takes half of it at most. Whatever ids the equipment has that it signs for,
/// the other half is left to peers.
#[derive(Debug)]
pub struct StreamTable<const N: usize> {
    links: Links,
    window: Window,
    /// What is fresh in every stream, whatever its row says.
    first: Fresh,
    rows: Vec<Row, N>,
    /// The links on which this end sent frames of streams that have no row.
    closed: Option<Links>,
}

#[derive(Debug)]
struct Row {
    stream: Stream,
    fresh: Fresh,
    /// Whether it was taken for a frame that this end sent.
    own: bool,
}

impl<const N: usize> AntiReplay for StreamTable<N> {
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

    fn record_sent(&mut self, frame: FrameRef<'_>) {
        Self::record_sent(self, frame);
    }

    fn rejects_own(&self, _link_id: u8) -> bool {
        true
    }
}

impl<const N: usize> StreamTable<N> {
    /// A receiver that has accepted nothing yet.
    #[must_use]
    pub const fn new(links: Links, window: Window) -> Self {
        Self::resume(links, window, Timestamp::ZERO)
    }

    /// A receiver that accepts no frame stamped before `first`, of any stream: for one that kept a
    /// high-water mark over a restart.
    #[must_use]
    pub const fn resume(links: Links, window: Window, first: Timestamp) -> Self {
        Self {
            links,
            window,
            first: Fresh::from(first),
            rows: Vec::new(),
            closed: None,
        }
    }

    /// The link ids whose frames are accepted.
    #[must_use]
    pub const fn links(&self) -> Links {
        self.links
    }

    /// How far from the clock frames may be stamped.
    #[must_use]
    pub const fn window(&self) -> Window {
        self.window
    }

    /// The links on which no new stream is accepted, since this end sent more streams than have a row. One
    /// of them, reflected, would look like a peer's. `None` if there are none.
    #[must_use]
    pub const fn closed(&self) -> Option<Links> {
        self.closed
    }

    /// Every stream of which a frame was accepted or sent, and its newest timestamp. Frames of the stream
    /// up to it are rejected, and up to the mark that the receiver was resumed at.
    pub fn rows(&self) -> impl Iterator<Item = (Stream, Option<Timestamp>)> {
        self.rows.iter().map(|row| (row.stream, row.fresh.used()))
    }

    /// Accepts `frame` if its link is accepted, it lies in the window around `now`, and it is newer than
    /// every accepted frame of its stream. Then remembers it.
    ///
    /// # Errors
    ///
    /// [`VerifyError::WrongLink`], [`VerifyError::FromFuture`], [`VerifyError::TooOld`],
    /// [`VerifyError::Replayed`], [`VerifyError::StreamsFull`], looked for in this order. Nothing has
    /// changed then.
    pub fn admit<'a>(
        &mut self,
        frame: Authentic<'a>,
        now: Timestamp,
    ) -> Result<Verified<'a>, VerifyError> {
        self.check(&frame, now)?;
        let stamp = frame.stamp();
        let stream = Stream::new(frame.header(), stamp);
        let fresh = Fresh::after(stamp.timestamp);
        match self.row_mut(stream) {
            Some(row) => row.fresh = fresh,
            None => {
                let own = false;
                let pushed = self.rows.push(Row { stream, fresh, own });
                pushed.map_err(|_| VerifyError::StreamsFull)?;
            }
        }
        Ok(Verified::new(frame))
    }

    /// The verdict that [`StreamTable::admit`] would give; nothing changes.
    ///
    /// # Errors
    ///
    /// As [`StreamTable::admit`].
    pub fn check(&self, frame: &Authentic<'_>, now: Timestamp) -> Result<(), VerifyError> {
        let stamp = frame.stamp();
        if !self.links.take(stamp.link_id) {
            return Err(VerifyError::WrongLink(stamp.link_id));
        }
        self.window.check(stamp.timestamp, now)?;
        let stream = Stream::new(frame.header(), stamp);
        let row = self.rows.iter().find(|row| row.stream == stream);
        let fresh = row.map_or(self.first, |row| row.fresh.max(self.first));
        if !fresh.contains(stamp.timestamp) {
            return Err(VerifyError::Replayed);
        }
        let closed = self.closed.is_some_and(|it| it.take(stamp.link_id));
        if row.is_none() && (closed || self.rows.is_full()) {
            return Err(VerifyError::StreamsFull);
        }
        Ok(())
    }

    /// Remembers a frame that this end has signed and sends, so that its reflection is rejected. It is then
    /// a replay, or a frame of a new stream if there was no row left for it.
    ///
    /// Frames sent take rows until half of the table is taken in this way. After that, no new stream is
    /// accepted on the link that this end signs for.
    ///
    /// So a peer may sign for the link id that this end signs for. Ground stations do that take over the
    /// link id they hear, such as pymavlink's with link id 0. An unsigned frame, and one of a link that is
    /// not accepted, change nothing.
    pub fn record_sent(&mut self, frame: FrameRef<'_>) {
        let Some(stamp) = frame.signature().map(|signature| signature.stamp) else {
            return;
        };
        if !self.links.take(stamp.link_id) {
            return;
        }
        let stream = Stream::new(frame.header(), stamp);
        let fresh = Fresh::after(stamp.timestamp);
        if let Some(row) = self.row_mut(stream) {
            row.fresh = row.fresh.max(fresh);
            return;
        }
        let own = true;
        let left = self.rows.iter().filter(|row| row.own).count() < N / 2;
        if !left || self.rows.push(Row { stream, fresh, own }).is_err() {
            self.close(stamp.link_id);
        }
    }

    /// Accepts no new stream on `link_id` from now on.
    fn close(&mut self, link_id: u8) {
        self.closed = match self.closed {
            None => Some(Links::Only(link_id)),
            Some(closed) if closed.take(link_id) => Some(closed),
            // An end signs for one link, as a rule. If not, none of them is safe.
            Some(_) => Some(Links::Any),
        };
    }

    fn row_mut(&mut self, stream: Stream) -> Option<&mut Row> {
        self.rows.iter_mut().find(|row| row.stream == stream)
    }

    /// For proofs: with these rows, each with whether it is this end's own, and these links closed.
    #[cfg(kani)]
    #[must_use]
    pub fn holding(mut self, rows: &[(Stream, Timestamp, bool)], closed: Option<Links>) -> Self {
        for (stream, last, own) in rows {
            let (stream, fresh, own) = (*stream, Fresh::after(*last), *own);
            drop(self.rows.push(Row { stream, fresh, own }));
        }
        self.closed = closed;
        self
    }

    /// For proofs: how many rows were taken for frames that this end sent.
    #[cfg(kani)]
    #[must_use]
    pub fn own_rows(&self) -> usize {
        self.rows.iter().filter(|row| row.own).count()
    }

    /// For proofs: the first timestamp that is fresh in every stream.
    #[cfg(kani)]
    #[must_use]
    pub const fn floor(&self) -> Option<Timestamp> {
        self.first.first()
    }
}
