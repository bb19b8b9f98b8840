//! Replay protection for several senders on one link: one timestamp for each stream.

use core::mem;

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
/// Only an accepted frame takes a row. When all are taken, the stream with the oldest stamp is given up. From then on
/// no stream is accepted up to that stamp, so replay protection stays exact, and nobody is kept out for good. The
/// price: while more than `N` streams are in use, a sender whose clock is behind the others' may be rejected until it
/// has come after the stream given up.
///
/// What this end sends takes no row: what comes back in the name of a system that this end has signed for, on a link
/// that it has signed for, is rejected whatever its stamp. So a peer needs another system id or another link id.
#[derive(Debug)]
pub struct StreamTable<const N: usize> {
    links: Links,
    window: Window,
    /// What is fresh in every stream, whatever its row says.
    first: Fresh,
    rows: Vec<Row, N>,
    own: Own,
}

#[derive(Debug)]
struct Row {
    stream: Stream,
    fresh: Fresh,
}

/// The systems that this end has signed for, and on which links.
#[derive(Debug)]
struct Own {
    /// The links; `None` as long as nothing was sent. An end signs for one link, as a rule; if not, for any.
    links: Option<Links>,
    /// A bit for each system id.
    systems: [u32; 8],
}

impl Own {
    const NONE: Self = Self {
        links: None,
        systems: [0; 8],
    };

    fn add(&mut self, stream: Stream) {
        self.links = match self.links {
            None => Some(Links::Only(stream.link_id)),
            Some(links) if links.take(stream.link_id) => Some(links),
            Some(_) => Some(Links::Any),
        };
        if let Some(word) = self.systems.get_mut(usize::from(stream.system_id / 32)) {
            *word |= 1 << (stream.system_id % 32);
        }
    }

    fn has(&self, stream: Stream) -> bool {
        let word = self.systems.get(usize::from(stream.system_id / 32));
        let system = word.is_some_and(|word| word & (1 << (stream.system_id % 32)) != 0);
        system && self.links.is_some_and(|links| links.take(stream.link_id))
    }
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

    fn renewed(&self, first: Timestamp) -> Self {
        Self::resume(self.links, self.window, first)
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
            own: Own::NONE,
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

    /// The first timestamp that is fresh in a new stream; `None` when all are used up. It starts at the mark that the
    /// receiver was resumed at, and rises when a stream is given up.
    #[must_use]
    pub const fn floor(&self) -> Option<Timestamp> {
        self.first.first()
    }

    /// Whether this end has signed for `system_id` on `link_id`: what comes in for both is rejected.
    #[must_use]
    pub fn is_own(&self, link_id: u8, system_id: u8) -> bool {
        self.own.has(Stream {
            link_id,
            system_id,
            component_id: 0,
        })
    }

    /// Every stream that has a row, and its newest timestamp. Frames of the stream up to it are rejected, and what lies
    /// below the [`floor`](Self::floor).
    pub fn rows(&self) -> impl Iterator<Item = (Stream, Option<Timestamp>)> {
        self.rows.iter().map(|row| (row.stream, row.fresh.used()))
    }

    /// Accepts `frame` if its link is accepted, it is not one of this end's own, it lies in the window around `now`, and
    /// it is newer than every accepted frame of its stream. Then remembers it.
    ///
    /// # Errors
    ///
    /// [`VerifyError::WrongLink`], [`VerifyError::Reflected`], [`VerifyError::FromFuture`], [`VerifyError::TooOld`],
    /// [`VerifyError::Replayed`], looked for in this order. Nothing has changed then.
    pub fn admit<'a>(
        &mut self,
        frame: Authentic<'a>,
        now: Timestamp,
    ) -> Result<Verified<'a>, VerifyError> {
        self.check(&frame, now)?;
        let stamp = frame.stamp();
        let stream = Stream::new(frame.header(), stamp);
        self.remember(stream, Fresh::after(stamp.timestamp));
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
        let stream = Stream::new(frame.header(), stamp);
        if self.own.has(stream) {
            return Err(VerifyError::Reflected);
        }
        self.window.check(stamp.timestamp, now)?;
        let row = self.rows.iter().find(|row| row.stream == stream);
        let fresh = row.map_or(self.first, |row| row.fresh.max(self.first));
        if !fresh.contains(stamp.timestamp) {
            return Err(VerifyError::Replayed);
        }
        Ok(())
    }

    /// Remembers a frame that this end has signed and sends, so that its reflection is rejected, whenever it comes.
    ///
    /// So a peer may sign for the link id that this end signs for. Ground stations do that take over the
    /// link id they hear, such as pymavlink's with link id 0. An unsigned frame changes nothing.
    pub fn record_sent(&mut self, frame: FrameRef<'_>) {
        if let Some(signature) = frame.signature() {
            self.own.add(Stream::new(frame.header(), signature.stamp));
        }
    }

    /// Remembers that `stream` is fresh from `fresh` on. Of all streams, this one among them, the one with the oldest
    /// stamp is given up if there is no room.
    fn remember(&mut self, stream: Stream, fresh: Fresh) {
        if let Some(row) = self.row_mut(stream) {
            row.fresh = fresh;
            return;
        }
        let Err(row) = self.rows.push(Row { stream, fresh }) else {
            return;
        };
        let mut given_up = row;
        if let Some(oldest) = self.rows.iter_mut().min_by_key(|row| row.fresh)
            && oldest.fresh < given_up.fresh
        {
            mem::swap(oldest, &mut given_up);
        }
        // What was accepted of it is not accepted again, whatever is known of it.
        self.first = self.first.max(given_up.fresh);
    }

    fn row_mut(&mut self, stream: Stream) -> Option<&mut Row> {
        self.rows.iter_mut().find(|row| row.stream == stream)
    }

    /// For proofs: with these rows, and with what was sent.
    #[cfg(kani)]
    #[must_use]
    pub fn holding(mut self, rows: &[(Stream, Timestamp)], sent: Option<Stream>) -> Self {
        for (stream, last) in rows {
            let (stream, fresh) = (*stream, Fresh::after(*last));
            drop(self.rows.push(Row { stream, fresh }));
        }
        if let Some(stream) = sent {
            self.own.add(stream);
        }
        self
    }
}
