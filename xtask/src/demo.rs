//! `cargo xtask demo`: recorded telemetry through the signer on an emulated Cortex-M7.

mod restart;
mod seal;
pub(crate) mod wire;

use std::{
    fs,
    io::{Read, Write},
    net::TcpStream,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
        mpsc::{self, Receiver, Sender},
    },
    thread,
    time::{Duration, Instant, SystemTime},
};

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use comfy_table::{CellAlignment, Table, presets};
use mavseal_chips_host::{Chip, Image};

use crate::qemu::Machine;
use wire::Frame;

/// The link ids that the firmware signs and verifies with: `chips/qemu-m7/src/bin/relay.rs`.
const LINK_OUT: u8 = 1;
const LINK_IN: u8 = 2;
/// How far the peer's clock is behind this machine's, so that it is never ahead of the firmware's.
const BEHIND: Duration = Duration::from_millis(500);
const TICKS_PER_SECOND: u64 = 100_000;
/// How long the firmware may say nothing while something is expected of it.
const MAX_DELAY: Duration = Duration::from_secs(6);
/// Frames of each kind that must be rejected.
const EACH: usize = 25;
/// Authentic frames from the peer, before and again after those.
const FROM_PEER: usize = 200;

/// Options of `cargo xtask demo`.
#[derive(Args)]
pub(crate) struct Options {
    /// Which firmware to boot; with the echo, which signs nothing, the demonstration fails
    #[arg(long, value_enum, default_value = "relay")]
    firmware: Firmware,
    /// Instead, reset the machine again and again while the link is in use and its key is changed
    #[arg(long, conflicts_with = "firmware")]
    restart: bool,
    /// Instead, seal: one vehicle and two ground stations, over links that lose, double and reorder
    #[arg(long, conflicts_with_all = ["firmware", "restart"])]
    seal: bool,
    /// With --seal: what the links do, as an earlier run printed it
    #[arg(long, requires = "seal")]
    seed: Option<u64>,
    /// With --seal: give the stations other keys than the vehicle; the demonstration fails
    #[arg(long, requires = "seal")]
    other_keys: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Firmware {
    Relay,
    Echo,
}

/// Runs the demonstration.
///
/// # Errors
/// If anything came out that should not have, or did not come out that should have.
pub(crate) fn run(options: &Options) -> Result<()> {
    if options.seal {
        return seal::run(options.seed, options.other_keys);
    }
    let bin = match options.firmware {
        Firmware::Relay => "relay",
        Firmware::Echo => "echo",
    };
    let elf = Image::logging(Chip::QemuM7, bin, "ardupilotmega").build()?;
    if options.restart {
        return restart::run(&elf);
    }
    let telemetry = wire::telemetry()?;
    let mut demo = Demo::boot(&elf)?;

    println!(
        "Local side: {} frames of recorded telemetry, and what must not be signed",
        telemetry.len()
    );
    let signed = demo.sign(&telemetry)?;
    println!("Link side: the peer, and what it must not get through");
    demo.verify(&telemetry, &signed)?;
    demo.finish()
}

/// What is sent as one kind, and what must become of it.
struct Act {
    name: &'static str,
    frames: usize,
    /// Why the firmware must reject it; `None` if it must pass it on.
    rejection: Option<&'static str>,
    passed: usize,
    rejected: usize,
}

/// A way through the firmware, by the name that it has in the log.
#[derive(Clone, Copy, Debug)]
enum Direction {
    Outbound,
    Inbound,
}

impl Direction {
    /// How the line with this direction's counters begins.
    fn summary(self) -> &'static str {
        match self {
            Self::Outbound => "[INFO ] signed: ",
            Self::Inbound => "[INFO ] verified: ",
        }
    }

    /// The reason in a line about rejections in this direction, and how often it was given in a row.
    fn rejections(self, line: &str) -> Option<(String, usize)> {
        let said = line.strip_prefix(&format!("[INFO ] {self:?} rejected: "))?;
        let (reason, times) = said.strip_suffix(" times")?.rsplit_once(", ")?;
        Some((reason.to_owned(), times.parse().ok()?))
    }
}

/// The firmware and what it has been seen to do.
struct Demo {
    machine: Machine,
    local: Port,
    link: Port,
    log: Receiver<String>,
    lines: Vec<String>,
    key: Vec<u8>,
    last_stamp: u64,
    outbound: Vec<Act>,
    inbound: Vec<Act>,
    failures: Vec<String>,
    started: Instant,
}

