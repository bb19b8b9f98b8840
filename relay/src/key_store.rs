//! Two slots for keys in flash, and how far a change from one to the other has come.

use embedded_storage::nor_flash::NorFlash;
use mavlink_signing::{
    KEY_SIZE, KeyChange, KeyChangeError, KeyRing, KeySlot, KeyStore, NotStored, Profile,
    RolloverState, SigningKey,
};
use mavseal_store::{Binding, Contents, Journal, OpenError, Region};
use zeroize::Zeroizing;

/// Bytes of phase, slot and use, and of zeros behind them.
const PHASE_SIZE: usize = 8;
/// Bytes of the record: phase, then the old key, then the new one, zeros if there is none.
pub const KEYS_SIZE: usize = PHASE_SIZE + 2 * KEY_SIZE;
/// What the records are.
const BINDING: Binding = Binding::new(2, [0; 4]);

type Record = [u8; KEYS_SIZE];

/// The keys of one end of a link in flash: [`KeyRing`] over a restart.
///
/// Whoever can read the flash has the keys: protect it as the part allows. A key that is given up is erased, or
/// overwritten where a page no longer erases; what fails is tried again at each start:
/// [`retired_key_remains`](Self::retired_key_remains).
#[derive(Debug)]
pub struct FlashKeyStore<F> {
    journal: Journal<F, KEYS_SIZE>,
    empty: bool,
    remains: bool,
    in_use: bool,
}

impl<F: NorFlash> FlashKeyStore<F> {
    /// The slots in `region` of `flash`, and the keys that they hold; `None` if they are
    /// [empty](FlashKeyStore::is_empty), or hold something that cannot be relied on: nothing is signed or accepted
    /// then.
    ///
    /// What is found is stored again before it is relied on, and what was given up is erased.
    ///
    /// # Errors
    ///
    /// [`OpenError`].
    pub fn open<P: Profile>(
        flash: F,
        region: Region,
    ) -> Result<(Self, Option<KeyRing<P>>), OpenError> {
        let (journal, stored) = Journal::open(flash, region, BINDING)?;
        let mut slots = Self {
            journal,
            empty: matches!(stored, Contents::Blank | Contents::Interrupted),
            remains: false,
            in_use: false,
        };
        let Contents::Record(record) = stored else {
            return Ok((slots, None));
        };
        let record = Zeroizing::new(record);
        slots.in_use = used(&record);
        let keys = keys(&record);
        // What a cut write has left may not be found by the next restart; what follows from it now must not
        // outlive it.
        let keys = keys.filter(|_| slots.journal.append(&record).is_ok());
        if keys
            .as_ref()
            .is_some_and(|keys| keys.rollover_state() == RolloverState::Settled)
        {
            slots.remains = slots.journal.forget().is_err();
        }
        Ok((slots, keys))
    }

    /// Stores the first key, which came in on a trusted port or was there when the board was made. Every
    /// other is erased. It is not [in use](Self::is_in_use) yet.
    ///
    /// # Errors
    ///
    /// [`KeyChangeError::Key`], [`KeyChangeError::NotStored`].
    pub fn provision<P: Profile>(
        &mut self,
        key: &[u8; KEY_SIZE],
    ) -> Result<KeyRing<P>, KeyChangeError> {
        let prepared = KeyRing::<P>::prepare(key)?;
        self.provision_first(key, prepared)
    }

    /// The same with a key that everybody knows: for demonstrations.
    ///
    /// # Errors
    ///
    /// As [`provision`](Self::provision).
    pub fn provision_demonstration<P: Profile>(
        &mut self,
        key: &[u8; KEY_SIZE],
    ) -> Result<KeyRing<P>, KeyChangeError> {
        let prepared = SigningKey::new(key)?;
        self.provision_first(key, prepared)
    }

    fn provision_first<P: Profile>(
        &mut self,
        key: &[u8; KEY_SIZE],
        prepared: SigningKey<P>,
    ) -> Result<KeyRing<P>, KeyChangeError> {
        self.in_use = false;
        let record = self.record(RolloverState::Settled, KeySlot::A, key, &[0; KEY_SIZE]);
        self.journal.provision(&record).map_err(|_| NotStored)?;
        self.empty = false;
        Ok(prepared.into())
    }

    /// Whether the first key may have been signed or accepted with: [`set_in_use`](Self::set_in_use) was called. If
    /// not, its mark may still be made.
    pub const fn is_in_use(&self) -> bool {
        self.in_use
    }

