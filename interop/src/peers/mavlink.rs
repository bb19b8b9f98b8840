//! The crate `mavlink`, with its feature `mav2-message-signing`.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use mavlink::{
    MAVLinkMessageRaw, MAVLinkV2MessageRaw, MavHeader, MavlinkReader, MavlinkVersion, Message,
    SigningConfig, SigningData, dialects::all::MavMessage,
};
use rand::{SeedableRng, rngs::SmallRng};

use super::{Order, Peer};

pub(crate) struct Mavlink {
    key: [u8; 32],
    /// One for each link id: it counts on within a tick of the clock.
    senders: BTreeMap<u8, SigningData>,
    receiver: SigningData,
}

impl Mavlink {
    pub(crate) fn new(key: &[u8; 32]) -> Self {
        Self {
            key: *key,
            senders: BTreeMap::new(),
            receiver: signing(key, 0),
        }
    }
}

fn signing(key: &[u8; 32], link_id: u8) -> SigningData {
    SigningData::from_config(SigningConfig::new(*key, link_id, true, false))
}

impl Peer for Mavlink {
    fn name(&self) -> &'static str {
        "mavlink"
    }

    fn version(&self) -> &str {
        super::built_with("mavlink")
    }

    fn sign(&mut self, order: &Order) -> Result<Vec<u8>> {
        let id = order.message.id;
        // Bytes that are no value of an enumeration are no message of this crate: then one that is.
        let message = match MavMessage::parse(MavlinkVersion::V2, id, order.payload) {
            Ok(message) => message,
            Err(_) => {
                let mut random = SmallRng::seed_from_u64(order.ticks);
                MavMessage::random_message_from_id(id, &mut random)
                    .with_context(|| format!("no message {id}"))?
            }
        };
        let header = MavHeader {
            sequence: order.sequence,
            system_id: order.system_id.into(),
            component_id: order.component_id,
        };
        let mut frame = MAVLinkV2MessageRaw::new();
        frame.serialize_message_for_signing(header, &message);
        let sender = self.senders.entry(order.link_id);
        sender
            .or_insert_with(|| signing(&self.key, order.link_id))
            .sign_message(&mut frame);
        Ok(frame.raw_bytes().to_vec())
    }

    /// Its clock is the machine's.
    fn restart(&mut self, _ticks: u64) -> Result<()> {
        self.receiver = signing(&self.key, 0);
        Ok(())
    }

    fn accepts(&mut self, frame: &[u8]) -> Result<bool> {
        let read = MavlinkReader::new(frame)
            .read_any_raw_message_signed::<MavMessage>(Some(&self.receiver));
        Ok(match read {
            Ok(MAVLinkMessageRaw::V2(raw)) => raw.raw_bytes() == frame,
            Ok(MAVLinkMessageRaw::V1(_)) => true,
            Err(_) => false,
        })
    }
}
