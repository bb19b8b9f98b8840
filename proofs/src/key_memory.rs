//! Where an end of a link keeps its keys, and a model of it that holds numbers.

use mavlink_signing::{
    KEY_SIZE, KeyChange, KeyRing, KeySlot, KeyStore, KeyUse, NotStored, Profile, RolloverState,
    SigningKey,
};

/// Where an end keeps its keys.
pub trait Memory: KeyStore {
    /// The keys after a restart.
    fn restart<P: Profile>(&mut self) -> KeyRing<P>;

    /// The next store fails, and may leave a trace.
    fn fail(&mut self, trace: bool);
}

/// A memory that holds the numbers of the keys.
#[derive(Clone, Copy, Debug)]
pub struct Model {
    stored: Stored,
    /// What a failed store has left.
    trace: Option<Stored>,
    failing: Option<bool>,
}

#[derive(Clone, Copy, Debug)]
struct Stored {
    phase: RolloverState,
    base: KeySlot,
    old: u8,
    new: u8,
}

impl Model {
    /// A memory with the first key.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            stored: Stored {
                phase: RolloverState::Settled,
                base: KeySlot::A,
                old: FIRST,
                new: FIRST,
            },
            trace: None,
            failing: None,
        }
    }

    /// A memory in the middle of a change, the old key in the slot `base`.
    pub(crate) const fn holding(phase: RolloverState, base: KeySlot, old: u8, new: u8) -> Self {
        let mut model = Self::new();
        model.stored = Stored {
            phase,
            base,
            old,
            new,
        };
        model
    }

    /// Phase, where the old key is, old and new key; settled, one key is both.
    pub(crate) fn stored(&self) -> (RolloverState, KeySlot, u8, u8) {
        let Stored {
            phase,
            base,
            old,
            new,
        } = self.stored;
        (
            phase,
            base,
            old,
            if phase == RolloverState::Settled {
                old
            } else {
                new
            },
        )
    }

    /// The next store fails, and leaves nothing.
    pub(crate) const fn fails(&mut self) {
        self.failing = Some(false);
    }
}

impl Default for Model {
    fn default() -> Self {
        Self::new()
    }
}

impl KeyStore for Model {
    fn store(&mut self, change: KeyChange<'_>) -> Result<(), NotStored> {
        let before = self.stored;
        let Stored {
            phase,
            base,
            old,
            new,
        } = before;
        let next = match change {
            KeyChange::Begin(key, phase) => Stored {
                phase,
                new: key[0],
                ..before
            },
            KeyChange::Confirm => Stored {
                phase: RolloverState::Confirmed,
                ..before
            },
            KeyChange::Retire => Stored {
                phase: RolloverState::Settled,
                base: base.other(),
                old: new,
                new,
            },
            KeyChange::Withdraw => Stored {
                phase: RolloverState::Settled,
                new: old,
                ..before
            },
        };
        assert!(phase != RolloverState::Settled || matches!(change, KeyChange::Begin(..)));
        match self.failing.take() {
            None => {
                self.stored = next;
                self.trace = None;
                Ok(())
            }
            Some(trace) => {
                self.trace = trace.then_some(next);
                Err(NotStored)
            }
        }
    }
}

impl Memory for Model {
    fn restart<P: Profile>(&mut self) -> KeyRing<P> {
        self.stored = self.trace.take().unwrap_or(self.stored);
        self.failing = None;
        let Stored {
            phase,
            base,
            old,
            new,
        } = self.stored;
        KeyRing::resume(base, key(old), key(new), phase)
    }

    fn fail(&mut self, trace: bool) {
        self.failing = Some(trace);
    }
}

/// The number of the key that both ends begin with.
pub(crate) const FIRST: u8 = 1;

/// The bytes of key `number`.
#[must_use]
pub const fn bytes(number: u8) -> [u8; KEY_SIZE] {
    [number; KEY_SIZE]
}

/// Key `number`, neither 0 nor 255: zeros, and erased flash.
pub(crate) fn key<P: Profile>(number: u8) -> SigningKey<P> {
    SigningKey::new(&bytes(number)).expect("not zeros")
}

/// Keys with which a frame that is signed with the key of number [`FIRST`] is of this use.
pub(crate) fn ring<P: Profile>(used: KeyUse) -> KeyRing<P> {
    if used.former {
        let new = key(FIRST + 1);
        KeyRing::resume(used.slot, key(FIRST), new, RolloverState::Applied)
    } else {
        KeyRing::in_slot(used.slot, key(FIRST))
    }
}
