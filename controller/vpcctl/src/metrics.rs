//! `vpcctl metrics`: the Prometheus text format, 0.0.4.

use std::fmt::Display;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::Router;
use axum::http::header::CONTENT_TYPE;
use axum::response::Html;
use axum::routing::get;
use messages::{
    ArmBound, CycleRecord, Hold, PhaseCode, RealTime, RobotFaults, RobotMode, Table, TwistState,
};
use program::Exit;

use crate::failure::Failure;
use crate::latency::{BOUNDS, Histogram, STAGES};
use crate::request::strategy_name;
use crate::status::{self, Status};
use crate::view::View;
use crate::watcher::Watcher;
use crate::{output, server};

/// Time between two looks at the ports.
const LOOK: Duration = Duration::from_millis(50);
/// Silence after which the daemon does not count as up: three seconds, or 100 periods of 30 Hz.
const SILENCE_NS: u64 = 3_000_000_000;
/// The media type of the text format.
const MEDIA: &str = "text/plain; version=0.0.4; charset=utf-8";
/// What the root has.
const INDEX: &str = "<!doctype html><title>vpcctl</title><a href=\"/metrics\">metrics</a>\n";

/// Type, name and help of each family. Counters of the daemon begin with it; those of the observer,
/// and histograms, with vpcctl.
const FAMILIES: [&str; 32] = [
    "gauge vpc_up Whether cycles are coming.",
    "counter vpc_observer_missed_records_total Records of cycles that this exporter missed.",
    "counter vpc_observer_refused_messages_total Messages that broke the contract.",
    "counter vpc_observer_restarts_total Starts of the daemon after the first one seen.",
    "gauge vpc_last_cause_info What kept the law's twist back last, or disarmed it; stays after the daemon's end.",
    "counter vpc_observed_cycles_total Cycles watched, by what kept the law's twist back.",
    "counter vpc_observed_recalls_total Cycles watched in which the memory was asked.",
    "counter vpc_observed_page_faults_total Page faults of the loop's thread from wake to send.",
    "counter vpc_observed_blocking_calls_total Calls of the loop's thread that blocked from wake to send.",
    "counter vpc_observed_heap_calls_total Calls of the heap by the loop's thread from wake to send.",
    "histogram vpc_cycle_duration_seconds From waking up to having sent.",
    "histogram vpc_phase_duration_seconds Stages of a cycle; wake is the time after the release.",
    "counter vpc_cycles_total Cycles since the daemon's start.",
    "counter vpc_overruns_total Releases missed since the daemon's start.",
    "counter vpc_lost_records_total Records lost since the daemon's start.",
    "gauge vpc_last_cycle_age_seconds Since the newest cycle.",
    "gauge vpc_cycle_rate_hertz Cycles a second, measured.",
    "gauge vpc_state 1 for the present state, 0 for the others.",
    "gauge vpc_strategy_info The strategy in use.",
    "gauge vpc_realtime_degraded 1 where real time was asked for and something of it is missing.",
    "gauge vpc_phase_state The grid of releases against the camera's frames.",
    "gauge vpc_phase_error_seconds This release after the one aimed at.",
    "gauge vpc_features_age_seconds Age of the features at wake-up.",
    "gauge vpc_error_pixels Largest component of s - s*.",
    "gauge vpc_clearance_pixels Least clearance from an occlusion.",
    "gauge vpc_twist_linear_meters_per_second Camera velocity sent, camera frame.",
    "gauge vpc_twist_angular_radians_per_second Camera velocity sent, camera frame.",
    "gauge vpc_arm_bound 1 for what of the arm binds the command, 0 for the others.",
    "gauge vpc_robot_mode 1 for the present mode, 0 for the others.",
    "gauge vpc_robot_fault 1 where the robot reports it.",
    "gauge vpc_image_rate_hertz Frames of the camera a second, lost ones too.",
    "gauge vpc_image_age_seconds Since the newest image was published.",
];