impl Demo {
    fn boot(elf: &Path) -> Result<Self> {
        let key = Path::new(env!("CARGO_MANIFEST_DIR")).with_file_name("chips/demo/demo.key");
        let key = fs::read(&key).with_context(|| key.display().to_string())?;
        let (machine, [local, link], log) = Machine::boot_between(elf)?;
        let mut demo = Self {
            machine,
            local: Port::new(local)?,
            link: Port::new(link)?,
            log,
            lines: Vec::new(),
            key,
            last_stamp: 0,
            outbound: Vec::new(),
            inbound: Vec::new(),
            failures: Vec::new(),
            started: Instant::now(),
        };
        // It speaks when its clock is set and its ports are open.
        let line = demo.log.recv_timeout(MAX_DELAY);
        demo.lines.push(line.context("the firmware says nothing")?);
        demo.started = Instant::now();
        Ok(demo)
    }

    /// Telemetry and things that must not be signed, into the local side; gives the signed frames.
    fn sign(&mut self, telemetry: &[Frame]) -> Result<Vec<Frame>> {
        let mut acts = Acts::new(telemetry);
        acts.add("recorded telemetry", None, telemetry.to_vec());
        acts.add("damaged", Some("bad checksum"), acts.damaged());
        acts.add(
            "unknown message",
            Some("unknown message"),
            acts.unknown_message(),
        );
        acts.add("MAVLink 1", Some("MAVLink 1"), mavlink1());
        let key = &self.key;
        let already = acts.local(|frame| wire::sign(frame, key, LINK_OUT, ticks_now()));
        acts.add("already signed", Some("already signed"), already);

        let begun = ticks_now();
        let came = exchange(
            &mut self.local,
            &mut self.link,
            acts.stream(),
            telemetry.len(),
        )?;
        let mut last = 0;
        for (at, frame) in came.frames.iter().enumerate() {
            let Some(original) = telemetry.get(at) else {
                break;
            };
            if frame[2] & 1 == 0 {
                self.failures
                    .push(format!("frame {at} left the link side unsigned"));
                break;
            }
            let ticks = wire::ticks(frame);
            if *frame != wire::sign(original, &self.key, LINK_OUT, ticks) {
                self.failures
                    .push(format!("frame {at} is not the telemetry's, signed"));
            }
            // The firmware was told the time to the second.
            let earliest = begun - 2 * TICKS_PER_SECOND;
            let off = earliest.saturating_sub(ticks) + ticks.saturating_sub(ticks_now());
            if off > 0 {
                self.failures
                    .push(format!("frame {at} is stamped {off} ticks off"));
            }
            if ticks <= last {
                self.failures
                    .push(format!("the stamp of frame {at} is not newer"));
            }
            last = ticks;
        }
        self.failures.extend(came.failure);
        self.outbound = self.judge(acts, Direction::Outbound, came.frames.len());
        Ok(came.frames)
    }

