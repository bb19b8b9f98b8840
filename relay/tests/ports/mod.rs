//! Ports in memory, for tests.

use std::collections::VecDeque;

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};

/// More bytes than any test sends.
const ENOUGH: usize = 1_000_000;

/// A port of which the test is the other end.
#[derive(Default)]
pub struct Line {
    pub input: VecDeque<u8>,
    pub output: Vec<u8>,
    /// Bytes that may still be written before the port is not ready.
    pub room: usize,
    /// Bytes taken by one write at most.
    pub at_once: usize,
    pub broken: bool,
    pub ended: bool,
}

impl Line {
    pub fn new() -> Self {
        Self {
            room: usize::MAX,
            at_once: usize::MAX,
            ..Self::default()
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Broken;

impl std::fmt::Display for Broken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("broken")
    }
}

impl std::error::Error for Broken {}

impl embedded_io::Error for Broken {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for Line {
    type Error = Broken;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, Broken> {
        if self.broken {
            return Err(Broken);
        }
        Ok(self.ended || !self.input.is_empty())
    }
}

impl Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Broken> {
        assert!(
            self.ended || !self.input.is_empty(),
            "nobody waits for input"
        );
        Ok(std::io::Read::read(&mut self.input, buffer).expect("memory"))
    }
}

impl WriteReady for Line {
    fn write_ready(&mut self) -> Result<bool, Broken> {
        Ok(self.room > 0)
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Broken> {
        assert!(self.room > 0, "nobody waits for output");
        assert!(self.output.len() < ENOUGH, "bytes without end");
        let count = bytes.len().min(self.room).min(self.at_once);
        self.output.extend(&bytes[..count]);
        self.room -= count;
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), Broken> {
        Ok(())
    }
}
