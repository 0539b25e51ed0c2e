//! A stop by a hand on the files, and on a disk that is full: whatever happens to the stop file,
//! the camera stands, and nobody says so who does not know.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use ipc::now_ns;
use messages::{Action, Hold, Outcome};
use rustix::process::Signal;
use testkit::is_root;

use crate::fixture::{
    CAMERA_PRIORITY, Ended, PERIOD_NS, Place, Running, Stage, Witness, are_installed, ended,
    eventually, is_still, not_run, program, root, scene_file, tell, turn,
};
use crate::machine::on_time;
use crate::stall::{fairly, in_time};

/// From the end of what the hand did to the first zero twist, ns.
const ZERO_NS: u64 = 3 * PERIOD_NS;

/// What a hand does in the directory of the domain `domain`; and whether the file can be used
/// afterwards.
const HANDS: [(&str, bool); 10] = [
    ("date > domain/stop", true),
    ("echo stop > domain/stop", true),
    (": > domain/stop", true),
    ("touch domain/stop", true),
    ("echo >> domain/stop", true),
    ("mv domain/stop domain/elsewhere", false),
    ("ln domain/stop domain/backup; rm domain/stop", false),
    ("cp -p domain/stop new; mv new domain/stop", false),
    ("rm domain/stop", false),
    ("mv domain moved", false),
];

#[test]
fn every_hand_on_the_stop_file_is_a_stop() {
    let _turn = turn();
    let mut worst = 0;
    for (number, (line, is_usable)) in HANDS.into_iter().enumerate() {
        worst = worst.max(fairly(line, || stopped_by(number, line, is_usable)));
    }
    tell(format!(
        "{} hands on the stop file: zero after {} ms at most",
        HANDS.len(),
        worst / 1_000_000
    ));
}

/// How long after the end of the shell's line the zero twist went out, ns, at most.
fn stopped_by(number: usize, line: &str, is_usable: bool) -> anyhow::Result<u64> {
    let mut stage = Stage::in_motion(number);
    // The same again, after arming, is a stop again.
    let rounds = if is_usable { 2 } else { 1 };
    let mut worst = 0;
    for round in 0..rounds {
        if round > 0 {
            stage.camera.signal(Signal::KILL);
            eventually("the camera's end", || {
                (!stage.camera.is_running()).then_some(())
            });
            stage.camera = moving_camera(&stage, number + round);
            is_seen(&mut stage.witness);
            stage.witness.set_in_motion();
        }
        stage.witness.commands();
        shell(stage.place.directory(), line);
        worst = worst.max(stands(&mut stage.witness, now_ns())?);
        // Who arms has to know of it.
        let outcome = stage.witness.ask(Action::Arm);
        anyhow::ensure!(outcome == Outcome::Stopped, "armed after {line}: {outcome}");
    }
    let (domain, by_request) = match stage.place.domain().exists() {
        true => (stage.place.domain(), !is_usable),
        // Where it is now, the file is the controller's.
        false => (stage.place.path("moved"), false),
    };
    let Ended { code, stdout, .. } = stop(&domain);
    assert_eq!(code, Some(0), "vpcctl stop after {line}: {stdout}");
    assert_eq!(stdout.contains("by a request"), by_request, "{stdout}");
    if !is_usable {
        // Nobody could stop it any more: it cannot be armed before it is started again.
        stage.witness.ask(Action::Arm);
        std::thread::sleep(Duration::from_nanos(2 * PERIOD_NS));
        stands(&mut stage.witness, now_ns())?;
    }
    Ok(worst)
}

/// Waits for the zero twist: how long after that instant it went out. Nothing moves after it.
fn stands(witness: &mut Witness, since_ns: u64) -> anyhow::Result<u64> {
    let first = witness.until("a zero twist", is_still);
    let zero_ns = first.last().map_or(0, |zero| zero.stamp.published_ns);
    std::thread::sleep(Duration::from_nanos(4 * PERIOD_NS));
    assert!(witness.commands().iter().all(is_still), "it moves on");
    let last = witness.records().last().copied();
    let hold = last.and_then(|record| record.hold());
    assert_eq!(hold, Some(Hold::Operator));
    // It may come before the shell has ended.
    in_time("zero", since_ns.min(zero_ns), zero_ns, ZERO_NS)
}

/// Waits until the daemon has seen a camera that has just started, another one than before.
fn is_seen(witness: &mut Witness) {
    while witness.observer.features.oldest().unwrap().is_some() {}
    eventually("its features", || {
        witness.observer.features.oldest().unwrap()
    });
    std::thread::sleep(Duration::from_nanos(4 * PERIOD_NS));
}

fn moving_camera(stage: &Stage, start: usize) -> Running {
    Running::start(on_time(stage.place.hw_sim(start % 100), CAMERA_PRIORITY))
}

fn shell(directory: &Path, line: &str) {
    let mut shell = testkit::command("/bin/sh");
    shell.args(["-c", line]).current_dir(directory);
    let ended = ended(shell);
    assert_eq!(ended.code, Some(0), "{line}: {}", ended.stderr);
}

fn stop(domain: &Path) -> Ended {
    let mut vpcctl = testkit::command(program("vpcctl"));
    vpcctl.arg("--domain").arg(domain);
    ended(vpcctl.args(["stop", "--timeout", "0.5"]))
}

