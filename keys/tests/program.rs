//! The program that makes and checks key files.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use mavseal_keys::{Exceptions, KeyFile};

fn run(folder: &Path, arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_mavseal-keys"));
    program.current_dir(folder).args(arguments);
    program.output().expect("a program")
}

fn text(bytes: &[u8]) -> &str {
    str::from_utf8(bytes).expect("text")
}

#[test]
fn a_file_is_made_and_checked() {
    let folder = tempfile::tempdir().expect("a folder");
    let made = run(folder.path(), &["mine.toml", "--stations", "2"]);
    assert_eq!(text(&made.stderr), "");
    let about = "mine.toml: header id-counter; vehicle 0; stations 1, 2\n";
    assert_eq!(text(&made.stdout), about);
    let path = folder.path().join("mine.toml");
    let file = KeyFile::read(&path, Exceptions::default()).expect("a key file");
    assert_eq!(file.stations().len(), 2);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = fs::metadata(&path).expect("a file").permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
    let checked = run(folder.path(), &["mine.toml", "--check"]);
    assert_eq!(text(&checked.stdout), about);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).expect("my file");
        let checked = run(folder.path(), &["mine.toml", "--check"]);
        assert!(!checked.status.success());
        let said =
            "error: mine.toml: mode 0640 lets others than its owner in: `chmod 600` mends it\n";
        assert_eq!(text(&checked.stderr), said);
        let checked = run(folder.path(), &["mine.toml", "--check", "--exposed-file"]);
        assert_eq!(text(&checked.stdout), about);
    }
}

#[test]
fn a_file_that_is_there_is_kept_and_named_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("keys.toml");
    fs::write(&path, "mine").expect("written");
    for arguments in [&[][..], &["--check", "--exposed-file"]] {
        let output = run(folder.path(), arguments);
        assert!(!output.status.success());
        let said = text(&output.stderr);
        assert_eq!(said.matches("keys.toml").count(), 1, "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert_eq!(
            said.matches("exists").count(),
            usize::from(arguments.is_empty()),
            "{said}"
        );
    }
    assert_eq!(fs::read(&path).expect("a file"), b"mine");
}
