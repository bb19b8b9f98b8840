//! Log lines that cost nothing when the feature `logging` is off.

/// Logs what the firmware did.
#[macro_export]
macro_rules! info {
    ($($argument:tt)*) => {{
        #[cfg(feature = "logging")]
        $crate::defmt::info!($($argument)*);
    }};
}

/// Logs what somebody should look at.
#[macro_export]
macro_rules! warn {
    ($($argument:tt)*) => {{
        #[cfg(feature = "logging")]
        $crate::defmt::warn!($($argument)*);
    }};
}
