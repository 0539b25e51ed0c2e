//! A program that steers the camera in place of our law. It speaks the lines that
//! `tests/rivals/visp.cpp` describes.

use std::fmt::Write as _;
use std::io::{self, BufRead, BufReader, Write as _};
use std::process::{Child, ChildStdin, ChildStdout, Stdio};

use decision::{Input, Inputs};
use messages::CycleRecord;
use scene::Scene;
use vpc::{Settings, SettingsError, Task};

use crate::steering::Steering;

/// A rival's process; killed when it is dropped.
#[derive(Debug)]
pub struct Rival {
    name: String,
    task: Task,
    np: usize,
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

/// Why a rival does not steer.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say it
pub enum RivalError {
    #[error("--rival: no program; expected: a program and its arguments")]
    Empty,
    #[error("{program}: cannot be started: {error}")]
    Start { program: String, error: io::Error },
    #[error("{name}: ended at the line `{line}`")]
    Ended { name: String, line: String },
    #[error("{name}: answers `{answer}` to the line `{line}`; expected: six finite numbers")]
    Answer {
        name: String,
        line: String,
        answer: String,
    },
    #[error(transparent)]
    Task(#[from] SettingsError),
}

impl Rival {
    /// Starts a program with its arguments, which are separated by spaces, for this scene, as it
    /// believes it to be; its limits of acceleration are those of our law.
    ///
    /// # Errors
    /// [`RivalError`]: it cannot be started, or the scene gives no task.
    pub fn start(words: &str, scene: &Scene, settings: &Settings) -> Result<Self, RivalError> {
        let mut task = Task::new(scene).map_err(SettingsError::from)?;
        task.acceleration = settings.acceleration(&scene.limits);
        let mut words = words.split_whitespace();
        let program = words.next().ok_or(RivalError::Empty)?;
        let file = program.rsplit('/').next().unwrap_or(program);
        let name = words
            .clone()
            .fold(file.to_owned(), |name, word| name + " " + word);
        let mut command = testkit::command(program);
        command
            .args(words)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        let started = command.spawn().and_then(|mut child| {
            let pipes = child.stdin.take().zip(child.stdout.take());
            let (input, output) = pipes.ok_or(io::ErrorKind::BrokenPipe)?;
            Ok((child, input, BufReader::new(output)))
        });
        let (child, input, output) = started.map_err(|error| RivalError::Start {
            program: program.to_owned(),
            error,
        })?;
        Ok(Self {
            name,
            task,
            np: settings.np,
            child,
            input,
            output,
        })
    }

    /// The program and its arguments, without its directory.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The line that begins a run.
    fn opening(&self) -> String {
        let camera = &self.task.camera;
        let mut line = "run".to_owned();
        add(&mut line, [camera.fx, camera.fy, camera.cx, camera.cy]);
        add(&mut line, [self.task.period]);
        add(&mut line, self.task.limits);
        add(&mut line, [self.task.pattern.len() as f64]);
        add(&mut line, self.task.pattern.iter().flatten().copied());
        add(&mut line, self.task.goal.iter().flatten().copied());
        line
    }

    fn ended(&self, line: &str) -> RivalError {
        RivalError::Ended {
            name: self.name.clone(),
            line: line.to_owned(),
        }
    }

    fn tell(&mut self, line: &str) -> Result<(), RivalError> {
        let told = writeln!(self.input, "{line}");
        told.map_err(|_| self.ended(line))
    }
}

/// Adds numbers to a line.
fn add(line: &mut String, numbers: impl IntoIterator<Item = f64>) {
    for number in numbers {
        let _ = write!(line, " {number}");
    }
}

/// Six finite numbers of a line.
fn twist(line: &str) -> Option<[f64; 6]> {
    let numbers: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
    let twist: [f64; 6] = numbers.ok()?.try_into().ok()?;
    twist.iter().all(|v| v.is_finite()).then_some(twist)
}

impl Steering for Rival {
    type Error = RivalError;

    fn task(&self) -> &Task {
        &self.task
    }

    fn np(&self) -> usize {
        self.np
    }

    fn begin(&mut self) -> Result<(), RivalError> {
        let line = self.opening();
        self.tell(&line)
    }

    fn answer(&mut self, inputs: &Inputs) -> Result<CycleRecord, RivalError> {
        let line = match &inputs.features {
            Input::Message(features) if features.all_visible() => {
                let mut line = "frame".to_owned();
                add(&mut line, [features.stamp.data_ns as f64 * 1e-9]);
                add(&mut line, features.pairs().flatten());
                line
            }
            Input::Message(_) => "hidden".to_owned(),
            _ => "none".to_owned(),
        };
        self.tell(&line)?;
        let mut answer = String::new();
        match self.output.read_line(&mut answer) {
            Ok(1..) => (),
            _ => return Err(self.ended(&line)),
        }
        let twist = twist(&answer).ok_or_else(|| RivalError::Answer {
            name: self.name.clone(),
            line,
            answer: answer.trim_end().to_owned(),
        })?;
        Ok(CycleRecord {
            twist,
            ..CycleRecord::default()
        })
    }
}

impl Drop for Rival {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated::Simulated;

    fn error(words: &str) -> String {
        let scene = Scene::parse(scene::PAPER_SIM, "sim").unwrap();
        let rival = Rival::start(words, &scene, &Settings::default());
        let answer = rival.and_then(|mut rival| {
            rival.begin()?;
            rival.answer(&Simulated::received(None, 0))
        });
        answer.unwrap_err().to_string()
    }

    #[test]
    fn a_program_that_does_not_steer_is_named_with_its_line() {
        assert!(error("/nowhere/visp --fast").starts_with("/nowhere/visp: cannot be started"));
        assert!(error(" ").contains("no program"));
        let ended = error("/bin/true");
        assert!(ended.starts_with("true: ended at the line `"), "{ended}");
        let answered = error("/bin/cat -u");
        assert!(
            answered.starts_with("cat -u: answers `run 800 800 512 512 "),
            "{answered}"
        );
        assert!(answered.ends_with("to the line `none`; expected: six finite numbers"));
    }

    #[test]
    fn an_answer_is_six_finite_numbers() {
        assert_eq!(
            twist("1 -2e-1 3 4 5 6\n"),
            Some([1.0, -0.2, 3.0, 4.0, 5.0, 6.0])
        );
        for line in [
            "",
            "1 2 3 4 5",
            "1 2 3 4 5 6 7",
            "1 2 3 4 5 nan",
            "1 2 3 4 5 x",
        ] {
            assert_eq!(twist(line), None, "{line}");
        }
    }
}
