//! SIGHUP: the daemon begins again with its files as they are now, disarmed, in the same process.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::process::Signal;

use crate::fixture::{Manager, Place, Running, eventually, is_root, thread, vpcd};

/// Another scene than the first.
const OTHER: &str = "# another goal\n";

/// A daemon with a scene of its own, which began armed and has been ready.
struct Own {
    place: Place,
    manager: Manager,
    scene: PathBuf,
    daemon: Running,
}

impl Own {
    fn begun(configuration: &str) -> Self {
        let place = Place::new();
        let manager = Manager::new(&place);
        let scene = place.file("own.toml", scene::PAPER_SIM);
        let configuration = place.file("vpcd.toml", format!("scene = 'own.toml'\n{configuration}"));
        let mut command = vpcd();
        command.arg("--config").arg(configuration);
        command.arg("--domain").arg(place.domain()).arg("--arm");
        let daemon = manager.manage(command, None);
        manager.until("READY=1");
        Self {
            place,
            manager,
            scene,
            daemon,
        }
    }

    fn change(&self, text: &str) {
        std::fs::write(&self.scene, text).unwrap();
    }

    /// What viewers read.
    fn told(&self) -> Option<String> {
        std::fs::read_to_string(self.place.domain().join("scene/scene.toml")).ok()
    }
}

fn other() -> String {
    format!("{OTHER}{}", scene::PAPER_SIM)
}

#[test]
fn a_hang_up_brings_the_new_scene_disarmed() {
    let own = Own::begun("");
    own.change(&other());
    own.daemon.signal(Signal::HUP);
    let said = own.manager.until("RELOADING=1").concat();
    assert!(
        said.contains("MONOTONIC_USEC=") && !said.contains("STOPPING=1"),
        "{said}"
    );
    own.manager.until("READY=1");
    assert_eq!(own.told(), Some(other()));
    own.manager.until("STATUS=disarmed");
    let name = std::fs::read_to_string(format!("/proc/{}/comm", own.daemon.id()));
    assert_eq!(name.unwrap().trim(), "vpcd");
    let (code, log) = own.daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    let began: Vec<_> = log
        .lines()
        .filter(|line| line.contains("INFO scene "))
        .collect();
    let [first, second] = began[..] else {
        panic!("began not twice: {log}");
    };
    assert!(
        first.ends_with(", armed") && second.ends_with(", disarmed"),
        "{log}"
    );
}

#[test]
fn wrong_files_change_nothing() {
    let own = Own::begun("");
    own.change("nonsense");
    own.daemon.signal(Signal::HUP);
    own.manager.until("STATUS=holding");
    let line = eventually("a reason", || {
        let log = own.daemon.stderr();
        log.contains("SIGHUP: goes on with what it has read before")
            .then_some(log)
    });
    assert!(line.contains("own.toml"), "{line}");
    own.manager.until("STATUS=holding");
    assert_eq!(own.told().as_deref(), Some(scene::PAPER_SIM));
    // Mended, they count.
    own.change(&other());
    own.daemon.signal(Signal::HUP);
    own.manager.until("READY=1");
    assert_eq!(own.told(), Some(other()));
    assert_eq!(own.daemon.terminated().log().0, 0);
}

#[test]
fn hang_ups_without_number_do_not_end_it() {
    let own = Own::begun("");
    let begin = Instant::now();
    while begin.elapsed() < Duration::from_secs(3) {
        own.daemon.signal(Signal::HUP);
        std::thread::sleep(Duration::from_millis(1));
    }
    own.change(&other());
    own.daemon.signal(Signal::HUP);
    eventually("the new scene", || {
        (own.told() == Some(other())).then_some(())
    });
    own.manager.until("STATUS=disarmed");
    assert_eq!(own.daemon.terminated().log().0, 0);
}

/// Wherever a request to stop falls, it ends the process.
#[test]
fn who_asks_to_stop_meanwhile_wins() {
    for pause_ms in [0, 1, 2, 5, 10, 20, 35, 50] {
        let own = Own::begun("");
        own.daemon.signal(Signal::HUP);
        own.manager.until("RELOADING=1");
        std::thread::sleep(Duration::from_millis(pause_ms));
        own.daemon.signal(Signal::TERM);
        // Panics where it does not end.
        own.daemon.ended();
    }
}

#[test]
fn threads_are_scheduled_as_before() {
    if !is_root("scheduling after a hang-up") {
        return;
    }
    let own = Own::begun("[realtime]\npriority = 70\ncpu = 0\n");
    let scheduled = |name: &str| {
        let path = format!(
            "/proc/{}/task/{}",
            own.daemon.id(),
            thread(own.daemon.id(), name)
        );
        scheduling(Path::new(&path))
    };
    let before = ["vpcd", "recorder"].map(scheduled);
    own.daemon.signal(Signal::HUP);
    own.manager.until("RELOADING=1");
    own.manager.until("READY=1");
    assert_eq!(["vpcd", "recorder"].map(scheduled), before);
    let [(policy, priority, alone), (ordinary, ..)] = &before;
    assert_eq!((&**policy, &**priority, &**alone), ("1", "70", "0"));
    assert_eq!(ordinary, "0");
    assert_eq!(own.daemon.terminated().log().0, 0);
}

/// Policy (1: SCHED_FIFO), priority and processors of a thread.
fn scheduling(task: &Path) -> (String, String, String) {
    let stat = std::fs::read_to_string(task.join("stat")).unwrap();
    let (_, fields) = stat.rsplit_once(") ").unwrap();
    // Fields 40 and 41 of proc(5); the first after the name is 3.
    let field = |number: usize| fields.split(' ').nth(number - 3).unwrap().to_owned();
    let status = std::fs::read_to_string(task.join("status")).unwrap();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("Cpus_allowed_list:"));
    (field(41), field(40), line.unwrap().trim().to_owned())
}

/// What was killed after it has begun again, or while it begins, was armed by nobody since.
#[test]
fn an_unclean_end_after_a_hang_up_is_known() {
    for waits in [true, false] {
        let own = Own::begun("");
        own.daemon.signal(Signal::HUP);
        own.manager.until("RELOADING=1");
        if waits {
            own.manager.until("READY=1");
        }
        own.daemon.signal(Signal::KILL);
        own.daemon.kill();
        let mut command = vpcd();
        command.arg("--config").arg(own.place.path("vpcd.toml"));
        command.arg("--domain").arg(own.place.domain()).arg("--arm");
        let next = own.manager.manage(command, None);
        own.manager.until("STATUS=disarmed");
        let (code, log) = next.terminated().log();
        assert_eq!(code, 0, "{log}");
        assert!(log.contains("was killed or crashed"), "{log}");
    }
}
