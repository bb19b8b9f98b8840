//! The target about the key file.

use mavseal_keys::{Exceptions, KeyFile, KeyFileError, Role};

/// Any text as a key file, in both forms: what is read is read again from what is written of it, makes
/// constants for everybody in it, and breaks none of the rules; an error shows nothing that may be a key.
pub fn key_file(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else {
        return;
    };
    for published_keys in [false, true] {
        for shared_station_keys in [false, true] {
            let exceptions = Exceptions {
                published_keys,
                shared_station_keys,
                exposed_file: false,
            };
            read(text, exceptions, &KeyFile::from_toml(text, exceptions));
            read(text, exceptions, &KeyFile::from_keys_mk(text, exceptions));
        }
    }
}

fn read(text: &str, exceptions: Exceptions, read: &Result<KeyFile, KeyFileError>) {
    match read {
        Ok(file) => is_kept(file, exceptions),
        Err(error) => {
            let shown = error.to_string();
            let words = text.split(|c: char| !c.is_ascii_hexdigit());
            // No text of an error has so many digits in a row.
            let mut long = words.filter(|word| word.len() >= 16);
            assert!(long.all(|word| !shown.contains(word)));
        }
    }
}

fn is_kept(file: &KeyFile, exceptions: Exceptions) {
    let again = KeyFile::from_toml(&file.to_toml(), exceptions);
    assert_eq!(again.expect("what was written"), *file);
    let senders = || [file.vehicle()].into_iter().chain(file.stations());
    for (at, sender) in senders().enumerate() {
        assert!(sender.id <= file.header().max_id());
        assert!(*sender.key != [0; 16] && *sender.key != [0xFF; 16]);
        for other in senders().take(at) {
            assert_ne!(sender.id, other.id);
            let shared = exceptions.shared_station_keys && other.id != file.vehicle().id;
            assert!(shared || sender.key != other.key);
        }
        let who = [Role::Vehicle, Role::Station(sender.id)][at.min(1)];
        let source = file.to_rust_source(who).expect("somebody in it");
        assert!(source.contains(&format!("SenderId({})", sender.id)));
    }
}
