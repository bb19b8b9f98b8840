//! One direction: bytes in, packets treated, frames out, without waiting.

use core::fmt;

use embedded_io::{Read, ReadReady, Write, WriteReady};
use mavlink_signing::{Decoder, Frame, Profile, SigningKey, Timestamp, dialect};

use crate::direction::Treat;
use crate::event::{Counters, Event};
use crate::{Clock, IDLE};

/// Bytes read at most in one poll.
const READ_SIZE: usize = 64;

/// Which of a direction's two ports failed, and with what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PortError<Input, Output> {
    /// The port that is read.
    Input(Input),
    /// The port that is written.
    Output(Output),
    /// The port that is written said that it was ready, and took nothing.
    Closed,
}

impl<Input: fmt::Display, Output: fmt::Display> fmt::Display for PortError<Input, Output> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input(error) => write!(f, "cannot read: {error}"),
            Self::Output(error) => write!(f, "cannot write: {error}"),
            Self::Closed => f.write_str("the port takes no more bytes"),
        }
    }
}

impl<Input, Output> core::error::Error for PortError<Input, Output>
where
    Input: fmt::Debug + fmt::Display,
    Output: fmt::Debug + fmt::Display,
{
}

/// A direction of the relay.
#[derive(Debug)]
pub(crate) struct Pump<T> {
    decoder: Decoder,
    treat: T,
    sending: Option<Sending>,
    heard: Option<Timestamp>,
    counters: Counters,
}

/// A frame of which `sent` bytes have left.
#[derive(Debug)]
struct Sending {
    frame: Frame,
    sent: usize,
}

impl<T: Treat> Pump<T> {
    pub(crate) fn new(treat: T) -> Self {
        Self {
            decoder: Decoder::new(dialect::crc_extra),
            treat,
            sending: None,
            heard: None,
            counters: Counters::default(),
        }
    }

    pub(crate) const fn counters(&self) -> &Counters {
        &self.counters
    }

    pub(crate) fn poll<P: Profile, Input: Read + ReadReady, Output: Write + WriteReady>(
        &mut self,
        input: &mut Input,
        output: &mut Output,
        key: &SigningKey<P>,
        clock: &mut impl Clock,
        observe: &mut impl FnMut(Event),
    ) -> Result<bool, PortError<Input::Error, Output::Error>> {
        let sent = self.send(output).map_err(|error| match error {
            Some(error) => PortError::Output(error),
            None => PortError::Closed,
        })?;
        // The frame being sent is the bound on memory: no next one before it has left.
        if self.sending.is_some() {
            return Ok(sent);
        }
        let now = clock.now();
        if self.treat_next(key, now, observe) {
            return Ok(true);
        }
        let read = self.receive(input, now).map_err(PortError::Input)?;
        Ok(sent || read)
    }

    /// Writes what is left of the frame being sent; whether any byte left. A port that is ready
    /// and yet takes nothing is an error without one of its own.
    fn send<Output: Write + WriteReady>(
        &mut self,
        output: &mut Output,
    ) -> Result<bool, Option<Output::Error>> {
        let mut moved = false;
        while let Some(sending) = &mut self.sending {
            let rest = sending
                .frame
                .as_bytes()
                .get(sending.sent..)
                .unwrap_or_default();
            if rest.is_empty() {
                self.sending = None;
            } else if !output.write_ready()? {
                break;
            } else {
                let written = output.write(rest)?;
                if written == 0 {
                    return Err(None);
                }
                sending.sent += written;
                moved = true;
            }
        }
        Ok(moved)
    }

    /// Looks at the next packet that has arrived; whether there was one.
    fn treat_next<P: Profile>(
        &mut self,
        key: &SigningKey<P>,
        now: Timestamp,
        observe: &mut impl FnMut(Event),
    ) -> bool {
        let Some(decoded) = self.decoder.read() else {
            return false;
        };
        let treated = match decoded {
            Ok(packet) => self.treat.treat(packet, key, now),
            Err(error) => Err(error.into()),
        };
        match treated {
            Ok(frame) => {
                self.sending = Some(Sending { frame, sent: 0 });
                self.counters.count_passed();
                observe(Event::Passed(T::DIRECTION));
            }
            Err(refusal) => {
                self.counters.count_refused(refusal);
                observe(Event::Refused(T::DIRECTION, refusal));
            }
        }
        true
    }

    /// Reads what has arrived, or notices that nothing has for long; whether there is more to do.
    fn receive<Input: Read + ReadReady>(
        &mut self,
        input: &mut Input,
        now: Timestamp,
    ) -> Result<bool, Input::Error> {
        let mut bytes = [0; READ_SIZE];
        let room = self.decoder.room().min(READ_SIZE);
        let slots = bytes.get_mut(..room).unwrap_or_default();
        let count = if input.read_ready()? {
            input.read(slots)?
        } else {
            0
        };
        if count > 0 {
            self.decoder.write(bytes.get(..count).unwrap_or_default());
            self.heard = Some(now);
        } else if self
            .heard
            .is_some_and(|heard| now.ticks_since(heard) > IDLE)
        {
            self.heard = None;
            self.decoder.idle();
            return Ok(true);
        }
        Ok(count > 0)
    }
}
