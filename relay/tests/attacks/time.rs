//! Recordings of other streams do not pull a clock back that nobody has told the time.

use std::cell::Cell;

use mavlink_signing::*;
use mavseal_relay::*;
use mavseal_store::model::Flash;

use crate::common::*;

const KEY: [u8; 32] = [1; 32];

/// The attacker has no key and jams nothing. He has recorded another vehicle an hour ago, which this end never heard.
#[test]
fn recordings_do_not_pull_an_unsynced_clock_back() {
    for attacked in [false, true] {
        let timer = Cell::new(1000u64);
        let flash = LinkFlash {
            keys: Flash::<2>::new(1),
            marks: [Flash::new(2), Flash::new(3)],
            region: REGION,
        };
        let (keys, mut m) =
            LinkMemory::open::<Standard>(flash, FirstKey::Own(&KEY), || timer.get()).unwrap();
        let mut r = Relay::new(
            keys,
            Stamper::new(1),
            StreamTable::<16>::new(Links::Any, Window::ONE_MINUTE),
            ForwardMode::KeepSignature,
        )
        .unwrap();
        // The station: synced.
        let mut station = StreamTable::<16>::new(Links::Any, Window::ONE_MINUTE);
        let key = SigningKey::<Standard>::new(&KEY).unwrap();
        let (mut passed, mut old, mut back) = (0, 0, 0);
        for second in 0..600u64 {
            timer.set(1000 + second * S);
            let now = NOW + second * S;
            let mut hear = |r: &mut Relay<Standard, StreamTable<16>>, f: Frame| {
                r.received(Side::Link, f.as_bytes(), &mut m.clock, &mut |_| {});
                let n = r.pending(Side::Local).len();
                r.sent(Side::Local, n, &mut m.clock, &mut |_| {});
                n > 0
            };
            assert!(
                hear(&mut r, signed::<Standard>(&KEY, 255, 0, now)),
                "the station is heard"
            );
            if attacked {
                assert!(
                    hear(&mut r, signed::<Standard>(&KEY, 7, 3, now - 3600 * S)),
                    "the recording is accepted"
                );
            }
            timer.set(1000 + second * S + S / 2);
            if m.clock.now().ticks() + 60 * S < now {
                back += 1
            }
            let h = Header {
                compat_flags: 0,
                sequence: 0,
                system_id: 1,
                component_id: 1,
                message_id: MessageId::from(0),
            };
            let f = Frame::new(h, &[5, 0, 0, 0, 2, 3, 81, 4, 3]).unwrap();
            r.received(Side::Local, f.as_bytes(), &mut m.clock, &mut |_| {});
            let out = r.pending(Side::Link).to_vec();
            r.sent(Side::Link, out.len(), &mut m.clock, &mut |_| {});
            let frame = FrameRef::parse(&out).unwrap();
            match station.admit(authenticate(frame, &key).unwrap(), at(now + S / 2)) {
                Ok(_) => passed += 1,
                Err(VerifyError::TooOld) => old += 1,
                Err(e) => panic!("{e:?}"),
            }
        }
        println!(
            "attacked {attacked}: of 600 frames the synced station accepts {passed}, rejects as too old {old}; clock far behind what was accepted: {back} times"
        );
        if attacked {
            assert_eq!(old, 0);
        }
    }
}
