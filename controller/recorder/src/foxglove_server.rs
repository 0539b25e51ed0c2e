//! Foxglove's WebSocket protocol `foxglove.sdk.v1`, as much of it as clients need that only read.
//!
//! The SDK's own server neither asks for a page's origin nor bounds what a client that does not
//! read makes it hold. Source: github.com/foxglove/ws-protocol, `docs/spec.md`.

use std::collections::{BTreeMap, VecDeque};
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use base64::prelude::{BASE64_STANDARD, Engine};
use futures_util::{SinkExt, StreamExt};
use recording::Encoding;
use serde::Deserialize;
use serde_json::json;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Notify, Semaphore};
use tokio_tungstenite::accept_hdr_async_with_config;
use tokio_tungstenite::tungstenite::handshake::server::{ErrorResponse, Request, Response};
use tokio_tungstenite::tungstenite::http::header::{HeaderValue, ORIGIN, SEC_WEBSOCKET_PROTOCOL};
use tokio_tungstenite::tungstenite::http::{StatusCode, Uri};
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{Error, Message};

use crate::scenery::IMAGE;

const PROTOCOL: &str = "foxglove.sdk.v1";
/// Most clients; further ones wait to be accepted.
const CLIENTS: usize = 16;
/// Messages that wait for one client. Of images only the newest waits, whatever its size.
const BACKLOG: usize = 64;
/// How long a client may take to open the connection.
const PATIENCE: Duration = Duration::from_secs(5);
/// Longest message of a client, bytes.
const LONGEST: usize = 64 * 1024;
/// Pause after a connection that could not be accepted, for instance for want of descriptors.
const PAUSE: Duration = Duration::from_millis(100);

