//! `vpc-ros2`: the gateway as a process.

mod tap;

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender};
use std::time::{Duration, Instant};

use ipc::{Domain, Subscriber, now_ns};
use messages::CycleRecord;
use program::Exit;
use ros2_client::Publisher;
use rustix::process::{Resource, getrlimit, setrlimit};
use vpc_ros2::agreement::{Agreement, OtherScene};
use vpc_ros2::bridge::Bridge;
use vpc_ros2::config::{Arguments, Config, Reliability};
use vpc_ros2::diagnostics;
use vpc_ros2::event::{BridgeError, Event, Report};
use vpc_ros2::guard;
use vpc_ros2::message::DiagnosticArray;
use vpc_ros2::overlay::Overlay;
use vpc_ros2::ros::Ros;
use vpc_ros2::services::{RequestServer, Services};
use vpc_ros2::stamp;

/// Events that wait for the log; more are lost.
const EVENTS: usize = 1024;
/// How often the log looks.
const LOOK: Duration = Duration::from_millis(50);
/// Between two looks for requests of services.
const REQUESTS: Duration = Duration::from_millis(2);
/// Between two lines about the same thing.
const SELDOM: Duration = Duration::from_secs(10);
/// Between two diagnostics, and two drawings.
const DIAGNOSTICS: Duration = Duration::from_secs(1);
const DRAWING: Duration = Duration::from_millis(90);
/// Most memory of its own, bytes: twenty times what it uses.
const MOST_MEMORY: u64 = 512 << 20;
/// The program's name, for messages.
const NAME: &str = "vpc-ros2";
/// Longest time from a signal to the end.
const LAST: Duration = Duration::from_secs(2);
/// How long a preflight listens.
const LISTEN: Duration = Duration::from_secs(3);

fn main() -> ExitCode {
    begin().unwrap_or_else(|code| code)
}

fn begin() -> Result<ExitCode, ExitCode> {
    let unavailable = |error| Exit::Unavailable.say(NAME, error);
    let mut words = std::env::args().skip(1);
    if words.next().as_deref() == Some(guard::ROLE) {
        // The guard ends with the gateway, not by a signal.
        let _ignored = program::stop_on_signals().map_err(unavailable)?;
        let name = format!("{NAME} {}", guard::ROLE);
        let ended = guard::run(words).map(|()| ExitCode::SUCCESS);
        return ended.map_err(|error| Exit::Software.say(&name, error));
    }
    let matches = program::arguments::<Arguments>()?;
    // What the DDS library has to tell is for its developers.
    program::log("info,rustdds=off,ros2_client=off");
    let config = Config::load(&matches).map_err(|error| Exit::from(&error).say(NAME, error))?;
    let stop = program::stop_on_signals().map_err(unavailable)?;
    program::end_within(LAST, &stop, NAME).map_err(unavailable)?;
    limit_memory()?;
    let ended = match matches.get_flag("preflight") {
        true => preflight(&config, &stop),
        false => run(&config, &stop),
    };
    ended.map_err(|error| {
        let exit = match error {
            BridgeError::Scene(_) => Exit::Config,
            _ => Exit::Unavailable,
        };
        exit.say(NAME, error)
    })
}

/// What the network makes it allocate ends in an abort, not in a machine without memory; and no
/// core is dumped, which takes time.
fn limit_memory() -> Result<(), ExitCode> {
    for (resource, most) in [(Resource::Data, MOST_MEMORY), (Resource::Core, 0)] {
        let mut limit = getrlimit(resource);
        limit.current = Some(limit.maximum.map_or(most, |maximum| maximum.min(most)));
        setrlimit(resource, limit)
            .map_err(|error| Exit::Unavailable.say(NAME, format_args!("{resource:?}: {error}")))?;
    }
    Ok(())
}

