//! The runner of plays: boots the machine, sends, compares what comes out, what is logged and what is
//! counted, and prints a table.

use std::{
    io::{self, ErrorKind, Read, Write},
    net::TcpStream,
    path::Path,
    sync::mpsc::{Receiver, RecvTimeoutError},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail, ensure};
use comfy_table::{CellAlignment, Table, presets};

use crate::machine::Machine;

/// How long nothing may happen while something is expected: this machine may be busy with other things.
const PATIENCE: Duration = Duration::from_secs(20);
/// How long the firmware has for what was sent last before a reset.
const MOMENT: Duration = Duration::from_millis(300);
const POLL: Duration = Duration::from_millis(2);
/// What the tables call [`Side::Local`].
const LOCAL: &str = "local side";

/// A side of a device, by its port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// UART 0: equipment that cannot sign or seal.
    Local,
    /// UART 1: the radio.
    Link,
}

impl Side {
    const BOTH: [Self; 2] = [Self::Local, Self::Link];

    const fn other(self) -> Self {
        match self {
            Self::Local => Self::Link,
            Self::Link => Self::Local,
        }
    }

    /// How a line of the log about rejections of what was sent into this side begins.
    const fn rejected(self) -> &'static str {
        match self {
            Self::Local => "[INFO ] Outbound rejected: ",
            Self::Link => "[INFO ] Inbound rejected: ",
        }
    }
}

/// The firmware of a play, as its peers see it.
pub trait Device {
    /// What passes is called so, by the side that it was sent into.
    const PASSED: [&'static str; 2];

    /// Takes a line of the log since the start; gives whether the firmware is ready.
    ///
    /// # Errors
    ///
    /// If it does not start as it must.
    fn started(&mut self, line: &str) -> Result<bool>;

    /// Takes bytes that came out of `side`. What they say, without signature or seal, is added to `out`,
    /// and an answer to `reply`.
    ///
    /// # Errors
    ///
    /// If they are not signed or sealed as they must be.
    fn open(
        &mut self,
        side: Side,
        bytes: &[u8],
        out: &mut Vec<u8>,
        reply: &mut Vec<u8>,
    ) -> Result<()>;

    /// How the lines begin that the log has when all is done, with how many frames have passed and were
    /// rejected since the start, by the side that they were sent into.
    fn counters(&self, counts: [Counts; 2]) -> Vec<String>;

    /// Prepares for a reset; gives what is to be on its way into each side then.
    fn reset(&mut self) -> [Vec<u8>; 2];

    /// Whether anything is left over when a phase is over.
    ///
    /// # Errors
    ///
    /// If so.
    fn settled(&self) -> Result<()>;
}

/// What has become of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// They came out on the other side.
    pub passed: usize,
    /// The log has a reason.
    pub rejected: usize,
}

/// What air has done to frames on their way.
#[derive(Clone, Copy, Debug)]
pub struct InAir {
    /// How many were sent.
    pub sent: usize,
    /// How many never arrived.
    pub lost: usize,
    /// How many arrived twice.
    pub doubled: usize,
}

/// A line of a table: frames of one kind.
#[derive(Clone, Debug)]
pub struct Row {
    /// Who gets them.
    pub to: &'static str,
    /// What they are.
    pub name: String,
    /// What came before they arrived, if they went through air.
    pub air: Option<InAir>,
    /// How many arrived.
    pub arrived: usize,
    /// What became of them.
    pub counts: Counts,
    /// Why frames were rejected.
    pub because: &'static str,
}

/// What must become of a frame: these bytes come out on the other side, or it is rejected with this reason.
pub type Verdict = Result<Vec<u8>, &'static str>;

/// What a step sends.
#[derive(Debug, Default)]
pub struct Sending {
    rows: Vec<(Side, Row)>,
    /// Each with its row
    frames: Vec<(usize, Vec<u8>, Verdict)>,
    lines: Vec<&'static str>,
}

