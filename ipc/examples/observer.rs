//! Watches a controller: prints its cycles as they come.
//!
//! ```sh
//! cargo run --release -p ipc --example observer [DOMAIN]
//! ```

use std::path::PathBuf;
use std::time::Duration;

use ipc::{Domain, Observer};
use messages::{Order, TwistState};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let directory = std::env::args_os().nth(1);
    let directory = directory.map_or_else(ipc::default_directory, PathBuf::from);
    let domain = Domain::join(&directory)?;
    let mut observer = Observer::open(&domain)?;
    println!("watching");
    loop {
        let Some(cycle) = observer.cycles.oldest()? else {
            std::thread::sleep(Duration::from_millis(1));
            continue;
        };
        if let Order::Gap { missed } = cycle.order {
            println!("{missed} cycles missed");
        }
        // Reception refuses unknown codes.
        let Some(state) = TwistState::from_code(cycle.state) else {
            continue;
        };
        let hold = (cycle.hold()).map_or_else(|| "none".to_owned(), |hold| hold.to_string());
        let law_us = cycle.step_ns as f64 / 1e3;
        let (number, error_px, twist) = (cycle.cycle, cycle.error_px, cycle.twist);
        println!(
            "cycle {number}: {state}, hold {hold}, law {law_us:.1} us, error {error_px:.2} px, twist {twist:.3?}"
        );
    }
}
