//! A recorder that is killed or hangs.

use std::path::PathBuf;
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use recorder::{Options, record};
use recording::Recording;
use rustix::process::Signal;

use testkit::{Place, Running, eventually};

use crate::fixture::{FILE, Stage, check, python, same, scene};

/// Starts this executable as a recorder.
fn recorder(place: &Place) -> Running {
    Running::start(
        testkit::command(std::env::current_exe().unwrap())
            .args([
                "--exact",
                "interrupted::play_a_recorder",
                "--ignored",
                "--test-threads=1",
            ])
            .env("VPC_TEST_DOMAIN", place.domain())
            .env("VPC_TEST_FILE", place.path(FILE))
            .stdout(Stdio::null()),
    )
}

#[test]
#[ignore = "not a test: the recorder of the tests that kill or stop one"]
fn play_a_recorder() {
    let variable = |name| PathBuf::from(std::env::var_os(name).unwrap());
    let options = Options {
        domain: variable("VPC_TEST_DOMAIN"),
        output: variable("VPC_TEST_FILE"),
        force: false,
        duration: None,
        scene: Some(scene()),
        mount: None,
    };
    // Ends by a signal, or when the file that it is told by appears.
    let stop = AtomicBool::new(false);
    let enough = options.output.with_extension("enough");
    std::thread::scope(|threads| {
        threads.spawn(|| {
            while !enough.exists() {
                std::thread::sleep(Duration::from_millis(5));
            }
            stop.store(true, Ordering::Relaxed);
        });
        record(&options, &stop, |_| ()).unwrap();
    });
}

fn size(place: &Place) -> u64 {
    std::fs::metadata(place.path(FILE)).map_or(0, |file| file.len())
}

/// Publishes until the recorder has flushed twice; the bound is on messages, not on time.
fn until_flushed(
    place: &Place,
    stage: &mut Stage,
    random: &mut ChaCha8Rng,
    published: &mut Recording,
) {
    let mut sizes = Vec::new();
    eventually("two flushes", || {
        stage.publish(published.features.len(), random, published);
        sizes.push(size(place));
        sizes.dedup();
        (sizes.len() > 2 && published.features.len() > 500).then_some(())
    });
}

#[test]
fn a_killed_recorder_leaves_a_file_that_can_be_read() {
    let place = Place::new();
    let mut stage = Stage::open(&place.domain());
    let mut random = ChaCha8Rng::seed_from_u64(6);
    let mut published = Recording::default();
    let recorder = recorder(&place);
    stage.wait_for_recorder();
    let begun = size(&place);
    until_flushed(&place, &mut stage, &mut random, &mut published);
    recorder.kill();

    let recording = Recording::read(&place.path(FILE)).unwrap();
    assert!(size(&place) > begun);
    assert!(recording.cut.is_some() && !recording.metadata.contains_key("vpc.ledger"));
    assert_eq!(recording.scene_toml(), Some(scene::PAPER_SIM));
    let (count, cycles) = (recording.features.len(), recording.cycles.len());
    assert!(count >= 100 && cycles >= 100, "{count}, {cycles}");
    // Those before the last of them are there, but for those that a starved machine lost.
    for (read, number) in recording.features.iter().zip(1_u64..) {
        assert!(read.stamp.sequence >= number);
        let published = &published.features[read.stamp.sequence as usize - 1];
        same(&[*read], &[*published]);
    }
    for read in &recording.cycles {
        let published = &published.cycles[read.stamp.sequence as usize - 1];
        same(&[*read], &[*published]);
    }

    if let Some(python) = python("a_killed_recorder_leaves_a_file_that_can_be_read") {
        let found = check(&python, "rest", &[&place.path(FILE)]);
        for line in [
            format!("count /vpc/features {count}"),
            format!("count /vpc/cycles {cycles}"),
        ] {
            assert!(found.contains(&line), "{line}: {found:?}");
        }
    }
}

#[test]
fn a_recorder_that_hangs_delays_nobody_and_counts_losses() {
    let place = Place::new();
    let mut stage = Stage::open(&place.domain());
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut published = Recording::default();
    let recorder = recorder(&place);
    stage.wait_for_recorder();
    until_flushed(&place, &mut stage, &mut random, &mut published);
    recorder.signal(Signal::STOP);
    let before = published.features.len() as u64;
    for i in 0..2_000 {
        // Every `publish` in here succeeds.
        stage.publish(i, &mut random, &mut published);
    }
    let all = before + 2_000;
    recorder.signal(Signal::CONT);
    std::fs::write(place.path(FILE).with_extension("enough"), "").unwrap();
    assert_eq!(recorder.ended().code, Some(0));

    let recording = Recording::read(&place.path(FILE)).unwrap();
    let ledger = &recording.metadata["vpc.ledger"];
    for (topic, missing, last) in [
        (
            "/vpc/features",
            Recording::missing(&recording.features),
            recording.features.last().map(|m| m.stamp),
        ),
        (
            "/vpc/cycles",
            Recording::missing(&recording.cycles),
            recording.cycles.last().map(|m| m.stamp),
        ),
    ] {
        let count = |name| ledger[&format!("{topic}.{name}")].parse::<u64>().unwrap();
        let (recorded, lost) = (count("recorded"), count("lost"));
        // How many depends on when the recorder really stood still; the longest queue holds 1024.
        assert!(lost >= 100, "{topic}: {lost}");
        assert_eq!(lost, missing, "{topic}");
        assert_eq!(last.unwrap().sequence, all, "{topic}");
        assert!(recorded + lost <= all, "{topic}: {recorded}, {lost}");
    }
}