impl Sending {
    /// Adds a row, of frames that arrived through `air`; gives its number.
    pub fn row(&mut self, into: Side, name: impl Into<String>, air: Option<InAir>) -> usize {
        let to = match into {
            Side::Local => LOCAL,
            Side::Link => "link side",
        };
        let row = Row {
            to,
            name: name.into(),
            air,
            arrived: 0,
            counts: Counts::default(),
            because: "",
        };
        self.rows.push((into, row));
        self.rows.len() - 1
    }

    /// Adds a frame to a row.
    pub fn frame(&mut self, row: usize, bytes: Vec<u8>, verdict: Verdict) {
        self.frames.push((row, bytes, verdict));
    }

    /// The firmware must log this line.
    pub fn says(&mut self, line: &'static str) {
        self.lines.push(line);
    }

    /// Adds a row of frames that must pass, each with what must come out.
    pub fn passes(
        &mut self,
        into: Side,
        name: impl Into<String>,
        frames: impl IntoIterator<Item = (Vec<u8>, Vec<u8>)>,
    ) {
        let row = self.row(into, name, None);
        for (bytes, out) in frames {
            self.frame(row, bytes, Ok(out));
        }
    }

    /// Adds a row of frames that must be rejected.
    pub fn rejected(
        &mut self,
        into: Side,
        name: impl Into<String>,
        because: &'static str,
        frames: impl IntoIterator<Item = Vec<u8>>,
    ) {
        let row = self.row(into, name, None);
        for bytes in frames {
            self.frame(row, bytes, Err(because));
        }
    }
}

type Step<D> = Box<dyn FnOnce(&mut D, &mut Sending) -> Result<()>>;
type After<D> = Box<dyn FnOnce(&mut D) -> Result<Vec<Row>>>;

/// A part of a play, after which the log is read.
pub struct Phase<D> {
    title: String,
    reset: bool,
    steps: Vec<Step<D>>,
    after: Option<After<D>>,
}

impl<D> Phase<D> {
    /// One in which nothing happens yet.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            reset: false,
            steps: Vec::new(),
            after: None,
        }
    }

    /// It begins with a reset of the board.
    #[must_use]
    pub fn reset(mut self) -> Self {
        self.reset = true;
        self
    }

    /// Then this is sent, into both sides at once, and what must come out and be logged is awaited.
    #[must_use]
    pub fn step(mut self, step: impl FnOnce(&mut D, &mut Sending) -> Result<()> + 'static) -> Self {
        self.steps.push(Box::new(step));
        self
    }

    /// At its end the peers judge what they got.
    #[must_use]
    pub fn after(mut self, after: impl FnOnce(&mut D) -> Result<Vec<Row>> + 'static) -> Self {
        self.after = Some(Box::new(after));
        self
    }
}

/// Plays `phases` with the firmware in `elf`, prints what became of them, and gives the device back.
///
/// # Errors
///
/// If anything came out that must not, or did not that must, or for another reason; the phases after that are
/// not played.
pub fn run<D: Device>(device: D, elf: &Path, phases: Vec<Phase<D>>, log: bool) -> Result<D> {
    let mut stage = Stage::boot(device, elf)?;
    let result = phases.into_iter().try_for_each(|phase| {
        println!("\n{}", phase.title);
        let title = phase.title.clone();
        stage.play(phase).context(title)
    });
    let result = result.and_then(|()| stage.nothing_comes());
    stage.lines.extend(stage.log.try_iter());
    if log || result.is_err() {
        println!("The firmware's log:");
        for run in stage.lines.chunk_by(|a, b| a == b) {
            match run {
                [line] => println!("  {line}"),
                _ => println!("  {}   ({} times)", run[0], run.len()),
            }
        }
    }
    result.map(|()| stage.device)
}

/// One side of the firmware, read and written without waiting.
struct Port {
    stream: TcpStream,
    /// What the firmware has not taken yet
    outbox: Vec<u8>,
}

impl Port {
    fn new(stream: TcpStream) -> Result<Self> {
        stream.set_nonblocking(true)?;
        let outbox = Vec::new();
        Ok(Self { stream, outbox })
    }

