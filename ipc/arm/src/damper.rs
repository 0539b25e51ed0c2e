//! Velocity dampers: the bounds on the camera's velocity by which an arm keeps within its ranges,
//! speeds and walls, off its singular postures, and its links off each other and off boxes.
//!
//! | Symbol | Here | Meaning |
//! |---|---|---|
//! | v | | the camera's velocity along camera axes, m/s and rad/s |
//! | dq = M v + s w | [`Dampers::joints`] | velocities of the joints |
//! | s w | [`Dampers::elbow`] | what of them turns the elbow at w, rad/s, while the camera stands |
//! | h(q) | | what is left: to the end of a range, to what is near, of the acceleration |
//! | g v <= b | [`Bound`] | -dh/dt is no greater than what is left allows |
//!
//! An arm with fewer than six joints moves the camera in as many directions only; of the others
//! [`Dampers::still`] has a basis, n v = 0.
//!
//! Every b is at least 0, so that standing still is always allowed, and with a twist each shorter
//! one. A motion that keeps to all bounds leaves no range that it is in.
//!
//! Nearness to a singular posture is what the end effector's accelerations ask of the joints'
//! there, as bridges measure it ([`singularity`]): the robot refuses that first, and unlike a
//! singular value it needs no exchange of metres for radians.
//!
//! Source: B. Faverjon and P. Tournassoud, "A local based approach for path planning of
//! manipulators with a high number of degrees of freedom", ICRA 1987.

use nalgebra::{Matrix6, RowSVector, RowVector6, SMatrix, SVector, Vector3};

use crate::collision::MAX_ROWS;
use crate::description::{Arm, MAX_POINTS, MAX_WALLS, Pair};
use crate::elbow;
use crate::ik::{self, Inverse, held, inverse, square};
use crate::kinematics::{Chain, JOINTS, Jacobian, Joints, Pose, Twist};
use crate::reserve::nearing;
use crate::singularity;

/// Deceleration with which joints near the ends of their ranges, rad/s^2 or m/s^2; also of points
/// near a wall, m/s^2.
const DECELERATION: f64 = 0.5;
/// Least time in which what is left may be used up, s: some periods of the law.
const LEAST_S: f64 = 0.15;
/// A motion along a bound is not stopped for rounding.
const TOLERANCE: f64 = 1e-5;
/// A joint's acceleration has a bound where its share is at least this part of the largest.
const RIVAL: f64 = 0.8;
/// Rate at which the share of the joints' accelerations that is left may shrink, 1/s.
const RATE: f64 = 2.0;

/// Share of what a bound leaves that the elbow may take of the camera.
const ELBOWS: f64 = 0.5;

/// Square of a camera's velocity, as a share of its limits, below which the elbow turns alone.
const SLOW: f64 = 0.01;

/// Most bounds of an arm.
pub const MAX_BOUNDS: usize = WITHOUT_SHAPES + MAX_ROWS;
/// Most bounds of an arm whose links have no shapes.
pub const WITHOUT_SHAPES: usize = 3 * JOINTS + MAX_WALLS * MAX_POINTS;
/// Most directions in which an arm does not move its camera: it has four joints at least.
pub const MAX_STILL: usize = 2;

/// What bounds a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The end of the range of the joint of this index, base to flange.
    Joint(usize),
    /// The greatest speed of the joint of this index.
    Speed(usize),
    /// A singular posture.
    Singularity,
    /// The wall of this index, for the camera or a point beside it.
    Wall(usize),
    /// A link, and what it is near.
    Near(Pair),
}

/// A bound on the camera's velocity: `gradient` times it is at most `most`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bound {
    /// g, for a velocity along camera axes.
    pub gradient: [f64; 6],
    /// b, at least 0; rad/s of a joint that turns, m/s of one that slides, of a wall and of a
    /// pair, 1/s of a singularity.
    pub most: f64,
    /// What bounds.
    pub cause: Cause,
}

impl Bound {
    /// How far a camera's velocity is within it, in its own unit; negative beyond it.
    pub fn left(&self, twist: &[f64; 6]) -> f64 {
        let pairs = self.gradient.iter().zip(twist);
        self.most - pairs.map(|(g, v)| g * v).sum::<f64>()
    }
}

