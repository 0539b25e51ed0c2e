//! An external method: a program that steers the camera in place of our law. It speaks the lines
//! of JSON that `tests/peers/README.md` describes.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStdin, ChildStdout, Stdio};
use std::str::FromStr;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use decision::{Input, Inputs};
use messages::CycleRecord;
use scene::{Occlusion, Scene};
use serde_json::{Value, json};
use vpc::{Settings, SettingsError, Task};

use crate::steering::Steering;

/// The most bytes of an answer.
const MOST_BYTES: u64 = 4096;
/// The most characters of a line that a message quotes.
const QUOTED: usize = 80;
/// How long a program may take to end once a pipe is closed.
const ENDING: Duration = Duration::from_secs(1);

/// The components of a twist, and their units.
const COMPONENTS: [(&str, &str); 6] = [
    ("vx", "m/s"),
    ("vy", "m/s"),
    ("vz", "m/s"),
    ("wx", "rad/s"),
    ("wy", "rad/s"),
    ("wz", "rad/s"),
];

/// A method of the command line: `NAME=PROGRAM ARGS`.
#[derive(Clone, Debug, PartialEq)]
pub struct Method {
    /// What its row is called.
    pub name: String,
    /// A program and its arguments, separated by spaces.
    pub words: String,
}

impl FromStr for Method {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('=');
        let (name, words) = parts.map_or(("", ""), |(name, words)| (name.trim(), words.trim()));
        match name.is_empty() || words.is_empty() {
            true => Err(format!("`{text}`; allowed: NAME=PROGRAM, with arguments")),
            false => Ok(Self {
                name: name.to_owned(),
                words: words.to_owned(),
            }),
        }
    }
}

/// A method's process. When it is dropped its input ends, and soon it is killed.
#[derive(Debug)]
pub struct External {
    name: String,
    task: Task,
    np: usize,
    child: Child,
    /// Lines to the program.
    asked: Sender<String>,
    /// What it answered, line by line.
    answered: Receiver<io::Result<Answer>>,
    patience: Duration,
    /// The last command, and that of a camera at rest before the first.
    standing: [f64; 6],
    begin_ns: Option<u64>,
    runs: usize,
    times_us: Vec<f64>,
}

/// What a program answers to a line.
#[derive(Debug)]
struct Answer {
    /// Its line; empty if the output ended.
    line: Vec<u8>,
    /// From the first byte of the question to the last one of the answer, us.
    us: f64,
    /// Whether it has written more than that line.
    has_more: bool,
}

/// Why a method does not steer.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say it
pub enum ExternalError {
    #[error("{name}: {program} cannot be started: {error}")]
    Start {
        name: String,
        program: String,
        error: io::Error,
    },
    #[error("{name}: ended ({how}) at the line `{line}`; allowed: an answer to each line")]
    Ended {
        name: String,
        how: String,
        line: String,
    },
    #[error("{name}: no answer to `{line}` after {patience:?}; allowed: --timeout-s")]
    TimeOut {
        name: String,
        line: String,
        patience: Duration,
    },
    #[error("{name}: answers `{answer}` to `{line}`; allowed: {allowed}")]
    Answer {
        name: String,
        answer: String,
        line: String,
        allowed: &'static str,
    },
    #[error("{name}: commands {component} = {value} {unit}; allowed: {least} to {most}")]
    Beyond {
        name: String,
        component: &'static str,
        unit: &'static str,
        value: f64,
        least: f64,
        most: f64,
    },
    #[error(transparent)]
    Task(#[from] SettingsError),
}

impl External {
    /// Starts a method for this scene, as the law believes it to be, and waits until it is ready.
    /// Its limits of acceleration are those of the law. It has `patience` for each answer.
    ///
    /// # Errors
    /// [`ExternalError`]: it cannot be started, is not ready in time, or the scene gives no task.
    pub fn start(
        method: &Method,
        scene: &Scene,
        settings: &Settings,
        patience: Duration,
    ) -> Result<Self, ExternalError> {
        let mut task = Task::new(scene).map_err(SettingsError::from)?;
        task.acceleration = settings.acceleration(&scene.limits);
        let mut words = method.words.split_whitespace();
        let program = words.next().unwrap_or_default();
        let mut command = testkit::command(program);
        command
            .args(words)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        let started = command.spawn().and_then(|mut child| {
            let pipes = child.stdin.take().zip(child.stdout.take());
            let (input, output) = pipes.ok_or(io::ErrorKind::BrokenPipe)?;
            Ok((child, input, output))
        });
        let (child, input, output) = started.map_err(|error| ExternalError::Start {
            name: method.name.clone(),
            program: program.to_owned(),
            error,
        })?;
        let (asked, questions) = channel();
        let (answers, answered) = channel();
        // Either pipe may block. The thread ends with the program, or when nothing more is asked.
        std::thread::spawn(move || {
            let mut talk = Talk {
                input,
                output: BufReader::new(output),
            };
            for question in questions {
                if answers.send(talk.exchange(question)).is_err() {
                    break;
                }
            }
        });
        let mut external = Self {
            name: method.name.clone(),
            task,
            np: settings.np,
            child,
            asked,
            answered,
            patience,
            standing: [0.0; 6],
            begin_ns: None,
            runs: 0,
            times_us: Vec::new(),
        };
        let line = json!({ "scene": external.described(scene) }).to_string();
        external.wait_until_ready(line)?;
        Ok(external)
    }

