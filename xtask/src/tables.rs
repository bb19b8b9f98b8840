//! The message tables of `mavlink/src/dialect`, generated from published definitions.
//!
//! The definitions are the XML files that the mavlink crate ships. A table has one row for each
//! message: its id and its `crc_extra`, <https://mavlink.io/en/guide/serialization.html#crc_extra>.
//! The tests hold each row against other generators.

use core::cmp::Reverse;
use core::fmt::Write as _;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use cargo_metadata::{Metadata, MetadataCommand, Package};
use crc::{CRC_16_MCRF4XX, Crc};
use roxmltree::{Document, Node};

const CORE: &str = "mavlink-signing";
const SOURCE: &str = "mavlink";
const TABLES: &str = "mavlink/src/dialect/tables";

/// Definitions that exist to test generators.
const NO_DIALECTS: [&str; 2] = ["test", "python_array_test"];

/// Writes the tables, or with `check` fails if a committed file is not what would be written.
pub(crate) fn run(check: bool) -> Result<()> {
    let metadata = metadata()?;
    let dialects = dialects(&definitions(&metadata)?)?;
    let core = package(&metadata, CORE)?;
    for dialect in &dialects {
        ensure!(
            core.features.contains_key(&dialect.feature),
            "{CORE}'s Cargo.toml has no feature `{}` for {}",
            dialect.feature,
            dialect.xml.display()
        );
    }

    let folder = metadata.workspace_root.join(TABLES).into_std_path_buf();
    let wanted = files(&dialects, &package(&metadata, SOURCE)?.version.to_string())?;
    let mut names: BTreeSet<_> = wanted.keys().cloned().collect();
    for file in fs::read_dir(&folder).into_iter().flatten() {
        names.insert(file?.file_name().to_string_lossy().into_owned());
    }
    names.retain(|name| wanted.get(name) != fs::read_to_string(folder.join(name)).ok().as_ref());
    if check {
        ensure!(
            names.is_empty(),
            "{TABLES} is not what `cargo xtask tables` writes: {names:?} differ, are missing, or do not belong there"
        );
    }
    fs::create_dir_all(&folder)?;
    for name in names {
        let path = folder.join(&name);
        match wanted.get(&name) {
            Some(text) => fs::write(&path, text),
            None => fs::remove_file(&path),
        }
        .with_context(|| path.display().to_string())?;
        println!("{TABLES}/{name}");
    }
    Ok(())
}

fn metadata() -> Result<Metadata> {
    MetadataCommand::new()
        .manifest_path(Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml"))
        .other_options(["--locked".to_owned()])
        .exec()
        .context("cargo metadata")
}

fn package<'a>(metadata: &'a Metadata, name: &str) -> Result<&'a Package> {
    let packages = metadata.packages.iter();
    let packages: Vec<_> = packages.filter(|it| it.name.as_str() == name).collect();
    match packages[..] {
        [package] => Ok(package),
        _ => bail!("Cargo.lock has {} versions of {name}", packages.len()),
    }
}

/// The folder of XML files that the mavlink crate ships.
fn definitions(metadata: &Metadata) -> Result<PathBuf> {
    let manifest = &package(metadata, SOURCE)?.manifest_path;
    let root = manifest.parent().context("the manifest has no folder")?;
    Ok(root
        .join("mavlink/message_definitions/v1.0")
        .into_std_path_buf())
}

#[derive(Debug)]
struct Dialect {
    /// The file's name without `.xml`, in lower case: the name of the feature and of the table.
    feature: String,
    xml: PathBuf,
    messages: BTreeMap<u32, Message>,
}

#[derive(Clone, Debug, PartialEq)]
struct Message {
    name: String,
    crc_extra: u8,
}

