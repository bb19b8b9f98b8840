//! Opening: the acceptance trace, the order of checks, and what a rejection leaves behind.

use mavlink_commsec::{
    AesGcm, Cipher as _, Credential, INTEGRITY_LIMIT, Nonce, OpenError, Opener, PermitError,
    Sealer, SealingKeyError, SenderId,
};

use crate::common::{assert_rejected, hex, key, last, message, receiver, seal};
use crate::vectors::{self, A, B, B2, B8, BASE_KEY, BASE_SALT, C, UAV_KEY, UAV_SALT};

const ALL_IDS: [u32; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

fn stale(counter: u32, last: u32) -> OpenError {
    OpenError::Stale { counter, last }
}

/// A vehicle as SMACCMPilot's: every id from 0 to 15, one key.
fn vehicle() -> Opener<16> {
    receiver(BASE_KEY, BASE_SALT, ALL_IDS)
}

/// Row by row, in the order of the reference; each row says what the vehicle remembers of station 5.
#[test]
fn acceptance_trace() {
    let mut vehicle = vehicle();
    let with = |digits: &str, at: usize, bytes: &[u8]| {
        let mut package = hex(digits);
        package[at..at + bytes.len()].copy_from_slice(bytes);
        package
    };
    // 1: B is accepted.
    let opened = vehicle.open(&hex(B.package)).expect("row 1");
    assert_eq!(opened.plaintext(), &message(B.plain));
    assert_eq!((opened.sender(), opened.counter()), (SenderId(5), 1));
    assert_eq!(last(&vehicle, 5), 1);
    // 2: B again is stale.
    assert_rejected(&mut vehicle, &hex(B.package), stale(1, 1));
    // 3: C is accepted, a jump.
    let opened = vehicle.open(&hex(C.package)).expect("row 3");
    assert_eq!(opened.plaintext(), &message(C.plain));
    assert_eq!(last(&vehicle, 5), 31_870);
    // 4: B2, genuine and late.
    assert_rejected(&mut vehicle, &hex(B2.package), stale(2, 31_870));
    // 5: C with its last bit changed is stale, not a bad tag: order comes first.
    let changed = with(C.package, 95, &[0xB7 ^ 1]);
    assert_rejected(&mut vehicle, &changed, stale(31_870, 31_870));
    assert_eq!(vehicle.failed_opens(SenderId(5)), Some(0));
    // 6: C with another counter.
    let changed = with(C.package, 4, &[0, 0, 0x7C, 0x7F]);
    assert_rejected(&mut vehicle, &changed, OpenError::BadTag);
    // 7: B with an id that nobody has.
    let changed = with(B.package, 0, &[0, 0, 0, 16]);
    assert_rejected(
        &mut vehicle,
        &changed,
        OpenError::UnknownSender(SenderId(16)),
    );
    // 8: B with the id of another station.
    let changed = with(B.package, 0, &[0, 0, 0, 6]);
    assert_rejected(&mut vehicle, &changed, OpenError::BadTag);
    assert_eq!(last(&vehicle, 6), 0);
    // 9: A, which goes the other way.
    assert_rejected(&mut vehicle, &hex(A.package), OpenError::BadTag);
    assert_eq!(last(&vehicle, 7), 0);
    // 10: B8, and a vehicle that has heard nobody.
    let mut fresh = self::vehicle();
    assert_rejected(&mut fresh, &hex(B8.package), OpenError::BadTag);
    assert_eq!(last(&fresh, 5), 0);
    // 11: other lengths.
    for length in [95, 97] {
        let mut package = hex(B2.package);
        package.resize(length, 0);
        assert_rejected(&mut vehicle, &package, OpenError::WrongLength(length));
    }
    assert_eq!(last(&vehicle, 5), 31_870);
    assert_eq!(vehicle.failed_opens(SenderId(5)), Some(3));
    assert_eq!(fresh.failed_opens(SenderId(5)), Some(1));
}

#[test]
fn reference_packages_open() {
    for vector in vectors::ALL {
        let last = (SenderId(vector.id), vector.counter - 1);
        let mut opener = Opener::<1>::new();
        let permitted = opener.resume(key(vector.key, vector.salt), &[last]);
        permitted.expect("there is room");
        let opened = opener.open(&hex(vector.package)).expect(vector.name);
        assert_eq!(
            opened.plaintext(),
            &message(vector.plain),
            "{}",
            vector.name
        );
        assert_eq!(opened.counter(), vector.counter, "{}", vector.name);
    }
}

#[test]
fn every_other_length_is_rejected() {
    let mut vehicle = vehicle();
    for length in (0..96).chain(97..=200) {
        let package: Vec<u8> = hex(B.package).into_iter().cycle().take(length).collect();
        assert_rejected(&mut vehicle, &package, OpenError::WrongLength(length));
    }
    assert_rejected(&mut vehicle, &hex(vectors::E), OpenError::WrongLength(100));
}

#[test]
fn every_changed_bit_is_rejected() {
    let package = hex(B.package);
    let mut vehicle = receiver(BASE_KEY, BASE_SALT, [5]);
    for bit in 0..8 * package.len() {
        let mut changed = package.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let error = match bit / 8 {
            0..4 => {
                let id = u32::from_be_bytes(*changed.first_chunk().expect("4 bytes"));
                OpenError::UnknownSender(SenderId(id))
            }
            // Counter 1 with its last bit changed is 0, which nobody uses.
            7 if bit % 8 == 0 => stale(0, 0),
            _ => OpenError::BadTag,
        };
        assert_rejected(&mut vehicle, &changed, error);
    }
    assert_eq!(vehicle.failed_opens(SenderId(5)), Some(31 + 88 * 8));
    assert!(vehicle.open(&package).is_ok());
}

#[test]
fn another_key_salt_or_sender_is_rejected() {
    let other_key = "000102030405060708090a0b0c0d0e1f";
    for (key, salt) in [(other_key, BASE_SALT), (BASE_KEY, BASE_SALT + 1)] {
        let mut opener = receiver(key, salt, [5]);
        assert_rejected(&mut opener, &hex(B.package), OpenError::BadTag);
    }
    let mut opener = receiver(BASE_KEY, BASE_SALT, [6]);
    let unknown = OpenError::UnknownSender(SenderId(5));
    assert_rejected(&mut opener, &hex(B.package), unknown);
    assert_eq!(opener.failed_opens(SenderId(5)), None);
}

/// Two stations with keys of their own, each heard as itself alone.
#[test]
fn each_sender_has_its_key() {
    let other = "a1a2a3a4a5a6a7a8a9aaabacadaeafb0";
    let mut vehicle = Opener::<2>::new();
    for (digits, salt, id) in [(BASE_KEY, BASE_SALT, 5), (other, 99, 6)] {
        let permitted = vehicle.permit(key(digits, salt), &[SenderId(id)]);
        permitted.expect("there is room");
    }
    let mut six: Sealer = Sealer::new(key(other, 99), SenderId(6));
    let mut six_as_five: Sealer = Sealer::new(key(other, 99), SenderId(5));
    let forged = six_as_five.seal(&[1; 80]).expect("a counter is left");
    assert_rejected(&mut vehicle, forged.as_bytes(), OpenError::BadTag);
    let genuine = six.seal(&[2; 80]).expect("a counter is left");
    assert!(vehicle.open(genuine.as_bytes()).is_ok());
    assert!(vehicle.open(&hex(B.package)).is_ok());
    assert_eq!(
        vehicle.senders().collect::<Vec<_>>(),
        [(SenderId(5), 1), (SenderId(6), 1)]
    );
    // The forgery was charged to the key that it claimed.
    assert_eq!(vehicle.failed_opens(SenderId(5)), Some(1));
    assert_eq!(vehicle.failed_opens(SenderId(6)), Some(0));
}

/// A vehicle hears no packages that come back to it, even where a station has its id.
#[test]
fn reflected_packages_are_rejected() {
    let mut vehicle = vehicle();
    let package = seal(&A).expect("a counter is left");
    assert_rejected(&mut vehicle, package.as_bytes(), OpenError::BadTag);
}

#[test]
fn wrong_tags_wear_a_key_out() {
    let forged = |counter: u32| {
        let mut package = hex(B.package);
        package[4..8].copy_from_slice(&counter.to_be_bytes());
        package
    };
    let mut opener = Opener::<3>::with_limit(3);
    let shared = opener.permit(key(BASE_KEY, BASE_SALT), &[SenderId(5), SenderId(6)]);
    shared.expect("there is room");
    let own = opener.permit(key(UAV_KEY, UAV_SALT), &[SenderId(7)]);
    own.expect("there is room");
    for failed in 1..=3 {
        let mut package = forged(9);
        package[3] = 5 + (failed % 2) as u8;
        assert_rejected(&mut opener, &package, OpenError::BadTag);
        assert_eq!(opener.failed_opens(SenderId(5)), Some(failed));
        assert_eq!(opener.failed_opens(SenderId(6)), Some(failed));
    }
    // From now on nothing of this key is tried, not even what is genuine; the order of checks stays.
    assert_rejected(
        &mut opener,
        &hex(B.package),
        OpenError::IntegrityLimitReached,
    );
    assert_rejected(&mut opener, &forged(0), stale(0, 0));
    assert_eq!(opener.failed_opens(SenderId(5)), Some(3));
    // The other key is as good as before.
    assert!(opener.open(&hex(A.package)).is_ok());
}

#[test]
fn usual_limit() {
    assert_eq!(INTEGRITY_LIMIT, u32::MAX);
    let mut opener = receiver(BASE_KEY, BASE_SALT, [5]);
    let mut package = hex(B.package);
    package[95] ^= 1;
    for _ in 0..1_000 {
        assert_rejected(&mut opener, &package, OpenError::BadTag);
    }
    assert!(opener.open(&hex(B.package)).is_ok());
}

#[test]
fn resumed_receiver_rejects_what_was_before() {
    let mut opener = Opener::<1>::new();
    let resumed = opener.resume(key(BASE_KEY, BASE_SALT), &[(SenderId(5), 1)]);
    resumed.expect("there is room");
    assert_rejected(&mut opener, &hex(B.package), stale(1, 1));
    assert!(opener.open(&hex(B2.package)).is_ok());
}

/// A genuine package with the counter behind the last one would make its sender's row reject everything.
#[test]
fn no_counter() {
    let nonce: Nonce = hex("0000435300000005ffffffff")
        .try_into()
        .expect("12 bytes");
    let mut sealed = [7; 80];
    let cipher = AesGcm::new(hex(BASE_KEY)[..].try_into().expect("16 bytes"));
    let tag = cipher.seal(&nonce, &mut sealed).expect("AES does not fail");
    let package = [&nonce[4..], &sealed, &tag].concat();
    let mut opener = receiver(BASE_KEY, BASE_SALT, [5]);
    assert_rejected(&mut opener, &package, OpenError::NoCounter(SenderId(5)));
    assert_eq!(opener.failed_opens(SenderId(5)), Some(0));
    assert!(opener.open(&hex(B.package)).is_ok());
}

/// The last counter is accepted like any other; behind it there is nothing.
#[test]
fn last_counter() {
    let end = u32::MAX - 1;
    let mut opener = Opener::<1>::new();
    let resumed = opener.resume(key(BASE_KEY, BASE_SALT), &[(SenderId(15), end - 1)]);
    resumed.expect("there is room");
    assert!(opener.open(&hex(vectors::F.package)).is_ok());
    assert_rejected(&mut opener, &hex(vectors::F.package), stale(end, end));
}

/// Stations of one key are permitted with one key; marks are kept.
#[test]
fn receiver_of_credentials() {
    let credential = |id, digits: &str, salt| Credential {
        id: SenderId(id),
        key: hex(digits).try_into().expect("16 bytes"),
        salt,
    };
    let all = [
        credential(5, BASE_KEY, BASE_SALT),
        credential(7, UAV_KEY, UAV_SALT),
        credential(6, BASE_KEY, BASE_SALT),
        credential(8, BASE_KEY, BASE_SALT + 1),
    ];
    let mut opener = Opener::<4>::from_credentials(&all, |id| id.0 - 5).expect("there is room");
    let senders: Vec<_> = opener.senders().map(|(id, last)| (id.0, last)).collect();
    assert_eq!(senders, [(5, 0), (6, 1), (7, 2), (8, 3)]);
    let mut forged = hex(B.package);
    forged[4..8].copy_from_slice(&[0, 0, 0, 9]);
    assert_rejected(&mut opener, &forged, OpenError::BadTag);
    let failed = [5, 6, 7, 8].map(|id| opener.failed_opens(SenderId(id)));
    assert_eq!(failed, [Some(1), Some(1), Some(0), Some(0)]);
    assert!(opener.open(&hex(B.package)).is_ok());
    assert_rejected(&mut opener, &hex(A.package), stale(1, 2));

    let error =
        |credentials: &[Credential]| Opener::<4>::from_credentials(credentials, |_| 0).err();
    let zero = credential(1, "00000000000000000000000000000000", 1);
    assert_eq!(
        error(&[zero]),
        Some(PermitError::Key(SealingKeyError::AllZero))
    );
    let twice = [credential(5, BASE_KEY, 1), credential(5, UAV_KEY, 1)];
    assert_eq!(
        error(&twice),
        Some(PermitError::DuplicateSender(SenderId(5)))
    );
    let five = [1, 2, 3, 4, 5].map(|id| credential(id, BASE_KEY, id));
    assert_eq!(error(&five), Some(PermitError::TableFull));
    assert_eq!(error(&[]), None);
}

#[test]
fn permitting() {
    let five_six = [SenderId(5), SenderId(6)];
    let new_key = || key(BASE_KEY, BASE_SALT);
    let mut opener = Opener::<3>::new();
    assert_eq!(opener.permit(new_key(), &[]), Err(PermitError::NoSender));
    let twice = [SenderId(5), SenderId(6), SenderId(5)];
    let error = PermitError::DuplicateSender(SenderId(5));
    assert_eq!(opener.permit(new_key(), &twice), Err(error));
    assert_eq!(opener.senders().count(), 0);
    assert_eq!(opener.permit(new_key(), &five_six), Ok(()));
    assert_eq!(opener.permit(new_key(), &[SenderId(5)]), Err(error));
    let seven_eight = [SenderId(7), SenderId(8)];
    let full = Err(PermitError::TableFull);
    assert_eq!(opener.permit(new_key(), &seven_eight), full);
    assert_eq!(opener.senders().count(), 2);
    assert_eq!(opener.permit(new_key(), &[SenderId(7)]), Ok(()));
    assert_eq!(opener.permit(new_key(), &[SenderId(8)]), full);
    let ids: Vec<_> = opener.senders().map(|(sender, _)| sender.0).collect();
    assert_eq!(ids, [5, 6, 7]);
    assert!(opener.open(&hex(B.package)).is_ok());
}
