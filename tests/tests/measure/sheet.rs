//! What a measurement fills in, and the finding that this makes.

use std::any::Any;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};

use serde::Serialize;

use crate::Measurement;
use crate::judge::{Miss, NotShown};
use crate::reference::{Class, Lateness, Reference};

/// A result.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "outcome", content = "reason", rename_all = "kebab-case")]
pub enum Outcome {
    /// Every bar was kept.
    Kept,
    /// A bar was missed, and the machine is not to blame.
    Broken(String),
    /// The machine was late, or lacks something.
    NotShown(String),
}

impl Outcome {
    /// Whether it is broken.
    pub fn is_broken(&self) -> bool {
        matches!(self, Self::Broken(_))
    }

    /// The word for it.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Kept => "kept",
            Self::Broken(_) => "broken",
            Self::NotShown(_) => "not shown",
        }
    }

    /// Why, where it was not kept.
    pub fn reason(&self) -> &str {
        match self {
            Self::Kept => "",
            Self::Broken(reason) | Self::NotShown(reason) => reason,
        }
    }
}

/// A number that was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    pub name: String,
    pub value: f64,
    pub unit: &'static str,
    /// What it must not exceed.
    pub bar: Option<f64>,
}

/// What came out of a measurement.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    pub name: &'static str,
    pub promise: &'static str,
    #[serde(flatten)]
    pub outcome: Outcome,
    pub figures: Vec<Figure>,
    /// How long it took, s.
    pub seconds: f64,
}

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            name, value, unit, ..
        } = self;
        let digits = if value.fract() == 0.0 { 0 } else { 2 };
        let unit = if unit.is_empty() {
            ""
        } else {
            &format!(" {unit}")
        };
        write!(f, "{name} {value:.digits$}{unit}")?;
        match self.bar {
            Some(bar) => write!(f, " (bar {bar})"),
            None => Ok(()),
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let figures: Vec<_> = self.figures.iter().map(Figure::to_string).collect();
        write!(f, "{}: {}", self.name, self.outcome.word().to_uppercase())?;
        if self.outcome != Outcome::Kept {
            write!(f, ": {}", self.outcome.reason())?;
        }
        write!(f, "; {} [{:.0} s]", figures.join(", "), self.seconds)
    }
}

/// A measurement at work: its figures, and how each of its rounds ended.
#[derive(Debug, Default)]
pub struct Sheet {
    /// Whether it runs at full length.
    pub is_long: bool,
    figures: Vec<Figure>,
    /// Rounds that kept their bars, and checks of what no machine can cause.
    kept: usize,
    checked: usize,
    /// Whether its rounds repeat one thing.
    is_repeated: bool,
    disturbed: Vec<String>,
    broken: Vec<String>,
    lacks: Vec<String>,
}

impl Sheet {
    /// Runs a measurement.
    pub fn fill(measurement: &Measurement, is_long: bool) -> Finding {
        let begin = std::time::Instant::now();
        let stalled_us = pressure_us();
        let mut sheet = Self {
            is_long,
            ..Self::default()
        };
        let run = AssertUnwindSafe(|| (measurement.run)(&mut sheet));
        if let Err(panic) = catch_unwind(run) {
            sheet.broken.push(words(&*panic));
        }
        let seconds = begin.elapsed().as_secs_f64();
        if let Some(us) = pressure_us().zip(stalled_us).map(|(now, then)| now - then) {
            let share = 100.0 * us as f64 / 1e6 / seconds;
            sheet.figure("cpu pressure", share, "%");
        }
        if sheet.is_repeated && !sheet.disturbed.is_empty() {
            let [kept, disturbed] = [sheet.kept, sheet.disturbed.len()];
            sheet.figure("rounds", (kept + disturbed) as f64, "");
            sheet.figure("disturbed", disturbed as f64, "");
        }
        Finding {
            name: measurement.name,
            promise: measurement.promise,
            outcome: sheet.outcome(),
            figures: sheet.figures,
            seconds,
        }
    }

    /// One round, measured once, beside references of these classes. `None` where it was disturbed
    /// or is broken.
    pub fn round<T>(
        &mut self,
        classes: &[Class],
        what: &str,
        round: impl FnOnce() -> anyhow::Result<T>,
    ) -> Option<T> {
        let done = self.round_beside(classes, what, round);
        done.map(|(value, _)| value)
    }

    /// The same, with how late the references were.
    pub fn round_beside<T>(
        &mut self,
        classes: &[Class],
        what: &str,
        round: impl FnOnce() -> anyhow::Result<T>,
    ) -> Option<(T, Lateness)> {
        let reference = Reference::start(classes);
        let done = catch_unwind(AssertUnwindSafe(round));
        let seen = reference.end();
        let error = match done {
            Ok(Ok(value)) => {
                self.kept += 1;
                return Some((value, seen));
            }
            Ok(Err(error)) => error,
            Err(panic) => match panic.downcast::<anyhow::Error>() {
                Ok(error) => *error,
                Err(panic) => anyhow::Error::msg(words(&*panic)),
            },
        };
        let (is_disturbed, said) = match error.downcast_ref::<Miss>() {
            Some(miss) => {
                let late = miss.late_ns(&seen) as f64 / 1e6;
                let said = format!("{miss}; the reference was {late:.1} ms late");
                (miss.is_the_machines(&seen), said)
            }
            None => (error.is::<NotShown>(), format!("{error:#}")),
        };
        let said = format!("{what}: {said}");
        match is_disturbed {
            true => self.disturbed.push(said),
            false => self.broken.push(said),
        }
        None
    }

