//! The signing demonstration, run on an emulated chip: its verdicts, and what they cost.

use anyhow::{Result, ensure};
use mavseal_chips_host::{Chip, Image};

use crate::{
    elf::Elf,
    emulator::{Call, Machine},
    wire,
};

/// Lengths of payload that are measured, in bytes.
pub(crate) const LENGTHS: [u32; 3] = [3, 32, 255];

/// What `chips/demo/src/run.rs` signs: a heartbeat of system 1, component 1, on link 1.
const HEADER: [u8; 6] = [0, 1, 1, 0, 0, 0];
const CRC_EXTRA: u8 = 50;
const LINK_ID: u8 = 1;
/// The demonstration goes on to the next verdict only if the last was right.
const CALLS: [usize; 2] = [1, 4];
const FUNCTIONS: [&str; 2] = ["mavseal_demo::run::sign", "mavseal_demo::run::verify"];

/// What the demonstration costs.
pub(crate) struct Cost {
    /// Instructions that sign a frame and that verify it, for each of [`LENGTHS`].
    pub(crate) instructions: [[usize; 2]; LENGTHS.len()],
    /// Most bytes of stack that the image takes, from reset to end.
    pub(crate) stack: u32,
    /// What signing and what verifying take of it, whatever the length and the verdict.
    pub(crate) stack_of: [u32; 2],
}

/// One run from reset to its end.
struct Run {
    /// The frame on the wire, with which the memory begins.
    frame: Vec<u8>,
    /// Calls of each of [`FUNCTIONS`].
    calls: [Vec<Call>; 2],
    stack: u32,
}

/// Runs the demonstration, with each length of payload and with another key; checks everything that
/// comes out of it.
///
/// # Errors
/// If a verdict is wrong, or a tag is not that of another implementation.
pub(crate) fn measure(image: &Image, elf: &Elf) -> Result<Cost> {
    let mut cost = Cost {
        instructions: [[0; 2]; LENGTHS.len()],
        stack: 0,
        stack_of: [0; 2],
    };
    for (length, instructions) in LENGTHS.into_iter().zip(&mut cost.instructions) {
        let mut elf = elf.clone();
        // The payload becomes what lies in flash from its first byte on. A slice is its address and its
        // length.
        let slice = elf.flash_mut("mavseal_demo::run::PAYLOAD")?;
        slice[4..8].copy_from_slice(&length.to_le_bytes());
        let run = run(image, &mut elf)?;
        for (index, calls) in run.calls.iter().enumerate() {
            instructions[index] = calls[0].trace.len();
            for call in calls {
                cost.stack_of[index] = cost.stack_of[index].max(call.stack);
            }
        }
        cost.stack = cost.stack.max(run.stack);
    }

    let mut other_key = elf.clone();
    other_key.flash_mut("mavseal_demo::run::KEY")?.fill(0xA5);
    let frame = run(image, &mut elf.clone())?.frame;
    let other_frame = run(image, &mut other_key)?.frame;
    let tag_at = frame.len() - 6;
    ensure!(
        frame[tag_at..] != other_frame[tag_at..],
        "another key makes the same tag"
    );
    Ok(cost)
}

/// Runs from reset to the end.
fn run(image: &Image, elf: &mut Elf) -> Result<Run> {
    let mut machine = Machine::reset(image.chip, elf)?;
    let [sign, verify] = FUNCTIONS.map(|path| elf.find(path));
    let functions = [sign?.start, verify?.start];
    let mut run = Run {
        frame: Vec::new(),
        calls: [Vec::new(), Vec::new()],
        stack: 0,
    };
    loop {
        let function = functions.iter().position(|start| *start == machine.pc());
        if let Some(index) = function {
            run.calls[index].push(machine.call()?);
            if run.frame.is_empty() {
                run.frame = machine.ram(elf.find("MEMORY")?);
            }
        } else if !machine.step()? {
            break;
        }
    }
    run.stack = machine.stack();
    run.frame.truncate(usize::from(run.frame[1]) + 25);
    check(image, elf, &machine, &run)?;
    Ok(run)
}

/// Whether all verdicts are right, and the frame is what another implementation makes.
fn check(image: &Image, elf: &mut Elf, machine: &Machine, run: &Run) -> Result<()> {
    let calls = [run.calls[0].len(), run.calls[1].len()];
    ensure!(
        calls == CALLS,
        "{calls:?} calls of {FUNCTIONS:?} instead of {CALLS:?}: a verdict is wrong"
    );

    let key = elf.flash_mut("mavseal_demo::run::KEY")?.to_vec();
    let now = elf.flash_mut("mavseal_demo::run::NOW")?;
    let ticks = u64::from_le_bytes(now.try_into()?);
    let payload = &run.frame[10..run.frame.len() - 15];
    let unsigned = wire::frame(HEADER, payload, CRC_EXTRA);
    let key = (wire::tag(image), &key[..]);
    let expected = wire::sign(&unsigned, CRC_EXTRA, key, LINK_ID, ticks);
    ensure!(
        run.frame == expected,
        "on the wire: {:02x?}, expected: {expected:02x?}",
        run.frame
    );
    match image.chip {
        Chip::QemuM7 => {
            let verdict = machine.ram(elf.find("demo::VERDICT")?);
            ensure!(verdict == [1, 0, 0, 0], "its verdict is {verdict:?}");
        }
        Chip::Stm32c092rc => {
            let board = machine.stm32c0.borrow();
            ensure!(board.sent == expected, "the serial port says otherwise");
            ensure!(board.light, "the light is not on");
        }
    }
    Ok(())
}
