//! A simulation of `vpcd` in virtual time: the real decision ([`decision::ControlStep`]), the
//! emulator's camera, the dead man of the contract, the real grid of releases, phase loop and stop
//! file, with a robot, operators and another program, on a clock that [`world`] moves. One seed
//! decides every choice; what goes wrong ([`fault`]) is the seed's remainder by the number of
//! faults. After each event [`property`] and [`trial`] check what must hold. The first property that
//! does not hold is one line, with the seed that repeats it and tells every command:
//!
//! ```sh
//! cargo test --test simulation                               # 1,000 runs, some 8 s of one processor
//! SIM_SEEDS=20000 cargo test --test simulation               # the first 20,000 seeds
//! VPC_LONG=1 cargo test --test simulation                    # 100,000 runs
//! SIM_SEED=204 cargo test --test simulation -- --nocapture   # that run, told line by line
//! ```
//!
//! What is not shown here: the loop itself (`controller/src/cycle.rs`), whose order [`daemon`]
//! repeats, and its ports. `cargo test --test daemon` shows that it passes on what it receives;
//! `cargo xtask measure` shows it in real time.
//!
//! Each promise that tests in real time showed before, the property that shows it now, and the line
//! that was seen when its mechanism was taken out of a copy (alone, or with others that these faults do not meet):
//!
//! | promise | test before | property now | seen to fail without | line |
//! |---|---|---|---|---|
//! | silence brakes within 3 periods | `silence` | `silence:` of every command | `Gate::is_stale` | `SIM_SEED=5 (Silence) silence: the law's command 129 ms after it` |
//! | so does a camera that goes back in time | `silence` | `brake:` | the order in `Gate::wrong_time` | `SIM_SEED=7 (Older) brake: the law goes on for 108 ms` |
//! | or repeats an exposure | `silence` | `brake:` | the same `data_ns` in `Gate::wrong_time` | `SIM_SEED=0 (Freeze) brake: the law goes on for 112 ms` |
//! | or does not count | | `brake:` | `Gate::restarted` | `SIM_SEED=16 (Uncounted) brake: the law goes on for 146 ms` |
//! | or is in the future | | `brake:` | `FUTURE_NS` in `Gate::wrong_time` | `SIM_SEED=12 (Future) brake: the law goes on for 128 ms` |
//! | or repeats an image | `silence` | `brake:` | `frozen::check` | `SIM_SEED=1 (Image) brake: the law goes on for 130 ms` |
//! | with a little noise | `silence` | `cause:` | `Follow::add` | `SIM_SEED=2 (Noise) cause: Some(Lost), must be one of [NotFollowing, Frozen]` |
//! | or shows another object | `silence` | `brake:` | `gate::check_place` | `SIM_SEED=4 (OtherAfterRestart) brake: the law goes on for 118 ms` |
//! | or shows points in a corner or on a line | `silence` | `brake:` | `gate::check_shape` | `SIM_SEED=10 (Line) brake: the law goes on for 108 ms` |
//! | or hides a point for more than `blind_s` | `silence` | `brake:` | the end of `Law::completed` | `SIM_SEED=8 (Hidden) brake: the law goes on for 1132 ms` |
//! | without features it disarms | `silence` | `disarm:` | `Hold::Lost` | `SIM_SEED=0 (Freeze) disarm: not in 2279 ms: holding, Some(Stale)` |
//! | no command jumps | `steps` | `steps:`, `brake:` | the bound in `Supervisor::braked` | `SIM_SEED=0 (Freeze) steps: 4.500 of what is allowed` |
//! | a loop that is late again and again disarms | `failures` | `brake:` | `Hold::Overruns` | `SIM_SEED=32 (LateLoop) brake: the law goes on for 438 ms` |
//! | one late cycle is forgiven | `failures` | `goes on:` | `OVERRUN * IN_A_ROW` | `SIM_SEED=31 (LateOnce) goes on: disarmed, Some(Overruns)` |
//! | a law without an answer disarms | `failures` | `cause:` | the third failure in `Supervisor::response` | `SIM_SEED=19 (NoAnswer) cause: Some(Lost), must be one of [Solver]` |
//! | a standstill of the loop disarms | `hang` | `brake:` | `Hold::Standstill` | `SIM_SEED=28 (Hang) brake: the law goes on for 110 ms` |
//! | so does a suspended machine | | `brake:` | `Situation::suspended` | `SIM_SEED=29 (Suspend) brake: the law goes on for 133 ms` |
//! | and a clock that goes back | | `cause:` | `Hold::Clock` | `SIM_SEED=30 (ClockBack) cause: Some(Standstill), must be one of [Clock]` |
//! | the robot stands 100 ms after the last command | `hang` | `rest:`, `dead man:` | `TwistCommand::in_force` | `SIM_SEED=26 (Crash) dead man: it moves 2 ms after the end of the last command` |
//! | an arm that waited is refused | | `late requests:` | `cycle::is_late` | `SIM_SEED=28 (Hang) late requests: Some(Done)` |
//! | a crash begins disarmed | `consent` | `restart:` | `Supervisor::begin_disarmed` | `SIM_SEED=26 (Crash) restart: holding (Some(Stale))` |
//! | an armed start waits 5 s | `consent` | `unasked:` | `Supervisor::has_waited` | `SIM_SEED=46 (ArmedAlone) unasked: it moves` |
//! | a loop of `arm` does not undo a stop | `consent` | `consent:` | the name in `Supervisor::arm` | `SIM_SEED=38 (StopAgainstArm) consent: armed by the name of stop 0, the last is 1` |
//! | after a reload the stops are the same | | `stops:` | `Supervisor::begin_again` | `SIM_SEED=35 (Reload) stops: 2 came, 1 are told` |
//! | a stop is zero in its cycle | `stop`, `hands`, `daemon process` | `stop:` | `Action::Stop` | `SIM_SEED=36 (Stop) stop: another command in its cycle` |
//! | so is any hand on the stop file | `hands` | `stop:` | the file's place in `StopFile::is_asked` | `SIM_SEED=541 (StopFile) stop: none after 114 ms` |
//! | and no arm counts before that zero | | `stop:` | `is_stopped` in `Supervisor::arm` | `SIM_SEED=86 (Stop) stop: another command in its cycle: Some(Moving)` |
//! | a disarm brakes | `daemon process` | `unasked:` | `Action::Disarm` | `SIM_SEED=42 (Disarm) unasked: it goes on after a disarm` |
//! | SIGTERM brakes, then zero | `shutdown` | `end:` | `Hold::Shutdown` | `SIM_SEED=34 (Terminate) end: the last word is a jump to zero` |
//! | nothing moves before a robot is heard | `daemon process` | `no robot:` | `Hold::NoRobot` | `SIM_SEED=25 (RobotUnheard) no robot: arm is answered Some(Done)` |
//! | a silent robot disarms | `daemon process` | `brake:` | `Hold::RobotLost` | `SIM_SEED=20 (RobotSilent) brake: the law goes on for 425 ms` |
//! | a faulty robot is a stop | `daemon process` | `brake:` | `Hold::RobotFault` | `SIM_SEED=22 (RobotFault) brake: the law goes on for 122 ms` |
//! | one that does something else disarms | `daemon process` | `brake:` | `Hold::NotFollowed` | `SIM_SEED=23 (RobotStrays) brake: the law goes on for 411 ms` |
//! | a blocked arm disarms | `follow` | `disarm:` | `Follow::add` | `SIM_SEED=24 (RobotBlocked) end: none after a minute` |
//! | a silent policy brakes | `guardian` | `guardian:` | the end of a wish in `ControlStep::want` | `SIM_SEED=47 (Guardian) guardian: it moves 506 ms after the program` |
//! | a replay repeats the records | `guardian` | `replay:` | what a request names, in `replay` | `SIM_SEED=48 (Storm) replay: cycle 54: reply.seen differs` |
//! | a rehearsal changes nothing | | same hash | `standing` in `ControlStep::restore` | `a rehearsal changes it` |

