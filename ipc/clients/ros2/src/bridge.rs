//! The loop: from topics to shared memory, and from `vpc/twist` to the robot.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::Duration;

use ipc::{Domain, Publisher, ReceiveError, RobotPorts, now_ns};
use messages::{DesiredTwist, Features};
use nalgebra::UnitQuaternion;
use ros2_client::Publisher as Topic;

use crate::arm::Arm;
use crate::config::{CommandFrame, Config, Executed, FeaturesKind};
use crate::event::{BridgeError, Event, Report};
use crate::eye::Eye;
use crate::guard;
use crate::inbox::Inbox;
use crate::message::{
    AprilTagDetectionArray, CameraInfo, Header, JointState, PolygonStamped, PoseStamped, Twist,
    TwistStamped,
};
use crate::outlet::Outlet;
use crate::policy::Policy;
use crate::refusal::Counts;
use crate::ros::{Listeners, Ros, RosError};
use crate::stamp::{self, Clocks};

/// Between two looks: a thirtieth of a period at 30 Hz.
const PAUSE: Duration = Duration::from_millis(1);
/// Between two measurements of the clocks, and two reports, ns.
const MEASURE_NS: u64 = 10_000_000;
const REPORT_NS: u64 = 200_000_000;
/// Zero twists at the end, twists that brake before them at most, and between two of them.
const LAST_ZEROS: u32 = 10;
const LAST_BRAKES: u32 = 50;
const LAST_PAUSE: Duration = Duration::from_millis(20);

/// The camera's side.
struct Camera {
    eye: Eye,
    info: Option<Inbox<CameraInfo>>,
    tags: Option<Inbox<AprilTagDetectionArray>>,
    points: Option<Inbox<PolygonStamped>>,
}

/// The robot's side.
struct Robot {
    arm: Arm,
    outlet: Outlet,
    twists: Option<Inbox<TwistStamped>>,
    poses: Option<Inbox<PoseStamped>>,
    joints: Option<Inbox<JointState>>,
    command: Topic<TwistStamped>,
    listeners: Option<Listeners>,
    frame: String,
}

/// The side of another program, which wants the camera to move.
struct Wishes {
    policy: Policy,
    inbox: Inbox<TwistStamped>,
}

/// All of ROS that the loop needs.
pub struct Bridge {
    clocks: Clocks,
    camera: Option<Camera>,
    robot: Option<Robot>,
    wishes: Option<Wishes>,
    report: Report,
}

/// The places in the domain: none in a preflight.
struct Ports {
    features: Option<Publisher<Features>>,
    robot: Option<RobotPorts>,
    desired: Option<Publisher<DesiredTwist>>,
}

impl Bridge {
    /// Subscribes to topics, and offers the command.
    ///
    /// # Errors
    /// [`RosError`].
    pub fn open(config: &Config, ros: &mut Ros) -> Result<Self, RosError> {
        let camera = config.is_camera().then(|| Camera::open(config, ros));
        let robot = config.is_robot().then(|| Robot::open(config, ros));
        let wishes = config.is_policy().then(|| Wishes::open(config, ros));
        Ok(Self {
            clocks: Clocks::new(stamp::measure(), config.max_age_ns),
            camera: camera.transpose()?,
            robot: robot.transpose()?,
            wishes: wishes.transpose()?,
            report: Report::default(),
        })
    }

    /// Takes the places of camera, robot and policy in the domain, and works until `stop`.
    ///
    /// # Errors
    /// [`BridgeError`]: another program has such a place, or shared memory fails.
    pub fn run(
        mut self,
        config: &Config,
        stop: &AtomicBool,
        is_stopping: &AtomicBool,
        tell: &SyncSender<Event>,
    ) -> Result<(), BridgeError> {
        let domain = Domain::join(&config.domain)?;
        let mut ports = Ports {
            features: match self.camera {
                Some(_) => Some(domain.publisher()?),
                None => None,
            },
            robot: match self.robot {
                Some(_) => Some(RobotPorts::open(&domain)?),
                None => None,
            },
            desired: match self.wishes {
                Some(_) => Some(domain.publisher()?),
                None => None,
            },
        };
        let ended = self.work(&mut ports, stop, is_stopping, tell);
        // However it ends, the robot is told to stand.
        if let Some(robot) = &mut self.robot {
            robot.end(&self.clocks, &mut self.report, tell);
        }
        self.count();
        let _ = tell.try_send(Event::Report(self.report.clone()));
        ended
    }

