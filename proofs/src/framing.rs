//! F1 and F2: what is framed comes out again, whatever was before; and no frame is empty.

use mavlink_commsec::hx::{
    DecodeError, Decoder, ESCAPE, FLAG, Frame, FrameError, FrameKind, MAX_ENCODED_SIZE,
    MAX_PAYLOAD_SIZE,
};

/// F1, from any state of the decoder: of a frame's bytes on the line, the first and the last alone are
/// boundaries. There are at most 203. The decoder gives the frame with the last byte, and nothing
/// between the first and the last. With the first byte it may give what was begun before.
///
/// So whatever bytes came before, a whole frame is found.
///
/// # Panics
///
/// If the property does not hold.
pub fn comes_through(decoder: &mut Decoder, tag: FrameKind, payload: &[u8]) {
    let frame = Frame::new(tag, payload).expect("1 to 100 bytes");
    assert_eq!(frame.payload().len(), payload.len());
    let escaped = payload.iter().filter(|byte| is_special(**byte)).count();
    let size = payload.len() + escaped + 3;
    assert!(size <= MAX_ENCODED_SIZE);
    let mut count = 0;
    for byte in frame.encode() {
        count += 1;
        assert_eq!(byte == FLAG, count == 1 || count == size);
        let outcome = decoder.push(byte);
        if count == size {
            assert_eq!(outcome, Some(Ok(frame)));
        } else if count > 1 {
            assert!(outcome.is_none());
        }
    }
    assert_eq!(count, size);
}

fn is_special(byte: u8) -> bool {
    byte == FLAG || byte == ESCAPE
}

/// F1 and F2, from any state of the decoder: any byte is taken. A frame comes out with a boundary alone,
/// and has 1 to 100 bytes. One that ends empty or behind an escape is dropped with a boundary. One too
/// long or of an unknown kind is dropped with another byte. Returns what came out.
///
/// # Errors
///
/// Why a frame was dropped.
///
/// # Panics
///
/// If the property does not hold.
pub fn takes_any(decoder: &mut Decoder, byte: u8) -> Result<Option<usize>, DecodeError> {
    let outcome = match decoder.push(byte) {
        None => return Ok(None),
        Some(outcome) => outcome.map(|frame| frame.payload().len()),
    };
    let with_boundary = match outcome {
        Ok(length) => {
            assert!((1..=MAX_PAYLOAD_SIZE).contains(&length));
            true
        }
        Err(DecodeError::Empty | DecodeError::TruncatedEscape) => true,
        Err(DecodeError::UnknownKind(tag)) => {
            assert_eq!(tag, byte);
            assert!(tag > 1);
            false
        }
        Err(_) => false,
    };
    assert_eq!(with_boundary, byte == FLAG);
    // Behind a boundary there is nothing yet: another one gives nothing.
    if byte == FLAG {
        assert!(decoder.push(FLAG).is_none());
    }
    outcome.map(Some)
}

/// F2: a frame is made if and only if there are 1 to 100 bytes for it.
///
/// # Errors
///
/// Why it is not made.
///
/// # Panics
///
/// If the property does not hold.
pub fn never_empty(tag: FrameKind, payload: &[u8]) -> Result<(), FrameError> {
    let made = Frame::new(tag, payload);
    match payload.len() {
        0 => assert_eq!(made, Err(FrameError::Empty)),
        1..=MAX_PAYLOAD_SIZE => assert!(made.is_ok()),
        length => assert_eq!(made, Err(FrameError::TooLong(length))),
    }
    made.map(|frame| {
        assert_eq!(frame.kind(), tag);
        assert!(!frame.payload().is_empty());
    })
}

/// F1 over a whole stream: the outcomes are those of a naive decoder, which cuts the stream at its
/// boundaries first. How many there were.
///
/// # Panics
///
/// If the property does not hold.
#[must_use]
pub fn stream(bytes: &[u8]) -> usize {
    let mut decoder = Decoder::new();
    let mut outcomes = Vec::new();
    for byte in bytes {
        if let Some(outcome) = decoder.push(*byte) {
            outcomes.push(outcome.map(|frame| (frame.kind(), frame.payload().to_vec())));
        }
    }
    let parts: Vec<&[u8]> = bytes.split(|byte| *byte == FLAG).collect();
    // What is in front of the first boundary belongs to no frame; what is behind the last has no end.
    let naive: Vec<_> = match parts.as_slice() {
        [_, whole @ .., rest] => {
            let ended = whole.iter().filter_map(|part| naive(part, true));
            ended.chain(naive(rest, false)).collect()
        }
        _ => Vec::new(),
    };
    assert_eq!(outcomes, naive);
    outcomes.len()
}

