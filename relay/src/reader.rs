//! Packets out of the bytes of a line: what both kinds of endpoint do with what comes in.

use heapless::Deque;
use mavlink_signing::{
    DecodeError, Decoder, Packet, Resync, TICKS_PER_SECOND, dialect, field::MAX_FRAME_SIZE,
};

/// How long a sender may pause within a packet, unless [said otherwise](crate::Relay::idle): 100 milliseconds, in ticks
/// of 10 microseconds.
pub const IDLE: u64 = TICKS_PER_SECOND / 10;

/// Bytes a second that a line carries, unless [said otherwise](crate::Relay::line_rate): those of 57,600 baud.
pub const LINE_RATE: u32 = 5_760;

/// Into how many parts the time of a packet is divided, at whose ends arrivals are noted.
const PARTS: u64 = 8;
/// Arrivals that are noted: those of a whole packet's time, and some to spare.
const ARRIVALS: usize = PARTS as usize + 3;

/// Packets out of bytes, silence, and faults of the line.
///
/// The local side ([`Resync::Silence`]) knows silence alone: it ends deafness, and nothing else. The link side
/// ([`Resync::NextByte`]) gives a packet up that has not come within the time that its bytes take, and [`IDLE`], from
/// its first byte on. So nobody can hold up what comes behind for longer.
#[derive(Debug)]
pub(crate) struct PacketReader {
    decoder: Decoder,
    resync: Resync,
    /// Ticks that a sender may pause within a packet.
    idle: u64,
    /// Ticks that the longest packet takes on the line.
    longest: u64,
    /// Bytes that have come, modulo 2^32, and when the last did.
    heard: u32,
    last: u64,
    /// After how many bytes, and when, more came.
    arrivals: Deque<(u32, u64), ARRIVALS>,
}

impl PacketReader {
    pub(crate) fn new(resync: Resync) -> Self {
        let mut reader = Self {
            decoder: Decoder::new(resync, dialect::crc_extra),
            resync,
            idle: IDLE,
            longest: 0,
            heard: 0,
            last: 0,
            arrivals: Deque::new(),
        };
        reader.set_line_rate(LINE_RATE);
        reader
    }

    pub(crate) const fn set_idle(&mut self, ticks: u64) {
        self.idle = ticks;
    }

    /// `rate` in bytes a second.
    pub(crate) fn set_line_rate(&mut self, rate: u32) {
        let longest = TICKS_PER_SECOND * MAX_FRAME_SIZE as u64;
        self.longest = longest.div_ceil(u64::from(rate.max(1)));
    }

    /// Bytes that [`PacketReader::write`] takes.
    pub(crate) fn room(&self) -> usize {
        self.decoder.room()
    }

    /// Takes bytes that came in at `now`, as many as there is room for.
    pub(crate) fn write(&mut self, bytes: &[u8], now: u64) -> usize {
        if !bytes.is_empty() {
            self.last = now;
        }
        let count = self.decoder.write(bytes);
        if count > 0 {
            self.arrived(now);
            self.heard = self.heard.wrapping_add(count as u32);
        }
        count
    }

    fn arrived(&mut self, now: u64) {
        if self.resync == Resync::Silence {
            return;
        }
        let noted = self.arrivals.back();
        if noted.is_some_and(|(_, time)| now.saturating_sub(*time) < self.part()) {
            return;
        }
        if self.arrivals.is_full() {
            self.arrivals.pop_front();
        }
        let _ = self.arrivals.push_back((self.heard, now));
    }

    /// The ticks within which arrivals are not told apart.
    const fn part(&self) -> u64 {
        (self.longest + self.idle) / PARTS + 1
    }

    /// The next packet that has arrived.
    pub(crate) fn read(&mut self) -> Option<Result<Packet<'_>, DecodeError>> {
        self.decoder.read()
    }

    /// Whether bytes are dropped until the line is silent.
    pub(crate) fn is_deaf(&self) -> bool {
        self.decoder.is_deaf()
    }

    /// Bytes that belonged to no packet.
    pub(crate) const fn dropped(&self) -> u32 {
        self.decoder.dropped()
    }

    /// Until `now`, what has come in was not read: the sender may have held back what it has begun, and where the place
    /// is lost is found only now. Time begins anew, also that of a silence.
    pub(crate) fn restart_timer(&mut self, now: u64) {
        self.last = now;
        self.arrivals.clear();
        let (begun, _) = self.decoder.begun();
        let before = self.heard.wrapping_sub(begun as u32);
        let _ = self.arrivals.push_back((before, now));
    }

    /// When time changes something, unless more bytes come: a deaf side hears again, or a packet that has begun is given
    /// up. While the reader is `blocked`, what has come in waits to be read, and time stands still for it.
    pub(crate) fn due_at(&self, blocked: bool) -> Option<u64> {
        if self.resync == Resync::Silence {
            let deaf = self.decoder.is_deaf();
            return deaf.then(|| self.last.saturating_add(self.idle).saturating_add(1));
        }
        let (begun, announced) = self.decoder.begun();
        if begun == 0 || blocked {
            return None;
        }
        // The time of the noted arrival that the first byte came with, or after.
        let first = self.heard.wrapping_sub(begun as u32);
        let distance =
            |count: u32| self.heard.wrapping_sub(count) >= self.heard.wrapping_sub(first);
        let before = self
            .arrivals
            .iter()
            .rev()
            .find(|(count, _)| distance(*count));
        let (_, came) = before.or_else(|| self.arrivals.front())?;
        let takes = self.longest * announced as u64 / MAX_FRAME_SIZE as u64;
        Some(came.saturating_add(takes + self.idle + self.part()))
    }

    /// Does what is due at `now`; whether there was something. To be [read](PacketReader::read) to the end, and asked
    /// again.
    pub(crate) fn poll(&mut self, now: u64, blocked: bool) -> bool {
        let due = self.due_at(blocked).is_some_and(|at| now >= at);
        if due {
            match self.resync {
                Resync::Silence => self.decoder.idle(),
                Resync::NextByte => self.decoder.give_up(),
            }
        }
        due
    }

    /// The line has been silent for long. To be [read](PacketReader::read) to the end.
    pub(crate) fn silent(&mut self) {
        self.decoder.idle();
    }

    /// Bytes of what has begun were lost, inserted or changed. To be [read](PacketReader::read) to the end.
    pub(crate) fn fault(&mut self, now: u64) {
        self.last = now;
        self.decoder.fault();
    }
}
