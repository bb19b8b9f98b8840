//! The in-line signer over TCP, with an unmodified rust-mavlink on both sides of it.

#[path = "../examples/tcp.rs"]
#[expect(dead_code, reason = "its `main` is the example's")]
mod tcp;

use std::{
    net::{Ipv4Addr, TcpListener, TcpStream},
    thread,
};

use mavlink::{
    Connection, MavConnection, MavHeader, SigningConfig,
    dialects::minimal::{HEARTBEAT_DATA, MavMessage},
};
use mavlink_signing::SigningKey;

const KEY: [u8; 32] = *b"a key for tests, known to anyone";
const LINK_STATION: u8 = 2;

/// A rust-mavlink that has connected, and the other end of its connection.
fn connect() -> (Connection<MavMessage>, TcpStream) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let address = listener.local_addr().expect("an address");
    let connecting = thread::spawn(move || mavlink::connect(&format!("tcpout:{address}")));
    let (stream, _) = listener.accept().expect("a connection");
    let connection = connecting.join().expect("no panic").expect("connected");
    (connection, stream)
}

fn heartbeat(custom_mode: u32) -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode,
        ..Default::default()
    })
}

fn header(sequence: u8, system_id: u8) -> MavHeader {
    MavHeader {
        sequence,
        system_id: system_id.into(),
        component_id: 1,
    }
}

#[test]
fn a_station_that_signs_and_an_autopilot_that_cannot() {
    let (autopilot, local) = connect();
    let (mut station, link) = connect();
    let stranger = SigningConfig::new([9; 32], 3, true, false);
    let relay = thread::spawn(move || tcp::run(local, link, SigningKey::new(&KEY).expect("a key")));

    // It takes nothing that is not signed with the key.
    let config = SigningConfig::new(KEY, LINK_STATION, true, false);
    station.setup_signing(Some(config.clone()));
    for at in 0..10 {
        autopilot
            .send(&header(at, 1), &heartbeat(at.into()))
            .expect("sent");
        let (from, message) = station.recv().expect("signed with the key");
        assert_eq!((from, message), (header(at, 1), heartbeat(at.into())));
    }

    // What another key signed, or none, does not reach the autopilot.
    station.setup_signing(Some(stranger));
    station
        .send(&header(0, 255), &heartbeat(100))
        .expect("sent");
    station.setup_signing(None);
    station
        .send(&header(1, 255), &heartbeat(101))
        .expect("sent");
    station.setup_signing(Some(config));
    for at in 2..10 {
        station
            .send(&header(at, 255), &heartbeat(at.into()))
            .expect("sent");
        let (from, message) = autopilot.recv().expect("not signed");
        assert_eq!((from, message), (header(at, 255), heartbeat(at.into())));
    }

    drop(station);
    relay.join().expect("no panic").expect("both ended");
}
