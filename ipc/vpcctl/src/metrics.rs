//! `vpcctl metrics`: the Prometheus text format, from what watching tells.

use std::fmt::{Display, Write};
use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use ipc::{Domain, Hold, PhaseCode, RealTime, RobotMode, TwistState};

use crate::exit::{Exit, Failure};
use crate::http::{Request, Response, Server};
use crate::output;
use crate::phase::{BOUNDS, Histogram, Phase};
use crate::presence::Presence;
use crate::request::strategy_name;
use crate::view::View;
use crate::watcher::Watcher;
use crate::words::fault_names;

/// Time between two looks at the ports.
const LOOK: Duration = Duration::from_millis(50);
/// Time between two renewals of the text that is served.
const RENEWAL: Duration = Duration::from_millis(250);
/// Silence after which the daemon does not count as up: three seconds, or a hundred periods of 30 Hz.
const SILENCE_NS: u64 = 3_000_000_000;
/// The media type of the text format.
const MEDIA: &str = "text/plain; version=0.0.4; charset=utf-8";

/// Watches for a while and prints the metrics.
///
/// # Errors
/// What stands against joining, watching and writing.
pub fn once(directory: &Path, watch: Duration) -> Result<Exit, Failure> {
    let end = Instant::now() + watch;
    let mut watcher = open(directory)?;
    while Instant::now() < end {
        watcher.poll()?;
        std::thread::sleep(LOOK.min(watch));
    }
    output::write(&text(&watcher.view, ipc::now_ns()))?;
    Ok(Exit::Ok)
}

/// Serves the metrics at this address until `end`.
///
/// # Errors
/// What stands against joining, watching and listening.
pub fn serve(directory: &Path, address: SocketAddr, end: &AtomicBool) -> Result<Exit, Failure> {
    let mut watcher = open(directory)?;
    let page = Arc::new(Mutex::new(text(&watcher.view, ipc::now_ns())));
    let served = Arc::clone(&page);
    let server = Server::start(address, move |request| answer(request, address, &served))?;
    output::write(&format!("metrics at http://{}/metrics\n", server.address()))?;
    let mut renewed: Option<Instant> = None;
    while !end.load(Ordering::Relaxed) {
        watcher.poll()?;
        if renewed.is_none_or(|at| at.elapsed() >= RENEWAL) {
            let text = text(&watcher.view, ipc::now_ns());
            *page.lock().unwrap_or_else(PoisonError::into_inner) = text;
            renewed = Some(Instant::now());
        }
        std::thread::sleep(LOOK);
    }
    Ok(Exit::Ok)
}

fn open(directory: &Path) -> Result<Watcher, Failure> {
    if Presence::of(directory) == Presence::NoDomain {
        let domain = directory.display().to_string();
        return Err(Failure::NoDaemon { domain });
    }
    let mut watcher = Watcher::open(&Domain::join(directory)?)?;
    watcher.poll()?;
    Ok(watcher)
}

fn answer(request: &Request, address: SocketAddr, page: &Mutex<String>) -> Response {
    let is_local = IpAddr::is_loopback(&address.ip());
    match (request.method.as_str(), request.path.as_str()) {
        _ if is_local && !request.host_is_plain() => Response::refusal(403, "host not allowed"),
        ("GET" | "HEAD", "/metrics") => {
            let text = page.lock().unwrap_or_else(PoisonError::into_inner).clone();
            Response::whole(200, MEDIA, text)
        }
        ("GET" | "HEAD", "/") => Response::whole(
            200,
            "text/html; charset=utf-8",
            "<!doctype html><title>vpcctl</title><a href=\"/metrics\">metrics</a>\n".to_owned(),
        ),
        ("GET" | "HEAD", _) => Response::refusal(404, "see /metrics"),
        _ => Response::refusal(405, "allowed: GET"),
    }
}

/// Text under construction. Writing to a string does not fail.
struct Text(String);

impl Text {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    fn sample(&mut self, name: &str, labels: &str, value: impl Display) {
        let labels = match labels {
            "" => String::new(),
            labels => format!("{{{labels}}}"),
        };
        let _ = writeln!(self.0, "{name}{labels} {value}");
    }

    fn counter(&mut self, name: &str, help: &str, value: u64) {
        self.family(name, "counter", help);
        self.sample(name, "", value);
    }

