//! Measures what needs the wall clock: `cargo xtask measure [NAME..] [--long]`.
//!
//! One measurement runs at a time, and each thing is measured once. Beside it runs a *reference*
//! (`reference`): threads of the scheduling class of the slowest participant, which measure how
//! late the machine was. A finding is
//!
//! - *kept*: every bar was kept;
//! - *broken*: a bar was missed by more than the reference was late in that very time, or something
//!   that no machine can cause was seen;
//! - *not shown*: a bar was missed, but the reference was late, too, or the machine lacks
//!   something.
//!
//! The exit code is 1 only where something is broken. Findings and figures go to a JSON file and a
//! page beside it.

#[path = "../promises/camera.rs"]
mod camera;
#[path = "../../../controller/tests/service/frozen.rs"]
mod frozen;
#[path = "../promises/limits.rs"]
mod limits;
#[path = "../../../controller/tests/judges/spin.rs"]
mod spin;

mod bridge;
mod damage;
mod deadlines;
mod faultless;
mod fixture;
mod floods;
mod hands;
mod hang;
mod judge;
mod load;
mod logging;
mod machine;
mod onlookers;
mod orphans;
mod paced;
mod peers;
mod phase;
mod realtime;
mod recipe;
mod reference;
mod results;
mod sheet;
mod shutdown;
mod soak;
mod startup;
mod stop;
mod stopping;
mod watchdog;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;

use crate::results::{Machine, Page};
use crate::sheet::{Outcome, Sheet};

/// Something that is measured.
pub struct Measurement {
    /// A name to run it by.
    pub name: &'static str,
    /// What is promised, in a sentence.
    pub promise: &'static str,
    /// Whether it runs with `--long` only.
    pub is_long: bool,
    /// Measures, and fills the sheet.
    pub run: Box<dyn Fn(&mut Sheet)>,
}

impl Measurement {
    fn new(name: &'static str, promise: &'static str, run: impl Fn(&mut Sheet) + 'static) -> Self {
        Self {
            name,
            promise,
            is_long: false,
            run: Box::new(run),
        }
    }

    fn long(self) -> Self {
        Self {
            is_long: true,
            ..self
        }
    }
}

/// All measurements, in the order in which they run.
fn measurements() -> Vec<Measurement> {
    let mut all = vec![
        Measurement::new(
            "deadlines 250 Hz",
            "no deadline is missed under load, and the loop wakes up as promptly as a reference",
            |sheet| deadlines::measure(250, sheet),
        ),
        Measurement::new(
            "deadlines 30 Hz",
            "no deadline is missed under load, and the loop wakes up as promptly as a reference",
            |sheet| deadlines::measure(30, sheet),
        ),
    ];
    for strategy in faultless::STRATEGIES {
        all.push(Measurement::new(
            strategy.name,
            "from wake to send the loop has no page fault, blocking call or heap call",
            move |sheet| faultless::measure(strategy, sheet),
        ));
    }
    all.extend([
        Measurement::new(
            "onlookers",
            "views, metrics and a recorder cost the loop no release, fault, block or heap call",
            onlookers::measure,
        ),
        Measurement::new(
            "phase",
            "with clock phase the time from features to command stays in a narrow band",
            phase::measure,
        ),
        Measurement::new(
            "logging",
            "a full disk or an unread log costs no cycle; lost lines are counted",
            logging::measure,
        ),
        Measurement::new(
            "floods",
            "floods, subscribers that never read, and peers that come and go cost no release",
            floods::measure,
        ),
        Measurement::new(
            "stop",
            "under floods a stop is zero within 3 periods, and vpcctl stop returns in 200 ms",
            stop::measure,
        ),
        Measurement::new(
            "hands",
            "whatever a hand does to the stop file, zero goes out within 3 periods",
            hands::measure,
        ),
        Measurement::new(
            "full disk",
            "on a full disk a stop is a stop, and without room for its file nothing starts",
            hands::measure_full_disk,
        ),
        Measurement::new(
            "stop elsewhere",
            "a stop that finds no vpcd names those at work elsewhere, and --all stops each",
            hands::measure_elsewhere,
        ),
        Measurement::new(
            "shutdown",
            "SIGTERM in motion, once or twice: vpcd brakes and exits with 0 within 500 ms",
            shutdown::measure,
        ),
        Measurement::new(
            "hang",
            "when vpcd hangs, the emulated robot stands within 100 ms",
            hang::measure,
        ),
        Measurement::new(
            "peers killed",
            "cameras and clients that are killed come back within 500 ms and leave nothing behind",
            peers::measure_killed,
        ),
        Measurement::new(
            "vpcd killed",
            "the robot stands within 100 ms; the next vpcd commands within 1 s, and is disarmed",
            peers::measure_vpcd,
        ),
        Measurement::new(
            "damage",
            "if a peer's shared memory is damaged, vpcd goes on, or ends and the robot stands",
            damage::measure,
        ),
        Measurement::new(
            "startup",
            "after kill -9 during start-up the next start works, and no files are left",
            startup::measure,
        ),
    ]);
    for fault in bridge::FAULTS {
        all.push(Measurement::new(
            fault.name(),
            "if vpcd, bridge or robot dies or hangs, the arm stands within 150 ms and a frame",
            move |sheet| bridge::measure(fault, sheet),
        ));
    }
    all.extend([
        Measurement::new(
            "bridge, robot gone",
            "a robot that is gone ends the bridge and disarms",
            bridge::measure_missing_robot,
        ),
        Measurement::new(
            "bridge, lockstep",
            "a controller in lockstep moves no robot",
            bridge::measure_lockstep,
        ),
    ]);
    for case in stopping::CASES {
        all.push(Measurement::new(
            case.name,
            "the arm comes to rest in time, by the robot's own report",
            move |sheet| stopping::measure(case, sheet),
        ));
    }
    all.extend([
        Measurement::new(
            "recipe",
            "the recipe for a real robot runs in its folder, with an emulated robot",
            recipe::measure,
        ),
        Measurement::new(
            "realtime",
            "vpcd gets real time where it may have it, and says what is lacking where not",
            realtime::measure,
        ),
        Measurement::new(
            "orphans, demo",
            "the demo leaves nothing behind, however it ends",
            orphans::measure_demo,
        ),
        Measurement::new(
            "orphans, harness",
            "a test harness that aborts or is killed leaves no process behind",
            orphans::measure_harness,
        ),
    ]);
    for hang in watchdog::HANGS {
        all.push(Measurement::new(
            hang.name(),
            "two periods after the loop hangs the watchdog is not fed any more",
            move |sheet| watchdog::measure(hang, sheet),
        ));
    }
    all.push(
        Measurement::new(
            "soak",
            "an hour of random faults leaves nothing behind, and nothing moves on",
            soak::measure,
        )
        .long(),
    );
    all
}

