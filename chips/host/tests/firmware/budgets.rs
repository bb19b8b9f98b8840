//! What the shipped images take, and the most that they may.

use std::thread;

use anyhow::{Context, Result, anyhow};
use mavseal_chips_host::{Chip, Image};

use crate::{
    demo::{self, Cost, LENGTHS},
    elf::Elf,
    emulator::Machine,
    relay, vehicle,
};

/// A shipped image, and the most that it may take.
struct Budget {
    image: Image,
    /// Bytes
    flash: u64,
    /// Bytes of `.data` and `.bss`
    ram: u64,
    /// Bytes of the whole stack
    stack: u32,
    /// Of the demonstration: instructions to sign and to verify a frame with 3 bytes of payload, both
    /// together
    instructions: usize,
}

const STANDARD: &str = "minimal,standard-signature";

const BUDGETS: [Budget; 11] = [
    demo(Chip::Stm32c092rc, "minimal", false, 5000, 37_000),
    demo(Chip::Stm32c092rc, "minimal", true, 15_000, 26_500),
    demo(Chip::Stm32c092rc, STANDARD, false, 5000, 20_000),
    demo(Chip::Stm32c092rc, STANDARD, true, 15_000, 15_000),
    demo(Chip::QemuM7, "minimal", false, 5000, 22_000),
    demo(Chip::QemuM7, "minimal", true, 13_000, 15_000),
    demo(Chip::QemuM7, STANDARD, false, 5000, 12_500),
    demo(Chip::QemuM7, STANDARD, true, 13_000, 9_000),
    // With clock, marks and keys, and how they outlive cuts of the power and a worn flash.
    link("relay", "ardupilotmega", 32_000, 7250),
    link("relay", "ardupilotmega,standard-signature", 32_000, 7250),
    link("vehicle", "ardupilotmega,sealing", 34_000, 13_000),
];

const fn demo(
    chip: Chip,
    features: &'static str,
    unrolled: bool,
    flash: u64,
    instructions: usize,
) -> Budget {
    Budget {
        image: Image {
            unrolled,
            ..Image::shipped(chip, "demo", features)
        },
        flash,
        ram: 750,
        stack: 900,
        instructions,
    }
}

/// An image with two serial lines. All that it remembers is on the stack of `main`.
const fn link(bin: &'static str, features: &'static str, flash: u64, stack: u32) -> Budget {
    Budget {
        image: Image::shipped(Chip::QemuM7, bin, features),
        flash,
        ram: 64,
        stack,
        instructions: 0,
    }
}

/// The shipped demonstrations.
pub(crate) fn demonstrations() -> impl Iterator<Item = Image> {
    let images = BUDGETS.into_iter().map(|budget| budget.image);
    images.filter(|image| image.bin == "demo")
}

/// Functions that no play gets to: what ends a program that cannot go on, or has neither memory nor keys that
/// it can rely on.
const NOT_PLAYED: [&str; 6] = [
    "DefaultHandler",
    "HardFault",
    "semihosting::process::exit",
    "semihosting::sys::arm_compat::exit",
    "mavseal_relay::sealed::Egress<F,C>::reject",
    "core::ptr::drop_in_place<mavlink_commsec::key::SealingKey>",
];

/// What an image takes.
struct Figures {
    elf: Elf,
    stack: u32,
    /// Of the demonstration.
    cost: Option<Cost>,
}

fn measure(image: &Image) -> Result<Figures> {
    let elf = Elf::read(&image.build()?)?;
    let (stack, cost) = match image.bin {
        "demo" => {
            let cost = demo::measure(image, &elf)?;
            (cost.stack, Some(cost))
        }
        "relay" => (all_played(&elf, &relay::play(image, &elf)?)?, None),
        _ => (all_played(&elf, &vehicle::play(image, &elf)?)?, None),
    };
    Ok(Figures { elf, stack, cost })
}

/// The deepest stack of a play in which every function was called, without which it would say little.
fn all_played(elf: &Elf, machine: &Machine) -> Result<u32> {
    let not_played = NOT_PLAYED.map(|path| elf.find(path).ok().map(|range| range.start));
    let mut missing = elf.functions().filter(|function| {
        !machine.has_reached(function.address) && !not_played.contains(&Some(function.address))
    });
    match missing.next() {
        Some(function) => Err(anyhow!("the play does not call {}", function.path)),
        None => Ok(machine.stack()),
    }
}

/// Builds them, runs them on emulated chips, and prints the tables of the documentation.
#[test]
fn shipped_images_keep_their_budgets() -> Result<()> {
    let all = thread::scope(|scope| {
        let measured = BUDGETS.map(|budget| scope.spawn(move || (measure(&budget.image), budget)));
        measured.map(|thread| thread.join().expect("no panic"))
    });
    let [a, b, c] = LENGTHS;
    let mut bytes = vec![
        "image | profile | SHA-256 | flash | .data + .bss | stack | of sign | of verify".to_owned(),
        "---|---|---|---:|---:|---:|---:|---:".to_owned(),
    ];
    let mut instructions = vec![
        format!("image | profile | SHA-256 | {a} | {b} | {c}"),
        "---|---|---|---|---|---".to_owned(),
    ];
    let mut faults = Vec::new();
    for (figures, budget) in all {
        let Budget { image, .. } = budget;
        let Figures { elf, stack, cost } = figures.with_context(|| image.to_string())?;
        let mut limit = |is: u64, most: u64, what: &str| {
            if is > most {
                faults.push(format!("{image}: {is} {what}, of {most}"));
            }
        };
        limit(elf.flash, budget.flash, "bytes of flash");
        limit(elf.ram, budget.ram, "bytes of static RAM");
        limit(stack.into(), budget.stack.into(), "bytes of stack");
        let name = name(&image);
        let mut row = format!(
            "{name} | {} | {} | {}",
            number(elf.flash),
            number(elf.ram),
            number(stack)
        );
        if let Some(cost) = &cost {
            let [sign, verify] = cost.instructions[0];
            limit(
                (sign + verify) as u64,
                budget.instructions as u64,
                "instructions",
            );
            let [sign, verify] = cost.stack_of.map(number);
            row += &format!(" | {sign} | {verify}");
            let counts = cost
                .instructions
                .map(|counts| counts.map(|count| number(count as u64)).join(" + "));
            instructions.push(format!("{name} | {}", counts.join(" | ")));
        } else {
            row += " | | ";
        }
        bytes.push(row);
        faults.extend(
            elf.complaints
                .iter()
                .map(|complaint| format!("{image} {complaint}")),
        );
    }
    for table in [bytes, instructions] {
        println!("\n| {} |", table.join(" |\n| "));
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    Ok(())
}

/// Its first three columns.
fn name(image: &Image) -> String {
    let sealing = image.features.contains("sealing");
    let profile = match image.features.contains("standard-signature") {
        _ if sealing => "AES-GCM",
        true => "Standard",
        false => "Hmac",
    };
    let rounds = match image.unrolled {
        _ if sealing => "",
        true => "unrolled",
        false => "compact",
    };
    format!(
        "{}/{} | {profile} | {rounds}",
        image.chip.folder(),
        image.bin
    )
}

/// With a comma between thousands.
fn number(number: impl Into<u64>) -> String {
    match number.into() {
        number @ ..1000 => number.to_string(),
        number => format!("{},{:03}", number / 1000, number % 1000),
    }
}
