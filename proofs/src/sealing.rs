//! N1: no nonce is used twice within a run.
//!
//! That nothing seals with a copy is a matter of types. These programs must not compile, and each
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
//! fn twice(x: mavlink_commsec::SealingKey) -> [mavlink_commsec::SealingKey; 2] { [x.clone(), x] }
//! ```
//!
//! A key is given to one sealer:
//!
//! ```
//! use mavlink_commsec::{SealingKey, Sealer, SenderId};
//! fn seals(key: SealingKey) -> Sealer { Sealer::new(key, SenderId(1)) }
//! ```
//!
//! ```compile_fail
//! use mavlink_commsec::{SealingKey, Sealer, SenderId};
//! fn seals(key: &SealingKey) -> Sealer { Sealer::new(key, SenderId(1)) }
//! ```
//!
//! ```compile_fail
//! use mavlink_commsec::{SealingKey, Sealer, SenderId};
//! fn seals(key: SealingKey) -> [Sealer; 2] { [Sealer::new(key, SenderId(1)), Sealer::new(key, SenderId(1))] }
//! ```
//!
//! A key belongs to one header, and so does what the key file says of a sender. There is no sealer of
//! the one format with a key of the other, and no list of peers of both.
//!
//! ```
//! use mavlink_commsec::{AesGcm, EpochError, EpochHeader, EpochSenderId, SealingKey, Sealer};
//! fn seals(key: SealingKey<AesGcm, EpochHeader>) -> Result<Sealer<AesGcm, EpochHeader>, EpochError> {
//!     Sealer::begin(key, EpochSenderId(1), 0)
//! }
//! ```
//!
//! ```compile_fail
//! use mavlink_commsec::{AesGcm, EpochError, EpochHeader, EpochSenderId, SealingKey, Sealer};
//! fn seals(key: SealingKey<AesGcm>) -> Result<Sealer<AesGcm, EpochHeader>, EpochError> {
//!     Sealer::begin(key, EpochSenderId(1), 0)
//! }
//! ```
//!
//! ```compile_fail
//! use mavlink_commsec::{AesGcm, EpochHeader, SealingKey, Sealer, SenderId};
//! fn seals(key: SealingKey<AesGcm, EpochHeader>) -> Sealer { Sealer::new(key, SenderId(1)) }
//! ```
//!
//! ```
//! use mavlink_commsec::{Credential, SenderId};
//! const PEERS: [Credential; 2] = [
//!     Credential { id: SenderId(1), key: [1; 16], salt: 1 },
//!     Credential { id: SenderId(2), key: [2; 16], salt: 2 },
//! ];
//! ```
//!
//! ```compile_fail
//! use mavlink_commsec::{Credential, EpochSenderId, SenderId};
//! const PEERS: [Credential; 2] = [
//!     Credential { id: SenderId(1), key: [1; 16], salt: 1 },
//!     Credential { id: EpochSenderId(2), key: [2; 16], salt: 2 },
//! ];
//! ```
//!
//! A package is not made by hand, with a counter of somebody's choice:
//!
//! ```compile_fail
//! fn package(bytes: [u8; 96]) -> mavlink_commsec::Package { mavlink_commsec::Package(bytes) }
//! ```

use mavlink_commsec::field::{HEADER_SIZE, PLAINTEXT_SIZE};
use mavlink_commsec::{
    EpochCounter, EpochError, EpochHeader, EpochSenderId, HeaderFormat, Package, PackageHeader,
    Plaintext, SealError, Sealer, SealingKey, SenderId,
};

use crate::cipher::{Specified, Told, Verdict, nonce_of};

/// N1, from any state that a sender can be resumed in: what is sealed next is sealed under salt, sender
/// and counter. The counter is at least 1, at least `first`, and one greater each time. After 2^32 - 2
/// nothing is sealed any more, now and later. What the cipher could not seal is not sent, and uses its
/// counter up.
///
/// `at` is an index below 80 at which the sealed messages are looked at. Returns the counter of the last
/// package. As a sender in any state is one resumed there, one message says it of all.
///
/// # Errors
///
/// Why the last of the messages was not sealed.
///
/// # Panics
///
/// If the property does not hold.
pub fn packages(
    [salt, id, first]: [u32; 3],
    verdict: Verdict,
    messages: &[Plaintext],
    at: usize,
) -> Result<u32, SealError> {
    let key = SealingKey::<Told>::new(&Told::key(verdict), salt).expect("a key");
    let sealer = Sealer::resume(key, SenderId(id), first);
    seals::<PackageHeader>(sealer, salt, id, 0, first.max(1), verdict, messages, at)
}

