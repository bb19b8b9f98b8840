//! `cargo xtask fuzz speed`: a target against one that does nothing.

use std::{fs, time::Duration};

use anyhow::{Context, Result, ensure};

use super::{
    Fuzzer,
    engine::Session,
    plan::EMPTY,
    results::{Results, Run, Speed},
    table::{self, grouped},
};

/// The target that is measured.
const TARGET: &str = "verify_repaired";
/// What part of the empty target's speed it must have.
const BAR: f64 = 0.25;
/// Runs of each, by turns; the best of each counts.
const ROUNDS: usize = 4;
const TIME: Duration = Duration::from_secs(5);

/// Measures both with the same options, seeds and lengths.
///
/// # Errors
/// If the target is slower than it must be.
pub(super) fn speed(fuzzer: &Fuzzer) -> Result<()> {
    let target = fuzzer.targets.iter().find(|target| target.name == TARGET);
    let target = target.context("only with this target: verify_repaired")?;
    let scratch = fuzzer.target_dir.join("speed");
    let measure = |name: &str| {
        if scratch.is_dir() {
            fs::remove_dir_all(&scratch)?;
        }
        let mut corpus = vec![scratch.clone()];
        corpus.extend(fuzzer.engine.seeds(target));
        // Seeds that reach nothing new are kept and changed too, so that lengths are alike.
        let options = ["-keep_seed=1", "-len_control=0"]
            .map(str::to_owned)
            .to_vec();
        let session = Session {
            corpus,
            time: TIME,
            options,
        };
        let per_second = fuzzer.engine.speed(name, target.max_len, &session)?;
        anyhow::Ok(per_second as u64)
    };
    let (mut per_second, mut empty_per_second) = (0, 0);
    for _ in 0..ROUNDS {
        per_second = per_second.max(measure(TARGET)?);
        empty_per_second = empty_per_second.max(measure(EMPTY)?);
    }
    let speed = Speed {
        target: TARGET.to_owned(),
        per_second,
        empty_per_second,
    };
    let ratio = speed.ratio();
    let (of, empty) = (grouped(per_second), grouped(empty_per_second));
    println!("{TARGET}: {of} a second, {EMPTY}: {empty} a second, ratio {ratio:.2}");
    let run = Run::new(&fuzzer.root, fuzzer.cargo_fuzz.rustc()?, speed)?;
    Results::change(&fuzzer.root, |results| results.speed = Some(run))?;
    table::write(&fuzzer.root)?;
    ensure!(
        ratio >= BAR,
        "{TARGET} must have {BAR} of the speed of {EMPTY}"
    );
    Ok(())
}
