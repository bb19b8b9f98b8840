//! The in-line signer: both directions, and what they share.

use core::fmt;

use mavlink_signing::{
    AntiReplay, KEY_SIZE, KeyChangeError, KeyRing, KeyStore, LinkClock, Profile, RejectUnsigned,
    ReplayGuard, RolloverState, SetupSigning, Stamper, Timestamp, UnsignedPolicy,
};

use crate::direction::{ForwardMode, Presence, Senders, Signer, Verifier};
use crate::endpoint::{Endpoint, LineEvent, Side};
use crate::event::{Counters, Direction, Event, RejectReason};
use crate::pump::{Lane, Pump};

/// The ids of the two directions are the same, so that a frame sent out and reflected would be
/// taken for the peer's. Whoever set up the link is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SameLinkId(
    /// The id.
    pub u8,
);

impl fmt::Display for SameLinkId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "both directions have link id {}", self.0)
    }
}

impl core::error::Error for SameLinkId {}

/// The in-line signer, an [`Endpoint`]. See the [crate's documentation](crate).
///
/// `R` decides about order: [`ReplayGuard`] for one peer, [`StreamTable`](mavlink_signing::StreamTable) for several.
/// `U` says which unsigned frames go on to the local side all the same: none, unless asked.
pub struct Relay<P, R = ReplayGuard, U = RejectUnsigned> {
    keys: KeyRing<P>,
    link_id: u8,
    outbound: Pump<Signer>,
    inbound: Pump<Verifier<R, U>>,
}

impl<P, R, U> fmt::Debug for Relay<P, R, U> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Relay")
            .field("outbound", &self.outbound.lane.counters)
            .field("inbound", &self.inbound.lane.counters)
            .finish_non_exhaustive()
    }
}

impl<P: Profile, R: AntiReplay> Relay<P, R> {
    /// A relay that signs with `keys`, one key or the two of a change, and the stamps of `stamper`,
    /// verifies with `keys` and `receiver`, and hands verified frames on as `forward` says.
    ///
    /// `stamper` and `receiver` are for the key that is signed with now. What a clock remembers of each key,
    /// [`LinkClock::floor`], is kept to in any case.
    ///
    /// # Errors
    ///
    /// [`SameLinkId`] if `receiver` would take frames that were signed here for frames of the peer.
    pub fn new(
        keys: impl Into<KeyRing<P>>,
        stamper: Stamper,
        receiver: R,
        forward: ForwardMode,
    ) -> Result<Self, SameLinkId> {
        let link_id = stamper.link_id();
        if !receiver.rejects_own(link_id) {
            return Err(SameLinkId(link_id));
        }
        let keys = keys.into();
        let slot = keys.signing_slot();
        Ok(Self {
            keys,
            link_id,
            outbound: Pump::new(Signer::new(stamper.in_slot(slot))),
            inbound: Pump::new(Verifier::new(slot, receiver, forward)),
        })
    }

    /// The same relay, which also hands on to the local side what comes in unsigned and `policy`
    /// accepts. The policy is told the link id that the relay signs for, whatever the peers sign for.
    ///
    /// Unsigned it leaves, with [`ForwardMode::KeepSignature`] too: the local side cannot tell it from what was
    /// verified and stripped, and signs it if it sends it back.
    #[must_use]
    pub fn accepting<U: UnsignedPolicy>(self, policy: U) -> Relay<P, R, U> {
        let link_id = self.link_id;
        Relay {
            keys: self.keys,
            link_id,
            outbound: self.outbound,
            inbound: self
                .inbound
                .map(|verifier| verifier.accepting(link_id, policy)),
        }
    }
}

impl<P: Profile, R: AntiReplay, U: UnsignedPolicy> Relay<P, R, U> {
    /// The same relay with `ticks` in place of [`IDLE`](crate::IDLE): longer than any sender pauses within a packet, such
    /// as a radio's slots make.
    #[must_use]
    pub const fn idle(mut self, ticks: u64) -> Self {
        self.outbound.lane.reader.set_idle(ticks);
        self.inbound.lane.reader.set_idle(ticks);
        self
    }

