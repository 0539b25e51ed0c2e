//! How each fault begins, and how those end that last for some time.

use decision::veto::Names;
use messages::{Action, Request, StrategyCode};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::dice;
use crate::fault::{Fault, Outcome};
use crate::operator::{Habit, MOST, Operator};
use crate::plan::Blow;
use crate::queue::Event;
use crate::trial::{FORGOTTEN, MS, SECOND, Stage};
use crate::visitor::{self, Visitor};
use crate::world::World;

impl World<'_> {
    /// The fault begins.
    pub fn strike(&mut self) {
        let fault = self.plan.fault;
        self.tell(|| format!("{fault:?}"));
        let now_ns = self.now_ns;
        self.trial.since_ns = now_ns;
        (self.trial.figures.brakes_ns, self.trial.figures.zero_ns) = (0, 0);
        self.trial.stage = match fault.outcome(self.plan.period_ns) {
            Outcome::GoesOn => {
                self.queue.at(now_ns + SECOND, Event::Turn);
                Stage::Going
            }
            Outcome::Ends => Stage::Ending,
            Outcome::Bears { .. } => Stage::Bearing,
            Outcome::Disarms { .. } => Stage::Failing,
            Outcome::Own if fault.is_of_joints() => {
                self.queue.at(now_ns + 4 * SECOND, Event::Turn);
                Stage::Going
            }
            Outcome::Own => self.trial.stage,
        };
        let strikes = u64::from(self.trial.strikes);
        self.begin_fault(fault, &mut dice(self.plan.seed, 100 + strikes));
    }

    /// An event of a storm begins.
    pub fn blow(&mut self, blow: &Blow) {
        let Blow { number, fault, .. } = *blow;
        if self.is_at_work {
            self.tell(|| format!("{fault:?} ({number})"));
            self.begin_fault(fault, &mut dice(self.plan.seed, 100 + number as u64));
        }
    }

    /// An event of a storm is over.
    pub fn over(&mut self, blow: &Blow) {
        let Blow { number, fault, .. } = *blow;
        self.tell(|| format!("{fault:?} ({number}) is over"));
        match fault {
            Fault::Network => self.network.recover(),
            _ if fault.is_short() => (),
            _ => {
                self.camera.recover();
                self.robot.recover();
            }
        }
        self.see_well();
    }

    fn begin_fault(&mut self, fault: Fault, random: &mut ChaCha8Rng) {
        let now_ns = self.now_ns;
        let period_ns = self.plan.period_ns;
        let is_storm = self.plan.fault == Fault::Storm;
        self.trial.is_grave |= fault.is_grave() && !is_storm;
        match fault {
            _ if fault >= Fault::RobotSilent && fault < Fault::Crash => {
                self.robot.fail(fault, random);
            }
            Fault::Crash | Fault::CrashDisarmed => {
                self.kill();
                self.start_again(random.random_range(100 * MS..SECOND));
            }
            Fault::Hang => {
                self.hung_until_ns = now_ns + 2 * SECOND;
                self.trial.since_ns = self.hung_until_ns;
                self.judge.hung_until(self.hung_until_ns);
                // An arm that waits in the queue must not count afterwards.
                let asked_ns = now_ns + random.random_range(0..2 * SECOND);
                if !is_storm {
                    self.queue.at(asked_ns, Event::Recover);
                }
            }
            Fault::Suspend => {
                self.suspended_ns += random.random_range(10 * MS..100 * SECOND);
            }
            Fault::ClockBack => {
                self.back_ns = 2 * period_ns + random.random_range(0..period_ns);
            }
            Fault::LateOnce => {
                let late_ns = random.random_range(2 * period_ns..3 * period_ns);
                self.late = (1, late_ns);
            }
            Fault::LateLoop => {
                let late_ns = random.random_range(period_ns + MS..2 * period_ns);
                self.late = (12, late_ns);
            }
            Fault::Unsent => self.unsent = random.random_range(1..6),
            Fault::Terminate => {
                self.is_again = false;
                self.stop.ask();
            }
            Fault::Reload => {
                self.reload();
                if !is_storm && random.random_bool(0.3) {
                    let at_ns = now_ns + random.random_range(0..100 * MS);
                    self.queue.at(at_ns, Event::Recover);
                }
            }
            Fault::Stop => {
                self.ask_stop();
                // In the same cycle somebody arms by the name that this stop will have.
                let name = Names(self.names()).next(true);
                self.ask(2, Request::arm(0, name));
            }
            Fault::StopTwice => self.ask_stop(),
            Fault::StopAgainstArm if random.random_bool(0.5) => self.ask_stop(),
            Fault::StopInFlood => {
                self.flood();
                self.ask_stop();
            }
            Fault::StopInBrake => {
                self.ask(1, Request::new(0, Action::Disarm));
                let at_ns = now_ns + random.random_range(0..100 * MS);
                self.queue.at(at_ns, Event::Recover);
            }
            Fault::StopFile | Fault::StopAgainstArm => {
                let may_be_lost = self.plan.fault == Fault::StopFile && self.trial.strikes == 1;
                self.change_stop_file(!may_be_lost, random);
            }
            Fault::Disarm => self.ask(1, Request::new(0, Action::Disarm)),
            Fault::VisitDisarm | Fault::VisitStop | Fault::VisitForeign if is_storm => {
                self.visit_goals(fault);
            }
            Fault::VisitDisarm => self.ask(1, Request::new(0, Action::Disarm)),
            Fault::VisitStop => self.ask_stop(),
            Fault::VisitForeign => (),
            Fault::Strategy => {
                let request = match random.random_bool(0.5) {
                    true => Request::strategy(0, StrategyCode::Knn, 3),
                    false => Request::strategy(0, StrategyCode::Previous, 0),
                };
                self.ask(1, request);
            }
            Fault::ToFollow => self.ask(1, Request::strategy(0, StrategyCode::Follow, 0)),
            Fault::ToGoal => self.ask(1, Request::strategy(0, StrategyCode::Previous, 0)),
            Fault::Flood => self.flood(),
            Fault::Network => self.network.disturb(random),
            _ => {
                if matches!(fault, Fault::OtherAfterHidden | Fault::OtherAfterRestart) {
                    self.camera.see_other(self.plan.stock.starts());
                }
                self.camera.fail(fault, now_ns, random);
                if fault == Fault::Replaced && !is_storm {
                    let at_ns = now_ns + random.random_range(400 * MS..700 * MS);
                    self.queue.at(at_ns, Event::Recover);
                }
            }
        }
    }

    /// A program begins to visit goals.
    pub fn visit_goals(&mut self, fault: Fault) {
        use crate::plan::Place::{Beside, Foreign, Paper};
        if self.visitor.as_ref().is_some_and(|one| !one.is_over()) {
            return;
        }
        let goals = match fault {
            Fault::VisitForeign => vec![Paper, Foreign],
            _ => vec![Paper, Beside, Paper],
        };
        self.visitor = Some(Visitor::new(goals, self.judge.veto));
        self.operators[visitor::OPERATOR].habit = Habit::Idle;
        self.queue.at(self.now_ns, Event::Visit);
    }

    /// SIGHUP: the daemon ends in order to begin again.
    pub fn reload(&mut self) {
        // Who asked it to end wins.
        self.is_again |= !self.stop.is_asked();
        self.stop.ask();
    }

    /// Another daemon starts after so long, ns.
    pub fn start_again(&mut self, after_ns: u64) {
        let start_ns = self.now_ns + after_ns;
        self.queue.at(start_ns, Event::Start);
        if self.is_trial() {
            self.trial.stage = Stage::Gone;
            let known_ns = start_ns + FORGOTTEN * self.plan.period_ns;
            self.queue.at(known_ns, Event::Turn);
        }
    }

    fn ask_stop(&mut self) {
        self.ask(1, Request::new(0, Action::Stop));
        self.expect_stop();
    }

    /// A stop was asked for: a loop that runs and can send obeys it in time.
    fn expect_stop(&mut self) {
        if self.is_at_work && self.is_trial() && self.late.0 == 0 && self.unsent == 0 {
            let asked_ns = self.now_ns.max(self.hung_until_ns);
            self.judge.stop_asked(asked_ns);
        }
    }

    /// All operators but the first two fill their queues.
    fn flood(&mut self) {
        for number in 2..MOST {
            self.let_act(number, Habit::Flood);
        }
    }

    fn change_stop_file(&mut self, must_be_usable: bool, random: &mut ChaCha8Rng) {
        let Some(domain) = &mut self.domain else {
            return;
        };
        self.trial.can_arm = domain.change(must_be_usable, random);
        self.expect_stop();
    }

    /// A second part of a fault, or its end.
    pub fn recover(&mut self) {
        match self.plan.fault {
            Fault::Replaced => self.camera.replace(&self.plan.start),
            Fault::StopInBrake => self.ask_stop(),
            Fault::Hang => self.ask(1, Request::arm(0, 0)),
            Fault::Reload if self.is_at_work && self.is_again => self.ask_stop(),
            _ => (),
        }
    }

    /// The process has ended in order, with zero as its last word, under this veto.
    pub fn ended(&mut self, veto: u32) {
        self.tell(|| "vpcd has ended".to_owned());
        self.is_at_work = false;
        self.process += 1;
        let is_again = self.is_again;
        self.again = is_again.then_some(veto);
        if !is_again {
            self.judge.forget();
        }
        self.operators.iter_mut().for_each(Operator::forget);
        self.observe_end();
        if !self.trial.is_over() {
            let after_ns = self.between(20 * MS, 200 * MS);
            self.start_again(after_ns);
        }
    }
}
