//! A stand-in for the daemon: answers requests and publishes records of cycles, in a thread of its
//! own.

use std::fs::File;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;
use std::time::Duration;

use ipc::StopFile;
use ipc::{ControllerPorts, Domain, RecorderPort};
use messages::{Action, CycleRecord, Hold, Outcome, Reply};
use messages::{ImageHeader, Request, SolverStatus, Stamp, StrategyCode, TwistState};

/// Period of its loop.
const PERIOD: Duration = Duration::from_millis(10);

/// The thread; it ends when this is dropped.
pub struct StandIn {
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    /// The lock on the file that names the daemon's process.
    _claim: File,
}

/// What it does.
#[derive(Clone, Copy)]
pub struct Manner {
    /// Whether it answers requests.
    pub answers: bool,
    /// Whether its cycles go on.
    pub cycles: bool,
}

impl StandIn {
    /// Starts it in this directory, which exists; returns when its ports are open.
    pub fn start(directory: &Path, manner: Manner) -> Self {
        let path = directory.join("vpcd.pid");
        std::fs::write(&path, format!("{}\n", std::process::id())).unwrap();
        let claim = File::open(&path).unwrap();
        claim.lock().unwrap();
        let end = Arc::new(AtomicBool::new(false));
        let (ready, opened) = mpsc::channel();
        let thread = {
            let (directory, end) = (directory.to_owned(), Arc::clone(&end));
            std::thread::spawn(move || {
                let domain = Domain::join(&directory).unwrap();
                let mut ports = ControllerPorts::open(&domain).unwrap();
                let mut recorder = RecorderPort::open(&domain).unwrap();
                let mut stop_file = StopFile::open(domain.directory()).unwrap();
                ready.send(()).unwrap();
                let mut law = Law::default();
                while !end.load(Ordering::Relaxed) {
                    std::thread::sleep(PERIOD);
                    if manner.answers {
                        while let Ok(Some(request)) = ports.requests.oldest() {
                            let reply = law.answer(&request.message);
                            ports.replies.publish(&reply).unwrap();
                        }
                        if stop_file.is_asked() {
                            law.answer(&Request::new(Request::STOP_FILE, Action::Stop));
                            stop_file.obey();
                        }
                    }
                    if manner.cycles {
                        recorder.cycles.publish(&law.cycle()).unwrap();
                    }
                }
            })
        };
        opened.recv().unwrap();
        let thread = Some(thread);
        Self {
            end,
            thread,
            _claim: claim,
        }
    }

    /// One that does all that a daemon does.
    pub fn sound(directory: &Path) -> Self {
        let manner = Manner {
            answers: true,
            cycles: true,
        };
        Self::start(directory, manner)
    }
}

impl Drop for StandIn {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// A camera that sends the same image again and again, in a thread of its own.
pub struct Camera {
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Camera {
    /// Starts it in this domain; `pixel` gives the bytes of the pixel (u, v).
    pub fn start<const N: usize>(
        directory: &Path,
        header: ImageHeader,
        pixel: impl Fn(u32, u32) -> [u8; N],
    ) -> Self {
        let rows = (0..header.height).flat_map(|v| (0..header.width).map(move |u| (u, v)));
        let bytes: Vec<u8> = rows.flat_map(|(u, v)| pixel(u, v)).collect();
        let end = Arc::new(AtomicBool::new(false));
        let thread = {
            let (directory, end) = (directory.to_owned(), Arc::clone(&end));
            std::thread::spawn(move || {
                let domain = Domain::join(&directory).unwrap();
                let mut publisher = domain.image_publisher(bytes.len()).unwrap();
                while !end.load(Ordering::Relaxed) {
                    let mut image = publisher.loan(&header).unwrap();
                    image.copy_from_slice(&bytes);
                    publisher.publish(image).unwrap();
                    std::thread::sleep(PERIOD);
                }
            })
        };
        let thread = Some(thread);
        Self { end, thread }
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// What it knows.
pub struct Law {
    cycle: u64,
    state: TwistState,
    hold: Option<Hold>,
    strategy: StrategyCode,
    neighbours: u32,
    /// The veto that stands.
    veto: u32,
    vetoes: u32,
}

impl Default for Law {
    fn default() -> Self {
        Self {
            cycle: 0,
            state: TwistState::Disarmed,
            hold: Some(Hold::NotArmed),
            strategy: StrategyCode::Previous,
            neighbours: 0,
            veto: 0,
            vetoes: 0,
        }
    }
}

impl Law {
    pub fn answer(&mut self, request: &Request) -> Reply {
        let strategy = StrategyCode::from_code(request.strategy);
        let outcome = match (request.action().unwrap(), strategy.unwrap()) {
            (Action::Strategy, StrategyCode::Gpr) => Outcome::NoMemory,
            (Action::Arm, _) if ![0, request.veto].contains(&self.veto) => Outcome::Vetoed,
            _ => Outcome::Done,
        };
        match (request.action().unwrap(), outcome) {
            (Action::Arm, Outcome::Done) => {
                (self.state, self.hold) = (TwistState::Moving, None);
                self.veto = 0;
            }
            (Action::Stop, _) => {
                (self.state, self.hold) = (TwistState::Disarmed, Some(Hold::Operator));
                self.vetoes += 1;
                self.veto = 2 * self.vetoes + 1;
            }
            (Action::Disarm, _) => {
                (self.state, self.hold) = (TwistState::Disarmed, Some(Hold::Operator));
                self.vetoes += 1;
                self.veto = 2 * self.vetoes;
            }
            (Action::Strategy, Outcome::Done) => {
                self.strategy = strategy.unwrap();
                self.neighbours = request.neighbours;
            }
            _ => (),
        }
        Reply {
            stamp: Stamp::default(),
            id: request.id,
            cycle: 0,
            action: request.action,
            outcome: outcome.code(),
            state: self.state.code(),
            hold: Hold::number(self.hold),
            strategy: self.strategy.code(),
            neighbours: self.neighbours,
            veto: self.veto,
            named: request.veto,
            veto_ns: 0,
        }
    }

    pub fn cycle(&mut self) -> CycleRecord {
        self.cycle += 1;
        let mut record = CycleRecord {
            cycle: self.cycle,
            veto: self.veto,
            status: SolverStatus::Converged.code(),
            wake_latency_ns: 50_000,
            receive_ns: 2_000,
            step_ns: 30_000,
            send_ns: 3_000,
            overruns: 2,
            features_sequence: self.cycle,
            features_age_ns: 33_000_000,
            count: 4,
            strategy: self.strategy.code(),
            neighbours: self.neighbours,
            np: 3,
            iterations: 2,
            hold: Hold::number(self.hold),
            state: self.state.code(),
            cost: 12.0,
            violation_px: 0.0,
            clearance_px: 25.5,
            error_px: 120.25,
            ..CycleRecord::default()
        };
        record.stamp.data_ns = ipc::now_ns();
        for (place, value) in [700.0, 500.0, 900.0, 500.0, 900.0, 700.0, 700.0, 700.0]
            .iter()
            .enumerate()
        {
            record.points[place] = *value;
        }
        if self.state == TwistState::Moving {
            record.twist = [0.1, -0.2, 0.05, 0.0, 0.3, -0.4];
        }
        record
    }
}
