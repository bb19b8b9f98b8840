//! The key file: read, checked, written.

use std::{
    fmt, fs,
    fs::{File, OpenOptions},
    io::{self, Read as _, Write as _},
    path::Path,
};

use serde::Deserialize;
use zeroize::Zeroizing;

use crate::error::KeyFileError;
use crate::field::MAX_STATIONS;
use crate::rust_source::Role;

/// The header of all packages that the keys of a file seal. Under one key, the two headers would use nonces
/// twice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HeaderKind {
    /// `id-counter`: sender and counter, as SMACCMPilot has it.
    #[default]
    IdCounter,
    /// `counter-epoch-id`: with a number for each start of the sender.
    CounterEpochId,
}

impl HeaderKind {
    const ALL: [Self; 2] = [Self::IdCounter, Self::CounterEpochId];

    /// What a key file calls it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::IdCounter => "id-counter",
            Self::CounterEpochId => "counter-epoch-id",
        }
    }

    /// The header that a key file calls `name`.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|header| header.name() == name)
    }

    /// The greatest id that it has room for.
    #[must_use]
    pub const fn max_id(self) -> u32 {
        match self {
            Self::IdCounter => u32::MAX,
            Self::CounterEpochId => 0xFFFF,
        }
    }
}

/// Greatest id in Keys.mk.
const MAX_OLD_ID: u32 = 15;

/// Keys that were published: anybody can look them up.
///
/// Those of Keys.mk.example and of the constants before it. Those in tests and defaults of SMACCMPilot and
/// its successor. Those of the examples in the documentation of this package and of `mavlink-commsec`.
const PUBLISHED: [[u8; 16]; 9] = [
    [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15],
    [15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0],
    [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16],
    [
        24, 23, 22, 21, 20, 19, 18, 17, 16, 15, 14, 13, 12, 11, 10, 9,
    ],
    0xb5cc_1a3e_8f8d_5a6c_01f2_d8c3_7b0e_94aa_u128.to_be_bytes(),
    0x7d0f_6a1b_e4c2_9358_08de_17ab_4f5c_6e22_u128.to_be_bytes(),
    *b"16 random bytes.",
    *b"16 other bytes..",
    *b"another 16 bytes",
];

/// What is allowed although a link in use must not have it. By default nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Exceptions {
    /// Keys that were published: for demonstrations and tests.
    pub published_keys: bool,
    /// One key for several stations, as SMACCMPilot has it: each can speak as the others.
    pub shared_station_keys: bool,
    /// Files that group or others have access to, as on a file system without permissions. Only
    /// [`KeyFile::read`] looks, and only on Unix.
    pub exposed_file: bool,
}

/// A vehicle or a ground station: who it is, and what it seals with. [`Debug`] shows the id alone. The key
/// is wiped when it is dropped.
#[derive(Clone, PartialEq, Eq)]
pub struct SenderKeys {
    /// Its id in every package.
    pub id: u32,
    /// Its key.
    pub key: Zeroizing<[u8; 16]>,
    /// The part of its nonces that is never sent.
    pub salt: u32,
}

impl fmt::Debug for SenderKeys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Sender")
            .field("id", &self.id)
            .finish_non_exhaustive()
    }
}

/// A key file that was checked: one vehicle and its stations, no id twice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyFile {
    header: HeaderKind,
    vehicle: SenderKeys,
    stations: Vec<SenderKeys>,
}

/// The file as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    header: String,
    vehicle: WrittenSender,
    #[serde(rename = "station")]
    stations: Vec<WrittenSender>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenSender {
    id: u32,
    key: Zeroizing<String>,
    salt: u32,
}

impl TryFrom<WrittenSender> for SenderKeys {
    type Error = KeyFileError;

    fn try_from(written: WrittenSender) -> Result<Self, KeyFileError> {
        let WrittenSender { id, key, salt } = written;
        let mut bytes = Zeroizing::new([0; 16]);
        let decoded = base16ct::mixed::decode(key.as_bytes(), &mut *bytes);
        match decoded {
            Ok(all) if all.len() == 16 => Ok(Self {
                id,
                key: bytes,
                salt,
            }),
            _ => Err(KeyFileError::BadKey(id)),
        }
    }
}

