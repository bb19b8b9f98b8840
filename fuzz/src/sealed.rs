//! Targets about sealed links: packages, frames, messages, and histories of all of them.

use arbitrary::Arbitrary;
use mavlink_commsec::field::{
    HEADER_SIZE, KEY_SIZE, NONCE_SIZE, PACKAGE_SIZE, PLAINTEXT_SIZE, TAG_SIZE,
};
use mavlink_commsec::hx::{Decoder, FrameKind};
use mavlink_commsec::{
    AesGcm, Cipher, CipherError, Credential, EpochCounter, EpochHeader, Opener, PackError,
    PackageHeader, PackageTag, Plaintext, Sealer, SealingKey, SenderId, radio,
};
use mavseal_proofs::cipher::{Specified, Verdict, nonce_of};
use mavseal_proofs::link::{self, Step};
use mavseal_proofs::packing::Kind;
use mavseal_proofs::{framing, opening, packing, sealing};
use mavseal_relay::sealed::SealedRejectReason;
use ring::aead::{AES_128_GCM, Aad, LessSafeKey, Nonce, UnboundKey};
use std::error::Error as _;
use std::time::Duration;

use crate::repair;

/// The keys of the two senders, and their ids.
const KEYS: [[u8; KEY_SIZE]; 2] = [[0x51; KEY_SIZE], [0x62; KEY_SIZE]];
const IDS: [u32; 2] = [5, 6];
const SALT: u32 = 0x0000_4353;

/// A package that arrives at a receiver of two senders.
#[derive(Arbitrary, Clone, Debug)]
pub struct Arrival<'a> {
    /// Whether packages have epochs.
    pub epochs: bool,
    /// Whether both senders have one key.
    pub shared: bool,
    /// How many wrong tags a key survives.
    pub limit: u8,
    /// Of each sender, what was accepted last: epoch and counter.
    pub last: [(u16, u32); 2],
    /// What is made right. 1: the length; 2: the id; 4: the place, `near` the last one; 8: the tag.
    pub right: u8,
    /// How far from the last place.
    pub near: i8,
    /// What was accepted behind the last, of every ninth place: 1, 10, 19 and so on.
    pub late: u8,
    /// The package.
    pub bytes: &'a [u8],
}

/// A package of any bytes, or one made right in parts: the verdict (O1), and what comes out (O2), with
/// the real cipher and with one that tells what it was asked.
pub fn open_package(input: Arrival<'_>) {
    if input.epochs {
        arrives::<EpochHeader>(&input);
    } else {
        arrives::<PackageHeader>(&input);
    }
}

fn arrives<H: Specified>(input: &Arrival<'_>) {
    let lasts = input
        .last
        .map(|(epoch, counter)| H::place_of(epoch, counter));
    let package = repaired::<H>(input);
    let right = expected::<H>(input.shared, &package).is_some();
    let limit = input.limit.into();
    let mut opener = receiver::<H>(input, lasts, limit);
    let place = 1 + u32::from(input.limit) % opening::WINDOW;
    let verdict = opening::step(&mut opener, limit, input.shared, &package, right, place);
    // A relay has no packages with epochs.
    let reason = verdict.err().map(SealedRejectReason::from);
    assert!(input.epochs || reason != Some(SealedRejectReason::Other));

    let opened = receiver::<H>(input, lasts, u32::MAX).open(&package);
    if let Ok(opened) = opened {
        let message = expected::<H>(input.shared, &package);
        assert_eq!(Some(*opened.plaintext()), message);
        for packet in opened.packets() {
            let _ = packet;
        }
        let _ = packing::unpacked(opened.plaintext());
    }
    if let Ok(package) = <&[u8; PACKAGE_SIZE]>::try_from(&package[..]) {
        let at = usize::from(input.limit) % PLAINTEXT_SIZE;
        for verdict in [Verdict::Right, Verdict::Wrong, Verdict::Fails] {
            let _ = opening::comes_out::<H>(SALT, lasts[0], verdict, package, at);
        }
    }
}

/// The package, as far as it is made right.
fn repaired<H: Specified>(input: &Arrival<'_>) -> Vec<u8> {
    let mut package = input.bytes.to_vec();
    let makes = |bit: u8| input.right & bit != 0;
    if makes(1) {
        package.resize(PACKAGE_SIZE, 0);
    }
    if package.len() != PACKAGE_SIZE {
        return package;
    }
    let (mut id, mut sequence) = header_of::<H>(&package);
    let which = usize::from(package[0] & 1);
    if makes(2) {
        id = H::id(IDS[which]);
    }
    if makes(4) {
        let (epoch, counter) = input.last[which];
        sequence = H::place_of(epoch, counter.wrapping_add_signed(input.near.into()));
    }
    package[..HEADER_SIZE].copy_from_slice(&H::write(id, sequence));
    if makes(8) {
        let mut message = *package[HEADER_SIZE..].first_chunk().expect("96 bytes");
        let key = if input.shared { 0 } else { which };
        let tag = sealed::<H>(key, id, sequence, &mut message);
        package[HEADER_SIZE..][..PLAINTEXT_SIZE].copy_from_slice(&message);
        package[HEADER_SIZE + PLAINTEXT_SIZE..].copy_from_slice(&tag);
    }
    package
}

