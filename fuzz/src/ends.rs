//! Target: one end of a sealed link, over restarts, between ports and flashes that fail.

use std::collections::BTreeSet;
use std::time::Duration;

use arbitrary::Arbitrary;
use mavlink_commsec::field::{KEY_SIZE, PACKAGE_SIZE, PLAINTEXT_SIZE};
use mavlink_commsec::radio::Status;
use mavlink_commsec::{
    AesGcm, Cipher, CipherError, Credential, Nonce, Opener, PackageTag, Plaintext, Sealer,
    SenderId, ZeroizeOnDrop, hx, hx::FrameKind, packets,
};
use mavlink_signing::{TICKS_PER_SECOND, Timestamp};
use mavseal_relay::sealed::{
    ACCEPTED_KIND, HighWaterMarks, MAX_AGE, MAX_LEAD, Radio, SENT_KIND, SealedCounters,
    SealedEndpoint, SealedEvent, SealedRejectReason,
};
use mavseal_relay::{Direction, adapter};
use mavseal_store::{Binding, HighWaterMark};

use crate::flash::{REGION, Shared};
use crate::ports::{Behaviour, Fault, Port, is_due};
use crate::repair;

/// The end, its two peers, and one that it does not know.
const OWN: Credential = credential(7, 1);
const PEERS: [Credential; 2] = [credential(5, 2), credential(6, 3)];
const UNKNOWN: Credential = credential(9, 4);
/// When it all begins, in ticks: late enough for a clock whose counters have come to their end.
const START: u64 = 1 << 43;
/// The first byte of a key with which nothing can be sealed.
const BROKEN: u8 = 0xEE;

const fn credential(id: u32, byte: u8) -> Credential {
    Credential {
        id: SenderId(id),
        key: [byte; KEY_SIZE],
        salt: 0x4353,
    }
}

/// AES-128-GCM that fails to seal packages with some keys.
struct Unit {
    cipher: AesGcm,
    broken: bool,
}

// The one secret wipes itself.
impl ZeroizeOnDrop for Unit {}

impl Cipher for Unit {
    fn new(key: &[u8; KEY_SIZE]) -> Self {
        Self {
            cipher: AesGcm::new(key),
            broken: key[0] == BROKEN,
        }
    }

    fn seal(&self, nonce: &Nonce, message: &mut Plaintext) -> Result<PackageTag, CipherError> {
        // Not for the fingerprint, without which there is no end.
        if self.broken && nonce[8..] != [0xFF; 4] {
            return Err(CipherError);
        }
        self.cipher.seal(nonce, message)
    }

    fn open(
        &self,
        nonce: &Nonce,
        message: &mut Plaintext,
        tag: &PackageTag,
    ) -> Result<(), CipherError> {
        self.cipher.open(nonce, message, tag)
    }
}

/// A step: what arrives or happens, then a turn of the end.
#[derive(Arbitrary, Clone, Copy, Debug)]
pub struct Stage {
    /// 0: a HEARTBEAT on the local side; 1: a TUNNEL of `of` bytes of payload; 2 and 3: `of` of the
    /// bytes on the local side, in the air; 4 and 5: a package of a peer with a TUNNEL; 6: one of a
    /// stranger; 7: the package of `of` before; 8: one of the first peer with byte `of` changed, counted
    /// round; 9: one of `of` of the bytes; 10 and 11: a frame of `of` of the bytes, air and radio data;
    /// 12: an answer of the radio; 13: a restart; 14 and 15: flash `of` modulo 3 loses its power after
    /// `of` / 4 steps, or rejects; anything else: nothing.
    pub kind: u8,
    /// See `kind`.
    pub of: u8,
    /// Time since the step before, in 40 microseconds.
    pub ticks: u16,
    /// What the local and the radio's port do; 255 bytes are all there are.
    pub ports: [Behaviour; 2],
}

/// An end, and all that happens to it.
#[derive(Arbitrary, Clone, Debug)]
pub struct Ends<'a> {
    /// Whether it is a station.
    pub station: bool,
    /// Whether its cipher is broken.
    pub broken: bool,
    /// Whether counters follow the clock, which begins where the peers' counters do.
    pub clocked: bool,
    /// What is left to chance: how a cut leaves words.
    pub chance: i64,
    /// Where its own counters begin, and those of both peers.
    pub first: [u32; 2],
    /// How long a packet waits for others, in milliseconds.
    pub max_delay: u8,
    /// In order.
    pub stages: Vec<Stage>,
    /// What some of them take bytes from.
    pub bytes: &'a [u8],
}

