//! Runs one harness with Kani and reads what it says.

use std::{path::Path, process::Command};

use anyhow::Result;
use serde::{Deserialize, Serialize};

use super::{
    process::{self, Ended, Limits, Stopped},
    scan::Harness,
};

/// Failures of these classes say that Kani did not get to the end, not that a property is wrong.
const NO_REFUTATION: [&str; 7] = [
    "unwind",
    "recursion",
    "unsupported_construct",
    "missing_definition",
    "reachability_check",
    "sanity_check",
    "cover",
];

/// The same by description, as the class of some depends on the version.
const NO_REFUTATION_TEXTS: [&str; 3] = [
    "unwinding assertion",
    "not currently supported by Kani",
    "missing definition",
];

/// How a harness ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Verdict {
    /// Every check holds and every cover is satisfied.
    Verified,
    /// A check of the property, or of Rust's own rules, fails.
    Refuted,
    /// Every check holds, but no cover, or not every one, is satisfied.
    Vacuous,
    /// More time than allowed.
    Timeout,
    /// More memory than allowed.
    Memory,
    /// No verdict: it does not compile, is unwound too little, or uses what Kani does not know.
    Error,
}

/// One run of one harness.
pub(crate) struct Run {
    pub(crate) verdict: Verdict,
    /// Why it is not verified, in one line.
    pub(crate) reason: Option<String>,
    pub(crate) report: Report,
    pub(crate) seconds: f64,
    pub(crate) memory_mb: Option<u64>,
}

/// What Kani's output says.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Report {
    /// The harnesses that were checked.
    harnesses: Vec<String>,
    /// `SUCCESSFUL` or `FAILED`, for each.
    verdicts: Vec<String>,
    /// Checks other than covers.
    pub(crate) checks: usize,
    failures: Vec<Check>,
    pub(crate) covers: usize,
    pub(crate) covers_satisfied: usize,
    /// What the summary says of both: satisfied, all.
    covers_summary: Option<(usize, usize)>,
    covers_missed: Vec<String>,
    /// `original -> replacement`
    pub(crate) stubs: Vec<String>,
    /// Kani's own time for the solver's part.
    pub(crate) seconds: Option<f64>,
    pub(crate) cbmc: Option<String>,
    /// The toolchain that Kani compiled with.
    pub(crate) rustc: Option<String>,
}

#[derive(Debug, Default, PartialEq)]
struct Check {
    class: String,
    status: String,
    description: String,
}

/// The version of the installed Kani, if there is one.
pub(crate) fn installed() -> Option<String> {
    let output = kani().arg("--version").output().ok()?;
    let said = String::from_utf8(output.stdout).ok()?;
    let version = said.trim().strip_prefix("cargo-kani ")?.to_owned();
    output.status.success().then_some(version)
}

/// Runs `harness` on the workspace in `tree`.
///
/// # Errors
/// If Kani cannot be started.
pub(crate) fn run(tree: &Path, target: &Path, harness: &Harness, limits: Limits) -> Result<Run> {
    let mut command = kani();
    command.current_dir(tree);
    command.args(["-p", &harness.package]);
    command.arg("--target-dir").arg(target);
    command.args(["--exact", "--harness", &harness.path]);
    let ended = process::run(&mut command, limits)?;
    let report = Report::read(&ended.stdout);
    let (verdict, reason) = judge(&report, &ended, &harness.path);
    Ok(Run {
        verdict,
        reason,
        report,
        seconds: ended.time.as_secs_f64(),
        memory_mb: ended.memory_mb,
    })
}