/// Every dialect, that with the most messages first, so that none comes after a part of it.
fn dialects(folder: &Path) -> Result<Vec<Dialect>> {
    let mut dialects = Vec::new();
    for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let xml = entry?.path();
        let name = xml
            .file_name()
            .and_then(|name| name.to_str()?.strip_suffix(".xml"));
        let Some(name) = name.filter(|name| !NO_DIALECTS.contains(name)) else {
            continue;
        };
        let (feature, mut messages) = (name.to_lowercase(), BTreeMap::new());
        read_definition(&xml, &mut BTreeSet::new(), &mut messages)?;
        dialects.push(Dialect {
            feature,
            xml,
            messages,
        });
    }
    dialects.sort_by_key(|dialect| (Reverse(dialect.messages.len()), dialect.feature.clone()));
    Ok(dialects)
}

/// Adds the messages of `xml` and of the files that it includes, each file once.
fn read_definition(
    xml: &Path,
    seen: &mut BTreeSet<PathBuf>,
    messages: &mut BTreeMap<u32, Message>,
) -> Result<()> {
    if !seen.insert(xml.to_owned()) {
        return Ok(());
    }
    let text = fs::read_to_string(xml).with_context(|| xml.display().to_string())?;
    let document = Document::parse(&text).with_context(|| xml.display().to_string())?;
    let root = document.root_element();
    for include in children(root, "include") {
        let name = include.text().context("an <include> names no file")?;
        read_definition(&xml.with_file_name(name.trim()), seen, messages)?;
    }
    for node in children(root, "messages").flat_map(|list| children(list, "message")) {
        let id = attribute(node, "id")?.parse()?;
        ensure!(id < 1 << 24, "message id {id} has more than 3 bytes");
        let name = attribute(node, "name")?;
        let place = || format!("{name} in {}", xml.display());
        let message = Message {
            name: name.to_owned(),
            crc_extra: crc_extra(node).with_context(place)?,
        };
        if let Some(other) = messages.insert(id, message.clone()) {
            ensure!(
                other == message,
                "{} has {other:?} and {message:?} with the id {id}",
                xml.display()
            );
        }
    }
    Ok(())
}

/// The checksum of what the two ends of a link must agree on: the message's name and its fields in
/// the order on the wire.
/// <https://mavlink.io/en/guide/serialization.html#crc_extra>
fn crc_extra(message: Node) -> Result<u8> {
    // Extension fields can be added later and so are left out.
    let base = message
        .children()
        .take_while(|node| !node.has_tag_name("extensions"));
    let mut fields = base
        .filter(|node| node.has_tag_name("field"))
        .map(Field::new)
        .collect::<Result<Vec<_>>>()?;
    // Larger types first; the sort keeps those of equal size in order.
    // https://mavlink.io/en/guide/serialization.html#field_reordering
    fields.sort_by_key(|field| Reverse(field.size));

    let crc = Crc::<u16>::new(&CRC_16_MCRF4XX);
    let mut digest = crc.digest();
    digest.update(format!("{} ", attribute(message, "name")?).as_bytes());
    for field in fields {
        digest.update(format!("{} {} ", field.base_type, field.name).as_bytes());
        digest.update(field.array_length.as_slice());
    }
    let [low, high] = digest.finalize().to_le_bytes();
    Ok(low ^ high)
}

struct Field<'a> {
    name: &'a str,
    base_type: &'a str,
    /// Bytes of one element.
    size: u8,
    array_length: Option<u8>,
}

impl<'a> Field<'a> {
    fn new(node: Node<'a, '_>) -> Result<Self> {
        let declared = attribute(node, "type")?;
        let (base_type, array_length) = match declared
            .strip_suffix(']')
            .and_then(|array| array.split_once('['))
        {
            Some((base_type, length)) => (
                base_type,
                Some(length.parse().with_context(|| declared.to_owned())?),
            ),
            None => (declared, None),
        };
        let (base_type, size) = match base_type {
            "uint8_t_mavlink_version" => ("uint8_t", 1),
            "char" | "int8_t" | "uint8_t" => (base_type, 1),
            "int16_t" | "uint16_t" => (base_type, 2),
            "float" | "int32_t" | "uint32_t" => (base_type, 4),
            "double" | "int64_t" | "uint64_t" => (base_type, 8),
            _ => bail!("the type {declared} is not known"),
        };
        Ok(Self {
            name: attribute(node, "name")?,
            base_type,
            size,
            array_length,
        })
    }
}

