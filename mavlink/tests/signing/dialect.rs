//! What the compiler checks about the tables of the chosen dialects, with tables made for it.

use std::{env, fs, path::Path, process::Command};

/// What the compiler says of the module `dialect` with `tables`: each dialect's name, and the id and
/// CRC_EXTRA of its messages.
fn compile(test: &str, tables: &[(&str, &[(u32, u32)])]) -> Result<(), String> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(test);
    let dialect = folder.join("dialect");
    fs::create_dir_all(&dialect).expect("a folder");
    fs::copy(source.join("dialect/mod.rs"), dialect.join("mod.rs")).expect("the module");

    let rows = |messages: &[(u32, u32)]| {
        let rows = messages.iter().map(|(id, extra)| id << 8 | extra);
        format!("{:?}", rows.collect::<Vec<_>>())
    };
    let dialects: String = tables
        .iter()
        .map(|(name, messages)| format!("super::Dialect({name:?}, &{}),", rows(messages)))
        .collect();
    let chosen = format!("pub(super) const CHOSEN: &[super::Dialect] = &[{dialects}];");
    fs::write(dialect.join("tables.rs"), chosen).expect("the tables");

    let module = |name: &str| {
        let path = source.join(name).with_extension("rs");
        format!("#[path = {path:?}] pub mod {name};")
    };
    let (field, header) = (module("field"), module("header"));
    let root = format!("#![no_std] {field} {header} pub mod dialect; pub use header::MessageId;");
    fs::write(folder.join("lib.rs"), root).expect("the root");

    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let mut rustc = Command::new(rustc);
    rustc.args(["--edition=2024", "--crate-type=lib", "--emit=metadata"]);
    rustc
        .args(["--cap-lints=allow", "-o"])
        .arg(folder.join("out"));
    let output = rustc.arg(folder.join("lib.rs")).output().expect("rustc");
    if output.status.success() {
        Ok(())
    } else {
        Err(String::from_utf8_lossy(&output.stderr).into_owned())
    }
}

#[test]
fn a_dialect_and_its_parts_compile() {
    let tables: [(&str, &[(u32, u32)]); 3] = [
        ("whole", &[(0, 50), (1, 124), (300, 217)]),
        ("part", &[(0, 50), (300, 217)]),
        ("empty", &[]),
    ];
    assert_eq!(compile("parts", &tables), Ok(()));
}

/// An id stands for one definition in one dialect and for another one in the next.
#[test]
fn dialects_that_disagree_do_not_compile() {
    for (test, other) in [("disagree", (1, 125)), ("more", (2, 124))] {
        let tables: [(&str, &[(u32, u32)]); 3] = [
            ("one", &[(0, 50), (1, 124)]),
            ("part", &[(0, 50)]),
            ("other", &[(0, 50), other]),
        ];
        let error = compile(test, &tables).expect_err("neither has every row");
        let reason = "the dialects `one` and `other` are both chosen, and neither has every \
                      message of the other: choose one";
        assert!(error.contains(reason), "{error}");
    }
}

/// Bisection would not find every message.
#[test]
fn a_table_that_does_not_ascend_does_not_compile() {
    for (test, messages) in [
        ("descends", [(0, 50), (2, 1), (1, 255)]),
        ("twice", [(0, 50), (1, 1), (1, 2)]),
    ] {
        let error = compile(test, &[("one", &messages)]).expect_err("it does not ascend");
        let reason = "a table's ids do not ascend strictly";
        assert!(error.contains(reason), "{error}");
    }
}
