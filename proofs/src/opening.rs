//! O1 and O2: a package is accepted once and in order, and nothing of it is seen before.
//!
//! That [`Opened`](mavlink_commsec::Opened) comes from nowhere else, and counts once, is a matter of
//! types: these programs must not compile, and each differs in one line from one that does.
//!
//! ```
//! use mavlink_commsec::{OpenError, Opened, Opener};
//! fn opened(bytes: &[u8], opener: &mut Opener<1>) -> Result<Opened, OpenError> { opener.open(bytes) }
//! ```
//!
//! ```compile_fail
//! use mavlink_commsec::{OpenError, Opened, Opener};
//! fn opened(bytes: &[u8], opener: &Opener<1>) -> Result<Opened, OpenError> { opener.open(bytes) }
//! ```
//!
//! ```compile_fail
//! use mavlink_commsec::{Header, Message, Opened};
//! fn opened(header: Header, message: Message) -> Opened { Opened { header, message: message.into() } }
//! ```
//!
//! Messages come from what was opened, not from a package:
//!
//! ```
//! fn act(package: &mavlink_commsec::Opened) -> usize { package.message().len() }
//! ```
//!
//! ```compile_fail
//! fn act(package: &mavlink_commsec::Package) -> usize { package.message().len() }
//! ```
//!
//! What counts once is not copied:
//!
//! ```
//! fn twice(x: mavlink_commsec::Package) -> [mavlink_commsec::Package; 2] { [x.clone(), x] }
//! ```
//!
//! ```compile_fail
//! fn twice(x: mavlink_commsec::Opened) -> [mavlink_commsec::Opened; 2] { [x.clone(), x] }
//! ```
//!
//! ```compile_fail
//! fn twice(x: mavlink_commsec::Opener<1>) -> [mavlink_commsec::Opener<1>; 2] { [x.clone(), x] }
//! ```

use mavlink_commsec::field::{HEADER_SIZE, MESSAGE_SIZE, PACKAGE_SIZE, TAG_SIZE};
use mavlink_commsec::{Cipher, Header, Key, OpenError, Opener, SenderId};

use crate::cipher::{Told, Verdict, nonce_of};

/// What is known of one sender: who, with which of the keys, the last counter, and the wrong tags of
/// the key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// Who.
    pub sender: SenderId,
    /// The last counter accepted.
    pub last: u32,
    /// Wrong tags counted for his key.
    pub failed: u32,
}

/// O1, one step from any state: a package is accepted if and only if it has 96 bytes, its sender is
/// permitted, it is newer than the last accepted of him, his key has not had too many wrong tags, and
/// its tag is right; otherwise the error names the first that is wrong. What is accepted is then the
/// last of its sender, and the same again is refused; of other senders nothing changes. What is refused
/// changes nothing, but a wrong tag is counted, once, for everybody who has that key.
///
/// Every history is a sequence of such steps, so each package is accepted at most once in every
/// history. `right` tells whether the cipher takes the tag for right; `shared` whether the second sender
/// has the first one's key.
///
/// # Errors
///
/// The verdict, where it is a refusal.
///
/// # Panics
///
/// If the property does not hold.
pub fn step<C: Cipher>(
    opener: &mut Opener<2, C>,
    limit: u32,
    shared: bool,
    package: &[u8],
    right: bool,
) -> Result<(), OpenError> {
    let before = rows(opener);
    let expected = specified(&before, limit, package, right);
    let verdict = opener.open(package).map(drop);
    assert_eq!(verdict, expected);

    let mut after = before;
    if let Some(Header { sender, counter }) = header_of(package) {
        for row in after.iter_mut().flatten() {
            let his = row.sender == sender;
            if his && verdict.is_ok() {
                row.last = counter;
            }
            let has_key = his || (shared && permitted(&before, sender).is_some());
            if has_key && verdict == Err(OpenError::BadTag) {
                row.failed += 1;
            }
        }
    }
    assert_eq!(rows(opener), after);

    if let (Ok(()), Some(Header { counter, .. })) = (verdict, header_of(package)) {
        let again = opener.open(package).map(drop);
        let last = counter;
        assert_eq!(again, Err(OpenError::Stale { counter, last }));
        assert_eq!(rows(opener), after);
    }
    verdict
}

/// What the receiver remembers of each sender.
fn rows<C: Cipher>(opener: &Opener<2, C>) -> [Option<Row>; 2] {
    let mut rows = [None; 2];
    for (slot, (sender, last)) in rows.iter_mut().zip(opener.senders()) {
        let failed = opener.failed_opens(sender).expect("permitted");
        *slot = Some(Row {
            sender,
            last,
            failed,
        });
    }
    rows
}

fn permitted(rows: &[Option<Row>; 2], sender: SenderId) -> Option<Row> {
    rows.iter()
        .flatten()
        .find(|row| row.sender == sender)
        .copied()
}

