//! Packets that nobody should send: what the DDS library makes of them does not move the robot.

use std::net::{Ipv4Addr, UdpSocket};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::json;
use testkit::{PATIENCE, eventually, tell, within};

use crate::bench::{Bench, Via};

/// Mutated packets in a round, each to all ports.
const PACKETS: u32 = 2000;
const ROUNDS: u32 = 5;
/// The vendor of RustDDS, and so of the gateway.
const OURS: [u8; 2] = [1, 18];
/// Until when the robot stands: 200 ms without a twist, the kill, a tick of the peer, a frame.
const STANDS: Duration = Duration::from_millis(500);

/// Another program in the ROS domain.
struct Stranger {
    socket: UdpSocket,
    /// Where the gateway reads.
    ports: Vec<u16>,
    /// What others sent here.
    heard: Vec<Vec<u8>>,
}

impl Stranger {
    /// Listens where the participants of a machine look for each other, as a new peer does.
    fn join(bench: &mut Bench) -> Self {
        let base = 7400 + 250 * bench.plan.ros_domain_id;
        let own = (0..10).map(|k| base + 10 + 2 * k).rev();
        let bound = own
            .filter_map(|port| UdpSocket::bind((Ipv4Addr::LOCALHOST, port)).ok())
            .next();
        let socket = bound.expect("a free place of a participant");
        let wait = Some(Duration::from_millis(100));
        socket.set_read_timeout(wait).unwrap();
        bench.restart_peer();
        let mut stranger = Self {
            socket,
            ports: Vec::new(),
            heard: Vec::new(),
        };
        eventually("a peer that tells of itself", || {
            let mut buffer = [0; 65536];
            while let Ok(length) = stranger.socket.recv(&mut buffer) {
                stranger.heard.push(buffer[..length].to_vec());
            }
            (!stranger.peers().is_empty()).then_some(())
        });
        stranger
    }

    /// The first parts of the GUIDs of all but the gateway.
    fn peers(&self) -> Vec<[u8; 12]> {
        let others = self.heard.iter().filter(|heard| heard[6..8] != OURS);
        let mut peers: Vec<[u8; 12]> = others.map(|h| h[8..20].try_into().unwrap()).collect();
        peers.sort_unstable();
        peers.dedup();
        peers
    }

    fn send(&self, packet: &[u8]) {
        for port in &self.ports {
            let _ = self.socket.send_to(packet, (Ipv4Addr::LOCALHOST, *port));
        }
    }
}

/// The UDP ports that a process has bound.
fn ports(id: u32) -> Vec<u16> {
    let open = std::fs::read_dir(format!("/proc/{id}/fd")).unwrap();
    let links = open.filter_map(|entry| std::fs::read_link(entry.ok()?.path()).ok());
    let sockets: Vec<String> = links.map(|l| l.to_string_lossy().into_owned()).collect();
    let table = std::fs::read_to_string("/proc/net/udp").unwrap();
    let bound = table.lines().skip(1).filter_map(|line| {
        let words: Vec<_> = line.split_whitespace().collect();
        let is_its = sockets.contains(&format!("socket:[{}]", words[9]));
        let (_, port) = words[1].split_once(':')?;
        is_its.then(|| u16::from_str_radix(port, 16).ok())?
    });
    bound.collect()
}

fn number(number: i64) -> [u8; 8] {
    let halves = [(number >> 32) as u32, number as u32].map(u32::to_le_bytes);
    halves.concat().try_into().unwrap()
}

fn packet(prefix: &[u8; 12], kind: u8, flags: u8, parts: &[&[u8]]) -> Vec<u8> {
    let body = parts.concat();
    let mut packet = b"RTPS\x02\x03\x01\x10".to_vec();
    packet.extend(prefix);
    packet.extend([kind, flags]);
    packet.extend((body.len() as u16).to_le_bytes());
    packet.extend(body);
    packet
}

/// A HEARTBEAT of the writer that tells of publications, with the samples 1 to 2^62.
fn endless(prefix: &[u8; 12]) -> Vec<u8> {
    let numbers = [number(1), number(1 << 62)].concat();
    let packet = packet(
        prefix,
        7,
        1,
        &[
            &[0; 4],
            &[0, 0, 3, 0xc2],
            &numbers,
            &[0xff, 0xff, 0xff, 0x7f],
        ],
    );
    assert_eq!(packet.len(), 52);
    packet
}

