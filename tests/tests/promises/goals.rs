//! Goals that are shown: the daemon takes one up, disarmed; several are visited in turn; and a stop
//! ends that. In lockstep: the camera waits for each answer.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use hw_sim::FreeCamera;
use ipc::{CameraPorts, Domain};
use messages::{Action, CycleRecord, Features, Hold, Outcome, Stamp, TwistState};
use rustix::process::Signal;
use scene::{Scene, with_value};

use crate::fixture::{
    Ended, PERIOD_NS, Place, Running, Witness, ended, eventually, is_still, program,
};

/// A camera on the first start, on a thread of its own and in lockstep, until it is dropped.
struct Camera {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Camera {
    fn start(place: &Place) -> Self {
        let domain = place.domain();
        let ends = Arc::new(AtomicBool::new(false));
        let its_end = Arc::clone(&ends);
        let thread = std::thread::spawn(move || show(&domain, &its_end));
        Self {
            ends,
            thread: Some(thread),
        }
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_some_and(|ended| ended.is_ok()));
    }
}

/// Shows the first start, and moves as the answers say; a daemon that begins again answers the frame
/// that it finds.
fn show(domain: &Path, ends: &AtomicBool) {
    let domain = Domain::join(domain).unwrap();
    let mut ports = CameraPorts::open(&domain).unwrap();
    let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "starts").unwrap();
    let mut camera = FreeCamera::new(&scene, &starts[0]);
    for sequence in 1.. {
        let at_ns = sequence * PERIOD_NS;
        let mut features = Features::new(&camera.features().unwrap(), at_ns);
        features.stamp = Stamp {
            sequence,
            published_ns: at_ns,
            data_ns: at_ns,
        };
        let sent = ports.features.publish_verbatim(&features).unwrap();
        let answer = loop {
            if ends.load(Ordering::Relaxed) {
                return;
            }
            if let Some(answer) = ports.wait_for_answer(&sent, LOOK).unwrap() {
                break answer.message.twist;
            }
        };
        camera.advance(&answer, scene.sampling_time());
        // A processor for the others.
        std::thread::sleep(PAUSE);
    }
}

/// Between two looks of the camera at its end, and between its frames.
const LOOK: Duration = Duration::from_millis(50);
const PAUSE: Duration = Duration::from_millis(1);

/// A camera, and a daemon with a scene of its own.
struct Shown {
    witness: Witness,
    daemon: Running,
    _camera: Camera,
    place: Place,
    vpcctl: PathBuf,
}

impl Shown {
    fn begun() -> Self {
        Self::with("[law]\nstrategy = 'previous'\n")
    }

    /// With these lines of configuration.
    fn with(law: &str) -> Self {
        let place = Place::new();
        let witness = Witness::new(&place);
        place.file("own.toml", scene::PAPER_SIM);
        let text = format!("scene = 'own.toml'\nsafety.armed = false\n{law}");
        let mut daemon = testkit::command(program("vpcd"));
        daemon.arg("--config").arg(place.file("vpcd.toml", text));
        daemon.args(["--clock", "lockstep"]);
        daemon.arg("--domain").arg(place.domain());
        daemon.stdout(Stdio::null()).stderr(Stdio::piped());
        let mut shown = Self {
            daemon: Running::start(daemon),
            _camera: Camera::start(&place),
            place,
            witness,
            vpcctl: program("vpcctl"),
        };
        eventually("a cycle with features", || {
            shown
                .witness
                .records()
                .iter()
                .any(|record| record.count > 0)
                .then_some(())
        });
        shown
    }