/// Watches for this time and prints the metrics.
///
/// # Errors
/// The domain cannot be joined or watched; the output cannot be written.
pub fn once(directory: &Path, watch: Duration) -> Result<Exit, Failure> {
    let mut watcher = Watcher::open(directory)?;
    let mut status = Status::new(&watcher);
    status::watch_until(Instant::now() + watch, &mut watcher, &mut status)?;
    output::write(&text(&status.view, ipc::now_ns()))?;
    Ok(Exit::Ok)
}

/// Serves the metrics until a signal comes.
///
/// # Errors
/// The domain cannot be watched; the address cannot be used.
pub fn serve(mut watcher: Watcher, address: SocketAddr) -> Result<Exit, Failure> {
    let status: &'static Mutex<Status> = Box::leak(Box::new(Mutex::new(Status::new(&watcher))));
    let page = async || {
        let status = status.lock().unwrap_or_else(PoisonError::into_inner);
        ([(CONTENT_TYPE, MEDIA)], text(&status.view, ipc::now_ns()))
    };
    let routes = Router::new()
        .route("/metrics", get(page))
        .route("/", get(Html(INDEX)));
    let routes = match address.ip().is_loopback() {
        true => server::for_plain_hosts(routes),
        false => routes,
    };
    let line = |address| format!("metrics at http://{address}/metrics\n");
    server::serve(
        address,
        routes,
        line,
        status::keep(status, &mut watcher, LOOK, |_| ()),
    )
}

/// Text under construction.
#[derive(Default)]
struct Text {
    text: String,
    family: &'static str,
}

impl Text {
    /// A sample of a family of one kind of samples.
    fn sample(&mut self, family: &'static str, labels: &str, value: impl Display) {
        self.head(family);
        self.line(family, labels, value);
    }

    /// The head of a family, before its first sample.
    fn head(&mut self, name: &'static str) {
        let families = FAMILIES.iter().map(|family| family.splitn(3, ' '));
        let family = families.map(Vec::from_iter).find(|words| words[1] == name);
        if let Some([kind, _, help]) = family.as_deref()
            && self.family != name
        {
            self.text += &format!("# HELP {name} {help}\n# TYPE {name} {kind}\n");
            self.family = name;
        }
    }

    fn line(&mut self, name: &str, labels: &str, value: impl Display) {
        let labels = match labels {
            "" => String::new(),
            labels => format!("{{{labels}}}"),
        };
        self.text += &format!("{name}{labels} {value}\n");
    }

    /// A family with a sample for each value: 1 for the present one.
    fn codes(&mut self, family: &'static str, label: &str, table: &Table, present: u32) {
        for name in table.names {
            let label = format!("{label}=\"{}\"", name.text);
            self.sample(family, &label, u8::from(name.number == present));
        }
    }

    fn histogram(&mut self, family: &'static str, labels: &str, histogram: &Histogram) {
        self.head(family);
        let comma = if labels.is_empty() { "" } else { "," };
        let bounds = BOUNDS.iter().map(|&bound| seconds(bound).to_string());
        let mut below = 0;
        for (count, bound) in histogram
            .counts
            .iter()
            .zip(bounds.chain(["+Inf".to_owned()]))
        {
            below += count;
            let labels = format!("{labels}{comma}le=\"{bound}\"");
            self.line(&format!("{family}_bucket"), &labels, below);
        }
        self.line(&format!("{family}_sum"), labels, seconds(histogram.sum_ns));
        self.line(&format!("{family}_count"), labels, below);
    }
}

fn seconds(ns: u64) -> f64 {
    ns as f64 / 1e9
}

/// A number as the format writes it.
fn number(value: f64) -> String {
    match value {
        f64::INFINITY => "+Inf".to_owned(),
        f64::NEG_INFINITY => "-Inf".to_owned(),
        _ => value.to_string(),
    }
}

/// The metrics. Gauges of a daemon that is silent are left out, all but its last cause.
pub fn text(view: &View, now_ns: u64) -> String {
    let mut out = Text::default();
    let silence = view.silence_ns(now_ns);
    let up = silence.filter(|&silence| silence < SILENCE_NS);
    out.sample("vpc_up", "", u8::from(up.is_some()));
    observer(&mut out, view);
    if let (Some(silence), Some(last)) = (up, view.latest()) {
        out.sample("vpc_last_cycle_age_seconds", "", seconds(silence));
        daemon(&mut out, last);
        if let Some(rate) = view.rate_hz() {
            out.sample("vpc_cycle_rate_hertz", "", rate);
        }
        robot(&mut out, view, now_ns);
    }
    image(&mut out, view, now_ns);
    out.text
}

