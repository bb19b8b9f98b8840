//! `cargo xtask fuzz coverage`: which lines of the cores seeds and corpora reach, and which errors.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, ensure};

use super::{
    plan,
    replay::{ReplayGuard, succeed},
    results::{Coverage, Lines, Results, Run},
    scan, table,
};
use crate::setup::{llvm_tools, root, rustc_in_use, target_dir};

/// What is measured, and the share of its lines that must be reached.
const FOLDERS: [(&str, f64); 4] = [
    ("mavlink/src", 0.95),
    ("commsec/src", 0.95),
    ("store/src", 0.0),
    ("relay/src", 0.0),
];

/// How often each line of a file was run.
type Counts = BTreeMap<String, BTreeMap<usize, u64>>;

/// Runs every target over its files, instrumented and without an engine, and keeps what that reached.
///
/// # Errors
/// If a target fails on a file, or less is reached than must be.
pub(super) fn coverage() -> Result<()> {
    let root = fs::canonicalize(root())?;
    let work = Instrumented::build(&root)?;
    let mut outcome = Coverage::default();
    let mut errors = BTreeSet::new();
    let mut profiles = Vec::new();
    for target in plan::targets(&root)? {
        let (profile, reached) = work.run(&target.name)?;
        let lines = work.count(std::slice::from_ref(&profile))?;
        let sum = FOLDERS.iter().map(|(folder, _)| Lines::of(&lines, folder));
        let sum = sum.fold(Lines::default(), |all, lines| all + lines);
        println!("{}: {sum}", target.name);
        outcome.targets.insert(target.name, sum);
        profiles.push(profile);
        errors.extend(reached);
    }
    let together = work.count(&profiles)?;
    let variants = scan::error_variants(&root, &FOLDERS.map(|(folder, _)| folder))?;
    outcome.missed = missed(&together);
    outcome.errors = variants.len();
    outcome.errors_missed = variants.difference(&errors).cloned().collect();
    let mut faults = Vec::new();
    for (folder, bar) in FOLDERS {
        let lines = Lines::of(&together, folder);
        println!("{folder}, all targets: {lines}");
        if lines.share() < bar {
            faults.push(format!("{lines} of {folder}, not {} %", 100.0 * bar));
        }
        outcome.folders.insert(folder.to_owned(), lines);
    }
    println!("not reached: {}", list(&outcome.missed));
    println!(
        "of {} errors, not reached: {}",
        outcome.errors,
        list(&outcome.errors_missed)
    );
    if !outcome.errors_missed.is_empty() {
        faults.push("not every error".to_owned());
    }
    let run = Run::new(&root, rustc_in_use()?, outcome)?;
    Results::change(&root, |results| results.coverage = Some(run))?;
    table::write(&root)?;
    ensure!(faults.is_empty(), "reached: {}", faults.join("; "));
    Ok(())
}

fn list(names: &[String]) -> String {
    if names.is_empty() {
        return "none".to_owned();
    }
    names.join(", ")
}

/// The targets without an engine, instrumented.
struct Instrumented {
    root: PathBuf,
    folder: PathBuf,
    replay: ReplayGuard,
    tools: PathBuf,
}

impl Instrumented {
    fn build(root: &Path) -> Result<Self> {
        let tools = llvm_tools()?;
        let folder = target_dir()?.join("fuzz/coverage");
        Ok(Self {
            root: root.to_owned(),
            replay: ReplayGuard::build(root, &folder, "-Cinstrument-coverage")?,
            folder,
            tools,
        })
    }

    /// Runs a target over all its files: where the counts are, and which errors came out.
    fn run(&self, target: &str) -> Result<(PathBuf, Vec<String>)> {
        let profile = self.folder.join(target).with_extension("profraw");
        let mut replay = self.replay.command(target, &["seeds", "found", "corpus"]);
        let errors = succeed(replay.env("LLVM_PROFILE_FILE", &profile))?;
        Ok((profile, errors.lines().map(str::to_owned).collect()))
    }

    /// How often all those runs together ran each line of the cores.
    fn count(&self, profiles: &[PathBuf]) -> Result<Counts> {
        let merged = self.folder.join("merged.profdata");
        let mut profdata = Command::new(self.tools.join("llvm-profdata"));
        profdata
            .args(["merge", "-sparse", "-o"])
            .arg(&merged)
            .args(profiles);
        succeed(&mut profdata)?;
        let mut cov = Command::new(self.tools.join("llvm-cov"));
        cov.args(["export", "-format=lcov", "-instr-profile"])
            .arg(&merged)
            .arg(&self.replay.program);
        let mut counts = parse(&succeed(&mut cov)?, &self.root);
        for (file, lines) in &mut counts {
            let text = fs::read_to_string(self.root.join(file)).context(file.clone())?;
            let without = scan::not_counted(file, &text);
            lines.retain(|line, _| !without.contains(line));
        }
        Ok(counts)
    }
}

/// Reads the lines of [`FOLDERS`] from what `llvm-cov` exports.
fn parse(lcov: &str, root: &Path) -> Counts {
    let mut counts = Counts::new();
    let mut file = None;
    for line in lcov.lines() {
        if let Some(path) = line.strip_prefix("SF:") {
            let path = Path::new(path).strip_prefix(root).ok();
            let path = path.map(|path| path.display().to_string());
            file = path.filter(|path| FOLDERS.iter().any(|(folder, _)| path.starts_with(folder)));
        } else if let (Some(file), Some(data)) = (&file, line.strip_prefix("DA:"))
            && let Some((number, count)) = data.split_once(',')
            && let (Ok(number), Ok(count)) = (number.parse(), count.parse())
        {
            counts
                .entry(file.clone())
                .or_default()
                .insert(number, count);
        }
    }
    counts
}

/// The lines that nothing ran: `file:3-5,9`.
fn missed(counts: &Counts) -> Vec<String> {
    let mut missed = Vec::new();
    for (file, lines) in counts {
        let mut ranges: Vec<(usize, usize)> = Vec::new();
        for (line, _) in lines.iter().filter(|(_, count)| **count == 0) {
            match ranges.last_mut() {
                Some((_, last)) if *last + 1 == *line => *last = *line,
                _ => ranges.push((*line, *line)),
            }
        }
        let ranges = ranges.into_iter().map(|(first, last)| match last {
            last if last == first => first.to_string(),
            last => format!("{first}-{last}"),
        });
        let ranges = ranges.collect::<Vec<_>>().join(",");
        if !ranges.is_empty() {
            missed.push(format!("`{file}:{ranges}`"));
        }
    }
    missed
}

impl Lines {
    fn of(counts: &Counts, folder: &str) -> Self {
        let files = counts.iter().filter(|(file, _)| file.starts_with(folder));
        let lines: Vec<_> = files.flat_map(|(_, lines)| lines.values()).collect();
        Self {
            reached: lines.iter().filter(|count| ***count > 0).count(),
            of: lines.len(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_the_cores() {
        let lcov = "SF:/p/mavlink/src/a.rs\nFN:1,x\nDA:1,3\nDA:2,0\nDA:3,0\nDA:5,0\nend_of_record\n\
            SF:/p/proofs/src/b.rs\nDA:1,0\nend_of_record\n";
        let counts = parse(lcov, Path::new("/p"));
        assert_eq!(missed(&counts), ["`mavlink/src/a.rs:2-3,5`"]);
        let lines = Lines::of(&counts, "mavlink/src");
        assert_eq!((lines.reached, lines.of), (1, 4));
    }
}
