//! Two slots for keys in flash, and how far a change from one to the other has come.

use embedded_storage::nor_flash::NorFlash;
use mavlink_signing::{
    KEY_SIZE, KeyChange, KeyChangeError, KeyRing, KeyStore, NotStored, Profile, RolloverState,
    SigningKey,
};
use mavseal_store::{Journal, OpenError, Region};
use zeroize::Zeroizing;

/// Bytes of phase, and of zeros behind it.
const PHASE_SIZE: usize = 8;
/// Bytes of the record: phase, then the old key, then the new one, zeros if there is none.
pub const KEYS_SIZE: usize = PHASE_SIZE + 2 * KEY_SIZE;

type Record = [u8; KEYS_SIZE];

/// The keys of one end of a link in flash: [`KeyRing`] over a restart.
///
/// Whoever can read the flash has the keys: protect it as the part allows. A key that is given up is erased; if
/// the power fails meanwhile, at the next start.
#[derive(Debug)]
pub struct FlashKeyStore<F> {
    journal: Journal<F, KEYS_SIZE>,
}

impl<F: NorFlash> FlashKeyStore<F> {
    /// The slots in `region` of `flash`, and the keys that they hold; `None` if they are
    /// [empty](FlashKeyStore::is_empty), or hold something that cannot be relied on: nothing is signed or accepted
    /// then.
    ///
    /// What is found is stored again before it is relied on, and what was given up is erased: 80 bytes for each
    /// start, two erases for 25 of them.
    ///
    /// # Errors
    ///
    /// [`OpenError`].
    pub fn open<P: Profile>(
        flash: F,
        region: Region,
    ) -> Result<(Self, Option<KeyRing<P>>), OpenError> {
        let (journal, stored) = Journal::open(flash, region)?;
        let mut slots = Self { journal };
        let Some(record) = stored.map(Zeroizing::new) else {
            return Ok((slots, None));
        };
        let keys = keys(&record);
        // What a cut write has left may not be found by the next restart; what follows from it now must not
        // outlive it.
        let keys = keys.filter(|_| slots.journal.append(&record).is_ok());
        if keys
            .as_ref()
            .is_some_and(|keys| keys.rollover_state() == RolloverState::Settled)
        {
            // If it fails, the next start tries again.
            let _ = slots.journal.forget();
        }
        Ok((slots, keys))
    }

    /// Stores the first key, which came in on a trusted port or was there when the board was made. Every
    /// other is erased.
    ///
    /// # Errors
    ///
    /// [`KeyChangeError::Key`], [`KeyChangeError::NotStored`].
    pub fn provision<P: Profile>(
        &mut self,
        key: &[u8; KEY_SIZE],
    ) -> Result<KeyRing<P>, KeyChangeError> {
        let keys = SigningKey::new(key)?.into();
        self.settle(&record(RolloverState::Settled, key, &[0; KEY_SIZE]))?;
        Ok(keys)
    }

    /// Stores `record` and erases all before it. That it counts is enough: what is left is erased at the next
    /// start.
    fn settle(&mut self, record: &Record) -> Result<(), NotStored> {
        let stored = self.journal.replace(record).is_ok() || self.journal.newest() == Some(*record);
        stored.then_some(()).ok_or(NotStored)
    }

    /// Whether nothing was ever stored. Only then may a first key be provided without somebody's asking for it:
    /// otherwise it would take the place of one that is there, or was there and can no longer be read.
    pub const fn is_empty(&self) -> bool {
        self.journal.is_empty()
    }

    /// The flash, for what else it holds.
    pub fn into_flash(self) -> F {
        self.journal.into_flash()
    }
}

impl<F: NorFlash> KeyStore for FlashKeyStore<F> {
    fn store(&mut self, change: KeyChange<'_>) -> Result<(), NotStored> {
        let stored = Zeroizing::new(self.journal.newest().ok_or(NotStored)?);
        let (found, old, new) = split(&stored).ok_or(NotStored)?;
        let none = [0; KEY_SIZE];
        let next = match change {
            KeyChange::Begin(key, phase) => record(phase, old, key),
            _ if found == RolloverState::Settled => return Err(NotStored),
            KeyChange::Confirm => record(RolloverState::Confirmed, old, new),
            KeyChange::Retire => return self.settle(&record(RolloverState::Settled, new, &none)),
            KeyChange::Withdraw => return self.settle(&record(RolloverState::Settled, old, &none)),
        };
        self.journal.append(&next).map_err(|_| NotStored)
    }
}

const fn code(phase: RolloverState) -> u8 {
    match phase {
        RolloverState::Settled => 1,
        RolloverState::Offered => 2,
        RolloverState::Applied => 3,
        RolloverState::Confirmed => 4,
    }
}

fn record(phase: RolloverState, old: &[u8; KEY_SIZE], new: &[u8; KEY_SIZE]) -> Zeroizing<Record> {
    let mut record = Zeroizing::new([0; KEYS_SIZE]);
    let first = [code(phase), 0, 0, 0, 0, 0, 0, 0];
    let parts = first.iter().chain(old).chain(new);
    for (slot, byte) in record.iter_mut().zip(parts) {
        *slot = *byte;
    }
    record
}

fn split(record: &Record) -> Option<(RolloverState, &[u8; KEY_SIZE], &[u8; KEY_SIZE])> {
    let (&[first, ..], rest) = record.split_first_chunk::<PHASE_SIZE>()?;
    let (old, rest) = rest.split_first_chunk()?;
    let phases = [
        RolloverState::Settled,
        RolloverState::Offered,
        RolloverState::Applied,
        RolloverState::Confirmed,
    ];
    let phase = phases.into_iter().find(|phase| code(*phase) == first)?;
    Some((phase, old, rest.first_chunk()?))
}

fn keys<P: Profile>(record: &Record) -> Option<KeyRing<P>> {
    let (phase, old, new) = split(record)?;
    let old = SigningKey::new(old).ok()?;
    if phase == RolloverState::Settled {
        return Some(old.into());
    }
    Some(KeyRing::resume(old, SigningKey::new(new).ok()?, phase))
}
