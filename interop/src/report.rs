//! What was seen: counts for the table, differences, and what must not have been.

use std::collections::{BTreeMap, BTreeSet};

use comfy_table::{CellAlignment, Table, presets};

use crate::differences::{self, Difference};

/// A row of the table.
#[derive(Clone, Debug, Default)]
pub(crate) struct Row {
    pub(crate) peer: String,
    pub(crate) version: String,
    pub(crate) direction: &'static str,
    pub(crate) messages: usize,
    pub(crate) frames: usize,
    pub(crate) agreed: usize,
    /// The scenarios in which the peer does something else, for a known reason.
    pub(crate) differences: BTreeSet<&'static str>,
}

/// Everything that was seen.
#[derive(Debug)]
pub(crate) struct Report {
    rows: Vec<Row>,
    reasons: Vec<Reason>,
    pub(crate) failures: Vec<String>,
}

/// Why a peer does something else.
#[derive(Debug)]
struct Reason {
    peer: &'static str,
    scenario: &'static str,
    reason: &'static str,
}

/// Compares what passes with what is to pass, and remembers it. By default no difference is listed.
#[derive(Default)]
pub(crate) struct Judge {
    rows: Vec<Row>,
    listed: BTreeMap<(&'static str, &'static str), Listed>,
    /// What failed, and how often: one line for each, not for each message.
    failures: BTreeMap<String, (usize, String)>,
}

struct Listed {
    difference: Difference,
    seen: bool,
}

impl Judge {
    /// With every difference that is listed, each of which has to be seen.
    pub(crate) fn new() -> Self {
        let listed = differences::all().map(|difference| {
            let key = (difference.peer, difference.scenario);
            let seen = false;
            (key, Listed { difference, seen })
        });
        Self {
            rows: Vec::new(),
            listed: listed.collect(),
            failures: BTreeMap::new(),
        }
    }

    /// Begins a row; what is judged from now on is counted in it.
    pub(crate) fn begin(
        &mut self,
        peer: &str,
        version: &str,
        direction: &'static str,
        messages: usize,
    ) {
        self.rows.push(Row {
            peer: peer.to_owned(),
            version: version.to_owned(),
            direction,
            messages,
            ..Row::default()
        });
    }

    /// A whole row.
    pub(crate) fn row(&mut self, row: Row) {
        self.rows.push(row);
    }

    /// How many things failed that must not.
    pub(crate) fn failed(&self) -> usize {
        self.failures.len()
    }

    /// `passes` frame by frame in a scenario, `right` what is right; `example` is a frame to look at.
    pub(crate) fn compare(
        &mut self,
        peer: &'static str,
        scenario: &'static str,
        right: &[bool],
        passes: &[bool],
        example: impl FnOnce() -> String,
    ) {
        let listed = self.listed.get_mut(&(peer, scenario));
        let known = listed
            .as_ref()
            .is_some_and(|listed| listed.difference.passes == passes);
        let agreed = right
            .iter()
            .zip(passes)
            .filter(|(right, passes)| right == passes)
            .count();
        if let Some(row) = self.rows.last_mut() {
            row.frames += right.len();
            row.agreed += agreed;
            if known && right != passes {
                row.differences.insert(scenario);
            }
        }
        if right == passes {
            return;
        }
        match listed {
            Some(listed) if known => listed.seen = true,
            _ => {
                let what = format!("{peer}, {scenario}: {passes:?}, and right is {right:?}");
                let (times, _) = self.failures.entry(what).or_insert_with(|| (0, example()));
                *times += 1;
            }
        }
    }

    /// Something that must not be, in this implementation or in a peer.
    pub(crate) fn fail(&mut self, what: String, example: impl FnOnce() -> String) {
        let (times, _) = self.failures.entry(what).or_insert_with(|| (0, example()));
        *times += 1;
    }

    pub(crate) fn finish(self) -> Report {
        let mut failures: Vec<String> = self
            .failures
            .into_iter()
            .map(|(what, (times, example))| format!("{what} ({times} times; {example})"))
            .collect();
        let mut reasons = Vec::new();
        for Listed { difference, seen } in self.listed.into_values() {
            let Difference {
                peer,
                scenario,
                reason,
                ..
            } = difference;
            if !seen {
                failures.push(format!(
                    "{peer}, {scenario}: listed as a difference, and there is none"
                ));
            }
            reasons.push(Reason {
                peer,
                scenario,
                reason,
            });
        }
        Report {
            rows: self.rows,
            reasons,
            failures,
        }
    }
}

impl Report {
    /// Prints what differs for a known reason, and the table.
    pub(crate) fn print(&self) {
        let mut table = Table::new();
        table.load_preset(presets::NOTHING).set_header([
            "peer",
            "version",
            "direction",
            "messages",
            "frames",
            "agreed",
            "differences",
        ]);
        for row in &self.rows {
            table.add_row([
                row.peer.clone(),
                row.version.clone(),
                row.direction.to_owned(),
                row.messages.to_string(),
                row.frames.to_string(),
                row.agreed.to_string(),
                row.differences.len().to_string(),
            ]);
        }
        for column in table.column_iter_mut().skip(3) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        let mut scenarios: BTreeMap<_, Vec<_>> = BTreeMap::new();
        for reason in &self.reasons {
            let same = scenarios.entry((reason.peer, reason.reason)).or_default();
            same.push(reason.scenario);
        }
        if !scenarios.is_empty() {
            println!("\nWhat the peers do in another way, in every run:");
        }
        for ((peer, reason), scenarios) in scenarios {
            println!("  {peer}: {}\n    {reason}", scenarios.join("; "));
        }
        println!("\n{table}");
    }
}

#[cfg(test)]
mod tests {
    use super::Judge;

    const LISTED: (&str, &str) = ("pymavlink", "2 minutes ahead");

    fn failures(judge: Judge) -> Vec<String> {
        judge.finish().failures
    }

    #[test]
    fn a_listed_difference_that_is_not_seen_fails() {
        let of = |failures: &[String]| {
            let (peer, scenario) = LISTED;
            let start = format!("{peer}, {scenario}: ");
            failures
                .iter()
                .filter(|what| what.starts_with(&start))
                .count()
        };
        let mut judge = Judge::new();
        judge.compare(LISTED.0, LISTED.1, &[false], &[false], String::new);
        assert_eq!(of(&failures(judge)), 1);

        let mut judge = Judge::new();
        judge.compare(LISTED.0, LISTED.1, &[false], &[true], String::new);
        assert_eq!(of(&failures(judge)), 0);
    }

    #[test]
    fn a_difference_that_is_not_listed_fails() {
        let none = failures(Judge::new()).len();
        let mut judge = Judge::new();
        judge.begin("pymavlink", "0", "here", 1);
        judge.compare("pymavlink", "tag changed", &[false], &[true], String::new);
        judge.compare("pymavlink", "tag changed", &[false], &[true], String::new);
        assert_eq!(judge.rows[0].agreed, 0);
        let failures = failures(judge);
        assert_eq!(failures.len(), none + 1);
        assert!(
            failures
                .iter()
                .any(|what| what.contains("tag changed") && what.contains("2 times"))
        );
    }

    #[test]
    fn another_difference_than_the_listed_one_fails() {
        let none = failures(Judge::new()).len();
        let mut judge = Judge::new();
        let scenario = "one 2 minutes ahead, then another stream";
        judge.compare(
            "pymavlink",
            scenario,
            &[false, true],
            &[false, false],
            String::new,
        );
        assert_eq!(failures(judge).len(), none + 1);
    }
}
