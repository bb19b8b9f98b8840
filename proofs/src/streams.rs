//! R2: several streams, one timestamp each, in a table that gives up the oldest row and keeps nobody out.

use mavlink_signing::{
    Frame, FrameRef, Header, Links, Profile, SigningKey, Stamp, Stream, StreamTable, Timestamp,
    VerifyError, authenticate, sign_frame,
};

/// R2, one step from any state: an authentic frame is accepted if and only if all of these hold. It is
/// of a link that is taken, and none of this end's own. It is in the window, not below the floor, and newer than every
/// accepted one of its stream that has a row. Otherwise the error names the first that is wrong, and nothing changes.
///
/// An accepted frame takes the row of its stream, or a free one. If there is none, the stream with the oldest stamp is
/// given up, of all rows and the new one, and the floor is above that stamp. No other row changes, and the floor is
/// otherwise as it was. So the same frame, and any that was accepted before, is rejected from then on.
///
/// # Errors
///
/// The verdict, where it is a rejection.
///
/// # Panics
///
/// If the property does not hold.
pub fn step<P: Profile, const N: usize>(
    streams: &mut StreamTable<N>,
    key: &SigningKey<P>,
    header: Header,
    stamp: Stamp,
    now: Timestamp,
) -> Result<(), VerifyError> {
    let mut frame = Frame::new(header, &[]).expect("a known message");
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    let received = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
    let authentic = || authenticate(received, key).expect("signed with this key");

    let (before, floor) = (rows(streams), streams.floor());
    let expected = specified(streams, &before, header, stamp, now);
    assert_eq!(streams.check(&authentic(), now), expected);
    let verdict = streams.admit(authentic(), now).map(drop);
    assert_eq!(verdict, expected);

    let (after, ours) = (rows(streams), stream(header, stamp));
    let given_up = remembered(&before, &after, ours, stamp.timestamp, verdict.is_ok());
    let least = given_up.map(|last| last.ticks() + 1);
    let first = |floor: Option<Timestamp>| floor.map_or(1 << 48, Timestamp::ticks);
    assert_eq!(first(streams.floor()), first(floor).max(least.unwrap_or(0)));
    if verdict.is_ok() {
        let again = streams.check(&authentic(), now);
        assert_eq!(again, Err(VerifyError::Replayed), "once");
    }
    verdict
}

/// Checks what an accepted or rejected frame of `ours` did to the rows. Returns the stamp of the stream that was given
/// up, if one was.
fn remembered<const N: usize>(
    before: &Rows<N>,
    after: &Rows<N>,
    ours: Stream,
    stamp: Timestamp,
    accepted: bool,
) -> Option<Timestamp> {
    let new = Some((ours, Some(stamp)));
    if !accepted {
        assert_eq!(before, after);
        return None;
    }
    let has_row = last_of(before, ours).is_some();
    let full = before.iter().flatten().count() == N;
    let mut given_up = (full && !has_row).then_some(stamp);
    let mut taken = 0;
    for (old, now) in before.iter().zip(after) {
        if *now == *old {
            continue;
        }
        taken += 1;
        assert_eq!(*now, new, "no row changes but for the new stamp");
        match old {
            Some((stream, _)) if *stream == ours => {}
            Some((_, last)) => given_up = *last,
            None => {}
        }
    }
    assert!(taken <= 1);
    assert!(taken == 1 || given_up == Some(stamp) || N == 0);
    if let Some(given_up) = given_up {
        assert!(full && !has_row);
        let mut stamps = after.iter().flatten().filter_map(|(_, last)| *last);
        assert!(stamps.all(|last| given_up <= last), "the oldest");
    }
    given_up
}

/// R2, of what this end sends: it is rejected when it comes back, whatever its stamp, now and later. No row changes, nor
/// the floor. A frame without signature changes nothing. Returns why it is rejected.
///
/// # Panics
///
/// If the property does not hold.
pub fn reflected<P: Profile, const N: usize>(
    streams: &mut StreamTable<N>,
    key: &SigningKey<P>,
    header: Header,
    stamp: Stamp,
    now: Timestamp,
) -> VerifyError {
    let mut frame = Frame::new(header, &[]).expect("a known message");
    let unsigned = frame.clone();
    let unsigned = FrameRef::parse(unsigned.as_bytes()).expect("a whole frame");
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    let frame = FrameRef::parse(frame.as_bytes()).expect("a whole frame");

    let before = (rows(streams), streams.floor());
    let own = streams.is_own(stamp.link_id, header.system_id);
    streams.record_sent(unsigned);
    assert_eq!((rows(streams), streams.floor()), before);
    assert_eq!(streams.is_own(stamp.link_id, header.system_id), own);
    streams.record_sent(frame);
    assert_eq!((rows(streams), streams.floor()), before);
    assert!(streams.is_own(stamp.link_id, header.system_id));

    let authentic = authenticate(frame, key).expect("signed with this key");
    let verdict = streams.admit(authentic, now).map(drop);
    assert_eq!((rows(streams), streams.floor()), before);
    let rejection = verdict.expect_err("reflected");
    let expected = if takes(streams.links(), stamp) {
        VerifyError::Reflected
    } else {
        VerifyError::WrongLink(stamp.link_id)
    };
    assert_eq!(rejection, expected);
    rejection
}

