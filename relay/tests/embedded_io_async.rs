//! The relay as one task of an executor that polls it only when it is woken.

use std::{
    cell::{Cell, RefCell},
    collections::VecDeque,
    future::{Future, poll_fn},
    pin::Pin,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context, Poll, Wake, Waker},
};

use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use mavlink_signing::{
    Frame, Header, Hmac, MessageId, ReplayGuard, SigningKey, Stamp, Stamper, Timestamp, Window,
    sign_frame,
};
use mavseal_relay::{
    ForwardMode, IDLE, LineEvent, Relay, Side,
    adapter::embedded_io_async::{Line, run},
};

const NOW: u64 = 37_555_200_000_000;
const LINK_OUT: u8 = 1;
const LINK_IN: u8 = 2;
/// More polls than any test needs.
const MANY: u32 = 10_000;

fn at(ticks: u64) -> Timestamp {
    Timestamp::from_ticks(ticks).expect("48 bits")
}

fn key() -> SigningKey<Hmac> {
    SigningKey::new(&[7; 32]).expect("a key")
}

fn unsigned(payload: &[u8]) -> Frame {
    let header = Header {
        compat_flags: 0,
        sequence: 9,
        system_id: 1,
        component_id: 1,
        message_id: MessageId::from(0),
    };
    Frame::new(header, payload).expect("a frame")
}

fn signed(payload: &[u8], link_id: u8, ticks: u64) -> Frame {
    let mut frame = unsigned(payload);
    let stamp = Stamp {
        link_id,
        timestamp: at(ticks),
    };
    sign_frame(&mut frame, &key(), stamp).expect("unsigned");
    frame
}

/// What a UART reports in place of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Fault(LineEvent);

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", self.0)
    }
}

impl std::error::Error for Fault {}

impl embedded_io_async::Error for Fault {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// One half of a port, of which the test is the other end.
#[derive(Clone, Default)]
struct Half {
    bytes: Rc<RefCell<VecDeque<u8>>>,
    /// What a reader gives when there are no bytes.
    fault: Rc<Cell<Option<Fault>>>,
    ended: Rc<Cell<bool>>,
    /// Bytes that a writer takes.
    room: Rc<Cell<usize>>,
    waker: Rc<RefCell<Option<Waker>>>,
}

impl Half {
    fn changed(&self) {
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
    }

    fn put(&self, bytes: &[u8]) {
        self.bytes.borrow_mut().extend(bytes);
        self.changed();
    }

    fn taken(&self) -> Vec<u8> {
        self.bytes.borrow_mut().drain(..).collect()
    }
}

impl ErrorType for Half {
    type Error = Fault;
}

impl Read for Half {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Fault> {
        poll_fn(|context| {
            let mut bytes = self.bytes.borrow_mut();
            if !bytes.is_empty() {
                let count = std::io::Read::read(&mut *bytes, buffer).expect("memory");
                return Poll::Ready(Ok(count));
            }
            if let Some(fault) = self.fault.take() {
                return Poll::Ready(Err(fault));
            }
            if self.ended.get() {
                return Poll::Ready(Ok(0));
            }
            *self.waker.borrow_mut() = Some(context.waker().clone());
            Poll::Pending
        })
        .await
    }
}

impl Write for Half {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Fault> {
        poll_fn(|context| {
            let count = bytes.len().min(self.room.get());
            if self.ended.get() {
                return Poll::Ready(Ok(0));
            }
            if count == 0 {
                *self.waker.borrow_mut() = Some(context.waker().clone());
                return Poll::Pending;
            }
            self.room.set(self.room.get() - count);
            self.bytes.borrow_mut().extend(&bytes[..count]);
            Poll::Ready(Ok(count))
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), Fault> {
        Ok(())
    }
}

struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// The task, both lines and the time.
struct Bench {
    task: Pin<Box<dyn Future<Output = Side>>>,
    woken: Arc<Woken>,
    now: Rc<Cell<u64>>,
    alarm: Rc<RefCell<Option<(u64, Waker)>>>,
    local_in: Half,
    local_out: Half,
    link_in: Half,
    link_out: Half,
}

impl Bench {
    fn new() -> Self {
        let halves: [Half; 4] = Default::default();
        let [local_in, local_out, link_in, link_out] = halves;
        local_out.room.set(usize::MAX);
        link_out.room.set(usize::MAX);
        let now = Rc::new(Cell::new(NOW));
        let alarm = Rc::new(RefCell::new(None));
        let line = |reader: &Half, writer: &Half| Line {
            reader: reader.clone(),
            writer: writer.clone(),
            fault: |fault: Fault| fault.0,
        };
        let (local, link) = (line(&local_in, &local_out), line(&link_in, &link_out));
        let (time, alarms) = (now.clone(), alarm.clone());
        let task = async move {
            let replay = ReplayGuard::new(LINK_IN, Window::ONE_MINUTE);
            let stamper = Stamper::new(LINK_OUT);
            let mut relay =
                Relay::new(key(), stamper, replay, ForwardMode::StripSignature).expect("two links");
            let mut clock = || at(time.get());
            let wait_until = async |until| {
                poll_fn(|context| {
                    if time.get() >= until {
                        return Poll::Ready(());
                    }
                    *alarms.borrow_mut() = Some((until, context.waker().clone()));
                    Poll::Pending
                })
                .await;
            };
            run(&mut relay, local, link, &mut clock, wait_until, &mut |_| {}).await
        };
        Self {
            task: Box::pin(task),
            woken: Arc::new(Woken(AtomicBool::new(true))),
            now,
            alarm,
            local_in,
            local_out,
            link_in,
            link_out,
        }
    }

