//! The vehicle: firmware on the emulated board, its autopilot and its radio.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::mpsc::Receiver,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail, ensure};
use mavlink_commsec::{hx, radio};

use crate::demo::{Direction, Port};
use crate::qemu::Machine;

/// How long nothing may come while something is expected: this machine may be busy with other things.
const MAX_DELAY: Duration = Duration::from_secs(20);
/// How long nothing has come when all has.
const MOMENT: Duration = Duration::from_millis(300);

/// What the vehicle's radio says of the link.
pub(super) const STATUS: radio::Status = radio::Status {
    rssi: 201,
    noise: 41,
    received: 0x1234,
    remote_rssi: 199,
    remote_noise: 43,
    remote_received: 0x5678,
    tx_errors: 0x0102,
    rx_errors: 3,
    serial_tx_overflow: 4,
    serial_rx_overflow: 5,
    ecc_errors: 0x0607,
    ecc_packets: 8,
    serial_tx_ok: 9,
    serial_rx_ok: 10,
};

/// Where the firmware begins to count, as it says.
#[derive(Debug, Default)]
pub(super) struct Start {
    /// The counter of its next package.
    pub(super) next: u32,
    /// Of each sender, the counter up to which everything is rejected.
    pub(super) above: BTreeMap<u32, u32>,
}

/// What the firmware has counted in one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counted {
    pub(super) packages: usize,
    pub(super) packets: usize,
    pub(super) rejected: usize,
    /// Bytes of no packet
    pub(super) dropped: usize,
}

/// The board, and what has been seen of it since its last start.
pub(super) struct Vehicle {
    machine: Machine,
    pub(super) autopilot: Port,
    pub(super) radio: Port,
    log: Receiver<String>,
    pub(super) lines: Vec<String>,
    decoder: hx::Decoder,
    /// Packages in the air, bytes at the autopilot, questions to the radio
    pub(super) packages: Vec<Vec<u8>>,
    pub(super) handed: Vec<u8>,
    pub(super) asked: usize,
    /// By direction: reasons one by one, and the last counts
    pub(super) rejected: [Vec<String>; 2],
    pub(super) counted: [Counted; 2],
    /// Packages opened of each sender, as the firmware counts them
    pub(super) opened_of: BTreeMap<u32, usize>,
    pub(super) faults: Vec<String>,
}

impl Vehicle {
    pub(super) fn boot(elf: &Path, stations: usize) -> Result<(Self, Start)> {
        let (machine, [autopilot, radio], log) = Machine::boot_between(elf)?;
        let mut vehicle = Self {
            machine,
            autopilot: Port::new(autopilot)?,
            radio: Port::new(radio)?,
            log,
            lines: Vec::new(),
            decoder: hx::Decoder::new(),
            packages: Vec::new(),
            handed: Vec::new(),
            asked: 0,
            rejected: Default::default(),
            counted: Default::default(),
            opened_of: BTreeMap::new(),
            faults: Vec::new(),
        };
        let start = vehicle.start(stations)?;
        Ok((vehicle, start))
    }

    /// Presses the reset button; gives where the firmware goes on.
    pub(super) fn restart(&mut self, stations: usize) -> Result<Start> {
        self.machine.reset()?;
        self.lines.push("(reset)".into());
        self.decoder = hx::Decoder::new();
        self.packages.clear();
        self.handed.clear();
        self.asked = 0;
        self.rejected = Default::default();
        self.counted = Default::default();
        self.opened_of.clear();
        self.start(stations)
    }

    /// The lines with which it starts.
    fn start(&mut self, stations: usize) -> Result<Start> {
        let mut next = None;
        let mut start = Start::default();
        while next.is_none() || start.above.len() < stations {
            let line = self.log.recv_timeout(MAX_DELAY);
            let line = line.context("the firmware does not say where it starts")?;
            if let Some((_, counter)) = line.split_once(" goes on at ") {
                next = Some(counter.parse()?);
            } else if let Some((sender, last)) = line
                .strip_prefix("[INFO ] Sender ")
                .and_then(|rest| rest.split_once(" is heard above "))
            {
                start.above.insert(sender.parse()?, last.parse()?);
            }
            self.lines.push(line);
        }
        start.next = next.context("it says so")?;
        Ok(start)
    }