    /// Only listens, until `stop`; returns what came.
    ///
    /// # Errors
    /// None that is known: nothing is published.
    pub fn listen(
        mut self,
        stop: &AtomicBool,
        tell: &SyncSender<Event>,
    ) -> Result<Report, BridgeError> {
        let mut ports = Ports {
            features: None,
            robot: None,
            desired: None,
        };
        let never = AtomicBool::new(false);
        self.work(&mut ports, stop, &never, tell)?;
        self.count();
        Ok(self.report)
    }

    fn work(
        &mut self,
        ports: &mut Ports,
        stop: &AtomicBool,
        is_stopping: &AtomicBool,
        tell: &SyncSender<Event>,
    ) -> Result<(), BridgeError> {
        let (mut measured_ns, mut reported_ns) = (0, 0);
        while !stop.load(Ordering::Relaxed) {
            let now = now_ns();
            if now - measured_ns >= MEASURE_NS {
                measured_ns = now;
                if let Some(step) = self.clocks.follow(stamp::measure(), now)? {
                    let _ = tell.try_send(Event::Step(step));
                }
                if guard::is_gone() {
                    return Err(BridgeError::Guard);
                }
                let listeners = self.robot.as_mut().and_then(|r| r.listeners.as_mut());
                if listeners.is_some_and(Listeners::have_left) {
                    guard::nobody_listens();
                }
                // A vpcd that came meanwhile finds the last features.
                if let Some(features) = &mut ports.features {
                    features.refresh()?;
                }
            }
            if let Some(robot) = &mut self.robot {
                // The dead man first, whatever waits on topics.
                self.report.is_stopping = is_stopping.load(Ordering::Relaxed);
                robot.outlet.stop(self.report.is_stopping);
                if let Some(ports) = &mut ports.robot {
                    robot.pass_on(ports, &self.clocks, &mut self.report, tell)?;
                }
                robot.look(&self.clocks, ports.robot.as_mut(), tell)?;
            }
            if let Some(camera) = &mut self.camera {
                camera.look(&self.clocks, ports.features.as_mut(), tell)?;
            }
            if let Some(wishes) = &mut self.wishes {
                let arm = self.robot.as_ref().map(|robot| &robot.arm);
                let turn = arm.and_then(|arm| arm.base_from_tool(now_ns()));
                wishes.look(&self.clocks, turn.as_ref(), ports.desired.as_mut(), tell)?;
            }
            if now - reported_ns >= REPORT_NS {
                reported_ns = now;
                self.count();
                let _ = tell.try_send(Event::Report(self.report.clone()));
            }
            std::thread::sleep(PAUSE);
        }
        Ok(())
    }

    fn count(&mut self) {
        fn note<M>(topics: &mut Vec<(String, Counts)>, inbox: &Option<Inbox<M>>) {
            let counts = inbox.iter().map(|i| (i.topic.clone(), i.counts.clone()));
            topics.extend(counts);
        }
        let topics = &mut self.report.topics;
        topics.clear();
        if let Some(camera) = &self.camera {
            note(topics, &camera.tags);
            note(topics, &camera.points);
            note(topics, &camera.info);
            self.report.foreign_tags = camera.eye.foreign;
        }
        if let Some(robot) = &self.robot {
            note(topics, &robot.twists);
            note(topics, &robot.poses);
            note(topics, &robot.joints);
        }
        if let Some(Wishes { inbox, .. }) = &self.wishes {
            topics.push((inbox.topic.clone(), inbox.counts.clone()));
        }
        self.report.steps = self.clocks.steps;
        self.report.offset_ns = self.clocks.offset_ns();
    }
}

