//! Replay protection for several senders on one link: one timestamp for each stream.

use heapless::LinearMap;

use crate::error::VerifyError;
use crate::header::Header;
use crate::replay::Admit;
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
    const fn of(header: Header, stamp: Stamp) -> Self {
        Self {
            link_id: stamp.link_id,
            system_id: header.system_id,
            component_id: header.component_id,
        }
    }
}

/// Which link ids a receiver takes frames of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Links {
    /// All. A frame recorded on one link is then authentic on another, and accepted there as the
    /// first of its stream for as long as it lies in the window.
    Any,
    /// All but this one, which the receiver's own frames are signed for: reflected, they are refused.
    AllBut(u8),
    /// This one alone: a frame recorded on another link is refused.
    Only(u8),
}

impl Links {
    /// Whether frames of `link_id` are taken.
    #[must_use]
    pub const fn take(self, link_id: u8) -> bool {
        match self {
            Self::Any => true,
            Self::AllBut(own) => link_id != own,
            Self::Only(taken) => link_id == taken,
        }
    }
}

/// What a receiver remembers of up to `N` streams. It is not copied: a copy would accept again what
/// the original has accepted.
///
/// Only an authentic frame takes a row, and no row is given up: when all are taken, further streams are
/// refused. Whoever has the key can therefore fill the table; nobody else can.
#[derive(Debug)]
pub struct Streams<const N: usize> {
    links: Links,
    window: Window,
    /// What is fresh in a stream that has no row.
    first: Fresh,
    rows: LinearMap<Stream, Fresh, N>,
}

impl<const N: usize> Admit for Streams<N> {
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

    fn takes(&self, link_id: u8) -> bool {
        self.links.take(link_id)
    }
}

impl<const N: usize> Streams<N> {
    /// A receiver that has accepted nothing yet.
    #[must_use]
    pub const fn new(links: Links, window: Window) -> Self {
        Self::resume(links, window, Timestamp::ZERO)
    }

    /// A receiver that accepts no frame stamped before `first`, of any stream: for one that kept a
    /// mark over a restart.
    #[must_use]
    pub const fn resume(links: Links, window: Window, first: Timestamp) -> Self {
        Self {
            links,
            window,
            first: Fresh::from(first),
            rows: LinearMap::new(),
        }
    }

    /// Which link ids frames are taken of.
    #[must_use]
    pub const fn links(&self) -> Links {
        self.links
    }

    /// How far from the clock frames may be stamped.
    #[must_use]
    pub const fn window(&self) -> Window {
        self.window
    }

    /// Every stream of which a frame was accepted, and the timestamp up to which all of its frames
    /// are refused.
    pub fn rows(&self) -> impl Iterator<Item = (Stream, Option<Timestamp>)> {
        self.rows
            .iter()
            .map(|(stream, fresh)| (*stream, fresh.used()))
    }

    /// Lets `frame` through if it is of a link that this receiver takes, lies in the window around
    /// `now`, and is newer than every frame of its stream let through before; then remembers it.
    ///
    /// # Errors
    ///
    /// [`VerifyError::WrongLink`], [`VerifyError::FromFuture`], [`VerifyError::TooOld`],
    /// [`VerifyError::Replayed`], [`VerifyError::StreamsFull`], looked for in this order; nothing has
    /// changed then.
    pub fn admit<'a>(
        &mut self,
        frame: Authentic<'a>,
        now: Timestamp,
    ) -> Result<Verified<'a>, VerifyError> {
        self.check(&frame, now)?;
        let stamp = frame.stamp();
        let stream = Stream::of(frame.header(), stamp);
        let inserted = self.rows.insert(stream, Fresh::after(stamp.timestamp));
        inserted.map_err(|_| VerifyError::StreamsFull)?;
        Ok(Verified::new(frame))
    }

    /// The verdict that [`Streams::admit`] would give; nothing changes.
    ///
    /// # Errors
    ///
    /// As [`Streams::admit`].
    pub fn check(&self, frame: &Authentic<'_>, now: Timestamp) -> Result<(), VerifyError> {
        let stamp = frame.stamp();
        if !self.links.take(stamp.link_id) {
            return Err(VerifyError::WrongLink(stamp.link_id));
        }
        self.window.check(stamp.timestamp, now)?;
        let row = self.rows.get(&Stream::of(frame.header(), stamp));
        if !row.unwrap_or(&self.first).contains(stamp.timestamp) {
            return Err(VerifyError::Replayed);
        }
        if row.is_none() && self.rows.len() == self.rows.capacity() {
            return Err(VerifyError::StreamsFull);
        }
        Ok(())
    }

    /// For proofs: with these rows.
    #[cfg(kani)]
    #[must_use]
    pub fn holding(mut self, rows: &[(Stream, Timestamp)]) -> Self {
        for (stream, last) in rows {
            let _ = self.rows.insert(*stream, Fresh::after(*last));
        }
        self
    }
}
