//! The in-line signer: UART 0 is the local side, UART 1 the link side.

#![no_std]
#![no_main]

use cortex_m_rt::entry;
use mavlink_signing::{
    KEY_SIZE, KeyChangeError, KeyRing, LinkClock, RolloverState, SigningKey, Stamper,
    TICKS_PER_SECOND, TimeSource, Timestamp,
};
use mavseal_qemu_m7::{Board, Flash, PAGE_SIZE, Runs, WallClock, exit, info, log_rejected, warn};
use mavseal_relay::{
    Counters, Direction, Endpoint, Event, FirstKey, ForwardMode, LineEvent, LinkFlash, LinkMemory,
    PersistentClock, Presence, RejectReason, Relay, Senders, Side, TimeError, adapter,
};
use mavseal_store::Region;

/// The link id of the frames that this end signs.
const LINK_OUT: u8 = 1;
/// Silence after which the counters are logged: one second.
const QUIET: u64 = TICKS_PER_SECOND;
/// Bytes a second that the link side carries at least: the machine that emulates this one may pause for longer than a
/// line does. The local side has no such bound, and is heard again after the [idle time](mavseal_relay::IDLE).
const LINK_RATE: u32 = 100;
/// How often the clock is told the time of day: well within what it believes a source for.
const HOUR: u64 = 3600 * TICKS_PER_SECOND;
/// The whole of a flash.
const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};
/// The clock, and the mark in flash.
type Memory<T> = PersistentClock<Flash, T>;

/// The system and component that SETUP_SIGNING names to give the relay a key: a vehicle's, and
/// MAV_COMP_ID_USER1.
const SYSTEM: u8 = 1;
const COMPONENT: u8 = 25;

/// With mavseal at both ends: its own profile, and one peer.
#[cfg(not(feature = "standard-signature"))]
mod peer {
    use mavlink_signing::{Hmac, KEY_SIZE, ReplayGuard, Window};
    use mavseal_qemu_m7::{DEMO_KEY, info};

    /// The link id of the frames that the peer signs.
    const LINK_IN: u8 = 2;

    pub(super) type Profile = Hmac;
    pub(super) type Receiver = ReplayGuard;

    pub(super) fn first_key() -> [u8; KEY_SIZE] {
        DEMO_KEY
    }

    pub(super) fn receiver() -> Receiver {
        info!(
            "In-line signer: signs on link {}, verifies link {}",
            super::LINK_OUT,
            LINK_IN
        );
        ReplayGuard::new(LINK_IN, Window::ONE_MINUTE)
    }
}

/// With MAVProxy and other ground stations: the standard's signature, a key that can be typed, and streams
/// for them and for what is behind the relay.
#[cfg(feature = "standard-signature")]
mod peer {
    use mavlink_signing::{KEY_SIZE, Links, Standard, StreamTable, Window, passphrase_key};
    use mavseal_qemu_m7::{DEMO_PASSPHRASE, info};

    pub(super) type Profile = Standard;
    pub(super) type Receiver = StreamTable<16>;

    pub(super) fn first_key() -> [u8; KEY_SIZE] {
        passphrase_key(DEMO_PASSPHRASE)
    }

    pub(super) fn receiver() -> Receiver {
        info!(
            "In-line signer: signs on link {}, verifies every link",
            super::LINK_OUT
        );
        StreamTable::new(Links::Any, Window::ONE_MINUTE)
    }
}

