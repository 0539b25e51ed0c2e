//! `cargo table -- --robot panda` or `urdf`: strategies on the same starts against the emulated
//! robot, in simulated time.

use anyhow::Context;
use hw_sim::following::FollowingReport;
use hw_sim::rig::RigSettings;
use hw_sim::robot::arm::ArmSettings;
use hw_sim::robot::truth::Truth;
use memory_blob::MemoryFile;
use messages::ClockMode;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, UnitSphere};
use rayon::prelude::*;
use scene::{Pose, Scene};
use serde::Serialize;
use vpc::Settings;

use crate::column::{self, Column, Shown};
use crate::edge::{self, Goal, ServoRule, Start};
use crate::flags::{Common, RobotFlags};
use crate::joint_task::JointTask;
use crate::processes::slowed;
use crate::robot::{Course, Reason, RobotRun, run};
use crate::simulated::Simulated;
use crate::statistics::mean;

/// A row.
#[derive(Clone, Debug, Serialize)]
pub struct RobotRow {
    /// Strategy and window.
    pub strategy: String,
    /// Share of successful runs, 0 to 1.
    pub success_rate: f64,
    /// Runs that failed because of a violation.
    pub violations: usize,
    /// ... a marker that stayed hidden.
    pub markers_lost: usize,
    /// ... time.
    pub time_outs: usize,
    /// ... another disarm, or a command beyond the limits.
    pub faults: usize,
    /// ... a reflex.
    pub reflexes: u64,
    /// Milliseconds beyond a limit, all runs.
    pub limit_violations: u64,
    /// Milliseconds with a discontinuity, all runs.
    pub discontinuities: u64,
    /// Mean time to arrival of the successful runs, s; none if there are none.
    pub arrived_s: Option<f64>,
    /// Mean running cost over Np.
    pub cost: f64,
    /// Where markers have a size: the least clearance of any marker's edge, px.
    pub least_edge_px: Option<f64>,
    /// Share of the time in which the bridge slowed the camera down, all runs.
    pub slowed: f64,
    /// At starts at the edge of what the arm can do: those whose goal the arm shows with the elbow
    /// held, with another elbow only, and not at all; each with how many of them arrived.
    pub goals: [[usize; 2]; 3],
    /// Largest shares of the joints' limits in any run: speed, acceleration, jerk.
    pub joint_shares: [f64; 3],
    /// The deepest that a point was inside an occlusion or outside the image at any of twelve
    /// instants a period, px.
    pub deepest_px: f64,
    /// How well the successful runs followed, all their frames together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub following: Option<FollowingReport>,
    /// The most at which the camera moved relative to a moving pattern, at the release: m/s, rad/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub release: Option<[f64; 2]>,
    /// Whether that was asked for.
    #[serde(skip)]
    pub is_following: bool,
}

/// The law's settings for the robot: the paper's on-line settings of its second experiment.
pub fn law(flags: &RobotFlags, base: Settings) -> Settings {
    Settings {
        iterations: 10,
        tolerance: 1e-6,
        trigger_px: flags.trigger,
        hysteresis: flags.hysteresis,
        margin_px: flags.margin,
        ..base
    }
}

/// The scene as the law believes it to be.
pub fn believed(scene: &Scene, flags: &RobotFlags) -> Scene {
    let mut believed = scene.clone();
    if flags.ignore_marker_size {
        believed.marker_size = 0.0;
    }
    if flags.ignore_arm {
        believed.arm = None;
    }
    believed
}

