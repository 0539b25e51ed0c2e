//! The scripts of `memory-blob/cluster` as they ship, under a real Slurm: a node is killed, and nothing
//! is lost.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;
use testkit::{are_installed, ended, is_long, is_root, not_run, program, root, tell, within};

use crate::nodes::{Cluster, field};

/// How long a job may take.
const PATIENCE: Duration = Duration::from_secs(600);
const PARTS: usize = 4;
const STRATEGIES: &str = "knn:3,gpr:3";

/// How far two memories may differ over the same starts, in standard errors of the mean difference.
const Z: f64 = 3.0;

/// Sizes of the test.
struct Sizes {
    trajectories: usize,
    /// Starts that are tried at a time: a part has to take several such batches.
    batch: usize,
    starts: usize,
}

#[test]
#[ignore = "takes two minutes"]
fn a_memory_and_a_table_in_parts_survive_the_kill_of_a_node() {
    let what = "Slurm";
    let needs = [
        "munged=munge",
        "slurmctld=slurm-wlm",
        "slurmd=slurm-wlm",
        "sbatch=slurm-wlm",
    ];
    if !is_root(what) || !are_installed(what, &needs) {
        return;
    }
    if std::thread::available_parallelism().is_ok_and(|count| count.get() < 2) {
        return not_run(what, "two nodes of one processor each want two processors");
    }
    let sizes = match is_long() {
        true => Sizes {
            trajectories: 900,
            batch: 32,
            starts: 2000,
        },
        false => Sizes {
            trajectories: 120,
            batch: 4,
            starts: 120,
        },
    };
    let begin = Instant::now();
    let programs = program("vpc-memory").parent().unwrap().to_owned();
    program("table");
    let mut cluster = Cluster::start(&programs);
    let here = cluster.work();
    fs::copy(
        root().join("ipc/scene/scenes/paper-sim.toml"),
        here.join("scene.toml"),
    )
    .unwrap();
    tell(format_args!(
        "Slurm is up after {:.0} s",
        begin.elapsed().as_secs_f64()
    ));

    // A memory, of which a node is killed.
    let trajectories = sizes.trajectories.to_string();
    let script = |name: &str| {
        root()
            .join("memory-blob/cluster")
            .join(name)
            .display()
            .to_string()
    };
    let (memory, table) = (script("memory.sbatch"), script("table.sbatch"));
    let array = format!("--array=0-{}", PARTS - 1);
    let build = ["scene.toml", "slurm.vpcmem"];
    let batch = format!("batch = {}", sizes.batch);
    fs::write(here.join("settings.toml"), batch).unwrap();
    let flags = format!("--settings settings.toml --trajectories {trajectories}");
    let mut words: Vec<_> = flags.split(' ').collect();
    words.extend(["--checkpoint-s", "0"]);
    let clock = Instant::now();
    let parts = cluster.submit(&[&[array.as_str(), &memory], &build[..], &words].concat());
    let after = format!("--dependency=afterok:{parts}");
    let merge = cluster.submit(
        &[
            &[after.as_str(), "--kill-on-invalid-dep=yes", &memory],
            &build[..],
        ]
        .concat(),
    );
    // In the midst of a part: something is saved, and not all.
    let victim = task_on(&cluster, &parts, "n2");
    let part = here.join(format!("slurm.vpcmem.parts/{victim}"));
    let saved = within(PATIENCE, || saved(&part)).expect("nothing is saved");
    cluster.kill_node("n2");
    let left = self::saved(&part).unwrap();
    assert!(
        left >= saved && left < sizes.trajectories / PARTS,
        "{left} trajectories left"
    );
    cluster.completed(&parts, PATIENCE);
    let task = cluster.job(&format!("{parts}_{victim}"));
    assert_eq!(field(&task[0], "Restarts"), "1", "{task:?}");
    assert_eq!(field(&task[0], "NodeList"), "n1");
    cluster.completed(&merge, PATIENCE);
    tell(format_args!(
        "memory of {trajectories} trajectories, n2 killed when part {victim} had {left}: requeued to n1, merged after {:.0} s",
        clock.elapsed().as_secs_f64()
    ));

    // The same without Slurm and without a kill, and in one piece.
    let run = |line: &str| {
        let mut command = testkit::command(programs.join("vpc-memory"));
        let ended = ended(command.args(line.split_whitespace()).current_dir(&here));
        assert_eq!(ended.code, Some(0), "{line}: {}", ended.stderr);
    };
    for part in 0..PARTS {
        run(&format!(
            "build scene.toml --part {part}/{PARTS} -o calm-{part} {flags}"
        ));
    }
    run("merge calm-2 calm-0 calm-3 calm-1 -o calm.vpcmem");
    let bytes = |name: &str| fs::read(here.join(name)).unwrap();
    assert!(
        bytes("slurm.vpcmem") == bytes("calm.vpcmem"),
        "the kill shows in the memory"
    );
    run(&format!("build scene.toml -o piece.vpcmem {flags}"));
    run(&format!(
        "starts scene.toml -o starts.csv --count {} --seed 7001",
        sizes.starts
    ));

    // The table of each, the first with a kill of the other node.
    cluster.start_node("n2");
    let documents = [("slurm.vpcmem", true), ("piece.vpcmem", false)].map(|(memory, is_killed)| {
        let clock = Instant::now();
        let json = memory.replace("vpcmem", "json");
        let files = ["scene.toml", "starts.csv", memory, json.as_str()];
        let flags = ["--strategies", STRATEGIES, "--repeats", "1"];
        let parts = cluster.submit(&[&[array.as_str(), &table], &files[..], &flags].concat());
        let after = format!("--dependency=afterok:{parts}");
        let merge = cluster.submit(&[&[after.as_str(), &table], &files[..]].concat());
        if is_killed {
            let victim = task_on(&cluster, &parts, "n1");
            std::thread::sleep(Duration::from_millis(500));
            cluster.kill_node("n1");
            let requeued = || {
                let tasks = cluster.job(&format!("{parts}_{victim}"));
                (field(&tasks[0], "Restarts") == "1").then_some(())
            };
            within(PATIENCE, requeued).expect("not requeued");
            cluster.start_node("n1");
        }
        cluster.completed(&merge, PATIENCE);
        tell(format_args!(
            "table of {memory}, {} starts: {:.0} s",
            sizes.starts,
            clock.elapsed().as_secs_f64()
        ));
        serde_json::from_slice::<Value>(&bytes(&json)).unwrap()
    });
    for document in &documents {
        assert_eq!(document["runs"].as_array().unwrap().len(), 2 * sizes.starts);
    }
    compare(&documents, sizes.starts);
}

