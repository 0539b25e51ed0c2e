//! Motion of the pattern: conveyor, circle, hand, push, and their sum.
//!
//! A [`Motion`] depends on time alone. It gives the displacement M(t) of the pattern from its place
//! at rest, in the pattern's own frame there: x and y along the pattern, z along its normal. The
//! object in the camera frame is (object at rest in the camera frame) M(t). Time counts from the
//! begin of the run; before it the pattern rests. Conveyor and circle without a start are at full
//! speed from there on. Translations and rotation vectors of several motions add up.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::str::FromStr;

use nalgebra::{Rotation3, Translation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::pose::RigidPose;

/// Ramp of conveyor and circle where none is given, s.
const RAMP_S: f64 = 0.2;
/// Time in which a hand begins to move, s.
const HAND_BEGIN_S: f64 = 1.0;
/// Lowest frequency of a hand, as a share of its bandwidth: below it positions would grow large.
const HAND_LOWEST: f64 = 0.1;
/// A hand turns as fast as a point moves that is this far from the axis, m.
const HAND_LEVER_M: f64 = 0.5;
/// Waves along or about each axis of a hand.
const WAVES: usize = 12;

/// What kind of motion: a constant velocity and turn rate; a circle in the pattern's plane that does
/// not turn the pattern; noise of limited bandwidth, along and about all axes; a displacement that
/// begins and ends smoothly.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[schemars(description = "")]
#[allow(missing_docs)]
pub enum Kind {
    #[default]
    Conveyor,
    Circle,
    Hand,
    Push,
}

impl Kind {
    /// As in the file.
    const fn name(self) -> &'static str {
        match self {
            Self::Conveyor => "conveyor",
            Self::Circle => "circle",
            Self::Hand => "hand",
            Self::Push => "push",
        }
    }

    /// The keys that go with it.
    const fn keys(self) -> &'static [&'static str] {
        match self {
            Self::Conveyor => &["velocity_m_s", "turn_rad_s", "from_s", "until_s", "ramp_s"],
            Self::Circle => &["radius_m", "speed_m_s", "from_s", "ramp_s"],
            Self::Hand => &["speed_m_s", "bandwidth_hz", "seed", "from_s"],
            Self::Push => &["by_m", "from_s", "over_s"],
        }
    }
}

/// A motion of the pattern along and about its axes at rest; several add up.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(extend("required" = ["kind"]))]
pub struct MotionKeys {
    /// Kind.
    pub kind: Kind,
    /// Conveyor: velocity.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(inner(range(min = -1, max = 1)), extend("x-unit" = "m/s", "x-default" = "zero"))]
    pub velocity_m_s: Option<[f64; 3]>,
    /// Conveyor: turn rate about the normal.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -3, max = 3), extend("x-unit" = "rad/s", "x-default" = "zero"))]
    pub turn_rad_s: Option<f64>,
    /// Start.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 86400), extend("x-unit" = "s", "x-default" = "zero"))]
    pub from_s: Option<f64>,
    /// Conveyor: stop.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 86400), extend("x-unit" = "s", "x-default" = "never"))]
    pub until_s: Option<f64>,
    /// Conveyor, circle: time to full speed, and to rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 60), extend("x-unit" = "s", "x-default" = "0.2; 0 without a start"))]
    pub ramp_s: Option<f64>,
    /// Circle: radius.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.001, max = 1), extend("x-unit" = "m", "x-default" = "0.05"))]
    pub radius_m: Option<f64>,
    /// Circle: speed; hand: its RMS.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1), extend("x-unit" = "m/s", "x-default" = "0.05"))]
    pub speed_m_s: Option<f64>,
    /// Hand: highest frequency.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.01, max = 10), extend("x-unit" = "Hz", "x-default" = "1"))]
    pub bandwidth_hz: Option<f64>,
    /// Hand: seed.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-default" = "1"))]
    pub seed: Option<u32>,
    /// Push: displacement.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(inner(range(min = -1, max = 1)), extend("x-unit" = "m", "x-default" = "zero"))]
    pub by_m: Option<[f64; 3]>,
    /// Push: duration.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.01, max = 60), extend("x-unit" = "s", "x-default" = "0.5"))]
    pub over_s: Option<f64>,
}

