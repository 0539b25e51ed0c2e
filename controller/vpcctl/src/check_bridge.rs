//! `check-bridge`: plays `vpcd` to the program that carries out twists, and judges what it reports.
//!
//! The camera moves along its x axis, out and back. What counts is the twist that the bridge tells
//! on `vpc/robot`, with the time at which it told it.

use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

use clap::Args;
use ipc::{Domain, Publisher, Subscriber};
use messages::{MOST_OBEYED_NS, RobotState, TwistCommand, TwistState};
use program::Exit;
use scene::Scene;

use crate::clock::Clock;
use crate::failure::Failure;
use crate::presence::Presence;
use crate::units::{number, seconds};

/// Between two commands, ns.
const PERIOD_NS: u64 = 33_333_333;
/// Between two looks at what came, ns.
const LOOK_NS: u64 = 2_000_000;
/// Longest silence of a bridge, and greatest age of what it tells, ns.
const FRESH_NS: u64 = 100_000_000;
/// Share of the limit below which the camera stands.
const REST: f64 = 0.01;
/// Factor on the limits that a bridge must cut off, and the share of them by which it may miss.
const BEYOND: f64 = 1.5;
const ROUNDING: f64 = 0.02;

const SECOND: u64 = 1_000_000_000;

/// The command line of `check-bridge`.
#[derive(Clone, Debug, Args)]
pub struct CheckBridgeArguments {
    /// The scene, for its limits.
    #[arg(long, value_name = "FILE")]
    pub scene: std::path::PathBuf,

    /// Speed of the motions, as a share of the limit of vx.
    #[arg(long, value_name = "SHARE", default_value = "0.1", value_parser = share)]
    pub speed: f64,

    /// How long the robot may take from the end of a command to standstill, 0.05 to 3600 s.
    #[arg(long, value_name = "SECONDS", default_value = "0.3", value_parser = seconds)]
    pub stopping: Duration,
}

fn share(text: &str) -> Result<f64, String> {
    number(text, 0.05..=1.0, "")
}

/// Checks the bridge of this domain: the report, and whether it kept all rules.
///
/// # Errors
/// A `vpcd` is at work, the scene cannot be read, or the ports cannot be used.
pub fn check(
    directory: &Path,
    with: &CheckBridgeArguments,
    clock: &mut dyn Clock,
) -> Result<(String, Exit), Failure> {
    if let Some(process) = Presence::of(directory).process() {
        let domain = directory.display();
        let message = format!("domain {domain}: vpcd, process {process}, is at work; end it first");
        return Err(Failure::new(Exit::Unavailable, message));
    }
    let scene = Scene::read(&with.scene)?;
    let domain = Domain::join(directory)?;
    let mut play = Play {
        clock,
        twists: domain.publisher()?,
        states: domain.subscriber(64)?,
        limits: scene.limits.velocity(),
        stopping_ns: with.stopping.as_nanos() as u64,
        sequence: 0,
    };
    let speed = with.speed * play.limits[0];
    let (mut text, mut exit) = (String::new(), Exit::Ok);
    let mut tell = |name: &str, verdict: Result<String, String>| {
        let (mark, words) = match verdict {
            Ok(words) => ("ok  ", words),
            Err(words) => {
                exit = Exit::Attention;
                ("FAIL", words)
            }
        };
        let _ = writeln!(text, "{mark}  {name:<10}{words}");
    };
    let told = play.tells()?;
    let is_heard = told.is_ok();
    tell("state", told);
    if is_heard {
        let checks: [(&str, Check); 8] = [
            ("motion", &|play| play.moves(speed)),
            ("back", &|play| play.moves(-speed)),
            ("silence", &|play| play.stops(speed, Claim::Usual)),
            ("long", &|play| play.stops(-speed, Claim::Long)),
            ("expired", &|play| play.ignored(speed, Claim::Expired)),
            ("lockstep", &|play| play.ignored(speed, Claim::Lockstep)),
            ("future", &|play| play.ignored(speed, Claim::Future)),
            ("limits", &|play| play.cuts()),
        ];
        for (name, check) in checks {
            tell(name, check(&mut play)?);
        }
    }
    Ok((text, exit))
}

