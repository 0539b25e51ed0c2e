//! Each hold and its response, with a clock moved by hand.

use messages::Request;

use super::*;

const MS: u64 = 1_000_000;
const PERIOD: u64 = 33 * MS;
const FAST: [f64; 6] = [0.1, 0.0, 0.05, 0.0, 0.2, 0.0];
const GOOD: Decision = Decision {
    twist: FAST,
    elbow: 0.0,
    state: TwistState::Moving,
    hold: None,
};

/// A supervisor whose clock is moved by hand.
struct Bench {
    supervisor: Supervisor,
    now: u64,
    situation: Situation,
}

impl Bench {
    fn new(armed: bool) -> Self {
        let rules = Rules {
            limits: [0.1, 0.1, 0.1, 0.4, 0.4, 0.4],
            change: [f64::INFINITY; 6],
            brake_ns: 150 * MS,
            ramp_ns: 150 * MS,
            valid_ns: Some(100 * MS),
            lost_ns: Some(300 * MS),
            needs_robot: false,
            begins_armed: armed,
            after_arrival: AfterArrival::Follow,
        };
        Self {
            supervisor: Supervisor::new(rules),
            now: 1000 * MS,
            situation: Situation {
                decision: GOOD,
                good_ns: Some(1000 * MS),
                solver_failed: Some(false),
                missed: 0,
                robot: None,
                suspended: false,
                shutdown: false,
            },
        }
    }

    fn moving() -> Self {
        let mut bench = Self::new(true);
        bench.resumes();
        bench
    }

    /// Cycles with good features, until the law's twist goes out; it is taken up as steeply as it
    /// is braked.
    fn resumes(&mut self) -> usize {
        let step = self.supervisor.rules.limits[0] * PERIOD as f64 / (150 * MS) as f64;
        for cycle in 1..8 {
            let before = self.supervisor.sent.twist[0].abs();
            let decision = self.good();
            assert_eq!((decision.state, decision.hold), (TwistState::Moving, None));
            assert!(decision.twist[0] - before <= step + 1e-12, "{decision:?}");
            if decision == GOOD {
                return cycle;
            }
        }
        panic!("the law's twist is never reached");
    }

    /// The next cycle, with good features.
    fn good(&mut self) -> Decision {
        self.situation.decision = GOOD;
        self.situation.good_ns = Some(self.now + PERIOD);
        self.cycle()
    }

    /// The next cycle, with this hold against the law.
    fn bad(&mut self, hold: Hold) -> Decision {
        self.situation.decision = Decision::still(hold, TwistState::Holding);
        self.cycle()
    }

    fn cycle(&mut self) -> Decision {
        self.now += PERIOD;
        self.supervisor.supervise(&self.situation, self.now)
    }

    fn ask(&mut self, action: Action) -> Outcome {
        self.supervisor.request(action, 0)
    }

    /// The name of the veto that stands.
    fn veto(&self) -> u32 {
        self.supervisor.veto().map_or(0, |veto| veto.name)
    }

    /// Arms in spite of it.
    fn arm(&mut self) -> Outcome {
        let veto = self.veto();
        self.supervisor.request(Action::Arm, veto)
    }
}

fn is_still(decision: &Decision) -> bool {
    decision.twist == [0.0; 6]
}

#[test]
fn without_arming_nothing_moves() {
    let mut bench = Bench::new(false);
    assert_eq!(bench.ask(Action::Arm), Outcome::NoFeatures);
    for _ in 0..10 {
        assert_eq!(
            bench.good(),
            Decision::still(Hold::NotArmed, TwistState::Disarmed)
        );
    }
    assert_eq!(bench.ask(Action::Arm), Outcome::Done);
    bench.resumes();
}

