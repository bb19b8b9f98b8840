//! Changing the key of a link while it is in use, in two phases, so that no end goes deaf.

use core::fmt;

use subtle::ConstantTimeEq;

use crate::error::{NotStored, VerifyError};
use crate::field::KEY_SIZE;
use crate::frame::FrameRef;
use crate::key::{KeyError, SigningKey, is_published};
use crate::profile::Profile;
use crate::verify::{Authentic, Verified, authenticate};

/// Which of the two places of a [`KeyRing`] a key is in: the same for as long as the key is kept, over restarts too.
///
/// A key has its own order of stamps, its own mark and its own receiver. So whoever has an old key cannot spoil the
/// new one, and a new key starts anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum KeySlot {
    /// The first.
    A,
    /// The second.
    B,
}

impl KeySlot {
    /// The other one.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }

    /// What belongs to this one.
    pub const fn of<T>(self, both: &[T; 2]) -> &T {
        let [a, b] = both;
        match self {
            Self::A => a,
            Self::B => b,
        }
    }

    /// What belongs to this one, to be changed.
    pub const fn of_mut<T>(self, both: &mut [T; 2]) -> &mut T {
        let [a, b] = both;
        match self {
            Self::A => a,
            Self::B => b,
        }
    }
}

/// Which key a frame was signed with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct KeyUse {
    /// Where it is.
    pub slot: KeySlot,
    /// Whether another key is already in use in its place, or was heard. Such a frame is accepted, and sets no clock.
    pub former: bool,
}

impl KeyUse {
    /// That of an end with one key.
    pub const ONLY: Self = Self {
        slot: KeySlot::A,
        former: false,
    };
}

/// How far a change of key has come at one end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RolloverState {
    /// One key. No change is under way.
    Settled,
    /// This end has sent a new key to the other, and does not know whether it arrived. It signs with the
    /// old one until it accepts a frame with the new one.
    Offered,
    /// This end was given a new key, and signs with it. The end that gave it accepts both.
    Applied,
    /// A frame of the other end with the new key was accepted. Both sign with it. The old key waits to be
    /// retired.
    Confirmed,
}

/// What is to be stored of a change of key, before it has any effect.
#[derive(Clone, Copy)]
pub enum KeyChange<'a> {
    /// A new key beside the one in use, in the state [`RolloverState::Offered`] or
    /// [`RolloverState::Applied`].
    Begin(&'a [u8; KEY_SIZE], RolloverState),
    /// [`RolloverState::Confirmed`]; the keys stay.
    Confirm,
    /// [`RolloverState::Settled`] with the new key; the old one is to be erased.
    Retire,
    /// [`RolloverState::Settled`] with the old key; the new one is to be erased.
    Withdraw,
}

impl fmt::Debug for KeyChange<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Begin(..) => "Begin(redacted)",
            Self::Confirm => "Confirm",
            Self::Retire => "Retire",
            Self::Withdraw => "Withdraw",
        })
    }
}

/// Where keys are kept over a restart.
pub trait KeyStore {
    /// Stores `change`. After a restart, the [`KeyRing`] is resumed in the state after it.
    ///
    /// # Errors
    ///
    /// [`NotStored`]: after a restart, either the state before it or the state after it is found.
    fn store(&mut self, change: KeyChange<'_>) -> Result<(), NotStored>;
}

/// Why a key was not changed. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum KeyChangeError {
    /// It is no key. Its sender is at fault, or wants this end to stop signing: it does not.
    Key(KeyError),
    /// Another change is under way. Retire its old key, or withdraw its new one.
    UnderWay,
    /// No new key has been offered that could be withdrawn, or the other end uses it already.
    NotOffered,
    /// No frame with the new key has been accepted. To retire the old key could make this end deaf.
    NotConfirmed,
    /// The keys cannot be stored. The memory is at fault.
    NotStored,
}

impl From<KeyError> for KeyChangeError {
    fn from(error: KeyError) -> Self {
        Self::Key(error)
    }
}

