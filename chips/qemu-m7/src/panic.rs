//! What a panic does: it resets the board. The images that are deployed have none.

use core::panic::PanicInfo;

#[panic_handler]
fn panic(_info: &PanicInfo) -> ! {
    #[cfg(feature = "logging")]
    defmt::error!("{}", defmt::Display2Format(_info));
    cortex_m::peripheral::SCB::sys_reset()
}