/// One packet of each kind, in the name of a peer, between writers and readers of discovery.
fn seeds(prefix: &[u8; 12]) -> Vec<Vec<u8>> {
    let writers = [
        [0, 1, 0, 0xc2],
        [0, 0, 3, 0xc2],
        [0, 0, 4, 0xc2],
        [0, 2, 0, 0xc2],
    ];
    let mut seeds = Vec::new();
    for writer in writers {
        let mut reader = writer;
        reader[3] = 0xc7;
        let (reader, writer): (&[u8], &[u8]) = (&reader, &writer);
        let (one, few) = (number(1), number(3));
        let set = [&one[..], &[32, 0, 0, 0, 0xff, 0xff, 0xff, 0xff]].concat();
        let data = [0, 3, 0, 0, 0x15, 0, 4, 0, 2, 4, 0, 0, 1, 0, 0, 0];
        seeds.extend([
            packet(
                prefix,
                0x07,
                1,
                &[reader, writer, &one, &few, &[9, 0, 0, 0]],
            ),
            packet(prefix, 0x08, 1, &[reader, writer, &one, &set]),
            packet(prefix, 0x06, 1, &[reader, writer, &set, &[9, 0, 0, 0]]),
            packet(
                prefix,
                0x15,
                5,
                &[&[0, 0, 16, 0], reader, writer, &few, &data],
            ),
            packet(
                prefix,
                0x15,
                3,
                &[&[0, 0, 16, 0], reader, writer, &few, &data[4..]],
            ),
            packet(
                prefix,
                0x16,
                1,
                &[
                    &[0, 0, 28, 0],
                    reader,
                    writer,
                    &few,
                    &[1, 0, 0, 0, 1, 0, 16, 0, 64, 0, 0, 0],
                    &data,
                ],
            ),
            packet(
                prefix,
                0x13,
                1,
                &[reader, writer, &few, &[8, 0, 0, 0, 9, 0, 0, 0]],
            ),
            packet(
                prefix,
                0x12,
                1,
                &[
                    reader,
                    writer,
                    &few,
                    &[1, 0, 0, 0, 8, 0, 0, 0, 255, 0, 0, 0, 9, 0, 0, 0],
                ],
            ),
        ]);
    }
    seeds
}

/// A generator of numbers that look random (xorshift).
struct Dice(u64);

impl Dice {
    fn below(&mut self, end: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % end as u64) as usize
    }

    fn mutate(&mut self, seed: &[u8]) -> Vec<u8> {
        let mut packet = seed.to_vec();
        for _ in 0..=self.below(5) {
            let at = 4 + self.below(packet.len() - 4);
            match self.below(5) {
                0 => packet[at] ^= 1 << self.below(8),
                1 => packet[at] = self.below(256) as u8,
                2 => {
                    let extremes = [0, 1, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff_u32];
                    let extreme = extremes[self.below(5)].to_le_bytes();
                    let end = packet.len().min(at + 4);
                    packet[at..end].copy_from_slice(&extreme[..end - at]);
                }
                3 => drop(
                    packet.drain(
                        at..(at + self.below(40))
                            .min(seed.len())
                            .clamp(at, packet.len()),
                    ),
                ),
                _ => {
                    let again = packet[at..].to_vec();
                    packet.extend(again);
                }
            }
            packet.resize(packet.len().clamp(24, 8192), 0);
        }
        packet
    }
}

/// Waits for a zero; how long it took, since this instant, in which there were `zeros`.
fn stands(bench: &mut Bench, since: Instant, zeros: u64) -> Duration {
    let peer = &mut bench.peer;
    let mut last = json!(null);
    let found = within(PATIENCE, || {
        last = peer.status();
        let came = last["zeros"].as_u64().unwrap() - zeros;
        (came > 0 && last["speed"] == json!(0.0)).then(|| since.elapsed())
    });
    found.unwrap_or_else(|| panic!("no zero: {last}; {}", bench.gateway.stderr()))
}

