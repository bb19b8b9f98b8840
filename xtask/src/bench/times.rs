//! Measured times: criterion's samples of every round, and pymavlink's.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use serde::Deserialize;

/// What the name of a round's samples begins with.
pub(super) const ROUND: &str = "round-";

/// Of this part of the samples the slowest counts: few were disturbed then, and none was lucky.
const PART: f64 = 0.1;

/// How frames follow each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Mode {
    OneAtATime,
    BackToBack,
}

impl Mode {
    pub(super) const ALL: [Self; 2] = [Self::OneAtATime, Self::BackToBack];

    /// The group of criterion's that it is.
    const fn group(self) -> &'static str {
        match self {
            Self::OneAtATime => "one at a time",
            Self::BackToBack => "back to back",
        }
    }

    pub(super) const fn describe(self) -> &'static str {
        match self {
            Self::OneAtATime => {
                "One at a time: a frame is begun when the one before is done. ns (times the floor)"
            }
            Self::BackToBack => {
                "Back to back: the processor overlaps a frame with the next. ns (times the floor)"
            }
        }
    }
}

/// What `interop/python/bench.py` says: nanoseconds a frame by operation and payload.
#[derive(Deserialize)]
pub(super) struct Pymavlink {
    pub(super) pymavlink: String,
    pub(super) python: String,
    times: BTreeMap<String, f64>,
}

/// Nanoseconds a frame, by who does what, and the bytes of payload.
pub(super) struct Times {
    rust: BTreeMap<(String, String, usize), f64>,
    python: BTreeMap<String, f64>,
}

/// Criterion's `benchmark.json`.
#[derive(Deserialize)]
struct Benchmark {
    group_id: String,
    function_id: String,
    value_str: Option<String>,
}

/// Criterion's `sample.json`.
#[derive(Deserialize)]
struct Sample {
    iters: Vec<f64>,
    times: Vec<f64>,
}

impl Times {
    /// Those below `folder`, which criterion has written, and those of pymavlink's rounds.
    pub(super) fn read(folder: &Path, asked: &[Pymavlink]) -> Result<Self> {
        let mut samples: BTreeMap<_, Vec<f64>> = BTreeMap::new();
        for round in rounds(folder)? {
            let benchmark: Benchmark = json(&round.join("benchmark.json"))?;
            let sample: Sample = json(&round.join("sample.json"))?;
            let size = match benchmark.value_str {
                Some(size) => size.parse()?,
                None => 0,
            };
            let key = (benchmark.group_id, benchmark.function_id, size);
            let each = sample.times.iter().zip(&sample.iters);
            samples
                .entry(key)
                .or_default()
                .extend(each.map(|(time, count)| time / count));
        }
        let rust = samples.into_iter().map(|(key, mut samples)| {
            samples.sort_by(f64::total_cmp);
            let at = (samples.len() as f64 * PART) as usize;
            (key, samples[at])
        });
        let mut python = BTreeMap::new();
        for (what, time) in asked.iter().flat_map(|asked| &asked.times) {
            let least = python.entry(what.clone()).or_insert(*time);
            *least = least.min(*time);
        }
        Ok(Self {
            rust: rust.collect(),
            python,
        })
    }

    pub(super) fn has(&self, mode: Mode) -> bool {
        self.measured(mode, "nothing", 0).is_ok()
    }

    /// What the bars are held to: not every processor can keep frames apart.
    pub(super) fn strictest(&self) -> Mode {
        if self.has(Mode::OneAtATime) {
            Mode::OneAtATime
        } else {
            Mode::BackToBack
        }
    }

    /// The time of `what`, such as `mavlink verify`, less that of passing over frames and doing nothing.
    pub(super) fn get(&self, mode: Mode, what: &str, size: usize) -> Result<f64> {
        if let Some(operation) = what.strip_prefix("pymavlink ") {
            let time = self.python.get(&format!("{operation}/{size}"));
            return time.copied().with_context(|| format!("{what}, {size}"));
        }
        Ok(self.measured(mode, what, size)? - self.measured(mode, "nothing", 0)?)
    }

    /// The floor of `profile`: its compressions and the fastest checksum, each alone, added up.
    pub(super) fn floor(&self, mode: Mode, profile: &str, size: usize) -> Result<f64> {
        let compressions = self.get(mode, &format!("compressions {profile}"), size)?;
        let (_, checksum) = self.fastest_checksum(mode, size)?;
        Ok(compressions + checksum - self.measured(mode, "nothing", 0)?)
    }

    /// The checksum that is the fastest for payloads with `size` bytes: its name and the time.
    pub(super) fn fastest_checksum(&self, mode: Mode, size: usize) -> Result<(&str, f64)> {
        let checksums = self.rust.iter().filter_map(|((group, what, of), time)| {
            let name = what.strip_prefix("checksum: ")?;
            (group == mode.group() && *of == size).then_some((name, *time))
        });
        let fastest = checksums.min_by(|(_, a), (_, b)| a.total_cmp(b));
        fastest.with_context(|| format!("no checksum, {size}"))
    }

    fn measured(&self, mode: Mode, what: &str, size: usize) -> Result<f64> {
        let key = (mode.group().to_owned(), what.to_owned(), size);
        let time = self.rust.get(&key).copied();
        time.with_context(|| format!("{what}, {size} was not measured"))
    }
}

/// The folders with the samples of a round.
fn rounds(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if !path.is_dir() {
            continue;
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with(ROUND) {
            found.push(path);
        } else {
            found.extend(rounds(&path)?);
        }
    }
    Ok(found)
}

fn json<T: for<'a> Deserialize<'a>>(path: &Path) -> Result<T> {
    let text = fs::read(path).with_context(|| path.display().to_string())?;
    serde_json::from_slice(&text).with_context(|| path.display().to_string())
}
