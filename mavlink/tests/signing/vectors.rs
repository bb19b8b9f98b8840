//! Frames that others signed: every one is authentic, made here the same, and rejected when changed.
//!
//! `cargo xtask interop --vectors` writes the files, each named by its source.

use std::{fs, path::Path};

use mavlink_signing::{field::HEADER_SIZE, *};

struct Vector {
    /// File, message and payload, for whoever reads why a test failed.
    name: String,
    frame: Vec<u8>,
}

impl Vector {
    /// Whether the dialect in use defines its message. The messages of the files are those of `common`.
    fn is_known(&self) -> bool {
        let id = &self.frame[7..HEADER_SIZE];
        let id = MessageId::from_le_bytes(id.try_into().expect("3 bytes"));
        dialect::crc_extra(id).is_some()
    }
}

/// All that the dialect in use defines, file by file, and the key.
fn vectors() -> (Vec<Vec<Vector>>, SigningKey<Standard>) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/vectors");
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("a file").path();
        let text = fs::read_to_string(&path).expect("text");
        assert!(
            text.contains("pass-phrase: correct horse battery staple\n"),
            "{}",
            path.display()
        );
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        let vector = |line: &str| {
            let (name, frame) = line.rsplit_once(' ').expect("a name and a frame");
            let digits = frame.as_bytes().chunks(2);
            let byte = |pair| u8::from_str_radix(str::from_utf8(pair).expect("ASCII"), 16);
            Vector {
                name: format!("{}: {name}", path.display()),
                frame: digits.map(|pair| byte(pair).expect("digits")).collect(),
            }
        };
        files.push(lines.map(vector).filter(Vector::is_known).collect());
    }
    let key = SigningKey::from_passphrase("correct horse battery staple");
    (files, key.expect("a key"))
}

fn verdict(frame: &[u8], key: &SigningKey<Standard>) -> Result<(), VerifyError> {
    authenticate(FrameRef::parse(frame)?, key).map(drop)
}

#[test]
fn there_are_vectors_of_several_sources() {
    let (files, _) = vectors();
    assert!(files.len() >= 3, "{} files", files.len());
    // Every dialect has HEARTBEAT; `common` has all messages of the files.
    let least = if cfg!(feature = "common") { 30 } else { 3 };
    assert!(files.iter().all(|vectors| vectors.len() >= least));
}

#[test]
fn frames_of_others_are_authentic_and_made_the_same() {
    let (files, key) = vectors();
    for Vector { name, frame } in files.iter().flatten() {
        let view = FrameRef::parse(frame).expect(name);
        assert_eq!(view.as_bytes(), frame, "{name}");
        let authentic = authenticate(view, &key).expect(name);
        let payload = &frame[HEADER_SIZE..HEADER_SIZE + usize::from(frame[1])];
        let mut ours = Frame::new(view.header(), payload).expect(name);
        sign_frame(&mut ours, &key, authentic.stamp()).expect(name);
        assert_eq!(ours.as_bytes(), frame, "{name}");
    }
}

#[test]
fn frames_of_others_with_one_bit_changed_are_rejected() {
    let (files, key) = vectors();
    for Vector { name, frame } in files.iter().flatten() {
        let mut changed = frame.clone();
        for at in 0..frame.len() {
            changed[at] ^= 1 << (at % 8);
            assert!(verdict(&changed, &key).is_err(), "{name}, byte {at}");
            changed[at] = frame[at];
        }
        assert_eq!(verdict(&changed, &key), Ok(()), "{name}");
    }
}

#[test]
fn frames_of_others_are_admitted_once() {
    let (files, key) = vectors();
    for vectors in files {
        let mut streams = StreamTable::<1>::new(Links::Any, Window::STRICT);
        for Vector { name, frame } in &vectors {
            let mut admit = || {
                let authentic = authenticate(FrameRef::parse(frame)?, &key)?;
                let now = authentic.stamp().timestamp;
                streams.admit(authentic, now).map(drop)
            };
            assert_eq!(admit(), Ok(()), "{name}");
            assert_eq!(admit(), Err(VerifyError::Replayed), "{name}");
        }
    }
}
