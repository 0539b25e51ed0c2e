//! A simulation of `vpcd` in virtual time: the real loop ([`controller::cycle::Cycle`]) with the
//! real decision and law, the emulator's camera, the dead man of the contract, the real stop file,
//! and the real rules by which a daemon knows of the one before it; with a robot and its arm,
//! operators, programs that steer or arm by themselves, and a network between them, on a clock that
//! [`world`] moves. One seed decides every choice. What goes wrong ([`fault`]) is the seed's
//! remainder by the number of faults: one fault of a moving camera, after which [`trial`] checks
//! what must follow; or a storm, a list of events of any kind at any time. After every event
//! [`property`] checks what must always hold; [`promise`] has a line for each.
//!
//! ```sh
//! cargo test --test simulation                               # 2,000 runs
//! cargo xtask simulate --seeds 100000                       # that many, and what each promise saw
//! SIM_SEED=204 cargo test --test simulation -- --nocapture   # one run, told line by line
//! ```
//!
//! What breaks a promise is told in one line, with the command that repeats it. Of a storm, the
//! events are dropped one by one that it does not need; `SIM_EVENTS` names those that are left.
//!
//! What is not shown here are the ports, files and clocks of [`controller::machine`], real time,
//! and lockstep: `cargo test --test daemon` and `cargo xtask measure` show them.
//!
//! Mends of the fourth attack: what 2,000 seeds found first when each was taken out of this commit,
//! one by one:
//!
//! | mend taken out | found |
//! |---|---|
//! | an operator's disarm is a veto, `Supervisor::request` | `SIM_SEED=77 (StopInBrake) consent:`, `80 (Disarm)`, `86 (VisitDisarm)` |
//! | a change between `follow` and a goal disarms, `ControlStep::change` | `SIM_SEED=84 (ToGoal) unasked:`, `82 (ToFollow) disarm:` |
//! | a visit takes up no other limits, `SceneFiles::differences` | `SIM_SEED=89 (VisitForeign) cell:` |
//! | *joints do not follow*, `JointWatch::hold` | `SIM_SEED=46 (JointsFrozen) joints:`, `49 (JointsJump)`, `52 (JointsOther)` |
//! | *image moves more than commanded*, `Follow::check_gain` | `SIM_SEED=229 (RobotFast) brake:` |
//! | *robot is late*, `RobotWatch::look` | not found: the image's own watch ends most of these runs |
//! | hidden time is a budget, predicted points are not seen | not found within the 2 s that a run may take; `--test closed_loop` bounds its way |
//!
//! `Fault::LateFresh`, images that are late and stamped fresh, is not judged yet: some of its runs
//! swing at the limits for more than the 1.5 s that would be asked of them.
//!
//! Each promise that tests in real time showed before, the property that shows it now, and the line
//! that was seen when its mechanism was taken out of a copy (alone, or with others that these
//! faults do not meet). The seeds of that time are other ones now:
//!
//! | promise | test before | property now | seen to fail without | line |
//! |---|---|---|---|---|
//! | silence brakes within 3 periods | `silence` | `silence:` of every command | `Gate::is_stale` | `(Silence) silence: the law's command 129 ms after it` |
//! | so does a camera that goes back in time | `silence` | `brake:` | the order in `Gate::wrong_time` | `(Older) brake: the law goes on for 108 ms` |
//! | or repeats an exposure | `silence` | `brake:` | the same `data_ns` in `Gate::wrong_time` | `(Freeze) brake: the law goes on for 112 ms` |
//! | or does not count | | `brake:` | `Gate::restarted` | `(Uncounted) brake: the law goes on for 146 ms` |
//! | or is in the future | | `brake:` | `FUTURE_NS` in `Gate::wrong_time` | `(Future) brake: the law goes on for 128 ms` |
//! | or repeats an image | `silence` | `brake:` | `frozen::check` | `(Image) brake: the law goes on for 130 ms` |
//! | with a little noise | `silence` | `cause:` | `Follow::add` | `(Noise) cause: Some(Lost), must be one of [NotFollowing, Frozen]` |
//! | or shows another object | `silence` | `brake:` | `gate::check_place` | `(OtherAfterRestart) brake: the law goes on for 118 ms` |
//! | or shows points in a corner or on a line | `silence` | `brake:` | `gate::check_shape` | `(Line) brake: the law goes on for 108 ms` |
//! | or hides a point for more than `blind_s` | `silence` | `brake:` | the end of `Law::completed` | `(Hidden) brake: the law goes on for 1132 ms` |
//! | without features it disarms | `silence` | `disarm:` | `Hold::Lost` | `(Freeze) disarm: not in 2279 ms: holding, Some(Stale)` |
//! | no command jumps | `steps` | `steps:`, `brake:` | the bound in `Supervisor::braked` | `(Freeze) steps: 4.500 of what is allowed` |
//! | a loop that is late again and again disarms | `failures` | `brake:` | `Hold::Overruns` | `(LateLoop) brake: the law goes on for 438 ms` |
//! | one late cycle is forgiven | `failures` | `goes on:` | `OVERRUN * IN_A_ROW` | `(LateOnce) goes on: disarmed, Some(Overruns)` |
//! | a law without an answer disarms | `failures` | `cause:` | the third failure in `Supervisor::response` | `(NoAnswer) cause: Some(Lost), must be one of [Solver]` |
//! | a standstill of the loop disarms | `hang` | `brake:` | `Hold::Standstill` | `(Hang) brake: the law goes on for 110 ms` |
//! | so does a suspended machine | | `brake:` | `Situation::suspended` | `(Suspend) brake: the law goes on for 133 ms` |
//! | and a clock that goes back | | `cause:` | `Hold::Clock` | `(ClockBack) cause: Some(Standstill), must be one of [Clock]` |
//! | the robot stands 100 ms after the last command | `hang` | `rest:`, `dead man:` | `TwistCommand::in_force` | `(Crash) dead man: it moves 2 ms after the end of the last command` |
//! | an arm that waited is refused | | `late requests:` | `cycle::is_late` | `(Hang) late requests: Some(Done)` |
//! | a crash begins disarmed | `consent` | `restart:` | `Supervisor::begin_disarmed` | `(Crash) restart: holding (Some(Stale))` |
//! | an armed start waits 5 s | `consent` | `unasked:` | `Supervisor::has_waited` | `(ArmedAlone) unasked: it moves` |
//! | a loop of `arm` does not undo a stop | `consent` | `consent:` | the name in `Supervisor::arm` | `(StopAgainstArm) consent: armed by the name 0, veto 3 stands` |
//! | after a reload the veto is the same | | `consent:` | `Supervisor::begin_again` | `(Reload) consent: veto 3 stands, 0 is told` |
//! | a stop is zero in its cycle | `stop`, `hands`, `daemon process` | `stop:` | `Action::Stop` | `(Stop) stop: another command in its cycle` |
//! | so is any hand on the stop file | `hands` | `stop:` | the file's place in `StopFile::is_asked` | `(StopFile) stop: none after 114 ms` |
//! | and no arm counts before that zero | | `stop:` | `Veto::is_fresh` in `Supervisor::arm` | `(Stop) stop: another command in its cycle: Some(Moving)` |
//! | a disarm brakes | `daemon process` | `unasked:` | `Action::Disarm` | `(Disarm) unasked: it goes on after a disarm` |
//! | SIGTERM brakes, then zero | `shutdown` | `end:` | `Hold::Shutdown` | `(Terminate) end: the last word is a jump to zero` |
//! | nothing moves before a robot is heard | `daemon process` | `no robot:` | `Hold::NoRobot` | `(RobotUnheard) no robot: arm is answered Some(Done)` |
//! | a silent robot disarms | `daemon process` | `brake:` | `Hold::RobotLost` | `(RobotSilent) brake: the law goes on for 425 ms` |
//! | a faulty robot is a stop | `daemon process` | `brake:` | `Hold::RobotFault` | `(RobotFault) brake: the law goes on for 122 ms` |
//! | one that does something else disarms | `daemon process` | `brake:` | `Hold::NotFollowed` | `(RobotStrays) brake: the law goes on for 411 ms` |
//! | a blocked arm disarms | `follow` | `disarm:` | `Follow::add` | `(RobotBlocked) end: none after a minute` |
//! | a silent policy brakes | `guardian` | `guardian:` | the end of a wish in `ControlStep::want` | `(Guardian) guardian: it moves 506 ms after the program` |
//! | a replay repeats the records | `guardian` | `replay:` | what a request names, in `replay` | `(Storm) replay: cycle 54: reply.named differs` |
//! | a rehearsal changes nothing | | same hash | `standing` in `ControlStep::restore` | `a rehearsal changes it` |