    /// Time of each cycle of the last run, us: from the question to the answer, both pipes and the
    /// program's reading and writing included.
    pub fn times_us(&self) -> &[f64] {
        &self.times_us
    }

    /// All that a method may know.
    fn described(&self, scene: &Scene) -> Value {
        let camera = &scene.camera;
        json!({
            "camera": {
                "width": camera.width, "height": camera.height,
                "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy,
            },
            "period": self.task.period,
            "pattern": scene.pattern.as_slice(),
            "marker_size": scene.marker_size,
            "goal": {
                "translation": scene.goal.translation,
                "rotation": scene.goal.rotation,
                "features": self.task.goal.iter().collect::<Vec<_>>(),
            },
            "limits": self.task.limits,
            "acceleration": self.task.acceleration,
            "cost": { "k_q": scene.cost.k_q, "r": scene.cost.r, "np": self.np },
            "violation_px": scene.success.violation_px,
            "convergence_px": scene.success.convergence_px,
            "time_s": scene.success.time_s,
            "occlusions": scene.occlusions.iter().map(occlusion).collect::<Vec<_>>(),
        })
    }

    /// Asks a line, and waits for the answer.
    fn ask(&mut self, line: &str) -> Result<Answer, ExternalError> {
        // The thread may be gone: then no answer arrives, either.
        let _ = self.asked.send(line.to_owned());
        match self.answered.recv_timeout(self.patience) {
            Ok(Ok(answer)) if !answer.line.is_empty() => Ok(answer),
            Err(RecvTimeoutError::Timeout) => Err(ExternalError::TimeOut {
                name: self.name.clone(),
                line: quoted(line),
                patience: self.patience,
            }),
            Ok(_) | Err(RecvTimeoutError::Disconnected) => {
                let status = testkit::within(ENDING, || self.child.try_wait().ok().flatten());
                let how = status.map(|status| status.to_string());
                Err(ExternalError::Ended {
                    name: self.name.clone(),
                    how: how.unwrap_or_else(|| "its output is closed".to_owned()),
                    line: quoted(line),
                })
            }
        }
    }

    /// The error of an answer that is not what is allowed.
    fn refused(&self, answer: &Answer, line: &str, allowed: &'static str) -> ExternalError {
        ExternalError::Answer {
            name: self.name.clone(),
            answer: quoted(&String::from_utf8_lossy(&answer.line)),
            line: quoted(line),
            allowed,
        }
    }

    fn wait_until_ready(&mut self, line: String) -> Result<(), ExternalError> {
        let answer = self.ask(&line)?;
        match serde_json::from_slice(&answer.line) {
            Ok(Value::String(word)) if word == "ready" && !answer.has_more => Ok(()),
            _ => Err(self.refused(&answer, &line, "one line \"ready\"")),
        }
    }