mod camera;
mod daemon;
mod fault;
mod figures;
mod memory;
mod operator;
mod plan;
mod policy;
mod process;
mod property;
mod queue;
mod recorder;
mod robot;
mod stop_file;
mod strike;
mod trial;
mod world;

use std::sync::LazyLock;

use rayon::prelude::*;

use fault::{ALL, Fault};
use figures::Figures;
use plan::{Plan, Stock};
use world::{Found, World};

/// One sampling period of the paper's scene, ns.
pub const PERIOD_NS: u64 = 33_333_333;
/// Runs of each fault.
const ROUNDS: u64 = 20;
const LONG_ROUNDS: u64 = 2_000;

static STOCK: LazyLock<Stock> = LazyLock::new(Stock::read);

/// A number of the environment.
fn number(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    let number = text.parse();
    Some(number.unwrap_or_else(|_| panic!("{name} = {text}; allowed: a whole number")))
}

/// The seeds of these faults: that of `SIM_SEED` alone, if it is one of theirs, or a share of
/// `SIM_SEEDS`.
fn seeds(faults: &[Fault]) -> Vec<u64> {
    let all = ALL.len() as u64;
    let is_theirs = |seed: &u64| faults.contains(&ALL[(seed % all) as usize]);
    if let Some(seed) = number("SIM_SEED") {
        return Some(seed).into_iter().filter(is_theirs).collect();
    }
    let rounds = if testkit::is_long() {
        LONG_ROUNDS
    } else {
        ROUNDS
    };
    let most = number("SIM_SEEDS").unwrap_or(all * rounds);
    (0..most).filter(is_theirs).collect()
}