fn children<'a, 'input>(
    node: Node<'a, 'input>,
    tag: &str,
) -> impl Iterator<Item = Node<'a, 'input>> {
    node.children().filter(move |child| child.has_tag_name(tag))
}

fn attribute<'a>(node: Node<'a, '_>, name: &str) -> Result<&'a str> {
    let tag = node.tag_name().name();
    node.attribute(name)
        .with_context(|| format!("a <{tag}> has no {name}"))
}

/// The text of each generated file by its name.
fn files(dialects: &[Dialect], version: &str) -> Result<BTreeMap<String, String>> {
    let mut files = BTreeMap::from([("mod.rs".to_owned(), module(dialects, version)?)]);
    for dialect in dialects {
        files.insert(format!("{}.rs", dialect.feature), table(dialect, version)?);
    }
    Ok(files)
}

fn table(dialect: &Dialect, version: &str) -> Result<String> {
    let (feature, messages) = (&dialect.feature, &dialect.messages);
    let mut text = format!(
        "//! {feature}: generated by `cargo xtask tables` from mavlink crate {version}.\n\n\
         /// `message_id << 8 | crc_extra` of {} messages; the last two digits are `crc_extra`.\n\
         pub(super) const ROWS: &[u32] = &[\n",
        messages.len()
    );
    for (id, Message { name, crc_extra }) in messages {
        let (high, low) = (id >> 8, (id & 0xff) << 8 | u32::from(*crc_extra));
        writeln!(text, "    0x{high:04x}_{low:04x}, // {id} {name}")?;
    }
    text.push_str("];\n");
    Ok(text)
}

