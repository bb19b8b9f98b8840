//! The in-line signer between two TCP connections: an autopilot, or its simulator, and a ground station that signs.
//!
//! `cargo run -p mavseal-relay --features std --example tcp 127.0.0.1:5760 127.0.0.1:14550 "a pass-phrase"` connects to the autopilot and listens for
//! the station.

use std::{
    env,
    error::Error,
    io,
    net::{TcpListener, TcpStream},
    thread,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use mavlink_signing::{
    Links, SigningKey, Stamper, Standard, StreamTable, Timestamp, Window, passphrase_key,
};
use mavseal_relay::{
    ForwardMode, Relay,
    adapter::{self, NonBlocking, PortError},
};

/// The link id of what the relay signs.
const LINK_OUT: u8 = 1;
/// How long to wait when nothing has moved.
const PAUSE: Duration = Duration::from_millis(1);

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = env::args().skip(1);
    let mut next = || arguments.next().ok_or("three arguments: see the source");
    let local = TcpStream::connect(next()?)?;
    let (link, station) = TcpListener::bind(next()?)?.accept()?;
    println!("{station} is connected");
    let key = SigningKey::new(&passphrase_key(&next()?))?;
    Ok(run(local, link, key)?)
}

/// Signs what comes from `local` and verifies what comes from `link` until one of them ends.
///
/// Nothing is remembered over a restart: see `PersistentClock`.
///
/// # Errors
///
/// If a connection fails.
pub fn run(local: TcpStream, link: TcpStream, key: SigningKey<Standard>) -> io::Result<()> {
    let streams = StreamTable::<16>::new(Links::Any, Window::ONE_MINUTE);
    let stamper = Stamper::new(LINK_OUT);
    let relay = Relay::new(key, stamper, streams, ForwardMode::StripSignature);
    let mut relay = relay.map_err(io::Error::other)?;
    local.set_nonblocking(true)?;
    link.set_nonblocking(true)?;
    let (mut local, mut link) = (NonBlocking::new(local), NonBlocking::new(link));
    let mut clock = clock();
    loop {
        let polled = adapter::poll(
            &mut relay,
            &mut local,
            &mut link,
            &mut clock,
            &mut |event| {
                println!("{event:?}");
            },
        );
        let moved = polled.moved();
        for failed in [polled.outbound.err(), polled.inbound.err()] {
            match failed {
                None => {}
                Some(PortError::InputClosed | PortError::OutputClosed) => return Ok(()),
                Some(PortError::Input(error) | PortError::Output(error)) => return Err(error),
            }
        }
        if !moved {
            thread::sleep(PAUSE);
        }
    }
}

/// The time of day, by a clock that nobody sets while this runs.
fn clock() -> impl FnMut() -> Timestamp {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    let micros = since.map_or(0, |since| since.as_micros() as u64);
    let begin = Timestamp::from_unix_micros(micros).unwrap_or(Timestamp::ZERO);
    let began = Instant::now();
    move || begin.saturating_add(began.elapsed().as_micros() as u64 / 10)
}
