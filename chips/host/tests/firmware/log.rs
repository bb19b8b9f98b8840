//! The log of the board's firmware, as a person with the board would flash it.

use std::fs;

use anyhow::{Result, ensure};
use defmt_decoder::Table;
use mavseal_chips_host::{Chip, Image};

use crate::{elf::Elf, emulator::Machine};

#[test]
fn the_demonstration_logs_what_is_committed_beside_it() -> Result<()> {
    let path = Image::logging(Chip::Stm32c092rc, "demo", "").build()?;
    let elf = Elf::read(&path)?;
    let mut machine = Machine::reset(Chip::Stm32c092rc, &elf)?;
    while machine.step()? {}
    // SEGGER's control block: a name of 16 bytes, two counts, then the first channel to the host:
    // name, buffer, its size, how far it is written, how far it is read.
    let block = machine.ram(elf.find("_SEGGER_RTT")?);
    let (words, _) = block.as_chunks();
    let [buffer, size, written, read] = [7, 8, 9, 10].map(|at| u32::from_le_bytes(words[at]));
    ensure!(
        written < size && read == 0,
        "the log is longer than its buffer"
    );
    let data = fs::read(path)?;
    let table = Table::parse(&data)?.expect("a log");
    let mut decoder = table.new_stream_decoder();
    decoder.received(&machine.ram(buffer..buffer + written));
    let mut said = String::new();
    while let Ok(frame) = decoder.decode() {
        let level = frame.level().expect("a level").as_str().to_uppercase();
        said += &format!("[{level:<5}] {}\n", frame.display_message());
    }
    let expected = include_str!("../../../demo/demo.out");
    assert_eq!(said, expected, "demo.out says otherwise");
    Ok(())
}
