//! What is asked of the radio, and what becomes of the answer.

use mavlink_commsec::radio::{Answer, RADIO_PACKET_SIZE, Request, Status};
use mavlink_signing::TICKS_PER_SECOND;

use super::SealedRejectReason;

/// How often the radio is asked for its status: every second, in ticks of 10 microseconds.
pub const STATUS_INTERVAL: u64 = TICKS_PER_SECOND;

/// Whose radio it is, and so which packet becomes of its status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Radio {
    /// A vehicle's, with this system and component: VEHICLE_RADIO to the stations, sealed.
    Vehicle {
        /// The vehicle.
        system_id: u8,
        /// The part of it that answers for the radio.
        component_id: u8,
    },
    /// A ground station's: GCS_RADIO to its program, on the local side.
    Station,
}

/// What is asked of the radio, and what becomes of the answer.
pub(super) struct RadioPoller {
    radio: Radio,
    /// When it was last asked, in ticks.
    asked: Option<u64>,
    /// Whether it has not answered yet.
    open: bool,
    /// Of the packets that are made from answers.
    sequence: u8,
    /// What is to be handed on.
    answer: Option<Status>,
}

impl RadioPoller {
    pub(super) const fn new(radio: Radio) -> Self {
        Self {
            radio,
            asked: None,
            open: false,
            sequence: 0,
            answer: None,
        }
    }

    /// When it is time for the question.
    pub(super) fn ask_at(&self) -> u64 {
        let next = |asked: u64| asked.saturating_add(STATUS_INTERVAL);
        self.asked.map_or(0, next)
    }

    /// The question, when it is time for it. One that was not answered is answered no more.
    pub(super) fn ask(&mut self, now: u64) -> Option<Request> {
        if now < self.ask_at() {
            return None;
        }
        self.asked = Some(now);
        self.open = true;
        Some(Request::Status)
    }

    /// Takes what the radio says: one answer for each question, until it is time for the next. So neither a radio nor
    /// somebody on its line can fill the air with them, or store questions for later.
    pub(super) fn take(&mut self, bytes: &[u8], now: u64) -> Result<Status, SealedRejectReason> {
        let answer = Answer::from_wire(bytes)?;
        if !self.open || now >= self.ask_at() {
            return Err(SealedRejectReason::NotAsked);
        }
        self.open = false;
        self.answer = Some(*answer.status());
        Ok(*answer.status())
    }

    /// What a vehicle has to tell of its radio.
    pub(super) fn vehicle(&mut self) -> Option<[u8; RADIO_PACKET_SIZE]> {
        let Radio::Vehicle {
            system_id,
            component_id,
        } = self.radio
        else {
            return None;
        };
        let status = self.answer.take()?;
        Some(status.vehicle_radio(self.next(), system_id, component_id))
    }

    /// What a station has to tell of its radio.
    pub(super) fn station(&mut self) -> Option<[u8; RADIO_PACKET_SIZE]> {
        if self.radio != Radio::Station {
            return None;
        }
        let status = self.answer.take()?;
        Some(status.gcs_radio(self.next()))
    }

    fn next(&mut self) -> u8 {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        sequence
    }
}
