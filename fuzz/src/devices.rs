//! Target about whole devices.

use arbitrary::Arbitrary;
use mavseal_proofs::adversary::{Step, play};

/// A history of three devices.
#[derive(Arbitrary, Clone, Debug)]
pub struct Devices {
    /// Who has a trusted clock: bit `n` for device `n`.
    pub synced: u8,
    /// What cuts leave in flash.
    pub chance: u64,
    /// What happens.
    pub steps: Vec<Step>,
}

/// Steps of a history at most, so that one takes milliseconds.
const STEPS: usize = 60;

/// An adversary with link, payloads, power, flash and old keys against three devices as the firmware builds them (D1 to
/// D6).
pub fn adversary(input: Devices) {
    let steps = &input.steps[..input.steps.len().min(STEPS)];
    let _ = play(steps, input.synced % 8, input.chance);
}
