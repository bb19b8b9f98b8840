//! Bytes as hexadecimal digits.

use std::fmt::Write as _;

use anyhow::{Context, Result, ensure};

pub(crate) fn encode(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

pub(crate) fn decode(text: &str) -> Result<Vec<u8>> {
    ensure!(text.len().is_multiple_of(2), "half a byte: {text}");
    let byte = |at| {
        let digits = text.get(at..at + 2).context("no digits")?;
        Ok(u8::from_str_radix(digits, 16)?)
    };
    (0..text.len()).step_by(2).map(byte).collect()
}