#[test]
fn braking_stays_on_the_path_and_within_its_time() {
    let mut bench = Bench::moving();
    let mut last = FAST;
    for _ in 0..4 {
        let decision = bench.bad(Hold::Hidden);
        assert_eq!(
            (decision.state, decision.hold),
            (TwistState::Braking, Some(Hold::Hidden))
        );
        let share = decision.twist[0] / FAST[0];
        assert!((last[0] - decision.twist[0] - 0.1 * 33.0 / 150.0).abs() < 1e-12);
        for k in 0..6 {
            assert!((decision.twist[k] - share * FAST[k]).abs() < 1e-12);
        }
        last = decision.twist;
    }
    assert_eq!(
        bench.bad(Hold::Hidden),
        Decision::still(Hold::Hidden, TwistState::Holding)
    );
}

#[test]
fn braking_is_no_faster_than_the_acceleration_allows() {
    let mut bench = Bench::moving();
    let acceleration = [1.0, 1.0, 1.0, 1.2, 1.2, 1.2];
    let mut rules = bench.supervisor.rules();
    // 0.2 rad/s take 167 ms; in lockstep as well.
    for lost_ns in [Some(300 * MS), None] {
        (rules.lost_ns, rules.brake_ns) = (lost_ns, 0);
        rules.change = acceleration.map(|a| a * 0.033);
        bench.supervisor = Supervisor::new(rules);
        assert!((0..8).any(|_| bench.good() == GOOD));
        let mut last = FAST;
        for cycle in 0..6 {
            let decision = bench.bad(Hold::Hidden);
            let most = last.iter().zip(decision.twist).zip(acceleration);
            let most = most.map(|((before, now), a)| (before - now).abs() / (a * 0.033));
            let most = most.fold(0.0, f64::max);
            assert!(most < 1.0 + 1e-9, "{cycle}: {most}");
            assert!(cycle == 5 || most > 1.0 - 1e-9, "{cycle}: {most}");
            last = decision.twist;
        }
        assert_eq!(last, [0.0; 6]);
        // A stop does not wait.
        bench.good();
        bench.supervisor.request(Action::Stop, 0);
        assert_eq!(bench.good().twist, [0.0; 6]);
    }
}

#[test]
fn a_cause_that_passes_lets_the_law_go_on_by_itself() {
    for hold in [
        Hold::Stale,
        Hold::Invalid,
        Hold::Hidden,
        Hold::Count,
        Hold::NotFinite,
        Hold::OffImage,
        Hold::Transport,
        Hold::Mixed,
        Hold::Elsewhere,
        Hold::Order,
        Hold::NoJoints,
    ] {
        let mut bench = Bench::moving();
        assert_eq!(bench.bad(hold).state, TwistState::Braking);
        bench.resumes();
    }
}

#[test]
fn features_that_stay_away_disarm() {
    let mut bench = Bench::moving();
    let mut cycles = 0;
    while bench.bad(Hold::Stale).state != TwistState::Disarmed {
        cycles += 1;
    }
    assert_eq!(cycles, 300 / 33);
    assert_eq!(
        bench.good(),
        Decision::still(Hold::Lost, TwistState::Disarmed)
    );
    assert_eq!(bench.ask(Action::Arm), Outcome::Done);
    bench.resumes();
}

#[test]
fn graver_causes_brake_and_disarm() {
    type Change = fn(&mut Situation);
    let cases: [(Hold, Change); 6] = [
        (Hold::Shutdown, |s| s.shutdown = true),
        (Hold::RobotLost, |s| s.robot = Some(Hold::RobotLost)),
        (Hold::BadTwist, |s| s.decision.hold = Some(Hold::BadTwist)),
        (Hold::Overruns, |s| s.missed = 1),
        (Hold::NotFollowing, |s| {
            s.decision.hold = Some(Hold::NotFollowing)
        }),
        (Hold::Frozen, |s| s.decision.hold = Some(Hold::Frozen)),
    ];
    for (hold, change) in cases {
        let mut bench = Bench::moving();
        let untouched = bench.situation;
        change(&mut bench.situation);
        let first = (0..IN_A_ROW)
            .map(|_| bench.cycle())
            .find(|d| d.hold.is_some());
        let first = first.unwrap();
        assert_eq!((first.state, first.hold), (TwistState::Braking, Some(hold)));
        assert!(!is_still(&first));
        // The hold is gone: it goes on braking, and stays.
        bench.situation = untouched;
        for _ in 0..4 {
            assert_eq!(bench.good().hold, Some(hold));
        }
        assert_eq!(bench.good(), Decision::still(hold, TwistState::Disarmed));
        assert!(bench.supervisor.is_at_rest());
    }
}

