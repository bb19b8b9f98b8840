//! Which packages of one sender have been accepted: the newest, and 64 counters behind it.

use crate::error::OpenError;
use crate::header::HeaderFormat;

/// How many counters behind the newest accepted one a package may still come: 64.
pub const REORDER_WINDOW: u32 = u64::BITS;

/// How many counters of a sender may be passed over in all, from one start of the receiver to the next: 2^26.
///
/// Counters are passed over where packages are lost, and where a sender starts again: its mark is ahead. Whoever has
/// a sender's key can pass over more on purpose, up to the last counter, after which the sender is never heard again.
/// This bound is what he can take away per start, of 2^32. With [`EpochHeader`](crate::EpochHeader) a new epoch counts
/// as 2^16: 1,024 starts of a sender may go unheard.
///
/// Honest packages reach it after 13 days in which none is heard at 57,600 baud, which carry 58 a second. The receiver
/// must then be started again. With a clock there is no such bound:
/// [`Opener::open_between`](crate::Opener::open_between).
pub const MAX_PASSED_OVER: u32 = 1 << 26;

/// What is remembered of the packages of one sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Seen<P> {
    /// The newest accepted; before the first, what everything is rejected up to.
    pub(crate) newest: P,
    /// Of the counters behind it, in its epoch, which are rejected. Bit 0 is the one directly behind.
    pub(crate) behind: u64,
    /// How many counters were passed over.
    pub(crate) passed_over: u32,
}

impl<P: Copy + Ord> Seen<P> {
    /// Everything up to `newest` is rejected.
    pub(crate) const fn up_to(newest: P) -> Self {
        Self {
            newest,
            behind: u64::MAX,
            passed_over: 0,
        }
    }

    /// Whether the package with this header may still be accepted.
    pub(crate) fn is_fresh<H: HeaderFormat<Sequence = P>>(&self, header: H) -> bool {
        let sequence = header.sequence();
        let place = H::distance(sequence, self.newest).map_or(0, bit);
        sequence > self.newest || place & !self.behind != 0
    }

    /// How many counters will have been passed over with it.
    ///
    /// # Errors
    ///
    /// [`OpenError::JumpTooFar`]: too many.
    pub(crate) fn pass_over<H: HeaderFormat<Sequence = P>>(
        &self,
        header: H,
    ) -> Result<u32, OpenError> {
        let jump = H::passed_over(self.newest, header.sequence());
        let sum = u64::from(self.passed_over).saturating_add(jump);
        u32::try_from(sum)
            .ok()
            .filter(|sum| *sum <= MAX_PASSED_OVER)
            .ok_or(OpenError::JumpTooFar(header.sender().into()))
    }

    /// The package with this header is accepted.
    pub(crate) fn record<H: HeaderFormat<Sequence = P>>(&mut self, header: H) {
        let sequence = header.sequence();
        if sequence > self.newest {
            self.behind = match H::distance(self.newest, sequence) {
                Some(distance) => self.behind.checked_shl(distance).unwrap_or(0) | bit(distance),
                // Of a new epoch none was accepted before.
                None => 0,
            };
            self.newest = sequence;
        } else {
            self.behind |= H::distance(sequence, self.newest).map_or(0, bit);
        }
    }
}

/// The bit of a counter so far behind the newest; none beyond the window.
fn bit(distance: u32) -> u64 {
    let place = distance.checked_sub(1);
    place
        .and_then(|place| 1_u64.checked_shl(place))
        .unwrap_or(0)
}