    /// The same relay on a link side that carries `rate` bytes a second, in place of [`LINE_RATE`](crate::LINE_RATE). A
    /// packet that takes longer than its bytes at that rate, and the idle time, is given up.
    #[must_use]
    pub fn line_rate(mut self, rate: u32) -> Self {
        self.inbound.lane.reader.set_line_rate(rate);
        self
    }

    /// The same relay, which signs in the name of `senders`, not of the system whose HEARTBEAT comes first.
    #[must_use]
    pub fn senders(mut self, senders: Senders) -> Self {
        self.outbound = self.outbound.map(|signer| signer.for_senders(senders));
        self
    }

    /// From now on keeps the last SETUP_SIGNING for this system and component that comes in on the local side with
    /// [presence](Self::set_presence) or proof, for [`Relay::take_setup`].
    pub fn keep_setup(&mut self, system_id: u8, component_id: u8) {
        self.outbound.handler.keep_setup(system_id, component_id);
    }

    /// Says whether somebody is there who may give a key. Absent, unless said otherwise.
    pub fn set_presence(&mut self, presence: Presence) {
        self.outbound.handler.set_presence(presence);
    }

    /// The SETUP_SIGNING that came since it was last asked for. Nothing has been done about it:
    /// [`Relay::apply_setup`] does.
    pub fn take_setup(&mut self) -> Option<SetupSigning> {
        self.outbound.handler.take_setup()
    }

    /// The keys of both directions.
    pub const fn keys(&self) -> &KeyRing<P> {
        &self.keys
    }

    /// Takes over the key of `setup`: [`KeyRing::apply`]. A new key has its own order of stamps, which begins with the
    /// `initial_timestamp`, if that may be right. A clock that nobody has told the time begins there too; with the newest
    /// key once more too, until the change has come to its end; then it shows it at least. A synced clock is not touched.
    ///
    /// # Errors
    ///
    /// Those of [`KeyRing::apply`].
    pub fn apply_setup(
        &mut self,
        setup: &SetupSigning,
        clock: &mut impl LinkClock,
        store: &mut impl KeyStore,
    ) -> Result<(), KeyChangeError> {
        self.begin_key(&setup.secret_key, setup.initial_timestamp, clock)?;
        self.keys.apply(&setup.secret_key, store)
    }

    /// Begins to change to `key`, before it is sent to the other end: [`KeyRing::offer`]. `initial` is the time, as
    /// whoever changes the key knows it, and the `initial_timestamp` to send: [`LinkClock::begin_key`].
    ///
    /// # Errors
    ///
    /// Those of [`KeyRing::offer`].
    pub fn offer_key(
        &mut self,
        key: &[u8; KEY_SIZE],
        initial: Timestamp,
        clock: &mut impl LinkClock,
        store: &mut impl KeyStore,
    ) -> Result<(), KeyChangeError> {
        self.begin_key(key, initial, clock)?;
        self.keys.offer(key, store)
    }

    /// If `key` begins a change, forgets what was remembered of the slot that it goes to.
    fn begin_key(
        &mut self,
        key: &[u8; KEY_SIZE],
        initial: Timestamp,
        clock: &mut impl LinkClock,
    ) -> Result<(), KeyChangeError> {
        let key = KeyRing::<P>::prepare(key)?;
        if let Some(slot) = self.keys.slot_for(&key) {
            let first = clock.begin_key(slot, key.fingerprint(), initial)?;
            self.outbound.handler.begin_key(slot, first);
            self.inbound.handler.begin_key(slot, first);
        } else if self.keys.is_newest(&key) {
            let settled = self.keys.rollover_state() == RolloverState::Settled;
            clock.repeat_key(initial, settled);
        }
        Ok(())
    }

    /// Goes over to the new key, if a frame with it was accepted: [`KeyRing::confirm`].
    ///
    /// # Errors
    ///
    /// Those of [`KeyRing::confirm`].
    pub fn confirm_key(&mut self, store: &mut impl KeyStore) -> Result<(), KeyChangeError> {
        self.keys.confirm(store)
    }