impl From<NotStored> for KeyChangeError {
    fn from(_: NotStored) -> Self {
        Self::NotStored
    }
}

impl fmt::Display for KeyChangeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Key(error) => error.fmt(f),
            Self::UnderWay => f.write_str("another change of key is under way"),
            Self::NotOffered => f.write_str("no key is offered that could be withdrawn"),
            Self::NotConfirmed => f.write_str("the other end has not been heard with the new key"),
            Self::NotStored => f.write_str("the keys cannot be stored"),
        }
    }
}

impl core::error::Error for KeyChangeError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Key(error) => Some(error),
            _ => None,
        }
    }
}

/// What frames are authenticated with: one key, or the [`KeyRing`] of a change.
pub trait Authenticate {
    /// [`authenticate`] with any of the keys.
    ///
    /// # Errors
    ///
    /// Those of [`authenticate`].
    fn authenticate<'a>(&self, frame: FrameRef<'a>) -> Result<Authentic<'a>, VerifyError>;

    /// Learns from a frame that was accepted.
    fn on_accepted(&mut self, frame: &Verified<'_>) {
        let _ = frame;
    }
}

impl<P: Profile> Authenticate for &SigningKey<P> {
    fn authenticate<'a>(&self, frame: FrameRef<'a>) -> Result<Authentic<'a>, VerifyError> {
        authenticate(frame, self)
    }
}

/// The key of one end of a link, or the old and the new one while it is changed.
///
/// ```text
/// ground station            SETUP_SIGNING            vehicle
/// Settled(old)                                       Settled(old)
///   offer(new)                  ------>
/// Offered: signs old, accepts both                     apply(new)
///                               <------              Applied: signs new, accepts both
///   hears new: confirm()
/// Confirmed: signs new, accepts both
///                               ------>                hears new: confirm()
///                                                    Confirmed: signs new, accepts both
///   retire()                                           retire()
/// Settled(new)                                       Settled(new)
/// ```
///
/// Each end accepts at every moment what the other signs with, whatever is lost on the way and wherever the
/// power fails. [`KeyRing::retire`] alone drops an old key, never a timeout. It does so only after a frame
/// with the new key was accepted. Every step is stored before it has an effect.
///
/// Each key is in a [`KeySlot`] of its own, with its own order of stamps.
pub struct KeyRing<P> {
    /// Where the old one is.
    base: KeySlot,
    /// The key that was in use before the change, or the only one.
    old: SigningKey<P>,
    /// The new one, unless `Settled`.
    new: Option<SigningKey<P>>,
    phase: RolloverState,
    /// A frame with the new key was accepted.
    heard: bool,
}

impl<P: Profile> From<SigningKey<P>> for KeyRing<P> {
    fn from(key: SigningKey<P>) -> Self {
        Self::in_slot(KeySlot::A, key)
    }
}

impl<P: Profile> KeyRing<P> {
    /// One key, in this slot.
    #[must_use]
    pub const fn in_slot(slot: KeySlot, key: SigningKey<P>) -> Self {
        Self {
            base: slot,
            old: key,
            new: None,
            phase: RolloverState::Settled,
            heard: false,
        }
    }
}

impl<P: Profile> Authenticate for KeyRing<P> {
    fn authenticate<'a>(&self, frame: FrameRef<'a>) -> Result<Authentic<'a>, VerifyError> {
        let slot = self.signing_slot();
        let other = || self.key(slot.other()).ok_or(VerifyError::BadTag);
        let (slot, verdict) = match authenticate(frame, self.signing()) {
            Err(VerifyError::BadTag) => (slot.other(), authenticate(frame, other()?)),
            verdict => (slot, verdict),
        };
        let former = slot == self.base && (self.signing_slot() != slot || self.heard);
        verdict.map(|frame| frame.with_key(KeyUse { slot, former }))
    }

    fn on_accepted(&mut self, frame: &Verified<'_>) {
        let unconfirmed = matches!(self.phase, RolloverState::Offered | RolloverState::Applied);
        self.heard |= unconfirmed && frame.key().slot != self.base;
    }
}

