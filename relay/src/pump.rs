//! One direction: bytes in, packets treated, frames out.

use mavlink_signing::{Frame, FrameRef, KeyRing, LinkClock, Profile};

use crate::direction::PacketHandler;
use crate::event::{Counters, Event, RejectReason, RejectedPacket};
use crate::reader::PacketReader;

/// A direction of the relay.
#[derive(Debug)]
pub(crate) struct Pump<T> {
    pub(crate) lane: Lane,
    pub(crate) handler: T,
}

/// What a direction holds, whatever is done to its packets.
#[derive(Debug)]
pub(crate) struct Lane {
    pub(crate) reader: PacketReader,
    /// The frame that goes out, and how many of its bytes have left.
    sending: Option<Frame>,
    sent: usize,
    pub(crate) counters: Counters,
}

impl Lane {
    /// What is left of the frame that goes out.
    pub(crate) fn pending(&self) -> &[u8] {
        let sending = self.sending.as_ref();
        sending
            .and_then(|frame| frame.as_bytes().get(self.sent..))
            .unwrap_or_default()
    }

    /// Takes note of `count` bytes that have left; whether the frame has left with them.
    pub(crate) fn sent(&mut self, count: usize) -> bool {
        let Some(frame) = &self.sending else {
            return false;
        };
        self.sent = self.sent.saturating_add(count);
        let left = self.sent >= frame.as_bytes().len();
        if left {
            self.sending = None;
        }
        left
    }

    /// Drops the frame that was to go out; whether there was one.
    pub(crate) fn drop_frame(&mut self) -> bool {
        let dropped = self.sending.take().is_some();
        if dropped {
            self.counters.count_rejected(RejectReason::LineClosed, None);
        }
        dropped
    }

    /// When time changes something for the line that is read.
    pub(crate) fn due_at(&self) -> Option<u64> {
        self.reader.due_at(self.sending.is_some())
    }

    /// Does what is due at `now`; whether there was something.
    pub(crate) fn poll(&mut self, now: u64) -> bool {
        self.reader.poll(now, self.sending.is_some())
    }
}

impl<T: PacketHandler> Pump<T> {
    pub(crate) fn new(handler: T) -> Self {
        Self {
            lane: Lane {
                reader: PacketReader::new(T::RESYNC),
                sending: None,
                sent: 0,
                counters: Counters::default(),
            },
            handler,
        }
    }

    /// The same direction, which treats packets otherwise from now on.
    pub(crate) fn map<U: PacketHandler>(self, change: impl FnOnce(T) -> U) -> Pump<U> {
        Pump {
            lane: self.lane,
            handler: change(self.handler),
        }
    }

    /// Looks at packets that have arrived until one becomes a frame to send, which is given, or no more are there.
    pub(crate) fn advance<P: Profile>(
        &mut self,
        keys: &mut KeyRing<P>,
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(Event),
    ) -> Option<FrameRef<'_>> {
        // The frame being sent is the bound on memory: no next one before it has left.
        if self.lane.sending.is_some() {
            return None;
        }
        while self.lane.sending.is_none() && self.process_next(keys, clock, observe) {}
        FrameRef::parse(self.lane.sending.as_ref()?.as_bytes()).ok()
    }

    /// Looks at the next packet that has arrived; whether there was one.
    fn process_next<P: Profile>(
        &mut self,
        keys: &mut KeyRing<P>,
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(Event),
    ) -> bool {
        let Self { lane, handler } = self;
        let read = lane.reader.read();
        let processed = match read {
            None => {
                // What has no magic byte is no error, but something came.
                if lane.reader.is_deaf() {
                    handler.no_packet();
                }
                Ok(None)
            }
            Some(Err(error)) => {
                handler.no_packet();
                Err((error.into(), None))
            }
            Some(Ok(packet)) => match handler.process(packet, keys, clock) {
                // Straight to its place: a frame takes 280 bytes of stack.
                Ok((frame, event)) => {
                    lane.sending = Some(frame);
                    lane.sent = 0;
                    Ok(Some(event))
                }
                Err(reason) => Err((reason, Some(RejectedPacket::new(&packet, reason)))),
            },
        };
        lane.counters.set_dropped(lane.reader.dropped());
        match processed {
            Ok(None) => return false,
            Ok(Some(event)) => {
                lane.counters.count_passed(event);
                observe(event);
            }
            Err((reason, packet)) => {
                lane.counters.count_rejected(reason, packet);
                observe(Event::Rejected(T::DIRECTION, reason));
            }
        }
        true
    }
}