impl MotionKeys {
    /// The first key that does not go with the kind: its name, its value, and what is allowed.
    pub fn stray(&self) -> Option<(String, String, String)> {
        let keys = serde_json::to_value(self).unwrap_or_default();
        let mut keys = keys.as_object().into_iter().flatten();
        let (key, value) =
            keys.find(|(key, _)| *key != "kind" && !self.kind.keys().contains(&key.as_str()))?;
        let allowed = format!(
            "with kind = \"{}\": {}",
            self.kind.name(),
            self.kind.keys().join(", ")
        );
        Some((key.clone(), value.to_string(), allowed))
    }
}

/// Such as `circle: radius_m = 0.05, speed_m_s = 0.1`.
impl fmt::Display for MotionKeys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let keys = serde_json::to_value(self).unwrap_or_default();
        let keys = keys.as_object().into_iter().flatten();
        let keys = keys.filter(|(key, _)| *key != "kind");
        let keys: Vec<String> = keys
            .map(|(key, value)| format!("{key} = {value}"))
            .collect();
        write!(f, "{}: {}", self.kind.name(), keys.join(", "))
    }
}

/// A motion as a flag: kind and numbers between colons.
const FORMS: &str = "conveyor:M_S (x, or x:y:z), turn:RAD_S, circle:M:M_S, hand:M_S:HZ (or hand:M_S:HZ:SEED), push:S:M";

impl FromStr for MotionKeys {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refused = || format!("allowed: {FORMS}");
        let (kind, rest) = text.split_once(':').ok_or_else(refused)?;
        let numbers: Result<Vec<f64>, _> = rest.split(':').map(str::parse).collect();
        let numbers = numbers.map_err(|_| refused())?;
        let of = |kind| Self {
            kind,
            ..Self::default()
        };
        let keys = match (kind, numbers.as_slice()) {
            ("conveyor", &[x]) => Self {
                velocity_m_s: Some([x, 0.0, 0.0]),
                ..of(Kind::Conveyor)
            },
            ("conveyor", &[x, y, z]) => Self {
                velocity_m_s: Some([x, y, z]),
                ..of(Kind::Conveyor)
            },
            ("turn", &[rate]) => Self {
                turn_rad_s: Some(rate),
                ..of(Kind::Conveyor)
            },
            ("circle", &[radius, speed]) => Self {
                radius_m: Some(radius),
                speed_m_s: Some(speed),
                ..of(Kind::Circle)
            },
            ("hand", &[speed, bandwidth]) => Self {
                speed_m_s: Some(speed),
                bandwidth_hz: Some(bandwidth),
                ..of(Kind::Hand)
            },
            ("hand", &[speed, bandwidth, seed]) if seed >= 0.0 && seed.fract() == 0.0 => Self {
                speed_m_s: Some(speed),
                bandwidth_hz: Some(bandwidth),
                seed: Some(seed as u32),
                ..of(Kind::Hand)
            },
            ("push", &[at, by]) => Self {
                from_s: Some(at),
                by_m: Some([by, 0.0, 0.0]),
                ..of(Kind::Push)
            },
            _ => return Err(refused()),
        };
        toml_schema::check(&keys).map_err(|refusal| refusal.to_string())?;
        Ok(keys)
    }
}

/// A flag of a motion.
pub const HELP: &str = "How the pattern moves: conveyor:M_S along its x axis, turn:RAD_S about its \
    normal, circle:M:M_S, hand:M_S:HZ, push:S:M; several add up";

/// A sinusoid of a velocity: rate, m/s or rad/s; angular frequency, rad/s; phase, rad.
type Wave = [f64; 3];

/// One of the motions that add up.
#[derive(Clone, Debug, PartialEq)]
enum Part {
    Conveyor {
        velocity: Vector3<f64>,
        turn: f64,
        /// From the start on.
        until_s: f64,
        ramp_s: f64,
    },
    Circle {
        radius: f64,
        speed: f64,
        ramp_s: f64,
    },
    /// Waves along the three axes, then about them.
    Hand(Vec<[Wave; WAVES]>),
    Push {
        by: Vector3<f64>,
        over_s: f64,
    },
}

