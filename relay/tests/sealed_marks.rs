//! Marks of a sealed end: power cuts while they are provisioned, and what they wear.

mod links;
mod ports;

use std::cell::RefCell;
use std::rc::Rc;

use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use links::{Driven, OTHER, RADIO, SECOND, STATION, Time, VEHICLE, counter, sealer};
use mavlink_commsec::{AesGcm, SenderId};
use mavseal_relay::sealed::{HighWaterMarks, MarksError, Pace, Place};
use mavseal_store::{
    MarkError, Region,
    model::{Failure, Flash, PAGE_SIZE},
};

/// One flash of three regions, which lose their power together.
#[derive(Clone)]
struct Chip(Rc<RefCell<Flash<6>>>);

impl ErrorType for Chip {
    type Error = Failure;
}

impl ReadNorFlash for Chip {
    const READ_SIZE: usize = Flash::<6>::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failure> {
        self.0.borrow_mut().read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.borrow().capacity()
    }
}

impl NorFlash for Chip {
    const WRITE_SIZE: usize = Flash::<6>::WRITE_SIZE;
    const ERASE_SIZE: usize = Flash::<6>::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Failure> {
        self.0.borrow_mut().erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failure> {
        self.0.borrow_mut().write(offset, bytes)
    }
}

type Marks = Result<HighWaterMarks<Chip, 2>, MarksError>;

impl Chip {
    fn new(chance: u64) -> Self {
        Self(Rc::new(RefCell::new(Flash::new(chance))))
    }

    fn places(&self) -> (Place<Self>, [Place<Self>; 2]) {
        let place = |at: u32| {
            let page_size = PAGE_SIZE as u32;
            let start = 2 * at * page_size;
            (self.clone(), Region { start, page_size })
        };
        (place(0), [place(1), place(2)])
    }

    fn provision(&self) -> Marks {
        let (sent, accepted) = self.places();
        HighWaterMarks::provision::<AesGcm>(&VEHICLE, &[STATION, OTHER], sent, accepted)
    }

    fn open(&self) -> Marks {
        let (sent, accepted) = self.places();
        HighWaterMarks::open::<AesGcm>(&VEHICLE, &[STATION, OTHER], sent, accepted)
    }

    /// Starts the board: the marks that are there, or those of a board that was never provisioned.
    fn start(&self) -> Marks {
        match self.open() {
            Err(MarksError::NotProvisioned) => self.provision(),
            opened => opened,
        }
    }

    fn restart(&self) {
        self.0.borrow_mut().restart();
    }

    fn cut_after(&self, steps: u32) {
        self.0.borrow_mut().cut_after(steps);
    }