/// A posture that an arm goes to.
#[derive(Clone, Copy, Debug)]
pub struct Towards {
    /// The joints there, rad or m.
    pub q: Joints,
    /// The greatest velocity of the camera, m/s and rad/s.
    pub limits: [f64; 6],
}

impl Towards {
    /// The velocity of the elbow that goes with the camera's `twist`: what of it is the elbow's
    /// alone, and what each component of a camera's velocity adds, so that both keep step.
    fn coupled(&self, twist: &[f64; 6], elbow: f64) -> (f64, [f64; 6]) {
        let weights = self.limits.map(|most| 1.0 / (most * most));
        let pairs = twist.iter().zip(weights);
        let square = pairs.map(|(v, weight)| v * v * weight).sum::<f64>() + SLOW;
        let coupling = core::array::from_fn(|k| elbow * twist[k] * weights[k] / square);
        (elbow * SLOW / square, coupling)
    }

    /// The velocities of the camera, along its axes, and of the elbow that lead straight there from
    /// `q`, as fast as their limits and the joints' allow, and not past it in so many seconds.
    fn straight(&self, arm: &Arm, q: &Joints, moves: &Moves, seconds: f64) -> ([f64; 6], f64) {
        let way = arm.limits.way(q, &self.q);
        let twist = moves.along.transpose() * (moves.jacobian * way);
        let elbow = match arm.is_elbow_free {
            true => elbow::along(&moves.free, &(way - moves.map * twist)),
            false => 0.0,
        };
        let camera = twist.iter().zip(&self.limits);
        let joints = way.iter().zip(&arm.limits.0);
        let all = camera
            .map(|(v, most)| v.abs() / most)
            .chain(joints.map(|(way, joint)| way.abs() / (arm.speed * joint.velocity)))
            .chain([elbow.abs() / elbow::FASTEST, seconds, LEAST_S]);
        let took = all.fold(0.0, f64::max);
        ((twist / took).into(), elbow / took)
    }
}

/// How an arm moves at a posture.
struct Moves {
    jacobian: Jacobian,
    /// From a velocity along camera axes to one along base axes.
    along: Matrix6<f64>,
    /// M and s of [`Dampers`].
    map: SMatrix<f64, JOINTS, 6>,
    free: Joints,
}

/// The bounds of a posture.
#[derive(Clone, Debug, PartialEq)]
pub struct Dampers {
    /// M: from the camera's velocity along its axes to those of the joints, the elbow held.
    map: SMatrix<f64, JOINTS, 6>,
    /// s: the velocities of the joints as the elbow turns at 1 rad/s.
    free: Joints,
    /// The velocity of the elbow while the camera stands, rad/s.
    elbow: f64,
    /// What a camera's velocity adds to it, rad/s for each m/s or rad/s.
    coupling: [f64; 6],
    /// The camera's velocity on the straight way to a posture, along camera axes.
    pub wanted: Option<[f64; 6]>,
    /// Share of the camera's accelerations that the joints have room for, 0.01 to 1: as bridges
    /// shorten their ramps near a singular posture.
    pub ramps: f64,
    /// All bounds.
    pub bounds: heapless::Vec<Bound, MAX_BOUNDS>,
    /// The directions in which the arm does not move its camera, orthonormal, along camera axes;
    /// none for six joints or more.
    pub still: heapless::Vec<[f64; 6], MAX_STILL>,
}

impl Dampers {
    /// The dampers of an arm at `q`, for a command that is held for `seconds` and changes by at
    /// most `accelerations`, m/s^2 and rad/s^2. Where these are not finite, singular postures have
    /// none.
    pub fn at(arm: &Arm, q: &Joints, accelerations: &[f64; 6], seconds: f64) -> Self {
        Self::towards(arm, q, accelerations, seconds, None)
    }

