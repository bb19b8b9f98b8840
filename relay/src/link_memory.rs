//! What one end of a signed link remembers: its keys, and a mark for each, in an order that no cut of the power upsets.

use core::fmt;

use embedded_storage::nor_flash::NorFlash;
use mavlink_signing::{KEY_SIZE, KeyChangeError, KeyRing, Profile};
use mavseal_store::{
    Binding, Contents, Journal, MARK_SIZE, MarkError, OpenError, ProvisionError, Region,
};

use crate::key_store::FlashKeyStore;
use crate::persistent_clock::PersistentClock;

/// The flash of one end: for its keys, and for the mark of the key in each slot. Each has two pages of its own.
#[derive(Debug)]
pub struct LinkFlash<F> {
    /// For [`FlashKeyStore`].
    pub keys: F,
    /// For [`PersistentClock`].
    pub marks: [F; 2],
    /// Where they are in each.
    pub region: Region,
}

/// What a device does that has no key yet.
#[derive(Clone, Copy)]
pub enum FirstKey<'a> {
    /// It does not start.
    None,
    /// It takes this one.
    Own(&'a [u8; KEY_SIZE]),
    /// It takes this one, which everybody knows.
    Demonstration(&'a [u8; KEY_SIZE]),
}

impl fmt::Debug for FirstKey<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::None => "None",
            Self::Own(_) => "Own(redacted)",
            Self::Demonstration(_) => "Demonstration(redacted)",
        })
    }
}

/// Keys and marks of one end of a signed link.
#[derive(Debug)]
pub struct LinkMemory<F, T> {
    /// Where the keys are stored.
    pub store: FlashKeyStore<F>,
    /// The clock, with the marks.
    pub clock: PersistentClock<F, T>,
}

impl<F: NorFlash, T: FnMut() -> u64> LinkMemory<F, T> {
    /// The keys and marks in `flash`. A device on which nothing was ever stored takes the `first` key. `timer` gives
    /// ticks of 10 microseconds that never go back.
    ///
    /// The first key is stored, then its mark, then that it is in use. Nothing is signed or accepted before. So a cut at
    /// any moment leaves a device that starts, and later a mark that is not there was lost.
    ///
    /// # Errors
    ///
    /// [`LinkMemoryError`]. Nothing may be signed or accepted then.
    pub fn open<P: Profile>(
        flash: LinkFlash<F>,
        first: FirstKey<'_>,
        timer: T,
    ) -> Result<(KeyRing<P>, Self), LinkMemoryError> {
        let LinkFlash {
            keys,
            mut marks,
            region,
        } = flash;
        let (mut store, found) = FlashKeyStore::open(keys, region)?;
        let keys = match found {
            Some(keys) if store.is_in_use() => {
                let clock = PersistentClock::open(marks, region, &keys, timer)?;
                return Ok((keys, Self { store, clock }));
            }
            Some(keys) => keys,
            None if !store.is_empty() => return Err(LinkMemoryError::KeysUnreadable),
            None => {
                // A mark without keys: they were in use, and are lost.
                let [a, b] = marks;
                let (a, b) = (unused(a, region)?, unused(b, region)?);
                marks = [a, b];
                match first {
                    FirstKey::None => return Err(LinkMemoryError::NoKey),
                    FirstKey::Own(key) => store.provision(key)?,
                    FirstKey::Demonstration(key) => store.provision_demonstration(key)?,
                }
            }
        };
        Self::begin(keys, store, marks, region, timer)
    }

    /// A device that somebody gives `key`, whatever its flash holds: all of that is forgotten.
    ///
    /// # Errors
    ///
    /// [`LinkMemoryError`].
    pub fn provision<P: Profile>(
        flash: LinkFlash<F>,
        key: &[u8; KEY_SIZE],
        timer: T,
    ) -> Result<(KeyRing<P>, Self), LinkMemoryError> {
        let (mut store, _) = FlashKeyStore::open::<P>(flash.keys, flash.region)?;
        let keys = store.provision(key)?;
        Self::begin(keys, store, flash.marks, flash.region, timer)
    }

    fn begin<P: Profile>(
        keys: KeyRing<P>,
        mut store: FlashKeyStore<F>,
        marks: [F; 2],
        region: Region,
        timer: T,
    ) -> Result<(KeyRing<P>, Self), LinkMemoryError> {
        let clock = PersistentClock::provision(marks, region, &keys, timer)?;
        let in_use = store.set_in_use();
        in_use.map_err(|_| LinkMemoryError::NotStored)?;
        Ok((keys, Self { store, clock }))
    }
}

/// That a flash for marks was never used. It is handed back, so that all code exists for one type of it.
fn unused<F: NorFlash>(flash: F, region: Region) -> Result<F, LinkMemoryError> {
    let (journal, contents) =
        Journal::<F, MARK_SIZE>::open(flash, region, Binding::new(0, [0; 4]))?;
    match contents {
        Contents::Blank | Contents::Interrupted => Ok(journal.into_flash()),
        _ => Err(LinkMemoryError::KeysLost),
    }
}

/// Why an end of a link does not start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum LinkMemoryError {
    /// The flash cannot hold the keys or a mark. Its layout is at fault.
    Open(OpenError),
    /// There is no key yet. It must be given one.
    NoKey,
    /// There were keys, and they can no longer be read. It must be given one anew.
    KeysUnreadable,
    /// The flash for the keys is blank, but there are marks: somebody erased the keys. It must be given one anew.
    KeysLost,
    /// The mark of a key was lost, or is another key's. The device must be given a new key.
    Mark(MarkError),
    /// The first key is none.
    Key(KeyChangeError),
    /// The flash does not hold what is written to it.
    NotStored,
}

impl From<OpenError> for LinkMemoryError {
    fn from(error: OpenError) -> Self {
        Self::Open(error)
    }
}

impl From<MarkError> for LinkMemoryError {
    fn from(error: MarkError) -> Self {
        match error {
            MarkError::Open(error) => Self::Open(error),
            _ => Self::Mark(error),
        }
    }
}

impl From<ProvisionError> for LinkMemoryError {
    fn from(error: ProvisionError) -> Self {
        match error {
            ProvisionError::Open(error) => Self::Open(error),
            _ => Self::NotStored,
        }
    }
}

impl From<KeyChangeError> for LinkMemoryError {
    fn from(error: KeyChangeError) -> Self {
        match error {
            KeyChangeError::NotStored => Self::NotStored,
            _ => Self::Key(error),
        }
    }
}

impl fmt::Display for LinkMemoryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Open(error) => error.fmt(f),
            Self::NoKey => f.write_str("there is no key yet"),
            Self::KeysUnreadable => f.write_str("the keys can no longer be read"),
            Self::KeysLost => f.write_str("the keys were erased, and the marks were not"),
            Self::Mark(error) => error.fmt(f),
            Self::Key(error) => error.fmt(f),
            Self::NotStored => f.write_str("the flash does not hold what is written to it"),
        }
    }
}

impl core::error::Error for LinkMemoryError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Open(error) => Some(error),
            Self::Mark(error) => Some(error),
            Self::Key(error) => Some(error),
            _ => None,
        }
    }
}
