//! Frames that peers made, kept so that the plain tests need no network.

use std::{fmt::Write as _, fs, path::Path};

use anyhow::{Context, Result};
use rand::{SeedableRng, rngs::SmallRng};

use crate::{
    here, hex,
    messages::Message,
    payloads::Kind,
    peers::{Order, Peer},
};

/// Messages of `common`: short and long, with extensions and without, of every type of field.
const MESSAGES: [&str; 12] = [
    "HEARTBEAT",
    "GPS_RAW_INT",
    "ATTITUDE",
    "COMMAND_LONG",
    "RADIO_STATUS",
    "SERIAL_CONTROL",
    "ENCAPSULATED_DATA",
    "BATTERY_STATUS",
    "AUTOPILOT_VERSION",
    "STATUSTEXT",
    "SETUP_SIGNING",
    "TUNNEL",
];
const KINDS: [Kind; 3] = [Kind::Zeros, Kind::Random, Kind::WithoutExtensions];

/// Writes a file in `folder` for each peer whose frames are authentic.
pub(crate) fn write(
    folder: &Path,
    peers: &mut [Box<dyn Peer>],
    messages: &[Message],
    passphrase: &str,
    seed: u64,
) -> Result<()> {
    fs::create_dir_all(folder)?;
    // The other way to sign with the same crate makes frames that nobody accepts.
    for peer in peers.iter_mut().filter(|peer| peer.receives()) {
        let (name, _) = peer.name().split_once(',').unwrap_or((peer.name(), ""));
        let file = format!("{name}-{}.txt", peer.version());
        let mut text = format!(
            "# Frames that {} {} signed, one a line: message, payload, frame.\n\
             # Written by `cargo xtask interop --vectors`; pass-phrase: {passphrase}\n",
            peer.name(),
            peer.version()
        );
        let mut random = SmallRng::seed_from_u64(seed);
        let mut ticks = here::now()?;
        for name in MESSAGES {
            let message = messages.iter().find(|message| message.name == name);
            let message = message.with_context(|| name.to_owned())?;
            for kind in KINDS {
                ticks = here::now()?.max(ticks + 1);
                let frame = peer.sign(&Order {
                    message,
                    payload: &kind.payload(message, &mut random),
                    sequence: 17,
                    system_id: 1,
                    component_id: 190,
                    link_id: 3,
                    ticks,
                })?;
                writeln!(text, "{name} {} {}", kind.name(), hex::encode(&frame))?;
            }
        }
        let path = folder.join(file);
        fs::write(&path, text).with_context(|| path.display().to_string())?;
        eprintln!("{}", path.display());
    }
    Ok(())
}
