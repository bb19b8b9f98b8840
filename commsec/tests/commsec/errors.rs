//! What errors say: which bytes, whose, how many; and what they are made of.

use std::error::Error;

use mavlink_commsec::hx::{DecodeError, FrameError};
use mavlink_commsec::radio::RadioError;
use mavlink_commsec::{
    CipherError, EpochCounter, EpochError, OpenError, PackError, PermitError, SealError,
    SealingKeyError, SenderId, UnpackError,
};
use mavlink_signing::ParseError;

#[test]
fn texts() {
    let stale = OpenError::Stale {
        counter: 2,
        last: 3,
    };
    let sequence = |epoch, counter| EpochCounter { epoch, counter };
    let stale_in_epoch = OpenError::StaleInEpoch {
        sequence: sequence(1, 9),
        last: sequence(2, 1),
    };
    let unpack = UnpackError {
        offset: 9,
        fault: ParseError::Truncated,
    };
    let texts: [(&dyn Error, &str); 32] = [
        (&CipherError, "the cipher rejected"),
        (
            &SealingKeyError::WrongLength(15),
            "a key has 16 bytes, this one has 15",
        ),
        (&SealingKeyError::AllZero, "a key of zeros only is no key"),
        (
            &PermitError::Key(SealingKeyError::AllZero),
            "a key of zeros only is no key",
        ),
        (
            &SealingKeyError::Erased,
            "a key of 0xFF only is erased flash",
        ),
        (
            &OpenError::NoCounter(SenderId(5)),
            "sender 5 has used up its counters, or its epochs",
        ),
        (
            &PackError::LegacyVehicle,
            "a MAVLink 2 packet for a vehicle of MAVLink 1",
        ),
        (&PermitError::NoSender, "a key without a sender"),
        (
            &PermitError::DuplicateSender(SenderId(5)),
            "sender 5 is permitted twice",
        ),
        (&PermitError::TableFull, "the table of senders is full"),
        (
            &SealError::CounterExhausted,
            "all counters of the key are used up",
        ),
        (&SealError::Cipher, "the cipher failed"),
        (
            &OpenError::WrongLength(95),
            "a package has 96 bytes, this one has 95",
        ),
        (
            &OpenError::UnknownSender(SenderId(16)),
            "sender 16 is not permitted",
        ),
        (
            &stale,
            "counter 2 is a replay or too old: 3 is the newest accepted",
        ),
        (&EpochError, "all epochs of the key are used up"),
        (
            &stale_in_epoch,
            "counter 9 of epoch 1 is a replay or too old: 1 of epoch 2 is the newest accepted",
        ),
        (
            &OpenError::IntegrityLimitReached,
            "too many wrong tags: the key is worn out",
        ),
        (
            &OpenError::JumpTooFar(SenderId(5)),
            "sender 5 has passed over too many counters",
        ),
        (
            &OpenError::TooOld(SenderId(5)),
            "a package of sender 5 is too old",
        ),
        (
            &OpenError::FromFuture(SenderId(5)),
            "a package of sender 5 is from the future",
        ),
        (&OpenError::BadTag, "bad tag: another key or a forgery"),
        (
            &PackError::TooLong(81),
            "a packet of 81 bytes does not fit into a message",
        ),
        (
            &PackError::Parse(ParseError::Truncated),
            "the frame is cut short",
        ),
        (&PackError::Trailing(3), "3 bytes behind the packet"),
        (
            &unpack,
            "no packet at byte 9 of the message: the frame is cut short",
        ),
        (&FrameError::Empty, "an empty frame"),
        (
            &FrameError::TooLong(101),
            "a frame has at most 100 bytes, this one has 101",
        ),
        (&DecodeError::TooLong, "a frame of more than 100 bytes"),
        (
            &DecodeError::TruncatedEscape,
            "a frame that ends in an escape",
        ),
        (
            &DecodeError::UnknownKind(7),
            "a frame of the unknown kind 0x07",
        ),
        (
            &RadioError::NoStatus(24),
            "24 bytes that are no status of a radio",
        ),
    ];
    for (error, text) in texts {
        assert_eq!(error.to_string(), text);
    }
    assert_eq!(DecodeError::Empty.to_string(), "an empty frame");
}

/// What an error wraps is its source.
#[test]
fn sources() {
    let wrapping: [(&dyn Error, &str); 3] = [
        (
            &PermitError::Key(SealingKeyError::AllZero),
            "a key of zeros only is no key",
        ),
        (
            &PackError::Parse(ParseError::BadMagic(3)),
            "a MAVLink 2 frame begins with 0xFD, not 0x03",
        ),
        (
            &UnpackError {
                offset: 0,
                fault: ParseError::Truncated,
            },
            "the frame is cut short",
        ),
    ];
    for (error, text) in wrapping {
        assert_eq!(error.source().expect("a source").to_string(), text);
    }
    assert!(PermitError::NoSender.source().is_none());
    assert!(PackError::TooLong(81).source().is_none());
}
