//! One end of a sealed link: MAVLink in the clear on one side, a radio on the other.
//!
//! ```text
//! local side         packed, sealed, framed as air data         radio
//! (autopilot,      ------------------------------------>   (the other ends)
//!  ground station) <------------------------------------
//!                   only packets out of opened packages
//! ```
//!
//! * Local side to radio: packets with a right checksum, of MAVLink 1 or 2, signed or not, whole and
//!   unchanged. They wait for one another until a message is full or a HEARTBEAT comes, or until the first has
//!   waited for the maximum delay. A packet of more than 80 bytes fits into no message: it is rejected and counted.
//! * Radio to local side: the packets of packages that a permitted sender sealed, each package once. All
//!   else is rejected and counted by reason. No packet that came from the radio goes out on it again.
//! * The end asks its radio for its status every second. The answer, which nothing protects, becomes
//!   VEHICLE_RADIO, which a vehicle sends to its stations, or GCS_RADIO, which a station hands to its program.
//!
//! # Over a restart
//!
//! No counter is used twice, and no package is opened twice, wherever the power failed: [`HighWaterMarks`]. They are
//! provisioned once for the keys, and belong to them: a mark that is lost, swapped or of another key is an error.
//!
//! | choice | price |
//! |---|---|
//! | the mark of the counters to seal with is stored every 60 s ([`Pace::SENT`]) | a restart uses up the counters of so long, of 2^32 |
//! | that of those accepted is stored every 10 s ([`Pace::ACCEPTED`]) | after a restart, packages of each peer may be rejected for so long |
//! | each start stores marks more often at first | flash: see `mavseal-store`, Wear; [`SealedEndpoint::erases`] tells |
//! | what cannot be remembered is rejected | with a worn-out flash the link ends: [`SealedRejectReason::NotStored`] |
//! | whoever has a peer's key can take 2^26 of his counters away per start ([`MAX_PASSED_OVER`]) | a peer of which nothing was heard while he sealed so many is rejected until this end starts again |
//!
//! # With a clock
//!
//! Counters know order, and no time: a package that somebody held back for weeks is accepted if nothing newer has
//! come. Where all ends have a trusted clock, [`SealedEndpoint::clocked`] makes them follow it, and rejects what is
//! more than 60 s from it. Nothing changes on the wire.

mod clocked;
mod egress;
mod event;
mod ingress;
mod marks;
mod paced;
mod radio;
mod tx_buffer;

pub use clocked::{COUNTERS_PER_SECOND, MAX_AGE, MAX_LEAD};
pub use event::{SealedCounters, SealedEvent, SealedRejectReason};
pub use marks::{ACCEPTED_KIND, HighWaterMarks, MarksError, Place, SENT_KIND, provision_peer};
pub use mavlink_commsec::MAX_PASSED_OVER;
pub use paced::Pace;
pub use radio::{Radio, STATUS_INTERVAL};

use core::fmt;
use core::time::Duration;

use embedded_storage::nor_flash::NorFlash;
use mavlink_commsec::{
    AesGcm, Cipher, Credential, Opener, Packer, PermitError, Sealer, SenderId, hx,
};
use mavlink_signing::{LinkClock, Resync, Timestamp};

use crate::endpoint::{Endpoint, LineEvent, Side};
use crate::reader::PacketReader;
use clocked::Moment;
use egress::Egress;
use ingress::Ingress;
use marks::Fingerprints;
use paced::PacedMark;
use radio::RadioPoller;
use tx_buffer::TxBuffer;

/// One end of a sealed link with `N` peers. See the [module's documentation](self).
pub struct SealedEndpoint<F, const N: usize, C: Cipher = AesGcm> {
    outward: Egress<F, C>,
    inward: Ingress<F, N, C>,
    radio: RadioPoller,
    /// When the counters that follow a clock began.
    origin: Option<Timestamp>,
}

