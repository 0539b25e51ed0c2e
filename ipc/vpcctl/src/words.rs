//! Numbers and faults in words.

use ipc::RobotFaults;

/// A duration for people: three digits and a unit.
pub fn duration(ns: u64) -> String {
    let ns = ns as f64;
    let (value, unit) = match ns {
        _ if ns < 1e3 => return format!("{ns:.0} ns"),
        _ if ns < 1e6 => (ns / 1e3, "us"),
        _ if ns < 1e9 => (ns / 1e6, "ms"),
        _ => (ns / 1e9, "s"),
    };
    match value {
        _ if value < 10.0 => format!("{value:.2} {unit}"),
        _ if value < 100.0 => format!("{value:.1} {unit}"),
        _ => format!("{value:.0} {unit}"),
    }
}

/// Pixels for people; a dash where the law did not run.
pub fn pixels(value: f64) -> String {
    match value {
        _ if value.is_nan() => "-".to_owned(),
        _ if value.is_infinite() => "unbounded".to_owned(),
        _ => format!("{value:.1} px"),
    }
}

/// The faults and their names.
pub fn fault_names() -> [(RobotFaults, &'static str); 5] {
    [
        (RobotFaults::STALE_COMMAND, "stale command"),
        (RobotFaults::COMMAND_LIMITED, "command limited"),
        (RobotFaults::REFLEX, "reflex"),
        (RobotFaults::JOINT_LIMIT, "joint limit"),
        (RobotFaults::PATTERN_LOST, "pattern lost"),
    ]
}

/// Names of the faults that are set.
pub fn faults(faults: RobotFaults) -> Vec<&'static str> {
    let set = fault_names()
        .into_iter()
        .filter(|(bit, _)| faults.any(*bit));
    set.map(|(_, name)| name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_have_three_digits_and_a_unit() {
        let texts = [999, 1_500, 12_340, 123_400, 2_000_000_000].map(duration);
        assert_eq!(texts, ["999 ns", "1.50 us", "12.3 us", "123 us", "2.00 s"]);
    }

    #[test]
    fn faults_are_named_bit_by_bit() {
        assert_eq!(faults(RobotFaults(0b10100)), ["reflex", "pattern lost"]);
        assert_eq!(faults(RobotFaults(0)).len(), 0);
    }
}
