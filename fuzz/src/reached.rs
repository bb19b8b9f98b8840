//! Which errors came out: counted when coverage is measured, not when fuzzing.

use std::any::type_name;
use std::collections::BTreeSet;
use std::fmt::Debug;
use std::sync::{Mutex, OnceLock, PoisonError};

static REACHED: OnceLock<Mutex<BTreeSet<String>>> = OnceLock::new();

/// Errors are counted from now on.
pub fn watch() {
    let _ = REACHED.set(Mutex::default());
}

/// The errors so far, such as `VerifyError::BadTag`.
#[must_use]
pub fn errors() -> BTreeSet<String> {
    REACHED.get().map_or_else(BTreeSet::new, |reached| {
        reached
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    })
}

/// Counts the error in `outcome`, if there is one.
pub(crate) fn reached<T, E: Debug>(outcome: Result<T, E>) {
    if let (Some(reached), Err(error)) = (REACHED.get(), outcome) {
        let kind = type_name::<E>();
        let kind = kind.split('<').next().unwrap_or(kind);
        let kind = kind.rsplit("::").next().unwrap_or(kind);
        let error = format!("{error:?}");
        let variant = error.split(|c: char| !c.is_alphanumeric()).next();
        let name = format!("{kind}::{}", variant.unwrap_or_default());
        reached
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(name);
    }
}
