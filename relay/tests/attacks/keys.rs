//! Keys that change: records that come back, keys that are taken back, former keys, cuts in a row.

use std::cell::Cell;

use mavlink_signing::*;
use mavseal_relay::*;
use mavseal_store::model::Flash;

use crate::common::*;

const K1: [u8; 32] = [1; 32];
const K2: [u8; 32] = [2; 32];
const K3: [u8; 32] = [3; 32];

fn setup(key: [u8; 32], initial: u64) -> SetupSigning {
    SetupSigning {
        target_system: 1,
        target_component: 25,
        secret_key: key,
        initial_timestamp: at(initial),
    }
}

type R = Relay<Hmac, ReplayGuard>;
fn relay(keys: KeyRing<Hmac>) -> R {
    Relay::new(
        keys,
        Stamper::new(1),
        ReplayGuard::new(2, Window::ONE_MINUTE),
        ForwardMode::KeepSignature,
    )
    .unwrap()
}
fn send(relay: &mut R, clock: &mut impl LinkClock, sys: u8) -> Option<u64> {
    let mut o = |_| {};
    let f = Frame::new(header(sys), &[5, 0, 0, 0, 2, 3, 81, 4, 3]).unwrap();
    relay.received(Side::Local, f.as_bytes(), clock, &mut o);
    let out = relay.pending(Side::Link).to_vec();
    relay.sent(Side::Link, out.len(), clock, &mut o);
    Some(
        FrameRef::parse(&out)
            .ok()?
            .signature()?
            .stamp
            .timestamp
            .ticks(),
    )
}

/// A replacement (withdraw) is cut; the next start does not see what it left, goes on with the old state, and the start
/// after that sees it: the journal goes back by itself.
#[test]
fn a_record_that_comes_back_withdraws_no_key() {
    let mut ghosts = 0;
    let mut deaf = 0;
    let mut tried = 0;
    for chance in 0..30u64 {
        for cut in 0..12 {
            let flash = Shared::new(chance);
            let (mut store, _) = FlashKeyStore::open::<Hmac>(flash.clone(), REGION).unwrap();
            let mut keys: KeyRing<Hmac> = store.provision(&K1).unwrap();
            keys.apply(&K2, &mut store).unwrap();
            flash.0.borrow_mut().cut_after(cut);
            if keys.apply(&K1, &mut store).is_ok() || flash.0.borrow().has_power() {
                continue;
            } // cut inside
            drop(store);
            tried += 1;
            flash.0.borrow_mut().restart();
            // First start.
            let (mut store, keys) = FlashKeyStore::open::<Hmac>(flash.clone(), REGION).unwrap();
            let Some(mut keys) = keys else { continue };
            if keys.rollover_state() != RolloverState::Applied {
                continue;
            }
            // The peer is heard with the new key: confirmed, and stored. The peer retires the old key.
            let f = signed::<Hmac>(&K2, 255, 2, NOW);
            let v = ReplayGuard::new(2, Window::ONE_MINUTE)
                .admit(
                    keys.authenticate(FrameRef::parse(f.as_bytes()).unwrap())
                        .unwrap(),
                    at(NOW),
                )
                .unwrap();
            keys.on_accepted(&v);
            keys.confirm(&mut store).unwrap();
            assert_eq!(keys.rollover_state(), RolloverState::Confirmed);
            drop(store);
            // Second start.
            let (_store, keys) = FlashKeyStore::open::<Hmac>(flash.clone(), REGION).unwrap();
            let keys = keys.expect("keys");
            if keys.rollover_state() != RolloverState::Confirmed {
                ghosts += 1;
                if keys
                    .authenticate(FrameRef::parse(f.as_bytes()).unwrap())
                    .is_err()
                {
                    deaf += 1
                }
                if ghosts == 1 {
                    println!(
                        "chance {chance}, cut {cut}: confirmed and stored, then {:?}",
                        keys.rollover_state()
                    );
                }
            }
        }
    }
    println!("{tried} cuts; ghosts {ghosts}, new key gone {deaf}");
    assert_eq!(ghosts, 0);
}

