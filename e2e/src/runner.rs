//! The runner of plays: boots the machine, sends, compares what comes out, what is logged and what is counted,
//! and prints tables.

use std::{
    io::{self, ErrorKind, Read, Write},
    net::TcpStream,
    path::Path,
    sync::mpsc::Receiver,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail, ensure};
use comfy_table::{Cell, CellAlignment, Table, presets};

use crate::{
    machine::Machine,
    scenario::{
        Counts, Device, Phase, Row, Sending, Sent,
        Side::{Link, Local},
    },
};

/// How long nothing may happen while something is expected: this machine may be busy with other things.
const PATIENCE: Duration = Duration::from_secs(20);
/// How long the firmware has for what was sent last before a reset, or the end.
const MOMENT: Duration = Duration::from_millis(300);
const POLL: Duration = Duration::from_millis(2);

/// How a line of the log about rejections begins, by the side that the frames were sent into.
const REJECTED: [&str; 2] = ["[INFO ] Outbound rejected: ", "[INFO ] Inbound rejected: "];

/// Plays `phases` with the firmware in `elf` and prints what became of them; gives the device back. The
/// firmware's log is printed too if `log`, or if it failed.
///
/// # Errors
///
/// If anything comes out that must not, or does not that must, or for another reason. What follows is not
/// played.
pub fn run<D: Device>(device: D, elf: &Path, phases: Vec<Phase<D>>, log: bool) -> Result<D> {
    let (machine, ports, lines) = Machine::boot(elf)?;
    for port in &ports {
        port.set_nonblocking(true)?;
    }
    let mut stage = Stage {
        device,
        machine,
        ports: ports.map(|stream| (stream, Vec::new())),
        log: lines,
        lines: Vec::new(),
        counts: Default::default(),
        seen: Seen::default(),
    };
    let mut played = stage.wait_for_start();
    for phase in phases {
        if played.is_ok() {
            println!("\n{}", phase.title);
            let title = phase.title.clone();
            played = stage.play(phase).context(title);
        }
    }
    let played = played.and_then(|()| stage.nothing_comes());
    if log || played.is_err() {
        println!("\nThe firmware's log:");
        stage.lines.extend(stage.log.try_iter());
        for run in stage.lines.chunk_by(|a, b| a == b) {
            match run {
                [line] => println!("  {line}"),
                _ => println!("  {}   ({} times)", run[0], run.len()),
            }
        }
    }
    played.map(|()| stage.device)
}

/// The machine and what is known of it.
struct Stage<D> {
    device: D,
    machine: Machine,
    /// Each with the bytes that the firmware has not taken yet
    ports: [(TcpStream, Vec<u8>); 2],
    log: Receiver<String>,
    lines: Vec<String>,
    /// What must become of frames since the start, by the side that they were sent into
    counts: [Counts; 2],
    seen: Seen,
}

/// What was seen in a phase.
#[derive(Default)]
struct Seen {
    rows: Vec<Row>,
    ways: [Way; 2],
    lines_due: Vec<&'static str>,
    lines: Vec<String>,
}

/// Of what was sent into one side: what must become of it, in order, and what has.
#[derive(Default)]
struct Way {
    /// Bytes on the other side; each frame's end, and its row
    due: Vec<u8>,
    ends: Vec<(usize, usize)>,
    came: Vec<u8>,
    /// Reasons of rejections, each with its row
    reasons_due: Vec<(&'static str, usize)>,
    reasons: Vec<String>,
}

impl Way {
    /// What has come that must not.
    fn wrong(&self, rows: &[Row]) -> Option<String> {
        if !self.due.starts_with(&self.came) {
            let same = self.due.iter().zip(&self.came).take_while(|(a, b)| a == b);
            let same = same.count();
            let frame = self.ends.iter().find(|(end, _)| *end > same);
            return Some(match frame {
                Some((_, row)) => format!("{}: another frame came out", rows[*row].name),
                None => format!("{} bytes came out that must not", self.came.len() - same),
            });
        }
        let mut due = self.reasons_due.iter();
        self.reasons.iter().find_map(|reason| match due.next() {
            Some((because, _)) if because == reason => None,
            Some((because, row)) => {
                let name = &rows[*row].name;
                Some(format!(
                    "{name}: rejected because {reason}, not because {because}"
                ))
            }
            None => Some(format!("a frame was rejected that must not be: {reason}")),
        })
    }

