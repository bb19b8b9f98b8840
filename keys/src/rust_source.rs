//! The key file as constants of a program.

use std::fmt::Write as _;

use zeroize::Zeroizing;

use crate::error::KeyFileError;
use crate::file::{HeaderKind, KeyFile, SenderKeys};

/// Whose image it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The vehicle's: it hears every station.
    Vehicle,
    /// That of the station with this id: it hears the vehicle.
    Station(u32),
}

impl KeyFile {
    /// Rust source with two statics of `mavlink_commsec::Credential`: `OWN`, what the image seals with, and
    /// `PEERS`, whom it hears. Their type says which header the file has. A program that uses them with the
    /// other does not compile.
    ///
    /// # Errors
    ///
    /// [`KeyFileError::NoStation`].
    pub fn to_rust_source(&self, who: Role) -> Result<Zeroizing<String>, KeyFileError> {
        let (own, peers) = match who {
            Role::Vehicle => (self.vehicle(), self.stations()),
            Role::Station(id) => {
                let mut stations = self.stations().iter();
                let own = stations.find(|station| station.id == id);
                let own = own.ok_or(KeyFileError::NoStation(id))?;
                (own, std::slice::from_ref(self.vehicle()))
            }
        };
        // Room for all of it, so that no copy is left behind where it would have to grow.
        let mut text = Zeroizing::new(String::with_capacity(512 * (2 + peers.len())));
        let (kind, id) = match self.header() {
            HeaderKind::IdCounter => ("Credential", "SenderId"),
            HeaderKind::CounterEpochId => (
                "Credential<::mavlink_commsec::EpochSenderId>",
                "EpochSenderId",
            ),
        };
        text.push_str("// What this image seals with, and whom it hears. Made from the key file: keep it secret.\n\n");
        text.push_str("/// What this image seals with.\n");
        // Writing to a string cannot fail.
        let _ = write!(text, "pub static OWN: ::mavlink_commsec::{kind} = ");
        credential(&mut text, own, id, "");
        text.push_str(";\n\n/// Whom it hears.\n");
        let _ = writeln!(
            text,
            "pub static PEERS: [::mavlink_commsec::{kind}; {}] = [",
            peers.len()
        );
        for peer in peers {
            text.push_str("    ");
            credential(&mut text, peer, id, "    ");
            text.push_str(",\n");
        }
        text.push_str("];\n");
        Ok(text)
    }
}

fn credential(text: &mut String, sender: &SenderKeys, kind: &str, indent: &str) {
    let SenderKeys { id, key, salt } = sender;
    let _ = write!(
        text,
        "::mavlink_commsec::Credential {{\n\
         {indent}    id: ::mavlink_commsec::{kind}({id}),\n\
         {indent}    key: {key:?},\n\
         {indent}    salt: {salt},\n\
         {indent}}}",
        key = **key,
    );
}
