//! The motion is the integral of the commands, however long it takes.

use arm::{Shaper, ShaperSettings};
use nalgebra::Vector3;
use panda::kinematics::difference;
use panda::limits::PERIOD;
use panda::{Mode, Twist};

use crate::rig::{answer, echo, moving, ready};

/// Milliseconds a side of the square, and a pause at its end in which the robot comes to rest.
const SIDE: u64 = 3900;
const PAUSE: u64 = 100;

/// Four sides in a plane that lies askew, each with a turn, the last two the first two backwards.
fn side(number: u64) -> Twist {
    let sign = if number % 4 < 2 { 1.0 } else { -1.0 };
    let twist = if number.is_multiple_of(2) {
        Twist::new(0.01, 0.0, 0.004, 0.0, 0.0, 0.03)
    } else {
        Twist::new(0.0, 0.01, 0.004, 0.0, 0.0, -0.02)
    };
    twist * sign
}

/// A sum that loses nothing over millions of terms (Kahan).
#[derive(Default)]
struct Sum {
    total: Vector3<f64>,
    lost: Vector3<f64>,
}

impl Sum {
    fn add(&mut self, term: Vector3<f64>) {
        let corrected = term - self.lost;
        let next = self.total + corrected;
        self.lost = (next - self.total) - corrected;
        self.total = next;
    }
}

/// Goes round the square and compares at the end of each side; lengths in m, angles in rad.
fn go_round(laps: u64) {
    let mut robot = moving(ready());
    let mut shaper = Shaper::new(ShaperSettings::default()).expect("good settings");
    let start = *robot.state();
    let mut travelled = Sum::default();
    let mut lap_end = start;
    for number in 0..4 * laps {
        for tick in 0..SIDE + PAUSE {
            let target = if tick < SIDE {
                side(number)
            } else {
                Twist::zeros()
            };
            shaper.aim(&target, u64::MAX);
            let twist = shaper.step(&echo(robot.state()), 0);
            let state = answer(&mut robot, twist);
            travelled.add(twist.fixed_rows::<3>(0) * PERIOD);
            assert_eq!(state.robot_mode, Mode::Move, "{}", state.current_errors);
        }
        let state = *robot.state();
        let expected = start.o_t_ee.translation.vector + travelled.total;
        let error = (state.o_t_ee_d.translation.vector - expected).norm();
        assert!(error < 1e-8, "side {number}: {error:e} m from the integral");
        assert!((state.o_t_ee.translation.vector - expected).norm() < 1e-6);
        if number % 4 == 3 {
            let open = difference(&state.o_t_ee_d, &start.o_t_ee).norm();
            assert!(open < 1e-8, "side {number}: the square is open by {open:e}");
            if number == 3 {
                lap_end = state;
            }
            // The elbow, too, comes back to the same place in every lap.
            let wandered = (state.q_d - lap_end.q_d).norm();
            assert!(
                wandered < 1e-3,
                "side {number}: joints wandered {wandered:e}"
            );
        }
    }
    let end = *robot.state();
    println!(
        "{} s: square open by {:.1e}, joints wandered {:.1e} rad, elbow {:.1e} rad from its reference",
        4 * laps * (SIDE + PAUSE) / 1000,
        difference(&end.o_t_ee_d, &start.o_t_ee).norm(),
        (end.q_d - lap_end.q_d).norm(),
        (end.q_d[2] - start.q_d[2]).abs(),
    );
}

#[test]
fn the_desired_pose_is_the_integral_of_commands() {
    go_round(3);
}

#[test]
#[ignore = "an hour of simulated time: see the README"]
fn the_desired_pose_is_the_integral_of_commands_for_an_hour() {
    go_round(225);
}