fn header_of<H: Specified>(package: &[u8]) -> (H::Id, H::Sequence) {
    H::read(*package.first_chunk().expect("96 bytes"))
}

/// The message of a package whose tag is that of its sender's key: found by sealing alone. What is sealed
/// of zeros is what a message is mixed with.
fn expected<H: Specified>(shared: bool, package: &[u8]) -> Option<Plaintext> {
    let package: &[u8; PACKAGE_SIZE] = package.try_into().ok()?;
    let (id, sequence) = header_of::<H>(package);
    let which = IDS.iter().position(|number| H::id(*number) == id)?;
    let key = if shared { 0 } else { which };
    let mut message = [0; PLAINTEXT_SIZE];
    sealed::<H>(key, id, sequence, &mut message);
    for (byte, sealed) in message.iter_mut().zip(&package[HEADER_SIZE..]) {
        *byte ^= sealed;
    }
    let tag = sealed::<H>(key, id, sequence, &mut message.clone());
    (Some(&tag) == package.last_chunk::<TAG_SIZE>()).then_some(message)
}

/// Seals `message` in place: the tag.
fn sealed<H: Specified>(
    key: usize,
    id: H::Id,
    sequence: H::Sequence,
    message: &mut Plaintext,
) -> PackageTag {
    let nonce = nonce_of::<H>(SALT, id, sequence);
    let sealed = AesGcm::new(&KEYS[key]).seal(&nonce, message);
    sealed.expect("AES does not fail")
}

/// A receiver that has accepted `lasts`, and of the first sender what `late` says.
fn receiver<H: Specified>(
    input: &Arrival<'_>,
    lasts: [H::Sequence; 2],
    limit: u32,
) -> Opener<2, AesGcm, H> {
    let mut opener = Opener::<2, AesGcm, H>::with_limit(u32::MAX);
    let key = |which: usize| SealingKey::new(&KEYS[which], SALT).expect("a key");
    let (epoch, newest) = input.last[0];
    let before = newest.checked_sub(65).filter(|_| !H::never_used(lasts[0]));
    let before = before.map_or(lasts[0], |counter| H::place_of(epoch, counter));
    let [one, two] = [(H::id(IDS[0]), before), (H::id(IDS[1]), lasts[1])];
    let senders: &[&[_]] = if input.shared {
        &[&[one, two]]
    } else {
        &[&[one], &[two]]
    };
    for (which, senders) in senders.iter().enumerate() {
        let permitted = opener.resume(key(which), senders);
        permitted.expect("there is room");
    }
    for byte in [0, 1, 0xFF] {
        let credential = Credential {
            id: one.0,
            key: [byte; KEY_SIZE],
            salt: SALT,
        };
        let made = Opener::<1, AesGcm, H>::from_credentials(&[credential], |_| H::ZERO);
        assert_eq!(made.is_ok(), byte == 1);
        assert!(made.err().is_none_or(|error| error.source().is_some()));
    }
    for senders in [&[][..], &[one.0], &[H::id(8), H::id(9)]] {
        assert!(opener.permit(key(0), senders).is_err());
    }
    if before != lasts[0] {
        let late = (0..8).filter(|bit| input.late >> bit & 1 == 1);
        for counter in late.map(|bit| newest - 1 - 9 * bit).chain([newest]) {
            let sequence = H::place_of(epoch, counter);
            let mut message = [3; PLAINTEXT_SIZE];
            let tag = sealed::<H>(0, one.0, sequence, &mut message);
            let package = [&H::write(one.0, sequence)[..], &message, &tag].concat();
            let opened = opener.open(&package);
            assert_eq!(opened.map(|opened| opened.sequence()), Ok(sequence));
        }
    }
    opener.set_limit(limit);
    opener
}

/// Two messages, and the sender that seals them.
#[derive(Arbitrary, Clone, Debug)]
pub struct Sealing {
    /// The salt, the id, and where it is resumed.
    pub numbers: [u32; 3],
    /// The mark of its epochs.
    pub mark: u64,
    /// Whether its unit fails.
    pub fails: bool,
    /// What both messages are made of.
    pub bytes: [u8; 16],
    /// Where the sealed message is looked at; modulo 80.
    pub at: u8,
}