    /// Polls the task until nobody wakes it; the side that has closed.
    fn run(&mut self) -> Option<Side> {
        let waker = Waker::from(self.woken.clone());
        let mut context = Context::from_waker(&waker);
        let mut polls = 0..MANY;
        while self.woken.0.swap(false, Ordering::Relaxed) {
            assert!(polls.next().is_some(), "the task does not come to rest");
            if let Poll::Ready(side) = self.task.as_mut().poll(&mut context) {
                return Some(side);
            }
        }
        None
    }

    fn pass(&mut self, ticks: u64) {
        self.now.set(self.now.get() + ticks);
        let due = self
            .alarm
            .borrow_mut()
            .take_if(|(until, _)| *until <= self.now.get());
        if let Some((_, waker)) = due {
            waker.wake();
        }
        assert_eq!(self.run(), None);
    }
}

#[test]
fn frames_go_both_ways_and_slow_writers_lose_nothing() {
    let mut bench = Bench::new();
    bench.local_out.room.set(0);
    let (mut signed_out, mut stripped) = (Vec::new(), Vec::new());
    for i in 0..30_u8 {
        let payload = [i + 1; 100];
        bench.local_in.put(unsigned(&payload).as_bytes());
        signed_out.extend_from_slice(signed(&payload, LINK_OUT, NOW + u64::from(i)).as_bytes());
        bench
            .link_in
            .put(signed(&payload, LINK_IN, NOW + u64::from(i)).as_bytes());
        stripped.extend_from_slice(unsigned(&payload).as_bytes());
    }
    assert_eq!(bench.run(), None);
    assert_eq!(bench.link_out.taken(), signed_out);
    assert!(
        !bench.link_in.bytes.borrow().is_empty(),
        "memory is bounded"
    );
    let mut output = Vec::new();
    while output.len() < stripped.len() {
        bench.local_out.room.set(7);
        bench.local_out.changed();
        assert_eq!(bench.run(), None);
        let taken = bench.local_out.taken();
        assert!(!taken.is_empty());
        output.extend(taken);
    }
    assert_eq!(output, stripped);
}

#[test]
fn time_gives_up_what_noise_began() {
    let mut bench = Bench::new();
    bench.link_in.put(&[0xFD, 255, 0]);
    bench
        .link_in
        .put(signed(&[1, 2, 3], LINK_IN, NOW).as_bytes());
    assert_eq!(bench.run(), None);
    bench.pass(IDLE);
    assert!(bench.local_out.taken().is_empty());
    bench.pass(IDLE);
    assert_eq!(bench.local_out.taken(), unsigned(&[1, 2, 3]).as_bytes());
}

#[test]
fn a_fault_is_reported_and_the_line_read_on() {
    let mut bench = Bench::new();
    let frame = unsigned(&[1, 2, 3]);
    bench.local_in.fault.set(Some(Fault(LineEvent::Overrun)));
    assert_eq!(bench.run(), None);
    bench.local_in.put(frame.as_bytes());
    assert_eq!(bench.run(), None);
    assert!(bench.link_out.taken().is_empty(), "it is deaf");
    bench.pass(IDLE + 1);
    bench.local_in.put(frame.as_bytes());
    assert_eq!(bench.run(), None);
    assert!(!bench.link_out.taken().is_empty());
}

/// How a line is closed.
type Close = fn(&Bench);

#[test]
fn a_closed_line_ends_it() {
    let cases: [(Close, Side); 4] = [
        (|bench| bench.local_in.ended.set(true), Side::Local),
        (
            |bench| bench.link_in.fault.set(Some(Fault(LineEvent::Closed))),
            Side::Link,
        ),
        (
            |bench| {
                bench.local_out.ended.set(true);
                bench.link_in.put(signed(&[1], LINK_IN, NOW).as_bytes());
            },
            Side::Local,
        ),
        (
            |bench| {
                bench.link_out.ended.set(true);
                bench.local_in.put(unsigned(&[1]).as_bytes());
            },
            Side::Link,
        ),
    ];
    for (close, side) in cases {
        let mut bench = Bench::new();
        close(&bench);
        assert_eq!(bench.run(), Some(side));
    }
}
