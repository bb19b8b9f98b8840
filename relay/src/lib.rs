//! The in-line signer: it sits between equipment that cannot sign and a radio.
//!
//! ```text
//! plain side            signed with the key, on one link id            secure side
//! (autopilot, UART)  ------------------------------------------>  (radio, network)
//!                    <------------------------------------------
//!                    only verified frames
//! ```
//!
//! * Plain to secure: a frame is signed only if its own checksum is right. Bad checksums, unknown
//!   messages, MAVLink 1 and frames that are already signed are refused and counted. The payload of a
//!   refused packet is not searched for packets, so that bytes that somebody else put there are not
//!   signed: [`Resync::AnnouncedEnd`](mavlink_signing::Resync), also for what that does not do on a line
//!   that loses bytes.
//! * Secure to plain: only verified frames leave, without signature or whole, and unsigned ones that a
//!   [policy](Relay::accepting) accepts, if there is one. Everything else is refused and counted by reason.
//!   The relay signs nothing that came in on the secure side; where the plain side may send back what it
//!   receives, hand frames on [whole](Forward::Whole), so that they are refused as already signed.
//! * SETUP_SIGNING, which carries a key, passes in neither direction. What comes for the relay itself on the
//!   plain side, a cable, it [takes](Relay::take_setup) if it is told to: [`Relay::keep_setup`].
//!
//! [`sealed`] is the end of a sealed link, over the same ports.
//!
//! # Over a restart
//!
//! With a [`Kept`] as its clock, no stamp is used again and no frame accepted again after the power failed,
//! wherever it did. [`KeySlots`] keep the key, and both keys while it is changed. What each choice costs:
//!
//! | choice | price |
//! |---|---|
//! | the mark is up to 10 s ahead of what is used | after a restart, frames are refused for up to 10 s |
//! | it is stored every 10 s, at first more often | flash: see `mavseal-store`, Wear; a [`Relay::poll`] takes as long as a write, or an erase |
//! | the keys are stored again at each start | flash: 80 bytes |
//! | a board without a clock keeps within 10 s of what it hears | its frames may be refused for so much longer |
//! | it accepts whatever is newer than all before | it has no window: it cannot tell how late a frame is, nor that a recording is one which it never heard |
//! | it goes up to 365 days ahead with a frame | a peer with a wrong clock takes it along so far; off for longer, it is deaf until it is told the time |
//! | a trusted clock is asked at least every 8 h | otherwise the board is one without a clock |
//! | GNSS and SYSTEM_TIME move a clock by a second at most, until a trusted source sets it | a board with these alone is one without a clock |
//! | a trusted clock more than 70 s behind the mark is not believed | a board that ran ahead, or was taken along, is one without a clock until that time has come |
//! | what cannot be remembered is refused | with a worn-out flash the link ends: [`Refusal::NotStored`] |
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
//! SETUP_SIGNING on the plain side, once at each end: the end that it is told to signs with it from then on, and
//! accepts both keys; [`Keys::offer`] is for the end that sends it. When an end has heard the new key,
//! [`Keys::confirm`] is due. Then the old one can be [retired](Keys::retire): the firmware in `chips/qemu-m7` does
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
//! * The time told is not believed ([`BehindMark`]): the same.
//! * `bad tag`: another key. SETUP_SIGNING on the plain side with a key that the other end has; the key in
//!   use before is accepted as well until it is retired. While another change is under way
//!   ([`Phase`](mavlink_signing::Phase), [`UnderWay`](mavlink_signing::KeyChangeError::UnderWay)) a third key is
//!   refused: end that one first, or take it back with the old key, as long as the other end has not retired
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
mod kept;
mod port;
mod pump;
pub mod sealed;
mod slots;

pub use direction::{Forward, Handed, Signer, Verifier};
pub use event::{Counters, Direction, Event, Offender, Refusal};
pub use kept::{BehindMark, FIRST_RESERVATION, Kept, KeptError};
/// Where the relay takes the time from, and where it keeps its mark.
///
/// Without [`Kept`], it must be shared with the peer as closely as the [`Replay`]'s window asks for.
pub use port::PortError;
pub use slots::{KEYS_SIZE, KeySlots};

use core::fmt;

use embedded_io::{Read, ReadReady, Write, WriteReady};
use mavlink_signing::{
    Admit, Keys, Profile, Refuse, Replay, SetupSigning, Stamper, TICKS_PER_SECOND, Timekeeper,
    Timestamp, UnsignedPolicy,
};
use pump::Pump;

/// Silence on a line after which a packet that has begun is given up, unless
/// [said otherwise](Relay::idle): 100 milliseconds, in ticks of 10 microseconds.
pub const IDLE: u64 = TICKS_PER_SECOND / 10;

