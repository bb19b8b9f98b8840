//! Sealed packages, against the package `cryptography` for Python: both ways, both headers.

use std::path::Path;

use anyhow::{Context, Result};
use mavlink_commsec::{
    AesGcm, EpochCounter, EpochHeader, EpochSenderId, HeaderFormat, Opener, PackageHeader,
    Plaintext, Sealer, SealingKey, SenderId,
};
use rand::{Rng, RngExt, rngs::SmallRng};

use crate::{hex, report::Judge, script::Script};

const PEER: &str = "cryptography";
/// Messages of each header, each way.
const MESSAGES: usize = 1500;

/// A header, and how it is spoken of to the peer.
trait Spoken: HeaderFormat {
    const NAME: &'static str;
    /// An id and a place by chance, not beyond the last ones.
    fn any(random: &mut SmallRng) -> (Self::Id, Self::Sequence);
    /// Id, epoch and counter, as the peer says them.
    fn words(id: Self::Id, sequence: Self::Sequence) -> String;
    /// A package sealed here with a sender that is next at `sequence`, or near it; and where it was.
    fn seal(
        key: SealingKey<AesGcm, Self>,
        id: Self::Id,
        sequence: Self::Sequence,
        message: &Plaintext,
    ) -> Result<(Self::Sequence, Vec<u8>)>;
}

impl Spoken for PackageHeader {
    const NAME: &'static str = "id-counter";

    fn any(random: &mut SmallRng) -> (SenderId, u32) {
        (SenderId(random.random()), random.random_range(1..u32::MAX))
    }

    fn words(id: SenderId, counter: u32) -> String {
        format!("{id} 0 {counter}")
    }

    fn seal(
        key: SealingKey,
        id: SenderId,
        counter: u32,
        message: &Plaintext,
    ) -> Result<(u32, Vec<u8>)> {
        let package = Sealer::resume(key, id, counter).seal(message)?;
        Ok((counter, package.as_bytes().to_vec()))
    }
}

impl Spoken for EpochHeader {
    const NAME: &'static str = "counter-epoch-id";

    fn any(random: &mut SmallRng) -> (EpochSenderId, EpochCounter) {
        let sequence = EpochCounter {
            epoch: random.random_range(0..u16::MAX),
            counter: random.random_range(1..u32::MAX),
        };
        (EpochSenderId(random.random()), sequence)
    }

    fn words(id: EpochSenderId, EpochCounter { epoch, counter }: EpochCounter) -> String {
        format!("{id} {epoch} {counter}")
    }

    /// The first package of the epoch, or one of the next.
    fn seal(
        key: SealingKey<AesGcm, Self>,
        id: EpochSenderId,
        sequence: EpochCounter,
        message: &Plaintext,
    ) -> Result<(EpochCounter, Vec<u8>)> {
        let mut sealer = Sealer::begin(key, id, sequence.epoch.into())?;
        for _ in 0..sequence.counter % 4 {
            sealer.seal(message)?;
        }
        let sequence = sealer.next_sequence().context("a counter is left")?;
        Ok((sequence, sealer.seal(message)?.as_bytes().to_vec()))
    }
}

/// Every package is made by the one and opened by the other, and is the same whoever makes it. Damaged, or
/// with another key or salt, both reject it.
pub(crate) fn run(python: &Path, random: &mut SmallRng, judge: &mut Judge) -> Result<()> {
    let mut peer = Script::start(python, PEER, "sealed.py", [])?;
    eprintln!("{PEER} {}", peer.version);
    for direction in ["sealed here, opened there", "sealed there, opened here"] {
        judge.begin(PEER, &peer.version, direction, 2 * MESSAGES);
        for _ in 0..MESSAGES {
            exchange::<PackageHeader>(
                &mut peer,
                direction.starts_with("sealed here"),
                random,
                judge,
            )?;
            exchange::<EpochHeader>(
                &mut peer,
                direction.starts_with("sealed here"),
                random,
                judge,
            )?;
        }
    }
    Ok(())
}

/// What a package is sealed with.
#[derive(Clone, Copy)]
struct Secret {
    key: [u8; 16],
    salt: u32,
}

impl Secret {
    fn key<H: HeaderFormat>(&self) -> Result<SealingKey<AesGcm, H>> {
        Ok(SealingKey::new(&self.key, self.salt)?)
    }

    /// Its words in an order.
    fn words(&self) -> String {
        format!("{} {:08x}", hex::encode(&self.key), self.salt)
    }
}

fn exchange<H: Spoken>(
    peer: &mut Script,
    from_here: bool,
    random: &mut SmallRng,
    judge: &mut Judge,
) -> Result<()> {
    let secret = Secret {
        key: random.random(),
        salt: random.random(),
    };
    let mut message: Plaintext = [0; 80];
    random.fill_bytes(&mut message);
    let (id, mut sequence) = H::any(random);
    let mut made = Vec::new();
    if from_here {
        (sequence, made) = H::seal(secret.key()?, id, sequence, &message)?;
    }
    let order = format!(
        "seal {} {} {} {}",
        H::NAME,
        secret.words(),
        H::words(id, sequence),
        hex::encode(&message)
    );
    let theirs = hex::decode(&peer.ask(&order)?)?;
    let mut package = theirs.clone();
    if from_here {
        judge.compare(PEER, "the same bytes", &[true], &[made == theirs], || {
            order.clone()
        });
        package = made;
    }

    let mut passes = |package: &[u8], secret: &Secret| -> Result<bool> {
        if from_here {
            let bytes = hex::encode(package);
            let answer = peer.ask(&format!("open {} {} {bytes}", H::NAME, secret.words()))?;
            let right = format!("{} {}", H::words(id, sequence), hex::encode(&message));
            return Ok(answer == right);
        }
        let mut opener = Opener::<1, AesGcm, H>::new();
        opener.permit(secret.key()?, &[id])?;
        let right = |opened: mavlink_commsec::Opened<H>| {
            (opened.sender(), opened.sequence(), *opened.plaintext()) == (id, sequence, message)
        };
        // Any counter, however far from the last.
        let fresh = H::ZERO..=H::NEVER_USED;
        Ok(opener.open_between(package, fresh).is_ok_and(right))
    };
    let mut check = |scenario, right, package: &[u8], secret: &Secret| -> Result<()> {
        let passed = passes(package, secret)?;
        judge.compare(PEER, scenario, &[right], &[passed], || {
            format!("{} {} {}", H::NAME, secret.words(), hex::encode(package))
        });
        Ok(())
    };
    check("opened", true, &package, &secret)?;
    let mut changed = |scenario, bytes: std::ops::Range<usize>| -> Result<()> {
        let bit = random.random_range(8 * bytes.start..8 * bytes.end);
        let mut changed = package.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        check(scenario, false, &changed, &secret)
    };
    changed("a bit of the header changed", 0..8)?;
    changed("a bit of the sealed message changed", 8..88)?;
    changed("a bit of the tag changed", 88..96)?;
    let mut other = secret;
    other.salt ^= 1 << random.random_range(0..32);
    check("another salt", false, &package, &other)?;
    let mut other = secret;
    other.key[random.random_range(0..16)] ^= 1 << random.random_range(0..8);
    check("another key", false, &package, &other)
}
