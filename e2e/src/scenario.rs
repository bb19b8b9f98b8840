//! What a play is made of: a device, phases, what they send and what must become of it.

use anyhow::Result;

/// A side of a device, by its port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// UART 0: equipment that cannot sign or seal.
    Local,
    /// UART 1: the radio.
    Link,
}

/// The firmware of a play, as its peers see it.
pub trait Device {
    /// What the tables call frames that pass, by the side that they were sent into.
    const PASSED: [&'static str; 2];

    /// Takes a line of the log since the start; gives whether the firmware is ready.
    ///
    /// # Errors
    ///
    /// If it does not start as it must.
    fn started(&mut self, line: &str) -> Result<bool>;

    /// Takes bytes that came out of `side`. What they say, without signature or seal, is added to `out`, and an
    /// answer to `reply`. It is sent if the firmware has nothing else of this side to look at.
    ///
    /// # Errors
    ///
    /// If they are not signed or sealed as they must be.
    fn open(
        &mut self,
        side: Side,
        bytes: &[u8],
        out: &mut Vec<u8>,
        reply: &mut Vec<u8>,
    ) -> Result<()>;

    /// Whether the next step may be taken.
    fn is_ready(&self) -> bool {
        true
    }

    /// How the lines begin that the log has when all is done, with what has become of the frames since the
    /// start, by the side that they were sent into.
    fn counters(&self, counts: [Counts; 2]) -> Vec<String>;

    /// Prepares for a reset; gives what is to be on its way into each side then.
    fn reset(&mut self) -> [Vec<u8>; 2];

    /// The board has been reset: what was in its memory alone is gone.
    fn was_reset(&mut self) {}
}

/// What becomes of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// They come out on the other side.
    pub passed: usize,
    /// The log has a reason.
    pub rejected: usize,
}

/// What air has done to frames on their way.
#[derive(Clone, Copy, Debug)]
pub struct InAir {
    /// How many were sent.
    pub sent: usize,
    /// How many never arrive.
    pub lost: usize,
    /// How many arrive twice.
    pub doubled: usize,
}

/// A line of a table: frames of one kind.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// Who gets them.
    pub to: &'static str,
    /// What they are.
    pub name: String,
    /// What came before they arrived, if they went through air.
    pub air: Option<InAir>,
    /// What becomes of those that arrive.
    pub counts: Counts,
    /// Why frames are rejected.
    pub because: &'static str,
}

impl Row {
    /// One without frames.
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            ..Self::default()
        }
    }
}

/// What must become of a frame: these bytes come out on the other side, or it is rejected with this reason.
pub type Verdict = Result<Vec<u8>, &'static str>;

/// A frame, or bytes that are sent together.
#[derive(Debug)]
pub(crate) struct Sent {
    pub(crate) into: Side,
    pub(crate) row: usize,
    pub(crate) bytes: Vec<u8>,
    pub(crate) verdict: Verdict,
    /// Nothing follows before the firmware has counted it, and the lines were silent.
    pub(crate) alone: bool,
}

/// What a step sends, and what it has found out.
#[derive(Debug, Default)]
pub struct Sending {
    pub(crate) rows: Vec<Row>,
    pub(crate) frames: Vec<Sent>,
    pub(crate) lines: Vec<&'static str>,
}

impl Sending {
    /// Adds a row; gives its number. It may have been judged already, by a peer.
    pub fn row(&mut self, row: Row) -> usize {
        self.rows.push(row);
        self.rows.len() - 1
    }

    /// Adds a frame to a row.
    pub fn frame(&mut self, into: Side, row: usize, bytes: Vec<u8>, verdict: Verdict) {
        let row_of = &mut self.rows[row];
        row_of.to = match into {
            Side::Local => "local side",
            Side::Link => "link side",
        };
        match verdict {
            Ok(_) => row_of.counts.passed += 1,
            Err(because) => {
                row_of.counts.rejected += 1;
                row_of.because = because;
            }
        }
        self.frames.push(Sent {
            into,
            row,
            bytes,
            verdict,
            alone: false,
        });
    }

    /// Adds a row of frames that must pass, each with what must come out.
    pub fn passes<F>(&mut self, into: Side, name: &str, frames: F)
    where
        F: IntoIterator<Item = (Vec<u8>, Vec<u8>)>,
    {
        let frames = frames.into_iter().map(|(bytes, out)| (bytes, Ok(out)));
        self.frames(into, name, frames);
    }

    /// Adds a row of frames that must be rejected.
    pub fn rejected<F>(&mut self, into: Side, name: &str, because: &'static str, frames: F)
    where
        F: IntoIterator<Item = Vec<u8>>,
    {
        let frames = frames.into_iter().map(|bytes| (bytes, Err(because)));
        self.frames(into, name, frames);
    }

    /// Adds a row of bytes that must be rejected as one, each in a silence: what the firmware cannot read as packets
    /// makes its local side deaf until there is one.
    pub fn unreadable<F>(&mut self, name: &str, because: &'static str, bytes: F)
    where
        F: IntoIterator<Item = Vec<u8>>,
    {
        let first = self.frames.len();
        self.rejected(Side::Local, name, because, bytes);
        for sent in &mut self.frames[first..] {
            sent.alone = true;
        }
    }

    fn frames(&mut self, into: Side, name: &str, frames: impl Iterator<Item = (Vec<u8>, Verdict)>) {
        let row = self.row(Row::new(name));
        for (bytes, verdict) in frames {
            self.frame(into, row, bytes, verdict);
        }
    }

    /// The firmware must log this line.
    pub fn says(&mut self, line: &'static str) {
        self.lines.push(line);
    }
}

/// Adds what is sent.
pub type Step<D> = Box<dyn FnOnce(&mut D, &mut Sending) -> Result<()>>;

/// A part of a play, with a table of its own.
pub struct Phase<D> {
    pub(crate) title: String,
    pub(crate) reset: bool,
    pub(crate) steps: Vec<Step<D>>,
}

impl<D> Phase<D> {
    /// One in which nothing happens yet.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            reset: false,
            steps: Vec::new(),
        }
    }

    /// It begins with a reset of the board.
    #[must_use]
    pub fn reset(mut self) -> Self {
        self.reset = true;
        self
    }

    /// Then this is sent, into both sides at once, and what must come out and be logged is awaited.
    #[must_use]
    pub fn step(mut self, step: impl FnOnce(&mut D, &mut Sending) -> Result<()> + 'static) -> Self {
        self.steps.push(Box::new(step));
        self
    }
}