    /// The same on the way to a posture, where there is one: the camera's velocity that leads
    /// there, and an elbow that keeps step with it. A bound counts what both do together.
    pub fn towards(
        arm: &Arm,
        q: &Joints,
        accelerations: &[f64; 6],
        seconds: f64,
        towards: Option<&Towards>,
    ) -> Self {
        let least_s = seconds.max(LEAST_S);
        let damped = |left: f64| damped(left, least_s);
        let (camera, jacobian) = arm.chain.at(q);
        let along = along_camera(&camera);
        let inverse = inverse(&jacobian);
        let free = ik::elbow(&inverse, &jacobian);
        let map = held(&inverse, &free) * along;
        let mut bounds = heapless::Vec::<Bound, MAX_BOUNDS>::new();
        // Of each bound, what the elbow takes as it turns at 1 rad/s.
        let mut turns = heapless::Vec::<f64, MAX_BOUNDS>::new();
        let mut add = |gradient: [f64; 6], turn, most, cause| {
            let bound = Bound {
                gradient,
                most,
                cause,
            };
            let has_room = turns.push(turn).is_ok() && bounds.push(bound).is_ok();
            debug_assert!(has_room, "more than {MAX_BOUNDS} bounds");
        };
        for k in 0..arm.chain.count() {
            let joint = &arm.limits.0[k];
            let row: [f64; 6] = map.row(k).transpose().into();
            for (side, sign) in [(0, -1.0), (1, 1.0)] {
                let left = joint.room(q[k])[side] - arm.margin;
                let fastest = arm.speed * joint.speeds(q[k])[side];
                let (most, cause) = match damped(left) {
                    most if most < fastest => (most, Cause::Joint(k)),
                    _ => (fastest, Cause::Speed(k)),
                };
                add(row.map(|g| sign * g), sign * free[k], most, cause);
            }
        }
        let mut ramps = 1.0;
        let (mut strained, mut steepest) = (0.0, RowSVector::zeros());
        if accelerations.iter().all(|a| a.is_finite()) {
            let strain = Strain::at(arm, q, accelerations);
            strained = strain.shares.max();
            ramps = singularity::ramps(strained);
            let rate = RATE.min(1.0 / least_s);
            for k in strain.largest() {
                let by_joints = strain.gradient(arm, k);
                if strain.shares[k] == strained {
                    steepest = by_joints;
                }
                let most = rate * (arm.strain - strain.shares[k]).max(0.0);
                let gradient = (by_joints * map).transpose().into();
                add(gradient, (by_joints * free)[0], most, Cause::Singularity);
            }
        }
        for (i, wall) in arm.walls.iter().enumerate() {
            let normal = Vector3::from(wall.normal);
            let turned = camera.rotation.inverse() * normal;
            for point in &arm.points {
                let away = camera.rotation * Vector3::from(*point);
                let left = wall.distance(&(camera.translation.vector + away));
                let moment = camera.rotation.inverse() * away.cross(&normal);
                let gradient = [turned.x, turned.y, turned.z, moment.x, moment.y, moment.z];
                add(gradient.map(|g| -g), 0.0, damped(left), Cause::Wall(i));
            }
        }
        for row in arm.rows_of_pairs(q, &camera, &jacobian) {
            let gradient: [f64; 6] = (row.gradient * map).transpose().into();
            let turn = -(row.gradient * free)[0];
            add(
                gradient.map(|g| -g),
                turn,
                damped(row.left),
                Cause::Near(row.pair),
            );
        }
        let (mut wanted, mut coupling) = (None, [0.0; 6]);
        let mut turning = 0.0;
        match towards {
            Some(to) => {
                let moves = Moves {
                    jacobian,
                    along,
                    map,
                    free,
                };
                let (twist, elbow) = to.straight(arm, q, &moves, seconds);
                (turning, coupling) = to.coupled(&twist, elbow);
                wanted = Some(twist);
            }
            None if arm.is_elbow_free => {
                turning = elbow::rate(&arm.limits, arm.margin, q, &free, strained, &steepest);
            }
            None => (),
        }
        let taken = turns.iter().map(|turn| turn * turning);
        let share = |(bound, taken): (&Bound, f64)| match taken > ELBOWS * bound.most {
            true => ELBOWS * bound.most / taken,
            false => 1.0,
        };
        let elbow = turning * bounds.iter().zip(taken).map(share).fold(1.0, f64::min);
        for (bound, turn) in bounds.iter_mut().zip(&turns) {
            bound.most -= (turn * elbow).max(0.0);
            let coupled = bound.gradient.iter_mut().zip(&coupling);
            coupled.for_each(|(g, with)| *g += turn * with);
        }
        Self {
            map,
            free,
            elbow,
            coupling,
            wanted,
            ramps,
            bounds,
            still: still(&arm.chain, &jacobian, &along),
        }
    }