#[test]
fn two_failures_and_an_overrun_in_three_cycles_are_forgiven() {
    let mut bench = Bench::moving();
    for _ in 0..50 {
        for (missed, failed) in [(1, true), (0, true), (0, false)] {
            bench.situation.missed = missed;
            bench.situation.solver_failed = Some(failed);
            assert_eq!(bench.good(), GOOD);
        }
    }
}

#[test]
fn three_solver_failures_in_a_row_disarm() {
    let mut bench = Bench::moving();
    let mut look = |failed: bool| {
        bench.situation.solver_failed = Some(failed);
        match failed {
            true => bench.bad(Hold::Solver),
            false => bench.good(),
        }
    };
    for _ in 0..10 {
        for _ in 1..IN_A_ROW {
            let decision = look(true);
            assert_eq!(
                (decision.state, decision.hold),
                (TwistState::Braking, Some(Hold::Solver))
            );
            assert!(!is_still(&decision));
        }
        assert!((0..4).any(|_| look(false) == GOOD));
    }
    for _ in 0..IN_A_ROW {
        assert_eq!(look(true).state, TwistState::Braking);
    }
    while look(false).state == TwistState::Braking {}
    assert_eq!(
        look(false),
        Decision::still(Hold::Solver, TwistState::Disarmed)
    );
}

#[test]
fn an_overrun_every_other_cycle_stops_the_camera_in_the_end() {
    let mut bench = Bench::moving();
    let mut missed = [1, 0].into_iter().cycle();
    let forgiven = (0..100)
        .take_while(|_| {
            bench.situation.missed = missed.next().unwrap();
            bench.good().hold.is_none()
        })
        .count();
    assert_eq!(forgiven, 8);
    assert_eq!(
        bench.supervisor.state(),
        (TwistState::Braking, Some(Hold::Overruns))
    );
}

#[test]
fn the_gravest_stop_at_once() {
    let mut bench = Bench::moving();
    bench.situation.robot = Some(Hold::RobotFault);
    assert_eq!(
        bench.good(),
        Decision::still(Hold::RobotFault, TwistState::Disarmed)
    );
    assert_eq!(bench.ask(Action::Arm), Outcome::RobotFault);
    bench.situation.robot = None;
    bench.good();
    assert_eq!(bench.ask(Action::Arm), Outcome::Done);

    let mut bench = Bench::moving();
    assert_eq!(bench.ask(Action::Stop), Outcome::Done);
    assert_eq!(
        bench.good(),
        Decision::still(Hold::Operator, TwistState::Disarmed)
    );

    let mut bench = Bench::moving();
    assert_eq!(
        bench.bad(Hold::Clock),
        Decision::still(Hold::Clock, TwistState::Disarmed)
    );
}

#[test]
fn a_loop_that_stood_still_starts_no_motion() {
    let mut bench = Bench::moving();
    bench.now += 2000 * MS;
    bench.situation.missed = 60;
    assert_eq!(
        bench.good(),
        Decision::still(Hold::Standstill, TwistState::Disarmed)
    );
    bench.situation.missed = 0;
    assert_eq!(
        bench.good(),
        Decision::still(Hold::Standstill, TwistState::Disarmed)
    );
}

#[test]
fn a_clock_that_goes_back_stops() {
    let mut bench = Bench::moving();
    bench.now -= 2 * PERIOD;
    assert_eq!(
        bench.good(),
        Decision::still(Hold::Clock, TwistState::Disarmed)
    );
}

