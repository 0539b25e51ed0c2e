//! Paths in the space of the arm's joints, for goals that need another posture: a long turn of the
//! last joint, another elbow, a way out of a corner of the joints' ranges.
//!
//! Two trees of postures grow towards each other, one from where the arm is, one from postures that
//! show the goal. Every posture keeps to the arm's ranges, singular postures, walls and links, and
//! shows the whole pattern; so does every edge, in short steps. A search takes one cycle's time,
//! begins anew in the next, with other numbers, and remembers nothing. What it finds is a candidate
//! of foresight like all others: the law goes straight in the joints to the next place, by the
//! nearest twist that its constraints allow, and a simulated future tells whether it arrives.
//!
//! A posture must leave as much of all limits as is wanted, or as the posture before it left: so a
//! path leads out of what the arm must not enter. The pattern is taken to be at rest.
//!
//! Source: J. Kuffner and S. LaValle, "RRT-Connect: an efficient approach to single-query path
//! planning", ICRA 2000.

use core::f64::consts::PI;

use ::arm::ik::{ELBOW, posture};
use ::arm::{Arm, JOINTS, Joints, Limits, Pose, Slack};
use nalgebra::{Point3, Rotation3, Translation3, Vector3};
use serde::{Deserialize, Serialize};

use crate::obstacle::Obstacle;
use crate::prediction::InitialState;
use crate::random::uniform;
use crate::task::Task;
use crate::workspace::Workspace;
use crate::{MAX_POINTS, Points, camera, constraint, gate, motion};

/// Most places of a path.
pub const PLACES: usize = 32;
/// Distance between two places, rad or m, where there is room for as many.
const SPACING: f64 = 0.2;
/// Growth of the distance where there is not.
const WIDER: f64 = 1.25;

/// Most postures of a tree, and of a path before it is shortened.
const MOST: usize = 256;
/// Numbers of a posture in a tree: the joints, and the index of the one before.
const NUMBERS: usize = JOINTS + 1;
/// Numbers of workspace.
pub const ROOM: usize = 3 * MOST * NUMBERS;

/// Distance between two postures of an edge that are looked at, rad or m.
const STEP: f64 = 0.12;
/// Most Newton steps to a posture.
const NEWTON: usize = 20;
/// Every so many tries a posture at the goal is added.
const GOALS: u64 = 24;
/// Share of the work that shortens the path.
const SHORTENING: u64 = 3;

/// What a path leaves at least where the arm is not beyond it: more than the law keeps to, so that
/// it can follow.
const LEAST: Slack = Slack {
    joints: 0.05,
    strain: 0.05,
    space: 0.005,
};
/// The same of the clearance in the image, beside the law's, px.
const CLEAR_PX: f64 = 3.0;

/// Views that are drawn: the pattern's origin in the image, as shares of its size; depth, as a
/// share of that at the goal; tilt against the goal, rad.
const SHARES: [f64; 2] = [0.1, 0.9];
const DEPTHS: [f64; 2] = [0.5, 2.5];
const TILT: f64 = 0.6;
/// Of so many samples one searches for a posture from anywhere, and one near a known posture.
const KINDS: f64 = 6.0;
/// How far from a known posture a search for another begins, rad or m.
const NEAR: f64 = 0.6;
/// Range of a joint that has no end, rad or m.
const ENDLESS: [f64; 2] = [-PI, PI];

/// What a Newton step, a look at a posture, and a comparison with one cost, ns.
const NEWTON_NS: u64 = 1000;
const LOOK_NS: u64 = 1300;
const PAIR_NS: u64 = 12;
const NEAREST_NS: u64 = 6;

/// Postures to the goal, one after the other. Plain data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointPath {
    /// Places, 0 to [`PLACES`].
    pub count: u32,
    /// The pattern's points in the base of the arm, m.
    pattern: [[f64; 3]; MAX_POINTS],
    /// Joints at each place, base to flange, rad or m; the rest is zero.
    places: [[f32; JOINTS]; PLACES],
}

impl JointPath {
    /// No path.
    pub const NONE: Self = Self {
        count: 0,
        pattern: [[0.0; 3]; MAX_POINTS],
        places: [[0.0; JOINTS]; PLACES],
    };

