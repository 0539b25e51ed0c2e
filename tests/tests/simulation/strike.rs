//! How each fault begins, and how those end that last for some time.

use messages::{Action, Request, StrategyCode};
use rand::RngExt;

use crate::PERIOD_NS;
use crate::fault::{ALL, Fault, Outcome};
use crate::operator::{Habit, MOST};
use crate::queue::Event;
use crate::trial::{FORGOTTEN_NS, MS, SECOND, Stage};
use crate::world::World;

impl World<'_> {
    /// The fault begins.
    pub fn strike(&mut self) {
        let fault = self.plan.fault;
        self.tell(|| format!("{fault:?}"));
        let now_ns = self.now_ns;
        self.trial.since_ns = now_ns;
        (self.trial.figures.brakes_ns, self.trial.figures.zero_ns) = (0, 0);
        self.trial.stage = match fault.outcome() {
            Outcome::GoesOn => {
                self.queue.at(now_ns + SECOND, Event::Turn);
                Stage::Going
            }
            Outcome::Ends => Stage::Ending,
            _ => Stage::Failing,
        };
        self.begin_fault(fault);
    }

    fn begin_fault(&mut self, fault: Fault) {
        let now_ns = self.now_ns;
        match fault {
            Fault::RobotSilent
            | Fault::RobotDead
            | Fault::RobotReflex
            | Fault::RobotStrays
            | Fault::RobotBlocked => {
                self.trial.is_grave = fault == Fault::RobotReflex;
                self.robot.fail(fault);
            }
            Fault::Crash | Fault::CrashDisarmed => self.crash(),
            Fault::Hang => {
                self.hung_until_ns = now_ns + 2 * SECOND;
                self.trial.since_ns = self.hung_until_ns;
                self.judge.hung_until(self.hung_until_ns);
                // An arm that waits in the queue must not count afterwards.
                let asked_ns = now_ns + self.between(0, 2 * SECOND);
                self.queue.at(asked_ns, Event::Recover);
            }
            Fault::Suspend => {
                self.trial.is_grave = true;
                self.suspended_ns += self.between(10 * MS, 100 * SECOND);
            }
            Fault::ClockBack => {
                self.trial.is_grave = true;
                self.back_ns = 2 * PERIOD_NS + self.between(0, PERIOD_NS);
            }
            Fault::LateOnce => {
                let late_ns = self.between(2 * PERIOD_NS, 3 * PERIOD_NS);
                self.late = (1, late_ns);
            }
            Fault::LateLoop => {
                let late_ns = self.between(PERIOD_NS + MS, 2 * PERIOD_NS);
                self.late = (12, late_ns);
            }
            Fault::Unsent => self.unsent = self.random.random_range(1..6),
            Fault::Terminate | Fault::Reload => {
                self.shutdown = true;
                if fault == Fault::Reload && self.random.random_bool(0.3) {
                    let at_ns = now_ns + self.between(0, 100 * MS);
                    self.queue.at(at_ns, Event::Recover);
                }
            }
            Fault::Stop => {
                self.ask_stop();
                // In the same cycle somebody arms by the name that this stop will have.
                self.operators[2].ask(Request::arm(0, 1), now_ns);
            }
            Fault::StopTwice => self.ask_stop(),
            Fault::StopAgainstArm if self.random.random_bool(0.5) => self.ask_stop(),
            Fault::StopInFlood => {
                self.flood();
                self.ask_stop();
            }
            Fault::StopInBrake => {
                self.operators[1].ask(Request::new(0, Action::Disarm), now_ns);
                let at_ns = now_ns + self.between(0, 100 * MS);
                self.queue.at(at_ns, Event::Recover);
            }
            Fault::StopFile | Fault::StopAgainstArm => {
                let may_be_lost = self.plan.fault == Fault::StopFile && self.trial.strikes == 1;
                let must_be_usable = !may_be_lost;
                self.change_stop_file(must_be_usable);
            }
            Fault::Disarm => self.operators[1].ask(Request::new(0, Action::Disarm), now_ns),
            Fault::Strategy => {
                let request = match self.random.random_bool(0.5) {
                    true => Request::strategy(0, StrategyCode::Knn, 3),
                    false => Request::strategy(0, StrategyCode::Previous, 0),
                };
                self.operators[1].ask(request, now_ns);
            }
            Fault::Flood => self.flood(),
            _ => {
                self.trial.is_grave = fault == Fault::Future;
                if matches!(fault, Fault::OtherAfterHidden | Fault::OtherAfterRestart) {
                    self.camera.see_other(self.plan.stock.starts());
                }
                self.camera.fail(fault, now_ns, &mut self.random);
                if fault == Fault::Replaced {
                    let at_ns = now_ns + self.between(400 * MS, 700 * MS);
                    self.queue.at(at_ns, Event::Recover);
                }
            }
        }
    }

    fn ask_stop(&mut self) {
        self.operators[1].ask(Request::new(0, Action::Stop), self.now_ns);
        self.expect_stop();
    }

    /// A stop was asked for: a loop that runs and can send obeys it in time.
    fn expect_stop(&mut self) {
        if self.daemon.is_some() && self.late.0 == 0 && self.unsent == 0 {
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

    fn change_stop_file(&mut self, must_be_usable: bool) {
        let Some(domain) = &mut self.domain else {
            return;
        };
        self.trial.can_arm = domain.change(must_be_usable, &mut self.random);
        self.expect_stop();
    }

    fn crash(&mut self) {
        self.kill();
        let start_ns = self.now_ns + self.between(100 * MS, SECOND);
        self.queue.at(start_ns, Event::Start);
        if self.trial.stage == Stage::Storm {
            return;
        }
        self.trial.stage = Stage::Gone;
        self.queue.at(start_ns + FORGOTTEN_NS, Event::Turn);
    }

    /// A second part of a fault, or its end.
    pub fn recover(&mut self) {
        match self.plan.fault {
            Fault::Replaced => self.camera.replace(&self.plan.start),
            Fault::StopInBrake => self.ask_stop(),
            Fault::Hang => self.operators[1].ask(Request::arm(0, 0), self.now_ns),
            Fault::Reload if self.daemon.is_some() && self.shutdown => self.ask_stop(),
            Fault::Storm => {
                self.camera.recover();
                self.robot.recover();
                self.see_well();
            }
            _ => (),
        }
    }

    /// Something goes wrong, or something else, until the time is up.
    pub fn storm(&mut self) {
        if self.now_ns > self.trial.until_ns {
            self.trial.stage = Stage::Over;
            return;
        }
        self.trial.is_grave = false;
        let number = self.random.random_range(0..ALL.len());
        let fault = ALL[number];
        let is_left_out = matches!(
            fault,
            Fault::Storm
                | Fault::Guardian
                | Fault::ArmedStart
                | Fault::ArmedAlone
                | Fault::RobotUnheard
                | Fault::CrashDisarmed
                | Fault::Terminate
                | Fault::Reload
                | Fault::StopInBrake
                | Fault::StopAgainstArm
        );
        // Records of a clock that goes back have no order.
        let is_left_out = is_left_out || fault == Fault::ClockBack && self.plan.is_recorded;
        if self.daemon.is_some() && !is_left_out {
            self.tell(|| format!("{fault:?}"));
            self.begin_fault(fault);
        }
        let recover_ns = self.now_ns + self.between(10 * MS, SECOND);
        self.queue.at(recover_ns, Event::Recover);
        let next_ns = recover_ns + self.between(10 * MS, 2 * SECOND);
        self.queue.at(next_ns, Event::Turn);
    }
}
