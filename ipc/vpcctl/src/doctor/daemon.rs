//! The daemon: its process, its answers, its cycles.

use std::path::Path;
use std::time::Duration;

use super::Finding;
use crate::exit::Failure;
use crate::presence::Presence;
use crate::status::{self, Asking, Cycles, Status};
use crate::words::duration;

pub(super) fn examine(directory: &Path, watch: Duration) -> Vec<Finding> {
    let what = "daemon";
    let presence = Presence::of(directory);
    let mut findings = Vec::new();
    match presence {
        // Joining would create it.
        Presence::NoDomain => return vec![nobody(directory)],
        Presence::NoDaemon => (),
        Presence::Process(process) => findings.push(life(process)),
    }
    match status::look(directory, watch, Asking::Always) {
        Ok(status) => findings.extend(health(&status)),
        Err(Failure::NoDaemon { .. }) => findings.push(nobody(directory)),
        Err(failure) => {
            let remedy = "mend what the line says; other versions of vpcd and vpcctl do not mix";
            findings.push(Finding::fail(what, failure.to_string(), remedy));
        }
    }
    findings
}

fn nobody(directory: &Path) -> Finding {
    let path = directory.display();
    let remedy = format!("start it: vpcd --domain {path} --config FILE, or systemctl start vpcd");
    Finding::warn("daemon", format!("none is at work in {path}"), remedy)
}

/// What the kernel says of the process.
fn life(process: u32) -> Finding {
    let what = "process";
    let Ok(stat) = std::fs::read_to_string(format!("/proc/{process}/stat")) else {
        return Finding::warn(
            what,
            format!("{process}: hidden, or ended just now"),
            "look again",
        );
    };
    let is_realtime = std::fs::read_dir(format!("/proc/{process}/task"))
        .into_iter()
        .flatten()
        .filter_map(|task| std::fs::read_to_string(task.ok()?.path().join("stat")).ok())
        .any(|stat| field(&stat, POLICY) == Some("1"));
    judge(process, field(&stat, STATE).unwrap_or("?"), is_realtime)
}

/// Age from which on features are none, ns.
const SILENT_NS: u64 = 500_000_000;

/// Place of the state in `/proc/PID/stat`, counted from behind the name.
const STATE: usize = 0;
/// Place of the scheduling policy.
const POLICY: usize = 38;

/// A field of `/proc/PID/stat`; the name before them may have blanks and brackets in it.
fn field(stat: &str, place: usize) -> Option<&str> {
    stat.rsplit_once(')')?.1.split_whitespace().nth(place)
}

fn judge(process: u32, state: &str, is_realtime: bool) -> Finding {
    let what = "process";
    match (state, is_realtime) {
        ("T" | "t", _) => {
            let remedy = format!("kill -CONT {process}, or end it: kill -KILL {process}");
            Finding::fail(
                what,
                format!("{process}: stopped by a signal or a debugger"),
                remedy,
            )
        }
        ("Z" | "X", _) => {
            let remedy = "its parent must collect it; start the daemon anew";
            Finding::fail(what, format!("{process}: dead"), remedy)
        }
        (_, true) => Finding::ok(what, format!("{process}: alive, real-time (SCHED_FIFO)")),
        (_, false) => {
            let remedy = "fine for simulation; else set realtime.priority, see `vpcd --preflight`";
            let words = format!("{process}: alive, without real-time scheduling");
            Finding::warn(what, words, remedy)
        }
    }
}

fn health(status: &Status) -> Vec<Finding> {
    let what = "daemon";
    if status.hangs() {
        let remedy = match status.process {
            Some(process) => {
                format!("see its log; kill -TERM {process}, then -KILL, and start anew")
            }
            None => "the last process of this domain that published cycles is gone".to_owned(),
        };
        return vec![Finding::fail(
            what,
            "neither answers nor goes on with its cycles",
            remedy,
        )];
    }
    let state = status.state.as_deref().unwrap_or("unknown");
    let mut findings = vec![match &status.cause {
        Some(cause) => Finding::warn(what, format!("{state}: {cause}"), remedy(cause)),
        None => Finding::ok(what, state),
    }];
    if status.answered == Some(false) {
        let words = "publishes cycles, but did not answer";
        findings.push(Finding::warn(
            "requests",
            words,
            "is it overloaded? see its log",
        ));
    }
    for service in &status.full {
        let words = format!("{service}: all subscribers' places are taken");
        findings.push(Finding::warn(
            "places",
            words,
            "end observers that are not needed",
        ));
    }
    let Some(cycles) = &status.cycles else {
        let remedy = "in lockstep it waits for features: is the camera (hw-sim) at work?";
        findings.push(Finding::warn("cycles", "none came while watching", remedy));
        return findings;
    };
    findings.push(camera(cycles));
    let words = format!("{} overruns in {} cycles", cycles.overruns, cycles.cycle);
    findings.push(match cycles.overruns {
        0 => Finding::ok("deadline", words),
        _ => {
            let remedy = "real-time priority, an idle machine: `vpcd --preflight` says what lacks";
            Finding::warn("deadline", words, remedy)
        }
    });
    if let Some(lacks) = cycles
        .realtime_lacks
        .as_ref()
        .filter(|lacks| !lacks.is_empty())
    {
        let remedy = "`vpcd --preflight` says how to get it";
        findings.push(Finding::warn("real time", lacks.join(", "), remedy));
    }
    if cycles.lost_records > 0 {
        let words = format!("{} lost by the daemon", cycles.lost_records);
        let remedy = "its ordinary thread gets too little time: fewer processes on its core";
        findings.push(Finding::warn("records", words, remedy));
    }
    if let Some(robot) = status
        .robot
        .as_ref()
        .filter(|robot| !robot.faults.is_empty())
    {
        let words = format!("{}: {}", robot.mode, robot.faults.join(", "));
        findings.push(Finding::warn(
            "robot",
            words,
            "clear the fault at the robot",
        ));
    }
    findings
}