impl KeyFile {
    /// The file at `path`: Keys.mk if its name ends in `.mk`, TOML otherwise.
    ///
    /// # Errors
    ///
    /// [`KeyFileError::Io`], [`KeyFileError::Exposed`], or [`KeyFileError::Content`] with whatever is wrong
    /// first.
    pub fn read(path: &Path, exceptions: Exceptions) -> Result<Self, KeyFileError> {
        let fault = |error| io_error(path, error);
        let mut file = File::open(path).map_err(fault)?;
        let about = file.metadata().map_err(fault)?;
        // Of the file that is open: nobody can put another in its place in between.
        if !exceptions.exposed_file
            && let Some(mode) = exposed(&about)
        {
            let path = path.to_owned();
            return Err(KeyFileError::Exposed { path, mode });
        }
        // Room for all of it, so that no copy is left behind where it would have to grow.
        let room = usize::try_from(about.len()).unwrap_or(0).saturating_add(1);
        let mut text = Zeroizing::new(String::with_capacity(room));
        file.read_to_string(&mut text).map_err(fault)?;
        let read = if is_keys_mk(path) {
            Self::from_keys_mk(&text, exceptions)
        } else {
            Self::from_toml(&text, exceptions)
        };
        read.map_err(|fault| KeyFileError::Content {
            path: path.to_owned(),
            fault: Box::new(fault),
        })
    }

    /// The file with this content.
    ///
    /// # Errors
    ///
    /// [`KeyFileError`], whatever is wrong first.
    pub fn from_toml(text: &str, exceptions: Exceptions) -> Result<Self, KeyFileError> {
        let text = without_mark(text);
        let written: Written = toml::from_str(text).map_err(|error| syntax(text, &error))?;
        let header = HeaderKind::named(&written.header).ok_or(KeyFileError::UnknownHeader)?;
        let stations = written.stations.into_iter().map(SenderKeys::try_from);
        let file = Self::checked(
            written.vehicle.try_into()?,
            stations.collect::<Result<_, _>>()?,
            exceptions,
        )?;
        file.with_header(header)
    }

    /// The file with this content, in the form of SMACCMPilot's Keys.mk: six variables of GNU make.
    ///
    /// Numbers are decimal, whatever they begin with: `017235` is 17235.
    ///
    /// # Errors
    ///
    /// [`KeyFileError`], whatever is wrong first.
    pub fn from_keys_mk(text: &str, exceptions: Exceptions) -> Result<Self, KeyFileError> {
        let mut variables = Variables::read(without_mark(text))?;
        let mut sender = |id, key, salt| {
            Ok(SenderKeys {
                id: variables.number(id, MAX_OLD_ID)?,
                key: variables.key(key)?,
                salt: variables.number(salt, u32::MAX)?,
            })
        };
        let vehicle = sender("UAV_ID", "UAV_KEY", "UAV_SALT")?;
        let station = sender("BASE_ID", "BASE_KEY", "BASE_SALT")?;
        variables.nothing_else()?;
        Self::checked(vehicle, vec![station], exceptions)
    }

    /// The file of these senders and the header `id-counter`, if nothing is wrong with it.
    ///
    /// # Errors
    ///
    /// [`KeyFileError`], whatever is wrong first.
    pub fn checked(
        vehicle: SenderKeys,
        stations: Vec<SenderKeys>,
        exceptions: Exceptions,
    ) -> Result<Self, KeyFileError> {
        if !(1..=MAX_STATIONS).contains(&stations.len()) {
            return Err(KeyFileError::StationCount(stations.len()));
        }
        let file = Self {
            header: HeaderKind::default(),
            vehicle,
            stations,
        };
        for (at, sender) in file.senders().enumerate() {
            if *sender.key == [0; 16] {
                return Err(KeyFileError::AllZero(sender.id));
            }
            if *sender.key == [0xFF; 16] {
                return Err(KeyFileError::Erased(sender.id));
            }
            if !exceptions.published_keys && PUBLISHED.contains(&sender.key) {
                return Err(KeyFileError::Published(sender.id));
            }
            for (before, other) in file.senders().take(at).enumerate() {
                if other.id == sender.id {
                    return Err(KeyFileError::DuplicateId(sender.id));
                }
                if other.key != sender.key {
                    continue;
                }
                if before == 0 {
                    return Err(KeyFileError::VehicleKeyShared(sender.id));
                }
                if !exceptions.shared_station_keys {
                    return Err(KeyFileError::StationKeyShared(other.id, sender.id));
                }
            }
        }
        Ok(file)
    }