/// What is sealed opens with the same key and comes out as it was; under which nonces it is sealed, with
/// both headers (N1).
pub fn seal_open(input: Sealing) {
    let Sealing { numbers, mark, .. } = input;
    let [salt, id, first] = numbers;
    let message =
        |turn: u8| std::array::from_fn(|at| input.bytes[at % 16].rotate_left(turn.into()));
    let messages: [Plaintext; 2] = [message(0), message(3)];
    let verdict = [Verdict::Right, Verdict::Fails][usize::from(input.fails)];
    let at = usize::from(input.at) % PLAINTEXT_SIZE;
    let _ = sealing::packages(numbers, verdict, &messages, at);
    let _ = sealing::packages_of_epoch(salt, id as u16, mark, verdict, &messages, at);
    let sequence = EpochCounter::from_number(mark);
    let number = sequence.map(EpochCounter::to_number);
    assert_eq!(number, Some(mark).filter(|mark| mark >> 48 == 0));

    let key = || SealingKey::<AesGcm>::new(&KEYS[0], salt).expect("a key");
    let mut sealer = if first == 1 {
        Sealer::new(key(), SenderId(id))
    } else {
        Sealer::resume(key(), SenderId(id), first)
    };
    let mut opener = Opener::<1>::new();
    let last = (SenderId(id), first.max(1) - 1);
    opener.resume(key(), &[last]).expect("there is room");
    for message in &messages {
        if let Ok(package) = sealer.seal(message) {
            let opened = opener.open(package.as_bytes()).expect("genuine");
            assert_eq!(opened.plaintext(), message);
        }
    }
}

/// What happens on a link.
#[derive(Arbitrary, Clone, Debug)]
pub struct History {
    /// Whether packages have epochs.
    pub epochs: bool,
    /// Where all counters begin, or of what the first epoch is made.
    pub first: u32,
    /// In order.
    pub steps: Vec<Step>,
}

/// A vehicle and two stations, through loss, repetition, reordering, damage and restarts, with a naive
/// model (O1, N1, F1).
pub fn sealed_link(input: History) {
    let history = if input.epochs {
        link::history::<AesGcm, EpochHeader>
    } else {
        link::history::<AesGcm, PackageHeader>
    };
    let _ = history(input.first, &input.steps);
}

/// Bytes on a serial line, and a frame behind them.
#[derive(Arbitrary, Clone, Debug)]
pub struct Line<'a> {
    /// Whether the frame is for the radio.
    pub radio: bool,
    /// How many of the bytes are the frame's payload; the others come before it.
    pub payload: u8,
    /// The bytes.
    pub bytes: &'a [u8],
}

/// A stream, byte by byte and as a whole, then a frame, which comes out whatever was before (F1, F2); and
/// what a host makes of a radio's answer.
pub fn hx_decoder(input: Line<'_>) {
    let payload = usize::from(input.payload).min(input.bytes.len());
    let (payload, noise) = input.bytes.split_at(payload);
    let tag = [FrameKind::AirData, FrameKind::Radio][usize::from(input.radio)];
    let _ = framing::stream(noise);
    let mut decoder = Decoder::new();
    for byte in noise {
        let _ = framing::takes_any(&mut decoder, *byte);
    }
    if framing::never_empty(tag, payload).is_ok() {
        framing::comes_through(&mut decoder, tag, payload);
    }
    let answer = radio::Answer::from_wire(payload);
    if let Ok(answer) = &answer {
        match answer {
            radio::Answer::Status(status) => assert_eq!(status.to_wire(), payload),
            radio::Answer::Debug(status, debug) => assert_eq!(status.to_wire_with(debug), payload),
        }
        let status = answer.status();
        let gcs = status.gcs_radio(payload[0]);
        let vehicle = status.vehicle_radio(payload[1], 1, 2);
        // Both say the same of the status, but for one byte: how the frames of the host overflowed.
        assert_eq!(gcs[6..12], vehicle[6..12]);
        assert_eq!(gcs[13..15], vehicle[13..15]);
        for (packet, crc_extra) in [(gcs, 108), (vehicle, 238)] {
            let sum = repair::checksum(&packet[1..15], crc_extra);
            assert_eq!(packet[15..], sum.to_le_bytes());
        }
    }
    let request = radio::Request::from_wire(payload);
    let written = request.map(|request| request.to_wire().to_vec());
    let known = matches!(payload, [b'B' | b'b' | b'D' | b'd', b'\r']);
    assert_eq!(written.is_some(), known);
    assert!(written.is_none_or(|bytes| bytes.eq_ignore_ascii_case(payload)));
}