impl Camera {
    fn open(config: &Config, ros: &mut Ros) -> Result<Self, RosError> {
        let keys = &config.camera;
        let (mut tags, mut points, mut info) = (None, None, None);
        match keys.features {
            FeaturesKind::Tags => tags = Some(Inbox::open(ros, &keys.topic, keys.reliability)?),
            FeaturesKind::Points => points = Some(Inbox::open(ros, &keys.topic, keys.reliability)?),
            FeaturesKind::None => (),
        }
        if !keys.info.is_empty() {
            info = Some(Inbox::open(ros, &keys.info, keys.reliability)?);
        }
        Ok(Self {
            eye: Eye::new(config),
            info,
            tags,
            points,
        })
    }

    fn look(
        &mut self,
        clocks: &Clocks,
        mut port: Option<&mut Publisher<Features>>,
        tell: &SyncSender<Event>,
    ) -> Result<(), BridgeError> {
        let eye = &mut self.eye;
        if let Some(inbox) = &mut self.info {
            inbox.each(
                tell,
                |message, now| eye.info(message).map(|()| Some((now, ()))),
                |()| Ok(()),
            )?;
        }
        let mut publish = |features: Features| {
            if let Some(port) = &mut port {
                port.publish(&features)?;
            }
            Ok(())
        };
        let dated = |features: Features| Some((features.stamp.data_ns, features));
        if let Some(inbox) = &mut self.tags {
            let judge = |message: &_, now| eye.tags(message, clocks, now).map(dated);
            inbox.each(tell, judge, &mut publish)?;
        }
        if let Some(inbox) = &mut self.points {
            let judge = |message: &_, now| eye.points(message, clocks, now).map(dated);
            inbox.each(tell, judge, &mut publish)?;
        }
        Ok(())
    }
}

impl Wishes {
    fn open(config: &Config, ros: &mut Ros) -> Result<Self, RosError> {
        let keys = &config.policy;
        Ok(Self {
            policy: Policy::new(config),
            inbox: Inbox::open(ros, &keys.desired, keys.reliability)?,
        })
    }

    fn look(
        &mut self,
        clocks: &Clocks,
        turn: Option<&UnitQuaternion<f64>>,
        mut port: Option<&mut Publisher<DesiredTwist>>,
        tell: &SyncSender<Event>,
    ) -> Result<(), BridgeError> {
        let policy = &mut self.policy;
        let judge = |message: &_, now| {
            let desired = policy.wish(message, clocks, now, turn)?;
            Ok(Some((desired.stamp.data_ns, desired)))
        };
        self.inbox.each(tell, judge, |desired| {
            if let Some(port) = &mut port {
                port.publish(&desired)?;
            }
            Ok(())
        })
    }
}

impl Robot {
    fn open(config: &Config, ros: &mut Ros) -> Result<Self, RosError> {
        let (keys, limits) = (&config.robot, &config.scene.limits);
        let command = ros.publisher(&keys.command, keys.command_reliability)?;
        guard::writer(command.guid().to_bytes());
        let mut robot = Self {
            arm: Arm::new(config),
            outlet: Outlet::new(config.zeros_ns, limits.velocity(), limits.acceleration()),
            twists: None,
            poses: None,
            joints: None,
            listeners: ros.listeners(&command),
            command,
            frame: match keys.command_frame {
                CommandFrame::Camera => config.camera.frame.clone(),
                CommandFrame::Tool => keys.tool.clone(),
                CommandFrame::Base => keys.base.clone(),
            },
        };
        if keys.executed == Executed::Twist {
            robot.twists = Some(Inbox::open(ros, &keys.twist, keys.reliability)?);
        }
        if !keys.pose.is_empty() {
            robot.poses = Some(Inbox::open(ros, &keys.pose, keys.reliability)?);
        }
        if !keys.joints.is_empty() {
            robot.joints = Some(Inbox::open(ros, &keys.joint_states, keys.reliability)?);
        }
        Ok(robot)
    }