fn module(dialects: &[Dialect], version: &str) -> Result<String> {
    let features = dialects.iter().map(|dialect| dialect.feature.as_str());
    let mut features: Vec<_> = features.collect();
    let by_size = features.clone();
    features.sort_unstable();

    let mut text = format!(
        "//! The tables: generated by `cargo xtask tables` from mavlink crate {version}.\n\n\
         use super::Dialect;\n\n"
    );
    for feature in &features {
        writeln!(text, "#[cfg(feature = \"{feature}\")]\nmod {feature};")?;
    }
    text.push_str("\n/// Every chosen dialect, that with the most messages first.\n");
    text.push_str("pub(super) const CHOSEN: &[Dialect] = &[\n");
    for feature in by_size {
        writeln!(text, "    #[cfg(feature = \"{feature}\")]")?;
        writeln!(text, "    Dialect(\"{feature}\", {feature}::ROWS),")?;
    }
    text.push_str("];\n\n#[cfg(not(any(\n");
    for feature in &features {
        writeln!(text, "    feature = \"{feature}\",")?;
    }
    writeln!(
        text,
        ")))]\ncompile_error!(\n    \"choose a MAVLink dialect, a feature of mavlink-signing: {}\"\n);",
        features.join(", ")
    )?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::process::Command;

    use super::*;

    /// Messages for which pymavlink has another id or `crc_extra`, each with the reason.
    const PYMAVLINK_DIFFERS: [(&str, &str); 0] = [];

    fn published() -> Vec<Dialect> {
        dialects(&definitions(&metadata().unwrap()).unwrap()).unwrap()
    }

    #[test]
    fn committed_tables_are_those_of_the_published_definitions() {
        run(true).unwrap();
    }

    #[test]
    fn well_known_values() {
        let dialects = published();
        let common = dialects
            .iter()
            .find(|dialect| dialect.feature == "common")
            .unwrap();
        for (id, name, crc_extra) in [
            (0, "HEARTBEAT", 50),
            (24, "GPS_RAW_INT", 24),
            (76, "COMMAND_LONG", 152),
            (109, "RADIO_STATUS", 185),
            (256, "SETUP_SIGNING", 71),
            (300, "PROTOCOL_VERSION", 217),
        ] {
            let message = Message {
                name: name.to_owned(),
                crc_extra,
            };
            assert_eq!(common.messages[&id], message);
        }
    }

    /// Another parser and another generator, on the same files.
    #[test]
    fn mavlink_bindgen_agrees_on_every_row() {
        for Dialect {
            feature,
            xml,
            messages,
        } in published()
        {
            let (folder, file) = (xml.parent().unwrap(), xml.file_name().unwrap());
            let profile =
                mavlink_bindgen::parser::parse_profile(folder, file.as_ref(), &mut HashSet::new())
                    .unwrap();
            let theirs = profile.messages.into_values().map(|message| {
                let crc_extra = mavlink_bindgen::parser::extra_crc(&message);
                (message.id, (message.name, crc_extra))
            });
            let ours = messages
                .into_iter()
                .map(|(id, message)| (id, (message.name, message.crc_extra)));
            let theirs: BTreeMap<_, _> = theirs.collect();
            assert_eq!(ours.collect::<BTreeMap<_, _>>(), theirs, "{feature}");
        }
    }

    /// Another generator on another copy of the definitions. A message that only one copy has is no
    /// disagreement.
    #[test]
    fn pymavlink_agrees_on_every_message_it_has() {
        let pymavlink: BTreeMap<&str, (u32, u8)> = include_str!("tables/pymavlink.txt")
            .lines()
            .filter(|line| !line.starts_with('#'))
            .map(|line| match line.split(' ').collect::<Vec<_>>()[..] {
                [id, crc_extra, name] => (name, (id.parse().unwrap(), crc_extra.parse().unwrap())),
                _ => panic!("{line}"),
            })
            .collect();

        let (mut rows, mut confirmed) = (0, 0);
        for Dialect {
            feature, messages, ..
        } in published()
        {
            rows += messages.len();
            for (
                id,
                Message {
                    name, crc_extra, ..
                },
            ) in messages
            {
                if let Some(theirs) = pymavlink.get(name.as_str()) {
                    let differs = PYMAVLINK_DIFFERS.iter().any(|(listed, _)| *listed == name);
                    assert_eq!((id, crc_extra) != *theirs, differs, "{name} of {feature}");
                    confirmed += usize::from(!differs);
                }
            }
        }
        println!("pymavlink confirms {confirmed} of {rows} rows");
        assert!(confirmed * 10 >= rows * 8, "{confirmed} of {rows}");
    }

    #[test]
    fn each_dialect_compiles_alone_and_a_mixture_only_with_one_that_has_all_rows() {
        let metadata = metadata().unwrap();
        for dialect in published() {
            check(&metadata, &dialect.feature).unwrap();
        }
        check(&metadata, "minimal,common,ardupilotmega").unwrap();

        for (features, message) in [
            ("asluav,avssuas", "`asluav` and `avssuas` are both chosen"),
            (
                "all,common,paparazzi",
                "`all` and `paparazzi` are both chosen",
            ),
            ("", "choose a MAVLink dialect"),
        ] {
            let error = check(&metadata, features).expect_err(features);
            assert!(error.to_string().contains(message), "{error}");
        }
    }

    /// Whether the core compiles with these features, in a target folder that no other cargo holds.
    fn check(metadata: &Metadata, features: &str) -> Result<()> {
        let output = Command::new(env!("CARGO"))
            .current_dir(&metadata.workspace_root)
            .args([
                "check",
                "--locked",
                "--package",
                CORE,
                "--no-default-features",
            ])
            .args(["--features", features, "--target-dir"])
            .arg(metadata.target_directory.join("tables"))
            .output()?;
        ensure!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        Ok(())
    }
}
