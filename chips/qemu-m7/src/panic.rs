//! What a panic does. The images that are deployed have none.

use core::panic::PanicInfo;

#[cfg(feature = "logging")]
#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    defmt::error!("{}", defmt::Display2Format(info));
    semihosting::process::abort()
}

#[cfg(not(feature = "logging"))]
#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    cortex_m::asm::udf()
}