/// The cell for one start.
pub fn cell(
    scene: &Scene,
    arm: &ArmSettings,
    flags: &RobotFlags,
    common: &Common,
    start: usize,
) -> RigSettings {
    let mut settings = RigSettings::new(scene);
    settings.arm = *arm;
    let seed = common.seed.wrapping_add(start as u64);
    // Directions of calibration errors: of each start's own, the same for every size.
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed);
    let mut direction = |length: f64| -> [f64; 3] {
        let unit: [f64; 3] = UnitSphere.sample(&mut random);
        unit.map(|x| x * length)
    };
    settings.arm.truth = Truth {
        focal: flags.focal_error,
        hand_eye_m: direction(0.01 * flags.hand_eye_cm),
        hand_eye_deg: direction(flags.hand_eye_deg),
        depth: common.depth_error,
        ..Truth::default()
    };
    if flags.unshaped {
        settings.arm.is_shaped = false;
    }
    settings.eye.noise_px = common.noise;
    settings.eye.seed = seed;
    settings.eye.latency.latency_ns = (flags.delay_ms * 1e6).round() as u64;
    settings.eye.latency.jitter_ns = (flags.jitter_ms * 1e6).round() as u64;
    settings.eye.latency.drop = common.drop;
    settings.eye.latency.seed = seed;
    settings
}

/// Runs every strategy on every start, on all processors; the order of runs makes no difference to
/// them.
///
/// # Errors
/// A start out of reach, a setting out of its range.
pub fn table(
    (scene, arm): (&Scene, &ArmSettings),
    starts: &[Pose],
    memory: Option<&MemoryFile>,
    flags: &RobotFlags,
    common: &Common,
    tick: &(dyn Fn() + Sync),
) -> anyhow::Result<Vec<(String, Vec<RobotRun>)>> {
    flags.check(starts.len())?;
    let edges = flags
        .edge
        .map(|seed| edge::starts(scene, starts.len(), seed));
    let edges = edges.unwrap_or_default();
    let chosen = flags.only.map_or(0..starts.len(), |only| only..only + 1);
    let mut all = Vec::new();
    let believed = believed(scene, flags);
    let rule = flags.servo_rule.then(ServoRule::new);
    let known = scene.arm.as_ref().map(arm::Arm::from);
    let goal = |start: usize, edge: Option<&Start>| {
        let (edge, arm) = edge.zip(known.as_ref())?;
        let mut random = ChaCha8Rng::seed_from_u64(start as u64);
        Some(Goal::search(
            scene,
            arm,
            edge.q[arm::ik::ELBOW],
            &mut random,
        ))
    };
    for &spec in &common.strategies {
        let settings = law(flags, common.settings(spec));
        let work = |start: usize| {
            let mut daemon = Simulated::new(&believed, memory, settings, ClockMode::Fixed)?;
            let mut cell = cell(scene, arm, flags, common, start);
            let edge = edges.get(start);
            cell.arm.joints = edge.map(|edge| edge.q).or(cell.arm.joints);
            let pose = edge.map_or(&starts[start], |edge| &edge.pose);
            let course = Course {
                motion: common.motion(),
                follow_s: common.follow_s,
                rule: rule.as_ref(),
            };
            let run = run(scene, &cell, course, &mut daemon, pose);
            tick();
            let mut run = run.with_context(|| format!("start {start}"))?;
            run.goal = goal(start, edge);
            Ok(run)
        };
        let runs: anyhow::Result<Vec<RobotRun>> =
            chosen.clone().into_par_iter().map(work).collect();
        all.push((spec.to_string(), runs?));
    }
    if flags.joint_task {
        let task = JointTask::new(scene).context("--joint-task goes with a scene with an arm")?;
        let work = |start: usize| {
            let cell = cell(scene, arm, flags, common, start);
            let run = task.run(&cell, &edges[start]);
            tick();
            let mut run = run.with_context(|| format!("start {start}"))?;
            run.goal = goal(start, edges.get(start));
            Ok(run)
        };
        let runs: anyhow::Result<Vec<RobotRun>> = chosen.into_par_iter().map(work).collect();
        all.push(("joint-limit task".to_owned(), runs?));
    }
    Ok(all)
}

