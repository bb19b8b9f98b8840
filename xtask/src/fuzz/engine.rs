//! The fuzz targets as programs: built, run, and understood.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use anyhow::{Context, Result, ensure};

use crate::setup::CargoFuzz;

use super::plan::Target;

/// No sanitizer: the cores forbid `unsafe`, and the address sanitizer halves the speed. What `unsafe`
/// there is, in the libraries that they use, ClusterFuzzLite runs with the sanitizer.
pub(super) const SANITIZER: &str = "none";

/// How targets are built: with debug assertions in the cores only, which `fuzz/Cargo.toml` asks for, and
/// without a look at each comparison, which halves the speed; seeds and dictionary know what to compare
/// with.
const OPTIMISED: [&str; 2] = ["--release", "--no-trace-compares"];

/// How long one input may take.
const TIMEOUT_SECONDS: u64 = 10;

/// Every target of one copy of the sources, built.
pub(super) struct Engine {
    tree: PathBuf,
    target_dir: PathBuf,
    cargo_fuzz: CargoFuzz,
}

/// One run of a target.
pub(super) struct Session {
    /// Where inputs are kept, which is read first, and other folders that are only read.
    pub(super) corpus: Vec<PathBuf>,
    /// When it ends, if nothing is found before; zero for one look at every file.
    pub(super) time: Duration,
    /// More of the engine's options.
    pub(super) options: Vec<String>,
}

/// How far a run is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Status {
    pub(super) executions: u64,
    pub(super) edges: u64,
    pub(super) features: u64,
}

/// A run that has ended.
#[derive(Clone, Debug)]
pub(super) struct Ended {
    pub(super) status: Status,
    pub(super) seconds: f64,
    /// What was found, if something was.
    pub(super) finding: Option<Finding>,
}

/// An input on which a target failed.
#[derive(Clone, Debug)]
pub(super) struct Finding {
    /// What the target said.
    pub(super) said: String,
    /// The input; none if the program ended in another way than by failing on one.
    pub(super) input: Option<PathBuf>,
}

impl Engine {
    /// The targets in `tree`, not built yet.
    pub(super) fn new(cargo_fuzz: &CargoFuzz, tree: &Path, target_dir: &Path) -> Self {
        Self {
            tree: tree.to_owned(),
            target_dir: target_dir.to_owned(),
            cargo_fuzz: cargo_fuzz.clone(),
        }
    }

    /// Builds `target`, or all of them.
    ///
    /// # Errors
    /// If they do not compile, with what the compiler says.
    pub(super) fn build(&self, target: Option<&str>) -> Result<()> {
        let mut cargo = self.cargo("build");
        let output = cargo.args(target).stdin(Stdio::null()).output()?;
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(
            output.status.success(),
            "the targets were not built:\n{said}"
        );
        Ok(())
    }

    /// `cargo fuzz <command>`, to which the caller adds a target.
    fn cargo(&self, verb: &str) -> Command {
        let mut cargo = self.cargo_fuzz.command();
        cargo.current_dir(&self.tree);
        cargo.args([verb, "--fuzz-dir", "fuzz", "--sanitizer", SANITIZER]);
        cargo
            .args(OPTIMISED)
            .arg("--target-dir")
            .arg(&self.target_dir);
        cargo
    }

    /// The program of a target, with the options that every run has.
    fn program(&self, name: &str, max_len: usize) -> Result<Command> {
        let folder = self.target_dir.join(&self.cargo_fuzz.host).join("release");
        let mut program = Command::new(folder.join(name));
        let artifacts = self.artifacts(name);
        fs::create_dir_all(&artifacts)?;
        program.arg(format!("-artifact_prefix={}/", artifacts.display()));
        program.arg(format!(
            "-dict={}",
            self.tree.join("fuzz/mavlink.dict").display()
        ));
        program.arg(format!("-max_len={max_len}"));
        program.arg(format!("-timeout={TIMEOUT_SECONDS}"));
        program.args(["-print_final_stats=1", "-verbosity=1"]);
        program.stdin(Stdio::null()).stdout(Stdio::null());
        Ok(program)
    }

    /// Where the inputs go that a target fails on.
    fn artifacts(&self, name: &str) -> PathBuf {
        self.tree.join("fuzz/artifacts").join(name)
    }