    /// The peer's frames and everything that must not pass, into the link side.
    fn verify(&mut self, telemetry: &[Frame], reflected: &[Frame]) -> Result<()> {
        let key = self.key.clone();
        let mut acts = Acts::new(telemetry);
        let mut stamp = || {
            let ticks = ticks_now() - ticks_in(BEHIND);
            self.last_stamp = ticks.max(self.last_stamp + 1);
            self.last_stamp
        };
        let mut sign = |frames: &[Frame]| -> Vec<Frame> {
            let frames = frames.iter();
            frames
                .map(|frame| wire::sign(frame, &key, LINK_IN, stamp()))
                .collect()
        };
        // They are stamped before they are sent: all of them must arrive within the window.
        let telemetry = &telemetry[..2 * FROM_PEER];
        let (first, then) = telemetry.split_at(FROM_PEER);
        let authentic = sign(first);
        let forge = |forge: &dyn Fn(&mut Frame)| {
            acts.local(|frame| {
                let mut signed = wire::sign(frame, &key, LINK_IN, ticks_now());
                forge(&mut signed);
                signed
            })
        };
        let payload = forge(&|frame| {
            frame[10] ^= 1;
            wire::repair(frame);
        });
        let tag = forge(&|frame| flip(frame, 1));
        let link = forge(&|frame| flip(frame, 13));
        let ticks = forge(&|frame| flip(frame, 12));
        let other_key = acts.local(|frame| wire::sign(frame, &[0x5A; 32], LINK_IN, ticks_now()));
        let other_link = acts.local(|frame| wire::sign(frame, &key, 3, ticks_now()));
        let future = ticks_now() + 120 * TICKS_PER_SECOND;
        let future = acts.local(|frame| wire::sign(frame, &key, LINK_IN, future));
        let old = ticks_now() - 61 * TICKS_PER_SECOND;
        let old = acts.local(|frame| wire::sign(frame, &key, LINK_IN, old));
        let replayed = authentic.iter().take(EACH).cloned().collect();
        let reflected = reflected.iter().take(EACH).cloned().collect();

        acts.add("authentic, from the peer", None, authentic);
        acts.add("the same again", Some("replayed"), replayed);
        acts.add("own frames, reflected", Some("wrong link"), reflected);
        acts.add("made for another link", Some("wrong link"), other_link);
        acts.add(
            "payload changed, checksum repaired",
            Some("bad tag"),
            payload,
        );
        acts.add("tag changed", Some("bad tag"), tag);
        acts.add("link id changed", Some("bad tag"), link);
        acts.add("timestamp changed", Some("bad tag"), ticks);
        acts.add("another key", Some("bad tag"), other_key);
        acts.add("stamped two minutes ahead", Some("from the future"), future);
        acts.add("stamped 61 seconds ago", Some("too old"), old);
        acts.add("unsigned", Some("not signed"), acts.local(<[u8]>::to_vec));
        acts.add("damaged", Some("bad checksum"), acts.damaged());
        acts.add("MAVLink 1", Some("MAVLink 1"), mavlink1());
        // None of it has moved the receiver's clock or window.
        acts.add("authentic, after all that", None, sign(then));

        let came = exchange(
            &mut self.link,
            &mut self.local,
            acts.stream(),
            telemetry.len(),
        )?;
        for (at, frame) in came.frames.iter().enumerate() {
            if telemetry.get(at) != Some(frame) {
                self.failures
                    .push(format!("frame {at} on the local side is not the peer's"));
            }
        }
        self.failures.extend(came.failure);
        self.inbound = self.judge(acts, Direction::Inbound, came.frames.len());
        Ok(())
    }

    /// Compares the firmware's log with what had to be rejected, in order, and with its counters.
    fn judge(&mut self, acts: Acts, direction: Direction, passed: usize) -> Vec<Act> {
        let mut acts = acts.acts;
        let expected: Vec<&str> = acts
            .iter()
            .flat_map(|act| act.rejection.map(|rejection| vec![rejection; act.frames]))
            .flatten()
            .collect();
        let counted = format!(
            "{}{passed}, rejected: {}, ",
            direction.summary(),
            expected.len()
        );
        let mut said = Vec::new();
        let mut summary = String::new();
        // The counters come after a second of silence, which may also have been this machine's.
        while !summary.starts_with(&counted) {
            let Ok(line) = self.log.recv_timeout(MAX_DELAY) else {
                self.failures.push(format!(
                    "{direction:?}: the firmware counted {summary:?}, not {counted:?}"
                ));
                break;
            };
            if let Some((reason, times)) = direction.rejections(&line) {
                said.extend(vec![reason; times]);
            }
            if line.starts_with(direction.summary()) {
                summary.clone_from(&line);
            }
            self.lines.push(line);
        }
        if said != expected {
            self.failures.push(format!(
                "{direction:?}: {} rejections expected, {} logged, or for other reasons",
                expected.len(),
                said.len()
            ));
        }
        let mut said = said.into_iter();
        let mut passed = passed;
        for act in &mut acts {
            match act.rejection {
                None => {
                    act.passed = passed.min(act.frames);
                    passed -= act.passed;
                }
                Some(rejection) => {
                    let of_this = said.by_ref().take(act.frames);
                    act.rejected = of_this.filter(|reason| reason == rejection).count();
                }
            }
            let done = if act.rejection.is_some() {
                act.rejected
            } else {
                act.passed
            };
            if done != act.frames {
                self.failures
                    .push(format!("{}: {done} of {} frames", act.name, act.frames));
            }
        }
        if passed > 0 {
            self.failures.push(format!(
                "{direction:?}: {passed} frames passed that must not"
            ));
        }
        acts
    }

