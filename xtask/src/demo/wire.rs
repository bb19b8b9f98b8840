//! MAVLink 2 signing once more, for the demonstration's peer: shares no code with `mavlink/`.
//!
//! The HMAC is the crate `hmac-sha256`'s, the checksum the crate `crc`'s, the CRC_EXTRA bytes the
//! crate `mavlink`'s, and the offsets are written out from the MAVLink guide.

use std::{fs, path::PathBuf};

use anyhow::{Context, Result, ensure};
use mavlink::Message;
use mavlink::dialects::ardupilotmega::MavMessage;

pub(crate) type Frame = Vec<u8>;

/// A frame's checksum, by the message id in it; zero for a message that is not in the dialect.
fn checksum(frame: &[u8], end: usize) -> [u8; 2] {
    checksum_with(&frame[..end], MavMessage::extra_crc(message_id(frame)))
}

/// The checksum of a packet that ends with its payload.
pub(super) fn checksum_with(packet: &[u8], crc_extra: u8) -> [u8; 2] {
    let crc = crc::Crc::<u16>::new(&crc::CRC_16_MCRF4XX);
    let mut digest = crc.digest();
    digest.update(&packet[1..]);
    digest.update(&[crc_extra]);
    digest.finalize().to_le_bytes()
}

pub(super) fn message_id(frame: &[u8]) -> u32 {
    u32::from_le_bytes([frame[7], frame[8], frame[9], 0])
}

/// Where a frame's payload ends and its checksum begins.
fn payload_end(frame: &[u8]) -> usize {
    10 + usize::from(frame[1])
}

/// Makes the checksum right again.
pub(super) fn repair(frame: &mut [u8]) {
    let end = payload_end(frame);
    let checksum = checksum(frame, end);
    frame[end..end + 2].copy_from_slice(&checksum);
}

/// `frame`, unsigned, as it looks signed by mavseal's own profile with `key` on `link_id` at `ticks`.
pub(crate) fn sign(frame: &[u8], key: &[u8], link_id: u8, ticks: u64) -> Frame {
    let tag = |covered: &[u8]| hmac_sha256::HMAC::mac(covered, key);
    sign_by(tag, frame, link_id, ticks)
}

fn sign_by(tag: impl Fn(&[u8]) -> [u8; 32], frame: &[u8], link_id: u8, ticks: u64) -> Frame {
    let mut signed = frame.to_vec();
    signed[2] |= 1;
    repair(&mut signed);
    signed.push(link_id);
    signed.extend(&ticks.to_le_bytes()[..6]);
    let tag = tag(&signed);
    signed.extend(&tag[..6]);
    signed
}

/// The timestamp of a signed frame, in ticks.
pub(super) fn ticks(signed: &[u8]) -> u64 {
    let mut ticks = [0; 8];
    ticks[..6].copy_from_slice(&signed[signed.len() - 12..signed.len() - 6]);
    u64::from_le_bytes(ticks)
}

/// Takes the whole frames from the front of `bytes`.
///
/// # Errors
/// If something stands there that is no MAVLink 2 frame.
pub(super) fn take_frames(bytes: &mut Vec<u8>) -> Result<Vec<Frame>> {
    let mut frames = Vec::new();
    while let [magic, length, flags, ..] = bytes[..] {
        ensure!(magic == 0xFD, "a byte {magic:#04X} between two frames");
        let trailer = if flags & 1 == 0 { 2 } else { 15 };
        let size = 10 + usize::from(length) + trailer;
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
/// If the crate's sources are not there or the log is not as expected.
pub(super) fn telemetry() -> Result<Vec<Frame>> {
    let path = telemetry_path()?;
    let mut log = fs::read(&path).with_context(|| path.display().to_string())?;
    let mut frames = Vec::new();
    while !log.is_empty() {
        ensure!(log.len() > 8, "{} ends in a time", path.display());
        log.drain(..8);
        let mut front: Frame = log.iter().copied().take(280).collect();
        let first = take_first(&mut front)?.context("a frame that is cut short")?;
        log.drain(..first.len());
        frames.push(first);
    }
    Ok(frames)
}

/// The first frame at the front of `bytes`, whatever follows.
fn take_first(bytes: &mut Vec<u8>) -> Result<Option<Frame>> {
    let Some(&length) = bytes.get(1) else {
        return Ok(None);
    };
    bytes.truncate(12 + usize::from(length));
    Ok(take_frames(bytes)?.pop())
}

/// The log itself.
///
/// # Errors
/// If the crate's sources are not there.
pub(crate) fn telemetry_path() -> Result<PathBuf> {
    let metadata = cargo_metadata::MetadataCommand::new()
        .manifest_path(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"))
        .exec()?;
    let package = metadata
        .packages
        .iter()
        .find(|package| package.name.as_str() == "mavlink")
        .context("xtask depends on the crate mavlink")?;
    Ok(package
        .manifest_path
        .with_file_name("tests/log.tlog")
        .into())
}
