//! Ports of `embedded_io` that say whether they are ready.

use embedded_io::{Read, ReadReady, Write, WriteReady};

use super::Port;

impl<T: Read + ReadReady + Write + WriteReady> Port for T {
    type Error = T::Error;

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<Option<usize>, T::Error> {
        if !self.read_ready()? {
            return Ok(None);
        }
        self.read(buffer).map(Some)
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<Option<usize>, T::Error> {
        if !self.write_ready()? {
            return Ok(None);
        }
        self.write(bytes).map(Some)
    }
}
