//! The table: a line for each payload and operation, a column for each who does it.

use std::fmt;

use anyhow::Result;
use comfy_table::{CellAlignment, presets};

use super::{Given, PEERS, PROFILES, Times, times::Mode};

/// What is printed of one mode.
pub(super) struct Table(comfy_table::Table);

impl Table {
    pub(super) fn of(given: &Given, times: &Times, mode: Mode) -> Result<Self> {
        let mut table = comfy_table::Table::new();
        table.load_preset(presets::ASCII_MARKDOWN);
        let [hmac, standard] = PROFILES;
        let floors = [format!("floor, {hmac}"), format!("floor, {standard}")];
        let mut header = vec!["payload".to_owned(), "operation".to_owned()];
        header.extend(floors);
        header.extend(PROFILES.map(|profile| format!("here, {profile}")));
        header.extend(PEERS.map(str::to_owned));
        table.set_header(header);
        for message in &given.messages {
            for operation in ["sign", "verify", "verify, streams"] {
                let floors = [
                    times.floor(mode, hmac, message.size)?,
                    times.floor(mode, standard, message.size)?,
                ];
                let mut row = vec![message.size.to_string(), operation.to_owned()];
                row.extend(floors.map(|floor| format!("{floor:.0}")));
                let cell = |who: &str, floor: f64| {
                    let time = times.get(mode, &format!("{who} {operation}"), message.size)?;
                    anyhow::Ok(format!("{time:.0} ({:.2})", time / floor))
                };
                for (profile, floor) in PROFILES.into_iter().zip(floors) {
                    row.push(cell(profile, floor)?);
                }
                for peer in PEERS {
                    // Only the core can be told to remember one stream or several.
                    let measured = operation != "verify, streams";
                    row.push(if measured {
                        cell(peer, floors[1])?
                    } else {
                        String::new()
                    });
                }
                table.add_row(row);
            }
        }
        for column in table.column_iter_mut() {
            if column.index != 1 {
                column.set_cell_alignment(CellAlignment::Right);
            }
        }
        Ok(Self(table))
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}