    /// Writes what can be written; gives what has come.
    fn turn(&mut self) -> Result<Vec<u8>> {
        while let Some(length) = unless_blocked(self.stream.write(&self.outbox))? {
            self.outbox.drain(..length);
            if self.outbox.is_empty() {
                break;
            }
        }
        let mut came = Vec::new();
        let mut buffer = [0; 4096];
        while let Some(length) = unless_blocked(self.stream.read(&mut buffer))? {
            ensure!(length > 0, "the emulator has ended");
            came.extend(&buffer[..length]);
        }
        Ok(came)
    }
}

fn unless_blocked(result: io::Result<usize>) -> io::Result<Option<usize>> {
    match result {
        Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
        other => other.map(Some),
    }
}

/// The machine and what was seen of it.
struct Stage<D> {
    device: D,
    machine: Machine,
    ports: [Port; 2],
    log: Receiver<String>,
    lines: Vec<String>,
    /// Since the start, by the side that frames were sent into
    counts: [Counts; 2],
    /// Since the phase began
    rows: Vec<(Side, Row)>,
    frames: Vec<(usize, Verdict)>,
    lines_due: Vec<&'static str>,
    first_line: usize,
    ways: [Way; 2],
}

/// What must become, and what has become, of what was sent into one side in a phase.
#[derive(Default)]
struct Way {
    /// Bytes on the other side
    due: Vec<u8>,
    came: Vec<u8>,
    /// Reasons of rejections
    reasons_due: Vec<&'static str>,
    reasons: Vec<String>,
}

impl Way {
    fn is_right_so_far(&self) -> bool {
        let reasons = self.reasons_due.get(..self.reasons.len());
        self.due.starts_with(&self.came) && reasons.is_some_and(|due| *due == self.reasons[..])
    }
}

impl<D: Device> Stage<D> {
    fn boot(device: D, elf: &Path) -> Result<Self> {
        let (machine, [local, link], log) = Machine::boot(elf)?;
        let mut stage = Self {
            device,
            machine,
            ports: [Port::new(local)?, Port::new(link)?],
            log,
            lines: Vec::new(),
            counts: Default::default(),
            rows: Vec::new(),
            frames: Vec::new(),
            lines_due: Vec::new(),
            first_line: 0,
            ways: Default::default(),
        };
        stage.wait_for_start()?;
        Ok(stage)
    }

    fn wait_for_start(&mut self) -> Result<()> {
        loop {
            let line = match self.log.recv_timeout(PATIENCE) {
                Ok(line) => line,
                Err(RecvTimeoutError::Timeout) => bail!("the firmware does not start"),
                Err(RecvTimeoutError::Disconnected) => bail!("the firmware has ended"),
            };
            self.lines.push(line.clone());
            if self.device.started(&line)? {
                return Ok(());
            }
        }
    }

    fn play(&mut self, phase: Phase<D>) -> Result<()> {
        let begun = Instant::now();
        if phase.reset {
            self.reset()?;
        }
        self.rows.clear();
        self.frames.clear();
        self.lines_due.clear();
        self.first_line = self.lines.len();
        self.ways = Default::default();
        for step in phase.steps {
            let mut sending = Sending::default();
            step(&mut self.device, &mut sending)?;
            self.send(sending);
            self.until(|stage| {
                let said = stage.lines_due.iter().all(|line| stage.has_logged(line));
                said && stage.ways.iter().all(|way| way.came.len() >= way.due.len())
            })?;
        }
        if !self.rows.is_empty() {
            self.until(|stage| stage.missing_counters().is_empty())?;
        }
        let mut failures = self.judge();
        let mut missing = self.missing_counters();
        missing.extend(self.lines_due.iter().map(|line| (*line).to_owned()));
        missing.retain(|line| !self.has_logged(line));
        failures.extend(
            missing
                .iter()
                .map(|line| format!("the firmware has not said: {line}")),
        );
        let mut rows: Vec<Row> = self.rows.drain(..).map(|(_, row)| row).collect();
        if let Some(after) = phase.after {
            rows.extend(after(&mut self.device)?);
        }
        println!(
            "{}\n{:.1} s",
            table(&rows, D::PASSED),
            begun.elapsed().as_secs_f32()
        );
        failures.extend(self.device.settled().err().map(|error| error.to_string()));
        ensure!(failures.is_empty(), "{}", failures.join("\n  "));
        Ok(())
    }

