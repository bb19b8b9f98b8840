//! O1 and O2: a package is accepted once and in order, and nothing of it is seen before.
//!
//! That [`Opened`](mavlink_commsec::Opened) comes from nowhere else, and counts once, is a matter of
//! types. These programs must not compile, and each differs in one line from one that does.
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
//! use mavlink_commsec::{PackageHeader, Plaintext, Opened};
//! fn opened(header: PackageHeader, message: Plaintext) -> Opened { Opened { header, message: message.into() } }
//! ```
//!
//! Messages come from what was opened, not from a package:
//!
//! ```
//! fn act(package: &mavlink_commsec::Opened) -> usize { package.plaintext().len() }
//! ```
//!
//! ```compile_fail
//! fn act(package: &mavlink_commsec::Package) -> usize { package.plaintext().len() }
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

use mavlink_commsec::field::{HEADER_SIZE, PACKAGE_SIZE, PLAINTEXT_SIZE, TAG_SIZE};
use mavlink_commsec::{Cipher, HeaderFormat, OpenError, Opener, SealingKey};

use crate::cipher::{Specified, Told, Verdict, nonce_of};

/// What is known of one sender: who, the last place, and the wrong tags of his key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row<I, P> {
    /// Who.
    pub sender: I,
    /// The last place accepted.
    pub last: P,
    /// Wrong tags counted for his key.
    pub failed: u32,
}

/// Both senders, as a receiver knows them.
type Rows<H> = [Option<Row<<H as HeaderFormat>::Id, <H as HeaderFormat>::Sequence>>; 2];

/// O1, one step from any state: a package is accepted if and only if all of these hold. It has 96 bytes,
/// its sender is permitted, and its counter (and epoch) is one that senders use. It is newer than the
/// last accepted of him, his key has not had too many wrong tags, and its tag is right. Otherwise the
/// error names the first that is wrong. What is accepted is then the last of its sender, and the same
/// again is rejected; of other senders nothing changes. What is rejected changes nothing, but a wrong
/// tag is counted, once, for everybody who has that key.
///
/// Every history is a sequence of such steps, so each package is accepted at most once in every
/// history. `right` tells whether the cipher takes the tag for right; `shared` whether the second sender
/// has the first one's key.
///
/// # Errors
///
/// The verdict, where it is a rejection.
///
/// # Panics
///
/// If the property does not hold.
pub fn step<C: Cipher, H: Specified>(
    opener: &mut Opener<2, C, H>,
    limit: u32,
    shared: bool,
    package: &[u8],
    right: bool,
) -> Result<(), OpenError> {
    let before = rows(opener);
    let expected = specified::<H>(&before, limit, package, right);
    let verdict = opener.open(package).map(drop);
    assert_eq!(verdict, expected);

    let header = header_of::<H>(package);
    let known = header.is_some_and(|(sender, _)| permitted::<H>(&before, sender).is_some());
    let after = before.map(|row| {
        let (mut row, (sender, sequence)) = row.zip(header)?;
        let his = row.sender == sender;
        if his && verdict.is_ok() {
            row.last = sequence;
        }
        let has_key = his || (shared && known);
        if has_key && verdict == Err(OpenError::BadTag) {
            row.failed += 1;
        }
        Some(row)
    });
    let after = if header.is_some() { after } else { before };
    assert_eq!(rows(opener), after);

    if let (Ok(()), Some((_, sequence))) = (verdict, header) {
        let again = opener.open(package).map_err(Some);
        assert_eq!(again.map(drop), Err(H::is_stale(sequence, sequence)));
        assert_eq!(rows(opener), after);
    }
    verdict
}

/// What the receiver remembers of each sender.
fn rows<C: Cipher, H: Specified>(opener: &Opener<2, C, H>) -> Rows<H> {
    let mut senders = opener.senders();
    [(); 2].map(|()| {
        let (sender, last) = senders.next()?;
        let failed = opener.failed_opens(sender).expect("permitted");
        Some(Row {
            sender,
            last,
            failed,
        })
    })
}

