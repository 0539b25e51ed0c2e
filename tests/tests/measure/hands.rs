//! A stop by a hand on the files, and on a disk that is full: whatever happens to the stop file,
//! the camera stands, and nobody says so who does not know.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use ipc::now_ns;
use messages::{Action, Hold, Outcome};
use rustix::process::Signal;

use crate::fixture::{
    CAMERA_PRIORITY, Ended, PERIOD_NS, Place, Running, Stage, Witness, classes, ended, eventually,
    is_still, on_time, program, root, scene_file,
};
use crate::judge::{Miss, NotShown, in_time};
use crate::reference::Class;
use crate::sheet::Sheet;

/// From the end of what the hand did to the first zero twist, ns.
const ZERO_NS: u64 = 3 * PERIOD_NS;

/// Exit code of `vpcctl stop` where the controller does not answer within a second.
const NO_ANSWER: i32 = 4;

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

/// Measures the hands.
pub fn measure(sheet: &mut Sheet) {
    for (number, (line, is_usable)) in HANDS.into_iter().enumerate() {
        let stopped = sheet.round(&classes(), line, || stopped_by(number, line, is_usable));
        if let Some(ns) = stopped {
            sheet.longest("zero after", ns, ZERO_NS);
        }
    }
}

/// How long after the end of the shell's line the zero twist went out, ns, at most.
fn stopped_by(number: usize, line: &str, is_usable: bool) -> anyhow::Result<u64> {
    let mut stage = Stage::in_motion(number)?;
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
            stage.witness.set_in_motion()?;
        }
        stage.witness.commands();
        shell(stage.place.directory(), line);
        worst = worst.max(stands(&mut stage.witness, now_ns())?);
        // Who arms has to know of it.
        let outcome = stage.witness.ask(Action::Arm);
        anyhow::ensure!(outcome == Outcome::Vetoed, "armed after {line}: {outcome}");
    }
    let (domain, by_request) = match stage.place.domain().exists() {
        true => (stage.place.domain(), !is_usable),
        // Where it is now, the file is the controller's.
        false => (stage.place.path("moved"), false),
    };
    let from_ns = now_ns();
    let Ended { code, stdout, .. } = stop(&domain);
    if code == Some(NO_ANSWER) {
        let what = "vpcctl stop: no answer in time";
        return Err(Miss::upset(what, Class::Ordinary, from_ns, now_ns()).into());
    }
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
    let last = eventually("a record", || witness.records().pop());
    assert_eq!(last.hold(), Some(Hold::Operator));
    // It may come before the shell has ended.
    let from_ns = since_ns.min(zero_ns);
    Ok(in_time(
        "zero",
        Class::of_vpcd(),
        from_ns,
        zero_ns,
        ZERO_NS,
    )?)
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

/// A file system of its own until it is dropped; its size is in KiB.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(path: PathBuf, kib: u32) -> anyhow::Result<Self> {
        std::fs::create_dir(&path)?;
        let mut mount = testkit::command("mount");
        let size = format!("size={kib}k,mode=0700");
        mount.args(["-t", "tmpfs", "-o", &size, "vpc"]);
        let mounted = ended(mount.arg(&path));
        if mounted.code != Some(0) {
            return Err(NotShown(mounted.stderr.trim().to_owned()).into());
        }
        Ok(Self(path))
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

/// Measures a disk without room.
pub fn measure_full_disk(sheet: &mut Sheet) {
    if !sheet.is_root() {
        return;
    }
    for (number, way) in ["vpcctl", "python", "shell"].into_iter().enumerate() {
        let stopped = sheet.round(&classes(), way, || stopped_on_a_full_disk(number, way));
        if let Some(ns) = stopped {
            sheet.figure(&format!("{way}: zero after"), ns as f64 / 1e6, "ms");
        }
    }
    sheet.round(&classes(), "no room for the stop file", starts_without_room);
}

/// How long after one begins to stop a full disk's daemon the zero twist went out, ns.
fn stopped_on_a_full_disk(number: usize, way: &str) -> anyhow::Result<u64> {
    let place = Place::new();
    let disk = SmallDisk::mount(place.domain(), 4096)?;
    let mut witness = Witness::new(&place);
    let _daemon = Running::start(place.vpcd(""));
    let _camera = Running::start(on_time(place.hw_sim(number), CAMERA_PRIORITY));
    is_seen(&mut witness);
    witness.set_in_motion()?;
    disk.fill();
    witness.commands();
    let asked_ns = now_ns();
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
    let zero = witness.until("a zero twist", is_still);
    let zero_ns = zero.last().map_or(asked_ns, |zero| zero.stamp.published_ns);
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
    Ok(zero_ns.saturating_sub(asked_ns))
}

fn starts_without_room() -> anyhow::Result<()> {
    let place = Place::new();
    let disk = SmallDisk::mount(place.domain(), 64)?;
    // All but the stop file has its room already.
    let domain = ipc::Domain::join(&place.domain()).unwrap();
    disk.fill();
    let message = ipc::StopFile::open(domain.directory())
        .unwrap_err()
        .to_string();
    assert!(message.contains("No space left on device"), "{message}");
    Ok(())
}

/// In a process namespace of its own, so that it stops nobody else's.
pub fn measure_elsewhere(sheet: &mut Sheet) {
    if sheet.is_root() && sheet.has(&["unshare=util-linux"]) {
        sheet.round(&classes(), "daemons elsewhere", || {
            is_named_elsewhere();
            Ok(())
        });
    }
}

fn is_named_elsewhere() {
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
