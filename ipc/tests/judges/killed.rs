//! A peer is killed at each call of its start-up that touches files, beside a living one: it leaves
//! no place taken, and the living one never waits for it. `strace` counts the calls, and kills.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::process::Child;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use ipc::{CameraPorts, ControllerPorts, Domain};
use messages::{Features, Message, TwistCommand, TwistState};
use rustix::process::{Pid, Signal, kill_process};
use testkit::{Place, are_installed, is_long, tell};

use crate::peers::{peer, square, working};

/// Every so many calls, unless all are asked for; prime, so that it meets all kinds of them.
const STRIDE: usize = 13;
/// How often a call of the living peer may give up its processor. Waiting for a peer, iceoryx2
/// sleeps every millisecond.
const PATIENCE: u64 = 10;

/// The n-th call of this name, counted from 1.
#[derive(Debug)]
struct Call {
    name: String,
    number: usize,
}

/// The file-system calls of a peer between its first look at the domain and its first message.
fn calls_of(role: &str, place: &Place) -> Vec<Call> {
    let log = place.path("calls");
    let mut strace = testkit::command("strace");
    strace.args([
        "-f",
        "-e",
        "trace=%file,ftruncate,fchmod,flock,write,getdents64,mmap",
        "-o",
    ]);
    strace.arg(&log);
    let status = peer(role, place, Some(strace)).spawn().unwrap().wait();
    status.unwrap();
    let domain = place.domain().display().to_string();
    let (mut numbers, mut found, mut is_inside) = (BTreeMap::new(), Vec::new(), false);
    let log = std::fs::read_to_string(log).unwrap();
    for line in log.lines() {
        // 1234 openat(AT_FDCWD, "/dev/null", O_RDONLY) = 3
        let (_, call) = line.split_once(' ').unwrap();
        let Some((name, words)) = call.trim_start().split_once('(') else {
            continue;
        };
        let number = numbers.entry(name).or_insert(0);
        *number += 1;
        is_inside |= words.contains(&domain);
        if words.contains("working") {
            return found;
        }
        // Of the mappings only those of shared memory.
        if is_inside && (name != "mmap" || words.contains("MAP_SHARED")) {
            found.push(Call {
                name: name.to_owned(),
                number: *number,
            });
        }
    }
    panic!("{role}: it never worked")
}

/// Starts a peer that is killed at this call, or when it works.
fn killed_at(call: &Call, role: &str, place: &Place) -> Child {
    let Call { name, number } = call;
    let mut strace = testkit::command("strace");
    strace.args([
        "-f",
        "-o",
        "/dev/null",
        "-e",
        &format!("trace={name}"),
        "-e",
    ]);
    strace.arg(format!("inject={name}:signal=KILL:when={number}"));
    peer(role, place, Some(strace)).spawn().unwrap()
}

/// Kills what runs under `strace`, which ends then.
fn kill_children(strace: &Child) {
    let id = strace.id();
    let children = std::fs::read_to_string(format!("/proc/{id}/task/{id}/children")).unwrap();
    for child in children.split_whitespace() {
        let process = Pid::from_raw(child.parse().unwrap()).unwrap();
        kill_process(process, Signal::KILL).unwrap();
    }
}

/// How often this thread has given up its processor by itself.
fn given_up() -> u64 {
    let status = std::fs::read_to_string("/proc/thread-self/status").unwrap();
    let mut lines = status.lines();
    let line = lines.find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
    line.unwrap().trim().parse().unwrap()
}

/// Ends this process where the living peer makes no turn for long: it cannot tell itself that it
/// waits without end. Ends with the last holder of the count.
fn watch(turns: &Arc<AtomicU64>) {
    let turns = Arc::downgrade(turns);
    let now = move || turns.upgrade().map(|turns| turns.load(Ordering::Relaxed));
    std::thread::spawn(move || {
        while let Some(before) = now() {
            std::thread::sleep(3 * testkit::PATIENCE);
            if now() == Some(before) {
                tell("the living peer waits for a killed one without end");
                std::process::abort();
            }
        }
    });
}