#[test]
fn an_operator_brakes_and_arms_again() {
    let mut bench = Bench::moving();
    assert_eq!(bench.ask(Action::Disarm), Outcome::Done);
    let decision = bench.good();
    assert_eq!(
        (decision.state, decision.hold),
        (TwistState::Braking, Some(Hold::Operator))
    );
    assert_eq!(bench.ask(Action::Arm), Outcome::Braking);
    for _ in 0..4 {
        bench.good();
    }
    assert_eq!(
        bench.good(),
        Decision::still(Hold::Operator, TwistState::Disarmed)
    );
    assert_eq!(bench.arm(), Outcome::Done);
    bench.resumes();
    assert_eq!(bench.ask(Action::Arm), Outcome::Done);
}

#[test]
fn for_half_a_second_after_a_stop_no_arm_is_accepted() {
    let mut bench = Bench::moving();
    // Also where it stands already.
    for _ in 0..2 {
        assert_eq!(bench.ask(Action::Stop), Outcome::Done);
        assert_eq!(bench.arm(), Outcome::Braking);
        let still = Decision::still(Hold::Operator, TwistState::Disarmed);
        for _ in 0..=Request::AFTER_STOP_NS / PERIOD {
            assert_eq!(bench.good(), still);
            assert_eq!(bench.arm(), Outcome::Braking);
        }
        assert_eq!(bench.good(), still);
    }
    // A clock that goes back begins the time anew.
    bench.now -= 30 * PERIOD;
    bench.good();
    assert_eq!(bench.arm(), Outcome::Braking);
    (0..=Request::AFTER_STOP_NS / PERIOD).for_each(|_| _ = bench.good());
    assert_eq!(bench.arm(), Outcome::Done);
    bench.resumes();
}

#[test]
fn in_lockstep_an_arm_waits_for_the_zero_after_a_stop_alone() {
    let mut bench = Bench::moving();
    bench.supervisor.rules.lost_ns = None;
    bench.ask(Action::Stop);
    assert_eq!(bench.arm(), Outcome::Braking);
    assert!(is_still(&bench.good()));
    assert_eq!(bench.arm(), Outcome::Done);
}

#[test]
fn who_arms_after_a_stop_or_a_disarm_names_the_newest() {
    let mut bench = Bench::moving();
    bench.supervisor.name_vetoes(7);
    let mut old = Vec::new();
    for action in [Action::Stop, Action::Disarm, Action::Disarm, Action::Stop] {
        // The second one comes while it stands.
        for _ in 0..2 {
            bench.ask(action);
            assert_eq!(Action::of_veto(bench.veto()), Some(action));
            (0..20).for_each(|_| _ = bench.good());
            let veto = bench.veto();
            assert!(!old.contains(&veto));
            for named in [0, 1, 2, veto ^ 1, veto ^ 2].iter().chain(&old) {
                let outcome = bench.supervisor.request(Action::Arm, *named);
                assert_eq!(outcome, Outcome::Vetoed, "{named} of {veto}");
                assert!(is_still(&bench.good()));
            }
            old.push(veto);
        }
        assert_eq!(bench.arm(), Outcome::Done);
        bench.resumes();
        assert_eq!(bench.veto(), 0);
        // After that arming a plain one does, until the next veto.
        bench.situation.robot = Some(Hold::RobotFault);
        bench.good();
        bench.situation.robot = None;
        bench.good();
        assert_eq!(bench.ask(Action::Arm), Outcome::Done);
        bench.resumes();
    }
}

#[test]
fn a_disarm_after_a_stop_stays_a_stop() {
    let mut bench = Bench::moving();
    bench.ask(Action::Stop);
    let stop = bench.veto();
    bench.ask(Action::Disarm);
    assert_eq!(Action::of_veto(bench.veto()), Some(Action::Stop));
    assert_ne!(bench.veto(), stop);
}