/// Runs the seeds of these faults, and prints the greatest figures of each fault.
fn show(faults: &[Fault]) {
    let (seeds, is_told) = (seeds(faults), number("SIM_SEED").is_some());
    let run = |seed: &u64| (*seed, World::run(&STOCK, *seed, is_told));
    let runs: Vec<(u64, Found)> = seeds.par_iter().map(run).collect();
    let broken = |(seed, found): &(u64, Found)| {
        let what = found.broken.as_ref()?;
        Some(format!("SIM_SEED={seed} ({:?}) {what}", found.fault))
    };
    for fault in faults {
        let same = runs.iter().filter(|(_, found)| found.fault == *fault);
        let found: Vec<&Found> = same.map(|(_, found)| found).collect();
        let figures = found.iter().map(|found| found.figures);
        let most = figures.fold(Figures::default(), Figures::max);
        let cycles: u64 = found.iter().map(|found| found.cycles).sum();
        let seconds = found.iter().map(|found| found.took_ns).sum::<u64>() / 1_000_000_000;
        let runs = found.len();
        println!("{fault:?}: {runs} runs, {seconds} s, {cycles} cycles; at most {most}");
    }
    let broken = runs.iter().find_map(broken);
    assert!(broken.is_none(), "{}", broken.unwrap_or_default());
}

#[test]
fn silence() {
    let faults: Vec<_> = ALL
        .into_iter()
        .filter(|fault| *fault < Fault::NoAnswer)
        .collect();
    show(&faults);
}

#[test]
fn failures() {
    show(&[
        Fault::NoAnswer,
        Fault::LateOnce,
        Fault::LateLoop,
        Fault::Unsent,
    ]);
}

#[test]
fn robot() {
    show(&[
        Fault::RobotSilent,
        Fault::RobotDead,
        Fault::RobotReflex,
        Fault::RobotStrays,
        Fault::RobotBlocked,
        Fault::RobotUnheard,
    ]);
}

#[test]
fn hang() {
    show(&[Fault::Hang, Fault::Suspend, Fault::ClockBack]);
}

#[test]
fn consent() {
    show(&[
        Fault::Crash,
        Fault::CrashDisarmed,
        Fault::Reload,
        Fault::ArmedStart,
        Fault::ArmedAlone,
        Fault::StopAgainstArm,
        Fault::StopTwice,
        Fault::Disarm,
    ]);
}

#[test]
fn stop() {
    show(&[
        Fault::Stop,
        Fault::StopInFlood,
        Fault::StopInBrake,
        Fault::StopFile,
        Fault::Flood,
        Fault::Strategy,
    ]);
}

#[test]
fn shutdown() {
    show(&[Fault::Terminate]);
}

#[test]
fn guardian() {
    show(&[Fault::Guardian]);
}

#[test]
fn storm() {
    show(&[Fault::Storm]);
}

#[test]
fn the_same_seed_gives_the_same_bits_and_a_rehearsal_changes_none() {
    let all = ALL.len() as u64;
    (0..all).into_par_iter().for_each(|seed| {
        let run = |rehearses| {
            let (mut plan, random) = Plan::new(&STOCK, seed);
            (plan.is_recorded, plan.rehearses) = (false, rehearses);
            let found = World::of(plan, random, false).finished();
            (found.hash, found.cycles)
        };
        let first = run(false);
        assert_eq!(first, run(false), "SIM_SEED={seed}: not the same again");
        assert_eq!(first, run(true), "SIM_SEED={seed}: a rehearsal changes it");
    });
    let hashes = [0, all].map(|seed| World::run(&STOCK, seed, false).hash);
    assert_ne!(hashes[0], hashes[1], "other seeds, other runs");
}
