//! Changing the key of a link while it is in use, in two phases, so that no end goes deaf.

use core::fmt;

use subtle::ConstantTimeEq;

use crate::error::{NotStored, VerifyError};
use crate::field::KEY_SIZE;
use crate::frame::FrameRef;
use crate::key::{KeyError, SigningKey};
use crate::profile::Profile;
use crate::verify::{Authentic, Verified, authenticate};

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
/// Stamps go on across the change, so one receiver serves both keys.
pub struct KeyRing<P> {
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
        Self {
            old: key,
            new: None,
            phase: RolloverState::Settled,
            heard: false,
        }
    }
}

impl<P: Profile> Authenticate for KeyRing<P> {
    fn authenticate<'a>(&self, frame: FrameRef<'a>) -> Result<Authentic<'a>, VerifyError> {
        let verdict = authenticate(frame, self.signing());
        match (self.other(), &verdict) {
            (Some(other), Err(VerifyError::BadTag)) => authenticate(frame, other),
            _ => verdict,
        }
    }

    fn on_accepted(&mut self, frame: &Verified<'_>) {
        let unconfirmed = matches!(self.phase, RolloverState::Offered | RolloverState::Applied);
        if let Some(new) = self.new.as_ref().filter(|_| unconfirmed && !self.heard) {
            let frame = FrameRef::parse(frame.as_bytes());
            self.heard = frame.is_ok_and(|frame| authenticate(frame, new).is_ok());
        }
    }
}

impl<P: Profile> KeyRing<P> {
    /// Two keys in the middle of a change, as they were stored. With [`RolloverState::Settled`], `new` is dropped.
    #[must_use]
    pub fn resume(old: SigningKey<P>, new: SigningKey<P>, phase: RolloverState) -> Self {
        Self {
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

    /// The key that is also accepted.
    fn other(&self) -> Option<&SigningKey<P>> {
        match self.phase {
            RolloverState::Settled => None,
            RolloverState::Offered => self.new.as_ref(),
            RolloverState::Applied | RolloverState::Confirmed => Some(&self.old),
        }
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
        let new = SigningKey::new(key)?;
        if same(&new, self.new.as_ref().unwrap_or(&self.old)) {
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
        let new = SigningKey::new(key)?;
        if same(&new, self.new.as_ref().unwrap_or(&self.old)) {
            // Otherwise two ends that were both told to offer it would wait for each other.
            if self.phase == RolloverState::Offered {
                store.store(KeyChange::Begin(key, RolloverState::Applied))?;
                self.phase = RolloverState::Applied;
            }
            return Ok(());
        }
        if self.phase == RolloverState::Applied && !self.heard && same(&new, &self.old) {
            store.store(KeyChange::Withdraw)?;
            *self = Self::from(new);
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
            *self = Self::from(new);
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
