//! What comes to a receiver that has forgotten everything, and what is to pass.

mod replayed;
mod tampered;

use anyhow::Result;
use rand::rngs::SmallRng;

use crate::{forge::Draft, here::Here, messages::Message, payloads::Kind, peers::Order};

/// Frames that come to a receiver one after another.
pub(crate) struct Scenario {
    pub(crate) name: &'static str,
    pub(crate) steps: Vec<Step>,
}

/// A frame, and what is right to do with it.
pub(crate) struct Step {
    pub(crate) frame: Vec<u8>,
    /// Ticks after the beginning at which it comes.
    pub(crate) after: u64,
    pub(crate) passes: bool,
}

/// What scenarios are made of: a message, a moment, and whoever can sign.
pub(crate) struct Maker<'a> {
    pub(crate) here: &'a Here,
    pub(crate) key: &'a [u8; 32],
    pub(crate) message: &'a Message,
    /// Another message, for a header that is changed to it.
    pub(crate) other: &'a Message,
    pub(crate) now: u64,
    pub(crate) random: &'a mut SmallRng,
}

/// Whose frame: link id, system, component.
pub(crate) type Sender = (u8, u8, u8);

/// The usual sender.
pub(crate) const A: Sender = (1, 1, 1);
/// Another, on the same link.
pub(crate) const B: Sender = (1, 2, 1);

impl Maker<'_> {
    pub(crate) fn tampered(&mut self) -> Result<Vec<Scenario>> {
        tampered::scenarios(self)
    }

    pub(crate) fn replayed(&mut self) -> Result<Vec<Scenario>> {
        replayed::scenarios(self)
    }

    /// A frame of `sender` with a random payload, signed `ahead` of now.
    fn signed(
        &mut self,
        (link_id, system_id, component_id): Sender,
        ahead: i64,
    ) -> Result<Vec<u8>> {
        let payload = Kind::Random.payload(self.message, self.random);
        self.here.sign(&Order {
            message: self.message,
            payload: &payload,
            sequence: 0,
            system_id,
            component_id,
            link_id,
            ticks: self.now.saturating_add_signed(ahead),
        })
    }

    /// Such a frame without what comes behind its payload.
    fn draft(&mut self) -> Result<Draft> {
        Ok(Draft::of(&self.signed(A, 0)?, self.message.crc_extra))
    }
}

/// One frame that comes at once.
fn one(name: &'static str, passes: bool, frame: Vec<u8>) -> Scenario {
    let step = Step {
        frame,
        after: 0,
        passes,
    };
    Scenario {
        name,
        steps: vec![step],
    }
}
