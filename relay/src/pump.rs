//! One direction: bytes in, packets treated, frames out.

use mavlink_signing::{Frame, FrameRef, KeyRing, LinkClock, Profile};

use crate::direction::PacketHandler;
use crate::event::{Counters, Event, RejectReason, RejectedPacket};
use crate::reader::PacketReader;

/// A direction of the relay.
#[derive(Debug)]
pub(crate) struct Pump<T> {
    pub(crate) reader: PacketReader,
    pub(crate) handler: T,
    sending: Option<Sending>,
    pub(crate) counters: Counters,
}

/// A frame of which `sent` bytes have left.
#[derive(Debug)]
struct Sending {
    frame: Frame,
    sent: usize,
}

impl<T> Pump<T> {
    /// What is left of the frame that goes out.
    pub(crate) fn pending(&self) -> &[u8] {
        match &self.sending {
            Some(sending) => sending
                .frame
                .as_bytes()
                .get(sending.sent..)
                .unwrap_or_default(),
            None => &[],
        }
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

    /// Looks at packets that have arrived until one becomes a frame to send, which is given, or no more are there.
    pub(crate) fn advance<P: Profile>(
        &mut self,
        keys: &mut KeyRing<P>,
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(Event),
    ) -> Option<FrameRef<'_>> {
        // The frame being sent is the bound on memory: no next one before it has left.
        if self.sending.is_some() {
            return None;
        }
        while self.sending.is_none() && self.process_next(keys, clock, observe) {}
        FrameRef::parse(self.sending.as_ref()?.frame.as_bytes()).ok()
    }

    /// Drops the frame that was to go out, if there is one.
    pub(crate) fn drop_frame(&mut self, observe: &mut impl FnMut(Event)) {
        if self.sending.take().is_some() {
            self.reject(RejectReason::LineClosed, None, observe);
        }
    }

    /// Looks at the next packet that has arrived; whether there was one.
    fn process_next<P: Profile>(
        &mut self,
        keys: &mut KeyRing<P>,
        clock: &mut impl LinkClock,
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
            Some(Err((rejection, rejected))) => self.reject(rejection, rejected, observe),
        }
        true
    }

    fn reject(
        &mut self,
        reason: RejectReason,
        packet: Option<RejectedPacket>,
        observe: &mut impl FnMut(Event),
    ) {
        self.counters.count_rejected(reason, packet);
        observe(Event::Rejected(T::DIRECTION, reason));
    }
}
