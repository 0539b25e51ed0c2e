//! The robot: it carries the camera as the dead man lets it, or otherwise, and says what it does,
//! or something else.

use std::collections::VecDeque;

use messages::{RobotMode, RobotState, TwistCommand};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::fault::Fault;
use crate::joints::Joints;
use crate::world::TICK_NS;

/// How much more along y than it is told a robot says that it moves that strays, m/s: twice the
/// limit.
const BESIDE: f64 = 1.0;

/// How the motion differs from what the robot is told.
#[derive(Clone, Copy, Debug)]
struct Lie {
    gain: f64,
    /// How late it is, ns.
    lag_ns: u64,
    /// A motion beside, m/s and rad/s.
    bias: [f64; 6],
    /// Components below this share of ... do not move it, m/s and rad/s.
    dead: f64,
    /// Whether it takes x for y.
    is_crossed: bool,
    /// Whether it says what it was told, and not what it does.
    is_told: bool,
}

const TRUTH: Lie = Lie {
    gain: 1.0,
    lag_ns: 0,
    bias: [0.0; 6],
    dead: 0.0,
    is_crossed: false,
    is_told: false,
};

/// The robot and its client.
pub struct Robot {
    /// The newest command.
    command: Option<TwistCommand>,
    /// What it was told, the newest first.
    told: VecDeque<[f64; 6]>,
    /// What it carries out until its next tick.
    twist: [f64; 6],
    fault: Option<Fault>,
    lie: Lie,
    /// The joints of the arm, where the scene has one.
    pub joints: Option<Joints>,
    sequence: u64,
}

impl Robot {
    /// One that stands.
    pub fn new(joints: Option<Joints>) -> Self {
        Self {
            command: None,
            told: VecDeque::new(),
            twist: [0.0; 6],
            fault: None,
            lie: TRUTH,
            joints,
            sequence: 0,
        }
    }

    /// A command came.
    pub fn obey(&mut self, command: &TwistCommand) {
        self.command = Some(*command);
    }

    /// From now on it fails so.
    pub fn fail(&mut self, fault: Fault, random: &mut ChaCha8Rng) {
        self.fault = Some(fault);
        self.lie = lie(fault, random);
        if let Some(joints) = &mut self.joints {
            joints.fail(fault);
        }
    }

    /// From now on it works.
    pub fn recover(&mut self) {
        (self.fault, self.lie) = (None, TRUTH);
        if let Some(joints) = &mut self.joints {
            joints.recover();
        }
    }

    /// What it carries out.
    pub fn twist(&self) -> [f64; 6] {
        self.twist
    }

    /// What the dead man lets it carry out.
    pub fn told(&self) -> [f64; 6] {
        self.told.front().copied().unwrap_or_default()
    }

    /// Its tick at `now_ns`: what it carries out from now on, by the dead man of the contract.
    pub fn tick(&mut self, now_ns: u64) {
        let command = self.command.unwrap_or_default();
        self.told.push_front(command.in_force(now_ns));
        let late = (self.lie.lag_ns / TICK_NS) as usize;
        self.told.truncate(late.max(256));
        let told = self.told.get(late).copied().unwrap_or_default();
        self.twist = match self.fault {
            Some(Fault::RobotDead | Fault::RobotReflex | Fault::RobotBlocked) => [0.0; 6],
            _ => self.lie.of(&told),
        };
        if let Some(joints) = &mut self.joints {
            let elbow = command.elbow_in_force(now_ns);
            joints.tick(&self.twist, elbow);
        }
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
        let told = self.told();
        state.twist = match self.fault {
            Some(Fault::RobotBlocked) => told,
            Some(Fault::RobotStrays) => {
                let mut twist = self.twist;
                twist[1] += BESIDE;
                twist
            }
            _ if self.lie.is_told => told,
            _ => self.twist,
        };
        if let Some(joints) = &mut self.joints {
            joints.tell(&mut state, now_ns);
        }
        Some(state)
    }
}

impl Lie {
    /// What it does of what it is told.
    fn of(&self, told: &[f64; 6]) -> [f64; 6] {
        let mut twist = *told;
        if twist == [0.0; 6] {
            return twist;
        }
        if self.is_crossed {
            twist.swap(0, 1);
        }
        std::array::from_fn(|k| match twist[k].abs() < self.dead {
            true => 0.0,
            false => self.gain * twist[k] + self.bias[k],
        })
    }
}

/// How a robot lies with this fault.
fn lie(fault: Fault, random: &mut ChaCha8Rng) -> Lie {
    let is_told = random.random_bool(0.5);
    let each = |most: f64, random: &mut ChaCha8Rng| {
        std::array::from_fn(|_| random.random_range(-most..most))
    };
    match fault {
        Fault::RobotFast => Lie {
            gain: random.random_range(2.5..4.0),
            is_told: true,
            ..TRUTH
        },
        Fault::RobotLate => Lie {
            lag_ns: random.random_range(350_000_000..500_000_000),
            is_told,
            ..TRUTH
        },
        Fault::RobotLags => Lie {
            lag_ns: random.random_range(20_000_000..100_000_000),
            is_told,
            ..TRUTH
        },
        Fault::RobotGain => Lie {
            gain: random.random_range(0.7..1.3),
            is_told,
            ..TRUTH
        },
        Fault::RobotBias => Lie {
            bias: each(0.03, random),
            is_told,
            ..TRUTH
        },
        Fault::RobotDeadZone => Lie {
            dead: random.random_range(0.005..0.03),
            is_told,
            ..TRUTH
        },
        Fault::RobotCrossed => Lie {
            is_crossed: true,
            is_told,
            ..TRUTH
        },
        _ => TRUTH,
    }
}