#[test]
fn a_packet_that_hangs_the_library_brings_zeros() {
    let Some(mut bench) = Bench::new("attack", Via::Dds, false) else {
        return;
    };
    let mut stranger = Stranger::join(&mut bench);
    if !bench.peer.set_off(5) {
        return;
    }
    stranger.ports = ports(bench.gateway.id());
    let zeros = bench.peer.status()["zeros"].as_u64().unwrap();
    let since = Instant::now();
    for peer in stranger.peers() {
        stranger.send(&endless(&peer));
    }
    let after = stands(&mut bench, since, zeros);
    let ended = bench.replace_gateway().ended();
    let words = &ended.stderr;
    tell(format_args!("zeros {after:?} after 52 bytes: {words}"));
    assert!(after < STANDS, "{after:?}: {words}");
    assert_eq!(ended.code, None, "{words}");
    assert!(words.contains("zeros are sent for 500 ms"), "{words}");
}

#[test]
fn gateway_or_guard_that_hang_or_are_killed_bring_zeros() {
    for via in [Via::Dds, Via::Kilted] {
        if let Some(bench) = Bench::new("guard", via, false) {
            hang_and_kill(bench);
        }
    }
}

fn hang_and_kill(mut bench: Bench) {
    for (signal, is_guard) in [
        (Signal::STOP, false),
        (Signal::KILL, false),
        (Signal::KILL, true),
    ] {
        if !bench.peer.set_off(5) {
            return;
        }
        let zeros = bench.peer.status()["zeros"].as_u64().unwrap();
        let since = Instant::now();
        match is_guard {
            true => kill_process(guard(bench.gateway.id()), signal).unwrap(),
            false => bench.gateway.signal(signal),
        }
        let after = stands(&mut bench, since, zeros);
        let who = if is_guard { "guard" } else { "gateway" };
        let via = bench.plan.via;
        tell(format_args!(
            "{via:?}: {who}, {signal:?}: zeros {after:?} after"
        ));
        assert!(after < STANDS, "{after:?}");
        let ended = bench.replace_gateway().ended();
        assert_eq!(ended.code, is_guard.then_some(69), "{}", ended.stderr);
    }
}

/// The only child of a process.
fn guard(gateway: u32) -> Pid {
    let children = std::fs::read_to_string(format!("/proc/{gateway}/task/{gateway}/children"));
    let only = children.unwrap().trim().parse().unwrap();
    Pid::from_raw(only).unwrap()
}

#[test]
fn mutated_packets_do_not_keep_the_robot_moving() {
    let Some(mut bench) = Bench::new("mutated packets", Via::Dds, false) else {
        return;
    };
    let mut stranger = Stranger::join(&mut bench);
    let seeds: Vec<_> = stranger.peers().iter().flat_map(seeds).collect();
    let mut dice = Dice(0x9e37_79b9_7f4a_7c15);
    let mut ends = 0;
    for _ in 0..ROUNDS {
        if !bench.peer.set_off(5) {
            return;
        }
        stranger.ports = ports(bench.gateway.id());
        let zeros = bench.peer.status()["zeros"].as_u64().unwrap();
        for sent in 0..PACKETS {
            let seed = dice.below(seeds.len());
            stranger.send(&dice.mutate(&seeds[seed]));
            if sent % 20 == 0 {
                std::thread::sleep(Duration::from_millis(2));
            }
        }
        // What lives obeys; what hangs or has ended has said zero.
        let since = Instant::now();
        bench.vpcd.signal(Signal::STOP);
        let after = stands(&mut bench, since, zeros);
        bench.vpcd.signal(Signal::CONT);
        assert!(after < STANDS, "{after:?}");
        if !bench.gateway.is_running() {
            ends += 1;
            let ended = bench.replace_gateway().ended();
            let last = ended.stderr.lines().last().unwrap_or_default();
            tell(format_args!("signal {:?}: {last}", ended.signal));
        }
    }
    let (all, ports) = (ROUNDS * PACKETS, stranger.ports.len());
    tell(format_args!(
        "{all} mutated packets to {ports} ports: the gateway ended {ends} times"
    ));
}
