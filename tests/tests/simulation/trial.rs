//! The course of a run: the camera is set in motion, something goes wrong, what must follow
//! follows, and after that nothing moves until somebody arms again.

use messages::{Action, Hold, Outcome as Answer, Request, StrategyCode, TwistCommand, TwistState};
use rand::RngExt;

use crate::fault::{Fault, Outcome};
use crate::figures::Figures;
use crate::operator::{Habit, MOST};
use crate::promise::Promise;
use crate::property::share;
use crate::queue::Event;
use crate::world::World;

pub const MS: u64 = 1_000_000;
pub const SECOND: u64 = 1_000 * MS;
/// Wake-ups and the ways to the ports, ns.
const SLACK_NS: u64 = 4 * MS;
/// For how many periods the law remembers its commands, and may take points for others.
pub const FORGOTTEN: u64 = 36;
/// In which a camera that is armed moves, ns.
const PATIENCE_NS: u64 = 2 * SECOND;
/// How long a robot without commands moves on, ns: the dead man, a tick, the way of a command.
const REST_NS: u64 = 107 * MS;
/// In which a daemon that is told to end has ended, ns.
const END_NS: u64 = 500 * MS;
/// In which the camera stands after a guarded program fell silent, ns.
const SILENT_NS: u64 = 500 * MS;
/// From this share of the limits on a camera is fast.
const FAST: f64 = 0.25;
/// In which it arrives, or gives up, ns.
const ARRIVES_NS: u64 = 20 * SECOND;
/// Longest visit, ns.
const VISIT_NS: u64 = 6 * SECOND;
/// Twists of a guarded program, and cycles in which they move the camera at least.
const TWISTS: u32 = 100;
const MOVED: u32 = 200;
/// The deepest that a guarded point may be in an occlusion or outside the image, px.
const DEEPEST_PX: f64 = 3.0;

/// Where a run is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stage {
    /// Nothing may move; what is to come is due at the next turn.
    Waiting,
    /// It is to be set in motion.
    Arming,
    Moving,
    /// The fault has begun.
    Failing,
    /// The daemon is gone, or another one has begun.
    Gone,
    /// It has disarmed.
    GaveUp,
    /// It can never be armed again, whatever an operator asks.
    Refused,
    /// It must go on in spite of the fault.
    Going,
    /// It arrives in spite of the fault, or disarms.
    Bearing,
    /// A program visits goals.
    Visiting,
    /// Nothing may move any more.
    Watched,
    /// It is told to end.
    Ending,
    /// Another program steers; then it has fallen silent.
    Guarded,
    Unwanted,
    Storm,
    /// The storm is over.
    Calm,
    Over,
}

/// The course of a run.
pub struct Trial {
    pub stage: Stage,
    /// From when times count: the last good features, or the fault, ns.
    pub since_ns: u64,
    /// Until when it must move, ns.
    pub until_ns: u64,
    /// How often the fault is still to strike.
    pub strikes: u32,
    /// Whether the careful operator asks to arm.
    pub is_armed_for: bool,
    /// Whether it can be armed again after this fault.
    pub can_arm: bool,
    /// Whether zero at once is in order now.
    pub is_grave: bool,
    /// Twists that the other program has wanted, and cycles in which the camera moved.
    pub twists: u32,
    pub moved: u32,
    /// The times of this run.
    pub figures: Figures,
}

impl Trial {
    /// Before anything.
    pub fn new() -> Self {
        Self {
            stage: Stage::Arming,
            since_ns: 0,
            until_ns: u64::MAX,
            strikes: 1,
            is_armed_for: true,
            can_arm: true,
            is_grave: false,
            twists: 0,
            moved: 0,
            figures: Figures::default(),
        }
    }

    /// Whether the run is over.
    pub fn is_over(&self) -> bool {
        self.stage == Stage::Over
    }

    /// Whether the other program goes on.
    pub fn wants_twist(&self) -> bool {
        self.twists < TWISTS
    }
}

