//! Authentic frames in an order, and at times, that matter.

use anyhow::Result;
use mavlink_signing::{TICKS_PER_SECOND, Timestamp};

use super::{A, B, Maker, Scenario, Sender, Step};

const SECOND: i64 = TICKS_PER_SECOND as i64;

/// A frame to make: of whom, how far ahead of the beginning it is stamped, when it comes, whether it
/// is to pass. Seconds are SECOND ticks.
type Plan = (Sender, i64, i64, bool);

/// Every stamp is one of the beginning, unless it says otherwise.
const PLANS: [(&str, &[Plan]); 13] = [
    ("the next one", &[(A, 0, 0, true), (A, 1, 0, true)]),
    ("an older one", &[(A, 0, 0, true), (A, -1, 0, false)]),
    (
        "another with the same stamp",
        &[(A, 0, 0, true), (A, 0, 0, false)],
    ),
    (
        "other links, systems and components with the same stamp",
        &[
            (A, 0, 0, true),
            ((2, 1, 1), 0, 0, true),
            ((1, 2, 1), 0, 0, true),
            ((1, 1, 2), 0, 0, true),
            (A, 0, 0, false),
        ],
    ),
    ("a new stream, 59 s behind", &[(A, -59 * SECOND, 0, true)]),
    ("a new stream, 61 s behind", &[(A, -61 * SECOND, 0, false)]),
    (
        "a second stream, 58 s behind the first",
        &[(A, 0, 0, true), (B, -58 * SECOND, 0, true)],
    ),
    ("30 s ahead", &[(A, 30 * SECOND, 0, true)]),
    // The second frame takes the receiver's clock along, where a frame can.
    (
        "a known stream, 88 s behind",
        &[
            (A, -59 * SECOND, 0, true),
            (B, 30 * SECOND, 30 * SECOND, true),
            (A, -58 * SECOND, 30 * SECOND, false),
        ],
    ),
    ("2 minutes ahead", &[(A, 120 * SECOND, 0, false)]),
    (
        "one 2 minutes ahead, then the same stream",
        &[(A, 120 * SECOND, 0, false), (A, 0, 0, true)],
    ),
    (
        "one 2 minutes ahead, then another stream",
        &[(A, 120 * SECOND, 0, false), (B, 0, 0, true)],
    ),
    (
        "one stamped years ahead",
        &[(A, 1 << 46, 0, false), (B, 0, 0, true)],
    ),
];

pub(super) fn scenarios(maker: &mut Maker) -> Result<Vec<Scenario>> {
    let mut scenarios = Vec::new();
    for (name, plans) in PLANS {
        let mut steps = Vec::new();
        for &(sender, ahead, after, passes) in plans {
            steps.push(Step {
                frame: maker.signed(sender, ahead)?,
                after: after.unsigned_abs(),
                passes,
            });
        }
        scenarios.push(Scenario { name, steps });
    }

    let frame = maker.signed(A, 0)?;
    let twice = [(frame.clone(), true), (frame, false)];
    scenarios.push(in_order("the same again", twice));

    let last = Timestamp::MAX.ticks() - maker.now;
    let last = maker.signed(A, last.try_into()?)?;
    scenarios.push(in_order("the last stamp of all", [(last, false)]));

    let mut forged = maker.signed(A, 30 * SECOND)?;
    let tag = forged.len() - 1;
    forged[tag] ^= 1;
    let authentic = maker.signed(A, 0)?;
    let order = [(forged, false), (authentic, true)];
    scenarios.push(in_order(
        "a forged one 30 s ahead, then the same stream",
        order,
    ));
    Ok(scenarios)
}

fn in_order<const N: usize>(name: &'static str, frames: [(Vec<u8>, bool); N]) -> Scenario {
    let step = |(frame, passes)| Step {
        frame,
        after: 0,
        passes,
    };
    Scenario {
        name,
        steps: frames.into_iter().map(step).collect(),
    }
}
