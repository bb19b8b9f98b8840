//! The signer in QEMU with a vehicle at its local side, and whoever else takes part.

use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Child, Command, Stdio},
    sync::mpsc::{self, Receiver},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail};
use mavseal_e2e::Machine;

use super::bridge;
use crate::python;

/// How long to wait for anything; a loaded machine is slow.
const MAX_DELAY: Duration = Duration::from_secs(120);

/// The signer, and the vehicle.
pub(super) struct Bench {
    /// The TCP port for a ground station.
    pub(super) link: u16,
    pub(super) vehicle: Process,
    log: Receiver<String>,
    seen: Vec<String>,
    _machine: Machine,
}

impl Bench {
    pub(super) fn boot(python: &Path, elf: &Path) -> Result<Self> {
        let (machine, [local, link], log) = Machine::boot(elf)?;
        // It speaks when its clock is set and its ports are open.
        let hello = log.recv_timeout(MAX_DELAY);
        let hello = hello.context("the firmware says nothing")?;
        let local = bridge::open(local)?;
        let mut vehicle = python::script(python, "vehicle.py");
        vehicle.arg(local.to_string());
        Ok(Self {
            link: bridge::open(link)?,
            vehicle: Process::start(&mut vehicle)?,
            log,
            seen: vec![hello],
            _machine: machine,
        })
    }

    /// The firmware's log when nothing moves any more, for whoever has to find out why something
    /// failed.
    pub(super) fn log(&mut self) -> String {
        self.vehicle.close_input();
        self.listen();
        let lines = self.seen.chunk_by(|a, b| a == b);
        lines
            .map(|run| format!("\n    {} ({} times)", run[0], run.len()))
            .collect()
    }

    /// Ends the vehicle; gives the line that it says then.
    pub(super) fn end_vehicle(&mut self) -> Result<String> {
        self.vehicle.close_input();
        self.vehicle.wait_for("{")
    }

    /// Reads the log until nothing comes: rejections and counters do a second after the last byte.
    fn listen(&mut self) {
        while let Ok(line) = self.log.recv_timeout(Duration::from_secs(6)) {
            self.seen.push(line);
        }
    }

    /// The last of the counters that the firmware logs when nothing moves any more: how many frames
    /// it has `passed`, signed or verified, and how many rejected.
    pub(super) fn counters(&mut self, passed: &str) -> Result<(usize, usize)> {
        self.listen();
        let counters = self.seen.iter().rev().find_map(|line| {
            let said = line.strip_prefix(&format!("[INFO ] {passed}: "))?;
            let (count, rest) = said.split_once(", rejected: ")?;
            let (rejected, _) = rest.split_once(',')?;
            Some((count.parse().ok()?, rejected.parse().ok()?))
        });
        counters.with_context(|| format!("the firmware has not logged what it {passed}"))
    }
}

/// A program whose output is looked at line by line; ends with the value.
pub(super) struct Process {
    child: Child,
    lines: Receiver<String>,
}

impl Process {
    pub(super) fn start(command: &mut Command) -> Result<Self> {
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().with_context(|| format!("{command:?}"))?;
        let output = child.stdout.take().context("its output")?;
        let (send, lines) = mpsc::channel();
        thread::spawn(move || {
            let lines = BufReader::new(output).lines().map_while(Result::ok);
            // The receiver is gone only when nobody wants to know any more.
            lines.for_each(|line| drop(send.send(line)));
        });
        Ok(Self { child, lines })
    }

    /// The next line that has `part` in it.
    pub(super) fn wait_for(&mut self, part: &str) -> Result<String> {
        let start = Instant::now();
        let mut said = String::new();
        while let Some(left) = MAX_DELAY.checked_sub(start.elapsed()) {
            let Ok(line) = self.lines.recv_timeout(left) else {
                break;
            };
            if line.contains(part) {
                return Ok(line);
            }
            said.push_str("\n  ");
            said.push_str(&line);
        }
        bail!("{part:?} has not come, but:{said}")
    }

    pub(super) fn say(&mut self, line: &str) -> Result<()> {
        let input = self.child.stdin.as_mut().context("its input")?;
        Ok(writeln!(input, "{line}")?)
    }

    pub(super) fn close_input(&mut self) {
        self.child.stdin = None;
    }

    /// Closes its input and waits until it has ended, which shows in its output.
    pub(super) fn end(&mut self) -> Result<()> {
        self.close_input();
        while self.lines.recv_timeout(MAX_DELAY).is_ok() {}
        self.child.wait().map(drop).context("it does not end")
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // An error means that it has ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
