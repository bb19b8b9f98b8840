//! The plays with the firmware that they are for, and with what they must not take for it.

use anyhow::Result;
use mavseal_e2e::{relay, sealed::sealed};

#[test]
fn signer() -> Result<()> {
    relay::signer(&relay::build("relay")?, true)
}

#[test]
fn restart() -> Result<()> {
    relay::restart(&relay::build("relay")?, true)
}

#[test]
fn sealed_link() -> Result<()> {
    sealed(None, false, true)
}

#[test]
fn an_echo_is_no_signer() -> Result<()> {
    let result = relay::signer(&relay::build("echo")?, true);
    fails(result, "a frame left the link side unsigned")
}

#[test]
fn stations_with_other_keys_hear_nothing() -> Result<()> {
    fails(sealed(None, true, true), "from the vehicle: bad tag")
}

/// A play must fail, and for this reason.
fn fails(result: Result<()>, reason: &str) -> Result<()> {
    let error = format!("{:#}", result.expect_err("it must fail"));
    assert!(
        error.contains(reason),
        "it fails for another reason: {error}"
    );
    Ok(())
}
