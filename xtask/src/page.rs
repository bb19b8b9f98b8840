//! Parts of a page that a tool writes, between two lines that mark them.

use std::{fmt::Write as _, fs, path::Path};

use anyhow::{Context, Result, bail, ensure};

/// The page with all of them.
const PAGE: &str = "verification.md";

/// verification.md, and the part of it between `<!-- name:begin -->` and `<!-- name:end -->`.
pub(crate) struct Page {
    text: String,
    begin: usize,
    end: usize,
}

impl Page {
    /// Finds the part `name`.
    ///
    /// # Errors
    /// If the page has no place for it.
    pub(crate) fn load(root: &Path, name: &str) -> Result<Self> {
        let text = fs::read_to_string(root.join(PAGE)).context(PAGE)?;
        let [first, last] = ["begin", "end"].map(|edge| format!("<!-- {name}:{edge} -->\n"));
        let begin = text.find(&first).map(|at| at + first.len());
        let end = text.find(&last);
        let (Some(begin), Some(end)) = (begin, end.filter(|end| Some(*end) >= begin)) else {
            bail!("{PAGE} needs these two lines:\n{first}{last}");
        };
        Ok(Self { text, begin, end })
    }

    /// Has the part say `part`.
    ///
    /// # Errors
    /// If the page cannot be written.
    pub(crate) fn write(&self, root: &Path, part: &str) -> Result<()> {
        if part == self.part() {
            return Ok(());
        }
        let (before, after) = (&self.text[..self.begin], &self.text[self.end..]);
        fs::write(root.join(PAGE), [before, part, after].concat()).context(PAGE)
    }

    /// Whether the part says `part`.
    ///
    /// # Errors
    /// If it does not, with the `command` that has it say so.
    pub(crate) fn check(&self, part: &str, verb: &str) -> Result<()> {
        ensure!(
            part == self.part(),
            "{PAGE} does not say what sources and results say: run again, or have it say so with \
             `{verb}`"
        );
        Ok(())
    }

    fn part(&self) -> &str {
        &self.text[self.begin..self.end]
    }
}

/// Appends a row of a table.
pub(crate) fn row(text: &mut String, cells: &[&str]) {
    for cell in cells {
        let cell = cell.split_whitespace().collect::<Vec<_>>().join(" ");
        let _ = write!(text, "| {} ", cell.replace('|', "\\|"));
    }
    text.push_str("|\n");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_stay_in_their_row() {
        let mut text = String::new();
        row(&mut text, &["a|b", "two\nlines"]);
        assert_eq!(text, "| a\\|b | two lines |\n");
    }
}
