//! Target: the relay between ports that fail and lines that fall silent.

use arbitrary::Arbitrary;
use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};
use mavlink_signing::{FrameRef, field::MAGIC};
use mavlink_signing::{
    Hmac, ReplayGuard, SigningKey, Stamper, Timestamp, VerifyError, Window, authenticate,
};
use mavseal_relay::{
    ForwardMode, Relay, SameLinkId, Senders,
    adapter::{self, PortError},
};

use crate::input::Moment;
use crate::repair::{self, KEY, SECRET};

/// What one port does in one turn.
#[derive(Arbitrary, Clone, Copy, Debug)]
pub struct Behaviour {
    /// Bytes that arrive.
    pub arrive: u8,
    /// Bytes that it takes.
    pub room: u8,
    /// What fails: 1 to 6, one of its calls; mostly nothing.
    pub fault: u8,
}

/// A turn of the relay.
#[derive(Arbitrary, Clone, Copy, Debug)]
pub struct Poll {
    /// Ticks since the last one.
    pub ticks: u16,
    /// What the local and the link port do.
    pub ports: [Behaviour; 2],
}

/// What arrives on both sides, and how the ports behave.
#[derive(Arbitrary, Clone, Debug)]
pub struct Faulty<'a> {
    /// The link ids of what is signed and of what is verified.
    pub link_ids: [u8; 2],
    /// When it begins.
    pub start: Moment,
    /// The turns.
    pub polls: Vec<Poll>,
    /// How many of the bytes come from the local side.
    pub local: u16,
    /// The bytes from the local side, then those from the link side.
    pub bytes: &'a [u8],
}

/// Which call of a port fails in a turn, by [`Behaviour::fault`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fault {
    None,
    ReadReady,
    Read,
    Ended,
    WriteReady,
    Write,
    Full,
}

impl Fault {
    pub(crate) fn from(number: u8) -> Self {
        match number {
            1 => Self::ReadReady,
            2 => Self::Read,
            3 => Self::Ended,
            4 => Self::WriteReady,
            5 => Self::Write,
            6 => Self::Full,
            _ => Self::None,
        }
    }
}

/// A side's port.
pub(crate) struct Port<'a> {
    /// What has not been read yet, and how much of it has arrived.
    input: &'a [u8],
    arrived: usize,
    pub(crate) output: Vec<u8>,
    room: usize,
    fault: Fault,
}

impl<'a> Port<'a> {
    pub(crate) fn new(input: &'a [u8]) -> Self {
        Self {
            input,
            arrived: 0,
            output: Vec::new(),
            room: 0,
            fault: Fault::None,
        }
    }

    pub(crate) fn turn(&mut self, arrive: usize, room: usize, fault: Fault) {
        self.arrived = self.arrived.saturating_add(arrive).min(self.input.len());
        self.room = room;
        self.fault = fault;
    }

    fn fail_at(&self, fault: Fault) -> Result<(), ErrorKind> {
        if self.fault == fault {
            return Err(ErrorKind::Other);
        }
        Ok(())
    }
}

impl ErrorType for Port<'_> {
    type Error = ErrorKind;
}

impl ReadReady for Port<'_> {
    fn read_ready(&mut self) -> Result<bool, ErrorKind> {
        self.fail_at(Fault::ReadReady)?;
        Ok(self.arrived > 0 || self.fault == Fault::Ended)
    }
}

impl Read for Port<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ErrorKind> {
        self.fail_at(Fault::Read)?;
        if self.fault == Fault::Ended {
            return Ok(0);
        }
        let count = buffer.len().min(self.arrived);
        let (now, later) = self.input.split_at(count);
        buffer[..count].copy_from_slice(now);
        self.input = later;
        self.arrived -= count;
        Ok(count)
    }
}

impl WriteReady for Port<'_> {
    fn write_ready(&mut self) -> Result<bool, ErrorKind> {
        self.fail_at(Fault::WriteReady)?;
        Ok(self.room > 0 || self.fault == Fault::Full)
    }
}

impl Write for Port<'_> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        self.fail_at(Fault::Write)?;
        if self.fault == Fault::Full {
            return Ok(0);
        }
        let count = bytes.len().min(self.room);
        self.output.extend(&bytes[..count]);
        self.room -= count;
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}

