// Foxglove's own client of its WebSocket; messages are read by the schemas that the server advertises, and by nothing else.
// Subscribes to every channel and prints a line of JSON for each event, until SIGTERM.
//
//     client.cjs URL          reads all
//     client.cjs URL deaf     subscribes, and then reads nothing more

const { FoxgloveClient } = require("@foxglove/ws-protocol");
const protobuf = require("protobufjs");
const { FileDescriptorSet } = require("protobufjs/ext/descriptor");
const WebSocket = require("ws");

const [url, manner] = process.argv.slice(2);

// Integers beyond a double's 53 bits as text; of bytes their number and their sum.
function plain(_, value) {
  if (typeof value === "bigint") return value.toString();
  if (value instanceof Uint8Array) return { bytes: value.length, sum: value.reduce((sum, byte) => sum + byte, 0) };
  return value;
}

function say(event) {
  process.stdout.write(JSON.stringify(event, plain) + "\n");
}

function protobufReader(schema, name) {
  const set = FileDescriptorSet.decode(Buffer.from(schema, "base64"));
  const type = protobuf.Root.fromDescriptor(set).resolveAll().lookupType(name);
  return (bytes) => type.toObject(type.decode(bytes), { longs: String, enums: String, defaults: true });
}

function jsonReader(bytes) {
  return JSON.parse(new TextDecoder().decode(bytes));
}

const socket = new WebSocket(url, ["foxglove.sdk.v1"]);
const client = new FoxgloveClient({ ws: socket });
const subscriptions = new Map();

client.on("open", () => say({ event: "open", protocol: socket.protocol }));
client.on("serverInfo", (info) => say({ event: "server", ...info }));
client.on("status", (status) => say({ event: "status", ...status }));
client.on("error", (error) => say({ event: "error", message: String(error.message ?? error) }));
client.on("close", () => {
  say({ event: "close" });
  process.exit(0);
});
client.on("advertise", (channels) => {
  for (const channel of channels) {
    const { id, topic, encoding, schemaName, schemaEncoding, schema } = channel;
    const read = schemaEncoding === "protobuf" ? protobufReader(schema, schemaName) : jsonReader;
    subscriptions.set(client.subscribe(id), { topic, read });
    say({ event: "channel", topic, encoding, schemaName, schema: schemaEncoding === "jsonschema" ? schema : "" });
  }
  if (manner === "deaf") setTimeout(() => socket.pause(), 500);
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const { topic, read } = subscriptions.get(subscriptionId);
  const bytes = new Uint8Array(data.buffer, data.byteOffset, data.byteLength);
  say({ event: "message", topic, time: timestamp, value: read(bytes) });
});
process.on("SIGTERM", () => client.close());
