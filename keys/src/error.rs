//! What can be wrong with a key file. No text here shows what is in it, except ids and names.

use std::{io, path::PathBuf};

use crate::field::MAX_STATIONS;

/// Why a key file is not used, or not written. Its author, or the one who chose it, is at fault.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeyFileError {
    /// The file cannot be read or written.
    #[error("{path}: {error}", path = path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Why. No [`source`](std::error::Error::source): whoever prints those too would say it twice.
        error: io::Error,
    },
    /// Group or others have access to the file. Whoever may have read it has the keys: make new ones then.
    #[error("{path}: mode {mode:04o} lets others than its owner in: `chmod 600` mends it", path = path.display())]
    Exposed {
        /// Which file.
        path: PathBuf,
        /// Its permissions, the last 12 bits of its mode.
        mode: u32,
    },
    /// What is wrong with the content of a file that was read.
    #[error("{path}: {fault}", path = path.display())]
    Content {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        fault: Box<KeyFileError>,
    },
    /// TOML is not written to a name that is read as Keys.mk.
    #[error("a file whose name ends in .mk is read as SMACCMPilot's Keys.mk: choose another name")]
    NameOfKeysMk,
    /// Not the shape of a key file.
    #[error("line {line}: {what}")]
    Syntax {
        /// Which line, from 1.
        line: usize,
        /// What is wrong with it.
        what: String,
    },
    /// A variable of Keys.mk is missing.
    #[error("{0} is missing")]
    Missing(&'static str),
    /// A header that this version does not know.
    #[error("the header is neither `id-counter` nor `counter-epoch-id`")]
    UnknownHeader,
    /// An id that the file's header has no room for.
    #[error("id {0} is too large for the header `{1}`")]
    IdTooLarge(u32, &'static str),
    /// A key is not 16 bytes.
    #[error("the key of sender {0} is not 16 bytes, as 32 hexadecimal digits")]
    BadKey(u32),
    /// A key of zeros only.
    #[error("the key of sender {0} is all zeros")]
    AllZero(u32),
    /// A key of 0xFF only: erased flash.
    #[error("the key of sender {0} is all ones: erased flash")]
    Erased(u32),
    /// A key that anybody can look up.
    #[error("the key of sender {0} is a published example: make fresh ones")]
    Published(u32),
    /// Two senders with one id.
    #[error("id {0} is given twice")]
    DuplicateId(u32),
    /// A vehicle and a station with one key: each would accept the other's packages as its own.
    #[error("the vehicle and station {0} have the same key")]
    VehicleKeyShared(u32),
    /// Two stations with one key: each could speak as the other.
    #[error("stations {0} and {1} have the same key")]
    StationKeyShared(u32, u32),
    /// No station, or more than are sensible.
    #[error("{0} stations: 1 to {MAX_STATIONS} are possible")]
    StationCount(usize),
    /// There is no such station.
    #[error("there is no station {0}")]
    NoStation(u32),
    /// The operating system gives no random bytes.
    #[error("no random bytes: {0}")]
    Random(getrandom::Error),
}
