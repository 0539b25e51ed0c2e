//! The same seed gives the same memory: whatever the number of threads, and however often it was
//! interrupted.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{OnceLock, mpsc};
use std::time::Duration;

use memory_blob::Contents;
use memory_builder::build::{collect, is_enough};
use memory_builder::foresight::Need;
use memory_builder::memory;
use memory_builder::progress::Progress;
use memory_builder::settings::{BuildSettings, ForesightSettings};
use memory_builder::state::BuildIdentity;
use scene::{Pose, Scene, SceneFiles};
use vpc::Task;

fn settings() -> BuildSettings {
    BuildSettings {
        trajectories: 6,
        iterations: 30,
        guide_after: 3,
        batch: 3,
        ..BuildSettings::default()
    }
}

fn files() -> SceneFiles {
    SceneFiles::parse(scene::PAPER_SIM.to_owned(), "sim", &|_| unreachable!()).unwrap()
}

fn scene() -> Scene {
    Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap()
}

fn pool(threads: usize) -> rayon::ThreadPool {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
    pool.build().unwrap()
}

/// What one thread builds.
fn built() -> &'static Progress {
    static BUILT: OnceLock<Progress> = OnceLock::new();
    BUILT.get_or_init(|| built_by(1, &settings()))
}

fn built_by(threads: usize, settings: &BuildSettings) -> Progress {
    let pool = pool(threads);
    let never = AtomicBool::new(false);
    pool.install(|| collect(&scene(), settings, Progress::default(), &never, &mut |_| ()).unwrap())
}

/// The same, interrupted at once, and then in the middle of batches, after waits that double.
fn interrupted(threads: usize, settings: &BuildSettings) -> Progress {
    let pool = pool(threads);
    let directory = tempfile::TempDir::new().unwrap();
    let path = directory.path().join("state");
    let files = files();
    let build = BuildIdentity::new(&files, settings);
    let (mut wait, mut in_vain) = (Duration::ZERO, 0);
    loop {
        let before = build.resume(&path).unwrap();
        let stop = &AtomicBool::new(wait.is_zero());
        let (end, ended) = mpsc::channel::<()>();
        let progress = std::thread::scope(|scope| {
            scope.spawn(move || {
                let _ = ended.recv_timeout(wait);
                stop.store(true, Ordering::Relaxed);
            });
            let go_on = || collect(&files.scene, settings, before.clone(), stop, &mut |_| ());
            let progress = pool.install(go_on).unwrap();
            drop(end);
            progress
        });
        if is_enough(settings, &progress) {
            assert!(in_vain > 0);
            return progress;
        }
        in_vain += u32::from(progress == before);
        build.save(&path, &progress).unwrap();
        wait = (2 * wait).max(Duration::from_millis(100));
    }
}

/// Settings of a build from so many starts that keeps what pays more than 2 %.
fn needed(starts: u64) -> BuildSettings {
    BuildSettings {
        batch: 4,
        // Of its first three starts some pay more, and some do not.
        seed: 3,
        foresight: Some(ForesightSettings {
            starts,
            pause_s: 0.0,
            think_s: 0.5,
            pays: 1.02,
        }),
        ..settings()
    }
}

#[test]
fn foresight_s_trajectories_are_kept_where_it_pays_more_without_thought() {
    keep(3);
}

#[test]
#[ignore = "long: 8 starts, each several times"]
fn foresight_s_trajectories_are_the_same_after_interruptions() {
    let settings = needed(8);
    assert_eq!(keep(8), interrupted(3, &settings));
}

/// Builds from so many starts.
fn keep(starts: u64) -> Progress {
    let settings = needed(starts);
    let one = built_by(1, &settings);
    let (tried, kept) = (one.tried, one.trajectories.len());
    assert!(
        tried == starts && (1..tried).contains(&(kept as u64)),
        "{kept} of {tried}"
    );
    assert_eq!(one.failures.len(), kept);

    // The first one was kept because of what it costs without a memory.
    let foresight = settings.foresight.unwrap();
    let task = Task::new(&scene()).unwrap();
    let start = Pose {
        translation: one.failures[0][..3].try_into().unwrap(),
        rotation: one.failures[0][3..].try_into().unwrap(),
    };
    let need = Need::of(&scene(), &task, &foresight, &start, None);
    let (paid, trajectory) = need.needed(&foresight).unwrap();
    assert_eq!((paid, trajectory), (one.paid[0], &one.trajectories[0]));
    assert!(paid > 1.02 && one.paid.len() == kept);
    let pays = 2.0 * paid;
    assert!(
        need.needed(&ForesightSettings { pays, ..foresight })
            .is_none()
    );
    one
}

