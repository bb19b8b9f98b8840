//! Attacks on sealed links, each of which did harm once.

mod links;
mod ports;

use std::collections::BTreeSet;

use links::{
    Driven, OTHER, RADIO, REGION, SECOND, STATION, Time, VEHICLE, counter, open, provisioned,
    sealer,
};
use mavlink_commsec::radio::Status;
use mavlink_commsec::{MAX_PASSED_OVER, Opener, SenderId, hx};
use mavseal_relay::sealed::{HighWaterMarks, MarksError, Radio, SealedEvent, SealedRejectReason};
use mavseal_store::{
    MarkError,
    model::{Flash, WORD_SIZE},
};

fn start() -> Time {
    Time { timer: 1, clock: 0 }
}

/// Seals heartbeats as a vehicle with this flash, and gives their packages and the flash back.
fn seal_beats(sent: Flash<2>, accepted: Flash<2>, count: u32) -> (Vec<Vec<u8>>, Flash<2>) {
    let mut end = Driven::new(&VEHICLE, &[STATION], (sent, [accepted]), RADIO);
    let packages = (0..count).map(|custom| end.seal(custom, &mut start()).expect("sealed"));
    let packages = packages.collect();
    (packages, end.into_flashes().0)
}

/// Where the words of a flash cannot be read, no link begins at counter 1 again, nor at a mark that was passed.
#[test]
fn no_nonce_is_used_twice_whatever_cannot_be_read() {
    let peers = [STATION];
    let (sent, [accepted]) = provisioned(&VEHICLE, &peers);
    let (before, flash) = seal_beats(sent, accepted.clone(), 600);
    let used: BTreeSet<_> = before.iter().map(|package| counter(package)).collect();
    let words = (0..4096).step_by(WORD_SIZE);
    let spoiled = |offsets: &[usize]| {
        let mut flash = flash.clone();
        for offset in offsets {
            flash.spoil(*offset);
        }
        flash
    };
    // Every word alone: the other copy counts.
    for offset in words.clone().take(40) {
        let (after, _) = seal_beats(spoiled(&[offset]), accepted.clone(), 1);
        assert!(!used.contains(&counter(&after[0])), "word at {offset}");
        assert!(counter(&after[0]) > 600 && counter(&after[0]) <= 1100);
    }
    // All that was written: there is no end.
    let all: Vec<_> = words.collect();
    let unreadable = Some(MarksError::Mark(SenderId(7), MarkError::Unreadable));
    let opened = open(&VEHICLE, &peers, spoiled(&all), [accepted.clone()]);
    assert_eq!(opened.err(), unreadable);
    // An erased region beside one that says that all was stored: neither.
    let opened = open(&VEHICLE, &peers, Flash::default(), [accepted]);
    let none = MarksError::Mark(SenderId(7), MarkError::NotProvisioned);
    assert_eq!(opened.err(), Some(none));
}

/// Regions that have changed places, peers in another order, and other keys are errors.
#[test]
fn marks_of_others_are_no_marks() {
    let peers = [STATION, OTHER];
    let (sent, [one, two]) = provisioned(&VEHICLE, &peers);
    let is = |opened: Result<HighWaterMarks<_, 2>, _>, id| {
        let unreadable = MarksError::Mark(SenderId(id), MarkError::Unreadable);
        assert_eq!(opened.err(), Some(unreadable));
    };
    let all = || (sent.clone(), one.clone(), two.clone());
    let (a, b, c) = all();
    is(open(&VEHICLE, &peers, b, [a, c]), 7);
    let (a, b, c) = all();
    is(open(&VEHICLE, &peers, a, [c, b]), 5);
    let (a, b, c) = all();
    is(open(&VEHICLE, &[OTHER, STATION], a, [b, c]), 6);
    let (a, b, c) = all();
    is(open(&links::credential(7, 9), &peers, a, [b, c]), 7);
    let (a, b, c) = all();
    is(
        open(&VEHICLE, &[STATION, links::credential(6, 9)], a, [b, c]),
        6,
    );
    let (a, b, c) = all();
    assert!(open(&VEHICLE, &peers, a, [b, c]).is_ok());
}