/// A file system of its own, of so many KiB, until it is dropped.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(path: PathBuf, kib: u32) -> Option<Self> {
        if !is_root("a file system of its own") {
            return None;
        }
        std::fs::create_dir(&path).unwrap();
        let mut mount = testkit::command("mount");
        mount.args([
            "-t",
            "tmpfs",
            "-o",
            &format!("size={kib}k,mode=0700"),
            "vpc",
        ]);
        let mounted = ended(mount.arg(&path));
        if mounted.code != Some(0) {
            not_run("a full disk", mounted.stderr.trim());
            return None;
        }
        Some(Self(path))
    }

    fn fill(&self) {
        let mut file = std::fs::File::create(self.0.join("fill")).unwrap();
        while file.write(&[1; 512]).is_ok_and(|count| count > 0) {}
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        // Lazily: processes that have files open there end after this.
        ended(testkit::command("umount").arg("-l").arg(&self.0));
    }
}

#[test]
fn on_a_full_disk_a_stop_is_a_stop() {
    let _turn = turn();
    let place = Place::new();
    let Some(disk) = SmallDisk::mount(place.domain(), 4096) else {
        return;
    };
    let mut witness = Witness::new(&place);
    let _daemon = Running::start(place.vpcd(""));
    for (number, way) in ["vpcctl", "python", "shell"].into_iter().enumerate() {
        let _camera = Running::start(on_time(place.hw_sim(number), CAMERA_PRIORITY));
        is_seen(&mut witness);
        witness.set_in_motion();
        disk.fill();
        witness.commands();
        match way {
            "vpcctl" => {
                let Ended { code, stderr, .. } = stop(&place.domain());
                assert_eq!(code, Some(0), "{stderr}");
            }
            "python" => {
                // Without iceoryx2: the function needs the file alone.
                let path = root().join("ipc/clients/python/vpc_client");
                let script = format!(
                    "import importlib.util, sys, types\n\
                     package = types.ModuleType('p'); package.__path__ = ['{0}']; sys.modules['p'] = package\n\
                     domain = types.ModuleType('p.domain'); domain.default_directory = str; sys.modules['p.domain'] = domain\n\
                     from p.stop import stop\n\
                     stop('{1}')\n",
                    path.display(),
                    place.domain().display()
                );
                let mut python = testkit::command("python3");
                python.env("PYTHONDONTWRITEBYTECODE", "1");
                let Ended { code, stderr, .. } = ended(python.args(["-c", &script]));
                assert_eq!(code, Some(0), "{stderr}");
            }
            _ => {
                // The shell empties the file, then finds no room for the words.
                let mut shell = testkit::command("/bin/sh");
                ended(
                    shell
                        .args(["-c", "date > stop"])
                        .current_dir(place.domain()),
                );
            }
        }
        witness.until("a zero twist", is_still);
        std::thread::sleep(Duration::from_nanos(4 * PERIOD_NS));
        assert!(
            witness.commands().iter().all(is_still),
            "{way}: it moves on"
        );
        std::fs::remove_file(place.domain().join("fill")).unwrap();
        // With room again the last stop is acknowledged.
        eventually("the acknowledgement", || {
            let file = std::fs::read(place.domain().join("stop")).unwrap();
            (file.len() == 64 && file[..32] == file[32..]).then_some(())
        });
    }
}

#[test]
fn without_room_for_the_stop_file_nothing_starts() {
    let _turn = turn();
    let place = Place::new();
    let Some(disk) = SmallDisk::mount(place.domain(), 64) else {
        return;
    };
    // All but the stop file has its room already.
    let domain = ipc::Domain::join(&place.domain()).unwrap();
    disk.fill();
    let message = ipc::StopFile::open(domain.directory())
        .unwrap_err()
        .to_string();
    assert!(message.contains("No space left on device"), "{message}");
}

/// In a process namespace of its own, so that it stops nobody else's.
#[test]
fn a_stop_names_daemons_at_work_elsewhere_and_stops_all() {
    let what = "a process namespace";
    if !is_root(what) || !are_installed(what, &["unshare=util-linux"]) {
        return;
    }
    let place = Place::new();
    let script = format!(
        r#"
        for name in a b; do
            {vpcd} --scene {scene} --clock lockstep --domain $name 2>log-$name &
        done
        for name in a b; do
            until [ -s $name/stop ] && [ -s $name/vpcd.pid ]; do sleep 0.02; done
        done
        {vpcctl} --domain c stop; echo "elsewhere: $?"
        {vpcctl} stop --all; echo "all: $?"
        for name in a b; do cmp -n 32 -i 0:32 $name/stop $name/stop && echo "$name obeyed"; done
        mv b moved; {vpcctl} stop --all; echo "moved: $?"
        kill -KILL -1
        "#,
        vpcd = program("vpcd").display(),
        vpcctl = program("vpcctl").display(),
        scene = scene_file().display(),
    );
    let mut unshare = testkit::command("unshare");
    unshare.args(["--pid", "--fork", "--mount-proc", "/bin/sh", "-c", &script]);
    let Ended { stdout, stderr, .. } = ended(unshare.current_dir(place.directory()));
    let all = format!("{stdout}\n{stderr}");
    let directory = place.directory().canonicalize().unwrap();
    for name in ["a", "b"] {
        let elsewhere = format!(
            "is at work in {0}/{name}: vpcctl --domain {0}/{name} stop, or vpcctl stop --all",
            directory.display()
        );
        assert!(stderr.contains(&elsewhere), "{all}");
        assert!(stdout.contains(&format!("{name} obeyed")), "{all}");
    }
    for words in ["elsewhere: 3", "all: 0", "moved: 0", "/moved: stop: done"] {
        assert!(stdout.contains(words), "{words}: {all}");
    }
}
