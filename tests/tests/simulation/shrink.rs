//! What is told of a run that breaks a promise: a command that repeats it, and of a storm the
//! fewest events that still break one.

use crate::plan::{Plan, Stock};
use crate::world::World;

/// The plan of a seed, with the events that `SIM_EVENTS` names if it is set.
pub fn asked(stock: &Stock, seed: u64) -> Plan<'_> {
    let Ok(text) = std::env::var("SIM_EVENTS") else {
        return Plan::new(stock, seed);
    };
    let words = text.split(',').filter(|word| !word.is_empty());
    let parse = |word: &str| {
        let number = word.parse();
        number.unwrap_or_else(|_| panic!("SIM_EVENTS = {text}; allowed: numbers, and commas"))
    };
    with(stock, seed, &words.map(parse).collect::<Vec<_>>())
}

/// The plan of a seed, with none but these of its events.
fn with<'s>(stock: &'s Stock, seed: u64, kept: &[usize]) -> Plan<'s> {
    let mut plan = Plan::new(stock, seed);
    plan.blows.retain(|blow| kept.contains(&blow.number));
    plan
}

/// One line with what is broken and the command that repeats it, then the events that are needed.
pub fn report(stock: &Stock, seed: u64, broken: &str) -> String {
    let plan = Plan::new(stock, seed);
    let fault = plan.fault;
    let command = |events: &str| {
        format!("{events}SIM_SEED={seed} cargo test --test simulation -- --nocapture")
    };
    if plan.blows.is_empty() {
        return format!("({fault:?}) {broken}\n{}", command(""));
    }
    let mut kept: Vec<usize> = plan.blows.iter().map(|blow| blow.number).collect();
    let breaks = |kept: &[usize]| World::of(with(stock, seed, kept), false).finished().broken;
    let mut broken = broken.to_owned();
    // Without one after the other, the last first, as long as one can be missed.
    for at in (0..kept.len()).rev() {
        let mut fewer = kept.clone();
        fewer.remove(at);
        if let Some(found) = breaks(&fewer) {
            (kept, broken) = (fewer, found);
        }
    }
    let blows = plan.blows.iter().filter(|blow| kept.contains(&blow.number));
    let lines = blows.map(|blow| {
        let [from, until] = [blow.from_ns, blow.until_ns].map(|ns| ns as f64 * 1e-9);
        format!(
            "  {}: {:?} from {from:.3} to {until:.3} s",
            blow.number, blow.fault
        )
    });
    let lines: Vec<String> = lines.collect();
    let numbers: Vec<String> = kept.iter().map(ToString::to_string).collect();
    let command = command(&format!("SIM_EVENTS={} ", numbers.join(",")));
    format!("({fault:?}) {broken}\n{command}\n{}", lines.join("\n"))
}