/// The header of what has the length of a package.
fn header_of(package: &[u8]) -> Option<Header> {
    let package: &[u8; PACKAGE_SIZE] = package.try_into().ok()?;
    let number = |at| u32::from_be_bytes([0, 1, 2, 3].map(|byte: usize| package[at + byte]));
    Some(Header {
        sender: SenderId(number(0)),
        counter: number(4),
    })
}

/// The verdict, condition by condition.
fn specified(
    rows: &[Option<Row>; 2],
    limit: u32,
    package: &[u8],
    right: bool,
) -> Result<(), OpenError> {
    let wrong_length = OpenError::WrongLength(package.len());
    let Header { sender, counter } = header_of(package).ok_or(wrong_length)?;
    let Row { last, failed, .. } =
        permitted(rows, sender).ok_or(OpenError::UnknownSender(sender))?;
    if counter <= last {
        return Err(OpenError::Stale { counter, last });
    }
    if failed >= limit {
        return Err(OpenError::KeyWornOut);
    }
    if right {
        Ok(())
    } else {
        Err(OpenError::BadTag)
    }
}

/// O2: a message comes out if and only if the cipher has found the tag right; it is then what the
/// cipher has made of exactly the sealed message, the tag and the nonce of the package, which are salt
/// and header; and it comes with the header's sender and counter. The cipher decrypts before its verdict,
/// and all the same nothing comes out with a wrong tag.
///
/// `at` is an index below 80 at which the message is looked at.
///
/// # Panics
///
/// If the property does not hold.
pub fn comes_out(salt: u32, last: u32, verdict: Verdict, package: &[u8; PACKAGE_SIZE], at: usize) {
    let key = Key::<Told>::new(&Told::key(verdict), salt).expect("a key");
    let header = header_of(package).expect("96 bytes");
    let mut opener = Opener::<1, Told>::new();
    let permitted = opener.resume(key, &[(header.sender, last)]);
    permitted.expect("there is room");

    let opened = opener.open(package);
    let accepted = verdict == Verdict::Right && header.counter > last;
    assert_eq!(opened.is_ok(), accepted);
    let Ok(opened) = opened else { return };
    assert_eq!(
        (opened.sender(), opened.counter()),
        (header.sender, header.counter)
    );
    let sealed = package[HEADER_SIZE..].first_chunk::<MESSAGE_SIZE>();
    let tag = package.last_chunk::<TAG_SIZE>().expect("96 bytes");
    let nonce = nonce_of(salt, header);
    let expected = Told::byte(&nonce, sealed.expect("96 bytes"), tag, at);
    assert_eq!(opened.message()[at], expected);
}

#[cfg(test)]
mod twins {
    use super::*;
    use mavlink_commsec::{AesGcm, Sealer};
    use proptest::prelude::*;

    const KEYS: [[u8; 16]; 2] = [[7; 16], [8; 16]];

    /// Senders 5 and 6, with one key or two.
    fn receiver(shared: bool, lasts: [u32; 2], limit: u32) -> Opener<2> {
        let mut opener = Opener::with_limit(limit);
        let key = |which: usize| Key::new(&KEYS[which], 9).expect("a key");
        let [five, six] = [(SenderId(5), lasts[0]), (SenderId(6), lasts[1])];
        let permitted = if shared {
            opener.resume(key(0), &[five, six])
        } else {
            opener
                .resume(key(0), &[five])
                .and_then(|()| opener.resume(key(1), &[six]))
        };
        permitted.expect("there is room");
        opener
    }

    /// A package of sender `id`, sealed with one of the keys.
    fn package(which: usize, id: u32, counter: u32) -> [u8; PACKAGE_SIZE] {
        let key = Key::<AesGcm>::new(&KEYS[which], 9).expect("a key");
        let mut sealer = Sealer::resume(key, SenderId(id), counter);
        *sealer.seal(&[3; 80]).expect("a counter is left").as_bytes()
    }

    proptest! {
        #[test]
        fn o1_random(
            shared: bool,
            lasts: [u32; 2],
            limit in 0..4_u32,
            packages in proptest::collection::vec((0..2_usize, 4..8_u32, 1..u32::MAX, 0..9_u8), 0..12),
        ) {
            let mut opener = receiver(shared, lasts.map(|last| last % 8), limit);
            for (which, id, counter, fault) in packages {
                let counter = if counter % 3 == 0 { counter } else { 1 + counter % 12 };
                let mut bytes = package(which, id, counter).to_vec();
                match fault {
                    0 => bytes[95] ^= 1,
                    1 => bytes[40] ^= 0x80,
                    2 => bytes.truncate(95),
                    3 => bytes.push(0),
                    _ => {}
                }
                let own_key = if shared || id == 5 { 0 } else { 1 };
                let right = fault > 1 && which == own_key;
                let _ = step(&mut opener, limit, shared, &bytes, right);
            }
        }

        #[test]
        fn o2_random(salt: u32, last: u32, bytes: [[u8; 32]; 3], right: bool, fails: bool) {
            let package = std::array::from_fn(|at| bytes[at / 32][at % 32]);
            let verdict = match (right, fails) {
                (true, _) => Verdict::Right,
                (false, true) => Verdict::Fails,
                (false, false) => Verdict::Wrong,
            };
            for at in 0..MESSAGE_SIZE {
                comes_out(salt, last, verdict, &package, at);
            }
        }
    }