    /// The number of rounds that repeat one thing, or of cycles: `long` at full length.
    pub fn repeats(&mut self, short: usize, long: usize) -> usize {
        self.is_repeated = true;
        if self.is_long { long } else { short }
    }

    /// A number that nothing is asked of.
    pub fn figure(&mut self, name: &str, value: f64, unit: &'static str) {
        self.put(name, value, unit, None);
    }

    /// A number beside its bar; who notes it has judged it.
    pub fn bar(&mut self, name: &str, value: f64, unit: &'static str, bar: f64) {
        self.put(name, value, unit, Some(bar));
    }

    /// Notes the longest duration of this name, ns, beside its bar, as ms.
    pub fn longest(&mut self, name: &str, ns: u64, bar_ns: u64) {
        let so_far = self.figures.iter().find(|figure| figure.name == name);
        let ms = (ns as f64 / 1e6).max(so_far.map_or(0.0, |figure| figure.value));
        self.put(name, ms, "ms", Some(bar_ns as f64 / 1e6));
    }

    fn put(&mut self, name: &str, value: f64, unit: &'static str, bar: Option<f64>) {
        let figure = Figure {
            name: name.to_owned(),
            value,
            unit,
            bar,
        };
        match self.figures.iter_mut().find(|found| found.name == name) {
            Some(found) => *found = figure,
            None => self.figures.push(figure),
        }
    }

    /// Something that no machine can cause: broken if it is not so.
    pub fn check(&mut self, is_so: bool, otherwise: impl FnOnce() -> String) {
        match is_so {
            true => self.checked += 1,
            false => self.broken.push(otherwise()),
        }
    }

    /// What the machine lacks for a part of it, or for all.
    pub fn lacks(&mut self, what: impl Into<String>) {
        self.lacks.push(what.into());
    }

    /// Whether these programs are installed, each `program` or `program=package`; notes those that
    /// are not.
    pub fn has(&mut self, programs: &[&str]) -> bool {
        let lacks: Vec<_> = programs
            .iter()
            .map(|program| program.split_once('=').unwrap_or((program, program)))
            .filter(|(program, _)| !is_installed(program))
            .map(|(program, package)| format!("{program} (apt-get install {package})"))
            .collect();
        if !lacks.is_empty() {
            self.lacks(format!("not installed: {}", lacks.join(", ")));
        }
        lacks.is_empty()
    }

    /// Whether this process is root; notes that it is not.
    pub fn is_root(&mut self) -> bool {
        let is_root = rustix::process::geteuid().is_root();
        if !is_root {
            self.lacks("needs root");
        }
        is_root
    }

    /// Kept where nothing is broken or lacking, and the machine disturbed no round; of rounds that
    /// repeat one thing, fewer than it let pass.
    fn outcome(&self) -> Outcome {
        if !self.broken.is_empty() {
            return Outcome::Broken(self.broken.join("; "));
        }
        if !self.lacks.is_empty() {
            return Outcome::NotShown(self.lacks.join("; "));
        }
        let most = match self.is_repeated {
            true => self.kept.saturating_sub(1),
            false => 0,
        };
        match self.disturbed.as_slice() {
            [] if self.kept + self.checked == 0 => {
                Outcome::NotShown("nothing was measured".to_owned())
            }
            [first, ..] if self.disturbed.len() > most => {
                let [disturbed, all] = [self.disturbed.len(), self.disturbed.len() + self.kept];
                Outcome::NotShown(format!("{disturbed} of {all} rounds disturbed: {first}"))
            }
            _ => Outcome::Kept,
        }
    }
}

fn is_installed(program: &str) -> bool {
    let mut shell = testkit::command("sh");
    shell.args([
        "-c",
        "PATH=$PATH:/usr/sbin:/sbin command -v \"$0\" >/dev/null",
        program,
    ]);
    shell.status().is_ok_and(|status| status.success())
}

/// What a panic said.
fn words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
    let error = || {
        panic
            .downcast_ref::<anyhow::Error>()
            .map(ToString::to_string)
    };
    text.map(str::to_owned)
        .or_else(error)
        .unwrap_or_else(|| "a panic without words".to_owned())
}

/// Time in which somebody waited for a processor, us since the boot; `None` where the kernel does
/// not tell.
fn pressure_us() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/pressure/cpu").ok()?;
    let some = text.lines().find(|line| line.starts_with("some"))?;
    some.split_once("total=")?.1.trim().parse().ok()
}