    /// Resets the board in the middle of something, and waits until the firmware runs again.
    fn reset(&mut self) -> Result<()> {
        for (port, bytes) in self.ports.iter_mut().zip(self.device.reset()) {
            port.outbox.extend(bytes);
        }
        self.nothing_comes()?;
        self.machine.reset()?;
        self.lines.push("(reset)".to_owned());
        self.counts = Default::default();
        self.wait_for_start().context("after a reset")
    }

    /// Waits for a moment, in which nothing may come out.
    fn nothing_comes(&mut self) -> Result<()> {
        self.ways = Default::default();
        let begun = Instant::now();
        self.until(|_| begun.elapsed() > MOMENT)?;
        let nothing = self.ways.iter().all(Way::is_right_so_far);
        ensure!(
            nothing,
            "something came out of the firmware that nobody sent"
        );
        Ok(())
    }

    fn send(&mut self, sending: Sending) {
        let first = self.rows.len();
        self.rows.extend(sending.rows);
        self.lines_due.extend(sending.lines);
        for (row, bytes, verdict) in sending.frames {
            let (into, row_of) = &mut self.rows[first + row];
            let into = *into as usize;
            row_of.arrived += 1;
            self.ports[into].outbox.extend(bytes);
            match &verdict {
                Ok(out) => {
                    self.counts[into].passed += 1;
                    self.ways[into].due.extend(out);
                }
                Err(because) => {
                    self.counts[into].rejected += 1;
                    self.ways[into].reasons_due.push(because);
                    row_of.because = because;
                }
            }
            self.frames.push((first + row, verdict));
        }
    }

    /// Goes on until everything was written and `done`, or until what comes is wrong, or nothing does. What is
    /// missing then shows in the verdict.
    fn until(&mut self, done: impl Fn(&Self) -> bool) -> Result<()> {
        let mut last = (Instant::now(), Vec::new());
        while last.0.elapsed() < PATIENCE {
            self.turn()?;
            let written = self.ports.iter().all(|port| port.outbox.is_empty());
            if written && done(self) || !self.ways.iter().all(Way::is_right_so_far) {
                return Ok(());
            }
            let unsent = self.ports.iter().map(|port| port.outbox.len());
            let came = self
                .ways
                .iter()
                .flat_map(|way| [way.came.len(), way.reasons.len()]);
            let progress: Vec<usize> = unsent.chain(came).collect();
            if progress != last.1 {
                last = (Instant::now(), progress);
            }
            thread::sleep(POLL);
        }
        let written = self.ports.iter().all(|port| port.outbox.is_empty());
        ensure!(written, "the firmware takes no more bytes");
        Ok(())
    }

    /// Takes what has come.
    fn turn(&mut self) -> Result<()> {
        for side in Side::BOTH {
            let port = &mut self.ports[side as usize];
            let bytes = port.turn()?;
            let came = &mut self.ways[side.other() as usize].came;
            self.device.open(side, &bytes, came, &mut port.outbox)?;
        }
        while let Ok(line) = self.log.try_recv() {
            self.lines.push(line.clone());
            let fault = line.contains("[WARN ]") || line.contains("[ERROR]");
            ensure!(!fault, "the firmware says: {line}");
            for side in Side::BOTH {
                if let Some(run) = line.strip_prefix(side.rejected()) {
                    let run = run
                        .strip_suffix(" times")
                        .and_then(|run| run.rsplit_once(", "));
                    let (reason, times) = run.with_context(|| line.clone())?;
                    let reasons = vec![reason.to_owned(); times.parse()?];
                    self.ways[side as usize].reasons.extend(reasons);
                }
            }
        }
        Ok(())
    }

