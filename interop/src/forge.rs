//! Frames that no sender makes: tampered with, or signed although nobody should.

use mavlink_signing::{
    crc::checksum,
    field::{CHECKSUM_SIZE, HEADER_SIZE},
};
use sha2::{Digest, Sha256};

/// Header and payload, and whatever is to be done with them.
pub(crate) struct Draft {
    pub(crate) bytes: Vec<u8>,
    pub(crate) crc_extra: u8,
}

impl Draft {
    /// The frame's header and payload; `frame` is a whole one with the usual header.
    pub(crate) fn of(frame: &[u8], crc_extra: u8) -> Self {
        Self {
            bytes: frame[..payload_end(frame)].to_vec(),
            crc_extra,
        }
    }

    /// With a right checksum, and signed with `key`.
    pub(crate) fn sign(mut self, key: &[u8; 32], link_id: u8, ticks: u64) -> Vec<u8> {
        self.append_checksum();
        self.bytes.push(link_id);
        self.bytes.extend(&ticks.to_le_bytes()[..6]);
        let digest = Sha256::new_with_prefix(key)
            .chain_update(&self.bytes)
            .finalize();
        self.bytes.extend(&digest[..6]);
        self.bytes
    }

    /// With a right checksum, and nothing behind it.
    pub(crate) fn finish(mut self) -> Vec<u8> {
        self.append_checksum();
        self.bytes
    }

    fn append_checksum(&mut self) {
        let checksum = checksum(&self.bytes[1..], self.crc_extra);
        self.bytes.extend(checksum.to_le_bytes());
    }
}

/// Where a frame's payload ends and its checksum begins.
pub(crate) fn payload_end(frame: &[u8]) -> usize {
    HEADER_SIZE + usize::from(frame[1])
}

/// Makes the checksum right again.
pub(crate) fn repair(frame: &mut [u8], crc_extra: u8) {
    let end = payload_end(frame);
    let checksum = checksum(&frame[1..end], crc_extra).to_le_bytes();
    frame[end..end + CHECKSUM_SIZE].copy_from_slice(&checksum);
}
