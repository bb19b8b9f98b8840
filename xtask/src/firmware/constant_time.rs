//! Whether the time of a rejection tells how much of a forged tag is right: compares the instructions
//! that the image executes.

use anyhow::{Context, Result, ensure};

use super::{
    Chip,
    emulator::{Machine, Moment},
    program::Program,
};

const TAG_SIZE: usize = 6;
/// Payload of the frame that is rejected, as the image has it.
const PAYLOAD_SIZE: usize = 3;
const FRAME_SIZE: usize = 10 + PAYLOAD_SIZE + 15;

/// The image before it verifies a frame for the first time.
struct Verifier {
    machine: Machine,
    before: Moment,
    tag: [u8; TAG_SIZE],
    tag_address: u32,
    /// The first instruction of verifying.
    verify: u32,
}

/// Rejects frames with wrong tags: a wrong byte, with values from `values`, at each position, and
/// tags that are wrong everywhere. Gives how many.
///
/// # Errors
/// If two rejections execute different instructions; says where they part.
pub(super) fn check(chip: Chip, program: &Program, values: &[u8]) -> Result<usize> {
    let mut verifier = Verifier::new(chip, program)?;
    let right = verifier.tag;
    let (accepted, _) = verifier.verify(right)?;
    ensure!(accepted, "the right tag is rejected");

    let mut wrong = Vec::new();
    for position in 0..TAG_SIZE {
        for value in values {
            let mut tag = right;
            tag[position] ^= value;
            wrong.push(tag);
            // The same first wrong byte, and all after it wrong.
            for byte in &mut tag[position + 1..] {
                *byte = !*byte;
            }
            wrong.push(tag);
        }
    }
    let mut first: Option<Vec<u32>> = None;
    for tag in &wrong {
        let (accepted, trace) = verifier.verify(*tag)?;
        ensure!(!accepted, "the tag {tag:02x?} is accepted for {right:02x?}");
        match &first {
            None => first = Some(trace),
            Some(first) => compare(first, &trace)
                .with_context(|| format!("the tag {tag:02x?}, where {right:02x?} is right"))?,
        }
    }
    Ok(wrong.len())
}

/// Fails where two traces part.
fn compare(first: &[u32], other: &[u32]) -> Result<()> {
    if first == other {
        return Ok(());
    }
    let same = first.iter().zip(other).take_while(|(a, b)| a == b).count();
    let after = first
        .get(same.saturating_sub(1))
        .copied()
        .unwrap_or_default();
    anyhow::bail!(
        "{} instructions instead of {}, other ones after {after:#010x}",
        other.len(),
        first.len()
    )
}

impl Verifier {
    fn new(chip: Chip, program: &Program) -> Result<Verifier> {
        let mut machine = Machine::reset(chip, program)?;
        let verify = program.find("mavseal_demo::run::verify")?.start;
        machine.run_to(verify)?;
        // The memory begins with the wire.
        let wire = program.find("MEMORY")?.start;
        let tag_address = wire + (FRAME_SIZE - TAG_SIZE) as u32;
        let mut tag = [0; TAG_SIZE];
        tag.copy_from_slice(&machine.ram(tag_address..tag_address + TAG_SIZE as u32));
        Ok(Verifier {
            before: machine.moment(),
            machine,
            tag,
            tag_address,
            verify,
        })
    }

    /// Whether the frame is accepted with this tag, and the instructions up to the verdict.
    fn verify(&mut self, tag: [u8; TAG_SIZE]) -> Result<(bool, Vec<u32>)> {
        self.machine.go_back(&self.before);
        self.machine.write_ram(self.tag_address, &tag);
        let call = self.machine.call()?;
        // An image that has accepted its frame verifies more; one that has not gives up.
        let accepted = loop {
            if self.machine.pc() == self.verify {
                break true;
            } else if !self.machine.step()? {
                break false;
            }
        };
        Ok((accepted, call.trace))
    }
}