/// Kills a peer at the calls of its start-up; `live` is one turn of the living one.
fn kill_everywhere(role: &str, place: &Place, mut live: impl FnMut()) {
    let once = format!("{role} once");
    let calls = calls_of(&once, place);
    assert!(calls.len() > 200, "{}", calls.len());
    let stride = if is_long() { 1 } else { STRIDE };
    // The longest turn beside each peer, in which it is connected, us.
    let (mut longest, mut kills) = (Vec::new(), 0);
    let turns = Arc::new(AtomicU64::new(0));
    watch(&turns);
    for (k, call) in calls.iter().step_by(stride).enumerate() {
        let mut peer = killed_at(call, &once, place);
        let (begin, mut turn) = (Instant::now(), Duration::ZERO);
        while peer.try_wait().unwrap().is_none() {
            let (before, start) = (given_up(), Instant::now());
            live();
            turns.fetch_add(1, Ordering::Relaxed);
            turn = turn.max(start.elapsed());
            let times = given_up() - before;
            assert!(
                times < PATIENCE,
                "beside a {role} killed at {call:?}: waited {times} times"
            );
            if begin.elapsed() > testkit::PATIENCE {
                kill_children(&peer);
                panic!("{role}, to be killed at {call:?}, waits for what others left");
            }
            std::thread::sleep(Duration::from_micros(200));
        }
        longest.push(turn.as_micros());
        let mut said = String::new();
        let stdout = peer.stdout.as_mut().unwrap();
        stdout.read_to_string(&mut said).unwrap();
        kills += usize::from(!said.contains("working"));
        if k % 8 == 0 {
            working(role, place).kill();
        }
    }
    longest.sort_unstable();
    let (peers, most) = (longest.len(), longest[longest.len() - 1]);
    tell(format_args!(
        "{role}: killed at {kills} of its {} calls; the longest turn beside it took {} us in the median, {most} at most",
        calls.len(),
        longest[peers / 2],
    ));
    // What others left changes how many calls a start-up needs.
    assert!(10 * kills > 9 * peers, "{kills} of {peers} were killed");
}

/// Asserts that all places of a domain are free, but for these of the living.
fn assert_free<P: Message, S: Message>(
    place: &Place,
    domains: usize,
    publishers: usize,
    subscribers: usize,
) {
    let domain = Domain::join(&place.domain()).unwrap();
    let publishers: Vec<_> = (publishers..P::QOS.publishers)
        .map(|_| domain.publisher::<P>().unwrap())
        .collect();
    let subscribers: Vec<_> = (subscribers..S::QOS.subscribers)
        .map(|_| domain.subscriber::<S>(1).unwrap())
        .collect();
    let domains: Vec<_> = (domains + 1..ipc::MAX_NODES)
        .map(|_| Domain::join(&place.domain()).unwrap())
        .collect();
    drop((publishers, subscribers, domains));
}

#[test]
fn a_kill_at_any_call_of_a_start_up_leaves_no_place_taken() {
    if !are_installed("a kill at every call of a start-up", &["strace"]) {
        return;
    }
    let place = Place::new();
    let domain = Domain::join(&place.domain()).unwrap();
    {
        let mut camera = CameraPorts::open(&domain).unwrap();
        kill_everywhere("echo", &place, || {
            camera.features.publish(&square(0.0)).unwrap();
            camera.twist.latest().unwrap();
        });
        assert_free::<TwistCommand, Features>(&place, 1, 0, 0);
    }
    let mut controller = ControllerPorts::open(&domain).unwrap();
    kill_everywhere("camera", &place, || {
        if let Some(features) = controller.features.latest().unwrap() {
            let twist = TwistCommand::answer(&features, [0.0; 6], TwistState::Moving);
            controller.twist.publish(&twist).unwrap();
        }
    });
    assert_free::<Features, TwistCommand>(&place, 1, 0, 0);
}
