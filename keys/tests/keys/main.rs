//! The key file: read, rejected, made, and turned into constants.

use std::{
    fs,
    path::{Path, PathBuf},
};

use mavseal_keys::{Exceptions, HeaderKind, KeyFile, KeyFileError, MAX_STATIONS, Role, SenderKeys};

mod constants;

/// As the template of SMACCMPilot has it.
const KEYS_MK: &str = include_str!("smaccmpilot.mk");
const TOML: &str = include_str!("two_stations.toml");

const PUBLISHED: Exceptions = Exceptions {
    published_keys: true,
    shared_station_keys: false,
    exposed_file: false,
};

fn toml(text: &str) -> Result<KeyFile, KeyFileError> {
    KeyFile::from_toml(text, Exceptions::default())
}

fn keys_mk(text: &str) -> Result<KeyFile, KeyFileError> {
    KeyFile::from_keys_mk(text, PUBLISHED)
}

/// Why `text` is rejected, in words.
fn fault(read: Result<KeyFile, KeyFileError>) -> String {
    read.expect_err("rejected").to_string()
}

fn sender(id: u32, key: u8, salt: u32) -> SenderKeys {
    SenderKeys {
        id,
        key: [key; 16].into(),
        salt,
    }
}

#[test]
fn keys_mk_is_read_in_decimal() {
    let file = keys_mk(KEYS_MK).expect("a key file");
    let vehicle = file.vehicle();
    assert_eq!((vehicle.id, vehicle.salt), (7, 9_219_834));
    let descending: [u8; 16] = std::array::from_fn(|at| 15 - at as u8);
    assert_eq!(*vehicle.key, descending);
    let [station] = file.stations() else {
        panic!("one station")
    };
    // Octal, it would be 7837.
    assert_eq!((station.id, station.salt), (5, 17_235));
    let ascending: [u8; 16] = std::array::from_fn(|at| at as u8);
    assert_eq!(*station.key, ascending);
    // Spaces, assignments and comments as make takes them.
    let spaced = KEYS_MK.replace("BASE_ID=5", "  BASE_ID := 5  # this station");
    assert_eq!(keys_mk(&spaced).expect("a key file"), file);
}

#[test]
fn published_keys_are_rejected() {
    let read = KeyFile::from_keys_mk(KEYS_MK, Exceptions::default());
    assert!(matches!(read, Err(KeyFileError::Published(7))));
    for first in [
        "000102030405060708090a0b0c0d0e0f",
        "0f0e0d0c0b0a09080706050403020100",
        "0102030405060708090a0b0c0d0e0f10",
        "1817161514131211100f0e0d0c0b0a09",
        "7d0f6a1be4c2935808de17ab4f5c6e22",
        "b5cc1a3e8f8d5a6c01f2d8c37b0e94aa",
        // Those of commsec/README.md, which are text.
        "31362072616e646f6d2062797465732e",
        "3136206f746865722062797465732e2e",
        "616e6f74686572203136206279746573",
    ] {
        let text = TOML.replace("8e1f7b2ce4c2935808de17ab4f5c6e22", first);
        assert!(matches!(toml(&text), Err(KeyFileError::Published(1))));
        assert!(KeyFile::from_toml(&text, PUBLISHED).is_ok());
    }
}