    /// From now on the keys are in use: their marks are there, and a mark that is missing later was lost.
    ///
    /// # Errors
    ///
    /// [`NotStored`].
    pub fn set_in_use(&mut self) -> Result<(), NotStored> {
        let stored = Zeroizing::new(self.journal.newest().ok_or(NotStored)?);
        let (phase, base, old, new) = split(&stored).ok_or(NotStored)?;
        self.in_use = true;
        let record = self.record(phase, base, old, new);
        self.journal.append(&record).map_err(|_| NotStored)
    }

    /// Stores `record` and erases all before it. That it counts is enough: what is left is erased at the next
    /// start.
    fn settle(&mut self, record: &Record) -> Result<(), NotStored> {
        self.remains = self.journal.replace(record).is_err();
        let stored = !self.remains || self.journal.newest() == Some(*record);
        stored.then_some(()).ok_or(NotStored)
    }

    /// Whether a key that was retired or withdrawn can still be read from the flash, as a page neither erases nor takes
    /// zeros. Then the flash is worn out: whoever gets the device gets that key.
    pub const fn retired_key_remains(&self) -> bool {
        self.remains
    }

    /// Whether nothing was ever stored as a whole. Only then may a first key be provided without somebody's asking for
    /// it: otherwise it would take the place of one that is there, or was there and can no longer be read.
    pub const fn is_empty(&self) -> bool {
        self.empty
    }

    /// The flash, for what else it holds.
    pub fn into_flash(self) -> F {
        self.journal.into_flash()
    }

    fn record(
        &self,
        phase: RolloverState,
        base: KeySlot,
        old: &[u8; KEY_SIZE],
        new: &[u8; KEY_SIZE],
    ) -> Zeroizing<Record> {
        let mut record = Zeroizing::new([0; KEYS_SIZE]);
        let (slot, in_use) = (u8::from(base == KeySlot::B), u8::from(self.in_use));
        let first = [code(phase), slot, in_use, 0, 0, 0, 0, 0];
        let parts = first.iter().chain(old).chain(new);
        for (slot, byte) in record.iter_mut().zip(parts) {
            *slot = *byte;
        }
        record
    }
}

impl<F: NorFlash> KeyStore for FlashKeyStore<F> {
    fn store(&mut self, change: KeyChange<'_>) -> Result<(), NotStored> {
        let stored = Zeroizing::new(self.journal.newest().ok_or(NotStored)?);
        let (found, base, old, new) = split(&stored).ok_or(NotStored)?;
        let none = [0; KEY_SIZE];
        let settled = RolloverState::Settled;
        let next = match change {
            KeyChange::Begin(key, phase) => self.record(phase, base, old, key),
            _ if found == settled => return Err(NotStored),
            KeyChange::Confirm => self.record(RolloverState::Confirmed, base, old, new),
            KeyChange::Retire => {
                let record = self.record(settled, base.other(), new, &none);
                return self.settle(&record);
            }
            KeyChange::Withdraw => {
                let record = self.record(settled, base, old, &none);
                return self.settle(&record);
            }
        };
        if self.journal.append(&next).is_ok() {
            return Ok(());
        }
        // What a failed write has left must not be what the next start finds.
        let _ = self.journal.append(&stored);
        Err(NotStored)
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

/// Whether the keys are in use.
fn used(record: &Record) -> bool {
    let [_, _, in_use, ..] = record;
    *in_use != 0
}

type Split<'a> = (
    RolloverState,
    KeySlot,
    &'a [u8; KEY_SIZE],
    &'a [u8; KEY_SIZE],
);

fn split(record: &Record) -> Option<Split<'_>> {
    let (&[first, slot, ..], rest) = record.split_first_chunk::<PHASE_SIZE>()?;
    let (old, rest) = rest.split_first_chunk()?;
    let phases = [
        RolloverState::Settled,
        RolloverState::Offered,
        RolloverState::Applied,
        RolloverState::Confirmed,
    ];
    let phase = phases.into_iter().find(|phase| code(*phase) == first)?;
    let base = match slot {
        0 => KeySlot::A,
        1 => KeySlot::B,
        _ => return None,
    };
    Some((phase, base, old, rest.first_chunk()?))
}

fn keys<P: Profile>(record: &Record) -> Option<KeyRing<P>> {
    let (phase, base, old, new) = split(record)?;
    let old = SigningKey::new(old).ok()?;
    if phase == RolloverState::Settled {
        return Some(KeyRing::in_slot(base, old));
    }
    Some(KeyRing::resume(
        base,
        old,
        SigningKey::new(new).ok()?,
        phase,
    ))
}
