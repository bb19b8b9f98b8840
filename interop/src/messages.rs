//! The messages of the dialect `all`, and how long their payloads are.

use std::{
    collections::HashSet,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, ensure};
use cargo_metadata::MetadataCommand;
use mavlink_bindgen::parser::{MavMessage, extra_crc, parse_profile};
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

/// The definition of the dialect, which the crate `mavlink` ships.
pub(crate) fn definition() -> Result<PathBuf> {
    let mut metadata = MetadataCommand::new();
    metadata.manifest_path(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"));
    let packages = metadata
        .other_options(["--locked".to_owned()])
        .exec()?
        .packages;
    let mavlink = packages.iter().find(|package| *package.name == "mavlink");
    let manifest = &mavlink.context("the crate mavlink")?.manifest_path;
    let folder = manifest.with_file_name("mavlink/message_definitions/v1.0");
    Ok(folder.join("all.xml").into())
}

/// Reads the definition, by another parser than the core's tables.
///
/// # Errors
/// If it is not the core's dialect.
pub(crate) fn read(definition: &Path) -> Result<Vec<Message>> {
    let folder = definition.parent().context("a folder")?;
    let profile = parse_profile(folder, Path::new("all.xml"), &mut HashSet::new())?;
    let messages = profile.messages.into_values().map(Message::from);
    let mut messages = Vec::from_iter(messages);
    messages.sort_by_key(|message| message.id);
    let listed = messages
        .iter()
        .map(|message| (message.id, message.crc_extra));
    let here = dialect::messages().map(|(id, crc_extra)| (id.get(), crc_extra));
    ensure!(
        dialect::NAME == "all" && listed.eq(here),
        "{} has other messages than the core's dialect {}",
        definition.display(),
        dialect::NAME
    );
    Ok(messages)
}

impl From<MavMessage> for Message {
    fn from(message: MavMessage) -> Self {
        let size = |extensions: bool| {
            let fields = message.fields.iter();
            let fields = fields.filter(|field| extensions || !field.is_extension);
            fields.map(|field| field.mavtype.size()).sum()
        };
        Self {
            id: message.id,
            crc_extra: extra_crc(&message),
            base_size: size(false),
            size: size(true),
            name: message.name,
        }
    }
}