#[test]
fn faults_of_keys_mk() {
    for (from, to, expected) in [
        ("UAV_ID=7\n", "", "UAV_ID is missing"),
        (
            "UAV_ID=7",
            "UAV_ID=16",
            "line 2: UAV_ID is not a decimal number from 0 to 15",
        ),
        (
            "UAV_ID=7",
            "UAV_ID=",
            "line 2: UAV_ID is not a decimal number from 0 to 15",
        ),
        (
            "UAV_ID=7",
            "UAV_ID=+7",
            "line 2: UAV_ID is not a decimal number from 0 to 15",
        ),
        ("UAV_ID=7", "UAV_ID=5", "id 5 is given twice"),
        (
            "UAV_ID=7",
            "BASE_ID=5",
            "line 3: a variable that was set before",
        ),
        (
            "UAV_ID=7",
            "UAV_ID=7\nKEY=1",
            "line 3: a variable that Keys.mk does not have",
        ),
        (
            "UAV_ID=7",
            "UAV_ID 7",
            "line 2: not a variable and its value",
        ),
        (
            "9219834",
            "4294967296",
            "line 6: UAV_SALT is not a decimal number from 0 to 4294967295",
        ),
        (
            "9219834",
            "0x8caefa",
            "line 6: UAV_SALT is not a decimal number from 0 to 4294967295",
        ),
        (
            "[15,",
            "[256,",
            "line 4: UAV_KEY is not 16 decimal numbers from 0 to 255: [1,2,...]",
        ),
        (
            "[15,",
            "[",
            "line 4: UAV_KEY is not 16 decimal numbers from 0 to 255: [1,2,...]",
        ),
        (
            "[15,",
            "[15,15,",
            "line 4: UAV_KEY is not 16 decimal numbers from 0 to 255: [1,2,...]",
        ),
        (
            "[15,14",
            "15,14",
            "line 4: UAV_KEY is not 16 decimal numbers from 0 to 255: [1,2,...]",
        ),
        (
            "[15,14,13,12,11,10,9,8,7,6,5,4,3,2,1,0]",
            "[0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0]",
            "the key of sender 7 is all zeros",
        ),
        (
            "[15,14,13,12,11,10,9,8,7,6,5,4,3,2,1,0]",
            "[0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,15]",
            "the vehicle and station 5 have the same key",
        ),
    ] {
        assert!(KEYS_MK.contains(from), "{from}");
        let text = KEYS_MK.replacen(from, to, 1);
        assert_eq!(fault(keys_mk(&text)), expected);
    }
}

#[test]
fn toml_is_read() {
    let file = toml(TOML).expect("a key file");
    assert_eq!((file.vehicle().id, file.vehicle().salt), (0, 0xDEAD_BEEF));
    let stations = file.stations().iter();
    let stations: Vec<_> = stations.map(|s| (s.id, s.key[15], s.salt)).collect();
    assert_eq!(stations, [(1, 0x22, 0x1234_5678), (4_000_000_000, 0x23, 0)]);
}

#[test]
fn faults_of_toml() {
    let vehicle_key = "c6dd2b4f9f8d5a6c01f2d8c37b0e94ab";
    let station_key = "8e1f7b2ce4c2935808de17ab4f5c6e22";
    let elsewhere = "not what a key file has there";
    let not_16 = "the key of sender 0 is not 16 bytes, as 32 hexadecimal digits";
    for (from, to, expected) in [
        (
            "id-counter",
            "epoch-id",
            "the header is neither `id-counter` nor `counter-epoch-id`".to_owned(),
        ),
        (
            "header = \"id-counter\"\n",
            "",
            "line 1: missing field `header`".to_owned(),
        ),
        ("id = 0\n", "", "line 4: missing field `id`".to_owned()),
        (
            "salt = 0\n",
            "salt = 017235\n",
            format!("line 17: {elsewhere}"),
        ),
        ("salt = 0\n", "salt = -1\n", format!("line 17: {elsewhere}")),
        (
            "salt = 0\n",
            "salt = 4294967296\n",
            format!("line 17: {elsewhere}"),
        ),
        (
            "salt = 0\n",
            "salt = 0\nsalt = 0\n",
            format!("line 18: {elsewhere}"),
        ),
        (
            "salt = 0\n",
            "salt = 0\nsugar = 1\n",
            format!("line 18: {elsewhere}"),
        ),
        (vehicle_key, "", not_16.to_owned()),
        (vehicle_key, &vehicle_key[1..], not_16.to_owned()),
        (vehicle_key, &vehicle_key[2..], not_16.to_owned()),
        (vehicle_key, &format!("{vehicle_key}00"), not_16.to_owned()),
        (
            vehicle_key,
            &vehicle_key.replace('b', "g"),
            not_16.to_owned(),
        ),
        (
            vehicle_key,
            &"0".repeat(32),
            "the key of sender 0 is all zeros".to_owned(),
        ),
        (
            vehicle_key,
            &"fF".repeat(16),
            "the key of sender 0 is all ones: erased flash".to_owned(),
        ),
        (
            "id-counter",
            "counter-epoch-id",
            "id 4000000000 is too large for the header `counter-epoch-id`".to_owned(),
        ),
        // One file has one header, and no sender one of his own: what would be two formats under one key.
        (
            "salt = 0\n",
            "salt = 0\nheader = \"counter-epoch-id\"\n",
            format!("line 18: {elsewhere}"),
        ),
        (
            "header = \"id-counter\"\n",
            "header = \"id-counter\"\nheader = \"counter-epoch-id\"\n",
            format!("line 3: {elsewhere}"),
        ),
        (
            "header = \"id-counter\"\n",
            "header = [\"id-counter\", \"counter-epoch-id\"]\n",
            format!("line 2: {elsewhere}"),
        ),
        (
            "id = 4000000000",
            "id = 1",
            "id 1 is given twice".to_owned(),
        ),
        (
            "id = 4000000000",
            "id = 0",
            "id 0 is given twice".to_owned(),
        ),
        (
            vehicle_key,
            station_key,
            "the vehicle and station 1 have the same key".to_owned(),
        ),
        (
            "6E23",
            "6E22",
            "stations 1 and 4000000000 have the same key".to_owned(),
        ),
    ] {
        assert!(TOML.contains(from), "{from}");
        assert_eq!(fault(toml(&TOML.replacen(from, to, 1))), expected);
    }
}