    /// Drops the old key: [`KeyRing::retire`].
    ///
    /// # Errors
    ///
    /// Those of [`KeyRing::retire`].
    pub fn retire_key(&mut self, store: &mut impl KeyStore) -> Result<(), KeyChangeError> {
        self.keys.retire(store)
    }

    /// Drops the key that was offered: [`KeyRing::withdraw`].
    ///
    /// # Errors
    ///
    /// Those of [`KeyRing::withdraw`].
    pub fn withdraw_key(&mut self, store: &mut impl KeyStore) -> Result<(), KeyChangeError> {
        self.keys.withdraw(store)
    }

    /// What has been signed and rejected on its way from the local to the link side.
    #[must_use]
    pub const fn outbound(&self) -> &Counters {
        &self.outbound.lane.counters
    }

    /// What has been verified and rejected on its way from the link to the local side.
    #[must_use]
    pub const fn inbound(&self) -> &Counters {
        &self.inbound.lane.counters
    }

    /// What came in on `side` and goes out on the other.
    const fn from(&mut self, side: Side) -> &mut Lane {
        match side {
            Side::Local => &mut self.outbound.lane,
            Side::Link => &mut self.inbound.lane,
        }
    }

    /// Looks at what has come in on `side`.
    fn advance(&mut self, side: Side, clock: &mut impl LinkClock, observe: &mut impl FnMut(Event)) {
        let Self {
            keys,
            outbound,
            inbound,
            ..
        } = self;
        match side {
            Side::Local => {
                if let Some(frame) = outbound.advance(keys, clock, observe) {
                    inbound.handler.record_sent(keys.signing_slot(), frame);
                }
            }
            Side::Link => {
                let _ = inbound.advance(keys, clock, observe);
            }
        }
    }
}

impl<P: Profile, R: AntiReplay, U: UnsignedPolicy> Endpoint for Relay<P, R, U> {
    type Event = Event;

    fn room(&self, side: Side) -> usize {
        match side {
            Side::Local => self.outbound.lane.reader.room(),
            Side::Link => self.inbound.lane.reader.room(),
        }
    }

    fn received(
        &mut self,
        side: Side,
        bytes: &[u8],
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(Event),
    ) -> usize {
        let now = clock.monotonic();
        let mut rest = bytes;
        loop {
            let count = self.from(side).reader.write(rest, now);
            if count == 0 {
                return bytes.len() - rest.len();
            }
            rest = rest.get(count..).unwrap_or_default();
            self.advance(side, clock, observe);
        }
    }

    fn pending(&self, side: Side) -> &[u8] {
        match side {
            Side::Local => self.inbound.lane.pending(),
            Side::Link => self.outbound.lane.pending(),
        }
    }

    fn sent(
        &mut self,
        side: Side,
        count: usize,
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(Event),
    ) {
        let from = side.other();
        let lane = self.from(from);
        if lane.sent(count) {
            lane.reader.restart_timer(clock.monotonic());
            self.advance(from, clock, observe);
        }
    }

    fn line_event(
        &mut self,
        side: Side,
        event: LineEvent,
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(Event),
    ) {
        let reader = &mut self.from(side).reader;
        match event {
            LineEvent::Idle => reader.silent(),
            _ => reader.fault(clock.monotonic()),
        }
        self.advance(side, clock, observe);
        if event == LineEvent::Closed && self.from(side.other()).drop_frame() {
            let direction = match side {
                Side::Local => Direction::Inbound,
                Side::Link => Direction::Outbound,
            };
            observe(Event::Rejected(direction, RejectReason::LineClosed));
            self.from(side.other())
                .reader
                .restart_timer(clock.monotonic());
            self.advance(side.other(), clock, observe);
        }
    }

    fn poll_at(&self) -> Option<u64> {
        let deadlines = [self.outbound.lane.due_at(), self.inbound.lane.due_at()];
        deadlines.into_iter().flatten().min()
    }

    fn poll(&mut self, clock: &mut impl LinkClock, observe: &mut impl FnMut(Event)) {
        let now = clock.monotonic();
        for side in [Side::Local, Side::Link] {
            while self.from(side).poll(now) {
                self.advance(side, clock, observe);
            }
        }
    }
}