mod camera;
mod fault;
mod figures;
mod joints;
mod memory;
mod network;
mod operator;
mod plan;
mod policy;
mod process;
mod promise;
mod property;
mod queue;
mod recorder;
mod robot;
mod shrink;
mod stop_file;
mod strike;
mod trial;
mod visitor;
mod world;

use std::sync::LazyLock;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use fault::{FAULTS, Fault};
use plan::Stock;
use world::{Found, World};

/// Runs in `cargo test`, and at full length.
const SEEDS: u64 = 2_000;
const LONG_SEEDS: u64 = 100_000;
/// One run of so many is a storm.
const STORMS: usize = 4;

static STOCK: LazyLock<Stock> = LazyLock::new(Stock::read);

/// A source of choices of a seed; each party has one of its own, so that what one does changes no
/// other.
fn dice(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(stream);
    random
}

/// The faults in the order of their seeds: each once, and a storm after every third.
fn kinds() -> &'static [Fault] {
    static KINDS: LazyLock<Vec<Fault>> = LazyLock::new(|| {
        let is_alone = |one: &Fault| !matches!(one, Fault::Storm | Fault::Network);
        let faults = FAULTS.iter().copied().filter(is_alone);
        let faults: Vec<Fault> = faults.filter(|one| !one.is_awaited()).collect();
        let parts = faults.chunks(STORMS - 1);
        parts
            .flat_map(|part| [part, &[Fault::Storm]].concat())
            .collect()
    });
    &KINDS
}

