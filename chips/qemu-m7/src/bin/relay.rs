//! The in-line signer: UART 0 is the plain side, UART 1 the secure side.

#![no_std]
#![no_main]

use cortex_m_rt::entry;
use mavlink_signing::{Hmac, Replay, SigningKey, Stamper, TICKS_PER_SECOND, Timestamp, Window};
use mavseal_qemu_m7::{Board, DEMO_KEY, Overrun, WallClock, exit, info, warn};
use mavseal_relay::{Clock, Counters, Direction, Event, Forward, PortError, Refusal, Relay};

/// The link id of the frames that this end signs.
const LINK_OUT: u8 = 1;
/// The link id of the frames that the peer signs.
const LINK_IN: u8 = 2;
/// Silence after which the counters are logged: one second.
const QUIET: u64 = TICKS_PER_SECOND;

#[entry]
fn main() -> ! {
    let Some(board) = Board::take() else {
        exit(1);
    };
    let Some(mut clock) = WallClock::synced(board.timer) else {
        warn!("The relay needs a clock, and nobody tells the time");
        exit(1);
    };
    let Ok(key) = SigningKey::<Hmac>::new(&DEMO_KEY) else {
        warn!("The key cannot be used");
        exit(1);
    };
    let replay = Replay::new(LINK_IN, Window::SEED);
    let Ok(mut relay) = Relay::new(key, Stamper::new(LINK_OUT), replay, Forward::Stripped) else {
        warn!("Both directions have the same link id");
        exit(1);
    };
    let [mut plain, mut secure] = board.uarts;
    info!(
        "In-line signer: signs on link {}, verifies link {}",
        LINK_OUT, LINK_IN
    );

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

    fn turn(&mut self, moved: bool, now: Timestamp, relay: &Relay<Hmac>) {
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