    /// The same senders with another header, for keys that were never used. What they sealed with one
    /// header may have used the nonces of the other.
    ///
    /// # Errors
    ///
    /// [`KeyFileError::IdTooLarge`].
    pub fn with_header(self, header: HeaderKind) -> Result<Self, KeyFileError> {
        let mut ids = self.senders().map(|sender| sender.id);
        if let Some(id) = ids.find(|id| *id > header.max_id()) {
            return Err(KeyFileError::IdTooLarge(id, header.name()));
        }
        drop(ids);
        Ok(Self { header, ..self })
    }

    /// The header of all packages.
    #[must_use]
    pub const fn header(&self) -> HeaderKind {
        self.header
    }

    /// The vehicle.
    #[must_use]
    pub const fn vehicle(&self) -> &SenderKeys {
        &self.vehicle
    }

    /// The stations: 1 to 64, in the order of the file.
    #[must_use]
    pub fn stations(&self) -> &[SenderKeys] {
        &self.stations
    }

    /// The vehicle, then the stations.
    fn senders(&self) -> impl Iterator<Item = &SenderKeys> {
        [&self.vehicle].into_iter().chain(&self.stations)
    }

    /// The file's content as TOML.
    #[must_use]
    pub fn to_toml(&self) -> Zeroizing<String> {
        // Room for all of it, so that no copy is left behind where it would have to grow.
        let mut text = Zeroizing::new(String::with_capacity(256 * (2 + self.stations.len())));
        text.push_str(
            "# Keys of a sealed MAVLink link. Whoever has them can read it and speak on it.\n",
        );
        text.push_str("header = \"");
        text.push_str(self.header.name());
        text.push_str("\"\n");
        for (at, sender) in self.senders().enumerate() {
            let title = if at == 0 { "[vehicle]" } else { "[[station]]" };
            let key = Zeroizing::new(base16ct::lower::encode_string(&*sender.key));
            let lines = [
                "\n",
                title,
                "\nid = ",
                &sender.id.to_string(),
                "\nkey = \"",
                &key,
                "\"\nsalt = ",
                &sender.salt.to_string(),
                "\n",
            ];
            lines.iter().for_each(|part| text.push_str(part));
        }
        text
    }

    /// Writes the file to `path`, as TOML, for its owner alone to read.
    ///
    /// # Errors
    ///
    /// [`KeyFileError::Io`], also if there is a file already: it is never overwritten.
    /// [`KeyFileError::NameOfKeysMk`]. What could not be written to its end is removed.
    pub fn write_new(&self, path: &Path) -> Result<(), KeyFileError> {
        if is_keys_mk(path) {
            return Err(KeyFileError::NameOfKeysMk);
        }
        write_new(path, &self.to_toml())
    }

    /// Writes [`to_rust_source`](Self::to_rust_source) to `path`, for its owner alone to read: for build
    /// scripts. What an earlier build left there is removed first, whoever could read it.
    ///
    /// # Errors
    ///
    /// [`KeyFileError::NoStation`], [`KeyFileError::Io`].
    pub fn write_rust_source(&self, who: Role, path: &Path) -> Result<(), KeyFileError> {
        let source = self.to_rust_source(who)?;
        match fs::remove_file(path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(io_error(path, error)),
            _ => write_new(path, &source),
        }
    }
}

/// Writes a file that was not there, for its owner alone to read from its first moment.
fn write_new(path: &Path, text: &str) -> Result<(), KeyFileError> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(path).map_err(|error| io_error(path, error))?;
    let written = file.write_all(text.as_bytes());
    let written = written.and_then(|()| file.sync_all());
    written.map_err(|error| {
        // Of two errors the first one is returned.
        let _ = fs::remove_file(path);
        io_error(path, error)
    })
}

/// The permissions of a file, if any of them is for group or others: who may write it chooses the keys.
#[cfg(unix)]
fn exposed(about: &fs::Metadata) -> Option<u32> {
    let mode = std::os::unix::fs::MetadataExt::mode(about) & 0o7777;
    Some(mode).filter(|mode| mode & 0o077 != 0)
}

