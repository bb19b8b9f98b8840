//! What a device remembers: old recordings, marks in swapped places.

use std::cell::Cell;

use mavlink_commsec::AesGcm;
use mavlink_signing::*;
use mavseal_relay::{sealed::HighWaterMarks, *};

use crate::common::*;

const DAY: u64 = 24 * 3600 * S;
const KEY: [u8; 32] = [1; 32];

/// A new member of a fleet whose key is older than a year. The first frame it hears is a recording of then.
#[test]
fn an_old_recording_does_not_lock_a_new_board() {
    let today = NOW + 500 * DAY;
    let timer = Cell::new(1000u64);
    let stores = [Shared::new(1), Shared::new(2), Shared::new(3)];
    let flash = || LinkFlash {
        keys: stores[0].clone(),
        marks: [stores[1].clone(), stores[2].clone()],
        region: REGION,
    };
    let mut lost = vec![];
    for start in 0..5u64 {
        let (keys, mut m) =
            LinkMemory::open::<Hmac>(flash(), FirstKey::Own(&KEY), || timer.get()).unwrap();
        let mut r = Relay::new(
            keys,
            Stamper::new(1),
            ReplayGuard::new(2, Window::ONE_MINUTE),
            ForwardMode::KeepSignature,
        )
        .unwrap();
        if start == 0 {
            assert_eq!(
                hear(&mut r, &mut m.clock, &signed::<Hmac>(&KEY, 255, 2, NOW)),
                Ok(())
            );
        }
        for hour in 0..48 {
            timer.set(timer.get() + 3600 * S);
            let day = today + start * 2 * DAY + hour * 3600 * S;
            lost.push(hear(
                &mut r,
                &mut m.clock,
                &signed::<Hmac>(&KEY, 255, 2, day),
            ));
        }
    }
    println!(
        "honest frames over 10 days and 4 restarts: {} of {} accepted, last {:?}",
        lost.iter().filter(|r| r.is_ok()).count(),
        lost.len(),
        lost.last()
    );
    assert!(lost.iter().any(Result::is_ok));
}

/// Marks of a sealed end in swapped places, provisioned "again".
#[test]
fn swapped_marks_are_not_provisioned_again() {
    let [own, peer] = credentials();
    let peers = [peer];
    let (a, b) = (Shared::new(1), Shared::new(2));
    let provision = |sent: &Shared, accepted: &Shared| {
        let accepted = [(accepted.clone(), REGION)];
        HighWaterMarks::provision::<AesGcm>(&own, &peers, (sent.clone(), REGION), accepted)
    };
    let marks = provision(&a, &b).unwrap();
    let mut end = sealed::SealedEndpoint::<_, 1>::new(
        &own,
        &peers,
        marks,
        sealed::Radio::Station,
        std::time::Duration::ZERO,
    )
    .unwrap();
    let mut used = vec![];
    let mut clock = at(NOW);
    end.poll(&mut clock, &mut |_| {});
    for _ in 0..3 {
        let f = Frame::new(header(1), &[5, 0, 0, 0, 2, 3, 81, 4, 3]).unwrap();
        end.received(Side::Local, f.as_bytes(), &mut clock, &mut |e| {
            if let sealed::SealedEvent::Sealed(c) = e {
                used.push(c)
            }
        });
        while !end.pending(Side::Link).is_empty() {
            let n = end.pending(Side::Link).len();
            end.sent(Side::Link, n, &mut clock, &mut |e| {
                if let sealed::SealedEvent::Sealed(c) = e {
                    used.push(c)
                }
            });
        }
    }
    drop(end);
    println!("used {used:?}; in place: {:?}", provision(&a, &b).err());
    println!(
        "swapped, opened: {:?}",
        HighWaterMarks::open::<AesGcm>(&own, &peers, (b.clone(), REGION), [(a.clone(), REGION)])
            .err()
    );
    let again = provision(&b, &a);
    println!("swapped, provisioned: {:?}", again.as_ref().err());
    if let Ok(marks) = again {
        let end = sealed::SealedEndpoint::<_, 1>::new(
            &own,
            &peers,
            marks,
            sealed::Radio::Station,
            std::time::Duration::ZERO,
        )
        .unwrap();
        panic!(
            "next counter {:?} after {used:?}: nonces twice",
            end.next_counter()
        );
    }
}
