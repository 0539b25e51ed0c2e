//! Numbers with their units, for people.

use std::ops::RangeInclusive;
use std::time::Duration;

/// A duration with three digits and a unit.
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

/// Pixels; a dash where the law did not run.
pub fn pixels(value: f64) -> String {
    match value {
        _ if value.is_nan() => "-".to_owned(),
        _ if value.is_infinite() => "unbounded".to_owned(),
        _ => format!("{value:.1} px"),
    }
}

/// Reads a number in this range.
pub(crate) fn number(text: &str, range: RangeInclusive<f64>, unit: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| range.contains(number));
    number.ok_or_else(|| format!("allowed: {} to {}{unit}", range.start(), range.end()))
}

/// Reads a duration in seconds.
pub(crate) fn seconds(text: &str) -> Result<Duration, String> {
    number(text, 0.05..=3600.0, " seconds").map(Duration::from_secs_f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_have_three_digits_and_a_unit() {
        let texts = [999, 1_500, 12_340, 123_400, 2_000_000_000].map(duration);
        assert_eq!(texts, ["999 ns", "1.50 us", "12.3 us", "123 us", "2.00 s"]);
    }
}