/// All that will arrive, and how much of it in each stage, from the local side and from the radio.
#[derive(Default)]
struct Script {
    local: Vec<u8>,
    air: Vec<u8>,
    lengths: Vec<[usize; 2]>,
    /// What the peers sealed.
    sealed: Vec<(SenderId, u32, Plaintext)>,
}

fn tunnel(length: u8, serial: u8) -> Vec<u8> {
    let length = length.max(1);
    let mut packet = vec![0xFD, length, 0, 0, serial, 1, 1, 0x81, 0x01, 0];
    packet.resize(10 + usize::from(length), serial | 1);
    let sum = repair::checksum(&packet[1..], 147);
    packet.extend(sum.to_le_bytes());
    packet
}

const HEARTBEAT: [u8; 17] = [0xFE, 9, 78, 1, 1, 0, 5, 0, 0, 0, 2, 3, 81, 4, 3, 0xA7, 0xE3];

impl Script {
    fn of(input: &Ends<'_>, stages: &[Stage]) -> Self {
        let mut script = Self::default();
        let first = input.first[1];
        let mut sealers = [&PEERS[0], &PEERS[1], &UNKNOWN].map(|credential| {
            let key = credential.prepare().expect("a key");
            Sealer::<AesGcm>::resume(key, credential.id, first)
        });
        let mut packages: Vec<Vec<u8>> = Vec::new();
        let mut rest = input.bytes;
        for (Stage { kind, of, .. }, serial) in stages.iter().zip(1..) {
            let before = [script.local.len(), script.air.len()];
            let mut some = || {
                let (some, others) = rest.split_at(rest.len().min((*of).into()));
                rest = others;
                some.to_vec()
            };
            let mut seal = |which: usize, text: &[u8]| {
                let mut message = [0; PLAINTEXT_SIZE];
                for (byte, text) in message.iter_mut().zip(text) {
                    *byte = *text;
                }
                let counter = sealers[which].next_counter()?;
                let package = sealers[which].seal(&message).ok()?.as_bytes().to_vec();
                script.sealed.push((sealers[which].id(), counter, message));
                packages.push(package.clone());
                Some(package)
            };
            let payload = match kind {
                4..=6 => seal(usize::from(kind - 4), &tunnel(of % 68, serial)),
                7 => packages.iter().nth_back((*of).into()).cloned(),
                8 => seal(0, &tunnel(9, serial)).map(|mut package| {
                    package[usize::from(*of) % PACKAGE_SIZE] ^= 0x10;
                    package
                }),
                9 => seal(0, &some()),
                10 | 11 => Some(some()),
                12 => {
                    let (rssi, others) = (*of, Status::default());
                    Some(Status { rssi, ..others }.to_wire().to_vec())
                }
                _ => None,
            };
            let tag = [FrameKind::AirData, FrameKind::Radio][usize::from(*kind >= 11)];
            match kind {
                0 => script.local.extend(HEARTBEAT),
                1 => script.local.extend(tunnel(*of, serial)),
                2 => script.local.extend(some()),
                3 => script.air.extend(some()),
                _ => {
                    let payload = payload.unwrap_or_default();
                    let frame = hx::Frame::new(tag, &payload).into_iter();
                    script.air.extend(frame.flat_map(|frame| frame.encode()));
                }
            }
            let lengths = [script.local.len() - before[0], script.air.len() - before[1]];
            script.lengths.push(lengths);
        }
        script
    }
}

/// What has been seen of an end since it was switched on.
#[derive(Default)]
struct Seen {
    /// Packages and packets, sealed and opened.
    packages: [u32; 2],
    packets: [u32; 2],
    rejected: [Vec<SealedRejectReason>; 2],
    /// Statuses of the radio that were told.
    told: u8,
    /// What goes to the local side.
    to_local: Vec<u8>,
}

