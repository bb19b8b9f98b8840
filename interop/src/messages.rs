//! The messages of the dialect `all`, and how long their payloads are.

use std::{fs, path::Path};

use anyhow::{Context, Result, ensure};
use mavlink_signing::dialect;

/// A message as its definition has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Message {
    pub(crate) id: u32,
    pub(crate) crc_extra: u8,
    /// Bytes of payload without extensions.
    pub(crate) base_size: usize,
    /// Bytes of payload.
    pub(crate) size: usize,
    pub(crate) name: String,
}

/// Reads the list that `cargo xtask interop` made from the definitions: a message a line.
///
/// # Errors
/// If it is not the core's dialect.
pub(crate) fn read(path: &Path) -> Result<Vec<Message>> {
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let messages = text.lines().map(parse).collect::<Result<Vec<_>>>()?;
    let listed = messages
        .iter()
        .map(|message| (message.id, message.crc_extra));
    let here = dialect::messages().map(|(id, crc_extra)| (id.get(), crc_extra));
    ensure!(
        dialect::NAME == "all" && listed.eq(here),
        "{} has other messages than the core's dialect {}",
        path.display(),
        dialect::NAME
    );
    Ok(messages)
}

fn parse(line: &str) -> Result<Message> {
    let mut words = line.split(' ');
    let mut word = || words.next().with_context(|| line.to_owned());
    Ok(Message {
        id: word()?.parse()?,
        crc_extra: word()?.parse()?,
        base_size: word()?.parse()?,
        size: word()?.parse()?,
        name: word()?.to_owned(),
    })
}