    /// The posture where so many places are ahead, rad or m; `None` if there are not so many.
    pub fn posture(&self, ahead: u32) -> Option<Joints> {
        let place = self.count.checked_sub(ahead).filter(|_| ahead > 0)?;
        Some(Joints::from(
            self.places.get(place as usize)?.map(f64::from),
        ))
    }

    /// What the camera sees there, px, and the posture.
    pub fn target(&self, task: &Task, ahead: u32) -> Option<(Points, Joints)> {
        let q = self.posture(ahead)?;
        let camera = task.arm.as_ref()?.chain.pose(&q).inverse();
        let points = self.pattern.iter().take(task.pattern.len());
        let seen = points.map(|x| {
            let x = camera * Point3::from(*x);
            camera::project(&task.camera, x.coords.into())
        });
        Some((seen.collect::<Option<Points>>()?, q))
    }
}

/// What a posture leaves.
#[derive(Clone, Copy)]
struct Condition {
    slack: Slack,
    clear_px: f64,
}

impl Condition {
    /// Whether a step from here to `next` is allowed, where `least_px` is the clearance wanted.
    fn allows(&self, next: &Self, least_px: f64) -> bool {
        next.slack.is_at_least(&self.slack.min(&LEAST))
            && next.clear_px >= self.clear_px.min(least_px)
    }
}

/// Postures, each with the index of the one before; a root has its own.
struct Tree<'w> {
    nodes: &'w mut [[f64; NUMBERS]],
    count: usize,
}

impl Tree<'_> {
    fn get(&self, index: usize) -> Option<(Joints, usize)> {
        let [q @ .., parent] = self.nodes.get(index).filter(|_| index < self.count)?;
        Some((Joints::from_column_slice(q), *parent as usize))
    }

    /// Adds a posture; `None` without room.
    fn push(&mut self, q: &Joints, parent: usize) -> Option<usize> {
        let index = self.count;
        let [to @ .., before] = self.nodes.get_mut(index)?;
        to.copy_from_slice(q.as_slice());
        *before = parent as f64;
        self.count += 1;
        Some(index)
    }

    fn nearest(&self, limits: &Limits, to: &Joints) -> Option<usize> {
        let nodes = self.nodes.iter().take(self.count);
        let away = |[q @ .., _]: &[f64; NUMBERS]| -> f64 {
            let each = q.iter().zip(to.iter()).zip(&limits.0);
            let ways = each.map(|((from, to), joint)| joint.way(*from, *to));
            ways.map(|way| way * way).sum()
        };
        let all = nodes.map(away).enumerate();
        Some(all.min_by(|a, b| a.1.total_cmp(&b.1))?.0)
    }
}

/// One search.
pub(crate) struct Planner<'a> {
    task: &'a Task,
    arm: &'a Arm,
    /// The pattern's frame in the base.
    pattern: Pose,
    /// The camera at the goal, in the base.
    goal: Pose,
    /// Where the search begins.
    start: Joints,
    is_elbow_held: bool,
    least_px: f64,
    /// Work of a look at a posture, ns.
    look_ns: u64,
    /// The number that the next one to be drawn follows from.
    number: u64,
    /// Work that is left, ns.
    left: u64,
}

impl<'a> Planner<'a> {
    /// The search of this number from the pattern and the arm as they are, with a clearance of
    /// `margin_px` in the image and for so much work, ns. `None` where the arm or the pattern's
    /// pose is not known.
    pub fn new(
        task: &'a Task,
        initial: &InitialState,
        margin_px: f64,
        number: u64,
        work: u64,
    ) -> Option<Self> {
        let (arm, start) = (task.arm.as_ref()?, initial.q?);
        let seen = initial.pose(task)?;
        let rotation = Rotation3::from_matrix_unchecked(seen.rotation);
        let in_camera = Pose::from_parts(Translation3::from(seen.translation), rotation);
        let pattern = arm.chain.pose(&start) * in_camera;
        let at_goal = Pose::from_parts(
            Translation3::from(task.goal_pose.translation),
            Rotation3::from_matrix_unchecked(motion::rotation(task.goal_pose.rotation)),
        );
        let clearances: u32 = task.obstacles().map(Obstacle::price_ns).sum();
        let look_ns = LOOK_NS
            + PAIR_NS * arm.shapes.pairs.len() as u64
            + task.pattern.len() as u64 * u64::from(clearances);
        Some(Self {
            look_ns,
            task,
            arm,
            pattern,
            goal: pattern * at_goal.inverse(),
            start,
            is_elbow_held: arm.chain.count() == JOINTS && !arm.is_elbow_free,
            least_px: margin_px + CLEAR_PX,
            number: number << 32,
            left: work,
        })
    }

