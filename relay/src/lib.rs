//! The in-line signer: it sits between equipment that cannot sign and a radio.
//!
//! ```text
//! local side            signed with the key, on one link id            link side
//! (autopilot, UART)  ------------------------------------------>  (radio, network)
//!                    <------------------------------------------
//!                    only verified frames
//! ```
//!
//! * Local to link: a frame is signed only if its own checksum is right. Bad checksums, unknown
//!   messages, MAVLink 1 and frames that are already signed are rejected and counted. The payload of a
//!   rejected packet is not searched for packets, so that bytes that somebody else put there are not
//!   signed: [`Resync::AnnouncedEnd`](mavlink_signing::Resync), also for what that does not do on a line
//!   that loses bytes.
//! * Link to local: only verified frames leave, without signature or whole, and unsigned ones that a
//!   [policy](Relay::accepting) accepts, if there is one. Everything else is rejected and counted by reason.
//!   The relay signs nothing that came in on the link side; where the local side may send back what it
//!   receives, hand frames on [whole](ForwardMode::KeepSignature), so that they are rejected as already signed.
//! * SETUP_SIGNING, which carries a key, passes in neither direction. What comes for the relay itself on the
//!   local side, a cable, it [takes](Relay::take_setup) if it is told to: [`Relay::keep_setup`].
//!
//! [`sealed`] is the end of a sealed link, over the same ports.
//!
//! # Over a restart
//!
//! With a [`PersistentClock`] as its clock, no stamp is used again and no frame accepted again after the power failed,
//! wherever it did. [`FlashKeyStore`] keep the key, and both keys while it is changed. What each choice costs:
//!
//! | choice | price |
//! |---|---|
//! | the mark is up to 10 s ahead of what is used | after a restart, frames are rejected for up to 10 s |
//! | it is stored every 10 s, at first more often | flash: see `mavseal-store`, Wear; a [`Relay::poll`] takes as long as a write, or an erase |
//! | the keys are stored again at each start | flash: 80 bytes |
//! | a board without a clock keeps within 10 s of what it hears | its frames may be rejected for so much longer |
//! | it accepts whatever is newer than all before | it has no window: it cannot tell how late a frame is, nor that a recording is one which it never heard |
//! | it goes up to 365 days ahead with a frame | a peer with a wrong clock takes it along so far; off for longer, it is deaf until it is told the time |
//! | a trusted clock is asked at least every 8 h | otherwise the board is one without a clock |
//! | GNSS and SYSTEM_TIME move a clock by a second at most, until a trusted source sets it | a board with these alone is one without a clock |
//! | a trusted clock more than 70 s behind the mark is not believed | a board that ran ahead, or was taken along, is one without a clock until that time has come |
//! | what cannot be remembered is rejected | with a worn-out flash the link ends: [`RejectReason::NotStored`] |
//! | an old key stays until it is retired | whoever has it is heard until then |
//!
//! The link is back 35 seconds after the power at the latest, if a third of the frames is lost: the reservation
//! that was skipped, the one that a board without a clock is behind, and the rest for frames to come through.
//! It takes longer if somebody's clock, or last stamp, is ahead of the others: by as much as that is, and, beyond
//! 60 seconds, which the window takes, twice. Clocks of boards that nobody has told the time go wrong by 2
//! minutes in a week, with the worst of crystals. `relay/tests/simulation.rs` asserts this in 100,000 histories
//! (`cargo xtask test --all`).
//!
//! # A new key
//!
//! SETUP_SIGNING on the local side, once at each end: the end that it is told to signs with it from then on, and
//! accepts both keys; [`KeyRing::offer`] is for the end that sends it. When an end has heard the new key,
//! [`KeyRing::confirm`] is due. Then the old one can be [retired](KeyRing::retire): the firmware in `chips/qemu-m7` does
//! when SETUP_SIGNING brings the key in use once more, and until then takes no third. A key that leaked is
//! accepted until it is retired.
//!
//! Where more than two ends share a key, who has offered it confirms when all others were heard with it, and
//! everybody retires the old one before the next is offered.
//!
//! # Locked out
//!
//! * `too old` or `from the future`, and it does not end: one of the two clocks is wrong. Set it right on a
//!   trusted port, by SETUP_SIGNING with the key in use and the right `initial_timestamp`.
//! * `replayed` after a restart: the mark is ahead. It passes, at most the reservation after the clocks are
//!   together. If a trusted source, or a peer that a board without a clock believed, once told a time far in the
//!   future, it does not: nothing that was signed or accepted with this key may become fresh again. Erase mark
//!   and keys, both, and give both ends a new key.
//! * The time told is not believed ([`TimeBehindMark`]): the same.
//! * `bad tag`: another key. SETUP_SIGNING on the local side with a key that the other end has; the key in
//!   use before is accepted as well until it is retired. While another change is under way
//!   ([`RolloverState`](mavlink_signing::Phase), [`UnderWay`](mavlink_signing::KeyChangeError::UnderWay)) a third key is
//!   rejected: end that one first, or take it back with the old key, as long as the other end has not retired
//!   that: after it has, both are deaf until the new key is applied once more.
//! * Nothing starts because the keys cannot be read: start again, as a flash that did not take a write has lost
//!   nothing. If that does not help, they are lost. Erase it; the mark may stay.
//! * `not stored`: replace the board, or its flash.
//!
//! The relay knows no UART, no clock and no heap. Its ports are [`embedded_io`] ports that say
//! whether they are ready, its time comes from a [`Clock`], and [`Relay::poll`] never waits for them. Each
//! direction holds one packet being received and one frame being sent, 560 bytes together; when a
//! port does not take bytes, its direction stops reading until it does, and the other goes on. So
//! nothing that was read is dropped; a port without flow control has to count its own overruns.

