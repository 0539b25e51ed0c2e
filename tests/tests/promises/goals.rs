//! Goals that are shown: the daemon takes one up, disarmed; several are visited in turn; and a stop
//! ends that.

use std::fs;
use std::process::{Command, Stdio};

use messages::{Action, CycleRecord, Hold, Outcome, TwistState};
use scene::{Scene, with_value};

use crate::fixture::{
    Ended, Place, Running, Witness, ended, eventually, is_still, memory_file, program, turn,
};

/// A camera on the first start, which never arrives by its own referee, and a daemon with a scene
/// of its own.
struct Shown {
    place: Place,
    witness: Witness,
    daemon: Running,
    _camera: Running,
}

impl Shown {
    fn begun() -> Self {
        Self::with("[law]\nstrategy = 'previous'\n")
    }

    /// With these lines of configuration.
    fn with(law: &str) -> Self {
        let place = Place::new();
        let witness = Witness::new(&place);
        let own = place.file("own.toml", scene::PAPER_SIM);
        fs::copy(memory_file(), place.path("own.vpcmem")).unwrap();
        let mut daemon = place.vpcd(law);
        daemon.arg("--scene").arg(own);
        let mut shown = Self {
            daemon: Running::start(daemon),
            _camera: Running::start(place.hw_sim(0)),
            place,
            witness,
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
        let mut command = testkit::command(program("vpcctl"));
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
    let _turn = turn();
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
    let _turn = turn();
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
        again.stderr.contains("stopped since it was last armed"),
        "{again:?}"
    );
    assert!(shown.witness.commands().iter().all(is_still));
}

#[test]
fn a_goal_that_cannot_be_taken_up_changes_nothing() {
    let _turn = turn();
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
    assert!(!log.1.contains("SIGHUP: goes on"), "{log:?}");
    assert_eq!(log.0, 0);
}

#[test]
fn its_memory_is_built_and_taken_up() {
    let _turn = turn();
    let mut shown = Shown::with("memory = 'own.vpcmem'\n[law]\nstrategy = 'foresight'\n");
    let memory = shown.place.path("own.vpcmem");
    let before = fs::read(&memory).unwrap();
    shown.taught();
    assert_ne!(fs::read(&memory).unwrap(), before);
    assert_eq!(
        fs::read(shown.place.path("own.vpcmem.before")).unwrap(),
        before
    );
    eventually("arming", || {
        (shown.witness.ask(Action::Arm) == Outcome::Done).then_some(())
    });
    eventually("the goal", || {
        let arrived = |record: &CycleRecord| record.state == TwistState::Arrived.code();
        shown.witness.records().iter().any(arrived).then_some(())
    });
}