/// N1 for a sender that begins the epoch `mark`: the same from counter 1 on, all in this epoch. 65,535
/// and what has more than 16 bits is no epoch.
///
/// # Errors
///
/// [`EpochError`]; and why the last of the messages was not sealed.
///
/// # Panics
///
/// If the property does not hold.
pub fn packages_of_epoch(
    salt: u32,
    id: u16,
    mark: u64,
    verdict: Verdict,
    messages: &[Plaintext],
    at: usize,
) -> Result<Result<u32, SealError>, EpochError> {
    let key = SealingKey::<Told, EpochHeader>::new(&Told::key(verdict), salt).expect("a key");
    let sealer = Sealer::begin(key, EpochSenderId(id), mark);
    assert_eq!(sealer.is_ok(), mark < 0xFFFF);
    let sealer = sealer?;
    let epoch = mark as u16;
    assert_eq!(
        sealer.next_sequence(),
        Some(EpochCounter { epoch, counter: 1 })
    );
    Ok(seals::<EpochHeader>(
        sealer,
        salt,
        id.into(),
        epoch,
        1,
        verdict,
        messages,
        at,
    ))
}

/// N1, of the place after a package's: its counter is one greater, in the same epoch where there are any.
/// Behind the last one, 2^32 - 2, is that which no sender uses, and it stays there.
///
/// # Panics
///
/// If the property does not hold.
pub fn next_is_one_greater(epoch: u16, counter: u32) {
    let after = counter.saturating_add(1);
    assert_eq!(PackageHeader::next(counter), after);
    let next = EpochHeader::next(EpochCounter { epoch, counter });
    assert_eq!((next.epoch, next.counter), (epoch, after));
}

/// N1, of counters that follow a clock: the next one is `clock`, or the one that was next if that is greater. It never
/// goes back, and behind the last there is none.
///
/// # Panics
///
/// If the property does not hold.
pub fn follows_a_clock(first: u32, clock: u32) {
    let key = SealingKey::<Told>::new(&Told::key(Verdict::Right), 1).expect("a key");
    let mut sealer = Sealer::resume(key, SenderId(5), first);
    sealer.advance_to(clock);
    let next = Some(clock.max(first).max(1)).filter(|next| *next < u32::MAX);
    assert_eq!(sealer.next_counter(), next);
}

/// Seals `messages`, and compares with what must come out, from counter `first` on.
#[expect(
    clippy::too_many_arguments,
    reason = "each is a part of the nonce, or what is sealed"
)]
fn seals<H: Specified>(
    mut sealer: Sealer<Told, H>,
    salt: u32,
    id: u32,
    epoch: u16,
    first: u32,
    verdict: Verdict,
    messages: &[Plaintext],
    at: usize,
) -> Result<u32, SealError> {
    let mut expected = Some(first).filter(|counter| *counter < u32::MAX);
    let mut last = Ok(0);
    for message in messages {
        assert_eq!(sealer.next_counter(), expected);
        let sequence = expected.map(|counter| H::place_of(epoch, counter));
        assert_eq!(sealer.next_sequence(), sequence);
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
                let header = (H::id(id), H::place_of(epoch, counter));
                is_sealed::<H>(&sealed.expect("it can be"), salt, header, message, at);
                Ok(counter)
            }
        };
        expected = expected.map(|counter| counter + 1);
        expected = expected.filter(|counter| *counter < u32::MAX);
    }
    assert_eq!(sealer.next_counter(), expected);
    assert_eq!(sealer.id(), H::id(id));
    last
}

