//! Hands the linker its scripts.

fn main() {
    if std::env::var("TARGET").as_deref() != Ok("thumbv6m-none-eabi") {
        println!(
            "cargo::error=the STM32C092RC is a Cortex-M0+: call cargo in chips/stm32c092rc, or with --target \
             thumbv6m-none-eabi"
        );
    }
    println!("cargo:rustc-link-search={}", env!("CARGO_MANIFEST_DIR"));
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rerun-if-changed=device.x");
    println!("cargo:rustc-link-arg-bins=-Tlink.x");
    if std::env::var_os("CARGO_FEATURE_LOGGING").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
}
