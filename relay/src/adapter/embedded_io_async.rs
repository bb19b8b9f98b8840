//! Ports of `embedded_io_async`, in one task of any executor.

use core::cell::RefCell;
use core::future::poll_fn;
use core::task::Poll;

use embassy_futures::select::{Either5, select, select5};
use embassy_futures::yield_now;
use embedded_io_async::{ErrorType, Read, Write};
use mavlink_signing::{LinkClock, field::MAX_FRAME_SIZE};

use crate::endpoint::{Endpoint, LineEvent, Side};

/// Bytes read at a time.
const READ_SIZE: usize = 64;

/// One line: both halves of a port, and what the errors of the one that is read mean.
#[derive(Debug)]
pub struct Line<R: ErrorType, W> {
    /// Where bytes come in.
    pub reader: R,
    /// Where bytes go out.
    pub writer: W,
    /// What an error of `reader` is reported as. [`LineEvent::Closed`] ends [`run`].
    pub fault: fn(R::Error) -> LineEvent,
}

/// Moves bytes between `endpoint` and two lines until one of them is closed; returns which.
///
/// A line is closed when its reader reads 0 bytes or fails as [`LineEvent::Closed`], or when its writer
/// takes 0 bytes or fails. No read
/// and no write is given up before that, so that they need not be cancel safe.
///
/// `wait_until` waits for a time of `clock`'s [`monotonic`](LinkClock::monotonic), in ticks of 10 microseconds. It may
/// be given up.
pub async fn run<E: Endpoint>(
    endpoint: &mut E,
    local: Line<impl Read, impl Write>,
    link: Line<impl Read, impl Write>,
    clock: &mut impl LinkClock,
    mut wait_until: impl AsyncFnMut(u64),
    observe: &mut impl FnMut(E::Event),
) -> Side {
    let shared = &Shared(RefCell::new((endpoint, clock, observe)));
    let closed = select5(
        shared.read(Side::Local, local.reader, local.fault),
        shared.read(Side::Link, link.reader, link.fault),
        shared.write(Side::Local, local.writer),
        shared.write(Side::Link, link.writer),
        shared.keep_time(&mut wait_until),
    )
    .await;
    let side = match closed {
        Either5::First(()) | Either5::Third(()) => Side::Local,
        Either5::Second(()) | Either5::Fourth(()) => Side::Link,
        Either5::Fifth(never) => match never {},
    };
    shared.line_event(side, LineEvent::Closed);
    side
}

/// What all futures of [`run`] use in turn. None holds it while it waits.
///
/// They are polled by one task: whoever changes something wakes it, so that the others look again.
struct Shared<'a, E, C, O>(RefCell<(&'a mut E, &'a mut C, &'a mut O)>);

impl<E: Endpoint, C: LinkClock, O: FnMut(E::Event)> Shared<'_, E, C, O> {
    async fn read<R: Read>(&self, side: Side, mut reader: R, fault: fn(R::Error) -> LineEvent) {
        let mut bytes = [0; READ_SIZE];
        loop {
            match reader.read(&mut bytes).await {
                Ok(0) => return,
                Ok(count) => {
                    self.received(side, bytes.get(..count).unwrap_or_default())
                        .await
                }
                Err(error) => match fault(error) {
                    LineEvent::Closed => return,
                    event => {
                        self.line_event(side, event);
                        // Wakes the others, and lets them have their turn if the reader fails again at once.
                        yield_now().await;
                    }
                },
            }
        }
    }

    /// Waits until all of `bytes` have been taken.
    async fn received(&self, side: Side, mut bytes: &[u8]) {
        poll_fn(|context| {
            let (endpoint, clock, observe) = &mut *self.0.borrow_mut();
            let count = endpoint.received(side, bytes, *clock, *observe);
            bytes = bytes.get(count..).unwrap_or_default();
            if count > 0 {
                context.waker().wake_by_ref();
            }
            if bytes.is_empty() {
                Poll::Ready(())
            } else {
                Poll::Pending
            }
        })
        .await;
    }

    async fn write(&self, side: Side, mut writer: impl Write) {
        let mut bytes = [0; MAX_FRAME_SIZE];
        loop {
            let count = poll_fn(|context| {
                let (endpoint, clock, observe) = &mut *self.0.borrow_mut();
                let count = endpoint.transmit(side, &mut bytes, *clock, *observe);
                if count == 0 {
                    return Poll::Pending;
                }
                context.waker().wake_by_ref();
                Poll::Ready(count)
            })
            .await;
            let mut rest = bytes.get(..count).unwrap_or_default();
            // Not `write_all`, which panics where a port has ended.
            while !rest.is_empty() {
                match writer.write(rest).await {
                    Ok(0) | Err(_) => return,
                    Ok(written) => rest = rest.get(written..).unwrap_or_default(),
                }
            }
            if writer.flush().await.is_err() {
                return;
            }
        }
    }

    async fn keep_time(&self, wait_until: &mut impl AsyncFnMut(u64)) -> core::convert::Infallible {
        loop {
            let at = self.0.borrow().0.poll_at();
            let changed = poll_fn(|_| {
                if self.0.borrow().0.poll_at() == at {
                    Poll::Pending
                } else {
                    Poll::Ready(())
                }
            });
            match at {
                Some(at) => {
                    select(wait_until(at), changed).await;
                }
                None => changed.await,
            }
            self.poll();
            // Wakes the writers, which may have something to write now.
            yield_now().await;
        }
    }

    fn poll(&self) {
        let (endpoint, clock, observe) = &mut *self.0.borrow_mut();
        endpoint.poll(*clock, *observe);
    }

    fn line_event(&self, side: Side, event: LineEvent) {
        let (endpoint, clock, observe) = &mut *self.0.borrow_mut();
        endpoint.line_event(side, event, *clock, *observe);
    }
}