/// With a clock, a command that the attacker kept from arriving is rejected a week later, after restarts too.
#[test]
fn what_was_held_back_for_a_week_is_too_old() {
    let week = 7 * 24 * 3600 * SECOND;
    let origin = 1_000_000 * SECOND;
    let mut time = Time {
        timer: 1,
        clock: origin + 5000 * SECOND,
    };
    let station_marks = provisioned(&STATION, &[VEHICLE]);
    let mut station = Driven::new(&STATION, &[VEHICLE], station_marks, Radio::Station);
    station = station.clocked(origin);
    let mut held = Vec::new();
    for custom in 0..20 {
        held.push(station.seal(custom, &mut time).expect("sealed"));
        time.pass(SECOND);
    }
    // The vehicle hears the first only; the rest is recorded and jammed.
    let mut flashes = provisioned(&VEHICLE, &[STATION]);
    for start in 0..3 {
        let mut vehicle = Driven::new(&VEHICLE, &[STATION], flashes, RADIO).clocked(origin);
        if start == 0 {
            assert_eq!(vehicle.open(&held[0], &mut time), None);
        } else {
            for package in &held[1..] {
                // In the end something newer has come.
                let reasons = [SealedRejectReason::TooOld, SealedRejectReason::Stale];
                let rejected = vehicle.open(package, &mut time);
                assert_eq!(rejected, Some(reasons[start - 1]));
            }
            // What the station says now is heard.
            let package = station.seal(99, &mut time).expect("sealed");
            assert_eq!(vehicle.open(&package, &mut time), None);
        }
        flashes = vehicle.into_flashes();
        time.pass(week);
    }
}

/// Without a clock it is accepted, once: the limit that SECURITY.md states.
#[test]
fn without_a_clock_what_was_held_back_is_accepted_once() {
    let mut station = sealer(&STATION, 1);
    let held = station.seal(&[0; 80]).expect("sealed");
    let flashes = provisioned(&VEHICLE, &[STATION]);
    let mut vehicle = Driven::new(&VEHICLE, &[STATION], flashes, RADIO);
    let mut later = Time {
        timer: 7 * 24 * 3600 * SECOND,
        clock: 0,
    };
    assert_eq!(vehicle.open(held.as_bytes(), &mut later), None);
    let again = vehicle.open(held.as_bytes(), &mut later);
    assert_eq!(again, Some(SealedRejectReason::Stale));
}

/// A station, which has the vehicle's key, does not end the vehicle's way down to others with one package.
#[test]
fn one_package_does_not_silence_a_sender() {
    let flashes = provisioned(&OTHER, &[VEHICLE]);
    let mut station = Driven::new(&OTHER, &[VEHICLE], flashes, Radio::Station);
    let sealed = |counter: u32| {
        let package = sealer(&VEHICLE, counter).seal(&[0; 80]).expect("sealed");
        package.as_bytes().to_vec()
    };
    let mut honest = 1000;
    for run in 0..3 {
        for far in [u32::MAX - 1, honest + MAX_PASSED_OVER + 2] {
            let rejected = station.open(&sealed(far), &mut start());
            assert_eq!(rejected, Some(SealedRejectReason::JumpTooFar));
        }
        for _ in 0..3 {
            assert_eq!(
                station.open(&sealed(honest), &mut start()),
                None,
                "run {run}"
            );
            honest += 1;
        }
        // Nor does a package end what the flash remembers.
        let flashes = station.into_flashes();
        station = Driven::new(&OTHER, &[VEHICLE], flashes, Radio::Station);
        honest += 2000;
    }
    // A new key begins anew, whatever was taken away of the old one.
    assert_eq!(
        station.open(&sealed(honest + MAX_PASSED_OVER - 3000), &mut start()),
        None
    );
    let (mut sent, [mut accepted]) = station.into_flashes();
    let new = [links::credential(7, 8)];
    let old = HighWaterMarks::provision::<mavlink_commsec::AesGcm>(
        &OTHER,
        &[VEHICLE],
        (&mut sent, REGION),
        [(&mut accepted, REGION)],
    );
    assert_eq!(old.err(), Some(MarksError::InUse(SenderId(7))));
    mavseal_relay::sealed::provision_peer::<_, mavlink_commsec::AesGcm>(
        &new[0],
        (&mut accepted, REGION),
    )
    .expect("another key");
    let mut station = Driven::new(&OTHER, &new, (sent, [accepted]), Radio::Station);
    let first = sealer(&new[0], 1).seal(&[0; 80]).expect("sealed");
    assert_eq!(station.open(first.as_bytes(), &mut start()), None);
}

