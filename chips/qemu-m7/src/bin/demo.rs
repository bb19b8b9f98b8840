//! Signs a frame and verifies it: the smallest firmware that does both.

#![no_std]
#![no_main]

use core::ptr::read_volatile;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m_rt::entry;
use mavlink_signing::{
    Frame, FrameRef, Header, Hmac, MavLinkState, MessageId, Replay, SigningKey, Stamper, Timestamp,
    Window, sign_frame, verify_frame,
};
use mavseal_qemu_m7::{DEMO_KEY, exit, info, warn};

const LINK_ID: u8 = 1;
/// PING, and 3 bytes of payload.
const MESSAGE_ID: u8 = 4;

// Read volatile, so that nothing is computed when the image is built.
static KEY: [u8; 32] = DEMO_KEY;
static PAYLOAD: [u8; 3] = [1, 2, 3];
static NOW: u64 = 37_555_200_000_000;

static LINK: MavLinkState = MavLinkState::new(Replay::new(LINK_ID, Window::SEED));

/// What a debugger finds when the demonstration is over: 1 for success, 2 for failure.
#[used]
static VERDICT: AtomicU32 = AtomicU32::new(0);

#[entry]
fn main() -> ! {
    info!("MAVLink signing demo");
    let verdict = match run() {
        Some(()) => 1,
        None => 2,
    };
    VERDICT.store(verdict, Ordering::Relaxed);
    if cfg!(feature = "logging") {
        if verdict != 1 {
            warn!("The demonstration failed");
        }
        exit(i32::from(verdict != 1));
    }
    loop {
        cortex_m::asm::wfi();
    }
}

fn run() -> Option<()> {
    // SAFETY: they are statics, initialised and never written.
    let (key, payload, now) = unsafe {
        (
            read_volatile(&raw const KEY),
            read_volatile(&raw const PAYLOAD),
            read_volatile(&raw const NOW),
        )
    };
    let key = SigningKey::<Hmac>::new(&key).ok()?;
    let now = Timestamp::from_ticks(now)?;
    let header = Header {
        compat_flags: 0,
        sequence: 0,
        system_id: 1,
        component_id: 1,
        message_id: MessageId::from(MESSAGE_ID),
    };

    let mut frame = Frame::new(header, &payload).ok()?;
    let stamp = Stamper::new(LINK_ID).stamp(now).ok()?;
    sign_frame(&mut frame, &key, stamp).ok()?;
    info!("Frame signed");

    let received = FrameRef::parse(frame.as_bytes()).ok()?;
    let verified = verify_frame(received, &key, now, &LINK).ok()?;
    if verified.payload() != payload {
        return None;
    }
    info!("Verification passed");
    Some(())
}