/// No counter is used and no package opened twice, over all restarts; with a clock, none is far from it; what comes out was sealed by a peer, or
/// came in on the local side, whole; every count is that of what was observed.
pub fn sealed_end(input: Ends<'_>) {
    let stages = &input.stages[..input.stages.len().min(200)];
    let script = Script::of(&input, stages);
    let flashes = [0, 1, 2].map(|at| Shared::new(input.chance.wrapping_add(at)));
    let [first, first_of_peers] = input.first;
    provisioned(&input, &flashes);
    let (mut local, mut air) = (Port::new(&script.local), Port::new(&script.air));
    let mut due = [0; 2];
    let mut now = START;
    // Above everything that was used.
    let mut used = 0;
    let mut last = first.saturating_sub(1);
    let mut accepted = [BTreeSet::new(), BTreeSet::new()];
    let mut stages = stages.iter().zip(&script.lengths).peekable();
    while stages.peek().is_some() {
        let mut end = switched_on(&input, &flashes);
        let mut seen = Seen::default();
        for (stage, lengths) in stages.by_ref() {
            now += 4 * u64::from(stage.ticks);
            let flash = &flashes[usize::from(stage.of % 3)];
            match stage.kind {
                13 => break,
                14 => flash.with(|flash| flash.cut_after((stage.of / 4).into())),
                15 => flash.with(|flash| flash.fail(u8::MAX)),
                _ => {}
            }
            let faults = stage.ports.map(|port| Fault::from(port.fault));
            let all = |bytes| match bytes {
                u8::MAX => usize::MAX,
                bytes => bytes.into(),
            };
            for (which, port) in [&mut local, &mut air].into_iter().enumerate() {
                due[which] += lengths[which];
                let arrive = all(stage.ports[which].arrive).min(due[which]);
                due[which] -= arrive;
                port.turn(arrive, all(stage.ports[which].room), faults[which]);
            }
            for _ in 0..1000 {
                let mut events = Vec::new();
                let mut clock = Timestamp::from_ticks(now).expect("48 bits");
                let mut observe = |event| events.push(event);
                let polled =
                    adapter::poll(&mut end, &mut local, &mut air, &mut clock, &mut observe);
                for event in events {
                    match event {
                        SealedEvent::Sealed(counter) => {
                            assert!(u64::from(counter) >= used, "a counter is used twice");
                            let clock = clock_of(first_of_peers, now);
                            let ahead = u64::from(counter).saturating_sub(clock);
                            assert!(!input.clocked || ahead <= MAX_LEAD.into());
                            used = u64::from(counter) + 1;
                            seen.packages[0] += 1;
                        }
                        SealedEvent::Packed => seen.packets[0] += 1,
                        SealedEvent::Opened(sender, counter) => {
                            let clock = clock_of(first_of_peers, now);
                            let age = clock.abs_diff(counter.into());
                            assert!(!input.clocked || age <= MAX_AGE.into());
                            opened(&script, sender, counter, &mut accepted, &mut seen);
                        }
                        SealedEvent::Radio(status) if input.station => {
                            seen.to_local.extend(status.gcs_radio(seen.told));
                            seen.told = seen.told.wrapping_add(1);
                        }
                        SealedEvent::Radio(_) => {}
                        SealedEvent::Rejected(Direction::Outbound, it) => seen.rejected[0].push(it),
                        SealedEvent::Rejected(Direction::Inbound, it) => seen.rejected[1].push(it),
                    }
                }
                let moved = polled.moved();
                let failed = polled.outbound.is_err() || polled.inbound.is_err();
                for (direction, from, to) in [
                    (polled.outbound, faults[0], faults[1]),
                    (polled.inbound, faults[1], faults[0]),
                ] {
                    if let Err(error) = direction {
                        assert!(is_due(&error, from, to), "{error}");
                    }
                }
                if failed || !moved {
                    break;
                }
            }
        }
        adds_up(end.sealed(), 0, &seen);
        adds_up(end.opened(), 1, &seen);
        // The rest of it is lost with the power.
        let to_local = std::mem::take(&mut local.output);
        assert!(seen.to_local.starts_with(&to_local));
        let to_air = std::mem::take(&mut air.output);
        left(&input, &script.local, &to_air, &mut last);
        flashes.iter().for_each(Shared::restart);
    }
}

fn switched_on(input: &Ends<'_>, flashes: &[Shared; 3]) -> SealedEndpoint<Shared, 2, Unit> {
    let own = own(input);
    let place = |at: usize| (flashes[at].clone(), REGION);
    let accepted = [place(1), place(2)];
    let marks = HighWaterMarks::open::<Unit>(&own, &PEERS, place(0), accepted);
    let vehicle = Radio::Vehicle {
        system_id: 1,
        component_id: 68,
    };
    let radio = [vehicle, Radio::Station][usize::from(input.station)];
    let max_delay = Duration::from_millis(input.max_delay.into());
    let marks = marks.expect("provisioned");
    let end = SealedEndpoint::new(&own, &PEERS, marks, radio, max_delay).expect("keys");
    if !input.clocked {
        return end;
    }
    let origin = START - u64::from(input.first[1]) * TICKS_PER_SECOND / 64;
    end.clocked(Timestamp::from_ticks(origin).expect("48 bits"))
}

