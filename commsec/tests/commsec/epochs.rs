//! Packages with epochs: the draft's example, the order of places, and where epochs end.

use mavlink_commsec::{
    AesGcm, Credential, EpochCounter, EpochError, EpochHeader, EpochSenderId, OpenError, Opener,
    PermitError, Sealer, SealingKey, SenderId,
};

use crate::common::{hex, message};
use crate::vectors::{self, BASE_KEY, BASE_SALT};

const FIVE: EpochSenderId = EpochSenderId(5);

fn key() -> SealingKey<AesGcm, EpochHeader> {
    SealingKey::new(&hex(BASE_KEY), BASE_SALT).expect("a key")
}

fn begin(epoch: u64) -> Sealer<AesGcm, EpochHeader> {
    Sealer::begin(key(), FIVE, epoch).expect("an epoch is left")
}

fn receiver(last: EpochCounter) -> Opener<2, AesGcm, EpochHeader> {
    let mut opener = Opener::<2, AesGcm, EpochHeader>::new();
    let permitted = opener.resume(key(), &[(FIVE, last)]);
    permitted.expect("there is room");
    opener
}

fn sequence(epoch: u16, counter: u32) -> EpochCounter {
    EpochCounter { epoch, counter }
}

/// The example of the draft is what a station with id 5 seals first in epoch 2; and it opens.
#[test]
fn reference_package() {
    let mut station = begin(2);
    assert_eq!(station.next_sequence(), Some(sequence(2, 1)));
    let package = station.seal(&message(vectors::B.plain));
    let package = package.expect("a counter is left");
    assert_eq!(package.as_bytes()[..], hex(vectors::X));
    let mut opener = receiver(sequence(0, 0));
    let opened = opener.open(&hex(vectors::X)).expect("genuine");
    assert_eq!(opened.plaintext(), &message(vectors::B.plain));
    assert_eq!((opened.sender(), opened.sequence()), (FIVE, sequence(2, 1)));
    assert_eq!(opened.counter(), 1);
    let shown = "Opened { header: EpochHeader { sequence: EpochCounter { epoch: 2, counter: 1 }, sender: EpochSenderId(5) }, .. }";
    assert_eq!(format!("{opened:?}"), shown);
    assert_eq!(
        opener.senders().collect::<Vec<_>>(),
        [(FIVE, sequence(2, 1))]
    );
}

#[test]
fn header_on_the_wire() {
    let header = EpochHeader {
        sequence: sequence(0x0506, 0x0102_0304),
        sender: EpochSenderId(0x0708),
    };
    assert_eq!(header.to_wire(), [1, 2, 3, 4, 5, 6, 7, 8]);
    assert_eq!(EpochHeader::from_wire(&header.to_wire()), header);
    assert_eq!(header.sender.to_string(), "1800");
}

/// Epoch and counter are compared together: the draft, which compares counters alone, would reject all
/// that a sender says after a restart.
#[test]
fn later_epochs_are_newer() {
    let sealed = |epoch: u64, count: usize| {
        let mut sender = begin(epoch);
        let packages = (0..count).map(|_| sender.seal(&[7; 80]).expect("a counter is left"));
        let last = packages.last().expect("one at least");
        *last.as_bytes()
    };
    let mut opener = receiver(sequence(0, 0));
    let stale = |epoch, counter, last| OpenError::StaleInEpoch {
        sequence: sequence(epoch, counter),
        last,
    };
    for (epoch, counter, accepted) in [
        (0, 3, true),
        (0, 3, false),
        // It was overtaken.
        (0, 2, true),
        // The counter begins anew, and the package is newer.
        (1, 1, true),
        (0, 9, false),
        // Starts that nobody heard of are jumped over.
        (7, 2, true),
        (7, 1, true),
        (6, 5, false),
        (7, 3, true),
    ] {
        let [(_, last)] = opener.senders().collect::<Vec<_>>()[..] else {
            panic!("one sender")
        };
        let verdict = opener.open(&sealed(epoch, counter));
        let expected = stale(epoch as u16, counter as u32, last);
        assert_eq!(
            verdict.map(drop),
            if accepted { Ok(()) } else { Err(expected) }
        );
    }
}

/// A receiver that kept a mark rejects what is below it, in its epoch and before.
#[test]
fn resumed_receiver_needs_no_new_epoch() {
    let mut sender = begin(3);
    let packages = [(); 3].map(|()| sender.seal(&[1; 80]).expect("a counter is left"));
    let mut opener = receiver(sequence(3, 2));
    for package in &packages[..2] {
        let rejected = opener.open(package.as_bytes()).map(drop);
        assert!(matches!(rejected, Err(OpenError::StaleInEpoch { .. })));
    }
    assert!(opener.open(packages[2].as_bytes()).is_ok());
}

