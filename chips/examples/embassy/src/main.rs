//! The in-line signer as an embassy task on an STM32C092RC: USART 1 is the local side, USART 2 the link side.
//!
//! The local side must report what the line loses. embassy's `BufferedUart` does not: it drops bytes without an error
//! when its buffer is full or the hardware overruns. The ring-buffered receiver reports all of it.

#![no_std]
#![no_main]

use core::cell::RefCell;
use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use embassy_embedded_hal::flash::partition::BlockingPartition;
use embassy_executor::Spawner;
use embassy_stm32::{
    bind_interrupts, dma,
    flash::Flash,
    mode::Async,
    peripherals::{DMA1_CH1, DMA1_CH2, DMA1_CH3, DMA1_CH4, IWDG, USART1, USART2},
    usart::{self, Config, RingBufferedUartRx, Uart, UartTx},
    wdg::IndependentWatchdog,
};
use embassy_sync::blocking_mutex::{Mutex, raw::NoopRawMutex};
use embassy_time::{Instant, Timer};
use mavlink_signing::{KeyRing, Links, Stamper, Standard, StreamTable, Window, passphrase_key};
use mavseal_relay::{
    Endpoint, FirstKey, ForwardMode, LineEvent, LinkFlash, LinkMemory, Relay, Side,
    adapter::embedded_io_async::{Line, run},
};
use mavseal_store::Region;

bind_interrupts!(struct Interrupts {
    USART1 => usart::InterruptHandler<USART1>;
    USART2 => usart::InterruptHandler<USART2>;
    DMA1_CHANNEL1 => dma::InterruptHandler<DMA1_CH1>;
    DMA1_CHANNEL2_3 => dma::InterruptHandler<DMA1_CH2>, dma::InterruptHandler<DMA1_CH3>;
    DMAMUX1_DMA1_CH4_5_6_7 => dma::InterruptHandler<DMA1_CH4>;
});

/// The demonstration's pass-phrase, which everybody knows: a board in use has a key of its own.
const PASSPHRASE: &str = include_str!("../../../demo/demo.passphrase");
/// The link id of what this board signs.
const LINK_OUT: u8 = 1;
/// Where keys and marks are: three times two pages, the last of 256 KiB of flash. Their place stays the same for good.
const FIRST: u32 = 244 * 1024;
const PAGE_SIZE: u32 = 2048;
const REGION: Region = Region {
    start: 0,
    page_size: PAGE_SIZE,
};
/// Bytes that may wait for the task: 22 milliseconds of the line at 115,200 baud.
const RING: usize = 256;
const MICROS_PER_TICK: u64 = 10;
/// Microseconds after which a board that hangs is reset.
const TIMEOUT: u32 = 8_000_000;

#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    SCB::sys_reset()
}

#[embassy_executor::task]
async fn feed(mut watchdog: IndependentWatchdog<'static, IWDG>) {
    watchdog.unleash();
    loop {
        watchdog.pet();
        Timer::after_secs(1).await;
    }
}

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let board = embassy_stm32::init(Default::default());
    spawner.spawn(feed(IndependentWatchdog::new(board.IWDG, TIMEOUT)).expect("spawned once"));
    let uarts = (
        Uart::new(
            board.USART1,
            board.PA10,
            board.PA9,
            board.DMA1_CH1,
            board.DMA1_CH2,
            Interrupts,
            Config::default(),
        ),
        Uart::new(
            board.USART2,
            board.PA3,
            board.PA2,
            board.DMA1_CH3,
            board.DMA1_CH4,
            Interrupts,
            Config::default(),
        ),
    );
    let (Ok(local), Ok(link)) = uarts else {
        panic!("115,200 baud");
    };
    let (mut local_ring, mut link_ring) = ([0; RING], [0; RING]);

    let flash = Mutex::<NoopRawMutex, _>::new(RefCell::new(Flash::new_blocking(board.FLASH)));
    let part =
        |index: u32| BlockingPartition::new(&flash, FIRST + index * 2 * PAGE_SIZE, 2 * PAGE_SIZE);
    let flash = LinkFlash {
        keys: part(0),
        marks: [part(1), part(2)],
        region: REGION,
    };
    // A board in use takes `FirstKey::None`, and is given a key of its own: `LinkMemory::provision`.
    let key = passphrase_key(PASSPHRASE.trim_end());
    let memory = LinkMemory::open(flash, FirstKey::Demonstration(&key), ticks);
    let (keys, memory): (KeyRing<Standard>, _) = memory.expect("keys and marks");
    let mut clock = memory.clock;
    let streams = StreamTable::<4>::new(Links::Any, Window::ONE_MINUTE);
    let stamper = Stamper::new(LINK_OUT);
    let relay = Relay::new(keys, stamper, streams, ForwardMode::StripSignature);
    let mut relay = relay.expect("streams remember what is sent");
    // What is on the line may have begun before the start: nothing is heard before the line was silent.
    relay.line_event(Side::Local, LineEvent::Overrun, &mut clock, &mut |_| {});

    let wait_until = async |ticks: u64| {
        Timer::at(Instant::from_micros(ticks * MICROS_PER_TICK)).await;
    };
    // No fault of these UARTs is a closed line, so this ends only if writing by DMA fails.
    run(
        &mut relay,
        line(local, &mut local_ring),
        line(link, &mut link_ring),
        &mut clock,
        wait_until,
        &mut |_| {},
    )
    .await;
}

/// Ticks of 10 microseconds since the start.
fn ticks() -> u64 {
    Instant::now().as_micros() / MICROS_PER_TICK
}

fn line<'d>(
    uart: Uart<'d, Async>,
    ring: &'d mut [u8],
) -> Line<RingBufferedUartRx<'d>, UartTx<'d, Async>> {
    let (writer, reader) = uart.split();
    Line {
        reader: reader.into_ring_buffered(ring),
        writer,
        fault: |error| match error {
            usart::Error::Framing => LineEvent::FramingError,
            usart::Error::Noise | usart::Error::Parity => LineEvent::Noise,
            _ => LineEvent::Overrun,
        },
    }
}
