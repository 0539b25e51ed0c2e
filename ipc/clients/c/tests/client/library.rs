//! The functions, called as C calls them.

use std::ffi::CStr;
use std::ptr::{null, null_mut};

use ipc::ControllerPorts;
use messages::{
    DesiredTwist, Encoding, Features, ImageHeader, RobotState, TwistCommand, TwistState,
};
use vpcclient::boundary::{Fault, enter, vpc_message};
use vpcclient::camera::{vpc_camera_close, vpc_camera_open, vpc_camera_publish};
use vpcclient::domain::{vpc_domain_join, vpc_domain_leave};
use vpcclient::image::{
    vpc_image_loan, vpc_image_newest, vpc_image_publisher_close, vpc_image_publisher_open,
    vpc_image_release, vpc_image_send, vpc_image_skip, vpc_image_subscriber_close,
    vpc_image_subscriber_open,
};
use vpcclient::names::vpc_hold_name;
use vpcclient::operator::vpc_stop;
use vpcclient::policy::{vpc_policy_close, vpc_policy_open, vpc_policy_want};
use vpcclient::robot::{
    vpc_robot_close, vpc_robot_open, vpc_robot_publish, vpc_robot_twist, vpc_twist_in_force,
};
use vpcclient::status::Status;

fn words() -> String {
    // SAFETY: valid until the next call.
    let words = unsafe { CStr::from_ptr(vpc_message()) };
    words.to_str().unwrap().to_owned()
}

#[test]
fn a_panic_becomes_a_status_with_its_words() {
    assert_eq!(enter(|| panic!("the {} broke", "spring")), Status::Panic);
    assert_eq!(words(), "a defect: the spring broke");
    assert_eq!(enter(|| Ok(())), Status::Ok);
    let fault = || Err(Fault::new(Status::Argument, "with \0 inside"));
    assert_eq!(enter(fault), Status::Argument);
    assert_eq!(words(), "with ? inside");
}

#[test]
fn null_is_refused_by_its_name() {
    // SAFETY: NULL is allowed everywhere.
    unsafe {
        assert_eq!(vpc_robot_twist(null_mut(), null_mut()), Status::Argument);
        assert_eq!(words(), "robot = NULL; allowed: a valid pointer");
        assert_eq!(vpc_camera_close(null_mut()), Status::Ok);
    }
}

#[test]
fn a_handle_is_refused_in_another_thread() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().to_str().unwrap().to_owned() + "\0";
    let (mut domain, mut camera, mut second) = (null_mut(), null_mut(), null_mut());
    // SAFETY: handles are used as the header says, but for the thread, which is what is tested.
    unsafe {
        let joined = vpc_domain_join(path.as_ptr().cast(), &mut domain);
        assert_eq!(joined, Status::Ok, "{}", words());
        assert_eq!(vpc_camera_open(domain, &mut camera), Status::Ok);
        assert_eq!(vpc_camera_open(domain, &mut second), Status::Taken);
        assert!(words().contains("another publisher"), "{}", words());
        let address = camera as usize;
        let foreign = std::thread::spawn(move || {
            let camera = address as *mut _;
            (vpc_camera_close(camera), words())
        });
        let (status, said) = foreign.join().unwrap();
        assert_eq!(status, Status::Thread);
        assert!(said.starts_with("camera: used in another thread"), "{said}");

        assert_eq!(vpc_domain_leave(domain), Status::Ok);
        // What the camera publishes is heard, and what breaks the contract does not leave.
        let peer = ipc::Domain::join(directory.path()).unwrap();
        let mut controller = ControllerPorts::open(&peer).unwrap();
        let mut features = Features::new(&[[1.0, 2.0]; 4], 0);
        features.points[3] = f64::NAN;
        assert_eq!(
            vpc_camera_publish(camera, &features, null_mut()),
            Status::Argument
        );
        assert_eq!(
            words(),
            "vpc/features: points[3] = NaN; allowed: finite numbers"
        );
        features.points[3] = 5.0;
        assert_eq!(
            vpc_camera_publish(camera, &features, null_mut()),
            Status::Ok
        );
        let heard = controller.features.latest().unwrap().unwrap();
        assert_eq!((heard.stamp.sequence, heard.points[3]), (1, 5.0));
        assert_eq!(heard.stamp.data_ns, heard.stamp.published_ns);
        assert_eq!(vpc_camera_close(camera), Status::Ok);
    }
}

