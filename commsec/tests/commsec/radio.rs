//! What a host and its radio say to each other.

use mavlink_commsec::radio::{Answer, DebugStatus, RadioError, Request, Status};

use crate::common::hex;
use crate::vectors::{GCS_RADIO, STATUS};

const REFERENCE: Status = Status {
    rssi: 200,
    noise: 40,
    received: 1000,
    remote_rssi: 126,
    remote_noise: 35,
    remote_received: 990,
    tx_errors: 1,
    rx_errors: 2,
    serial_tx_overflow: 3,
    serial_rx_overflow: 4,
    ecc_errors: 5,
    ecc_packets: 124,
    serial_tx_ok: 700,
    serial_rx_ok: 800,
};

#[test]
fn requests() {
    for (request, bytes) in [(Request::Status, b"B\r"), (Request::Debug, b"D\r")] {
        assert_eq!(request.to_wire(), *bytes);
        assert_eq!(Request::from_wire(bytes), Some(request));
        assert_eq!(
            Request::from_wire(&bytes.map(|byte| byte.to_ascii_lowercase())),
            Some(request)
        );
    }
    for other in [&b""[..], b"B", b"B\n", b"B\r\r", b"ATI5\r"] {
        assert_eq!(Request::from_wire(other), None);
    }
}

#[test]
fn reference_status() {
    let answer = hex(STATUS);
    assert_eq!(Answer::from_wire(&answer), Ok(Answer::Status(REFERENCE)));
    assert_eq!(REFERENCE.to_wire()[..], answer);
    assert_eq!(Answer::Status(REFERENCE).status(), &REFERENCE);
    assert_eq!(REFERENCE.gcs_radio(0)[..], hex(GCS_RADIO));
}

#[test]
fn debug_status() {
    let debug = DebugStatus {
        largest_window: 9,
        tx_queue: [1, 2],
        rx_queue: [3, 4],
    };
    let mut wire = hex(STATUS);
    wire[0] = b'D';
    wire.extend([9, 1, 2, 3, 4]);
    assert_eq!(REFERENCE.to_wire_with(&debug)[..], wire);
    let answer = Answer::from_wire(&wire).expect("an answer");
    assert_eq!(answer, Answer::Debug(REFERENCE, debug));
    assert_eq!(answer.status(), &REFERENCE);
}

#[test]
fn other_answers() {
    let status = hex(STATUS);
    let debug = [&status[..], &[0; 5]].concat();
    for length in (0..=40).filter(|length| *length != 25) {
        let answer: Vec<u8> = debug.iter().copied().cycle().take(length).collect();
        assert_eq!(
            Answer::from_wire(&answer),
            Err(RadioError::NoStatus(length))
        );
    }
    for first in (0..=255).filter(|first| *first != b'B') {
        let answer = [&[first], &status[1..]].concat();
        assert_eq!(Answer::from_wire(&answer), Err(RadioError::NoStatus(25)));
    }
}

/// VEHICLE_RADIO is GCS_RADIO but for its sender, its id, and the byte of overflow.
#[test]
fn vehicle_radio() {
    let status = Status {
        serial_rx_overflow: 0x1234,
        ..REFERENCE
    };
    let packet = status.vehicle_radio(9, 1, 2);
    let mut expected = hex(GCS_RADIO);
    expected[2..6].copy_from_slice(&[9, 1, 2, 174]);
    expected[12] = 0x34;
    assert_eq!(packet[..15], expected[..15]);
    let sum = mavlink_signing::crc::checksum(&packet[1..15], 238);
    assert_eq!(packet[15..], sum.to_le_bytes());
}