/// A packet, whole or not.
#[derive(Arbitrary, Clone, Copy, Debug)]
pub struct Shape {
    /// Time since the packet before it, in milliseconds.
    pub wait: u8,
    /// 0 and 1: MAVLink 1; 2: MAVLink 2; 3: the same, signed; 4: with a flag that is unknown; 5: with
    /// another magic byte; modulo 6.
    pub version: u8,
    /// Its message: modulo 4, so that there are heartbeats.
    pub id: u8,
    /// Bytes of payload.
    pub length: u8,
    /// Bytes that are missing at its end or, as negative numbers, too many.
    pub cut: i8,
}

impl Shape {
    fn bytes(self) -> Vec<u8> {
        let (id, length) = (self.id % 4, self.length);
        let mut bytes = match self.version % 6 {
            0 | 1 => vec![0xFE, length, 7, 1, 1, id],
            flags @ 2..=4 => vec![0xFD, length, flags - 2, 0, 7, 1, 1, id, 0, 0],
            _ => vec![0x55, length, 7, 1, 1, id],
        };
        let end = if self.version % 6 == 3 { 15 } else { 2 };
        bytes.resize(bytes.len() + usize::from(length) + end, length ^ 0x5A);
        let kept = bytes.len().saturating_add_signed(-isize::from(self.cut));
        bytes.resize(kept, 0xFD);
        bytes
    }
}

/// Packets for a packer, and a message.
#[derive(Arbitrary, Clone, Debug)]
pub struct Packets {
    /// Whether it packs for old vehicles.
    pub old: bool,
    /// Whether it is asked after each packet.
    pub polls: bool,
    /// How long a packet may wait, in milliseconds.
    pub max_delay: u8,
    /// Any message.
    pub message: Plaintext,
    /// The packets.
    pub shapes: Vec<Shape>,
}

/// Packets go into messages and come out again whole (P1); any message is unpacked.
pub fn pack_packets(input: Packets) {
    let millis = |millis: u8| Duration::from_millis(millis.into());
    let kind = Kind {
        old: input.old,
        max_delay: millis(input.max_delay),
    };
    let mut now = Duration::ZERO;
    let packets = input.shapes.iter().map(|shape| {
        now += millis(shape.wait);
        (shape.bytes(), now)
    });
    let packets: Vec<_> = packets.collect();
    let given: Vec<_> = packets
        .iter()
        .map(|(packet, at)| (&packet[..], *at))
        .collect();
    let _ = packing::packed(kind, &given, input.polls);
    for (packet, now) in given {
        if let Err(error) = kind.packer().push(packet, now) {
            let parsed = matches!(error, PackError::Parse(_));
            assert_eq!(error.source().is_some(), parsed);
        }
    }
    if let Err(error) = packing::unpacked(&input.message) {
        assert!(error.source().is_some());
    }
}

/// What is sealed, and one bit of it.
#[derive(Arbitrary, Clone, Debug)]
pub struct Gcm<'a> {
    /// The key.
    pub key: [u8; KEY_SIZE],
    /// The nonce.
    pub nonce: [u8; NONCE_SIZE],
    /// The message.
    pub message: Plaintext,
    /// A bit of what was sealed and its tag, counted round.
    pub bit: u16,
    /// What may be a key.
    pub other: &'a [u8],
}

/// AES-128-GCM against the crate `ring`: the same bytes, the first half of its tag; one changed bit is
/// rejected. Which bytes are a key.
pub fn diff_gcm(input: Gcm<'_>) {
    let cipher = AesGcm::new(&input.key);
    let mut sealed = input.message;
    let tag = cipher.seal(&input.nonce, &mut sealed);
    let tag = tag.expect("AES does not fail");

    let theirs = LessSafeKey::new(UnboundKey::new(&AES_128_GCM, &input.key).expect("16 bytes"));
    let mut expected = input.message;
    let nonce = Nonce::assume_unique_for_key(input.nonce);
    let whole = theirs.seal_in_place_separate_tag(nonce, Aad::empty(), &mut expected);
    assert_eq!(sealed, expected);
    assert_eq!(tag, whole.expect("a short message").as_ref()[..TAG_SIZE]);

    let mut changed = [&sealed[..], &tag].concat();
    let bit = usize::from(input.bit) % (8 * changed.len());
    changed[bit / 8] ^= 1 << (bit % 8);
    let (text, changed_tag) = changed.split_last_chunk().expect("88 bytes");
    let mut text = text.try_into().expect("80 bytes");
    let rejected = cipher.open(&input.nonce, &mut text, changed_tag);
    assert_eq!(rejected, Err(CipherError));
    assert_eq!(cipher.open(&input.nonce, &mut sealed, &tag), Ok(()));
    assert_eq!(sealed, input.message);

    let made = SealingKey::<AesGcm>::new(input.other, SALT);
    let all = |of: u8| input.other.iter().all(|byte| *byte == of);
    let is_key = input.other.len() == KEY_SIZE && !all(0) && !all(0xFF);
    assert_eq!(made.is_ok(), is_key);
}
