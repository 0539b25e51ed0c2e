//! The paper's hand-held camera: it moves exactly as told, at once. A command takes effect when it
//! was sent.

use messages::RobotState;
use scene::{Pose, Scene};

use crate::camera::{FreeCamera, Points, outlines, project};
use crate::cell::{self, Cell, Exposed, Observation, Order};
use crate::eye::{EyeError, Shot};
use crate::motion::Motion;
use crate::pose::RigidPose;
use crate::progress::Progress;
use crate::referee::{End, INSTANTS};
use crate::sensor::{Flaws, Sensor};
use crate::standing::Standing;

/// A camera that is free to move.
#[derive(Clone, Debug)]
pub struct FreeCell {
    scene: Scene,
    /// Sees the object where that would be at rest.
    camera: FreeCamera,
    motion: Motion,
    sensor: Sensor,
    delay_frames: u64,
    time_limit_s: f64,
    progress: Progress,
    standing: Standing,
    epoch_ns: u64,
    /// The instant of the camera's pose.
    now_ns: u64,
}

impl FreeCell {
    /// A camera that sees the object at `start`. Without a limit of time its run never ends.
    pub fn new(scene: &Scene, start: &Pose, flaws: Flaws, time_limit_s: f64) -> Self {
        Self {
            scene: scene.clone(),
            camera: FreeCamera::new(scene, start),
            motion: Motion::default(),
            sensor: Sensor::new(scene, flaws),
            delay_frames: flaws.delay_frames as u64,
            time_limit_s,
            progress: Progress::new(scene),
            standing: Standing::default(),
            epoch_ns: 0,
            now_ns: 0,
        }
    }

    /// The object moves, and the run goes on after the arrival, to measure for `follow_s` seconds how
    /// well the camera follows.
    pub fn follow(mut self, motion: Motion, follow_s: f64) -> Self {
        self.motion = motion;
        self.progress.follow_for(&self.scene, follow_s);
        self
    }

    /// The object in the camera frame, where it is now.
    fn object(&self) -> RigidPose {
        let time_s = self.progress.since_s(self.now_ns);
        self.motion.moved(&self.camera.pose, time_s)
    }

    /// Moves the camera to an instant by the command, for as long as that holds, before the eyes of
    /// the referee.
    fn carry(&mut self, to_ns: u64) {
        self.pass(to_ns.min(self.standing.until_ns()), &self.standing.twist());
        if !self.motion.is_rest() {
            // The camera stands, the object does not.
            self.pass(to_ns, &[0.0; 6]);
        }
        self.now_ns = to_ns.max(self.now_ns);
    }

    /// Moves the camera with a constant twist to an instant.
    fn pass(&mut self, to_ns: u64, twist: &[f64; 6]) {
        let from_ns = self.now_ns;
        let seconds = to_ns.saturating_sub(from_ns) as f64 * 1e-9;
        let instants = seconds * self.scene.camera.rate_hz * f64::from(INSTANTS);
        let instants = instants.ceil().min(1e4);
        for instant in 1..=instants as u32 {
            self.camera.advance(twist, seconds / instants);
            let elapsed_s = seconds * f64::from(instant) / instants;
            self.now_ns = from_ns + (1e9 * elapsed_s).round() as u64;
            let object = self.object();
            if self.time_limit_s.is_finite()
                && let Ok(points) = project(&self.scene, &object)
            {
                let outlines = outlines(&self.scene, &object);
                self.progress.judge_between(&points, outlines);
            }
        }
    }

    fn judge(&mut self, points: &Points, object: &RigidPose) {
        let end = match self.progress.judge(points, outlines(&self.scene, object)) {
            Some(End::Arrived) | None => self.progress.has_followed().then_some(End::Arrived),
            end => end,
        };
        let is_late = self.progress.arrived_s.is_none();
        let is_late = is_late && self.progress.time_s >= self.time_limit_s;
        if let Some(end) = end.or(is_late.then_some(End::TimeOut))
            && self.time_limit_s.is_finite()
        {
            self.progress.finish(end);
        }
    }
}

impl Cell for FreeCell {
    fn begin(&mut self, epoch_ns: u64) {
        (self.epoch_ns, self.now_ns) = (epoch_ns, epoch_ns);
    }

    fn due_ns(&self) -> u64 {
        let elapsed_s = self.progress.frames as f64 * self.scene.sampling_time();
        self.epoch_ns + (1e9 * elapsed_s).round() as u64
    }

    fn obey(&mut self, order: &Order) {
        if order.is_armed {
            self.progress.begin(self.now_ns);
        }
        self.carry(order.sent_ns);
        self.standing = Standing::new(&order.twist, order.until_ns, &self.scene.limits.velocity());
        self.progress.limited += u64::from(self.standing.was_limited());
    }

    fn look(&mut self, now_ns: u64) -> Result<Observation, EyeError> {
        self.carry(now_ns);
        // A command that would end before the next frame ends now: the state that goes out with
        // this frame must not tell of a motion that is over before the next.
        let period_ns = (1e9 * self.scene.sampling_time()) as u64;
        if self.standing.until_ns() < now_ns + period_ns {
            self.standing.end(now_ns);
        }
        self.progress.tick(now_ns);
        let object = self.object();
        let Ok(points) = project(&self.scene, &object) else {
            self.progress.finish(End::LostSight);
            return Ok(Observation::default());
        };
        self.judge(&points, &object);
        self.progress.follow(&points, &object, &self.aimed());
        if self.progress.end.is_some() {
            return Ok(Observation::default());
        }
        self.progress.frames += 1;
        let frame = self.sensor.expose(&points, now_ns);
        let shot = frame.map(|frame| Shot {
            // Frames are numbered as they are exposed: a lost one shows as a gap.
            number: self.progress.frames - self.delay_frames,
            stamp_ns: frame.exposure_ns,
            visible: frame.visible,
            points: frame.points,
            image: None,
        });
        let time_s = self.progress.since_s(self.now_ns);
        let exposed = Some(Exposed {
            points,
            object,
            object_twist: self.motion.twist(&self.camera.pose, time_s),
        });
        Ok(Observation { exposed, shot })
    }

