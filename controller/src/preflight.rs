//! What a machine lacks for real time, and how to provide it: `vpcd --preflight`.
//!
//! First, facts are read from the kernel and measured; then a pure function judges them.

mod facts;
mod foresight;

use std::fmt::{self, Display, Formatter};

use program::kernel;
use serde::Serialize;

use crate::realtime::RealtimeRequest;
use crate::report::Percentiles;
pub use facts::Facts;
pub use foresight::Cost;

/// Longest wake-up latency that 99 of 100 may have, ns: a hundredth of a period at 30 Hz.
const WAKE_P99_NS: u64 = 300_000;
/// Least room for shared memory: what a domain takes, several times.
const SHM_BYTES: u64 = 64 << 20;

/// How to see what a loop makes of it.
const MEASURE: &str = "in a clone of the source, `cargo test --test promises deadlines` runs a loop \
    here for five seconds under load, and `cargo xtask measure` measures every promise about time";

/// The result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Nothing is missing.
    Ok,
    /// Advisable, but a loop at 30 Hz works without it.
    Note,
    /// Missing.
    Lack,
}

impl Display for State {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Ok => "ok",
            Self::Note => "note",
            Self::Lack => "LACK",
        })
    }
}

/// One property of the machine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What was checked.
    pub name: &'static str,
    /// The result.
    pub state: State,
    /// What was found.
    pub found: String,
    /// What is needed.
    pub needed: String,
    /// How to provide it: a command, or a setting of the unit; empty if nothing is missing.
    pub remedy: String,
}

/// All of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Preflight {
    /// Whether nothing is missing.
    pub fit: bool,
    /// The properties.
    pub checks: Vec<Check>,
    /// Wake-up latencies of the measured run, ns.
    pub wake_ns: Percentiles,
}

impl Display for Preflight {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        for check in &self.checks {
            let Check {
                name,
                state,
                found,
                needed,
                remedy,
            } = check;
            writeln!(f, "{state:<5} {name:<22} {found}; needed: {needed}")?;
            if !remedy.is_empty() {
                writeln!(f, "{:28} -> {remedy}", "")?;
            }
        }
        let lacks = self
            .checks
            .iter()
            .filter(|c| c.state == State::Lack)
            .count();
        match self.fit {
            true => writeln!(f, "fit for real time")?,
            false => writeln!(f, "NOT FIT for real time: {lacks} lacking")?,
        }
        write!(f, "{MEASURE}")
    }
}

/// Judges the facts for a loop with these real-time requirements.
pub fn judge(facts: &Facts, wanted: RealtimeRequest) -> Preflight {
    let checks = [
        priority(facts, wanted),
        processor(facts, wanted),
        memory(facts),
        throttling(facts),
        kernel(facts),
        clock(facts),
        governor(facts),
        idle(facts),
        threads(facts),
        isolation(facts, wanted),
        room(facts),
        wake(facts),
    ]
    .into_iter()
    .chain(facts.foresight.map(foresight_cost))
    .collect::<Vec<_>>();
    Preflight {
        fit: checks.iter().all(|check| check.state != State::Lack),
        checks,
        wake_ns: facts.wake_ns,
    }
}

/// A check; the remedy is dropped if nothing is missing.
fn check(
    name: &'static str,
    (is_well, otherwise): (bool, State),
    found: impl Into<String>,
    needed: impl Into<String>,
    remedy: impl Into<String>,
) -> Check {
    let remedy = if is_well {
        String::new()
    } else {
        remedy.into()
    };
    Check {
        name,
        state: if is_well { State::Ok } else { otherwise },
        found: found.into(),
        needed: needed.into(),
        remedy,
    }
}

