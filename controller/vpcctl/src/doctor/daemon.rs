//! The daemon: its process, its answers, its cycles.

use std::path::Path;
use std::time::Duration;

use messages::{CycleRecord, Hold, RealTime};
use program::Exit;
use scene::Arm;

use super::{Finding, arm};
use crate::presence::Presence;
use crate::settings::Settings;
use crate::status::{self, Asking, Status, lacks};
use crate::units::duration;
use crate::view::{View, word};

/// Age from which features count as missing, ns.
const SILENT_NS: u64 = 500_000_000;
/// The domain of the service (systemd/vpcd.service).
const SERVICE: &str = "/run/vpcd";

/// Looks at the daemon and its robot, which should have the arm that is `given`, or else that of
/// the daemon's scene.
pub(super) fn examine(directory: &Path, watch: Duration, given: Option<&Arm>) -> Vec<Finding> {
    let mut findings = Vec::new();
    match Presence::of(directory) {
        Presence::Process(process) => findings.push(life(process)),
        _ => findings.extend(elsewhere(directory, Path::new(SERVICE))),
    }
    match status::look(directory, watch, Asking::Always) {
        Ok(mut status) => {
            status.view.arm = given.cloned().or(status.view.arm);
            findings.extend(health(&status, &Settings::of(directory)));
        }
        Err(failure) if failure.exit == Exit::NoDaemon => {
            let path = directory.display();
            let remedy =
                format!("start it: vpcd --domain {path} --config FILE, or systemctl start vpcd");
            let words = format!("none is at work in {path}");
            findings.push(Finding::warn("daemon", words, remedy));
        }
        Err(failure) => {
            let remedy = "run as the user of the domain (sudo -u), or name another --domain; other \
                          versions of vpcd and vpcctl do not mix";
            findings.push(Finding::fail("domain", failure.to_string(), remedy));
        }
    }
    findings
}

/// Whether the domain of the service exists, where no daemon runs in the one asked for.
fn elsewhere(directory: &Path, service: &Path) -> Option<Finding> {
    // Other users cannot see inside. If the directory exists, the service was started.
    if directory == service || !service.exists() {
        return None;
    }
    let path = service.display();
    let words = format!("{path} exists: the service's domain");
    let remedy = format!("to reach the service: sudo -u vpcd vpcctl --domain {path}");
    Some(Finding::warn("other domain", words, remedy))
}

/// Whether the kernel lets the process run.
fn life(process: u32) -> Finding {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    judge(process, state(&stat).unwrap_or('?'))
}

/// The state in `/proc/PID/stat`; the name before it may have blanks and brackets in it.
fn state(stat: &str) -> Option<char> {
    stat.rsplit_once(')')?.1.trim_start().chars().next()
}

fn judge(process: u32, state: char) -> Finding {
    let what = "process";
    match state {
        'T' | 't' => {
            let remedy = format!("kill -CONT {process}, or end it: kill -KILL {process}");
            let words = format!("{process}: stopped by a signal or a debugger");
            Finding::fail(what, words, remedy)
        }
        'Z' | 'X' => {
            let remedy = "its parent must collect it; start the daemon again";
            Finding::fail(what, format!("{process}: dead"), remedy)
        }
        _ => Finding::ok(what, format!("{process}: alive")),
    }
}

fn health(status: &Status, settings: &Settings) -> Vec<Finding> {
    let what = "daemon";
    if status.hangs() {
        let remedy = match status.process {
            Some(process) => {
                format!("see its log; kill -TERM {process}, then -KILL, and start it again")
            }
            None => "the last process that published cycles in this domain has ended".to_owned(),
        };
        let words = "neither answers nor goes on with its cycles";
        return vec![Finding::fail(what, words, remedy)];
    }
    let state = word(status.state());
    let mut findings = vec![match status.hold() {
        Some(hold) => {
            let cause = status.view.cause_words(status.now_ns);
            let cause = cause.unwrap_or_else(|| hold.to_string());
            Finding::warn(what, format!("{state}: {cause}"), remedy(hold))
        }
        None => Finding::ok(what, state),
    }];
    let mut warn = |what, words: String, remedy| findings.push(Finding::warn(what, words, remedy));
    if status.answered == Some(false) {
        let words = "publishes cycles, but did not answer".to_owned();
        warn("requests", words, "is it overloaded? see its log");
    }
    for service in &status.full {
        let words = format!("{service}: all subscribers' slots are taken");
        warn("slots", words, "end observers that are not needed");
    }
    findings.push(robot(&status.view, status.now_ns, settings));
    findings.extend(arm::examine(&status.view, status.now_ns));
    let mut warn = |what, words: String, remedy| findings.push(Finding::warn(what, words, remedy));
    match status.view.latest() {
        Some(last) => findings.extend(cycles(last)),
        None => {
            let remedy = "in lockstep it waits for features: is the camera (hw-sim) at work?";
            warn("cycles", "none came while watching".to_owned(), remedy);
        }
    }
    findings
}

