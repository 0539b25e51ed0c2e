//! On a real clock no command is further from the one before than a brake from the limits allows,
//! also in a scene without limits of acceleration.

use std::time::Duration;

use crate::fixture::{LIMITS, PERIOD_NS, Stage, repeats, tell, turn};

/// Time from zero to the limits, s: `safety.brake_s`.
const BRAKE_S: f64 = 0.15;

#[test]
fn no_command_jumps() {
    let _turn = turn();
    let most = PERIOD_NS as f64 * 1e-9 / BRAKE_S;
    let mut greatest = 0.0_f64;
    for start in 0..repeats("runs", 4, 100) {
        let mut stage = Stage::in_motion(start);
        std::thread::sleep(Duration::from_millis(1500));
        let commands = stage.witness.commands();
        let mut pairs = 0;
        for pair in commands.windows(2) {
            if pair[1].stamp.sequence != pair[0].stamp.sequence + 1 {
                continue;
            }
            pairs += 1;
            for ((v, before), limit) in pair[1].twist.iter().zip(pair[0].twist).zip(LIMITS) {
                greatest = greatest.max((v - before).abs() / limit);
            }
        }
        assert!(pairs > 20, "{commands:?}");
        assert!(
            greatest <= most * (1.0 + 1e-6),
            "start {start}: {greatest} > {most}"
        );
    }
    tell(format!(
        "the greatest step is {greatest:.4} of the limit, of {most:.4} allowed"
    ));
}
