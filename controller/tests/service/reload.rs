//! SIGUSR2, and SIGHUP under a service manager: the daemon begins again with its files as they are
//! now, disarmed, in the same process.
//!
//! All in lockstep without a camera: the loop waits, and nothing depends on how late it is.

use std::path::PathBuf;

use rustix::process::Signal;

use crate::fixture::{Manager, Place, Running, eventually, vpcd};
use crate::frozen::{Frozen, thread};

/// A daemon with a scene of its own, which began armed and has been ready.
struct Own {
    manager: Manager,
    scene: PathBuf,
    daemon: Running,
    place: Place,
}

impl Own {
    fn begun() -> Self {
        let place = Place::new();
        let manager = Manager::new(&place);
        let scene = place.file("own.toml", scene::PAPER_SIM);
        let memory = std::fs::read(testkit::memory_file()).unwrap();
        place.file("own.vpcmem", memory);
        place.file(
            "vpcd.toml",
            "scene = 'own.toml'\nmemory = 'own.vpcmem'\n[cycle]\nclock = 'lockstep'\n",
        );
        let daemon = start(&place, &manager, "lockstep");
        Self {
            manager,
            scene,
            daemon,
            place,
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

/// The daemon of a place, ready.
fn start(place: &Place, manager: &Manager, clock: &str) -> Running {
    let mut command = vpcd();
    command.arg("--config").arg(place.path("vpcd.toml"));
    command.arg("--domain").arg(place.domain());
    command.args(["--arm", "--clock", clock]);
    let daemon = manager.manage(command, None);
    manager.until("READY=1");
    daemon
}

/// Another scene than the first.
fn other() -> String {
    format!("# another goal\n{}", scene::PAPER_SIM)
}

#[test]
fn a_request_brings_the_new_scene_disarmed_and_wrong_files_change_nothing() {
    let own = Own::begun();
    own.change("nonsense");
    own.daemon.signal(Signal::USR2);
    let log = eventually("a reason", || {
        let log = own.daemon.stderr();
        log.contains("goes on with what it has read before")
            .then_some(log)
    });
    assert!(log.contains("own.toml"), "{log}");
    assert_eq!(own.told().as_deref(), Some(scene::PAPER_SIM));
    // Mended, they count; a hang-up is the same here.
    own.change(&other());
    own.daemon.signal(Signal::HUP);
    let said = own.manager.until("RELOADING=1").concat();
    assert!(!said.contains("STOPPING=1"), "{said}");
    own.manager.until("READY=1");
    assert_eq!(own.told(), Some(other()));
    let name = std::fs::read_to_string(format!("/proc/{}/comm", own.daemon.id()));
    assert_eq!(name.unwrap().trim(), "vpcd");
    let (code, log) = own.daemon.terminated().log();
    assert_eq!(code, 0, "{log}");
    let began = log.lines().filter(|line| line.contains("INFO scene "));
    let [first, second] = began.collect::<Vec<_>>()[..] else {
        panic!("began not twice: {log}");
    };
    assert!(
        first.ends_with(", armed") && second.ends_with(", disarmed"),
        "{log}"
    );
}

/// Wherever it falls, a request to stop ends the process, and a kill is known to the next daemon.
#[test]
fn who_asks_to_stop_or_kills_it_meanwhile_wins() {
    for is_ready in [false, true] {
        for signal in [Signal::TERM, Signal::KILL] {
            let own = Own::begun();
            // Any number of them asks for no more than one.
            for _ in 0..100 {
                own.daemon.signal(Signal::USR2);
            }
            own.manager.until("RELOADING=1");
            if is_ready {
                own.manager.until("READY=1");
            }
            own.daemon.signal(signal);
            // Panics where it does not end.
            let ended = own.daemon.ended();
            if signal == Signal::TERM {
                continue;
            }
            assert_eq!(ended.signal, Some(9), "{ended:?}");
            // Nobody has armed it since it began again.
            let next = start(&own.place, &own.manager, "fixed");
            own.manager
                .until("STATUS=disarmed: unclean end of the last vpcd");
            let (code, log) = next.terminated().log();
            assert_eq!(code, 0, "{log}");
            assert!(log.contains("was killed or crashed"), "{log}");
            let began = log.lines().find(|line| line.contains("INFO scene "));
            assert!(began.unwrap().ends_with(", disarmed"), "{log}");
        }
    }
}

/// The files of a daemon that has checked them and still brakes.
#[test]
fn what_goes_wrong_after_the_check_is_taken_as_it_was_checked() {
    let third = format!("# a third goal\n{}", scene::PAPER_SIM);
    let pipe = |own: &Own, name: &str| {
        std::fs::remove_file(own.place.path(name)).unwrap();
        let made = testkit::command("mkfifo")
            .arg(own.place.path(name))
            .status();
        assert!(made.unwrap().success());
    };
    type Spoil<'a> = (&'a dyn Fn(&Own), bool);
    let spoils: [Spoil; 6] = [
        (&|own| own.change("nonsense"), true),
        (&|own| pipe(own, "own.toml"), true),
        (&|own| pipe(own, "vpcd.toml"), true),
        (&|own| drop(own.place.file("own.vpcmem", "nonsense")), true),
        (
            &|own| std::fs::remove_file(own.place.path("vpcd.toml")).unwrap(),
            true,
        ),
        (&|own| own.change(&third), false),
    ];
    for (case, (spoil, is_wrong)) in spoils.into_iter().enumerate() {
        let own = Own::begun();
        own.change(&other());
        // The loop stands, so that the end takes as long as we please.
        let frozen = Frozen::freeze(thread(own.daemon.id(), "vpcd"));
        own.daemon.signal(Signal::USR2);
        own.manager.until("RELOADING=1");
        spoil(&own);
        drop(frozen);
        own.manager.until("READY=1");
        let expected = if is_wrong { other() } else { third.clone() };
        assert_eq!(own.told(), Some(expected), "case {case}");
        let (code, log) = own.daemon.terminated().log();
        assert_eq!(code, 0, "{log}");
        let words = "begins with its files as they were checked before";
        assert_eq!(log.contains(words), is_wrong, "case {case}: {log}");
    }
}

/// As from a terminal that is closed; `nohup` is for what is to outlive it.
#[test]
fn without_a_manager_a_hang_up_ends_it_and_a_request_does_not() {
    for is_deaf in [false, true] {
        let place = Place::new();
        place.file("own.toml", scene::PAPER_SIM);
        let mut command = testkit::command("env");
        command.arg(match is_deaf {
            true => "--ignore-signal=HUP",
            false => "--default-signal=HUP",
        });
        command.arg("--unset=NOTIFY_SOCKET");
        command
            .arg(vpcd().get_program())
            .arg("--scene")
            .arg(place.path("own.toml"));
        command.arg("--domain").arg(place.domain());
        command.args(["--clock", "lockstep"]);
        command.stdout(std::process::Stdio::null());
        command.stderr(std::process::Stdio::piped());
        let mut daemon = Running::start(command);
        let begun = |daemon: &Running, times: usize| {
            let log = daemon.stderr();
            (log.matches("INFO scene ").count() == times).then_some(log)
        };
        eventually("a beginning", || begun(&daemon, 1));
        if is_deaf {
            daemon.signal(Signal::HUP);
        }
        daemon.signal(Signal::USR2);
        eventually("another one", || begun(&daemon, 2));
        assert!(daemon.is_running());
        let (code, log) = if is_deaf {
            daemon.terminated().log()
        } else {
            daemon.signal(Signal::HUP);
            daemon.ended().log()
        };
        assert_eq!(code, 0, "{log}");
        assert!(log.contains("stopped"), "{log}");
    }
}