/// The same for a whole device that is given a new key by `provision`, cut; it goes on with the old ones for a while.
#[test]
fn a_record_that_comes_back_provisions_no_key() {
    let mut ghosts = 0;
    let mut tried = 0;
    for chance in 0..30u64 {
        for cut in 0..12 {
            let flash = Shared::new(chance);
            let (mut store, _) = FlashKeyStore::open::<Hmac>(flash.clone(), REGION).unwrap();
            let mut keys: KeyRing<Hmac> = store.provision(&K1).unwrap();
            store.set_in_use().unwrap();
            keys.apply(&K2, &mut store).unwrap();
            flash.0.borrow_mut().cut_after(cut);
            let _ = store.provision::<Hmac>(&K3);
            if flash.0.borrow().has_power() {
                continue;
            }
            drop(store);
            tried += 1;
            flash.0.borrow_mut().restart();
            let (store, keys) = FlashKeyStore::open::<Hmac>(flash.clone(), REGION).unwrap();
            let Some(keys) = keys else { continue };
            if keys.rollover_state() != RolloverState::Applied {
                continue;
            }
            drop(store);
            for start in 0..4 {
                let (_s, keys) = FlashKeyStore::open::<Hmac>(flash.clone(), REGION).unwrap();
                let keys = keys.expect("keys");
                if keys.rollover_state() != RolloverState::Applied {
                    ghosts += 1;
                    if ghosts == 1 {
                        println!(
                            "chance {chance} cut {cut} start {start}: {:?}",
                            keys.rollover_state()
                        );
                    }
                    break;
                }
            }
        }
    }
    println!("{tried} cuts; ghosts {ghosts}");
    assert_eq!(ghosts, 0);
}

fn memory(
    timer: &Cell<u64>,
    first: FirstKey<'_>,
) -> (R, LinkMemory<Flash<2>, impl FnMut() -> u64>) {
    let flash = LinkFlash {
        keys: Flash::<2>::new(1),
        marks: [Flash::new(2), Flash::new(3)],
        region: REGION,
    };
    let (keys, memory) = LinkMemory::open::<Hmac>(flash, first, || timer.get()).unwrap();
    (relay(keys), memory)
}

/// The new key, the old one (taken back), the new one again: documented; the same SETUP_SIGNING message both times.
#[test]
fn no_stamp_twice_after_a_change_was_taken_back() {
    for synced in [false, true] {
        let timer = Cell::new(1000);
        let (mut relay, mut m) = memory(&timer, FirstKey::Own(&K1));
        if synced {
            m.clock.update(TimeSource::Trusted, at(NOW)).unwrap();
        }
        let once = setup(K2, NOW);
        relay
            .apply_setup(&once, &mut m.clock, &mut m.store)
            .unwrap();
        let mut used = vec![];
        for _ in 0..5 {
            timer.set(timer.get() + S);
            used.push(send(&mut relay, &mut m.clock, 1).unwrap());
        }
        let peer = signed::<Hmac>(&K2, 255, 2, NOW + 4 * S);
        // not heard in time to confirm: nothing accepted
        relay
            .apply_setup(&setup(K1, NOW + 6 * S), &mut m.clock, &mut m.store)
            .unwrap();
        assert_eq!(relay.keys().rollover_state(), RolloverState::Settled);
        relay
            .apply_setup(&once, &mut m.clock, &mut m.store)
            .unwrap();
        assert_eq!(relay.keys().rollover_state(), RolloverState::Applied);
        let mut again = vec![];
        for _ in 0..5 {
            timer.set(timer.get() + S);
            again.push(send(&mut relay, &mut m.clock, 1).unwrap());
        }
        let twice = again.iter().filter(|s| used.contains(s)).count();
        let back = again[0] <= *used.last().unwrap();
        println!(
            "synced {synced}: stamps of the new key {used:?}, then {again:?}: back {back}, twice {twice}; peer {:?}",
            hear(&mut relay, &mut m.clock, &peer)
        );
        assert!(!back, "stamps of one key went back");
    }
}

/// A frame that was accepted under the new key is accepted again.
#[test]
fn no_replay_after_a_change_was_taken_back() {
    let timer = Cell::new(1000);
    let (mut r, mut m) = memory(&timer, FirstKey::Own(&K1));
    let once = setup(K2, NOW);
    r.apply_setup(&once, &mut m.clock, &mut m.store).unwrap();
    let f = signed::<Hmac>(&K2, 255, 2, NOW + S);
    assert_eq!(hear(&mut r, &mut m.clock, &f), Ok(()));
    // Power fails before `confirm_key` was called: `heard` is in memory alone.
    let LinkMemory { store, clock } = m;
    let [a, b] = clock.into_flashes();
    let flash = LinkFlash {
        keys: store.into_flash(),
        marks: [a.unwrap(), b.unwrap()],
        region: REGION,
    };
    let (keys, mut m) = LinkMemory::open::<Hmac>(flash, FirstKey::None, || timer.get()).unwrap();
    let mut r = relay(keys);
    r.apply_setup(&setup(K1, NOW + 2 * S), &mut m.clock, &mut m.store)
        .unwrap();
    r.apply_setup(&once, &mut m.clock, &mut m.store).unwrap();
    let again = hear(&mut r, &mut m.clock, &f);
    println!("the same frame under the same key: {again:?}");
    assert_eq!(again, Err(RejectReason::Replayed));
}

