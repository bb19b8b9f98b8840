//! Runs a program within limits of time and memory, and measures both.

use std::{
    collections::BTreeMap,
    fs,
    io::{ErrorKind, Read},
    process::{Child, Command, ExitStatus, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result};

/// Between two looks at the memory in use.
const POLL: Duration = Duration::from_millis(50);

/// What a program and its children may take together.
#[derive(Clone, Copy)]
pub(crate) struct Limits {
    pub(crate) time: Duration,
    pub(crate) memory_mb: u64,
}

/// Why a program was stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stopped {
    Time,
    Memory,
}

/// A program that has ended.
pub(crate) struct Ended {
    pub(crate) status: ExitStatus,
    pub(crate) stopped: Option<Stopped>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
    pub(crate) time: Duration,
    /// The most that it and its children took; none where there is no `/proc` to look at.
    pub(crate) memory_mb: Option<u64>,
}

/// Runs `command` to its end, or to the end of what it may take.
///
/// # Errors
/// If it cannot be started or watched.
pub(crate) fn run(command: &mut Command, limits: Limits) -> Result<Ended> {
    let start = Instant::now();
    command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = command.spawn().with_context(|| format!("{command:?}"))?;
    let stdout = drain(child.stdout.take());
    let stderr = drain(child.stderr.take());
    let mut memory_mb = None;
    let mut stopped = None;
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        memory_mb = memory_mb.max(family(child.id()).map(|family| memory(&family)));
        if stopped.is_none() {
            if start.elapsed() > limits.time {
                stopped = Some(Stopped::Time);
            } else if memory_mb > Some(limits.memory_mb) {
                stopped = Some(Stopped::Memory);
            }
            if stopped.is_some() {
                kill(&mut child)?;
            }
        }
        thread::sleep(POLL);
    };
    let text = |reader: thread::JoinHandle<Vec<u8>>| {
        let bytes = reader.join().unwrap_or_default();
        String::from_utf8_lossy(&bytes).into_owned()
    };
    Ok(Ended {
        status,
        stopped,
        stdout: text(stdout),
        stderr: text(stderr),
        time: start.elapsed(),
        memory_mb,
    })
}

/// Reads a pipe to its end in a thread, so that the program never waits for it.
fn drain(pipe: Option<impl Read + Send + 'static>) -> thread::JoinHandle<Vec<u8>> {
    thread::spawn(move || {
        let mut bytes = Vec::new();
        if let Some(mut pipe) = pipe {
            // What came before an error is still worth having.
            let _ = pipe.read_to_end(&mut bytes);
        }
        bytes
    })
}

/// A process and all its descendants; none where there is no `/proc`.
fn family(root: u32) -> Option<Vec<u32>> {
    let mut parents: BTreeMap<u32, u32> = BTreeMap::new();
    for entry in fs::read_dir("/proc").ok()?.flatten() {
        let Some(id) = entry
            .file_name()
            .to_str()
            .and_then(|name| name.parse().ok())
        else {
            continue;
        };
        // `id (name) state parent ...`; the name may hold spaces and parentheses.
        let stat = fs::read_to_string(entry.path().join("stat")).unwrap_or_default();
        let rest = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
        if let Some(parent) = rest
            .split_whitespace()
            .nth(1)
            .and_then(|id| id.parse().ok())
        {
            parents.insert(id, parent);
        }
    }
    let mut family = vec![root];
    let mut next = 0;
    while let Some(&parent) = family.get(next) {
        let children = parents.iter().filter(|(_, of)| **of == parent);
        family.extend(children.map(|(id, _)| *id));
        next += 1;
    }
    parents.contains_key(&root).then_some(family)
}

/// Megabytes in use by all of `family` now, or by one of them at its peak, whichever is more.
fn memory(family: &[u32]) -> u64 {
    let field = |status: &str, name: &str| {
        let line = status.lines().find(|line| line.starts_with(name));
        let number = line.and_then(|line| line.split_whitespace().nth(1));
        number
            .and_then(|kilobytes| kilobytes.parse().ok())
            .unwrap_or(0)
    };
    let (mut together, mut peak) = (0, 0);
    for id in family {
        let status = fs::read_to_string(format!("/proc/{id}/status")).unwrap_or_default();
        together += field(&status, "VmRSS:");
        peak = peak.max(field(&status, "VmHWM:"));
    }
    together.max(peak) * 1024 / 1_000_000
}

/// Kills a child and its descendants, as far as they can be found.
fn kill(child: &mut Child) -> Result<()> {
    if let Some(family) = family(child.id()) {
        let ids = family.iter().map(u32::to_string);
        let mut kill = Command::new("kill");
        kill.arg("-KILL").args(ids).stderr(Stdio::null());
        kill.status().context("kill")?;
    }
    match child.kill() {
        Err(error) if error.kind() != ErrorKind::InvalidInput => Err(error.into()),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        time: Duration::from_secs(20),
        memory_mb: 1_000,
    };

    fn shell(script: &str, limits: Limits) -> Ended {
        run(Command::new("sh").args(["-c", script]), limits).expect("sh")
    }

    #[test]
    fn what_a_program_says_and_takes() {
        let ended = shell("echo out; echo err >&2; sleep 0.2; exit 3", LIMITS);
        assert_eq!(ended.status.code(), Some(3));
        assert_eq!((&*ended.stdout, &*ended.stderr), ("out\n", "err\n"));
        assert_eq!(ended.stopped, None);
        assert_eq!(ended.memory_mb.is_some(), cfg!(target_os = "linux"));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn too_long_and_too_much_end_with_all_children() {
        let limits = Limits {
            time: Duration::from_millis(200),
            ..LIMITS
        };
        // The child holds the pipes open: this returns only if it is killed too.
        let ended = shell("sleep 60 & wait", limits);
        assert_eq!(ended.stopped, Some(Stopped::Time));
        assert!(ended.time < Duration::from_secs(20));

        let limits = Limits {
            memory_mb: 0,
            ..LIMITS
        };
        assert_eq!(
            shell("sleep 60 & wait", limits).stopped,
            Some(Stopped::Memory)
        );
    }
}