    /// Searches; `None` if it finds nothing.
    pub fn search(&mut self, workspace: &mut [f64]) -> Option<JointPath> {
        let mut room = Workspace(workspace);
        let mut tree = || {
            let nodes = room.arrays(MOST)?;
            Some(Tree { nodes, count: 0 })
        };
        let (mut out, mut back, mut path) = (tree()?, tree()?, tree()?);
        let reserve = self.left / SHORTENING;
        let start = self.start;
        out.push(&start, 0)?;
        self.condition(&start)?;
        let mut tries = 0;
        let (joined, joins) = loop {
            let is_full = out.count == MOST || back.count == MOST;
            if self.left <= reserve || is_full {
                return None;
            }
            tries += 1;
            if back.count == 0 || tries % GOALS == 0 {
                self.add_goal(&mut back);
                continue;
            }
            let (from, to) = match tries % 2 {
                0 => (&mut out, &mut back),
                _ => (&mut back, &mut out),
            };
            let Some(sample) = self.sample(from) else {
                continue;
            };
            let Some((reached, _)) = self.extend(from, &sample) else {
                continue;
            };
            let (new, _) = from.get(reached)?;
            if let Some((other, true)) = self.extend(to, &new) {
                break match tries % 2 {
                    0 => (reached, other),
                    _ => (other, reached),
                };
            }
        };
        join(&out, joined, &back, joins, &mut path)?;
        self.shorten(&mut path);
        self.places(&path)
    }

    /// Adds a posture at the goal, if the search from a random one finds it.
    fn add_goal(&mut self, back: &mut Tree) {
        let (begin, goal) = (self.anywhere(), self.goal);
        let Some(q) = self.posture(begin, &goal) else {
            return;
        };
        // Its scene was checked: the goal is in sight.
        let is_fit = |found: Condition| found.slack.is_at_least(&LEAST);
        if self.condition(&q).is_some_and(is_fit) {
            let _ = back.push(&q, back.count);
        }
    }

    /// Where a tree is to grow: towards a posture from which the camera sees the pattern, or any
    /// near one of its own, which costs little and leads out of corners.
    fn sample(&mut self, tree: &Tree) -> Option<Joints> {
        let kind = self.between([0.0, KINDS]);
        if kind < 1.0 {
            let (begin, camera) = (self.anywhere(), self.view());
            return self.posture(begin, &camera);
        }
        let index = self.between([0.0, tree.count as f64]) as usize;
        let (q, _) = tree.get(index)?;
        let mut near = q;
        for (k, joint) in near.iter_mut().enumerate() {
            if self.moves(k) {
                *joint += self.between([-NEAR, NEAR]);
            }
        }
        if kind < 2.0 {
            let camera = self.view();
            return self.posture(near, &camera);
        }
        Some(near)
    }

    /// A camera, in the base, that looks at the pattern.
    fn view(&mut self) -> Pose {
        let camera = &self.task.camera;
        let [u, v] = [camera.width, camera.height].map(|size| size * self.between(SHARES));
        let depth = self.task.goal_pose.translation[2] * self.between(DEPTHS);
        let [x, y] = camera::normalise(camera, [u, v]);
        let tilt = Vector3::new(
            self.between([-TILT, TILT]),
            self.between([-TILT, TILT]),
            0.0,
        );
        let roll = Vector3::z() * self.between([-PI, PI]);
        let goal = motion::rotation(self.task.goal_pose.rotation);
        let rotation =
            Rotation3::new(tilt) * Rotation3::new(roll) * Rotation3::from_matrix_unchecked(goal);
        let at = Translation3::new(x * depth, y * depth, depth);
        self.pattern * Pose::from_parts(at, rotation).inverse()
    }

