//! The bytes of a version: little-endian, packed. What differs between versions stands in a table
//! each, [`v5`] and [`v10`].

pub mod v10;
pub mod v5;

use std::fmt;
use std::str::FromStr;

use crate::errors;
use crate::message::{Answer, Command, Controller, Generator, Kind, Load, Request, State};

/// Bytes of a TCP message's head: command, its number, bytes of the message.
pub const HEAD: usize = 12;
/// Most bytes of a request.
pub const LONGEST: usize = 1024;

/// A version of the interface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Version {
    /// The Panda's; libfranka 0.8 and 0.9.
    #[default]
    V5,
    /// The FR3's; libfranka from 0.15 on.
    V10,
}

impl Version {
    /// Its number.
    pub fn number(self) -> u16 {
        self.table().version
    }

    pub(crate) fn table(self) -> &'static Table {
        match self {
            Self::V5 => &v5::TABLE,
            Self::V10 => &v10::TABLE,
        }
    }
}

impl FromStr for Version {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "5" => Ok(Self::V5),
            "10" => Ok(Self::V10),
            _ => Err(format!("{text}: no such version; allowed: 5, 10")),
        }
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.number().fmt(f)
    }
}

/// What differs between versions.
pub(crate) struct Table {
    pub version: u16,
    /// The requests, each at the place of its number.
    pub requests: &'static [Row],
    /// How numbers stand in a state.
    pub width: Width,
    /// Numbers of accelerometers in a state, which are sent as zeros.
    pub accelerometers: usize,
    /// Bytes of a command.
    pub command: usize,
}

/// A request.
pub(crate) struct Row {
    pub kind: Kind,
    /// Bytes of its arguments.
    pub bytes: usize,
    /// How it may end, each at the place of its number.
    pub answers: &'static [Answer],
}

/// The row of a request.
const fn row(kind: Kind, bytes: usize, answers: &'static [Answer]) -> Row {
    Row {
        kind,
        bytes,
        answers,
    }
}

/// How a number of a state is sent.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Width {
    F32,
    F64,
}

impl Table {
    /// The number of an answer; where a request has no such answer, that of its refusal, or 1.
    pub fn status(&self, kind: Kind, answer: Answer) -> u8 {
        let row = self.requests.iter().find(|row| row.kind == kind);
        let place = |answer| row?.answers.iter().position(|a| *a == answer);
        let place = place(answer).or_else(|| place(Answer::NotPossibleRejected));
        place.unwrap_or(1) as u8
    }

    /// A state message.
    pub fn state(&self, state: &State) -> Vec<u8> {
        let mut bytes = state.message_id.to_le_bytes().to_vec();
        let mut put = |numbers: &[f64]| {
            for number in numbers {
                match self.width {
                    Width::F32 => bytes.extend((*number as f32).to_le_bytes()),
                    Width::F64 => bytes.extend(number.to_le_bytes()),
                }
            }
        };
        let Load {
            mass,
            center,
            inertia,
        } = &state.load;
        for transform in [
            &state.o_t_ee,
            &state.o_t_ee_d,
            &state.f_t_ee,
            &state.ee_t_k,
            &state.f_t_ne,
            &state.ne_t_ee,
        ] {
            put(transform);
        }
        // m_ee, I_ee, F_x_Cee.
        put(&[0.0; 1 + 9 + 3]);
        put(&[*mass]);
        put(inertia);
        put(center);
        put(&state.elbow);
        put(&state.elbow_d);
        // tau_J, tau_J_d, dtau_J.
        put(&[0.0; 3 * 7]);
        for joints in [&state.q, &state.q_d, &state.dq, &state.dq_d, &state.ddq_d] {
            put(joints);
        }
        // Contacts and collisions of joints and end effector, external torques and forces.
        put(&[0.0; 2 * (7 + 6) + 7 + 6 + 6]);
        put(&state.o_dp_ee_d);
        // O_ddP_O.
        put(&[0.0, 0.0, -9.81]);
        put(&state.elbow_d);
        // delbow_c, ddelbow_c.
        put(&[0.0; 2 + 2]);
        put(&state.o_t_ee_c);
        put(&state.o_dp_ee_c);
        put(&state.o_ddp_ee_c);
        // theta, dtheta: the motors', which are the joints' here.
        put(&state.q);
        put(&state.dq);
        put(&vec![0.0; self.accelerometers]);
        bytes.extend([state.generator as u8, state.controller as u8]);
        bytes.extend(state.errors.map(u8::from));
        bytes.extend(state.reflex_reason.map(u8::from));
        bytes.push(state.mode as u8);
        match self.width {
            Width::F32 => bytes.extend((state.control_command_success_rate as f32).to_le_bytes()),
            Width::F64 => bytes.extend(state.control_command_success_rate.to_le_bytes()),
        }
        bytes
    }