fn observer(out: &mut Text, view: &View) {
    out.sample("vpc_observer_missed_records_total", "", view.missed);
    out.sample("vpc_observer_refused_messages_total", "", view.refused);
    out.sample("vpc_observer_restarts_total", "", view.restarts);
    if view.latest().is_some() {
        let cause = view
            .cause()
            .map_or("none".to_owned(), |hold| hold.to_string());
        let label = format!("cause=\"{cause}\"");
        out.sample("vpc_last_cause_info", &label, 1);
    }
    for hold in Hold::TABLE.names {
        let count = view.held.get(&hold.number).copied().unwrap_or(0);
        let cause = format!("cause=\"{}\"", hold.text);
        out.sample("vpc_observed_cycles_total", &cause, count);
    }
    out.sample("vpc_observed_recalls_total", "", view.recalled);
    let [minor, major, blocked, heap] = view.disturbances;
    out.sample("vpc_observed_page_faults_total", "kind=\"minor\"", minor);
    out.sample("vpc_observed_page_faults_total", "kind=\"major\"", major);
    out.sample("vpc_observed_blocking_calls_total", "", blocked);
    out.sample("vpc_observed_heap_calls_total", "", heap);
    let [stages @ .., cycle] = &view.histograms;
    out.histogram("vpc_cycle_duration_seconds", "", cycle);
    for (stage, histogram) in STAGES.iter().zip(stages) {
        let label = format!("phase=\"{stage}\"");
        out.histogram("vpc_phase_duration_seconds", &label, histogram);
    }
}

fn daemon(out: &mut Text, last: &CycleRecord) {
    out.sample("vpc_cycles_total", "", last.cycle);
    out.sample("vpc_overruns_total", "", last.overruns);
    out.sample("vpc_lost_records_total", "", last.lost_records);
    out.codes("vpc_state", "state", &TwistState::TABLE, last.state);
    let strategy = strategy_name(last.strategy, last.neighbours);
    let label = format!("strategy=\"{strategy}\"");
    out.sample("vpc_strategy_info", &label, 1);
    let is_degraded = RealTime(last.realtime).is_degraded();
    out.sample("vpc_realtime_degraded", "", u8::from(is_degraded));
    out.codes("vpc_phase_state", "phase", &PhaseCode::TABLE, last.phase);
    let error_s = last.phase_error_ns as f64 / 1e9;
    out.sample("vpc_phase_error_seconds", "", error_s);
    if last.features_sequence > 0 {
        let age_s = seconds(last.features_age_ns);
        out.sample("vpc_features_age_seconds", "", age_s);
    }
    out.sample("vpc_error_pixels", "", number(last.error_px));
    out.sample("vpc_clearance_pixels", "", number(last.clearance_px));
    let linear = "vpc_twist_linear_meters_per_second";
    let angular = "vpc_twist_angular_radians_per_second";
    for (i, value) in last.twist.iter().enumerate() {
        let axis = ["axis=\"x\"", "axis=\"y\"", "axis=\"z\""][i % 3];
        out.sample(if i < 3 { linear } else { angular }, axis, number(*value));
    }
    out.codes("vpc_arm_bound", "bound", &ArmBound::TABLE, last.arm_bound);
}

fn robot(out: &mut Text, view: &View, now_ns: u64) {
    let Some(robot) = view.robot_at(now_ns) else {
        return;
    };
    out.codes("vpc_robot_mode", "mode", &RobotMode::TABLE, robot.mode);
    for fault in RobotFaults::TABLE.names {
        let is_set = u8::from(robot.faults & fault.number != 0);
        let label = format!("fault=\"{}\"", fault.text);
        out.sample("vpc_robot_fault", &label, is_set);
    }
}