fn priority(facts: &Facts, RealtimeRequest { priority, .. }: RealtimeRequest) -> Check {
    let is_within = facts
        .priority_limit
        .is_none_or(|limit| limit >= priority as u64);
    let limit = match facts.priority_limit {
        Some(limit) => limit.to_string(),
        None => "unlimited".to_owned(),
    };
    let (capability, taken) = match (facts.may_schedule, facts.has_fifo) {
        (true, true) => (" (CAP_SYS_NICE)", "taken"),
        (false, true) => ("", "taken"),
        (_, false) => ("", "refused"),
    };
    check(
        "real-time priority",
        (
            facts.has_fifo && (facts.may_schedule || is_within),
            State::Lack,
        ),
        format!("limit {limit}{capability}, SCHED_FIFO {priority} {taken}"),
        format!("limit {priority} or more, or CAP_SYS_NICE"),
        format!(
            "LimitRTPRIO={priority} in the unit; elsewhere `@vpcd - rtprio {priority}` in /etc/security/limits.d/vpcd.conf; in a container --cap-add SYS_NICE"
        ),
    )
}

fn processor(facts: &Facts, RealtimeRequest { cpu, .. }: RealtimeRequest) -> Check {
    let wished = cpu.map_or("any".to_owned(), |cpu| cpu.to_string());
    check(
        "processor",
        (facts.has_cpu, State::Lack),
        format!("{} processors, wished: {wished}", facts.processors),
        "the wished one is there and allowed".to_owned(),
        "another realtime.cpu; AllowedCPUs= and CPUAffinity= in the unit must contain it",
    )
}

fn memory(facts: &Facts) -> Check {
    let limit = match facts.lock_limit {
        Some(bytes) => format!("limit {} KiB", bytes >> 10),
        None => "unlimited".to_owned(),
    };
    let (capability, taken) = match (facts.may_lock, facts.has_lock) {
        (true, true) => (" (CAP_IPC_LOCK)", "locked"),
        (false, true) => ("", "locked"),
        (_, false) => ("", "refused"),
    };
    check(
        "locked memory",
        (facts.has_lock, State::Lack),
        format!("{limit}{capability}, {taken}"),
        "unlimited, or CAP_IPC_LOCK: all or nothing",
        "LimitMEMLOCK=infinity in the unit; elsewhere `@vpcd - memlock unlimited` in /etc/security/limits.d/vpcd.conf; in a container --ulimit memlock=-1",
    )
}

fn throttling(facts: &Facts) -> Check {
    let found = match facts.rt_runtime_us {
        Some(-1) => "no bound".to_owned(),
        Some(us) => format!("{us} us of {}", facts.rt_period_us),
        None => "unknown".to_owned(),
    };
    let share = |us: i64| us == -1 || us as f64 >= 0.5 * facts.rt_period_us as f64;
    check(
        "real-time share",
        (facts.rt_runtime_us.is_none_or(share), State::Lack),
        found,
        "half of the time or more; a bound is good, it saves the machine from an endless loop",
        "sysctl -w kernel.sched_rt_runtime_us=950000; with group scheduling also cpu.rt_runtime_us of the unit's group",
    )
}

fn kernel(facts: &Facts) -> Check {
    check(
        "kernel",
        (facts.kernel.is_enough(), State::Note),
        facts.kernel.to_string(),
        kernel::NEEDED,
        kernel::REMEDY,
    )
}

fn clock(facts: &Facts) -> Check {
    let good = [
        "tsc",
        "arch_sys_counter",
        "kvm-clock",
        "hyperv_clocksource_tsc_page",
    ];
    check(
        "clock source",
        (good.contains(&&*facts.clock_source), State::Lack),
        facts.clock_source.clone(),
        format!("one that is read without the kernel: {}", good.join(", ")),
        "clocksource=tsc tsc=reliable on the kernel's command line",
    )
}

fn governor(facts: &Facts) -> Check {
    let is_well = facts.governors.iter().all(|name| name == "performance");
    let found = match &*facts.governors {
        [] => "no frequency scaling visible".to_owned(),
        names => names.join(", "),
    };
    check(
        "frequency governor",
        (is_well, State::Note),
        found,
        "performance",
        "cpupower frequency-set --governor performance",
    )
}

fn idle(facts: &Facts) -> Check {
    check(
        "idle states",
        (facts.may_hold_idle, State::Note),
        match facts.may_hold_idle {
            true => "/dev/cpu_dma_latency can be opened by a helper that holds it",
            false => "/dev/cpu_dma_latency cannot be opened by us",
        },
        "shallow ones where wake-ups measure too late; vpcd itself does without",
        "processor.max_cstate=1 on the kernel's command line, or tuned-adm profile latency-performance",
    )
}

