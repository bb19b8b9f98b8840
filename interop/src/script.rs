//! A peer in Python, in a process of its own: one order a line in, one answer a line out.

use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Child, ChildStdin, ChildStdout, Stdio},
};

use anyhow::{Context, Result, bail};

use crate::python;

pub(crate) struct Script {
    child: Child,
    orders: ChildStdin,
    answers: BufReader<ChildStdout>,
    /// The version of the package that it is about.
    pub(crate) version: String,
}

impl Script {
    /// Starts `script` of the folder `python/`, with a Python that has `package`.
    pub(crate) fn start<'a>(
        python: &Path,
        package: &str,
        script: &str,
        arguments: impl IntoIterator<Item = &'a str>,
    ) -> Result<Self> {
        let version = python::version(python, package)?;
        let mut child = python::script(python, script)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| python.display().to_string())?;
        Ok(Self {
            orders: child.stdin.take().context("the peer's input")?,
            answers: BufReader::new(child.stdout.take().context("the peer's output")?),
            child,
            version,
        })
    }

    pub(crate) fn ask(&mut self, order: &str) -> Result<String> {
        writeln!(self.orders, "{order}")?;
        let mut answer = String::new();
        if self.answers.read_line(&mut answer)? == 0 {
            bail!("the peer ended at: {order}");
        }
        Ok(answer.trim_end().to_owned())
    }
}

impl Drop for Script {
    fn drop(&mut self) {
        // It ends by itself when nobody gives it orders; this is for one that hangs.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