fn own(input: &Ends<'_>) -> Credential {
    credential(7, if input.broken { BROKEN } else { 1 })
}

/// What the clock says as a counter, which is `first` at the start.
fn clock_of(first: u32, now: u64) -> u64 {
    let before = u64::from(first) * TICKS_PER_SECOND / 64;
    (before + (now - START)) * 64 / TICKS_PER_SECOND
}

/// Marks of an end that has sealed and accepted everything below `first`.
fn provisioned(input: &Ends<'_>, flashes: &[Shared; 3]) {
    let own = own(input);
    let place = |at: usize| (flashes[at].clone(), REGION);
    let accepted = [place(1), place(2)];
    let made = HighWaterMarks::provision::<Unit>(&own, &PEERS, place(0), accepted);
    made.map(drop).expect("blank flashes");
    for (at, of) in [&own, &PEERS[0], &PEERS[1]].into_iter().enumerate() {
        let (kind, first) =
            [(SENT_KIND, input.first[0]), (ACCEPTED_KIND, input.first[1])][at.min(1)];
        let key = of.prepare::<Unit>().expect("a key").fingerprint(of.id);
        let binding = Binding::new(kind, key.expect("not for this one"));
        let mark = HighWaterMark::open(flashes[at].clone(), REGION, binding);
        let last = u64::from(first).saturating_sub(1);
        mark.expect("provisioned").reserve(last, 0).expect("stored");
    }
}

/// A package that was accepted was not accepted before, and is one that this peer sealed.
fn opened(
    script: &Script,
    sender: SenderId,
    counter: u32,
    accepted: &mut [BTreeSet<u32>; 2],
    seen: &mut Seen,
) {
    let which = PEERS.iter().position(|peer| peer.id == sender);
    let accepted = &mut accepted[which.expect("a peer")];
    assert!(accepted.insert(counter), "a package is opened twice");
    let is = |(id, number, _): &&(SenderId, u32, Plaintext)| *id == sender && *number == counter;
    let (_, _, message) = script.sealed.iter().find(is).expect("sealed by that peer");
    seen.packages[1] += 1;
    for packet in packets(message).flatten() {
        seen.packets[1] += 1;
        seen.to_local.extend(packet);
    }
}

fn adds_up(counters: &SealedCounters, direction: usize, seen: &Seen) {
    assert_eq!(counters.packages(), seen.packages[direction]);
    assert_eq!(counters.packets(), seen.packets[direction]);
    for (rejection, count) in counters.rejections() {
        let rejected = seen.rejected[direction].iter();
        let expected = rejected.filter(|other| **other == rejection).count();
        assert_eq!(usize::try_from(count), Ok(expected), "{rejection}");
    }
}

/// The packages of a run open after all before them with the end's own key, and hold whole packets of the
/// local side and of the radio.
fn left(input: &Ends<'_>, local: &[u8], air: &[u8], last: &mut u32) {
    let mut opener = Opener::<1>::new();
    let key = OWN.prepare().expect("a key");
    let permitted = opener.resume(key, &[(OWN.id, *last)]);
    permitted.expect("there is room");
    let mut decoder = hx::Decoder::new();
    for byte in air {
        let frame = decoder
            .push(*byte)
            .map(|frame| frame.expect("whole frames"));
        let Some(frame) = frame else { continue };
        if frame.kind() == FrameKind::Radio {
            assert_eq!(frame.payload(), b"B\r");
            continue;
        }
        assert!(!input.broken && frame.payload().len() == PACKAGE_SIZE);
        let opened = opener.open_between(frame.payload(), *last + 1..=u32::MAX);
        let opened = opened.expect("sealed once, in order");
        *last = opened.counter();
        for packet in opened.packets() {
            let packet = packet.expect("whole packets");
            // VEHICLE_RADIO is its own.
            let told = !input.station && packet.len() == 17 && packet[3..6] == [1, 68, 174];
            let came = local.windows(packet.len()).any(|window| window == packet);
            assert!(told || came, "{packet:?}");
        }
    }
}
