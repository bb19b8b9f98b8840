//! One direction: bytes in, packets treated, frames out, without waiting.

use core::fmt;

use embedded_io::{Read, ReadReady, Write, WriteReady};
use mavlink_signing::{Decoder, Frame, FrameRef, Keys, Profile, Timekeeper, Timestamp, dialect};

use crate::Link;
use crate::direction::Treat;
use crate::event::{Counters, Event, Offender};

/// Bytes read at most in one poll.
const READ_SIZE: usize = 64;

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

/// A direction of the relay.
#[derive(Debug)]
pub(crate) struct Pump<T> {
    decoder: Decoder,
    treat: T,
    sending: Option<Sending>,
    /// When the line was last not silent; `None` when nothing has come since it was.
    heard: Option<Timestamp>,
    counters: Counters,
}

/// A frame of which `sent` bytes have left.
#[derive(Debug)]
struct Sending {
    frame: Frame,
    sent: usize,
}

impl<T> Pump<T> {
    pub(crate) const fn counters(&self) -> &Counters {
        &self.counters
    }

    pub(crate) const fn treat_mut(&mut self) -> &mut T {
        &mut self.treat
    }

    /// The frame of which no byte has left: every frame is here when a turn has ended in which it was
    /// made.
    pub(crate) fn unsent(&self) -> Option<FrameRef<'_>> {
        let sending = self.sending.as_ref().filter(|sending| sending.sent == 0)?;
        FrameRef::parse(sending.frame.as_bytes()).ok()
    }
}

impl<T: Treat> Pump<T> {
    pub(crate) fn new(treat: T) -> Self {
        Self {
            decoder: Decoder::new(T::RESYNC, dialect::crc_extra),
            treat,
            sending: None,
            heard: None,
            counters: Counters::default(),
        }
    }

    /// The same direction, which treats packets otherwise from now on.
    pub(crate) fn map<U: Treat>(self, change: impl FnOnce(T) -> U) -> Pump<U> {
        Pump {
            decoder: self.decoder,
            treat: change(self.treat),
            sending: self.sending,
            heard: self.heard,
            counters: self.counters,
        }
    }

    /// One turn; whether there is more to do at once.
    pub(crate) fn poll<P: Profile, Input: Read + ReadReady, Output: Write + WriteReady>(
        &mut self,
        input: &mut Input,
        output: &mut Output,
        link: &mut Link<P>,
        clock: &mut impl Timekeeper,
        observe: &mut impl FnMut(Event),
    ) -> Result<bool, PortError<Input::Error, Output::Error>> {
        let now = clock.now();
        let sent = self.send(output)?;
        if sent || self.sending.is_some() {
            // What was not read meanwhile, the sender may have held back: that is no silence.
            self.heard = self.heard.map(|_| now);
        }
        // The frame being sent is the bound on memory: no next one before it has left.
        if self.sending.is_some() {
            return Ok(sent);
        }
        if self.treat_next(&mut link.keys, clock, observe) {
            return Ok(true);
        }
        let received = self.receive(input, link.idle, now)?;
        Ok(sent || received)
    }

    /// Writes what is left of the frame being sent; whether any byte left.
    fn send<InputError, Output: Write + WriteReady>(
        &mut self,
        output: &mut Output,
    ) -> Result<bool, PortError<InputError, Output::Error>> {
        let mut moved = false;
        while let Some(sending) = &mut self.sending {
            let rest = sending
                .frame
                .as_bytes()
                .get(sending.sent..)
                .unwrap_or_default();
            if rest.is_empty() {
                self.sending = None;
            } else if !output.write_ready().map_err(PortError::Output)? {
                break;
            } else {
                match output.write(rest).map_err(PortError::Output)? {
                    0 => return Err(PortError::OutputClosed),
                    written => sending.sent += written,
                }
                moved = true;
            }
        }
        Ok(moved)
    }

    /// Looks at the next packet that has arrived; whether there was one.
    fn treat_next<P: Profile>(
        &mut self,
        keys: &mut Keys<P>,
        clock: &mut impl Timekeeper,
        observe: &mut impl FnMut(Event),
    ) -> bool {
        let decoded = self.decoder.read();
        let treated = decoded.map(|decoded| match decoded {
            Ok(packet) => {
                let treated = self.treat.treat(packet, keys, clock);
                treated.map_err(|refusal| (refusal, Some(Offender::new(&packet, refusal))))
            }
            Err(error) => Err((error.into(), None)),
        });
        self.counters.set_dropped(self.decoder.dropped());
        match treated {
            None => return false,
            Some(Ok((frame, event))) => {
                self.sending = Some(Sending { frame, sent: 0 });
                self.counters.count_passed(event);
                observe(event);
            }
            Some(Err((refusal, offender))) => {
                self.counters.count_refused(refusal, offender);
                observe(Event::Refused(T::DIRECTION, refusal));
            }
        }
        true
    }

    /// Reads what has arrived, or notices that nothing has for long; whether there is more to do.
    fn receive<Input: Read + ReadReady, OutputError>(
        &mut self,
        input: &mut Input,
        idle: u64,
        now: Timestamp,
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
        let silent = |heard| now.ticks_since(heard) > idle;
        if self.heard.is_some_and(silent) {
            self.heard = None;
            self.decoder.idle();
            return Ok(true);
        }
        Ok(false)
    }
}