    /// Whether anything has not come yet.
    fn is_open(&self) -> bool {
        self.came.len() < self.due.len() || self.reasons.len() < self.reasons_due.len()
    }

    /// What has not come yet.
    fn missing(&self, rows: &[Row]) -> Option<String> {
        let frame = self.ends.iter().find(|(end, _)| *end > self.came.len());
        let passes = frame.map(|(_, row)| format!("{}: no frame came out", rows[*row].name));
        let reason = self.reasons_due.get(self.reasons.len());
        passes.or(reason.map(|(_, row)| format!("{}: no rejection was logged", rows[*row].name)))
    }
}

impl<D: Device> Stage<D> {
    fn wait_for_start(&mut self) -> Result<()> {
        loop {
            let line = self.log.recv_timeout(PATIENCE);
            self.lines
                .push(line.context("the firmware does not start")?);
            if self.device.started(&self.lines[self.lines.len() - 1])? {
                // It hears nothing on its local side before that was silent.
                thread::sleep(MOMENT);
                return Ok(());
            }
        }
    }

    fn play(&mut self, phase: Phase<D>) -> Result<()> {
        let begun = Instant::now();
        if phase.reset {
            self.reset()?;
        }
        self.seen = Seen::default();
        for step in phase.steps {
            let mut sending = Sending::default();
            step(&mut self.device, &mut sending)?;
            let first = self.seen.rows.len();
            self.seen.rows.extend(sending.rows);
            self.seen.lines_due.extend(sending.lines);
            for sent in sending.frames {
                let alone = sent.alone;
                self.send(first, sent);
                if alone {
                    // The firmware tells its counters when the lines were silent.
                    self.until(|stage| stage.missing(&stage.counters()).is_none())?;
                }
            }
            self.until(|stage| {
                let mut ways = stage.seen.ways.iter();
                let came = ways.all(|way| way.came.len() >= way.due.len());
                came && stage.missing(&[]).is_none() && stage.device.is_ready()
            })?;
        }
        let is_used = |way: &Way| !way.ends.is_empty() || !way.reasons_due.is_empty();
        if self.seen.ways.iter().any(is_used) {
            self.until(|stage| stage.missing(&stage.counters()).is_none())?;
        }
        println!("{}", table(&self.seen.rows, D::PASSED).trim_fmt());
        println!("{:.1} s", begun.elapsed().as_secs_f32());
        Ok(())
    }

    /// Resets the board in the middle of something, and waits until the firmware runs again.
    fn reset(&mut self) -> Result<()> {
        for ((_, outbox), bytes) in self.ports.iter_mut().zip(self.device.reset()) {
            outbox.extend(bytes);
        }
        self.nothing_comes()?;
        self.machine.reset()?;
        self.device.was_reset();
        self.lines.push("(reset)".to_owned());
        self.counts = Default::default();
        self.wait_for_start().context("after a reset")
    }

    /// Waits for a moment, in which nothing may come out.
    fn nothing_comes(&mut self) -> Result<()> {
        self.seen = Seen::default();
        let begun = Instant::now();
        self.until(|_| begun.elapsed() > MOMENT)
    }

    /// Sends a frame, whose row is one of those from `first` on.
    fn send(&mut self, first: usize, sent: Sent) {
        let (into, row) = (sent.into as usize, first + sent.row);
        self.ports[into].1.extend(sent.bytes);
        let (way, counts) = (&mut self.seen.ways[into], &mut self.counts[into]);
        match sent.verdict {
            Ok(out) => {
                way.due.extend(out);
                way.ends.push((way.due.len(), row));
                counts.passed += 1;
            }
            Err(because) => {
                way.reasons_due.push((because, row));
                counts.rejected += 1;
            }
        }
    }

    /// How the lines begin with which the firmware counts what it was sent.
    fn counters(&self) -> Vec<String> {
        self.device.counters(self.counts)
    }

    /// Goes on until everything was written and `done`.
    fn until(&mut self, done: impl Fn(&Self) -> bool) -> Result<()> {
        let mut last = (Instant::now(), Vec::new());
        loop {
            self.turn()?;
            let Seen { rows, ways, .. } = &self.seen;
            if let Some(wrong) = ways.iter().find_map(|way| way.wrong(rows)) {
                bail!(wrong);
            }
            let unsent = self.ports.each_ref().map(|(_, outbox)| outbox.len());
            if unsent == [0; 2] && done(self) {
                return Ok(());
            }
            let came = ways
                .each_ref()
                .map(|way| [way.came.len(), way.reasons.len()]);
            let progress = [&unsent[..], came.as_flattened()].concat();
            if progress != last.1 {
                last = (Instant::now(), progress);
            }
            if last.0.elapsed() > PATIENCE {
                ensure!(unsent == [0; 2], "the firmware takes no more bytes");
                let missing = ways.iter().find_map(|way| way.missing(rows));
                bail!(
                    missing
                        .or(self.missing(&self.counters()))
                        .unwrap_or_default()
                );
            }
            thread::sleep(POLL);
        }
    }

