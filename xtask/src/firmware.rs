//! `cargo xtask firmware`: builds the images of `chips/`, runs them on emulated chips, and holds them
//! to their budgets.

mod build;
mod constant_time;
mod demo;
mod emulator;
mod instructions;
mod peripherals;
mod program;
mod sizes;

use anyhow::{Context, Result, ensure};
use clap::Args;
use comfy_table::{CellAlignment, Table, presets};

pub(crate) use build::{Chip, Image, KEYS_VARIABLE, Profile, Rounds, build, build_with, keys};
use demo::LENGTHS;
use program::Program;
use sizes::{Symbols, sizes};

use crate::setup;

/// The most that an image may take.
struct Budget {
    image: Image,
    /// Bytes
    flash: u64,
    /// Bytes of `.data` and `.bss`
    ram: u64,
    /// Only for the demonstration
    demo: Option<DemoBudget>,
}

/// The most that the demonstration may take.
struct DemoBudget {
    /// Instructions to sign and to verify a frame with 3 bytes of payload, both together
    instructions: u64,
    /// Bytes of the whole stack
    stack: u32,
}

/// A shipped image: no log, no way to panic.
const fn deployed(chip: Chip, bin: &'static str, features: &'static [&'static str]) -> Image {
    Image {
        chip,
        bin,
        profile: "release-deploy",
        rounds: Rounds::Looped,
        features,
        default_features: false,
    }
}

/// The demonstration as it is shipped.
const fn demo(chip: Chip, rounds: Rounds) -> Image {
    Image {
        rounds,
        ..deployed(chip, "demo", &["minimal"])
    }
}

/// The same with the standard's signature.
const fn standard_demo(chip: Chip, rounds: Rounds) -> Image {
    Image {
        features: &["minimal", "standard-signature"],
        ..demo(chip, rounds)
    }
}

/// Images that are shipped, and the most that they may take.
const BUDGETS: &[Budget] = &[
    Budget {
        image: demo(Chip::Stm32c092rc, Rounds::Looped),
        flash: FLASH,
        ram: 750,
        demo: Some(DemoBudget {
            instructions: 37_000,
            stack: STACK,
        }),
    },
    Budget {
        image: demo(Chip::Stm32c092rc, Rounds::Unrolled),
        flash: 15_000,
        ram: 750,
        demo: Some(DemoBudget {
            instructions: 26_500,
            stack: STACK,
        }),
    },
    Budget {
        image: demo(Chip::QemuM7, Rounds::Looped),
        flash: FLASH,
        ram: 750,
        demo: Some(DemoBudget {
            instructions: 22_000,
            stack: STACK,
        }),
    },
    Budget {
        image: demo(Chip::QemuM7, Rounds::Unrolled),
        flash: 13_000,
        ram: 750,
        demo: Some(DemoBudget {
            instructions: 15_000,
            stack: STACK,
        }),
    },
    Budget {
        image: standard_demo(Chip::Stm32c092rc, Rounds::Looped),
        flash: FLASH,
        ram: 750,
        demo: Some(DemoBudget {
            instructions: 20_000,
            stack: STACK,
        }),
    },
    Budget {
        image: standard_demo(Chip::Stm32c092rc, Rounds::Unrolled),
        flash: 15_000,
        ram: 750,
        demo: Some(DemoBudget {
            instructions: 15_000,
            stack: STACK,
        }),
    },
    Budget {
        image: standard_demo(Chip::QemuM7, Rounds::Looped),
        flash: FLASH,
        ram: 750,
        demo: Some(DemoBudget {
            instructions: 12_500,
            stack: STACK,
        }),
    },
    Budget {
        image: standard_demo(Chip::QemuM7, Rounds::Unrolled),
        flash: 13_000,
        ram: 750,
        demo: Some(DemoBudget {
            instructions: 9_000,
            stack: STACK,
        }),
    },
    Budget {
        image: deployed(
            Chip::QemuM7,
            "relay",
            &["ardupilotmega", "standard-signature"],
        ),
        flash: RELAY_FLASH,
        ram: 64,
        demo: None,
    },
    Budget {
        image: deployed(Chip::QemuM7, "relay", &["ardupilotmega"]),
        flash: RELAY_FLASH,
        ram: 64,
        demo: None,
    },
    Budget {
        image: deployed(Chip::QemuM7, "vehicle", &["ardupilotmega", "sealing"]),
        flash: 25_000,
        ram: 64,
        demo: None,
    },
];

/// Bytes of flash for the smallest images.
const FLASH: u64 = 5000;
/// Bytes of flash for the relay. A third of it is clock, mark, key slots and key change.
const RELAY_FLASH: u64 = 20_500;
/// Bytes of stack for every demonstration.
const STACK: u32 = 900;

/// Options of `cargo xtask firmware`.
#[derive(Args, Default)]
pub(crate) struct Options {
    /// Also list the sections of each image
    #[arg(long)]
    sections: bool,
    /// Instead, show that wrong tags are rejected in constant time: every value of every byte
    #[arg(long)]
    constant_time: bool,
}

/// Builds every image that has a budget, runs the demonstrations, and prints what all take.
///
/// # Errors
/// If an image does not build, does wrong, is above its budget, can panic, or logs.
pub(crate) fn run(options: &Options) -> Result<()> {
    if options.constant_time {
        return constant_time(true);
    }
    let mut bytes = new_table(&[
        "image",
        "profile",
        "SHA-256",
        "flash",
        ".data + .bss",
        "stack",
        "of sign",
        "of verify",
    ]);
    let mut instructions = new_table(&[
        "image", "profile", "SHA-256", "payload", "sign", "verify", "both",
    ]);
    let mut sections = new_table(&["image", "section", "size"]);
    let mut complaints = Vec::new();
    for budget in BUDGETS {
        let image = &budget.image;
        let elf = build(image)?;
        let sizes = sizes(&elf)?;
        let name = [
            image.to_string(),
            image.tags().to_string(),
            match image.tags() {
                Profile::AesGcm => String::new(),
                _ => image.rounds.to_string(),
            },
        ];
        let mut limit = |is: u64, most: u64, what: &str| {
            if is > most {
                complaints.push(format!("{}: {is} {what}, of {most}", name.join(", ")));
            }
        };
        limit(sizes.flash, budget.flash, "bytes of flash");
        limit(sizes.ram_static, budget.ram, "bytes of static RAM");
        let mut row = name.to_vec();
        row.extend([sizes.flash, sizes.ram_static].map(|size| size.to_string()));
        if let Some(budget) = &budget.demo {
            let cost = demo::measure(image, &Program::read(&elf)?);
            let cost = cost.with_context(|| name.join(", "))?;
            let both = |[sign, verify]: [usize; 2]| sign + verify;
            let least = both(cost.instructions[0]) as u64;
            limit(least, budget.instructions, "instructions");
            limit(cost.stack.into(), budget.stack.into(), "bytes of stack");
            row.push(cost.stack.to_string());
            row.extend(cost.stack_of.map(|stack| stack.to_string()));
            for (length, counts) in LENGTHS.into_iter().zip(cost.instructions) {
                let [sign, verify] = counts;
                let numbers = [length as usize, sign, verify, both(counts)];
                let numbers = numbers.map(|number| number.to_string());
                instructions.add_row(name.clone().into_iter().chain(numbers));
            }
        }
        bytes.add_row(row);
        for section in &sizes.sections {
            sections.add_row([
                name[0].clone(),
                section.name.clone(),
                section.size.to_string(),
            ]);
        }
        let symbols = Symbols::read(&elf)?;
        let found = symbols.complaints();
        complaints.extend(found.map(|complaint| format!("{image} {complaint}")));
    }
    println!("Bytes:\n{bytes}\n\nInstructions for a frame:\n{instructions}");
    if options.sections {
        println!("\n{sections}");
    }
    ensure!(complaints.is_empty(), "{}", complaints.join("\n"));
    Ok(())
}

/// Shows that the checks can fail: an image with a log is found to log, and to panic, and one that
/// hashes with a wrong constant is found to sign wrongly.
///
/// # Errors
/// If it is not.
pub(crate) fn checks_can_fail() -> Result<()> {
    let image = deployed(Chip::QemuM7, "relay", &["ardupilotmega", "logging"]);
    let found = Symbols::read(&build(&image)?)?;
    ensure!(!found.logging.is_empty(), "its log was not found");
    ensure!(!found.panicking.is_empty(), "its panics were not found");
    println!(
        "rejected, as it must be: {}",
        found.complaints().next().unwrap_or_default()
    );

    for chip in Chip::ALL {
        let image = demo(chip, Rounds::Looped);
        let mut wrong = Program::read(&build(&image)?)?;
        let constants = wrong.find("sha2::consts::K32")?;
        wrong.flash_mut(constants)?[0] ^= 1;
        let error = demo::measure(&image, &wrong).err();
        let error = error.context("a wrong hash was not found out")?;
        println!("a wrong hash is found out: {error:#}");
    }
    Ok(())
}

/// Shows that the shipped demonstrations execute the same instructions for every wrong tag, and that
/// one with a leaky comparison is found to leak. `all` takes every value of every byte of a tag.
///
/// # Errors
/// If it is not so.
pub(crate) fn constant_time(all: bool) -> Result<()> {
    let every = (1..=u8::MAX).collect::<Vec<_>>();
    let values = if all { &every[..] } else { &[0x01, 0x80, 0xFF] };
    for chip in Chip::ALL {
        let images = [
            demo(chip, Rounds::Looped),
            demo(chip, Rounds::Unrolled),
            standard_demo(chip, Rounds::Looped),
            standard_demo(chip, Rounds::Unrolled),
        ];
        for image in images {
            let program = Program::read(&build(&image)?)?;
            let rejected = constant_time::check(chip, &program, values)?;
            let (tags, rounds) = (image.tags(), image.rounds);
            println!(
                "{image}, {tags}, {rounds}: {rejected} wrong tags rejected by the same instructions"
            );
        }
        let leaky = deployed(chip, "demo", &["minimal", "leaky"]);
        let program = Program::read(&build(&leaky)?)?;
        let leak = constant_time::check(chip, &program, &[0x01]).err();
        let leak = leak.context("a comparison that leaks was not found out")?;
        println!("a comparison that leaks is found out: {leak:#}");
    }
    Ok(())
}

/// Shows that the firmware for the STM32C092RC, as a person with the board would flash it, logs what
/// is committed beside the demonstration.
///
/// # Errors
/// If it logs something else.
pub(crate) fn log() -> Result<()> {
    let image = Image {
        profile: "release",
        features: &[],
        default_features: true,
        ..demo(Chip::Stm32c092rc, Rounds::Looped)
    };
    let elf = build(&image)?;
    let said = demo::log(image.chip, &elf)?;
    print!("{said}");
    let expected = std::fs::read_to_string(setup::root().join("chips/demo/demo.out"))?;
    ensure!(said == expected, "demo.out says otherwise:\n{expected}");
    Ok(())
}

fn new_table(header: &[&str]) -> Table {
    let mut table = Table::new();
    table
        .load_preset(presets::ASCII_MARKDOWN)
        .set_header(header);
    for (index, name) in header.iter().enumerate() {
        if !["image", "profile", "SHA-256", "section"].contains(name)
            && let Some(column) = table.column_mut(index)
        {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}
