//! Firmware in QEMU: boots an ELF file, gives its serial ports and its log.

use std::{
    env, fs,
    io::{BufRead, BufReader, ErrorKind, Read, Write as _},
    net::{Ipv4Addr, TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::mpsc::{self, Receiver},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context, Result, anyhow, bail, ensure};
use defmt_decoder::{DecodeError, Frame, Table};

use crate::wire;

/// The machine that `chips/qemu-m7` is for: MPS2 with the AN500 image, a Cortex-M7.
const MACHINE: &str = "mps2-an500";
const PROGRAM: &str = "qemu-system-arm";
/// How long QEMU may take to connect its serial ports, which it does before it runs the firmware.
const START: Duration = Duration::from_secs(20);
const POLL: Duration = Duration::from_millis(5);

/// A running emulator. It ends with the value, and with this process however that ends.
pub struct Machine {
    child: Child,
    /// QEMU's machine protocol
    control: Option<BufReader<TcpStream>>,
    log: Option<JoinHandle<Result<()>>>,
}

impl Machine {
    /// Boots an ELF file with UART 0 and UART 1 connected; gives them, and the lines of the log.
    ///
    /// # Errors
    ///
    /// If there is no QEMU, or it ends before it has connected the ports.
    pub fn boot(elf: &Path) -> Result<(Self, [TcpStream; 2], Receiver<String>)> {
        // We listen and QEMU connects: no port is ever free for another program to take.
        let listen = || TcpListener::bind((Ipv4Addr::LOCALHOST, 0));
        let [first, second, control] = [listen()?, listen()?, listen()?];
        let mut serial = Vec::new();
        for listener in [&first, &second] {
            serial.push(format!("tcp:{},nodelay=on", listener.local_addr()?));
        }
        let qmp = format!("tcp:{}", control.local_addr()?);
        let (send, log) = mpsc::channel();
        // Nobody receives any more when the play is over.
        let on_line = move |line| drop(send.send(line));
        let mut machine = Self::launch(elf, &serial, &["-qmp", &qmp], on_line)?;
        let mut control = machine.accept(&control)?;
        // QEMU takes no other command before this one.
        writeln!(control, r#"{{"execute": "qmp_capabilities"}}"#)?;
        machine.control = Some(BufReader::new(control));
        let ports = [machine.accept(&first)?, machine.accept(&second)?];
        Ok((machine, ports, log))
    }

    /// Boots an ELF file with its UARTs where `serial` says, and other `options`, in QEMU's words.
    ///
    /// `on_line` gets each line of the log, in another thread.
    ///
    /// # Errors
    ///
    /// If there is no QEMU, or the file is no firmware.
    pub fn launch(
        elf: &Path,
        serial: &[String],
        options: &[&str],
        on_line: impl FnMut(String) + Send + 'static,
    ) -> Result<Self> {
        let data = fs::read(elf).with_context(|| elf.display().to_string())?;
        let is_elf = data.starts_with(b"\x7FELF");
        ensure!(is_elf, "{} is not an ELF file", elf.display());
        let table = Table::parse(&data).with_context(|| format!("the log of {}", elf.display()))?;
        let qemu = find_qemu()?;
        // Has Linux end QEMU when this process ends, also by a signal.
        let mut command = if on_path("setpriv").is_some() {
            let mut setpriv = Command::new("setpriv");
            setpriv.args(["--pdeathsig", "KILL", "--"]).arg(qemu);
            setpriv
        } else {
            Command::new(qemu)
        };
        command.args(["-machine", MACHINE, "-display", "none", "-monitor", "none"]);
        command.args(["-semihosting-config", "enable=on,target=native"]);
        command.arg("-kernel").arg(elf).args(options);
        for port in serial {
            command.args(["-serial", port]);
        }
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().context("QEMU cannot be run")?;
        let stdout = child.stdout.take().context("QEMU's output")?;
        let log = thread::spawn(move || read_log(stdout, table.as_ref(), on_line));
        Ok(Self {
            child,
            control: None,
            log: Some(log),
        })
    }

    /// Resets the board as its button does: the program starts again, RAM stays as it is.
    ///
    /// # Errors
    ///
    /// If QEMU does not say that it has.
    pub fn reset(&mut self) -> Result<()> {
        let control = self.control.as_mut().context("launched without control")?;
        writeln!(control.get_mut(), r#"{{"execute": "system_reset"}}"#)?;
        let mut line = String::new();
        while !line.contains("\"RESET\"") {
            line.clear();
            ensure!(control.read_line(&mut line)? > 0, "QEMU has ended");
            ensure!(!line.contains("\"error\""), "QEMU: {line}");
        }
        Ok(())
    }

    /// Waits for the firmware to end; gives the status it ended with, after its whole log was read.
    ///
    /// # Errors
    ///
    /// If it has not ended in time.
    pub fn wait(&mut self, timeout: Option<Duration>) -> Result<ExitStatus> {
        let start = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait()? {
                break status;
            }
            if let Some(timeout) = timeout.filter(|timeout| start.elapsed() >= *timeout) {
                bail!("the firmware has not ended within {} s", timeout.as_secs());
            }
            thread::sleep(POLL);
        };
        let log = self.log.take().context("it has ended before")?.join();
        log.map_err(|_| anyhow!("the reader of the log panicked"))??;
        Ok(status)
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
            let late = start.elapsed() > START;
            ensure!(!late, "QEMU has not connected its serial ports");
            thread::sleep(POLL);
        }
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        // An error means that it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// QEMU on PATH, or where `cargo xtask demo` unpacks it.
fn find_qemu() -> Result<PathBuf> {
    if let Some(qemu) = on_path(PROGRAM) {
        return Ok(qemu);
    }
    let target = wire::metadata().no_deps().exec()?.target_directory;
    let unpacked = PathBuf::from(target).join("qemu").join(PROGRAM);
    ensure!(
        unpacked.is_file(),
        "there is no {PROGRAM}: `cargo xtask demo` gets it"
    );
    Ok(unpacked)
}

fn on_path(program: &str) -> Option<PathBuf> {
    env::split_paths(&env::var_os("PATH")?)
        .map(|folder| folder.join(program))
        .find(|path| path.is_file())
}

/// Reads standard output to its end: defmt's frames where there is a table, otherwise text.
fn read_log(
    mut output: impl Read,
    table: Option<&Table>,
    mut on_line: impl FnMut(String),
) -> Result<()> {
    let Some(table) = table else {
        for line in BufReader::new(output).split(b'\n') {
            on_line(String::from_utf8_lossy(&line?).into_owned());
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
                Ok(frame) => on_line(text(&frame)),
                Err(DecodeError::UnexpectedEof) => break,
                Err(DecodeError::Malformed) => {
                    ensure!(table.encoding().can_recover(), "the log is malformed");
                    on_line("(a malformed frame)".to_owned());
                }
            }
        }
    }
}

/// An entry of the log as `defmt-print` has it: `[INFO ] message`.
fn text(frame: &Frame<'_>) -> String {
    let message = frame.display_message();
    match frame.level() {
        Some(level) => format!("[{:<5}] {message}", level.as_str().to_uppercase()),
        None => message.to_string(),
    }
}