/// The file that the documentation shows is no key file: its keys are published.
#[test]
fn example_of_the_documentation_is_rejected() {
    let readme = include_str!("../../README.md");
    let (_, rest) = readme.split_once("```toml\n").expect("an example");
    let (example, _) = rest.split_once("```").expect("its end");
    assert!(matches!(toml(example), Err(KeyFileError::Published(0))));
    assert!(KeyFile::from_toml(example, PUBLISHED).is_ok());
}

#[test]
fn headers() {
    let small = TOML.replacen("4000000000", "65535", 1);
    assert_eq!(
        toml(&small).expect("a key file").header(),
        HeaderKind::IdCounter
    );
    let epochs = small.replacen("id-counter", "counter-epoch-id", 1);
    let file = toml(&epochs).expect("a key file");
    assert_eq!(file.header(), HeaderKind::CounterEpochId);
    assert_eq!(toml(&file.to_toml()).expect("a key file"), file);
    let other = toml(&small).and_then(|file| file.with_header(HeaderKind::CounterEpochId));
    assert_eq!(other.expect("ids of 16 bits"), file);
    let large = toml(&small.replacen("65535", "65536", 1));
    let large = large.and_then(|file| file.with_header(HeaderKind::CounterEpochId));
    assert!(matches!(large, Err(KeyFileError::IdTooLarge(65_536, _))));
    assert_eq!(
        keys_mk(KEYS_MK).expect("a key file").header(),
        HeaderKind::IdCounter
    );
    assert_eq!(
        HeaderKind::named("counter-epoch-id"),
        Some(HeaderKind::CounterEpochId)
    );
    assert_eq!(HeaderKind::named(""), None);
}

/// An error quotes nothing that may be a key, wherever in the file it stands.
#[test]
fn errors_show_no_keys() {
    let key = "c6dd2b4f9f8d5a6c01f2d8c37b0e94ab";
    let quoted = format!("\"{key}\"");
    for text in [
        TOML.replacen("id = 0", &format!("id = {quoted}"), 1),
        TOML.replacen("salt = 3735928559", &format!("salt = {quoted}"), 1),
        TOML.replacen("key =", "key", 1),
        TOML.replacen(&quoted, key, 1),
        TOML.replacen("key = ", &format!("{key} = "), 1),
        TOML.replacen("header = \"id-counter\"", &format!("header = {quoted}"), 1),
        TOML.replacen("[vehicle]", &format!("[{key}]"), 1),
        format!("{TOML}{key}"),
    ] {
        let error = toml(&text).expect_err("rejected");
        for shown in [error.to_string(), format!("{error:?}")] {
            assert!(!shown.contains(&key[..8]), "{shown}");
        }
    }
    let text = KEYS_MK.replacen("UAV_ID=7", "UAV_ID=[9,9,99,9]", 1);
    assert!(!fault(keys_mk(&text)).contains("99"));
    let file = toml(TOML).expect("a key file");
    let shown = format!("{file:?}");
    assert_eq!(
        shown,
        "KeyFile { header: IdCounter, vehicle: Sender { id: 0, .. }, stations: [Sender { id: 1, .. }, Sender { id: 4000000000, .. }] }"
    );
}