impl<F: NorFlash, const N: usize, C: Cipher> SealedEndpoint<F, N, C> {
    /// The end that seals as `own` and opens what `peers` have sealed, from where `marks` say.
    ///
    /// No packet waits for others for longer than twice `max_delay`, if [`poll`](Endpoint::poll) is called when
    /// [`poll_at`](Endpoint::poll_at) says.
    ///
    /// # Errors
    ///
    /// [`SealedEndpointError`]: what is wrong with the keys, or that the marks are those of others.
    pub fn new(
        own: &Credential,
        peers: &[Credential; N],
        marks: HighWaterMarks<F, N>,
        radio: Radio,
        max_delay: Duration,
    ) -> Result<Self, SealedEndpointError> {
        if marks.fingerprints != Fingerprints::new::<C>(own, peers)? {
            return Err(SealedEndpointError::OtherMarks);
        }
        let HighWaterMarks { sent, accepted, .. } = marks;
        // A mark behind the last counter is as good as the last: it seals nothing, and nothing is newer.
        let first = counter(sent.get());
        let last = |sender| {
            let mut marks = peers.iter().zip(&accepted);
            let mark = marks.find(|(peer, _)| peer.id == sender);
            // The mark itself was never accepted.
            mark.map_or(0, |(_, mark)| counter(mark.get().saturating_sub(1)))
        };
        let opener = Opener::from_credentials(peers, last)?;
        let key = own.prepare().map_err(PermitError::from)?;
        Ok(Self {
            outward: Egress {
                reader: PacketReader::new(Resync::Silence),
                packer: Packer::new(max_delay),
                sealer: Sealer::resume(key, own.id, first),
                mark: PacedMark::new(sent, Pace::SENT),
                line: TxBuffer::new(),
                counters: SealedCounters::default(),
            },
            inward: Ingress {
                decoder: hx::Decoder::new(),
                opener,
                peers: peers.each_ref().map(|peer| peer.id),
                marks: accepted.map(|mark| PacedMark::new(mark, Pace::ACCEPTED)),
                line: TxBuffer::new(),
                counters: SealedCounters::default(),
            },
            radio: RadioPoller::new(radio),
            origin: None,
        })
    }

    /// The same end, whose counters follow the clock it is given with each call, and which rejects what is more than
    /// [`MAX_AGE`] from it, either way. All ends of the link must do so, with the same `origin`: when the keys were
    /// made, or any moment before that.
    ///
    /// A counter is the time since `origin` in 1/64 s, or the last one plus 1 if that is greater. 2^32 of them last
    /// for 2.1 years after `origin`; then only new keys help. What would run more than [`MAX_LEAD`] ahead of the clock
    /// is not sealed: more than 64 packages a second for long.
    ///
    /// The clock must be one that can be trusted, and know the time before the first call. A sender whose clock was
    /// ahead is silent until that time has come, over restarts too.
    #[must_use]
    pub fn clocked(mut self, origin: Timestamp) -> Self {
        self.origin = Some(origin);
        self.outward.mark.pace = Pace::SENT_WITH_CLOCK;
        for mark in &mut self.inward.marks {
            mark.pace = Pace::ACCEPTED_WITH_CLOCK;
        }
        self
    }

    /// The same end, which gives a peer's key up after `limit` wrong tags in place of
    /// [`INTEGRITY_LIMIT`](mavlink_commsec::INTEGRITY_LIMIT), until the next start.
    #[must_use]
    pub const fn integrity_limit(mut self, limit: u32) -> Self {
        self.inward.opener.set_limit(limit);
        self
    }

    /// The same end with `ticks` of silence on the local side in place of [`IDLE`](crate::IDLE): longer than any pause
    /// within a packet.
    #[must_use]
    pub const fn idle(mut self, ticks: u64) -> Self {
        self.outward.reader.set_idle(ticks);
        self
    }

    /// The counter of the next package to be sealed; `None` when all are used up.
    #[must_use]
    pub fn next_counter(&self) -> Option<u32> {
        self.outward.sealer.next_counter()
    }

    /// Every peer, and the counter up to which everything of his is rejected.
    pub fn peers(&self) -> impl Iterator<Item = (SenderId, u32)> {
        self.inward.opener.senders()
    }

    /// How many packages for the key of `peer` had a wrong tag since the start; `None` if he is none.
    #[must_use]
    pub fn failed_opens(&self, peer: SenderId) -> Option<u32> {
        self.inward.opener.failed_opens(peer)
    }

    /// How often each page of the mark that wears most was erased so far. Tell people long before the flash is worn
    /// out, which its data sheet says: often after 10,000 times.
    pub fn erases(&self) -> u32 {
        let accepted = self.inward.marks.iter().map(PacedMark::erases);
        accepted.fold(self.outward.mark.erases(), u32::max)
    }

    /// What has been sealed and rejected on its way to the radio.
    #[must_use]
    pub const fn sealed(&self) -> &SealedCounters {
        &self.outward.counters
    }

    /// What has been opened and rejected on its way from the radio.
    #[must_use]
    pub const fn opened(&self) -> &SealedCounters {
        &self.inward.counters
    }

    /// The flashes of the marks, for what else they hold.
    pub fn into_flashes(self) -> (F, [F; N]) {
        let accepted = self.inward.marks.map(PacedMark::into_flash);
        (self.outward.mark.into_flash(), accepted)
    }
}

