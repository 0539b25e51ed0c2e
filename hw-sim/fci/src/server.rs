//! The sockets: one client at a time over TCP, states and commands over UDP. Nothing here waits, so
//! that the robot's millisecond can call it.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::message::{Answer, Command, Kind, Request, State};
use crate::wire::{HEAD, LONGEST, Version};

/// How long a client may take for its first request.
const PATIENCE: Duration = Duration::from_secs(2);
/// Most datagrams taken at a time.
const DATAGRAMS: usize = 64;
/// Bytes of the answer about a Cartesian limit after its status: none is known.
const CARTESIAN_LIMIT: usize = 8 * (3 + 16) + 1;

/// What happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A client of our version is there.
    Connected(SocketAddr),
    /// A client asked for another version.
    Incompatible {
        /// Its address.
        client: SocketAddr,
        /// The version that it speaks.
        version: u16,
    },
    /// The client is gone, or was sent away.
    Gone(String),
    /// A request to answer.
    Request(Ticket, Request),
}

/// The client and the request that an answer is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ticket {
    kind: Kind,
    command: u32,
    number: u32,
    /// Which of the clients.
    client: u64,
}

impl Ticket {
    /// What was asked for.
    pub fn kind(&self) -> Kind {
        self.kind
    }
}

/// The robot's end of the interface.
#[derive(Debug)]
pub struct Server {
    version: Version,
    address: SocketAddr,
    /// None while a client of our version is there: its port refuses others then. One of another
    /// version may come back at once with ours.
    listener: Option<TcpListener>,
    client: Option<Client>,
    clients: u64,
}

#[derive(Debug)]
struct Client {
    stream: TcpStream,
    address: SocketAddr,
    since: Instant,
    /// For its states and commands, once it has said where: datagrams of others do not get in, and
    /// take no room.
    datagrams: Option<UdpSocket>,
    /// What came of the next request.
    received: Vec<u8>,
}

impl Server {
    /// Listens at this address; clients expect port 1337.
    ///
    /// # Errors
    /// The address cannot be had.
    pub fn bind(address: SocketAddr, version: Version) -> io::Result<Self> {
        let listener = listen(address)?;
        Ok(Self {
            version,
            address: listener.local_addr()?,
            listener: Some(listener),
            client: None,
            clients: 0,
        })
    }

