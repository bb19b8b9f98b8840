//! Fresh keys from the operating system's random generator.

use zeroize::Zeroizing;

use crate::error::KeyFileError;
use crate::file::{Exceptions, KeyFile, SenderKeys};

impl KeyFile {
    /// Random keys and salts for a vehicle with id 0 and stations with ids from 1.
    ///
    /// # Errors
    ///
    /// [`KeyFileError::StationCount`], [`KeyFileError::Random`].
    pub fn generate(stations: usize) -> Result<Self, KeyFileError> {
        // Before any number of them is made.
        if stations > crate::MAX_STATIONS {
            return Err(KeyFileError::StationCount(stations));
        }
        let vehicle = fresh(0)?;
        let senders = (1..).take(stations).map(fresh);
        let senders = senders.collect::<Result<Vec<_>, _>>()?;
        Self::checked(vehicle, senders, Exceptions::default())
    }
}

fn fresh(id: u32) -> Result<SenderKeys, KeyFileError> {
    let mut key = Zeroizing::new([0; 16]);
    getrandom::fill(&mut *key).map_err(KeyFileError::Random)?;
    let mut salt = [0; 4];
    getrandom::fill(&mut salt).map_err(KeyFileError::Random)?;
    Ok(SenderKeys {
        id,
        key,
        salt: u32::from_be_bytes(salt),
    })
}