#[test]
fn shared_keys_of_stations_only_on_demand() {
    let stations = || vec![sender(1, 7, 1), sender(2, 7, 1)];
    let shared = Exceptions {
        shared_station_keys: true,
        ..Exceptions::default()
    };
    let read = KeyFile::checked(sender(0, 8, 1), stations(), Exceptions::default());
    assert!(matches!(read, Err(KeyFileError::StationKeyShared(1, 2))));
    assert!(KeyFile::checked(sender(0, 8, 1), stations(), shared).is_ok());
    // The vehicle's is never one of them.
    let read = KeyFile::checked(sender(0, 7, 2), stations(), shared);
    assert!(matches!(read, Err(KeyFileError::VehicleKeyShared(1))));
}

#[test]
fn number_of_stations() {
    let stations = |count: usize| {
        (1..)
            .take(count)
            .map(|id| sender(id, id as u8, 1))
            .collect()
    };
    let read = |count| KeyFile::checked(sender(0, 254, 1), stations(count), Exceptions::default());
    for count in [0, MAX_STATIONS + 1] {
        assert!(matches!(read(count), Err(KeyFileError::StationCount(n)) if n == count));
    }
    for count in [1, MAX_STATIONS] {
        assert_eq!(read(count).expect("a key file").stations().len(), count);
    }
}

#[test]
fn fresh_keys() {
    let file = KeyFile::generate(3).expect("random bytes");
    let ids: Vec<_> = file.stations().iter().map(|station| station.id).collect();
    assert_eq!((file.vehicle().id, &ids[..]), (0, &[1, 2, 3][..]));
    assert_eq!(toml(&file.to_toml()).expect("a key file"), file);
    let other = KeyFile::generate(3).expect("random bytes");
    assert_ne!(other.vehicle().key, file.vehicle().key);
    assert_ne!(other.vehicle().salt, file.vehicle().salt);
    for count in [0, MAX_STATIONS + 1, 1000] {
        let made = KeyFile::generate(count);
        assert!(matches!(made, Err(KeyFileError::StationCount(n)) if n == count));
    }
}

/// Does nothing where there are no modes.
fn set_mode(path: &Path, mode: u32) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("my file");
    }
    let _ = (path, mode);
}

/// A file that anybody else may read or write is not read: it says so, and how to mend it.
#[cfg(unix)]
#[test]
fn files_that_others_may_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("keys.toml");
    let file = KeyFile::generate(1).expect("random bytes");
    file.write_new(&path).expect("written");
    let exposed_file = Exceptions {
        exposed_file: true,
        ..Exceptions::default()
    };
    for mode in [0o640, 0o604, 0o620, 0o602, 0o610, 0o644, 0o4604] {
        set_mode(&path, mode);
        let read = KeyFile::read(&path, Exceptions::default());
        assert!(matches!(&read, Err(KeyFileError::Exposed { mode: m, .. }) if *m == mode));
        let said = fault(read);
        assert!(
            said.contains(&format!("keys.toml: mode {mode:04o} ")),
            "{said}"
        );
        assert!(said.contains("chmod 600"), "{said}");
        let read = KeyFile::read(&path, exposed_file);
        assert_eq!(read.expect("a key file"), file);
    }
    for mode in [0o600, 0o400, 0o700] {
        set_mode(&path, mode);
        assert!(KeyFile::read(&path, Exceptions::default()).is_ok());
    }
    // The file counts, not what leads to it.
    let link = folder.path().join("link.toml");
    std::os::unix::fs::symlink(&path, &link).expect("a link");
    assert!(KeyFile::read(&link, Exceptions::default()).is_ok());
    set_mode(&path, 0o644);
    let read = KeyFile::read(&link, Exceptions::default());
    assert!(matches!(read, Err(KeyFileError::Exposed { .. })));
}

