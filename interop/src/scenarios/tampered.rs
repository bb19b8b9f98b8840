//! One frame, changed in each of its regions, or signed in a way that is not to be accepted.

use anyhow::Result;
use mavlink_signing::field::{HEADER_SIZE, SIGNED_FLAG};
use rand::RngExt;

use super::{A, Maker, Scenario, one};
use crate::forge::{payload_end, repair};

/// An id that no dialect gives to a message.
const UNDEFINED: [u8; 3] = [0xFE, 0xFF, 0xFF];
/// An incompatibility flag that the guide does not define, and no peer does.
const UNDEFINED_FLAG: u8 = 0x80;
/// The flag with which some senders say that the system id has 32 bits.
const LONG_SYSTEM_ID: u8 = 0x02;

/// Where the parts of a header begin.
const FLAGS: usize = 2;
const SYSTEM_ID: usize = 5;
const MESSAGE_ID: usize = 7;

pub(super) fn scenarios(maker: &mut Maker) -> Result<Vec<Scenario>> {
    let mut scenarios = vec![one("authentic", true, maker.signed(A, 0)?)];
    changed(maker, &mut scenarios)?;
    made(maker, &mut scenarios)?;
    Ok(scenarios)
}

/// One bit, somewhere in one region; a checksum made right again is what an attacker would send.
fn changed(maker: &mut Maker, scenarios: &mut Vec<Scenario>) -> Result<()> {
    let crc_extra = maker.message.crc_extra;
    let end = payload_end(&maker.signed(A, 0)?);
    let regions = [
        ("magic byte changed", 0..1, false),
        ("length changed", 1..2, false),
        ("compatibility flags changed", 3..4, false),
        ("compatibility flags changed, checksum repaired", 3..4, true),
        ("sequence changed", 4..5, false),
        ("sequence changed, checksum repaired", 4..5, true),
        ("system changed", 5..6, false),
        ("system changed, checksum repaired", 5..6, true),
        ("component changed", 6..7, false),
        ("component changed, checksum repaired", 6..7, true),
        ("payload changed", HEADER_SIZE..end, false),
        ("payload changed, checksum repaired", HEADER_SIZE..end, true),
        ("checksum changed", end..end + 2, false),
        ("link id changed", end + 2..end + 3, false),
        ("timestamp changed", end + 3..end + 9, false),
        ("tag changed", end + 9..end + 15, false),
    ];
    for (name, region, repaired) in regions {
        let mut frame = maker.signed(A, 0)?;
        let at = maker.random.random_range(region);
        frame[at] ^= 1 << maker.random.random_range(0..8);
        if repaired {
            repair(&mut frame, crc_extra);
        }
        scenarios.push(one(name, false, frame));
    }

    let mut other = maker.signed(A, 0)?;
    other[MESSAGE_ID..HEADER_SIZE].copy_from_slice(&maker.other.id.to_le_bytes()[..3]);
    scenarios.push(one("message changed", false, other.clone()));
    repair(&mut other, maker.other.crc_extra);
    scenarios.push(one("message changed, checksum repaired", false, other));

    let mut undefined = maker.signed(A, 0)?;
    undefined[MESSAGE_ID..HEADER_SIZE].copy_from_slice(&UNDEFINED);
    scenarios.push(one("message changed to none", false, undefined));

    let mut stripped = maker.signed(A, 0)?;
    stripped[FLAGS] &= !SIGNED_FLAG;
    scenarios.push(one("signed flag cleared", false, stripped.clone()));
    repair(&mut stripped, crc_extra);
    let name = "signed flag cleared, checksum repaired";
    scenarios.push(one(name, false, stripped));

    let mut flagged = maker.signed(A, 0)?;
    flagged[FLAGS] |= UNDEFINED_FLAG;
    repair(&mut flagged, crc_extra);
    let name = "undefined flag set, checksum repaired";
    scenarios.push(one(name, false, flagged));

    let mut short = maker.signed(A, 0)?;
    short.pop();
    scenarios.push(one("cut short by a byte", false, short));
    Ok(())
}

/// Whole frames that a sender with the key, or without, makes and that are not to be accepted.
fn made(maker: &mut Maker, scenarios: &mut Vec<Scenario>) -> Result<()> {
    let (link_id, now, key) = (A.0, maker.now, maker.key);

    let mut other_key = *key;
    other_key[31] ^= 1;
    let frame = maker.draft()?.sign(&other_key, link_id, now);
    scenarios.push(one("another key", false, frame));

    let mut unsigned = maker.draft()?;
    unsigned.bytes[FLAGS] &= !SIGNED_FLAG;
    scenarios.push(one("unsigned", false, unsigned.finish()));

    // HEARTBEAT, the one that every receiver knows.
    let version1 = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];
    scenarios.push(one("MAVLink 1", false, version1.to_vec()));

    let mut flagged = maker.draft()?;
    flagged.bytes[FLAGS] |= UNDEFINED_FLAG;
    let name = "undefined flag, signed with the key";
    scenarios.push(one(name, false, flagged.sign(key, link_id, now)));

    let mut long = maker.draft()?;
    long.bytes[FLAGS] |= LONG_SYSTEM_ID;
    long.bytes.splice(SYSTEM_ID..=SYSTEM_ID, [1, 1, 0, 0]);
    let name = "32-bit system id, signed with the key";
    scenarios.push(one(name, false, long.sign(key, link_id, now)));

    // Nobody knows what its checksum has to be; zero is a guess that some make.
    let mut undefined = maker.draft()?;
    undefined.bytes[MESSAGE_ID..HEADER_SIZE].copy_from_slice(&UNDEFINED);
    undefined.crc_extra = 0;
    let name = "undefined message, signed with the key";
    scenarios.push(one(name, false, undefined.sign(key, link_id, now)));
    Ok(())
}
