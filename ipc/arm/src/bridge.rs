//! The core of every bridge: from the newest twist of the camera to the command of this
//! millisecond. Nothing here waits, allocates or panics.
//!
//! What is beyond a limit slows the camera down along its way, by one share for all axes: it never
//! turns the camera elsewhere.

use nalgebra::Vector3;

use crate::elbow::FASTEST;
use crate::kinematics::{Pose, Twist, split};
use crate::mount::Mount;
use crate::shaper::{Echo, Shaper, ShaperError, ShaperSettings};

/// Part of a command by which rounding may shorten it.
const ROUNDING: f64 = 1e-9;

/// The newest state of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// O_T_EE, the end effector in the base.
    pub base_from_ee: Pose,
    /// F_T_EE, the end effector in the flange.
    pub flange_from_ee: Pose,
    /// The last command that the robot executed: O_dP_EE_c, O_ddP_EE_c.
    pub echo: Echo,
}

/// How much of a motion the robot has room for, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Room {
    /// By the walls of its workspace.
    pub workspace: f64,
    /// By its joints and singularities.
    pub joints: f64,
    /// For the shaper's ramps, by the joints' accelerations.
    pub ramps: f64,
}

impl Room {
    /// For all of it.
    pub const FULL: Self = Self {
        workspace: 1.0,
        joints: 1.0,
        ramps: 1.0,
    };
}

/// A robot with a velocity interface: implement it for yours.
pub trait Driver {
    /// The state that the next command answers.
    fn measured(&self) -> Measured;

    /// How much of this velocity of the end effector's origin (base axes) there is room for.
    fn room(&self, _twist: &Twist) -> Room {
        Room::FULL
    }

    /// Joint 3 of seven, the elbow, is to turn at this velocity, rad/s, with the next command; it is
    /// held where a driver leaves this out.
    fn turn_elbow(&mut self, _elbow: f64) {}

    /// Commands this velocity for one millisecond.
    fn command(&mut self, twist: &Twist);

    /// The velocity that is carried out.
    fn carried_out(&self) -> Twist {
        self.measured().echo.twist
    }
}

/// The greatest speeds of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Caps {
    /// Of its origin, m/s.
    pub linear: f64,
    /// Of its turn, rad/s.
    pub angular: f64,
    /// Of each component, m/s and rad/s.
    pub axes: [f64; 6],
}

impl Caps {
    /// None.
    pub const NONE: Self = Self::axes([f64::INFINITY; 6]);

    /// Caps on the components alone.
    pub const fn axes(axes: [f64; 6]) -> Self {
        Self {
            linear: f64::INFINITY,
            angular: f64::INFINITY,
            axes,
        }
    }

    /// The part of a twist that they allow, 0 to 1.
    fn share(&self, twist: &Twist) -> f64 {
        let (linear, angular) = split(twist);
        let part = |size: f64, most: f64| if size > most { most / size } else { 1.0 };
        let length = |part: Vector3<f64>| part.norm();
        let lengths = part(length(linear), self.linear).min(part(length(angular), self.angular));
        let axes = twist.iter().zip(self.axes);
        axes.fold(lengths, |share, (v, most)| share.min(part(v.abs(), most)))
    }
}

/// What limits the motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limited {
    /// The command was longer than the caps allow, or not finite.
    pub is_cut: bool,
    /// A wall of the workspace is near.
    pub by_workspace: bool,
    /// A joint is near the margin of its range, or would be too fast, or a singularity is near.
    pub by_joint: bool,
    /// No command is in force: the robot is to stand.
    pub is_stale: bool,
}

/// Carries out the newest command of the camera.
#[derive(Clone, Debug)]
pub struct Bridge<D> {
    /// The robot.
    pub driver: D,
    mount: Mount,
    shaper: Shaper,
    /// The newest command, cut: camera axes, m/s and rad/s.
    command: Twist,
    /// The velocity of the elbow with it, rad/s.
    elbow: f64,
    /// When it ends, ns.
    until_ns: u64,
    limited: Limited,
}

impl<D: Driver> Bridge<D> {
    /// A bridge to a robot that carries the camera so; it commands standing still until its first
    /// command.
    ///
    /// # Errors
    /// A bound of the shaper that is not a positive number.
    pub fn new(driver: D, mount: Mount, shaper: ShaperSettings) -> Result<Self, ShaperError> {
        Ok(Self {
            driver,
            mount,
            shaper: Shaper::new(shaper)?,
            command: Twist::zeros(),
            elbow: 0.0,
            until_ns: 0,
            limited: Limited::default(),
        })
    }

    /// Takes a command: the camera's velocity along camera axes, m/s and rad/s, until an instant.
    /// It is shortened to the caps, its direction kept; zero where it is not finite.
    pub fn obey(&mut self, twist: &[f64; 6], until_ns: u64, caps: &Caps) {
        let twist = Twist::from(*twist);
        let share = match twist.iter().all(|v| v.is_finite()) {
            true => caps.share(&twist),
            false => 0.0,
        };
        self.command = if share > 0.0 {
            twist * share
        } else {
            Twist::zeros()
        };
        self.until_ns = until_ns;
        self.elbow = 0.0;
        self.limited.is_cut = share < 1.0 - ROUNDING;
    }

    /// Takes the velocity of joint 3 of seven, the elbow, that goes with the last command, rad/s:
    /// at most [`FASTEST`]; zero where it is not finite.
    pub fn turn_elbow(&mut self, elbow: f64) {
        let is_finite = elbow.is_finite();
        self.elbow = if is_finite {
            elbow.clamp(-FASTEST, FASTEST)
        } else {
            0.0
        };
    }

