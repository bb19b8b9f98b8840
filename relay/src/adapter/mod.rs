//! Adapters: they move bytes between an [`Endpoint`] and ports, and hold none themselves.
//!
//! | feature | ports | module |
//! |---|---|---|
//! | `embedded-io` | polled, such as a bare-metal UART | [`poll`], with `embedded_io::{Read, ReadReady, Write, WriteReady}` |
//! | `embedded-io-async` | of an async runtime, such as embassy | `embedded_io_async` |
//! | `std` | non-blocking streams, such as TCP and serial ports | [`poll`], with `NonBlocking` |

#[cfg(feature = "embedded-io")]
mod embedded_io;
#[cfg(feature = "embedded-io-async")]
pub mod embedded_io_async;
#[cfg(feature = "std")]
mod std;

#[cfg(feature = "std")]
pub use self::std::NonBlocking;

use core::fmt;

use mavlink_signing::LinkClock;

use crate::endpoint::{Endpoint, Side};

/// Bytes read at most from one port in one [`poll`].
const READ_SIZE: usize = 64;

/// A port that never waits.
pub trait Port {
    /// Why it failed.
    type Error;

    /// Reads into `buffer`, which is not empty. `None`: nothing has arrived; 0 bytes: the port has ended.
    ///
    /// # Errors
    ///
    /// If the port fails. What it means for the bytes is for the caller to
    /// [report](crate::LineEvent).
    fn try_read(&mut self, buffer: &mut [u8]) -> Result<Option<usize>, Self::Error>;

    /// Writes from the front of `bytes`, which are not empty. `None`: there is no room; 0 bytes: the port has ended.
    ///
    /// # Errors
    ///
    /// If the port fails.
    fn try_write(&mut self, bytes: &[u8]) -> Result<Option<usize>, Self::Error>;
}

/// Which of a direction's two ports failed, and with what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PortError<Input, Output> {
    /// The port that is read failed.
    Input(Input),
    /// The port that is written failed.
    Output(Output),
    /// The port that is read said that it was ready, and gave nothing: it has ended.
    InputClosed,
    /// The port that is written said that it was ready, and took nothing.
    OutputClosed,
}

impl<Input: fmt::Display, Output: fmt::Display> fmt::Display for PortError<Input, Output> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input(error) => write!(f, "cannot read: {error}"),
            Self::Output(error) => write!(f, "cannot write: {error}"),
            Self::InputClosed => f.write_str("the port gives no more bytes"),
            Self::OutputClosed => f.write_str("the port takes no more bytes"),
        }
    }
}

impl<Input, Output> core::error::Error for PortError<Input, Output>
where
    Input: fmt::Debug + fmt::Display,
    Output: fmt::Debug + fmt::Display,
{
}

/// What [`poll`] did in each direction: whether bytes moved, or which port failed.
///
/// A failure of one direction does not keep the other from its turn. The next poll tries again; nothing that was read
/// is lost.
#[derive(Debug)]
#[must_use = "a port may have failed"]
pub struct Polled<LocalError, LinkError> {
    /// From the local port to the link port.
    pub outbound: Result<bool, PortError<LocalError, LinkError>>,
    /// From the link port to the local port.
    pub inbound: Result<bool, PortError<LinkError, LocalError>>,
}

impl<LocalError, LinkError> Polled<LocalError, LinkError> {
    /// Whether to poll again at once.
    pub const fn moved(&self) -> bool {
        matches!(self.outbound, Ok(true)) || matches!(self.inbound, Ok(true))
    }
}

/// Takes one turn in each direction without waiting: reads up to 64 bytes, does what the time asks for, writes what is
/// ready.
///
/// Call it again at once while [`Polled::moved`]; otherwise when a port has become ready, and when
/// [`Endpoint::poll_at`] says. An error of a port that means lost or damaged bytes is for
/// [`Endpoint::line_event`], before the next poll.
pub fn poll<E: Endpoint, Local: Port, Link: Port>(
    endpoint: &mut E,
    local: &mut Local,
    link: &mut Link,
    clock: &mut impl LinkClock,
    observe: &mut impl FnMut(E::Event),
) -> Polled<Local::Error, Link::Error> {
    // What has arrived comes before the time: a line with bytes to read is not silent.
    let from_local = read(endpoint, Side::Local, local, clock, observe);
    let from_link = read(endpoint, Side::Link, link, clock, observe);
    endpoint.poll(clock, observe);
    let to_link = write(endpoint, Side::Link, link, clock, observe);
    let to_local = write(endpoint, Side::Local, local, clock, observe);
    Polled {
        outbound: from_local.and_then(|read| Ok(read | to_link?)),
        inbound: from_link.and_then(|read| Ok(read | to_local?)),
    }
}

/// Reads what there is room for; whether anything came.
fn read<E: Endpoint, Input: Port, OutputError>(
    endpoint: &mut E,
    side: Side,
    input: &mut Input,
    clock: &mut impl LinkClock,
    observe: &mut impl FnMut(E::Event),
) -> Result<bool, PortError<Input::Error, OutputError>> {
    let mut bytes = [0; READ_SIZE];
    let mut left = READ_SIZE;
    loop {
        let room = endpoint.room(side).min(left);
        let slots = bytes.get_mut(..room).unwrap_or_default();
        if slots.is_empty() {
            break;
        }
        let Some(count) = input.try_read(slots).map_err(PortError::Input)? else {
            break;
        };
        if count == 0 {
            return Err(PortError::InputClosed);
        }
        endpoint.received(side, slots.get(..count).unwrap_or_default(), clock, observe);
        left = left.saturating_sub(count);
    }
    Ok(left < READ_SIZE)
}

/// Writes what is ready, as far as the port takes it; whether any byte left.
fn write<E: Endpoint, Output: Port, InputError>(
    endpoint: &mut E,
    side: Side,
    output: &mut Output,
    clock: &mut impl LinkClock,
    observe: &mut impl FnMut(E::Event),
) -> Result<bool, PortError<InputError, Output::Error>> {
    let mut moved = false;
    loop {
        let bytes = endpoint.pending(side);
        if bytes.is_empty() {
            return Ok(moved);
        }
        match output.try_write(bytes).map_err(PortError::Output)? {
            None => return Ok(moved),
            Some(0) => return Err(PortError::OutputClosed),
            Some(count) => endpoint.sent(side, count, clock, observe),
        }
        moved = true;
    }
}
