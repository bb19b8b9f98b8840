//! MAVLink 2 signing a second time, for the peer of the plays: shares no code with `mavlink/`.
//!
//! The HMAC is the crate `hmac-sha256`'s, the checksum the crate `crc`'s, the CRC_EXTRA bytes the
//! crate `mavlink`'s, and the offsets are written out from the MAVLink guide.

use std::{fs, path::PathBuf};

use anyhow::{Context, Result, bail, ensure};
use cargo_metadata::MetadataCommand;
use mavlink::{Message, dialects::ardupilotmega::MavMessage};

/// The bytes of a packet, from its first to its last.
pub type Frame = Vec<u8>;

/// Bytes of a signature: link id, timestamp, tag.
const SIGNATURE_SIZE: usize = 13;

/// The checksum of a packet that ends with its payload.
#[must_use]
pub fn checksum(packet: &[u8], crc_extra: u8) -> [u8; 2] {
    let crc = crc::Crc::<u16>::new(&crc::CRC_16_MCRF4XX);
    let mut digest = crc.digest();
    digest.update(&packet[1..]);
    digest.update(&[crc_extra]);
    digest.finalize().to_le_bytes()
}

/// Makes the checksum right again; CRC_EXTRA is zero for a message that is not in the dialect.
pub fn repair(frame: &mut [u8]) {
    let id = u32::from_le_bytes([frame[7], frame[8], frame[9], 0]);
    let end = 10 + usize::from(frame[1]);
    let checksum = checksum(&frame[..end], MavMessage::extra_crc(id));
    frame[end..end + 2].copy_from_slice(&checksum);
}

/// `frame`, unsigned, as it looks signed by mavseal's own profile with `key` on `link_id` at `ticks` of
/// 10 microseconds since 2015.
#[must_use]
pub fn sign(frame: &[u8], key: &[u8], link_id: u8, ticks: u64) -> Frame {
    let mut signed = frame.to_vec();
    signed[2] |= 1;
    repair(&mut signed);
    signed.push(link_id);
    signed.extend(&ticks.to_le_bytes()[..6]);
    let tag = hmac_sha256::HMAC::mac(&signed, key);
    signed.extend(&tag[..6]);
    signed
}

/// A signed frame as it was before; the signature is not looked at.
#[must_use]
pub fn unsign(signed: &[u8]) -> Frame {
    let mut frame = signed[..signed.len() - SIGNATURE_SIZE].to_vec();
    frame[2] &= !1;
    repair(&mut frame);
    frame
}

/// The timestamp of a signed frame, in ticks of 10 microseconds since 2015.
#[must_use]
pub fn ticks(signed: &[u8]) -> u64 {
    let mut ticks = [0; 8];
    ticks[..6].copy_from_slice(&signed[signed.len() - 12..signed.len() - 6]);
    u64::from_le_bytes(ticks)
}

/// Takes the whole frames from the front of `bytes`.
///
/// # Errors
///
/// If something stands there that is no MAVLink 2 frame.
pub fn take_frames(bytes: &mut Vec<u8>) -> Result<Vec<Frame>> {
    let mut frames = Vec::new();
    while let [magic, length, flags, ..] = bytes[..] {
        ensure!(magic == 0xFD, "a byte {magic:#04X} between two frames");
        let signature = if flags & 1 == 0 { 0 } else { SIGNATURE_SIZE };
        let size = 12 + usize::from(length) + signature;
        if bytes.len() < size {
            break;
        }
        frames.push(bytes.drain(..size).collect());
    }
    Ok(frames)
}

/// The frames of the telemetry log that the crate `mavlink` ships: 8 bytes of time before each.
///
/// # Errors
///
/// If the crate's sources are not there or the log is not as expected.
pub fn telemetry() -> Result<Vec<Frame>> {
    let path = telemetry_path()?;
    let log = fs::read(&path).with_context(|| path.display().to_string())?;
    let mut rest = &log[..];
    let mut frames = Vec::new();
    while !rest.is_empty() {
        let frame = rest.get(8..).unwrap_or_default();
        let [0xFD, length, 0, ..] = frame else {
            bail!("{} has other frames", path.display());
        };
        let parts = frame.split_at_checked(12 + usize::from(*length));
        let (frame, others) = parts.context("a frame that is cut short")?;
        frames.push(frame.to_vec());
        rest = others;
    }
    Ok(frames)
}

/// The log itself.
///
/// # Errors
///
/// If the crate's sources are not there.
pub fn telemetry_path() -> Result<PathBuf> {
    let metadata = metadata().exec()?;
    let mut packages = metadata.packages.iter();
    let mavlink = packages.find(|package| package.name.as_str() == "mavlink");
    let mavlink = mavlink.context("the crate mavlink is a dependency")?;
    Ok(mavlink
        .manifest_path
        .with_file_name("tests/log.tlog")
        .into())
}

/// Asks cargo about this workspace.
pub(crate) fn metadata() -> MetadataCommand {
    let mut command = MetadataCommand::new();
    command.manifest_path(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"));
    command
}