    fn anywhere(&mut self) -> Joints {
        let (mut q, arm) = (self.start, self.arm);
        for (k, (joint, limits)) in q.iter_mut().zip(&arm.limits.0).enumerate() {
            if self.moves(k) {
                let is_endless = limits.is_endless();
                *joint = self.between(if is_endless { ENDLESS } else { limits.range });
            }
        }
        q
    }

    /// Whether a search moves the joint of this index.
    fn moves(&self, joint: usize) -> bool {
        joint < self.arm.chain.count() && (joint != ELBOW || !self.is_elbow_held)
    }

    fn posture(&mut self, begin: Joints, camera: &Pose) -> Option<Joints> {
        let chain = &self.arm.chain;
        let (found, steps) = posture(chain, begin, camera, self.is_elbow_held, NEWTON);
        self.spend(NEWTON_NS * (1 + steps as u64));
        found
    }

    /// What a posture leaves; `None` where the camera does not see the front of the pattern.
    fn condition(&mut self, q: &Joints) -> Option<Condition> {
        let task = self.task;
        self.spend(self.look_ns);
        let camera = self.arm.chain.pose(q).inverse() * self.pattern;
        let (mut points, mut clear_px) = (Points::new(), f64::INFINITY);
        for x in &task.pattern {
            let x = camera * Point3::from(*x);
            let pixel = camera::project(&task.camera, x.coords.into())?;
            let [u, v] = pixel;
            let border = u
                .min(v)
                .min(task.camera.width - u)
                .min(task.camera.height - v);
            let clear = border.min(constraint::least_clearance(task, pixel)) - task.radius(x.z);
            clear_px = clear_px.min(clear);
            points.extend([pixel]);
        }
        gate::is_from_front(task, &points).then(|| Condition {
            slack: Slack::at(self.arm, q, &task.acceleration),
            clear_px,
        })
    }

    /// Adds to a tree the steps from its nearest posture to `to`, as far as they are allowed. The
    /// last that was added, and whether it is `to`; `None` if there is none.
    fn extend(&mut self, tree: &mut Tree, to: &Joints) -> Option<(usize, bool)> {
        self.spend(NEAREST_NS * tree.count as u64);
        let mut at = tree.nearest(&self.arm.limits, to)?;
        let (mut q, _) = tree.get(at)?;
        let mut before = self.condition(&q)?;
        let mut added = None;
        loop {
            let way = self.way(&q, to);
            let is_there = way.norm() <= STEP;
            let next = match is_there {
                true => *to,
                false => q + way * (STEP / way.norm()),
            };
            let Some(condition) = self.condition(&next) else {
                return added;
            };
            if !before.allows(&condition, self.least_px) {
                return added;
            }
            let Some(new) = tree.push(&next, at) else {
                return added;
            };
            added = Some((new, is_there));
            if is_there {
                return added;
            }
            (at, q, before) = (new, next, condition);
        }
    }

    /// Whether the straight way between two postures is allowed.
    fn is_straight(&mut self, from: &Joints, to: &Joints) -> bool {
        let Some(mut before) = self.condition(from) else {
            return false;
        };
        let way = self.way(from, to);
        let steps = libm::ceil(way.norm() / STEP).max(1.0) as u32;
        (1..=steps).all(|k| {
            let q = from + way * (f64::from(k) / f64::from(steps));
            let next = self.condition(&q);
            let is_allowed = next.is_some_and(|next| before.allows(&next, self.least_px));
            before = next.unwrap_or(before);
            is_allowed
        })
    }

