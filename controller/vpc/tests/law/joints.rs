//! An arm that carries the camera: its joints keep within their ranges whatever the law is shown,
//! and futures go no farther than it does.

use arm::{Arm, Chain, JOINTS, Joints, Model, Pose, READY};
use nalgebra::{Point3, Rotation3, Translation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::Scene;
use vpc::arm::Cause;
use vpc::guide::{Guide, Kind};
use vpc::{Law, Measurement, Refusal, Settings, Step, Strategy};

use crate::world::{is_long, taken};

const PERIOD_NS: u64 = 33_333_333;

/// The paper's robot scene at ten times its speed, with the shipped Panda or a free camera.
fn scene(knows_arm: bool) -> Scene {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../ipc/scene/scenes/s.toml");
    let key = if knows_arm {
        "arm = \"panda.toml\"\n"
    } else {
        ""
    };
    let text = format!("{key}{}", scene::PAPER_ROBOT);
    let mut scene = Scene::parse(&text, shipped).unwrap();
    (scene.limits.linear, scene.limits.angular) = (0.1, 0.3);
    scene
}

/// The arm of the scene.
fn panda() -> Arm {
    Arm::from(&scene(true).arm.unwrap())
}

fn law(scene: &Scene, strategy: Strategy) -> Law<Vec<f64>> {
    let settings = Settings {
        strategy,
        step_s: 0.4,
        ..Settings::default()
    };
    Law::new(scene, settings, |len| vec![0.0; len]).unwrap()
}

/// How much a joint at least has left to the ends of its range, rad.
fn room(arm: &Arm, q: &Joints) -> f64 {
    let room = |k: usize| {
        arm.limits.0[k]
            .room(q[k])
            .into_iter()
            .fold(f64::INFINITY, f64::min)
    };
    (0..JOINTS).map(room).fold(f64::INFINITY, f64::min)
}

/// The least distance of the arm's links, m.
fn between(arm: &Arm, q: &Joints) -> f64 {
    let each = arm.distances(q).map(|(_, distance)| distance);
    each.fold(f64::INFINITY, f64::min)
}

/// Inputs of each test that draws them: `VPC_LONG=1` a million.
fn inputs() -> usize {
    if is_long() { 1_000_000 } else { 6_000 }
}

#[test]
fn whatever_the_law_is_shown_no_command_leads_a_joint_out_of_its_range() {
    // In few cycles, too, this seed leads to the ends of ranges, to the table and to other links.
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let mut scene = scene(true);
    let table = scene::Wall {
        normal: [0.0, 0.0, 1.0],
        offset: 0.1,
    };
    scene.arm.as_mut().unwrap().walls.push(table).unwrap();
    let arm = panda();
    let (mut nearest, mut lowest, mut bound) = (f64::INFINITY, f64::INFINITY, 0);
    let (mut apart, mut close) = (f64::INFINITY, 0);
    for strategy in [Strategy::Previous, Strategy::Foresight, Strategy::Ibvs] {
        let mut law = law(&scene, strategy);
        let (mut q, mut target) = (Joints::from(READY), [[0.0; 2]; 4]);
        let mut is_apart = true;
        for k in 0..inputs() / 3 {
            if k % 40 == 0 {
                // Anywhere within the ranges; and another picture to run after.
                q = Joints::from_fn(|k, _| {
                    let [least, most] = arm.limits.0[k].range;
                    random.random_range(least + arm.margin..most - arm.margin)
                });
                let [u, v] = [
                    random.random_range(150.0..450.0),
                    random.random_range(100.0..300.0),
                ];
                let size = random.random_range(20.0..120.0);
                target = [[u, v], [u + size, v], [u + size, v + size], [u, v + size]];
                is_apart = between(&arm, &q) > arm.shapes.clearance;
                law.reset();
                law.sent(&[0.0; 6], k as u64 * PERIOD_NS);
            }
            let camera = arm.chain.pose(&q);
            if camera.translation.z < 0.1 || !is_apart {
                continue;
            }
            let now_ns = k as u64 * PERIOD_NS;
            let noise = |x: f64, random: &mut ChaCha8Rng| x + random.random_range(-8.0..8.0);
            let points = target.map(|p| p.map(|x| noise(x, &mut random)));
            law.see_joints(q.as_slice(), now_ns);
            let measured = Measurement::from_points(&points).taken(now_ns, now_ns);
            let Ok(step) = law.step(&measured, None) else {
                law.sent(&[0.0; 6], now_ns);
                continue;
            };
            law.sent(&step.twist, now_ns);
            law.sent_elbow(step.elbow);
            if k % 8 == 0 {
                law.think(None);
            }
            // A robot that obeys at once, a millisecond at a time.
            for _ in 0..33 {
                q = arm.moved(&q, &step.twist, step.elbow, 1e-3);
            }
            let left = room(&arm, &q);
            bound += usize::from(left < 1.05 * arm.margin);
            nearest = nearest.min(left);
            lowest = lowest.min(arm.chain.pose(&q).translation.z);
            apart = apart.min(between(&arm, &q));
            close += usize::from(between(&arm, &q) < 1.5 * arm.shapes.clearance);
        }
    }
    // Where a posture turns singular on the way, braking takes a part of the margin.
    assert!(nearest > 0.6 * arm.margin, "{nearest} rad left");
    assert!(lowest > 0.097, "{lowest} m above the base");
    let clearance = arm.shapes.clearance;
    assert!(apart > 0.8 * clearance, "{apart} m between links");
    assert!(1_500 * close > inputs(), "{close}");
    // The bounds were needed.
    assert!(300 * bound > inputs(), "{bound}");
}

#[test]
fn a_start_whose_way_ends_at_a_joint_arrives_where_the_law_knows_the_arm() {
    // The camera starts high above the object.
    let object = object();
    let arm = panda();
    let drawn = |random: &mut ChaCha8Rng| loop {
        let mut place = || random.random_range(-1.0..1.0);
        let q = Joints::from_fn(|k, _| READY[k] + 0.5 * place());
        let camera = arm.chain.pose(&q);
        if room(&arm, &q) > 0.3 && is_in_sight(&scene(false), &(camera.inverse() * object)) {
            return q;
        }
    };
    let mut random = ChaCha8Rng::seed_from_u64(6);
    let starts: Vec<Joints> = (0..12).map(|_| drawn(&mut random)).collect();
    let numbers = taken(&[1], 0..starts.len());
    let [without, with] = [false, true].map(|knows| {
        let scene = scene(knows);
        let mut law = law(&scene, Strategy::Foresight);
        let arrives = |number: &&usize| {
            law.reset();
            arrives(&mut law, &scene, &arm, &object, starts[**number], 20.0)
        };
        numbers.iter().filter(arrives).count()
    });
    let most_lost = numbers.len() / 12;
    assert!(
        with + most_lost >= numbers.len() && with > without,
        "{without} {with}"
    );
}

#[test]
fn arms_with_four_and_five_joints_arrive_where_the_law_knows_what_they_cannot_do() {
    let tests = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests");
    let seconds = if is_long() { 20.0 } else { 8.0 };
    // From these few, an arm that the law does not know stays behind.
    for (file, few) in [("five.toml", 3), ("scara.toml", 5)] {
        let mut scene = Scene::read(&tests.join("scenes").join(file)).unwrap();
        let described = scene.arm.take().unwrap();
        let arm = Arm::from(&described);
        let at_goal = arm::joints(&described.goal);
        let object = arm.chain.pose(&at_goal) * goal(&scene);
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let mut drawn = || loop {
            let q = Joints::from_fn(|k, _| match k < arm.chain.count() {
                true => at_goal[k] + random.random_range(-0.4..0.4),
                false => 0.0,
            });
            if is_in_sight(&scene, &(arm.chain.pose(&q).inverse() * object)) {
                return q;
            }
        };
        let starts: Vec<Joints> = (0..8).map(|_| drawn()).collect();
        let all_arrive = [Some(described), None].map(|told| {
            scene.arm = told;
            let mut law = law(&scene, Strategy::Foresight);
            let arrives = |number: usize| {
                law.reset();
                arrives(&mut law, &scene, &arm, &object, starts[number], seconds)
            };
            taken(&[few], 0..starts.len()).into_iter().all(arrives)
        });
        assert_eq!(all_arrive, [true, false], "{file}");
    }
}

#[test]
fn a_path_in_the_joints_leads_out_of_corners() {
    let (arm, scene) = (panda(), scene(true));
    let mut law = law(&scene, Strategy::Foresight);
    // From searches for starts at the ends of ranges: joint 7 must turn the long way, which only
    // such a path does; joint 2 is in its margin, out of which a refined way leads as well.
    let starts = [
        (
            true,
            [0.8181, 0.3634, -0.1536, -1.2315, -0.1924, 1.2493, -2.7790],
        ),
        (
            false,
            [0.1959, -1.6083, 0.2638, -2.2543, -0.0948, 1.0303, 1.1995],
        ),
    ];
    for (is_lost, q) in starts.into_iter().take(if is_long() { 2 } else { 1 }) {
        law.reset();
        assert!(arrives(&mut law, &scene, &arm, &object(), q.into(), 60.0));
        let state = law.state();
        assert_eq!(
            (state.searches > 0, state.path.count > 0),
            (is_lost, is_lost)
        );
    }
}

#[test]
fn only_foresight_goes_along_a_path_in_the_joints() {
    let (arm, scene) = (panda(), scene(true));
    let mut law = law(&scene, Strategy::Foresight);
    let mut q = Joints::from([0.8181, 0.3634, -0.1536, -1.2315, -0.1924, 1.2493, -2.7790]);
    let step = |law: &mut Law<_>, q: &Joints, k: u64| {
        let points = seen(&scene, &(arm.chain.pose(q).inverse() * object())).unwrap();
        let now_ns = k * PERIOD_NS;
        law.see_joints(q.as_slice(), now_ns);
        let measured = Measurement::from_points(&points).taken(now_ns, now_ns);
        law.step(&measured, None).unwrap()
    };
    let found = (0..900).find(|k| {
        let sent = step(&mut law, &q, *k);
        law.sent(&sent.twist, k * PERIOD_NS);
        law.sent_elbow(sent.elbow);
        law.think(None);
        q = arm.moved(&q, &sent.twist, sent.elbow, 1.0 / 30.0);
        law.foreseen().guide.kind == Kind::Joints
    });
    let next = found.unwrap() + 1;
    let (mut with, mut without) = (law.state(), law.state());
    without.foresight.guide = Guide::GOAL;
    for state in [&mut with, &mut without] {
        state.strategy = Strategy::Previous;
    }
    let [with, without] = [with, without].map(|state| {
        law.restore(&state);
        step(&mut law, &q, next)
    });
    assert_eq!(with, without);
}

/// An object half a metre before the arm.
fn object() -> Pose {
    Pose::from_parts(
        Translation3::new(0.5, 0.0, 0.05),
        Rotation3::from_matrix_unchecked(nalgebra::Matrix3::new(
            0.0, -1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0,
        )),
    )
}

/// Whether the law brings the camera to the goal in time, with an arm that slows down as its bridge
/// does.
fn arrives(
    law: &mut Law<Vec<f64>>,
    scene: &Scene,
    arm: &Arm,
    object: &Pose,
    mut q: Joints,
    seconds: f64,
) -> bool {
    let bridge = Arm {
        margin: 0.15,
        speed: 0.3,
        strain: 0.7,
        ..arm.clone()
    };
    let acceleration = scene.limits.acceleration();
    for k in 0..(seconds * 30.0) as u64 {
        let now_ns = k * PERIOD_NS;
        let Some(points) = seen(scene, &(arm.chain.pose(&q).inverse() * object)) else {
            return false;
        };
        law.see_joints(&q.as_slice()[..arm.chain.count()], now_ns);
        let measured = Measurement::from_points(&points).taken(now_ns, now_ns);
        let Ok(step) = law.step(&measured, None) else {
            return false;
        };
        if step.error_px < scene.success.convergence_px {
            return true;
        }
        law.sent(&step.twist, now_ns);
        law.sent_elbow(step.elbow);
        law.think(None);
        let dampers = arm::Dampers::at(&bridge, &q, &acceleration, 0.033);
        let share = dampers.share(&step.twist);
        q = arm.moved(&q, &step.twist.map(|v| share * v), step.elbow, 1.0 / 30.0);
    }
    false
}

/// Whether all points of the pattern are in the image, clear of its border and of the gripper.
fn is_in_sight(scene: &Scene, object: &Pose) -> bool {
    let is_inside = |p: &[f64; 2]| (20.0..620.0).contains(&p[0]) && (20.0..380.0).contains(&p[1]);
    seen(scene, object).is_some_and(|points| points.iter().all(is_inside))
}

/// The points of the pattern in the image, px, if all are before the camera.
fn seen(scene: &Scene, object: &Pose) -> Option<Vec<[f64; 2]>> {
    let camera = &scene.camera;
    let pixel = |point: &[f64; 3]| {
        let x = object * Point3::from(*point);
        let [a, b] = [x.x / x.z, x.y / x.z];
        (x.z > 0.05).then_some([camera.fx * a + camera.cx, camera.fy * b + camera.cy])
    };
    scene.pattern.iter().map(pixel).collect()
}

#[test]
fn the_shipped_arm_moves_as_the_bridges_know_it() {
    let (arm, turned) = (
        panda(),
        Rotation3::new(Vector3::z() * std::f64::consts::FRAC_PI_4),
    );
    let aside = 0.07 * 0.5f64.sqrt();
    let camera = Pose::from_parts(Translation3::new(aside, -aside, 0.04), turned);
    let theirs = Chain::FRANKA.with_ee(camera);
    for k in 0..50 {
        let q = Joints::from_fn(|i, _| ((7 * k + 3 * i) % 11) as f64 * 0.2 - 1.0);
        let apart = arm.chain.pose(&q).to_matrix() - theirs.pose(&q).to_matrix();
        assert!(apart.norm() < 1e-12, "{apart}");
        let apart = arm.chain.jacobian(&q) - theirs.jacobian(&q);
        assert!(apart.norm() < 1e-12, "{apart}");
    }
    for (ours, theirs) in arm.limits.0.iter().zip(Model::Panda.limits().0) {
        assert_eq!(*ours, theirs);
    }
}

#[test]
fn a_law_with_an_arm_waits_for_its_joints() {
    let with = scene(true);
    let mut law = law(&with, Strategy::Previous);
    let points = law.task().goal.clone();
    let measured = Measurement::from_points(&points);
    assert_eq!(law.step(&measured, None), Err(Refusal::NoJoints));
    // Of another arm.
    law.see_joints(&READY[..6], 0);
    assert_eq!(law.step(&measured, None), Err(Refusal::NoJoints));
    law.see_joints(&READY, 0);
    assert!(law.step(&measured, None).is_ok());
    // Old ones, and those of another arm after that.
    let late = measured.taken(0, 600_000_000);
    assert_eq!(law.step(&late, None), Err(Refusal::NoJoints));
    law.see_joints(&READY, 500_000_000);
    assert!(law.step(&late, None).is_ok());
    law.see_joints(&READY[..6], 590_000_000);
    assert_eq!(law.step(&late, None), Err(Refusal::NoJoints));
}

#[test]
fn a_step_tells_what_of_the_arm_binds_its_command() {
    // Down to the goal from 10 cm above it, and up from as far below.
    let causes = |change: &dyn Fn(&mut scene::Arm, &Pose)| {
        [-0.1, 0.1].map(|away| {
            let mut scene = scene(true);
            let camera = panda().chain.pose(&Joints::from(READY));
            change(scene.arm.as_mut().unwrap(), &camera);
            let mut law = law(&scene, Strategy::Previous);
            let goal = goal(&scene);
            let points = seen(&scene, &(Translation3::new(0.0, 0.0, -away) * goal)).unwrap();
            law.see_joints(&READY, 0);
            let measured = Measurement::from_points(&points);
            // It speeds up first.
            law.sent(&[0.0, 0.0, -0.1 * away.signum(), 0.0, 0.0, 0.0], 0);
            law.step(&measured, None).unwrap().cause
        })
    };
    assert_eq!(causes(&|_, _| ()), [None; 2]);
    let floor = |arm: &mut scene::Arm, camera: &Pose| {
        let (normal, offset) = ([0.0, 0.0, 1.0], camera.translation.z);
        arm.walls.push(scene::Wall { normal, offset }).unwrap();
    };
    assert_eq!(causes(&floor), [Some(Cause::Wall(0)), None]);
    let elbow = |arm: &mut scene::Arm, _: &Pose| {
        arm.joints[3].range[1] = READY[3] + arm.margin;
    };
    assert_eq!(causes(&elbow), [None, Some(Cause::Joint(3))]);
    let slow = |arm: &mut scene::Arm, _: &Pose| arm.joints[3].velocity = 0.01;
    assert_eq!(causes(&slow), [Some(Cause::Speed(3)); 2]);
    let strained = |arm: &mut scene::Arm, _: &Pose| arm.strain = 0.05;
    let of_strain = causes(&strained);
    assert!(
        of_strain.contains(&Some(Cause::Singularity)),
        "{of_strain:?}"
    );
}

#[test]
fn near_a_goal_behind_a_wall_it_stands_and_tells_the_wall() {
    let (mut scene, arm) = (scene(true), panda());
    let camera = arm.chain.pose(&Joints::from(READY));
    // The goal is 10 cm below, and the wall 6 cm.
    let object = camera * Translation3::new(0.0, 0.0, 0.1) * goal(&scene);
    let (normal, offset) = ([0.0, 0.0, 1.0], camera.translation.z - 0.06);
    let wall = scene::Wall { normal, offset };
    scene.arm.as_mut().unwrap().walls.push(wall).unwrap();
    let mut lowest = f64::INFINITY;
    let step = steered(&scene, &arm, &object, |q| {
        lowest = lowest.min(arm.chain.pose(q).translation.z);
    });
    assert!(lowest > offset - 1e-4, "{lowest}");
    assert!((5.0..50.0).contains(&step.error_px), "{}", step.error_px);
    assert_eq!((step.stands, step.cause), (true, Some(Cause::Wall(0))));
}

/// The last step of 15 s from the ready position in front of an object, with a robot that obeys.
fn steered(scene: &Scene, arm: &Arm, object: &Pose, mut look: impl FnMut(&Joints)) -> Step {
    let mut law = law(scene, Strategy::Foresight);
    let (mut q, mut last) = (Joints::from(READY), Step::default());
    for k in 0..450 {
        let points = seen(scene, &(arm.chain.pose(&q).inverse() * object)).unwrap();
        let now_ns = k * PERIOD_NS;
        law.see_joints(q.as_slice(), now_ns);
        let measured = Measurement::from_points(&points).taken(now_ns, now_ns);
        last = law.step(&measured, None).unwrap();
        law.sent(&last.twist, now_ns);
        law.sent_elbow(last.elbow);
        law.think(None);
        q = arm.moved(&q, &last.twist, last.elbow, 1.0 / 30.0);
        look(&q);
    }
    last
}

/// The object in a camera at its goal.
fn goal(scene: &Scene) -> Pose {
    Pose::from_parts(
        Translation3::from(scene.goal.translation),
        Rotation3::new(Vector3::from(scene.goal.rotation)),
    )
}

#[test]
fn a_way_that_presses_a_link_into_a_box_or_wall_ends_at_the_clearance_and_tells_what_is_near() {
    let camera = panda().chain.pose(&Joints::from(READY));
    // The goal is 10 cm below. The hand's lowest point is 7.5 cm below the camera, and a box or a
    // table 5 cm below that; the box is as far from the camera's own way as the hand reaches.
    let top = camera.translation.z - 0.075 - 0.05;
    let aside = |scene: &mut Scene| {
        let hand = camera.translation.vector - Vector3::new(0.07, 0.0, 0.0);
        let known = scene::Cuboid {
            center: [hand.x, hand.y, top - 0.1],
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            half: [0.04, 0.15, 0.1],
        };
        let arm = scene.arm.as_mut().unwrap();
        arm.boxes.push(known).unwrap();
        scene::Other::Box(0)
    };
    let table = |scene: &mut Scene| {
        let (normal, offset) = ([0.0, 0.0, 1.0], top);
        let arm = scene.arm.as_mut().unwrap();
        arm.walls.push(scene::Wall { normal, offset }).unwrap();
        scene::Other::Wall(0)
    };
    for (build, of_box) in [(&aside as &dyn Fn(&mut Scene) -> _, true), (&table, false)] {
        let mut scene = scene(true);
        let other = build(&mut scene);
        let known = scene.arm.as_mut().unwrap();
        let hands = (0..known.shapes.len()).filter(|k| known.shape_links[*k] == "panda_hand");
        let hands: Vec<u8> = hands.map(|k| k as u8).collect();
        let pairs = hands.iter().map(|shape| scene::Pair {
            shape: *shape,
            other,
        });
        known.pairs.extend(pairs);
        let (arm, clearance) = (arm::Arm::from(&*known), known.clearance);
        let object = camera * Translation3::new(0.0, 0.0, 0.1) * goal(&scene);
        let mut nearest = f64::INFINITY;
        let step = steered(&scene, &arm, &object, |q| {
            let distances = arm.distances(q).map(|(_, distance)| distance);
            nearest = distances.fold(nearest, f64::min);
        });
        let Some(Cause::Near(pair)) = step.cause else {
            panic!("{:?}, {nearest}", step.cause);
        };
        let is_named = match pair.other {
            vpc::arm::Other::Box(0) => of_box,
            vpc::arm::Other::Wall(0) => !of_box,
            _ => false,
        };
        assert!(is_named && hands.contains(&pair.shape), "{pair:?}");
        assert!(
            nearest > clearance - 1e-4 && nearest < clearance + 2e-3,
            "{nearest}"
        );
        assert!(step.stands && step.error_px > 5.0, "{}", step.error_px);
    }
}

#[test]
fn without_an_arm_joints_change_nothing() {
    let without = scene(false);
    let mut laws = [0, 1].map(|_| law(&without, Strategy::Foresight));
    for k in 0..40 {
        let now_ns = k * PERIOD_NS;
        laws[1].see_joints(&READY, now_ns);
        let points = [
            [100.0, 100.0],
            [200.0, 101.0],
            [199.0, 180.0],
            [99.0, 181.0],
        ];
        let points = points.map(|p| p.map(|x| x + k as f64));
        let measured = Measurement::from_points(&points).taken(now_ns, now_ns);
        let [a, b] = laws.each_mut().map(|law| {
            let step = law.step(&measured, None).unwrap();
            law.sent(&step.twist, now_ns);
            law.sent_elbow(step.elbow);
            law.think(None);
            step
        });
        assert_eq!(a, b);
        assert_eq!(laws[0].state(), laws[1].state());
    }
}
