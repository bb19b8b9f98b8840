//! The core under test, as a sender and as a receiver.

use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result};
use mavlink_signing::{
    Frame, FrameRef, Header, Links, MessageId, SigningKey, Stamp, Standard, StreamTable,
    TICKS_PER_SECOND, Timestamp, VerifyError, Window, authenticate, sign_frame,
};

use crate::peers::Order;

/// A minute: what the MAVLink guide gives a new stream.
pub(crate) const MINUTE: u64 = 60 * TICKS_PER_SECOND;

/// The receiver's window: the guide's minute, for every frame, and as much ahead.
const WINDOW: Window = Window {
    past: MINUTE,
    ahead: MINUTE,
};

/// The machine's clock, in ticks.
pub(crate) fn now() -> Result<u64> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH)?;
    let now = Timestamp::from_unix_micros(since.as_micros().try_into()?);
    Ok(now.context("a clock before 2015")?.ticks())
}

pub(crate) fn at(ticks: u64) -> Result<Timestamp> {
    Timestamp::from_ticks(ticks).context("more than 48 bits")
}

/// A receiver, and the key that it shares with every peer.
pub(crate) struct Here {
    key: SigningKey<Standard>,
    streams: StreamTable<16>,
}

impl Here {
    pub(crate) fn new(key: &[u8; 32]) -> Result<Self> {
        Ok(Self {
            key: SigningKey::new(key)?,
            streams: StreamTable::new(Links::Any, WINDOW),
        })
    }

    /// Forgets every frame.
    pub(crate) fn restart(&mut self) {
        self.streams = StreamTable::new(Links::Any, WINDOW);
    }

    /// The frame of `order`, its payload taken as it is.
    pub(crate) fn sign(&self, order: &Order) -> Result<Vec<u8>> {
        let header = Header {
            compat_flags: 0,
            sequence: order.sequence,
            system_id: order.system_id,
            component_id: order.component_id,
            message_id: MessageId::new(order.message.id).context("24 bits")?,
        };
        let mut frame = Frame::new(header, order.payload)?;
        let stamp = Stamp {
            link_id: order.link_id,
            timestamp: at(order.ticks)?,
        };
        sign_frame(&mut frame, &self.key, stamp)?;
        Ok(frame.as_bytes().to_vec())
    }

    /// The verdict on `bytes`, all of them one frame, that come at `now`.
    pub(crate) fn verify(&mut self, bytes: &[u8], now: u64) -> Result<(), VerifyError> {
        let frame = FrameRef::parse(bytes)?;
        let now = Timestamp::from_ticks(now).unwrap_or(Timestamp::MAX);
        self.streams
            .admit(authenticate(frame, &self.key)?, now)
            .map(drop)
    }
}
