#![doc = include_str!("../README.md")]

mod error;
mod file;
mod generate;
mod rust_source;

pub use error::KeyFileError;
pub use file::{Exceptions, HeaderKind, KeyFile, MAX_STATIONS, SenderKeys};
pub use rust_source::Role;