/// The same key given by `LinkMemory::provision` once more.
#[test]
fn a_key_that_is_provisioned_again_goes_on() {
    let timer = Cell::new(1000);
    let (mut r, mut m) = memory(&timer, FirstKey::Own(&K1));
    let f = signed::<Hmac>(&K1, 255, 2, NOW);
    assert_eq!(hear(&mut r, &mut m.clock, &f), Ok(()));
    let used = send(&mut r, &mut m.clock, 1).unwrap();
    let LinkMemory { store, clock } = m;
    let [a, b] = clock.into_flashes();
    let flash = LinkFlash {
        keys: store.into_flash(),
        marks: [a.unwrap(), b.unwrap()],
        region: REGION,
    };
    match LinkMemory::provision::<Hmac>(flash, &K1, || timer.get()) {
        Err(e) => println!("{e:?}"),
        Ok((keys, mut m)) => {
            let mut r = relay(keys);
            let again = hear(&mut r, &mut m.clock, &f);
            let stamp = send(&mut r, &mut m.clock, 1).unwrap();
            println!("provision(same key): the same frame {again:?}; stamp {used} then {stamp}");
            assert!(again.is_err() && stamp > used);
        }
    }
}

fn setup_frame(key: &[u8; 32], s: &SetupSigning, ticks: u64) -> Vec<u8> {
    let mut f = s.to_frame(header(255)).unwrap();
    sign_frame(
        &mut f,
        &SigningKey::<Hmac>::new(key).unwrap(),
        Stamp {
            link_id: 9,
            timestamp: at(ticks),
        },
    )
    .unwrap();
    f.as_bytes().to_vec()
}
/// The holder of the old key plays one SETUP_SIGNING (even for somebody else) far ahead on the local side; then the key
/// is changed. Proofs with the new key are rejected.
#[test]
fn proof_with_an_old_key_ends_with_it() {
    let timer = Cell::new(1000);
    let (mut r, mut m) = memory(&timer, FirstKey::Own(&K1));
    r.keep_setup(1, 25);
    let mut o = |_| {};
    hear(&mut r, &mut m.clock, &signed::<Hmac>(&K1, 255, 2, NOW)).unwrap();
    let mut other = setup(K3, NOW);
    other.target_system = 77;
    r.received(
        Side::Local,
        &setup_frame(&K1, &other, NOW + 300 * 24 * 3600 * S),
        &mut m.clock,
        &mut o,
    );
    assert!(r.take_setup().is_none());
    // A new key, by presence; confirmed and retired.
    r.apply_setup(&setup(K2, NOW + 10 * S), &mut m.clock, &mut m.store)
        .unwrap();
    hear(
        &mut r,
        &mut m.clock,
        &signed::<Hmac>(&K2, 255, 2, NOW + 11 * S),
    )
    .unwrap();
    r.confirm_key(&mut m.store).unwrap();
    r.retire_key(&mut m.store).unwrap();
    let mut why = vec![];
    r.received(
        Side::Local,
        &setup_frame(&K2, &setup(K3, NOW + 20 * S), NOW + 20 * S),
        &mut m.clock,
        &mut |e| why.push(e),
    );
    println!(
        "SETUP_SIGNING with proof of the new key: taken {:?}, {why:?}",
        r.take_setup()
    );
    let mut why2 = vec![];
    r.received(
        Side::Local,
        &setup_frame(&K2, &setup(K3, NOW + 20 * S), NOW + 21 * S),
        &mut m.clock,
        &mut |e| why2.push(e),
    );
    assert!(
        !why2.contains(&Event::Rejected(
            Direction::Outbound,
            RejectReason::Replayed
        )),
        "{why2:?}"
    );
}

