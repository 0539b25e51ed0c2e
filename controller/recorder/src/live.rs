//! A domain live for Foxglove: its WebSocket, with the schemas and views of a recording.
//!
//! Clients only read. The server drops the oldest messages of a client that does not keep up;
//! nobody waits for it.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use arm::Mount;
use foxglove::messages::RawImage;
use ipc::ReceiveError;
use ipc::{Domain, Image, ImageSubscriber};
use messages::Order;
use messages::{CycleRecord, Message};
use recording::{Encoding, Sink, WallClock, WriteError};
use scene::{Scene, SceneFiles};
use tokio::net::TcpListener;
use tokio::runtime::Runtime;

use crate::foxglove_server::Server;
use crate::ledger::Notice;
use crate::ports::{self, Failures, Source};
use crate::record::RecordError;
use crate::recorder::Recorder;
use crate::scenery::{CAMERA, IMAGE};

/// Sleep between two looks at the queues: the shortest holds 64 messages, so 12,000 a second.
const PAUSE: Duration = Duration::from_millis(5);
/// Least time between two messages of a topic, ns: of a robot's 1,000 a second every fourth, of a
/// daemon's 250 cycles all, unless the loop woke up half a millisecond late.
const APART_NS: u64 = 3_500_000;
/// Least time between two images, ns: of a camera's 30 a second every second one.
const IMAGES_APART_NS: u64 = 60_000_000;
/// Least time between two sendings of what stands still, however many subscribe.
const STILL_APART: Duration = Duration::from_secs(1);
/// Time after which it is sent in any case: the full queue of a client may have dropped it.
const STILL_AGAIN: Duration = Duration::from_secs(3);

/// What to serve, and where.
#[derive(Clone, Debug)]
pub struct LiveOptions {
    /// Directory of the domain.
    pub domain: PathBuf,
    /// The scene to draw; `None`: the one that the daemon leaves in the domain.
    pub scene: Option<SceneFiles>,
    /// The camera on the arm, where it is known.
    pub mount: Option<Mount>,
    /// Address to listen at; port 0 takes a free one. Clients are not authenticated.
    pub address: SocketAddr,
    /// Origins of the pages that may connect, beside those of this machine.
    pub origins: Vec<String>,
}

/// Serves a domain until `stop` is set; the daemon may come and go meanwhile. `begun` receives the
/// address.
///
/// # Errors
/// [`RecordError`].
pub fn serve(
    options: &LiveOptions,
    stop: &AtomicBool,
    begun: impl FnOnce(SocketAddr),
    mut tell: impl FnMut(&Notice),
) -> Result<(), RecordError> {
    let domain = Domain::join(&options.domain)?;
    let mut ports = ports::free_for_the_loop(&domain)?;
    let mut camera = Camera {
        images: domain.image_subscriber()?,
        failures: Failures::default(),
        has_sent: false,
    };
    let server = Arc::new(Server::default());
    let (runtime, address) = listen(options, &server)?;
    begun(address);
    let channels = Channels {
        clock: WallClock::now(),
        server: Arc::clone(&server),
        open: HashMap::new(),
    };
    let mut live = Recorder::new(channels, APART_NS);
    live.writer.mount = options.mount;
    let mut still = Still {
        scene: options.scene.as_ref().map(|files| files.scene.clone()),
        lives: 0,
        sent: None,
        has_arrived: false,
    };
    while !stop.load(Ordering::Relaxed) {
        for port in &mut ports {
            pass_on(port.as_mut(), &mut live, &mut tell)?;
        }
        camera.pass_on(&mut live)?;
        if let Some(origin) = server.refused() {
            tell(&Notice::Origin { origin });
        }
        still.has_arrived |= server.has_arrived();
        still.pass_on(options, &camera, &mut live, &mut tell)?;
        std::thread::sleep(PAUSE);
    }
    // A client that does not read would not let the server end.
    runtime.shutdown_background();
    Ok(())
}