    fn advance(&mut self) {}

    fn progress(&mut self) -> &mut Progress {
        &mut self.progress
    }

    fn aimed(&self) -> [f64; 6] {
        self.standing.twist_at(self.now_ns)
    }

    fn is_stale(&self) -> bool {
        self.standing.is_stale(self.now_ns)
    }

    fn state(&self) -> RobotState {
        let (stale, limited) = (self.is_stale(), self.standing.was_limited());
        let pose = &self.camera.pose;
        let mut state = cell::state(&self.progress, pose, self.now_ns, stale, limited);
        state.twist = self.aimed();
        state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::from_scene;

    #[test]
    fn a_command_carries_the_camera_while_it_is_valid() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let mut cell = FreeCell::new(&scene, &scene.goal, Flaws::default(), 15.0);
        cell.begin(1_000_000_000);
        cell.obey(&Order {
            twist: [0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
            elbow: 0.0,
            sent_ns: 1_010_000_000,
            until_ns: 1_100_000_000,
            is_armed: true,
        });
        let mut moved = |to_ns: u64| {
            let before = cell.camera.pose.translation.x;
            cell.look(to_ns).unwrap();
            before - cell.camera.pose.translation.x
        };
        assert!((moved(1_030_000_000) - 0.002).abs() < 1e-12);
        // 70 ms are left of the 100.
        assert!((moved(1_200_000_000) - 0.007).abs() < 1e-12);
        assert_eq!(moved(1_300_000_000), 0.0);
        assert!(cell.is_stale() && cell.aimed() == [0.0; 6]);
    }

    /// A cell in which the object moves, and its frames: a controller that is armed keeps the camera
    /// still, or moves it as the object.
    fn before_a_moving_object(motion: &str, follows: bool) -> (FreeCell, Vec<Exposed>) {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let motion = Motion::new(&[motion.parse().unwrap()]);
        let cell = FreeCell::new(&scene, &scene.goal, Flaws::default(), 15.0);
        let mut cell = cell.follow(motion, 2.0);
        let (mut exposed, mut twist) = (Vec::new(), [0.0; 6]);
        cell.begin(1_000_000_000);
        while cell.progress.end.is_none() {
            let now_ns = cell.due_ns();
            cell.obey(&Order {
                twist,
                elbow: 0.0,
                sent_ns: now_ns,
                until_ns: now_ns + 100_000_000,
                is_armed: true,
            });
            if let Some(frame) = cell.look(now_ns).unwrap().exposed {
                twist = if follows { frame.object_twist } else { twist };
                exposed.push(frame);
            }
        }
        (cell, exposed)
    }

    #[test]
    fn an_object_that_moves_leaves_a_camera_that_stands() {
        let (cell, exposed) = before_a_moving_object("conveyor:0.1", false);
        let scene = &cell.scene;
        // After a second.
        let away = exposed[30].object.translation.x - scene.goal.translation[0];
        assert!((away - 0.1).abs() < 1e-6, "{away}");
        assert_eq!(
            exposed[30].points,
            project(scene, &exposed[30].object).unwrap()
        );
        assert!((exposed[30].object_twist[0] - 0.1).abs() < 1e-12);
        // It leaves the image on the right, which is seen between two frames, too.
        assert!(matches!(cell.progress.end, Some(End::Violation(_))));
        let referee = &cell.progress.referee;
        assert!(referee.least_between() < 0.0 && referee.least_clearance() < 0.0);
        // The state tells of the camera alone.
        let rest = scene.goal.translation;
        let told = cell.state().translation;
        assert!((0..3).all(|k| (told[k] - rest[k]).abs() < 1e-12));
    }

    #[test]
    fn a_camera_that_follows_is_measured_and_arrives() {
        let (cell, exposed) = before_a_moving_object("circle:0.05:0.1", true);
        assert_eq!(cell.progress.end, Some(End::Arrived));
        assert!((cell.progress.time_s - 3.0).abs() < 0.04);
        let report = cell.progress.following().unwrap();
        // It is a frame late: 3 mm at 10 cm/s.
        assert!(report.rms_mm < 8.0 && report.worst_px > 0.5, "{report:?}");
        assert!(exposed.len() >= 90);
        let (_, stands) = before_a_moving_object("push:60:0.1", false);
        assert_eq!(stands[80].object, from_scene(&cell.scene.goal));
    }

    #[test]
    fn frames_are_due_at_whole_periods() {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let flaws = Flaws {
            delay_frames: 2,
            ..Flaws::default()
        };
        let mut cell = FreeCell::new(&scene, &scene.goal, flaws, f64::INFINITY);
        let mut numbers = Vec::new();
        for _ in 0..4 {
            let now_ns = cell.due_ns();
            let shot = cell.look(now_ns).unwrap().shot;
            numbers.push(shot.map(|shot| (shot.number, shot.stamp_ns)));
        }
        assert_eq!(numbers, [None, None, Some((1, 0)), Some((2, 33_333_333))]);
    }
}