/// What the newest cycle shows.
fn cycles(last: &CycleRecord) -> Vec<Finding> {
    let words = format!("{} overruns in {} cycles", last.overruns, last.cycle);
    let deadline = match last.overruns {
        0 => Finding::ok("deadline", words),
        _ => {
            let remedy =
                "real-time priority, an idle machine: `vpcd --preflight` says what is missing";
            Finding::warn("deadline", words, remedy)
        }
    };
    let realtime = match lacks(RealTime(last.realtime)) {
        None => Finding::ok("real time", "not asked for: fine for simulation"),
        Some(lacks) if lacks.is_empty() => Finding::ok("real time", "held"),
        Some(lacks) => {
            let remedy = "`vpcd --preflight` says how to get it";
            Finding::warn("real time", lacks.join(", "), remedy)
        }
    };
    let mut findings = vec![camera(last), deadline, realtime];
    if last.lost_records > 0 {
        let words = format!("{} lost by the daemon", last.lost_records);
        let remedy = "its ordinary thread gets too little time: fewer processes on its core";
        findings.push(Finding::warn("records", words, remedy));
    }
    findings
}

/// Whether features come: a daemon that is disarmed does not complain of their absence, and cannot
/// be armed without.
fn camera(last: &CycleRecord) -> Finding {
    let what = "camera";
    let remedy = "start the camera in this domain: hw-sim --domain DIR, or your own (CONTRACT.md)";
    let age = duration(last.features_age_ns);
    match (last.features_sequence, last.features_age_ns) {
        (0, _) => Finding::warn(what, "no features came, or no good ones", remedy),
        (_, SILENT_NS..) => {
            Finding::warn(what, format!("the newest features are {age} old"), remedy)
        }
        _ => Finding::ok(what, format!("{} points, {age} old", last.count)),
    }
}

/// What the robot's client, its bridge, tells: when, mode and faults.
fn robot(view: &View, now_ns: u64, settings: &Settings) -> Finding {
    let what = "robot";
    let Some(heard) = &view.robot else {
        if settings.does_without_robot() {
            let words = "none was heard; safety.robot = \"optional\" does without";
            return Finding::ok(what, words);
        }
        let remedy = "start its client (the bridge, such as vpc-panda) in this domain, or set \
                      safety.robot = \"optional\"";
        return Finding::warn(what, "none was heard on vpc/robot", remedy);
    };
    let age = duration(now_ns.saturating_sub(heard.stamp.published_ns));
    if view.robot_at(now_ns).is_none() {
        let remedy = "its client (the bridge) ended or hangs: start it again, then `vpcctl arm`";
        return Finding::warn(what, format!("last heard {age} ago"), remedy);
    }
    let words = format!("{}, heard {age} ago", view.robot_words(now_ns));
    match heard.faults().0 {
        0 => Finding::ok(what, words),
        _ => Finding::warn(
            what,
            words,
            "clear the fault at the robot, or: vpcctl recover",
        ),
    }
}

