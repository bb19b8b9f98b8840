//! Runs harnesses with Kani and reads what it prints.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    path::Path,
    process::{Command, Stdio},
    thread,
    time::Duration,
};

use anyhow::{Result, ensure};
use regex::Regex;
use serde::{Deserialize, Serialize};

use crate::sources::{text, today};

/// Failures of these classes, or with these descriptions, say that Kani did not get to the end, not that a
/// property is wrong.
const NO_REFUTATION: &str = "^(unwind|recursion|unsupported_construct|missing_definition|reachability_check|\
    sanity_check|cover)$|unwinding assertion|not currently supported by Kani|missing definition";

/// The most that CBMC may use. How long it may take stands in Cargo.toml.
const MEMORY_MB: u64 = 8000;

/// How a harness ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Verdict {
    /// Every check holds and every cover is satisfied.
    Verified,
    /// A check of the property, or of Rust's own rules, fails.
    Refuted,
    /// Every check holds, but a cover is not satisfied, or there is none.
    Vacuous,
    /// It does not compile, takes too much, is unwound too little, or uses what Kani does not know.
    Error,
}

/// A harness that was run.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct Proof {
    pub(crate) verdict: Verdict,
    /// Why it is not verified.
    pub(crate) reason: String,
    pub(crate) checks: usize,
    /// Satisfied, and all.
    pub(crate) covers: [usize; 2],
    /// What CBMC says it solved with, not what it was asked to.
    pub(crate) solver: String,
    /// CBMC's part, as Kani measures it.
    pub(crate) seconds: f64,
    /// The most that CBMC used, as seen five times a second.
    pub(crate) memory_mb: u64,
    /// Kani, CBMC and the compiler.
    pub(crate) tools: String,
    pub(crate) date: String,
}

/// `cargo kani`, free of what rustup sets for this program: Kani has a compiler of its own.
fn kani() -> Command {
    let mut command = Command::new("cargo");
    command.arg("kani").env("NO_COLOR", "1");
    for name in ["CARGO", "RUSTUP_TOOLCHAIN", "RUSTC", "LD_LIBRARY_PATH"] {
        command.env_remove(name);
    }
    command
}

/// The version of the installed Kani, if there is one.
pub(crate) fn installed() -> Option<String> {
    let output = kani().arg("--version").output().ok()?;
    let said = String::from_utf8(output.stdout).ok()?;
    Some(said.trim().strip_prefix("cargo-kani ")?.to_owned())
}

/// All harnesses in the copy of the sources `tree`, as Kani lists them: names and paths.
///
/// # Errors
/// If Kani cannot list them, or two have one name.
pub(crate) fn list(tree: &Path) -> Result<BTreeMap<String, String>> {
    #[derive(Deserialize)]
    #[serde(rename_all = "kebab-case")]
    struct List {
        standard_harnesses: BTreeMap<String, Vec<String>>,
    }
    // Kani leaves its list where it is called. Here it rejects the flags of the workspace, so that the manifest
    // of the package is named.
    let folder = tree.join("target/kani");
    fs::create_dir_all(&folder)?;
    let mut list = kani();
    list.current_dir(&folder).env("CARGO_TARGET_DIR", &folder);
    list.arg("--manifest-path")
        .arg(tree.join("proofs/Cargo.toml"));
    let output = list
        .args(["list", "--format", "json", "-Z", "stubbing"])
        .output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "cargo kani list: {said}");
    let list: List = serde_json::from_str(&text(&folder, "kani-list.json")?)?;
    let mut harnesses = BTreeMap::new();
    for path in list.standard_harnesses.into_values().flatten() {
        let name = path.rsplit("::").next().unwrap_or(&path).to_owned();
        ensure!(
            harnesses.insert(name, path.clone()).is_none(),
            "two harnesses are called {path}"
        );
    }
    Ok(harnesses)
}

