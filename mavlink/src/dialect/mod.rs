//! The chosen dialect: the `crc_extra` byte of every message it defines.
//!
//! A MAVLink packet's checksum covers one byte that is not sent: `crc_extra`, computed from the message's
//! definition. So two ends with different definitions reject each other's packets ([Packet
//! Serialization](https://mavlink.io/en/guide/serialization.html#crc_extra)). A receiver must know it for
//! each message, and some dialects give one id to different messages. So one dialect is in use, chosen by
//! the feature of this crate that has its name in lower case.
//!
//! Cargo adds up the features that all dependents ask for. That does no harm where one chosen
//! dialect has every row of the others: it is the one in use (`common` and `ardupilotmega` give
//! `ardupilotmega`). Any other mixture does not compile.

mod tables;

use crate::header::MessageId;

/// A dialect's name, and `message_id << 8 | crc_extra` of its messages by ascending id.
struct Dialect(&'static str, &'static [u32]);

/// The dialect in use. No dialect at all is a `compile_error!` in `tables`.
const LARGEST: &Dialect = match tables::CHOSEN {
    [largest, ..] => largest,
    [] => &Dialect("", &[]),
};

static ROWS: &[u32] = LARGEST.1;

/// The name of the dialect in use, which is also the name of its feature.
pub const NAME: &str = LARGEST.0;

/// The byte that message `id` adds to its packet's checksum, or `None` if the dialect in use has no
/// such message.
///
/// "Packet Serialization" in the MAVLink guide,
/// [CRC_EXTRA Calculation](https://mavlink.io/en/guide/serialization.html#crc_extra). The search is
/// a bisection of a table of 4 bytes a message.
///
/// ```
/// use mavlink_signing::{MessageId, dialect::crc_extra};
///
/// const HEARTBEAT: MessageId = MessageId::from_le_bytes([0, 0, 0]);
/// assert_eq!(crc_extra(HEARTBEAT), Some(50));
/// ```
#[must_use]
pub fn crc_extra(id: MessageId) -> Option<u8> {
    #[cfg(feature = "fast-checksum")]
    if let Some(known) = low::find(id) {
        return known;
    }
    let index = ROWS.binary_search_by_key(&id.get(), |row| row >> 8).ok()?;
    let [crc_extra, ..] = ROWS.get(index)?.to_le_bytes();
    Some(crc_extra)
}

/// The messages with the lowest ids, which are the most frequent, without a search.
#[cfg(feature = "fast-checksum")]
mod low {
    use super::{MessageId, ROWS};

    /// `1 << 8 | crc_extra` of the message whose id is the index; 0 where there is none.
    static ROW: [u16; 512] = {
        let mut row = [0; 512];
        let mut rows = ROWS;
        while let [first, rest @ ..] = rows {
            let [crc_extra, a, b, c] = first.to_le_bytes();
            let id = u32::from_le_bytes([a, b, c, 0]) as usize;
            if id < row.len() {
                row[id] = u16::from_le_bytes([crc_extra, 1]);
            }
            rows = rest;
        }
        row
    };

    /// What the table says of `id`; `None` if it is too high for this table.
    pub(super) fn find(id: MessageId) -> Option<Option<u8>> {
        let row = ROW.get(usize::try_from(id.get()).ok()?)?;
        let [crc_extra, known] = row.to_le_bytes();
        Some((known != 0).then_some(crc_extra))
    }
}

/// Every message of the dialect in use as its id and `crc_extra`, by ascending id.
#[must_use]
pub fn messages() -> impl ExactSizeIterator<Item = (MessageId, u8)> + Clone {
    ROWS.iter().map(|row| {
        let [crc_extra, a, b, c] = row.to_le_bytes();
        (MessageId::from_le_bytes([a, b, c]), crc_extra)
    })
}

// For each choice of features the compiler checks two things. Bisection needs ascending ids. A mixture
// needs one dialect that has every row of the others.
const _: () = {
    let mut dialects = tables::CHOSEN;
    while let [Dialect(name, rows), rest @ ..] = dialects {
        assert!(ascends(rows), "a table's ids do not ascend strictly");
        assert!(contains(ROWS, rows), "{}", as_str(&conflict(NAME, name)));
        dialects = rest;
    }
};

const fn ascends(mut rows: &[u32]) -> bool {
    while let [row, rest @ ..] = rows {
        if let [next, ..] = rest
            && *row >> 8 >= *next >> 8
        {
            return false;
        }
        rows = rest;
    }
    true
}

/// Whether ascending `rows` has every row of ascending `part`.
const fn contains(mut rows: &[u32], mut part: &[u32]) -> bool {
    while let [sought, part_rest @ ..] = part {
        let [row, rest @ ..] = rows else { return false };
        if *row == *sought {
            part = part_rest;
        }
        rows = rest;
    }
    true
}

/// Says which two dialects cannot be in use together. A constant's panic takes one string and no
/// format, so it is joined here.
const fn conflict(one: &str, other: &str) -> [u8; 160] {
    let mut message = [b' '; 160];
    let mut end = 0;
    let mut parts: &[&str] = &[
        "the dialects `",
        one,
        "` and `",
        other,
        "` are both chosen, and neither has every message of the other: choose one",
    ];
    while let [part, rest @ ..] = parts {
        let (_, free) = message.split_at_mut(end);
        let (here, _) = free.split_at_mut(part.len());
        here.copy_from_slice(part.as_bytes());
        end += part.len();
        parts = rest;
    }
    message
}

const fn as_str(text: &[u8]) -> &str {
    match core::str::from_utf8(text) {
        Ok(text) => text,
        Err(_) => "two chosen dialects conflict",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bisection only compares, so each message's id and the ids beside it stand for all.
    #[test]
    fn every_message_of_the_table_is_found_and_no_other() {
        let beside = |id: u32| [id.saturating_sub(1), id, id + 1];
        let ids = messages().flat_map(|(id, _)| beside(id.get()));
        for id in ids.chain([0, (1 << 24) - 1]).filter_map(MessageId::new) {
            let listed = messages().find(|(listed, _)| *listed == id);
            assert_eq!(crc_extra(id), listed.map(|(_, crc_extra)| crc_extra));
        }
    }
}
