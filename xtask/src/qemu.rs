//! Firmware in QEMU: boots an ELF file, gives its serial ports and decodes its log.

use std::{
    fmt, fs,
    io::{BufRead, BufReader, ErrorKind, Read, Write as _},
    net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::mpsc::{self, Receiver},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::Args;
use defmt_decoder::{DecodeError, Table};

use crate::setup;

/// How long QEMU may take to connect its serial ports, which it does before it runs the firmware.
const START: Duration = Duration::from_secs(20);
const POLL: Duration = Duration::from_millis(5);

/// Options of `cargo xtask run-qemu`.
#[derive(Args)]
pub(crate) struct Options {
    /// The firmware, an ELF file
    elf: PathBuf,
    /// Give up after this many seconds
    #[arg(long, value_name = "SECONDS")]
    timeout: Option<u64>,
    /// The TCP port of this machine that UART 0 listens on; a second time for UART 1
    #[arg(long, value_name = "PORT")]
    serial: Vec<u16>,
}

/// Runs firmware, prints its log, and exits with its status.
///
/// # Errors
/// If QEMU does not start, or the firmware has not ended in time.
pub(crate) fn run(options: &Options) -> Result<()> {
    let serial: Vec<String> = match options.serial[..] {
        [] => vec!["null".into(); 2],
        ref ports => ports
            .iter()
            .map(|port| format!("tcp:127.0.0.1:{port},server=on,wait=off,nodelay=on"))
            .collect(),
    };
    let mut machine = Machine::launch(&options.elf, &serial, None, |line| println!("{line}"))?;
    let status = machine.wait(options.timeout.map(Duration::from_secs))?;
    std::process::exit(status.code().unwrap_or(1));
}

/// A running emulator; ends with the value.
pub(crate) struct Machine {
    /// UART0, UART1 and so on; taken by whoever reads or writes them
    pub(crate) serial: Vec<TcpStream>,
    child: Child,
    /// QEMU's machine protocol
    control: Option<BufReader<TcpStream>>,
    log: Option<JoinHandle<Result<()>>>,
}

/// One entry of the firmware's log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Line {
    /// None where the firmware defines no `defmt::timestamp!`
    pub(crate) timestamp: Option<String>,
    /// `trace` to `error`; None for `defmt::println!` and for plain text
    pub(crate) level: Option<&'static str>,
    pub(crate) message: String,
}

impl Line {
    fn text(message: impl Into<String>) -> Line {
        Line {
            timestamp: None,
            level: None,
            message: message.into(),
        }
    }
}

impl fmt::Display for Line {
    /// As `defmt-print` has it: `[INFO ] message`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(timestamp) = &self.timestamp {
            write!(f, "{timestamp} ")?;
        }
        if let Some(level) = self.level {
            write!(f, "[{:<5}] ", level.to_uppercase())?;
        }
        f.write_str(&self.message)
    }
}