#[test]
fn foresight_is_not_asked_for_an_arm_whose_joints_nobody_knows() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/scenes/ur5e.toml");
    let files = SceneFiles::read(path.as_ref()).unwrap();
    let never = AtomicBool::new(false);
    let begin = Progress::default();
    let error = collect(&files.scene, &needed(8), begin, &never, &mut |_| ()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the scene has an arm; allowed with --foresight: scenes without one"
    );
}

fn contents(task: &Task, settings: &BuildSettings, progress: &Progress) -> Contents {
    memory::contents(&scene(), task, settings, progress).unwrap()
}

#[test]
fn one_thread_and_three_build_the_same_memory() {
    let (one, three) = (built(), built_by(3, &settings()));
    assert_eq!(*one, three);
    assert_eq!(one.trajectories.len(), 6);

    let task = Task::new(&scene()).unwrap();
    let mut settings = settings();
    settings.regression.samples = 100;
    assert_eq!(
        contents(&task, &settings, one),
        contents(&task, &settings, &three)
    );
}

#[test]
fn an_interrupted_build_goes_on_to_the_same_memory() {
    let directory = tempfile::TempDir::new().unwrap();
    let path = directory.path().join("state");
    let files = files();
    let build = BuildIdentity::new(&files, &settings());
    let mut progress = Progress::default();
    let mut interruptions = 0;
    while progress.trajectories.len() < settings().trajectories {
        let stop = AtomicBool::new(false);
        let mut after_a_batch = |_: &Progress| stop.store(true, Ordering::Relaxed);
        // Through the file, as after a Ctrl-C.
        let resumed = build.resume(&path).unwrap();
        assert_eq!(resumed, progress);
        progress = collect(
            &files.scene,
            &settings(),
            resumed,
            &stop,
            &mut after_a_batch,
        )
        .unwrap();
        build.save(&path, &progress).unwrap();
        interruptions += 1;
    }
    assert!(interruptions >= 2);
    assert_eq!(progress, *built());
}

#[test]
fn every_trajectory_ends_at_the_goal_inside_the_limits() {
    let task = Task::new(&scene()).unwrap();
    for trajectory in &built().trajectories {
        let last = trajectory.features.last().unwrap();
        let error = vpc::features::largest_error(last, &task.goal);
        assert!(error < scene().success.convergence_px);
        for twist in &trajectory.twists {
            assert!(
                twist
                    .iter()
                    .zip(&task.limits)
                    .all(|(v, limit)| v.abs() <= *limit)
            );
        }
    }
}

#[test]
fn variances_are_in_the_units_of_the_outputs() {
    let task = Task::new(&scene()).unwrap();
    let mut settings = settings();
    settings.regression.variance = true;
    settings.regression.samples = 100;
    let contents = contents(&task, &settings, built());
    let process = contents.regression.as_ref().unwrap();
    let scales = &process.output_scale;

    // What the outputs were divided by: the root mean square of y - m over the samples of the
    // process.
    let output_of = |x| &contents.y[contents.x.iter().position(|other| other == x).unwrap()];
    for (o, scale) in scales.iter().enumerate() {
        let square = |x| (output_of(x)[o] - process.mean[o]).powi(2);
        let mean = process.x.iter().map(square).sum::<f64>() / process.x.len() as f64;
        assert!(
            (scale - mean.sqrt()).abs() < 1e-9 * scale,
            "output {o}: {scale}"
        );
    }

    let directory = tempfile::TempDir::new().unwrap();
    let path = directory.path().join("variance.vpcmem");
    contents.write(&path).unwrap();
    let file = memory_blob::MemoryFile::open(&path, None).unwrap();
    let gpr = file.view().gpr().unwrap();
    let (mut scratch, mut variance) = (vec![0.0; gpr.len()], vec![0.0; gpr.outputs()]);
    // At a sample little is left to learn but the noise; far away everything.
    gpr.variance(&process.x[0], &mut scratch, &mut variance)
        .unwrap();
    for (variance, scale) in variance.iter().zip(scales) {
        assert!(*variance <= 1.01 * process.noise_variance * scale * scale);
    }
    gpr.variance(&[1e6; 10], &mut scratch, &mut variance)
        .unwrap();
    for (variance, scale) in variance.iter().zip(scales) {
        assert!((variance / (process.signal_variance * scale * scale) - 1.0).abs() < 1e-12);
    }
}