impl<P: Profile> KeyRing<P> {
    /// Two keys in the middle of a change, as they were stored, the old one in the slot `base`. With
    /// [`RolloverState::Settled`], `new` is dropped.
    #[must_use]
    pub fn resume(
        base: KeySlot,
        old: SigningKey<P>,
        new: SigningKey<P>,
        phase: RolloverState,
    ) -> Self {
        Self {
            base,
            old,
            new: (phase != RolloverState::Settled).then_some(new),
            phase,
            heard: false,
        }
    }

    /// How far a change of key has come.
    #[must_use]
    pub const fn rollover_state(&self) -> RolloverState {
        self.phase
    }

    /// The key to sign with.
    #[must_use]
    pub fn signing(&self) -> &SigningKey<P> {
        match (&self.new, self.phase) {
            (Some(new), RolloverState::Applied | RolloverState::Confirmed) => new,
            _ => &self.old,
        }
    }

    /// Where the key to sign with is.
    #[must_use]
    pub const fn signing_slot(&self) -> KeySlot {
        match self.phase {
            RolloverState::Applied | RolloverState::Confirmed => self.base.other(),
            RolloverState::Settled | RolloverState::Offered => self.base,
        }
    }

    /// Where the key is that was given last.
    #[must_use]
    pub const fn newest_slot(&self) -> KeySlot {
        match self.phase {
            RolloverState::Settled => self.base,
            _ => self.base.other(),
        }
    }

    /// The key in `slot`, if there is one.
    #[must_use]
    pub fn key(&self, slot: KeySlot) -> Option<&SigningKey<P>> {
        if slot == self.base {
            Some(&self.old)
        } else {
            self.new.as_ref()
        }
    }

    /// Where `key` would go, if [`offer`](Self::offer) or [`apply`](Self::apply) began a change to it; `None` if they
    /// would not. What was remembered of that slot is to be forgotten first: [`LinkClock::begin_key`].
    ///
    /// [`LinkClock::begin_key`]: crate::LinkClock::begin_key
    #[must_use]
    pub fn slot_for(&self, key: &SigningKey<P>) -> Option<KeySlot> {
        let begins = self.phase == RolloverState::Settled && !same(key, &self.old);
        begins.then_some(self.base.other())
    }

    /// Whether `key` is the one that was given last.
    #[must_use]
    pub fn is_newest(&self, key: &SigningKey<P>) -> bool {
        same(key, self.new.as_ref().unwrap_or(&self.old))
    }

    /// Begins to change to `key`, before it is sent to the other end. A key that is already offered can be
    /// offered again, since SETUP_SIGNING may be lost.
    ///
    /// # Errors
    ///
    /// [`KeyChangeError::Key`], [`KeyChangeError::UnderWay`], [`KeyChangeError::NotStored`].
    pub fn offer(
        &mut self,
        key: &[u8; KEY_SIZE],
        store: &mut impl KeyStore,
    ) -> Result<(), KeyChangeError> {
        let new = Self::prepare(key)?;
        if self.is_newest(&new) {
            return Ok(());
        }
        if self.phase != RolloverState::Settled {
            return Err(KeyChangeError::UnderWay);
        }
        store.store(KeyChange::Begin(key, RolloverState::Offered))?;
        self.begin(new, RolloverState::Offered);
        Ok(())
    }