/// What is between two boundaries, or behind the last one.
fn naive(part: &[u8], ended: bool) -> Option<Result<(FrameKind, Vec<u8>), DecodeError>> {
    let (&tag, escaped) = part.split_first()?;
    let tag = match tag {
        0 => FrameKind::AirData,
        1 => FrameKind::Radio,
        unknown => return Some(Err(DecodeError::UnknownKind(unknown))),
    };
    let mut payload = Vec::new();
    let mut bytes = escaped.iter();
    let mut cut = false;
    while let Some(&byte) = bytes.next() {
        if byte != ESCAPE {
            payload.push(byte);
        } else if let Some(escaped) = bytes.next() {
            payload.push(escaped ^ 0x20);
        } else {
            cut = true;
        }
    }
    if payload.len() > MAX_PAYLOAD_SIZE {
        return Some(Err(DecodeError::TooLong));
    }
    ended.then_some(match payload.len() {
        _ if cut => Err(DecodeError::TruncatedEscape),
        0 => Err(DecodeError::Empty),
        _ => Ok((tag, payload)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Bytes among which the special ones are frequent.
    fn byte() -> impl Strategy<Value = u8> {
        prop_oneof![2 => Just(FLAG), 1 => Just(ESCAPE), 2 => 0..3_u8, 4 => any::<u8>()]
    }

    proptest! {
        #[test]
        fn f1_random(
            before in proptest::collection::vec(byte(), 0..120),
            payload in proptest::collection::vec(byte(), 1..=100),
            radio: bool,
        ) {
            let mut decoder = Decoder::new();
            for byte in before {
                let _ = takes_any(&mut decoder, byte);
            }
            let tag = if radio { FrameKind::Radio } else { FrameKind::AirData };
            comes_through(&mut decoder, tag, &payload);
        }

        #[test]
        fn f1_streams(bytes in proptest::collection::vec(byte(), 0..400)) {
            let _ = stream(&bytes);
        }

        /// Few boundaries, so that frames become too long.
        #[test]
        fn f1_long_streams(
            bytes in proptest::collection::vec(prop_oneof![1 => byte(), 30 => 0..2_u8], 0..1000),
        ) {
            let _ = stream(&bytes);
        }

        #[test]
        fn f2_random(payload in proptest::collection::vec(any::<u8>(), 0..=110)) {
            let _ = never_empty(FrameKind::AirData, &payload);
        }
    }

    #[test]
    fn f1_every_length() {
        for special in [FLAG, ESCAPE, 0, 1, FLAG ^ 0x20, ESCAPE ^ 0x20] {
            for length in 1..=MAX_PAYLOAD_SIZE {
                let mut decoder = Decoder::new();
                comes_through(&mut decoder, FrameKind::AirData, &vec![special; length]);
                comes_through(&mut decoder, FrameKind::Radio, &vec![special; length]);
            }
        }
    }

    #[test]
    fn f1_too_long_at_every_place() {
        for length in 99..=102 {
            for cut in [&[FLAG][..], &[ESCAPE, FLAG], &[]] {
                let bytes = [&[FLAG, 0][..], &vec![5; length], cut].concat();
                let _ = stream(&bytes);
            }
        }
    }

    #[test]
    fn f2_every_length() {
        for length in 0..=110 {
            for tag in [FrameKind::AirData, FrameKind::Radio] {
                let made = never_empty(tag, &vec![0; length]);
                assert_eq!(made.is_ok(), (1..=100).contains(&length));
            }
        }
    }

    /// Every frame without payload, and every boundary after it.
    #[test]
    fn f2_no_empty_frame_comes_out() {
        for tag in 0..=255 {
            let mut decoder = Decoder::new();
            let outcomes = [FLAG, tag, FLAG, FLAG].map(|byte| takes_any(&mut decoder, byte));
            assert!(
                outcomes
                    .iter()
                    .all(|outcome| !matches!(outcome, Ok(Some(_))))
            );
        }
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::any_prefix;

    fn any_tag() -> FrameKind {
        if kani::any() {
            FrameKind::AirData
        } else {
            FrameKind::Radio
        }
    }

    /// Bytes of payload; longer ones in the property tests.
    const LENGTH: usize = 3;

    #[kani::proof]
    #[kani::unwind(12)]
    fn f1_comes_through_3() {
        let payload: [u8; LENGTH] = kani::any();
        comes_through(&mut Decoder::any(), any_tag(), &payload);
        kani::cover!(payload[0] == FLAG && payload[2] == ESCAPE, "escaped");
    }

    #[kani::proof]
    #[kani::unwind(2)]
    fn f1_takes_any() {
        let byte = kani::any();
        let outcome = takes_any(&mut Decoder::any(), byte);
        kani::cover!(outcome == Ok(Some(100)), "the longest frame");
        kani::cover!(outcome == Ok(None) && byte == ESCAPE, "an escape");
        kani::cover!(outcome == Err(DecodeError::TooLong), "too long");
        kani::cover!(outcome == Err(DecodeError::UnknownKind(7)), "unknown tag");
        kani::cover!(outcome == Err(DecodeError::TruncatedEscape), "cut escape");
    }

    #[kani::proof]
    #[kani::unwind(2)]
    fn f2_never_empty() {
        let payload: [u8; MAX_PAYLOAD_SIZE + 1] = kani::any();
        let made = never_empty(any_tag(), any_prefix(&payload));
        kani::cover!(made.is_ok(), "made");
        kani::cover!(made == Err(FrameError::Empty), "empty");
        kani::cover!(made == Err(FrameError::TooLong(101)), "too long");
        // Nor does one come out.
        let outcome = takes_any(&mut Decoder::any(), FLAG);
        kani::cover!(outcome == Ok(Some(1)), "the shortest frame");
        kani::cover!(outcome == Err(DecodeError::Empty), "an empty one");
    }
}