#![no_std]
#![cfg_attr(
    not(test),
    deny(
        clippy::expect_used,
        clippy::indexing_slicing,
        clippy::panic,
        clippy::unreachable,
        clippy::unwrap_used
    )
)]

// `cargo kani` builds every crate of the workspace, and finds it in those with `no_std` only so.
#[cfg(kani)]
extern crate kani;

mod direction;
mod event;
mod key_store;
mod persistent_clock;
mod port;
mod pump;
pub mod sealed;

pub use direction::{ForwardMode, Forwarded, Signer, Verifier};
pub use event::{Counters, Direction, Event, RejectReason, RejectedPacket};
pub use key_store::{FlashKeyStore, KEYS_SIZE};
pub use persistent_clock::{
    FIRST_RESERVATION, PersistentClock, PersistentClockError, TimeBehindMark,
};
/// Where the relay takes the time from, and where it keeps its mark.
///
/// Without [`PersistentClock`], it must be shared with the peer as closely as the [`ReplayGuard`]'s window asks for.
pub use port::PortError;

use core::fmt;

use embedded_io::{Read, ReadReady, Write, WriteReady};
use mavlink_signing::{
    AntiReplay, KeyRing, LinkClock, Profile, RejectUnsigned, ReplayGuard, SetupSigning, Stamper,
    TICKS_PER_SECOND, Timestamp, UnsignedPolicy,
};
use pump::Pump;

/// Silence on a line after which a packet that has begun is given up, unless
/// [said otherwise](Relay::idle): 100 milliseconds, in ticks of 10 microseconds.
pub const IDLE: u64 = TICKS_PER_SECOND / 10;

/// The time of one end, to stamp and to judge by, and a timer to measure silence with.
///
/// Any `FnMut() -> Timestamp` is both, for a time that nobody sets, and so is a [`Timestamp`], which stands
/// still.
pub trait Clock: LinkClock {
    /// What a timer shows that nobody sets, in ticks of 10 microseconds: unlike the time, it does not leap
    /// when somebody tells it, or a frame does.
    fn timer(&mut self) -> u64;
}

impl<F: FnMut() -> Timestamp> Clock for F {
    fn timer(&mut self) -> u64 {
        self().ticks()
    }
}

impl Clock for Timestamp {
    fn timer(&mut self) -> u64 {
        self.ticks()
    }
}

/// A port that can be polled.
pub trait Port: Read + ReadReady + Write + WriteReady {}

impl<T: Read + ReadReady + Write + WriteReady> Port for T {}

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

/// What [`Relay::poll`] did in each direction: whether there is more to do, or which port failed.
///
/// A failure of one direction does not keep the other from its turn; the next poll tries again,
/// nothing that was read is lost.
#[derive(Debug)]
#[must_use = "a port may have failed"]
pub struct Polled<LocalError, LinkError> {
    /// From the local port to the link port.
    pub outbound: Result<bool, PortError<LocalError, LinkError>>,
    /// From the link port to the local port.
    pub inbound: Result<bool, PortError<LinkError, LocalError>>,
}

impl<LocalError, LinkError> Polled<LocalError, LinkError> {
    /// Whether to poll again at once.
    pub const fn moved(&self) -> bool {
        matches!(self.outbound, Ok(true)) || matches!(self.inbound, Ok(true))
    }
}

