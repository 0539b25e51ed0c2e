//! A planner in pose space for starts that the controller leaves stuck: two rapidly exploring
//! random trees, one from the start and one from the goal, joined, shortened, and the shortest of a
//! few such paths taken, so that neighbouring starts get similar paths.
//!
//! Source: J. Kuffner and S. LaValle, "RRT-Connect", ICRA 2000. The paper names a planner as its
//! future work.

use nalgebra::{Rotation3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use scene::{Pose, Scene};
use vpc::features::largest_distance;
use vpc::{Points, Task, constraint};

use crate::start;

/// Paths planned, of which the shortest is kept.
const ATTEMPTS: usize = 4;
/// Nodes of both trees together before an attempt is given up.
const MAX_NODES: usize = 3000;
/// Random shortcuts tried on a path.
const SHORTCUTS: usize = 150;
/// Longest extension of a tree, in the metric of [`Node::distance`].
const EXTENSION: f64 = 0.25;
/// Image motion between two checked poses, share of the image width.
const RESOLUTION: f64 = 0.008;
/// Clearance that a path keeps where start and goal do, share of the image width.
const CLEARANCE: f64 = 0.012;

/// A pose of the object in the camera frame.
#[derive(Clone, Copy, Debug)]
struct Node {
    rotation: Rotation3<f64>,
    translation: Vector3<f64>,
}

impl Node {
    fn from_pose(pose: &Pose) -> Self {
        Self {
            rotation: Rotation3::new(Vector3::from(pose.rotation)),
            translation: Vector3::from(pose.translation),
        }
    }

    fn pose(&self) -> Pose {
        Pose {
            translation: self.translation.into(),
            rotation: self.rotation.scaled_axis().into(),
        }
    }

    /// Translation in units of the mean depth plus rotation in rad: both as image motion over the
    /// focal length.
    fn distance(&self, other: &Self) -> f64 {
        self.shift(other) + self.rotation.angle_to(&other.rotation)
    }

    /// The part of the distance that comes from the translations.
    fn shift(&self, other: &Self) -> f64 {
        let depth = 0.5 * (self.translation.z + other.translation.z);
        (self.translation - other.translation).norm() / depth
    }

    /// The pose at `share` of the way to `other`.
    fn towards(&self, other: &Self, share: f64) -> Self {
        let turn = (self.rotation.inverse() * other.rotation).scaled_axis();
        Self {
            rotation: self.rotation * Rotation3::new(turn * share),
            translation: self.translation.lerp(&other.translation, share),
        }
    }
}

/// What makes a pose or a motion valid.
struct Space<'a> {
    task: &'a Task,
    clearance: f64,
}

impl Space<'_> {
    fn features(&self, node: &Node) -> Option<Points> {
        let points = self.task.features_at(&node.pose())?;
        radii(self.task, node)
            .zip(&points)
            .all(|(radius, &pixel)| {
                let least = self.clearance + radius;
                constraint::border_clearance(self.task, pixel) >= least
                    && constraint::least_clearance(self.task, pixel) >= least
            })
            .then_some(points)
    }

    /// The features along the motion from `a` (left out) to `b`, none of them further than the
    /// resolution from the one before; `None` where the motion is not clear.
    fn motion(&self, a: &Node, b: &Node) -> Option<Vec<Points>> {
        let (first, last) = (self.task.features_at(&a.pose())?, self.features(b)?);
        let resolution = RESOLUTION * self.task.camera.width;
        let count = (1.5 * largest_distance(&first, &last) / resolution)
            .ceil()
            .max(1.0) as usize;
        (1..=count)
            .map(|i| self.features(&a.towards(b, i as f64 / count as f64)))
            .collect()
    }
}

/// The radius of each marker, px.
fn radii(task: &Task, node: &Node) -> impl Iterator<Item = f64> {
    let points = task.pattern.iter();
    points.map(|&p| task.radius((node.rotation * Vector3::from(p) + node.translation).z))
}

/// A tree of poses; each node but the root has a parent.
struct Tree {
    nodes: Vec<(Node, usize)>,
}

impl Tree {
    fn nearest(&self, target: &Node) -> usize {
        let (mut nearest, mut least) = (0, f64::INFINITY);
        for (index, (node, _)) in self.nodes.iter().enumerate() {
            // Most are too far away by the translation alone, which costs a tenth.
            if node.shift(target) < least {
                let distance = node.distance(target);
                if distance < least {
                    (nearest, least) = (index, distance);
                }
            }
        }
        nearest
    }

