//! What a host and its own radio say to each other in frames of kind 1: the status of the link.
//!
//! SMACCMPilot's radio firmware (SMACCM-SiK) takes commands as text and answers `B` and `D` in binary,
//! integers big-endian. Anybody on the line can make such frames. They are for people to look at, and
//! nothing must act on them.

use core::fmt;

use mavlink_signing::crc::checksum;
use mavlink_signing::field::{CHECKSUM_SIZE, HEADER_SIZE_V1, MAGIC_V1};

/// Bytes of an answer to [`Request::Status`].
pub const STATUS_SIZE: usize = 25;
/// Bytes of an answer to [`Request::Debug`].
pub const DEBUG_SIZE: usize = 30;

/// What a host asks its radio; a host with SMACCMPilot's software asks once a second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Request {
    /// `B`: [`Status`].
    Status,
    /// `D`: [`Status`] and [`DebugStatus`].
    Debug,
}

impl Request {
    /// Its 2 bytes: a letter and a carriage return.
    #[must_use]
    pub const fn to_wire(self) -> [u8; 2] {
        [self.letter(), b'\r']
    }

    /// The request in `bytes`; `None` if they are another command. Small letters count as capitals.
    #[must_use]
    pub const fn from_wire(bytes: &[u8]) -> Option<Self> {
        match bytes {
            [b'B' | b'b', b'\r'] => Some(Self::Status),
            [b'D' | b'd', b'\r'] => Some(Self::Debug),
            _ => None,
        }
    }

    const fn letter(self) -> u8 {
        match self {
            Self::Status => b'B',
            Self::Debug => b'D',
        }
    }
}

/// The state of the link, as a radio counts and measures it. Counts have 16 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// Average strength of what it receives, in the radio's own unit.
    pub rssi: u8,
    /// Average strength of what it receives when nobody sends.
    pub noise: u8,
    /// Packets it received.
    pub received: u16,
    /// Average strength of what the radio at the other end receives.
    pub remote_rssi: u8,
    /// Average strength of what it receives when nobody sends.
    pub remote_noise: u8,
    /// Packets that the other end received.
    pub remote_received: u16,
    /// Packets it could not send.
    pub tx_errors: u16,
    /// Packets it received damaged.
    pub rx_errors: u16,
    /// Frames from the air that its host did not take in time.
    pub serial_tx_overflow: u16,
    /// Frames of its host that it had no room for.
    pub serial_rx_overflow: u16,
    /// Errors that its code has corrected.
    pub ecc_errors: u16,
    /// Packets in which its code has corrected errors.
    pub ecc_packets: u16,
    /// Frames that it gave to its host.
    pub serial_tx_ok: u16,
    /// Frames that it took from its host.
    pub serial_rx_ok: u16,
}

/// What only an answer to [`Request::Debug`] has after its [`Status`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct DebugStatus {
    /// The largest window in which it sent; forgotten when it is read.
    pub largest_window: u8,
    /// Where frames from the air are put in, and taken out.
    pub tx_queue: [u8; 2],
    /// Where frames of its host are put in, and taken out.
    pub rx_queue: [u8; 2],
}

/// A radio's answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Answer {
    /// To [`Request::Status`].
    Status(Status),
    /// To [`Request::Debug`].
    Debug(Status, DebugStatus),
}

impl Answer {
    /// The answer in the payload of a frame of kind 1.
    ///
    /// # Errors
    ///
    /// [`RadioError::NoStatus`]: another length, or another letter in front.
    pub fn from_wire(bytes: &[u8]) -> Result<Self, RadioError> {
        Self::parse(bytes).ok_or(RadioError::NoStatus(bytes.len()))
    }

    fn parse(bytes: &[u8]) -> Option<Self> {
        let (status, rest) = bytes.split_first_chunk::<STATUS_SIZE>()?;
        match (status.first()?, rest) {
            (b'B', []) => Some(Self::Status(Status::from_wire(status))),
            (b'D', &[largest_window, a, b, c, d]) => {
                let debug = DebugStatus {
                    largest_window,
                    tx_queue: [a, b],
                    rx_queue: [c, d],
                };
                Some(Self::Debug(Status::from_wire(status), debug))
            }
            _ => None,
        }
    }

    /// The status, whichever was asked for.
    #[must_use]
    pub const fn status(&self) -> &Status {
        match self {
            Self::Status(status) | Self::Debug(status, _) => status,
        }
    }
}

impl Status {
    const fn from_wire(wire: &[u8; STATUS_SIZE]) -> Self {
        #[rustfmt::skip]
        let [_, rssi, noise, a, b, remote_rssi, remote_noise, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s, t] = *wire;
        Self {
            rssi,
            noise,
            received: u16::from_be_bytes([a, b]),
            remote_rssi,
            remote_noise,
            remote_received: u16::from_be_bytes([c, d]),
            tx_errors: u16::from_be_bytes([e, f]),
            rx_errors: u16::from_be_bytes([g, h]),
            serial_tx_overflow: u16::from_be_bytes([i, j]),
            serial_rx_overflow: u16::from_be_bytes([k, l]),
            ecc_errors: u16::from_be_bytes([m, n]),
            ecc_packets: u16::from_be_bytes([o, p]),
            serial_tx_ok: u16::from_be_bytes([q, r]),
            serial_rx_ok: u16::from_be_bytes([s, t]),
        }
    }