    /// Takes what has come.
    fn turn(&mut self) -> Result<()> {
        while let Some(bytes) = self.radio.receive(Duration::ZERO) {
            for byte in bytes {
                self.air(byte)?;
            }
        }
        while let Some(bytes) = self.autopilot.receive(Duration::ZERO) {
            self.handed.extend(bytes);
        }
        while let Ok(line) = self.log.try_recv() {
            self.said(line)?;
        }
        Ok(())
    }

    /// What only grows when something happens that does not happen every second anyhow: the radio is
    /// asked then, and its status told.
    fn news(&self) -> usize {
        let rejected: usize = self.rejected.iter().map(Vec::len).sum();
        let told = self.packages.len().saturating_sub(self.asked);
        told + self.handed.len() + rejected
    }

    /// The radio takes a byte from the vehicle.
    fn air(&mut self, byte: u8) -> Result<()> {
        let Some(frame) = self.decoder.push(byte) else {
            return Ok(());
        };
        match frame.map(|frame| (frame.kind(), frame.payload())) {
            Ok((hx::FrameKind::AirData, package)) => self.packages.push(package.to_vec()),
            Ok((hx::FrameKind::Radio, bytes)) => {
                let request = radio::Request::from_wire(bytes);
                ensure!(
                    request == Some(radio::Request::Status),
                    "asked of the radio: {bytes:02X?}"
                );
                self.asked += 1;
                let answer = frame_of(hx::FrameKind::Radio, &STATUS.to_wire())?;
                self.radio.send(answer)?;
            }
            Err(error) => self.faults.push(format!("the radio gets {error}")),
        }
        Ok(())
    }

    fn said(&mut self, line: String) -> Result<()> {
        let directions = [Direction::Outbound, Direction::Inbound];
        for (direction, rejected) in directions.into_iter().zip(&mut self.rejected) {
            if let Some((reason, times)) = direction.rejections(&line) {
                rejected.extend(vec![reason; times]);
            }
        }
        for (name, counted) in ["sealed: ", "opened: "].iter().zip(&mut self.counted) {
            if let Some((_, counts)) = line.split_once(name) {
                let numbers = counts.split(|c: char| !c.is_ascii_digit());
                let numbers = numbers.filter(|number| !number.is_empty());
                let numbers = numbers.map(str::parse).collect::<Result<Vec<_>, _>>()?;
                let [packages, packets, rejected, dropped] = numbers[..] else {
                    bail!("the firmware counts so: {line}");
                };
                *counted = Counted {
                    packages,
                    packets,
                    rejected,
                    dropped,
                };
            }
        }
        if let Some((_, counts)) = line.split_once("opened of sender ") {
            let (sender, count) = counts.split_once(": ").context("a sender and a count")?;
            self.opened_of.insert(sender.parse()?, count.parse()?);
        }
        if line.contains("[WARN ]") || line.contains("[ERROR]") {
            self.faults.push(line.clone());
        }
        self.lines.push(line);
        Ok(())
    }

    /// Goes on until `done` and a moment longer, or until nothing more happens.
    pub(super) fn until(&mut self, mut done: impl FnMut(&Self) -> bool) -> Result<()> {
        let mut last = Instant::now();
        let mut most = 0;
        loop {
            self.turn()?;
            if self.news() > most {
                most = self.news();
                last = Instant::now();
            }
            let written = self.autopilot.is_written() && self.radio.is_written();
            let wait = if written && done(self) {
                MOMENT
            } else {
                MAX_DELAY
            };
            if last.elapsed() >= wait {
                if !written {
                    bail!("the firmware takes no more bytes");
                }
                return Ok(());
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    pub(super) fn stop(&mut self) -> Result<()> {
        self.machine.stop()?;
        self.lines.extend(self.log.try_iter());
        Ok(())
    }
}

/// The bytes of a frame on the line.
pub(super) fn frame_of(tag: hx::FrameKind, payload: &[u8]) -> Result<Vec<u8>> {
    Ok(hx::Frame::new(tag, payload)?.encode().collect())
}
