//! Target: keys in flash while they are changed, and the power fails inside writes.

use std::cell::RefCell;
use std::rc::Rc;

use arbitrary::Arbitrary;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use mavlink_signing::{
    Authenticate, FrameRef, Hmac, KEY_SIZE, KeyChange, KeyChangeError, KeyRing, KeyStore,
    NotStored, Profile, RolloverState, SigningKey,
};
use mavseal_proofs::keys::{self, Event, Memory};
use mavseal_relay::FlashKeyStore;
use mavseal_store::model::{Failure, Flash, PAGE_SIZE, WORD_SIZE};
use mavseal_store::{Binding, HighWaterMark, Journal, OpenError, Region};

use crate::input::Stamped;
use crate::repair::signed;

/// What the records are.
const BINDING: Binding = Binding::new(9, [1, 2, 3, 4]);

/// The two pages of a [`Shared`].
pub(crate) const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};

/// A flash whose power somebody else can take away while it is in use.
#[derive(Clone)]
pub(crate) struct Shared(Rc<RefCell<Flash<2>>>);

impl Shared {
    pub(crate) fn new(chance: i64) -> Self {
        Self(Rc::new(RefCell::new(Flash::new(chance as u64))))
    }

    /// Does `change` to the flash behind it.
    pub(crate) fn with<T>(&self, change: impl FnOnce(&mut Flash<2>) -> T) -> T {
        change(&mut self.0.borrow_mut())
    }

    /// The power comes back, and nothing fails any more.
    pub(crate) fn restart(&self) {
        self.with(|flash| {
            flash.restart();
            flash.fail(0);
        });
    }
}

impl ErrorType for Shared {
    type Error = Failure;
}

impl ReadNorFlash for Shared {
    const READ_SIZE: usize = Flash::<2>::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failure> {
        self.with(|flash| flash.read(offset, bytes))
    }

    fn capacity(&self) -> usize {
        self.with(|flash| flash.capacity())
    }
}

impl NorFlash for Shared {
    const WRITE_SIZE: usize = Flash::<2>::WRITE_SIZE;
    const ERASE_SIZE: usize = Flash::<2>::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        self.with(|flash| flash.erase(from, to))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        self.with(|flash| flash.write(offset, bytes))
    }
}

/// Keys in flash, and what happens to them.
#[derive(Arbitrary, Clone, Debug)]
pub struct Slots {
    /// What is left to chance: how a cut leaves words.
    pub chance: i64,
    /// Start and size of the pages of a region that may not fit, in units of 1024 bytes.
    pub region: [u8; 2],
    /// The keys that are provided before all others, 32 times the same byte: none, if it is 0 or 255.
    pub provided: [u8; 2],
    /// Of 256 writes, how many fail meanwhile.
    pub failing: u8,
    /// Words and pages until the power fails, for each cut, in turn; modulo 16.
    pub cuts: [u8; 4],
    /// At which starts the power fails again: a bit for each, in turn.
    pub starts: u8,
    /// In order. What fails with a trace is a flash that rejects; without, its power.
    pub events: Vec<Event>,
}

/// The keys of an end in flash.
struct InFlash {
    flash: Shared,
    slots: FlashKeyStore<Shared>,
    cuts: [u8; 4],
    starts: u8,
}

impl InFlash {
    /// With the key that both ends begin with.
    fn new(chance: i64, input: &Slots) -> Self {
        let flash = Shared::new(chance);
        let (mut slots, found) = opened::<Hmac>(&flash);
        assert!(found.is_none() && slots.is_empty());
        let _ = slots.provision::<Hmac>(&keys::bytes(1)).expect("stored");
        Self {
            flash,
            slots,
            cuts: input.cuts,
            starts: input.starts,
        }
    }

    fn cut(&mut self) {
        let [steps, ..] = self.cuts;
        self.cuts.rotate_left(1);
        let after = (steps % 16).into();
        self.flash.with(|flash| flash.cut_after(after));
    }
}

fn opened<P: Profile>(flash: &Shared) -> (FlashKeyStore<Shared>, Option<KeyRing<P>>) {
    FlashKeyStore::open(flash.clone(), REGION).expect("fits")
}

impl KeyStore for InFlash {
    fn store(&mut self, change: KeyChange<'_>) -> Result<(), NotStored> {
        let stored = self.slots.store(change);
        self.flash.with(|flash| flash.fail(0));
        stored
    }
}

impl Memory for InFlash {
    fn restart<P: Profile>(&mut self) -> KeyRing<P> {
        self.flash.restart();
        self.starts = self.starts.rotate_left(1);
        let mut before = None;
        if self.starts & 1 == 1 {
            self.cut();
            before = opened::<P>(&self.flash).1.map(|keys| keys.rollover_state());
            self.flash.restart();
        }
        let (slots, keys) = opened(&self.flash);
        self.slots = slots;
        let keys: KeyRing<P> = keys.expect("a key was stored");
        // What one start relied on, the next one finds.
        assert!(before.is_none_or(|phase| phase == keys.rollover_state()));
        keys
    }

    fn fail(&mut self, rejects: bool) {
        if rejects {
            self.flash.with(|flash| flash.fail(u8::MAX));
        } else {
            self.cut();
        }
    }
}