/// Translation, m, and rotation vector, rad, with their derivatives by time.
#[derive(Clone, Copy, Debug, Default)]
struct Course {
    position: Vector3<f64>,
    turn: Vector3<f64>,
    velocity: Vector3<f64>,
    turn_rate: Vector3<f64>,
}

/// A smooth step from 0 to 1 in `over` seconds, and its derivative by time.
fn step(t: f64, over: f64) -> [f64; 2] {
    if t <= 0.0 {
        [0.0; 2]
    } else if t >= over {
        [1.0, 0.0]
    } else {
        let share = t / over;
        let value = 0.5 * (1.0 - (PI * share).cos());
        [value, 0.5 * PI / over * (PI * share).sin()]
    }
}

/// The time for which something has moved at full speed that begins with a [`step`], s; and the
/// step.
fn passed(t: f64, ramp: f64) -> [f64; 2] {
    if t <= 0.0 {
        [0.0; 2]
    } else if t >= ramp {
        [t - 0.5 * ramp, 1.0]
    } else {
        let angle = PI * t / ramp;
        [0.5 * (t - ramp / PI * angle.sin()), step(t, ramp)[0]]
    }
}

impl Part {
    fn new(keys: &MotionKeys) -> Self {
        let vector = |value: Option<[f64; 3]>| value.map_or(Vector3::zeros(), Vector3::from);
        // What has no start has always moved.
        let usual_s = keys.from_s.map_or(0.0, |_| RAMP_S);
        let ramp_s = keys.ramp_s.unwrap_or(usual_s);
        let speed = keys.speed_m_s.unwrap_or(0.05);
        match keys.kind {
            Kind::Conveyor => Self::Conveyor {
                velocity: vector(keys.velocity_m_s),
                turn: keys.turn_rad_s.unwrap_or(0.0),
                until_s: keys
                    .until_s
                    .map_or(f64::INFINITY, |s| (s - from_s(keys)).max(0.0)),
                ramp_s,
            },
            Kind::Circle => Self::Circle {
                radius: keys.radius_m.unwrap_or(0.05),
                speed,
                ramp_s,
            },
            Kind::Hand => {
                let bandwidth = keys.bandwidth_hz.unwrap_or(1.0);
                let mut random = ChaCha8Rng::seed_from_u64(u64::from(keys.seed.unwrap_or(1)));
                let mut waves = |rms: f64| -> [Wave; WAVES] {
                    // The squares of all waves along the three axes add up to twice the square.
                    let rate = rms * (2.0 / (3 * WAVES) as f64).sqrt();
                    std::array::from_fn(|k| {
                        let place = (k as f64 + random.random::<f64>()) / WAVES as f64;
                        let share = HAND_LOWEST + (1.0 - HAND_LOWEST) * place;
                        [rate, TAU * bandwidth * share, TAU * random.random::<f64>()]
                    })
                };
                let rms = [speed, speed / HAND_LEVER_M];
                Self::Hand((0..6).map(|axis| waves(rms[axis / 3])).collect())
            }
            Kind::Push => Self::Push {
                by: vector(keys.by_m),
                over_s: keys.over_s.unwrap_or(0.5),
            },
        }
    }

