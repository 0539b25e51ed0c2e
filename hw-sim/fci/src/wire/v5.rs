//! Version 5, the Panda's. Source: libfranka-common at libfranka 0.9.2,
//! `research_interface/robot/service_types.h` and `rbk_types.h`.

use super::{Table, Width, row};
use crate::message::Answer::{self, *};
use crate::message::Kind;

const SETTER: &[Answer] = &[Success, NotPossibleRejected, InvalidArgumentRejected];

pub(super) static TABLE: Table = Table {
    version: 5,
    width: Width::F64,
    accelerometers: 0,
    command: 370,
    requests: &[
        row(Kind::Connect, 4, &[Success, IncompatibleLibraryVersion]),
        row(
            Kind::Move,
            56,
            &[
                Success,
                MotionStarted,
                Preempted,
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
                EmergencyAborted,
                ReflexAborted,
                Aborted,
            ],
        ),
        row(Kind::GetCartesianLimit, 4, SETTER),
        row(Kind::SetCollisionBehavior, 416, SETTER),
        row(Kind::SetJointImpedance, 56, SETTER),
        row(Kind::SetCartesianImpedance, 48, SETTER),
        row(Kind::SetGuidingMode, 7, SETTER),
        row(Kind::SetEeToK, 128, SETTER),
        row(Kind::SetNeToEe, 128, SETTER),
        row(Kind::SetLoad, 104, SETTER),
        row(Kind::SetFilters, 40, SETTER),
        row(
            Kind::AutomaticErrorRecovery,
            0,
            &[
                Success,
                NotPossibleRejected,
                ManualErrorRecoveryRequiredRejected,
                ReflexAborted,
                EmergencyAborted,
                Aborted,
            ],
        ),
        row(Kind::LoadModelLibrary, 2, &[Success, Error]),
    ],
};
