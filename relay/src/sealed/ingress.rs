//! From the radio to the local side: only packets out of opened packages.

use embedded_storage::nor_flash::NorFlash;
use mavlink_commsec::{Cipher, Opener, SenderId, field, hx};

use super::clocked::Moment;
use super::paced::PacedMark;
use super::radio::RadioPoller;
use super::tx_buffer::TxBuffer;
use super::{SealedCounters, SealedEvent, SealedRejectReason};
use crate::event::Direction;

/// From the radio to the local side.
pub(super) struct Ingress<F, const N: usize, C: Cipher> {
    pub(super) decoder: hx::Decoder,
    pub(super) opener: Opener<N, C>,
    pub(super) peers: [SenderId; N],
    pub(super) marks: [PacedMark<F>; N],
    pub(super) line: TxBuffer<{ field::PLAINTEXT_SIZE }>,
    pub(super) counters: SealedCounters,
}

impl<F: NorFlash, const N: usize, C: Cipher> Ingress<F, N, C> {
    pub(super) fn drop_packets(&mut self, observe: &mut impl FnMut(SealedEvent)) {
        if !self.line.is_empty() {
            self.line.clear();
            let rejection = SealedRejectReason::LineClosed;
            self.counters.count_rejected(rejection);
            observe(SealedEvent::Rejected(Direction::Inbound, rejection));
        }
    }

    /// Takes the next byte.
    pub(super) fn push(
        &mut self,
        byte: u8,
        radio: &mut RadioPoller,
        now: Moment,
        observe: &mut impl FnMut(SealedEvent),
    ) {
        let Self {
            decoder,
            opener,
            peers,
            marks,
            line,
            counters,
        } = self;
        let mut reject = |rejection| {
            counters.count_rejected(rejection);
            observe(SealedEvent::Rejected(Direction::Inbound, rejection));
        };
        let frame = match decoder.push(byte) {
            None => return,
            Some(Ok(frame)) => frame,
            Some(Err(error)) => return reject(error.into()),
        };
        if frame.kind() == hx::FrameKind::Radio {
            match radio.take(frame.payload(), now.ticks) {
                Ok(status) => observe(SealedEvent::Radio(status)),
                Err(rejection) => return reject(rejection),
            }
            if let Some(packet) = radio.station() {
                line.put(packet);
            }
            return;
        }
        let opened = match now.clock {
            None => opener.open(frame.payload()),
            Some(clock) => opener.open_between(frame.payload(), clock.fresh()),
        };
        let opened = opened.map_err(SealedRejectReason::from);
        let opened = opened.and_then(|opened| {
            let mut marks = peers.iter().zip(marks);
            let mark = marks.find(|(peer, _)| **peer == opened.sender());
            let (_, mark) = mark.ok_or(SealedRejectReason::UnknownSender)?;
            mark.reserve(opened.counter(), now.ticks)?;
            Ok(opened)
        });
        let opened = match opened {
            Ok(opened) => opened,
            Err(rejection) => return reject(rejection),
        };
        counters.count_package();
        observe(SealedEvent::Opened(opened.sender(), opened.counter()));
        for packet in opened.packets() {
            match packet {
                Ok(packet) => {
                    counters.count_packet();
                    line.put(packet.iter().copied());
                }
                Err(error) => {
                    let rejection = error.into();
                    counters.count_rejected(rejection);
                    observe(SealedEvent::Rejected(Direction::Inbound, rejection));
                }
            }
        }
    }
}
