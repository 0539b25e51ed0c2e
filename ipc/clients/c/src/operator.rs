//! An operator: commands the controller.

use std::ffi::c_char;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::time::Duration;

use ipc::OperatorPorts;
use messages::{Action, Outcome, Reply, Request};

use crate::boundary::{self, Fault, Handle};
use crate::domain::{self, Domain};
use crate::status::Status;

/// Asks the controller, and waits for its answers.
pub type Operator = Handle<OperatorPorts>;

/// Opens an operator's ports. VPC_STATUS_TAKEN if as many operators are at work as the service
/// allows: close it when it is no longer needed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_operator_open(domain: *mut Domain, out: *mut *mut Operator) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let domain = unsafe { boundary::handle(domain, "domain") }?;
        // SAFETY: the header asks for a place.
        unsafe { boundary::give(out, OperatorPorts::open(domain)?) }
    })
}

/// Closes an operator's ports. NULL does nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_operator_close(operator: *mut Operator) -> Status {
    // SAFETY: the header asks for a handle that is not used again.
    boundary::enter(|| unsafe { boundary::close(operator, "operator") })
}

/// A number that no other operator uses: the standard library seeds its hash tables from the
/// operating system's random numbers.
fn fresh_id() -> u64 {
    let mut hasher = RandomState::new().build_hasher();
    hasher.write_u64(ipc::now_ns());
    hasher.finish()
}

/// Sends a request and waits for the answer, at most `patience_ns`. `action` is a vpc_action; for
/// VPC_ACTION_STRATEGY, `strategy` is a vpc_strategy and `neighbours` 1 to 64 with knn; otherwise
/// both are 0. `out` (may be NULL) gets the answer, also of VPC_STATUS_REFUSED.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_operator_ask(
    operator: *mut Operator,
    action: u32,
    strategy: u32,
    neighbours: u32,
    patience_ns: u64,
    out: *mut Reply,
) -> Status {
    let request = Request {
        action,
        strategy,
        neighbours,
        id: fresh_id(),
        ..Request::default()
    };
    // SAFETY: the header asks for a handle and a place.
    unsafe { ask(operator, request, patience_ns, out) }
}

/// Sends this request and waits for the answer.
unsafe fn ask(
    operator: *mut Operator,
    mut request: Request,
    patience_ns: u64,
    out: *mut Reply,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the caller has a handle.
        let operator = unsafe { boundary::handle(operator, "operator") }?;
        request.stamp.sequence = 1;
        request.check_codes()?;
        let patience = Duration::from_nanos(patience_ns);
        let Some(reply) = operator.ask(&request, patience)? else {
            let words = format!(
                "vpc/replies: no answer within {} ms; does vpcd run in this domain?",
                patience.as_millis()
            );
            return Err(Fault::new(Status::Timeout, words));
        };
        // SAFETY: the header asks for NULL or a place.
        unsafe { boundary::put_if_asked(out, reply) };
        match reply.outcome() {
            Some(Outcome::Done) => Ok(()),
            Some(outcome) => Err(Fault::new(Status::Refused, outcome.to_string())),
            None => Err(Fault::new(Status::Refused, "refused")),
        }
    })
}

/// How long vpc_arm and vpc_disarm wait.
const PATIENCE_NS: u64 = 1_000_000_000;

/// Lets the control law move the camera, from the next good features on; waits for the answer, at
/// most a second. VPC_STATUS_REFUSED with VPC_OUTCOME_VETOED in `out`: an operator has stopped or
/// disarmed it since it was last armed; vpc_arm_despite.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_arm(operator: *mut Operator, out: *mut Reply) -> Status {
    // SAFETY: the header asks for a handle and a place.
    unsafe { vpc_operator_ask(operator, Action::Arm.code(), 0, 0, PATIENCE_NS, out) }
}

/// Arms in spite of a stop or a disarm, the `veto` of a reply or a cycle that the operator has
/// seen. Refused if another came since. A program that arms by itself names the one that stood when
/// it was started.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_arm_despite(
    operator: *mut Operator,
    veto: u32,
    out: *mut Reply,
) -> Status {
    // SAFETY: the header asks for a handle and a place.
    unsafe { ask(operator, Request::arm(fresh_id(), veto), PATIENCE_NS, out) }
}

/// Brakes to zero and stays there until the next vpc_arm; waits for the answer, at most a second.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_disarm(operator: *mut Operator, out: *mut Reply) -> Status {
    // SAFETY: the header asks for a handle and a place.
    unsafe { vpc_operator_ask(operator, Action::Disarm.code(), 0, 0, PATIENCE_NS, out) }
}

/// Zero at once, without braking, until the next vpc_arm. Waits until the zero twist is sent, at
/// most `patience_ns`; VPC_STATUS_TIMEOUT: no controller obeyed in that time, and the next one of
/// this domain begins disarmed. Goes by the stop file of the domain in `directory` (NULL:
/// /tmp/vpc-UID), which needs neither a joined domain nor an operator: nothing that others do keeps
/// it waiting. Any thread may call it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_stop(directory: *const c_char, patience_ns: u64) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for NULL or a string that ends in NUL.
        let directory = unsafe { domain::named(directory) };
        ipc::stop(&directory, Duration::from_nanos(patience_ns))?;
        Ok(())
    })
}