impl World<'_> {
    /// Before the first event.
    pub fn begin_trial(&mut self) {
        let now_ns = self.now_ns;
        self.trial.until_ns = now_ns + PATIENCE_NS;
        self.let_act(0, Habit::Careful);
        match self.plan.fault {
            Fault::RobotUnheard => {
                self.trial.stage = Stage::Waiting;
                self.robot.fail(Fault::RobotUnheard, &mut self.random);
                self.trial.strikes = 0;
                self.queue.at(now_ns + 3 * SECOND / 2, Event::Turn);
            }
            Fault::ArmedStart => {
                self.peers_ns += self.between(0, 4 * SECOND);
                self.trial.until_ns = self.peers_ns + PATIENCE_NS;
                (self.trial.is_armed_for, self.trial.strikes) = (false, 0);
            }
            Fault::ArmedAlone => {
                self.peers_ns += self.between(5_300 * MS, 8 * SECOND);
                self.trial.stage = Stage::Waiting;
                (self.trial.is_armed_for, self.trial.strikes) = (false, 0);
                self.queue.at(self.peers_ns + SECOND, Event::Turn);
            }
            Fault::StopAgainstArm => {
                for number in 2..5 {
                    self.let_act(number, Habit::ArmLoop);
                }
            }
            Fault::StopTwice | Fault::StopFile => self.trial.strikes = 2,
            fault if fault.is_of_policy() => self.trial.until_ns = u64::MAX,
            Fault::Storm => {
                self.trial.stage = Stage::Storm;
                self.let_act(1, Habit::Wild);
                if self.random.random_bool(0.3) {
                    self.let_act(2, Habit::Flood);
                }
                if self.random.random_bool(0.5) {
                    self.queue.at(now_ns + SECOND, Event::Want);
                }
                let last_ns = self.plan.blows.iter().map(|blow| blow.until_ns).max();
                let end_ns = now_ns + last_ns.unwrap_or(0) + 2 * SECOND;
                self.queue.at(end_ns, Event::Turn);
            }
            fault if fault.is_of_visit() => {
                self.trial.stage = Stage::Visiting;
                self.trial.is_armed_for = false;
                self.queue.at(now_ns + SECOND, Event::Turn);
                // At any instant from the first goal on.
                let strike_ns = self.between(1_100 * MS, 4 * SECOND);
                self.queue.at(now_ns + strike_ns, Event::Strike);
            }
            _ => (),
        }
    }

    /// Whether something goes wrong once, and something follows.
    pub fn is_trial(&self) -> bool {
        self.plan.fault != Fault::Storm && !self.plan.fault.is_of_visit()
    }

    /// From now on an operator has this habit.
    pub fn let_act(&mut self, number: usize, habit: Habit) {
        self.operators[number].habit = habit;
    }

    /// A command has gone out at `now_ns`.
    pub fn observe(&mut self, command: &TwistCommand, hold: Option<Hold>, now_ns: u64) {
        let is_still = command.twist == [0.0; 6];
        let state = command.state().unwrap();
        let is_of_law = matches!(state, TwistState::Moving | TwistState::Arrived);
        match self.trial.stage {
            Stage::Arming if self.plan.fault.is_of_policy() => self.begin_to_want(),
            Stage::Arming if is_of_law && !is_still => self.moves(),
            Stage::Arming if now_ns > self.trial.until_ns => {
                let heard = self.operators[0].heard.and_then(|reply| reply.outcome());
                self.judge.fail(Promise::Motion, || {
                    format!("none in time: {state}, {hold:?}; arm is answered {heard:?}")
                });
            }
            Stage::Failing => self.observe_fault(command, hold, now_ns),
            Stage::Bearing => {
                self.observe_speed(&command.twist, state);
                self.observe_arrival(state, hold);
            }
            Stage::Moving if self.plan.fault == Fault::Nothing => {
                self.observe_arrival(state, hold);
            }
            Stage::Watched => {
                self.judge.check(Promise::Unasked, is_still, || {
                    format!("{state} after a change of the strategy")
                });
            }
            Stage::Gone => {
                let is_fine = state == TwistState::Disarmed;
                self.judge
                    .check(Promise::Restart, is_fine, || format!("{state} ({hold:?})"));
                let causes = match self.plan.fault {
                    Fault::Reload => &[Hold::NotArmed, Hold::Operator][..],
                    _ => &[Hold::Unclean],
                };
                self.judge.cause(causes, hold);
            }
            Stage::Refused => {
                let is_fine = state == TwistState::Disarmed;
                self.judge.check(Promise::Consent, is_fine, || {
                    format!("{state} without a stop file")
                });
            }
            Stage::Going if state == TwistState::Disarmed => {
                let is_lie = self.plan.fault.is_of_joints();
                self.judge
                    .check(Promise::GoesOn, is_lie, || format!("disarmed, {hold:?}"));
            }
            Stage::Guarded => self.trial.moved += u32::from(!is_still),
            Stage::Unwanted => self.observe_silence(is_still, state, hold),
            _ => (),
        }
    }

    /// It has been set in motion: what goes wrong comes soon; or it was all that was to be shown.
    fn moves(&mut self) {
        self.trial.is_armed_for = false;
        if self.trial.strikes == 0 {
            self.trial.stage = Stage::Over;
            return;
        }
        self.trial.stage = Stage::Moving;
        if self.plan.fault == Fault::Nothing {
            self.trial.until_ns = self.now_ns + ARRIVES_NS;
            return;
        }
        let periods = if self.plan.fault == Fault::NoAnswer {
            40..60
        } else {
            5..12
        };
        let period_ns = self.plan.period_ns;
        let after_ns = self.between(periods.start * period_ns, periods.end * period_ns);
        self.queue.at(self.now_ns + after_ns, Event::Strike);
    }

    /// The law is fast for no longer, in all, than it takes to notice the fault.
    fn observe_speed(&mut self, twist: &[f64; 6], state: TwistState) {
        let Outcome::Bears { fast_ns, .. } = self.plan.fault.outcome(self.plan.period_ns) else {
            return;
        };
        let is_fast = share(twist, &self.scene.limits.velocity()) > FAST;
        if state == TwistState::Moving && is_fast {
            self.trial.figures.fast_ns += self.plan.period_ns;
            let took_ns = self.trial.figures.fast_ns;
            self.judge.check(Promise::Brake, took_ns <= fast_ns, || {
                format!("the law is fast for {} ms in all", took_ns / MS)
            });
        }
    }

    /// It arrives in the end, or disarms for a cause that the fault may have.
    fn observe_arrival(&mut self, state: TwistState, hold: Option<Hold>) {
        let until_ns = match self.plan.fault {
            Fault::Nothing => self.trial.until_ns,
            _ => self.trial.since_ns + ARRIVES_NS,
        };
        let outcome = self.plan.fault.outcome(self.plan.period_ns);
        match (state, outcome) {
            (TwistState::Arrived, _) => {
                self.judge.check(Promise::Arrives, true, String::new);
                self.trial.stage = Stage::Over;
            }
            (TwistState::Disarmed, Outcome::Bears { causes, .. }) => {
                self.judge.cause(causes, hold);
                self.trial.stage = Stage::Over;
            }
            (TwistState::Disarmed, _) => {
                let disarmed = || format!("disarmed, {hold:?}");
                self.judge.fail(Promise::Arrives, disarmed);
            }
            // A wish never arrives.
            _ if self.plan.fault.is_of_policy() && self.now_ns >= until_ns => {
                self.trial.stage = Stage::Over;
            }
            _ => {
                let is_in_time = self.now_ns < until_ns || self.plan.fault.is_of_policy();
                self.judge.check(Promise::Arrives, is_in_time, || {
                    format!("not in {} s: {state}, {hold:?}", ARRIVES_NS / SECOND)
                });
            }
        }
    }

    fn observe_fault(&mut self, command: &TwistCommand, hold: Option<Hold>, now_ns: u64) {
        let Outcome::Disarms {
            causes,
            goes_on_ns,
            brakes,
        } = self.plan.fault.outcome(self.plan.period_ns)
        else {
            return;
        };
        let zero_ns = goes_on_ns + brakes * self.plan.brake_ns();
        if self.plan.fault.is_of_eyes() {
            self.trial.since_ns = self.camera.good_ns();
        }
        let Some(took_ns) = now_ns.checked_sub(self.trial.since_ns) else {
            return;
        };
        let (is_still, state) = (command.twist == [0.0; 6], command.state().unwrap());
        let is_of_law = matches!(state, TwistState::Moving | TwistState::Arrived);
        let ms = took_ns / MS;
        let figures = &mut self.trial.figures;
        let had_zero = figures.zero_ns > 0;
        let brakes = !is_of_law && figures.brakes_ns == 0;
        if brakes {
            figures.brakes_ns = took_ns;
        }
        if is_still && !had_zero {
            figures.zero_ns = took_ns;
        }
        // The last command of the law, and the one that replaces it.
        if is_of_law || brakes {
            let is_in_time = took_ns <= goes_on_ns + SLACK_NS;
            self.judge.check(Promise::Brake, is_in_time, || {
                format!("the law goes on for {ms} ms")
            });
        }
        let is_late = took_ns > zero_ns + SLACK_NS && !had_zero;
        self.judge.check(Promise::Zero, !is_late, || {
            format!("after {ms} ms, {hold:?}")
        });
        let again = had_zero && !is_still;
        self.judge
            .check(Promise::Zero, !again || self.plan.fault.may_flare(), || {
                format!("it moves again after {ms} ms, {hold:?}")
            });
        let never = took_ns > zero_ns + 2 * SECOND;
        self.judge.check(Promise::Disarm, !never, || {
            format!("not in {ms} ms: {state}, {hold:?}")
        });
        if is_still && state == TwistState::Disarmed {
            self.judge.cause(causes, hold);
            self.gave_up();
        }
    }

    /// It has disarmed: whatever was wrong is over, and nothing moves.
    fn gave_up(&mut self) {
        self.tell(|| "it gave up".to_owned());
        self.trial.stage = Stage::GaveUp;
        self.trial.strikes -= 1;
        self.trial.is_grave = false;
        if self.plan.fault != Fault::Replaced {
            self.camera.recover();
        }
        self.robot.recover();
        self.late = (0, 0);
        self.see_well();
        let periods = FORGOTTEN + self.between(3, 12);
        let wait_ns = periods * self.plan.period_ns;
        self.queue.at(self.now_ns + wait_ns, Event::Turn);
    }

    /// Somebody carries the camera to where it sees the pattern, where it does not.
    pub fn see_well(&mut self) {
        let size = [self.plan.scene.camera.width, self.plan.scene.camera.height];
        let is_seen = self.camera.eye.features().is_ok_and(|points| {
            let mut points = points.iter();
            points.all(|p| (0..2).all(|k| p[k] > 20.0 && p[k] < size[k] - 20.0))
        });
        if !is_seen {
            self.camera.place(&self.plan.start);
        }
    }

    /// The robot carries out motion, or none.
    pub fn observe_robot(&mut self, is_moving: bool) {
        let fault = self.plan.fault;
        let took_ns = match (self.trial.stage, fault) {
            (Stage::Gone, Fault::Crash | Fault::CrashDisarmed) => self.now_ns - self.trial.since_ns,
            (Stage::Failing, Fault::Hang) if self.now_ns < self.hung_until_ns => {
                self.now_ns + 2 * SECOND - self.hung_until_ns
            }
            _ => return,
        };
        if is_moving {
            self.trial.figures.rest_ns = took_ns;
            self.judge.check(Promise::Rest, took_ns <= REST_NS, || {
                format!("the robot moves {} ms after", took_ns / MS)
            });
        }
    }

    /// The process has ended in order, with zero as its last word.
    pub fn observe_end(&mut self) {
        if self.trial.stage != Stage::Ending {
            return;
        }
        let took_ns = self.now_ns - self.trial.since_ns;
        self.trial.figures.end_ns = took_ns;
        self.judge.check(Promise::End, took_ns <= END_NS, || {
            format!("after {} ms", took_ns / MS)
        });
        if self.plan.fault == Fault::Terminate {
            self.trial.stage = Stage::Over;
        }
    }

    /// The next part of the trial.
    pub fn turn(&mut self) {
        match self.trial.stage {
            Stage::Waiting => {
                if self.plan.fault == Fault::RobotUnheard {
                    let heard = self.operators[0].heard.and_then(|reply| reply.outcome());
                    let is_refused = heard == Some(Answer::NoRobot);
                    self.judge.check(Promise::NoRobot, is_refused, || {
                        format!("arm is answered {heard:?}")
                    });
                    self.robot.recover();
                }
                self.arm_again();
            }
            Stage::GaveUp if !self.trial.can_arm => {
                // Nobody could stop it any more: it cannot be armed.
                (self.trial.is_armed_for, self.trial.can_arm) = (true, true);
                self.trial.stage = Stage::Refused;
                self.queue.at(self.now_ns + SECOND, Event::Turn);
            }
            // Where nobody wants a twist, nothing moves.
            Stage::GaveUp if self.plan.fault == Fault::ToFollow => {
                self.trial.stage = Stage::Over;
            }
            Stage::GaveUp | Stage::Gone => {
                self.trial.strikes = self.trial.strikes.min(1);
                if self.trial.stage == Stage::Gone {
                    self.trial.strikes = 0;
                }
                let wrong = self.random.random_range(2..9);
                self.ask(1, Request::arm(0, wrong));
                self.arm_again();
            }
            Stage::Visiting if self.visitor.is_none() => {
                self.visit_goals(self.plan.fault);
                self.queue.at(self.now_ns + VISIT_NS, Event::Turn);
            }
            Stage::Guarded => {
                self.trial.stage = Stage::Watched;
                self.queue.at(self.now_ns, Event::Strike);
                self.queue.at(self.now_ns + 2 * SECOND, Event::Turn);
            }
            Stage::Going | Stage::Refused | Stage::Visiting | Stage::Watched => {
                self.trial.stage = Stage::Over;
            }
            Stage::Storm => self.calm(),
            Stage::Calm => {
                // It stands.
                self.camera.place(&self.plan.start);
                self.trial.stage = Stage::Waiting;
                let wait_ns = 2 * FORGOTTEN * self.plan.period_ns;
                self.queue.at(self.now_ns + wait_ns, Event::Turn);
            }
            _ => (),
        }
    }

    /// A storm is over, and nothing is wrong any more: the camera can be armed, and moves.
    fn calm(&mut self) {
        self.tell(|| "all is well".to_owned());
        self.network.recover();
        self.camera.recover();
        self.robot.recover();
        (self.late, self.unsent, self.visitor) = ((0, 0), 0, None);
        for number in 0..MOST {
            self.let_act(number, Habit::Idle);
        }
        self.let_act(0, Habit::Careful);
        self.ask(1, Request::new(0, Action::Disarm));
        let strategy = Request::strategy(0, StrategyCode::Previous, 0);
        self.ask(1, strategy);
        self.trial.stage = Stage::Calm;
        (self.trial.is_armed_for, self.trial.strikes) = (false, 0);
        self.queue.at(self.now_ns + SECOND, Event::Turn);
    }

    fn arm_again(&mut self) {
        self.trial.stage = Stage::Arming;
        self.trial.is_armed_for = true;
        self.trial.until_ns = self.now_ns + PATIENCE_NS;
    }

    /// A guarded program begins, once it is armed.
    fn begin_to_want(&mut self) {
        let heard = self.operators[0].heard;
        let is_armed = heard.is_some_and(|reply| reply.outcome() == Some(Answer::Done));
        if is_armed {
            self.trial.stage = Stage::Guarded;
            self.trial.is_armed_for = false;
            match self.plan.fault {
                // Nobody wants anything: it waits.
                Fault::ToGoal => self.queue.at(self.now_ns + SECOND, Event::Turn),
                Fault::Guardian => self.queue.at(self.now_ns, Event::Want),
                _ => {
                    self.queue.at(self.now_ns, Event::Want);
                    self.queue.at(self.now_ns + SECOND / 2, Event::Strike);
                }
            }
        }
    }

    /// The guarded program says nothing more.
    pub fn policy_is_silent(&mut self) {
        if self.trial.stage != Stage::Guarded {
            return;
        }
        self.trial.stage = Stage::Unwanted;
        self.trial.since_ns = self.now_ns - crate::policy::EVERY_NS;
    }

    fn observe_silence(&mut self, is_still: bool, state: TwistState, hold: Option<Hold>) {
        let took_ns = self.now_ns - self.trial.since_ns;
        if is_still && self.trial.figures.zero_ns == 0 {
            self.trial.figures.zero_ns = took_ns;
        }
        let is_in_time = is_still || took_ns <= SILENT_NS;
        self.judge.check(Promise::Guardian, is_in_time, || {
            format!("it moves {} ms after the program", took_ns / MS)
        });
        if took_ns < SECOND {
            return;
        }
        let is_fine = (state, hold) == (TwistState::Holding, Some(Hold::Unwanted));
        self.judge
            .check(Promise::Guardian, is_fine, || format!("{state}, {hold:?}"));
        let moved = self.trial.moved;
        self.judge.check(Promise::Guardian, moved > MOVED, || {
            format!("it moved in {moved} cycles")
        });
        let least = self.referee.as_ref().map_or(0.0, |one| one.least_between());
        self.trial.figures.deepest_px = (-least).max(0.0);
        self.judge
            .check(Promise::Guardian, -least < DEEPEST_PX, || {
                format!("a point is {:.1} px deep", -least)
            });
        self.trial.stage = Stage::Over;
    }
}
