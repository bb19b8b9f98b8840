//! Sealing: the reference packages, counters, and the end of them.

use mavlink_commsec::field::{HEADER_SIZE, PLAINTEXT_SIZE};
use mavlink_commsec::{
    AesGcm, Cipher, CipherError, Credential, EpochHeader, EpochSenderId, Nonce, PackageTag, Packer,
    Plaintext, SealError, Sealer, SealingKey, SealingKeyError, SenderId, ZeroizeOnDrop, hx,
    packets,
};

use crate::common::{hex, key, message, seal};
use crate::vectors::{self, BASE_KEY, BASE_SALT};

#[test]
fn reference_packages() {
    for vector in vectors::ALL {
        let package = seal(vector).expect("a counter is left");
        assert_eq!(
            package.as_bytes()[..],
            hex(vector.package),
            "{}",
            vector.name
        );
    }
}

/// A key of zeros is rejected as a key, and the cipher behind it agrees with the reference.
#[test]
fn key_of_zeros() {
    assert_eq!(
        SealingKey::<AesGcm>::new(&[0; 16], 0).err(),
        Some(SealingKeyError::AllZero)
    );
    let nonce = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1];
    let mut sealed = [0; PLAINTEXT_SIZE];
    let tag = AesGcm::new(&[0; 16]).seal(&nonce, &mut sealed);
    let expected = hex(vectors::G);
    assert_eq!(expected[HEADER_SIZE..][..PLAINTEXT_SIZE], sealed);
    assert_eq!(
        expected[HEADER_SIZE + PLAINTEXT_SIZE..],
        tag.expect("a tag")
    );
}

#[test]
fn keys_of_other_lengths() {
    for length in [0, 15, 17, 32] {
        let key = SealingKey::<AesGcm>::new(&vec![1; length], 1);
        assert_eq!(key.err(), Some(SealingKeyError::WrongLength(length)));
    }
}

/// One byte other than zero is a key, wherever it stands.
#[test]
fn keys_with_one_byte() {
    for at in 0..16 {
        let mut bytes = [0; 16];
        bytes[at] = 1;
        assert!(SealingKey::<AesGcm>::new(&bytes, 0).is_ok());
    }
}

/// The old test program sealed 84 bytes: the first 80 come out the same.
#[test]
fn longer_package_has_the_same_keystream() {
    let mut text = [b' '; PLAINTEXT_SIZE];
    text[..27].copy_from_slice(b"This is a message from uav!");
    let mut sealer: Sealer = Sealer::new(key(BASE_KEY, 284_920), SenderId(0));
    let package = sealer.seal(&text).expect("a counter is left");
    let same = HEADER_SIZE + PLAINTEXT_SIZE;
    assert_eq!(package.as_bytes()[..same], hex(vectors::E)[..same]);
    assert_ne!(package.as_bytes()[same..], hex(vectors::E)[same..][..8]);
}

/// A package of the draft with epochs is one of this format too, of another sender and counter: under
/// one key, the two formats would use nonces twice.
#[test]
fn epochs_would_collide() {
    let mut sealer: Sealer = Sealer::resume(key(BASE_KEY, BASE_SALT), SenderId(1), 0x0002_0005);
    let package = sealer.seal(&message(vectors::B.plain));
    assert_eq!(
        package.expect("a counter is left").as_bytes()[..],
        hex(vectors::X)
    );
}

#[test]
fn counters_begin_at_one_and_go_up_by_one() {
    let mut sealer: Sealer = Sealer::new(key(BASE_KEY, BASE_SALT), SenderId(5));
    for counter in 1..=300_u32 {
        assert_eq!(sealer.next_counter(), Some(counter));
        let package = sealer
            .seal(&[0; PLAINTEXT_SIZE])
            .expect("a counter is left");
        let header: &[u8; 8] = package.as_bytes().first_chunk().expect("96 bytes");
        let header = mavlink_commsec::PackageHeader::from_wire(header);
        assert_eq!((header.sender, header.counter), (SenderId(5), counter));
    }
    assert_eq!(sealer.id(), SenderId(5));
}