/// Accepts clients in a thread of the runtime, at the address that is returned.
fn listen(
    options: &LiveOptions,
    server: &Arc<Server>,
) -> Result<(Runtime, SocketAddr), RecordError> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .thread_name("foxglove")
        .enable_all()
        .build()
        .map_err(RecordError::Thread)?;
    let address = options.address;
    let bound = runtime.block_on(async {
        let listener = TcpListener::bind(address).await?;
        let bound = listener.local_addr()?;
        tokio::spawn(Arc::clone(server).accept(listener, options.origins.clone()));
        Ok(bound)
    });
    let bound = bound.map_err(|source| RecordError::Listen { address, source })?;
    Ok((runtime, bound))
}

/// Passes on what waits at a port.
fn pass_on(
    port: &mut dyn Source<Channels>,
    live: &mut Recorder<Channels>,
    tell: &mut impl FnMut(&Notice),
) -> Result<(), RecordError> {
    let mut written = Ok(());
    port.drain(&mut |item| match item(live) {
        Ok(notice) => {
            notice.iter().for_each(&mut *tell);
            true
        }
        Err(error) => {
            written = Err(error);
            false
        }
    })?;
    Ok(written?)
}

/// What stands still: the scene.
struct Still {
    scene: Option<Scene>,
    /// Starts of the daemon up to the one that gave the scene.
    lives: u64,
    /// When the scene was sent.
    sent: Option<Instant>,
    /// Whether a client has subscribed since.
    has_arrived: bool,
}

impl Still {
    /// Sends the scene if it is new or due.
    fn pass_on(
        &mut self,
        options: &LiveOptions,
        camera: &Camera,
        live: &mut Recorder<Channels>,
        tell: &mut impl FnMut(&Notice),
    ) -> Result<(), RecordError> {
        let cycles = live.ledger().of(CycleRecord::TOPIC);
        let is_new = cycles.recorded > 0 && self.lives <= cycles.restarts;
        if is_new {
            self.lives = cycles.restarts + 1;
            if options.scene.is_none() {
                self.scene = daemons(&options.domain, tell);
            }
        }
        let now = Instant::now();
        if !is_new && !is_due(self.sent, now, self.has_arrived) {
            return Ok(());
        }
        (self.sent, self.has_arrived) = (Some(now), false);
        // The wall clock may have been set meanwhile.
        live.writer.sink.clock = WallClock::now();
        if let Some(scene) = &self.scene {
            let wall_ns = live.writer.sink.clock.wall_ns;
            live.draw(scene, wall_ns)?;
            if !camera.has_sent {
                live.draw_image_plane(scene, wall_ns)?;
            }
        }
        Ok(())
    }
}

/// Whether what stands still is to be sent, which it was at `sent`. A client that has arrived since
/// has not received it.
fn is_due(sent: Option<Instant>, now: Instant, has_arrived: bool) -> bool {
    let wait = match has_arrived {
        true => STILL_APART,
        false => STILL_AGAIN,
    };
    sent.is_none_or(|sent| now.duration_since(sent) >= wait)
}

/// The scene that the daemon left in its domain.
fn daemons(domain: &std::path::Path, tell: &mut impl FnMut(&Notice)) -> Option<Scene> {
    match SceneFiles::read(&domain.join(ipc::SCENE_FILE)) {
        Ok(files) => Some(files.scene),
        Err(error) => {
            let reason = error.to_string();
            tell(&Notice::NoScene { reason });
            None
        }
    }
}

/// The camera's images, where a camera sends them.
struct Camera {
    images: ImageSubscriber,
    failures: Failures,
    has_sent: bool,
}