fn run(config: &Config, stop: &AtomicBool) -> Result<ExitCode, BridgeError> {
    if config.is_robot() {
        // Before anything reads the network.
        guard::start(Duration::from_nanos(config.zeros_ns)).map_err(BridgeError::NoGuard)?;
    }
    let mut ros = Ros::join(config)?;
    let bridge = Bridge::open(config, &mut ros)?;
    let services = Services::open(&mut ros)?;
    let diagnostics = ros.publisher("/diagnostics", Reliability::Reliable)?;
    let overlay = Overlay::open(&mut ros, &config.scene, &config.camera.frame)?;
    let name = ros.name().to_owned();
    tracing::info!(
        "{name} in ROS domain {}, vpcd's domain {}",
        config.ros_domain_id,
        config.domain.display()
    );
    let domain = Domain::join(&config.domain)?;
    let onlooker = Onlooker {
        cycles: domain.subscriber(usize::MAX)?,
        cycle: None,
        agreement: Agreement::new(config.scene.clone(), &config.domain),
        diagnostics,
        overlay,
        name,
        domain: config.domain.display().to_string(),
        before: Report::default(),
        told: Instant::now(),
        drawn: Instant::now(),
    };
    let is_stopping = AtomicBool::new(false);
    let is_over = AtomicBool::new(false);
    let (sender, events) = mpsc::sync_channel(EVENTS);
    std::thread::scope(|scope| {
        let (is_over, is_stopping) = (&is_over, &is_stopping);
        let tell = sender.clone();
        let bridge = scope.spawn(move || {
            let _over = SetAtEnd(is_over);
            bridge.run(config, stop, is_stopping, &sender)
        });
        let server = scope.spawn(move || {
            // Nothing moves that the service cannot stop: with this thread the loop ends, too.
            let _stop = SetAtEnd(stop);
            serve(config, &services, is_stopping, is_over, tell)
        });
        // Until both have ended.
        let seen = onlooker.watch(&events, stop);
        match (bridge.join(), server.join()) {
            (Ok(bridge), Ok(server)) => {
                seen?;
                bridge.and(server).map(|()| ExitCode::SUCCESS)
            }
            _ => {
                let defect = "a defect; robots stop by their own time-out";
                Ok(Exit::Software.say(NAME, defect))
            }
        }
    })
}

/// Sets a flag when its thread ends, by a panic too.
struct SetAtEnd<'a>(&'a AtomicBool);

impl Drop for SetAtEnd<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn serve(
    config: &Config,
    services: &Services,
    is_stopping: &AtomicBool,
    is_over: &AtomicBool,
    tell: SyncSender<Event>,
) -> Result<(), BridgeError> {
    let domain = Domain::join(&config.domain)?;
    let directory = config.domain.clone();
    let mut server = RequestServer::open(services, &domain, directory, is_stopping, tell)?;
    while !is_over.load(Ordering::Relaxed) {
        server.look();
        std::thread::sleep(REQUESTS);
    }
    Ok(())
}

/// What is told of: to the log, to /diagnostics, and over the image.
struct Onlooker {
    cycles: Subscriber<CycleRecord>,
    /// vpcd's last, and when it came, ns.
    cycle: Option<(CycleRecord, u64)>,
    agreement: Agreement,
    diagnostics: Publisher<DiagnosticArray>,
    overlay: Overlay,
    name: String,
    domain: String,
    /// The report of the last diagnostics.
    before: Report,
    told: Instant,
    drawn: Instant,
}

