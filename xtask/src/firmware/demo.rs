//! The signing demonstration, run on an emulated chip: its verdicts, and what they cost.

use std::{fs, path::Path};

use anyhow::{Result, bail, ensure};

use super::{
    Chip, Image, Profile,
    emulator::{Call, Machine},
    program::Program,
};
use crate::{demo::wire, qemu::read_log};

/// Lengths of payload that are measured, in bytes.
pub(super) const LENGTHS: [u32; 3] = [3, 32, 255];

/// What `chips/demo/src/run.rs` signs: a heartbeat of system 1, component 1, on link 1.
const HEADER: [u8; 10] = [0xFD, 0, 0, 0, 0, 1, 1, 0, 0, 0];
const LINK_ID: u8 = 1;
/// The demonstration goes on to the next verdict only if the last was right.
const CALLS: [usize; 2] = [1, 4];
const FUNCTIONS: [&str; 2] = ["mavseal_demo::run::sign", "mavseal_demo::run::verify"];

/// What the demonstration costs.
pub(super) struct Cost {
    /// Instructions that sign a frame and that verify it, for each of [`LENGTHS`].
    pub(super) instructions: [[usize; 2]; LENGTHS.len()],
    /// Most bytes of stack that the image takes, from reset to end.
    pub(super) stack: u32,
    /// What signing and what verifying take of it, whatever the length and the verdict.
    pub(super) stack_of: [u32; 2],
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
pub(super) fn measure(image: &Image, program: &Program) -> Result<Cost> {
    let mut cost = Cost {
        instructions: [[0; 2]; LENGTHS.len()],
        stack: 0,
        stack_of: [0; 2],
    };
    for (length, instructions) in LENGTHS.into_iter().zip(&mut cost.instructions) {
        let mut program = program.clone();
        set_payload_length(&mut program, length)?;
        let run = run(image, &mut program)?;
        for (index, calls) in run.calls.iter().enumerate() {
            instructions[index] = calls[0].trace.len();
            for call in calls {
                cost.stack_of[index] = cost.stack_of[index].max(call.stack);
            }
        }
        cost.stack = cost.stack.max(run.stack);
    }

    let mut other_key = program.clone();
    let key = other_key.find("mavseal_demo::run::KEY")?;
    other_key.flash_mut(key)?.fill(0xA5);
    let [tag, other_tag] = [&mut program.clone(), &mut other_key].map(|program| {
        let frame = run(image, program)?.frame;
        anyhow::Ok(frame[frame.len() - 6..].to_vec())
    });
    ensure!(tag? != other_tag?, "another key makes the same tag");
    Ok(cost)
}

/// The payload becomes what lies in flash from its first byte on.
fn set_payload_length(program: &mut Program, length: u32) -> Result<()> {
    let payload = program.find("mavseal_demo::run::PAYLOAD")?;
    // A slice is its address and its length.
    let slice = program.flash_mut(payload)?;
    slice[4..8].copy_from_slice(&length.to_le_bytes());
    Ok(())
}

/// Runs from reset to the end.
fn run(image: &Image, program: &mut Program) -> Result<Run> {
    let mut machine = Machine::reset(image.chip, program)?;
    let [sign, verify] = FUNCTIONS.map(|path| program.find(path));
    let functions = [sign?.start, verify?.start];
    let memory = program.find("MEMORY")?;
    let top = machine.sp();
    let mut lowest = top;
    let mut run = Run {
        frame: Vec::new(),
        calls: [Vec::new(), Vec::new()],
        stack: 0,
    };
    loop {
        let function = functions.iter().position(|start| *start == machine.pc());
        if let Some(index) = function {
            let entry = machine.sp();
            let call = machine.call()?;
            lowest = lowest.min(entry - call.stack);
            run.calls[index].push(call);
            if run.frame.is_empty() {
                run.frame = machine.ram(memory.clone());
            }
        } else if !machine.step()? {
            break;
        }
        lowest = lowest.min(machine.sp());
    }
    run.stack = top - lowest;
    run.frame.truncate(usize::from(run.frame[1]) + 25);
    check(image, program, &machine, &run)?;
    Ok(run)
}

/// Whether all verdicts are right, and the frame is what another implementation makes.
fn check(image: &Image, program: &mut Program, machine: &Machine, run: &Run) -> Result<()> {
    let calls = [run.calls[0].len(), run.calls[1].len()];
    ensure!(
        calls == CALLS,
        "{calls:?} calls of {FUNCTIONS:?} instead of {CALLS:?}: a verdict is wrong"
    );

    let key = program.find("mavseal_demo::run::KEY")?;
    let key = program.flash_mut(key)?.to_vec();
    let now = program.find("mavseal_demo::run::NOW")?;
    let mut ticks = [0; 8];
    ticks.copy_from_slice(program.flash_mut(now)?);
    let end = run.frame.len() - 15;
    let mut unsigned = HEADER.to_vec();
    unsigned[1] = u8::try_from(end - HEADER.len())?;
    unsigned.extend(&run.frame[HEADER.len()..end]);
    unsigned.extend([0; 2]);
    let sign = match image.tags() {
        Profile::Hmac => wire::sign,
        Profile::Standard => wire::sign_standard,
        Profile::AesGcm => bail!("{image} signs nothing"),
    };
    let expected = sign(&unsigned, &key, LINK_ID, u64::from_le_bytes(ticks));
    ensure!(
        run.frame == expected,
        "on the wire: {:02x?}, expected: {expected:02x?}",
        run.frame
    );
    match image.chip {
        Chip::QemuM7 => {
            let verdict = machine.ram(program.find("demo::VERDICT")?);
            ensure!(verdict == [1, 0, 0, 0], "its verdict is {verdict:?}");
        }
        Chip::Stm32c092rc => {
            let peripherals = machine.peripherals.borrow();
            ensure!(
                peripherals.sent == expected,
                "the serial port says otherwise"
            );
            ensure!(peripherals.light, "the light is not on");
        }
    }
    Ok(())
}

/// Runs a demonstration that logs over RTT to its end; gives its log.
///
/// # Errors
/// If the log cannot be read.
pub(super) fn log(chip: Chip, elf: &Path) -> Result<String> {
    let program = Program::read(elf)?;
    let mut machine = Machine::reset(chip, &program)?;
    while machine.step()? {}
    // SEGGER's control block: a name of 16 bytes, two counts, then the first channel to the host:
    // name, buffer, its size, how far it is written, how far it is read.
    let block = machine.ram(program.find("_SEGGER_RTT")?);
    let (words, _) = block.as_chunks();
    let word = |index: usize| u32::from_le_bytes(words[index]);
    let (buffer, size, written) = (word(7), word(8), word(9));
    ensure!(
        written < size && word(10) == 0,
        "the log is longer than its buffer"
    );
    let bytes = machine.ram(buffer..buffer + written);
    let table = defmt_decoder::Table::parse(&fs::read(elf)?)?;
    let mut said = String::new();
    read_log(&*bytes, table.as_ref(), |line| said += &format!("{line}\n"))?;
    Ok(said)
}