/// Whether features come: a daemon that is disarmed does not complain of it, and cannot be armed without.
fn camera(cycles: &Cycles) -> Finding {
    let what = "camera";
    let remedy = "start the camera in this domain: hw-sim --domain DIR, or your own (CONTRACT.md)";
    match cycles.features_age_ns {
        None => Finding::warn(what, "no features came, or no good ones", remedy),
        Some(age) if age > SILENT_NS => {
            let words = format!("the newest features are {} old", duration(age));
            Finding::warn(what, words, remedy)
        }
        Some(age) => {
            let words = format!("{} points, {} old", cycles.count, duration(age));
            Finding::ok(what, words)
        }
    }
}

/// What helps against a cause, in the words of the contract.
fn remedy(cause: &str) -> &'static str {
    match cause {
        "no features" | "stale features" | "features lost" => {
            "start the camera in this domain; if its points are late, see its rate and delay"
        }
        "invalid message" | "wrong count" | "not finite" => {
            "the camera breaks the contract: CONTRACT.md, and the pattern of the scene"
        }
        "hidden point" | "off image" => "bring the whole pattern into the image",
        "points mixed up" => {
            "the camera must name its points as the scene does, and keep the names: pattern.points"
        }
        "frozen image" => "the camera sends one picture again and again: start its driver anew",
        "recall out of range" => {
            "the memory does not suit what is seen: vpc-memory build, or vpcctl strategy previous"
        }
        "features out of order" | "clock anomaly" => {
            "data_ns must be CLOCK_MONOTONIC of this machine, and grow"
        }
        "robot fault" | "robot silent" => "clear the fault at the robot, or start its client",
        "overruns" | "standstill of the loop" => "the machine is overloaded: `vpcd --preflight`",
        "not armed" | "operator" => "vpcctl arm",
        _ => "see the daemon's log",
    }
}

#[cfg(test)]
mod tests {
    use super::super::Verdict;
    use super::*;
    use crate::view::View;
    use crate::view::tests::record;
    use ipc::{Hold, Order, Received, TwistState};

    #[test]
    fn fields_are_counted_behind_a_nasty_name() {
        let tail: Vec<String> = (4..=52).map(|n| n.to_string()).collect();
        let stat = format!("12 (a) b) T {}", tail.join(" "));
        assert_eq!(field(&stat, STATE), Some("T"));
        // proc(5) numbers the policy 41.
        assert_eq!(field(&stat, POLICY), Some("41"));
    }

    #[test]
    fn a_stopped_process_is_a_failure_with_its_number_in_the_remedy() {
        let finding = judge(77, "T", true);
        assert_eq!(finding.verdict, Verdict::Fail);
        assert!(finding.remedy.starts_with("kill -CONT 77"));
        assert_eq!(judge(77, "S", true).verdict, Verdict::Ok);
        assert_eq!(judge(77, "S", false).verdict, Verdict::Warn);
    }

    #[test]
    fn a_camera_that_is_not_there_or_silent_is_missed_though_the_daemon_does_not_complain() {
        let seen = |features_sequence, age_ns| {
            let mut view = View::default();
            let mut message = record(5, TwistState::Disarmed, Hold::NotArmed);
            (message.features_sequence, message.features_age_ns) = (features_sequence, age_ns);
            let order = Order::First;
            view.cycle(&Received { message, order });
            let now_ns = message.stamp.published_ns;
            let findings = health(&Status::of(&view, None, now_ns));
            findings
                .into_iter()
                .find(|finding| finding.what == "camera")
        };
        let none = seen(0, 0).unwrap();
        assert_eq!(none.verdict, Verdict::Warn);
        assert!(none.remedy.contains("hw-sim --domain"), "{none:?}");
        let silent = seen(7, 2_000_000_000).unwrap();
        assert_eq!(silent.verdict, Verdict::Warn);
        assert!(silent.found.contains("2.00 s old"), "{silent:?}");
        assert_eq!(seen(7, 33_000_000).unwrap().verdict, Verdict::Ok);
    }

    #[test]
    fn every_cause_has_a_remedy_of_its_own_but_those_inside_the_daemon() {
        let general = remedy("");
        let without: Vec<String> = (1..)
            .map_while(ipc::Hold::from_code)
            .map(|hold| hold.to_string())
            .filter(|cause| remedy(cause) == general)
            .collect();
        assert_eq!(
            without,
            ["transport", "bad twist", "solver failure", "shutdown"]
        );
    }
}
