//! pymavlink, in a process of its own.

use std::{collections::BTreeMap, path::Path};

use anyhow::{Context, Result, bail};

use super::{Order, Peer};
use crate::{hex, script::Script};

pub(crate) struct Pymavlink(Script);

impl Pymavlink {
    pub(crate) fn start(python: &Path, dialect: &Path, key: &[u8; 32]) -> Result<Self> {
        let dialect = dialect.to_str().context("a path of Unicode")?;
        let key = hex::encode(key);
        let script = Script::start(python, "pymavlink", "peer.py", [dialect, &key])?;
        Ok(Self(script))
    }

    /// The bytes of payload of each message, as pymavlink has them.
    pub(crate) fn sizes(&mut self) -> Result<BTreeMap<u32, usize>> {
        let answer = self.0.ask("sizes")?;
        let size = |word: &str| {
            let (id, size) = word.split_once(':').context("a size")?;
            Ok((id.parse()?, size.parse()?))
        };
        answer.split(' ').map(size).collect()
    }
}

impl Peer for Pymavlink {
    fn name(&self) -> &'static str {
        "pymavlink"
    }

    fn version(&self) -> &str {
        &self.0.version
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
        hex::decode(&self.0.ask(&format!(
            "sign {link_id} {ticks} {sequence} {system_id} {component_id} {id} {payload}"
        ))?)
    }

    fn restart(&mut self, ticks: u64) -> Result<()> {
        self.0.ask(&format!("restart {ticks}")).map(drop)
    }

    fn accepts(&mut self, frame: &[u8]) -> Result<bool> {
        match self
            .0
            .ask(&format!("accepts {}", hex::encode(frame)))?
            .as_str()
        {
            "yes" => Ok(true),
            "no" => Ok(false),
            other => bail!("pymavlink says {other}"),
        }
    }
}