fn threads(facts: &Facts) -> Check {
    check(
        "hyper-threads",
        (!facts.has_smt, State::Note),
        if facts.has_smt { "on" } else { "off or none" },
        "off, or the sibling of realtime.cpu idle",
        "echo off > /sys/devices/system/cpu/smt/control",
    )
}

fn isolation(facts: &Facts, RealtimeRequest { cpu, .. }: RealtimeRequest) -> Check {
    let found = match (&*facts.isolated, cpu) {
        ("", _) => "none isolated".to_owned(),
        (list, _) => format!("isolated: {list}"),
    };
    let is_ours = cpu.is_some_and(|cpu| contains(&facts.isolated, cpu));
    check(
        "isolated processor",
        (is_ours, State::Note),
        found,
        "one for the loop where other work disturbs it",
        "isolcpus=managed_irq,domain,N nohz_full=N on the kernel's command line, and realtime.cpu = N",
    )
}

fn room(facts: &Facts) -> Check {
    check(
        "room in /dev/shm",
        (facts.shm_bytes >= SHM_BYTES, State::Lack),
        format!("{} MiB free", facts.shm_bytes >> 20),
        format!("{} MiB", SHM_BYTES >> 20),
        "mount -o remount,size=256M /dev/shm; in a container --shm-size 256m",
    )
}

fn foresight_cost(cost: Cost) -> Check {
    let all_ns = u64::from(cost.steps) * cost.step_ns;
    let most = cost.control_ns / 2;
    let fitting = most.checked_div(cost.step_ns).unwrap_or(0);
    check(
        "foresight",
        (all_ns <= most, State::Note),
        format!(
            "{} simulated steps of {:.1} us each: {:.1} ms",
            cost.steps,
            cost.step_ns as f64 / 1e3,
            all_ns as f64 / 1e6
        ),
        format!(
            "at most half of the control period: {:.1} ms",
            most as f64 / 1e6
        ),
        format!("law.foresight_steps = {fitting}"),
    )
}

fn wake(facts: &Facts) -> Check {
    let us = |ns: u64| ns / 1000;
    let Percentiles {
        p50,
        p99,
        p999: _,
        max,
    } = facts.wake_ns;
    check(
        "wake-up latency",
        (p99 <= WAKE_P99_NS && p99 > 0, State::Lack),
        format!(
            "p50 {} us, p99 {} us, longest {} us of {} wake-ups at 1 kHz",
            us(p50),
            us(p99),
            us(max),
            facts::WAKE_UPS
        ),
        format!("p99 at most {} us", us(WAKE_P99_NS)),
        "first what lacks above; then realtime.cpu on a quiet processor; a machine of your own if a host disturbs this one",
    )
}

/// Whether a list like `1,4-7` contains a processor.
fn contains(list: &str, cpu: usize) -> bool {
    list.split(',').any(|range| {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        match (first.trim().parse::<usize>(), last.trim().parse::<usize>()) {
            (Ok(first), Ok(last)) => (first..=last).contains(&cpu),
            _ => false,
        }
    })
}

#[cfg(test)]
mod tests {
    use program::kernel::Kernel;

    use super::*;

    const WISH: RealtimeRequest = RealtimeRequest {
        priority: 80,
        cpu: Some(5),
    };

    fn good() -> Facts {
        Facts {
            priority_limit: Some(80),
            may_schedule: false,
            has_fifo: true,
            has_cpu: true,
            processors: 8,
            lock_limit: None,
            may_lock: false,
            has_lock: true,
            rt_runtime_us: Some(950_000),
            rt_period_us: 1_000_000,
            kernel: Kernel {
                is_realtime: true,
                version: "#1 SMP PREEMPT_RT".to_owned(),
                mode: String::new(),
            },
            clock_source: "tsc".to_owned(),
            governors: vec!["performance".to_owned()],
            may_hold_idle: true,
            has_smt: false,
            isolated: "1,4-7".to_owned(),
            shm_bytes: 1 << 30,
            foresight: Some(Cost {
                step_ns: 10_000,
                steps: 150,
                control_ns: 33_333_333,
            }),
            wake_ns: Percentiles {
                p50: 5_000,
                p99: 20_000,
                p999: 30_000,
                max: 50_000,
            },
        }
    }

