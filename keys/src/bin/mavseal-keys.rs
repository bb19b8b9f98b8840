//! Makes a key file with fresh keys, or checks one.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Parser;
use mavseal_keys::{Exceptions, HeaderKind, KeyFile, KeyFileError};

/// Makes a key file with fresh keys for a sealed link, or checks one
#[derive(Parser)]
#[command(name = "mavseal-keys")]
struct Options {
    /// The key file. One that is there is never written over
    #[arg(default_value = "keys.toml")]
    path: PathBuf,
    /// How many ground stations
    #[arg(long, value_name = "N", default_value_t = 1)]
    stations: usize,
    /// The header of the packages that they seal: `id-counter` or `counter-epoch-id`
    #[arg(long, default_value = HeaderKind::default().name(), value_parser = header)]
    header: HeaderKind,
    /// Make nothing: say who has keys in the file, which may be a Keys.mk, or what is wrong with it
    #[arg(long, conflicts_with_all = ["stations", "header"])]
    check: bool,
    /// With --check: let keys pass that were published
    #[arg(long, requires = "check")]
    published_keys: bool,
    /// With --check: let several stations have one key
    #[arg(long, requires = "check")]
    shared_station_keys: bool,
    /// With --check: let the file pass although group or others have access to it
    #[arg(long, requires = "check")]
    exposed_file: bool,
}

fn header(name: &str) -> Result<HeaderKind, String> {
    HeaderKind::named(name).ok_or_else(|| format!("there is no header {name}"))
}

fn main() -> ExitCode {
    let options = Options::parse();
    match run(&options) {
        Ok(file) => {
            print(&options.path, &file);
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// The file that was made or checked.
fn run(options: &Options) -> Result<KeyFile, KeyFileError> {
    if options.check {
        let exceptions = Exceptions {
            published_keys: options.published_keys,
            shared_station_keys: options.shared_station_keys,
            exposed_file: options.exposed_file,
        };
        return KeyFile::read(&options.path, exceptions);
    }
    let file = KeyFile::generate(options.stations)?.with_header(options.header)?;
    file.write_new(&options.path)?;
    Ok(file)
}

fn print(path: &Path, file: &KeyFile) {
    let ids = file.stations().iter().map(|station| station.id.to_string());
    println!(
        "{}: header {}; vehicle {}; stations {}",
        path.display(),
        file.header().name(),
        file.vehicle().id,
        Vec::from_iter(ids).join(", ")
    );
}
