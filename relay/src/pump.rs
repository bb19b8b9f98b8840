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
    sending: Option<Sending>,
    pub(crate) counters: Counters,
}

/// A frame of which `sent` bytes have left.
#[derive(Debug)]
struct Sending {
    frame: Frame,
    sent: usize,
}

impl Lane {
    /// What is left of the frame that goes out.
    pub(crate) fn pending(&self) -> &[u8] {
        let sending = self.sending.as_ref();
        sending
            .and_then(|sending| sending.frame.as_bytes().get(sending.sent..))
            .unwrap_or_default()
    }

    /// Takes note of `count` bytes that have left; whether the frame has left with them.
    pub(crate) fn sent(&mut self, count: usize) -> bool {
        let Some(Sending { frame, sent }) = &mut self.sending else {
            return false;
        };
        *sent = sent.saturating_add(count);
        let left = *sent >= frame.as_bytes().len();
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

    /// When the line that is read will have been silent for long. While a frame waits to go out, the
    /// sender on that line may be held back, and that is no silence.
    pub(crate) fn idle_at(&self) -> Option<u64> {
        if self.sending.is_some() {
            return None;
        }
        self.reader.idle_at()
    }
}

impl<T: PacketHandler> Pump<T> {
    pub(crate) fn new(handler: T) -> Self {
        Self {
            lane: Lane {
                reader: PacketReader::new(T::RESYNC),
                sending: None,
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
        FrameRef::parse(self.lane.sending.as_ref()?.frame.as_bytes()).ok()
    }

    /// Looks at the next packet that has arrived; whether there was one.
    fn process_next<P: Profile>(
        &mut self,
        keys: &mut KeyRing<P>,
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(Event),
    ) -> bool {
        let Self { lane, handler } = self;
        let decoded = lane.reader.read();
        let processed = decoded.map(|decoded| match decoded {
            Ok(packet) => {
                let processed = handler.process(packet, keys, clock);
                processed
                    .map_err(|rejection| (rejection, Some(RejectedPacket::new(&packet, rejection))))
            }
            Err(error) => Err((error.into(), None)),
        });
        lane.counters.set_dropped(lane.reader.dropped());
        match processed {
            None => return false,
            Some(Ok((frame, event))) => {
                lane.sending = Some(Sending { frame, sent: 0 });
                lane.counters.count_passed(event);
                observe(event);
            }
            Some(Err((rejection, rejected))) => {
                lane.counters.count_rejected(rejection, rejected);
                observe(Event::Rejected(T::DIRECTION, rejection));
            }
        }
        true
    }
}
