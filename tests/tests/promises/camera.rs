//! A camera in the test's own process: sees a scene exactly, executes what comes back, and begins
//! again elsewhere when it has arrived.

use std::path::Path;

use hw_sim::{FreeCamera, Referee};
use ipc::{CameraPorts, Domain, Features, RobotPorts, RobotState, Sent, TwistCommand, now_ns};
use scene::{Pose, Scene};

/// Frames after which it begins elsewhere, wherever it is.
const MOST_FRAMES: u32 = 200;
/// Image error that counts as arrived, px.
const ARRIVED_PX: f64 = 3.0;

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
            _domain: domain,
        }
    }

    /// Publishes what it carries out and sees.
    pub fn show(&mut self) -> Sent {
        let mut state = RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], now_ns());
        state.twist = self.twist;
        self.robot.robot.publish(&state).unwrap();
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
                features.points[0] += 1e-9 * f64::from(self.frames);
                if std::mem::take(&mut self.is_blind) {
                    features.visible = 0;
                }
                return self.ports.features.publish(&features).unwrap();
            }
            let start = self.starts[self.next % self.starts.len()];
            (self.camera, self.frames) = (FreeCamera::new(self.scene, &start), 0);
            self.is_blind = true;
            self.next += 1;
        }
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
