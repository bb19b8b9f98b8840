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
//! No counter is used twice, and no package is opened twice, wherever the power failed: [`HighWaterMarks`].
//!
//! | choice | price |
//! |---|---|
//! | the mark of the counters to seal with is up to [`SENT_RESERVATION`] ahead | a restart uses up so many of 2^32 |
//! | that of those accepted is up to [`ACCEPTED_RESERVATION`] ahead | after a restart, so many packages of each peer may be rejected |
//! | a mark is stored for each so many packages | flash: see `mavseal-store`, Wear |
//! | what cannot be remembered is rejected | with a worn-out flash the link ends: [`SealedRejectReason::NotStored`] |
//!
//! Marks belong to keys. Whoever changes a key erases its mark; nobody erases a mark and keeps the key. They
//! are told apart by their order alone: a peer that is taken out, or another order, would hand one peer's mark
//! to the next, so that recordings of the latter pass. Then all keys are made new.

mod event;

pub use event::{SealedCounters, SealedEvent, SealedRejectReason};

use core::fmt;
use core::time::Duration;

use embedded_storage::nor_flash::NorFlash;
use heapless::Vec;
use mavlink_commsec::radio::{Answer, RADIO_PACKET_SIZE, Request, Status};
use mavlink_commsec::{
    AesGcm, Cipher, Credential, Opener, Packer, PermitError, Plaintext, Sealer, SenderId, field, hx,
};
use mavlink_signing::{LinkClock, Resync, TICKS_PER_SECOND};
use mavseal_store::HighWaterMark;

use crate::endpoint::{Endpoint, LineEvent, Side};
use crate::event::Direction;
use crate::reader::PacketReader;

/// How far the mark is stored ahead of the counters that this end seals with.
pub const SENT_RESERVATION: u64 = 256;
/// How far a mark is stored ahead of the counters accepted of one peer.
pub const ACCEPTED_RESERVATION: u64 = 8;
/// How often the radio is asked for its status: every second, in ticks of 10 microseconds.
pub const STATUS_INTERVAL: u64 = TICKS_PER_SECOND;

const MICROS_PER_TICK: u64 = 1_000_000 / TICKS_PER_SECOND;

/// Whose radio it is, and so which packet becomes of its status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Radio {
    /// A vehicle's, with this system and component: VEHICLE_RADIO to the stations, sealed.
    Vehicle {
        /// The vehicle.
        system_id: u8,
        /// The part of it that answers for the radio.
        component_id: u8,
    },
    /// A ground station's: GCS_RADIO to its program, on the local side.
    Station,
}

/// What an end remembers over a restart: numbers above every counter that it has used or accepted.
pub struct HighWaterMarks<F, const N: usize> {
    /// Above every counter that this end has sealed with.
    pub sent: HighWaterMark<F>,
    /// Above every counter that was accepted of each peer, in the order of the peers.
    pub accepted: [HighWaterMark<F>; N],
}

/// One end of a sealed link with `N` peers. See the [module's documentation](self).
pub struct SealedEndpoint<F, const N: usize, C: Cipher = AesGcm> {
    outward: Egress<F, C>,
    inward: Ingress<F, N, C>,
    radio: RadioPoller,
}