/// Both ends of a link with their keys in flash, whatever is lost and wherever the power fails (K1); which
/// keys are provided, and what is left of them; which regions hold keys.
pub fn key_slots(input: Slots) {
    fits(input.region);
    provides(&input);
    rejects(input.chance);
    // Each event is tried on every key that there ever was.
    let events = &input.events[..input.events.len().min(100)];
    let memories = [input.chance, !input.chance].map(|chance| InFlash::new(chance, &input));
    keys::change::<Hmac, _>(memories, events);
    alone(InFlash::new(input.chance, &input), events);
}

/// Only whole pages within the flash hold keys.
fn fits([start, size]: [u8; 2]) {
    let region = Region {
        start: 1024 * u32::from(start),
        page_size: 1024 * u32::from(size),
    };
    let flash = Shared::new(0);
    let opened = FlashKeyStore::open::<Hmac>(flash.clone(), region);
    let whole = start % 2 == 0 && size % 2 == 0 && size > 0;
    let inside = u16::from(start) + 2 * u16::from(size) <= 4;
    let expected = match (whole, inside) {
        (false, _) => Some(OpenError::NotAligned),
        (true, false) => Some(OpenError::OutOfBounds),
        (true, true) => None,
    };
    assert_eq!(opened.err(), expected);
    // With their sequence number and checksum, 11 bytes are no whole words.
    let odd = Journal::<_, 3>::open(flash, region, BINDING);
    assert_eq!(odd.is_err(), expected.is_some() || region == REGION);
}

/// Two keys are provided one after the other: the last that was stored is found again, alone, and that is no
/// longer there which went before it.
fn provides(input: &Slots) {
    let flash = Shared::new(input.chance);
    let (mut slots, _) = opened::<Hmac>(&flash);
    // What was rejected may have been stored all the same.
    let (mut may_be, mut in_use) = (Vec::new(), false);
    for byte in input.provided {
        flash.with(|flash| flash.fail(input.failing));
        let provided = slots.provision::<Hmac>(&[byte; KEY_SIZE]);
        match &provided {
            Ok(keys) => {
                assert_eq!(keys.rollover_state(), RolloverState::Settled);
                may_be = vec![byte];
                in_use = true;
            }
            Err(KeyChangeError::NotStored) if input.failing > 0 => may_be.push(byte),
            Err(error) => assert!(is_none(byte) && matches!(error, KeyChangeError::Key(_))),
        }
        assert!(!is_none(byte) || provided.is_err());
    }
    flash.restart();
    let (_, keys) = opened::<Hmac>(&flash);
    assert!(!in_use || keys.is_some());
    if let Some(keys) = keys {
        assert_eq!(keys.rollover_state(), RolloverState::Settled);
        let is = |byte: &&u8| accepts(&keys, **byte);
        let found = *may_be.iter().find(is).expect("one of those");
        for byte in input.provided {
            let holds = flash.with(|flash| flash.holds(&[byte; WORD_SIZE]));
            assert!(byte == found || is_none(byte) || !holds);
        }
    }
}

/// Whether 32 times this byte is no key: zeros, and erased flash.
const fn is_none(byte: u8) -> bool {
    matches!(byte, 0 | 0xFF)
}

/// Whether a frame that is signed with key `byte` is accepted.
fn accepts(keys: &KeyRing<Hmac>, byte: u8) -> bool {
    let key = SigningKey::<Hmac>::new(&[byte; KEY_SIZE]).expect("not zeros");
    let frame = signed(&key, Stamped::default().into());
    let frame = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
    keys.authenticate(frame).is_ok()
}

/// A flash that does nothing any more stores nothing, and says so.
fn rejects(chance: i64) {
    let flash = Shared::new(chance);
    let provision = |flash| HighWaterMark::provision(flash, REGION, BINDING, 0).expect("stored");
    let mut mark = provision(Shared::new(chance));
    assert!(mark.reserve(u64::MAX, 0).is_err());
    assert_eq!(mark.get(), 0);
    let mut mark = provision(flash.clone());
    let (mut journal, _) = Journal::<_, 8>::open(flash.clone(), REGION, BINDING).expect("fits");
    flash.with(Flash::cut);
    for stored in [journal.append(&[1; 8]), journal.replace(&[1; 8])] {
        assert!(stored.is_err());
    }
    assert!(mark.reserve(0, 9).is_err());
}

/// One end that hears nobody: what is rejected changes nothing, and what was stored is found again.
fn alone(mut memory: InFlash, events: &[Event]) {
    let mut keys: KeyRing<Hmac> = memory.restart();
    // Whether a store has failed, so that its trace may be found.
    let mut trace = false;
    for event in events {
        let before = keys.rollover_state();
        let result = match *event {
            Event::Offer => keys.offer(&keys::bytes(2), &mut memory),
            Event::Setup(number) => keys.apply(&keys::bytes(number % 4), &mut memory),
            Event::Confirm(_) => keys.confirm(&mut memory),
            Event::Retire(_) => keys.retire(&mut memory),
            Event::Withdraw => keys.withdraw(&mut memory),
            Event::Restart(_) => {
                keys = memory.restart();
                assert!(trace || keys.rollover_state() == before);
                trace = false;
                Ok(())
            }
            Event::Fail(_, rejects) => {
                memory.fail(rejects);
                Ok(())
            }
            Event::Send(_) | Event::Hear(..) => Ok(()),
        };
        trace |= result == Err(KeyChangeError::NotStored);
        assert!(result.is_ok() || keys.rollover_state() == before);
    }
}