    /// The answer to [`Request::Status`], 25 bytes.
    #[must_use]
    pub const fn to_wire(&self) -> [u8; STATUS_SIZE] {
        self.answer(Request::Status)
    }

    const fn answer(&self, request: Request) -> [u8; STATUS_SIZE] {
        let [a, b] = self.received.to_be_bytes();
        let [c, d] = self.remote_received.to_be_bytes();
        let [e, f] = self.tx_errors.to_be_bytes();
        let [g, h] = self.rx_errors.to_be_bytes();
        let [i, j] = self.serial_tx_overflow.to_be_bytes();
        let [k, l] = self.serial_rx_overflow.to_be_bytes();
        let [m, n] = self.ecc_errors.to_be_bytes();
        let [o, p] = self.ecc_packets.to_be_bytes();
        let [q, r] = self.serial_tx_ok.to_be_bytes();
        let [s, t] = self.serial_rx_ok.to_be_bytes();
        let Self {
            rssi,
            noise,
            remote_rssi,
            remote_noise,
            ..
        } = *self;
        #[rustfmt::skip]
        let wire = [
            request.letter(), rssi, noise, a, b, remote_rssi, remote_noise, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, r, s, t,
        ];
        wire
    }

    /// The answer to [`Request::Debug`], 30 bytes.
    #[must_use]
    pub fn to_wire_with(&self, debug: &DebugStatus) -> [u8; DEBUG_SIZE] {
        let [a, b] = debug.tx_queue;
        let [c, d] = debug.rx_queue;
        let status = self.answer(Request::Debug);
        let debug = [debug.largest_window, a, b, c, d];
        let mut wire = [0; DEBUG_SIZE];
        for (slot, byte) in wire.iter_mut().zip(status.iter().chain(&debug)) {
            *slot = *byte;
        }
        wire
    }

    /// The status as the MAVLink 1 packet GCS_RADIO (175) of SMACCMPilot's dialect: 17 bytes. A gateway
    /// makes it for its ground station, as system 77, component 0.
    ///
    /// As SMACCMPilot's gateway fills it: the field `rxerrors` has the errors of sending, `fixed` the
    /// corrected errors, and `txbuf` nothing.
    #[must_use]
    pub fn gcs_radio(&self, sequence: u8) -> [u8; RADIO_PACKET_SIZE] {
        self.packet(sequence, [77, 0], GCS_RADIO, 0)
    }

    /// The status as the MAVLink 1 packet VEHICLE_RADIO (174) of SMACCMPilot's dialect: 17 bytes. A vehicle
    /// sends it about its own radio.
    ///
    /// As SMACCMPilot's vehicle fills it: the field `rxerrors` has the errors of sending, `fixed` the
    /// corrected errors, and `txbuf` the low byte of [`serial_rx_overflow`](Self::serial_rx_overflow).
    #[must_use]
    pub fn vehicle_radio(
        &self,
        sequence: u8,
        system_id: u8,
        component_id: u8,
    ) -> [u8; RADIO_PACKET_SIZE] {
        let [txbuf, _] = self.serial_rx_overflow.to_le_bytes();
        self.packet(sequence, [system_id, component_id], VEHICLE_RADIO, txbuf)
    }

    fn packet(
        &self,
        sequence: u8,
        [system_id, component_id]: [u8; 2],
        [id, crc_extra]: [u8; 2],
        txbuf: u8,
    ) -> [u8; RADIO_PACKET_SIZE] {
        let [a, b] = self.tx_errors.to_le_bytes();
        let [c, d] = self.ecc_errors.to_le_bytes();
        let checked = [
            RADIO_PAYLOAD_SIZE as u8,
            sequence,
            system_id,
            component_id,
            id,
            a,
            b,
            c,
            d,
            self.rssi,
            self.remote_rssi,
            txbuf,
            self.noise,
            self.remote_noise,
        ];
        let sum = checksum(&checked, crc_extra).to_le_bytes();
        let mut packet = [0; RADIO_PACKET_SIZE];
        let parts = [MAGIC_V1].into_iter().chain(checked).chain(sum);
        for (slot, byte) in packet.iter_mut().zip(parts) {
            *slot = byte;
        }
        packet
    }
}

/// Message id and CRC_EXTRA of GCS_RADIO.
const GCS_RADIO: [u8; 2] = [175, 108];
/// Message id and CRC_EXTRA of VEHICLE_RADIO.
const VEHICLE_RADIO: [u8; 2] = [174, 238];

const RADIO_PAYLOAD_SIZE: usize = 9;
/// Bytes of GCS_RADIO and of VEHICLE_RADIO as MAVLink 1 packets.
pub const RADIO_PACKET_SIZE: usize = HEADER_SIZE_V1 + RADIO_PAYLOAD_SIZE + CHECKSUM_SIZE;

/// Why bytes of a radio are not the status that was asked for. They may be another answer of it: text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RadioError {
    /// Neither 25 bytes that begin with `B` nor 30 that begin with `D`, but this many.
    NoStatus(usize),
}

impl fmt::Display for RadioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoStatus(length) => write!(f, "{length} bytes that are no status of a radio"),
        }
    }
}

impl core::error::Error for RadioError {}
