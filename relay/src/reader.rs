//! Packets out of the bytes of a line: what both kinds of endpoint do with what comes in.

use mavlink_signing::{DecodeError, Decoder, Packet, Resync, TICKS_PER_SECOND, dialect};

/// Silence on a line after which a packet that has begun is given up, unless
/// [said otherwise](crate::Relay::idle): 100 milliseconds, in ticks of 10 microseconds.
pub const IDLE: u64 = TICKS_PER_SECOND / 10;

/// What becomes of bytes that come in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Intake {
    /// They go to the decoder.
    Open,
    /// They wait: what the decoder holds goes no further, and has not been read to its end yet.
    Ended,
    /// They are dropped: they may be the rest of a payload.
    Deaf,
}

/// Packets out of bytes, silence, and faults of the line.
#[derive(Debug)]
pub(crate) struct PacketReader {
    decoder: Decoder,
    intake: Intake,
    /// Bytes that came while it was deaf.
    unheard: u32,
    /// Ticks of silence that end a packet.
    idle: u64,
    /// The last tick that is no silence yet; [`NEVER`] when nothing has come since the last silence.
    heard_until: u64,
}

/// After all ticks.
const NEVER: u64 = u64::MAX;

impl PacketReader {
    pub(crate) const fn new(resync: Resync) -> Self {
        Self {
            decoder: Decoder::new(resync, dialect::crc_extra),
            intake: Intake::Open,
            unheard: 0,
            idle: IDLE,
            heard_until: NEVER,
        }
    }

    pub(crate) const fn set_idle(&mut self, ticks: u64) {
        self.idle = ticks;
    }

    /// Bytes that [`PacketReader::write`] takes.
    pub(crate) fn room(&self) -> usize {
        match self.intake {
            Intake::Open => self.decoder.room(),
            Intake::Ended => 0,
            Intake::Deaf => usize::MAX,
        }
    }

    /// Takes bytes that came in at `now`, as many as there is room for.
    pub(crate) fn write(&mut self, bytes: &[u8], now: u64) -> usize {
        if bytes.is_empty() {
            return 0;
        }
        self.hear(now);
        match self.intake {
            Intake::Open => self.decoder.write(bytes),
            Intake::Ended => 0,
            Intake::Deaf => {
                self.unheard = self.unheard.saturating_add(bytes.len() as u32);
                bytes.len()
            }
        }
    }

    /// The next packet that has arrived.
    pub(crate) fn read(&mut self) -> Option<Result<Packet<'_>, DecodeError>> {
        let found = self.decoder.read();
        if found.is_none() && self.intake == Intake::Ended {
            self.intake = Intake::Open;
        }
        found
    }

    /// Bytes that belonged to no packet.
    pub(crate) const fn dropped(&self) -> u32 {
        self.decoder.dropped().saturating_add(self.unheard)
    }

    const fn hear(&mut self, now: u64) {
        self.heard_until = now.saturating_add(self.idle);
    }

    /// Begins to measure silence at `now`: what came before, the sender may have held back.
    pub(crate) const fn restart_idle_timer(&mut self, now: u64) {
        if self.heard_until != NEVER {
            self.hear(now);
        }
    }

    /// When the line will have been silent for long.
    pub(crate) fn idle_at(&self) -> Option<u64> {
        self.heard_until.checked_add(1)
    }

    /// The line has been silent for long. To be [read](PacketReader::read) to the end.
    pub(crate) const fn silent(&mut self) {
        self.heard_until = NEVER;
        self.give_up(Intake::Ended);
    }

    /// Bytes of what has begun were lost, inserted or changed. To be [read](PacketReader::read) to the end.
    pub(crate) const fn fault(&mut self) {
        self.give_up(Intake::Ended);
    }

    /// The same at `now`, where bytes are trusted because of where they come from: what follows is not heard before
    /// the line has been silent for long.
    pub(crate) const fn deafen(&mut self, now: u64) {
        self.hear(now);
        self.give_up(Intake::Deaf);
    }

    const fn give_up(&mut self, intake: Intake) {
        self.decoder.idle();
        self.intake = intake;
    }
}
