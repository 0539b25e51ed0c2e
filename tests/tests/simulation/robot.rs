//! The robot: it carries the camera as the dead man lets it, and says what it does.

use messages::{RobotMode, RobotState, TwistCommand};

use crate::fault::Fault;

/// How much more along y than it is told a robot says that it moves that strays, m/s: twice the
/// limit.
const BESIDE: f64 = 1.0;

/// The robot and its client.
#[derive(Default)]
pub struct Robot {
    /// The newest command.
    command: Option<TwistCommand>,
    /// What it carries out until its next tick.
    twist: [f64; 6],
    fault: Option<Fault>,
    sequence: u64,
}

impl Robot {
    /// A command came.
    pub fn obey(&mut self, command: &TwistCommand) {
        self.command = Some(*command);
    }

    /// From now on it fails so.
    pub fn fail(&mut self, fault: Fault) {
        self.fault = Some(fault);
    }

    /// From now on it works.
    pub fn recover(&mut self) {
        self.fault = None;
    }

    /// What it carries out.
    pub fn twist(&self) -> [f64; 6] {
        self.twist
    }

    /// Its tick at `now_ns`: what it carries out from now on, by the dead man of the contract.
    pub fn tick(&mut self, now_ns: u64) {
        let command = self.command.unwrap_or_default();
        let told = command.in_force(now_ns);
        self.twist = match self.fault {
            Some(Fault::RobotDead | Fault::RobotReflex | Fault::RobotBlocked) => [0.0; 6],
            _ => told,
        };
    }

    /// What it says at `now_ns`; `None` if nothing.
    pub fn state(&mut self, now_ns: u64) -> Option<RobotState> {
        let silent = [Fault::RobotSilent, Fault::RobotDead, Fault::RobotUnheard];
        if self.fault.is_some_and(|fault| silent.contains(&fault)) {
            return None;
        }
        let mut state = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], now_ns);
        self.sequence += 1;
        (state.stamp.sequence, state.stamp.published_ns) = (self.sequence, now_ns);
        let is_fault = self.fault == Some(Fault::RobotReflex);
        let mode = match self.command {
            _ if is_fault => RobotMode::Fault,
            None => RobotMode::Idle,
            Some(command) if command.is_valid_at(now_ns) => RobotMode::Moving,
            Some(_) => RobotMode::Stale,
        };
        state.mode = mode.code();
        state.twist = match (self.fault, self.command) {
            (Some(Fault::RobotBlocked), Some(command)) => command.in_force(now_ns),
            (Some(Fault::RobotStrays), _) => {
                let mut twist = self.twist;
                twist[1] += BESIDE;
                twist
            }
            _ => self.twist,
        };
        Some(state)
    }
}
