//! What goes out is held up: deafness begins when a fault is found, not when it came in.

use std::time::Duration;

use mavlink_commsec::AesGcm;
use mavlink_signing::*;
use mavseal_relay::{
    sealed::{HighWaterMarks, Radio, SealedEndpoint},
    *,
};
use mavseal_store::model::Flash;

use crate::common::*;

fn frame(id: u32, payload: &[u8]) -> Vec<u8> {
    let header = Header {
        compat_flags: 0,
        sequence: 0,
        system_id: 1,
        component_id: 1,
        message_id: MessageId::from_le_bytes([id as u8, (id >> 8) as u8, 0]),
    };
    Frame::new(header, payload).unwrap().as_bytes().to_vec()
}
fn relay() -> Relay<Hmac, ReplayGuard> {
    Relay::new(
        SigningKey::new(&[7; 32]).unwrap(),
        Stamper::new(1),
        ReplayGuard::new(2, Window::ONE_MINUTE),
        ForwardMode::StripSignature,
    )
    .unwrap()
}

/// A stream: a heartbeat, a packet with an unknown message id, and a long honest packet in whose payload `inner` lies.
fn stream(inner: &[u8]) -> (Vec<u8>, Vec<u8>) {
    let heartbeat = frame(0, &[5, 0, 0, 0, 2, 3, 81, 4, 3]);
    let mut unknown = frame(0, &[1; 9]);
    unknown[7..10].copy_from_slice(&[0xEF, 0xEF, 0x7F]); // an id of no dialect
    let fill = 280 - unknown.len() - 10;
    // ENCAPSULATED_DATA (131): 2 + 253 bytes
    let mut payload = vec![1; 255];
    payload[fill - 50..fill - 50].fill(0);
    // two long honest packets: the boundary of the buffer lies in the second
    let first = frame(131, &[7; 200]); // honest filler, 212 bytes
    let used = unknown.len() + first.len();
    let offset = 280 - used - 10;
    payload[offset..offset + inner.len()].copy_from_slice(inner);
    let carrier = frame(131, &payload);
    let mut rest = unknown;
    rest.extend(first);
    rest.extend(carrier);
    (heartbeat, rest)
}

fn signer(blocked_for: u64, repeat_offers: bool) -> Vec<u8> {
    let inner = frame(
        76,
        &[
            0, 0, 128, 63, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1,
            144, 1, 1, 1, 1,
        ],
    );
    let (heartbeat, rest) = stream(&inner);
    let mut relay = relay();
    let mut o = |_| {};
    let mut clock = at(NOW);
    assert_eq!(
        relay.received(Side::Local, &heartbeat, &mut clock, &mut o),
        heartbeat.len()
    );
    let taken = relay.received(Side::Local, &rest, &mut clock, &mut o);
    assert_eq!(taken, 280);
    let mut t = NOW;
    while repeat_offers && t < NOW + blocked_for {
        t += 1000;
        let mut clock = at(t);
        relay.poll(&mut clock, &mut o);
        assert_eq!(
            relay.received(Side::Local, &rest[280..], &mut clock, &mut o),
            0
        );
    }
    let mut clock = at(NOW + blocked_for);
    let n = relay.pending(Side::Link).len();
    relay.sent(Side::Link, n, &mut clock, &mut o);
    relay.received(Side::Local, &rest[280..], &mut clock, &mut o);
    relay.pending(Side::Link).to_vec()
}

#[test]
fn signer_control() {
    assert!(signer(IDLE / 2, false).is_empty());
}
#[test]
fn signer_blocked() {
    let out = signer(2 * IDLE, true);
    println!("signed: {} bytes, message id {:?}", out.len(), out.get(7));
    assert!(out.is_empty(), "a command inside a payload was signed");
}
#[test]
fn setup_in_payload_taken_while_presence() {
    // the same with SETUP_SIGNING inside, presence Shown
    let inner_setup = SetupSigning {
        target_system: 1,
        target_component: 25,
        secret_key: [0x42; 32],
        initial_timestamp: at(NOW),
    };
    let header = Header {
        compat_flags: 0,
        sequence: 0,
        system_id: 255,
        component_id: 1,
        message_id: SETUP_SIGNING,
    };
    let inner = inner_setup.to_frame(header).unwrap().as_bytes().to_vec();
    let (heartbeat, rest) = stream(&inner);
    let mut relay = relay();
    relay.keep_setup(1, 25);
    relay.set_presence(Presence::Shown);
    let mut o = |_| {};
    let mut clock = at(NOW);
    relay.received(Side::Local, &heartbeat, &mut clock, &mut o);
    assert_eq!(relay.received(Side::Local, &rest, &mut clock, &mut o), 280);
    let mut clock = at(NOW + 2 * IDLE);
    let n = relay.pending(Side::Link).len();
    relay.sent(Side::Link, n, &mut clock, &mut o);
    relay.received(Side::Local, &rest[280..], &mut clock, &mut o);
    assert!(
        relay.take_setup().is_none(),
        "SETUP_SIGNING inside a payload was taken"
    );
}
/// Link closed while blocked: `drop_frame` unblocks too.
#[test]
fn signer_blocked_then_link_closed() {
    let inner = frame(76, &[1; 33]);
    let (heartbeat, rest) = stream(&inner);
    let mut relay = relay();
    let mut o = |_| {};
    let mut clock = at(NOW);
    relay.received(Side::Local, &heartbeat, &mut clock, &mut o);
    assert_eq!(relay.received(Side::Local, &rest, &mut clock, &mut o), 280);
    let mut clock = at(NOW + 2 * IDLE);
    relay.line_event(Side::Link, LineEvent::Closed, &mut clock, &mut o);
    relay.received(Side::Local, &rest[280..], &mut clock, &mut o);
    assert!(relay.pending(Side::Link).is_empty(), "signed");
}
#[test]
fn sealed_blocked() {
    let inner = frame(0, &[5, 0, 0, 0, 2, 3, 81, 4, 3]);
    let region = REGION;
    let [own, peer] = credentials();
    let peers = [peer];
    let marks = HighWaterMarks::provision::<AesGcm>(
        &own,
        &peers,
        (Flash::<2>::new(0), region),
        [(Flash::<2>::new(0), region)],
    )
    .unwrap();
    let mut end = SealedEndpoint::<_, 1>::new(
        &own,
        &peers,
        marks,
        Radio::Station,
        Duration::from_millis(50),
    )
    .unwrap();
    let mut sealed = 0;
    let mut packed = 0;
    let mut clock = at(NOW);
    let (heartbeat, rest) = stream(&inner);
    let mut o = |event| match event {
        mavseal_relay::sealed::SealedEvent::Packed => packed += 1,
        mavseal_relay::sealed::SealedEvent::Sealed(_) => sealed += 1,
        _ => {}
    };
    // the radio's question goes out first, and stays
    end.poll(&mut clock, &mut o);
    assert!(!end.pending(Side::Link).is_empty());
    let _ = heartbeat;
    assert_eq!(end.received(Side::Local, &rest, &mut clock, &mut o), 280);
    let mut clock = at(NOW + 2 * IDLE);
    let n = end.pending(Side::Link).len();
    end.sent(Side::Link, n, &mut clock, &mut o);
    end.received(Side::Local, &rest[280..], &mut clock, &mut o);
    end.poll(&mut clock, &mut o);
    println!("packed {packed}, sealed {sealed}");
    assert_eq!(packed, 0, "a heartbeat inside a payload was sealed");
}
