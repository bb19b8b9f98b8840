//! The messages that everybody signs and verifies, in frames with rising timestamps.

use mavlink_signing::{
    Frame, Header, MessageId, Profile, SigningKey, Stamp, TICKS_PER_SECOND, Timestamp, sign_frame,
};

/// The key of every frame.
pub const KEY: [u8; 32] = *b"32 bytes of a random generator..";
/// The link id of every frame.
pub const LINK: u8 = 7;
/// Frames of one pass: few enough to stay near the processor, as a received frame does.
pub const FRAMES: usize = 256;

/// 2040, ahead of every clock: the peers that ask the machine's take no frame for an old one.
const FIRST: u64 = 25 * 365 * 24 * 3600 * TICKS_PER_SECOND;

/// A message of the dialect `common`, and how long its payload is on the wire.
#[derive(Clone, Copy, Debug)]
pub struct Message {
    /// Its name.
    pub name: &'static str,
    /// Its number.
    pub id: u32,
    /// Bytes of payload; the last one is not zero, so that no sender cuts any.
    pub size: usize,
}

/// The shortest that every vehicle sends, one that fills a block, and the longest.
pub const MESSAGES: [Message; 3] = [
    Message {
        name: "HEARTBEAT",
        id: 0,
        size: 9,
    },
    Message {
        name: "VIBRATION",
        id: 241,
        size: 32,
    },
    Message {
        name: "ENCAPSULATED_DATA",
        id: 131,
        size: 255,
    },
];

/// The clock of a receiver: when the last frame of a pass has come.
#[must_use]
pub fn clock() -> Timestamp {
    stamp(FRAMES - 1).timestamp
}

/// What the frame at place `at` of a pass is signed for.
#[must_use]
pub fn stamp(at: usize) -> Stamp {
    Stamp {
        link_id: LINK,
        timestamp: Timestamp::from_ticks(FIRST + at as u64).expect("48 bits"),
    }
}

impl Message {
    /// The payload.
    #[must_use]
    pub fn payload(&self) -> Vec<u8> {
        match self.id {
            // Values of enumerations, which some peers look at.
            0 => vec![0, 0, 0, 0, 2, 3, 81, 4, 3],
            _ => (0..self.size).map(|at| (at * 31 % 256) as u8 | 1).collect(),
        }
    }

    /// The header of frame `at` of a pass.
    #[must_use]
    pub fn header(&self, at: usize) -> Header {
        Header {
            compat_flags: 0,
            sequence: (at % 256) as u8,
            system_id: 1,
            component_id: 1,
            message_id: MessageId::new(self.id).expect("24 bits"),
        }
    }

    /// The frames of one pass, signed.
    #[must_use]
    pub fn frames<P: Profile>(&self) -> Vec<Vec<u8>> {
        let key = SigningKey::<P>::new(&KEY).expect("a key");
        let payload = self.payload();
        let sign = |at| {
            let mut frame = Frame::new(self.header(at), &payload).expect("a message");
            sign_frame(&mut frame, &key, stamp(at)).expect("not signed yet");
            frame.as_bytes().to_vec()
        };
        (0..FRAMES).map(sign).collect()
    }
}
