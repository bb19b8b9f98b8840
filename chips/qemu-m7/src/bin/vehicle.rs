//! The vehicle of a sealed link: UART 0 is the autopilot's, UART 1 the radio's.
//!
//! Each time the emulator is started the flash is new, and counters begin at 1: it needs new keys then.

#![no_std]
#![no_main]

use core::time::Duration;

use cortex_m_rt::entry;
use heapless::Vec;
use mavlink_commsec::AesGcm;
use mavlink_signing::{LinkClock, TICKS_PER_SECOND};
use mavseal_qemu_m7::{
    Board, COUNTERS, Flash, PAGE_SIZE, Runs, Uptime, exit, info, log_rejected, warn,
};
use mavseal_relay::sealed::{
    HighWaterMarks, MarksError, Place, Radio, SealedCounters, SealedEndpoint, SealedEvent,
    SealedRejectReason,
};
use mavseal_relay::{Direction, Endpoint, LineEvent, Side, adapter};
use mavseal_store::Region;

/// The vehicle's key, and those of the stations.
mod keys {
    include!(concat!(env!("OUT_DIR"), "/keys.rs"));
}
use keys::{OWN, PEERS};

/// How many stations there are.
const STATIONS: usize = PEERS.len();
const _: () = assert!(STATIONS < COUNTERS, "a flash for every counter");

/// How long a packet waits for others.
const MAX_DELAY: Duration = Duration::from_millis(50);
/// Time without news after which the counters are logged: 300 milliseconds.
const QUIET: u64 = TICKS_PER_SECOND * 3 / 10;
/// Erases of a page after which the flash is complained of, of the 10,000 that its data sheet allows.
const WORN: u32 = 8_000;
/// The system and component that tell of the radio: a vehicle's, and MAV_COMP_ID_TELEMETRY_RADIO.
const RADIO: Radio = Radio::Vehicle {
    system_id: 1,
    component_id: 68,
};
/// The whole of a flash.
const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE as u32,
};

type MarkPlace<'a> = Place<&'a mut Flash>;

/// Where the marks lie: one flash for each counter.
fn places(flashes: &mut [Flash; COUNTERS]) -> Option<(MarkPlace<'_>, [MarkPlace<'_>; STATIONS])> {
    let [sent, accepted @ ..] = flashes.each_mut().map(|flash| (flash, REGION));
    let accepted = accepted.into_iter().take(STATIONS);
    let accepted = accepted.collect::<Vec<_, STATIONS>>();
    Some((sent, accepted.into_array().ok()?))
}

/// The marks in the flashes. Blank ones are provisioned: this board is a new one at each start of the emulator, with
/// new keys. In the field that is a step of production, and no start does it.
fn marks(flashes: &mut [Flash; COUNTERS]) -> Option<HighWaterMarks<&mut Flash, STATIONS>> {
    let (sent, accepted) = places(flashes)?;
    let opened = HighWaterMarks::open::<AesGcm>(&OWN, &PEERS, sent, accepted);
    let is_new = opened.err() == Some(MarksError::NotProvisioned);
    let (sent, accepted) = places(flashes)?;
    let marks = if is_new {
        HighWaterMarks::provision::<AesGcm>(&OWN, &PEERS, sent, accepted)
    } else {
        HighWaterMarks::open::<AesGcm>(&OWN, &PEERS, sent, accepted)
    };
    marks
        .inspect_err(|error| {
            warn!("{}", error);
            let _ = error;
        })
        .ok()
}

#[entry]
fn main() -> ! {
    let Some(mut board) = Board::take() else {
        exit(1);
    };
    board.watchdog.feed();
    let Some(marks) = marks(&mut board.counters) else {
        warn!("The marks cannot be used");
        exit(1);
    };
    let end = SealedEndpoint::<_, STATIONS>::new(&OWN, &PEERS, marks, RADIO, MAX_DELAY);
    let Ok(mut end) = end else {
        warn!("The keys cannot be used");
        exit(1);
    };
    let [mut local, mut radio] = board.uarts;
    let mut uptime = Uptime::new(board.timer);

    info!(
        "Sealed link: sender {} goes on at {}",
        OWN.id.0,
        end.next_counter().unwrap_or_default()
    );
    for (station, last) in end.peers() {
        info!("Sender {} is heard above {}", station.0, last);
        let _ = (station, last);
    }
    let mut log = Log::default();
    // What is on the line may have begun before the start: nothing is heard before the line was silent.
    end.line_event(
        Side::Local,
        LineEvent::Overrun,
        &mut uptime,
        &mut observer(&mut log, 0),
    );
    loop {
        board.watchdog.feed();
        let now = uptime.monotonic();
        {
            let mut observe = observer(&mut log, now);
            let polled = adapter::poll(&mut end, &mut local, &mut radio, &mut uptime, &mut observe);
            if let Err(error) = &polled.outbound {
                warn!("autopilot to radio: {}", error);
                let _ = error;
                // Bytes are lost: what follows may lie within a payload.
                end.line_event(Side::Local, LineEvent::Overrun, &mut uptime, &mut observe);
            }
            if let Err(error) = &polled.inbound {
                warn!("radio to autopilot: {}", error);
                let _ = error;
                end.line_event(Side::Link, LineEvent::Overrun, &mut uptime, &mut observe);
            }
        }
        if log.is_quiet(now) {
            if end.erases() > WORN {
                warn!("The flash is wearing out: {} erases", end.erases());
            }
            log.opened_of();
            log_counters("sealed", end.sealed());
            log_counters("opened", end.opened());
        }
    }
}

/// Logs rejections, and the counters when the news have gone quiet.
#[derive(Default)]
struct Log {
    rejected: Runs<(Direction, SealedRejectReason)>,
    opened: [u32; STATIONS],
    news: Option<u64>,
}

/// One type for all places: each other would have the end in the image once more.
fn observer(log: &mut Log, now: u64) -> impl FnMut(SealedEvent) {
    move |event| log.event(event, now)
}

impl Log {
    fn event(&mut self, event: SealedEvent, now: u64) {
        self.news = Some(now);
        match event {
            SealedEvent::Rejected(direction, rejection) => {
                log_rejected(self.rejected.push((direction, rejection)));
            }
            SealedEvent::Opened(sender, _) => {
                let mut opened = PEERS.iter().zip(&mut self.opened);
                if let Some((_, count)) = opened.find(|(peer, _)| peer.id == sender) {
                    *count = count.saturating_add(1);
                }
            }
            _ => {}
        }
    }

    /// Whether the news have just gone quiet.
    fn is_quiet(&mut self, now: u64) -> bool {
        let quiet = self
            .news
            .is_some_and(|last| now.saturating_sub(last) > QUIET);
        if quiet {
            self.news = None;
            log_rejected(self.rejected.take());
        }
        quiet
    }

    fn opened_of(&self) {
        for (peer, count) in PEERS.iter().zip(&self.opened) {
            info!("opened of sender {}: {}", peer.id.0, count);
            let _ = (peer, count);
        }
    }
}

fn log_counters(done: &str, counters: &SealedCounters) {
    let rejected = counters
        .rejections()
        .fold(0_u32, |sum, (_, count)| sum.saturating_add(count));
    info!(
        "{}: {} packages, {} packets, rejected: {}, bytes of no packet: {}",
        done,
        counters.packages(),
        counters.packets(),
        rejected,
        counters.dropped()
    );
    let _ = (done, rejected);
}
