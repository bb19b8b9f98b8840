//! MAVLink 2 signing once more: shares no code with `mavlink/`. The offsets are those of the MAVLink guide.

use mavseal_chips_host::Image;

/// How a tag is made of key and covered bytes.
pub(crate) type Tag = fn(&[u8], &[u8]) -> [u8; 32];

/// The tag of an image with these features.
pub(crate) fn tag(image: &Image) -> Tag {
    if image.features.contains("standard-signature") {
        |key, covered| hmac_sha256::Hash::hash(&[key, covered].concat())
    } else {
        |key, covered| hmac_sha256::HMAC::mac(covered, key)
    }
}

/// An unsigned frame; `header` is sequence, system, component and message id.
pub(crate) fn frame(header: [u8; 6], payload: &[u8], crc_extra: u8) -> Vec<u8> {
    with_checksum(
        &[&[0xFD, payload.len() as u8, 0, 0], &header[..], payload].concat(),
        crc_extra,
    )
}

/// `frame`, unsigned, as it looks signed with `key` on `link_id` at `ticks`.
pub(crate) fn sign(
    frame: &[u8],
    crc_extra: u8,
    (tag, key): (Tag, &[u8]),
    link_id: u8,
    ticks: u64,
) -> Vec<u8> {
    let mut signed = frame[..frame.len() - 2].to_vec();
    signed[2] |= 1;
    signed = with_checksum(&signed, crc_extra);
    signed.push(link_id);
    signed.extend(&ticks.to_le_bytes()[..6]);
    let tag = tag(key, &signed);
    signed.extend(&tag[..6]);
    signed
}

fn with_checksum(packet: &[u8], crc_extra: u8) -> Vec<u8> {
    let crc = crc::Crc::<u16>::new(&crc::CRC_16_MCRF4XX);
    let checksum = crc.checksum(&[&packet[1..], &[crc_extra]].concat());
    [packet, &checksum.to_le_bytes()].concat()
}
