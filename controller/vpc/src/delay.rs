//! Delay compensation: predicts the features at the instant at which the new command takes effect
//! from those of the exposure, along the commands sent in between.
//!
//! A camera delivers s(t_e) at t_e + d. In between, the sent commands moved it: v_i from t_i to
//! t_{i+1}. So the model predicts the present features from those of the exposure, piece by piece.
//! With [`Model::Pose`] this is the product of the rigid motions, exp(-(t_{i+1} - t_i) v_i) X,
//! which is exact; the other models integrate s' = L(s, Z) v_i.
//!
//! Source: paper, Eq. (model), with the sampling time replaced by the length of each piece.

use serde::{Deserialize, Serialize};

use crate::prediction::{InitialState, Model};
use crate::task::Task;
use crate::{DOF, Twist};

/// Time for which commands are remembered, ns: eight times the 100 to 130 ms of a real camera.
const MEMORY_NS: u64 = 1_100_000_000;
/// Most commands remembered: those of that time at 250 Hz.
const CAPACITY: usize = ROWS * ROW;
/// Commands of a row: serde takes no longer arrays.
const ROWS: usize = 5;
const ROW: usize = 32;

/// The sent commands with their times (one clock, ns). Its size is bounded: the oldest command is
/// dropped first. Plain data.
///
/// It never guesses. If an interval begins before the oldest known command, [`History::advance`]
/// returns [`Unpredictable::Unknown`] and the law refuses the features. Zero twists that are sent
/// meanwhile are remembered too, so that the interval is known again after one delay.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct History {
    /// Commands remembered, 0 to 160.
    pub count: u32,
    /// From when on each was in force, ns, the oldest first; the rest is zero.
    pub from_ns: [[u64; ROW]; ROWS],
    /// The commands, camera frame, m/s and rad/s; the rest is zero.
    pub twists: [[Twist; ROW]; ROWS],
    /// Whether the camera stood still before the oldest; otherwise nothing is known of then.
    pub from_rest: bool,
    /// How long a command is obeyed when none follows, ns; 2^64 - 1: for ever, in a simulated run.
    pub validity_ns: u64,
}

/// Why features cannot be advanced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unpredictable {
    /// The commands since the exposure are not all known.
    Unknown {
        /// How far back from the end of the interval they are, ns.
        known_ns: u64,
    },
    /// A point would have come behind the camera, or run away to where no image is.
    Lost,
}

impl Default for History {
    fn default() -> Self {
        Self::new()
    }
}

impl History {
    /// The history of a simulated run: the camera stood still before the first command, and obeys
    /// each until the next.
    pub const fn new() -> Self {
        Self {
            count: 0,
            from_ns: [[0; ROW]; ROWS],
            twists: [[[0.0; DOF]; ROW]; ROWS],
            from_rest: true,
            validity_ns: u64::MAX,
        }
    }

    /// The history of a robot in real time: each command is obeyed for `validity_ns` at most, and
    /// what moved the camera before the first one is unknown (a controller that was killed a moment
    /// ago, perhaps).
    pub const fn live(validity_ns: u64) -> Self {
        Self {
            from_rest: false,
            validity_ns,
            ..Self::new()
        }
    }

    /// Whether it is of a robot in real time.
    pub fn is_live(&self) -> bool {
        self.validity_ns != u64::MAX
    }

    /// Forgets all commands: those sent so far count as unknown.
    pub fn forget(&mut self) {
        *self = Self::live(self.validity_ns);
    }

    /// Remembers that `twist` was sent at `at_ns`; replaces one sent at the same instant. If the
    /// clock ran backwards, all earlier commands are forgotten.
    pub fn push(&mut self, twist: &Twist, at_ns: u64) {
        let last = self.entries().last().map(|(from_ns, _)| from_ns);
        if last.is_some_and(|last| last > at_ns) {
            self.forget();
        }
        // One that was followed by another so long ago is of no use.
        let since_ns = at_ns.saturating_sub(MEMORY_NS);
        let next = self.entries().skip(1);
        let mut old = next.take_while(|(from_ns, _)| *from_ns <= since_ns).count();
        let mut count = self.entries().len();
        if last == Some(at_ns) {
            count -= 1;
        } else if count == CAPACITY {
            old = old.max(1);
        }
        if old > 0 {
            let (times, twists) = (
                self.from_ns.as_flattened_mut(),
                self.twists.as_flattened_mut(),
            );
            times.copy_within(old.., 0);
            twists.copy_within(old.., 0);
            times
                .iter_mut()
                .rev()
                .take(old)
                .for_each(|from_ns| *from_ns = 0);
            twists
                .iter_mut()
                .rev()
                .take(old)
                .for_each(|twist| *twist = [0.0; DOF]);
            self.from_rest = false;
            count = count.saturating_sub(old);
        }
        let from_ns = self.from_ns.as_flattened_mut().iter_mut();
        let mut places = from_ns.zip(self.twists.as_flattened_mut());
        if let Some((from_ns, to)) = places.nth(count) {
            (*from_ns, *to) = (at_ns, *twist);
        }
        self.count = count as u32 + 1;
    }

