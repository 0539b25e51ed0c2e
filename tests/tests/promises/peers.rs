//! Peers that are killed: cameras, observers, operators; the daemon itself. Nobody else falls, who comes back is heard
//! in half a second, and nothing piles up.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use ipc::{Domain, TwistState};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;

use crate::fixture::{
    Place, Running, Stage, WAKE_NS, Witness, eventually, program, repeats, some_time, tell, turn,
};

/// Open files of a process.
fn descriptors(id: u32) -> usize {
    std::fs::read_dir(format!("/proc/{id}/fd")).unwrap().count()
}

#[test]
fn killed_peers_come_back_and_leave_nothing_behind() {
    let _turn = turn();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let place = Place::new();
    let mut witness = Witness::new(&place);
    let mut daemon = Running::start(place.vpcd(""));
    let mut plateau = None;
    let rounds = repeats("kill -9 of camera and client in turn", 20, 100);
    for round in 0..rounds {
        let camera = Running::start(place.hw_sim(round % 100));
        let born = Instant::now();
        let before = witness.newest_features_ns();
        // From the first features that it publishes to the first command that answers them.
        let published = eventually("features", || {
            let newest = witness.observer.features.latest().unwrap()?;
            (newest.stamp.published_ns > before).then_some(newest.stamp.published_ns)
        });
        let answered = witness.until("an answer", |twist| {
            twist.features_published_ns >= published
        });
        let took = answered.last().unwrap().stamp.published_ns - published;
        assert!(
            took <= 500_000_000,
            "round {round}: {took} ns; {:?} since its start",
            born.elapsed()
        );
        witness.set_in_motion();
        // A client that is killed while it joins, asks or leaves, before the camera or after it.
        let mut client = Command::new(program("vpcctl"));
        client.arg("--domain").arg(place.domain()).arg("status");
        client.stdout(Stdio::null()).stderr(Stdio::null());
        let mut camera = Some(camera);
        if round % 2 == 0 {
            drop(camera.take());
        }
        let client = Running::start(client);
        std::thread::sleep(Duration::from_micros(random.random_range(0..120_000)));
        client.kill();
        drop(camera);
        witness.until("a controller that gave up", |twist| {
            twist.state() == Some(TwistState::Disarmed)
        });
        assert!(daemon.is_running(), "round {round}");
        // Dead peers are cleared away once a second.
        if round + 1 == rounds / 2 || round + 1 == rounds {
            std::thread::sleep(Duration::from_millis(2500));
            let now = (
                descriptors(daemon.id()),
                Domain::segments(&place.domain()).unwrap(),
            );
            let then = *plateau.get_or_insert(now);
            tell(&format!(
                "after {} kills: {} descriptors, {} segments",
                2 * (round + 1),
                now.0,
                now.1
            ));
            assert!(
                now.0 <= then.0 + 2 && now.1 <= then.1 + 2,
                "{then:?} -> {now:?}"
            );
        }
    }
}

#[test]
fn when_the_daemon_is_killed_the_emulator_stops_and_a_new_one_is_ready_in_a_second() {
    let _turn = turn();
    let mut random = ChaCha8Rng::seed_from_u64(2);
    for round in 0..repeats("kill -9 of vpcd in motion", 5, 100) {
        let Stage {
            place,
            mut witness,
            daemon,
            camera: _camera,
        } = Stage::in_motion(round);
        some_time(4, &mut random);
        daemon.signal(Signal::KILL);
        let killed_ns = ipc::now_ns();
        daemon.kill();
        // What the robot says of itself.
        let took = witness.until_it_stands(killed_ns) - killed_ns;
        assert!(took <= 100_000_000 + WAKE_NS, "round {round}: {took} ns");
        let born = Instant::now();
        let _daemon = Running::start(place.vpcd(""));
        eventually("a command", || {
            let twist = witness.observer.twist.oldest().unwrap()?;
            (twist.stamp.published_ns > killed_ns).then_some(())
        });
        assert!(
            born.elapsed() <= Duration::from_secs(1),
            "round {round}: {:?}",
            born.elapsed()
        );
    }
}
