//! The camera.

use std::time::Duration;

use ipc::CameraPorts;
use messages::{Features, Message, Stamp, TwistCommand};

use crate::boundary::{self, Fault, Handle};
use crate::domain::Domain;
use crate::status::Status;

/// The ports, and the number of the last features.
pub struct CameraState {
    ports: CameraPorts,
    sequence: u64,
}

/// Publishes features, receives twists.
pub type Camera = Handle<CameraState>;

/// Features that were published, as their answer names them.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sent {
    /// Their sequence number.
    pub sequence: u64,
    /// Their time of publication, ns.
    pub published_ns: u64,
}

/// Opens the camera's ports. VPC_STATUS_TAKEN while another camera is at work.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_camera_open(domain: *mut Domain, out: *mut *mut Camera) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let domain = unsafe { boundary::handle(domain, "domain") }?;
        let camera = CameraState {
            ports: CameraPorts::open(domain)?,
            sequence: 0,
        };
        // SAFETY: the header asks for a place.
        unsafe { boundary::give(out, camera) }
    })
}

/// Closes the camera's ports. NULL does nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_camera_close(camera: *mut Camera) -> Status {
    // SAFETY: the header asks for a handle that is not used again.
    boundary::enter(|| unsafe { boundary::close(camera, "camera") })
}

/// Fills in features: `count` points u1 v1 u2 v2 ... in px, 1 to 8, all visible, no times.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_features_of(
    points: *const f64,
    count: u32,
    out: *mut Features,
) -> Status {
    boundary::enter(|| {
        if points.is_null() {
            return Err(Fault::null("points"));
        }
        if !(1..=messages::MAX_POINTS as u32).contains(&count) {
            let words = format!("count = {count}; allowed: 1 to {}", messages::MAX_POINTS);
            return Err(Fault::new(Status::Argument, words));
        }
        // SAFETY: the header asks for 2 `count` numbers, and `count` was looked at.
        let points =
            unsafe { std::slice::from_raw_parts(points.cast::<[f64; 2]>(), count as usize) };
        // SAFETY: the header asks for a place.
        unsafe { boundary::put(out, "out", Features::new(points, 0)) }
    })
}

/// Publishes features under the next sequence number. `stamp.published_ns` 0 becomes the present
/// time and `stamp.data_ns` 0 becomes `published_ns`; other values are kept (simulated time in
/// lockstep, the exposure of a real camera). `sent` may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_camera_publish(
    camera: *mut Camera,
    features: *const Features,
    sent: *mut Sent,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let camera = unsafe { boundary::handle(camera, "camera") }?;
        // SAFETY: the header asks for features.
        let mut features = unsafe { boundary::get(features, "features") }?;
        let Stamp {
            sequence,
            published_ns,
            data_ns,
        } = &mut features.stamp;
        *sequence = camera.sequence + 1;
        if *published_ns == 0 {
            *published_ns = ipc::now_ns();
        }
        if *data_ns == 0 {
            *data_ns = *published_ns;
        }
        features.check()?;
        camera.sequence += 1;
        let done = camera.ports.features.publish_verbatim(&features)?;
        let done = Sent {
            sequence: done.sequence,
            published_ns: done.published_ns,
        };
        // SAFETY: the header asks for NULL or a place.
        unsafe { boundary::put_if_asked(sent, done) };
        Ok(())
    })
}

/// Counts from 1 again: the next features begin a new run, for which the controller forgets
/// everything.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_camera_restart(camera: *mut Camera) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        unsafe { boundary::handle(camera, "camera") }?.sequence = 0;
        Ok(())
    })
}

/// Lockstep: waits for the answer to features that were `sent`, at most `patience_ns`;
/// VPC_STATUS_TIMEOUT if none comes. A controller that starts meanwhile gets them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vpc_camera_wait(
    camera: *mut Camera,
    sent: *const Sent,
    patience_ns: u64,
    out: *mut TwistCommand,
) -> Status {
    boundary::enter(|| {
        // SAFETY: the header asks for a handle.
        let camera = unsafe { boundary::handle(camera, "camera") }?;
        // SAFETY: the header asks for what `vpc_camera_publish` filled in.
        let sent = unsafe { boundary::get(sent, "sent") }?;
        let known = ipc::Sent {
            sequence: sent.sequence,
            published_ns: sent.published_ns,
            receivers: 0,
        };
        let patience = Duration::from_nanos(patience_ns);
        match camera.ports.wait_for_answer(&known, patience)? {
            // SAFETY: the header asks for a place.
            Some(twist) => unsafe { boundary::put(out, "out", twist.message) },
            None => Err(Fault::new(
                Status::Timeout,
                format!(
                    "vpc/twist: no answer to features {} within {} ms; does vpcd run in this domain, with --clock lockstep?",
                    sent.sequence,
                    patience.as_millis()
                ),
            )),
        }
    })
}