/// The row of a strategy's runs, which shows how well they followed if it `is_following`.
pub fn row(strategy: &str, runs: &[RobotRun], is_following: bool) -> RobotRow {
    let count = runs.len().max(1) as f64;
    let because = |reason| runs.iter().filter(|run| run.reason == Some(reason)).count();
    let good = runs.iter().filter(|run| run.success);
    let followed = good.clone();
    let most = |share: fn(&RobotRun) -> f64| runs.iter().map(share).fold(0.0, f64::max);
    RobotRow {
        strategy: strategy.to_owned(),
        success_rate: runs.iter().filter(|run| run.success).count() as f64 / count,
        violations: because(Reason::Violation),
        markers_lost: because(Reason::MarkerLost),
        time_outs: because(Reason::TimeOut),
        faults: because(Reason::Disarmed) + because(Reason::BeyondLimits),
        reflexes: runs.iter().map(|run| run.arm.reflexes).sum(),
        limit_violations: runs.iter().map(|run| run.arm.limit_violations).sum(),
        discontinuities: runs.iter().map(|run| run.arm.discontinuities).sum(),
        arrived_s: mean(good.filter_map(|run| run.arrived_s)),
        cost: runs.iter().map(|run| run.cost).sum::<f64>() / count,
        least_edge_px: runs
            .iter()
            .filter_map(|run| run.least_edge_px)
            .min_by(f64::total_cmp),
        deepest_px: most(|run| -run.least_clearance_px.min(run.least_between_px)),
        following: FollowingReport::of(followed.filter_map(|run| run.following.as_ref())),
        release: (runs.iter().filter_map(|run| run.release))
            .map(|release| [release.m_s, release.rad_s])
            .reduce(|a, b| [0, 1].map(|k| a[k].max(b[k]))),
        is_following,
        slowed: slowed(runs.iter().map(|run| &run.arm)),
        goals: [Goal::ElbowHeld, Goal::ElbowMoved, Goal::Nowhere].map(|goal| {
            let with = runs.iter().filter(|run| run.goal == Some(goal));
            [with.clone().count(), with.filter(|run| run.success).count()]
        }),
        joint_shares: [
            most(|run| run.arm.joint_velocity),
            most(|run| run.arm.joint_acceleration),
            most(|run| run.arm.joint_jerk),
        ],
    }
}

const IS_FOLLOWING: Shown<RobotRow> = |_, row| row.is_following;
const HAS_GOALS: Shown<RobotRow> = |_, row| row.goals != [[0; 2]; 3];
const IS_RELEASED: Shown<RobotRow> = |_, row| row.release.is_some();

/// The columns in their order. A new figure is a field of [`RobotRow`] and a line here.
pub const COLUMNS: [Column<RobotRow>; 17] = [
    Column::always("strategy", |row| row.strategy.clone()),
    Column::always("success", |row| {
        format!("{:.0} %", 100.0 * row.success_rate)
    }),
    Column::always("cost", |row| match row.cost.is_nan() {
        true => "-".to_owned(),
        false => format!("{:.4}", row.cost),
    }),
    Column::always("arrival (s)", |row| column::seconds(row.arrived_s)),
    Column::always("failures", |row| {
        column::failures(&[
            (row.violations, "violation"),
            (row.markers_lost, "lost marker"),
            (row.time_outs, "timeout"),
            (row.faults, "fault"),
        ])
    }),
    Column::always("reflexes", |row| row.reflexes.to_string()),
    Column::when("deepest (px)", IS_FOLLOWING, |row| {
        format!("{:.1}", row.deepest_px)
    }),
    Column::when("follows to (px RMS, most)", IS_FOLLOWING, |row| {
        column::followed_px(row.following.as_ref())
    }),
    Column::when("(mm RMS: camera, object)", IS_FOLLOWING, |row| {
        column::followed_mm(row.following.as_ref())
    }),
    Column::when("change a frame", IS_FOLLOWING, |row| {
        column::followed_change(row.following.as_ref())
    }),
    Column::when("released at (mm/s, mrad/s)", IS_RELEASED, |row| {
        let figures = |[m_s, rad_s]: [f64; 2]| format!("{:.1}, {:.1}", 1e3 * m_s, 1e3 * rad_s);
        row.release.map_or("-".to_owned(), figures)
    }),
    Column::when(
        "arrive by goal: elbow held, moved, nowhere",
        HAS_GOALS,
        |row| {
            let figures = row.goals.map(|[all, good]| format!("{good} of {all}"));
            figures.join(", ")
        },
    ),
    Column::wide("limit violations", |row| row.limit_violations.to_string()),
    Column::wide("discontinuities", |row| row.discontinuities.to_string()),
    Column::wide("least clearance of an edge (px)", |row| {
        row.least_edge_px
            .map_or("-".to_owned(), |px| format!("{px:.1}"))
    }),
    Column::wide("joint speed, acceleration, jerk (% of limit)", |row| {
        let [speed, push, snap] = row.joint_shares.map(|share| 100.0 * share);
        format!("{speed:.0}, {push:.0}, {snap:.0}")
    }),
    Column::wide("slowed by the bridge (% of time)", |row| {
        format!("{:.2}", 100.0 * row.slowed)
    }),
];