impl Onlooker {
    /// Until the loop ends, which it is told to by `stop` where vpcd has another scene.
    fn watch(mut self, events: &Receiver<Event>, stop: &AtomicBool) -> Result<(), OtherScene> {
        let mut log = Log::default();
        let mut report = Report::default();
        let mut agreed = Ok(());
        loop {
            match events.recv_timeout(LOOK) {
                // The loop turns, and so does this thread.
                Ok(Event::Report(newest)) => {
                    report = newest;
                    program::notify("READY=1\nWATCHDOG=1");
                }
                Ok(event) => log.tell(&event),
                Err(RecvTimeoutError::Timeout) => (),
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if let Err(other) = self.look(&report, &mut log) {
                stop.store(true, Ordering::Relaxed);
                agreed = Err(other);
            }
        }
        tracing::info!(
            "stopped: {} twists sent, {} of them zeros of its own",
            report.sent[0],
            report.sent[1]
        );
        agreed
    }

    fn look(&mut self, report: &Report, log: &mut Log) -> Result<(), OtherScene> {
        // A record that breaks the contract is none.
        if let Ok(Some(cycle)) = self.cycles.latest() {
            self.cycle = Some((cycle.message, now_ns()));
            if self.drawn.elapsed() >= DRAWING {
                self.drawn = Instant::now();
                let at = cycle.stamp.data_ns.saturating_sub(cycle.features_age_ns);
                let drawn = self.overlay.draw(&cycle, stamp::wall(at, report.offset_ns));
                log.failed("a drawing", drawn);
            }
        }
        if self.told.elapsed() < DIAGNOSTICS {
            return Ok(());
        }
        self.told = Instant::now();
        let now = now_ns();
        let cycle = self.cycle.as_ref().map(|(cycle, came)| (cycle, *came));
        let stamp = stamp::wall(now, report.offset_ns);
        let (name, domain, before) = (&self.name, &self.domain, &self.before);
        let array = diagnostics::array(name, domain, cycle, report, before, now, stamp);
        let sent = self.diagnostics.publish(array);
        log.failed("the diagnostics", sent.map_err(|why| format!("{why:?}")));
        self.before = report.clone();
        match self.cycle {
            Some((_, came)) if now.saturating_sub(came) < DIAGNOSTICS.as_nanos() as u64 => {
                self.agreement.check()
            }
            _ => Ok(()),
        }
    }
}

/// What the program tells, each thing at most every few seconds.
#[derive(Default)]
struct Log(BTreeMap<(String, &'static str), Instant>);

impl Log {
    fn failed(&mut self, what: &'static str, sent: Result<(), String>) {
        if let Err(why) = sent {
            self.tell(&Event::NotSent(what, why));
        }
    }

    fn tell(&mut self, event: &Event) {
        let about = match event {
            Event::Refused(topic, refusal) => (topic.clone(), refusal.kind()),
            Event::NoFrame => (String::new(), "frame"),
            Event::NotSent(what, _) => (String::new(), *what),
            Event::Command(_) => (String::new(), "command"),
            Event::Comes(topic) => return tracing::info!("{topic}: messages are coming"),
            Event::Step(ns) => {
                return tracing::warn!("the wall clock stepped by {:.1} ms", -1e-6 * *ns as f64);
            }
            Event::Service(words) => return tracing::warn!("{words}"),
            Event::Report(_) => return,
        };
        let last = self.0.get(&about);
        if last.is_some_and(|last| last.elapsed() < SELDOM) {
            return;
        }
        self.0.insert(about, Instant::now());
        match event {
            Event::Refused(topic, refusal) => tracing::warn!("{topic}: refused: {refusal}"),
            Event::NoFrame => tracing::warn!(
                "zero is sent: the tool's pose is missing, by which twists are turned into the base's frame"
            ),
            Event::NotSent(what, why) => tracing::warn!("{what} could not be sent: {why}"),
            Event::Command(invalid) => tracing::warn!("a command of vpcd is refused: {invalid}"),
            _ => (),
        }
    }
}

/// Listens, and says what comes.
fn preflight(config: &Config, stop: &AtomicBool) -> Result<ExitCode, BridgeError> {
    let mut ros = Ros::join(config)?;
    let bridge = Bridge::open(config, &mut ros)?;
    let (sender, events) = mpsc::sync_channel(EVENTS);
    let report = std::thread::scope(|scope| {
        let bridge = scope.spawn(|| bridge.listen(stop, &sender));
        std::thread::sleep(LISTEN);
        stop.store(true, Ordering::Relaxed);
        bridge.join()
    });
    let Ok(report) = report else {
        return Ok(Exit::Software.say(NAME, "a defect"));
    };
    let reasons: BTreeMap<String, String> = events
        .try_iter()
        .filter_map(|event| match event {
            Event::Refused(topic, refusal) => Some((topic, refusal.to_string())),
            _ => None,
        })
        .collect();
    let mut is_good = true;
    for (topic, counts) in &report?.topics {
        let refused: u64 = counts.refused.values().sum();
        let others = counts.passed_over;
        let (word, words) = match (counts.taken, reasons.get(topic)) {
            (0, None) if others > 0 => (
                "FAIL",
                format!("{others} messages, none of which names a joint of robot.joints"),
            ),
            (0, None) => (
                "FAIL",
                "nothing came: name, ROS domain, interfaces, reliability?".to_owned(),
            ),
            (0, Some(why)) => ("FAIL", format!("{refused} refused: {why}")),
            (taken, None) => {
                let age = 1e-6 * counts.age_ns as f64;
                ("ok", format!("{taken} taken, the last {age:.1} ms old"))
            }
            (taken, Some(why)) => ("warn", format!("{taken} taken, {refused} refused: {why}")),
        };
        is_good &= word != "FAIL";
        println!("{word:<5} {topic}: {words}");
    }
    Ok(if is_good { Exit::Ok } else { Exit::Attention }.into())
}