    /// Prints the log and the table; fails if anything was not as it must be.
    fn finish(mut self) -> Result<()> {
        let took = self.started.elapsed();
        for (side, port) in [("plain", &self.local), ("secure", &self.link)] {
            let late: usize = port.bytes.try_iter().map(|bytes| bytes.len()).sum();
            if late > 0 {
                self.failures
                    .push(format!("{late} bytes too many on the {side} side"));
            }
        }
        self.machine.stop()?;
        self.lines.extend(self.log.try_iter());
        println!("\nThe firmware's log:");
        print_log(&self.lines);
        println!(
            "\nInto the local side:\n{}",
            table("signed", &self.outbound)
        );
        println!(
            "\nInto the link side:\n{}",
            table("verified", &self.inbound)
        );
        println!(
            "\nplain side:  {} bytes in, {} bytes out\nsecure side: {} bytes in, {} bytes out\ntime: {:.1} s",
            self.local.sent,
            self.local.received,
            self.link.sent,
            self.link.received,
            took.as_secs_f32(),
        );
        ensure!(
            self.failures.is_empty(),
            "the demonstration failed:\n  {}",
            self.failures.join("\n  ")
        );
        println!("Every frame was as it had to be.");
        Ok(())
    }
}

/// What is sent into one side, in order.
struct Acts {
    acts: Vec<Act>,
    frames: Vec<Frame>,
    /// Frames without a byte inside that looks like the beginning of another, so that a damaged
    /// one is rejected once and not again for what it seems to contain.
    samples: Vec<Frame>,
}

impl Acts {
    fn new(telemetry: &[Frame]) -> Self {
        let samples: Vec<Frame> = telemetry
            .iter()
            .filter(|frame| !frame[1..].iter().any(|byte| [0xFD, 0xFE].contains(byte)))
            .take(EACH)
            .cloned()
            .collect();
        assert_eq!(samples.len(), EACH, "the telemetry is long enough");
        Self {
            acts: Vec::new(),
            frames: Vec::new(),
            samples,
        }
    }

    fn add(&mut self, name: &'static str, rejection: Option<&'static str>, frames: Vec<Frame>) {
        self.acts.push(Act {
            name,
            frames: frames.len(),
            rejection,
            passed: 0,
            rejected: 0,
        });
        self.frames.extend(frames);
    }

    fn stream(&self) -> Vec<u8> {
        self.frames.concat()
    }

    fn local(&self, make: impl FnMut(&[u8]) -> Frame) -> Vec<Frame> {
        self.samples.iter().map(Vec::as_slice).map(make).collect()
    }

    fn damaged(&self) -> Vec<Frame> {
        self.local(|frame| {
            let mut frame = frame.to_vec();
            frame[10] ^= 0x40;
            frame
        })
    }

    fn unknown_message(&self) -> Vec<Frame> {
        self.local(|frame| {
            let mut frame = frame.to_vec();
            frame[7..10].copy_from_slice(&[0xF0, 0xF0, 0xF0]);
            frame
        })
    }
}

/// Changes the byte that is `from_end` bytes from the end.
fn flip(frame: &mut Frame, from_end: usize) {
    let at = frame.len() - from_end;
    frame[at] ^= 1;
}

/// HEARTBEATs of MAVLink 1.
fn mavlink1() -> Vec<Frame> {
    let heartbeat = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];
    vec![heartbeat.to_vec(); EACH]
}

/// This machine's time, in signing time.
fn ticks_now() -> u64 {
    let epoch = SystemTime::UNIX_EPOCH + Duration::from_secs(1_420_070_400);
    // A clock before 2015 shows in the first verdict.
    ticks_in(SystemTime::now().duration_since(epoch).unwrap_or_default())
}

fn ticks_in(duration: Duration) -> u64 {
    (duration.as_micros() / 10) as u64
}

/// One side of the firmware, read and written by threads of its own.
struct Port {
    stream: TcpStream,
    received: usize,
    sent: usize,
    bytes: Receiver<Vec<u8>>,
    outbox: Sender<Vec<u8>>,
    written: Arc<AtomicUsize>,
}