/// Packages that overtake one another by up to 64 places all arrive, each once.
#[test]
fn nothing_is_lost_to_reordering() {
    let mut seed = 7_u64;
    let mut draw = |below: u64| {
        seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) % below
    };
    for jitter in [1, 2, 4, 8, 60] {
        let mut opener = Opener::<1>::new();
        let key = STATION.prepare().expect("a key");
        opener.permit(key, &[STATION.id]).expect("room");
        let mut sealer = sealer(&STATION, 1);
        let packages = (0..3000_u64).map(|at| {
            let package = sealer.seal(&[0; 80]).expect("sealed");
            (at + draw(jitter), package)
        });
        let mut packages: Vec<_> = packages.collect();
        packages.sort_by_key(|(at, _)| *at);
        for (_, package) in &packages {
            assert!(opener.open(package.as_bytes()).is_ok(), "jitter {jitter}");
        }
        for (_, package) in &packages {
            assert!(opener.open(package.as_bytes()).is_err(), "jitter {jitter}");
        }
    }
}

/// More forged packages than ended a link before; how many is told, and the limit can be set.
#[test]
fn forged_packages_do_not_end_a_link() {
    let flashes = provisioned(&VEHICLE, &[STATION]);
    let mut vehicle = Driven::new(&VEHICLE, &[STATION], flashes, RADIO);
    let mut forged = [0xA5; 96];
    forged[..8].copy_from_slice(&[0, 0, 0, 5, 0xFF, 0xFF, 0xFF, 0xFE]);
    for _ in 0..1000 {
        let rejected = vehicle.open(&forged, &mut start());
        assert_eq!(rejected, Some(SealedRejectReason::BadTag));
    }
    assert_eq!(vehicle.end.failed_opens(SenderId(5)), Some(1000));
    assert_eq!(vehicle.end.failed_opens(SenderId(9)), None);
    let mut station = sealer(&STATION, 1);
    let genuine = station.seal(&[0; 80]).expect("sealed");
    assert_eq!(vehicle.open(genuine.as_bytes(), &mut start()), None);
    vehicle.end = vehicle.end.integrity_limit(1000);
    let genuine = station.seal(&[0; 80]).expect("sealed");
    let rejected = vehicle.open(genuine.as_bytes(), &mut start());
    assert_eq!(rejected, Some(SealedRejectReason::IntegrityLimitReached));
}

/// Somebody on the radio's line has the vehicle tell one forged status a second, and no more.
#[test]
fn forged_statuses_are_one_a_second() {
    let flashes = provisioned(&VEHICLE, &[STATION]);
    let mut vehicle = Driven::new(&VEHICLE, &[STATION], flashes, RADIO);
    let mut time = start();
    // A radio that does not answer: no questions stay open.
    for _ in 0..300 {
        vehicle.run(&mut time);
        time.pass(SECOND);
    }
    vehicle.run(&mut time);
    let told = |vehicle: &Driven<1>| {
        let told = vehicle.events.iter();
        told.filter(|event| matches!(event, SealedEvent::Radio(_)))
            .count()
    };
    assert_eq!(told(&vehicle), 0);
    let status = Status::default().to_wire();
    for _ in 0..300 {
        vehicle.take(hx::FrameKind::Radio, &status, &mut time);
    }
    assert_eq!(told(&vehicle), 1);
    for _ in 0..300 {
        vehicle.take(hx::FrameKind::Radio, &status, &mut time);
        time.pass(SECOND / 100);
    }
    // Three seconds.
    assert_eq!(told(&vehicle), 3);
    vehicle.packages();
    time.pass(SECOND);
    vehicle.run(&mut time);
    assert!(vehicle.packages().len() <= 1);
}