    /// The version that it speaks.
    pub fn version(&self) -> Version {
        self.version
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether a client gets states.
    pub fn has_client(&self) -> bool {
        self.datagrams().is_some()
    }

    fn datagrams(&self) -> Option<&UdpSocket> {
        self.client.as_ref()?.datagrams.as_ref()
    }

    /// Waits until the client, which gets states, sends something or is gone; `false` where it does
    /// not in this time.
    pub fn wait(&self, patience: Duration) -> bool {
        let Some((client, datagrams)) = self.client.as_ref().zip(self.datagrams()) else {
            return false;
        };
        let mut ends = [
            PollFd::new(datagrams, PollFlags::IN),
            PollFd::new(&client.stream, PollFlags::IN),
        ];
        let patience = Timespec::try_from(patience).ok();
        poll(&mut ends, patience.as_ref()).is_ok_and(|ready| ready > 0)
    }

    /// What happened since the last call. Each [`Event::Request`] is to be answered.
    pub fn poll(&mut self) -> Vec<Event> {
        let mut events = Vec::new();
        self.accept();
        while let Some(event) = self.next() {
            if matches!(event, Event::Gone(_)) {
                self.client = None;
            }
            events.push(event);
        }
        events
    }

    /// Answers a request; an answer to a client that is gone is dropped.
    pub fn reply(&mut self, ticket: &Ticket, answer: Answer) {
        self.reply_with(ticket, answer, &[]);
    }

    /// Answers a request, with what was asked for.
    pub fn reply_with(&mut self, ticket: &Ticket, answer: Answer, asked: &[u8]) {
        let table = self.version.table();
        let mut body = vec![table.status(ticket.kind, answer)];
        match ticket.kind {
            Kind::Connect => body.extend(table.version.to_le_bytes()),
            Kind::GetCartesianLimit => body.extend([0; CARTESIAN_LIMIT]),
            _ => body.extend(asked),
        }
        let clients = self.clients;
        if let Some(client) = self.client.as_mut().filter(|_| ticket.client == clients) {
            let size = (HEAD + body.len()) as u32;
            let head = [ticket.command, ticket.number, size];
            let mut bytes: Vec<u8> = head.iter().flat_map(|x| x.to_le_bytes()).collect();
            bytes.append(&mut body);
            // One that does not read its answers is found at the next call.
            let _ = client.stream.write_all(&bytes);
        }
    }

    /// The commands that came since the last call: datagrams of the client, of the right size.
    pub fn commands(&mut self) -> Vec<Command> {
        let table = self.version.table();
        let mut commands = Vec::new();
        let Some(datagrams) = self.datagrams() else {
            return commands;
        };
        let mut bytes = [0; LONGEST];
        for _ in 0..DATAGRAMS {
            match datagrams.recv(&mut bytes) {
                Ok(count) => {
                    commands.extend(bytes.get(..count).and_then(|b| table.read_command(b)));
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                // What an earlier datagram met: a client that is gone.
                Err(_) => (),
            }
        }
        commands
    }

    /// Sends the state.
    pub fn tell(&self, state: &State) {
        if let Some(datagrams) = self.datagrams() {
            // One that is lost is lost, as on a network.
            let _ = datagrams.send(&self.version.table().state(state));
        }
    }

    fn accept(&mut self) {
        if self.client.is_some() {
            return;
        }
        if self.listener.is_none() {
            // Where the address cannot be had now, at the next call.
            self.listener = listen(self.address).ok();
        }
        let Some(Ok((stream, address))) = self.listener.as_ref().map(TcpListener::accept) else {
            return;
        };
        let is_ready = stream.set_nonblocking(true).and(stream.set_nodelay(true));
        if is_ready.is_ok() {
            self.clients += 1;
            self.client = Some(Client {
                stream,
                address,
                since: Instant::now(),
                datagrams: None,
                received: Vec::new(),
            });
        }
    }

    fn next(&mut self) -> Option<Event> {
        let (table, number) = (self.version.table(), self.clients);
        let client = self.client.as_mut()?;
        let frame = match client.read() {
            Ok(Some(frame)) => frame,
            Ok(None) => return None,
            Err(why) => return Some(Event::Gone(why)),
        };
        let Some((kind, request)) = table.read_request(frame.command, &frame.arguments) else {
            return Some(Event::Gone(format!(
                "request {} with {} bytes of arguments is not one of version {}",
                frame.command,
                frame.arguments.len(),
                table.version
            )));
        };
        let ticket = Ticket {
            kind,
            command: frame.command,
            number: frame.number,
            client: number,
        };
        if kind == Kind::Connect {
            return Some(self.greet(&ticket, &frame.arguments));
        }
        if client.datagrams.is_none() {
            return Some(Event::Gone(format!("{kind:?} before it has connected")));
        }
        Some(Event::Request(ticket, request))
    }

    fn greet(&mut self, ticket: &Ticket, arguments: &[u8]) -> Event {
        let word = |at| {
            let bytes = arguments.get(at..at + 2).and_then(|b| b.try_into().ok());
            u16::from_le_bytes(bytes.unwrap_or_default())
        };
        let (version, port) = (word(0), word(2));
        let Some(client) = &mut self.client else {
            return Event::Gone("nobody is there".to_owned());
        };
        let address = client.address;
        if version != self.version.number() {
            self.reply(ticket, Answer::IncompatibleLibraryVersion);
            return Event::Incompatible {
                client: address,
                version,
            };
        }
        match client.link(port) {
            Ok(datagrams) => client.datagrams = Some(datagrams),
            Err(error) => return Event::Gone(format!("port {port} for states: {error}")),
        }
        self.listener = None;
        self.reply(ticket, Answer::Success);
        Event::Connected(address)
    }
}

/// A message of the client.
struct Frame {
    command: u32,
    number: u32,
    arguments: Vec<u8>,
}

impl Client {
    /// A socket for its states and commands.
    fn link(&self, port: u16) -> io::Result<UdpSocket> {
        let datagrams = UdpSocket::bind((self.stream.local_addr()?.ip(), 0))?;
        datagrams.connect((self.address.ip(), port))?;
        datagrams.set_nonblocking(true)?;
        Ok(datagrams)
    }

    /// The next whole message, if it is there.
    ///
    /// # Errors
    /// Why the client is gone, or must go.
    fn read(&mut self) -> Result<Option<Frame>, String> {
        let mut bytes = [0; LONGEST];
        loop {
            if let Some(frame) = self.frame()? {
                return Ok(Some(frame));
            }
            match self.stream.read(&mut bytes) {
                Ok(0) => return Err("it closed the connection".to_owned()),
                Ok(count) => self.received.extend(bytes.get(..count).unwrap_or_default()),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => (),
                Err(error) => return Err(error.to_string()),
            }
        }
        match self.datagrams.is_none() && self.since.elapsed() > PATIENCE {
            true => Err(format!("it did not connect within {PATIENCE:?}")),
            false => Ok(None),
        }
    }

    /// Takes the first message off what was received.
    fn frame(&mut self) -> Result<Option<Frame>, String> {
        let word = |at: usize| {
            let bytes = self.received.get(at..at + 4)?;
            Some(u32::from_le_bytes(bytes.try_into().ok()?))
        };
        let (Some(command), Some(number), Some(size)) = (word(0), word(4), word(8)) else {
            return Ok(None);
        };
        let size = size as usize;
        if !(HEAD..=LONGEST).contains(&size) {
            return Err(format!(
                "a message of {size} bytes; allowed: {HEAD} to {LONGEST}"
            ));
        }
        if self.received.len() < size {
            return Ok(None);
        }
        let rest = self.received.split_off(size);
        let message = std::mem::replace(&mut self.received, rest);
        Ok(Some(Frame {
            command,
            number,
            arguments: message.get(HEAD..).unwrap_or_default().to_vec(),
        }))
    }
}

fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn server() -> Server {
        Server::bind("127.0.0.1:0".parse().unwrap(), Version::V5).unwrap()
    }

    fn connect(server: &Server) -> TcpStream {
        let stream = TcpStream::connect(server.address()).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(5)))
            .unwrap();
        stream
    }

    fn hello(version: u16, port: u16) -> Vec<u8> {
        let head = [0_u32, 7, 16].iter().flat_map(|x| x.to_le_bytes());
        let words = [version, port].into_iter().flat_map(u16::to_le_bytes);
        head.chain(words).collect()
    }

    /// Polls until something happens.
    fn event(server: &mut Server) -> Event {
        let begin = Instant::now();
        while begin.elapsed() < Duration::from_secs(5) {
            if let Some(event) = server.poll().into_iter().next() {
                return event;
            }
        }
        panic!("nothing happens");
    }

    #[test]
    fn a_client_of_our_version_gets_states_and_its_commands_count() {
        let mut server = server();
        let udp = UdpSocket::bind("127.0.0.1:0").unwrap();
        let mut client = connect(&server);
        let hello = hello(5, udp.local_addr().unwrap().port());
        // In two parts.
        client.write_all(&hello[..9]).unwrap();
        assert_eq!(server.poll(), []);
        client.write_all(&hello[9..]).unwrap();
        assert!(matches!(event(&mut server), Event::Connected(_)));
        let mut answer = [0; 15];
        client.read_exact(&mut answer).unwrap();
        assert_eq!(answer, [0, 0, 0, 0, 7, 0, 0, 0, 15, 0, 0, 0, 0, 5, 0]);

        server.tell(&State::default());
        let mut state = [0; 4000];
        let (count, from) = udp.recv_from(&mut state).unwrap();
        assert_eq!(count, 2373);
        // Strangers, though many, do not keep the client's from coming in.
        let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
        for _ in 0..2 * DATAGRAMS {
            stranger.send_to(&[0; 370], from).unwrap();
        }
        udp.send_to(&[0; 100], from).unwrap();
        udp.send_to(&[0; 370], from).unwrap();
        let mut commands = Vec::new();
        while commands.is_empty() {
            assert!(server.wait(Duration::from_secs(5)), "nothing came");
            commands = server.commands();
        }
        assert_eq!(commands.len(), 1);
        assert_eq!(server.commands(), []);

        // While it is there, the port refuses others; afterwards it does not.
        assert!(TcpStream::connect(server.address()).is_err());
        drop(client);
        assert!(matches!(event(&mut server), Event::Gone(_)));
        server.poll();
        connect(&server);
    }

    #[test]
    fn another_version_is_told_ours_and_nonsense_is_sent_away() {
        let mut server = server();
        let mut client = connect(&server);
        client.write_all(&hello(6, 1)).unwrap();
        let Event::Incompatible { version, .. } = event(&mut server) else {
            panic!("accepted");
        };
        assert_eq!(version, 6);
        let mut answer = [0; 15];
        client.read_exact(&mut answer).unwrap();
        assert_eq!(answer[12..], [1, 5, 0]);
        drop(client);
        assert!(matches!(event(&mut server), Event::Gone(_)));
        for nonsense in [[0xff; 12], [0; 12]] {
            server.poll();
            let mut client = connect(&server);
            client.write_all(&nonsense).unwrap();
            assert!(matches!(event(&mut server), Event::Gone(_)));
        }
        // A request before the handshake.
        server.poll();
        let mut client = connect(&server);
        let stop: Vec<u8> = [2_u32, 1, 12]
            .iter()
            .flat_map(|x| x.to_le_bytes())
            .collect();
        client.write_all(&stop).unwrap();
        assert!(matches!(event(&mut server), Event::Gone(_)));
    }
}