/// `package` is the header, `message` sealed under salt and header, and the tag of that.
fn is_sealed<H: Specified>(
    package: &Package,
    salt: u32,
    (id, sequence): (H::Id, H::Sequence),
    message: &Plaintext,
    at: usize,
) {
    let bytes = package.as_bytes();
    let nonce = nonce_of::<H>(salt, id, sequence);
    assert_eq!(bytes[..HEADER_SIZE], H::write(id, sequence));
    assert_eq!(bytes[..HEADER_SIZE], nonce[4..]);
    let tag = Told::tag(&nonce);
    assert_eq!(bytes[HEADER_SIZE + PLAINTEXT_SIZE..], tag);
    let sealed = Told::byte(&nonce, message, &tag, at);
    assert_eq!(bytes[HEADER_SIZE + at], sealed);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check(
        numbers: [u32; 3],
        verdict: Verdict,
        messages: [Plaintext; 2],
    ) -> Result<u32, SealError> {
        let mut last = Ok(0);
        for at in 0..PLAINTEXT_SIZE {
            last = packages(numbers, verdict, &messages, at);
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

        #[test]
        fn n1_random_epochs(salt: u32, id: u16, mark: u64, short: u16, a: [u8; 32]) {
            let message = std::array::from_fn(|at| a[at % 32]);
            for mark in [mark, short.into()] {
                let sealed = check_epoch(salt, id, mark, Verdict::Right, [message, [0; 80]]);
                assert_eq!(sealed.is_ok(), mark < 0xFFFF);
            }
        }
    }

    fn check_epoch(
        salt: u32,
        id: u16,
        mark: u64,
        verdict: Verdict,
        messages: [Plaintext; 2],
    ) -> Result<Result<u32, SealError>, EpochError> {
        let mut last = Ok(Ok(0));
        for at in 0..PLAINTEXT_SIZE {
            last = packages_of_epoch(salt, id, mark, verdict, &messages, at);
        }
        last
    }

    #[test]
    fn n1_edges_of_epochs() {
        let check = |mark, verdict| check_epoch(0xDEAD_BEEF, 5, mark, verdict, [[1; 80], [2; 80]]);
        for mark in [0, 1, 0xFF, 0x100, 0xFFFE] {
            assert_eq!(check(mark, Verdict::Right), Ok(Ok(2)));
            assert_eq!(check(mark, Verdict::Fails), Ok(Err(SealError::Cipher)));
        }
        for mark in [0xFFFF, 0x1_0000, 0x1_0001, u64::MAX] {
            assert_eq!(check(mark, Verdict::Right), Err(EpochError));
        }
    }

    #[test]
    fn n1_next() {
        let counters = [0, 1, 0xFF, 0xFFFF, 0x1_0000, u32::MAX - 1, u32::MAX];
        for counter in counters {
            for epoch in [0, 1, 0xFF, 0xFFFE, 0xFFFF] {
                next_is_one_greater(epoch, counter);
            }
        }
    }

    #[test]
    fn n1_clock() {
        let counters = [0, 1, 2, 0xFFFF, u32::MAX - 1, u32::MAX];
        for first in counters {
            for clock in counters {
                follows_a_clock(first, clock);
            }
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
mod verification {
    use super::*;

    // An error in a result as large as a package's needs CBMC's `--max-field-sensitivity-array-size`,
    // which the workspace sets. Without it, Kani 0.67 takes the error that `?` hands on for another one,
    // or for none.

    #[kani::proof]
    #[kani::unwind(1)]
    fn n1_next_is_one_greater() {
        let counter = kani::any();
        next_is_one_greater(kani::any(), counter);
        kani::cover!(counter == u32::MAX - 1, "the last counter of all");
    }

    #[kani::proof]
    #[kani::unwind(17)]
    fn n1_follows_a_clock() {
        let (first, clock) = (kani::any(), kani::any());
        follows_a_clock(first, clock);
        kani::cover!(first > clock && clock > 1, "it does not go back");
        kani::cover!(clock == u32::MAX, "behind all counters");
    }

    /// What the cipher cannot seal is not sent, and its counter is used up.
    #[kani::proof]
    #[kani::unwind(97)]
    fn n1_cipher_fails() {
        let numbers: [u32; 3] = kani::any();
        kani::assume(numbers[2] < u32::MAX);
        let last = packages(numbers, Verdict::Fails, &[kani::any()], 0);
        assert_eq!(last, Err(SealError::Cipher));
        kani::cover!(numbers[2] == u32::MAX - 1, "under the last counter");
    }

    /// Behind the last counter nothing is sealed, whatever the cipher says, then and later.
    #[kani::proof]
    #[kani::unwind(97)]
    fn n1_counters_used_up() {
        let (salt, id) = (kani::any(), kani::any());
        let messages: [Plaintext; 2] = kani::any();
        let last = packages([salt, id, u32::MAX], Verdict::Right, &messages, 0);
        assert_eq!(last, Err(SealError::CounterExhausted));
        kani::cover!(true, "nothing is sealed");
    }

    #[kani::proof]
    #[kani::unwind(97)]
    fn n1_package() {
        let at = kani::any();
        kani::assume(at < PLAINTEXT_SIZE);
        let numbers: [u32; 3] = kani::any();
        kani::assume(numbers[2] < u32::MAX);
        let last = packages(numbers, Verdict::Right, &[kani::any()], at);
        kani::cover!(last == Ok(u32::MAX - 1), "the last counter of all");
        kani::cover!(last == Ok(1) && numbers[2] == 0, "resumed at 0");
    }

    #[kani::proof]
    #[kani::unwind(97)]
    fn n1_package_of_epoch() {
        let at = kani::any();
        kani::assume(at < PLAINTEXT_SIZE);
        let (salt, id, mark) = (kani::any(), kani::any(), kani::any());
        let last = packages_of_epoch(salt, id, mark, Verdict::Right, &[kani::any()], at);
        kani::cover!(last == Ok(Ok(1)) && mark == 0xFFFE, "the last epoch of all");
        kani::cover!(last == Err(EpochError) && mark == 0x1_0000, "no epoch");
    }
}