    fn gauge(&mut self, name: &str, help: &str, value: f64) {
        self.family(name, "gauge", help);
        self.sample(name, "", number(value));
    }

    fn histogram(&mut self, name: &str, labels: &str, histogram: &Histogram) {
        let comma = if labels.is_empty() { "" } else { "," };
        let bucket = format!("{name}_bucket");
        let mut below = 0;
        for (count, bound) in histogram.counts.iter().zip(BOUNDS) {
            below += count;
            let le = seconds(bound);
            self.sample(&bucket, &format!("{labels}{comma}le=\"{le}\""), below);
        }
        let total = histogram.total();
        self.sample(&bucket, &format!("{labels}{comma}le=\"+Inf\""), total);
        self.sample(&format!("{name}_sum"), labels, seconds(histogram.sum_ns));
        self.sample(&format!("{name}_count"), labels, total);
    }
}

fn seconds(ns: u64) -> f64 {
    ns as f64 / 1e9
}

/// A number as the format writes it.
fn number(value: f64) -> String {
    match value {
        _ if value == f64::INFINITY => "+Inf".to_owned(),
        _ if value == f64::NEG_INFINITY => "-Inf".to_owned(),
        _ => value.to_string(),
    }
}

/// The metrics in the Prometheus text format, 0.0.4. Counters of the daemon start again with it; histograms and those
/// of causes count what was watched.
pub fn text(view: &View, now_ns: u64) -> String {
    let mut out = Text(String::new());
    let silence = view.silence_ns(now_ns);
    let up = silence.is_some_and(|silence| silence < SILENCE_NS);
    out.gauge(
        "vpc_up",
        "Whether cycles are coming.",
        f64::from(u8::from(up)),
    );
    watched(&mut out, view);
    if let Some(silence) = silence.filter(|_| up) {
        present(&mut out, view, silence, now_ns);
    }
    out.0
}

fn watched(out: &mut Text, view: &View) {
    let name = "vpc_observer_missed_records_total";
    out.counter(
        name,
        "Records of cycles that this exporter missed.",
        view.missed,
    );
    let name = "vpc_observer_refused_messages_total";
    out.counter(name, "Messages that broke the contract.", view.refused);
    let name = "vpc_observer_restarts_total";
    out.counter(
        name,
        "Starts of the daemon after the first one seen.",
        view.restarts,
    );
    let name = "vpc_observed_cycles_total";
    out.family(
        name,
        "counter",
        "Cycles watched, by what kept the law's twist back.",
    );
    for hold in (0..).map_while(Hold::from_code) {
        let count = view.held.get(&hold.code()).copied().unwrap_or(0);
        out.sample(name, &format!("cause=\"{hold}\""), count);
    }
    let name = "vpc_observed_recalls_total";
    out.counter(
        name,
        "Cycles watched in which the memory was asked.",
        view.recalled,
    );
    let [minor, major, blocked, heap] = view.disturbances;
    let name = "vpc_observed_page_faults_total";
    out.family(
        name,
        "counter",
        "Page faults of the loop's thread from wake to send.",
    );
    out.sample(name, "kind=\"minor\"", minor);
    out.sample(name, "kind=\"major\"", major);
    let name = "vpc_observed_blocking_calls_total";
    out.counter(
        name,
        "Calls of the loop's thread that blocked from wake to send.",
        blocked,
    );
    let name = "vpc_observed_heap_calls_total";
    out.counter(
        name,
        "Calls of the heap by the loop's thread from wake to send.",
        heap,
    );
    let [phases @ .., cycle] = &view.histograms;
    let name = "vpc_cycle_duration_seconds";
    out.family(name, "histogram", "From waking up to having sent.");
    out.histogram(name, "", cycle);
    let name = "vpc_phase_duration_seconds";
    out.family(
        name,
        "histogram",
        "Phases of a cycle; wake is the time after the release.",
    );
    for (phase, histogram) in Phase::ALL.into_iter().zip(phases) {
        out.histogram(name, &format!("phase=\"{}\"", phase.name()), histogram);
    }
}