fn permitted<H: Specified>(rows: &Rows<H>, sender: H::Id) -> Option<Row<H::Id, H::Sequence>> {
    let [one, two] = rows.map(|row| row.filter(|row| row.sender == sender));
    one.or(two)
}

/// The header of what has the length of a package: who, and which place.
fn header_of<H: Specified>(package: &[u8]) -> Option<(H::Id, H::Sequence)> {
    let package: &[u8; PACKAGE_SIZE] = package.try_into().ok()?;
    Some(H::read(
        [0, 1, 2, 3, 4, 5, 6, 7].map(|at: usize| package[at]),
    ))
}

/// The verdict, condition by condition.
fn specified<H: Specified>(
    rows: &Rows<H>,
    limit: u32,
    package: &[u8],
    right: bool,
) -> Result<(), OpenError> {
    let wrong_length = OpenError::WrongLength(package.len());
    let (sender, sequence) = header_of::<H>(package).ok_or(wrong_length)?;
    let unknown = OpenError::UnknownSender(sender.into());
    let Row { last, failed, .. } = permitted::<H>(rows, sender).ok_or(unknown)?;
    if H::never_used(sequence) {
        return Err(OpenError::NoCounter(sender.into()));
    }
    if let Some(stale) = H::is_stale(sequence, last) {
        return Err(stale);
    }
    if failed >= limit {
        return Err(OpenError::IntegrityLimitReached);
    }
    if right {
        Ok(())
    } else {
        Err(OpenError::BadTag)
    }
}

/// O2: a message comes out if and only if the cipher has found the tag right. It is then what the cipher
/// has made of exactly the sealed message, the tag, and the nonce of salt and header. It comes with the
/// header's sender and counter. The cipher decrypts before its verdict, and all the same nothing comes
/// out with a wrong tag.
///
/// `at` is an index below 80 at which the message is looked at. Returns whether it came out.
///
/// # Panics
///
/// If the property does not hold.
#[must_use]
pub fn comes_out<H: Specified>(
    salt: u32,
    last: H::Sequence,
    verdict: Verdict,
    package: &[u8; PACKAGE_SIZE],
    at: usize,
) -> bool {
    let key = SealingKey::<Told, H>::new(&Told::key(verdict), salt).expect("a key");
    let (sender, sequence) = header_of::<H>(package).expect("96 bytes");
    let mut opener = Opener::<1, Told, H>::new();
    let permitted = opener.resume(key, &[(sender, last)]);
    permitted.expect("there is room");

    let opened = opener.open(package);
    let accepted = verdict == Verdict::Right && is_newer::<H>(sequence, last);
    assert_eq!(opened.is_ok(), accepted);
    let Ok(opened) = opened else { return false };
    assert_eq!(
        (opened.sender(), opened.sequence(), opened.counter()),
        (sender, sequence, H::counter(sequence))
    );
    let sealed = package[HEADER_SIZE..].first_chunk::<PLAINTEXT_SIZE>();
    let tag = package.last_chunk::<TAG_SIZE>().expect("96 bytes");
    let nonce = nonce_of::<H>(salt, sender, sequence);
    let expected = Told::byte(&nonce, sealed.expect("96 bytes"), tag, at);
    assert_eq!(opened.plaintext()[at], expected);
    true
}

