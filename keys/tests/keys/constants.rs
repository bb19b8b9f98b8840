//! The constants compile, and are those of the file: both ends of the example link.

use mavlink_commsec::{AesGcm, EpochHeader, EpochSenderId, HeaderFormat as _, Opener, Sealer};
use mavseal_keys::{HeaderKind, KeyFile, Role};

use crate::{KEYS_MK, PUBLISHED};

mod vehicle {
    include!("vehicle.rs");
}

mod station {
    include!("station.rs");
}

mod epoch_vehicle {
    include!("epoch_vehicle.rs");
}

/// The files beside this one are what a build script would write.
#[test]
fn files_are_what_is_made() {
    let file = KeyFile::from_keys_mk(KEYS_MK, PUBLISHED).expect("a key file");
    let made = |who| file.to_rust_source(who).expect("a sender");
    assert_eq!(*made(Role::Vehicle), include_str!("vehicle.rs"));
    assert_eq!(*made(Role::Station(5)), include_str!("station.rs"));
    let file = file.with_header(HeaderKind::CounterEpochId);
    let made = file.expect("small ids").to_rust_source(Role::Vehicle);
    assert_eq!(*made.expect("a sender"), include_str!("epoch_vehicle.rs"));
}

/// With the other header the constants are of another type, which the other sealer takes.
#[test]
fn constants_with_epochs() {
    let own = &epoch_vehicle::OWN;
    let key = own.prepare::<AesGcm>().expect("a key");
    let mut sealer = Sealer::begin(key, own.id, 3).expect("an epoch is left");
    let package = sealer.seal(&[7; 80]).expect("a counter is left");
    assert_eq!(package.as_bytes()[..8], [0, 0, 0, 1, 0, 3, 0, 7]);
    let peers = &epoch_vehicle::PEERS;
    let none = EpochHeader::ZERO;
    let opener = Opener::<1, AesGcm, EpochHeader>::from_credentials(peers, |_| none);
    let opener = opener.expect("there is room");
    assert_eq!(
        opener.senders().collect::<Vec<_>>(),
        [(EpochSenderId(5), none)]
    );
}

/// With them, a vehicle and a station hear each other.
#[test]
fn ends_hear_each_other() {
    let ends = [
        (&vehicle::OWN, &station::PEERS),
        (&station::OWN, &vehicle::PEERS),
    ];
    for (own, peers) in ends {
        let mut sealer: Sealer = Sealer::new(own.prepare().expect("a key"), own.id);
        let mut opener = Opener::<1>::from_credentials(peers, |_| 0).expect("there is room");
        let package = sealer.seal(&[7; 80]).expect("a counter is left");
        let opened = opener.open(package.as_bytes()).expect("permitted");
        assert_eq!((opened.sender(), opened.plaintext()), (own.id, &[7; 80]));
    }
    assert_eq!([vehicle::OWN.id.0, station::OWN.id.0], [7, 5]);
}