/// A number of the environment.
fn number(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    let number = text.parse();
    Some(number.unwrap_or_else(|_| panic!("{name} = {text}; allowed: a whole number")))
}

/// The seeds of these faults: that of `SIM_SEED` alone, if it is one of theirs, or a share of
/// `SIM_SEEDS`.
fn seeds(faults: &[Fault]) -> Vec<u64> {
    let kinds = kinds();
    let all = kinds.len() as u64;
    let is_theirs = |seed: &u64| faults.contains(&kinds[(seed % all) as usize]);
    if let Some(seed) = number("SIM_SEED") {
        return Some(seed).into_iter().filter(is_theirs).collect();
    }
    let most = if testkit::is_long() {
        LONG_SEEDS
    } else {
        SEEDS
    };
    let most = number("SIM_SEEDS").unwrap_or(most);
    (0..most).filter(is_theirs).collect()
}

/// Runs the seeds of these faults, and prints the greatest figures of each fault.
fn show(faults: &[Fault]) {
    let (seeds, is_told) = (seeds(faults), number("SIM_SEED").is_some());
    if let (true, Some(seed)) = (is_told, seeds.first()) {
        let found = World::of(shrink::asked(&STOCK, *seed), true).finished();
        assert!(
            found.broken.is_none(),
            "{}",
            found.broken.unwrap_or_default()
        );
        return;
    }
    let run = |seed: &u64| (*seed, World::run(&STOCK, *seed));
    let runs: Vec<(u64, Found)> = seeds.par_iter().map(run).collect();
    for fault in faults {
        let same = runs.iter().filter(|(_, found)| found.fault == *fault);
        let found: Vec<&Found> = same.map(|(_, found)| found).collect();
        figures::print(*fault, &found);
    }
    // The first of each fault.
    let broken = faults.iter().filter_map(|fault| {
        let mut same = runs.iter().filter(|(_, found)| found.fault == *fault);
        let (seed, found) = same.find(|(_, found)| found.broken.is_some())?;
        Some(shrink::report(&STOCK, *seed, found.broken.as_ref()?))
    });
    let broken: Vec<String> = broken.collect();
    assert!(broken.is_empty(), "\n{}", broken.join("\n"));
}

/// Those from one to another.
fn between(first: Fault, last: Fault) -> Vec<Fault> {
    let all = FAULTS.iter().copied();
    all.filter(|fault| (first..=last).contains(fault)).collect()
}

#[test]
fn silence() {
    show(&between(Fault::Freeze, Fault::Replaced));
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
    show(&between(Fault::RobotSilent, Fault::RobotCrossed));
}

#[test]
fn joints() {
    show(&between(Fault::JointsFrozen, Fault::JointsFew));
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
        Fault::ToFollow,
        Fault::ToGoal,
        Fault::VisitDisarm,
        Fault::VisitStop,
        Fault::VisitForeign,
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
fn nothing() {
    show(&[Fault::Nothing]);
}

#[test]
fn storm() {
    show(&[Fault::Storm]);
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let all = kinds().len() as u64;
    (0..all).into_par_iter().for_each(|seed| {
        let run = || {
            let found = World::run(&STOCK, seed);
            (found.hash, found.cycles)
        };
        assert_eq!(run(), run(), "SIM_SEED={seed}: not the same again");
    });
    let hashes = [0, all].map(|seed| World::run(&STOCK, seed).hash);
    assert_ne!(hashes[0], hashes[1], "other seeds, other runs");
}
