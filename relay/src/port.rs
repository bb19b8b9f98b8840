//! What both kinds of link do with a port: read packets from it, and write to it, without waiting.

use core::fmt;

use embedded_io::{Read, ReadReady, Write, WriteReady};
use mavlink_signing::{DecodeError, Decoder, Packet, Resync, dialect};

/// Bytes read at most in one poll.
pub(crate) const READ_SIZE: usize = 64;

/// Which of a direction's two ports failed, and with what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PortError<Input, Output> {
    /// The port that is read failed.
    Input(Input),
    /// The port that is written failed.
    Output(Output),
    /// The port that is read said that it was ready, and gave nothing: it has ended.
    InputClosed,
    /// The port that is written said that it was ready, and took nothing.
    OutputClosed,
}

impl<Input: fmt::Display, Output: fmt::Display> fmt::Display for PortError<Input, Output> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input(error) => write!(f, "cannot read: {error}"),
            Self::Output(error) => write!(f, "cannot write: {error}"),
            Self::InputClosed => f.write_str("the port gives no more bytes"),
            Self::OutputClosed => f.write_str("the port takes no more bytes"),
        }
    }
}

impl<Input, Output> core::error::Error for PortError<Input, Output>
where
    Input: fmt::Debug + fmt::Display,
    Output: fmt::Debug + fmt::Display,
{
}

/// Writes what is left of `bytes`, of which `sent` have left, as far as the port takes it; whether any
/// byte left.
pub(crate) fn send<InputError, Output: Write + WriteReady>(
    output: &mut Output,
    bytes: &[u8],
    sent: &mut usize,
) -> Result<bool, PortError<InputError, Output::Error>> {
    let mut moved = false;
    loop {
        let rest = bytes.get(*sent..).unwrap_or_default();
        if rest.is_empty() || !output.write_ready().map_err(PortError::Output)? {
            return Ok(moved);
        }
        match output.write(rest).map_err(PortError::Output)? {
            0 => return Err(PortError::OutputClosed),
            written => *sent += written,
        }
        moved = true;
    }
}

/// Packets out of a port.
#[derive(Debug)]
pub(crate) struct PacketReader {
    decoder: Decoder,
    /// When the line was last not silent, in ticks of the timer; `None` when nothing has come since it was.
    heard: Option<u64>,
}

impl PacketReader {
    pub(crate) const fn new(resync: Resync) -> Self {
        Self {
            decoder: Decoder::new(resync, dialect::crc_extra),
            heard: None,
        }
    }

    /// The next packet that has arrived.
    pub(crate) fn read(&mut self) -> Option<Result<Packet<'_>, DecodeError>> {
        self.decoder.read()
    }

    /// Bytes that belonged to no packet.
    pub(crate) const fn dropped(&self) -> u32 {
        self.decoder.dropped()
    }

    /// Notes that the port was not read until `now`: what came meanwhile, the sender may have held
    /// back, and that is no silence.
    pub(crate) fn restart_idle_timer(&mut self, now: u64) {
        self.heard = self.heard.map(|_| now);
    }

    /// Reads what has arrived, or notices that nothing has for more than `idle` ticks; whether there is
    /// more to do. To be called when [`PacketReader::read`] has nothing more.
    pub(crate) fn receive<Input: Read + ReadReady, OutputError>(
        &mut self,
        input: &mut Input,
        idle: u64,
        now: u64,
    ) -> Result<bool, PortError<Input::Error, OutputError>> {
        if input.read_ready().map_err(PortError::Input)? {
            let mut bytes = [0; READ_SIZE];
            // The decoder has been read to its end, so there is room for at least one byte.
            let room = self.decoder.room().min(READ_SIZE);
            let slots = bytes.get_mut(..room).unwrap_or_default();
            let count = input.read(slots).map_err(PortError::Input)?;
            if count == 0 {
                return Err(PortError::InputClosed);
            }
            self.decoder.write(bytes.get(..count).unwrap_or_default());
            self.heard = Some(now);
            return Ok(true);
        }
        let silent = |heard| now.saturating_sub(heard) > idle;
        if self.heard.is_some_and(silent) {
            self.heard = None;
            self.decoder.idle();
            return Ok(true);
        }
        Ok(false)
    }
}
