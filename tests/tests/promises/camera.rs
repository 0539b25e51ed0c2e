//! A camera in the test's own process: sees a scene exactly, executes what comes back, and begins
//! again elsewhere when it has arrived.

use std::path::Path;

use hw_sim::{FreeCamera, Referee};
use ipc::{CameraPorts, Domain, RobotPorts, Sent, now_ns};
use messages::{Features, RobotState, Stamp, TwistCommand};
use scene::{Pose, Scene};

/// Frames after which it begins elsewhere, wherever it is.
const MOST_FRAMES: u32 = 200;
/// Image error that counts as arrived, px.
const ARRIVED_PX: f64 = 3.0;
/// Where it is nudged: how near to the goal, px, and by how much, m and rad: 27 px and 8.
const NUDGED_PX: f64 = 15.0;
const NUDGE: [f64; 6] = [0.02, 0.0, 0.0, 0.0, 0.0, 0.03];

/// The camera.
pub struct Camera<'a> {
    /// Its ports.
    pub ports: CameraPorts,
    robot: RobotPorts,
    scene: &'a Scene,
    starts: &'a [Pose],
    next: usize,
    camera: FreeCamera,
    referee: Referee,
    frames: u32,
    /// What it carries out.
    twist: [f64; 6],
    /// Whether the next frame is the first after a jump: it shows no point, as between two objects.
    is_blind: bool,
    /// Whether it is nudged instead of beginning elsewhere, which would disarm in real time.
    is_nudged: bool,
    /// In lockstep: its number and time of the last frame.
    lockstep: Option<(u64, u64)>,
    // The last to be dropped.
    _domain: Domain,
}

impl<'a> Camera<'a> {
    /// A camera in this domain, at the first of these starts.
    pub fn new(scene: &'a Scene, starts: &'a [Pose], domain: &Path) -> Self {
        let domain = Domain::join(domain).unwrap();
        Self {
            ports: CameraPorts::open(&domain).unwrap(),
            robot: RobotPorts::open(&domain).unwrap(),
            scene,
            starts,
            next: 1,
            camera: FreeCamera::new(scene, &starts[0]),
            referee: Referee::new(scene),
            frames: 0,
            twist: [0.0; 6],
            is_blind: false,
            is_nudged: false,
            lockstep: None,
            _domain: domain,
        }
    }

    /// The same, nudged at the goal.
    pub fn nudged(self) -> Self {
        Self {
            is_nudged: true,
            ..self
        }
    }

    /// The same, for a daemon in lockstep: its frames are the clock.
    pub fn in_lockstep(self) -> Self {
        Self {
            lockstep: Some((0, now_ns())),
            ..self
        }
    }

    /// Publishes what it carries out and sees.
    pub fn show(&mut self) -> Sent {
        let mut state = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], now_ns());
        state.twist = self.twist;
        self.robot.robot.publish(&state).unwrap();
        if let Ok(points) = self.camera.features()
            && self.is_nudged
        {
            self.frames = 0;
            if self.referee.error(&points) < NUDGED_PX {
                self.next += 1;
                let sign = if self.next.is_multiple_of(2) {
                    1.0
                } else {
                    -1.0
                };
                self.camera.advance(&NUDGE, sign);
            }
        }
        loop {
            let exposure = now_ns();
            if self.frames < MOST_FRAMES
                && let Ok(points) = self.camera.features()
                && (self.frames == 0 || self.referee.error(&points) > ARRIVED_PX)
            {
                self.frames += 1;
                let mut features = Features::new(&points, exposure);
                // No image is the last one to the last bit, also while this one waits for a
                // command.
                features.points[0] += 1e-12 * (exposure % 1_000_000_000) as f64;
                if std::mem::take(&mut self.is_blind) {
                    features.visible = 0;
                }
                return self.publish(features);
            }
            let start = self.starts[self.next % self.starts.len()];
            (self.camera, self.frames) = (FreeCamera::new(self.scene, &start), 0);
            self.is_blind = true;
            self.next += 1;
        }
    }

    fn publish(&mut self, mut features: Features) -> Sent {
        let Some((sequence, now_ns)) = &mut self.lockstep else {
            return self.ports.features.publish(&features).unwrap();
        };
        *sequence += 1;
        *now_ns += (self.scene.sampling_time() * 1e9) as u64;
        features.stamp = Stamp {
            sequence: *sequence,
            published_ns: *now_ns,
            data_ns: *now_ns,
        };
        self.ports.features.publish_verbatim(&features).unwrap()
    }

    /// Moves for one period as commanded.
    pub fn obey(&mut self, command: &TwistCommand) {
        self.twist = command.twist;
        self.camera
            .advance(&command.twist, self.scene.sampling_time());
    }

    /// The newest command since the last call.
    pub fn newest(&mut self) -> Option<TwistCommand> {
        self.ports
            .twist
            .latest()
            .unwrap()
            .map(|received| received.message)
    }
}