#[entry]
fn main() -> ! {
    let Some(mut board) = Board::take() else {
        exit(1);
    };
    board.watchdog.feed();
    let Some(mut wall) = WallClock::synced(board.timer) else {
        warn!("The relay needs a clock, and nobody tells the time");
        exit(1);
    };
    let [mark_a, mark_b, keys] = board.flashes;
    let flash = LinkFlash {
        keys,
        marks: [mark_a, mark_b],
        region: REGION,
    };
    let first_key = peer::first_key();
    // The timer of this board shows the time of day.
    let memory = LinkMemory::open(flash, FirstKey::Demonstration(&first_key), || {
        wall.now().ticks()
    });
    let (keys, mut store, mut kept) = match memory {
        Ok((keys, LinkMemory { store, clock })) => (keys, store, clock),
        Err(error) => {
            warn!("Keys and marks cannot be used: {}", error);
            let _ = error;
            exit(1);
        }
    };
    if is_published(&keys, &first_key) {
        warn!(
            "THE KEY IN USE IS THE DEMONSTRATION'S, WHICH EVERYBODY KNOWS: for demonstrations alone"
        );
    }
    if store.retired_key_remains() {
        warn!("A retired key can still be read from the flash: it is worn out");
    }
    let mut told = tell(&mut kept);
    let relay = Relay::new(
        keys,
        Stamper::new(LINK_OUT),
        peer::receiver(),
        ForwardMode::StripSignature,
    );
    let Ok(relay) = relay else {
        warn!("Both directions have the same link id");
        exit(1);
    };
    let mut relay = relay.line_rate(LINK_RATE).senders(Senders::System(SYSTEM));
    relay.keep_setup(SYSTEM, COMPONENT);
    let [mut local, mut link] = board.uarts;
    let mut log = Log::default();
    // What is on the line may have begun before the start: nothing is heard before the line was silent.
    relay.line_event(
        Side::Local,
        LineEvent::Overrun,
        &mut kept,
        &mut observer(&mut log),
    );
    // The board has neither jumper nor button: whoever switches it on may give it a key, before anything else comes.
    relay.set_presence(Presence::AtStart);

    loop {
        board.watchdog.feed();
        let moved = {
            let mut observe = observer(&mut log);
            let polled = adapter::poll(&mut relay, &mut local, &mut link, &mut kept, &mut observe);
            for (side, polled) in [
                (Side::Local, &polled.outbound),
                (Side::Link, &polled.inbound),
            ] {
                if let Err(error) = polled {
                    warn!("{}: {}", side, error);
                    let _ = error;
                    // Bytes are lost: what follows may lie within a payload.
                    relay.line_event(side, LineEvent::Overrun, &mut kept, &mut observe);
                }
            }
            polled.moved()
        };
        if let Some(setup) = relay.take_setup() {
            let applied = relay.apply_setup(&setup, &mut kept, &mut store);
            log_key("SETUP_SIGNING", applied);
            // The key in use once more: everybody has it now, and the one before may go.
            if applied.is_ok() && relay.keys().rollover_state() == RolloverState::Confirmed {
                log_key("Old key retired", relay.retire_key(&mut store));
                if store.retired_key_remains() {
                    warn!("The old key can still be read from the flash: it is worn out");
                }
            }
        }
        if relay.keys().confirm_pending() {
            log_key("New key heard", relay.confirm_key(&mut store));
        }
        if kept.monotonic().saturating_sub(told) > HOUR {
            told = tell(&mut kept);
        }
        log.turn(moved, kept.now(), &relay);
    }
}

/// Whether the key in use is the demonstration's.
fn is_published(keys: &KeyRing<peer::Profile>, published: &[u8; KEY_SIZE]) -> bool {
    let published = SigningKey::<peer::Profile>::new(published);
    published.is_ok_and(|key| key.fingerprint() == keys.signing().fingerprint())
}

/// Tells the clock the time of day; gives it.
fn tell<T: FnMut() -> u64>(kept: &mut Memory<T>) -> u64 {
    let ticks = kept.monotonic();
    if let Some(time) = Timestamp::from_ticks(ticks) {
        log_time(kept.update(TimeSource::Trusted, time));
    }
    ticks
}

/// Logs rejections, and the counters when the lines have gone quiet.
#[derive(Default)]
struct Log {
    rejected: Runs<(Direction, RejectReason)>,
    moved: Option<Timestamp>,
}

/// One type for all places: each other would have the relay in the image once more.
fn observer(log: &mut Log) -> impl FnMut(Event) {
    |event| log.event(event)
}

impl Log {
    fn event(&mut self, event: Event) {
        if let Event::Rejected(direction, rejection) = event {
            log_rejected(self.rejected.push((direction, rejection)));
        }
    }

    fn turn(&mut self, moved: bool, now: Timestamp, relay: &Relay<peer::Profile, peer::Receiver>) {
        if moved {
            self.moved = Some(now);
        } else if self.moved.is_some_and(|last| now.ticks_since(last) > QUIET) {
            self.moved = None;
            log_rejected(self.rejected.take());
            log_counters("signed", relay.outbound());
            log_counters("verified", relay.inbound());
        }
    }
}

fn log_key(what: &str, result: Result<(), KeyChangeError>) {
    match result {
        Ok(()) => info!("{}: done", what),
        Err(error) => {
            warn!("{}: {}", what, error);
            let _ = error;
        }
    }
    let _ = what;
}

fn log_time(result: Result<u64, TimeError>) {
    if let Err(error) = result {
        warn!("{}", error);
        let _ = error;
    }
}

fn log_counters(passed: &str, counters: &Counters) {
    let rejected = counters
        .rejections()
        .fold(0_u32, |sum, (_, count)| sum.saturating_add(count));
    info!(
        "{}: {}, rejected: {}, bytes of no packet: {}",
        passed,
        counters.passed(),
        rejected,
        counters.dropped()
    );
    let _ = (passed, rejected);
}
