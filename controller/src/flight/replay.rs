//! The replay: the pilot again on what was recorded, and the first bit that differs.

use ipc::Outcome;
use serde::Serialize;

use super::fields::measured;
use super::file::Flight;
use super::record::{Asked, FlightRecord, Key};
use super::words::{Layout, Seal, Words, words_of};
use crate::pilot::Pilot;

/// What a replay without a difference came to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Cycles that gave the same bits.
    pub cycles: u64,
    /// Number of the first one; 0 where there was none.
    pub first: u64,
    /// Number of the last one.
    pub last: u64,
    /// Keys that the state was compared with on the way.
    pub keys_compared: u64,
    /// Keys from which the replay began, or began again after lost records.
    pub keys_restored: u64,
    /// Cycles after lost records and before the next key, and those with more requests than a record tells: nothing can
    /// be said about them.
    pub skipped: u64,
}

/// The first word that differs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, thiserror::Error)]
#[error(
    "cycle {cycle}: {field} differs: recorded {recorded} ({recorded_bits}), replayed {replayed} ({replayed_bits})"
)]
pub struct Difference {
    /// Number of the cycle.
    pub cycle: u64,
    /// The field: of the record, or `key.` and one of the state before the cycle.
    pub field: String,
    /// What the file says.
    pub recorded: String,
    /// Its bits, hexadecimal.
    pub recorded_bits: String,
    /// What the pilot says.
    pub replayed: String,
    /// Its bits, hexadecimal.
    pub replayed_bits: String,
}

/// Repeats all cycles of a flight record, or those up to number `until`, beginning with the last key before it.
///
/// # Errors
/// The first [`Difference`].
pub fn replay(
    pilot: &mut Pilot,
    flight: &Flight,
    until: Option<u64>,
) -> Result<Report, Box<Difference>> {
    let (key_layout, record_layout) = (Key::layout(), FlightRecord::layout());
    let begin = until.map_or(0, |until| {
        let mut before = flight.keys.iter().filter(|key| key.cycle <= until);
        before.next_back().map_or(0, |key| key.cycle)
    });
    let mut keys = flight.keys.iter().peekable();
    let mut report = Report::default();
    // The cycle that the pilot's state is right for.
    let mut ready = None;
    for record in &flight.records {
        let cycle = record.cycle();
        if cycle < begin || until.is_some_and(|until| cycle > until) {
            continue;
        }
        while keys.next_if(|key| key.cycle < cycle).is_some() {}
        match keys.next_if(|key| key.cycle == cycle) {
            Some(key) => {
                if ready == Some(cycle) {
                    report.keys_compared += 1;
                } else {
                    pilot.restore(&key.state);
                    report.keys_restored += 1;
                }
                // Also after restoring: a key may say what no pilot says.
                let replayed = Key::sealed(cycle, pilot.state());
                compare(cycle, "key.", &key_layout, key, &replayed)?;
            }
            None if ready == Some(cycle) => (),
            None => {
                report.skipped += 1;
                continue;
            }
        }
        if !record.asked.is_whole() {
            report.skipped += 1;
            ready = None;
            continue;
        }
        compare(cycle, "", &record_layout, record, &repeat(pilot, record))?;
        ready = Some(cycle + 1);
        report.cycles += 1;
        report.last = cycle;
        if report.first == 0 {
            report.first = cycle;
        }
    }
    Ok(report)
}

/// One cycle again: the pilot's part anew, what the loop measured as it was.
pub fn repeat(pilot: &mut Pilot, record: &FlightRecord) -> FlightRecord {
    let before = Seal::of(&mut pilot.state());
    let mut asked = Asked::NOTHING;
    for asked_for in record.asked.iter() {
        let request = asked_for.request();
        let outcome = Outcome::from_code(pilot.request(&request).outcome);
        asked.push(&request, outcome.unwrap_or(Outcome::NoRecord));
    }
    let mut told = measured(&record.told);
    let answer = pilot.decide(&record.inputs, &mut told);
    if !record.sent {
        pilot.unsent();
    }
    FlightRecord::sealed(before, asked, record.inputs, answer, record.sent, told)
}

fn compare<T: Words + Clone>(
    cycle: u64,
    part: &str,
    layout: &Layout,
    recorded: &T,
    replayed: &T,
) -> Result<(), Box<Difference>> {
    let (recorded, replayed) = (
        words_of(&mut recorded.clone()),
        words_of(&mut replayed.clone()),
    );
    let mut pairs = recorded.iter().zip(&replayed).enumerate();
    let Some((index, (recorded, replayed))) = pairs.find(|(_, (a, b))| a != b) else {
        return Ok(());
    };
    let (name, kind) = layout.word(index).unwrap_or_default();
    Err(Box::new(Difference {
        cycle,
        field: format!("{part}{name}"),
        recorded: kind.show(*recorded),
        recorded_bits: format!("{recorded:#018x}"),
        replayed: kind.show(*replayed),
        replayed_bits: format!("{replayed:#018x}"),
    }))
}
