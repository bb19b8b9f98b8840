//! O1 and O2: a package is accepted once, and nothing of it is seen before.
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

/// How many counters behind the newest are taken.
pub const WINDOW: u32 = 64;
/// How many counters may be passed over.
pub const PASSED_OVER: u64 = 67_108_864;

use crate::cipher::{Specified, Told, Verdict, nonce_of};

/// What is known of one sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row<I, P> {
    /// Who.
    pub sender: I,
    /// The newest place accepted.
    pub last: P,
    /// Which places behind it are rejected, from bit 0 on.
    pub behind: u64,
    /// How many were passed over.
    pub passed_over: u32,
    /// Wrong tags counted for his key.
    pub failed: u32,
}

/// Both senders, as a receiver knows them.
type Rows<H> = [Option<Row<<H as HeaderFormat>::Id, <H as HeaderFormat>::Sequence>>; 2];

/// O1, one step from any state: a package is accepted if and only if all of these hold. It has 96 bytes,
/// its sender is permitted, and its counter (and epoch) is one that senders use. It is newer than the
/// newest accepted of him, or up to 64 counters behind that in its epoch and not accepted before. His key has
/// not had too many wrong tags, its tag is right, and no more than 2^26 counters of his will have been passed
/// over with it. Otherwise the error names the first that is wrong. What is accepted is then remembered, and the
/// same again is rejected; of other packages and senders nothing changes. What is rejected changes nothing, but
/// a wrong tag is counted, once, for everybody who has that key.
///
/// Every history is a sequence of such steps, so each package is accepted at most once in every
/// history. `right` tells whether the cipher takes the tag for right; `shared` whether the second sender
/// has the first one's key; `place`, 1 to 64, how far behind the newest the memory is looked at.
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
    place: u32,
) -> Result<(), OpenError> {
    let before = rows(opener);
    let expected = specified::<H>(&before, limit, package, right);
    let verdict = opener.open(package).map(drop);
    assert_eq!(verdict, expected);

    let header = header_of::<H>(package);
    let known = header.is_some_and(|(sender, _)| permitted::<H>(&before, sender).is_some());
    let remembered = rows(opener);
    for (row, now) in before.into_iter().zip(remembered) {
        let Some((mut row, now)) = row.zip(now) else {
            continue;
        };
        if let Some((sender, sequence)) = header {
            let his = row.sender == sender;
            if his && verdict.is_ok() {
                let is_rejected = now.behind >> (place - 1) & 1 == 1;
                assert_eq!(is_rejected, rejected_after::<H>(&row, sequence, place));
                row.behind = now.behind;
                row.passed_over += H::jump(row.last, sequence) as u32;
                if H::is_newer(sequence, row.last) {
                    row.last = sequence;
                }
            }
            let has_key = his || (shared && known);
            if has_key && verdict == Err(OpenError::BadTag) {
                row.failed += 1;
            }
        }
        assert_eq!(now, row);
    }

    if let (Ok(()), Some((sender, sequence))) = (verdict, header) {
        let newest = permitted::<H>(&remembered, sender).expect("permitted").last;
        let again = opener.open(package).map(drop);
        assert_eq!(again, Err(H::stale_error(sequence, newest)));
        assert_eq!(rows(opener), remembered);
    }
    verdict
}

/// Whether the counter `place` behind the newest is rejected once `sequence` has been accepted.
fn rejected_after<H: Specified>(
    before: &Row<H::Id, H::Sequence>,
    sequence: H::Sequence,
    place: u32,
) -> bool {
    let was = |place: u64| before.behind >> (place - 1) & 1 == 1;
    let place = u64::from(place);
    if !H::is_newer(sequence, before.last) {
        return was(place) || H::above(sequence, before.last) == Some(place);
    }
    match H::above(before.last, sequence) {
        Some(jump) if place > jump => was(place - jump),
        Some(jump) => place == jump,
        None => false,
    }
}

/// Whether the place is one that may be accepted.
fn is_fresh<H: Specified>(
    Row { last, behind, .. }: &Row<H::Id, H::Sequence>,
    sequence: H::Sequence,
) -> bool {
    let late = H::above(sequence, *last).filter(|place| *place <= u64::from(WINDOW));
    H::is_newer(sequence, *last) || late.is_some_and(|place| behind >> (place - 1) & 1 == 0)
}

