//! What the attacks share: a flash that outlives what runs on it, frames, and a relay that is fed.

use std::{cell::RefCell, rc::Rc};

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use mavlink_commsec::{Credential, SenderId};
use mavlink_signing::{
    AntiReplay, Frame, Header, LinkClock, MessageId, Profile, SigningKey, Stamp, TICKS_PER_SECOND,
    Timestamp, sign_frame,
};
use mavseal_relay::{Endpoint, Event, RejectReason, Relay, Side};
use mavseal_store::{
    Region,
    model::{Failure, Flash, PAGE_SIZE},
};

pub(crate) const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};
pub(crate) const NOW: u64 = 37_555_200_000_000;
pub(crate) const S: u64 = TICKS_PER_SECOND;

/// The two ends of a sealed link.
pub(crate) fn credentials() -> [Credential; 2] {
    [1, 2].map(|number| Credential {
        id: SenderId(number),
        key: [number as u8; 16],
        salt: 10 + number,
    })
}

pub(crate) fn at(ticks: u64) -> Timestamp {
    Timestamp::from_ticks(ticks).expect("48 bits")
}

/// That of a HEARTBEAT.
pub(crate) fn header(system_id: u8) -> Header {
    Header {
        compat_flags: 0,
        sequence: 0,
        system_id,
        component_id: 1,
        message_id: MessageId::from(0),
    }
}

pub(crate) fn signed<P: Profile>(key: &[u8; 32], system_id: u8, link_id: u8, ticks: u64) -> Frame {
    let payload = [5, 0, 0, 0, 2, 3, 81, 4, 3];
    let mut frame = Frame::new(header(system_id), &payload).expect("a heartbeat");
    let stamp = Stamp {
        link_id,
        timestamp: at(ticks),
    };
    let key = SigningKey::<P>::new(key).expect("a key");
    sign_frame(&mut frame, &key, stamp).expect("not signed yet");
    frame
}

/// A flash that can be looked at while somebody uses it.
#[derive(Clone)]
pub(crate) struct Shared(pub(crate) Rc<RefCell<Flash<2>>>);

impl Shared {
    pub(crate) fn new(chance: u64) -> Self {
        Self(Rc::new(RefCell::new(Flash::new(chance))))
    }
}

impl ErrorType for Shared {
    type Error = Failure;
}

impl ReadNorFlash for Shared {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failure> {
        self.0.borrow_mut().read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        2 * PAGE_SIZE
    }
}

impl NorFlash for Shared {
    const WRITE_SIZE: usize = <Flash<2> as NorFlash>::WRITE_SIZE;
    const ERASE_SIZE: usize = PAGE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        self.0.borrow_mut().erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        self.0.borrow_mut().write(offset, bytes)
    }
}

/// A frame comes in on the link side.
///
/// # Errors
///
/// Why it is not handed on.
pub(crate) fn hear<P: Profile, R: AntiReplay>(
    relay: &mut Relay<P, R>,
    clock: &mut impl LinkClock,
    frame: &Frame,
) -> Result<(), RejectReason> {
    let mut result = Err(RejectReason::Other);
    relay.received(
        Side::Link,
        frame.as_bytes(),
        clock,
        &mut |event| match event {
            Event::Passed(_) => result = Ok(()),
            Event::Rejected(_, reason) => result = Err(reason),
            _ => {}
        },
    );
    let count = relay.pending(Side::Local).len();
    relay.sent(Side::Local, count, clock, &mut |_| {});
    result
}
