//! The crate `mavio`. It has no receiver that checks signatures: its caller does with its functions.

use anyhow::Result;
use mavio::{
    Frame, Receiver,
    io::StdIoReader,
    protocol::{IncompatFlags, SecretKey, SigningConf, V2},
    utils::MavSha256,
};
use mavlink_signing::{MessageId, dialect};

use super::{Order, Peer};

pub(crate) struct Mavio {
    key: SecretKey,
    flag: Flag,
}

/// When a caller sets the flag that says that a frame is signed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Flag {
    /// Not at all: `add_signature` does, after the checksum has been made.
    AsDocumented,
    /// Before the checksum is made.
    First,
}

impl Mavio {
    pub(crate) fn new(key: &[u8; 32], flag: Flag) -> Self {
        Self {
            key: SecretKey::from(*key),
            flag,
        }
    }
}

impl Peer for Mavio {
    fn name(&self) -> &'static str {
        match self.flag {
            Flag::AsDocumented => "mavio",
            Flag::First => "mavio, flag first",
        }
    }

    fn version(&self) -> &str {
        super::built_with("mavio")
    }

    fn sign(&mut self, order: &Order) -> Result<Vec<u8>> {
        let flags = match self.flag {
            Flag::AsDocumented => IncompatFlags::empty(),
            Flag::First => IncompatFlags::MAVLINK_IFLAG_SIGNED,
        };
        let mut frame = Frame::builder()
            .version(V2)
            .sequence(order.sequence)
            .system_id(order.system_id)
            .component_id(order.component_id)
            .message_id(order.message.id)
            .payload(order.payload)
            .incompat_flags(flags)
            .crc_extra(order.message.crc_extra)
            .build();
        let conf = SigningConf {
            link_id: order.link_id,
            timestamp: order.ticks.into(),
            secret: self.key.clone(),
        };
        frame.add_signature(&mut MavSha256::default(), &conf);
        let mut bytes = vec![0; frame.size()];
        frame.serialize(&mut bytes)?;
        Ok(bytes)
    }

    fn receives(&self) -> bool {
        self.flag == Flag::First
    }

    /// It remembers nothing.
    fn restart(&mut self, _ticks: u64) -> Result<()> {
        Ok(())
    }

    fn accepts(&mut self, frame: &[u8]) -> Result<bool> {
        let Ok(frame) = Receiver::versioned(StdIoReader::new(frame), V2).recv() else {
            return Ok(false);
        };
        let Some(crc_extra) = MessageId::new(frame.message_id()).and_then(dialect::crc_extra)
        else {
            return Ok(false);
        };
        Ok(frame.validate_checksum_with_crc_extra(crc_extra).is_ok()
            && frame
                .validate_signature(&mut MavSha256::default(), &self.key)
                .is_ok())
    }
}