/// What helps against a cause.
fn remedy(hold: Hold) -> &'static str {
    match hold {
        Hold::NoFeatures | Hold::Stale | Hold::Lost => {
            "start the camera in this domain; if its points are late, see its rate and delay"
        }
        Hold::Invalid | Hold::Count | Hold::NotFinite => {
            "the camera breaks the contract: CONTRACT.md, and the pattern of the scene"
        }
        Hold::Hidden | Hold::OffImage => "bring the whole pattern into the image",
        Hold::Mixed => {
            "the camera must name its points as the scene does, and keep the names: pattern.points"
        }
        Hold::Frozen => {
            "the camera sends one image again and again: start its driver again; or data_ns is later than the exposure, and the motion is not in the image yet"
        }
        Hold::Order | Hold::Clock => "data_ns must be CLOCK_MONOTONIC of this machine, and grow",
        Hold::RobotFault => "clear the fault at the robot, then `vpcctl arm`",
        Hold::RobotLost => "start the robot's client again, then `vpcctl arm`",
        Hold::Overruns | Hold::Standstill => "the machine is overloaded: `vpcd --preflight`",
        Hold::NotArmed | Hold::Operator => "vpcctl arm",
        Hold::Arrived => "vpcctl arm, for the next run; or safety.after_arrival = \"follow\"",
        Hold::NoRobot => {
            "start the robot's client; `safety.robot = \"optional\"` where the robot tells nothing"
        }
        Hold::NoJoints => {
            "the robot must tell the positions of all joints of the arm that the scene names, in its ranges; `vpcctl doctor --scene FILE` compares them"
        }
        Hold::JointsNotFollowing => {
            "the robot's client tells joints of another arm or in another order, old or frozen ones, or another twist than it carries out; or the arm file's camera is mounted otherwise; mend it, then `vpcctl arm`"
        }
        Hold::NotFollowed => {
            "see why the robot does not move as commanded (its mode, its limits, the frames of its client), then `vpcctl arm`"
        }
        Hold::NotFollowing => {
            "the image does not move as commanded: a frozen image, another camera's, a wrong sign or mounting, or a robot that does not obey; mend it, then `vpcctl arm`"
        }
        Hold::RobotLate => {
            "the robot carries commands out too late for the law: see its client and its filters, or lower the scene's limits; then `vpcctl arm`"
        }
        Hold::ImageLate => {
            "the image shows motion too late for its stamps: data_ns must be the middle of the exposure, not the delivery; or see why the robot is late; then `vpcctl arm`"
        }
        Hold::ImageExceeds => {
            "the image moves more than twice as far as commanded: see the scale of the robot's client (m/s, rad/s), focal length and pattern; then `vpcctl arm`"
        }
        Hold::Elsewhere => {
            "the features are not where object and camera can be: see whether this is the object, then `vpcctl arm`"
        }
        Hold::NoWay => {
            "give a memory, one of more trajectories, or more law.foresight_steps; or bring the camera elsewhere by hand"
        }
        Hold::Unwanted => {
            "start the program that publishes vpc/desired; or `vpcctl strategy foresight`, for the goal"
        }
        Hold::Unclean => "find out why it ended (its log, `journalctl`), then `vpcctl arm`",
        Hold::Transport | Hold::BadTwist | Hold::Solver | Hold::Shutdown => "see the daemon's log",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::Tone;
    use crate::view::tests::record;
    use messages::{Hold, Order, Received, RobotFaults, RobotState, TwistState};

    #[test]
    fn the_state_is_found_behind_a_nasty_name() {
        assert_eq!(state("12 (a) b) T 4 5 6"), Some('T'));
        assert_eq!(state(""), None);
    }

    #[test]
    fn a_stopped_process_is_a_failure_with_its_number_in_the_remedy() {
        let finding = judge(77, 'T');
        assert_eq!(finding.verdict, Tone::Bad);
        assert!(finding.remedy.starts_with("kill -CONT 77"));
        assert_eq!(judge(77, 'S').verdict, Tone::Good);
    }

    #[test]
    fn the_services_domain_is_pointed_out() {
        let (asked, service) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let finding = elsewhere(asked.path(), service.path()).unwrap();
        assert!(finding.remedy.contains("sudo -u vpcd"), "{finding:?}");
        assert_eq!(elsewhere(service.path(), service.path()), None);
        assert_eq!(elsewhere(asked.path(), &service.path().join("none")), None);
    }

    #[test]
    fn a_silent_camera_is_missed() {
        let seen = |features_sequence, age_ns| {
            let mut status = Status::default();
            let mut message = record(5, TwistState::Disarmed, Hold::NotArmed);
            (message.features_sequence, message.features_age_ns) = (features_sequence, age_ns);
            let order = Order::First;
            status.view.cycle(&Received { message, order });
            status.now_ns = message.stamp.published_ns;
            let findings = health(&status, &Settings::default());
            findings
                .into_iter()
                .find(|finding| finding.what == "camera")
        };
        let none = seen(0, 0).unwrap();
        assert_eq!(none.verdict, Tone::Warning);
        assert!(none.remedy.contains("hw-sim --domain"), "{none:?}");
        let silent = seen(7, 2_000_000_000).unwrap();
        assert_eq!(silent.verdict, Tone::Warning);
        assert!(silent.found.contains("2.00 s old"), "{silent:?}");
        assert_eq!(seen(7, 33_000_000).unwrap().verdict, Tone::Good);
    }

    #[test]
    fn a_robot_is_told_of_with_its_age_mode_and_faults_or_missed() {
        let (mut view, needs) = (View::default(), Settings::default());
        let missed = robot(&view, 1, &needs);
        assert_eq!(missed.verdict, Tone::Warning);
        assert!(missed.remedy.contains("safety.robot"), "{missed:?}");
        let optional = toml::from_str("[safety]\nrobot = 'optional'").unwrap();
        assert_eq!(robot(&view, 1, &optional).verdict, Tone::Good);
        let mut state = RobotState::free_camera([0.0; 3], [0.0; 3], 0);
        state.stamp.published_ns = 1_000_000;
        view.robot = Some(state);
        let idle = robot(&view, 3_000_000, &needs);
        assert_eq!(idle.verdict, Tone::Good);
        assert_eq!(idle.found, "idle, heard 2.00 ms ago");
        let silent = robot(&view, 5_000_000_000, &needs);
        assert_eq!(
            (silent.verdict, &*silent.found),
            (Tone::Warning, "last heard 5.00 s ago")
        );
        state.faults = RobotFaults::REFLEX.0;
        view.robot = Some(state);
        let reflex = robot(&view, 3_000_000, &optional);
        assert_eq!(reflex.verdict, Tone::Warning);
        assert!(reflex.found.contains("reflex"), "{reflex:?}");
    }
}