/// Runs the harness `path` in `tree`, with the flags that `cargo kani` alone has; its output goes to `log`.
///
/// # Errors
/// If Kani cannot be started or watched.
pub(crate) fn prove(tree: &Path, path: &str, log: &Path) -> Result<Proof> {
    fs::create_dir_all(log.with_file_name(""))?;
    let file = File::create(log)?;
    let mut command = kani();
    command
        .current_dir(tree)
        .args(["--exact", "--harness", path]);
    command.arg("--target-dir").arg(tree.join("target/kani"));
    command
        .stdin(Stdio::null())
        .stdout(file.try_clone()?)
        .stderr(file);
    let mut child = command.spawn()?;
    let mut peak = 0;
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        let output = Command::new("ps")
            .args(["-e", "-o", "pid=,rss=,args="])
            .output()?;
        let output = String::from_utf8_lossy(&output.stdout);
        let ours = |line: &&str| line.contains(" cbmc ") && line.contains(&*tree.to_string_lossy());
        for cbmc in output.lines().filter(ours) {
            let mut words = cbmc.split_whitespace();
            let id = words.next().unwrap_or_default();
            let kilobytes = words
                .next()
                .and_then(|rss| rss.parse().ok())
                .unwrap_or(0u64);
            peak = peak.max(kilobytes * 1024 / 1_000_000);
            if peak > MEMORY_MB {
                Command::new("kill").args(["-KILL", id]).status()?;
            }
        }
        thread::sleep(Duration::from_millis(200));
    };
    let output = String::from_utf8_lossy(&fs::read(log)?).into_owned();
    let proof = Proof::read(&output, path)?;
    let failed = proof.verified() && !status.success();
    let verdict = if failed {
        Verdict::Error
    } else {
        proof.verdict
    };
    Ok(Proof {
        verdict,
        memory_mb: peak,
        ..proof
    })
}

impl Proof {
    /// Reads the output of `cargo kani` in its regular format.
    fn read(output: &str, path: &str) -> Result<Self> {
        let all = |pattern: &str| {
            let pattern = Regex::new(pattern).expect("a pattern");
            let all = pattern.captures_iter(output).map(|c| c[1].to_owned());
            let mut all: Vec<String> = all.collect();
            all.dedup();
            all
        };
        let one = |pattern: &str| all(pattern).into_iter().next().unwrap_or_default();
        let check = r#"(?m)^Check \d+: (.*)\n\s+- Status: (\w+)\n\s+- Description: "?(.*?)"?$"#;
        let check = Regex::new(check)?;
        let checks = check
            .captures_iter(output)
            .map(|check| check.extract::<3>().1);
        let class = |name: &str| name.rsplit('.').nth(1).unwrap_or_default().to_owned();
        let (covers, checks): (Vec<[&str; 3]>, Vec<_>) =
            checks.partition(|[name, ..]| class(name) == "cover");
        let missed = covers
            .iter()
            .filter(|[_, status, _]| *status != "SATISFIED");
        let missed: Vec<_> = missed
            .map(|[_, status, text]| format!("{text} ({status})"))
            .collect();
        let satisfied = covers.len() - missed.len();

        let no_refutation = Regex::new(NO_REFUTATION)?;
        let no_refutation = |text: &str| no_refutation.is_match(text);
        let passes = |status: &str| matches!(status, "SUCCESS" | "UNREACHABLE");
        let mut failed = checks
            .iter()
            .filter(|[_, status, _]| !passes(status))
            .peekable();
        let first = failed.peek().map(|[_, _, text]| *text);
        let refuted = failed.find(|[name, status, text]| {
            *status == "FAILURE" && !no_refutation(&class(name)) && !no_refutation(text)
        });
        let ran = all(r"(?m)^Checking harness (.+)\.\.\.$") == [path];
        let verdict = all(r"(?m)^VERIFICATION:- (\w+)");
        let verdict = verdict
            .first()
            .filter(|_| ran && verdict.len() == 1)
            .map(String::as_str);
        let summary = format!("{satisfied} of {} cover properties satisfied", covers.len());
        let (verdict, reason) = match (verdict, refuted) {
            (Some("SUCCESSFUL"), _) if covers.is_empty() => {
                (Verdict::Vacuous, "no cover".to_owned())
            }
            (Some("SUCCESSFUL"), _) if !missed.is_empty() => (Verdict::Vacuous, missed.join(", ")),
            (Some("SUCCESSFUL"), None) if first.is_none() && output.contains(&summary) => {
                (Verdict::Verified, String::new())
            }
            (Some("FAILED"), Some([_, _, text])) => (Verdict::Refuted, (*text).to_owned()),
            _ => {
                let said = one(r"(?m)^(error.*|CBMC failed.*|CBMC timed out.*|.*out of memory.*)$");
                (Verdict::Error, first.map_or(said, str::to_owned))
            }
        };
        Ok(Self {
            verdict,
            reason,
            checks: checks.len(),
            covers: [satisfied, covers.len()],
            solver: all(r"(?m)^Solving with (.+)$").join(", "),
            seconds: one(r"(?m)^Verification Time: ([\d.]+)s")
                .parse()
                .unwrap_or(0.0),
            memory_mb: 0,
            tools: format!(
                "Kani {}, CBMC {}, rustc {}",
                one(r"Kani Rust Verifier (\S+)"),
                one(r"(?m)^CBMC version (\S+)"),
                one(r"/toolchains/((?:nightly|stable|beta)[-\d]*\d)"),
            ),
            date: today()?,
        })
    }