/// What the receiver remembers of each sender.
fn rows<C: Cipher, H: Specified>(opener: &Opener<2, C, H>) -> Rows<H> {
    let mut memory = memory(opener);
    [(); 2].map(|()| {
        let (sender, last, behind, passed_over) = memory.next()?;
        let failed = opener.failed_opens(sender).expect("permitted");
        Some(Row {
            sender,
            last,
            behind,
            passed_over,
            failed,
        })
    })
}

/// Each sender, his newest counter, which behind it are rejected, and how many were passed over.
#[cfg(not(kani))]
fn memory<C: Cipher, H: Specified>(
    opener: &Opener<2, C, H>,
) -> impl Iterator<Item = (H::Id, H::Sequence, u64, u32)> {
    opener.senders().map(|(sender, last)| {
        let behind = opener.behind(sender).expect("permitted");
        let passed_over = opener.passed_over(sender).expect("permitted");
        (sender, last, behind, passed_over)
    })
}

#[cfg(kani)]
fn memory<C: Cipher, H: Specified>(
    opener: &Opener<2, C, H>,
) -> impl Iterator<Item = (H::Id, H::Sequence, u64, u32)> {
    opener.memory()
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
    let row = permitted::<H>(rows, sender).ok_or(unknown)?;
    if H::never_used(sequence) {
        return Err(OpenError::NoCounter(sender.into()));
    }
    if !is_fresh::<H>(&row, sequence) {
        return Err(H::stale_error(sequence, row.last));
    }
    if row.failed >= limit {
        return Err(OpenError::IntegrityLimitReached);
    }
    if !right {
        return Err(OpenError::BadTag);
    }
    if u64::from(row.passed_over) + H::jump(row.last, sequence) > PASSED_OVER {
        return Err(OpenError::JumpTooFar(sender.into()));
    }
    Ok(())
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

/// O1 with a clock, from any state of one sender that was resumed: a package is accepted if and only if its sequence
/// number is one that senders use, it is newer than `last`, its tag is right, and it lies from `earliest` to `latest`.
/// Otherwise the error names the first that is wrong, and nothing changes. How far it jumps does not matter, and is
/// not counted. Returns the verdict.
///
/// # Errors
///
/// The verdict, where it is a rejection.
///
/// # Panics
///
/// If the property does not hold.
pub fn between<H: Specified>(
    last: H::Sequence,
    verdict: Verdict,
    package: &[u8; PACKAGE_SIZE],
    earliest: H::Sequence,
    latest: H::Sequence,
) -> Result<(), OpenError> {
    let key = SealingKey::<Told, H>::new(&Told::key(verdict), 9).expect("a key");
    let (sender, sequence) = header_of::<H>(package).expect("96 bytes");
    let mut opener = Opener::<1, Told, H>::new();
    opener.resume(key, &[(sender, last)]).expect("room");
    let expected = if H::never_used(sequence) {
        Err(OpenError::NoCounter(sender.into()))
    } else if !H::is_newer(sequence, last) {
        Err(H::stale_error(sequence, last))
    } else if verdict != Verdict::Right {
        Err(OpenError::BadTag)
    } else if H::is_newer(earliest, sequence) {
        Err(OpenError::TooOld(sender.into()))
    } else if H::is_newer(sequence, latest) {
        Err(OpenError::FromFuture(sender.into()))
    } else {
        Ok(())
    };
    let opened = opener.open_between(package, earliest..=latest).map(drop);
    assert_eq!(opened, expected);
    let newest = if opened.is_ok() { sequence } else { last };
    assert!(opener.senders().next() == Some((sender, newest)));
    assert_eq!(opener.passed_over(sender), Some(0));
    opened
}

/// Whether a sender may use `sequence`, and it is after `last`, and not too far.
fn is_newer<H: Specified>(sequence: H::Sequence, last: H::Sequence) -> bool {
    let jump = H::jump(last, sequence);
    !H::never_used(sequence) && H::is_newer(sequence, last) && jump <= PASSED_OVER
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

    /// A step, and the memory at every place behind the newest.
    fn step_everywhere<H: Specified>(
        opener: &mut Opener<2, AesGcm, H>,
        limit: u32,
        shared: bool,
        package: &[u8],
        right: bool,
    ) -> Result<(), OpenError> {
        let before = rows(opener);
        let verdict = step(opener, limit, shared, package, right, 1);
        if let (Ok(()), Some((sender, sequence))) = (verdict, header_of::<H>(package)) {
            let [before, after] = [&before, &rows(opener)]
                .map(|rows| permitted::<H>(rows, sender).expect("permitted"));
            for place in 1..=WINDOW {
                let is_rejected = after.behind >> (place - 1) & 1 == 1;
                assert_eq!(is_rejected, rejected_after::<H>(&before, sequence, place));
            }
        }
        verdict
    }

    fn random<H: Specified>(shared: bool, lasts: [Sequence; 2], limit: u32, packages: &[Sealed]) {
        let mut opener = receiver::<H>(shared, lasts, limit);
        for (which, id, (epoch, counter), fault) in packages {
            let counter = match counter % 4 {
                0 => *counter,
                1 => counter >> 6,
                _ => 1 + counter % 90,
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
            let _ = step_everywhere(&mut opener, limit, shared, &bytes, right);
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
                0..24,
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
                let _ = step(&mut opener, 3, true, &bytes, right, 1);
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
                    let _ = step(&mut opener, limit, shared, &forged, false, 1);
                }
                let genuine = package::<H>(0, 5, (0, 1));
                let worn = step(&mut opener, limit, shared, &genuine, true, 1);
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

    /// Every place behind the newest, and every jump after it: each package is taken once.
    fn overtaking<H: Specified>() {
        for jump in 1..=WINDOW + 3 {
            let mut opener = receiver::<H>(true, [(1, 1000), (0, 0)], 3);
            let newest = 1002 + jump;
            let mut take = |counter| {
                let package = package::<H>(0, 5, (1, counter));
                step_everywhere(&mut opener, 3, true, &package, true).is_ok()
            };
            assert!(take(1002) && take(newest) && !take(1002));
            for counter in 990..newest {
                let fresh = counter > 1000 && counter != 1002 && newest - counter <= WINDOW;
                assert_eq!(take(counter), fresh, "{counter} behind {newest}");
            }
        }
    }

    /// Jumps that sum up to all that may be passed over, and one counter more.
    fn jumping<H: Specified>() {
        let all = PASSED_OVER as u32;
        let mut opener = receiver::<H>(true, [(1, 1), (0, 0)], 3);
        for (counter, accepted) in [
            (all + 3, false),
            (all / 2, true),
            (all + 4, false),
            (all + 3, true),
            (all + 5, false),
            (all + 4, true),
            (all - 3, true),
            (all - 61, false),
            (all, true),
            (u32::MAX - 1, false),
        ] {
            let package = package::<H>(0, 5, (1, counter));
            let verdict = step_everywhere(&mut opener, 3, true, &package, true);
            assert_eq!(verdict.is_ok(), accepted, "{counter}");
        }
    }

    #[test]
    fn o1_window() {
        overtaking::<PackageHeader>();
        overtaking::<EpochHeader>();
    }

    #[test]
    fn o1_jumps() {
        jumping::<PackageHeader>();
        jumping::<EpochHeader>();
    }

    /// Every other length.
    #[test]
    fn o1_lengths() {
        let bytes = [(0, 1), (0, 2)].map(|sequence| package::<PackageHeader>(0, 5, sequence));
        let bytes = bytes.as_flattened();
        for length in 0..=bytes.len() {
            let mut opener = receiver::<PackageHeader>(true, [(0, 0); 2], 3);
            let verdict = step(&mut opener, 3, true, &bytes[..length], true, 1);
            assert_eq!(verdict.is_ok(), length == 96);
        }
    }

    /// Every edge of what is fresh by the clock.
    #[test]
    fn o1_between() {
        fn edges<H: Specified>(epoch: u16) {
            let at = |counter| H::place_of(epoch, counter);
            for counter in [0, 1, 9, 10, 11, 3_000_000_000, u32::MAX - 1, u32::MAX] {
                let mut package = [7; PACKAGE_SIZE];
                package[..HEADER_SIZE].copy_from_slice(&H::write(H::id(5), at(counter)));
                for last in [0, 9, 10, 11] {
                    for (earliest, latest) in [(0, u32::MAX), (10, 10), (11, 20), (0, 9), (20, 3)] {
                        for verdict in [Verdict::Right, Verdict::Wrong, Verdict::Fails] {
                            let (earliest, latest) = (at(earliest), at(latest));
                            let _ = between::<H>(at(last), verdict, &package, earliest, latest);
                        }
                    }
                }
            }
        }
        edges::<PackageHeader>(0);
        edges::<EpochHeader>(3);
    }

    /// A place that no sender uses: nothing comes out, however new it is.
    #[test]
    fn o2_never_used() {
        fn none<H: Specified>(epoch: u16, counter: u32) {
            let header = H::write(H::id(5), H::place_of(epoch, counter));
            let mut package = [7; PACKAGE_SIZE];
            package[..HEADER_SIZE].copy_from_slice(&header);
            let out = comes_out::<H>(1, H::place_of(0, 0), Verdict::Right, &package, 0);
            assert!(!out);
        }
        none::<PackageHeader>(0, u32::MAX);
        none::<EpochHeader>(u16::MAX, 1);
        none::<EpochHeader>(1, u32::MAX);
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
                    // From 0 it is too far.
                    let near = last < counter && last > 0;
                    assert_eq!(out, near && verdict == Verdict::Right);
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
                    let newer = last < sequence(epoch, counter) && last.epoch > 0;
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
        let (behind, passed_over): ([u64; 2], [u32; 2]) = (kani::any(), kani::any());
        kani::assume(
            passed_over
                .iter()
                .all(|passed| u64::from(*passed) <= PASSED_OVER),
        );
        let (limit, failed): (u32, [u32; 2]) = (kani::any(), kani::any());
        // No state in which more were counted than are let be: the count stops there.
        kani::assume(failed.iter().all(|failed| *failed <= limit));
        let opener = Opener::<2, Told, H>::with_limit(limit);
        let opener = opener.with_key(key(0), failed[0]);
        let opener = opener.with_sender(one.0, 0, one.1, behind[0], passed_over[0]);
        let mut opener = if shared {
            opener.with_sender(two.0, 0, two.1, behind[1], passed_over[1])
        } else {
            let opener = opener.with_key(key(1), failed[1]);
            opener.with_sender(two.0, 1, two.1, behind[1], passed_over[1])
        };

        let bytes: [u8; PACKAGE_SIZE + 1] = kani::any();
        let package = any_prefix(&bytes);
        let second = header_of::<H>(package).is_some_and(|(sender, _)| sender == two.0);
        let right = right[usize::from(second && !shared)];
        let place = kani::any();
        kani::assume((1..=WINDOW).contains(&place));
        let late = header_of::<H>(package).is_some_and(|(sender, sequence)| {
            sender == one.0 && H::above(sequence, one.1) == Some(WINDOW.into())
        });
        let verdict = step(&mut opener, limit, shared, package, right, place);
        // What is wiped is no part of this.
        core::mem::forget(opener);
        kani::cover!(verdict.is_ok() && second, "accepted of the second");
        kani::cover!(verdict.is_ok() && late, "accepted at the end of the window");
        kani::cover!(matches!(verdict, Err(OpenError::JumpTooFar(_))), "too far");
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

    #[kani::proof]
    #[kani::unwind(97)]
    fn o1_between_any() {
        let verdict = if kani::any() {
            Verdict::Right
        } else {
            Verdict::Wrong
        };
        let package: [u8; PACKAGE_SIZE] = kani::any();
        let [last, earliest, latest] = kani::any::<[u32; 3]>();
        let opened = between::<PackageHeader>(last, verdict, &package, earliest, latest);
        kani::cover!(opened.is_ok(), "accepted");
        kani::cover!(matches!(opened, Err(OpenError::TooOld(_))), "too old");
        kani::cover!(
            matches!(opened, Err(OpenError::FromFuture(_))),
            "from the future"
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
