//! Instructions that firmware uses and armagnac 0.3 does not know.

use std::rc::Rc;

use armagnac::{
    core::{ArmVersion, Effect, ItState, Processor, RunError},
    decoder::{
        DecodeError, InstructionDecode, InstructionDecodeError, Lut16AndGrouped32InstructionDecoder,
    },
    instructions::{DecodeHelper, Encoding, Instruction, InstructionSize, Pattern},
    registers::RegisterIndex,
};

/// All of armagnac's instructions, and those below.
pub(super) struct Decoder(Lut16AndGrouped32InstructionDecoder);

impl Decoder {
    pub(super) fn new(version: ArmVersion) -> Decoder {
        Decoder(Lut16AndGrouped32InstructionDecoder::new(version))
    }
}

impl InstructionDecode for Decoder {
    fn try_decode(
        &self,
        code: u32,
        size: InstructionSize,
        state: ItState,
    ) -> Result<Rc<dyn Instruction>, InstructionDecodeError> {
        if size == InstructionSize::Ins32 && code & 0xFFF0_FFFF == 0xF380_8810 {
            return Ok(Rc::new(SetInterruptMask(code.reg4(16))));
        }
        self.0.try_decode(code, size, state)
    }
}

/// `msr PRIMASK, register`: the end of a critical section (ARM DDI 0419, section B4.2.3).
struct SetInterruptMask(RegisterIndex);

impl Instruction for SetInterruptMask {
    fn patterns() -> &'static [Pattern] {
        &[]
    }

    fn try_decode(_: Encoding, code: u32, _: ItState) -> Result<Self, DecodeError> {
        Ok(Self(code.reg4(16)))
    }

    fn execute(&self, processor: &mut Processor) -> Result<Effect, RunError> {
        let masked = processor[self.0] & 1 != 0;
        processor.registers.primask.set_pm(masked);
        Ok(Effect::None)
    }

    fn name(&self) -> String {
        "msr".into()
    }

    fn args(&self, _: u32) -> String {
        format!("primask, {}", self.0)
    }
}