    /// The course `t` seconds after the start.
    fn at(&self, t: f64) -> Course {
        match self {
            Self::Conveyor {
                velocity,
                turn,
                until_s,
                ramp_s,
            } => {
                let (begun, ended) = (passed(t, *ramp_s), passed(t - until_s, *ramp_s));
                let (time, share) = (begun[0] - ended[0], begun[1] - ended[1]);
                let about = Vector3::z() * *turn;
                Course {
                    position: velocity * time,
                    turn: about * time,
                    velocity: velocity * share,
                    turn_rate: about * share,
                }
            }
            Self::Circle {
                radius,
                speed,
                ramp_s,
            } => {
                let [time, share] = passed(t, *ramp_s);
                let (sin, cos) = (speed / radius * time).sin_cos();
                Course {
                    position: Vector3::new(sin, 1.0 - cos, 0.0) * *radius,
                    velocity: Vector3::new(cos, sin, 0.0) * (speed * share),
                    ..Course::default()
                }
            }
            Self::Hand(axes) => {
                let [share, rate] = step(t, HAND_BEGIN_S);
                let mut course = Course::default();
                for (axis, waves) in axes.iter().enumerate() {
                    let (mut way, mut speed) = (0.0, 0.0);
                    for [most, frequency, phase] in waves {
                        let angle = frequency * t + phase;
                        way += most / frequency * (angle.sin() - phase.sin());
                        speed += most * angle.cos();
                    }
                    let (place, change) = match axis {
                        0..3 => (&mut course.position, &mut course.velocity),
                        _ => (&mut course.turn, &mut course.turn_rate),
                    };
                    place[axis % 3] = share * way;
                    change[axis % 3] = share * speed + rate * way;
                }
                course
            }
            Self::Push { by, over_s } => {
                let [share, rate] = step(t, *over_s);
                Course {
                    position: by * share,
                    velocity: by * rate,
                    ..Course::default()
                }
            }
        }
    }
}

/// When a motion starts, s.
fn from_s(keys: &MotionKeys) -> f64 {
    keys.from_s.unwrap_or(0.0)
}

/// How the pattern moves; by default it rests.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Motion(
    /// With their starts, s.
    Vec<(f64, Part)>,
);

impl Motion {
    /// The sum of these motions.
    pub fn new(keys: &[MotionKeys]) -> Self {
        let part = |keys| (from_s(keys), Part::new(keys));
        Self(keys.iter().map(part).collect())
    }

    /// Whether the pattern always rests.
    pub fn is_rest(&self) -> bool {
        self.0.is_empty()
    }

    /// The displacement at `time_s` in the pattern's frame at rest; the velocity of the pattern's
    /// origin, m/s, and its angular velocity, rad/s, along the axes of that frame.
    pub fn at(&self, time_s: f64) -> (RigidPose, [f64; 6]) {
        let mut sum = Course::default();
        for (from_s, part) in self.0.iter().filter(|(from_s, _)| time_s > *from_s) {
            let course = part.at(time_s - from_s);
            sum.position += course.position;
            sum.turn += course.turn;
            sum.velocity += course.velocity;
            sum.turn_rate += course.turn_rate;
        }
        let pose =
            RigidPose::from_parts(Translation3::from(sum.position), Rotation3::new(sum.turn));
        let [[vx, vy, vz], [wx, wy, wz]] = [sum.velocity, angular_velocity(&sum)].map(Into::into);
        (pose, [vx, vy, vz, wx, wy, wz])
    }

    /// The object in the camera frame at `time_s`, which would be at `rest` there.
    pub fn moved(&self, rest: &RigidPose, time_s: f64) -> RigidPose {
        match self.is_rest() {
            true => *rest,
            false => rest * self.at(time_s).0,
        }
    }

    /// The velocity of the object against the world at `time_s`, which would be at `rest` in the
    /// camera frame: the twist with which a camera keeps its view of it (m/s, rad/s; camera frame,
    /// at the camera's origin).
    pub fn twist(&self, rest: &RigidPose, time_s: f64) -> [f64; 6] {
        if self.is_rest() {
            return [0.0; 6];
        }
        let (displacement, [vx, vy, vz, wx, wy, wz]) = self.at(time_s);
        let turn = rest.rotation * Vector3::new(wx, wy, wz);
        let velocity = rest.rotation * Vector3::new(vx, vy, vz);
        let origin = (rest * displacement).translation.vector;
        let [[vx, vy, vz], [wx, wy, wz]] = [velocity - turn.cross(&origin), turn].map(Into::into);
        [vx, vy, vz, wx, wy, wz]
    }
}

/// The angular velocity, rad/s, from a rotation vector r and its rate r': the left Jacobian of the
/// rotations times r'.
fn angular_velocity(course: &Course) -> Vector3<f64> {
    let (r, rate) = (course.turn, course.turn_rate);
    let angle = r.norm();
    let across = r.cross(&rate);
    if angle < 1e-6 {
        return rate + across * 0.5;
    }
    let half = 2.0 * (0.5 * angle).sin().powi(2) / angle.powi(2);
    rate + across * half + r.cross(&across) * ((angle - angle.sin()) / angle.powi(3))
}