/// The channels and the clients of a server.
#[derive(Debug, Default)]
pub(crate) struct Server(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    /// Topic and announcement of each channel; its index is its number.
    channels: Vec<(&'static str, String)>,
    clients: BTreeMap<SocketAddr, Client>,
    /// Whether somebody has subscribed since the last look.
    has_arrived: bool,
    /// The last origin that was refused, until it is told.
    refused: Option<String>,
}

#[derive(Debug, Default)]
struct Client {
    /// Numbers that the client chose, by channel.
    subscriptions: BTreeMap<usize, u32>,
    queue: Queue,
    wake: Arc<Notify>,
}

/// A message of a topic; its data are shared by the clients.
#[derive(Clone, Debug)]
struct Data {
    channel: usize,
    is_image: bool,
    time_ns: u64,
    bytes: Arc<[u8]>,
}

/// What waits for a client.
#[derive(Debug, Default)]
struct Queue {
    /// Announcements, none of which is dropped: one for each channel.
    announced: VecDeque<String>,
    data: VecDeque<Data>,
}

impl Queue {
    /// Adds a message. An image takes the place of the one that waits; of more than [`BACKLOG`]
    /// messages the oldest is dropped.
    fn push(&mut self, data: Data) {
        if data.is_image {
            self.data.retain(|waiting| !waiting.is_image);
        }
        if self.data.len() == BACKLOG {
            self.data.pop_front();
        }
        self.data.push_back(data);
    }
}

impl Server {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Opens a channel and returns its number.
    pub(crate) fn open(&self, topic: &'static str, encoding: Encoding) -> usize {
        let mut state = self.state();
        let id = state.channels.len();
        let Encoding { schema, message } = encoding;
        let (name, kind, data) = schema;
        let text = match kind.as_str() {
            "protobuf" | "flatbuffer" => BASE64_STANDARD.encode(data),
            _ => String::from_utf8_lossy(&data).into_owned(),
        };
        let channel = json!({"id": id, "topic": topic, "encoding": message, "schemaName": name,
            "schemaEncoding": kind, "schema": text});
        let announcement = json!({"op": "advertise", "channels": [channel]}).to_string();
        for client in state.clients.values_mut() {
            client.queue.announced.push_back(announcement.clone());
            client.wake.notify_one();
        }
        state.channels.push((topic, announcement));
        id
    }

    /// Sends a message to the subscribers of its channel; it is made only if there are any.
    pub(crate) fn send(&self, channel: usize, time_ns: u64, data: impl FnOnce() -> Vec<u8>) {
        let subscribes = |client: &Client| client.subscriptions.contains_key(&channel);
        if !self.state().clients.values().any(subscribes) {
            return;
        }
        let bytes = data().into();
        let mut state = self.state();
        let is_image = state
            .channels
            .get(channel)
            .is_some_and(|(topic, _)| *topic == IMAGE);
        let data = Data {
            channel,
            is_image,
            time_ns,
            bytes,
        };
        for client in state
            .clients
            .values_mut()
            .filter(|client| subscribes(client))
        {
            client.queue.push(data.clone());
            client.wake.notify_one();
        }
    }

    /// Whether somebody has subscribed since the last call.
    pub(crate) fn has_arrived(&self) -> bool {
        std::mem::take(&mut self.state().has_arrived)
    }

    /// The last origin that was refused since the last call.
    pub(crate) fn refused(&self) -> Option<String> {
        self.state().refused.take()
    }

    /// Accepts clients without end; `origins` are those of the pages that may connect beside pages
    /// of this machine.
    pub(crate) async fn accept(self: Arc<Self>, listener: TcpListener, origins: Vec<String>) {
        let (origins, places) = (Arc::new(origins), Arc::new(Semaphore::new(CLIENTS)));
        while let Ok(place) = Arc::clone(&places).acquire_owned().await {
            let Ok((stream, address)) = listener.accept().await else {
                tokio::time::sleep(PAUSE).await;
                continue;
            };
            let (server, origins) = (Arc::clone(&self), Arc::clone(&origins));
            tokio::spawn(async move {
                // A client that left or talks nonsense is its own affair.
                let _ = server.converse(stream, address, &origins).await;
                server.state().clients.remove(&address);
                drop(place);
            });
        }
    }

    async fn converse(
        &self,
        stream: TcpStream,
        address: SocketAddr,
        origins: &[String],
    ) -> Result<(), Error> {
        stream.set_nodelay(true)?;
        let bounds = WebSocketConfig::default()
            .max_message_size(Some(LONGEST))
            .max_frame_size(Some(LONGEST));
        #[allow(clippy::result_large_err)] // as the library asks for
        let check = |request: &Request, response| self.admit(request, response, origins);
        let opened = accept_hdr_async_with_config(stream, check, Some(bounds));
        let Ok(socket) = tokio::time::timeout(PATIENCE, opened).await else {
            return Ok(());
        };
        let (mut sink, mut source) = socket?.split();
        let session = SystemTime::now().duration_since(UNIX_EPOCH);
        let session = session.unwrap_or_default().as_millis().to_string();
        let info = json!({"op": "serverInfo", "name": "vpcd", "capabilities": [],
            "sessionId": session});
        sink.send(Message::text(info.to_string())).await?;
        let wake = self.welcome(address);
        let write = async {
            loop {
                match self.next(address) {
                    Some(message) => sink.send(message).await?,
                    None => wake.notified().await,
                }
            }
        };
        let read = async {
            while let Some(message) = source.next().await {
                if let Message::Text(text) = message? {
                    self.obey(address, &text);
                }
            }
            Ok(())
        };
        tokio::select! {
            result = write => result,
            result = read => result,
        }
    }

    /// Takes a client in.
    fn welcome(&self, address: SocketAddr) -> Arc<Notify> {
        let mut state = self.state();
        let mut client = Client::default();
        let channels = state.channels.iter().map(|(_, channel)| channel.clone());
        client.queue.announced.extend(channels);
        let wake = Arc::clone(&client.wake);
        state.clients.insert(address, client);
        wake
    }

    /// The next message to a client.
    fn next(&self, address: SocketAddr) -> Option<Message> {
        let (subscription, data) = {
            let mut state = self.state();
            let client = state.clients.get_mut(&address)?;
            if let Some(text) = client.queue.announced.pop_front() {
                return Some(Message::text(text));
            }
            loop {
                let data = client.queue.data.pop_front()?;
                // Otherwise it has unsubscribed meanwhile.
                if let Some(&subscription) = client.subscriptions.get(&data.channel) {
                    break (subscription, data);
                }
            }
        };
        let mut bytes = Vec::with_capacity(13 + data.bytes.len());
        bytes.push(1);
        bytes.extend_from_slice(&subscription.to_le_bytes());
        bytes.extend_from_slice(&data.time_ns.to_le_bytes());
        bytes.extend_from_slice(&data.bytes);
        Some(Message::binary(bytes))
    }

    /// Subscribes and unsubscribes; nothing else is obeyed.
    fn obey(&self, address: SocketAddr, text: &str) {
        let Ok(order) = serde_json::from_str(text) else {
            return;
        };
        let mut state = self.state();
        let channels = state.channels.len();
        let Some(client) = state.clients.get_mut(&address) else {
            return;
        };
        match order {
            Order::Subscribe { subscriptions } => {
                let known = subscriptions.iter().filter(|s| s.channel_id < channels);
                let known = known.map(|s| (s.channel_id, s.id));
                client.subscriptions.extend(known);
                state.has_arrived = true;
            }
            Order::Unsubscribe { subscription_ids } => {
                let ended = |id: &u32| subscription_ids.contains(id);
                client.subscriptions.retain(|_, id| !ended(id));
            }
        }
    }

    #[allow(clippy::result_large_err)] // as the library asks for
    fn admit(
        &self,
        request: &Request,
        mut response: Response,
        origins: &[String],
    ) -> Result<Response, ErrorResponse> {
        let refusal = |status, reason: String| {
            let mut refusal = ErrorResponse::new(Some(reason));
            *refusal.status_mut() = status;
            refusal
        };
        let headers = request.headers();
        let found: Vec<_> = headers.get_all(ORIGIN).iter().collect();
        // Programs send none; browsers send one in any case.
        let is_allowed = match found[..] {
            [] => true,
            [origin] => origin
                .to_str()
                .is_ok_and(|origin| is_allowed(origin, origins)),
            _ => false,
        };
        if !is_allowed {
            let origin = format!("{:.200}", String::from_utf8_lossy(found[0].as_bytes()));
            let reason = format!("origin not allowed: {origin}\n");
            self.state().refused = Some(origin);
            return Err(refusal(StatusCode::FORBIDDEN, reason));
        }
        let offered = headers.get_all(SEC_WEBSOCKET_PROTOCOL).iter();
        let mut offered = offered.flat_map(|names| names.to_str().unwrap_or_default().split(','));
        if !offered.any(|name| name.trim() == PROTOCOL) {
            let reason = format!("Sec-WebSocket-Protocol: allowed: {PROTOCOL}\n");
            return Err(refusal(StatusCode::BAD_REQUEST, reason));
        }
        let protocol = HeaderValue::from_static(PROTOCOL);
        response
            .headers_mut()
            .insert(SEC_WEBSOCKET_PROTOCOL, protocol);
        Ok(response)
    }
}

/// What a client may ask for.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
enum Order {
    Subscribe { subscriptions: Vec<Subscription> },
    Unsubscribe { subscription_ids: Vec<u32> },
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: usize,
}

/// Whether a page of this origin may connect: one of this machine, or one that is listed.
fn is_allowed(origin: &str, listed: &[String]) -> bool {
    if listed.iter().any(|listed| listed == origin) {
        return true;
    }
    let Ok(uri) = origin.parse::<Uri>() else {
        return false;
    };
    let is_page = matches!(uri.scheme_str(), Some("http" | "https"));
    let Some(authority) = uri.authority().filter(|_| is_page) else {
        return false;
    };
    let host = authority.host().trim_matches(['[', ']']);
    let is_local = host == "localhost" || host.parse().is_ok_and(|ip: IpAddr| ip.is_loopback());
    is_local && !authority.as_str().contains('@')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_pages_of_this_machine_and_listed_ones_may_connect() {
        let listed = ["https://app.foxglove.dev".to_owned()];
        for origin in [
            "http://localhost:8080",
            "https://127.0.0.1",
            "http://[::1]:1",
            &listed[0],
        ] {
            assert!(is_allowed(origin, &listed), "{origin}");
        }
        for origin in [
            "null",
            "",
            "file://",
            "http://evil.example",
            "https://app.foxglove.dev.evil.example",
            "http://localhost.evil.example",
            "http://localhost@evil.example",
            "http://evil@localhost",
            "ftp://localhost",
            "http://192.168.1.1",
        ] {
            assert!(!is_allowed(origin, &listed), "{origin}");
        }
    }

    #[test]
    fn only_the_newest_image_and_64_messages_wait() {
        let mut queue = Queue::default();
        for time_ns in 0..1000 {
            let (is_image, bytes) = (time_ns % 10 == 0, [].into());
            queue.push(Data {
                channel: 0,
                is_image,
                time_ns,
                bytes,
            });
        }
        assert_eq!(queue.data.len(), BACKLOG);
        let images: Vec<_> = queue.data.iter().filter(|data| data.is_image).collect();
        assert_eq!((images.len(), images[0].time_ns), (1, 990));
        assert_eq!(queue.data[BACKLOG - 1].time_ns, 999);
    }
}