/// Waits until a task of an array runs on a node; its index.
fn task_on(cluster: &Cluster, parts: &str, node: &str) -> String {
    let found = || {
        let tasks = cluster.job(parts);
        let on = |task: &&String| {
            field(task, "JobState") == "RUNNING" && field(task, "NodeList") == node
        };
        let task = tasks.iter().find(on)?;
        Some(field(task, "ArrayTaskId").to_owned())
    };
    within(PATIENCE, found).unwrap_or_else(|| panic!("nothing runs on {node}: {}", cluster.logs()))
}

/// Trajectories in an unfinished part.
fn saved(part: &Path) -> Option<usize> {
    let bytes = fs::read(part).ok()?;
    let header = bytes.split(|byte| *byte == b'\n').nth(1)?;
    let header: Value = serde_json::from_slice(header).ok()?;
    header["found"].as_u64().map(|found| found as usize)
}

/// The two memories do alike: success and cost differ no more than chance allows, start by start. Cost
/// is not judged from few starts: three standard errors are half of it.
fn compare(documents: &[Value; 2], starts: usize) {
    for strategy in STRATEGIES.split(',') {
        let runs = documents.each_ref().map(|document| {
            let runs = document["runs"].as_array().unwrap().iter();
            let runs = runs.filter(|run| run["strategy"] == strategy);
            let pairs = runs.map(|run| {
                (
                    run["success"].as_bool().unwrap(),
                    run["cost"].as_f64().unwrap(),
                )
            });
            pairs.collect::<Vec<_>>()
        });
        // The same starts: differences start by start, and the standard error of their mean.
        let pairs = runs[0].iter().zip(&runs[1]);
        let success: Vec<_> = pairs
            .clone()
            .map(|(a, b)| f64::from(a.0) - f64::from(b.0))
            .collect();
        let cost: Vec<_> = pairs.map(|(a, b)| a.1 - b.1).collect();
        let shown = runs.each_ref().map(|runs| {
            let arrived = runs.iter().filter(|run| run.0).count();
            let cost = runs.iter().map(|run| run.1).sum::<f64>() / starts as f64;
            format!("{arrived} of {starts}, cost {cost:.2}")
        });
        let [merged, piece] = shown;
        tell(format_args!(
            "{strategy}: merged {merged}; in one piece {piece}"
        ));
        for (name, differences, is_judged) in
            [("success", success, true), ("cost", cost, is_long())]
        {
            let (mean, error) = mean_and_standard_error(&differences);
            let most = Z * error;
            let allowed = match is_judged {
                true => format!("allowed: {most:.4}"),
                false => "not judged without VPC_LONG=1".to_owned(),
            };
            tell(format_args!(
                "{strategy}: {name} differs by {mean:.4}, standard error {error:.4}; {allowed}"
            ));
            assert!(!is_judged || mean.abs() <= most, "{strategy}: {name}");
        }
    }
}

/// Mean, and its standard error.
fn mean_and_standard_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let square = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
    (mean, (square / (n - 1.0) / n).sqrt())
}
