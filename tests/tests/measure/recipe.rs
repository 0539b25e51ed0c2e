//! The recipe of `ipc/clients/panda/README.md` for a real robot, in the folder that `vpcctl init`
//! writes, without a robot: its lines start emulator, bridge and `vpcd`, the arm moves once it is
//! armed, and where it stands can be taught as the goal.

use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Stdio};

use ipc::{Domain, Observer, now_ns};
use rustix::process::{Pid, Signal, kill_process_group};
use scene::Scene;

use crate::fixture::{Ended, Place, ended, eventually, program, root};
use crate::judge::Miss;
use crate::reference::Class;
use crate::sheet::Sheet;

/// A line of a shell, with everything that it starts; ended as a whole.
struct Line(Child);

impl Line {
    fn start(line: &str, folder: &Path) -> Self {
        let programs = program("vpcd");
        let path = std::env::var("PATH").unwrap();
        let mut shell = testkit::command("sh");
        shell
            .args(["-c", line])
            .current_dir(folder)
            .process_group(0);
        shell.env(
            "PATH",
            format!("{}:{path}", programs.parent().unwrap().display()),
        );
        shell.stdout(Stdio::null()).stderr(Stdio::null());
        Self(shell.spawn().unwrap())
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        let group = Pid::from_child(&self.0);
        let _ = kill_process_group(group, Signal::TERM);
        let _ = self.0.wait();
    }
}

/// A program in the folder, run to its end.
fn run(name: &str, words: &[&str], folder: &Path) -> Ended {
    ended(
        testkit::command(program(name))
            .args(words)
            .current_dir(folder),
    )
}

/// Where the goal of the folder's scene is.
fn goal(folder: &Path) -> [f64; 3] {
    let text = std::fs::read_to_string(folder.join("scene.toml")).unwrap();
    Scene::parse(&text, "scene.toml").unwrap().goal.translation
}

/// Measures.
pub fn measure(sheet: &mut Sheet) {
    sheet.round(&[Class::Ordinary], "the recipe", follow);
}

fn follow() -> anyhow::Result<()> {
    // The line finds these by their names.
    for name in ["hw-sim", "vpc-panda"] {
        assert!(program(name).exists());
    }
    let place = Place::new();
    let folder = place.path("cell");
    let (cell, domain) = (folder.to_str().unwrap(), place.domain());
    let domain = domain.to_str().unwrap();
    let made = run("vpcctl", &["init", "panda", cell], place.directory());
    assert_eq!(made.code, Some(0), "{made:?}");
    // The message names file, key and value.
    let daemon = folder.join("vpcd.toml");
    let text = std::fs::read_to_string(&daemon).unwrap();
    let with_memory = text.replace("# memory", "memory");
    std::fs::write(folder.join("with.toml"), with_memory).unwrap();
    let early = run("vpcd", &["--config", "with.toml", "--check-only"], &folder);
    assert_eq!(early.code, Some(66), "{early:?}");
    let words = "with.toml: memory = task.vpcmem: cannot read: No such file";
    assert!(early.stderr.contains(words), "{early:?}");

    // Three programs, in three lines.
    let readme = std::fs::read_to_string(root().join("ipc/clients/panda/README.md")).unwrap();
    let is_first = |line: &&str| !line.starts_with("D=/tmp/rehearsal");
    let lines: Vec<_> = readme.lines().skip_while(is_first).take(3).collect();
    let line = lines.join("\n");
    // An address of its own: others may rehearse on this machine.
    let own = format!("127.{}.1.1", 10 + std::process::id() % 200);
    let emulator = folder.join("hw-sim.toml");
    let text = std::fs::read_to_string(&emulator).unwrap();
    std::fs::write(emulator, text.replace("127.0.0.1", &own)).unwrap();
    let line = line
        .replace("127.0.0.1", &own)
        .replace("/tmp/rehearsal", domain);
    let mut observer = Observer::open(&Domain::join(&place.domain()).unwrap()).unwrap();
    let running = Line::start(&line, &folder);
    let ask = |words: &[&str]| {
        let words = [&["--domain", domain], words].concat();
        run("vpcctl", &words, &folder)
    };
    eventually("arming", || (ask(&["arm"]).code == Some(0)).then_some(()));
    let armed_ns = now_ns();
    // Whether a late machine disarmed it, from the instant at which it was armed.
    let disarmed = |from_ns| {
        let state = place.state();
        let miss = || Miss::upset(state.clone(), Class::Ordinary, from_ns, now_ns());
        state.starts_with("disarmed").then(miss)
    };
    let moved = eventually("motion", || {
        let newest = observer.robot.latest().unwrap();
        let moves = newest.is_some_and(|state| state.twist.iter().any(|v| v.abs() > 1e-3));
        let miss = disarmed(armed_ns);
        moves.then_some(None).or(miss.map(Some))
    });
    moved.map_or(Ok(()), Err)?;
    let class = Class::Ordinary;
    let found = ask(&["doctor"]).stdout;
    let is_found = found.contains("ok    robot");
    Miss::unless(is_found, || found.clone(), class, armed_ns)?;
    let said = ask(&["flight", "--timeout", "20"]).stdout;
    let file = Path::new(said.lines().last().unwrap_or_default());
    let is_done = said.starts_with("flight: done; ") && file.is_file();
    Miss::unless(is_done, || said.clone(), class, armed_ns)?;

    // On its way: the present view becomes the goal. Right after one another, as a script does it.
    let old = goal(&folder);
    for words in [&["disarm"][..], &["teach", "--replace"], &["arm"]] {
        let said = ask(words);
        let what = || format!("{words:?}: {said:?}");
        Miss::unless(said.code == Some(0), what, class, armed_ns)?;
    }
    let moved = goal(&folder).into_iter().zip(old).map(|(a, b)| a - b);
    let moved = moved.fold(0.0, |norm: f64, x| norm.hypot(x));
    assert!(moved > 0.01, "{moved} m");
    let armed_ns = now_ns();
    let arrived = eventually("arrival", || {
        let is_there = ask(&["status"]).stdout.contains("arrived");
        let miss = disarmed(armed_ns);
        is_there.then_some(None).or(miss.map(Some))
    });
    arrived.map_or(Ok(()), Err)?;
    drop(running);
    Ok(())
}