    pub(crate) fn verified(&self) -> bool {
        self.verdict == Verdict::Verified
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATH: &str = "a::harness::v1_x";

    /// Output of Kani 0.67 with these checks: name, status, description.
    fn output(checks: &[(&str, &str, &str)], verdict: &str) -> String {
        let mut text = format!(
            "Kani Rust Verifier 0.67.0 (cargo plugin)\nChecking harness {PATH}...\n\
             \t- Stub: a::b -> c::d\nCBMC version 6.8.0 (cbmc-6.8.0) 64-bit x86_64 linux\n\
             Solving with MiniSAT 2.2.1 with simplifier\nRESULTS:\n"
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

    fn read(output: String) -> Proof {
        Proof::read(&output, PATH).expect("patterns")
    }

    fn verdict(checks: &[(&str, &str, &str)], verdict: &str) -> (Verdict, String) {
        let proof = read(output(checks, verdict));
        (proof.verdict, proof.reason)
    }

    const HOLDS: (&str, &str, &str) = ("a::f.assertion.1", "SUCCESS", "assertion failed: x");
    const COVERED: (&str, &str, &str) = ("a::harness::v1_x.cover.1", "SATISFIED", "accepted");

    #[test]
    fn all_that_the_output_says() {
        let proof = read(output(&[HOLDS, COVERED], "SUCCESSFUL"));
        assert_eq!((proof.checks, proof.covers), (1, [1, 1]));
        assert_eq!(proof.seconds, 1.25);
        assert_eq!(
            proof.tools,
            "Kani 0.67.0, CBMC 6.8.0, rustc nightly-2025-11-21"
        );
        assert_eq!(proof.solver, "MiniSAT 2.2.1 with simplifier");
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
            assert_eq!(reason, format!("replayed ({status})"));
        }
        let other_summary =
            output(&[HOLDS, COVERED], "SUCCESSFUL").replace("1 of 1 cover", "1 of 2 cover");
        assert_eq!(read(other_summary).verdict, Verdict::Error);
    }

    #[test]
    fn only_a_counterexample_refutes() {
        let failed = |name, text| verdict(&[(name, "FAILURE", text), COVERED], "FAILED").0;
        let refuted = [
            ("a::f.assertion.1", "assertion failed: x"),
            ("a::f.pointer_dereference.1", "invalid"),
        ];
        for (name, text) in refuted {
            assert_eq!(failed(name, text), Verdict::Refuted);
        }
        let not = [
            ("a::f.unwind.0", "unwinding assertion loop 0"),
            (
                "a::f.unsupported_construct.1",
                "x is not currently supported by Kani",
            ),
            (
                "a::f.assertion.2",
                "Function `x` with missing definition is unreachable",
            ),
        ];
        for (name, text) in not {
            assert_eq!(failed(name, text), Verdict::Error);
        }
        let undetermined = ("a::f.assertion.3", "UNDETERMINED", "assertion failed: x");
        assert_eq!(verdict(&[undetermined], "FAILED").0, Verdict::Error);
    }

    #[test]
    fn another_harness_or_none_is_an_error() {
        for (expected, checks) in [
            ("SUCCESSFUL", HOLDS),
            ("FAILED", ("a.assertion.1", "FAILURE", "x")),
        ] {
            let other = output(&[checks, COVERED], expected).replace(PATH, "a::other");
            assert_eq!(read(other).verdict, Verdict::Error);
        }
        let none = read("error: no harnesses matched".to_owned());
        assert_eq!(
            (none.verdict, &*none.reason),
            (Verdict::Error, "error: no harnesses matched")
        );
        assert_eq!(
            read(format!("Checking harness {PATH}...\n")).verdict,
            Verdict::Error
        );
    }
}
