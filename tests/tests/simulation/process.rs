//! A process of the daemon in the world: it starts, wakes, decides, sends, sleeps, and ends.

use std::hash::Hasher;

use messages::{Action, Hold, Reply, Request, TwistCommand};
use rand::RngExt;

use crate::daemon::{Begin, Cycle, Daemon};
use crate::operator::{Habit, MOST, Operator};
use crate::property::Facts;
use crate::queue::Event;
use crate::stop_file::Domain;
use crate::world::{Left, World};

impl World<'_> {
    /// A new process, after what the one before has left.
    pub fn start(&mut self) {
        let begin = match self.left {
            Left::Nothing => Begin::Configured,
            Left::Killed => Begin::Unclean,
            Left::Again(stops) => Begin::Again(stops),
        };
        self.tell(|| format!("vpcd starts: {begin:?}"));
        self.process += 1;
        self.shutdown = false;
        if let (true, Some(domain)) = (self.left != Left::Nothing, &mut self.domain) {
            domain.open_again();
        }
        let daemon = Daemon::new(&self.plan, begin, self.now_ns, self.suspended_ns);
        self.recorder.state(&daemon, self.now_ns);
        let release_ns = daemon.release_ns();
        self.daemon = Some(daemon);
        self.queue
            .at(release_ns + 50_000, Event::Wake(self.process));
    }

    /// The process is gone, whatever it was about to do.
    pub fn kill(&mut self) {
        self.tell(|| "vpcd is killed".to_owned());
        self.daemon = None;
        self.process += 1;
        self.left = Left::Killed;
        self.operators.iter_mut().for_each(Operator::forget);
        self.judge.killed();
    }

    /// The daemon's cycle up to its decision.
    pub fn wake(&mut self) {
        let back_ns = std::mem::take(&mut self.back_ns);
        let woken_ns = self.now_ns - back_ns;
        let now_ns = woken_ns + self.between(5_000, 40_000);
        let inbox = std::mem::take(&mut self.inbox);
        let Some(mut daemon) = self.daemon.take() else {
            return;
        };
        daemon.hear(&inbox.features, woken_ns);
        self.take_requests(&mut daemon, now_ns);
        let mut cycle = daemon.decide(inbox, woken_ns, now_ns, self.suspended_ns, self.shutdown);
        let decided_ns = now_ns + self.between(10_000, 300_000);
        daemon.decided(&mut cycle, decided_ns);
        self.daemon = Some(daemon);
        let sent_ns = decided_ns + back_ns + self.between(5_000, 60_000);
        self.queue
            .at(sent_ns, Event::Send(self.process, Box::new(cycle)));
    }

    /// All requests that wait, in any order of the operators, and the stop file after them.
    fn take_requests(&mut self, daemon: &mut Daemon, now_ns: u64) {
        for operator in &mut self.operators {
            if operator.habit == Habit::Flood {
                operator.act(self.now_ns, &mut self.random);
            }
        }
        for _ in 0..Request::PER_CYCLE {
            let waiting = (0..MOST).filter(|k| self.operators[*k].waits());
            let waiting: Vec<usize> = waiting.collect();
            if waiting.is_empty() {
                break;
            }
            let number = waiting[self.random.random_range(0..waiting.len())];
            if let Some(request) = self.operators[number].oldest() {
                daemon.take(&request, now_ns);
            }
        }
        if self.domain.as_mut().is_some_and(Domain::is_asked) {
            daemon.take(&Request::new(Request::STOP_FILE, Action::Stop), now_ns);
        }
    }

    /// The cycle's command and its answers go out.
    pub fn send(&mut self, mut cycle: Box<Cycle>) {
        let Some(daemon) = &mut self.daemon else {
            return;
        };
        let can_send = self.unsent == 0;
        self.unsent = self.unsent.saturating_sub(1);
        let sent = daemon.send(&mut cycle, self.now_ns, can_send);
        let decision = cycle.answer.decision;
        let command = sent.unwrap_or_else(|| {
            TwistCommand::answer_to(&cycle.answer.stamp, decision.twist, decision.state)
        });
        for v in command.twist {
            self.hash.write_u64(v.to_bits());
        }
        self.hash.write_u32(command.state);
        self.hash.write_u32(Hold::number(decision.hold));
        self.hash.write_u32(cycle.record.predicted);
        self.tell(|| {
            let speed = command
                .twist
                .iter()
                .fold(0.0_f64, |most, v| most.max(v.abs()));
            format!(
                "{} {:?} {speed:.4}{}",
                decision.state,
                decision.hold,
                if sent.is_some() { "" } else { " (not sent)" }
            )
        });
        let facts = Facts {
            eyes_ns: self.eyes_ns,
            is_grave: self.trial.is_grave,
        };
        self.judge.cycle(&cycle, &command, facts, self.now_ns);
        self.answer(&mut cycle);
        if let Some(command) = sent {
            self.robot.obey(&command);
            self.newest = Some(command);
            self.acknowledge_stop(&command);
            self.observe(&command, decision.hold);
        }
        let thought_ns = self.now_ns + self.between(20_000, 7_000_000);
        self.queue.at(thought_ns, Event::Sleep(self.process, cycle));
    }

    /// Each answer goes to the operator that asked; each request has exactly one.
    fn answer(&mut self, cycle: &mut Cycle) {
        for (request, reply) in &mut cycle.replies {
            (reply.stamp.sequence, reply.stamp.published_ns) = (1, self.now_ns);
            let reply: &Reply = reply;
            if request.id == Request::STOP_FILE {
                continue;
            }
            self.tell(|| format!("answer to {:?}: {:?}", request.action(), reply.outcome()));
            let asks = self.operators.iter_mut().enumerate();
            let mut asks = asks.filter(|(k, _)| *k as u64 + 1 == reply.id >> 32);
            let is_heard = asks
                .next()
                .is_some_and(|(_, operator)| operator.hear(reply));
            self.judge.check(is_heard, || {
                format!("replies: one that nobody waits for: {reply:?}")
            });
        }
        for operator in &self.operators {
            let since_ns = operator.waits_since_ns().unwrap_or(u64::MAX);
            let woken_ns = cycle.woken_ns;
            self.judge.check(since_ns >= woken_ns, || {
                let waits_us = (woken_ns - since_ns) / 1000;
                format!("replies: none in a cycle that began {waits_us} us after the request")
            });
        }
    }

    fn acknowledge_stop(&mut self, command: &TwistCommand) {
        let Some(domain) = &mut self.domain else {
            return;
        };
        let was_confirmed = domain.is_confirmed();
        domain.acknowledge();
        let is_new = domain.is_confirmed() && !was_confirmed;
        self.judge.check(!is_new || command.twist == [0.0; 6], || {
            "stop: confirmed before zero was sent".to_owned()
        });
    }

    /// The cycle ends: the daemon thinks, and sleeps until its next release, or ends.
    pub fn sleep(&mut self, mut cycle: Box<Cycle>) {
        let Some(mut daemon) = self.daemon.take() else {
            return;
        };
        daemon.finish(&mut cycle, self.now_ns);
        self.cycles += 1;
        self.recorder.cycle(&cycle);
        self.recorder.state(&daemon, self.now_ns);
        if self.shutdown && daemon.is_over() {
            let command = daemon.last_word(self.now_ns);
            self.robot.obey(&command);
            self.newest = Some(command);
            self.judge.last_word(&command);
            self.ended(daemon);
            return;
        }
        daemon.rehearse();
        let (count, late_ns) = self.late;
        let late_ns = if count > 0 { late_ns } else { 0 };
        self.late.0 = count.saturating_sub(1);
        let wake_ns = daemon.release_ns() + self.between(20_000, 120_000) + late_ns;
        self.daemon = Some(daemon);
        let wake_ns = wake_ns.max(self.now_ns);
        self.queue.at(wake_ns, Event::Wake(self.process));
    }
}