    /// The newest command left later than was said of it, at `at_ns`.
    pub fn postpone(&mut self, at_ns: u64) {
        let newest = (self.count as usize).checked_sub(1);
        let from_ns = self.from_ns.as_flattened_mut();
        if let Some(from_ns) = newest.and_then(|newest| from_ns.get_mut(newest)) {
            *from_ns = at_ns.max(*from_ns);
        }
    }

    /// The commands with their times, the oldest first.
    fn entries(&self) -> impl DoubleEndedIterator<Item = (u64, &Twist)> + ExactSizeIterator {
        let times = self.from_ns.as_flattened().iter().copied();
        let entries = times.zip(self.twists.as_flattened());
        entries.take(self.count as usize)
    }

    /// The features of `initial`, exposed at `from_ns`, as they are at `to_ns`. Its work is
    /// bounded.
    ///
    /// # Errors
    /// [`Unpredictable`] if the commands are not known, or lead where no camera sees.
    pub fn advance(
        &self,
        task: &Task,
        model: Model,
        initial: &InitialState,
        from_ns: u64,
        to_ns: u64,
    ) -> Result<InitialState, Unpredictable> {
        let known_from_ns = match self.entries().next() {
            _ if self.from_rest => 0,
            Some((first_ns, _)) => first_ns,
            None => u64::MAX,
        };
        if from_ns < known_from_ns.min(to_ns) {
            let known_ns = to_ns.saturating_sub(known_from_ns);
            return Err(Unpredictable::Unknown { known_ns });
        }
        let mut initial = initial.clone();
        for (twist, length_ns) in self.pieces(from_ns, to_ns) {
            if length_ns == 0 || initial.relative(twist) == [0.0; DOF] {
                continue;
            }
            initial = initial
                .moved(task, model, twist, length_ns as f64 * 1e-9)
                .ok_or(Unpredictable::Lost)?;
        }
        Ok(initial)
    }

    /// The mean command in force between two instants; zero where none is known.
    pub fn mean(&self, from_ns: u64, to_ns: u64) -> Twist {
        let whole_ns = to_ns.saturating_sub(from_ns).max(1) as f64;
        let mut mean = [0.0; DOF];
        for (twist, length_ns) in self.pieces(from_ns, to_ns) {
            let share = length_ns as f64 / whole_ns;
            mean.iter_mut()
                .zip(twist)
                .for_each(|(sum, v)| *sum += share * v);
        }
        mean
    }