    /// The counters that the log must have in this phase, and has not.
    fn missing_counters(&self) -> Vec<String> {
        let mut counters = self.device.counters(self.counts);
        counters.retain(|counter| !self.has_logged(counter));
        counters
    }

    fn has_logged(&self, beginning: &str) -> bool {
        let mut lines = self.lines[self.first_line..].iter();
        lines.any(|line| line.starts_with(beginning))
    }

    /// Counts what became of the frames of each row; gives what is wrong with that.
    fn judge(&mut self) -> Vec<String> {
        let mut failures = Vec::new();
        for side in Side::BOTH {
            let way = &self.ways[side as usize];
            let mut came = &way.came[..];
            let mut reasons = way.reasons.iter();
            for (row, verdict) in &self.frames {
                let (into, row) = &mut self.rows[*row];
                match verdict {
                    _ if *into != side => {}
                    Ok(out) => {
                        if let Some(rest) = came.strip_prefix(&out[..]) {
                            came = rest;
                            row.counts.passed += 1;
                        }
                    }
                    Err(because) => match reasons.next() {
                        Some(reason) if reason == because => row.counts.rejected += 1,
                        Some(reason) => {
                            let wrong = format!("{}: rejected because {reason}", row.name);
                            failures.push(wrong + ", not because " + because);
                        }
                        None => {}
                    },
                }
            }
            if !came.is_empty() {
                failures.push(format!(
                    "{} bytes came out that must not, {side:?}",
                    came.len()
                ));
            }
            if let Some(reason) = reasons.next() {
                failures.push(format!("{side:?}: a rejection too many: {reason}"));
            }
        }
        failures.dedup();
        for (
            _,
            Row {
                name,
                arrived,
                counts,
                ..
            },
        ) in &self.rows
        {
            let Counts { passed, rejected } = counts;
            if passed + rejected != *arrived {
                failures.push(format!(
                    "{name}: of {arrived} frames {passed} passed, {rejected} were rejected, as they must"
                ));
            }
        }
        failures
    }
}

/// A table of `rows`; what passes has its name if all were sent into one side.
fn table(rows: &[Row], passed: [&str; 2]) -> Table {
    let first = rows.first().map_or("", |row| row.to);
    let several = rows.iter().any(|row| row.to != first);
    let air = rows.iter().any(|row| row.air.is_some());
    let passed = match first {
        _ if several => "passed",
        LOCAL => passed[0],
        _ => passed[1],
    };
    let mut table = Table::new();
    table.load_preset(presets::NOTHING);
    let columns =
        |to: &str, name: &str, [sent, lost, doubled, arrived]: [String; 4], rest: [&str; 3]| {
            let to = several.then(|| to.to_owned());
            let air = if air {
                vec![sent, lost, doubled, arrived]
            } else {
                vec![arrived]
            };
            let rest = rest.map(str::to_owned);
            to.into_iter()
                .chain([name.to_owned()])
                .chain(air)
                .chain(rest)
                .collect::<Vec<_>>()
        };
    let air_names = [
        "sent",
        "lost",
        "doubled",
        if air { "arrived" } else { "frames" },
    ];
    table.set_header(columns(
        "into",
        "what",
        air_names.map(str::to_owned),
        [passed, "rejected", "because"],
    ));
    for row in rows {
        let way = row.air.unwrap_or(InAir {
            sent: row.arrived,
            lost: 0,
            doubled: 0,
        });
        let numbers =
            [way.sent, way.lost, way.doubled, row.arrived].map(|number| number.to_string());
        let [passed, rejected] =
            [row.counts.passed, row.counts.rejected].map(|number| number.to_string());
        table.add_row(columns(
            row.to,
            &row.name,
            numbers,
            [&passed, &rejected, row.because],
        ));
    }
    let names = 1 + usize::from(several);
    let numbers = table
        .column_iter_mut()
        .skip(names)
        .take(if air { 6 } else { 3 });
    numbers.for_each(|column| column.set_cell_alignment(CellAlignment::Right));
    table
}
