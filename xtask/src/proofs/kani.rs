//! Runs harnesses with Kani and reads what it prints.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    path::Path,
    process::Command,
    thread,
    time::Duration,
};

use anyhow::{Result, ensure};
use regex::Regex;
use serde::{Deserialize, Serialize};

use crate::sources::{find, find_all, text, today};

/// Failures of these classes, or with these descriptions, say that Kani did not get to the end, not that a
/// property is wrong.
const NO_REFUTATION: &str = "^(unwind|recursion|unsupported_construct|missing_definition|reachability_check|\
    sanity_check)$|unwinding assertion|not currently supported by Kani|missing definition";
/// The most that CBMC may use. How long it may take stands in Cargo.toml.
const MEMORY_MB: u64 = 8000;

/// How a harness ended.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
    let said = String::from_utf8(kani().arg("--version").output().ok()?.stdout).ok()?;
    Some(said.trim().strip_prefix("cargo-kani ")?.to_owned())
}

/// All harnesses in the copy of the sources `tree`, as Kani lists them: names and paths.
///
/// # Errors
/// If Kani cannot list them, or two have one name.
pub(crate) fn list(tree: &Path) -> Result<BTreeMap<String, String>> {
    // Kani leaves its list where it is called. Here it rejects the flags of the workspace, so that the manifest
    // of the package is named.
    let folder = tree.join("target/kani");
    fs::create_dir_all(&folder)?;
    let mut list = kani();
    list.current_dir(&folder).env("CARGO_TARGET_DIR", &folder);
    list.args(["--manifest-path", "../../proofs/Cargo.toml", "list"]);
    list.args(["--format", "json", "-Z", "stubbing"]);
    let output = list.output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "cargo kani list: {said}");
    let list: serde_json::Value = serde_json::from_str(&text(&folder, "kani-list.json")?)?;
    let files = list["standard-harnesses"].as_object().into_iter().flatten();
    let mut harnesses = BTreeMap::new();
    for path in files.filter_map(|(_, paths)| paths.as_array()).flatten() {
        let path = path.as_str().unwrap_or_default();
        let name = path.rsplit("::").next().unwrap_or(path);
        let other = harnesses.insert(name.to_owned(), path.to_owned());
        ensure!(other.is_none(), "two harnesses are called {name}");
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
        .arg("--target-dir")
        .arg(tree.join("target/kani"));
    command.args(["--exact", "--harness", path]);
    let mut child = command.stdout(file.try_clone()?).stderr(file).spawn()?;
    let mut peak = 0;
    while child.try_wait()?.is_none() {
        let mut ps = Command::new("ps");
        let output = ps.args(["-e", "-o", "pid=,rss=,args="]).output()?;
        for line in String::from_utf8_lossy(&output.stdout).lines() {
            let mut words = line.split_whitespace();
            let [id, rss, program] = [(); 3].map(|()| words.next().unwrap_or_default());
            if program == "cbmc" && line.contains(&*tree.to_string_lossy()) {
                peak = peak.max(rss.parse::<u64>()? * 1024 / 1_000_000);
                if peak > MEMORY_MB {
                    Command::new("kill").args(["-KILL", id]).status()?;
                }
            }
        }
        thread::sleep(Duration::from_millis(200));
    }
    let output = String::from_utf8_lossy(&fs::read(log)?).into_owned();
    let mut proof = Proof::read(&output, path)?;
    if proof.verified() && !child.wait()?.success() {
        proof.verdict = Verdict::Error;
    }
    proof.memory_mb = peak;
    Ok(proof)
}

impl Proof {
    /// Reads the output of `cargo kani` in its regular format.
    fn read(output: &str, path: &str) -> Result<Self> {
        let check = Regex::new(
            r#"(?m)^Check \d+: (.*)\n\s+- Status: (\w+)\n\s+- Description: "?(.*?)"?$"#,
        )?;
        let no_refutation = Regex::new(NO_REFUTATION)?;
        let (mut checks, mut covers, mut missed) = (0, 0, Vec::new());
        let (mut failed, mut refuted) = (None, None);
        for [name, status, text] in check.captures_iter(output).map(|check| check.extract().1) {
            let class = name.rsplit('.').nth(1).unwrap_or_default();
            if class == "cover" {
                covers += 1;
                if status != "SATISFIED" {
                    missed.push(format!("{text} ({status})"));
                }
                continue;
            }
            checks += 1;
            if !matches!(status, "SUCCESS" | "UNREACHABLE") {
                failed = failed.or(Some(text));
                let incomplete = no_refutation.is_match(class) || no_refutation.is_match(text);
                if status == "FAILURE" && !incomplete {
                    refuted = refuted.or(Some(text));
                }
            }
        }
        let satisfied = covers - missed.len();
        let summary = format!("{satisfied} of {covers} cover properties satisfied");
        let ran = find_all(r"(?m)^Checking harness (.+)\.\.\.$", output) == [path];
        let verdicts = find_all(r"(?m)^VERIFICATION:- (\w+)", output).join(" ");
        let (verdict, reason) = match (&*verdicts, refuted) {
            ("SUCCESSFUL", None) if ran && covers == 0 => (Verdict::Vacuous, "no cover".to_owned()),
            ("SUCCESSFUL", None) if ran && satisfied < covers => {
                (Verdict::Vacuous, missed.join(", "))
            }
            ("SUCCESSFUL", None) if ran && failed.is_none() && output.contains(&summary) => {
                (Verdict::Verified, String::new())
            }
            ("FAILED", Some(text)) if ran => (Verdict::Refuted, text.to_owned()),
            _ => {
                let said = find(r"(?m)^(error.*|CBMC failed.*|CBMC timed out.*)$", output);
                (Verdict::Error, failed.map_or(said, str::to_owned))
            }
        };
        Ok(Self {
            verdict,
            reason,
            checks,
            covers: [satisfied, covers],
            solver: find_all(r"(?m)^Solving with (.+)$", output).join(", "),
            seconds: find(r"(?m)^Verification Time: ([\d.]+)s", output)
                .parse()
                .unwrap_or(0.0),
            memory_mb: 0,
            tools: format!(
                "Kani {}, CBMC {}, rustc {}",
                find(r"Kani Rust Verifier (\S+)", output),
                find(r"(?m)^CBMC version (\S+)", output),
                find(r"/toolchains/((?:nightly|stable|beta)[-\d]*\d)", output),
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
