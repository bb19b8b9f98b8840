//! Equal news in a row as one.

use mavseal_relay::Direction;

use crate::info;

/// What was said last, and how often in a row.
///
/// A line takes longer than a frame: one for each rejection would let whoever repeats one of them stall
/// the other.
#[derive(Clone, Copy, Debug)]
pub struct Runs<T>(Option<(T, u32)>);

impl<T> Default for Runs<T> {
    fn default() -> Self {
        Self(None)
    }
}

impl<T: PartialEq> Runs<T> {
    /// Takes the next; gives the run that it ends.
    pub fn push(&mut self, next: T) -> Option<(T, u32)> {
        match &mut self.0 {
            Some((last, times)) if *last == next => {
                *times = times.saturating_add(1);
                None
            }
            _ => self.0.replace((next, 1)),
        }
    }

    /// The run so far, which ends with that.
    pub fn take(&mut self) -> Option<(T, u32)> {
        self.0.take()
    }
}

/// Logs rejections in a row, if there are any.
pub fn log_rejected(run: Option<((Direction, impl Into<&'static str>), u32)>) {
    if let Some(((direction, rejection), times)) = run {
        let reason: &str = rejection.into();
        info!("{} rejected: {}, {} times", direction, reason, times);
        let _ = (direction, reason, times);
    }
}