impl<F: NorFlash, const N: usize, C: Cipher> SealedEndpoint<F, N, C> {
    /// The end that seals as `own` and opens what `peers` have sealed, from where `marks` say.
    ///
    /// No packet waits for others for longer than twice `max_delay`, if [`poll`](Endpoint::poll) is called when
    /// [`poll_at`](Endpoint::poll_at) says.
    ///
    /// # Errors
    ///
    /// [`PermitError`]: what is wrong with the keys.
    pub fn new(
        own: &Credential,
        peers: &[Credential; N],
        marks: HighWaterMarks<F, N>,
        radio: Radio,
        max_delay: Duration,
    ) -> Result<Self, PermitError> {
        let HighWaterMarks { sent, accepted } = marks;
        // A mark behind the last counter is as good as the last: it seals nothing, and nothing is newer.
        let first = counter(sent.get());
        let last = |sender| {
            let mut marks = peers.iter().zip(&accepted);
            let mark = marks.find(|(peer, _)| peer.id == sender);
            // The mark itself was never accepted.
            mark.map_or(0, |(_, mark)| counter(mark.get().saturating_sub(1)))
        };
        let opener = Opener::from_credentials(peers, last)?;
        Ok(Self {
            outward: Egress {
                reader: PacketReader::new(Resync::Silence),
                packer: Packer::new(max_delay),
                sealer: Sealer::resume(own.prepare()?, own.id, first),
                mark: sent,
                line: TxBuffer::new(),
                counters: SealedCounters::default(),
            },
            inward: Ingress {
                decoder: hx::Decoder::new(),
                opener,
                peers: peers.each_ref().map(|peer| peer.id),
                marks: accepted,
                line: TxBuffer::new(),
                counters: SealedCounters::default(),
            },
            radio: RadioPoller {
                radio,
                asked: None,
                unanswered: 0,
                sequence: 0,
                answer: None,
            },
        })
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
        let accepted = self.inward.marks.map(HighWaterMark::into_flash);
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
        let Self {
            outward,
            inward,
            radio,
        } = self;
        let now = clock.monotonic();
        let mut taken = 0;
        match side {
            Side::Local => loop {
                let rest = bytes.get(taken..).unwrap_or_default();
                let count = outward.reader.write(rest, now);
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
                    inward.push(*byte, radio, observe);
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
                    let now = clock.monotonic();
                    self.outward.reader.restart_timer(now);
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
        let Self {
            outward,
            inward,
            radio,
        } = self;
        let now = clock.monotonic();
        match (side, event) {
            (Side::Local, LineEvent::Idle) => outward.reader.silent(),
            (Side::Local, _) => outward.reader.fault(now),
            // A frame from the radio ends with a byte of its own.
            (Side::Link, LineEvent::Idle) => {}
            (Side::Link, _) => inward.decoder = hx::Decoder::new(),
        }
        if event == LineEvent::Closed {
            match side {
                Side::Local => inward.drop_packets(observe),
                Side::Link => outward.drop_frame(observe),
            }
        }
        outward.advance(radio, now, observe);
    }

    fn poll_at(&self) -> Option<u64> {
        self.outward.poll_at(&self.radio)
    }

    fn poll(&mut self, clock: &mut impl LinkClock, observe: &mut impl FnMut(SealedEvent)) {
        let now = clock.monotonic();
        if self.outward.line.is_empty() {
            let _ = self.outward.reader.poll(now);
        }
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

/// Bytes that leave one after the other.
struct TxBuffer<const SIZE: usize> {
    bytes: Vec<u8, SIZE>,
    sent: usize,
}

impl<const SIZE: usize> TxBuffer<SIZE> {
    const fn new() -> Self {
        Self {
            bytes: Vec::new(),
            sent: 0,
        }
    }

    fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Adds `bytes`, for which there is room wherever this is called.
    fn put(&mut self, bytes: impl IntoIterator<Item = u8>) {
        for byte in bytes {
            let put = self.bytes.push(byte);
            debug_assert!(put.is_ok(), "there is room");
        }
    }

    fn pending(&self) -> &[u8] {
        self.bytes.get(self.sent..).unwrap_or_default()
    }

    /// Takes note of `count` bytes that have left; whether the last has left with them.
    fn sent(&mut self, count: usize) -> bool {
        self.sent = self.sent.saturating_add(count);
        let left = !self.is_empty() && self.sent >= self.bytes.len();
        if left {
            self.clear();
        }
        left
    }

    fn clear(&mut self) {
        self.bytes.clear();
        self.sent = 0;
    }
}

/// From the local side to the radio.
struct Egress<F, C: Cipher> {
    reader: PacketReader,
    packer: Packer,
    sealer: Sealer<C>,
    mark: HighWaterMark<F>,
    line: TxBuffer<{ hx::MAX_ENCODED_SIZE }>,
    counters: SealedCounters,
}

impl<F: NorFlash, C: Cipher> Egress<F, C> {
    /// Makes the next frame for the radio, or as much of one as there is to make.
    fn advance(
        &mut self,
        radio: &mut RadioPoller,
        now: u64,
        observe: &mut impl FnMut(SealedEvent),
    ) {
        // The frame being sent is the bound on memory: no next one before it has left.
        while self.line.is_empty() && self.step(radio, now, observe) {}
    }

    /// Does one thing; whether there was one to do.
    fn step(
        &mut self,
        radio: &mut RadioPoller,
        now: u64,
        observe: &mut impl FnMut(SealedEvent),
    ) -> bool {
        let since = Duration::from_micros(now.saturating_mul(MICROS_PER_TICK));
        if let Some(message) = self.packer.poll(since) {
            self.seal(&message, observe);
            return true;
        }
        if let Some(request) = radio.ask(now) {
            if let Ok(frame) = hx::Frame::new(hx::FrameKind::Radio, &request.to_wire()) {
                self.line.put(frame.encode());
            }
            return true;
        }
        let told = radio.vehicle();
        let packed = match &told {
            Some(packet) => Ok(&packet[..]),
            None => match self.reader.read() {
                Some(Ok(packet)) => Ok(packet.as_bytes()),
                Some(Err(error)) => Err(error.into()),
                None => {
                    self.counters.set_dropped(self.reader.dropped());
                    return false;
                }
            },
        };
        let packed = packed.and_then(|packet| Ok(self.packer.push(packet, since)?));
        match packed {
            Ok(full) => {
                self.counters.count_packet();
                observe(SealedEvent::Packed);
                if let Some(message) = full {
                    self.seal(&message, observe);
                }
            }
            Err(rejection) => self.reject(rejection, observe),
        }
        true
    }

    /// When there will be something to do that no byte brings.
    fn poll_at(&self, radio: &RadioPoller) -> Option<u64> {
        if !self.line.is_empty() {
            return None;
        }
        let full = self.packer.poll_at().map(|at| {
            let micros = u64::try_from(at.as_micros()).unwrap_or(u64::MAX);
            micros.div_ceil(MICROS_PER_TICK)
        });
        let deadlines = [self.reader.due_at(), full, Some(radio.ask_at())];
        deadlines.into_iter().flatten().min()
    }

    fn seal(&mut self, message: &Plaintext, observe: &mut impl FnMut(SealedEvent)) {
        match self.try_seal(message) {
            Ok(counter) => {
                self.counters.count_package();
                observe(SealedEvent::Sealed(counter));
            }
            Err(rejection) => self.reject(rejection, observe),
        }
    }

    /// Puts the package on the line; gives its counter.
    fn try_seal(&mut self, message: &Plaintext) -> Result<u32, SealedRejectReason> {
        let counter = self.sealer.next_counter();
        let counter = counter.ok_or(SealedRejectReason::CounterExhausted)?;
        self.mark.reserve(counter.into(), SENT_RESERVATION)?;
        let package = self.sealer.seal(message)?;
        self.line.put(hx::Frame::from(&package).encode());
        Ok(counter)
    }

    fn drop_frame(&mut self, observe: &mut impl FnMut(SealedEvent)) {
        if !self.line.is_empty() {
            self.line.clear();
            self.reject(SealedRejectReason::LineClosed, observe);
        }
    }

    fn reject(&mut self, rejection: SealedRejectReason, observe: &mut impl FnMut(SealedEvent)) {
        self.counters.count_rejected(rejection);
        observe(SealedEvent::Rejected(Direction::Outbound, rejection));
    }
}

/// From the radio to the local side.
struct Ingress<F, const N: usize, C: Cipher> {
    decoder: hx::Decoder,
    opener: Opener<N, C>,
    peers: [SenderId; N],
    marks: [HighWaterMark<F>; N],
    line: TxBuffer<{ field::PLAINTEXT_SIZE }>,
    counters: SealedCounters,
}

impl<F: NorFlash, const N: usize, C: Cipher> Ingress<F, N, C> {
    fn drop_packets(&mut self, observe: &mut impl FnMut(SealedEvent)) {
        if !self.line.is_empty() {
            self.line.clear();
            let rejection = SealedRejectReason::LineClosed;
            self.counters.count_rejected(rejection);
            observe(SealedEvent::Rejected(Direction::Inbound, rejection));
        }
    }

    /// Takes the next byte.
    fn push(&mut self, byte: u8, radio: &mut RadioPoller, observe: &mut impl FnMut(SealedEvent)) {
        let Self {
            decoder,
            opener,
            peers,
            marks,
            line,
            counters,
        } = self;
        let mut reject = |rejection| {
            counters.count_rejected(rejection);
            observe(SealedEvent::Rejected(Direction::Inbound, rejection));
        };
        let frame = match decoder.push(byte) {
            None => return,
            Some(Ok(frame)) => frame,
            Some(Err(error)) => return reject(error.into()),
        };
        if frame.kind() == hx::FrameKind::Radio {
            match radio.take(frame.payload()) {
                Ok(status) => observe(SealedEvent::Radio(status)),
                Err(rejection) => return reject(rejection),
            }
            if let Some(packet) = radio.station() {
                line.put(packet);
            }
            return;
        }
        let opened = opener
            .open(frame.payload())
            .map_err(SealedRejectReason::from);
        let opened = opened.and_then(|opened| {
            let mut marks = peers.iter().zip(marks);
            let mark = marks.find(|(peer, _)| **peer == opened.sender());
            let (_, mark) = mark.ok_or(SealedRejectReason::UnknownSender)?;
            mark.reserve(opened.counter().into(), ACCEPTED_RESERVATION)?;
            Ok(opened)
        });
        let opened = match opened {
            Ok(opened) => opened,
            Err(rejection) => return reject(rejection),
        };
        counters.count_package();
        observe(SealedEvent::Opened(opened.sender()));
        for packet in opened.packets() {
            match packet {
                Ok(packet) => {
                    counters.count_packet();
                    line.put(packet.iter().copied());
                }
                Err(error) => {
                    let rejection = error.into();
                    counters.count_rejected(rejection);
                    observe(SealedEvent::Rejected(Direction::Inbound, rejection));
                }
            }
        }
    }
}

/// What is asked of the radio, and what becomes of the answer.
struct RadioPoller {
    radio: Radio,
    /// When it was last asked, in ticks.
    asked: Option<u64>,
    /// Questions that it has not answered.
    unanswered: u8,
    /// Of the packets that are made from answers.
    sequence: u8,
    /// What is to be handed on.
    answer: Option<Status>,
}

impl RadioPoller {
    /// When it is time for the question.
    fn ask_at(&self) -> u64 {
        let next = |asked: u64| asked.saturating_add(STATUS_INTERVAL);
        self.asked.map_or(0, next)
    }

    /// The question, when it is time for it.
    fn ask(&mut self, now: u64) -> Option<Request> {
        if now < self.ask_at() {
            return None;
        }
        self.asked = Some(now);
        self.unanswered = self.unanswered.saturating_add(1);
        Some(Request::Status)
    }

    /// Takes what the radio says: an answer for each question, so that a radio cannot fill the air with
    /// them.
    fn take(&mut self, bytes: &[u8]) -> Result<Status, SealedRejectReason> {
        let answer = Answer::from_wire(bytes)?;
        self.unanswered = self
            .unanswered
            .checked_sub(1)
            .ok_or(SealedRejectReason::NotAsked)?;
        self.answer = Some(*answer.status());
        Ok(*answer.status())
    }

    /// What a vehicle has to tell of its radio.
    fn vehicle(&mut self) -> Option<[u8; RADIO_PACKET_SIZE]> {
        let Radio::Vehicle {
            system_id,
            component_id,
        } = self.radio
        else {
            return None;
        };
        let status = self.answer.take()?;
        Some(status.vehicle_radio(self.next(), system_id, component_id))
    }

    /// What a station has to tell of its radio.
    fn station(&mut self) -> Option<[u8; RADIO_PACKET_SIZE]> {
        if self.radio != Radio::Station {
            return None;
        }
        let status = self.answer.take()?;
        Some(status.gcs_radio(self.next()))
    }

    fn next(&mut self) -> u8 {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        sequence
    }
}
