//! A program that wants the camera to move: a policy, a joystick, a planner.

use ipc::Publisher;
use messages::{DesiredTwist, Message};

use crate::boundary::{self, Handle};
use crate::domain::Domain;
use crate::status::Status;

/// Publishes wanted twists.
pub type Policy = Handle<Publisher<DesiredTwist>>;

/// Opens the policy's port. VPC_STATUS_TAKEN while another policy is at work.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_policy_open(domain: *mut Domain, out: *mut *mut Policy) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let domain = unsafe { boundary::handle(domain, "domain") }?;
        let policy = domain.publisher::<DesiredTwist>()?;
        // SAFETY: the header asks for a place.
        unsafe { boundary::give(out, policy) }
    })
}

/// Closes the policy's port. NULL does nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_policy_close(policy: *mut Policy) -> Status {
    // SAFETY: the header asks for a handle that is not used again.
    boundary::enter(|| unsafe { boundary::close(policy, "policy") })
}

/// Publishes the twist that is wanted (6 numbers, m/s and rad/s, camera frame) until the instant
/// `valid_until_ns` (CLOCK_MONOTONIC), but for no more than 0.5 s. With the strategy `follow` vpcd
/// sends the nearest twist that is allowed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_policy_want(
    policy: *mut Policy,
    twist: *const [f64; 6],
    valid_until_ns: u64,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let policy = unsafe { boundary::handle(policy, "policy") }?;
        // SAFETY: the header asks for a twist.
        let twist = unsafe { boundary::get(twist, "twist") }?;
        let mut desired = DesiredTwist::until(twist, valid_until_ns);
        desired.stamp.sequence = 1;
        desired.check()?;
        policy.publish(&desired)?;
        Ok(())
    })
}