fn present(out: &mut Text, view: &View, silence_ns: u64, now_ns: u64) {
    let Some(last) = view.latest() else { return };
    out.counter(
        "vpc_cycles_total",
        "Cycles since the daemon's start.",
        last.cycle,
    );
    out.counter(
        "vpc_overruns_total",
        "Releases missed since the daemon's start.",
        last.overruns,
    );
    let name = "vpc_lost_records_total";
    out.counter(
        name,
        "Records lost since the daemon's start.",
        last.lost_records,
    );
    out.gauge(
        "vpc_last_cycle_age_seconds",
        "Since the newest cycle.",
        seconds(silence_ns),
    );
    if let Some(rate) = view.rate_hz() {
        out.gauge("vpc_cycle_rate_hertz", "Cycles a second, measured.", rate);
    }
    out.family(
        "vpc_state",
        "gauge",
        "1 for the present state, 0 for the others.",
    );
    for state in (0..).map_while(TwistState::from_code) {
        let now = u8::from(state.code() == last.state);
        out.sample("vpc_state", &format!("state=\"{state}\""), now);
    }
    let strategy = strategy_name(last.strategy, last.neighbours);
    out.family("vpc_strategy_info", "gauge", "The strategy in use.");
    out.sample("vpc_strategy_info", &format!("strategy=\"{strategy}\""), 1);
    let degraded = RealTime(last.realtime).is_degraded();
    let help = "1 where real time was asked for and something of it is missing.";
    out.gauge("vpc_realtime_degraded", help, f64::from(u8::from(degraded)));
    out.family(
        "vpc_phase_state",
        "gauge",
        "The grid against the camera's frames.",
    );
    for phase in (0..).map_while(PhaseCode::from_code) {
        let now = u8::from(phase.code() == last.phase);
        out.sample("vpc_phase_state", &format!("phase=\"{phase}\""), now);
    }
    let error = last.phase_error_ns as f64 / 1e9;
    out.gauge(
        "vpc_phase_error_seconds",
        "This release after the one aimed at.",
        error,
    );
    if last.features_sequence > 0 {
        let age = seconds(last.features_age_ns);
        out.gauge(
            "vpc_features_age_seconds",
            "Age of the features at wake-up.",
            age,
        );
    }
    out.gauge(
        "vpc_error_pixels",
        "Largest component of s - s*.",
        last.error_px,
    );
    let name = "vpc_clearance_pixels";
    out.gauge(
        name,
        "Least clearance from an occlusion.",
        last.clearance_px,
    );
    for (name, values) in [
        ("vpc_twist_linear_meters_per_second", &last.twist[..3]),
        ("vpc_twist_angular_radians_per_second", &last.twist[3..]),
    ] {
        out.family(name, "gauge", "Camera velocity sent, camera frame.");
        for (axis, value) in ["x", "y", "z"].iter().zip(values) {
            out.sample(name, &format!("axis=\"{axis}\""), number(*value));
        }
    }
    let Some(robot) = view.robot_at(now_ns) else {
        return;
    };
    out.family(
        "vpc_robot_mode",
        "gauge",
        "1 for the present mode, 0 for the others.",
    );
    for mode in (0..).map_while(RobotMode::from_code) {
        let now = u8::from(mode.code() == robot.mode);
        out.sample("vpc_robot_mode", &format!("mode=\"{mode}\""), now);
    }
    out.family("vpc_robot_fault", "gauge", "1 where the robot reports it.");
    for (fault, name) in fault_names() {
        let set = u8::from(robot.faults().any(fault));
        out.sample("vpc_robot_fault", &format!("fault=\"{name}\""), set);
    }
}

#[cfg(test)]
mod tests {
    use ipc::{Order, Received};

    use super::*;
    use crate::view::tests::record;

    fn view() -> View {
        let mut view = View::default();
        for number in 1..=3 {
            let message = record(number, TwistState::Moving, Hold::None);
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
    fn a_silent_daemon_is_down_and_its_gauges_are_gone() {
        let text = text(&view(), 10_000_000_000);
        assert!(text.contains("\nvpc_up 0\n"), "{text}");
        assert!(!text.contains("vpc_state") && text.contains("vpc_cycle_duration_seconds_count 3"));
    }

    #[test]
    fn a_scene_without_occlusions_has_an_infinite_clearance() {
        assert_eq!(number(f64::INFINITY), "+Inf");
        assert_eq!(number(f64::NAN), "NaN");
    }
}
