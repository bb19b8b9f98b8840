//! An end of a link between two lines: bytes in, bytes out, line events and deadlines.

use mavlink_signing::LinkClock;

/// One of the two lines of an [`Endpoint`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Side {
    /// The trusted side: a cable to equipment that can neither sign nor seal.
    Local,
    /// The radio, or a network: where the attacker is.
    Link,
}

impl Side {
    /// The other line.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::Local => Self::Link,
            Self::Link => Self::Local,
        }
    }
}

/// What a port driver has noticed on its line, beside bytes.
///
/// **A driver must report every overrun, framing error and noise.** Bytes were lost, inserted or changed there, and
/// the end of the packet that has begun is no longer known. Without the report, what lies inside a payload of the
/// local side may be taken for a packet, and signed. Report it after the bytes that came before it, and before the
/// bytes that came after it. A driver that cannot tell where the fault was reports it before all bytes that it still
/// holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LineEvent {
    /// Bytes were lost, because nobody took them in time: in the UART, in a DMA ring, in a queue.
    Overrun,
    /// A byte without its stop bit, or a break.
    FramingError,
    /// A byte with noise or a wrong parity bit.
    Noise,
    /// The line has been silent for longer than its sender ever pauses within a packet. A UART's own idle flag comes
    /// after one byte time: report it only where the sender makes no such pauses.
    Idle,
    /// The line is closed: unplugged, disconnected, ended.
    Closed,
}

/// An end of a link as a state machine: no port, no clock, no waiting.
///
/// The caller moves the bytes and asks again after each call:
///
/// * Bytes that came in on a line go to [`received`](Self::received). What it does not take, the caller keeps and
///   offers again when [`transmit`](Self::transmit) or [`sent`](Self::sent) has made room.
/// * Bytes that are to go out come from [`transmit`](Self::transmit), or from [`pending`](Self::pending) and
///   [`sent`](Self::sent) where a port or a DMA channel takes a part of them.
/// * When the time [`poll_at`](Self::poll_at) has come, [`poll`](Self::poll) is due. Both may have changed with each
///   of the other calls.
/// * What is no byte goes to [`line_event`](Self::line_event): see [`LineEvent`] for what must be reported.
///
/// Each direction holds one packet that comes in and one frame that goes out. A line that takes no bytes stops its
/// own direction and no other. Nothing that was taken is lost, and what becomes of it does not depend on how the
/// bytes were cut into calls.
///
/// With a clock that stores its mark, such as [`PersistentClock`](crate::PersistentClock), each call but
/// [`pending`](Self::pending), [`room`](Self::room) and [`poll_at`](Self::poll_at) may wait for the flash: for a write
/// now and then, and every 128 marks for an erase, which takes tens of milliseconds.
///
/// In each call `clock` gives the time, and `observe` sees what became of each packet, in order.
pub trait Endpoint {
    /// What became of something.
    type Event;

    /// Bytes from `side` that [`received`](Self::received) takes for certain. It may take more. Never 0 unless
    /// something is [`pending`](Self::pending) for the other side.
    fn room(&self, side: Side) -> usize;

    /// Takes bytes that came in on `side` from the front of `bytes`; returns how many.
    fn received(
        &mut self,
        side: Side,
        bytes: &[u8],
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(Self::Event),
    ) -> usize;

    /// Bytes that are to go out on `side` next, 0 to 280. They stay the same until [`sent`](Self::sent).
    fn pending(&self, side: Side) -> &[u8];

    /// Says that the first `count` bytes of [`pending`](Self::pending) have left on `side`.
    fn sent(
        &mut self,
        side: Side,
        count: usize,
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(Self::Event),
    );

    /// Moves bytes that are to go out on `side` into `buffer`, as many as there are and fit; returns how many.
    fn transmit(
        &mut self,
        side: Side,
        buffer: &mut [u8],
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(Self::Event),
    ) -> usize {
        let mut filled = 0;
        loop {
            let free = buffer.get_mut(filled..).unwrap_or_default();
            let mut count = 0;
            for (slot, byte) in free.iter_mut().zip(self.pending(side)) {
                *slot = *byte;
                count += 1;
            }
            if count == 0 {
                return filled;
            }
            filled += count;
            self.sent(side, count, clock, observe);
        }
    }

    /// Takes note of what happened on the line of `side`.
    ///
    /// * [`Overrun`](LineEvent::Overrun), [`FramingError`](LineEvent::FramingError), [`Noise`](LineEvent::Noise): the
    ///   packet that has begun is given up. The link side is searched for the next packet at once. The local side
    ///   becomes deaf: its bytes are dropped and counted until the line has been silent for the idle time.
    /// * [`Idle`](LineEvent::Idle): what has begun is given up, and a deaf side hears again.
    /// * [`Closed`](LineEvent::Closed): as an overrun. In addition the frame that was to go out on `side` is dropped
    ///   and counted; it may have left in part.
    fn line_event(
        &mut self,
        side: Side,
        event: LineEvent,
        clock: &mut impl LinkClock,
        observe: &mut impl FnMut(Self::Event),
    );

    /// When [`poll`](Self::poll) is due, in ticks of [`LinkClock::monotonic`]; a time that has passed means now, and
    /// `None` that it waits for bytes alone.
    fn poll_at(&self) -> Option<u64>;

    /// Does what the time asks for. Early or superfluous calls do no harm.
    fn poll(&mut self, clock: &mut impl LinkClock, observe: &mut impl FnMut(Self::Event));
}