    #[test]
    fn a_good_machine_is_fit_and_has_nothing_to_mend() {
        let found = judge(&good(), WISH);
        assert!(found.fit, "{found}");
        for check in found.checks {
            assert!(
                check.state == State::Ok && check.remedy.is_empty(),
                "{check:?}"
            );
        }
    }

    #[test]
    fn slow_foresight_is_noted_with_what_would_fit() {
        let mut facts = good();
        facts.foresight = facts.foresight.map(|cost| Cost {
            step_ns: 200_000,
            ..cost
        });
        let found = judge(&facts, WISH);
        assert!(found.fit);
        let check = found.checks.last().unwrap();
        assert_eq!((check.name, check.state), ("foresight", State::Note));
        assert_eq!(check.remedy, "law.foresight_steps = 83");
    }

    #[test]
    fn each_lack_makes_unfit_and_names_value_need_and_remedy() {
        type Spoil = fn(&mut Facts);
        let cases: [(&str, Spoil, [&str; 2]); 8] = [
            (
                "real-time priority",
                |f| (f.priority_limit, f.has_fifo) = (Some(10), false),
                ["limit 10, SCHED_FIFO 80 refused", "LimitRTPRIO=80"],
            ),
            (
                "processor",
                |f| f.has_cpu = false,
                ["wished: 5", "CPUAffinity="],
            ),
            (
                "locked memory",
                |f| (f.lock_limit, f.has_lock) = (Some(8 << 20), false),
                ["limit 8192 KiB, refused", "LimitMEMLOCK=infinity"],
            ),
            (
                "real-time share",
                |f| f.rt_runtime_us = Some(100_000),
                [
                    "100000 us of 1000000",
                    "sysctl -w kernel.sched_rt_runtime_us",
                ],
            ),
            (
                "clock source",
                |f| f.clock_source = "hpet".to_owned(),
                ["hpet", "clocksource=tsc"],
            ),
            (
                "room in /dev/shm",
                |f| f.shm_bytes = 8 << 20,
                ["8 MiB free", "remount,size=256M"],
            ),
            (
                "wake-up latency",
                |f| f.wake_ns.p99 = 5_000_000,
                ["p99 5000 us", "realtime.cpu"],
            ),
            (
                "wake-up latency",
                |f| f.wake_ns = Percentiles::default(),
                ["p99 0 us", "realtime.cpu"],
            ),
        ];
        for (name, spoil, [found, remedy]) in cases {
            let mut facts = good();
            spoil(&mut facts);
            let outcome = judge(&facts, WISH);
            let lacks: Vec<_> = outcome
                .checks
                .iter()
                .filter(|c| c.state == State::Lack)
                .collect();
            let [lack] = *lacks else { panic!("{outcome}") };
            assert!(!outcome.fit && lack.name == name, "{outcome}");
            assert!(lack.found.contains(found), "{lack:?}");
            assert!(
                lack.remedy.contains(remedy) && !lack.needed.is_empty(),
                "{lack:?}"
            );
        }
    }

    #[test]
    fn what_30_hz_does_without_is_noted_and_leaves_the_machine_fit() {
        let mut facts = good();
        facts.kernel.is_realtime = false;
        facts.kernel.version = "#1 SMP PREEMPT_DYNAMIC".to_owned();
        facts.governors = vec!["powersave".to_owned()];
        (facts.has_smt, facts.may_hold_idle) = (true, false);
        facts.isolated = String::new();
        let found = judge(&facts, WISH);
        let notes: Vec<_> = found
            .checks
            .iter()
            .filter(|c| c.state == State::Note)
            .collect();
        assert!(found.fit && notes.len() == 5, "{found}");
        assert!(notes.iter().all(|note| !note.remedy.is_empty()), "{found}");
    }

    #[test]
    fn a_list_of_processors_is_read_as_the_kernel_writes_it() {
        assert!(contains("1,4-7", 5) && contains("5", 5) && !contains("1,6-7", 5));
        assert!(!contains("", 0));
    }
}