/// Whether a sender may use `sequence`, and it is after `last`.
fn is_newer<H: Specified>(sequence: H::Sequence, last: H::Sequence) -> bool {
    !H::never_used(sequence) && H::is_stale(sequence, last).is_none()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink_commsec::{AesGcm, EpochHeader, PackageHeader};
    use proptest::prelude::*;

    const KEYS: [[u8; 16]; 2] = [[7; 16], [8; 16]];

    /// An epoch and a counter; the epoch counts only where there are any.
    type Sequence = (u16, u32);

    fn place_of<H: Specified>((epoch, counter): Sequence) -> H::Sequence {
        H::place_of(epoch, counter)
    }

    /// Senders 5 and 6, with one key or two.
    fn receiver<H: Specified>(
        shared: bool,
        lasts: [Sequence; 2],
        limit: u32,
    ) -> Opener<2, AesGcm, H> {
        let mut opener = Opener::<2, AesGcm, H>::with_limit(limit);
        let key = |which: usize| SealingKey::new(&KEYS[which], 9).expect("a key");
        let [five, six] =
            [(5, lasts[0]), (6, lasts[1])].map(|(id, last)| (H::id(id), place_of::<H>(last)));
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
    fn package<H: Specified>(which: usize, id: u32, sequence: Sequence) -> [u8; PACKAGE_SIZE] {
        let (id, sequence) = (H::id(id), place_of::<H>(sequence));
        let mut message = [3; PLAINTEXT_SIZE];
        let tag = AesGcm::new(&KEYS[which]).seal(&nonce_of::<H>(9, id, sequence), &mut message);
        let header = H::write(id, sequence);
        let parts = [&header[..], &message, &tag.expect("AES does not fail")];
        parts.concat().try_into().expect("96 bytes")
    }

    /// Which key, who, epoch and counter, and what is wrong with the package.
    type Sealed = (usize, u32, Sequence, u8);

    fn random<H: Specified>(shared: bool, lasts: [Sequence; 2], limit: u32, packages: &[Sealed]) {
        let mut opener = receiver::<H>(shared, lasts, limit);
        for (which, id, (epoch, counter), fault) in packages {
            let counter = if counter % 3 == 0 {
                *counter
            } else {
                1 + counter % 12
            };
            let mut bytes = package::<H>(*which, *id, (*epoch, counter)).to_vec();
            match fault {
                0 => bytes[95] ^= 1,
                1 => bytes[40] ^= 0x80,
                2 => bytes.truncate(95),
                3 => bytes.push(0),
                _ => {}
            }
            let own_key = if shared || *id == 5 { 0 } else { 1 };
            let right = *fault > 1 && *which == own_key;
            let _ = step(&mut opener, limit, shared, &bytes, right);
        }
    }

    proptest! {
        #[test]
        fn o1_random(
            shared: bool,
            lasts in [(0..4_u16, 0..8_u32), (0..4_u16, 0..8_u32)],
            limit in 0..4_u32,
            packages in proptest::collection::vec(
                (0..2_usize, 4..8_u32, (0..5_u16, 1..u32::MAX), 0..9_u8),
                0..12,
            ),
        ) {
            random::<PackageHeader>(shared, lasts, limit, &packages);
            random::<EpochHeader>(shared, lasts, limit, &packages);
        }

        #[test]
        fn o2_random(salt: u32, last: Sequence, bytes: [[u8; 32]; 3], right: bool, fails: bool) {
            let package = std::array::from_fn(|at| bytes[at / 32][at % 32]);
            let verdict = match (right, fails) {
                (true, _) => Verdict::Right,
                (false, true) => Verdict::Fails,
                (false, false) => Verdict::Wrong,
            };
            for at in 0..PLAINTEXT_SIZE {
                let _ = comes_out::<PackageHeader>(salt, last.1, verdict, &package, at);
                let last = place_of::<EpochHeader>(last);
                let _ = comes_out::<EpochHeader>(salt, last, verdict, &package, at);
            }
        }
    }

    /// Every edge before every other, as last and as next place; one package is genuine.
    fn edges<H: Specified>(places: &[Sequence]) {
        for last in places {
            for sequence in places {
                let mut bytes = package::<H>(0, 5, (0, 1)).to_vec();
                let claimed = place_of::<H>(*sequence);
                bytes[..HEADER_SIZE].copy_from_slice(&H::write(H::id(5), claimed));
                let mut opener = receiver::<H>(true, [*last, (0, 0)], 3);
                let right = claimed == place_of::<H>((0, 1));
                let _ = step(&mut opener, 3, true, &bytes, right);
            }
        }
    }

    fn wears_out<H: Specified>() {
        for limit in [0, 1, 2] {
            for shared in [false, true] {
                let mut opener = receiver::<H>(shared, [(0, 0); 2], limit);
                for id in [5, 6, 5, 6, 5, 6] {
                    let which = usize::from(!shared && id == 6);
                    let forged = package::<H>(1 - which, id, (0, 1));
                    let _ = step(&mut opener, limit, shared, &forged, false);
                }
                let genuine = package::<H>(0, 5, (0, 1));
                let worn = step(&mut opener, limit, shared, &genuine, true);
                assert_eq!(worn, Err(OpenError::IntegrityLimitReached));
            }
        }
    }

    #[test]
    fn o1_edges() {
        let counters = [0, 1, 2, u32::MAX - 1, u32::MAX];
        edges::<PackageHeader>(&counters.map(|counter| (0, counter)));
        let epochs = [0, 1, u16::MAX - 1, u16::MAX];
        let places = epochs.map(|epoch| counters.map(|counter| (epoch, counter)));
        edges::<EpochHeader>(places.as_flattened());
        wears_out::<PackageHeader>();
        wears_out::<EpochHeader>();
    }

    /// Every other length.
    #[test]
    fn o1_lengths() {
        let bytes = [(0, 1), (0, 2)].map(|sequence| package::<PackageHeader>(0, 5, sequence));
        let bytes = bytes.as_flattened();
        for length in 0..=bytes.len() {
            let mut opener = receiver::<PackageHeader>(true, [(0, 0); 2], 3);
            let verdict = step(&mut opener, 3, true, &bytes[..length], true);
            assert_eq!(verdict.is_ok(), length == 96);
        }
    }

    #[test]
    fn o2_edges() {
        let package = std::array::from_fn(|at| at as u8);
        let (counter, sequence) = (0x0405_0607, |epoch, counter| {
            EpochHeader::place_of(epoch, counter)
        });
        for verdict in [Verdict::Right, Verdict::Wrong, Verdict::Fails] {
            for at in 0..PLAINTEXT_SIZE {
                for last in [0, counter - 1, counter, counter + 1] {
                    let out = comes_out::<PackageHeader>(1, last, verdict, &package, at);
                    assert_eq!(out, last < counter && verdict == Verdict::Right);
                }
                let (epoch, counter) = (0x0405, 0x0001_0203);
                for last in [
                    sequence(0, 0),
                    sequence(epoch - 1, u32::MAX),
                    sequence(epoch, counter - 1),
                    sequence(epoch, counter),
                    sequence(epoch, counter + 1),
                    sequence(epoch + 1, 0),
                ] {
                    let out = comes_out::<EpochHeader>(1, last, verdict, &package, at);
                    let newer = last < sequence(epoch, counter);
                    assert_eq!(out, newer && verdict == Verdict::Right);
                }
            }
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::any_prefix;
    use mavlink_commsec::{EpochHeader, PackageHeader};

    /// Any package at two senders, each with a key of his own and a verdict of its own, or with one key.
    /// Whether the key is shared is known to the solver: the number of keys follows from it.
    fn any_step<H: Specified>(shared: bool) -> Result<(), OpenError> {
        let verdict = |right| {
            if right {
                Verdict::Right
            } else {
                Verdict::Wrong
            }
        };
        let right: [bool; 2] = kani::any();
        let key = |which: usize| {
            SealingKey::<Told, H>::new(&Told::key(verdict(right[which])), 9).expect("a key")
        };
        let rows: [(u32, u16, u32); 2] = kani::any();
        let [one, two] = rows.map(|(id, epoch, last)| (H::id(id), H::place_of(epoch, last)));
        kani::assume(one.0 != two.0);
        let (limit, failed): (u32, [u32; 2]) = (kani::any(), kani::any());
        // No state in which more were counted than are let be: the count stops there.
        kani::assume(failed.iter().all(|failed| *failed <= limit));
        let opener = Opener::<2, Told, H>::with_limit(limit);
        let opener = opener.with_key(key(0), failed[0]);
        let opener = opener.with_sender(one.0, 0, one.1);
        let mut opener = if shared {
            opener.with_sender(two.0, 0, two.1)
        } else {
            let opener = opener.with_key(key(1), failed[1]);
            opener.with_sender(two.0, 1, two.1)
        };

        let bytes: [u8; PACKAGE_SIZE + 1] = kani::any();
        let package = any_prefix(&bytes);
        let second = header_of::<H>(package).is_some_and(|(sender, _)| sender == two.0);
        let right = right[usize::from(second && !shared)];
        let verdict = step(&mut opener, limit, shared, package, right);
        // What is wiped is no part of this.
        core::mem::forget(opener);
        kani::cover!(verdict.is_ok() && second, "accepted of the second");
        kani::cover!(
            verdict == Err(OpenError::IntegrityLimitReached) && limit > 0,
            "worn out"
        );
        verdict
    }

    #[kani::proof]
    #[kani::unwind(81)]
    fn o1_step_own_keys() {
        covered(any_step::<PackageHeader>(false));
    }

    #[kani::proof]
    #[kani::unwind(81)]
    fn o1_step_shared_key() {
        covered(any_step::<PackageHeader>(true));
    }

    fn covered(verdict: Result<(), OpenError>) {
        kani::cover!(verdict.is_ok(), "accepted");
        kani::cover!(verdict == Err(OpenError::BadTag), "bad tag");
        kani::cover!(matches!(verdict, Err(OpenError::Stale { .. })), "stale");
        kani::cover!(
            matches!(verdict, Err(OpenError::NoCounter(_))),
            "no counter"
        );
        kani::cover!(
            matches!(verdict, Err(OpenError::UnknownSender(_))),
            "unknown"
        );
        kani::cover!(verdict == Err(OpenError::WrongLength(97)), "too long");
    }

    #[kani::proof]
    #[kani::unwind(81)]
    fn o1_step_epoch() {
        let verdict = any_step::<EpochHeader>(false);
        kani::cover!(verdict.is_ok(), "accepted");
        kani::cover!(verdict == Err(OpenError::BadTag), "bad tag");
        kani::cover!(
            matches!(verdict, Err(OpenError::StaleInEpoch { sequence, last }) if sequence.counter > last.counter),
            "stale, with a greater counter"
        );
        kani::cover!(
            matches!(verdict, Err(OpenError::NoCounter(_))),
            "no counter"
        );
        kani::cover!(
            matches!(verdict, Err(OpenError::UnknownSender(_))),
            "unknown"
        );
    }

    /// Any package, last place and verdict.
    fn any_comes_out<H: Specified>() {
        let verdict = match kani::any() {
            0_u8 => Verdict::Right,
            1 => Verdict::Wrong,
            _ => Verdict::Fails,
        };
        let package: [u8; PACKAGE_SIZE] = kani::any();
        let last = H::place_of(kani::any(), kani::any());
        let at = kani::any();
        kani::assume(at < PLAINTEXT_SIZE);
        let out = comes_out::<H>(kani::any(), last, verdict, &package, at);
        let (_, sequence) = header_of::<H>(&package).expect("96 bytes");
        let newer = is_newer::<H>(sequence, last);
        kani::cover!(out, "accepted");
        kani::cover!(
            !out && newer && verdict == Verdict::Wrong,
            "decrypted and rejected"
        );
        kani::cover!(!out && !newer && verdict == Verdict::Right, "stale");
    }

    #[kani::proof]
    #[kani::unwind(97)]
    fn o2_comes_out() {
        any_comes_out::<PackageHeader>();
    }

    #[kani::proof]
    #[kani::unwind(97)]
    fn o2_comes_out_epoch() {
        any_comes_out::<EpochHeader>();
    }
}
