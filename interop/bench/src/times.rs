//! Measured times: criterion's samples of every round, and pymavlink's.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use serde_json::Value;

/// What the name of a round's samples begins with.
pub(crate) const ROUND: &str = "round-";
/// Of this part of the samples the slowest counts: few were disturbed then, and none was lucky.
const PART: f64 = 0.1;

/// How frames follow each other: criterion's groups, that to which the bars are held first.
pub(crate) const MODES: [&str; 2] = ["one at a time", "back to back"];

/// Nanoseconds a frame, by criterion's full name: mode, who does what, bytes of payload.
pub(crate) struct Times(BTreeMap<String, f64>);

impl Times {
    /// Those below `folder`, which criterion has written, and those of pymavlink's rounds.
    pub(crate) fn read(folder: &Path, asked: &[Value]) -> Result<Self> {
        let mut samples: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for round in rounds(folder)? {
            let [benchmark, sample] =
                ["benchmark.json", "sample.json"].map(|file| json(&round.join(file)));
            let (benchmark, sample) = (benchmark?, sample?);
            let name = benchmark["full_id"].as_str().context("a name")?;
            let numbers = |of: &str| sample[of].as_array().context("samples");
            let each = numbers("times")?.iter().zip(numbers("iters")?);
            let each = each.filter_map(|(time, count)| Some(time.as_f64()? / count.as_f64()?));
            samples.entry(name.to_owned()).or_default().extend(each);
        }
        let mut times = Self(BTreeMap::new());
        for (name, mut samples) in samples {
            samples.sort_by(f64::total_cmp);
            let at = (samples.len() as f64 * PART) as usize;
            times.0.insert(name, samples[at]);
        }
        for round in asked {
            for (what, time) in round["times"].as_object().context("times")? {
                let time = time.as_f64().context("a time")?;
                let least = times.0.entry(format!("pymavlink {what}")).or_insert(time);
                *least = least.min(time);
            }
        }
        Ok(times)
    }

    pub(crate) fn has(&self, mode: &str) -> bool {
        self.0.contains_key(&format!("{mode}/nothing"))
    }

    /// The mode that the bars are held to: not every processor can keep frames apart.
    pub(crate) fn strictest(&self) -> &'static str {
        if self.has(MODES[0]) {
            MODES[0]
        } else {
            MODES[1]
        }
    }

    /// The time of `what`, such as `mavlink verify/9`, less that of passing over frames and doing nothing.
    pub(crate) fn get(&self, mode: &str, what: &str) -> Result<f64> {
        if what.starts_with("pymavlink ") {
            return self.0.get(what).copied().with_context(|| what.to_owned());
        }
        Ok(self.measured(mode, what)? - self.measured(mode, "nothing")?)
    }

    /// The floor of `profile`: its compressions and the fastest checksum, each alone, added up.
    pub(crate) fn floor(&self, mode: &str, profile: &str, size: usize) -> Result<f64> {
        let compressions = self.get(mode, &format!("compressions {profile}/{size}"))?;
        let (_, checksum) = self.fastest_checksum(mode, size)?;
        Ok(compressions + checksum - self.measured(mode, "nothing")?)
    }

    /// The checksum that is the fastest for payloads with `size` bytes: its name and the time.
    pub(crate) fn fastest_checksum(&self, mode: &str, size: usize) -> Result<(&str, f64)> {
        let (start, end) = (format!("{mode}/checksum: "), format!("/{size}"));
        let checksums = self.0.iter().filter_map(|(name, time)| {
            let name = name.strip_prefix(&start)?.strip_suffix(&end)?;
            Some((name, *time))
        });
        let fastest = checksums.min_by(|(_, a), (_, b)| a.total_cmp(b));
        fastest.with_context(|| format!("no checksum, {size}"))
    }

    fn measured(&self, mode: &str, what: &str) -> Result<f64> {
        let time = self.0.get(&format!("{mode}/{what}")).copied();
        time.with_context(|| format!("{mode}, {what}: not measured"))
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

fn json(path: &Path) -> Result<Value> {
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    serde_json::from_str(&text).with_context(|| path.display().to_string())
}
