#![doc = include_str!("../README.md")]

mod constants;
mod error;
mod file;
mod make;

pub use constants::Who;
pub use error::KeyFileError;
pub use file::{Exceptions, KeyFile, MAX_STATIONS, Sender};
