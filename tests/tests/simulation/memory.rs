//! A memory of motion that answers out of range: the neighbour's answer is followed instead.

use decision::{ControlStep, Input, Inputs, Rules, Safety};
use hw_sim::FreeCamera;
use memory_blob::MemoryFile;
use messages::{
    Action, ClockMode, CycleRecord, Features, Outcome, RecallCode, Request, TwistState,
};
use vpc::{Settings, Strategy};

use crate::plan::Place;

/// One sampling period of the paper's scene, ns.
const PERIOD_NS: u64 = 33_333_333;

#[test]
fn an_answer_out_of_range_falls_back_to_the_neighbour() {
    // Right in its form, digests and probes, and far from any trajectory: weights a thousand times
    // too large.
    let shipped = testkit::memory_file();
    let mut contents = MemoryFile::open(&shipped, None).unwrap().contents();
    let process = contents.regression.as_mut().unwrap();
    let weights = process.lambda.iter_mut().flatten();
    weights.for_each(|weight| *weight *= 1e3);
    let directory = tempfile::tempdir().unwrap();
    let wrong = directory.path().join("wrong.vpcmem");
    contents.write(&wrong).unwrap();
    let wrong = MemoryFile::open(&wrong, None).unwrap();

    let scene = crate::STOCK.scene(Place::Paper);
    // Asked in every cycle, near occlusions or not.
    let settings = Settings {
        strategy: Strategy::Gpr,
        trigger_px: 1e4,
        ..Settings::daemon()
    };
    let safety = Safety {
        needs_robot: false,
        ..Safety::default()
    };
    let rules = Rules::new(scene, &settings, &safety, ClockMode::Fixed);
    let mut control = ControlStep::new(scene, settings, Some(wrong.view()), rules).unwrap();
    let mut eye = FreeCamera::new(scene, &crate::STOCK.starts()[0]);
    let mut now_ns = 1 << 40;
    let mut replaced = 0;
    for cycle in 1..60 {
        now_ns += PERIOD_NS;
        let mut features = Features::new(&eye.features().unwrap(), now_ns);
        (features.stamp.sequence, features.stamp.published_ns) = (cycle, now_ns);
        let inputs = Inputs {
            now_ns,
            features: Input::Message(features),
            robot: Input::Nothing,
            desired: Input::Nothing,
            missed: 0,
            suspended: false,
            shutdown: false,
        };
        if cycle == 5 {
            let reply = control.request(&Request::new(1, Action::Arm), cycle);
            assert_eq!(reply.outcome(), Some(Outcome::Done));
        }
        let mut record = CycleRecord::default();
        let decision = control.decide(&inputs, &mut record).decision;
        control.sent_at(now_ns);
        eye.advance(&decision.twist, PERIOD_NS as f64 * 1e-9);
        let other = [RecallCode::Followed.code(), RecallCode::Refused.code()];
        assert!(!other.contains(&record.recalled), "{record:?}");
        replaced += u32::from(record.recalled == RecallCode::Replaced.code());
        let is_armed = decision.state != TwistState::Disarmed;
        assert_eq!(is_armed, cycle >= 5, "{decision:?}");
    }
    assert!(replaced > 50, "{replaced}");
}
