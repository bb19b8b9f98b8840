//! Copies of the sources to work on, so that a run neither sees nor makes changes in the project.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, ensure};

/// A copy of the project as it was when the run began; the workers' copies are made from it.
pub(crate) struct Snapshot {
    folder: PathBuf,
}

/// A worker's own copy, and its own places to build in.
pub(crate) struct Workshop {
    pub(crate) tree: PathBuf,
    /// For `cargo kani`.
    pub(crate) kani: PathBuf,
    /// For `cargo test`.
    pub(crate) test: PathBuf,
}

impl Snapshot {
    /// Copies what git tracks, or would, in `root` to a folder in `target`.
    ///
    /// # Errors
    /// If `root` is no git repository, or a file cannot be copied.
    pub(crate) fn take(root: &Path, target: &Path) -> Result<Self> {
        let mut git = Command::new("git");
        git.current_dir(root);
        git.args(["ls-files", "-z", "-co", "--exclude-standard"]);
        let output = git.output().context("git")?;
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "git ls-files: {said}");
        let names = String::from_utf8(output.stdout)?;
        let names = names.split_terminator('\0').map(PathBuf::from);
        // A file may be listed that has been deleted and not yet committed.
        let names = names.filter(|name| root.join(name).is_file()).collect();
        let folder = target.join("proofs");
        mirror(root, &names, &folder.join("snapshot"))?;
        Ok(Self { folder })
    }

    /// The copy.
    pub(crate) fn tree(&self) -> PathBuf {
        self.folder.join("snapshot")
    }

    /// The copy of worker `number`, which may have built there before.
    pub(crate) fn workshop(&self, number: usize) -> Result<Workshop> {
        let folder = self.folder.join(number.to_string());
        let workshop = Workshop {
            tree: folder.join("tree"),
            kani: folder.join("kani"),
            test: folder.join("test"),
        };
        self.restore(&workshop)?;
        Ok(workshop)
    }

    /// Undoes all changes in a worker's copy.
    pub(crate) fn restore(&self, workshop: &Workshop) -> Result<()> {
        mirror(&self.tree(), &files(&self.tree())?, &workshop.tree)
    }
}

/// Makes `to` hold the files `names` of `from` and no others. What is the same already is not
/// touched, so that cargo does not build it again.
fn mirror(from: &Path, names: &BTreeSet<PathBuf>, to: &Path) -> Result<()> {
    fs::create_dir_all(to)?;
    for name in files(to)?.difference(names) {
        fs::remove_file(to.join(name)).with_context(|| name.display().to_string())?;
    }
    for name in names {
        let content = fs::read(from.join(name)).with_context(|| name.display().to_string())?;
        let path = to.join(name);
        if fs::read(&path).is_ok_and(|present| present == content) {
            continue;
        }
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        fs::write(&path, content).with_context(|| path.display().to_string())?;
    }
    Ok(())
}

/// Every file below `folder`, as a path from there.
///
/// # Errors
/// If a folder cannot be read.
pub(crate) fn files(folder: &Path) -> Result<BTreeSet<PathBuf>> {
    let mut files = BTreeSet::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(&next).with_context(|| next.display().to_string())? {
            let path = entry?.path();
            if path.is_dir() {
                open.push(path);
            } else {
                files.insert(path.strip_prefix(folder)?.to_owned());
            }
        }
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mirror_has_the_same_files_and_leaves_the_same_ones_alone() -> Result<()> {
        let folder = std::env::temp_dir().join(format!("mavseal-mirror-{}", std::process::id()));
        let (from, to) = (folder.join("from"), folder.join("to"));
        fs::create_dir_all(from.join("a"))?;
        fs::write(from.join("a/same"), "1")?;
        fs::write(from.join("other"), "2")?;
        mirror(&from, &files(&from)?, &to)?;
        let modified = || fs::metadata(to.join("a/same"))?.modified();
        let before = modified()?;
        fs::write(to.join("other"), "changed")?;
        fs::write(to.join("added"), "")?;
        mirror(&from, &files(&from)?, &to)?;
        assert_eq!(files(&to)?, files(&from)?);
        assert_eq!(fs::read_to_string(to.join("other"))?, "2");
        assert_eq!(modified()?, before);
        fs::remove_dir_all(folder)?;
        Ok(())
    }
}