/// Paths of the harnesses that Kani itself sees in the package in `folder`; Kani leaves a file
/// there. `unstable` features have to be named: listing does not read them from the manifest.
///
/// # Errors
/// If Kani cannot list them.
pub(crate) fn list(folder: &Path, target: &Path, unstable: &[String]) -> Result<Vec<String>> {
    /// `kani-list.json`: harnesses by file.
    #[derive(Deserialize)]
    #[serde(rename_all = "kebab-case")]
    struct List {
        standard_harnesses: std::collections::BTreeMap<String, Vec<String>>,
    }
    let mut command = kani();
    command.current_dir(folder).env("CARGO_TARGET_DIR", target);
    command.args(["list", "--format", "json"]);
    for feature in unstable {
        command.args(["-Z", feature]);
    }
    let output = command.output()?;
    anyhow::ensure!(
        output.status.success(),
        "cargo kani list: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    let list = std::fs::read_to_string(folder.join("kani-list.json"))?;
    let list: List = serde_json::from_str(&list)?;
    Ok(list.standard_harnesses.into_values().flatten().collect())
}

/// `cargo kani`, free of what rustup's cargo sets for its own children: Kani has its own compiler.
fn kani() -> Command {
    let mut command = Command::new("cargo");
    command.arg("kani").env("NO_COLOR", "1");
    for name in ["CARGO", "RUSTUP_TOOLCHAIN", "RUSTC", "LD_LIBRARY_PATH"] {
        command.env_remove(name);
    }
    command
}

fn judge(report: &Report, ended: &Ended, path: &str) -> (Verdict, Option<String>) {
    let (verdict, reason) = match ended.stopped {
        Some(Stopped::Time) => (Verdict::Timeout, "it took too long".to_owned()),
        Some(Stopped::Memory) => (Verdict::Memory, "it took too much memory".to_owned()),
        None => match report.judge(path) {
            Ok(()) if ended.status.success() => return (Verdict::Verified, None),
            Ok(()) => (Verdict::Error, format!("it ended with {}", ended.status)),
            Err(Fault::NoVerdict) => return no_verdict(ended),
            Err(Fault::Reason(verdict, reason)) => (verdict, reason),
        },
    };
    (verdict, Some(reason))
}

fn no_verdict(ended: &Ended) -> (Verdict, Option<String>) {
    let lines = || ended.stderr.lines().chain(ended.stdout.lines());
    if lines().any(|line| line.contains("run out of memory")) {
        return (Verdict::Memory, Some("CBMC ran out of memory".to_owned()));
    }
    let said = |mark: &str| lines().find(|line| line.starts_with(mark));
    let reason = said("error[").or_else(|| said("error"));
    let reason = reason.or_else(|| said("CBMC failed"));
    let reason = reason.map_or_else(|| "no verdict".to_owned(), str::to_owned);
    (Verdict::Error, Some(reason))
}

enum Fault {
    /// No harness got as far as a list of checks.
    NoVerdict,
    Reason(Verdict, String),
}

impl Report {
    /// Reads the output of `cargo kani` in its regular format.
    fn read(output: &str) -> Self {
        let mut report = Self::default();
        let mut check = Check::default();
        for line in output.lines() {
            let trimmed = line.trim();
            if let Some((_, rest)) = line.split_once("/toolchains/")
                && report.rustc.is_none()
            {
                let name = rest.split('/').next().unwrap_or(rest);
                report.rustc = Some(without_host(name));
            }
            if let Some(rest) = line.strip_prefix("Checking harness ") {
                let path = rest.trim_end_matches("...").to_owned();
                report.harnesses.push(path);
            } else if let Some(rest) = trimmed.strip_prefix("- Stub: ") {
                report.stubs.push(rest.to_owned());
            } else if let Some(rest) = line.strip_prefix("CBMC version ") {
                report.cbmc = rest.split_whitespace().next().map(str::to_owned);
            } else if let Some(rest) = line.strip_prefix("Check ") {
                let name = rest.split_once(": ").map_or("", |(_, name)| name);
                let class = name.rsplit('.').nth(1).unwrap_or_default();
                check = Check {
                    class: class.to_owned(),
                    ..Check::default()
                };
            } else if let Some(status) = trimmed.strip_prefix("- Status: ") {
                status.clone_into(&mut check.status);
            } else if let Some(text) = trimmed.strip_prefix("- Description: ") {
                text.trim_matches('"').clone_into(&mut check.description);
                report.count(std::mem::take(&mut check));
            } else if let Some(rest) = trimmed.strip_prefix("** ")
                && let Some((counts, _)) = rest.split_once(" cover properties satisfied")
            {
                let counts = counts.split_once(" of ");
                report.covers_summary =
                    counts.and_then(|(n, of)| Some((n.parse().ok()?, of.parse().ok()?)));
            } else if let Some(rest) = line.strip_prefix("VERIFICATION:- ") {
                let verdict = rest.split_whitespace().next().unwrap_or_default();
                report.verdicts.push(verdict.to_owned());
            } else if let Some(rest) = line.strip_prefix("Verification Time: ") {
                report.seconds = rest.trim_end_matches('s').parse().ok();
            }
        }
        report
    }

    fn count(&mut self, check: Check) {
        if check.class == "cover" {
            self.covers += 1;
            if check.status == "SATISFIED" {
                self.covers_satisfied += 1;
            } else {
                let missed = format!("{} ({})", check.description, check.status.to_lowercase());
                self.covers_missed.push(missed);
            }
        } else {
            self.checks += 1;
            if !matches!(&*check.status, "SUCCESS" | "UNREACHABLE") {
                self.failures.push(check);
            }
        }
    }

    fn judge(&self, path: &str) -> Result<(), Fault> {
        let fault = |verdict, reason: &str| Err(Fault::Reason(verdict, reason.to_owned()));
        if self.harnesses != [path] {
            return match self.harnesses.as_slice() {
                [] => Err(Fault::NoVerdict),
                _ => fault(Verdict::Error, "Kani ran another harness"),
            };
        }
        match self.verdicts.as_slice() {
            [verdict] if verdict == "SUCCESSFUL" => {}
            [verdict] if verdict == "FAILED" => {
                let refuted = self.failures.iter().find(|check| check.refutes());
                return match (refuted, self.failures.first()) {
                    (Some(check), _) => fault(Verdict::Refuted, &check.description),
                    (None, Some(check)) => fault(Verdict::Error, &check.description),
                    (None, None) if self.checks > 0 => {
                        fault(Verdict::Refuted, "a panic was expected, there is none")
                    }
                    (None, None) => Err(Fault::NoVerdict),
                };
            }
            _ => return Err(Fault::NoVerdict),
        }
        if self.covers_summary.unwrap_or((0, 0)) != (self.covers_satisfied, self.covers) {
            fault(
                Verdict::Error,
                "Kani's list of covers and its summary differ",
            )
        } else if self.covers == 0 {
            fault(Verdict::Vacuous, "it has no cover")
        } else if !self.covers_missed.is_empty() {
            let missed = self.covers_missed.join(", ");
            fault(Verdict::Vacuous, &format!("not covered: {missed}"))
        } else {
            Ok(())
        }
    }
}

impl Check {
    /// Whether it is a counterexample.
    fn refutes(&self) -> bool {
        self.status == "FAILURE"
            && !NO_REFUTATION.contains(&&*self.class)
            && !NO_REFUTATION_TEXTS
                .iter()
                .any(|text| self.description.contains(text))
    }
}

/// `nightly-2025-11-21` of `nightly-2025-11-21-x86_64-unknown-linux-gnu`.
fn without_host(toolchain: &str) -> String {
    toolchain
        .splitn(5, '-')
        .take(4)
        .collect::<Vec<_>>()
        .join("-")
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATH: &str = "a::harness::v1_x";

    /// Output of Kani 0.67 with these checks: name, status, description.
    fn output(checks: &[(&str, &str, &str)], verdict: &str) -> String {
        let mut text = format!(
            "Kani Rust Verifier 0.67.0 (cargo plugin)\nChecking harness {PATH}...\n\
             \t- Stub: a::b -> c::d\nCBMC version 6.8.0 (cbmc-6.8.0) 64-bit x86_64 linux\n\nRESULTS:\n"
        );
        for (i, (name, status, description)) in checks.iter().enumerate() {
            text += &format!(
                "Check {}: {name}\n\t - Status: {status}\n\t - Description: \"{description}\"\n\
                 \t - Location: ../x/.rustup/toolchains/nightly-2025-11-21-x86_64-unknown-linux-gnu/lib:1:2\n\n",
                i + 1
            );
        }
        let covers = |status: Option<&str>| {
            let all = checks.iter().filter(|(name, ..)| name.contains(".cover."));
            all.filter(|(_, is, _)| status.is_none_or(|status| *is == status))
                .count()
        };
        text += "\nSUMMARY:\n ** 0 of 1 failed\n";
        if covers(None) > 0 {
            let (n, of) = (covers(Some("SATISFIED")), covers(None));
            text += &format!("\n ** {n} of {of} cover properties satisfied (1 unreachable)\n\n");
        }
        text + &format!("\nVERIFICATION:- {verdict}\nVerification Time: 1.25s\n")
    }

    fn verdict(checks: &[(&str, &str, &str)], verdict: &str) -> (Verdict, String) {
        match Report::read(&output(checks, verdict)).judge(PATH) {
            Ok(()) => (Verdict::Verified, String::new()),
            Err(Fault::Reason(verdict, reason)) => (verdict, reason),
            Err(Fault::NoVerdict) => (Verdict::Error, "no verdict".to_owned()),
        }
    }

    const HOLDS: (&str, &str, &str) = ("a::f.assertion.1", "SUCCESS", "assertion failed: x");
    const COVERED: (&str, &str, &str) = ("a::harness::v1_x.cover.1", "SATISFIED", "accepted");

    #[test]
    fn all_that_a_report_says() {
        let report = Report::read(&output(&[HOLDS, COVERED], "SUCCESSFUL"));
        assert_eq!(report.stubs, ["a::b -> c::d"]);
        assert_eq!(
            (report.checks, report.covers, report.covers_satisfied),
            (1, 1, 1)
        );
        assert_eq!(report.seconds, Some(1.25));
        assert_eq!(report.cbmc.as_deref(), Some("6.8.0"));
        assert_eq!(report.rustc.as_deref(), Some("nightly-2025-11-21"));
    }

    #[test]
    fn success_needs_every_cover() {
        assert_eq!(
            verdict(&[HOLDS, COVERED], "SUCCESSFUL").0,
            Verdict::Verified
        );
        assert_eq!(verdict(&[HOLDS], "SUCCESSFUL").0, Verdict::Vacuous);
        for status in ["UNSATISFIABLE", "UNREACHABLE", "UNDETERMINED"] {
            let missed = ("a::harness::v1_x.cover.2", status, "replayed");
            let (verdict, reason) = verdict(&[HOLDS, COVERED, missed], "SUCCESSFUL");
            assert_eq!(verdict, Verdict::Vacuous);
            let expected = format!("not covered: replayed ({})", status.to_lowercase());
            assert_eq!(reason, expected);
        }
    }

    #[test]
    fn only_a_counterexample_refutes() {
        let failed = |name, text| verdict(&[(name, "FAILURE", text), COVERED], "FAILED").0;
        assert_eq!(
            failed("a::f.assertion.1", "assertion failed: x"),
            Verdict::Refuted
        );
        assert_eq!(
            failed("a::f.pointer_dereference.1", "invalid"),
            Verdict::Refuted
        );
        assert_eq!(
            failed("a::f.unwind.0", "unwinding assertion loop 0"),
            Verdict::Error
        );
        assert_eq!(
            failed(
                "a::f.unsupported_construct.1",
                "x is not currently supported by Kani"
            ),
            Verdict::Error
        );
        let missing = "Function `x` with missing definition is unreachable";
        assert_eq!(failed("a::f.assertion.2", missing), Verdict::Error);
        let undetermined = ("a::f.assertion.3", "UNDETERMINED", "assertion failed: x");
        assert_eq!(verdict(&[undetermined], "FAILED").0, Verdict::Error);
    }

    #[test]
    fn another_harness_or_none_is_no_verdict() {
        let other = output(&[HOLDS, COVERED], "SUCCESSFUL").replace(PATH, "a::other");
        assert!(Report::read(&other).judge(PATH).is_err());
        assert!(
            Report::read("error: no harnesses matched")
                .judge(PATH)
                .is_err()
        );
        assert!(
            Report::read(&format!("Checking harness {PATH}...\n"))
                .judge(PATH)
                .is_err()
        );
    }
}