    /// The first component of a twist that is beyond its limits.
    fn beyond(&self, twist: &[f64; 6]) -> Option<ExternalError> {
        let k = (0..6).find(|&k| {
            let mut one = self.standing;
            one[k] = twist[k];
            !self.is_within_limits(&one, &self.standing)
        })?;
        let (limit, before) = (self.task.limits[k], self.standing[k]);
        let change = self.task.acceleration[k] * self.task.period;
        Some(ExternalError::Beyond {
            name: self.name.clone(),
            component: COMPONENTS[k].0,
            unit: COMPONENTS[k].1,
            value: twist[k],
            least: (before - change).max(-limit),
            most: (before + change).min(limit),
        })
    }
}

/// The pipes of a program.
struct Talk {
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl Talk {
    fn exchange(&mut self, mut question: String) -> io::Result<Answer> {
        question.push('\n');
        let begin = Instant::now();
        self.input.write_all(question.as_bytes())?;
        let mut line = Vec::new();
        let mut output = self.output.by_ref().take(MOST_BYTES);
        output.read_until(b'\n', &mut line)?;
        let us = begin.elapsed().as_nanos() as f64 / 1e3;
        let has_more = !self.output.buffer().is_empty();
        Ok(Answer { line, us, has_more })
    }
}

/// The begin of a line.
fn quoted(line: &str) -> String {
    let line = line.trim_end();
    match line.char_indices().nth(QUOTED) {
        Some((end, _)) => line[..end].to_owned() + "...",
        None => line.to_owned(),
    }
}

/// An occlusion as a method reads it.
fn occlusion(occlusion: &Occlusion) -> Value {
    let parts = occlusion.parts.iter();
    let parts = parts.map(|part| json!({ "center": part.center, "half": part.half, "p": part.p }));
    let rectangles = occlusion.mask.iter().flat_map(|mask| mask.rectangles());
    let rectangles =
        rectangles.map(|[columns, rows]| [columns.start, columns.end, rows.start, rows.end]);
    json!({
        "name": occlusion.name.as_str(),
        "crossable": occlusion.crossable,
        "parts": parts.collect::<Vec<_>>(),
        "rectangles": rectangles.collect::<Vec<_>>(),
    })
}

impl Steering for External {
    type Error = ExternalError;

    fn task(&self) -> &Task {
        &self.task
    }

    fn np(&self) -> usize {
        self.np
    }

    fn begin(&mut self) -> Result<(), ExternalError> {
        (self.standing, self.begin_ns) = ([0.0; 6], None);
        self.times_us.clear();
        let line = json!({ "run": self.runs }).to_string();
        self.runs += 1;
        self.wait_until_ready(line)
    }

    fn answer(&mut self, inputs: &Inputs) -> Result<CycleRecord, ExternalError> {
        let begin_ns = *self.begin_ns.get_or_insert(inputs.now_ns);
        let since_begin = |at_ns: u64| (at_ns as f64 - begin_ns as f64) * 1e-9;
        let (exposed, points) = match &inputs.features {
            Input::Message(features) => {
                let points = features.pairs().enumerate();
                let points =
                    points.map(|(k, point)| (features.visible >> k & 1 > 0).then_some(point));
                let exposed = since_begin(features.stamp.data_ns);
                (Some(exposed), Some(points.collect::<Vec<_>>()))
            }
            _ => (None, None),
        };
        let time = since_begin(inputs.now_ns);
        let line = json!({ "time": time, "exposed": exposed, "points": points }).to_string();
        let answer = self.ask(&line)?;
        self.times_us.push(answer.us);
        let twist = serde_json::from_slice::<[f64; 6]>(&answer.line);
        let Some(twist) = twist.ok().filter(|_| !answer.has_more) else {
            return Err(self.refused(&answer, &line, "one line [vx, vy, vz, wx, wy, wz], finite"));
        };
        if let Some(error) = self.beyond(&twist) {
            return Err(error);
        }
        self.standing = twist;
        Ok(CycleRecord {
            twist,
            ..CycleRecord::default()
        })
    }
}

impl Drop for External {
    fn drop(&mut self) {
        // With the sender the thread ends, and with it the program's input.
        self.asked = channel().0;
        if testkit::within(ENDING, || self.child.try_wait().ok().flatten()).is_none() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
