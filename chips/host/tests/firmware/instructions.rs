//! Instructions that firmware uses and armagnac 0.3 does not know.

use std::rc::Rc;

use armagnac::{
    core::{ArmVersion, Effect, ItState, Processor, RunError},
    decoder::{
        DecodeError, InstructionDecode, InstructionDecodeError, Lut16AndGrouped32InstructionDecoder,
    },
    instructions::{DecodeHelper, Encoding, Instruction, InstructionSize, Pattern},
};

/// All of armagnac's instructions, and those below.
pub(crate) struct Decoder(Lut16AndGrouped32InstructionDecoder);

impl Decoder {
    pub(crate) fn new(version: ArmVersion) -> Self {
        Self(Lut16AndGrouped32InstructionDecoder::new(version))
    }
}

impl InstructionDecode for Decoder {
    fn try_decode(
        &self,
        code: u32,
        size: InstructionSize,
        state: ItState,
    ) -> Result<Rc<dyn Instruction>, InstructionDecodeError> {
        let mut added = ADDED.iter();
        match added.find(|added| code & added.mask == added.code) {
            Some(added) if size == InstructionSize::Ins32 => Ok(Rc::new(Decoded { code, added })),
            _ => self.0.try_decode(code, size, state),
        }
    }
}

struct Added {
    name: &'static str,
    mask: u32,
    code: u32,
    execute: fn(u32, &mut Processor),
}

/// By the Arm Architecture Reference Manuals DDI 0419 and DDI 0403.
const ADDED: [Added; 4] = [
    // `msr PRIMASK, register`: the end of a critical section.
    Added {
        name: "msr primask",
        mask: 0xFFF0_FFFF,
        code: 0xF380_8810,
        execute: |code, processor| {
            let masked = processor[code.reg4(16)] & 1 != 0;
            processor.registers.primask.set_pm(masked);
        },
    },
    Added {
        name: "uxtab or uxtb",
        mask: 0xFFF0_F0C0,
        code: 0xFA50_F080,
        execute: |code, processor| {
            let byte = processor[code.reg4(0)].rotate_right(8 * (code >> 4 & 0b11)) & 0xFF;
            // With R15 in its place, nothing is added: `uxtb`.
            let added = match code >> 16 & 0xF {
                0xF => 0,
                _ => processor[code.reg4(16)],
            };
            processor.set(code.reg4(8), byte.wrapping_add(added));
        },
    },
    Added {
        name: "pkhbt",
        mask: 0xFFF0_8030,
        code: 0xEAC0_0000,
        execute: |code, processor| {
            let top = processor[code.reg4(0)] << (code >> 10 & 0b1_1100 | code >> 6 & 0b11);
            let packed = top & 0xFFFF_0000 | processor[code.reg4(16)] & 0xFFFF;
            processor.set(code.reg4(8), packed);
        },
    },
    Added {
        name: "uqadd8",
        mask: 0xFFF0_F0F0,
        code: 0xFA80_F050,
        execute: |code, processor| {
            let mut sums = processor[code.reg4(16)].to_le_bytes();
            for (sum, byte) in sums.iter_mut().zip(processor[code.reg4(0)].to_le_bytes()) {
                *sum = sum.saturating_add(byte);
            }
            processor.set(code.reg4(8), u32::from_le_bytes(sums));
        },
    },
];

struct Decoded {
    code: u32,
    added: &'static Added,
}

impl Instruction for Decoded {
    fn patterns() -> &'static [Pattern] {
        &[]
    }

    fn try_decode(_: Encoding, _: u32, _: ItState) -> Result<Self, DecodeError> {
        // The decoder above makes all of them.
        Err(DecodeError::Other)
    }

    fn execute(&self, processor: &mut Processor) -> Result<Effect, RunError> {
        (self.added.execute)(self.code, processor);
        Ok(Effect::None)
    }

    fn name(&self) -> String {
        self.added.name.into()
    }

    fn args(&self, _: u32) -> String {
        format!("({:08x})", self.code)
    }
}