/// What a build script writes is its owner's alone, also where an older build left what anybody can read.
#[test]
fn constants_are_the_owners_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("keys.rs");
    let file = KeyFile::generate(1).expect("random bytes");
    fs::write(&path, "of an older build").expect("written");
    for who in [Role::Vehicle, Role::Station(1)] {
        set_mode(&path, 0o644);
        file.write_rust_source(who, &path).expect("written");
        let source = file.to_rust_source(who).expect("somebody in it");
        assert_eq!(fs::read_to_string(&path).expect("a file"), *source);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let mode = fs::metadata(&path).expect("a file").permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
    }
    let nobody = file.write_rust_source(Role::Station(2), &path);
    assert!(matches!(nobody, Err(KeyFileError::NoStation(2))));
    assert!(path.exists());
    let no_folder = file.write_rust_source(Role::Vehicle, &path.join("keys.rs"));
    assert!(matches!(no_folder, Err(KeyFileError::Io { .. })));
}

#[test]
fn files() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("keys.toml");
    let file = KeyFile::generate(2).expect("random bytes");
    file.write_new(&path).expect("written");
    let read = KeyFile::read(&path, Exceptions::default());
    assert_eq!(read.expect("a key file"), file);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = fs::metadata(&path).expect("a file").permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
    // A file that is there is not written over.
    let other = KeyFile::generate(1).expect("random bytes");
    assert!(matches!(
        other.write_new(&path),
        Err(KeyFileError::Io { .. })
    ));
    let read = KeyFile::read(&path, Exceptions::default());
    assert_eq!(read.expect("a key file"), file);

    let make = folder.path().join("mine.mk");
    assert!(matches!(
        other.write_new(&make),
        Err(KeyFileError::NameOfKeysMk)
    ));
    assert!(!make.exists());
    let old: PathBuf = folder.path().join("Keys.mk");
    fs::write(&old, KEYS_MK).expect("written");
    set_mode(&old, 0o600);
    let read = KeyFile::read(&old, PUBLISHED).expect("a key file");
    assert_eq!(read, keys_mk(KEYS_MK).expect("a key file"));
    let missing = folder.path().join("none.toml");
    assert!(fault(KeyFile::read(&missing, PUBLISHED)).contains("none.toml: "));
    // A fault of the content names the file too.
    fs::write(&old, KEYS_MK.replace("UAV_ID=7\n", "")).expect("written");
    let said = fault(KeyFile::read(&old, PUBLISHED));
    assert!(said.ends_with("Keys.mk: UAV_ID is missing"), "{said}");
}

#[test]
fn a_byte_order_mark_is_skipped() {
    let mark = '\u{FEFF}';
    assert_eq!(
        keys_mk(&format!("{mark}{KEYS_MK}")).expect("a key file"),
        keys_mk(KEYS_MK).expect("a key file")
    );
    assert_eq!(
        toml(&format!("{mark}{TOML}")).expect("a key file"),
        toml(TOML).expect("a key file")
    );
    // Once, and only at the beginning.
    assert_eq!(
        fault(keys_mk(&format!("{mark}{mark}{KEYS_MK}"))),
        "line 1: not a variable and its value"
    );
}

/// Who prints an error with all that is behind it says nothing twice.
#[test]
fn errors_say_nothing_twice() {
    let folder = tempfile::tempdir().expect("a folder");
    let read = KeyFile::read(folder.path(), PUBLISHED).expect_err("a folder");
    let written = KeyFile::generate(1)
        .expect("random bytes")
        .write_new(folder.path());
    for error in [read, written.expect_err("there")] {
        let said = error.to_string();
        assert!(
            said.starts_with(&*folder.path().to_string_lossy()),
            "{said}"
        );
        assert!(std::error::Error::source(&error).is_none(), "{said}");
    }
}

#[test]
fn constants_of_nobody() {
    let file = keys_mk(KEYS_MK).expect("a key file");
    for id in [6, 7] {
        let made = file.to_rust_source(Role::Station(id));
        assert!(matches!(made, Err(KeyFileError::NoStation(n)) if n == id));
    }
}
