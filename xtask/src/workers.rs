//! Work that is done by several threads at a time.

use std::{
    sync::{Mutex, PoisonError},
    thread,
};

use anyhow::{Result, bail};

/// Runs `jobs` workers, numbered from 0, each to its end; the first error of all, if there is one.
///
/// # Errors
/// Those of the workers.
pub(crate) fn run(jobs: usize, worker: impl Fn(usize) -> Result<()> + Sync) -> Result<()> {
    let worker = &worker;
    thread::scope(|scope| {
        let workers: Vec<_> = (0..jobs)
            .map(|number| scope.spawn(move || worker(number)))
            .collect();
        let mut outcome = Ok(());
        for worker in workers {
            match worker.join() {
                Ok(ended) => outcome = outcome.and(ended),
                Err(_) => bail!("a worker panicked"),
            }
        }
        outcome
    })
}

/// Has workers, each with a place of its own to work in, do `work` on `items` in order; all of them, also
/// after an error.
///
/// # Errors
/// The first one of all.
pub(crate) fn share<T: Send, Place>(
    jobs: usize,
    items: Vec<T>,
    place: impl Fn(usize) -> Result<Place> + Sync,
    work: impl Fn(&Place, T) -> Result<()> + Sync,
) -> Result<()> {
    let jobs = jobs.min(items.len());
    let items = Mutex::new(items.into_iter());
    run(jobs, |number| {
        let place = place(number)?;
        let mut outcome = Ok(());
        loop {
            let item = items.lock().unwrap_or_else(PoisonError::into_inner).next();
            let Some(item) = item else {
                return outcome;
            };
            outcome = outcome.and(work(&place, item));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_item_is_done_also_after_an_error() {
        let done = Mutex::new(Vec::new());
        let work = |_: &usize, item: u32| {
            done.lock().expect("not poisoned").push(item);
            if item == 2 { bail!("two") } else { Ok(()) }
        };
        assert!(share(3, vec![1, 2, 3, 4, 5], Ok, work).is_err());
        let mut done = done.into_inner().expect("not poisoned");
        done.sort_unstable();
        assert_eq!(done, [1, 2, 3, 4, 5]);
    }
}
