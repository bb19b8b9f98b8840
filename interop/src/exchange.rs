//! Every message, both ways: signed there and verified here, and the reverse.

use anyhow::Result;
use mavlink_signing::FrameRef;
use rand::{Rng, RngExt, rngs::SmallRng};

use crate::{
    differences::SIGNED_THERE,
    forge::payload_end,
    here::{self, Here},
    hex,
    messages::Message,
    payloads::Kind,
    peers::{Order, Peer},
    report::Judge,
};

/// The direction of which each kind of payload is a scenario.
const SIGNED_HERE: &str = "signed here, verified there";
/// The link that all frames of this part are signed for.
const LINK_ID: u8 = 7;
/// Systems and components whose frames come: each a stream of its own.
const SENDERS: [(u8, u8); 4] = [(1, 1), (1, 190), (255, 0), (17, 255)];

/// Both ways, with one receiver each for all frames.
pub(crate) fn run(
    peer: &mut dyn Peer,
    messages: &[Message],
    here: &mut Here,
    random: &mut SmallRng,
    judge: &mut Judge,
) -> Result<()> {
    judge.begin(peer.name(), peer.version(), SIGNED_THERE, messages.len());
    here.restart();
    let mut ticks = here::now()?;
    for message in messages {
        for kind in Kind::SENT {
            ticks = here::now()?.max(ticks + 1);
            let payload = kind.payload(message, random);
            let order = order(message, &payload, ticks, random);
            let frame = peer.sign(&order)?;
            let verdict = here.verify(&frame, here::now()?);
            let example = || format!("{} {}: {}", message.name, kind.name(), hex::encode(&frame));
            judge.compare(
                peer.name(),
                SIGNED_THERE,
                &[true],
                &[verdict.is_ok()],
                example,
            );
            if verdict.is_ok() && !same_made_here(here, &order, &frame)? {
                let what = format!(
                    "{}: the same frame, made here, has other bytes",
                    peer.name()
                );
                judge.fail(what, example);
            }
        }
    }
    if peer.receives() {
        receive(peer, messages, here, random, judge)?;
    }
    Ok(())
}

fn receive(
    peer: &mut dyn Peer,
    messages: &[Message],
    here: &Here,
    random: &mut SmallRng,
    judge: &mut Judge,
) -> Result<()> {
    judge.begin(peer.name(), peer.version(), SIGNED_HERE, messages.len());
    let mut ticks = here::now()?;
    peer.restart(ticks)?;
    for message in messages {
        for kind in Kind::RECEIVED {
            ticks = here::now()?.max(ticks + 1);
            let payload = kind.payload(message, random);
            let wire = kind.on_the_wire(&payload);
            let frame = here.sign(&order(message, wire, ticks, random))?;
            let passes = peer.accepts(&frame)?;
            let example = || format!("{} {}: {}", message.name, kind.name(), hex::encode(&frame));
            judge.compare(peer.name(), kind.scenario(), &[true], &[passes], example);
        }
    }
    Ok(())
}

fn order<'a>(
    message: &'a Message,
    payload: &'a [u8],
    ticks: u64,
    random: &mut SmallRng,
) -> Order<'a> {
    let (system_id, component_id) = SENDERS[random.random_range(0..SENDERS.len())];
    let sequence = random.next_u32() as u8;
    Order {
        message,
        payload,
        sequence,
        system_id,
        component_id,
        link_id: LINK_ID,
        ticks,
    }
}

/// Whether the peer's `frame` has the header that was ordered, and the core makes of its payload and
/// stamp the same bytes.
fn same_made_here(here: &Here, order: &Order, frame: &[u8]) -> Result<bool> {
    let Some(signature) = FrameRef::parse(frame)?.signature() else {
        return Ok(false);
    };
    let payload = &frame[frame.len().min(10)..payload_end(frame)];
    let again = here.sign(&Order {
        payload,
        ticks: signature.stamp.timestamp.ticks(),
        ..order.clone()
    })?;
    Ok(again == frame)
}
