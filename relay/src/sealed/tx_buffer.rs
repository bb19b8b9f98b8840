//! Bytes that leave one after the other.

use heapless::Vec;
use zeroize::Zeroize as _;

/// Bytes that leave one after the other, and are wiped when they have left.
pub(super) struct TxBuffer<const SIZE: usize> {
    bytes: Vec<u8, SIZE>,
    sent: usize,
}

impl<const SIZE: usize> TxBuffer<SIZE> {
    pub(super) const fn new() -> Self {
        Self {
            bytes: Vec::new(),
            sent: 0,
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Adds `bytes`, for which there is room wherever this is called.
    pub(super) fn put(&mut self, bytes: impl IntoIterator<Item = u8>) {
        for byte in bytes {
            let put = self.bytes.push(byte);
            debug_assert!(put.is_ok(), "there is room");
        }
    }

    pub(super) fn pending(&self) -> &[u8] {
        self.bytes.get(self.sent..).unwrap_or_default()
    }

    /// Takes note of `count` bytes that have left; whether the last has left with them.
    pub(super) fn sent(&mut self, count: usize) -> bool {
        self.sent = self.sent.saturating_add(count);
        let left = !self.is_empty() && self.sent >= self.bytes.len();
        if left {
            self.clear();
        }
        left
    }

    pub(super) fn clear(&mut self) {
        self.bytes.as_mut_slice().zeroize();
        self.bytes.clear();
        self.sent = 0;
    }
}

impl<const SIZE: usize> Drop for TxBuffer<SIZE> {
    fn drop(&mut self) {
        self.clear();
    }
}