    /// One of the robot's milliseconds: answers its state.
    pub fn step(&mut self, now_ns: u64) {
        let measured = self.driver.measured();
        let camera = Twist::from(self.aimed(now_ns));
        // The base axes turn under the camera: transported anew in each millisecond.
        let rotation = &measured.base_from_ee.rotation;
        let wanted = self
            .mount
            .to_base(rotation, &measured.flange_from_ee, &camera);
        let room = self.driver.room(&wanted);
        self.limited = Limited {
            by_workspace: room.workspace < 1.0,
            by_joint: room.joints < 1.0 || room.ramps < 1.0,
            is_stale: self.is_stale(now_ns),
            ..self.limited
        };
        let share = room.workspace.min(room.joints);
        self.shaper.aim(&(wanted * share), self.until_ns);
        let twist = self.shaper.step_with(&measured.echo, room.ramps, now_ns);
        let elbow = if self.is_stale(now_ns) {
            0.0
        } else {
            self.elbow
        };
        self.driver.turn_elbow(elbow);
        self.driver.command(&twist);
    }

    /// The camera's velocity that is commanded now, camera axes: zero once the command has ended.
    pub fn aimed(&self, now_ns: u64) -> [f64; 6] {
        match self.is_stale(now_ns) {
            true => [0.0; 6],
            false => self.command.into(),
        }
    }

    /// The camera's velocity that is carried out, camera axes.
    pub fn carried_out(&self) -> [f64; 6] {
        let measured = self.driver.measured();
        let rotation = &measured.base_from_ee.rotation;
        let twist = self.driver.carried_out();
        self.mount
            .to_camera(rotation, &measured.flange_from_ee, &twist)
            .into()
    }

    /// Whether no command is in force.
    pub fn is_stale(&self, now_ns: u64) -> bool {
        now_ns >= self.until_ns
    }

    /// What limited the last step.
    pub fn limited(&self) -> Limited {
        self.limited
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::PERIOD;

    const MS: u64 = 1_000_000;

    /// A robot that does as it is told, with room for part of it.
    struct Ideal(Measured, f64);

    impl Driver for Ideal {
        fn measured(&self) -> Measured {
            self.0
        }

        fn room(&self, _: &Twist) -> Room {
            Room {
                joints: self.1,
                ..Room::FULL
            }
        }

        fn command(&mut self, twist: &Twist) {
            let acceleration = (twist - self.0.echo.twist) / PERIOD;
            self.0.echo = Echo {
                twist: *twist,
                acceleration,
            };
        }
    }

    fn bridge(room: f64) -> Bridge<Ideal> {
        let echo = Echo {
            twist: Twist::zeros(),
            acceleration: Twist::zeros(),
        };
        let at = Measured {
            base_from_ee: Pose::rotation(Vector3::new(3.0, 0.1, -0.2)),
            flange_from_ee: Pose::translation(0.0, 0.0, 0.1),
            echo,
        };
        let mount = Mount {
            flange_from_camera: Pose::translation(0.05, 0.02, 0.0),
        };
        Bridge::new(Ideal(at, room), mount, ShaperSettings::default()).unwrap()
    }

    fn run(bridge: &mut Bridge<Ideal>, from: u64, to: u64) -> Twist {
        (from..to).for_each(|ms| bridge.step(ms * MS));
        bridge.carried_out().into()
    }

    const TWIST: [f64; 6] = [0.04, -0.02, 0.01, 0.1, 0.0, -0.2];

    #[test]
    fn caps_and_room_shorten_the_command_and_keep_its_direction() {
        let caps = Caps {
            linear: 0.03,
            ..Caps::axes([1.0; 6])
        };
        let length = Vector3::new(0.04, -0.02, 0.01).norm();
        for (caps, room, share) in [
            (Caps::NONE, 1.0, 1.0),
            (Caps::NONE, 0.3, 0.3),
            (caps, 1.0, 0.03 / length),
            (Caps::axes([0.01, 1.0, 1.0, 1.0, 1.0, 1.0]), 1.0, 0.25),
            (caps, 0.5, 0.5 * 0.03 / length),
        ] {
            let mut bridge = bridge(room);
            bridge.obey(&TWIST, u64::MAX, &caps);
            let seen = run(&mut bridge, 0, 500);
            assert!((seen - Twist::from(TWIST) * share).norm() < 1e-9, "{share}");
            assert_eq!(bridge.limited().is_cut, caps != Caps::NONE);
            assert_eq!(bridge.limited().by_joint, room < 1.0);
        }
    }

    #[test]
    fn a_command_ends_at_its_instant_and_the_robot_comes_to_rest() {
        let mut bridge = bridge(1.0);
        assert_eq!(run(&mut bridge, 0, 100), Twist::zeros());
        bridge.obey(&TWIST, 300 * MS, &Caps::NONE);
        assert!(run(&mut bridge, 100, 300).norm() > 0.2);
        assert!(!bridge.limited().is_stale);
        assert!(run(&mut bridge, 300, 550).norm() < 1e-12);
        assert!(bridge.limited().is_stale && bridge.aimed(301 * MS) == [0.0; 6]);
    }

    #[test]
    fn what_is_not_finite_stands_still() {
        let mut bridge = bridge(1.0);
        bridge.obey(&[0.1, f64::NAN, 0.0, 0.0, 0.0, 0.0], u64::MAX, &Caps::NONE);
        assert_eq!(run(&mut bridge, 0, 100), Twist::zeros());
        assert!(bridge.limited().is_cut);
    }
}