#[cfg(test)]
mod tests {
    use hw_sim::robot::described;
    use panda::kinematics::rotation_vector;
    use scene::{Arm, parse_starts};

    use super::*;
    use crate::flags::defaults;

    #[test]
    fn a_law_that_knows_the_arm_of_a_file_arrives_with_it_within_all_its_limits() {
        let scenes = crate::root().join("tests/scenes");
        let mut scene = Scene::read(&scenes.join("ur5e.toml")).unwrap();
        let starts = parse_starts(scene::PAPER_ROBOT_STARTS, "starts").unwrap();
        let starts: Vec<Pose> = starts.into_iter().step_by(20).collect();
        for file in ["ur5e.toml", "xarm6.toml"] {
            let arm = Arm::read(&crate::root().join("tests/arms").join(file)).unwrap();
            let robot = described::settings(&arm, &scene.goal);
            scene.arm = Some(arm);
            let row = all_arrive(&scene, &robot, &starts, "previous:3");
            assert!(row.joint_shares[0] > 0.01, "{file}: {row:?}");
        }
    }

    /// The row of a strategy that arrives from all starts, within all limits of the robot.
    fn all_arrive(scene: &Scene, robot: &ArmSettings, starts: &[Pose], strategy: &str) -> RobotRow {
        let common = Common {
            strategies: vec![strategy.parse().unwrap()],
            ..defaults()
        };
        let all = table((scene, robot), starts, None, &defaults(), &common, &|| ());
        let (name, runs) = all.unwrap().remove(0);
        let row = row(&name, &runs, false);
        assert_eq!(row.success_rate, 1.0, "{row:?}");
        assert_eq!((row.reflexes, row.limit_violations), (0, 0), "{row:?}");
        row
    }

    #[test]
    fn arms_with_four_and_five_joints_arrive_from_what_they_reach() {
        for file in ["five.toml", "scara.toml"] {
            let scene = Scene::read(&crate::root().join("tests/scenes").join(file)).unwrap();
            let described = scene.arm.as_ref().unwrap();
            let robot = described::settings(described, &scene.goal);
            let chain = arm::Arm::from(described).chain;
            let starts = [0.1, 0.07, 0.05].map(|away| {
                let mut q = described.goal.clone();
                let each = q.iter_mut().enumerate();
                each.for_each(|(k, q)| *q += [away, -0.04][k % 2]);
                let q = arm::joints(&q);
                let object = chain.pose(&q).inverse() * robot.base_from_object;
                Pose {
                    translation: object.translation.vector.into(),
                    rotation: rotation_vector(&object.rotation).into(),
                }
            });
            all_arrive(&scene, &robot, &starts, "foresight:3");
        }
    }
}