    /// What of a camera's velocity the joints can do.
    #[must_use]
    pub fn reached(&self, twist: &[f64; 6]) -> [f64; 6] {
        let mut reached = *twist;
        for direction in &self.still {
            let part: f64 = direction.iter().zip(twist).map(|(n, v)| n * v).sum();
            let pairs = reached.iter_mut().zip(direction);
            pairs.for_each(|(v, n)| *v -= part * n);
        }
        reached
    }

    /// How much of a camera's velocity they allow, 0 to 1.
    pub fn share(&self, twist: &[f64; 6]) -> f64 {
        let share = |bound: &Bound| {
            let excess = -bound.left(twist);
            if excess > 0.0 {
                (bound.most.max(TOLERANCE) / (bound.most + excess)).min(1.0)
            } else {
                1.0
            }
        };
        self.bounds.iter().map(share).fold(1.0, f64::min)
    }

    /// w: the velocity of the elbow while the camera moves at `twist` along its axes, rad/s.
    pub fn elbow(&self, twist: &[f64; 6]) -> f64 {
        let coupled = self.coupling.iter().zip(twist).map(|(k, v)| k * v);
        (self.elbow + coupled.sum::<f64>()).clamp(-elbow::FASTEST, elbow::FASTEST)
    }

    /// The velocities of the joints while the camera moves at `twist` along its axes.
    pub fn joints(&self, twist: &[f64; 6]) -> Joints {
        self.map * Twist::from(*twist) + self.free * self.elbow(twist)
    }
}

impl Arm {
    /// The joints after the camera has moved at `twist` along its axes for so long, and the elbow at
    /// `elbow`, rad/s; by the midpoint rule.
    pub fn moved(&self, q: &Joints, twist: &[f64; 6], elbow: f64, seconds: f64) -> Joints {
        let velocities = |q: &Joints| {
            let (camera, jacobian) = self.chain.at(q);
            let inverse = inverse(&jacobian);
            let free = ik::elbow(&inverse, &jacobian);
            held(&inverse, &free) * (along_camera(&camera) * Twist::from(*twist)) + free * elbow
        };
        let middle = q + velocities(q) * (0.5 * seconds);
        q + velocities(&middle) * seconds
    }

    /// The camera's velocity along its axes while the joints move at `dq`, rad/s or m/s; also its
    /// short way as they go `dq`, rad or m.
    pub fn camera_twist(&self, q: &Joints, dq: &Joints) -> [f64; 6] {
        let (camera, jacobian) = self.chain.at(q);
        (along_camera(&camera).transpose() * (jacobian * dq)).into()
    }

    /// The camera's mean velocity along its axes while it is told to move at `twist` for so long:
    /// `twist` itself, unless the arm has fewer than six joints.
    pub fn carried(&self, q: &Joints, twist: &[f64; 6], seconds: f64) -> [f64; 6] {
        if !self.chain.has_few_joints() {
            return *twist;
        }
        let middle = self.moved(q, twist, 0.0, 0.5 * seconds);
        let (camera, jacobian) = self.chain.at(&middle);
        let along = along_camera(&camera);
        let joints = inverse(&jacobian) * (along * Twist::from(*twist));
        (along.transpose() * (jacobian * joints)).into()
    }
}

/// Orthonormal directions along camera axes in which the joints of a chain do not move the camera.
fn still(
    chain: &Chain,
    jacobian: &Jacobian,
    along: &Matrix6<f64>,
) -> heapless::Vec<[f64; 6], MAX_STILL> {
    let mut basis = heapless::Vec::new();
    if !chain.has_few_joints() {
        return basis;
    }
    // What is left of each axis beside all that the joints do.
    let moved = along.transpose() * jacobian;
    let reached = moved * moved.transpose() * square(&moved).unwrap_or_default();
    let mut left = Matrix6::identity() - reached;
    for _ in chain.count()..6 {
        let longest = left.row_iter().map(|row| row.norm_squared());
        let longest = longest.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((k, square)) = longest.filter(|(_, square)| square.is_finite()) else {
            break;
        };
        let row: RowVector6<f64> = left.row(k) / libm::sqrt(square);
        left -= left * row.transpose() * row;
        if basis.push(row.transpose().into()).is_err() {
            break;
        }
    }
    basis
}

/// The greatest speed towards what is `left` away, and not to be used up in less than `least_s`.
fn damped(left: f64, least_s: f64) -> f64 {
    nearing(left, DECELERATION).min(left.max(0.0) / least_s)
}