/// The first epoch is 0, the last 65,534; a mark beyond 16 bits is not cut to one that was used.
#[test]
fn epochs_end() {
    for (mark, epoch) in [(0, 0), (1, 1), (0xFFFE, 0xFFFE)] {
        assert_eq!(begin(mark).next_sequence(), Some(sequence(epoch, 1)));
    }
    for mark in [0xFFFF, 0x1_0000, 0x1_0001, u64::MAX] {
        let begun = Sealer::begin(key(), FIVE, mark);
        assert_eq!(begun.err(), Some(EpochError));
    }
}

/// In an epoch the counter goes up by one, and the epoch stays.
#[test]
fn counters_in_an_epoch() {
    let mut sender = begin(0x0102);
    for counter in 1..=3_u32 {
        assert_eq!(sender.next_counter(), Some(counter));
        let package = sender.seal(&[0; 80]).expect("a counter is left");
        let expected = [0, 0, 0, counter as u8, 1, 2, 0, 5];
        assert_eq!(package.as_bytes()[..8], expected);
    }
    assert_eq!(sender.id(), FIVE);
}

/// Every part of the header is under the tag.
#[test]
fn changed_headers_are_rejected() {
    let package = hex(vectors::X);
    let mut opener = receiver(sequence(0, 0));
    for bit in 0..64 {
        let mut changed = package.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let rejected = opener.open(&changed).map(drop);
        if bit / 8 >= 6 {
            let id = u16::from_be_bytes([changed[6], changed[7]]);
            let unknown = OpenError::UnknownSender(SenderId(id.into()));
            assert_eq!(rejected, Err(unknown));
        } else {
            assert_eq!(rejected, Err(OpenError::BadTag), "bit {bit}");
        }
    }
    assert_eq!(opener.failed_opens(FIVE), Some(48));
    assert!(opener.open(&package).is_ok());
}

/// As a number for a mark, places keep their order.
#[test]
fn places_as_numbers() {
    let places = [
        sequence(0, 0),
        sequence(0, 1),
        sequence(0, u32::MAX),
        sequence(1, 0),
        sequence(0x1234, 0x5678_9ABC),
        sequence(u16::MAX, u32::MAX),
    ];
    for pair in places.windows(2) {
        assert!(pair[0] < pair[1]);
        assert!(pair[0].to_number() < pair[1].to_number());
    }
    for sequence in places {
        assert_eq!(
            EpochCounter::from_number(sequence.to_number()),
            Some(sequence)
        );
    }
    assert_eq!(places[4].to_number(), 0x1234_5678_9ABC);
    assert_eq!(EpochCounter::from_number(1 << 48), None);
}

/// Epoch 65,535, which nobody uses, is rejected whatever its tag; so is the counter behind the last one.
#[test]
fn no_epoch() {
    for claimed in [sequence(0xFFFF, 1), sequence(3, u32::MAX)] {
        let mut package = hex(vectors::X);
        let header = EpochHeader {
            sequence: claimed,
            sender: FIVE,
        };
        package[..8].copy_from_slice(&header.to_wire());
        let mut opener = receiver(sequence(0, 0));
        let rejected = opener.open(&package).map(drop);
        assert_eq!(rejected, Err(OpenError::NoCounter(SenderId(5))));
        assert_eq!(opener.failed_opens(FIVE), Some(0));
    }
}

#[test]
fn receiver_of_credentials() {
    let credential = |id| Credential {
        id: EpochSenderId(id),
        key: hex(BASE_KEY).try_into().expect("16 bytes"),
        salt: BASE_SALT,
    };
    let last = |id: EpochSenderId| sequence(id.0, 0);
    let peers = [credential(5), credential(6)];
    let mut opener =
        Opener::<2, AesGcm, EpochHeader>::from_credentials(&peers, last).expect("there is room");
    let senders: Vec<_> = opener.senders().collect();
    assert_eq!(
        senders,
        [(FIVE, sequence(5, 0)), (EpochSenderId(6), sequence(6, 0))]
    );
    assert!(opener.open(&hex(vectors::X)).is_err());
    let twice = [credential(5), credential(5)];
    let permitted = Opener::<2, AesGcm, EpochHeader>::from_credentials(&twice, last);
    let error = PermitError::DuplicateSender(SenderId(5));
    assert_eq!(permitted.err(), Some(error));
}

/// The last counter of an epoch is accepted, and then the first of the next one. The package is made with
/// the old header, whose counter can be chosen: its 8 bytes are these.
#[test]
fn last_counter_of_an_epoch() {
    let key = SealingKey::new(&hex(BASE_KEY), BASE_SALT).expect("a key");
    let mut old: Sealer = Sealer::resume(key, SenderId(u32::MAX - 1), 0x0002_0005);
    let last = old.seal(&[9; 80]).expect("a counter is left");
    let mut opener = receiver(sequence(2, u32::MAX - 2));
    let opened = opener.open(last.as_bytes()).expect("of epoch 2");
    assert_eq!(opened.sequence(), sequence(2, u32::MAX - 1));
    let next = begin(3).seal(&[9; 80]).expect("a counter is left");
    assert!(opener.open(next.as_bytes()).is_ok());
}
