//! Version 10, the FR3's. Source: the same headers as libfranka 0.21 has them, as the crate
//! `franka-rs` 0.4 and the simulator `franka-sim` 1.1.7 repeat them.

use super::{Table, Width, row};
use crate::message::Answer::{self, *};
use crate::message::Kind;

const SETTER: &[Answer] = &[
    Success,
    NotPossibleRejected,
    InvalidArgumentRejected,
    RejectedDueToActivatedSafetyFunctions,
];

pub(super) static TABLE: Table = Table {
    version: 10,
    width: Width::F32,
    accelerometers: 36,
    command: 371,
    requests: &[
        row(Kind::Connect, 4, &[Success, IncompatibleLibraryVersion]),
        row(
            Kind::Move,
            113,
            &[
                Success,
                MotionStarted,
                Preempted,
                PreemptedDueToActivatedSafetyFunctions,
                RejectedDueToActivatedSafetyFunctions,
                NotPossibleRejected,
                StartAtSingularPoseRejected,
                InvalidArgumentRejected,
                ReflexAborted,
                EmergencyAborted,
                InputErrorAborted,
                Aborted,
            ],
        ),
        row(
            Kind::StopMove,
            0,
            &[
                Success,
                NotPossibleRejected,
                RejectedDueToActivatedSafetyFunctions,
                EmergencyAborted,
                ReflexAborted,
                Aborted,
            ],
        ),
        row(Kind::SetCollisionBehavior, 416, SETTER),
        row(Kind::SetJointImpedance, 56, SETTER),
        row(Kind::SetCartesianImpedance, 48, SETTER),
        row(Kind::SetGuidingMode, 7, SETTER),
        row(Kind::SetEeToK, 128, SETTER),
        row(Kind::SetNeToEe, 128, SETTER),
        row(Kind::SetLoad, 104, SETTER),
        row(
            Kind::AutomaticErrorRecovery,
            0,
            &[
                Success,
                NotPossibleRejected,
                RejectedDueToActivatedSafetyFunctions,
                ManualErrorRecoveryRequiredRejected,
                ReflexAborted,
                EmergencyAborted,
                Aborted,
            ],
        ),
        row(
            Kind::GetRobotModel,
            0,
            &[
                Success,
                NotPossibleRejected,
                RejectedDueToActivatedSafetyFunctions,
            ],
        ),
    ],
};
