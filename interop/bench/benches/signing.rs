//! Sign and verify: the floor, the core and the peers, one after another.
//!
//! The program of this package (`cargo run`) runs this, asks pymavlink too, and puts the times beside each other.

use std::{hint::black_box, time::SystemTime};

use criterion::{
    BenchmarkGroup, BenchmarkId, Criterion, SamplingMode, criterion_group, criterion_main,
    measurement::WallTime,
};
use mavlink_signing::{Hmac, Profile, Standard, field::MAX_FRAME_SIZE};
use mavseal_bench::{
    checksums::{Checksum, Crc16, Crc16Tables, CrcAny, CrcFast, Crcxx8Tables, Crcxx16Tables},
    floor::{self, Input},
    here,
    messages::{FRAMES, MESSAGES, Message},
    pass::{CAN_SEPARATE, time},
    peers::{mavio, mavlink},
};

type Group<'a> = BenchmarkGroup<'a, WallTime>;

criterion_group!(benches, all);
criterion_main!(benches);

fn all(criterion: &mut Criterion) {
    if CAN_SEPARATE {
        everybody::<true>(&mut criterion.benchmark_group("one at a time"));
    }
    everybody::<false>(&mut criterion.benchmark_group("back to back"));
}

fn everybody<const SEPARATE: bool>(group: &mut Group) {
    group.sampling_mode(SamplingMode::Flat);
    let nothing = [(); FRAMES];
    group.bench_function("nothing", |bencher| {
        bencher.iter_custom(|count| time::<SEPARATE, _, _, _>(count, &nothing, || (), |(), ()| ()));
    });
    // The crate `mavlink` asks it for each frame; the core is told.
    group.bench_function("clock", |bencher| {
        bencher.iter_custom(|count| {
            time::<SEPARATE, _, _, _>(count, &nothing, || (), |(), ()| SystemTime::now())
        });
    });
    for message in &MESSAGES {
        let standard = message.frames::<Standard>();
        let hmac = message.frames::<Hmac>();
        floors::<SEPARATE>(group, message, floor::Profile::Hmac, &hmac);
        floors::<SEPARATE>(group, message, floor::Profile::Standard, &standard);
        core::<SEPARATE, Hmac>(group, message, "Hmac", &hmac);
        core::<SEPARATE, Standard>(group, message, "Standard", &standard);
        mavlink::<SEPARATE>(group, message, &standard);
        mavio::<SEPARATE>(group, message, &standard);
    }
}

/// What the floor is the sum of: the compressions, and the fastest checksum.
fn floors<const SEPARATE: bool>(
    group: &mut Group,
    message: &Message,
    profile: floor::Profile,
    frames: &[Vec<u8>],
) {
    let input = |frame: &Vec<u8>| Input::of(profile, message, frame);
    let inputs: Vec<_> = frames.iter().map(input).collect();
    let who = format!("compressions {}", profile.name());
    group.bench_function(BenchmarkId::new(who, message.size), |bencher| {
        bencher.iter_custom(|count| {
            time::<SEPARATE, _, _, _>(count, &inputs, || (), |(), input| input.compress())
        });
    });
    if profile == floor::Profile::Standard {
        checksum::<SEPARATE, Crc16Tables>(group, message, &inputs);
        checksum::<SEPARATE, Crcxx8Tables>(group, message, &inputs);
        checksum::<SEPARATE, Crcxx16Tables>(group, message, &inputs);
        checksum::<SEPARATE, CrcFast>(group, message, &inputs);
        checksum::<SEPARATE, CrcAny>(group, message, &inputs);
        checksum::<SEPARATE, Crc16>(group, message, &inputs);
    }
}

fn checksum<const SEPARATE: bool, C: Checksum>(
    group: &mut Group,
    message: &Message,
    inputs: &[Input],
) {
    for input in inputs {
        let right = input.checksum::<Crc16Tables>();
        assert_eq!(input.checksum::<C>(), right, "{}", C::NAME);
    }
    let who = format!("checksum: {}", C::NAME);
    group.bench_function(BenchmarkId::new(who, message.size), |bencher| {
        bencher.iter_custom(|count| {
            time::<SEPARATE, _, _, _>(count, inputs, || (), |(), input| input.checksum::<C>())
        });
    });
}

fn core<const SEPARATE: bool, P: Profile>(
    group: &mut Group,
    message: &Message,
    name: &str,
    frames: &[Vec<u8>],
) {
    let key = here::key::<P>();
    let payloads = payloads(message);
    group.bench_function(sign(name, message), |bencher| {
        bencher.iter_custom(|count| {
            time::<SEPARATE, _, _, _>(count, &payloads, here::sender, |sender, payload| {
                here::sign(message, payload, &key, sender)
            })
        });
    });
    group.bench_function(verify(name, message), |bencher| {
        bencher.iter_custom(|count| {
            time::<SEPARATE, _, _, _>(count, frames, here::one_stream, |receiver, frame| {
                here::verify(frame, &key, receiver)
            })
        });
    });
    let id = BenchmarkId::new(format!("{name} verify, streams"), message.size);
    group.bench_function(id, |bencher| {
        bencher.iter_custom(|count| {
            time::<SEPARATE, _, _, _>(count, frames, here::streams, |receiver, frame| {
                here::verify(frame, &key, receiver)
            })
        });
    });
}

fn mavlink<const SEPARATE: bool>(group: &mut Group, message: &Message, frames: &[Vec<u8>]) {
    let messages: Vec<_> = frames.iter().map(|_| mavlink::message(message)).collect();
    group.bench_function(sign("mavlink", message), |bencher| {
        bencher.iter_custom(|count| {
            time::<SEPARATE, _, _, _>(count, &messages, mavlink::endpoint, |endpoint, message| {
                mavlink::sign(message, endpoint)
            })
        });
    });
    group.bench_function(verify("mavlink", message), |bencher| {
        bencher.iter_custom(|count| {
            time::<SEPARATE, _, _, _>(count, frames, mavlink::endpoint, |endpoint, frame| {
                mavlink::verify(frame, endpoint)
            })
        });
    });
}

fn mavio<const SEPARATE: bool>(group: &mut Group, message: &Message, frames: &[Vec<u8>]) {
    let payloads = payloads(message);
    group.bench_function(sign("mavio", message), |bencher| {
        bencher.iter_custom(|count| {
            time::<SEPARATE, _, _, _>(count, &payloads, mavio::endpoint, |endpoint, payload| {
                let mut buffer = [0; MAX_FRAME_SIZE];
                mavio::sign(message, payload, endpoint, &mut buffer);
                black_box(&buffer);
            })
        });
    });
    group.bench_function(verify("mavio", message), |bencher| {
        bencher.iter_custom(|count| {
            time::<SEPARATE, _, _, _>(count, frames, mavio::endpoint, |endpoint, frame| {
                mavio::verify(frame, endpoint)
            })
        });
    });
}

fn payloads(message: &Message) -> Vec<Vec<u8>> {
    vec![message.payload(); FRAMES]
}

fn sign(who: &str, message: &Message) -> BenchmarkId {
    BenchmarkId::new(format!("{who} sign"), message.size)
}

fn verify(who: &str, message: &Message) -> BenchmarkId {
    BenchmarkId::new(format!("{who} verify"), message.size)
}
