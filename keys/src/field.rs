//! Sizes of a key file.

/// Most stations in a file.
pub const MAX_STATIONS: usize = 64;