/// A change of goals by `vpcctl visit`: the daemon ends by SIGUSR2, another begins again, and
/// `visit` asks it for `arm` until it is answered. Returns whether the camera moves, later than a
/// brake takes after an operator's disarm at this instant was confirmed.
fn visited(disarm_ns: u64) -> bool {
    const HANGUP_NS: u64 = 200 * MS;
    const GONE_NS: u64 = 300 * MS;
    let mut bench = Some(Bench::moving());
    let (mut began_ns, mut left, mut ended) = (0, 0, false);
    let (mut confirmed_ns, mut armed) = (None, false);
    let mut moved = false;
    for now_ns in (0..3000 * MS).step_by(10 * MS as usize) {
        if bench.is_none() && now_ns >= began_ns {
            let mut again = Bench::new(true);
            again.supervisor.begin_again(left);
            again.situation.decision = Decision::hold(Hold::NoFeatures);
            bench = Some(again);
        }
        let Some(daemon) = &mut bench else {
            continue;
        };
        let is_new = began_ns > 0;
        // A person whom nobody answers asks again.
        if now_ns >= disarm_ns && confirmed_ns.is_none() {
            assert_eq!(daemon.ask(Action::Disarm), Outcome::Done);
            confirmed_ns = Some(now_ns);
        }
        if is_new && !armed && !ended {
            match daemon.ask(Action::Arm) {
                Outcome::Done => armed = true,
                Outcome::Vetoed => ended = true,
                _ => (),
            }
        }
        if now_ns % (30 * MS) == 0 {
            daemon.situation.shutdown = !is_new && now_ns >= HANGUP_NS;
            let sees = !is_new || now_ns >= began_ns + 90 * MS;
            let sent = if sees { daemon.good() } else { daemon.cycle() };
            let is_late = confirmed_ns.is_some_and(|at| now_ns > at + 240 * MS);
            moved |= is_late && !is_still(&sent);
            if daemon.situation.shutdown && is_still(&sent) {
                left = daemon.veto();
                (bench, began_ns) = (None, now_ns + GONE_NS);
            }
        }
    }
    assert!(confirmed_ns.is_some() && (armed || ended));
    let mut daemon = bench.unwrap();
    if !moved {
        // Who names it may.
        assert_eq!(daemon.arm(), Outcome::Done);
        daemon.resumes();
    }
    moved
}

#[test]
fn a_disarm_at_any_instant_of_a_change_of_goals_holds() {
    for disarm_ns in (0..1200 * MS).step_by(50 * MS as usize) {
        assert!(!visited(disarm_ns), "at {} ms", disarm_ns / MS);
    }
}

#[test]
fn who_begins_armed_and_meets_nobody_disarms() {
    let still = |hold| Decision::still(hold, TwistState::Disarmed);
    for hold in [Hold::NoFeatures, Hold::Hidden] {
        let mut bench = Bench::new(true);
        bench.situation.good_ns = None;
        for _ in 0..PEERS_NS / PERIOD {
            assert_eq!(bench.bad(hold), Decision::hold(hold));
        }
        bench.bad(hold);
        assert_eq!(bench.bad(hold), still(hold));
        assert_eq!(bench.good(), still(hold));
        assert_eq!(bench.ask(Action::Arm), Outcome::Done);
        bench.resumes();
    }
    // Who has met them waits for as long as it takes.
    let mut bench = Bench::moving();
    bench.situation.robot = Some(Hold::NoRobot);
    for _ in 0..2 * PEERS_NS / PERIOD {
        assert_ne!(bench.good().state, TwistState::Disarmed);
    }
}

#[test]
fn after_its_arrival_it_does_what_is_wanted() {
    let at_goal = Decision {
        state: TwistState::Arrived,
        ..GOOD
    };
    let arrives = |after_arrival| {
        let mut bench = Bench::new(true);
        bench.supervisor.rules.after_arrival = after_arrival;
        bench.resumes();
        bench.situation.decision = at_goal;
        let told = bench.cycle();
        assert_eq!((told.state, told.hold), (TwistState::Arrived, None));
        // The pattern is carried away.
        (0..8).for_each(|_| _ = bench.good());
        let last = bench.good();
        (bench, last)
    };
    let (_, last) = arrives(AfterArrival::Follow);
    assert_eq!(last, GOOD);
    let (mut bench, last) = arrives(AfterArrival::Hold);
    assert_eq!(last, Decision::still(Hold::Arrived, TwistState::Arrived));
    assert_eq!(bench.ask(Action::Arm), Outcome::Done);
    bench.resumes();
    let (mut bench, last) = arrives(AfterArrival::Disarm);
    assert_eq!(last, Decision::still(Hold::Arrived, TwistState::Disarmed));
    assert_eq!(bench.ask(Action::Arm), Outcome::Done);
    bench.resumes();
}

