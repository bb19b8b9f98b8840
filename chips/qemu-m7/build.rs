//! Hands the linker its scripts, and the vehicle of a sealed link its keys.

fn main() {
    println!("cargo:rustc-link-search={}", env!("CARGO_MANIFEST_DIR"));
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rerun-if-changed=device.x");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    if std::env::var_os("CARGO_FEATURE_LOGGING").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
    #[cfg(feature = "sealing")]
    if let Err(error) = keys::write() {
        println!("cargo::error={error}");
    }
}

/// The key file as constants of the program.
#[cfg(feature = "sealing")]
mod keys {
    use std::{env, error::Error, path::Path};

    use mavseal_keys::{Exceptions, KeyFile, Role};

    /// The variable that names the key file.
    const VARIABLE: &str = "MAVSEAL_KEYS";
    /// If it is set, group or others may have access to that file: for file systems without permissions.
    const EXPOSED: &str = "MAVSEAL_KEYS_EXPOSED";

    pub(crate) fn write() -> Result<(), Box<dyn Error>> {
        println!("cargo::rerun-if-env-changed={VARIABLE}");
        println!("cargo::rerun-if-env-changed={EXPOSED}");
        let path = env::var_os(VARIABLE).ok_or_else(|| {
            format!(
                "{VARIABLE} names no key file. `cargo xtask keys --stations 2 FILE` makes one; then \
                 {VARIABLE}=FILE cargo build --locked, with the whole path of FILE"
            )
        })?;
        let path = Path::new(&path);
        println!("cargo::rerun-if-changed={}", path.display());
        let exceptions = Exceptions {
            exposed_file: env::var_os(EXPOSED).is_some(),
            ..Exceptions::default()
        };
        let keys = KeyFile::read(path, exceptions)?;
        let folder = env::var_os("OUT_DIR").ok_or("cargo sets OUT_DIR")?;
        keys.write_rust_source(Role::Vehicle, &Path::new(&folder).join("keys.rs"))?;
        Ok(())
    }
}