    /// Leaves out what lies between two postures with a straight way, until the work is done.
    fn shorten(&mut self, path: &mut Tree) {
        while self.left > 0 && path.count > 2 {
            let [a, b] = [0, 1].map(|_| self.between([0.0, path.count as f64]) as usize);
            let (first, last) = (a.min(b), a.max(b));
            let (Some((from, _)), Some((to, _))) = (path.get(first), path.get(last)) else {
                return;
            };
            // A short way costs little: so this ends.
            self.spend(LOOK_NS);
            if last - first > 1 && self.is_straight(&from, &to) {
                path.nodes.copy_within(last..path.count, first + 1);
                path.count -= last - first - 1;
            }
        }
    }

    /// The places of a path, without where it begins; `None` if there are none or too many corners.
    fn places(&self, path: &Tree) -> Option<JointPath> {
        let ways = |k: usize| Some((path.get(k)?.0, path.get(k + 1)?.0));
        let all = || (0..path.count.saturating_sub(1)).filter_map(ways);
        let parts = |(from, to): &(Joints, Joints), spacing: f64| {
            libm::ceil(self.way(from, to).norm() / spacing).max(1.0) as usize
        };
        let mut spacing = SPACING;
        while all().map(|way| parts(&way, spacing)).sum::<usize>() > PLACES {
            if all().count() > PLACES {
                return None;
            }
            spacing *= WIDER;
        }
        let mut found = JointPath::NONE;
        let points = found.pattern.iter_mut().zip(&self.task.pattern);
        points.for_each(|(to, x)| *to = (self.pattern * Point3::from(*x)).coords.into());
        let mut places = found.places.iter_mut();
        for way in all() {
            let (from, to) = way;
            let parts = parts(&way, spacing);
            for k in 1..=parts {
                let q = from + self.way(&from, &to) * (k as f64 / parts as f64);
                let place = places.next()?;
                place
                    .iter_mut()
                    .zip(q.iter())
                    .for_each(|(to, q)| *to = *q as f32);
                found.count += 1;
            }
        }
        (found.count > 0).then_some(found)
    }

    fn way(&self, from: &Joints, to: &Joints) -> Joints {
        self.arm.limits.way(from, to)
    }

    fn between(&mut self, [least, most]: [f64; 2]) -> f64 {
        self.number += 1;
        least + (most - least) * uniform(self.number)
    }

    fn spend(&mut self, work: u64) {
        self.left = self.left.saturating_sub(work);
    }

    /// Work that is left, ns.
    pub fn left(&self) -> u64 {
        self.left
    }
}

/// Writes the path out of one tree and back through the other; `None` if it is too long.
fn join(out: &Tree, joined: usize, back: &Tree, joins: usize, path: &mut Tree) -> Option<()> {
    // From where they meet to the root, then turned round.
    let mut at = joined;
    loop {
        let (q, parent) = out.get(at)?;
        path.push(&q, 0)?;
        if parent == at {
            break;
        }
        at = parent;
    }
    path.nodes.get_mut(..path.count)?.reverse();
    // Both have the posture where they meet.
    let (_, mut at) = back.get(joins)?;
    if at == joins {
        return Some(());
    }
    loop {
        let (q, parent) = back.get(at)?;
        path.push(&q, 0)?;
        if parent == at {
            return Some(());
        }
        at = parent;
    }
}

#[cfg(test)]
mod tests {
    use scene::Scene;

    use super::*;
    use crate::prediction::Model;

    const MARGIN_PX: f64 = 8.0;

    fn task() -> Task {
        let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../ipc/scene/scenes/s.toml");
        let text = std::format!("arm = \"panda.toml\"\n{}", scene::PAPER_ROBOT);
        let mut scene = Scene::parse(&text, shipped).unwrap();
        (
            scene.limits.linear_acceleration,
            scene.limits.angular_acceleration,
        ) = (Some(0.5), Some(1.2));
        Task::new(&scene).unwrap()
    }