/// The in-line signer. See the [crate's documentation](crate).
///
/// `R` decides about order: [`ReplayGuard`] for one peer, [`StreamTable`](mavlink_signing::Streams) for several.
/// `U` says which unsigned frames go on to the local side all the same: none, unless asked.
pub struct Relay<P, R = ReplayGuard, U = RejectUnsigned> {
    link: Link<P>,
    outbound: Pump<Signer>,
    inbound: Pump<Verifier<R, U>>,
}

/// What both directions share.
struct Link<P> {
    keys: KeyRing<P>,
    idle: u64,
    link_id: u8,
}

impl<P, R, U> fmt::Debug for Relay<P, R, U> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Relay")
            .field("plain_to_secure", self.outbound.counters())
            .field("secure_to_plain", self.inbound.counters())
            .finish_non_exhaustive()
    }
}

impl<P: Profile, R: AntiReplay> Relay<P, R> {
    /// A relay that signs with `keys`, one key or the two of a change, and the stamps of `stamper`,
    /// verifies with `keys` and `receiver`, and hands verified frames on as `forward` says.
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
        Ok(Self {
            link: Link {
                keys: keys.into(),
                idle: IDLE,
                link_id,
            },
            outbound: Pump::new(Signer::new(stamper)),
            inbound: Pump::new(Verifier::new(receiver, forward)),
        })
    }

    /// The same relay, which also hands on to the local side what comes in unsigned and `policy`
    /// accepts. The policy is told the link id that the relay signs for, whatever the peers sign for.
    ///
    /// Unsigned it leaves, with [`ForwardMode::KeepSignature`] too: the local side cannot tell it from what was
    /// verified and stripped, and signs it if it sends it back.
    #[must_use]
    pub fn accepting<U: UnsignedPolicy>(self, policy: U) -> Relay<P, R, U> {
        let link_id = self.link.link_id;
        Relay {
            link: self.link,
            outbound: self.outbound,
            inbound: self
                .inbound
                .map(|verifier| verifier.accepting(link_id, policy)),
        }
    }
}

impl<P: Profile, R: AntiReplay, U: UnsignedPolicy> Relay<P, R, U> {
    /// The same relay with `ticks` of silence in place of [`IDLE`]: longer than any pause within a
    /// packet, such as a radio's slots make.
    #[must_use]
    pub const fn idle(mut self, ticks: u64) -> Self {
        self.link.idle = ticks;
        self
    }

    /// From now on keeps the last SETUP_SIGNING for this system and component that comes in on the local side,
    /// for [`Relay::take_setup`]. The local side must be one that nobody else can reach.
    pub fn keep_setup(&mut self, system_id: u8, component_id: u8) {
        let signer = self.outbound.handler_mut();
        signer.keep_setup(system_id, component_id);
    }

    /// The SETUP_SIGNING that came since it was last asked for. Nothing has been done about it:
    /// [`KeyRing::apply`] takes over its key, and [`PersistentClock::update`] its timestamp.
    pub fn take_setup(&mut self) -> Option<SetupSigning> {
        self.outbound.handler_mut().take_setup()
    }

    /// The keys of both directions, to be changed.
    pub const fn keys(&mut self) -> &mut KeyRing<P> {
        &mut self.link.keys
    }

    /// Takes one turn in each direction without waiting: sends what is left of the last frame; when
    /// all of it has left, looks at the next packet; when there is none, reads up to 64 bytes.
    ///
    /// `observe` sees what became of each packet, in order. Call it again at once while
    /// [`Polled::moved`]; otherwise when a port has become ready, and at least every
    /// [`IDLE`]; after an error of a port as after a turn in which it moved something. With a [`PersistentClock`] it waits
    /// for the flash: for a write now and then, and every 128 marks for an erase, tens of milliseconds in which
    /// some parts execute nothing.
    pub fn poll<Local: Port, Radio: Port>(
        &mut self,
        local: &mut Local,
        radio: &mut Radio,
        clock: &mut impl Clock,
        observe: &mut impl FnMut(Event),
    ) -> Polled<Local::Error, Radio::Error> {
        let Self {
            link,
            outbound,
            inbound,
        } = self;
        let signed = outbound.poll(local, radio, link, clock, observe);
        if let Some(frame) = outbound.unsent() {
            inbound.handler_mut().record_sent(frame);
        }
        Polled {
            outbound: signed,
            inbound: inbound.poll(radio, local, link, clock, observe),
        }
    }

    /// What has been signed and rejected on its way from the local to the link side.
    #[must_use]
    pub const fn outbound(&self) -> &Counters {
        self.outbound.counters()
    }

    /// What has been verified and rejected on its way from the link to the local side.
    #[must_use]
    pub const fn inbound(&self) -> &Counters {
        self.inbound.counters()
    }
}
