//! The interrupt vectors: the firmware polls and enables no interrupt.

unsafe extern "C" {
    fn DefaultHandler();
}

/// One vector, the fewest that cortex-m-rt links; its own default table of 240 takes 960 bytes.
// SAFETY: the name and the section are those that cortex-m-rt's linker script looks for.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [unsafe extern "C" fn(); 1] = [DefaultHandler];
