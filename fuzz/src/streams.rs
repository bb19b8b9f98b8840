//! Targets about streams of bytes.

use arbitrary::Arbitrary;
use mavlink_signing::dialect::crc_extra;
use mavlink_signing::field::TIMESTAMP_SIZE;
use mavlink_signing::{Decoder, Frame, Hmac, Resync, SigningKey, Timestamp};
use mavseal_proofs::history::{Step, history};
use mavseal_proofs::payload::{Arrival, Damage};
use mavseal_proofs::pipes::{Turn, pipes};
use mavseal_proofs::{packet, payload};
use mavseal_relay::{ForwardMode, Senders};

use crate::input::{Head, Moment};
use crate::repair::{self, KEY, Parts, SECRET};

/// A stream of packets and what is between them.
#[derive(Arbitrary, Clone, Debug)]
pub struct Stream<'a> {
    /// Whether a payload is searched for packets.
    pub next_byte: bool,
    /// The packets whose checksums and tags are left as they are: bit `n` for packet `n`, modulo 16.
    pub spared: u16,
    /// The line is silent before each byte of this number; never, if it is zero.
    pub silence: u8,
    /// The lengths of the pieces that the stream comes in, in turn.
    pub cuts: [u16; 3],
    /// The bytes.
    pub bytes: &'a [u8],
}

/// A stream in pieces against the stream as a whole, and byte by byte with silences (W3).
pub fn decoder_chunks(input: Stream<'_>) {
    let mut stream = input.bytes.to_vec();
    repair::stream(&mut stream, input.spared, |_, _| {});
    let resync = [Resync::Silence, Resync::NextByte][usize::from(input.next_byte)];
    packet::cut_does_not_matter(resync, &stream, &input.cuts.map(usize::from));

    let mut decoder = Decoder::new(resync, crc_extra);
    for (at, byte) in stream.into_iter().enumerate() {
        if input.silence > 0 && at % usize::from(input.silence) == 0 {
            decoder.idle();
        }
        while decoder.room() == 0 {
            let _ = packet::gives(&mut decoder, crc_extra);
        }
        packet::takes(&mut decoder, byte);
        while packet::gives(&mut decoder, crc_extra).is_some() {}
    }
}

/// Packets on a line that is trusted, and what happens to it once.
#[derive(Arbitrary, Clone, Debug)]
pub struct Trusted<'a> {
    /// How they come in.
    pub arrival: Arrival,
    /// Where bytes are lost, and how many.
    pub lost: (u16, u8),
    /// What comes in their place, and how much of it, modulo 8; from 5 on, nothing happens at all.
    pub inserted: ([u8; 4], u8),
    /// Whether the line tells.
    pub reported: bool,
    /// Bytes of each payload.
    pub lengths: [u8; 4],
    /// The payloads: packets that are made right, and what is between them.
    pub bytes: &'a [u8],
}

/// Packets full of packets, with loss, noise and damage in one place, told or not: none that lies inside of another
/// comes out (D1).
pub fn trusted_line(input: Trusted<'_>) {
    let mut rest = input.bytes;
    let packets = input.lengths.map(|length| {
        let (payload, behind) = rest.split_at(rest.len().min(length.into()));
        rest = behind;
        let mut payload = payload.to_vec();
        repair::stream(&mut payload, 0, |_, _| {});
        let frame = Frame::new(Head::default().into(), &payload).expect("short enough");
        frame.as_bytes().to_vec()
    });
    let (bytes, count) = input.inserted;
    let (at, lost) = input.lost;
    let damage = Damage {
        at,
        lost,
        inserted: bytes[..usize::from(count % 8).min(4)].to_vec(),
        reported: input.reported,
    };
    let damage = (count % 8 < 5).then_some(&damage);
    let _ = payload::never_a_packet(&packets, &input.arrival, damage);
}

/// What happens on a link.
#[derive(Arbitrary, Clone, Debug)]
pub struct History {
    /// When it begins.
    pub start: Moment,
    /// What happens.
    pub steps: Vec<Step>,
}

/// Signing, loss, repetition, reordering, damage and clocks that jump, against a naive model (R1, T1).
pub fn replay_model(input: History) {
    history(&KEY, input.start.timestamp(), &input.steps);
}

/// What arrives on both sides of the relay.
#[derive(Arbitrary, Clone, Debug)]
pub struct Piped<'a> {
    /// Whether verified frames leave as they came.
    pub whole: bool,
    /// Whether only the system is signed for whose HEARTBEAT comes first.
    pub named: bool,
    /// The time.
    pub now: Moment,
    /// The packets that are left as they are: bit `n` for packet `n` of each side, modulo 16.
    pub spared: u16,
    /// How the ports behave, turn by turn.
    pub turns: Vec<Turn>,
    /// How many of the bytes come from the local side.
    pub local: u16,
    /// The bytes from the local side, then those from the link side.
    pub bytes: &'a [u8],
}

/// Brings the timestamp of a frame near `now`: of the one that it has, the lowest 3 bytes count, which
/// say how long ago it was, from 16 ticks ahead on; further back than the window reaches.
fn near(packet: &mut [u8], parts: Parts, now: Timestamp) {
    if let Some(at) = parts.signature {
        let [a, b, c] = [1, 2, 3].map(|offset| packet[at + offset]);
        let ago = u64::from(u32::from_le_bytes([a, b, c, 0]));
        let ticks = now.saturating_add(16).ticks().saturating_sub(ago);
        packet[at + 1..][..TIMESTAMP_SIZE].copy_from_slice(&ticks.to_le_bytes()[..6]);
    }
}

/// The relay between two pipes, both ways, against its parts in sequence (L1).
pub fn relay(input: Piped<'_>) {
    let forward = [ForwardMode::StripSignature, ForwardMode::KeepSignature];
    let key = || SigningKey::<Hmac>::new(&SECRET).expect("a key");
    let now = input.now.timestamp();
    let mut bytes = input.bytes.to_vec();
    let local = usize::from(input.local).min(bytes.len());
    let (local, link) = bytes.split_at_mut(local);
    for stream in [&mut *local, &mut *link] {
        repair::stream(stream, input.spared, |packet, parts| {
            near(packet, parts, now)
        });
    }
    let forward = forward[usize::from(input.whole)];
    let senders = [Senders::Any, Senders::FirstHeartbeat][usize::from(input.named)];
    let _ = pipes(key, forward, senders, now, local, link, &input.turns);
}