    /// What the camera sees with joint 7 at `at` of an object that is at the goal when joint 7 is at
    /// -2.1 rad.
    fn seen(task: &Task, at: f64) -> InitialState {
        let arm = task.arm.as_ref().unwrap();
        let turned = |at: f64| {
            let mut q = Joints::from(::arm::READY);
            q[6] = at;
            q
        };
        let from_goal = arm.chain.pose(&turned(at)).inverse() * arm.chain.pose(&turned(-2.1));
        let goal = Pose::from_parts(
            Translation3::from(task.goal_pose.translation),
            Rotation3::new(Vector3::from(task.goal_pose.rotation)),
        );
        let object = from_goal * goal;
        let points = task.pattern.iter().map(|x| {
            let x = object * Point3::from(*x);
            camera::project(&task.camera, x.coords.into()).unwrap()
        });
        let points: Points = points.collect();
        InitialState::new(task, Model::Pose, &points).with_joints(Some(turned(at)))
    }

    fn clear_px(task: &Task, points: &Points) -> f64 {
        let each = points.iter().map(|p| constraint::least_clearance(task, *p));
        each.fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn a_path_keeps_to_the_arm_and_the_sight_and_ends_at_the_goal() {
        let task = task();
        let arm = task.arm.as_ref().unwrap();
        let initial = seen(&task, 2.5);
        let least_px = MARGIN_PX.min(clear_px(&task, &initial.points) - 0.1);
        let mut found = 0;
        for number in 0..40 {
            let mut room = std::vec![0.0; ROOM];
            let work = 20_000_000;
            let mut planner = Planner::new(&task, &initial, MARGIN_PX, number, work).unwrap();
            let Some(path) = planner.search(&mut room) else {
                continue;
            };
            found += 1;
            let mut before = initial.q.unwrap();
            for ahead in (1..=path.count).rev() {
                let (points, q) = path.target(&task, ahead).unwrap();
                // Not the grown steps, but finer ones.
                for k in 0..=20 {
                    let between = before + (q - before) * (f64::from(k) / 20.0);
                    let slack = Slack::at(arm, &between, &task.acceleration);
                    assert!(slack.joints > 0.0 && slack.strain > 0.0 && slack.space > 0.0);
                }
                assert!(clear_px(&task, &points) > least_px);
                before = q;
            }
            let (points, _) = path.target(&task, 1).unwrap();
            let missed = crate::features::largest_error(&points, &task.goal);
            assert!(missed < 0.01, "{missed}");
            assert_eq!(path.target(&task, 0), None);
            assert_eq!(path.posture(path.count + 1), None);
        }
        assert!(found >= 20, "{found}");
    }

    #[test]
    fn a_path_goes_over_the_end_of_an_endless_joints_turn() {
        let mut task = task();
        let arm = task.arm.as_mut().unwrap();
        arm.limits.0[6].range = ::arm::JointLimits::NONE.range;
        let limits = arm.limits;
        // 1.7 rad this way round, 4.6 rad the other.
        let initial = seen(&task, 2.5);
        let mut found = 0;
        for number in 0..10 {
            let mut room = std::vec![0.0; ROOM];
            let work = 20_000_000;
            let mut planner = Planner::new(&task, &initial, MARGIN_PX, number, work).unwrap();
            let Some(path) = planner.search(&mut room) else {
                continue;
            };
            found += 1;
            let (mut before, mut turned) = (initial.q.unwrap(), 0.0);
            for ahead in (1..=path.count).rev() {
                let q = path.posture(ahead).unwrap();
                let way = limits.way(&before, &q);
                assert!(way.amax() < 0.5, "{way}");
                (before, turned) = (q, turned + way[6]);
            }
            // Whichever way round, it ends where joint 7 is at -2.1 rad or at a turn from there,
            // or at another posture that shows the goal.
            assert!(turned.abs() < 3.0, "{number}: {turned}");
        }
        assert!(found >= 5, "{found}");
    }

    #[test]
    fn a_search_ends_with_its_work() {
        let task = task();
        let initial = seen(&task, 2.5);
        for work in [0, 1, 100_000, 3_000_000] {
            let mut room = std::vec![0.0; ROOM];
            let mut planner = Planner::new(&task, &initial, MARGIN_PX, 1, work).unwrap();
            let found = planner.search(&mut room);
            assert!(found.is_some() || planner.left() <= work / SHORTENING);
        }
        let without = initial.with_joints(None);
        assert!(Planner::new(&task, &without, MARGIN_PX, 1, 1).is_none());
    }
}
