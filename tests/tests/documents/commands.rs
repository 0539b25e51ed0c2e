//! The commands of all documents.

use crate::call::{BUILT, CLIENTS, Call};
use crate::markdown::documents;

/// Checks the commands of all documents that pass `is_checked`, with the flags of these programs;
/// at least `least` are there.
pub fn check_commands(programs: &[&str], is_checked: impl Fn(&Call) -> bool, least: usize) {
    let mut faults = Vec::new();
    let mut count = 0;
    let own = [&BUILT[..], &CLIENTS, &["cargo"]].concat();
    for document in documents() {
        let commands = document.commands().into_iter();
        let mut calls: Vec<_> = commands
            .map(|piece| (Call::line(&piece.text), piece))
            .collect();
        // With an ellipsis it is a sketch.
        let code = document.inline_code().into_iter().filter(|code| {
            let first = code.text.split_once(' ').map(|(first, _)| first);
            first.is_some_and(|first| own.contains(&first)) && !code.text.contains("...")
        });
        calls.extend(code.map(|piece| {
            let calls = piece.text.split(" && ").map(Call::read);
            (calls.collect(), piece)
        }));
        for (calls, piece) in &calls {
            for call in calls.iter().filter(|call| is_checked(call)) {
                count += 1;
                if let Err(fault) = call.check(programs) {
                    faults.push(format!("{}: {}: {fault}", piece.place, piece.text));
                }
            }
        }
    }
    assert!(count > least, "{count}");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}
