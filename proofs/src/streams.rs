//! R2: several streams, one timestamp each, in a table that never gives up a row.

use mavlink_signing::{
    Frame, FrameRef, Header, Links, Profile, SigningKey, Stamp, Stream, StreamTable, Timestamp,
    VerifyError, authenticate, sign_frame,
};

/// R2, one step from any state: an authentic frame is accepted if and only if all of these hold. It is
/// of a link that is taken, in the window, and newer than every accepted one of its stream. It has a
/// row, or there is a free one and its link is not closed. Otherwise the error names the first that is
/// wrong. An accepted frame changes the row of its stream alone; a rejected one changes nothing; no row
/// is ever lost, and no link closed.
///
/// `first` is the first timestamp that is fresh in a new stream. Returns the verdict.
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
    first: Timestamp,
    key: &SigningKey<P>,
    header: Header,
    stamp: Stamp,
    now: Timestamp,
) -> Result<(), VerifyError> {
    let mut frame = Frame::new(header, &[]).expect("a known message");
    sign_frame(&mut frame, key, stamp).expect("not signed yet");
    let received = FrameRef::parse(frame.as_bytes()).expect("a whole frame");
    let authentic = authenticate(received, key).expect("signed with this key");

    let (before, closed) = (rows(streams), streams.closed());
    let expected = specified(streams, &before, first, header, stamp, now);
    assert_eq!(streams.check(&authentic, now), expected);
    let verdict = streams.admit(authentic, now).map(drop);
    assert_eq!(verdict, expected);

    let after = rows(streams);
    let ours = stream(header, stamp);
    for (old, new) in before.iter().zip(&after) {
        let Some((stream, last)) = old else {
            let taken = verdict.is_ok() && *new == Some((ours, Some(stamp.timestamp)));
            assert!(new.is_none() || taken);
            continue;
        };
        let last = if verdict.is_ok() && *stream == ours {
            Some(stamp.timestamp)
        } else {
            *last
        };
        assert_eq!(*new, Some((*stream, last)));
    }
    let count = |rows: &[Option<_>; N]| rows.iter().flatten().count();
    let new_stream = verdict.is_ok() && last_of(&before, ours).is_none();
    assert_eq!(count(&after), count(&before) + usize::from(new_stream));
    assert_eq!(streams.closed(), closed);
    verdict
}