/// Measures what needs the wall clock
#[derive(Parser)]
struct Arguments {
    /// Measurements by their names, or by words in them [default: all]
    names: Vec<String>,
    /// At full length, with those that take an hour
    #[arg(long)]
    long: bool,
    /// The file of the findings; the page goes beside it [default: target/measure/results.json]
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Only list the measurements
    #[arg(long)]
    list: bool,
}

impl Arguments {
    /// The measurements that are asked for.
    fn chosen(&self) -> Vec<Measurement> {
        let all = measurements();
        let is_asked = |measurement: &Measurement| {
            let is_named = |name: &String| {
                let is_whole = all.iter().any(|other| other.name == name);
                match is_whole {
                    true => measurement.name == name,
                    false => measurement.name.contains(name.as_str()),
                }
            };
            match self.names.is_empty() {
                true => self.long || self.list || !measurement.is_long,
                false => self.names.iter().any(is_named),
            }
        };
        let asked: Vec<bool> = all.iter().map(is_asked).collect();
        let chosen = all.into_iter().zip(asked).filter(|(_, is_asked)| *is_asked);
        chosen.map(|(measurement, _)| measurement).collect()
    }
}

fn main() -> ExitCode {
    if orphans::is_harness() {
        orphans::play_a_harness();
    }
    let arguments = Arguments::parse();
    let chosen = arguments.chosen();
    if arguments.list {
        for Measurement { name, promise, .. } in &chosen {
            println!("{name}: {promise}");
        }
        return ExitCode::SUCCESS;
    }
    let file = arguments
        .json
        .unwrap_or_else(|| testkit::target_directory().join("measure/results.json"));
    let mut page = Page::new(Machine::this(), arguments.long);
    for measurement in &chosen {
        let finding = Sheet::fill(measurement, arguments.long);
        println!("{finding}");
        page.findings.push(finding);
        // After each, so that an interrupted run leaves what it found.
        if let Err(error) = page.write(&file) {
            eprintln!("{}: {error}", file.display());
            return ExitCode::from(73);
        }
    }
    println!("{}", page.summary());
    println!("findings: {}", file.display());
    let is_broken = page.count(Outcome::is_broken) > 0;
    match chosen.is_empty() {
        true => ExitCode::from(64),
        false => ExitCode::from(u8::from(is_broken)),
    }
}