/// At the end that OFFERS, whoever has the old key moves the clock while the change is under way, and it stays.
#[test]
fn an_old_key_moves_no_end_for_good() {
    let timer = Cell::new(1000);
    let (mut r, mut m) = memory(&timer, FirstKey::Own(&K1));
    hear(&mut r, &mut m.clock, &signed::<Hmac>(&K1, 1, 2, NOW)).unwrap();
    r.offer_key(&K2, at(NOW + S), &mut m.clock, &mut m.store)
        .unwrap();
    let attack = hear(
        &mut r,
        &mut m.clock,
        &signed::<Hmac>(&K1, 1, 2, NOW + 364 * 24 * 3600 * S),
    );
    // The vehicle has taken it, and is heard with it.
    let honest = hear(
        &mut r,
        &mut m.clock,
        &signed::<Hmac>(&K2, 1, 2, NOW + 5 * S),
    );
    r.confirm_key(&mut m.store).unwrap();
    r.retire_key(&mut m.store).unwrap();
    let stamp = send(&mut r, &mut m.clock, 255).unwrap();
    println!(
        "attack {attack:?}, honest {honest:?}, stamp with the new key {} days ahead",
        (stamp.saturating_sub(NOW)) / (24 * 3600 * S)
    );
    assert!(stamp < NOW + 60 * S);
}
/// The same, but the attack comes after the vehicle was heard, right before `confirm_key`: nothing honest comes behind.
#[test]
fn an_old_key_moves_nothing_once_the_new_one_was_heard() {
    let timer = Cell::new(1000);
    let (mut r, mut m) = memory(&timer, FirstKey::Own(&K1));
    hear(&mut r, &mut m.clock, &signed::<Hmac>(&K1, 1, 2, NOW)).unwrap();
    r.offer_key(&K2, at(NOW + S), &mut m.clock, &mut m.store)
        .unwrap();
    let honest = hear(
        &mut r,
        &mut m.clock,
        &signed::<Hmac>(&K2, 1, 2, NOW + 5 * S),
    );
    let attack = hear(
        &mut r,
        &mut m.clock,
        &signed::<Hmac>(&K1, 1, 2, NOW + 364 * 24 * 3600 * S),
    );
    r.confirm_key(&mut m.store).unwrap();
    let stamp = send(&mut r, &mut m.clock, 255).unwrap();
    println!(
        "honest {honest:?}, attack {attack:?}, stamp with the new key {} days ahead",
        (stamp.saturating_sub(NOW)) / (24 * 3600 * S)
    );
    // From now on, for ever with this key: the stamper does not go back.
    hear(
        &mut r,
        &mut m.clock,
        &signed::<Hmac>(&K2, 1, 2, NOW + 9 * S),
    )
    .unwrap();
    let stamp = send(&mut r, &mut m.clock, 255).unwrap();
    assert!(
        stamp < NOW + 60 * S,
        "the stamps of the new key are {} days ahead for good",
        (stamp - NOW) / (24 * 3600 * S)
    );
}

/// Several cuts in a row in the very first write.
#[test]
fn three_cuts_in_a_row_in_the_first_provisioning() {
    for cuts in 1..=3 {
        let (mut dead, mut all) = (0, 0);
        for chance in 0..30u64 {
            let flash = Shared::new(chance);
            let marks = [Shared::new(chance + 1), Shared::new(chance + 2)];
            let lf = || LinkFlash {
                keys: flash.clone(),
                marks: marks.clone(),
                region: REGION,
            };
            for _ in 0..cuts {
                flash.0.borrow_mut().cut_after(0);
                let _ = LinkMemory::open::<Hmac>(lf(), FirstKey::Own(&K1), || 0);
                flash.0.borrow_mut().restart();
            }
            all += 1;
            let mut never = true;
            for _ in 0..10 {
                never &= LinkMemory::open::<Hmac>(lf(), FirstKey::Own(&K1), || 0).is_err();
            }
            dead += u32::from(never);
        }
        assert_eq!((dead, all), (0, 30), "{cuts} cuts in a row");
    }
}
/// One store fails for a moment (no cut): the flash holds one copy of a state that memory does not have.
#[test]
fn a_failed_change_and_then_another() {
    let mut stuck = 0;
    let mut all = 0;
    for chance in 0..100u64 {
        let timer = Cell::new(1000);
        let flash = Shared::new(chance);
        let marks = [Shared::new(chance + 1), Shared::new(chance + 2)];
        let lf = || LinkFlash {
            keys: flash.clone(),
            marks: marks.clone(),
            region: REGION,
        };
        let (keys, mut m) =
            LinkMemory::open::<Hmac>(lf(), FirstKey::Own(&K1), || timer.get()).unwrap();
        let mut r = relay(keys);
        flash.0.borrow_mut().fail(20);
        let one = r.apply_setup(&setup(K2, NOW), &mut m.clock, &mut m.store);
        if one.is_ok() {
            continue;
        }
        all += 1;
        let two = r.apply_setup(&setup(K3, NOW), &mut m.clock, &mut m.store);
        if two.is_ok() {
            continue;
        }
        flash.0.borrow_mut().fail(0);
        let again = LinkMemory::open::<Hmac>(lf(), FirstKey::None, || timer.get());
        if let Err(e) = again {
            stuck += 1;
            if stuck == 1 {
                println!("{e:?}")
            }
        }
    }
    assert!(all > 0);
    assert_eq!(stuck, 0, "of {all} failed changes");
}