    /// Takes what has come.
    fn turn(&mut self) -> Result<()> {
        for side in [Local, Link] {
            let (stream, outbox) = &mut self.ports[side as usize];
            while !outbox.is_empty() {
                let Some(length) = unless_blocked(stream.write(outbox))? else {
                    break;
                };
                outbox.drain(..length);
            }
            let mut buffer = [0; 4096];
            while let Some(length) = unless_blocked(stream.read(&mut buffer))? {
                ensure!(length > 0, "the emulator has ended");
                // An answer would come late behind what the firmware has not looked at yet.
                let busy = !outbox.is_empty() || self.seen.ways[side as usize].is_open();
                // It belongs to what was sent into the other side.
                let came = &mut self.seen.ways[1 - side as usize].came;
                let mut reply = Vec::new();
                self.device
                    .open(side, &buffer[..length], came, &mut reply)?;
                if !busy {
                    outbox.extend(reply);
                }
            }
        }
        while let Ok(line) = self.log.try_recv() {
            self.lines.push(line.clone());
            let fault = line.contains("[WARN ]") || line.contains("[ERROR]");
            ensure!(!fault, "the firmware says: {line}");
            for (way, beginning) in self.seen.ways.iter_mut().zip(REJECTED) {
                if let Some(run) = line.strip_prefix(beginning) {
                    let run = run
                        .strip_suffix(" times")
                        .and_then(|run| run.rsplit_once(", "));
                    let (reason, times) = run.with_context(|| line.clone())?;
                    way.reasons.extend(vec![reason.to_owned(); times.parse()?]);
                }
            }
            self.seen.lines.push(line);
        }
        Ok(())
    }

    /// A line that the log must have in this phase and has not, or must begin like one of these.
    fn missing(&self, beginnings: &[String]) -> Option<String> {
        let due = self.seen.lines_due.iter().copied();
        let mut due = due.chain(beginnings.iter().map(String::as_str));
        let lines = &self.seen.lines;
        let line = due.find(|due| !lines.iter().any(|line| line.starts_with(due)))?;
        Some(format!("the firmware has not said: {line}"))
    }
}

fn unless_blocked(result: io::Result<usize>) -> io::Result<Option<usize>> {
    match result {
        Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
        other => other.map(Some),
    }
}

/// A table of rows, with no more columns than they need.
fn table(rows: &[Row], [signed, verified]: [&str; 2]) -> Table {
    let first = rows.first().map_or("", |row| row.to);
    let several = rows.iter().any(|row| row.to != first);
    let air = rows.iter().any(|row| row.air.is_some());
    let passed = match first {
        _ if several => "passed",
        "local side" => signed,
        _ => verified,
    };
    let cells = |to: &str, name: &str, numbers: [String; 6], because: &str| {
        // The first three are about air.
        let numbers = numbers.into_iter().skip(if air { 0 } else { 3 });
        let numbers = numbers.map(|number| Cell::new(number).set_alignment(CellAlignment::Right));
        let front = several
            .then_some(to)
            .into_iter()
            .chain([name])
            .map(Cell::new);
        front
            .chain(numbers)
            .chain([Cell::new(because)])
            .collect::<Vec<_>>()
    };
    let mut table = Table::new();
    table.load_preset(presets::NOTHING);
    let arrived = if air { "arrived" } else { "frames" };
    let names = ["sent", "lost", "doubled", arrived, passed, "rejected"];
    table.set_header(cells("into", "what", names.map(str::to_owned), "because"));
    for row in rows {
        let Counts { passed, rejected } = row.counts;
        let arrived = passed + rejected;
        let air = row.air.map(|air| [air.sent, air.lost, air.doubled]);
        let [sent, lost, doubled] = air.unwrap_or([arrived, 0, 0]);
        let numbers = [sent, lost, doubled, arrived, passed, rejected];
        let numbers = numbers.map(|number| number.to_string());
        table.add_row(cells(row.to, &row.name, numbers, row.because));
    }
    table
}