    /// Extends the tree towards a pose once; the index of the new node, and whether it is the pose
    /// itself.
    fn extend(&mut self, space: &Space<'_>, target: &Node) -> Option<(usize, bool)> {
        let parent = self.nearest(target);
        let from = self.nodes[parent].0;
        let distance = from.distance(target);
        let reaches = distance <= EXTENSION;
        let node = if reaches {
            *target
        } else {
            from.towards(target, EXTENSION / distance)
        };
        space.motion(&from, &node)?;
        self.nodes.push((node, parent));
        Some((self.nodes.len() - 1, reaches))
    }

    /// From the node back to the root.
    fn branch(&self, mut index: usize) -> Vec<Node> {
        let mut branch = vec![self.nodes[index].0];
        while index != 0 {
            index = self.nodes[index].1;
            branch.push(self.nodes[index].0);
        }
        branch
    }
}

/// A path of features from a start to the goal, finely sampled and clear; `None` where none was
/// found.
pub fn path(scene: &Scene, task: &Task, start: &Pose, rng: &mut ChaCha8Rng) -> Option<Vec<Points>> {
    let (root, goal) = (Node::from_pose(start), Node::from_pose(&scene.goal));
    let clear = |node: &Node| -> Option<f64> {
        let points = task.features_at(&node.pose())?;
        radii(task, node)
            .zip(&points)
            .map(|(radius, &p)| {
                let border = constraint::border_clearance(task, p);
                border.min(constraint::least_clearance(task, p)) - radius
            })
            .min_by(f64::total_cmp)
    };
    let clearance = (CLEARANCE * task.camera.width)
        .min(clear(&root)?)
        .min(clear(&goal)?);
    let space = Space { task, clearance };
    let length = |path: &[Node]| {
        path.windows(2)
            .map(|pair| pair[0].distance(&pair[1]))
            .sum::<f64>()
    };
    let shortest = (0..ATTEMPTS)
        .filter_map(|_| {
            let path = connect(scene, &space, &root, &goal, rng)?;
            Some(shorten(&space, path, rng))
        })
        .min_by(|a, b| length(a).total_cmp(&length(b)))?;
    let pieces: Option<Vec<Vec<Points>>> = shortest
        .windows(2)
        .map(|pair| space.motion(&pair[0], &pair[1]))
        .collect();
    Some(pieces?.concat())
}

fn connect(
    scene: &Scene,
    space: &Space<'_>,
    start: &Node,
    goal: &Node,
    rng: &mut ChaCha8Rng,
) -> Option<Vec<Node>> {
    let mut trees = [
        Tree {
            nodes: vec![(*start, 0)],
        },
        Tree {
            nodes: vec![(*goal, 0)],
        },
    ];
    let mut side = 0;
    for _ in 0..10 * MAX_NODES {
        if trees[0].nodes.len() + trees[1].nodes.len() > MAX_NODES {
            return None;
        }
        let target = if rng.random::<f64>() < 0.1 {
            trees[1 - side].nodes[0].0
        } else {
            Node::from_pose(&start::draw(scene, rng))
        };
        if let Some((reached, _)) = trees[side].extend(space, &target) {
            let node = trees[side].nodes[reached].0;
            while let Some((met, arrived)) = trees[1 - side].extend(space, &node) {
                if arrived {
                    let mut path = trees[side].branch(reached);
                    path.reverse();
                    path.extend(trees[1 - side].branch(met).into_iter().skip(1));
                    if side == 1 {
                        path.reverse();
                    }
                    return Some(path);
                }
            }
        }
        side = 1 - side;
    }
    None
}

/// Replaces stretches of a path by straight motions where those are clear and shorter.
fn shorten(space: &Space<'_>, mut path: Vec<Node>, rng: &mut ChaCha8Rng) -> Vec<Node> {
    for _ in 0..SHORTCUTS {
        if path.len() < 2 {
            break;
        }
        // Two random places on the path: a piece, and how far along it.
        let pieces = path.len() - 1;
        let mut places = [(); 2].map(|()| {
            (
                rng.random_range(0..pieces as u64) as usize,
                rng.random::<f64>(),
            )
        });
        places.sort_by(|a, b| (a.0 as f64 + a.1).total_cmp(&(b.0 as f64 + b.1)));
        let [(i, s), (j, t)] = places;
        let (a, b) = (
            path[i].towards(&path[i + 1], s),
            path[j].towards(&path[j + 1], t),
        );
        let between: f64 = if i == j {
            continue;
        } else {
            a.distance(&path[i + 1])
                + path[i + 1..=j]
                    .windows(2)
                    .map(|pair| pair[0].distance(&pair[1]))
                    .sum::<f64>()
                + path[j].distance(&b)
        };
        if a.distance(&b) < between - 1e-9 && space.motion(&a, &b).is_some() {
            path.splice(i + 1..=j, [a, b]);
        }
    }
    path
}