/// Whether an error is the one that the faults of the port that is read and of the one that is written
/// make.
pub(crate) fn is_due(error: &PortError<ErrorKind, ErrorKind>, input: Fault, output: Fault) -> bool {
    match error {
        PortError::Input(_) => matches!(input, Fault::ReadReady | Fault::Read),
        PortError::InputClosed => input == Fault::Ended,
        PortError::Output(_) => matches!(output, Fault::WriteReady | Fault::Write),
        PortError::OutputClosed => output == Fault::Full,
    }
}

/// The relay between ports that fail: an error is the one that a port gave, and nothing is lost by it;
/// what leaves on the link side is signed, whole and in order, however long the lines are silent.
pub fn relay_ports(input: Faulty<'_>) {
    let local = usize::from(input.local).min(input.bytes.len());
    let mut bytes = input.bytes.to_vec();
    let (local, link) = bytes.split_at_mut(local);
    let start = input.start.timestamp();
    let [link_out, link_in] = input.link_ids;
    for side in [&mut *local, &mut *link] {
        repair::stream(side, 0, |packet, parts| {
            parts.restamp(packet, Some(link_in), Some(start));
        });
    }
    let output = run(&input, local, link, &input.polls);
    let Ok([to_local, to_link]) = output else {
        assert_eq!(link_out, link_in);
        return;
    };
    assert_ne!(link_out, link_in);
    // Only where the clock stands is a line never silent, so that it makes no difference when bytes
    // were read.
    if input.polls.iter().all(|poll| poll.ticks == 0) {
        let without = run(&input, local, link, &[]).expect("as before");
        assert_eq!([&to_local, &to_link], [&without[0], &without[1]]);
    }
    assert!(to_local.is_empty() || to_local[0] == MAGIC);
    let window = Window {
        past: u64::MAX,
        ahead: u64::MAX,
    };
    let mut replay = ReplayGuard::new(link_out, window);
    let mut rest = &to_link[..];
    while !rest.is_empty() {
        let frame = FrameRef::parse(rest).expect("whole frames");
        rest = &rest[frame.as_bytes().len()..];
        let admitted = authenticate(frame, &KEY).and_then(|frame| replay.admit(frame, start));
        assert_eq!(admitted.map(drop), Ok::<(), VerifyError>(()));
    }
}

/// What leaves on the plain and on the link side.
fn run(
    input: &Faulty<'_>,
    local: &[u8],
    link: &[u8],
    polls: &[Poll],
) -> Result<[Vec<u8>; 2], SameLinkId> {
    let [link_out, link_in] = input.link_ids;
    let mut now = input.start.timestamp();
    let key = SigningKey::<Hmac>::new(&SECRET).expect("a key");
    let replay = ReplayGuard::new(link_in, Window::STRICT);
    let mut relay = Relay::new(
        key,
        Stamper::new(link_out),
        replay,
        ForwardMode::StripSignature,
    )?
    .idle(0x8000)
    .senders(Senders::Any);
    let (mut local, mut link) = (Port::new(local), Port::new(link));
    for poll in polls {
        now = now.saturating_add(poll.ticks.into());
        let [from_local, from_link] = poll.ports.map(|port| Fault::from(port.fault));
        let [at_local, at_link] = poll.ports;
        local.turn(at_local.arrive.into(), at_local.room.into(), from_local);
        link.turn(at_link.arrive.into(), at_link.room.into(), from_link);
        let polled = adapter::poll(&mut relay, &mut local, &mut link, &mut { now }, &mut |_| {});
        for (direction, input, output) in [
            (polled.outbound, from_local, from_link),
            (polled.inbound, from_link, from_local),
        ] {
            if let Err(error) = direction {
                assert!(is_due(&error, input, output), "{error}");
            }
        }
    }
    drain(&mut relay, &mut local, &mut link, now);
    Ok([local.output, link.output])
}

/// Polls until nothing moves any more.
fn drain(relay: &mut Relay<Hmac>, local: &mut Port<'_>, link: &mut Port<'_>, now: Timestamp) {
    loop {
        local.turn(usize::MAX, usize::MAX, Fault::None);
        link.turn(usize::MAX, usize::MAX, Fault::None);
        let polled = adapter::poll(relay, local, link, &mut { now }, &mut |_| {});
        if !polled.moved() {
            break;
        }
    }
}
