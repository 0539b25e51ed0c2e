//! diagnostic_msgs/DiagnosticArray on /diagnostics, once a second: vpcd, and the gateway.

use messages::{CycleRecord, Hold, RealTime, TwistState};

use crate::event::Report;
use crate::message::{DiagnosticArray, DiagnosticStatus, Header, KeyValue, Time};

/// Levels of a status.
const OK: u8 = 0;
const WARN: u8 = 1;
const ERROR: u8 = 2;
const STALE: u8 = 3;
/// Silence of vpcd, or of a topic, that is told, ns.
const SILENT_NS: u64 = 1_000_000_000;

/// Both statuses. `cycle` is vpcd's last, and when it came.
pub fn array(
    node: &str,
    domain: &str,
    cycle: Option<(&CycleRecord, u64)>,
    report: &Report,
    before: &Report,
    now_ns: u64,
    stamp: Time,
) -> DiagnosticArray {
    let mut status = [vpcd(cycle, now_ns), gateway(report, before, now_ns)];
    for (status, what) in status.iter_mut().zip(["vpcd", "gateway"]) {
        status.name = format!("{node}: {what}");
        domain.clone_into(&mut status.hardware_id);
    }
    DiagnosticArray {
        header: Header {
            stamp,
            frame_id: String::new(),
        },
        status: status.into(),
    }
}

fn vpcd(cycle: Option<(&CycleRecord, u64)>, now_ns: u64) -> DiagnosticStatus {
    let fresh = cycle.filter(|(_, came_ns)| now_ns.saturating_sub(*came_ns) < SILENT_NS);
    let Some((cycle, _)) = fresh else {
        return DiagnosticStatus {
            level: STALE,
            message: "no vpcd is at work in this domain".to_owned(),
            ..DiagnosticStatus::default()
        };
    };
    let state = TwistState::from_code(cycle.state);
    let hold = cycle.hold();
    let lacks: Vec<_> = RealTime(cycle.realtime).lacks().collect();
    let level = match (state, hold) {
        (Some(TwistState::Disarmed), Some(Hold::NotArmed | Hold::Operator)) => OK,
        (Some(TwistState::Disarmed), _) => ERROR,
        (Some(TwistState::Holding | TwistState::Braking), _) => WARN,
        _ => OK,
    };
    let degraded = if lacks.is_empty() { OK } else { WARN };
    let mut message = state.map_or_else(String::new, |state| state.to_string());
    if let Some(hold) = hold {
        message += &format!(": {hold}");
    }
    if !lacks.is_empty() {
        message += &format!(" (not real time: {})", lacks.join(", "));
    }
    let ms = |ns: u64| format!("{:.1}", 1e-6 * ns as f64);
    DiagnosticStatus {
        level: level.max(degraded),
        message,
        values: values([
            ("cycle", cycle.cycle.to_string()),
            ("missed deadlines", cycle.overruns.to_string()),
            ("wake-up latency, ms", ms(cycle.wake_latency_ns)),
            ("age of the features, ms", ms(cycle.features_age_ns)),
            ("error, px", format!("{:.2}", cycle.error_px)),
            ("clearance, px", format!("{:.1}", cycle.clearance_px)),
            ("foreseen arrival, s", format!("{:.2}", cycle.arrival_s)),
        ]),
        ..DiagnosticStatus::default()
    }
}

fn gateway(report: &Report, before: &Report, now_ns: u64) -> DiagnosticStatus {
    let mut trouble = Vec::new();
    let mut told = Vec::new();
    let all = |counts: &crate::refusal::Counts| counts.refused.values().sum::<u64>();
    for (topic, counts) in &report.topics {
        if now_ns.saturating_sub(counts.last_ns) >= SILENT_NS {
            trouble.push(format!("nothing usable on {topic}"));
        }
        let last = before.topics.iter().find(|(name, _)| name == topic);
        if all(counts) > last.map_or(0, |(_, counts)| all(counts)) {
            trouble.push(format!("messages on {topic} are refused"));
        }
        told.push((format!("{topic}, taken"), counts.taken.to_string()));
        let age = format!("{:.1}", 1e-6 * counts.age_ns as f64);
        told.push((format!("{topic}, age of the last, ms"), age));
        if counts.passed_over > 0 {
            let others = counts.passed_over.to_string();
            told.push((format!("{topic}, of others"), others));
        }
        for (kind, count) in &counts.refused {
            told.push((format!("{topic}, refused: {kind}"), count.to_string()));
        }
    }
    if report.is_stopping {
        trouble.push("a stop is in force: only zeros are sent".to_owned());
    }
    if report.not_sent > before.not_sent {
        trouble.push("twists could not be sent".to_owned());
    }
    told.extend([
        ("twists sent".to_owned(), report.sent[0].to_string()),
        ("zeros of its own".to_owned(), report.sent[1].to_string()),
        ("twists not sent".to_owned(), report.not_sent.to_string()),
        ("foreign tags".to_owned(), report.foreign_tags.to_string()),
        (
            "steps of the wall clock".to_owned(),
            report.steps.to_string(),
        ),
    ]);
    DiagnosticStatus {
        level: if trouble.is_empty() { OK } else { WARN },
        message: match trouble.is_empty() {
            true => "messages are coming".to_owned(),
            false => trouble.join("; "),
        },
        values: values(told),
        ..DiagnosticStatus::default()
    }
}

fn values<K: Into<String>>(told: impl IntoIterator<Item = (K, String)>) -> Vec<KeyValue> {
    let pairs = told.into_iter().map(|(key, value)| (key.into(), value));
    pairs.map(|(key, value)| KeyValue { key, value }).collect()
}
