//! Peers that are killed: cameras, observers, operators, and the daemon itself. The others go on, a
//! peer that comes back is heard within half a second, and no leftovers accumulate.

use std::os::unix::net::UnixDatagram;
use std::process::Stdio;
use std::time::Duration;

use ipc::{Domain, now_ns};
use messages::{Action, Hold, Outcome, TwistState};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Signal;

use crate::fixture::{
    PERIOD_NS, Place, Running, Stage, WAKE_NS, Witness, classes, eventually, is_still, some_time,
};
use crate::judge::in_time;
use crate::reference::Class;
use crate::sheet::Sheet;

/// Longest time until a peer that came back is heard, ns.
const RECONNECT_NS: u64 = 500_000_000;
/// From the kill of the daemon to standstill, ns, and from the start of the next to its commands.
const STANDS_NS: u64 = 100_000_000 + WAKE_NS;
const COMMANDS_NS: u64 = 1_000_000_000;

/// Open files of a process.
fn descriptors(id: u32) -> usize {
    std::fs::read_dir(format!("/proc/{id}/fd")).unwrap().count()
}

/// One camera and one client that come, are heard, and are killed: how long the slower of them was
/// not heard, ns.
fn visit(
    place: &Place,
    witness: &mut Witness,
    round: usize,
    random: &mut impl Rng,
) -> anyhow::Result<u64> {
    let before = witness.newest_features_ns();
    let camera = Running::start(place.hw_sim(round % 100));
    // From the first features that it publishes to the first command that answers them.
    let published = eventually("features", || {
        let newest = witness.observer.features.oldest().unwrap()?;
        (newest.stamp.published_ns > before).then_some(newest.stamp.published_ns)
    });
    let answered = witness.until("an answer", |twist| {
        twist.features_published_ns >= published
    });
    let answer_ns = answered.last().unwrap().stamp.published_ns;
    let took = in_time(
        "the camera is answered",
        Class::of_vpcd(),
        published,
        answer_ns,
        RECONNECT_NS,
    )?;
    // A client, after the one that was killed: from its joining to its answer.
    let came = now_ns();
    let mut client = Witness::new(place);
    assert_eq!(client.ask(Action::Status), Outcome::Done);
    drop(client);
    let answered = in_time(
        "a client is answered",
        Class::Ordinary,
        came,
        now_ns(),
        RECONNECT_NS,
    )?;
    witness.set_in_motion()?;
    // A client that is killed while it joins, asks or leaves, before the camera or after it.
    let mut client = place.vpcctl();
    client
        .arg("status")
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    let mut camera = Some(camera);
    if round.is_multiple_of(2) {
        drop(camera.take());
    }
    let client = Running::start(client);
    std::thread::sleep(Duration::from_micros(random.random_range(0..120_000)));
    client.kill();
    drop(camera);
    witness.until("a controller that gave up", |twist| {
        twist.state() == Some(TwistState::Disarmed)
    });
    Ok(took.max(answered))
}

/// Measures cameras and clients that are killed.
pub fn measure_killed(sheet: &mut Sheet) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let place = Place::new();
    let mut witness = Witness::new(&place);
    let mut daemon = Running::start(place.vpcd(""));
    let mut plateau = None;
    let rounds = sheet.repeats(20, 100);
    for round in 0..rounds {
        let what = format!("round {round}");
        let visited = sheet.round(&classes(), &what, || {
            visit(&place, &mut witness, round, &mut random)
        });
        if let Some(ns) = visited {
            sheet.longest("heard again after", ns, RECONNECT_NS);
        }
        assert!(daemon.is_running(), "round {round}");
        // Dead peers are cleared away once a second.
        if round + 1 == rounds / 2 || round + 1 == rounds {
            std::thread::sleep(Duration::from_millis(2500));
            let now = [
                descriptors(daemon.id()),
                Domain::segments(&place.domain()).unwrap(),
            ];
            let then = *plateau.get_or_insert(now);
            sheet.bar("descriptors", now[0] as f64, "", (then[0] + 2) as f64);
            sheet.bar("segments", now[1] as f64, "", (then[1] + 2) as f64);
            let is_level = now[0] <= then[0] + 2 && now[1] <= then[1] + 2;
            sheet.check(is_level, || format!("left behind: {then:?} -> {now:?}"));
        }
    }
}

/// Measures a daemon that is killed, and the next one.
pub fn measure_vpcd(sheet: &mut Sheet) {
    let mut random = ChaCha8Rng::seed_from_u64(2);
    for round in 0..sheet.repeats(5, 100) {
        let what = format!("kill {round}");
        let took = sheet.round(&classes(), &what, || fall(round, &mut random));
        if let Some([stands_ns, commands_ns]) = took {
            sheet.longest("the robot stands after", stands_ns, STANDS_NS);
            sheet.longest("the next commands after", commands_ns, COMMANDS_NS);
        }
    }
}

/// One kill of the daemon, at a random phase of its cycle, and the next daemon: how long until the
/// robot stood and until the next was ready and commanded, ns.
fn fall(round: usize, random: &mut impl Rng) -> anyhow::Result<[u64; 2]> {
    let Stage {
        place,
        mut witness,
        daemon,
        mut camera,
    } = Stage::in_motion(round)?;
    some_time(4, random);
    daemon.signal(Signal::KILL);
    let killed_ns = now_ns();
    daemon.kill();
    // What the robot says of itself.
    let stands_ns = witness.until_it_stands(killed_ns, &mut camera);
    let class = Class::of_vpcd();
    let took = in_time("the robot stands", class, killed_ns, stands_ns, STANDS_NS)?;
    // READY as systemd hears it, and the first command.
    let manager = UnixDatagram::bind(place.path("manager")).unwrap();
    manager.set_nonblocking(true).unwrap();
    let mut command = place.vpcd("[safety]\narmed = true");
    command.env("NOTIFY_SOCKET", place.path("manager"));
    let born_ns = now_ns();
    let _daemon = Running::start(command);
    eventually("READY", || {
        let mut words = [0; 256];
        let length = manager.recv(&mut words).ok()?;
        let words = String::from_utf8_lossy(&words[..length]);
        words.contains("READY=1").then_some(())
    });
    let first = eventually("a command", || {
        let twist = witness.observer.twist.oldest().unwrap()?.message;
        (twist.stamp.published_ns > killed_ns).then_some(twist)
    });
    let commands_ns = now_ns();
    // Although it is to begin armed: the last one did not end by itself.
    assert_eq!(first.state(), Some(TwistState::Disarmed));
    std::thread::sleep(Duration::from_nanos(10 * PERIOD_NS));
    assert!(
        witness.commands().iter().all(is_still),
        "it moves by itself"
    );
    let last = eventually("a record", || witness.records().pop());
    assert_eq!(last.hold(), Some(Hold::Unclean));
    let ready = in_time(
        "READY and commands",
        Class::Ordinary,
        born_ns,
        commands_ns,
        COMMANDS_NS,
    )?;
    Ok([took, ready])
}
