//! N1: no nonce is used twice within a run.
//!
//! That nothing seals with a copy is a matter of types: these programs must not compile, and each
//! differs in one line from one that does.
//!
//! ```
//! fn twice(x: mavlink_commsec::Package) -> [mavlink_commsec::Package; 2] { [x.clone(), x] }
//! ```
//!
//! ```compile_fail
//! fn twice(x: mavlink_commsec::Sealer) -> [mavlink_commsec::Sealer; 2] { [x.clone(), x] }
//! ```
//!
//! ```compile_fail
//! fn twice(x: mavlink_commsec::Key) -> [mavlink_commsec::Key; 2] { [x.clone(), x] }
//! ```
//!
//! A key is given to one sealer:
//!
//! ```
//! use mavlink_commsec::{Key, Sealer, SenderId};
//! fn seals(key: Key) -> Sealer { Sealer::new(key, SenderId(1)) }
//! ```
//!
//! ```compile_fail
//! use mavlink_commsec::{Key, Sealer, SenderId};
//! fn seals(key: &Key) -> Sealer { Sealer::new(key, SenderId(1)) }
//! ```
//!
//! ```compile_fail
//! use mavlink_commsec::{Key, Sealer, SenderId};
//! fn seals(key: Key) -> [Sealer; 2] { [Sealer::new(key, SenderId(1)), Sealer::new(key, SenderId(1))] }
//! ```
//!
//! A package is not made by hand, with a counter of somebody's choice:
//!
//! ```compile_fail
//! fn package(bytes: [u8; 96]) -> mavlink_commsec::Package { mavlink_commsec::Package(bytes) }
//! ```

use mavlink_commsec::field::{HEADER_SIZE, MESSAGE_SIZE};
use mavlink_commsec::{Header, Key, Message, Package, SealError, Sealer, SenderId};

use crate::cipher::{Told, Verdict, nonce_of};

/// N1, from any state that a sender can be resumed in: what is sealed next is sealed under the salt, the
/// sender's id and a counter that is at least 1, at least `first`, and one greater each time; after
/// 2^32 - 2 nothing is sealed any more, now and later; what the cipher could not seal is not sent, and
/// uses its counter up.
///
/// `at` is an index below 80 at which the sealed message is looked at. Returns the counter of the last
/// package.
///
/// # Errors
///
/// Why one of the two messages was not sealed.
///
/// # Panics
///
/// If the property does not hold.
pub fn two_packages(
    [salt, id, first]: [u32; 3],
    verdict: Verdict,
    messages: &[Message; 2],
    at: usize,
) -> Result<u32, SealError> {
    let key = Key::<Told>::new(&Told::key(verdict), salt).expect("a key");
    let mut sealer = Sealer::resume(key, SenderId(id), first);
    let mut expected = Some(first.max(1)).filter(|counter| *counter < u32::MAX);
    let mut last = Ok(0);
    for message in messages {
        assert_eq!(sealer.next_counter(), expected);
        let sealed = sealer.seal(message);
        last = match expected {
            None => {
                assert_eq!(sealed, Err(SealError::CounterExhausted));
                Err(SealError::CounterExhausted)
            }
            Some(_) if verdict == Verdict::Fails => {
                assert_eq!(sealed, Err(SealError::Cipher));
                Err(SealError::Cipher)
            }
            Some(counter) => {
                let sender = SenderId(id);
                let header = Header { sender, counter };
                is_sealed(&sealed.expect("it can be"), salt, header, message, at);
                Ok(counter)
            }
        };
        expected = expected.map(|counter| counter + 1);
        expected = expected.filter(|counter| *counter < u32::MAX);
    }
    assert_eq!(sealer.id(), SenderId(id));
    last
}

/// `package` is `header`, `message` sealed under salt and header, and the tag of that.
fn is_sealed(package: &Package, salt: u32, header: Header, message: &Message, at: usize) {
    let bytes = package.as_bytes();
    let nonce = nonce_of(salt, header);
    assert_eq!(bytes[..HEADER_SIZE], header.to_wire());
    assert_eq!(bytes[..HEADER_SIZE], nonce[4..]);
    let tag = Told::tag(&nonce);
    assert_eq!(bytes[HEADER_SIZE + MESSAGE_SIZE..], tag);
    let sealed = Told::byte(&nonce, message, &tag, at);
    assert_eq!(bytes[HEADER_SIZE + at], sealed);
}

#[cfg(test)]
mod twins {
    use super::*;
    use proptest::prelude::*;

    fn check(
        numbers: [u32; 3],
        verdict: Verdict,
        messages: [Message; 2],
    ) -> Result<u32, SealError> {
        let mut last = Ok(0);
        for at in 0..MESSAGE_SIZE {
            last = two_packages(numbers, verdict, &messages, at);
        }
        last
    }

    proptest! {
        #[test]
        fn n1_random(numbers: [u32; 3], verdict in 0..4_u8, a: [u8; 32], b: [u8; 32]) {
            let verdict = if verdict == 0 { Verdict::Fails } else { Verdict::Right };
            let message = |from: [u8; 32]| std::array::from_fn(|at| from[at % 32] ^ at as u8);
            let _ = check(numbers, verdict, [message(a), message(b)]);
        }
    }

    #[test]
    fn n1_edges() {
        let edges = [
            0,
            1,
            2,
            1 << 31,
            u32::MAX - 3,
            u32::MAX - 2,
            u32::MAX - 1,
            u32::MAX,
        ];
        for first in edges {
            for id in edges {
                let last = check([0xDEAD_BEEF, id, first], Verdict::Right, [[0; 80], [9; 80]]);
                let exhausted = Err(SealError::CounterExhausted);
                let two = first.max(1).checked_add(1).filter(|two| *two < u32::MAX);
                assert_eq!(last, two.map_or(exhausted, Ok));
            }
        }
        let failed = check([1, 2, 3], Verdict::Fails, [[0; 80]; 2]);
        assert_eq!(failed, Err(SealError::Cipher));
    }
}

#[cfg(kani)]
mod harness {
    use super::*;

    #[kani::proof]
    #[kani::unwind(97)]
    fn n1_two_packages() {
        let verdict = if kani::any() {
            Verdict::Right
        } else {
            Verdict::Fails
        };
        let at = kani::any();
        kani::assume(at < MESSAGE_SIZE);
        let numbers: [u32; 3] = kani::any();
        let last = two_packages(numbers, verdict, &kani::any(), at);
        kani::cover!(last == Ok(u32::MAX - 1), "the last counter of all");
        kani::cover!(last == Err(SealError::CounterExhausted), "exhausted");
        kani::cover!(last == Err(SealError::Cipher), "a unit that fails");
        kani::cover!(last == Ok(2) && numbers[2] == 0, "resumed at 0");
    }
}
