//! `cargo xtask keys`: fresh keys for a sealed link, or a look at those there are.

use std::path::PathBuf;

use anyhow::{Result, anyhow};
use clap::Args;
use mavseal_keys::{Exceptions, HeaderKind, KeyFile};

/// Options of `cargo xtask keys`.
#[derive(Args)]
pub(crate) struct Options {
    /// The key file, which must not be there yet
    #[arg(default_value = "keys.toml")]
    path: PathBuf,
    /// How many ground stations
    #[arg(long, value_name = "N", default_value_t = 1)]
    stations: usize,
    /// The header of the packages that they seal: `id-counter` or `counter-epoch-id`
    #[arg(long, default_value = HeaderKind::default().name(), value_parser = header)]
    header: HeaderKind,
    /// Make nothing; say who has keys in the file, which may be a Keys.mk, or what is wrong with it
    #[arg(long, conflicts_with_all = ["stations", "header"])]
    check: bool,
    /// With --check: let keys pass that were published
    #[arg(long, requires = "check")]
    published_keys: bool,
    /// With --check: let several stations have one key
    #[arg(long, requires = "check")]
    shared_station_keys: bool,
}

fn header(name: &str) -> Result<HeaderKind> {
    HeaderKind::named(name).ok_or_else(|| anyhow!("there is no header {name}"))
}

/// Makes or checks a key file.
///
/// # Errors
/// If there is a file where one is to be made, or something is wrong with one that is to be checked.
pub(crate) fn run(options: &Options) -> Result<()> {
    let path = &options.path;
    let file = if options.check {
        let exceptions = Exceptions {
            published_keys: options.published_keys,
            shared_station_keys: options.shared_station_keys,
        };
        KeyFile::read(path, exceptions)?
    } else {
        let file = KeyFile::generate(options.stations)?.with_header(options.header)?;
        file.write_new(path)?;
        file
    };
    let ids = file.stations().iter().map(|station| station.id.to_string());
    println!(
        "{}: header {}; vehicle {}; stations {}",
        path.display(),
        file.header().name(),
        file.vehicle().id,
        Vec::from_iter(ids).join(", ")
    );
    Ok(())
}