/// The time of one end, to stamp and to judge by, and a timer to measure silence with.
///
/// Any `FnMut() -> Timestamp` is both, for a time that nobody sets, and so is a [`Timestamp`], which stands
/// still.
pub trait Clock: Timekeeper {
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
pub struct Polled<PlainError, SecureError> {
    /// From the plain port to the secure port.
    pub plain_to_secure: Result<bool, PortError<PlainError, SecureError>>,
    /// From the secure port to the plain port.
    pub secure_to_plain: Result<bool, PortError<SecureError, PlainError>>,
}

impl<PlainError, SecureError> Polled<PlainError, SecureError> {
    /// Whether to poll again at once.
    pub const fn moved(&self) -> bool {
        matches!(self.plain_to_secure, Ok(true)) || matches!(self.secure_to_plain, Ok(true))
    }
}

/// The in-line signer. See the [crate's documentation](crate).
///
/// `R` decides about order: [`Replay`] for one peer, [`Streams`](mavlink_signing::Streams) for several.
/// `U` says which unsigned frames go on to the plain side all the same: none, unless asked.
pub struct Relay<P, R = Replay, U = Refuse> {
    link: Link<P>,
    plain_to_secure: Pump<Signer>,
    secure_to_plain: Pump<Verifier<R, U>>,
}

/// What both directions share.
struct Link<P> {
    keys: Keys<P>,
    idle: u64,
    link_id: u8,
}

impl<P, R, U> fmt::Debug for Relay<P, R, U> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Relay")
            .field("plain_to_secure", self.plain_to_secure.counters())
            .field("secure_to_plain", self.secure_to_plain.counters())
            .finish_non_exhaustive()
    }
}

impl<P: Profile, R: Admit> Relay<P, R> {
    /// A relay that signs with `keys`, one key or the two of a change, and the stamps of `stamper`,
    /// verifies with `keys` and `receiver`, and hands verified frames on as `forward` says.
    ///
    /// # Errors
    ///
    /// [`SameLinkId`] if `receiver` would take frames that were signed here for frames of the peer.
    pub fn new(
        keys: impl Into<Keys<P>>,
        stamper: Stamper,
        receiver: R,
        forward: Forward,
    ) -> Result<Self, SameLinkId> {
        let link_id = stamper.link_id();
        if !receiver.refuses_own(link_id) {
            return Err(SameLinkId(link_id));
        }
        Ok(Self {
            link: Link {
                keys: keys.into(),
                idle: IDLE,
                link_id,
            },
            plain_to_secure: Pump::new(Signer::new(stamper)),
            secure_to_plain: Pump::new(Verifier::new(receiver, forward)),
        })
    }

    /// The same relay, which also hands on to the plain side what comes in unsigned and `policy`
    /// accepts. The policy is told the link id that the relay signs for, whatever the peers sign for.
    ///
    /// Unsigned it leaves, with [`Forward::Whole`] too: the plain side cannot tell it from what was
    /// verified and stripped, and signs it if it sends it back.
    #[must_use]
    pub fn accepting<U: UnsignedPolicy>(self, policy: U) -> Relay<P, R, U> {
        let link_id = self.link.link_id;
        Relay {
            link: self.link,
            plain_to_secure: self.plain_to_secure,
            secure_to_plain: self
                .secure_to_plain
                .map(|verifier| verifier.accepting(link_id, policy)),
        }
    }
}

impl<P: Profile, R: Admit, U: UnsignedPolicy> Relay<P, R, U> {
    /// The same relay with `ticks` of silence in place of [`IDLE`]: longer than any pause within a
    /// packet, such as a radio's slots make.
    #[must_use]
    pub const fn idle(mut self, ticks: u64) -> Self {
        self.link.idle = ticks;
        self
    }

    /// From now on keeps the last SETUP_SIGNING for this system and component that comes in on the plain side,
    /// for [`Relay::take_setup`]. The plain side must be one that nobody else can reach.
    pub fn keep_setup(&mut self, system_id: u8, component_id: u8) {
        let signer = self.plain_to_secure.treat_mut();
        signer.keep_setup(system_id, component_id);
    }

    /// The SETUP_SIGNING that came since it was last asked for. Nothing has been done about it:
    /// [`Keys::apply`] takes over its key, and [`Kept::tell`] its timestamp.
    pub fn take_setup(&mut self) -> Option<SetupSigning> {
        self.plain_to_secure.treat_mut().take_setup()
    }

    /// The keys of both directions, to be changed.
    pub const fn keys(&mut self) -> &mut Keys<P> {
        &mut self.link.keys
    }

    /// Takes one turn in each direction without waiting: sends what is left of the last frame; when
    /// all of it has left, looks at the next packet; when there is none, reads up to 64 bytes.
    ///
    /// `observe` sees what became of each packet, in order. Call it again at once while
    /// [`Polled::moved`]; otherwise when a port has become ready, and at least every
    /// [`IDLE`]; after an error of a port as after a turn in which it moved something. With a [`Kept`] it waits
    /// for the flash: for a write now and then, and every 128 marks for an erase, tens of milliseconds in which
    /// some parts execute nothing.
    pub fn poll<Plain: Port, Secure: Port>(
        &mut self,
        plain: &mut Plain,
        secure: &mut Secure,
        clock: &mut impl Clock,
        observe: &mut impl FnMut(Event),
    ) -> Polled<Plain::Error, Secure::Error> {
        let Self {
            link,
            plain_to_secure,
            secure_to_plain,
        } = self;
        let signed = plain_to_secure.poll(plain, secure, link, clock, observe);
        if let Some(frame) = plain_to_secure.unsent() {
            secure_to_plain.treat_mut().sent(frame);
        }
        Polled {
            plain_to_secure: signed,
            secure_to_plain: secure_to_plain.poll(secure, plain, link, clock, observe),
        }
    }

    /// What has been signed and refused on its way from the plain to the secure side.
    #[must_use]
    pub const fn plain_to_secure(&self) -> &Counters {
        self.plain_to_secure.counters()
    }

    /// What has been verified and refused on its way from the secure to the plain side.
    #[must_use]
    pub const fn secure_to_plain(&self) -> &Counters {
        self.secure_to_plain.counters()
    }
}