impl Camera {
    /// Passes the newest image on, if the one before is old enough.
    fn pass_on(&mut self, live: &mut Recorder<Channels>) -> Result<(), RecordError> {
        let image = match self.images.latest() {
            Ok(image) => image,
            // One that breaks the contract is not shown.
            Err(ReceiveError::Invalid { .. }) => None,
            Err(error) => return Ok(self.failures.pass_over(error)?),
        };
        self.failures.end();
        let Some(image) = image.filter(|image| image.order() != Order::Repeated) else {
            return Ok(());
        };
        self.has_sent = true;
        let stamp = image.header().stamp;
        let to = &mut live.writer;
        if to.is_due_after(IMAGES_APART_NS, IMAGE, stamp.published_ns) {
            to.draw(IMAGE, &stamp, |at| RawImage {
                timestamp: at,
                ..raw(&image)
            })?;
        }
        Ok(())
    }
}

fn raw(image: &Image) -> RawImage {
    let header = image.header();
    RawImage {
        frame_id: CAMERA.to_owned(),
        width: header.width,
        height: header.height,
        // The contract has the same names.
        encoding: header
            .encoding()
            .map_or_else(String::new, |encoding| encoding.to_string()),
        step: header.stride,
        data: image.to_vec().into(),
        ..RawImage::default()
    }
}

/// The channels of the server.
pub(crate) struct Channels {
    clock: WallClock,
    server: Arc<Server>,
    /// Numbers of the open channels.
    open: HashMap<&'static str, usize>,
}

impl Sink for Channels {
    fn clock(&self) -> WallClock {
        self.clock
    }

    /// Nothing is encoded where nobody has subscribed.
    fn put(
        &mut self,
        topic: &'static str,
        encoding: impl FnOnce() -> Encoding,
        _sequence: u64,
        wall_ns: u64,
        data: impl FnOnce() -> Vec<u8>,
    ) -> Result<(), WriteError> {
        let open = || self.server.open(topic, encoding());
        let channel = *self.open.entry(topic).or_insert_with(open);
        self.server.send(channel, wall_ns, data);
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use messages::{Encoding, ImageHeader};

    use super::*;
    use crate::ports::MOST_FAILURES;

    fn nobody() -> Recorder<Channels> {
        let channels = Channels {
            clock: WallClock::now(),
            server: Arc::default(),
            open: HashMap::new(),
        };
        Recorder::new(channels, APART_NS)
    }

    #[test]
    fn what_stands_still_is_repeated_every_three_seconds() {
        let sent = Instant::now();
        let is_due = |ms, has_arrived| {
            let now = sent + Duration::from_millis(ms);
            super::is_due(Some(sent), now, has_arrived)
        };
        assert!(!is_due(2999, false) && is_due(3000, false));
        assert!(!is_due(999, true) && is_due(1000, true));
        assert!(super::is_due(None, sent, false));
    }

    #[test]
    fn the_server_outlives_looks_for_an_image_that_fail() {
        let directory = tempfile::tempdir().unwrap();
        let domain = Domain::join(directory.path()).unwrap();
        let mut publisher = domain.image_publisher(16).unwrap();
        let mut camera = Camera {
            images: domain.image_subscriber().unwrap(),
            failures: Failures::default(),
            has_sent: false,
        };
        let header = ImageHeader::new(4, 4, Encoding::Mono8, 1);
        let mut send = || {
            let image = publisher.loan(&header).unwrap();
            publisher.publish(image).unwrap();
        };
        let mut live = nobody();
        let mut held = Vec::new();
        // They count in a row: twice as many are too few, with one between that was received.
        for _ in 0..2 {
            // As many as may be held, so that no further one can be received.
            for _ in 0..ImageHeader::PAYLOAD.borrowed() {
                send();
                held.extend(camera.images.latest().unwrap());
            }
            send();
            for _ in 1..MOST_FAILURES {
                camera.pass_on(&mut live).unwrap();
            }
            assert!(!camera.has_sent);
            held.clear();
            camera.pass_on(&mut live).unwrap();
            assert!(std::mem::take(&mut camera.has_sent));
        }
    }
}