/// R2, of what this end sends: it is rejected when it comes back, whether or not there was a row for it.
/// No other row changes, and none is lost. If there was none, its link is closed; a link that was closed
/// stays so. As rows do not go back ([`step`]), it is rejected later too. A frame without signature
/// changes nothing. Returns why it is rejected.
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

    let (before, closed) = (rows(streams), streams.closed());
    streams.record_sent(unsigned);
    assert_eq!((rows(streams), streams.closed()), (before, closed));
    streams.record_sent(frame);
    let after = rows(streams);
    let ours = stream(header, stamp);
    let without_row = takes(streams.links(), stamp) && last_of(&after, ours).is_none();
    match (closed, streams.closed()) {
        (before, after) if before == after => {
            assert!(!without_row || after.is_some_and(|it| takes(it, stamp)));
        }
        (None, Some(Links::Only(link_id))) => assert!(without_row && link_id == stamp.link_id),
        (Some(Links::Only(link_id)), Some(Links::Any)) => {
            assert!(without_row && link_id != stamp.link_id);
        }
        _ => panic!("a link was closed, or opened, that must not be"),
    }
    for (old, new) in before.iter().zip(&after) {
        let expected = match old {
            // What is of a link that is not taken needs no row.
            _ if !takes(streams.links(), stamp) => *old,
            Some((stream, last)) if *stream == ours => {
                Some((ours, (*last).max(Some(stamp.timestamp))))
            }
            None if new.is_some() => Some((ours, Some(stamp.timestamp))),
            _ => *old,
        };
        assert_eq!(*new, expected);
    }
    let count = |rows: &[Option<_>; N]| rows.iter().flatten().count();
    assert!(count(&after) <= count(&before) + 1);

    let authentic = authenticate(frame, key).expect("signed with this key");
    let verdict = streams.admit(authentic, now).map(drop);
    assert_eq!(rows(streams), after);
    verdict.expect_err("reflected")
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
    first: Timestamp,
    header: Header,
    stamp: Stamp,
    now: Timestamp,
) -> Result<(), VerifyError> {
    if !takes(streams.links(), stamp) {
        return Err(VerifyError::WrongLink(stamp.link_id));
    }
    let (ticks, now) = (stamp.timestamp.ticks(), now.ticks());
    if ticks > now.saturating_add(streams.window().ahead) {
        return Err(VerifyError::FromFuture);
    }
    if ticks < now.saturating_sub(streams.window().past) {
        return Err(VerifyError::TooOld);
    }
    let ours = stream(header, stamp);
    match last_of(rows, ours) {
        _ if stamp.timestamp < first => Err(VerifyError::Replayed),
        Some(last) if last.is_some_and(|last| stamp.timestamp <= last) => {
            Err(VerifyError::Replayed)
        }
        Some(_) => Ok(()),
        None if rows.iter().flatten().count() == N => Err(VerifyError::StreamsFull),
        None if streams.closed().is_some_and(|it| takes(it, stamp)) => {
            Err(VerifyError::StreamsFull)
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HEARTBEAT;
    use mavlink_signing::{Hmac, Window};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn r2_random(
            frames in proptest::collection::vec((1..3_u8, 0..3_u8, 0..2_u8, 0..60_u64, 0..60_u64, any::<bool>()), 0..40),
            links in 0..3_u8,
            first in 0..40_u64,
        ) {
            let at = |ticks| Timestamp::from_ticks(ticks).expect("48 bits");
            let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
            let links = [Links::Any, Links::Only(2), Links::Only(1)][usize::from(links)];
            let window = Window { past: 30, ahead: 20 };
            let mut streams = StreamTable::<4>::resume(links, window, at(first));
            for (link_id, system_id, component_id, ticks, now, back) in frames {
                let header = Header { system_id, component_id, ..HEARTBEAT };
                let stamp = Stamp { link_id, timestamp: at(ticks) };
                if back {
                    reflected(&mut streams, &key, header, stamp, at(now));
                } else {
                    let _ = step(&mut streams, at(first), &key, header, stamp, at(now));
                }
            }
        }
    }

    /// A full table rejects what is new and goes on with what it knows.
    #[test]
    fn r2_full() {
        let at = |ticks| Timestamp::from_ticks(ticks).expect("48 bits");
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let mut streams = StreamTable::<2>::new(Links::Any, Window::STRICT);
        let mut verdict = |system_id, ticks| {
            let header = Header {
                system_id,
                ..HEARTBEAT
            };
            let stamp = Stamp {
                link_id: 1,
                timestamp: at(ticks),
            };
            step(&mut streams, Timestamp::ZERO, &key, header, stamp, at(9))
        };
        assert_eq!(verdict(1, 5), Ok(()));
        assert_eq!(verdict(2, 3), Ok(()));
        assert_eq!(verdict(3, 6), Err(VerifyError::StreamsFull));
        assert_eq!(verdict(2, 3), Err(VerifyError::Replayed));
        assert_eq!(verdict(2, 4), Ok(()));
    }

    /// Rows of peers do not count as its own: half of the table is left to it, if it is there first.
    #[test]
    fn r2_peers_before_own() {
        let at = |ticks| Timestamp::from_ticks(ticks).expect("48 bits");
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let mut streams = StreamTable::<4>::new(Links::Any, Window::STRICT);
        let header = |system_id| Header {
            system_id,
            ..HEARTBEAT
        };
        let stamp = |link_id| Stamp {
            link_id,
            timestamp: at(5),
        };
        for system_id in [200, 201] {
            let (header, stamp) = (header(system_id), stamp(2));
            step(&mut streams, Timestamp::ZERO, &key, header, stamp, at(9)).expect("a row");
        }
        for system_id in [1, 2] {
            let rejection = reflected(&mut streams, &key, header(system_id), stamp(1), at(9));
            assert_eq!(rejection, VerifyError::Replayed);
        }
        assert_eq!((streams.rows().count(), streams.closed()), (4, None));
    }

    /// What this end sends leaves half of the table to peers, on other links than its own.
    #[test]
    fn r2_own_half() {
        let at = |ticks| Timestamp::from_ticks(ticks).expect("48 bits");
        let key = SigningKey::<Hmac>::new(&[7; 32]).expect("a key");
        let mut streams = StreamTable::<4>::new(Links::Any, Window::STRICT);
        let header = |system_id| Header {
            system_id,
            ..HEARTBEAT
        };
        let stamp = |link_id, ticks| Stamp {
            link_id,
            timestamp: at(ticks),
        };
        for system_id in 1..9 {
            let rejection = reflected(&mut streams, &key, header(system_id), stamp(1, 5), at(9));
            let has_row = system_id <= 2;
            assert_eq!(rejection == VerifyError::Replayed, has_row);
            assert_eq!(rejection == VerifyError::StreamsFull, !has_row);
            assert_eq!(streams.closed(), (!has_row).then_some(Links::Only(1)));
        }
        let mut verdict = |link_id, system_id, ticks| {
            let (header, stamp) = (header(system_id), stamp(link_id, ticks));
            step(&mut streams, Timestamp::ZERO, &key, header, stamp, at(9))
        };
        assert_eq!(verdict(1, 200, 6), Err(VerifyError::StreamsFull));
        assert_eq!(verdict(1, 2, 6), Ok(()));
        assert_eq!(verdict(2, 200, 6), Ok(()));
        assert_eq!(verdict(2, 201, 6), Ok(()));
        assert_eq!(verdict(2, 202, 6), Err(VerifyError::StreamsFull));
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
    /// then known to the solver. The third is how many rows are taken for frames that this end sent.
    fn any_streams<const TAKEN: usize>() -> (StreamTable<2>, Timestamp, usize) {
        let any_links = || {
            if kani::any() {
                Links::Any
            } else {
                Links::Only(kani::any())
            }
        };
        let links = any_links();
        let closed = kani::any::<bool>().then(any_links);
        let window = Window {
            past: kani::any(),
            ahead: kani::any(),
        };
        let first = any_timestamp();
        let rows: [_; TAKEN] = core::array::from_fn(|_| {
            (
                stream(any_header(), any_stamp()),
                any_timestamp(),
                kani::any(),
            )
        });
        if let [one, other] = rows.as_slice() {
            kani::assume(one.0 != other.0);
        }
        let own = rows.iter().filter(|(.., own)| *own).count();
        let streams = StreamTable::resume(links, window, first).holding(&rows, closed);
        (streams, first, own)
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
        let (mut streams, first, own) = any_streams::<TAKEN>();
        let (header, stamp, now) = (any_header(), any_stamp(), any_timestamp());
        let (links, window) = (streams.links(), streams.window());
        let verdict = step(&mut streams, first, &key, header, stamp, now);
        assert_eq!((streams.links(), streams.window()), (links, window));
        assert_eq!(streams.floor(), Some(first), "of every stream");
        assert_eq!(streams.own_rows(), own, "a peer's row is not its own");
        kani::cover!(verdict.is_ok(), "accepted");
        kani::cover!(verdict == Err(VerifyError::Replayed), "replayed");
        kani::cover!(verdict == Err(VerifyError::StreamsFull), "full, or closed");
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

    fn comes_back<const TAKEN: usize>() {
        let key = SigningKey::<AnyTag>::new(&[1; 32]).expect("a key");
        let (mut streams, first, own) = any_streams::<TAKEN>();
        let (header, stamp, now) = (any_header(), any_stamp(), any_timestamp());
        let rejection = reflected(&mut streams, &key, header, stamp, now);
        let taken = streams.rows().count() > TAKEN;
        assert!(!taken || own == 0, "half of two rows");
        assert_eq!(streams.own_rows(), own + usize::from(taken));
        assert_eq!(streams.floor(), Some(first), "of every stream");
        kani::cover!(rejection == VerifyError::Replayed, "replayed");
        kani::cover!(rejection == VerifyError::TooOld, "too old");
        kani::cover!(matches!(rejection, VerifyError::WrongLink(_)), "wrong link");
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn r2_reflected_empty() {
        comes_back::<0>();
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn r2_reflected_half() {
        comes_back::<1>();
    }

    #[kani::proof]
    #[kani::unwind(33)]
    fn r2_reflected_full() {
        comes_back::<2>();
    }
}
