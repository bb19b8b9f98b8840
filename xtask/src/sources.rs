//! The sources that a run is about: copies to work in, and the folder for its results.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use anyhow::{Context, Result};
use rayon::{ThreadPoolBuilder, current_thread_index, prelude::*};
use regex::Regex;
use serde::{Serialize, de::DeserializeOwned};
use xshell::{Shell, cmd};

use crate::setup::{root, target_dir};

/// All that git tracks, as it is now. Results lie in `target/evidence/TREE`, where TREE is what
/// `git rev-parse HEAD:` says: results of other sources are never found there.
pub(crate) struct Sources {
    /// A commit with them.
    pub(crate) commit: String,
    /// Whether that is the newest commit of the branch.
    pub(crate) committed: bool,
    pub(crate) results: PathBuf,
    target: PathBuf,
}

impl Sources {
    /// Takes changes that are not committed into a commit that no branch has.
    ///
    /// # Errors
    /// If this is no git repository.
    pub(crate) fn now() -> Result<Self> {
        let sh = Shell::new()?;
        sh.change_dir(root());
        let head = cmd!(sh, "git rev-parse HEAD").quiet().read()?;
        let changed = cmd!(sh, "git stash create").quiet().read()?;
        let committed = changed.is_empty();
        let commit = if committed { head } else { changed };
        let tree = cmd!(sh, "git rev-parse {commit}:").quiet().read()?;
        let target = target_dir()?;
        let results = target.join("evidence").join(tree);
        fs::create_dir_all(&results)?;
        Ok(Self {
            commit,
            committed,
            results,
            target,
        })
    }

    /// A copy of them for worker `number`, without what an earlier run changed in it.
    ///
    /// # Errors
    /// If git cannot make it.
    pub(crate) fn worktree(&self, number: usize) -> Result<PathBuf> {
        // One at a time: git locks its list of them.
        static MAKING: Mutex<()> = Mutex::new(());
        let _making = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
        let sh = Shell::new()?;
        sh.change_dir(root());
        let commit = &self.commit;
        let path = self.target.join(format!("worktrees/{number}"));
        if !path.join(".git").exists() {
            cmd!(sh, "git worktree prune").quiet().run()?;
            let add = ["--quiet", "--force", "--detach"];
            let add = cmd!(sh, "git worktree add {add...} {path} {commit}");
            add.quiet().run()?;
        }
        sh.change_dir(&path);
        let checkout = cmd!(sh, "git checkout --quiet --force --detach {commit}");
        checkout.quiet().run()?;
        Ok(path)
    }

    /// Keeps a result in the folder `NAME`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(crate) fn record(&self, name: &str, key: &str, value: &impl Serialize) -> Result<()> {
        let folder = self.results.join(name);
        fs::create_dir_all(&folder)?;
        fs::write(folder.join(key), serde_json::to_string_pretty(value)?)?;
        Ok(())
    }

    /// The results in the folder `NAME`; none if there is no such folder.
    ///
    /// # Errors
    /// If one is not as [`record`](Self::record) writes it.
    pub(crate) fn read<T: DeserializeOwned>(&self, name: &str) -> Result<BTreeMap<String, T>> {
        let folder = self.results.join(name);
        let mut results = BTreeMap::new();
        for file in fs::read_dir(&folder).into_iter().flatten() {
            let key = file?.file_name().to_string_lossy().into_owned();
            results.insert(key.clone(), serde_json::from_str(&text(&folder, &key)?)?);
        }
        Ok(results)
    }
}

/// Has `jobs` workers, numbered from 0, do `work` on `items`; all of them, also after an error.
///
/// # Errors
/// The first of those of `work`.
pub(crate) fn share<T: Send, R: Send>(
    jobs: usize,
    items: Vec<T>,
    work: impl Fn(usize, T) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    let pool = ThreadPoolBuilder::new().num_threads(jobs).build()?;
    // One item at a time, as some take a second and others an hour.
    let items = items.into_par_iter().with_max_len(1);
    let work = |item| work(current_thread_index().unwrap_or(0), item);
    let done: Vec<_> = pool.install(|| items.map(work).collect());
    done.into_iter().collect()
}

/// Today in UTC, as in 2026-01-31.
///
/// # Errors
/// If there is no program `date`.
pub(crate) fn today() -> Result<String> {
    let sh = Shell::new()?;
    Ok(cmd!(sh, "date -u +%F").quiet().read()?)
}

/// What the group of a regular expression matches in `text`, each time; the same again in a row counts once.
pub(crate) fn find_all(pattern: &str, text: &str) -> Vec<String> {
    let pattern = Regex::new(pattern).expect("a pattern");
    let found = pattern.captures_iter(text);
    let mut all: Vec<_> = found.map(|found| found[1].to_owned()).collect();
    all.dedup();
    all
}

/// The first that [`find_all`] finds, or nothing.
pub(crate) fn find(pattern: &str, text: &str) -> String {
    let all = find_all(pattern, text);
    all.into_iter().next().unwrap_or_default()
}

/// The text of a file of the project.
///
/// # Errors
/// If it cannot be read, with its name.
pub(crate) fn text(tree: &Path, file: &str) -> Result<String> {
    fs::read_to_string(tree.join(file)).context(file.to_owned())
}

#[cfg(test)]
mod tests {
    use anyhow::bail;

    use super::*;

    #[test]
    fn every_item_is_done_also_after_an_error() {
        let done = Mutex::new(Vec::new());
        let work = |_, item: u32| {
            done.lock().expect("not poisoned").push(item);
            if item == 2 { bail!("two") } else { Ok(()) }
        };
        assert!(share(3, vec![1, 2, 3, 4, 5], work).is_err());
        let mut done = done.into_inner().expect("not poisoned");
        done.sort_unstable();
        assert_eq!(done, [1, 2, 3, 4, 5]);
    }
}