#[test]
fn who_cannot_see_cannot_be_armed() {
    let mut bench = Bench::new(false);
    bench.bad(Hold::NoFeatures);
    assert_eq!(bench.ask(Action::Arm), Outcome::NoFeatures);
    bench.situation.shutdown = true;
    bench.good();
    assert_eq!(bench.ask(Action::Arm), Outcome::Shutdown);
}

#[test]
fn the_gravest_of_several_causes_is_told() {
    let mut bench = Bench::moving();
    bench.situation.shutdown = true;
    bench.situation.robot = Some(Hold::RobotLost);
    assert_eq!(bench.bad(Hold::Hidden).hold, Some(Hold::Shutdown));
    bench.situation.robot = Some(Hold::RobotFault);
    assert_eq!(
        bench.bad(Hold::Hidden),
        Decision::still(Hold::RobotFault, TwistState::Disarmed)
    );
}

#[test]
fn in_lockstep_braking_takes_no_time() {
    let rules = Rules {
        limits: [1.0; 6],
        change: [f64::INFINITY; 6],
        valid_ns: None,
        brake_ns: 0,
        ramp_ns: 0,
        lost_ns: None,
        needs_robot: false,
        begins_armed: true,
        after_arrival: AfterArrival::Follow,
    };
    let mut bench = Bench::moving();
    bench.supervisor = Supervisor::new(rules);
    assert_eq!(bench.good(), GOOD);
    for _ in 0..100 {
        assert_eq!(
            bench.bad(Hold::Hidden),
            Decision::still(Hold::Hidden, TwistState::Holding)
        );
    }
    assert_eq!(bench.good(), GOOD);
}

#[test]
fn the_laws_twist_is_taken_up_as_steeply_as_it_is_braked() {
    let mut bench = Bench::new(false);
    bench.good();
    bench.ask(Action::Arm);
    for cycle in 1..5 {
        let decision = bench.good();
        let share = f64::from(cycle) * 33.0 / 150.0;
        for k in 0..6 {
            assert!(
                (decision.twist[k] - share * FAST[k]).abs() < 1e-12,
                "{decision:?}"
            );
        }
    }
    assert_eq!(bench.good(), GOOD);
    // From then on it is the law's matter, also where it turns at once.
    bench.situation.decision.twist = FAST.map(|v| -v);
    assert_eq!(bench.cycle().twist, FAST.map(|v| -v));
    // After a brake, from the speed where that left it.
    bench.bad(Hold::Hidden);
    bench.bad(Hold::Hidden);
    assert_eq!(bench.resumes(), 2);
    // Where the law keeps limits of acceleration it is not held back.
    let mut rules = bench.supervisor.rules();
    (rules.change, rules.begins_armed) = ([0.01; 6], true);
    bench.supervisor = Supervisor::new(rules);
    bench.situation.decision.twist = [0.01, 0.0, 0.005, 0.0, 0.01, 0.0];
    let decision = bench.situation.decision;
    assert_eq!(bench.cycle(), decision);
    // But what it decided before it was held may be too far from what was sent since.
    bench.bad(Hold::Hidden);
    let decision = bench.good();
    for (v, most) in decision.twist.iter().zip(rules.change) {
        assert!(v.abs() <= most, "{decision:?}");
    }
    assert!((decision.twist[0] / decision.twist[4] - FAST[0] / FAST[4]).abs() < 1e-9);
    assert!(decision.twist[4] > 0.0099);
}