    /// The seeds of a target, and what campaigns found beside them: committed, only read.
    pub(super) fn seeds(&self, target: &Target) -> Vec<PathBuf> {
        let folders = ["fuzz/seeds", "fuzz/found"];
        let folders = folders.map(|folder| self.tree.join(folder).join(&target.name));
        folders
            .into_iter()
            .filter(|folder| folder.is_dir())
            .collect()
    }

    /// A target with the options of `session`.
    fn prepare(&self, name: &str, max_len: usize, session: &Session) -> Result<Command> {
        let mut program = self.program(name, max_len)?;
        match session.time.as_secs() {
            0 => program.arg("-runs=0"),
            seconds => program.arg(format!("-max_total_time={seconds}")),
        };
        program.args(&session.options).args(&session.corpus);
        for folder in &session.corpus {
            fs::create_dir_all(folder)?;
        }
        Ok(program)
    }

    /// Runs a target, and tells how far it is whenever it says so.
    ///
    /// # Errors
    /// If it cannot be started.
    pub(super) fn run(
        &self,
        name: &str,
        max_len: usize,
        session: &Session,
        mut progress: impl FnMut(Status),
    ) -> Result<Ended> {
        let mut program = self.prepare(name, max_len, session)?;
        let start = Instant::now();
        let child = program.stderr(Stdio::piped()).spawn();
        let mut child = child.with_context(|| name.to_owned())?;
        let mut reader = Reader::default();
        let stderr = BufReader::new(child.stderr.take().context("its messages")?);
        for line in stderr.split(b'\n') {
            reader.read(&String::from_utf8_lossy(&line?));
            progress(reader.status);
        }
        let success = child.wait()?.success();
        Ok(Ended {
            status: reader.status,
            seconds: start.elapsed().as_secs_f64(),
            finding: (!success).then(|| reader.finding(&self.tree)),
        })
    }

    /// Executions of a target in a second of the processor's time: other programs that run meanwhile do
    /// not count.
    ///
    /// # Errors
    /// If the target fails.
    pub(super) fn speed(&self, name: &str, max_len: usize, session: &Session) -> Result<f64> {
        let program = self.prepare(name, max_len, session)?;
        let mut shell = Command::new("sh");
        shell.args(["-c", "\"$0\" \"$@\" && times"]);
        shell.arg(program.get_program()).args(program.get_args());
        let output = shell.stdin(Stdio::null()).output().context("sh")?;
        ensure!(output.status.success(), "{name} failed");
        let mut reader = Reader::default();
        let said = String::from_utf8_lossy(&output.stderr);
        said.lines().for_each(|line| reader.read(line));
        let times = String::from_utf8_lossy(&output.stdout).into_owned();
        let seconds = children_seconds(&times).with_context(|| format!("times: {times}"))?;
        Ok(reader.status.executions as f64 / seconds)
    }

    /// Makes an input as small as it can while the target still fails on it.
    ///
    /// # Errors
    /// If cargo-fuzz cannot be called.
    pub(super) fn minimise(&self, name: &str, input: &Path) -> Result<PathBuf> {
        let output = self.cargo("tmin").arg(name).arg(input).output()?;
        let said = String::from_utf8_lossy(&output.stderr);
        let mut lines = said
            .lines()
            .skip_while(|line| !line.starts_with("Minimized artifact:"));
        let smaller = lines.find(|line| line.contains("minimized-from-"));
        let smaller = smaller.map(|line| self.tree.join(line.trim()));
        Ok(smaller
            .filter(|path| path.is_file())
            .unwrap_or_else(|| input.to_owned()))
    }

    /// What a developer types to see a failure again, in the project's folder.
    pub(super) fn reproduction(&self, name: &str, input: &Path) -> String {
        let input = input.strip_prefix(&self.tree).unwrap_or(input).display();
        let typed = self.cargo_fuzz.typed();
        format!("{typed} run --sanitizer {SANITIZER} {name} {input}")
    }

