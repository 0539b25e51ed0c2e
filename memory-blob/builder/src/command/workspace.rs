//! What an arm reaches of a scene, from the side and from above, for the preview.

use figures::Reach as View;
use memory_builder::reach::Reach;
use nalgebra::{Point3, Vector3};
use scene::{Pose, Scene, Wall};

/// Side of the squares in which the reach is drawn, m.
const SQUARE: f64 = 0.02;
/// Room about all that is shown, m.
const ROOM: f64 = 0.15;

/// Two views in the arm's base: along the horizontal axis across the goal, and down the vertical.
/// Each shows what the camera reaches in the plane of its goal, turned as there; and each start with
/// whether the arm reaches it.
pub fn views(scene: &Scene, reach: &Reach, starts: &[(Pose, bool)]) -> [View; 2] {
    let camera = reach.camera(&scene.goal).translation.vector;
    // The further away along an axis the goal is, the more of the arm is seen.
    let ahead = usize::from(camera.y.abs() > camera.x.abs());
    [("side", [ahead, 2], 1 - ahead), ("above", [0, 1], 2)].map(|(name, axes, through)| {
        // A zero without a sign.
        let place = (100.0 * camera[through]).round() / 100.0 + 0.0;
        View {
            title: format!("{name}: reach at {} = {place:.2} m", NAMES[through]),
            ..view(scene, reach, starts, axes)
        }
    })
}

const NAMES: [&str; 3] = ["x", "y", "z"];

fn view(scene: &Scene, reach: &Reach, starts: &[(Pose, bool)], axes: [usize; 2]) -> View {
    let flat = |place: Vector3<f64>| axes.map(|axis| place[axis]);
    let goal = reach.camera(&scene.goal);
    let arm: Vec<[f64; 2]> = reach.places().map(flat).collect();
    let object = reach.object();
    let pattern = scene.pattern.iter().chain(scene.pattern.first());
    let pattern: Vec<_> = pattern
        .map(|point| flat((object * Point3::from(*point)).coords))
        .collect();
    let starts: Vec<_> = starts
        .iter()
        .map(|(pose, is_reached)| (flat(reach.camera(pose).translation.vector), *is_reached))
        .collect();
    let shown = arm.iter().chain(&pattern);
    let shown = shown.chain(starts.iter().map(|(place, _)| place));
    let mut window = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    for place in shown {
        for k in 0..2 {
            window[0][k] = window[0][k].min(place[k] - ROOM);
            window[1][k] = window[1][k].max(place[k] + ROOM);
        }
    }
    let placed = |[a, b]: [f64; 2]| {
        let mut camera = goal;
        (
            camera.translation.vector[axes[0]],
            camera.translation.vector[axes[1]],
        ) = (a, b);
        camera
    };
    let walls = scene.arm.iter().flat_map(|arm| {
        arm.walls.iter().enumerate().filter_map(|(i, wall)| {
            let corners = beyond(wall, axes, &goal.translation.vector, window);
            let name = arm.wall_names.get(i).map_or("", |name| name.as_str());
            (!corners.is_empty()).then(|| (corners, name.to_owned()))
        })
    });
    View {
        axes: axes.map(|axis| NAMES[axis]),
        window,
        reached: squares(window, |place| reach.includes_camera(&placed(place))),
        walls: walls.collect(),
        arm,
        sight: sight(scene, &goal, flat),
        pattern,
        starts,
        title: String::new(),
    }
}

/// Squares of a window that are in something, joined along each row.
fn squares([low, high]: [[f64; 2]; 2], is_in: impl Fn([f64; 2]) -> bool) -> Vec<[f64; 4]> {
    let mut all: Vec<[f64; 4]> = Vec::new();
    let [columns, rows] = [0, 1].map(|k| ((high[k] - low[k]) / SQUARE).ceil() as usize);
    let edge = |k: usize, i: usize| low[k] + i as f64 * SQUARE;
    for j in 0..rows {
        for i in 0..columns {
            if !is_in([edge(0, i) + 0.5 * SQUARE, edge(1, j) + 0.5 * SQUARE]) {
                continue;
            }
            let (left, lower) = (edge(0, i), edge(1, j));
            match all.last_mut() {
                Some(last) if last[2] == left && last[1] == lower => last[2] = edge(0, i + 1),
                _ => all.push([left, lower, edge(0, i + 1), edge(1, j + 1)]),
            }
        }
    }
    all
}