    fn look(
        &mut self,
        clocks: &Clocks,
        mut ports: Option<&mut RobotPorts>,
        tell: &SyncSender<Event>,
    ) -> Result<(), BridgeError> {
        let (arm, outlet) = (&mut self.arm, &self.outlet);
        let mut publish = |state: Option<messages::RobotState>| {
            if let (Some(ports), Some(state)) = (&mut ports, state) {
                ports.robot.publish(&state)?;
            }
            Ok(())
        };
        if let Some(inbox) = &mut self.joints {
            let judge = |message: &_, now| {
                let at_ns = arm.joints(message, clocks, now)?;
                Ok(at_ns.map(|at_ns| (at_ns, ())))
            };
            inbox.each(tell, judge, |()| Ok(()))?;
        }
        if let Some(inbox) = &mut self.poses {
            let judge = |message: &_, now| {
                let state = arm.pose(message, clocks, now, outlet.command(now))?;
                let at_ns = state.map_or(now, |state| state.stamp.data_ns);
                Ok(Some((at_ns, state)))
            };
            inbox.each(tell, judge, &mut publish)?;
        }
        if let Some(inbox) = &mut self.twists {
            let judge = |message: &_, now| {
                let state = arm.twist(message, clocks, now, outlet.command(now))?;
                Ok(Some((state.stamp.data_ns, Some(state))))
            };
            inbox.each(tell, judge, &mut publish)?;
        }
        Ok(())
    }

    /// Sends what vpcd commands, and zeros when that ends.
    fn pass_on(
        &mut self,
        ports: &mut RobotPorts,
        clocks: &Clocks,
        report: &mut Report,
        tell: &SyncSender<Event>,
    ) -> Result<(), BridgeError> {
        match ports.twist.latest() {
            Ok(Some(command)) => {
                if let Some(twist) = self.outlet.take(&command, now_ns()) {
                    self.send(twist, clocks, report, tell);
                }
            }
            Ok(None) => (),
            Err(ReceiveError::Invalid { invalid, .. }) => {
                self.outlet.refuse();
                let _ = tell.try_send(Event::Command(invalid));
            }
            Err(error) => return Err(error.into()),
        }
        if let Some(twist) = self.outlet.due(now_ns()) {
            self.send_own(twist, clocks, report, tell);
        }
        Ok(())
    }

    /// Brakes, and sends zeros.
    fn end(&mut self, clocks: &Clocks, report: &mut Report, tell: &SyncSender<Event>) {
        let mut zeros = 0;
        for sent in 0..LAST_BRAKES + LAST_ZEROS {
            let twist = match sent < LAST_BRAKES && !report.is_stopping {
                true => self.outlet.brake(now_ns()),
                false => self.outlet.stand(now_ns()),
            };
            self.send_own(twist, clocks, report, tell);
            zeros += u32::from(twist == [0.0; 6]);
            if zeros == LAST_ZEROS {
                break;
            }
            std::thread::sleep(LAST_PAUSE);
        }
    }

    /// Sends a twist that nobody commanded.
    fn send_own(
        &mut self,
        twist: [f64; 6],
        clocks: &Clocks,
        report: &mut Report,
        tell: &SyncSender<Event>,
    ) {
        let is_sent = self.send(twist, clocks, report, tell);
        report.sent[1] += u64::from(is_sent && twist == [0.0; 6]);
    }

    /// Sends a twist of the camera in the frame of the command; returns whether it could.
    fn send(
        &mut self,
        camera: [f64; 6],
        clocks: &Clocks,
        report: &mut Report,
        tell: &SyncSender<Event>,
    ) -> bool {
        let now = now_ns();
        let twist = self.arm.command(&camera, now);
        // To stand is the same in every frame.
        if twist.is_none() && camera != [0.0; 6] {
            self.outlet.stand(now);
            let _ = tell.try_send(Event::NoFrame);
        }
        let message = TwistStamped {
            header: Header {
                stamp: stamp::wall(now, clocks.offset_ns()),
                frame_id: self.frame.clone(),
            },
            twist: Twist::from_array(twist.unwrap_or_default()),
        };
        let sent = self.command.publish(message);
        match &sent {
            Ok(()) => report.sent[0] += 1,
            Err(why) => {
                report.not_sent += 1;
                let _ = tell.try_send(Event::NotSent("a twist", format!("{why:?}")));
            }
        }
        sent.is_ok()
    }
}