#[test]
fn counter_zero_is_never_used() {
    let sealer: Sealer = Sealer::resume(key(BASE_KEY, BASE_SALT), SenderId(5), 0);
    assert_eq!(sealer.next_counter(), Some(1));
}

#[test]
fn exhausted_counter_sends_nothing() {
    let mut sealer: Sealer = Sealer::resume(key(BASE_KEY, BASE_SALT), SenderId(15), u32::MAX - 1);
    let last = sealer.seal(&[0; PLAINTEXT_SIZE]).expect("the last one");
    assert_eq!(last.as_bytes()[..], hex(vectors::F.package));
    for _ in 0..3 {
        assert_eq!(sealer.next_counter(), None);
        let rejected = sealer.seal(&[0; PLAINTEXT_SIZE]);
        assert_eq!(rejected, Err(SealError::CounterExhausted));
    }
}

/// A unit that fails now and then, and leaves the message as it is.
struct Unit(core::cell::Cell<u32>);

impl ZeroizeOnDrop for Unit {}

impl Cipher for Unit {
    fn new(_: &[u8; 16]) -> Self {
        Self(core::cell::Cell::new(0))
    }

    fn seal(&self, _: &Nonce, _: &mut Plaintext) -> Result<PackageTag, CipherError> {
        self.0.set(self.0.get() + 1);
        if self.0.get().is_multiple_of(2) {
            Ok([7; 8])
        } else {
            Err(CipherError)
        }
    }

    fn open(&self, _: &Nonce, _: &mut Plaintext, _: &PackageTag) -> Result<(), CipherError> {
        Err(CipherError)
    }
}

/// Erased flash is no key either; one bit of another makes one.
#[test]
fn key_of_erased_flash() {
    let made = |bytes: &[u8]| SealingKey::<AesGcm>::new(bytes, 0).err();
    assert_eq!(made(&[0xFF; 16]), Some(SealingKeyError::Erased));
    for at in [0, 7, 15] {
        let mut bytes = [0xFF; 16];
        bytes[at] = 0xFE;
        assert_eq!(made(&bytes), None);
        let mut bytes = [0; 16];
        bytes[at] = 1;
        assert_eq!(made(&bytes), None);
    }
}

/// What a unit failed to seal is not sent, and its counter is not used again.
#[test]
fn failed_unit_uses_the_counter_up() {
    let key = SealingKey::<Unit>::new(&[1; 16], 1).expect("a key");
    let mut sealer = Sealer::new(key, SenderId(5));
    assert_eq!(sealer.seal(&[1; PLAINTEXT_SIZE]), Err(SealError::Cipher));
    assert_eq!(sealer.next_counter(), Some(2));
    let sealed = sealer
        .seal(&[1; PLAINTEXT_SIZE])
        .expect("every second time");
    assert_eq!(sealed.as_bytes()[4..8], [0, 0, 0, 2]);
}

