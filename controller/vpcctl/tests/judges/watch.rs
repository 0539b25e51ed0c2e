//! `watch` in a terminal that `script` (util-linux) makes.

use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::stand_in::StandIn;
use crate::vpcctl;

/// Longest wait for anything, on a loaded machine.
const PATIENCE: Duration = Duration::from_secs(20);

/// A view in a terminal of its own.
struct Terminal {
    script: Child,
    process: u32,
}

impl Terminal {
    /// Starts the view; returns when it has drawn. `None` if `script` is not installed.
    fn start(domain: &Path) -> Option<Self> {
        let note = domain.join("watch.pid");
        let program = env!("CARGO_BIN_EXE_vpcctl");
        let (note_name, domain) = (note.display(), domain.display());
        let line = format!(
            "stty rows 24 cols 80; echo $$ > {note_name}; exec {program} --domain {domain} watch"
        );
        let mut script = testkit::command("script")
            .args(["-q", "-e", "-c", &line, "/dev/null"])
            .env("TERM", "xterm")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .ok()?;
        let mut output = script.stdout.take().unwrap();
        let seen = Arc::new(Mutex::new(String::new()));
        let writer = Arc::clone(&seen);
        std::thread::spawn(move || {
            let mut piece = [0; 4096];
            while let Ok(count @ 1..) = output.read(&mut piece) {
                *writer.lock().unwrap() += &String::from_utf8_lossy(&piece[..count]);
            }
        });
        let end = Instant::now() + PATIENCE;
        while !seen.lock().unwrap().contains("flight") {
            assert!(
                Instant::now() < end,
                "nothing is drawn:\n{}",
                seen.lock().unwrap()
            );
            std::thread::sleep(Duration::from_millis(20));
        }
        let process = std::fs::read_to_string(&note)
            .unwrap()
            .trim()
            .parse()
            .unwrap();
        Some(Self { script, process })
    }

    fn press(&mut self, keys: &str) {
        self.script
            .stdin
            .as_mut()
            .unwrap()
            .write_all(keys.as_bytes())
            .unwrap();
    }

    /// Whether the view has ended.
    fn ended(&self) -> bool {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.process));
        stat.map_or(true, |stat| stat.contains(") Z "))
    }

    /// Whether the view ends within the time that a loaded machine may take.
    fn ends(&self) -> bool {
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end {
            if self.ended() {
                return true;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        false
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if !self.ended() {
            let process = self.process.to_string();
            let _ = testkit::command("kill").args(["-KILL", &process]).status();
        }
        let _ = self.script.kill();
        let _ = self.script.wait();
    }
}

#[test]
fn keys_command_the_daemon_and_q_quits() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let Some(mut terminal) = Terminal::start(directory.path()) else {
        testkit::not_run("watch in a terminal", "no script(1)");
        return;
    };
    let becomes = |code: i32| {
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end {
            let status = vpcctl(directory.path(), &["status", "--watch", "0.1"]);
            if status.status.code() == Some(code) {
                return true;
            }
        }
        false
    };
    terminal.press("a");
    assert!(becomes(0), "a did not arm");
    terminal.press(" ");
    assert!(becomes(5), "the space bar did not stop");
    terminal.press("q");
    assert!(terminal.ends());
    assert_eq!(terminal.script.wait().unwrap().code(), Some(0));
}

#[test]
fn a_terminal_that_goes_away_ends_the_view() {
    let directory = tempfile::tempdir().unwrap();
    let _daemon = StandIn::sound(directory.path());
    let Some(mut terminal) = Terminal::start(directory.path()) else {
        testkit::not_run("watch in a terminal", "no script(1)");
        return;
    };
    terminal.script.kill().unwrap();
    assert!(terminal.ends());
}