    /// The command in a datagram; `None` if it is of another size.
    pub fn read_command(&self, bytes: &[u8]) -> Option<Command> {
        if bytes.len() != self.command {
            return None;
        }
        // message_id, q_c, dq_c, O_T_EE_c, O_dP_EE_c, elbow_c, two flags; torques.
        let [dq, twist] = [8 + 56, 8 + 56 + 56 + 128];
        let [elbow, flags] = [twist + 48, twist + 48 + 16];
        Some(Command {
            message_id: u64::from_le_bytes(bytes.get(..8)?.try_into().ok()?),
            dq_c: numbers(bytes, dq)?,
            o_dp_ee_c: numbers(bytes, twist)?,
            elbow_c: match *bytes.get(flags)? {
                0 => None,
                _ => numbers::<1>(bytes, elbow)?.first().copied(),
            },
            is_last: *bytes.get(flags + 1)? != 0,
        })
    }

    /// A request's kind, and what its arguments say; `None` if there is no such request, or its
    /// arguments are of another size.
    pub fn read_request(&self, command: u32, arguments: &[u8]) -> Option<(Kind, Request)> {
        let row = self.requests.get(usize::try_from(command).ok()?)?;
        if arguments.len() != row.bytes {
            return None;
        }
        let kind = row.kind;
        let request = match kind {
            Kind::Move => {
                let mode = |at: usize| {
                    Some(u32::from_le_bytes(
                        arguments.get(at..at + 4)?.try_into().ok()?,
                    ))
                };
                match (Controller::asked(mode(0)?), Generator::asked(mode(4)?)) {
                    (Some(controller), Some(generator)) => Request::Move {
                        controller,
                        generator,
                    },
                    _ => Request::Invalid(kind),
                }
            }
            Kind::StopMove => Request::StopMove,
            Kind::AutomaticErrorRecovery => Request::AutomaticErrorRecovery,
            Kind::SetEeToK => Request::SetEeToK(numbers(arguments, 0)?),
            Kind::SetNeToEe => Request::SetNeToEe(numbers(arguments, 0)?),
            Kind::SetLoad => Request::SetLoad(Load {
                mass: numbers::<1>(arguments, 0)?[0],
                center: numbers(arguments, 8)?,
                inertia: numbers(arguments, 32)?,
            }),
            Kind::SetGuidingMode => Request::Setting(kind),
            Kind::SetCollisionBehavior
            | Kind::SetJointImpedance
            | Kind::SetCartesianImpedance
            | Kind::SetFilters => {
                let mut all = arguments.chunks_exact(8);
                let is_good = |number: &[u8]| {
                    let number = number.try_into().map(f64::from_le_bytes);
                    number.is_ok_and(|number| number.is_finite() && number >= 0.0)
                };
                match all.all(is_good) {
                    true => Request::Setting(kind),
                    false => Request::Invalid(kind),
                }
            }
            Kind::Connect
            | Kind::GetCartesianLimit
            | Kind::LoadModelLibrary
            | Kind::GetRobotModel => Request::Query(kind),
        };
        Some((kind, request))
    }
}