/// Nothing is known of other systems' permissions.
#[cfg(not(unix))]
const fn exposed(_: &fs::Metadata) -> Option<u32> {
    None
}

/// Whether the file has the name of one for make.
fn is_keys_mk(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "mk")
}

/// Without the byte order mark that some editors write.
fn without_mark(text: &str) -> &str {
    text.strip_prefix('\u{FEFF}').unwrap_or(text)
}

fn io_error(path: &Path, error: io::Error) -> KeyFileError {
    KeyFileError::Io {
        path: path.to_owned(),
        error,
    }
}

/// Where TOML is wrong. The parser's text is shown only where it names fields alone: it may quote the line,
/// which may be a key.
fn syntax(text: &str, error: &toml::de::Error) -> KeyFileError {
    let at = error.span().map_or(0, |span| span.start);
    let before = text.get(..at).unwrap_or_default();
    let what = match error.message() {
        message if message.starts_with("missing field") => message,
        _ => "not what a key file has there",
    };
    KeyFileError::Syntax {
        line: before.matches('\n').count() + 1,
        what: what.to_owned(),
    }
}

/// The variables of a Keys.mk that were not yet asked for: line, name and value.
struct Variables<'a>(Vec<(usize, &'a str, &'a str)>);

impl<'a> Variables<'a> {
    /// `NAME = value` on a line each. What follows a `#` is a comment.
    fn read(text: &'a str) -> Result<Self, KeyFileError> {
        let mut variables: Vec<(usize, &str, &str)> = Vec::new();
        for (line, content) in (1..).zip(text.lines()) {
            let (content, _) = content.split_once('#').unwrap_or((content, ""));
            if content.trim().is_empty() {
                continue;
            }
            let fault = |what: &str| KeyFileError::Syntax {
                line,
                what: what.to_owned(),
            };
            let (name, value) = content
                .split_once('=')
                .ok_or_else(|| fault("not a variable and its value"))?;
            let name = name.trim_end_matches([':', '?', ' ', '\t']).trim_start();
            if variables.iter().any(|(_, other, _)| *other == name) {
                return Err(fault("a variable that was set before"));
            }
            variables.push((line, name, value.trim()));
        }
        Ok(Self(variables))
    }

    fn take(&mut self, name: &'static str) -> Result<(usize, &'a str), KeyFileError> {
        let mut variables = self.0.iter();
        let at = variables.position(|(_, other, _)| *other == name);
        let at = at.ok_or(KeyFileError::Missing(name))?;
        let (line, _, value) = self.0.swap_remove(at);
        Ok((line, value))
    }

    fn number(&mut self, name: &'static str, max: u32) -> Result<u32, KeyFileError> {
        let (line, value) = self.take(name)?;
        let number = decimal(value).filter(|number| *number <= max);
        number.ok_or_else(|| KeyFileError::Syntax {
            line,
            what: format!("{name} is not a decimal number from 0 to {max}"),
        })
    }

    fn key(&mut self, name: &'static str) -> Result<Zeroizing<[u8; 16]>, KeyFileError> {
        let (line, value) = self.take(name)?;
        parse_key(value).ok_or_else(|| KeyFileError::Syntax {
            line,
            what: format!("{name} is not 16 decimal numbers from 0 to 255: [1,2,...]"),
        })
    }

    fn nothing_else(&self) -> Result<(), KeyFileError> {
        match self.0.iter().min() {
            None => Ok(()),
            Some((line, ..)) => Err(KeyFileError::Syntax {
                line: *line,
                what: "a variable that Keys.mk does not have".to_owned(),
            }),
        }
    }
}

/// Digits and nothing else, in decimal; none if the number is too large.
fn decimal<T: std::str::FromStr>(digits: &str) -> Option<T> {
    let all_digits = digits.bytes().all(|byte| byte.is_ascii_digit());
    all_digits.then(|| digits.parse().ok()).flatten()
}

fn parse_key(value: &str) -> Option<Zeroizing<[u8; 16]>> {
    let list = value.strip_prefix('[')?.strip_suffix(']')?;
    let mut numbers = list.split(',');
    let mut key = Zeroizing::new([0; 16]);
    for byte in key.iter_mut() {
        *byte = decimal(numbers.next()?.trim())?;
    }
    numbers.next().is_none().then_some(key)
}