impl Machine {
    /// Boots an ELF file on the machine mps2-an500 with the first `ports` UARTs connected.
    ///
    /// `on_line` gets each line of the log, in a thread of its own.
    ///
    /// # Errors
    /// If there is no QEMU, or it ends before it has connected the ports.
    pub(crate) fn boot(
        elf: &Path,
        ports: usize,
        on_line: impl FnMut(Line) + Send + 'static,
    ) -> Result<Machine> {
        // We listen and QEMU connects: no port is ever free for another to take.
        let mut listeners = Vec::new();
        let mut serial = Vec::new();
        for _ in 0..ports {
            let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
            serial.push(format!("tcp:{},nodelay=on", listener.local_addr()?));
            listeners.push(listener);
        }
        let control = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
        let mut machine = Self::launch(elf, &serial, Some(control.local_addr()?), on_line)?;
        let mut control = machine.accept(&control)?;
        // QEMU takes no other command before this one.
        writeln!(control, r#"{{"execute": "qmp_capabilities"}}"#)?;
        machine.control = Some(BufReader::new(control));
        for listener in listeners {
            let stream = machine.accept(&listener)?;
            machine.serial.push(stream);
        }
        Ok(machine)
    }

    /// Boots an ELF file with both of its UARTs connected; gives them too, and the lines of its log.
    ///
    /// # Errors
    /// As [`Machine::boot`].
    pub(crate) fn boot_between(elf: &Path) -> Result<(Machine, [TcpStream; 2], Receiver<String>)> {
        let (send, log) = mpsc::channel();
        // The receiver is gone only when nobody wants to know any more.
        let mut machine = Machine::boot(elf, 2, move |line| drop(send.send(line.to_string())))?;
        let ports = std::mem::take(&mut machine.serial).try_into();
        Ok((machine, ports.ok().context("two serial ports")?, log))
    }

    /// Resets the board as its button does: the program starts anew, RAM stays as it is.
    ///
    /// # Errors
    /// If QEMU does not say that it has.
    pub(crate) fn reset(&mut self) -> Result<()> {
        let control = self.control.as_mut().context("booted without control")?;
        writeln!(control.get_mut(), r#"{{"execute": "system_reset"}}"#)?;
        let mut line = String::new();
        while !line.contains("\"RESET\"") {
            line.clear();
            ensure!(control.read_line(&mut line)? > 0, "QEMU has ended");
            ensure!(!line.contains("\"error\""), "QEMU: {line}");
        }
        Ok(())
    }

    /// Boots an ELF file with its UARTs where `serial` says, in QEMU's words; QEMU asks for commands at
    /// `control`.
    fn launch(
        elf: &Path,
        serial: &[String],
        control: Option<SocketAddr>,
        on_line: impl FnMut(Line) + Send + 'static,
    ) -> Result<Machine> {
        let qemu = {
            setup::qemu()?;
            "qemu-system-arm"
        };
        let data = fs::read(elf).with_context(|| elf.display().to_string())?;
        let table = Table::parse(&data).with_context(|| format!("the log of {}", elf.display()))?;

        let mut command = Command::new(qemu);
        command.args([
            "-machine",
            "mps2-an500",
            "-display",
            "none",
            "-monitor",
            "none",
        ]);
        command
            .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
            .arg(elf);
        for port in serial {
            command.args(["-serial", port]);
        }
        if let Some(address) = control {
            command.args(["-qmp", &format!("tcp:{address}")]);
        }
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().context("QEMU cannot be run")?;
        let stdout = child.stdout.take().context("QEMU's output")?;
        let log = thread::spawn(move || read_log(stdout, table.as_ref(), on_line));
        Ok(Machine {
            serial: Vec::new(),
            child,
            control: None,
            log: Some(log),
        })
    }

    /// Waits for the firmware to end; gives the status it ended with, after its whole log was read.
    ///
    /// # Errors
    /// If it has not ended in time; it is ended then.
    pub(crate) fn wait(&mut self, timeout: Option<Duration>) -> Result<ExitStatus> {
        let start = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait()? {
                break status;
            }
            if let Some(timeout) = timeout.filter(|timeout| start.elapsed() >= *timeout) {
                self.stop()?;
                bail!(
                    "the firmware has not ended within {} s",
                    timeout.as_secs_f32()
                );
            }
            thread::sleep(POLL);
        };
        self.finish_log()?;
        Ok(status)
    }

    /// Ends the machine, whatever the firmware does; the log up to then has been read.
    ///
    /// # Errors
    /// If the log could not be decoded.
    pub(crate) fn stop(&mut self) -> Result<()> {
        // An error means that it has ended by itself.
        let _ = self.child.kill();
        self.child.wait()?;
        self.finish_log()
    }

    fn finish_log(&mut self) -> Result<()> {
        let Some(log) = self.log.take() else {
            return Ok(());
        };
        log.join()
            .map_err(|_| anyhow!("the reader of the log panicked"))?
    }

    fn accept(&mut self, listener: &TcpListener) -> Result<TcpStream> {
        listener.set_nonblocking(true)?;
        let start = Instant::now();
        loop {
            match listener.accept() {
                Ok((stream, _)) => {
                    stream.set_nonblocking(false)?;
                    stream.set_nodelay(true)?;
                    return Ok(stream);
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Err(error.into()),
            }
            if let Some(status) = self.child.try_wait()? {
                bail!("QEMU did not start ({status})");
            }
            ensure!(
                start.elapsed() < START,
                "QEMU has not connected its serial ports"
            );
            thread::sleep(POLL);
        }
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        // Nobody is left to hear of a broken log.
        let _ = self.stop();
    }
}

/// Reads standard output to its end: defmt's frames where there is a table, otherwise text.
pub(crate) fn read_log(
    mut output: impl Read,
    table: Option<&Table>,
    mut on_line: impl FnMut(Line),
) -> Result<()> {
    let Some(table) = table else {
        for line in BufReader::new(output).split(b'\n') {
            on_line(Line::text(String::from_utf8_lossy(&line?)));
        }
        return Ok(());
    };
    let mut decoder = table.new_stream_decoder();
    let mut buffer = [0; 1024];
    loop {
        let length = output.read(&mut buffer)?;
        if length == 0 {
            return Ok(());
        }
        decoder.received(&buffer[..length]);
        loop {
            match decoder.decode() {
                Ok(frame) => on_line(Line {
                    timestamp: frame
                        .display_timestamp()
                        .map(|timestamp| timestamp.to_string()),
                    level: frame.level().map(|level| level.as_str()),
                    message: frame.display_message().to_string(),
                }),
                Err(DecodeError::UnexpectedEof) => break,
                Err(DecodeError::Malformed) => {
                    ensure!(table.encoding().can_recover(), "the log is malformed");
                    on_line(Line::text("(a malformed frame)"));
                }
            }
        }
    }
}
