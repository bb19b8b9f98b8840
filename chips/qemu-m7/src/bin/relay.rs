//! The in-line signer: UART 0 is the plain side, UART 1 the secure side.

#![no_std]
#![no_main]

use cortex_m_rt::entry;
use mavlink_signing::{Stamper, TICKS_PER_SECOND, Timestamp};
use mavseal_qemu_m7::{Board, Overrun, WallClock, exit, info, warn};
use mavseal_relay::{Clock, Counters, Direction, Event, Forward, PortError, Refusal, Relay};

/// The link id of the frames that this end signs.
const LINK_OUT: u8 = 1;
/// Silence after which the counters are logged: one second.
const QUIET: u64 = TICKS_PER_SECOND;

/// With mavseal at both ends: its own profile, one peer, and a clock that both share.
#[cfg(not(feature = "standard-signature"))]
mod peer {
    use mavlink_signing::{Hmac, KeyError, Replay, SigningKey, Window};
    use mavseal_qemu_m7::{DEMO_KEY, info};

    /// The link id of the frames that the peer signs.
    const LINK_IN: u8 = 2;

    pub(super) type Profile = Hmac;
    pub(super) type Receiver = Replay;

    pub(super) fn key() -> Result<SigningKey<Profile>, KeyError> {
        SigningKey::new(&DEMO_KEY)
    }

    pub(super) fn receiver() -> Receiver {
        info!(
            "In-line signer: signs on link {}, verifies link {}",
            super::LINK_OUT,
            LINK_IN
        );
        Replay::new(LINK_IN, Window::SEED)
    }
}

/// With MAVProxy and other ground stations: the standard's signature, a key that can be typed, streams
/// for them and for what is behind the relay, and the minute that the MAVLink guide gives a sender
/// ("Message Signing", Timestamp Handling), either way.
#[cfg(feature = "standard-signature")]
mod peer {
    use mavlink_signing::{
        KeyError, Links, SigningKey, Standard, Streams, TICKS_PER_SECOND, Window,
    };
    use mavseal_qemu_m7::{DEMO_PASSPHRASE, info};

    pub(super) type Profile = Standard;
    pub(super) type Receiver = Streams<16>;

    const MINUTE: u64 = 60 * TICKS_PER_SECOND;
    const WINDOW: Window = Window {
        past: MINUTE,
        ahead: MINUTE,
    };

    pub(super) fn key() -> Result<SigningKey<Profile>, KeyError> {
        SigningKey::from_passphrase(DEMO_PASSPHRASE)
    }

    pub(super) fn receiver() -> Receiver {
        info!(
            "In-line signer: signs on link {}, verifies every link",
            super::LINK_OUT
        );
        Streams::new(Links::Any, WINDOW)
    }
}

#[entry]
fn main() -> ! {
    let Some(board) = Board::take() else {
        exit(1);
    };
    let Some(mut clock) = WallClock::synced(board.timer) else {
        warn!("The relay needs a clock, and nobody tells the time");
        exit(1);
    };
    let Ok(key) = peer::key() else {
        warn!("The key cannot be used");
        exit(1);
    };
    let stamper = Stamper::new(LINK_OUT);
    let Ok(mut relay) = Relay::new(key, stamper, peer::receiver(), Forward::Stripped) else {
        warn!("Both directions have the same link id");
        exit(1);
    };
    let [mut plain, mut secure] = board.uarts;

    let mut log = Log::default();
    loop {
        let mut observe = |event| log.event(event);
        let polled = relay.poll(&mut plain, &mut secure, &mut clock, &mut observe);
        if let Err(error) = &polled.plain_to_secure {
            log_port(Direction::PlainToSecure, error);
        }
        if let Err(error) = &polled.secure_to_plain {
            log_port(Direction::SecureToPlain, error);
        }
        log.turn(polled.moved(), clock.now(), &relay);
    }
}

/// Logs refusals, equal ones in a row as one line, and the counters when the lines have gone quiet.
///
/// A line takes longer than a frame: one for each would let whoever floods one direction stall the
/// other.
#[derive(Default)]
struct Log {
    refused: Option<(Direction, Refusal, u32)>,
    moved: Option<Timestamp>,
}

impl Log {
    fn event(&mut self, event: Event) {
        let Event::Refused(direction, refusal) = event else {
            return;
        };
        match &mut self.refused {
            Some((last_direction, last_refusal, times))
                if (*last_direction, *last_refusal) == (direction, refusal) =>
            {
                *times = times.saturating_add(1);
            }
            _ => {
                self.flush();
                self.refused = Some((direction, refusal, 1));
            }
        }
    }

    fn flush(&mut self) {
        if let Some((direction, refusal, times)) = self.refused.take() {
            info!(
                "{} refused: {}, {} times",
                direction,
                refusal.as_str(),
                times
            );
            let _ = (direction, refusal, times);
        }
    }

    fn turn(&mut self, moved: bool, now: Timestamp, relay: &Relay<peer::Profile, peer::Receiver>) {
        if moved {
            self.moved = Some(now);
        } else if self.moved.is_some_and(|last| now.ticks_since(last) > QUIET) {
            self.moved = None;
            self.flush();
            log_counters("signed", relay.plain_to_secure());
            log_counters("verified", relay.secure_to_plain());
        }
    }
}

fn log_port(direction: Direction, error: &PortError<Overrun, Overrun>) {
    warn!("{}: {}", direction, error);
    let _ = (direction, error);
}

fn log_counters(passed: &str, counters: &Counters) {
    let refused = counters
        .refusals()
        .fold(0_u32, |sum, (_, count)| sum.saturating_add(count));
    info!(
        "{}: {}, refused: {}, bytes of no packet: {}",
        passed,
        counters.passed(),
        refused,
        counters.dropped()
    );
    let _ = (passed, refused);
}
