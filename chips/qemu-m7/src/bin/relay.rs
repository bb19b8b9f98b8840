//! The in-line signer: UART 0 is the plain side, UART 1 the secure side.

#![no_std]
#![no_main]

use cortex_m_rt::entry;
use mavlink_signing::{Hmac, Replay, SigningKey, Stamper, TICKS_PER_SECOND, Timestamp, Window};
use mavseal_qemu_m7::{DEMO_KEY, Overrun, WallClock, exit, info, uarts, warn};
use mavseal_relay::{Clock, Counters, Direction, Event, Forward, PortError, Refusal, Relay};

/// The link id of the frames that this end signs.
const LINK_OUT: u8 = 1;
/// The link id of the frames that the peer signs.
const LINK_IN: u8 = 2;
/// Silence after which the counters are logged: one second.
const QUIET: u64 = TICKS_PER_SECOND;

#[entry]
fn main() -> ! {
    let Some(mut clock) = WallClock::synced() else {
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
    let [mut plain, mut secure] = uarts();
    info!(
        "In-line signer: signs on link {}, verifies link {}",
        LINK_OUT, LINK_IN
    );

    let mut report = Report { last: None };
    loop {
        let polled = relay.poll(&mut plain, &mut secure, &mut clock, &mut log_refusal);
        if let Err(error) = &polled.plain_to_secure {
            log_port(Direction::PlainToSecure, error);
        }
        if let Err(error) = &polled.secure_to_plain {
            log_port(Direction::SecureToPlain, error);
        }
        report.update(polled.moved(), clock.now(), &relay);
    }
}

fn log_refusal(event: Event) {
    if let Event::Refused(direction, refusal) = event {
        info!("{} refused: {}", direction, refusal.as_str());
        let _ = (direction, refusal);
    }
}

fn log_port(direction: Direction, error: &PortError<Overrun, Overrun>) {
    warn!("{}: {}", direction, error);
    let _ = (direction, error);
}

/// Logs the counters whenever the line has gone quiet.
struct Report {
    last: Option<Timestamp>,
}

impl Report {
    fn update(&mut self, moved: bool, now: Timestamp, relay: &Relay<Hmac>) {
        if moved {
            self.last = Some(now);
        } else if self.last.is_some_and(|last| now.ticks_since(last) > QUIET) {
            self.last = None;
            log_counters("signed", relay.plain_to_secure());
            log_counters("verified", relay.secure_to_plain());
        }
    }
}

fn log_counters(passed: &str, counters: &Counters) {
    info!("{}: {}", passed, counters.passed());
    for (refusal, count) in counters.refusals() {
        if count > 0 {
            info!("refused, {}: {}", refusal.as_str(), count);
        }
        let _: (Refusal, u32) = (refusal, count);
    }
    let _ = passed;
}
