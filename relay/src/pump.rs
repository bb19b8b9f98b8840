//! One direction: bytes in, packets treated, frames out, without waiting.

use embedded_io::{Read, ReadReady, Write, WriteReady};
use mavlink_signing::{Frame, FrameRef, Keys, Profile};

use crate::direction::Treat;
use crate::event::{Counters, Event, Offender};
use crate::port::{Intake, PortError, send};
use crate::{Clock, Link};

/// A direction of the relay.
#[derive(Debug)]
pub(crate) struct Pump<T> {
    intake: Intake,
    treat: T,
    sending: Option<Sending>,
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
            intake: Intake::new(T::RESYNC),
            treat,
            sending: None,
            counters: Counters::default(),
        }
    }

    /// The same direction, which treats packets otherwise from now on.
    pub(crate) fn map<U: Treat>(self, change: impl FnOnce(T) -> U) -> Pump<U> {
        Pump {
            intake: self.intake,
            treat: change(self.treat),
            sending: self.sending,
            counters: self.counters,
        }
    }

    /// One turn; whether there is more to do at once.
    pub(crate) fn poll<P: Profile, Input: Read + ReadReady, Output: Write + WriteReady>(
        &mut self,
        input: &mut Input,
        output: &mut Output,
        link: &mut Link<P>,
        clock: &mut impl Clock,
        observe: &mut impl FnMut(Event),
    ) -> Result<bool, PortError<Input::Error, Output::Error>> {
        let now = clock.timer();
        let sent = self.send(output)?;
        if sent || self.sending.is_some() {
            self.intake.not_read(now);
        }
        // The frame being sent is the bound on memory: no next one before it has left.
        if self.sending.is_some() {
            return Ok(sent);
        }
        if self.treat_next(&mut link.keys, clock, observe) {
            return Ok(true);
        }
        let received = self.intake.receive(input, link.idle, now)?;
        Ok(sent || received)
    }

    /// Writes what is left of the frame being sent; whether any byte left.
    fn send<InputError, Output: Write + WriteReady>(
        &mut self,
        output: &mut Output,
    ) -> Result<bool, PortError<InputError, Output::Error>> {
        let Some(Sending { frame, sent }) = &mut self.sending else {
            return Ok(false);
        };
        let moved = send(output, frame.as_bytes(), sent)?;
        if *sent >= frame.as_bytes().len() {
            self.sending = None;
        }
        Ok(moved)
    }

    /// Looks at the next packet that has arrived; whether there was one.
    fn treat_next<P: Profile>(
        &mut self,
        keys: &mut Keys<P>,
        clock: &mut impl Clock,
        observe: &mut impl FnMut(Event),
    ) -> bool {
        let decoded = self.intake.read();
        let treated = decoded.map(|decoded| match decoded {
            Ok(packet) => {
                let treated = self.treat.treat(packet, keys, clock);
                treated.map_err(|refusal| (refusal, Some(Offender::new(&packet, refusal))))
            }
            Err(error) => Err((error.into(), None)),
        });
        self.counters.set_dropped(self.intake.dropped());
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
}
