//! Datagrams that are not the robot's, and signals while nothing answers.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::process::Stdio;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use ipc::{Domain, Subscriber};
use messages::RobotState;
use rustix::process::Signal;
use testkit::{Ended, PATIENCE, Running, eventually, tell};

use crate::robot::{Robot, own_address};

/// From a forged state, or a signal, to the end.
const ENDS: Duration = Duration::from_secs(4);

/// Between the bridge and the robot: passes everything on.
struct Relay {
    /// What the client takes for the robot's socket.
    states: UdpSocket,
    client: SocketAddr,
    newest: Arc<Mutex<Vec<u8>>>,
}

/// Passes on for one client at `address`, which the receiver gets when it has come.
fn relay(address: Ipv4Addr, robot: Ipv4Addr) -> Receiver<Relay> {
    let listener = TcpListener::bind((address, 1337)).unwrap();
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let (mut client, peer) = listener.accept().unwrap();
        let mut server = TcpStream::connect((robot, 1337)).unwrap();
        // A head, the version, and the client's port.
        let mut hello = [0; 16];
        client.read_exact(&mut hello).unwrap();
        let client_port = u16::from_le_bytes([hello[14], hello[15]]);
        let behind = Arc::new(UdpSocket::bind("127.0.0.1:0").unwrap());
        let port = behind.local_addr().unwrap().port();
        hello[14..].copy_from_slice(&port.to_le_bytes());
        server.write_all(&hello).unwrap();
        let back = (server.try_clone().unwrap(), client.try_clone().unwrap());
        for (mut from, mut to) in [(client, server), back] {
            std::thread::spawn(move || {
                let _ = std::io::copy(&mut from, &mut to);
                let _ = to.shutdown(Shutdown::Both);
            });
        }
        let relay = Relay {
            states: UdpSocket::bind((address, 0)).unwrap(),
            client: SocketAddr::new(peer.ip(), client_port),
            newest: Arc::default(),
        };
        let states = relay.states.try_clone().unwrap();
        let (to, newest) = (relay.client, Arc::clone(&relay.newest));
        let (mut buffer, commands) = ([0; 4096], Arc::clone(&behind));
        let (length, from) = behind.recv_from(&mut buffer).unwrap();
        let _ = relay.states.send_to(&buffer[..length], to);
        let answers = relay.states.try_clone().unwrap();
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok((length, _)) = answers.recv_from(&mut buffer) {
                let _ = commands.send_to(&buffer[..length], from);
            }
        });
        let _ = sender.send(relay);
        while let Ok(length) = behind.recv(&mut buffer) {
            *newest.lock().unwrap() = buffer[..length].to_vec();
            let _ = states.send_to(&buffer[..length], to);
        }
    });
    receiver
}

/// A bridge at work behind a relay.
struct Bench {
    robot: Robot,
    relay: Relay,
    bridge: Running,
    states: Subscriber<RobotState>,
}

impl Bench {
    fn start(address: Ipv4Addr) -> Self {
        let mut robot = Robot::start("fixed", 5, "");
        let relay = relay(address, robot.address);
        robot.address = address;
        let domain = Domain::join(&robot.place.domain()).unwrap();
        let states: Subscriber<RobotState> = domain.subscriber(1).unwrap();
        let mut command = robot.bridge("panda");
        let bridge = Running::start(command.stderr(Stdio::piped()));
        let mut bench = Self {
            relay: relay.recv_timeout(PATIENCE).unwrap(),
            robot,
            bridge,
            states,
        };
        bench.bridge.line("the robot follows vpc/twist");
        bench
    }

    /// The newest state under another number.
    fn forged(&self, number: u64) -> Vec<u8> {
        let mut forged = self.relay.newest.lock().unwrap().clone();
        forged[..8].copy_from_slice(&number.to_le_bytes());
        forged
    }
}

fn timed(bridge: Running) -> (Duration, Ended) {
    let since = Instant::now();
    let ended = bridge.ended_within(ENDS);
    (since.elapsed(), ended)
}

#[test]
fn an_invalid_state_ends_the_bridge_and_strangers_are_ignored() {
    let mut bench = Bench::start(own_address());
    // From another address: a forged number, and bytes that are no state.
    let stranger = UdpSocket::bind((own_address(), 0)).unwrap();
    for _ in 0..100 {
        let client = bench.relay.client;
        let forged = bench.forged(u64::MAX);
        stranger.send_to(&forged, client).unwrap();
        stranger.send_to(&forged[..9], client).unwrap();
        std::thread::sleep(Duration::from_millis(2));
    }
    bench.states.latest().unwrap();
    eventually("a state", || bench.states.latest().unwrap());
    assert!(bench.bridge.is_running(), "{}", bench.bridge.stderr());
    // From the robot's.
    let forged = bench.forged(u64::MAX);
    let (states, client) = (&bench.relay.states, bench.relay.client);
    states.send_to(&forged, client).unwrap();
    let (after, ended) = timed(bench.bridge);
    tell(format_args!("ended {after:?} after the number 2^64 - 1"));
    assert_eq!(ended.code, Some(69), "{ended:?}");
    assert!(ended.stderr.contains("18446744073709551615"), "{ended:?}");
    bench.robot.report();
}

#[test]
fn a_signal_ends_it_while_the_robot_does_not_answer() {
    let mut robot = Robot::start("fixed", 5, "");
    // It takes the connection, and says nothing.
    let address = own_address();
    let listener = TcpListener::bind((address, 1337)).unwrap();
    robot.address = address;
    let mut command = robot.bridge("panda");
    let bridge = Running::start(command.stderr(Stdio::piped()));
    let _client = listener.accept().unwrap();
    bridge.signal(Signal::TERM);
    let (after, ended) = timed(bridge);
    tell(format_args!("ended {after:?} after SIGTERM"));
    assert_eq!(ended.code, Some(1), "{ended:?}");
    assert!(ended.stderr.contains("not stopped within 3s"), "{ended:?}");
}

#[test]
fn a_signal_ends_it_at_whatever_point_of_its_start() {
    let robot = Robot::start("fixed", 5, "");
    for ms in [0, 3, 10, 30, 60, 100, 200, 400] {
        let bridge = Running::start(robot.bridge("panda").stderr(Stdio::piped()));
        std::thread::sleep(Duration::from_millis(ms));
        bridge.signal(Signal::TERM);
        let (_, ended) = timed(bridge);
        let is_so = ended.code == Some(0) || ended.signal == Some(15);
        assert!(is_so, "after {ms} ms: {ended:?}");
    }
}