#[test]
fn a_robot_lives_beside_a_camera_of_another_process() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().to_str().unwrap().to_owned() + "\0";
    let peer = ipc::Domain::join(directory.path()).unwrap();
    let _camera = ipc::CameraPorts::open(&peer).unwrap();
    let mut controller = ControllerPorts::open(&peer).unwrap();
    let (mut domain, mut robot, mut second) = (null_mut(), null_mut(), null_mut());
    // SAFETY: handles and pointers are used as the header says.
    unsafe {
        let joined = vpc_domain_join(path.as_ptr().cast(), &mut domain);
        assert_eq!(joined, Status::Ok, "{}", words());
        assert_eq!(
            vpc_robot_open(domain, &mut robot),
            Status::Ok,
            "{}",
            words()
        );
        assert_eq!(vpc_robot_open(domain, &mut second), Status::Taken);
        let mut command = TwistCommand::zero(TwistState::Moving);
        assert_eq!(vpc_robot_twist(robot, &mut command), Status::Nothing);
        let sent = TwistCommand {
            twist: [0.25; 6],
            ..command
        };
        controller.twist.publish(&sent).unwrap();
        assert_eq!(vpc_robot_twist(robot, &mut command), Status::Ok);
        assert_eq!(command.twist, [0.25; 6]);

        let mut state = RobotState::free_camera([0.1, 0.2, f64::NAN], [0.0; 3], 7);
        assert_eq!(vpc_robot_publish(robot, &state), Status::Argument);
        state.translation[2] = 0.3;
        assert_eq!(vpc_robot_publish(robot, &state), Status::Ok);
        let heard = controller.robot.latest().unwrap().unwrap();
        assert_eq!(
            (heard.translation, heard.stamp.data_ns),
            ([0.1, 0.2, 0.3], 7)
        );
        assert_eq!(vpc_robot_close(robot), Status::Ok);
        assert_eq!(vpc_domain_leave(domain), Status::Ok);
    }
}

#[test]
fn a_policy_publishes_what_it_wants() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().to_str().unwrap().to_owned() + "\0";
    let peer = ipc::Domain::join(directory.path()).unwrap();
    let mut controller = peer.subscriber::<DesiredTwist>(1).unwrap();
    let (mut domain, mut policy, mut second) = (null_mut(), null_mut(), null_mut());
    // SAFETY: handles and pointers are used as the header says.
    unsafe {
        let joined = vpc_domain_join(path.as_ptr().cast(), &mut domain);
        assert_eq!(joined, Status::Ok, "{}", words());
        assert_eq!(vpc_policy_open(domain, &mut policy), Status::Ok);
        assert_eq!(vpc_policy_open(domain, &mut second), Status::Taken);
        let (mut wanted, never) = ([0.25; 6], [f64::NAN; 6]);
        wanted[5] = -0.5;
        assert_eq!(vpc_policy_want(policy, &never, 7), Status::Argument);
        assert_eq!(vpc_policy_want(policy, &wanted, 7), Status::Ok);
        let heard = controller.latest().unwrap().unwrap();
        assert_eq!((heard.twist, heard.valid_until_ns), (wanted, 7));
        assert_eq!(vpc_policy_close(policy), Status::Ok);
        assert_eq!(vpc_domain_leave(domain), Status::Ok);
    }
}

