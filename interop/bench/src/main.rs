//! Prints what a peer in another language is to be measured with, and what hashes here, as JSON.

use mavlink_signing::Standard;
use mavseal_bench::{
    floor::{Profile, backend},
    messages::{KEY, MESSAGES},
};
use serde_json::json;

fn main() {
    let messages = MESSAGES.map(|message| {
        let frames: Vec<_> = message
            .frames::<Standard>()
            .iter()
            .map(|frame| hex(frame))
            .collect();
        let compressions = Profile::ALL.map(|profile| profile.compressions(message.size));
        json!({
            "name": message.name,
            "size": message.size,
            "frames": frames,
            "compressions": compressions,
        })
    });
    let given = json!({ "key": hex(&KEY), "sha2": backend(), "messages": messages });
    println!("{given}");
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