    /// Takes over `key`, which came from the other end, or in its place on a trusted port. It may also be
    /// one that this end has offered itself.
    ///
    /// * The old key again ends the change, unless a frame with the new key was accepted. If the other end
    ///   has retired the old key, this end rejects its frames until the new key is applied again.
    ///
    /// * The newest key changes nothing, except that an offer counts as taken over.
    ///
    /// A third key must wait: the other end may already sign with the second alone.
    ///
    /// # Errors
    ///
    /// [`KeyChangeError::Key`], [`KeyChangeError::UnderWay`], [`KeyChangeError::NotStored`].
    pub fn apply(
        &mut self,
        key: &[u8; KEY_SIZE],
        store: &mut impl KeyStore,
    ) -> Result<(), KeyChangeError> {
        let new = Self::prepare(key)?;
        if self.is_newest(&new) {
            // Otherwise two ends that were both told to offer it would wait for each other.
            if self.phase == RolloverState::Offered {
                store.store(KeyChange::Begin(key, RolloverState::Applied))?;
                self.phase = RolloverState::Applied;
            }
            return Ok(());
        }
        if self.phase == RolloverState::Applied && !self.heard && same(&new, &self.old) {
            store.store(KeyChange::Withdraw)?;
            *self = Self::in_slot(self.base, new);
            return Ok(());
        }
        if self.phase != RolloverState::Settled {
            return Err(KeyChangeError::UnderWay);
        }
        store.store(KeyChange::Begin(key, RolloverState::Applied))?;
        self.begin(new, RolloverState::Applied);
        Ok(())
    }

    /// Whether [`KeyRing::confirm`] is due: a frame with the new key was accepted.
    #[must_use]
    pub const fn confirm_pending(&self) -> bool {
        self.heard
    }

    /// Goes over to the new key, if a frame with it was accepted. Otherwise does nothing.
    ///
    /// # Errors
    ///
    /// [`KeyChangeError::NotStored`]; it is still due then.
    pub fn confirm(&mut self, store: &mut impl KeyStore) -> Result<(), KeyChangeError> {
        if self.heard {
            store.store(KeyChange::Confirm)?;
            self.phase = RolloverState::Confirmed;
            self.heard = false;
        }
        Ok(())
    }

    /// Drops the old key. Do so when frames with the new key were accepted from everybody who has the old
    /// one.
    ///
    /// # Errors
    ///
    /// [`KeyChangeError::NotConfirmed`], [`KeyChangeError::NotStored`].
    pub fn retire(&mut self, store: &mut impl KeyStore) -> Result<(), KeyChangeError> {
        if self.phase != RolloverState::Confirmed {
            return Err(KeyChangeError::NotConfirmed);
        }
        store.store(KeyChange::Retire)?;
        if let Some(new) = self.new.take() {
            *self = Self::in_slot(self.base.other(), new);
        }
        Ok(())
    }

    /// Drops the key that was offered, for instance because the other end rejects it.
    ///
    /// Then send the old key to the peer. If it had already switched, this end rejects its frames until it
    /// switches back. The peer still accepts the old key. Do not offer the same key again.
    ///
    /// # Errors
    ///
    /// [`KeyChangeError::NotOffered`], [`KeyChangeError::NotStored`].
    pub fn withdraw(&mut self, store: &mut impl KeyStore) -> Result<(), KeyChangeError> {
        if self.phase != RolloverState::Offered || self.heard {
            return Err(KeyChangeError::NotOffered);
        }
        store.store(KeyChange::Withdraw)?;
        self.new = None;
        self.phase = RolloverState::Settled;
        Ok(())
    }

    /// The key in `key`, if it is one to keep.
    ///
    /// # Errors
    ///
    /// [`KeyError`], [`KeyError::Published`] among them.
    pub fn prepare(key: &[u8; KEY_SIZE]) -> Result<SigningKey<P>, KeyError> {
        if is_published(key) {
            return Err(KeyError::Published);
        }
        SigningKey::new(key)
    }

    fn begin(&mut self, new: SigningKey<P>, phase: RolloverState) {
        self.new = Some(new);
        self.phase = phase;
        self.heard = false;
    }
}

/// Whether two keys give the same tags. Their bytes cannot be compared: keys do not show them.
fn same<P: Profile>(one: &SigningKey<P>, other: &SigningKey<P>) -> bool {
    // No frame begins so.
    [b"mavseal same key, 1", b"mavseal same key, 2"]
        .iter()
        .all(|text| bool::from(one.tag(*text).ct_eq(&other.tag(*text))))
}

impl<P> fmt::Debug for KeyRing<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("KeyRing")
            .field("phase", &self.phase)
            .finish_non_exhaustive()
    }
}
