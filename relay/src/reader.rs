//! Packets out of the bytes of a line: what both kinds of endpoint do with what comes in.

use mavlink_signing::{DecodeError, Decoder, Packet, Resync, TICKS_PER_SECOND, dialect};

/// Silence on a line after which a packet that has begun is given up, unless
/// [said otherwise](crate::Relay::idle): 100 milliseconds, in ticks of 10 microseconds.
pub const IDLE: u64 = TICKS_PER_SECOND / 10;

/// Packets out of bytes, silence, and faults of the line.
#[derive(Debug)]
pub(crate) struct PacketReader {
    decoder: Decoder,
    /// Ticks of silence that end a packet.
    idle: u64,
    /// When the line was last not silent; `None` when nothing has come since it was.
    heard: Option<u64>,
    /// What the decoder holds goes no further, and nothing may be appended to it: it has not been read to its end
    /// since.
    ended: bool,
    /// What comes in is trusted because of where it comes from. So a fault makes the reader deaf: what follows may be
    /// the rest of a payload.
    trusted: bool,
    deaf: bool,
    /// Bytes that came while it was deaf.
    unheard: u32,
}

impl PacketReader {
    pub(crate) const fn new(resync: Resync) -> Self {
        Self {
            decoder: Decoder::new(resync, dialect::crc_extra),
            idle: IDLE,
            heard: None,
            ended: false,
            trusted: matches!(resync, Resync::AnnouncedEnd),
            deaf: false,
            unheard: 0,
        }
    }

    pub(crate) const fn set_idle(&mut self, ticks: u64) {
        self.idle = ticks;
    }

    /// Bytes that [`PacketReader::write`] takes.
    pub(crate) fn room(&self) -> usize {
        if self.deaf {
            usize::MAX
        } else if self.ended {
            0
        } else {
            self.decoder.room()
        }
    }

    /// Takes bytes that came in at `now`, as many as there is room for.
    pub(crate) fn write(&mut self, bytes: &[u8], now: u64) -> usize {
        if bytes.is_empty() {
            return 0;
        }
        self.heard = Some(now);
        if self.deaf {
            self.unheard = self.unheard.saturating_add(bytes.len() as u32);
            bytes.len()
        } else if self.ended {
            0
        } else {
            self.decoder.write(bytes)
        }
    }

    /// The next packet that has arrived.
    pub(crate) fn read(&mut self) -> Option<Result<Packet<'_>, DecodeError>> {
        let found = self.decoder.read();
        if found.is_none() {
            self.ended = false;
        }
        found
    }

    /// Bytes that belonged to no packet.
    pub(crate) const fn dropped(&self) -> u32 {
        self.decoder.dropped().saturating_add(self.unheard)
    }

    /// Begins to measure silence at `now`: what came before, the sender may have held back.
    pub(crate) fn restart_idle_timer(&mut self, now: u64) {
        self.heard = self.heard.map(|_| now);
    }

    /// When the line will have been silent for long.
    pub(crate) fn idle_at(&self) -> Option<u64> {
        let heard = self.heard?;
        Some(heard.saturating_add(self.idle).saturating_add(1))
    }

    /// The line has been silent for long. To be [read](PacketReader::read) to the end.
    pub(crate) const fn silent(&mut self) {
        self.give_up();
        self.heard = None;
        self.deaf = false;
    }

    /// Bytes were lost, inserted or changed at `now`. To be [read](PacketReader::read) to the end.
    pub(crate) const fn fault(&mut self, now: u64) {
        self.give_up();
        if self.trusted {
            self.heard = Some(now);
            self.deaf = true;
        }
    }

    const fn give_up(&mut self) {
        self.decoder.idle();
        self.ended = true;
    }
}