/// From a velocity along camera axes to one along base axes.
fn along_camera(camera: &Pose) -> Matrix6<f64> {
    let mut along = Matrix6::zeros();
    for at in [0, 3] {
        let mut block = along.fixed_view_mut::<3, 3>(at, at);
        block.copy_from(camera.rotation.matrix());
    }
    along
}

/// Nearness to a singular posture: the largest share of a joint's acceleration that these of the
/// end effector take at `q`, all at once.
pub(crate) fn strain(arm: &Arm, q: &Joints, accelerations: &[f64; 6]) -> f64 {
    Strain::at(arm, q, accelerations).shares.max()
}

/// What the end effector's accelerations along base axes, all at once, ask of the joints'.
struct Strain {
    jacobian: Jacobian,
    /// S = (J J^T)^-1, but for rounding.
    square: Matrix6<f64>,
    inverse: Inverse,
    weights: Twist,
    /// Of each joint's, as a share of its limit.
    shares: Joints,
}

impl Strain {
    fn at(arm: &Arm, q: &Joints, accelerations: &[f64; 6]) -> Self {
        let jacobian = arm.shaped.jacobian(q);
        let square = square(&jacobian).unwrap_or_default();
        let inverse = jacobian.transpose() * square;
        let weights = Twist::from(*accelerations);
        let asked = inverse.abs() * weights;
        let shares = Joints::from_fn(|k, _| asked[k] / arm.limits.0[k].acceleration);
        Self {
            jacobian,
            square,
            inverse,
            weights,
            shares,
        }
    }

    /// The joints with the largest shares.
    fn largest(&self) -> impl Iterator<Item = usize> {
        let least = RIVAL * self.shares.max();
        (0..JOINTS).filter(move |k| self.shares[*k] > 0.0 && self.shares[*k] >= least)
    }

    /// The derivative of a joint's share by each joint, 1/rad or 1/m.
    fn gradient(&self, arm: &Arm, joint: usize) -> RowSVector<f64, JOINTS> {
        let Self {
            jacobian,
            square,
            inverse,
            weights,
            ..
        } = self;
        // A share is u w, u the joint's row of J^T S with its signs and w the weights, and
        // dS = -S (dJ J^T + J dJ^T) S.
        let row = inverse.row(joint);
        let signed = Twist::from_fn(|a, _| weights[a] * row[a].signum());
        let (through, back) = (inverse * signed, square * signed);
        let mut rest = -(row * jacobian).transpose();
        rest[joint] += 1.0;
        let gradient = RowSVector::from_fn(|_, i| {
            let change = |x: &Joints| changed(arm.shaped.count(), jacobian, i, x);
            change(&rest).dot(&back) - (row * change(&through))[0]
        });
        gradient / arm.limits.0[joint].acceleration
    }
}