/// The camera is no part of the daemon, and may be there without it.
fn image(out: &mut Text, view: &View, now_ns: u64) {
    if let Some(rate) = view.image_rate_hz() {
        out.sample("vpc_image_rate_hertz", "", rate);
    }
    if let Some(image) = view.image() {
        let age_ns = now_ns.saturating_sub(image.stamp.published_ns);
        out.sample("vpc_image_age_seconds", "", seconds(age_ns));
    }
}

#[cfg(test)]
mod tests {
    use messages::{Order, Received};

    use super::*;
    use crate::view::tests::{images, record};

    fn view() -> View {
        let mut view = View::default();
        for number in 1..=3 {
            let message = record(number, TwistState::Moving, None);
            let order = Order::Next;
            view.cycle(&Received { message, order });
        }
        view
    }

    #[test]
    fn buckets_are_cumulative_and_in_seconds() {
        let text = text(&view(), 0);
        // Cycles of 1, 2 and 3 us.
        for line in [
            "vpc_cycle_duration_seconds_bucket{le=\"0.000001\"} 1",
            "vpc_cycle_duration_seconds_bucket{le=\"0.000002\"} 2",
            "vpc_cycle_duration_seconds_bucket{le=\"0.000005\"} 3",
            "vpc_cycle_duration_seconds_bucket{le=\"+Inf\"} 3",
            "vpc_cycle_duration_seconds_count 3",
            "vpc_phase_duration_seconds_count{phase=\"step\"} 3",
            "vpc_state{state=\"moving\"} 1",
            "vpc_state{state=\"holding\"} 0",
            "vpc_arm_bound{bound=\"none\"} 1",
            "vpc_arm_bound{bound=\"wall\"} 0",
            "vpc_observed_cycles_total{cause=\"none\"} 3",
            "vpc_cycles_total 3",
            "vpc_up 1",
        ] {
            assert!(
                text.lines().any(|found| found == line),
                "{line} is missing:\n{text}"
            );
        }
    }

    #[test]
    fn every_family_has_one_head_before_its_samples() {
        let mut view = view();
        let mut robot = messages::RobotState::free_camera([0.0, 0.0, 0.5], [0.0; 3], 0);
        robot.stamp.published_ns = 30_000_000;
        view.robot = Some(robot);
        images(&mut view, &[1, 2]);
        let text = text(&view, 30_000_000);
        let mut heads = std::collections::BTreeSet::new();
        let mut family = "";
        for line in text.lines() {
            match line
                .strip_prefix("# TYPE ")
                .and_then(|head| head.split_once(' '))
            {
                Some((name, _)) => {
                    assert!(heads.insert(name), "{name} twice");
                    family = name;
                }
                None if line.starts_with('#') => (),
                None => {
                    let name = line.split(['{', ' ']).next().unwrap();
                    assert!(name.starts_with(family), "{line} below {family}");
                }
            }
        }
        assert_eq!(
            heads.len() + 1,
            FAMILIES.len(),
            "all but the age of features"
        );
    }

    #[test]
    fn a_silent_daemon_is_down_and_its_gauges_are_gone() {
        let text = text(&view(), 10_000_000_000);
        assert!(text.contains("\nvpc_up 0\n"), "{text}");
        assert!(
            text.contains("\nvpc_last_cause_info{cause=\"none\"} 1\n"),
            "{text}"
        );
        assert!(!text.contains("vpc_state") && text.contains("vpc_cycle_duration_seconds_count 3"));
    }

    #[test]
    fn images_are_told_also_without_a_daemon() {
        let mut view = View::default();
        assert!(!text(&view, 0).contains("vpc_image"));
        images(&mut view, &[1, 2, 101]);
        let text = text(&view, 4_010_000_000);
        assert!(text.contains("\nvpc_image_rate_hertz 100\n"), "{text}");
        assert!(text.contains("\nvpc_image_age_seconds 3\n"), "{text}");
    }

    #[test]
    fn a_scene_without_occlusions_has_an_infinite_clearance() {
        assert_eq!(number(f64::INFINITY), "+Inf");
        assert_eq!(number(f64::NAN), "NaN");
    }
}