impl Port {
    fn new(stream: TcpStream) -> Result<Self> {
        let mut reader = stream.try_clone()?;
        let (send, bytes) = mpsc::channel();
        thread::spawn(move || {
            let mut buffer = [0; 4096];
            // Ends with the emulator, or when nobody listens any more.
            while let Ok(length @ 1..) = reader.read(&mut buffer) {
                if send.send(buffer[..length].to_vec()).is_err() {
                    break;
                }
            }
        });
        let mut writer = stream.try_clone()?;
        let (outbox, to_send) = mpsc::channel::<Vec<u8>>();
        let written = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&written);
        thread::spawn(move || {
            for bytes in to_send {
                // Ends with the emulator; then what was sent is never written.
                if writer.write_all(&bytes).is_err() {
                    break;
                }
                count.fetch_add(bytes.len(), Ordering::Relaxed);
            }
        });
        Ok(Self {
            stream,
            received: 0,
            sent: 0,
            bytes,
            outbox,
            written,
        })
    }

    /// Sends `bytes` after everything before, without waiting until they are taken.
    fn send(&mut self, bytes: Vec<u8>) -> Result<()> {
        self.sent += bytes.len();
        self.outbox.send(bytes).context("the emulator has ended")
    }

    /// Whether everything that was sent has been taken.
    fn is_written(&self) -> bool {
        self.written.load(Ordering::Relaxed) == self.sent
    }

    /// The bytes that come within `wait`.
    fn receive(&mut self, wait: Duration) -> Option<Vec<u8>> {
        let bytes = self.bytes.recv_timeout(wait).ok()?;
        self.received += bytes.len();
        Some(bytes)
    }
}

/// The frames that came, and why no more are looked at.
struct Came {
    frames: Vec<Frame>,
    failure: Option<String>,
}

/// Sends `stream` into one port and collects what comes out of the other, until nothing more does.
fn exchange(into: &mut Port, out_of: &mut Port, stream: Vec<u8>, expected: usize) -> Result<Came> {
    into.send(stream)?;
    let mut came = Came {
        frames: Vec::new(),
        failure: None,
    };
    let mut pending = Vec::new();
    loop {
        // When all has come, only a moment for what must not come.
        let all = came.frames.len() >= expected && into.is_written();
        let Some(bytes) = out_of.receive(if all { MAX_DELAY / 20 } else { MAX_DELAY }) else {
            break;
        };
        pending.extend(bytes);
        match wire::take_frames(&mut pending) {
            Ok(frames) => came.frames.extend(frames),
            Err(error) if came.failure.is_none() => came.failure = Some(error.to_string()),
            Err(_) => {}
        }
    }
    if !into.is_written() {
        came.failure = Some("the firmware takes no more bytes".into());
        // Ends the write.
        into.stream.shutdown(std::net::Shutdown::Both)?;
    }
    if !pending.is_empty() {
        came.failure.get_or_insert("half a frame came out".into());
    }
    Ok(came)
}

/// The log, equal lines in a row as one.
fn print_log(lines: &[String]) {
    for run in lines.chunk_by(|a, b| a == b) {
        match run {
            [line] => println!("  {line}"),
            _ => println!("  {}   ({} times)", run[0], run.len()),
        }
    }
}

fn table(passed: &str, acts: &[Act]) -> Table {
    let rows = acts.iter().map(|act| Row {
        name: act.name.to_owned(),
        counts: [act.frames, act.passed, act.rejected],
        because: act.rejection.unwrap_or_default().to_owned(),
    });
    summed(["frames", passed, "rejected"], rows)
}

/// A line of a table: what was sent, what became of it, and why not more.
#[derive(Clone, Debug)]
struct Row<const COUNTS: usize> {
    name: String,
    counts: [usize; COUNTS],
    because: String,
}

/// A table of `rows` and their sums, with these names above the counts.
fn summed<const COUNTS: usize>(
    names: [&str; COUNTS],
    rows: impl IntoIterator<Item = Row<COUNTS>>,
) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::NOTHING);
    let header = ["sent"].into_iter().chain(names).chain(["because"]);
    table.set_header(header);
    let mut sums = [0; COUNTS];
    let mut add = |name: String, counts: [usize; COUNTS], because: String| {
        let counts = counts.map(|count| count.to_string());
        table.add_row([name].into_iter().chain(counts).chain([because]));
    };
    for row in rows {
        for (sum, count) in sums.iter_mut().zip(row.counts) {
            *sum += count;
        }
        add(row.name, row.counts, row.because);
    }
    add("all".to_owned(), sums, String::new());
    for column in 1..=COUNTS {
        if let Some(column) = table.column_mut(column) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}