/// The edges of what the camera sees at the goal down to the pattern's distance.
fn sight(
    scene: &Scene,
    goal: &arm::Pose,
    flat: impl Fn(Vector3<f64>) -> [f64; 2],
) -> Vec<[[f64; 2]; 2]> {
    let camera = &scene.camera;
    let depth = scene.goal.translation[2];
    let corner = |u: f64, v: f64| {
        let ray = Point3::new(
            (u - camera.cx) / camera.fx,
            (v - camera.cy) / camera.fy,
            1.0,
        );
        flat((goal * (ray * depth)).coords)
    };
    let (w, h) = (camera.width, camera.height);
    let corners = [
        corner(0.0, 0.0),
        corner(w, 0.0),
        corner(w, h),
        corner(0.0, h),
    ];
    let apex = flat(goal.translation.vector);
    let edges = (0..4).flat_map(|k| [[apex, corners[k]], [corners[k], corners[(k + 1) % 4]]]);
    edges.collect()
}

/// The part of a window beyond a wall, in the plane through `place` that a view shows; no corners
/// where there is none.
fn beyond(
    wall: &Wall,
    axes: [usize; 2],
    place: &Vector3<f64>,
    [low, high]: [[f64; 2]; 2],
) -> Vec<[f64; 2]> {
    let depth = |corner: &[f64; 2]| {
        let mut at = *place;
        (at[axes[0]], at[axes[1]]) = (corner[0], corner[1]);
        wall.offset - Vector3::from(wall.normal).dot(&at)
    };
    let corners = [low, [high[0], low[1]], high, [low[0], high[1]]];
    let mut inside = Vec::new();
    for (i, a) in corners.iter().enumerate() {
        let b = &corners[(i + 1) % corners.len()];
        let (from, to) = (depth(a), depth(b));
        if from > 0.0 {
            inside.push(*a);
        }
        if (from > 0.0) != (to > 0.0) {
            let share = from / (from - to);
            inside.push([0, 1].map(|k| a[k] + share * (b[k] - a[k])));
        }
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's robot scene with a Panda ready at the goal, over a table.
    fn scene() -> Scene {
        let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../ipc/scene/scenes/s.toml");
        let text = format!("arm = \"panda.toml\"\n{}", scene::PAPER_ROBOT);
        let mut scene = Scene::parse(&text, beside).unwrap();
        let described = scene.arm.as_mut().unwrap();
        described.goal.extend(arm::READY);
        let (normal, offset) = ([0.0, 0.0, 1.0], 0.2);
        described.walls.push(Wall { normal, offset }).unwrap();
        scene
    }

    #[test]
    fn the_side_shows_the_table_and_a_reach_above_it() {
        let scene = scene();
        let reach = Reach::of(&scene).unwrap();
        let [side, above] = views(&scene, &reach, &[(scene.goal, true)]);
        assert_eq!((side.axes, above.axes), (["x", "z"], ["x", "y"]));
        // At the goal; not below the table, nor farther away than the arm is long.
        let is_in = |view: &View, [x, y]: [f64; 2]| {
            let within = |[left, low, right, up]: &[f64; 4]| {
                (*left..=*right).contains(&x) && (*low..=*up).contains(&y)
            };
            view.reached.iter().any(within)
        };
        let (goal, _) = side.starts[0];
        assert!(is_in(&side, goal) && is_in(&above, above.starts[0].0));
        assert!(!is_in(&side, [goal[0], 0.15]));
        assert!(
            side.reached
                .iter()
                .all(|[_, low, right, _]| *low > 0.15 && *right < 1.2)
        );
        // The view from above is of a plane that the table does not cut.
        assert!(above.walls.is_empty());
        let (corners, _) = &side.walls[0];
        assert!(corners.iter().all(|[_, z]| *z <= 0.2 + 1e-9), "{corners:?}");
        // Base and camera.
        assert_eq!(side.arm[0], [0.0, 0.0]);
        let apart = (0..2).map(|k| side.arm.last().unwrap()[k] - goal[k]);
        assert!(apart.map(f64::abs).sum::<f64>() < 1e-9);
        // It sees the pattern below it.
        assert!(side.sight.iter().all(|[_, [_, z]]| *z < goal[1] - 0.2));
    }
}