/// Nothing that holds a key or a message shows it.
#[test]
fn debug_shows_no_secrets() {
    let frame = hx::Frame::new(hx::FrameKind::Radio, &[0x41; 20]).expect("a frame");
    let shown = [
        format!("{:?}", key(BASE_KEY, BASE_SALT)),
        format!("{:?}", AesGcm::new(&[0x41; 16])),
        format!(
            "{:?}",
            Credential {
                id: SenderId(5),
                key: [0x41; 16],
                salt: 0x4242_4242,
            }
        ),
        format!(
            "{:?}",
            Sealer::<AesGcm>::new(key(BASE_KEY, BASE_SALT), SenderId(5))
        ),
        format!(
            "{:?}",
            crate::common::receiver(BASE_KEY, BASE_SALT, [5]).open(&hex(vectors::B.package))
        ),
        format!("{:?}", crate::common::receiver(BASE_KEY, BASE_SALT, [5])),
        {
            let mut packer = Packer::new(core::time::Duration::ZERO);
            let packet = [0xFE, 2, 0, 1, 1, 30, 0x41, 0x42, 3, 4];
            let pushed = packer.push(&packet, core::time::Duration::ZERO);
            assert_eq!(pushed, Ok(None));
            format!("{packer:?}")
        },
        format!("{:?}", packets(&[0x41; PLAINTEXT_SIZE])),
        format!("{frame:?}"),
        format!("{:?}", frame.encode()),
        {
            let mut decoder = hx::Decoder::new();
            for byte in frame.encode().take(12) {
                assert_eq!(decoder.push(byte), None);
            }
            format!("{decoder:?}")
        },
    ];
    let expected = [
        "Key(redacted)",
        "AesGcm(redacted)",
        "Credential { id: SenderId(5), .. }",
        "Sealer { key: Key(redacted), id: SenderId(5), next: 1 }",
        "Ok(Opened { header: PackageHeader { sender: SenderId(5), counter: 1 }, .. })",
        "Opener { senders: [Row { sender: SenderId(5), key: 0, seen: Seen { newest: 0, behind: 18446744073709551615, passed_over: 0 } }], limit: 4294967295, .. }",
        "Packer { pending: 10, rejected: 0, .. }",
        "Packets { rest: 80 }",
        "Frame { kind: Radio, payload: 20 }",
        "Encode { payload: 20, .. }",
        "Decoder { state: Payload(Radio), payload: 10 }",
    ];
    assert_eq!(shown, expected);
}

#[test]
fn credential_is_the_key() {
    let vector = &vectors::B;
    let credential = Credential {
        id: SenderId(vector.id),
        key: hex(vector.key).try_into().expect("16 bytes"),
        salt: vector.salt,
    };
    let key = credential.prepare::<AesGcm>().expect("a key");
    let package = Sealer::new(key, credential.id).seal(&message(vector.plain));
    assert_eq!(
        package.expect("a counter is left").as_bytes()[..],
        hex(vector.package)
    );
}

/// Counters go forward with a clock, and by one where it does not.
#[test]
fn counters_follow_a_clock() {
    let mut sealer: Sealer = Sealer::new(key(BASE_KEY, BASE_SALT), SenderId(5));
    for (clock, counter) in [(0, 1), (9, 9), (9, 10), (3, 11), (12, 12)] {
        sealer.advance_to(clock);
        assert_eq!(sealer.next_counter(), Some(counter));
        let package = sealer.seal(&[0; PLAINTEXT_SIZE]).expect("counters");
        assert_eq!(package.as_bytes()[4..8], counter.to_be_bytes());
    }
    sealer.advance_to(u32::MAX);
    assert_eq!(sealer.next_counter(), None);
}

/// The front of a tag under a number that is never sent; another key, salt, id or header has another.
#[test]
fn fingerprints() {
    let bytes: [u8; 16] = hex(BASE_KEY).try_into().expect("16 bytes");
    let nonce = hex("0000435300000005ffffffff");
    let tag = AesGcm::new(&bytes).seal(&nonce.try_into().expect("12 bytes"), &mut [0; 80]);
    let of = |key: SealingKey, id| key.fingerprint(SenderId(id)).expect("AES does not fail");
    let five = of(key(BASE_KEY, BASE_SALT), 5);
    assert_eq!(five[..], tag.expect("AES does not fail")[..4]);
    let epochs = SealingKey::<AesGcm, EpochHeader>::new(&bytes, BASE_SALT).expect("a key");
    let others = [
        of(key(BASE_KEY, BASE_SALT), 6),
        of(key(BASE_KEY, BASE_SALT + 1), 5),
        of(key("000102030405060708090a0b0c0d0e1f", BASE_SALT), 5),
        epochs.fingerprint(EpochSenderId(5)).expect("AES"),
    ];
    assert!(others.iter().all(|other| *other != five));
}