/// dJ/dq_i x: how fast the velocity by these joint velocities changes as joint `i` moves.
fn changed(count: usize, jacobian: &Jacobian, i: usize, x: &Joints) -> SVector<f64, 6> {
    let part = |k: usize, from: usize| Vector3::from(jacobian.fixed_view::<3, 1>(from, k));
    let axis = part(i, 3);
    let (mut linear, mut angular) = (Vector3::zeros(), Vector3::zeros());
    for k in 0..count {
        // A joint turns all that is behind it, and itself moves nothing before it.
        linear += x[k]
            * match k > i {
                true => axis.cross(&part(k, 0)),
                false => part(k, 3).cross(&part(i, 0)),
            };
        if k > i {
            angular += axis.cross(&part(k, 3)) * x[k];
        }
    }
    SVector::from([
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
    ])
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Translation3};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::description::Wall;
    use crate::limits::Model;
    use crate::{READY, ShaperSettings};

    const ACCELERATIONS: [f64; 6] = [0.5, 0.5, 0.5, 1.2, 1.2, 1.2];

    fn arm() -> Arm {
        let camera = Pose::from_parts(
            Translation3::new(0.05, -0.05, 0.04),
            Rotation3::new(Vector3::z() * 0.8),
        );
        let wall = Wall {
            normal: [0.0, 0.0, 1.0],
            offset: 0.3,
        };
        Arm {
            chain: Chain::FRANKA.with_ee(camera),
            shaped: Chain::FRANKA,
            limits: *Model::Panda.limits(),
            margin: 0.2,
            speed: 0.25,
            strain: 0.6,
            is_elbow_free: false,
            walls: [wall].into_iter().collect(),
            points: [[0.0; 3], [0.0, 0.0, 0.1]].into_iter().collect(),
            shapes: Default::default(),
        }
    }

    fn posture(random: &mut ChaCha8Rng) -> Joints {
        Joints::from_fn(|k, _| READY[k] + random.random_range(-0.5..0.5))
    }

    #[test]
    fn joint_velocities_and_walls_are_those_of_the_moved_arm() {
        let (mut arm, mut random) = (arm(), ChaCha8Rng::seed_from_u64(1));
        for round in 0..50 {
            arm.is_elbow_free = round % 2 == 0;
            let q = posture(&mut random);
            let twist: [f64; 6] = core::array::from_fn(|_| random.random_range(-0.1..0.1));
            let dampers = Dampers::at(&arm, &q, &ACCELERATIONS, 0.0);
            let dq = dampers.joints(&twist);
            let h = 1e-6;
            let moved = (arm.moved(&q, &twist, dampers.elbow(&twist), h)
                - arm.moved(&q, &twist, dampers.elbow(&twist), -h))
                / (2.0 * h);
            assert!((moved - dq).norm() < 1e-8);
            let height = |q: &Joints| {
                let camera = arm.chain.pose(q);
                arm.points
                    .iter()
                    .map(|p| (camera * nalgebra::Point3::from(*p)).z)
                    .collect::<Vec<_>>()
            };
            let walls = dampers.bounds.iter().filter(|b| b.cause == Cause::Wall(0));
            let (after, before) = (height(&(q + dq * h)), height(&(q - dq * h)));
            for (bound, (after, before)) in walls.zip(after.iter().zip(before)) {
                let sinks: f64 = bound.gradient.iter().zip(twist).map(|(g, v)| g * v).sum();
                assert!((sinks + (after - before) / (2.0 * h)).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn the_way_to_a_posture_goes_over_the_end_of_an_endless_joints_turn() {
        let mut arm = arm();
        arm.limits.0[6].range = crate::limits::JointLimits::NONE.range;
        let mut q = Joints::from(READY);
        q[6] = 3.0;
        let wanted = |at: f64| {
            let mut to = q;
            to[6] = at;
            let limits = [0.5, 0.5, 0.5, 1.0, 1.0, 1.0];
            let towards = Towards { q: to, limits };
            let dampers = Dampers::towards(&arm, &q, &ACCELERATIONS, 0.1, Some(&towards));
            dampers.joints(&dampers.wanted.unwrap())[6]
        };
        let turn = core::f64::consts::TAU;
        for at in [3.1, 3.1 - turn, 3.1 + 3.0 * turn] {
            let speed = wanted(at);
            assert!(speed > 0.1, "{at}: {speed}");
            assert!((speed - wanted(3.1)).abs() < 1e-9, "{at}: {speed}");
        }
    }

    #[test]
    fn the_strain_has_the_derivative_that_differences_have() {
        let (arm, mut random) = (arm(), ChaCha8Rng::seed_from_u64(2));
        for _ in 0..50 {
            let q = posture(&mut random);
            let at = |q: &Joints| Strain::at(&arm, q, &ACCELERATIONS);
            for joint in 0..JOINTS {
                let exact = at(&q).gradient(&arm, joint);
                for k in 0..JOINTS {
                    let mut step = Joints::zeros();
                    step[k] = 1e-6;
                    let change = at(&(q + step)).shares[joint] - at(&(q - step)).shares[joint];
                    let apart = exact[k] - change / 2e-6;
                    assert!(apart.abs() < 1e-5, "{joint}, {k}: {apart}");
                }
            }
        }
    }

    /// An arm of so many joints: the first ones of a Panda.
    fn of_few(count: usize) -> Arm {
        let all = Chain::FRANKA.screws();
        let end = Pose::from_parts(
            Translation3::new(0.3, 0.1, 0.8),
            Rotation3::new(Vector3::new(0.3, -0.2, 0.5)),
        );
        let chain = Chain::new(&all[..count], end);
        Arm {
            chain,
            shaped: chain,
            ..arm()
        }
    }

    #[test]
    fn fewer_than_six_joints_do_what_they_can_and_the_camera_goes_where_they_lead() {
        let mut random = ChaCha8Rng::seed_from_u64(6);
        for (count, directions) in [(4, 2), (5, 1), (6, 0), (7, 0)] {
            let arm = match count {
                7 => arm(),
                _ => of_few(count),
            };
            for _ in 0..50 {
                let q = Joints::from_fn(|k, _| match k < count {
                    true => READY[k] + random.random_range(-0.5..0.5),
                    false => 0.0,
                });
                let twist: [f64; 6] = core::array::from_fn(|_| random.random_range(-0.1..0.1));
                let dampers = Dampers::at(&arm, &q, &ACCELERATIONS, 0.0);
                assert_eq!(dampers.still.len(), directions);
                let reached = dampers.reached(&twist);
                if count >= 6 {
                    assert_eq!((reached, arm.carried(&q, &twist, 0.1)), (twist, twist));
                    continue;
                }
                // No direction that stands is one in which a joint moves the camera.
                let (camera, jacobian) = arm.chain.at(&q);
                let moves = along_camera(&camera).transpose() * jacobian;
                for n in &dampers.still {
                    let n = RowSVector::from(*n);
                    assert!((n.norm() - 1.0).abs() < 1e-6 && (n * moves).norm() < 1e-6);
                }
                // What the joints can do, they do; the rest stands at right angles to it.
                let again = moves * dampers.joints(&reached);
                let apart = again - SVector::from(reached);
                assert!(apart.norm() < 1e-6, "{count} {apart}");
                // The camera's motion in the mean of a while is that of the joints.
                let h = 1e-4;
                let carried = arm.carried(&q, &twist, h);
                let after = arm.chain.pose(&arm.moved(&q, &twist, 0.0, h));
                let went = camera.inverse() * after;
                let turned = went.rotation.scaled_axis();
                for k in 0..3 {
                    assert!((went.translation.vector[k] / h - carried[k]).abs() < 1e-4);
                    assert!((turned[k] / h - carried[k + 3]).abs() < 1e-4);
                }
            }
        }
    }

    #[test]
    fn a_motion_within_all_bounds_leaves_no_range() {
        let (mut arm, mut random) = (arm(), ChaCha8Rng::seed_from_u64(3));
        let period = 1.0 / 30.0;
        let mut nearest = f64::INFINITY;
        for round in 0..80 {
            arm.is_elbow_free = round % 2 == 0;
            let mut q = posture(&mut random);
            let wanted: [f64; 6] = core::array::from_fn(|k| {
                random.random_range(-1.0..1.0) * if k < 3 { 0.3 } else { 1.0 }
            });
            for _ in 0..300 {
                let dampers = Dampers::at(&arm, &q, &ACCELERATIONS, period);
                let share = dampers.share(&wanted);
                q = arm.moved(
                    &q,
                    &wanted.map(|v| share * v),
                    dampers.elbow(&wanted),
                    period,
                );
                for (k, joint) in arm.limits.0.iter().enumerate() {
                    let [below, above] = joint.room(q[k]);
                    nearest = nearest.min(below).min(above);
                }
            }
        }
        assert!(
            nearest > 0.99 * arm.margin && nearest < 1.1 * arm.margin,
            "{nearest}"
        );
    }

    #[test]
    fn a_free_elbow_leaves_the_camera_where_it_is_and_makes_room() {
        let mut arm = arm();
        arm.is_elbow_free = true;
        let limits = arm.limits;
        let crowded = |q: &Joints| {
            let room = |k: usize| {
                limits.0[k]
                    .room(q[k])
                    .into_iter()
                    .fold(f64::INFINITY, f64::min)
            };
            (0..JOINTS).map(room).fold(f64::INFINITY, f64::min)
        };
        let strained = |q: &Joints| Strain::at(&arm, q, &ACCELERATIONS).shares.max();
        // Joint 7 near its end; the wrist near its singular posture.
        for (joint, at) in [(6, 2.6), (5, 0.4)] {
            let mut q = Joints::from(READY);
            (q[1], q[2], q[joint]) = (0.2, 0.4, at);
            let camera = arm.chain.pose(&q);
            let (before, strain) = (crowded(&q), strained(&q));
            for _ in 0..900 {
                let dampers = Dampers::at(&arm, &q, &ACCELERATIONS, 1.0 / 30.0);
                assert!(dampers.elbow(&[0.0; 6]).abs() <= elbow::FASTEST);
                q = arm.moved(&q, &[0.0; 6], dampers.elbow(&[0.0; 6]), 1.0 / 30.0);
            }
            let apart = camera.translation.vector - arm.chain.pose(&q).translation.vector;
            assert!(apart.norm() < 1e-4, "{apart}");
            match joint {
                6 => assert!(crowded(&q) > before + 0.1, "{}", crowded(&q)),
                _ => assert!(strained(&q) < 0.99 * strain, "{}", strained(&q)),
            }
        }
        // A held one stands.
        arm.is_elbow_free = false;
        let dampers = Dampers::at(&arm, &Joints::from(READY), &ACCELERATIONS, 1.0 / 30.0);
        assert_eq!(dampers.elbow(&[0.0; 6]), 0.0);
        assert_eq!(dampers.joints(&[0.0; 6]), Joints::zeros());
    }

    #[test]
    fn on_the_way_to_a_posture_camera_and_elbow_keep_step_within_the_bounds() {
        let (mut arm, mut random) = (arm(), ChaCha8Rng::seed_from_u64(5));
        let (period, mut arrived) = (1.0 / 30.0, 0);
        for round in 0..40 {
            arm.is_elbow_free = round % 2 == 0;
            let mut q = posture(&mut random);
            let mut to = Towards {
                q: Joints::from_fn(|k, _| q[k] + random.random_range(-0.3..0.3)),
                limits: [0.1, 0.1, 0.1, 0.3, 0.3, 0.3],
            };
            if !arm.is_elbow_free {
                to.q[ik::ELBOW] = q[ik::ELBOW];
            }
            for step in 0..400 {
                let dampers = Dampers::towards(&arm, &q, &ACCELERATIONS, period, Some(&to));
                let wanted = dampers.wanted.unwrap();
                let pairs = wanted.iter().zip(to.limits);
                assert!(pairs.into_iter().all(|(v, most)| v.abs() < 1.001 * most));
                let (way, dq) = (to.q - q, dampers.joints(&wanted));
                if step == 0 && dampers.share(&wanted) == 1.0 {
                    assert!(dq.dot(&way) > 0.95 * dq.norm() * way.norm());
                }
                // Each bound counts what camera and elbow do together.
                for bound in dampers
                    .bounds
                    .iter()
                    .filter(|b| matches!(b.cause, Cause::Joint(_)))
                {
                    let Cause::Joint(k) = bound.cause else {
                        continue;
                    };
                    let alone = dampers.joints(&[0.0; 6]);
                    let together = (dq - alone)[k].abs();
                    let counted: f64 = bound.gradient.iter().zip(wanted).map(|(g, v)| g * v).sum();
                    assert!((counted.abs() - together).abs() < 1e-9);
                }
                let twist = wanted.map(|v| v * dampers.share(&wanted));
                q = arm.moved(&q, &twist, dampers.elbow(&twist), period);
            }
            arrived += usize::from((to.q - q).amax() < 0.02);
        }
        // The others are beyond a margin, a wall or the greatest strain.
        assert!(arrived >= 20, "{arrived}");
    }

    #[test]
    fn the_strain_and_its_growth_are_those_that_bridges_see() {
        let (arm, mut random) = (arm(), ChaCha8Rng::seed_from_u64(4));
        let (shaper, limits) = (ShaperSettings::default(), Model::Panda.limits());
        for _ in 0..2000 {
            let q = Joints::from_fn(|k, _| {
                let [least, most] = limits.0[k].range;
                random.random_range(least..most)
            });
            let strain = |q: &Joints| singularity::strain(&arm.shaped, limits, &shaper, q);
            let ours = Strain::at(&arm, &q, &ACCELERATIONS);
            assert!((ours.shares.max() / strain(&q) - 1.0).abs() < 1e-9);
            let dq = Joints::from_fn(|_, _| random.random_range(-0.5..0.5));
            let h = 1e-6;
            let seen = (strain(&(q + dq * h)) - strain(&(q - dq * h))) / (2.0 * h);
            let exact = (ours.gradient(&arm, ours.shares.imax()) * dq)[0];
            // Where shares are equal, the difference has two slopes.
            assert!(
                (seen - exact).abs() < 0.02 * (1.0 + exact.abs()),
                "{seen} {exact}"
            );
        }
    }
}