    /// Keeps in `folder` what reaches more edges than what is there already.
    ///
    /// # Errors
    /// If the engine fails.
    pub(super) fn merge(&self, target: &Target, folder: &Path, from: &[PathBuf]) -> Result<()> {
        let mut program = self.program(&target.name, target.max_len)?;
        program
            .args(["-merge=1", "-use_counters=0"])
            .arg(folder)
            .args(from);
        let output = program.output()?;
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "{}: {said}", target.name);
        Ok(())
    }
}

/// Understands what libFuzzer prints.
#[derive(Default)]
struct Reader {
    status: Status,
    input: Option<PathBuf>,
    said: Vec<String>,
}

impl Reader {
    fn read(&mut self, line: &str) {
        if let Some(status) = Status::parse(line) {
            self.status = status;
        } else if let Some(executions) = line.strip_prefix("stat::number_of_executed_units:") {
            self.status.executions = executions.trim().parse().unwrap_or_default();
        } else if let Some((_, path)) = line.split_once("Test unit written to ") {
            self.input = Some(path.trim().into());
        } else if let Some((_, place)) = line.split_once("panicked at ") {
            self.said.push(place.to_owned());
        } else if let Some((_, error)) = line.split_once("ERROR: libFuzzer: ") {
            self.said.push(error.to_owned());
        } else if self.said.len() == 1 {
            // The message of a panic stands in the next line.
            self.said.push(line.trim().to_owned());
        }
    }

    /// What was found in the sources in `tree`.
    fn finding(self, tree: &Path) -> Finding {
        let mut said = self.said;
        said.truncate(2);
        Finding {
            said: said.join(" ").replace(&format!("{}/", tree.display()), ""),
            input: self.input,
        }
    }
}

impl Status {
    /// Parses `#4096  pulse  cov: 321 ft: 406 corp: 71/4589b exec/s: 175030 rss: 27Mb`.
    fn parse(line: &str) -> Option<Self> {
        let mut words = line.strip_prefix('#')?.split_whitespace();
        let executions = words.next()?.trim_end_matches(':').parse().ok()?;
        let mut after = |name: &str| {
            words.find(|word| *word == name)?;
            words.next()?.parse().ok()
        };
        Some(Self {
            executions,
            edges: after("cov:")?,
            features: after("ft:")?,
        })
    }
}

/// The processor's time of a shell's children, in its words: `0m0.01s 0m0.00s`, then theirs.
fn children_seconds(times: &str) -> Option<f64> {
    let (minutes, seconds) = times
        .lines()
        .nth(1)?
        .split_whitespace()
        .next()?
        .split_once('m')?;
    let seconds: f64 = seconds.strip_suffix('s')?.parse().ok()?;
    let minutes: f64 = minutes.parse().ok()?;
    Some(60.0 * minutes + seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_shell_says_of_its_children() {
        let seconds = children_seconds("0m0.01s 0m0.00s\n1m2.50s 0m0.25s\n");
        assert_eq!(seconds, Some(62.5));
        assert_eq!(children_seconds("0m0.01s 0m0.00s\n"), None);
    }

    #[test]
    fn what_the_engine_says() {
        let mut reader = Reader::default();
        for line in [
            "INFO: seed corpus: files: 3 min: 1b max: 3b total: 6b rss: 27Mb",
            "#4\tINITED cov: 20 ft: 21 corp: 3/6b exec/s: 0 rss: 27Mb",
            "#4096\tpulse  cov: 321 ft: 406 corp: 71/4589b lim: 4 exec/s: 17 rss: 27Mb",
        ] {
            reader.read(line);
        }
        let status = Status {
            executions: 4096,
            edges: 321,
            features: 406,
        };
        assert_eq!(reader.status, status);
        reader.read("thread '<unnamed>' (7) panicked at /p/proofs/src/verify.rs:37:13:");
        reader.read("assertion `left == right` failed");
        reader.read("  left: 1");
        reader.read("==7== ERROR: libFuzzer: deadly signal");
        reader.read("artifact_prefix='a/'; Test unit written to a/crash-01");
        reader.read("stat::number_of_executed_units: 5000");
        assert_eq!(reader.status.executions, 5000);
        let finding = reader.finding(Path::new("/p"));
        assert_eq!(finding.input, Some("a/crash-01".into()));
        let said = "proofs/src/verify.rs:37:13: assertion `left == right` failed";
        assert_eq!(finding.said, said);
    }
}
