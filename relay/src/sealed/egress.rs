//! From the local side to the radio: packets are packed, sealed and framed.

use core::time::Duration;

use embedded_storage::nor_flash::NorFlash;
use mavlink_commsec::{Cipher, Packer, Plaintext, Sealer, hx};
use mavlink_signing::TICKS_PER_SECOND;
use zeroize::Zeroizing;

use super::clocked::Moment;
use super::paced::PacedMark;
use super::radio::RadioPoller;
use super::tx_buffer::TxBuffer;
use super::{SealedCounters, SealedEvent, SealedRejectReason};
use crate::event::Direction;
use crate::reader::PacketReader;

const MICROS_PER_TICK: u64 = 1_000_000 / TICKS_PER_SECOND;

/// From the local side to the radio.
pub(super) struct Egress<F, C: Cipher> {
    pub(super) reader: PacketReader,
    pub(super) packer: Packer,
    pub(super) sealer: Sealer<C>,
    pub(super) mark: PacedMark<F>,
    pub(super) line: TxBuffer<{ hx::MAX_ENCODED_SIZE }>,
    pub(super) counters: SealedCounters,
}

impl<F: NorFlash, C: Cipher> Egress<F, C> {
    /// Makes the next frame for the radio, or as much of one as there is to make.
    pub(super) fn advance(
        &mut self,
        radio: &mut RadioPoller,
        now: Moment,
        observe: &mut impl FnMut(SealedEvent),
    ) {
        // The frame being sent is the bound on memory: no next one before it has left.
        while self.line.is_empty() && self.step(radio, now, observe) {}
    }

    /// Does one thing; whether there was one to do.
    fn step(
        &mut self,
        radio: &mut RadioPoller,
        now: Moment,
        observe: &mut impl FnMut(SealedEvent),
    ) -> bool {
        let since = Duration::from_micros(now.ticks.saturating_mul(MICROS_PER_TICK));
        if let Some(message) = self.packer.poll(since) {
            self.seal(message, now, observe);
            return true;
        }
        if let Some(request) = radio.ask(now.ticks) {
            if let Ok(frame) = hx::Frame::new(hx::FrameKind::Radio, &request.to_wire()) {
                self.line.put(frame.encode());
            }
            return true;
        }
        let told = radio.vehicle();
        let packed = match &told {
            Some(packet) => Ok(&packet[..]),
            None => match self.reader.read() {
                Some(Ok(packet)) => Ok(packet.as_bytes()),
                Some(Err(error)) => Err(error.into()),
                None => {
                    self.counters.set_dropped(self.reader.dropped());
                    return false;
                }
            },
        };
        let packed = packed.and_then(|packet| Ok(self.packer.push(packet, since)?));
        match packed {
            Ok(full) => {
                self.counters.count_packet();
                observe(SealedEvent::Packed);
                if let Some(message) = full {
                    self.seal(message, now, observe);
                }
            }
            Err(rejection) => self.reject(rejection, observe),
        }
        true
    }

    /// When there will be something to do that no byte brings.
    pub(super) fn poll_at(&self, radio: &RadioPoller) -> Option<u64> {
        let hears = self.reader.due_at(true);
        if !self.line.is_empty() {
            return hears;
        }
        let full = self.packer.poll_at().map(|at| {
            let micros = u64::try_from(at.as_micros()).unwrap_or(u64::MAX);
            micros.div_ceil(MICROS_PER_TICK)
        });
        let deadlines = [hears, full, Some(radio.ask_at())];
        deadlines.into_iter().flatten().min()
    }

    fn seal(&mut self, message: Plaintext, now: Moment, observe: &mut impl FnMut(SealedEvent)) {
        match self.try_seal(&Zeroizing::new(message), now) {
            Ok(counter) => {
                self.counters.count_package();
                observe(SealedEvent::Sealed(counter));
            }
            Err(rejection) => self.reject(rejection, observe),
        }
    }

    /// Puts the package on the line; gives its counter.
    fn try_seal(&mut self, message: &Plaintext, now: Moment) -> Result<u32, SealedRejectReason> {
        if let Some(clock) = now.clock {
            self.sealer.advance_to(clock.counter());
        }
        let counter = self.sealer.next_counter();
        let counter = counter.ok_or(SealedRejectReason::CounterExhausted)?;
        if now
            .clock
            .is_some_and(|clock| clock.is_too_far_ahead(counter))
        {
            return Err(SealedRejectReason::AheadOfClock);
        }
        self.mark.reserve(counter, now.ticks)?;
        let package = self.sealer.seal(message)?;
        self.line.put(hx::Frame::from(&package).encode());
        Ok(counter)
    }

    pub(super) fn drop_frame(&mut self, observe: &mut impl FnMut(SealedEvent)) {
        if !self.line.is_empty() {
            self.line.clear();
            self.reject(SealedRejectReason::LineClosed, observe);
        }
    }

    fn reject(&mut self, rejection: SealedRejectReason, observe: &mut impl FnMut(SealedEvent)) {
        self.counters.count_rejected(rejection);
        observe(SealedEvent::Rejected(Direction::Outbound, rejection));
    }
}