impl Controller {
    /// The one that a request names.
    fn asked(number: u32) -> Option<Self> {
        [
            Self::JointImpedance,
            Self::CartesianImpedance,
            Self::External,
        ]
        .get(number as usize)
        .copied()
    }
}

impl Generator {
    /// The one that a request names, which does not count [`Generator::Idle`].
    fn asked(number: u32) -> Option<Self> {
        [
            Self::JointPosition,
            Self::JointVelocity,
            Self::CartesianPosition,
            Self::CartesianVelocity,
            Self::None,
        ]
        .get(number as usize)
        .copied()
    }
}

/// So many numbers from there on.
fn numbers<const N: usize>(bytes: &[u8], at: usize) -> Option<[f64; N]> {
    let mut numbers = [0.0; N];
    let bytes = bytes.get(at..at + 8 * N)?;
    for (number, bytes) in numbers.iter_mut().zip(bytes.chunks_exact(8)) {
        *number = f64::from_le_bytes(bytes.try_into().ok()?);
    }
    Some(numbers)
}

const _: () = assert!(errors::COUNT == 41);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_have_the_sizes_of_the_vendors_packed_structs() {
        // sizeof(RobotState), sizeof(RobotCommand) of libfranka-common.
        for (version, state, command) in [(Version::V5, 2373, 370), (Version::V10, 1377, 371)] {
            let table = version.table();
            assert_eq!(table.state(&State::default()).len(), state);
            assert_eq!(table.command, command);
            assert_eq!(table.read_command(&vec![0; command - 1]), None);
            assert!(table.read_command(&vec![0; command]).is_some());
        }
    }

    #[test]
    fn a_command_is_read_from_its_places() {
        let mut bytes = vec![0; 370];
        bytes[..8].copy_from_slice(&7_u64.to_le_bytes());
        bytes[64..72].copy_from_slice(&0.25_f64.to_le_bytes());
        bytes[248..256].copy_from_slice(&0.5_f64.to_le_bytes());
        bytes[313] = 1;
        let command = Version::V5.table().read_command(&bytes).unwrap();
        assert_eq!((command.message_id, command.dq_c[0]), (7, 0.25));
        assert_eq!(command.o_dp_ee_c[0], 0.5);
        assert!(command.is_last && command.elbow_c.is_none());
        bytes[296..304].copy_from_slice(&0.75_f64.to_le_bytes());
        bytes[312] = 1;
        let command = Version::V5.table().read_command(&bytes).unwrap();
        assert_eq!(command.elbow_c, Some(0.75));
    }

    #[test]
    fn answers_have_the_numbers_of_their_version() {
        let (five, ten) = (Version::V5.table(), Version::V10.table());
        assert_eq!(five.status(Kind::Move, Answer::ReflexAborted), 6);
        assert_eq!(ten.status(Kind::Move, Answer::ReflexAborted), 8);
        assert_eq!(five.status(Kind::StopMove, Answer::Success), 0);
        // What a request cannot answer is a refusal.
        assert_eq!(five.status(Kind::SetLoad, Answer::EmergencyAborted), 1);
    }

    #[test]
    fn a_request_of_another_size_or_number_is_none() {
        let table = Version::V5.table();
        assert!(table.read_request(1, &[0; 56]).is_some());
        assert!(table.read_request(1, &[0; 55]).is_none());
        assert!(table.read_request(14, &[]).is_none());
        let (_, request) = table.read_request(1, &[9; 56]).unwrap();
        assert_eq!(request, Request::Invalid(Kind::Move));
        let nan = f64::NAN.to_le_bytes().repeat(7);
        let (_, request) = table.read_request(5, &nan).unwrap();
        assert_eq!(request, Request::Invalid(Kind::SetJointImpedance));
    }
}
