//! Passes over frames, and what their time is.

use std::{
    hint::black_box,
    time::{Duration, Instant},
};

/// Whether frames can be kept apart on this processor.
pub const CAN_SEPARATE: bool = cfg!(target_arch = "x86_64");

/// The time of `count` calls, in passes over `inputs`.
///
/// `state` is made for each pass, outside of the time: a receiver that remembers frames takes those
/// of a pass once. With `SEPARATE` a call begins when the one before it has ended, as with frames
/// that come one at a time; without, the processor works at the end of one and the beginning of
/// the next together.
pub fn time<const SEPARATE: bool, State, Input, Output>(
    count: u64,
    inputs: &[Input],
    mut state: impl FnMut() -> State,
    mut call: impl FnMut(&mut State, &Input) -> Output,
) -> Duration {
    let mut spent = Duration::ZERO;
    let mut left = usize::try_from(count).unwrap_or(usize::MAX);
    while left > 0 {
        let pass = &inputs[..inputs.len().min(left)];
        left -= pass.len();
        let mut state = state();
        let start = Instant::now();
        for input in pass {
            if SEPARATE {
                separate();
            }
            black_box(call(&mut state, black_box(input)));
        }
        spent += start.elapsed();
        drop(state);
    }
    spent
}

/// Waits until every instruction before has been completed.
#[inline(always)]
fn separate() {
    #[cfg(target_arch = "x86_64")]
    #[expect(unsafe_code)]
    // SAFETY: LFENCE is SSE2, which every x86-64 processor has; it touches no memory.
    unsafe {
        core::arch::x86_64::_mm_lfence();
    }
}
