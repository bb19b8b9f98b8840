//! pymavlink, in a process of its own.

use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
};

use anyhow::{Context, Result, bail, ensure};

use super::{Order, Peer};
use crate::hex;

pub(crate) struct Pymavlink {
    child: Child,
    orders: ChildStdin,
    answers: BufReader<ChildStdout>,
    version: String,
}

impl Pymavlink {
    pub(crate) fn start(python: &Path, dialect: &Path, key: &[u8; 32]) -> Result<Self> {
        let ask = "import importlib.metadata as m; print(m.version('pymavlink'))";
        let version = Command::new(python).args(["-c", ask]).output()?;
        ensure!(
            version.status.success(),
            "{} has no pymavlink",
            python.display()
        );
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/python/peer.py");
        let mut child = Command::new(python)
            .arg(script)
            .arg(dialect)
            .arg(hex::encode(key))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| python.display().to_string())?;
        Ok(Self {
            orders: child.stdin.take().context("the peer's input")?,
            answers: BufReader::new(child.stdout.take().context("the peer's output")?),
            child,
            version: String::from_utf8(version.stdout)?.trim().to_owned(),
        })
    }

    /// The bytes of payload of each message, as pymavlink has them.
    pub(crate) fn sizes(&mut self) -> Result<BTreeMap<u32, usize>> {
        let answer = self.ask("sizes")?;
        let size = |word: &str| {
            let (id, size) = word.split_once(':').context("a size")?;
            Ok((id.parse()?, size.parse()?))
        };
        answer.split(' ').map(size).collect()
    }

    fn ask(&mut self, order: &str) -> Result<String> {
        writeln!(self.orders, "{order}")?;
        let mut answer = String::new();
        if self.answers.read_line(&mut answer)? == 0 {
            bail!("pymavlink ended at: {order}");
        }
        Ok(answer.trim_end().to_owned())
    }
}

impl Peer for Pymavlink {
    fn name(&self) -> &'static str {
        "pymavlink"
    }

    fn version(&self) -> &str {
        &self.version
    }

    fn sign(&mut self, order: &Order) -> Result<Vec<u8>> {
        let Order {
            sequence,
            system_id,
            component_id,
            link_id,
            ticks,
            ..
        } = order;
        let (id, payload) = (order.message.id, hex::encode(order.payload));
        hex::decode(&self.ask(&format!(
            "sign {link_id} {ticks} {sequence} {system_id} {component_id} {id} {payload}"
        ))?)
    }

    fn restart(&mut self, ticks: u64) -> Result<()> {
        self.ask(&format!("restart {ticks}")).map(drop)
    }

    fn accepts(&mut self, frame: &[u8]) -> Result<bool> {
        match self
            .ask(&format!("accepts {}", hex::encode(frame)))?
            .as_str()
        {
            "yes" => Ok(true),
            "no" => Ok(false),
            other => bail!("pymavlink says {other}"),
        }
    }
}

impl Drop for Pymavlink {
    fn drop(&mut self) {
        // It ends by itself when nobody gives it orders; this is for one that hangs.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