    fn vpcctl(&self, words: &[&str]) -> Command {
        let mut command = testkit::command(&self.vpcctl);
        command.arg("--domain").arg(self.place.domain()).args(words);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Teaches the present view as the goal. Returns two scene files: of this goal, and of one a
    /// few centimeters away.
    fn taught(&self) -> [String; 2] {
        let said = ended(self.vpcctl(&["teach", "--replace"]));
        assert_eq!(said.code, Some(0), "{said:?}");
        let text = fs::read_to_string(self.place.path("own.toml")).unwrap();
        let goal = Scene::parse(&text, "own").unwrap().goal.translation;
        let aside = [goal[0] + 0.04, goal[1] - 0.02, goal[2] + 0.05];
        let aside = with_value(&text, "goal", "translation", &format!("{aside:?}")).unwrap();
        [("here.toml", text), ("aside.toml", aside)]
            .map(|(name, text)| self.place.file(name, text).display().to_string())
    }

    /// Where the points are now.
    fn points(&mut self) -> Vec<[f64; 2]> {
        self.witness.records();
        eventually("points", || {
            let records = self.witness.records();
            let seen = records.iter().find(|record| record.count > 0)?;
            Some(seen.pairs().collect())
        })
    }
}

#[test]
fn a_goal_that_was_shown_is_taken_up_disarmed_and_visited() {
    let mut shown = Shown::begun();
    let (process, before) = (shown.daemon.id(), shown.points());
    let [_, aside] = shown.taught();
    let record = eventually("a cycle", || shown.witness.records().pop());
    assert_eq!(record.state, TwistState::Disarmed.code());
    assert_eq!(record.hold(), Some(Hold::NotArmed));
    // The daemon's own file, which the first goal replaces, may be the second.
    let own = shown.place.path("own.toml").display().to_string();
    let kept = fs::read_to_string(shown.place.path("own.toml.before"));
    assert_eq!(kept.unwrap(), scene::PAPER_SIM);
    let Ended {
        code,
        stdout,
        stderr,
        ..
    } = ended(shown.vpcctl(&["visit", &aside, &own]));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    assert_eq!(stdout.matches("arrived at ").count(), 2, "{stdout}");
    let off = shown.points().into_iter().zip(before);
    let off = off.map(|(now, before)| (now[0] - before[0]).hypot(now[1] - before[1]));
    let off = off.fold(0.0, f64::max);
    assert!(off < 5.0, "{off} px from where it was shown");
    assert_eq!(shown.daemon.id(), process);
    assert!(shown.daemon.is_running());
    let armed = ended(shown.vpcctl(&["teach", "--replace"]));
    assert_eq!(armed.code, Some(2), "{armed:?}");
    assert!(armed.stderr.contains("the daemon is armed"), "{armed:?}");
}

#[test]
fn a_stop_ends_a_visit() {
    let mut shown = Shown::begun();
    let [here, aside] = shown.taught();
    let visit = Running::start(shown.vpcctl(&["visit", &aside, &here]));
    shown.witness.until("motion", |twist| !is_still(twist));
    shown.witness.ask(Action::Stop);
    let Ended {
        code,
        stdout,
        stderr,
        ..
    } = visit.ended();
    assert_eq!((code, &*stdout), (Some(1), ""), "{stderr}");
    assert!(stderr.contains("aside.toml: disarmed"), "{stderr}");
    // Nobody has armed since: neither a new visit nor a new beginning makes it forgotten.
    shown.witness.commands();
    let again = ended(shown.vpcctl(&["visit", &here]));
    assert_eq!(again.code, Some(2), "{again:?}");
    assert!(
        again.stderr.contains("has stopped or disarmed it"),
        "{again:?}"
    );
    assert!(shown.witness.commands().iter().all(is_still));
}

#[test]
fn a_disarm_at_a_change_of_goals_ends_a_visit() {
    let mut shown = Shown::begun();
    let [here, aside] = shown.taught();
    let visit = Running::start(shown.vpcctl(&["visit", &aside, &here, &aside, &here]));
    eventually("the first goal", || {
        let arrived = |record: &CycleRecord| record.state == TwistState::Arrived.code();
        shown.witness.records().iter().any(arrived).then_some(())
    });
    // The visit goes on once it was disarmed.
    visit.signal(Signal::STOP);
    eventually("a disarm", || {
        let said = ended(shown.vpcctl(&["disarm"]));
        (said.code == Some(0)).then_some(())
    });
    shown.witness.commands();
    visit.signal(Signal::CONT);
    let said = visit.ended();
    assert_ne!(said.code, Some(0), "{said:?}");
    assert!(shown.witness.commands().iter().all(is_still));
    // A person who says so later may.
    eventually("arming", || {
        let said = ended(shown.vpcctl(&["arm"]));
        (said.code == Some(0)).then_some(())
    });
}

#[test]
fn a_goal_with_other_limits_is_refused_and_a_reload_with_them_is_told() {
    let shown = Shown::begun();
    let [_, aside] = shown.taught();
    let own = || fs::read_to_string(shown.place.path("own.toml")).unwrap();
    let before = own();
    let faster = fs::read_to_string(&aside).unwrap();
    let faster = with_value(&faster, "limits", "linear", "5.0").unwrap();
    let faster = shown
        .place
        .file("faster.toml", faster)
        .display()
        .to_string();
    let said = ended(shown.vpcctl(&["visit", &faster]));
    assert_eq!(said.code, Some(2), "{said:?}");
    let named = "limits.linear: 0.5 -> 5.0; allowed:";
    assert!(said.stderr.contains(named), "{said:?}");
    assert_eq!(own(), before);
    let said = ended(shown.vpcctl(&["visit", &faster, "--accept", "limits"]));
    assert_eq!(said.code, Some(0), "{said:?}");
    let (code, log) = shown.daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    let told = "begins again with another limits.linear: 0.5 -> 5.0";
    assert!(log.contains(told), "{log}");
}

#[test]
fn a_goal_that_cannot_be_taken_up_changes_nothing() {
    let shown = Shown::begun();
    let [here, _] = shown.taught();
    let own = fs::read_to_string(shown.place.path("own.toml")).unwrap();
    // Its mask is not beside the daemon's scene.
    fs::create_dir(shown.place.path("elsewhere")).unwrap();
    let mask = shown.place.path("elsewhere/mask.png");
    scene::write_mask(&mask, 1024, 1024, |u, v| u < 40 && v < 40).unwrap();
    let text =
        fs::read_to_string(&here).unwrap() + "[[occlusion]]\nname = 'x'\nmask = 'mask.png'\n";
    let masked = shown.place.file("elsewhere/masked.toml", text);
    let said = ended(shown.vpcctl(&["visit", masked.to_str().unwrap()]));
    assert_eq!(said.code, Some(65), "{said:?}");
    assert!(said.stderr.contains("mask.png"), "{said:?}");
    assert_eq!(
        fs::read_to_string(shown.place.path("own.toml")).unwrap(),
        own
    );
    let log = shown.daemon.terminated().log();
    assert!(
        !log.1.contains("goes on with what it has read before"),
        "{log:?}"
    );
    assert_eq!(log.0, 0);
}

#[test]
fn its_memory_is_built_and_taken_up() {
    // Beside this vpcctl is a vpc-memory that builds a small one.
    let builders = Place::new();
    let settings = "--trajectories 4 --iterations 20 --gpr-samples 40";
    let builder = program("vpc-memory");
    let script = format!(
        "#!/bin/sh\nexec '{}' \"$@\" {settings}\n",
        builder.display()
    );
    let script = builders.file("vpc-memory", script);
    fs::set_permissions(script, fs::Permissions::from_mode(0o755)).unwrap();
    let (whole, vpcctl) = (program("vpcctl"), builders.path("vpcctl"));
    let linked = fs::hard_link(&whole, &vpcctl);
    linked
        .or_else(|_| fs::copy(&whole, &vpcctl).map(drop))
        .unwrap();
    let own = Place::new();
    let first = own.path("own.vpcmem");
    let mut build = testkit::command(builder);
    build
        .arg("build")
        .arg(own.file("own.toml", scene::PAPER_SIM));
    build.arg("-o").arg(&first).args(settings.split(' '));
    let said = ended(build.stdout(Stdio::null()).stderr(Stdio::piped()));
    assert_eq!(said.code, Some(0), "{said:?}");

    let memory = format!(
        "memory = '{}'\n[law]\nstrategy = 'foresight'\n",
        first.display()
    );
    let mut shown = Shown::with(&memory);
    shown.vpcctl = vpcctl;
    let memory = first;
    let before = fs::read(&memory).unwrap();
    shown.taught();
    assert_ne!(fs::read(&memory).unwrap(), before);
    assert_eq!(fs::read(own.path("own.vpcmem.before")).unwrap(), before);
    eventually("arming", || {
        (shown.witness.ask(Action::Arm) == Outcome::Done).then_some(())
    });
    eventually("the goal", || {
        let arrived = |record: &CycleRecord| record.state == TwistState::Arrived.code();
        shown.witness.records().iter().any(arrived).then_some(())
    });
}
