//! Streams of the standard library that do not block.

use std::io::{self, BufReader, ErrorKind, Read, Write};

use super::Port;

/// A stream that returns [`ErrorKind::WouldBlock`] in place of waiting, such as a
/// [`TcpStream`](std::net::TcpStream) after `set_nonblocking(true)`. Reads 8 KiB at a time.
///
/// When [`poll`](super::poll) has moved nothing, sleep for a millisecond or wait for the stream by other means.
#[derive(Debug)]
pub struct NonBlocking<S>(BufReader<S>);

impl<S: Read> NonBlocking<S> {
    /// The port of `stream`.
    pub fn new(stream: S) -> Self {
        Self(BufReader::new(stream))
    }
}

impl<S: Read + Write> Port for NonBlocking<S> {
    type Error = io::Error;

    fn try_read(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        unless_it_would_block(self.0.read(buffer))
    }

    fn try_write(&mut self, bytes: &[u8]) -> io::Result<Option<usize>> {
        unless_it_would_block(self.0.get_mut().write(bytes))
    }
}

fn unless_it_would_block(moved: io::Result<usize>) -> io::Result<Option<usize>> {
    match moved {
        Ok(count) => Ok(Some(count)),
        Err(error) => match error.kind() {
            ErrorKind::WouldBlock | ErrorKind::Interrupted => Ok(None),
            _ => Err(error),
        },
    }
}
