//! C2: the message table is searched without a gap.

use mavlink_signing::MessageId;
use mavlink_signing::dialect::{crc_extra, messages};

/// C2: for any id, the search gives the row of the table if there is one, and nothing else.
///
/// # Panics
///
/// If the property does not hold.
#[must_use]
pub fn found_if_there(id: MessageId) -> Option<u8> {
    let found = crc_extra(id);
    let row = messages().find(|(row, _)| *row == id);
    assert_eq!(found, row.map(|(_, crc_extra)| crc_extra));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn c2_every_row_and_its_neighbours() {
        assert!(messages().len() > 0);
        for (id, expected) in messages() {
            assert_eq!(found_if_there(id), Some(expected));
            for near in [id.get().wrapping_sub(1), id.get() + 1] {
                let _ = MessageId::new(near).map(found_if_there);
            }
        }
    }

    #[test]
    fn c2_every_id() {
        let found = (0..1 << 24)
            .filter_map(MessageId::new)
            .filter_map(crc_extra);
        assert_eq!(found.count(), messages().len());
    }
}

#[cfg(kani)]
mod verification {
    use super::*;

    #[kani::proof]
    #[kani::unwind(400)]
    fn c2_found_if_there() {
        let id = MessageId::from_le_bytes(kani::any());
        let found = found_if_there(id);
        kani::cover!(found.is_some(), "a row");
        kani::cover!(found.is_none(), "no row");
    }
}