    #[test]
    fn o1_edges() {
        let edges = [0, 1, 2, u32::MAX - 1, u32::MAX];
        for last in edges {
            for counter in edges {
                let mut bytes = package(0, 5, 1);
                bytes[4..8].copy_from_slice(&counter.to_be_bytes());
                let mut opener = receiver(true, [last, 0], 3);
                // The package of counter 1 is genuine.
                let _ = step(&mut opener, 3, true, &bytes, counter == 1);
            }
        }
        for limit in [0, 1, 2] {
            for shared in [false, true] {
                let mut opener = receiver(shared, [0, 0], limit);
                for id in [5, 6, 5, 6, 5, 6] {
                    let which = usize::from(!shared && id == 6);
                    let _ = step(
                        &mut opener,
                        limit,
                        shared,
                        &package(1 - which, id, 1),
                        false,
                    );
                }
                let worn = step(&mut opener, limit, shared, &package(0, 5, 1), true);
                assert_eq!(worn, Err(OpenError::KeyWornOut));
            }
        }
    }

    /// Every other length.
    #[test]
    fn o1_lengths() {
        let bytes = [package(0, 5, 1), package(0, 5, 2)].concat();
        for length in 0..=bytes.len() {
            let mut opener = receiver(true, [0, 0], 3);
            let verdict = step(&mut opener, 3, true, &bytes[..length], true);
            assert_eq!(verdict.is_ok(), length == 96);
        }
    }

    #[test]
    fn o2_edges() {
        let package = std::array::from_fn(|at| at as u8);
        let counter = 0x0405_0607;
        for last in [0, counter - 1, counter, counter + 1] {
            for verdict in [Verdict::Right, Verdict::Wrong, Verdict::Fails] {
                for at in 0..MESSAGE_SIZE {
                    comes_out(1, last, verdict, &package, at);
                }
            }
        }
    }
}

#[cfg(kani)]
mod harness {
    use super::*;
    use crate::model::any_prefix;

    #[kani::proof]
    #[kani::unwind(81)]
    fn o1_step() {
        let right = kani::any();
        let verdict = if right {
            Verdict::Right
        } else {
            Verdict::Wrong
        };
        let key = || Key::<Told>::new(&Told::key(verdict), 9).expect("a key");
        let rows: [(u32, u32); 2] = kani::any();
        let [one, two] = rows.map(|(id, last)| (SenderId(id), last));
        kani::assume(one.0 != two.0);
        let (shared, limit): (bool, u32) = (kani::any(), kani::any());
        let mut opener = Opener::<2, Told>::with_limit(limit);
        if shared {
            opener.resume(key(), &[one, two]).expect("there is room");
        } else {
            opener.resume(key(), &[one]).expect("there is room");
            opener.resume(key(), &[two]).expect("there is room");
        }
        let failed: [u32; 2] = kani::any();
        // No state in which more were counted than are let be: the count stops there.
        kani::assume(failed.iter().all(|failed| *failed <= limit));
        let mut opener = opener.having_failed(&failed);

        let bytes: [u8; PACKAGE_SIZE + 1] = kani::any();
        let verdict = step(&mut opener, limit, shared, any_prefix(&bytes), right);
        kani::cover!(verdict.is_ok() && shared, "accepted");
        kani::cover!(verdict == Err(OpenError::BadTag) && shared, "bad tag");
        kani::cover!(verdict == Err(OpenError::KeyWornOut), "worn out");
        kani::cover!(matches!(verdict, Err(OpenError::Stale { .. })), "stale");
        kani::cover!(
            matches!(verdict, Err(OpenError::UnknownSender(_))),
            "unknown"
        );
        kani::cover!(verdict == Err(OpenError::WrongLength(97)), "too long");
    }

    #[kani::proof]
    #[kani::unwind(97)]
    fn o2_comes_out() {
        let verdict = match kani::any() {
            0_u8 => Verdict::Right,
            1 => Verdict::Wrong,
            _ => Verdict::Fails,
        };
        let package: [u8; PACKAGE_SIZE] = kani::any();
        let (last, at) = (kani::any(), kani::any());
        kani::assume(at < MESSAGE_SIZE);
        let newer = header_of(&package).is_some_and(|header| header.counter > last);
        kani::cover!(newer && verdict == Verdict::Right, "accepted");
        kani::cover!(newer && verdict == Verdict::Wrong, "decrypted and refused");
        kani::cover!(!newer, "stale");
        comes_out(kani::any(), last, verdict, &package, at);
    }
}
