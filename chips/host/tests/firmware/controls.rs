//! The checks can fail: images that do wrong are found out.

use anyhow::Result;
use mavseal_chips_host::{Chip, Image};

use crate::{demo, elf::Elf};

#[test]
fn an_image_that_logs_and_panics_is_found_out() -> Result<()> {
    let image = Image {
        features: "ardupilotmega,logging",
        ..Image::shipped(Chip::QemuM7, "relay", "")
    };
    let complaints = Elf::read(&image.build()?)?.complaints;
    for what in ["logs: ", "can panic: "] {
        let found = complaints.iter().find(|text| text.starts_with(what));
        println!("found out: {}", found.expect(what));
    }
    Ok(())
}

#[test]
fn an_image_that_hashes_wrongly_is_found_out() -> Result<()> {
    for chip in Chip::ALL {
        let image = Image::shipped(chip, "demo", "minimal");
        let mut elf = Elf::read(&image.build()?)?;
        elf.flash_mut("sha2::consts::K32")?[0] ^= 1;
        let error = demo::measure(&image, &elf).err();
        println!("found out: {:#}", error.expect("a wrong hash"));
    }
    Ok(())
}
