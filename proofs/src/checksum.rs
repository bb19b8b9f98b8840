//! C1: the checksum is CRC-16/MCRF4XX.

use mavlink_signing::crc::{INITIAL, checksum, fold, step};

/// C1: one step equals the bitwise definition: polynomial 0x1021 reflected, lowest bit first.
///
/// # Panics
///
/// If the property does not hold.
pub fn step_is_bitwise(crc: u16, byte: u8) {
    let mut expected = crc ^ u16::from(byte);
    for _ in 0..8 {
        let out = expected & 1;
        expected >>= 1;
        if out == 1 {
            expected ^= 0x8408;
        }
    }
    assert_eq!(step(crc, byte), expected);
}

/// C1: the checksum is what the steps make of `covered` in order and then of `crc_extra`; so it is
/// without tables.
///
/// # Panics
///
/// If the property does not hold.
pub fn whole_is_the_fold(covered: &[u8], crc_extra: u8) {
    let mut expected = INITIAL;
    for byte in covered {
        expected = step(expected, *byte);
    }
    assert_eq!(fold(covered), expected);
    assert_eq!(checksum(covered, crc_extra), step(expected, crc_extra));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn c1_every_crc_and_byte() {
        for crc in 0..=u16::MAX {
            for byte in 0..=u8::MAX {
                step_is_bitwise(crc, byte);
            }
        }
    }

    /// The check value of CRC-16/MCRF4XX in the catalogue of parametrised CRC algorithms.
    #[test]
    fn c1_check_value() {
        assert_eq!(checksum(b"12345678", b'9'), 0x6F91);
    }

    /// Every value of each of 64 bytes: with tables, each entry of each table.
    #[test]
    fn c1_every_byte() {
        let mut covered = [0; 64];
        for index in 0..covered.len() {
            for byte in 0..=u8::MAX {
                covered[index] = byte;
                whole_is_the_fold(&covered, 0);
            }
            covered[index] = 0;
        }
    }

    /// The checksum of zeros, and of each single bit that is one, for every length. Both computations are
    /// linear but for a constant, by table or not: they agree on these, so they agree on every packet.
    #[test]
    fn c1_every_bit() {
        for length in 0..=264 {
            let mut covered = vec![0; length];
            whole_is_the_fold(&covered, 0);
            for index in 0..length {
                for bit in 0..8 {
                    covered[index] = 1 << bit;
                    whole_is_the_fold(&covered, 0);
                }
                covered[index] = 0;
            }
        }
    }

    proptest! {
        #[test]
        fn c1_whole(covered in proptest::collection::vec(any::<u8>(), 0..=264), crc_extra: u8) {
            whole_is_the_fold(&covered, crc_extra);
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::{any_checksum, any_prefix};

    #[kani::proof]
    #[kani::unwind(9)]
    fn c1_step_is_bitwise() {
        let (crc, byte) = (kani::any(), kani::any());
        step_is_bitwise(crc, byte);
        kani::cover!(step(crc, byte) == 0x6F91, "the check value");
    }

    /// What stands for the checksum in other harnesses: the same answer to the same question, and to two
    /// different ones any two answers.
    #[kani::proof]
    #[kani::unwind(10)]
    fn c1_stand_in_tells_questions_apart() {
        let (one, other): ([u8; 9], [u8; 9]) = kani::any();
        let (one, other) = (any_prefix(&one), any_prefix(&other));
        let extras: [u8; 2] = kani::any();
        let answers = [any_checksum(one, extras[0]), any_checksum(other, extras[1])];
        assert_eq!(any_checksum(one, extras[0]), answers[0]);
        if one == other && extras[0] == extras[1] {
            assert_eq!(answers[0], answers[1]);
        }
        let same_but = |at: usize| one.len() == 9 && other.len() == 9 && one[at] != other[at];
        let differ = answers[0] != answers[1];
        kani::cover!(differ && same_but(0), "told by the first byte");
        kani::cover!(differ && same_but(8), "told by the last byte");
        kani::cover!(differ && extras[0] != extras[1], "told by CRC_EXTRA");
        kani::cover!(differ && one.len() != other.len(), "told by the length");
    }

    fn whole<const LENGTH: usize>() {
        let covered: [u8; LENGTH] = kani::any();
        whole_is_the_fold(&covered, kani::any());
        kani::cover!(true, "it ends");
    }

    #[kani::proof]
    #[kani::unwind(1)]
    fn c1_whole_0() {
        whole::<0>();
    }

    #[kani::proof]
    #[kani::unwind(10)]
    fn c1_whole_9() {
        whole::<9>();
    }

    #[kani::proof]
    #[kani::unwind(40)]
    fn c1_whole_39() {
        whole::<39>();
    }
}