#[test]
fn images_are_written_and_read_in_shared_memory() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().to_str().unwrap().to_owned() + "\0";
    let (mut domain, mut publisher, mut subscriber) = (null_mut(), null_mut(), null_mut());
    let (mut pixels, mut seen) = (null_mut(), null());
    let (mut header, mut missed) = (ImageHeader::default(), 9);
    let plain = ImageHeader::new(4, 2, Encoding::Bgr8, 0);
    // SAFETY: handles and pointers are used as the header says.
    unsafe {
        let joined = vpc_domain_join(path.as_ptr().cast(), &mut domain);
        assert_eq!(joined, Status::Ok, "{}", words());
        let opened = vpc_image_publisher_open(domain, 24, &mut publisher);
        assert_eq!(opened, Status::Ok, "{}", words());
        assert_eq!(
            vpc_image_publisher_open(domain, 24, &mut null_mut()),
            Status::Taken
        );
        assert_eq!(
            vpc_image_publisher_open(domain, 0, &mut null_mut()),
            Status::Open
        );
        let opened = vpc_image_subscriber_open(domain, &mut subscriber);
        assert_eq!(opened, Status::Ok, "{}", words());
        let mut newest = || {
            let status = vpc_image_newest(subscriber, &mut header, &mut seen, &mut missed);
            (status, header, missed, seen)
        };
        assert_eq!(newest().0, Status::Nothing);

        assert_eq!(
            vpc_image_send(publisher, &plain, null_mut()),
            Status::Argument
        );
        assert!(words().contains("no image is loaned"), "{}", words());
        let large = ImageHeader::new(4, 3, Encoding::Bgr8, 0);
        assert_eq!(
            vpc_image_loan(publisher, &large, &mut pixels),
            Status::Argument
        );
        assert!(words().contains("36 bytes; allowed: 24"), "{}", words());
        // Twice: the first one is given up.
        for _ in 0..2 {
            assert_eq!(vpc_image_loan(publisher, &plain, &mut pixels), Status::Ok);
        }
        for k in 0..24 {
            pixels.add(k).write(k as u8);
        }
        let mut sent = plain;
        (sent.exposure_begin_ns, sent.exposure_ns) = (1_000, 10);
        sent.stamp.data_ns = 999;
        assert_eq!(
            vpc_image_send(publisher, &sent, null_mut()),
            Status::Argument
        );
        assert_eq!(words(), "vpc/image: data_ns = 999; allowed: 1000 to 1010");
        sent.stamp.data_ns = 1_005;
        assert_eq!(vpc_image_skip(publisher), Status::Ok);
        assert_eq!(vpc_image_send(publisher, &sent, null_mut()), Status::Ok);
        let (status, header, missed, first) = newest();
        assert_eq!((status, missed), (Status::Ok, 0), "{}", words());
        assert_eq!((header.stamp.sequence, header.exposure_ns), (2, 10));
        assert!(header.stamp.published_ns > 0);
        let bytes = std::slice::from_raw_parts(first, 24);
        assert!(bytes.iter().enumerate().all(|(k, byte)| *byte == k as u8));

        // The next ones are written elsewhere; one that a peer sends in another language counts too.
        for grey in 100..105 {
            assert_eq!(vpc_image_loan(publisher, &plain, &mut pixels), Status::Ok);
            pixels.write_bytes(grey, 24);
            assert_eq!(vpc_image_send(publisher, &plain, null_mut()), Status::Ok);
        }
        assert!(bytes.iter().enumerate().all(|(k, byte)| *byte == k as u8));
        let (status, header, missed, last) = newest();
        assert_eq!((status, missed), (Status::Ok, 4));
        assert_eq!(header.stamp.data_ns, header.stamp.published_ns);
        assert_eq!(*last, 104);
        assert_eq!(newest().0, Status::Nothing);
        // What is held stays until it is released.
        assert_eq!(*last, 104);
        assert_eq!(vpc_image_release(subscriber), Status::Ok);
        assert_eq!(vpc_image_release(subscriber), Status::Ok);

        assert_eq!(vpc_image_loan(publisher, &plain, &mut pixels), Status::Ok);
        assert_eq!(vpc_domain_leave(domain), Status::Ok);
        assert_eq!(vpc_image_publisher_close(publisher), Status::Ok);
        assert_eq!(vpc_image_subscriber_close(subscriber), Status::Ok);
    }
    assert_eq!(ipc::Domain::segments(directory.path()).unwrap(), 0);
}

#[test]
fn the_dead_man_and_the_stop_need_no_domain() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().to_str().unwrap().to_owned() + "\0";
    let mut command = TwistCommand::zero(TwistState::Moving);
    command.stamp.published_ns = 1_000;
    (command.valid_until_ns, command.twist) = (u64::MAX - 1, [0.5; 6]);
    let mut twist = [9.0; 6];
    // SAFETY: pointers are valid or NULL, as the header says.
    unsafe {
        for (now_ns, allowed) in [(1_000, 0.5), (100_000_999, 0.5), (100_001_000, 0.0)] {
            assert_eq!(vpc_twist_in_force(&command, now_ns, &mut twist), Status::Ok);
            assert_eq!(twist, [allowed; 6], "{now_ns}");
        }
        twist = [9.0; 6];
        assert_eq!(vpc_twist_in_force(null(), 1_000, &mut twist), Status::Ok);
        assert_eq!(twist, [0.0; 6]);
        assert_eq!(
            vpc_twist_in_force(&command, 0, null_mut()),
            Status::Argument
        );

        assert_eq!(vpc_stop(path.as_ptr().cast(), 1), Status::Domain);
        let mut stop_file = ipc::StopFile::open(directory.path()).unwrap();
        assert_eq!(vpc_stop(path.as_ptr().cast(), 1), Status::Timeout);
        assert!(words().contains("begins disarmed"), "{}", words());
        assert!(stop_file.is_asked());
        let address = path.clone();
        let stop = std::thread::spawn(move || vpc_stop(address.as_ptr().cast(), 10_000_000_000));
        while !stop.is_finished() {
            if stop_file.is_asked() {
                stop_file.obey();
            }
        }
        assert_eq!(stop.join().unwrap(), Status::Ok);
    }
}

#[test]
fn codes_have_words() {
    let name = |code| {
        // SAFETY: valid for ever.
        unsafe { CStr::from_ptr(vpc_hold_name(code)) }
            .to_str()
            .unwrap()
            .to_owned()
    };
    assert_eq!(name(0), "none");
    assert_eq!(name(20), "standstill of the loop");
    assert_eq!(name(22), "frozen image or wrong stamps");
    assert_eq!(name(23), "unknown");
    assert_eq!(name(24), "unclean end of the last vpcd");
}