    fn has_power(&self) -> bool {
        self.0.borrow().has_power()
    }
}

/// As many cuts as leave a board that starts by itself, however a cut leaves words.
fn cut(chance: u64, cuts: &[u32]) {
    let chip = Chip::new(chance);
    for steps in cuts {
        chip.cut_after(*steps);
        let started = chip.start();
        assert_eq!(
            started.is_ok(),
            chip.has_power(),
            "{cuts:?}, chance {chance}"
        );
        chip.restart();
    }
    for _ in 0..4 {
        let started = chip.start().map(drop);
        assert_eq!(started, Ok(()), "{cuts:?}, chance {chance}");
    }
    if !chance.is_multiple_of(8) {
        return;
    }
    // Once all is stored, a region that is lost is no new one.
    let (sent, accepted) = chip.places();
    for (at, (mut flash, region)) in [sent].into_iter().chain(accepted).enumerate() {
        let lost = Chip(Rc::new(RefCell::new(chip.0.borrow().clone())));
        let end = region.start + 2 * region.page_size;
        flash.0 = lost.0.clone();
        flash.erase(region.start, end).expect("a flash");
        let id = [7, 5, 6][at];
        let none = MarksError::Mark(SenderId(id), MarkError::NotProvisioned);
        assert_eq!(lost.start().err(), Some(none));
    }
}

#[test]
fn a_cut_at_any_write_of_provisioning_leaves_a_board_that_starts() {
    for chance in 0..6 {
        for steps in 0..40 {
            cut(chance, &[steps]);
        }
    }
}

/// Two cuts, each before or in any write.
fn two_cuts(firsts: impl Iterator<Item = u32>) {
    for first in firsts {
        for second in 0..40 {
            cut(u64::from(first * 40 + second), &[first, second]);
        }
    }
}

#[test]
fn two_cuts_leave_a_board_that_starts() {
    two_cuts((0..40).step_by(7));
}

#[test]
#[ignore = "half a minute, optimised; `cargo xtask test --all` runs it"]
fn any_two_cuts_leave_a_board_that_starts() {
    two_cuts(0..40);
}

#[test]
fn three_cuts_leave_a_board_that_starts() {
    for chance in 0..200 {
        let [a, b, c, ..] = 0x9E37_79B9_7F4A_7C15_u64.wrapping_mul(chance).to_le_bytes();
        cut(chance, &[a, b, c].map(|steps| u32::from(steps % 40)));
    }
}

/// Words that the marks of a vehicle take in so many seconds, in which it seals and opens packages at this rate: of
/// the counters that it seals with, and of those accepted.
fn words(rate: u32, seconds: u32, clocked: bool) -> [u64; 2] {
    let flashes = links::provisioned(&VEHICLE, &[STATION]);
    let mut vehicle = Driven::new(&VEHICLE, &[STATION], flashes, RADIO);
    let mut station = sealer(&STATION, 1);
    let mut time = Time { timer: 1, clock: 0 };
    if clocked {
        vehicle = vehicle.clocked(0);
    }
    for at in 0..seconds * rate {
        // In bursts of four.
        if at % 4 == 0 {
            time.pass(4 * SECOND / u64::from(rate));
        }
        if clocked {
            station.advance_to((time.clock * 64 / SECOND) as u32);
        }
        assert!(vehicle.seal(at, &mut time).is_some());
        let package = station.seal(&[0; 80]).expect("counters");
        assert_eq!(vehicle.open(package.as_bytes(), &mut time), None);
        vehicle.events.clear();
        vehicle.local.output.clear();
    }
    let (sent, [accepted]) = vehicle.into_flashes();
    [sent.writes(), accepted.writes()]
}

/// How long marks live, by the rate of packages. The table in docs/figures.md is what this prints.
#[test]
fn marks_outlive_a_board() {
    // Of two pages of 2 KB, each erased 10,000 times, in words.
    let all = 10_000.0 * (2 * PAGE_SIZE / 8) as f64;
    println!("| baud | packages a second | own mark | mark of a peer |");
    for (baud, rate, seconds, clocked) in [
        (9_600, 10, 600, false),
        (57_600, 58, 600, false),
        (57_600, 58, 300, true),
        (115_200, 117, 240, false),
        (921_600, 937, 60, false),
    ] {
        // Without the first minute, in which marks are stored more often.
        let [first, then] = [60, 60 + seconds].map(|seconds| words(rate, seconds, clocked));
        let days = [0, 1].map(|at| {
            let words = (then[at] - first[at]).max(1) as f64;
            all / words * f64::from(seconds) / 86_400.0
        });
        let clock = if clocked { ", with a clock" } else { "" };
        println!(
            "| {baud}{clock} | {rate} | {:.0} days | {:.0} days |",
            days[0], days[1]
        );
        assert!(days[1] > 140.0, "{baud}: {days:?}");
        assert!(
            days[0] > if clocked { 280.0 } else { 700.0 },
            "{baud}: {days:?}"
        );
    }
}

/// After a restart no more is lost than came in ten seconds, at any rate; and a start does not store many marks.
#[test]
fn a_restart_costs_ten_seconds() {
    for rate in [1, 10, 58, 300] {
        let flashes = links::provisioned(&VEHICLE, &[STATION]);
        let mut vehicle = Driven::new(&VEHICLE, &[STATION], flashes, RADIO);
        let mut station = sealer(&STATION, 1);
        let mut time = Time { timer: 1, clock: 0 };
        let mut last = 0;
        for at in 0..75 * rate {
            time.pass(SECOND / u64::from(rate));
            let package = station.seal(&[0; 80]).expect("counters");
            assert_eq!(vehicle.open(package.as_bytes(), &mut time), None);
            last = vehicle
                .seal(at, &mut time)
                .map_or(last, |package| counter(&package));
        }
        let (sent, [accepted]) = vehicle.into_flashes();
        // Two records of two words for each mark, and six of the first.
        let marks = (accepted.writes() - 12) / 4;
        assert!(marks <= 7 + 10, "{rate}: {marks} marks");
        let mut vehicle = Driven::new(&VEHICLE, &[STATION], (sent, [accepted]), RADIO);
        let mut lost = 0;
        loop {
            let package = station.seal(&[0; 80]).expect("counters");
            if vehicle.open(package.as_bytes(), &mut time).is_none() {
                break;
            }
            lost += 1;
        }
        let most = (10 * rate).max(8);
        assert!(lost <= most, "{rate}: {lost} lost");
        let first = counter(&vehicle.seal(0, &mut time).expect("sealed"));
        assert!(first > last);
        assert!(u64::from(first - last) <= u64::from(60 * rate).max(Pace::SENT.least) + 1);
    }
}

/// Whoever has a peer's key and jumps stores no more marks than jumps are bounded to.
#[test]
fn jumps_do_not_wear_the_flash_out() {
    let flashes = links::provisioned(&VEHICLE, &[STATION]);
    let mut vehicle = Driven::new(&VEHICLE, &[STATION], flashes, RADIO);
    let mut time = Time { timer: 1, clock: 0 };
    let mut counter = 1;
    let mut opened = 0;
    for _ in 0..20_000 {
        time.pass(SECOND / 58);
        let package = sealer(&STATION, counter).seal(&[0; 80]).expect("counters");
        opened += u32::from(vehicle.open(package.as_bytes(), &mut time).is_none());
        counter += Pace::ACCEPTED.most as u32 + 1;
        vehicle.events.clear();
        vehicle.local.output.clear();
    }
    assert!((4000..4200).contains(&opened), "{opened} opened");
    // Of 10,000.
    assert!(vehicle.end.erases() <= 40, "{}", vehicle.end.erases());
}