#[test]
fn no_command_of_a_jumping_law_changes_too_much() {
    let mut bench = Bench::new(true);
    let mut rules = bench.supervisor.rules();
    rules.change = rules.limits.map(|limit| limit * 33.0 / 150.0);
    bench.supervisor = Supervisor::new(rules);
    let mut last = [0.0; 6];
    for cycle in 0..48 {
        bench.situation.good_ns = Some(bench.now);
        bench.situation.decision.twist = match cycle / 12 % 2 {
            0 => FAST,
            _ => FAST.map(|v| -v),
        };
        let twist = bench.cycle().twist;
        for ((v, before), most) in twist.iter().zip(last).zip(rules.change) {
            assert!(
                (v - before).abs() <= most * (1.0 + 1e-9),
                "{cycle}: {v} after {before}"
            );
        }
        last = twist;
        if cycle % 12 == 11 {
            assert_eq!(twist, bench.situation.decision.twist, "{cycle}");
        }
    }
}

#[test]
fn a_robot_that_does_not_follow_disarms() {
    for (hold, refusal) in [
        (Hold::NotFollowed, Outcome::NotFollowed),
        (Hold::JointsNotFollowing, Outcome::JointsNotFollowing),
    ] {
        disarms_for(hold, refusal);
    }
}

/// Brakes and disarms for what is wrong with the robot, and stays so while it is.
fn disarms_for(hold: Hold, refusal: Outcome) {
    let mut bench = Bench::new(true);
    bench.situation.robot = Some(Hold::NoRobot);
    let waits = Decision::still(Hold::NoRobot, TwistState::Holding);
    assert_eq!((bench.good(), bench.good()), (waits, waits));
    bench.situation.robot = None;
    bench.resumes();
    bench.situation.robot = Some(hold);
    assert_eq!(bench.good().state, TwistState::Braking);
    while bench.good().state == TwistState::Braking {}
    let disarmed = Decision::still(hold, TwistState::Disarmed);
    assert_eq!(bench.good(), disarmed);
    for (hold, refusal) in [
        (hold, refusal),
        (Hold::NoRobot, Outcome::NoRobot),
        (Hold::RobotLost, Outcome::RobotLost),
        (Hold::RobotFault, Outcome::RobotFault),
    ] {
        bench.situation.robot = Some(hold);
        bench.good();
        assert_eq!(bench.ask(Action::Arm), refusal);
    }
}

#[test]
fn after_a_suspend_it_is_disarmed() {
    let mut bench = Bench::moving();
    bench.situation.suspended = true;
    let disarmed = Decision::still(Hold::Standstill, TwistState::Disarmed);
    assert_eq!(bench.good(), disarmed);
}

#[test]
fn without_a_way_it_stands_armed_and_may_be_armed() {
    let mut bench = Bench::moving();
    // The features are good all the while.
    let no_way = |bench: &mut Bench| {
        bench.situation.decision = Decision::hold(Hold::NoWay);
        bench.situation.good_ns = Some(bench.now + PERIOD);
        bench.cycle()
    };
    let first = no_way(&mut bench);
    assert_eq!(first.state, TwistState::Braking);
    let last = (0..60).map(|_| no_way(&mut bench)).last().unwrap();
    assert_eq!(last, Decision::still(Hold::NoWay, TwistState::Holding));
    bench.ask(Action::Disarm);
    no_way(&mut bench);
    assert_eq!(bench.arm(), Outcome::Done);
    assert_eq!(no_way(&mut bench).state, TwistState::Holding);
    bench.resumes();
}

#[test]
fn without_the_joints_of_the_arm_it_cannot_be_armed() {
    let mut bench = Bench::new(false);
    bench.bad(Hold::NoJoints);
    assert_eq!(bench.ask(Action::Arm), Outcome::NoJoints);
    bench.good();
    assert_eq!(bench.ask(Action::Arm), Outcome::Done);
    bench.resumes();
    // It disarms for them when they stay away.
    while bench.bad(Hold::NoJoints).state != TwistState::Disarmed {}
    let disarmed = Decision::still(Hold::NoJoints, TwistState::Disarmed);
    assert_eq!(bench.good(), disarmed);
}
