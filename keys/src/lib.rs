#![doc = include_str!("../README.md")]

mod error;
mod field;
mod file;
mod generate;
mod rust_source;

pub use error::KeyFileError;
pub use field::MAX_STATIONS;
pub use file::{Exceptions, HeaderKind, KeyFile, SenderKeys};
pub use rust_source::Role;
