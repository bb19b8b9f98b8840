//! Whether the time of a rejection tells how much of a forged tag is right: compares the instructions
//! that the image executes.

use anyhow::{Context, Result, ensure};
use mavseal_chips_host::{Chip, Image};

use crate::{budgets, elf::Elf, emulator::Machine};

const TAG_SIZE: usize = 6;
/// The frame that is rejected, as the image has it: with 3 bytes of payload.
const FRAME_SIZE: usize = 10 + 3 + 15;

/// The shipped demonstrations execute the same instructions for every wrong tag of some.
#[test]
fn some_wrong_tags_are_rejected_in_constant_time() -> Result<()> {
    all_images(&[0x01, 0x80, 0xFF])
}

/// The same for every value of every byte of a tag: 3,060 wrong tags for each image.
#[test]
#[ignore = "minutes of emulation; `cargo xtask test --all` runs it"]
fn every_wrong_tag_is_rejected_in_constant_time() -> Result<()> {
    all_images(&Vec::from_iter(1..=u8::MAX))
}

fn all_images(values: &[u8]) -> Result<()> {
    for image in budgets::demonstrations() {
        let rejected = check(image.chip, &Elf::read(&image.build()?)?, values)?;
        println!("{image}: {rejected} wrong tags rejected by the same instructions");
    }
    Ok(())
}

#[test]
fn a_comparison_that_leaks_is_found_out() -> Result<()> {
    for chip in Chip::ALL {
        let leaky = Image::shipped(chip, "demo", "minimal,leaky");
        let leak = check(chip, &Elf::read(&leaky.build()?)?, &[0x01]).err();
        println!("found out: {:#}", leak.expect("a leak"));
    }
    Ok(())
}

/// Rejects frames with wrong tags: a wrong byte, with values from `values`, at each position, and
/// tags that are wrong everywhere behind it. Gives how many.
///
/// # Errors
/// If two rejections execute different instructions; says where they part.
fn check(chip: Chip, elf: &Elf, values: &[u8]) -> Result<usize> {
    let mut machine = Machine::reset(chip, elf)?;
    // Before it verifies a frame for the first time. The memory begins with the frame.
    let verify = elf.find("mavseal_demo::run::verify")?.start;
    machine.run_to(verify)?;
    let before = machine.moment();
    let at = elf.find("MEMORY")?.start + (FRAME_SIZE - TAG_SIZE) as u32;
    let right = machine.ram(at..at + TAG_SIZE as u32);

    // Whether the frame is accepted with this tag, and the instructions up to the verdict.
    let mut verdict = |tag: &[u8]| -> Result<(bool, Vec<u32>)> {
        machine.go_back(&before);
        machine.write_ram(at, tag);
        let trace = machine.call()?.trace;
        // An image that has accepted its frame verifies more; one that has not gives up.
        while machine.pc() != verify {
            if !machine.step()? {
                return Ok((false, trace));
            }
        }
        Ok((true, trace))
    };
    ensure!(verdict(&right)?.0, "the right tag is rejected");

    let mut first: Option<Vec<u32>> = None;
    for position in 0..TAG_SIZE {
        for value in values {
            let mut tag = right.clone();
            tag[position] ^= value;
            // The same first wrong byte, and all after it wrong.
            let mut worse = tag.clone();
            worse[position + 1..]
                .iter_mut()
                .for_each(|byte| *byte = !*byte);
            for tag in [tag, worse] {
                let (accepted, trace) = verdict(&tag)?;
                ensure!(!accepted, "{tag:02x?} is accepted for {right:02x?}");
                compare(first.get_or_insert_with(|| trace.clone()), &trace)
                    .with_context(|| format!("{tag:02x?}, where {right:02x?} is right"))?;
            }
        }
    }
    Ok(2 * TAG_SIZE * values.len())
}

/// Fails where two traces part.
fn compare(first: &[u32], other: &[u32]) -> Result<()> {
    let same = first.iter().zip(other).take_while(|(a, b)| a == b).count();
    let after = first[..same].last().copied().unwrap_or_default();
    ensure!(
        first == other,
        "{} instructions instead of {}, other ones after {after:#010x}",
        other.len(),
        first.len()
    );
    Ok(())
}
