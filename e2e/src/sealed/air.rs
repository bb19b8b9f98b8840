//! The air between vehicle and stations, simulated: what is lost, doubled and reordered.

use rand::{Rng, RngExt, SeedableRng, rngs::SmallRng};

use crate::scenario::InAir;

/// Of 100 packages: how many are lost, come twice, and come late.
const LOST: u32 = 15;
const DOUBLED: u32 = 10;
const LATE: u32 = 15;
/// How many packages overtake a late one at most.
const OVERTAKEN: usize = 4;

/// The way from one sender to one receiver.
pub(super) struct Air(SmallRng);

impl Air {
    pub(super) fn new(seed: u64, way: u64) -> Self {
        // As far apart as the ways are many.
        Self(SmallRng::seed_from_u64(seed ^ (way << 56)))
    }

    fn happens(&mut self, of_100: u32) -> bool {
        self.0.random_range(0..100) < of_100
    }

    /// Lets `packages` through, one after the other; gives those that arrive, in the order of arrival.
    pub(super) fn carry<T: Clone>(&mut self, packages: &[T]) -> (Vec<T>, InAir) {
        let (mut lost, mut doubled) = (0, 0);
        let mut slots = Vec::new();
        for (at, package) in packages.iter().enumerate() {
            if self.happens(LOST) {
                lost += 1;
                continue;
            }
            let late = self.happens(LATE);
            let slot = at + usize::from(late) * self.0.random_range(1..=OVERTAKEN);
            slots.push((slot, package.clone()));
            if self.happens(DOUBLED) {
                doubled += 1;
                let slot = slot + self.0.random_range(0..=OVERTAKEN);
                slots.push((slot, package.clone()));
            }
        }
        // Stable: what has the same slot stays in order.
        slots.sort_by_key(|(slot, _)| *slot);
        let arrived = slots.into_iter().map(|(_, package)| package).collect();
        let sent = packages.len();
        (
            arrived,
            InAir {
                sent,
                lost,
                doubled,
            },
        )
    }

    /// One of `0..below`.
    pub(super) fn any(&mut self, below: usize) -> usize {
        self.0.random_range(0..below)
    }

    /// 16 bytes that are nobody's key.
    pub(super) fn strange_key(&mut self) -> [u8; 16] {
        let mut key = [0; 16];
        self.0.fill_bytes(&mut key);
        key
    }
}
