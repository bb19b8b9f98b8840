//! What the runner of plays and the machine promise, with firmware that is as it must be.

use std::{
    env, fs,
    net::{TcpListener, TcpStream},
    path::Path,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, ensure};
use mavseal_e2e::{
    Machine, Phase, Side,
    relay::{self, Relay},
    scenario::Sending,
    wire,
};

const CHIPS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../chips");

/// The error of a play in which telemetry is expected to end like this.
fn error_of(expect: fn(&mut Sending, Vec<wire::Frame>)) -> Result<String> {
    let mut telemetry = wire::telemetry()?;
    telemetry.retain(|frame| frame[5] == 1);
    let phase = Phase::new("control").step(move |_, sending| {
        expect(sending, telemetry[..25].to_vec());
        Ok(())
    });
    let result = mavseal_e2e::run(Relay::new()?, &relay::build("relay")?, vec![phase], true);
    Ok(format!("{:#}", result.err().context("the play must fail")?))
}

#[test]
fn a_frame_that_passes_and_must_not_is_noticed() -> Result<()> {
    let error = error_of(|sending, telemetry| {
        sending.rejected(Side::Local, "telemetry", "bad tag", telemetry);
    })?;
    assert!(error.contains("came out that must not"), "{error}");
    Ok(())
}

#[test]
fn another_reason_is_noticed() -> Result<()> {
    let error = error_of(|sending, telemetry| {
        sending.rejected(Side::Link, "unsigned", "bad tag", telemetry);
    })?;
    assert!(
        error.contains("unsigned: rejected because not signed, not because bad tag"),
        "{error}"
    );
    Ok(())
}

#[test]
fn another_frame_is_noticed() -> Result<()> {
    let error = error_of(|sending, telemetry| {
        let others: Vec<_> = telemetry.iter().rev().cloned().collect();
        sending.passes(Side::Local, "telemetry", telemetry.into_iter().zip(others));
    })?;
    assert!(
        error.contains("telemetry: another frame came out"),
        "{error}"
    );
    Ok(())
}

/// The smallest firmware prints what is committed beside it, run as a developer runs it.
#[test]
fn signing_demo() -> Result<()> {
    let chips = Path::new(CHIPS);
    let expected = fs::read_to_string(chips.join("demo/demo.out"))?;
    let mut cargo = Command::new("cargo");
    cargo
        .args(["run", "--locked", "--release"])
        .current_dir(chips.join("qemu-m7"));
    // What this test's own cargo has set.
    for (name, _) in env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("CARGO_"))
    {
        cargo.env_remove(name);
    }
    let output = cargo.stderr(Stdio::inherit()).output()?;
    assert_eq!(String::from_utf8_lossy(&output.stdout), expected);
    assert!(output.status.success());
    Ok(())
}

/// QEMU ends with what has started it, also when that is killed.
#[test]
fn no_machine_is_left_over() -> Result<()> {
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let mut run = Command::new(env!("CARGO_BIN_EXE_run-qemu"));
    run.arg("--serial")
        .arg(port.to_string())
        .arg(relay::build("echo")?);
    let mut run = run.stdout(Stdio::null()).spawn()?;
    let is_there = || TcpStream::connect(("127.0.0.1", port)).is_ok();
    let started = within(Duration::from_secs(20), is_there);
    run.kill()?;
    run.wait()?;
    ensure!(started, "QEMU does not start");
    ensure!(
        within(Duration::from_secs(5), || !is_there()),
        "QEMU is left over"
    );
    Ok(())
}

fn within(time: Duration, done: impl Fn() -> bool) -> bool {
    let start = Instant::now();
    while start.elapsed() < time {
        if done() {
            return true;
        }
        thread::sleep(Duration::from_millis(50));
    }
    false
}

#[test]
fn another_file_is_no_firmware() {
    let file = Path::new(CHIPS).join("demo/demo.key");
    let result = Machine::launch(&file, &[], &[], |_| {});
    let error = result.err().map(|error| error.to_string());
    assert!(error.is_some_and(|error| error.ends_with("demo.key is not an ELF file")));
}