/// The velocity of a camera relative to what it sees (m/s, rad/s; camera frame): how the view
/// changes.
pub fn relative(camera: &[f64; 6], object: &[f64; 6]) -> [f64; 6] {
    std::array::from_fn(|k| camera[k] - object[k])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::{from_scene, seen_after};

    const EACH: [&str; 5] = [
        "conveyor:0.03:-0.02:0.01",
        "turn:0.2",
        "circle:0.05:0.1",
        "hand:0.05:1",
        "push:2:0.03",
    ];

    fn keys(texts: &[&str]) -> Vec<MotionKeys> {
        texts.iter().map(|text| text.parse().unwrap()).collect()
    }

    fn of(texts: &[&str]) -> Motion {
        Motion::new(&keys(texts))
    }

    /// Motions that begin with the run.
    fn begun(texts: &[&str]) -> Motion {
        let mut keys = keys(texts);
        keys.iter_mut().for_each(|keys| keys.from_s = Some(0.0));
        Motion::new(&keys)
    }

    /// Each motion alone, all together, and a conveyor that starts and stops.
    fn all() -> Vec<Motion> {
        let mut all: Vec<Motion> = EACH.iter().map(|text| begun(&[text])).collect();
        all.push(begun(&EACH));
        let mut stops = keys(&EACH[..1]);
        (stops[0].from_s, stops[0].until_s) = (Some(1.0), Some(2.5));
        all.push(Motion::new(&stops));
        all
    }

    #[test]
    fn a_twist_is_the_derivative_of_the_displacement() {
        let h = 1e-5;
        for motion in all() {
            for k in 1..400 {
                let t = 0.0137 * f64::from(k);
                let (_, [vx, vy, vz, wx, wy, wz]) = motion.at(t);
                let (before, after) = (motion.at(t - h).0, motion.at(t + h).0);
                let way = after.translation.vector - before.translation.vector;
                assert!((way / (2.0 * h) - Vector3::new(vx, vy, vz)).norm() < 1e-6);
                let turned = after.rotation * before.rotation.inverse();
                let turn = panda::kinematics::rotation_vector(&turned) / (2.0 * h);
                assert!((turn - Vector3::new(wx, wy, wz)).norm() < 1e-6, "{t}");
            }
        }
    }

    #[test]
    fn a_pattern_rests_before_the_run_and_does_not_jump() {
        for motion in all() {
            for t in [-1.0, 0.0] {
                let (pose, twist) = motion.at(t);
                assert_eq!((pose, twist), (RigidPose::identity(), [0.0; 6]));
            }
            let speeds: Vec<f64> = (0..5000)
                .map(|k| motion.at(1e-3 * f64::from(k)).1[0])
                .collect();
            assert!(
                speeds
                    .windows(2)
                    .all(|pair| (pair[1] - pair[0]).abs() < 3e-3)
            );
        }
    }

    #[test]
    fn a_hand_has_the_rms_speed_that_it_says_and_stays() {
        let motion = of(&["hand:0.08:2"]);
        let (mut square, mut turn, mut farthest) = (0.0, 0.0, 0.0_f64);
        let count = 40_000;
        for k in 0..count {
            let (pose, [vx, vy, vz, wx, wy, wz]) = motion.at(2.0 + 0.037 * f64::from(k));
            square += Vector3::new(vx, vy, vz).norm_squared();
            turn += Vector3::new(wx, wy, wz).norm_squared();
            farthest = farthest.max(pose.translation.vector.norm());
        }
        let rms = [square, turn].map(|sum: f64| (sum / f64::from(count)).sqrt());
        assert!((rms[0] / 0.08 - 1.0).abs() < 0.02, "{rms:?}");
        assert!((rms[1] / 0.16 - 1.0).abs() < 0.02, "{rms:?}");
        assert!((0.005..0.15).contains(&farthest), "{farthest}");
        assert_eq!(motion, of(&["hand:0.08:2:1"]));
        assert_ne!(motion, of(&["hand:0.08:2:2"]));
    }

    #[test]
    fn conveyor_circle_and_push_go_where_they_should() {
        let place = |text: &str, t: f64| of(&[text]).at(t).0.translation.vector;
        let close = |a: Vector3<f64>, b: [f64; 3]| (a - Vector3::from(b)).norm() < 1e-9;
        assert!(close(place("conveyor:0.03", 2.0), [0.06, 0.0, 0.0]));
        // Half of the ramp is lost.
        let mut begins = keys(&["conveyor:0.03"]);
        begins[0].from_s = Some(1.0);
        let (begun, _) = Motion::new(&begins).at(3.1);
        assert!(close(begun.translation.vector, [0.06, 0.0, 0.0]));
        assert!(close(place("push:2:0.03", 2.25), [0.015, 0.0, 0.0]));
        assert!(close(place("push:2:0.03", 9.0), [0.03, 0.0, 0.0]));
        let half = PI * 0.05 / 0.1;
        assert!(close(place("circle:0.05:0.1", half), [0.0, 0.1, 0.0]));
        let turned = of(&["turn:0.2"]).at(1.0).0.rotation;
        assert!((turned.angle() - 0.2).abs() < 1e-9);
        let mut stops = keys(&["conveyor:0.1"]);
        (stops[0].from_s, stops[0].until_s) = (Some(1.0), Some(3.0));
        (stops[0].ramp_s, stops[0].turn_rad_s) = (Some(0.0), Some(0.1));
        let motion = Motion::new(&stops);
        assert_eq!(motion.at(1.0 + 1e-9).1[0], 0.1);
        assert!(close(motion.at(7.0).0.translation.vector, [0.2, 0.0, 0.0]));
        assert!((motion.at(7.0).0.rotation.angle() - 0.2).abs() < 1e-9);
        assert_eq!(motion.at(7.0).1, [0.0; 6]);
    }

    #[test]
    fn a_camera_that_moves_as_the_object_keeps_its_view() {
        let rest = from_scene(&scene::Pose {
            translation: [0.1, -0.2, 0.9],
            rotation: [0.3, -0.4, 1.2],
        });
        let h = 1e-4;
        for motion in all() {
            let now = motion.moved(&rest, 2.2);
            let twist = motion.twist(&rest, 2.2);
            // The camera moves meanwhile, and with it the place at rest in its frame.
            let later = motion.moved(&seen_after(&rest, &twist, h), 2.2 + h);
            let way = later.translation.vector - now.translation.vector;
            assert!(way.norm() < 1e-6 * h.sqrt(), "{way}");
            assert!((later.rotation.matrix() - now.rotation.matrix()).norm() < 1e-7);
        }
        assert_eq!(Motion::default().moved(&rest, 3.0), rest);
    }

    #[test]
    fn a_flag_that_is_no_motion_is_refused_with_what_is_allowed() {
        for (text, words) in [
            ("conveyor", "allowed: conveyor:M_S"),
            ("spin:1", "allowed: conveyor:M_S"),
            ("circle:0.05", "circle:M:M_S"),
            ("circle:0.05:9", "speed_m_s = 9; allowed: 0 to 1 m/s"),
            (
                "conveyor:nan",
                "velocity_m_s[0] = NaN; allowed: -1 to 1 m/s",
            ),
            ("push:2:x", "push:S:M"),
        ] {
            let message = text.parse::<MotionKeys>().unwrap_err();
            assert!(message.contains(words), "{message}");
        }
        let mut stray = keys(&["hand:0.05:1"]);
        stray[0].radius_m = Some(0.1);
        let (key, value, allowed) = stray[0].stray().unwrap();
        assert_eq!((key.as_str(), value.as_str()), ("radius_m", "0.1"));
        assert!(allowed.contains("speed_m_s, bandwidth_hz, seed, from_s"));
        assert_eq!(
            keys(&EACH)[2].to_string(),
            "circle: radius_m = 0.05, speed_m_s = 0.1"
        );
        assert_eq!(keys(&EACH)[3].stray(), None);
    }
}