    /// The commands in force between two instants and for how long, ns, one after the other; zero
    /// before the first and where one was no longer obeyed.
    fn pieces(&self, from_ns: u64, to_ns: u64) -> impl Iterator<Item = (&Twist, u64)> {
        let begins = self.entries().map(|(sent_ns, _)| sent_ns);
        let ends = begins.chain(core::iter::once(u64::MAX));
        let still = [(0, &[0.0; DOF])].into_iter();
        still
            .chain(self.entries())
            .zip(ends)
            .flat_map(move |((sent_ns, twist), end_ns)| {
                let expiry_ns = sent_ns.saturating_add(self.validity_ns).min(end_ns);
                let inside = |ns: u64| ns.clamp(from_ns, to_ns.max(from_ns));
                let length_ns = |from_ns, to_ns| inside(to_ns) - inside(from_ns);
                let (obeyed, over) = (length_ns(sent_ns, expiry_ns), length_ns(expiry_ns, end_ns));
                [(twist, obeyed), (&[0.0; DOF], over)]
            })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::*;
    use crate::{Points, camera, motion};

    /// One period of the paper's camera, ns.
    const PERIOD: u64 = 33_333_333;

    fn task() -> Task {
        Task::new(&scene::Scene::parse(scene::PAPER_SIM, "sim").unwrap()).unwrap()
    }

    /// The truth, on its own: X' = -nu - omega x X for each point, by fine Runge-Kutta steps.
    struct Truth {
        points: Vec<Vector3<f64>>,
        now_ns: u64,
    }

    impl Truth {
        fn new(task: &Task) -> Self {
            let rotation: Matrix3<f64> = motion::rotation([0.3, -0.2, 0.8]);
            let place = Vector3::new(0.1, -0.2, 0.9);
            let at = |p: &[f64; 3]| rotation * Vector3::from(*p) + place;
            Self {
                points: task.pattern.iter().map(at).collect(),
                now_ns: 1_000_000_000,
            }
        }

        fn go(&mut self, v: &Twist, ns: u64) {
            let (nu, omega) = (
                Vector3::new(v[0], v[1], v[2]),
                Vector3::new(v[3], v[4], v[5]),
            );
            let rate = |x: &Vector3<f64>| -nu - omega.cross(x);
            let h = ns as f64 * 1e-9 / 50.0;
            for x in &mut self.points {
                for _ in 0..50 {
                    let k1 = rate(x);
                    let k2 = rate(&(*x + k1 * (h / 2.0)));
                    let k3 = rate(&(*x + k2 * (h / 2.0)));
                    let k4 = rate(&(*x + k3 * h));
                    *x += (k1 + (k2 + k3) * 2.0 + k4) * (h / 6.0);
                }
            }
            self.now_ns += ns;
        }

        fn features(&self, task: &Task) -> Points {
            let see = |x: &Vector3<f64>| camera::project(&task.camera, (*x).into()).unwrap();
            self.points.iter().map(see).collect()
        }
    }

    /// A twist that changes from period to period.
    fn twist(k: usize) -> Twist {
        core::array::from_fn(|i| 0.3 * libm::sin(1.0 + 2.0 * k as f64 + i as f64))
    }

    fn furthest(a: &Points, b: &Points) -> f64 {
        let pairs = a.iter().flatten().zip(b.iter().flatten());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    /// Advances features over changing twists; the largest error, and the largest motion, px.
    fn error_of(model: Model, periods: usize, mut history: History) -> (f64, f64) {
        let task = task();
        let mut truth = Truth::new(&task);
        // Half a period under way when the frame is exposed.
        history.push(&twist(0), truth.now_ns);
        truth.go(&twist(0), PERIOD / 2);
        let (seen, exposed_ns) = (truth.features(&task), truth.now_ns);
        truth.go(&twist(0), PERIOD / 2);
        for k in 1..periods {
            history.push(&twist(k), truth.now_ns);
            truth.go(&twist(k), PERIOD);
        }
        let initial = InitialState::new(&task, model, &seen);
        let now = history
            .advance(&task, model, &initial, exposed_ns, truth.now_ns)
            .unwrap();
        let expected = truth.features(&task);
        (furthest(&now.points, &expected), furthest(&seen, &expected))
    }

    #[test]
    fn the_pose_model_advances_delayed_features_to_the_true_ones() {
        for periods in [1, 2, 3, 5, 12] {
            let (error, moved) = error_of(Model::Pose, periods, History::new());
            assert!(error < 1e-9 && moved > 1.0, "{periods}: {error} of {moved}");
        }
    }

    #[test]
    fn the_depth_models_advance_to_their_accuracy() {
        // What they do not know, the depths, is most of the error; without them it would be
        // `moved`.
        for (model, share) in [(Model::AreaDepth, 0.25), (Model::TargetDepth, 0.6)] {
            let (error, moved) = error_of(model, 4, History::new());
            assert!(
                moved > 5.0 && error < share * moved,
                "{model:?}: {error} of {moved}"
            );
        }
    }

    #[test]
    fn depth_models_follow_a_turning_camera() {
        // From the goal, where all depths are right, under a pure rotation, which asks for none.
        let task = task();
        let spin = [0.0, 0.0, 0.0, 0.4, -0.3, 0.9];
        let mut history = History::new();
        history.push(&spin, 0);
        let mut truth = Truth::new(&task);
        let seen = truth.features(&task);
        truth.go(&spin, 4 * PERIOD);
        for model in [Model::AreaDepth, Model::TargetDepth] {
            let initial = InitialState::new(&task, model, &seen);
            let now = history
                .advance(&task, model, &initial, 0, 4 * PERIOD)
                .unwrap();
            assert!(
                furthest(&now.points, &truth.features(&task)) < 0.01,
                "{model:?}"
            );
        }
    }

    #[test]
    fn a_ring_that_wrapped_many_times_still_advances() {
        let mut history = History::new();
        for k in 0..1000 {
            history.push(&twist(k), 1000 + k as u64);
        }
        let (error, moved) = error_of(Model::Pose, 32, history);
        assert!(error < 1e-8 && moved > 1.0, "{error} of {moved}");
        // The oldest is as old as is remembered, or the last but 159.
        let (task, fast) = (task(), 4_000_000);
        let initial = InitialState::new(&task, Model::Pose, &Truth::new(&task).features(&task));
        for (period, commands) in [(PERIOD, 1 + 34), (fast, CAPACITY as u64)] {
            let mut history = History::new();
            let last = 3 * CAPACITY as u64;
            (0..=last).for_each(|k| history.push(&[0.01; 6], k * period));
            let oldest = last - commands + 1;
            let advance = |from| history.advance(&task, Model::Pose, &initial, from, last * period);
            assert!(advance(oldest * period).is_ok());
            let known_ns = (last - oldest) * period;
            let refused = advance(oldest * period - 1).err();
            assert_eq!(refused, Some(Unpredictable::Unknown { known_ns }));
        }
    }

    #[test]
    fn before_the_first_command_only_a_simulated_camera_stands() {
        let task = task();
        let initial = InitialState::new(&task, Model::Pose, &Truth::new(&task).features(&task));
        let advance = |history: &History, from| {
            history
                .advance(&task, Model::Pose, &initial, from, 500)
                .map(|now| now.points)
        };
        let (mut simulated, mut live) = (History::new(), History::live(1000));
        assert_eq!(advance(&simulated, 1).as_ref(), Ok(&initial.points));
        let nothing = Err(Unpredictable::Unknown { known_ns: 0 });
        assert_eq!(advance(&live, 1), nothing);
        // No time has passed: nothing need be known.
        assert_eq!(advance(&live, 500).as_ref(), Ok(&initial.points));
        simulated.push(&twist(1), 300);
        live.push(&twist(1), 300);
        assert!(advance(&simulated, 1).is_ok());
        assert_eq!(
            advance(&live, 299),
            Err(Unpredictable::Unknown { known_ns: 200 })
        );
        assert_eq!(advance(&live, 300), advance(&simulated, 1));
    }

    #[test]
    fn a_command_that_expired_no_longer_moves_a_live_camera() {
        let task = task();
        let mut truth = Truth::new(&task);
        let seen = truth.features(&task);
        let mut history = History::live(2 * PERIOD);
        history.push(&twist(1), 0);
        truth.go(&twist(1), 2 * PERIOD);
        let initial = InitialState::new(&task, Model::Pose, &seen);
        let now = history
            .advance(&task, Model::Pose, &initial, 0, 9 * PERIOD)
            .unwrap();
        assert!(furthest(&now.points, &truth.features(&task)) < 1e-9);
    }

    #[test]
    fn a_clock_that_runs_backwards_clears_the_past() {
        let task = task();
        let initial = InitialState::new(&task, Model::Pose, &Truth::new(&task).features(&task));
        let mut history = History::new();
        history.push(&twist(1), 1000);
        history.push(&twist(2), 400);
        let advance = |from| history.advance(&task, Model::Pose, &initial, from, 1000);
        assert_eq!(
            advance(399).err(),
            Some(Unpredictable::Unknown { known_ns: 600 })
        );
        assert!(advance(400).is_ok());
    }

    #[test]
    fn a_command_sent_again_at_the_same_instant_replaces_the_first() {
        let task = task();
        let initial = InitialState::new(&task, Model::Pose, &Truth::new(&task).features(&task));
        let (mut once, mut twice) = (History::new(), History::new());
        once.push(&twist(2), 100);
        twice.push(&twist(1), 100);
        twice.push(&twist(2), 100);
        let advance = |history: &History| {
            history
                .advance(&task, Model::Pose, &initial, 0, PERIOD)
                .unwrap()
                .points
        };
        assert_eq!(advance(&once), advance(&twice));
    }

    #[test]
    fn motion_through_the_pattern_is_refused() {
        let task = task();
        for model in [Model::Pose, Model::TargetDepth] {
            let initial = InitialState::new(&task, model, &task.goal);
            let mut history = History::new();
            history.push(&[0.0, 0.0, 50.0, 0.0, 0.0, 0.0], 0);
            let refused = history
                .advance(&task, model, &initial, 0, 60 * PERIOD)
                .err();
            assert_eq!(refused, Some(Unpredictable::Lost), "{model:?}");
        }
    }
}
