//! What another implementation is asked to do, and those that are asked.

mod mavio;
mod mavlink;
mod pymavlink;

use std::path::Path;

use anyhow::Result;

use crate::messages::Message;

pub(crate) use pymavlink::Pymavlink;

/// A frame that somebody is to make and sign.
#[derive(Clone, Debug)]
pub(crate) struct Order<'a> {
    pub(crate) message: &'a Message,
    /// Whole, with the zeros at its end.
    pub(crate) payload: &'a [u8],
    pub(crate) sequence: u8,
    pub(crate) system_id: u8,
    pub(crate) component_id: u8,
    pub(crate) link_id: u8,
    /// When it is to be signed; a peer that asks the machine's clock does not look at it.
    pub(crate) ticks: u64,
}

/// Another implementation of the standard's signature.
pub(crate) trait Peer {
    /// Its name in its registry.
    fn name(&self) -> &'static str;

    /// The version that runs.
    fn version(&self) -> &str;

    /// Makes and signs a frame of a message with this payload, or with a payload near it that the
    /// peer's own types can say.
    fn sign(&mut self, order: &Order) -> Result<Vec<u8>>;

    /// Whether there is a receiver to ask, which there is not of one that signs in yet another way.
    fn receives(&self) -> bool {
        true
    }

    /// Forgets every frame; its clock, where it has one of its own to set, is at `ticks`.
    fn restart(&mut self, ticks: u64) -> Result<()>;

    /// Whether it hands on what is in `frame`.
    fn accepts(&mut self, frame: &[u8]) -> Result<bool>;
}

/// All of them; `python` has pymavlink, and `definitions` is the dialect that it generated.
pub(crate) fn all(python: &Path, definitions: &Path, key: &[u8; 32]) -> Result<Vec<Box<dyn Peer>>> {
    Ok(vec![
        Box::new(Pymavlink::start(python, definitions, key)?),
        Box::new(mavlink::Mavlink::new(key)),
        Box::new(mavio::Mavio::new(key, mavio::Flag::AsDocumented)),
        Box::new(mavio::Mavio::new(key, mavio::Flag::First)),
    ])
}

/// The version of a package that this was built with.
fn built_with(package: &str) -> &'static str {
    let lock = include_str!("../Cargo.lock");
    let name = format!("name = \"{package}\"");
    let mut lines = lock.lines().skip_while(|line| *line != name).skip(1);
    let version = lines
        .next()
        .and_then(|line| line.strip_prefix("version = "));
    version.map_or("unknown", |version| version.trim_matches('"'))
}

#[cfg(test)]
mod tests {
    use super::built_with;

    #[test]
    fn versions_of_the_peers_are_known() {
        for peer in ["mavlink", "mavio"] {
            let version = built_with(peer);
            assert!(
                version.starts_with(|c: char| c.is_ascii_digit()),
                "{peer} {version}"
            );
        }
        assert_eq!(built_with("no such package"), "unknown");
    }
}
