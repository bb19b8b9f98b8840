#![doc = include_str!("../README.md")]

mod constants;
mod error;
mod file;
mod make;

pub use constants::Who;
pub use error::KeyFileError;
pub use file::{Exceptions, Header, KeyFile, MAX_STATIONS, Sender};
