//! Targets about single values: keys and tags, checksums, message ids, stamps.

use arbitrary::Arbitrary;
use mavlink_signing::{
    Hmac, KEY_SIZE, KeyError, KeySlot, KeyUse, MessageId, Profile, SigningKey, Stamp, Timestamp,
    passphrase_key,
};
use mavseal_proofs::keeper::{self, Model};
use mavseal_proofs::{checksum, replay, stamp, table};

use crate::input::{Message, Moment, Receiver, Stamped};
use crate::repair::{self, KEY};

/// A key and what it signs.
#[derive(Arbitrary, Clone, Debug)]
pub struct Keyed<'a> {
    /// How many of the bytes are the key; 255 stands for 32.
    pub key_length: u8,
    /// The key, then the message.
    pub bytes: &'a [u8],
}

/// The profile `Hmac` and the key of a pass-phrase against the crate `hmac-sha256` (S3), and which keys there
/// are.
pub fn diff_hmac(input: Keyed<'_>) {
    let length = match input.key_length {
        u8::MAX => KEY_SIZE,
        length => length.into(),
    };
    let (key, message) = input.bytes.split_at(length.min(input.bytes.len()));
    let made = SigningKey::<Hmac>::new(key);
    match <&[u8; KEY_SIZE]>::try_from(key) {
        Err(_) => assert_eq!(made.as_ref().err(), Some(&KeyError::WrongLength(key.len()))),
        Ok([0, rest @ ..]) if rest.iter().all(|byte| *byte == 0) => {
            assert_eq!(made.as_ref().err(), Some(&KeyError::AllZero));
        }
        Ok([0xFF, rest @ ..]) if rest.iter().all(|byte| *byte == 0xFF) => {
            assert_eq!(made.as_ref().err(), Some(&KeyError::Erased));
        }
        Ok(key) if *key == hmac_sha256::Hash::hash(b"") => {
            assert_eq!(made.as_ref().err(), Some(&KeyError::EmptyPassphrase));
        }
        Ok(key) => {
            assert!(made.is_ok());
            let expected = hmac_sha256::HMAC::mac(message, key);
            assert_eq!(<Hmac>::new(key).tag(message), expected[..6]);
        }
    }
    if let Ok(passphrase) = str::from_utf8(message) {
        let key = passphrase_key(passphrase);
        assert_eq!(key, hmac_sha256::Hash::hash(message));
        let made = SigningKey::<Hmac>::from_passphrase(passphrase).map(|key| key.fingerprint());
        let same = SigningKey::<Hmac>::new(&key).map(|key| key.fingerprint());
        assert_eq!(made, same);
        assert_eq!(made.is_err(), passphrase.is_empty());
    }
}

/// Bytes under a checksum, and a message id.
#[derive(Arbitrary, Clone, Debug)]
pub struct Checked<'a> {
    /// The checksum so far.
    pub crc: u16,
    /// The next byte, or the byte that the message's definition adds.
    pub byte: u8,
    /// The message that is looked up.
    pub message: Message,
    /// The bytes.
    pub covered: &'a [u8],
}

/// The checksum, as a step and as a whole, against its definition and against the crate `crc` (C1); the
/// table of messages (C2).
pub fn checksum_table(input: Checked<'_>) {
    checksum::step_is_bitwise(input.crc, input.byte);
    checksum::whole_is_the_fold(input.covered, input.byte);
    let checksum = mavlink_signing::crc::checksum(input.covered, input.byte);
    assert_eq!(checksum, repair::checksum(input.covered, input.byte));
    let id = input.message.id();
    assert_eq!(MessageId::new(id.get()), Some(id));
    let _ = table::found_if_there(id);
}

/// A sender and a receiver, each in the state that it was resumed in, two moments, and what is kept over a restart.
#[derive(Arbitrary, Clone, Copy, Debug)]
pub struct Clocks {
    /// The moments.
    pub now: [Moment; 2],
    /// What the sender stamps with, and its mark.
    pub sender: Stamped,
    /// The receiver.
    pub receiver: Receiver,
    /// Another stamp that comes after a restart.
    pub earlier: Stamped,
    /// The marks that are stored for the keys in both slots, and the first timestamps that may be used.
    pub slots: [[Moment; 2]; 2],
    /// How many ticks ahead a mark is stored.
    pub ahead: u16,
    /// Bits: the memory does not store; the clock follows frames; the key is in the second slot; it is a former one.
    pub flags: u8,
}

/// Two stamps of a sender (T1), and one step of a receiver that is given the mark (R1); both with a memory
/// that may fail, and after a restart (T1, R3).
pub fn stamps(input: Clocks) {
    let now = input.now.map(Moment::timestamp);
    for moment in now {
        let again = Timestamp::from_unix_micros(moment.unix_micros());
        assert_eq!(again, Some(moment));
    }
    let in_1970 = input.now[0].offset.into();
    assert_eq!(Timestamp::from_unix_micros(in_1970), None);
    let Stamped { link_id, moment } = input.sender;
    let _ = stamp::two_stamps(link_id, moment.timestamp(), now);
    let _ = replay::step(&KEY, input.receiver.into(), input.sender.into(), now[0]);
    let flag = |bit: u8| input.flags >> bit & 1 == 1;
    let [marks, floors] = input.slots.map(|both| both.map(Moment::timestamp));
    let memory = Model {
        now: now[0],
        follows: flag(1),
        marks: marks.map(Timestamp::ticks),
        floors,
        ahead: input.ahead.into(),
        broken: flag(0),
        heard: 0,
    };
    let slot = [KeySlot::A, KeySlot::B][usize::from(flag(2))];
    let _ = keeper::stamps(slot, moment.timestamp(), &mut { memory }, now[1]);
    let stamps = [input.sender, input.earlier].map(Stamp::from);
    let used = KeyUse {
        slot,
        former: flag(3),
    };
    let receiver = input.receiver.into();
    let _ = keeper::accepts::<Hmac>(used, receiver, memory, stamps[0], stamps[1], now[1]);
}
