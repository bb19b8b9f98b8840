//! One direction: bytes in, packets treated, frames out, without waiting.

use embedded_io::{Read, ReadReady, Write, WriteReady};
use mavlink_signing::{Frame, FrameRef, KeyRing, Profile};

use crate::direction::PacketHandler;
use crate::event::{Counters, Event, RejectedPacket};
use crate::port::{PacketReader, PortError, send};
use crate::{Clock, Link};

/// A direction of the relay.
#[derive(Debug)]
pub(crate) struct Pump<T> {
    reader: PacketReader,
    handler: T,
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

    pub(crate) const fn handler_mut(&mut self) -> &mut T {
        &mut self.handler
    }

    /// The frame of which no byte has left: every frame is here when a turn has ended in which it was
    /// made.
    pub(crate) fn unsent(&self) -> Option<FrameRef<'_>> {
        let sending = self.sending.as_ref().filter(|sending| sending.sent == 0)?;
        FrameRef::parse(sending.frame.as_bytes()).ok()
    }
}

impl<T: PacketHandler> Pump<T> {
    pub(crate) fn new(handler: T) -> Self {
        Self {
            reader: PacketReader::new(T::RESYNC),
            handler,
            sending: None,
            counters: Counters::default(),
        }
    }

    /// The same direction, which treats packets otherwise from now on.
    pub(crate) fn map<U: PacketHandler>(self, change: impl FnOnce(T) -> U) -> Pump<U> {
        Pump {
            reader: self.reader,
            handler: change(self.handler),
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
            self.reader.restart_idle_timer(now);
        }
        // The frame being sent is the bound on memory: no next one before it has left.
        if self.sending.is_some() {
            return Ok(sent);
        }
        if self.process_next(&mut link.keys, clock, observe) {
            return Ok(true);
        }
        let received = self.reader.receive(input, link.idle, now)?;
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
    fn process_next<P: Profile>(
        &mut self,
        keys: &mut KeyRing<P>,
        clock: &mut impl Clock,
        observe: &mut impl FnMut(Event),
    ) -> bool {
        let decoded = self.reader.read();
        let processed = decoded.map(|decoded| match decoded {
            Ok(packet) => {
                let processed = self.handler.process(packet, keys, clock);
                processed
                    .map_err(|rejection| (rejection, Some(RejectedPacket::new(&packet, rejection))))
            }
            Err(error) => Err((error.into(), None)),
        });
        self.counters.set_dropped(self.reader.dropped());
        match processed {
            None => return false,
            Some(Ok((frame, event))) => {
                self.sending = Some(Sending { frame, sent: 0 });
                self.counters.count_passed(event);
                observe(event);
            }
            Some(Err((rejection, rejected))) => {
                self.counters.count_rejected(rejection, rejected);
                observe(Event::Rejected(T::DIRECTION, rejection));
            }
        }
        true
    }
}