type Rows<const N: usize> = [Option<(Stream, Option<Timestamp>)>; N];

const fn stream(header: Header, stamp: Stamp) -> Stream {
    Stream {
        link_id: stamp.link_id,
        system_id: header.system_id,
        component_id: header.component_id,
    }
}

/// The rows in the table's order; what is not taken is `None`.
fn rows<const N: usize>(streams: &StreamTable<N>) -> Rows<N> {
    let mut rows = [None; N];
    for (slot, row) in rows.iter_mut().zip(streams.rows()) {
        *slot = Some(row);
    }
    rows
}

fn takes(links: Links, stamp: Stamp) -> bool {
    match links {
        Links::Any => true,
        Links::Only(link_id) => stamp.link_id == link_id,
    }
}

fn last_of<const N: usize>(rows: &Rows<N>, ours: Stream) -> Option<Option<Timestamp>> {
    let row = rows.iter().flatten().find(|(stream, _)| *stream == ours);
    row.map(|(_, last)| *last)
}

/// The verdict on an authentic frame, condition by condition.
fn specified<const N: usize>(
    streams: &StreamTable<N>,
    rows: &Rows<N>,
    header: Header,
    stamp: Stamp,
    now: Timestamp,
) -> Result<(), VerifyError> {
    if !takes(streams.links(), stamp) {
        return Err(VerifyError::WrongLink(stamp.link_id));
    }
    if streams.is_own(stamp.link_id, header.system_id) {
        return Err(VerifyError::Reflected);
    }
    let (ticks, now) = (stamp.timestamp.ticks(), now.ticks());
    if ticks > now.saturating_add(streams.window().ahead) {
        return Err(VerifyError::FromFuture);
    }
    if ticks < now.saturating_sub(streams.window().past) {
        return Err(VerifyError::TooOld);
    }
    let last = last_of(rows, stream(header, stamp)).flatten();
    let fresh = streams
        .floor()
        .is_some_and(|floor| stamp.timestamp >= floor);
    if !fresh || last.is_some_and(|last| stamp.timestamp <= last) {
        return Err(VerifyError::Replayed);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use mavlink_signing::{Hmac, Window};
    use proptest::prelude::*;
    use std::collections::HashSet;

    fn at(ticks: u64) -> Timestamp {
        Timestamp::from_ticks(ticks).expect("48 bits")
    }

    fn key() -> SigningKey<Hmac> {
        SigningKey::new(&[7; 32]).expect("a key")
    }

    fn header(system_id: u8, component_id: u8) -> Header {
        Header {
            system_id,
            component_id,
            ..HEARTBEAT
        }
    }

    const fn stamp(link_id: u8, timestamp: Timestamp) -> Stamp {
        Stamp { link_id, timestamp }
    }

    proptest! {
        #[test]
        fn r2_random(
            frames in proptest::collection::vec((1..3_u8, 0..3_u8, 0..3_u8, 0..60_u64, 0..60_u64, 0..8_u8), 0..60),
            links in 0..3_u8,
            first in 0..40_u64,
        ) {
            let links = [Links::Any, Links::Only(2), Links::Only(1)][usize::from(links)];
            let window = Window { past: 30, ahead: 20 };
            let mut streams = StreamTable::<4>::resume(links, window, at(first));
            let mut accepted = HashSet::new();
            for (link_id, system_id, component_id, ticks, now, back) in frames {
                let (header, stamp) = (header(system_id, component_id), stamp(link_id, at(ticks)));
                if back == 0 {
                    reflected(&mut streams, &key(), header, stamp, at(now));
                } else if step(&mut streams, &key(), header, stamp, at(now)).is_ok() {
                    prop_assert!(accepted.insert((link_id, system_id, component_id, ticks)));
                }
            }
        }
    }

    /// A full table gives up the oldest stream, and accepts nothing up to its stamp, of nobody.
    #[test]
    fn r2_full() {
        let mut streams = StreamTable::<2>::new(Links::Any, Window::STRICT);
        let mut verdict = |system_id, ticks| {
            let (header, stamp) = (header(system_id, 1), stamp(1, at(ticks)));
            step(&mut streams, &key(), header, stamp, at(20))
        };
        assert_eq!(verdict(1, 5), Ok(()));
        assert_eq!(verdict(2, 3), Ok(()));
        assert_eq!(verdict(3, 6), Ok(()));
        // What was known of 2 is gone, and what it sent is still rejected.
        assert_eq!(verdict(2, 3), Err(VerifyError::Replayed));
        assert_eq!(verdict(2, 4), Ok(()));
        // It was the oldest itself.
        assert_eq!(verdict(2, 4), Err(VerifyError::Replayed));
        assert_eq!(verdict(1, 6), Ok(()));
        assert_eq!(verdict(3, 6), Err(VerifyError::Replayed));
        assert_eq!(streams.floor(), Some(at(5)));
    }

    /// Whoever plays recordings, however many, keeps out nobody whose stamps go on.
    #[test]
    fn r2_recordings_keep_nobody_out() {
        let mut streams = StreamTable::<4>::new(Links::Any, Window::ONE_MINUTE);
        let now = 100_000_000;
        for round in 0..50 {
            for system_id in 10..30 {
                let stamp = stamp(1, at(now - 5_000_000 + round * 1000 + u64::from(system_id)));
                let _ = step(&mut streams, &key(), header(system_id, 1), stamp, at(now));
            }
            let honest = stamp(0, at(now + round));
            let verdict = step(&mut streams, &key(), header(255, 190), honest, at(now));
            assert_eq!(verdict, Ok(()));
        }
    }

    /// However many components this end has, peers keep their rows; and all of them are rejected when they come back.
    #[test]
    fn r2_own_take_no_rows() {
        let mut streams = StreamTable::<2>::new(Links::Any, Window::STRICT);
        let peer = header(255, 190);
        step(&mut streams, &key(), peer, stamp(1, at(3)), at(9)).expect("a row");
        for component_id in 0..=255 {
            let own = header(1, component_id);
            let rejection = reflected(&mut streams, &key(), own, stamp(1, at(9)), at(9));
            assert_eq!(rejection, VerifyError::Reflected);
        }
        step(&mut streams, &key(), peer, stamp(1, at(4)), at(9)).expect("it has it still");
        // Another system, and another link, are somebody else's.
        step(&mut streams, &key(), header(2, 1), stamp(1, at(5)), at(9)).expect("a peer");
        step(&mut streams, &key(), header(1, 1), stamp(2, at(6)), at(9)).expect("a peer");
        // Two links: any.
        reflected(&mut streams, &key(), header(1, 1), stamp(3, at(6)), at(9));
        let verdict = step(&mut streams, &key(), header(1, 1), stamp(2, at(7)), at(9));
        assert_eq!(verdict, Err(VerifyError::Reflected));
    }
}

#[cfg(kani)]
mod verification {
    use super::*;
    use crate::model::AnyTag;
    use crate::model::HEARTBEAT;
    use crate::model::{any_stamp, any_timestamp};
    use mavlink_signing::Window;

    /// Any table of two with `TAKEN` rows in use, and any first timestamp: how many rows there are is
    /// then known to the solver. Something may have been sent.
    fn any_streams<const TAKEN: usize>() -> (StreamTable<2>, Option<Stream>) {
        let links = if kani::any() {
            Links::Any
        } else {
            Links::Only(kani::any())
        };
        let window = Window {
            past: kani::any(),
            ahead: kani::any(),
        };
        let rows: [_; TAKEN] =
            core::array::from_fn(|_| (stream(any_header(), any_stamp()), any_timestamp()));
        if let [one, other] = rows.as_slice() {
            kani::assume(one.0 != other.0);
        }
        let sent = kani::any::<bool>().then(|| stream(any_header(), any_stamp()));
        let streams = StreamTable::resume(links, window, any_timestamp());
        (streams.holding(&rows, sent), sent)
    }

    fn any_header() -> Header {
        Header {
            system_id: kani::any(),
            component_id: kani::any(),
            ..HEARTBEAT
        }
    }

    fn steps<const TAKEN: usize>() {
        let key = SigningKey::<AnyTag>::new(&[1; 32]).expect("a key");
        let (mut streams, _) = any_streams::<TAKEN>();
        let (header, stamp, now) = (any_header(), any_stamp(), any_timestamp());
        let (links, window) = (streams.links(), streams.window());
        let verdict = step(&mut streams, &key, header, stamp, now);
        assert_eq!((streams.links(), streams.window()), (links, window));
        kani::cover!(verdict.is_ok(), "accepted");
        kani::cover!(verdict == Err(VerifyError::Replayed), "replayed");
        kani::cover!(verdict == Err(VerifyError::Reflected), "its own");
        kani::cover!(verdict == Err(VerifyError::FromFuture), "from the future");
        kani::cover!(
            matches!(verdict, Err(VerifyError::WrongLink(_))),
            "wrong link"
        );
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn r2_step_empty() {
        steps::<0>();
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn r2_step_half() {
        steps::<1>();
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn r2_step_full() {
        steps::<2>();
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn r2_reflected() {
        let key = SigningKey::<AnyTag>::new(&[1; 32]).expect("a key");
        let (mut streams, sent) = any_streams::<1>();
        let (header, stamp, now) = (any_header(), any_stamp(), any_timestamp());
        let rejection = reflected(&mut streams, &key, header, stamp, now);
        // What was never sent is nobody's own; what was sent stays so.
        let (link_id, other): (u8, u8) = kani::any();
        let before = sent.is_some_and(|sent| sent.system_id == other);
        if other != header.system_id && !before {
            assert!(!streams.is_own(link_id, other));
        }
        assert!(sent.is_none_or(|sent| streams.is_own(sent.link_id, sent.system_id)));
        kani::cover!(rejection == VerifyError::Reflected, "of this end");
        kani::cover!(matches!(rejection, VerifyError::WrongLink(_)), "wrong link");
    }
}