/// What is told of a check, or the failure of the shared memory.
type Judged = Result<Result<String, String>, Failure>;

type Check<'a> = &'a dyn Fn(&mut Play<'_>) -> Judged;

/// What a command says about its validity.
#[derive(Clone, Copy, PartialEq)]
enum Claim {
    /// As `vpcd` says it: for three periods.
    Usual,
    /// For ten seconds.
    Long,
    /// It ended just now.
    Expired,
    /// For ever.
    Lockstep,
    /// From now on, and it was published in a second.
    Future,
}

/// What was told at an instant.
#[derive(Clone, Copy)]
struct Told {
    at_ns: u64,
    twist: [f64; 6],
}

/// The part of `vpcd`.
struct Play<'a> {
    clock: &'a mut dyn Clock,
    twists: Publisher<TwistCommand>,
    states: Subscriber<RobotState>,
    limits: [f64; 6],
    stopping_ns: u64,
    sequence: u64,
}

impl Play<'_> {
    /// Whether the bridge tells its state, freshly and at rest.
    fn tells(&mut self) -> Judged {
        let told = self.listen(SECOND, |_| Ok(()))?;
        let Some(last) = told.last() else {
            return Ok(Err("nothing on vpc/robot within a second".to_owned()));
        };
        let longest = told
            .windows(2)
            .map(|pair| pair[1].at_ns - pair[0].at_ns)
            .max();
        let longest = longest.unwrap_or(SECOND);
        if longest > FRESH_NS || self.clock.now_ns() - last.at_ns > FRESH_NS {
            let ms = longest / 1_000_000;
            return Ok(Err(format!(
                "vpc/robot is silent for {ms} ms; allowed: 100 ms"
            )));
        }
        Ok(match self.moving(&told) {
            Some(v) => Err(format!("it moves without a command: {}", words(&v))),
            None => Ok(format!("{} states in a second, at rest", told.len())),
        })
    }

    /// Whether a legal command is carried out, and zero after it.
    fn moves(&mut self, speed: f64) -> Judged {
        let told = self.listen(SECOND, |play| play.command(speed, Claim::Usual))?;
        let reached = told.iter().find(|told| told.twist[0] / speed > 0.5);
        let begin_ns = told.first().map_or(0, |told| told.at_ns);
        let verdict = match reached {
            None => Err(format!(
                "{speed:.3} m/s were not carried out within a second"
            )),
            Some(told) => {
                let ms = (told.at_ns - begin_ns) / 1_000_000;
                Ok(format!("half of {speed:.3} m/s after {ms} ms"))
            }
        };
        self.rest()?;
        Ok(verdict)
    }

    /// Whether the camera stands 100 ms, and the time for stopping, after the last command.
    fn stops(&mut self, speed: f64, claim: Claim) -> Judged {
        self.listen(SECOND / 2, |play| play.command(speed, claim))?;
        let last_ns = self.clock.now_ns();
        let told = self.listen(SECOND, |_| Ok(()))?;
        let until_ns = last_ns + MOST_OBEYED_NS + self.stopping_ns;
        let moving = told.iter().filter(|told| self.is_moving(&told.twist));
        let end_ns = moving.map(|told| told.at_ns).max().unwrap_or(last_ns);
        let ms = end_ns.saturating_sub(last_ns) / 1_000_000;
        let verdict = match end_ns <= until_ns {
            true => Ok(format!("stands {ms} ms after the last command")),
            false => Err(format!(
                "it moves for {ms} ms after the last command; allowed: {} ms",
                (until_ns - last_ns) / 1_000_000
            )),
        };
        self.rest()?;
        Ok(verdict)
    }

    /// Whether commands that are not in force move nothing.
    fn ignored(&mut self, speed: f64, claim: Claim) -> Judged {
        let told = self.listen(SECOND / 2, |play| play.command(speed, claim))?;
        let moving = self.moving(&told);
        self.rest()?;
        Ok(match moving {
            Some(v) => Err(format!("it is carried out: {}", words(&v))),
            None => Ok("is not carried out".to_owned()),
        })
    }

    /// Whether commands beyond the limits are cut, a tenth of a second long each way.
    fn cuts(&mut self) -> Judged {
        let most = self.limits[0];
        let mut fastest = 0.0_f64;
        for sign in [1.0, -1.0] {
            let speed = sign * BEYOND * most;
            let mut told = self.listen(SECOND / 10, |play| play.command(speed, Claim::Usual))?;
            told.extend(self.rest()?);
            fastest = told
                .iter()
                .map(|told| told.twist[0].abs())
                .fold(fastest, f64::max);
        }
        Ok(match fastest <= most * (1.0 + ROUNDING) {
            true => Ok(format!("{fastest:.3} m/s at most, limit {most:.3}")),
            false => Err(format!(
                "{fastest:.3} m/s are carried out; allowed: {most:.3}"
            )),
        })
    }

    /// Sends zero until the camera had time to stop; what was told meanwhile.
    fn rest(&mut self) -> Result<Vec<Told>, Failure> {
        let time = self.stopping_ns + SECOND / 5;
        self.listen(time, |play| play.command(0.0, Claim::Usual))
    }

    /// Acts once a period for so long, and returns what was told meanwhile.
    fn listen(
        &mut self,
        time_ns: u64,
        act: impl Fn(&mut Self) -> Result<(), Failure>,
    ) -> Result<Vec<Told>, Failure> {
        let end_ns = self.clock.now_ns() + time_ns;
        let mut next_ns = self.clock.now_ns();
        let mut all = Vec::new();
        // Nothing from before.
        while self.states.oldest()?.is_some() {}
        while self.clock.now_ns() < end_ns {
            if self.clock.now_ns() >= next_ns {
                act(self)?;
                next_ns += PERIOD_NS;
            }
            while let Some(state) = self.states.oldest()? {
                let RobotState { stamp, twist, .. } = state.message;
                let at_ns = stamp.published_ns;
                all.push(Told { at_ns, twist });
            }
            self.clock.pause(Duration::from_nanos(LOOK_NS));
        }
        Ok(all)
    }

    /// Sends a command along the camera's x axis.
    fn command(&mut self, speed: f64, claim: Claim) -> Result<(), Failure> {
        let now = self.clock.now_ns();
        let mut command = TwistCommand::zero(TwistState::Moving).valid_until(now + 3 * PERIOD_NS);
        command.twist[0] = speed;
        self.sequence += 1;
        (command.stamp.sequence, command.stamp.published_ns) = (self.sequence, now);
        match claim {
            Claim::Usual => (),
            Claim::Long => command.valid_until_ns = now + 10 * SECOND,
            Claim::Expired => command.valid_until_ns = now,
            Claim::Lockstep => command.valid_until_ns = u64::MAX,
            Claim::Future => {
                command.stamp.published_ns = now + SECOND;
                command.valid_until_ns = now + SECOND + 3 * PERIOD_NS;
            }
        }
        self.twists.publish_verbatim(&command)?;
        Ok(())
    }

    /// The first twist of these that is a motion.
    fn moving(&self, told: &[Told]) -> Option<[f64; 6]> {
        let twists = told.iter().map(|told| told.twist);
        twists.into_iter().find(|twist| self.is_moving(twist))
    }

    fn is_moving(&self, twist: &[f64; 6]) -> bool {
        let mut each = twist.iter().zip(self.limits);
        each.any(|(v, limit)| v.abs() > REST * limit)
    }
}

/// A twist in words.
fn words(twist: &[f64; 6]) -> String {
    let [vx, vy, vz, wx, wy, wz] = twist;
    format!("{vx:.3} {vy:.3} {vz:.3} m/s, {wx:.3} {wy:.3} {wz:.3} rad/s")
}