impl<F: NorFlash, const N: usize, C: Cipher> Endpoint for SealedEndpoint<F, N, C> {
    type Event = SealedEvent;

    fn room(&self, side: Side) -> usize {
        match side {
            Side::Local => self.outward.reader.room(),
            // What is behind a package waits for its packets to leave.
            Side::Link => usize::from(self.inward.line.is_empty()),
        }
    }

    fn received(
        &mut self,
        side: Side,
        bytes: &[u8],
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(SealedEvent),
    ) -> usize {
        let now = Moment::of(clock, self.origin);
        let Self {
            outward,
            inward,
            radio,
            ..
        } = self;
        let mut taken = 0;
        match side {
            Side::Local => loop {
                let rest = bytes.get(taken..).unwrap_or_default();
                let count = outward.reader.write(rest, now.ticks);
                if count == 0 {
                    break;
                }
                taken += count;
                outward.advance(radio, now, observe);
            },
            Side::Link => {
                for byte in bytes {
                    if !inward.line.is_empty() {
                        break;
                    }
                    taken += 1;
                    inward.push(*byte, radio, now, observe);
                    // The radio's answer may be for the stations.
                    outward.advance(radio, now, observe);
                }
            }
        }
        taken
    }

    fn pending(&self, side: Side) -> &[u8] {
        match side {
            Side::Local => self.inward.line.pending(),
            Side::Link => self.outward.line.pending(),
        }
    }

    fn sent(
        &mut self,
        side: Side,
        count: usize,
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(SealedEvent),
    ) {
        match side {
            Side::Local => {
                self.inward.line.sent(count);
            }
            Side::Link => {
                if self.outward.line.sent(count) {
                    let now = Moment::of(clock, self.origin);
                    self.outward.reader.restart_timer(now.ticks);
                    self.outward.advance(&mut self.radio, now, observe);
                }
            }
        }
    }

    fn line_event(
        &mut self,
        side: Side,
        event: LineEvent,
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(SealedEvent),
    ) {
        let now = Moment::of(clock, self.origin);
        let Self {
            outward,
            inward,
            radio,
            ..
        } = self;
        match (side, event) {
            (Side::Local, LineEvent::Idle) => outward.reader.silent(),
            (Side::Local, _) => outward.reader.fault(now.ticks),
            // A frame from the radio ends with a byte of its own.
            (Side::Link, LineEvent::Idle) => {}
            (Side::Link, _) => inward.decoder = hx::Decoder::new(),
        }
        if event == LineEvent::Closed {
            match side {
                Side::Local => inward.drop_packets(observe),
                Side::Link => {
                    outward.drop_frame(observe);
                    outward.reader.restart_timer(now.ticks);
                }
            }
        }
        outward.advance(radio, now, observe);
    }

    fn poll_at(&self) -> Option<u64> {
        self.outward.poll_at(&self.radio)
    }

    fn poll(&mut self, clock: &mut impl LinkClock, observe: &mut impl FnMut(SealedEvent)) {
        let now = Moment::of(clock, self.origin);
        self.outward.reader.poll(now.ticks, false);
        self.outward.advance(&mut self.radio, now, observe);
    }
}

impl<F, const N: usize, C: Cipher> fmt::Debug for SealedEndpoint<F, N, C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SealedEndpoint")
            .field("sealed", &self.outward.counters)
            .field("opened", &self.inward.counters)
            .finish_non_exhaustive()
    }
}

fn counter(mark: u64) -> u32 {
    u32::try_from(mark).unwrap_or(u32::MAX)
}

/// Why there is no end. The caller is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SealedEndpointError {
    /// Something is wrong with the keys.
    Permit(PermitError),
    /// A cipher's hardware failed, or a key is none.
    Marks(MarksError),
    /// The marks were opened for other keys, or for other peers, or in another order.
    OtherMarks,
}

impl From<PermitError> for SealedEndpointError {
    fn from(error: PermitError) -> Self {
        Self::Permit(error)
    }
}

impl From<MarksError> for SealedEndpointError {
    fn from(error: MarksError) -> Self {
        Self::Marks(error)
    }
}

impl fmt::Display for SealedEndpointError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Permit(error) => error.fmt(f),
            Self::Marks(error) => error.fmt(f),
            Self::OtherMarks => f.write_str("the marks are those of other keys"),
        }
    }
}

impl core::error::Error for SealedEndpointError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Permit(error) => Some(error),
            Self::Marks(error) => Some(error),
            Self::OtherMarks => None,
        }
    }
}
