"""A recording seen by others' code: the `mcap` package, JSON Schema, Foxglove's own descriptions of its schemas and
panels. Prints what it found, one line for each message, for the test to compare.

    check.py values FILE    every message of the contract: numbers as the bits of their doubles
    check.py schemas FILE   every message fits its schema; well-known schemas are Foxglove's own
    check.py rest FILE      what can be read of a file that was cut short: topic and count
    check.py layout FILE    a layout's panels and settings are ones that Foxglove's SDK knows
    check.py paths FILE LAYOUT      every topic that a layout names has messages, every path in it a number or a word in each
"""

import json
import re
import struct
import sys

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader


def bits(message, name):
    """A number, or each of a list, as 16 hexadecimal digits; those that JSON cannot carry by their names."""
    special = dict(entry.split("=") for entry in message.get("non_finite", []))

    def one(place, value):
        number = float(special[place]) if place in special else value
        assert isinstance(number, float), (place, number)
        return "nan" if number != number else struct.pack(">d", number).hex()

    value = message.get(name)
    if isinstance(value, list):
        return " ".join(one(f"{name}[{i}]", x) for i, x in enumerate(value))
    return one(name, value)


REALS = {
    "/vpc/features": ["points"],
    "/vpc/twist": ["twist"],
    "/vpc/robot": ["translation", "rotation", "twist", "q", "dq", "commands_in_time"],
    "/vpc/cycles": ["points", "way_point", "twist", "cost", "violation_px", "clearance_px", "error_px"],
    "/vpc/requests": [],
    "/vpc/replies": [],
}
WHOLE = {
    "/vpc/features": ["exposure_ns", "count", "visible"],
    "/vpc/twist": ["features_sequence", "features_published_ns", "valid_until_ns", "state"],
    "/vpc/robot": ["features_sequence", "mode", "faults", "joints"],
    "/vpc/cycles": ["cycle", "step_ns", "hold", "state", "way_point_count"],
    "/vpc/requests": ["id", "action", "strategy", "neighbours"],
    "/vpc/replies": ["id", "action", "outcome", "state"],
}


def values(path):
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        for channel in summary.channels.values():
            count = summary.statistics.channel_message_counts.get(channel.id, 0)
            print("count", channel.topic, count)
        for record in reader.iter_metadata():
            for key, value in sorted(record.metadata.items()):
                print("metadata", record.name, key, value)
        for attachment in reader.iter_attachments():
            print("attachment", attachment.name, attachment.media_type, len(attachment.data))
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.topic not in REALS:
                continue
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            read = json.loads(message.data)
            stamp = read["stamp"]
            assert message.sequence == stamp["sequence"] and message.log_time == message.publish_time
            words = [channel.topic, stamp["sequence"], stamp["published_ns"], stamp["data_ns"]]
            words += [read[name] for name in WHOLE[channel.topic]]
            words += [bits(read, name) for name in REALS[channel.topic]]
            print("message", *words)


def opens(place, schema):
    """Foxglove's parser of JSON schemas knows objects, arrays, oneOf with constants, and single types only."""
    if "oneOf" in schema:
        assert all(isinstance(choice["const"], int) for choice in schema["oneOf"]), place
        return
    kind = schema.get("type")
    assert kind in ("object", "array", "string", "number", "integer", "boolean"), (place, kind)
    if kind == "object":
        for name, field in schema["properties"].items():
            opens(f"{place}.{name}", field)
    if kind == "array":
        assert "contentEncoding" not in schema["items"], place
        opens(f"{place}[]", schema["items"])


def decoder(schema):
    """A function from the bytes of a message to a dict, by the schema in the file alone."""
    if schema.encoding == "jsonschema":
        return json.loads
    from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory

    pool = descriptor_pool.DescriptorPool()
    for proto in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(proto)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))

    def decode(data):
        message = kind.FromString(data)
        assert message.SerializeToString(deterministic=True), schema.name
        return json_format.MessageToDict(message, preserving_proto_field_name=True)

    return decode


def schemas(path):
    import foxglove.messages
    import jsonschema

    decoders, validators, counts = {}, {}, {}
    with open(path, "rb") as file:
        reader = make_reader(file)
        for schema in reader.get_summary().schemas.values():
            decoders[schema.name] = decoder(schema)
            family, name = schema.name.split(".")[:2]
            if family == "foxglove":
                known = getattr(foxglove.messages, name).get_schema()
                assert (schema.encoding, schema.data) == (known.encoding, known.data), schema.name
                counts[schema.name] = 0
                continue
            text = json.loads(schema.data)
            assert text["title"] == schema.name
            opens(schema.name, text)
            validators[schema.name] = jsonschema.Draft202012Validator(text)
        for schema, channel, message in reader.iter_messages():
            read = decoders[schema.name](message.data)
            if schema.name in counts:
                counts[schema.name] += 1
            else:
                validators[schema.name].validate(read)
    for name, count in sorted(counts.items()):
        print("known", name, count)


def rest(path):
    counts, channels = {}, {}
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file).records:
                match type(record).__name__:
                    case "Channel":
                        channels[record.id] = record.topic
                    case "Message":
                        topic = channels[record.channel_id]
                        counts[topic] = counts.get(topic, 0) + 1
        except (McapError, struct.error) as error:
            print("cut", type(error).__name__)
    for topic, count in sorted(counts.items()):
        print("count", topic, count)


PANELS = {
    "Image": ("ImagePanel", "ImageConfig"),
    "3D": ("ThreeDeePanel", "ThreeDeeConfig"),
    "Plot": ("PlotPanel", "PlotConfig"),
    "StateTransitions": ("StateTransitionsPanel", "StateTransitionsConfig"),
    "RosOut": ("LogPanel", "LogConfig"),
}
# Settings whose value is an object with settings of its own.
PARTS = {
    ("ImageConfig", "imageMode"): "ImageModeConfig",
    ("PlotConfig", "paths"): "PlotSeries",
    ("StateTransitionsConfig", "paths"): "StateTransitionsSeries",
    ("ThreeDeeConfig", "cameraState"): "ThreeDeeCameraState",
}
# What exports of the app have beside the SDK's settings.
APP = {"foxglovePanelTitle"}


def build(layouts, kind, settings):
    """Gives settings to the SDK's class, which refuses those that it does not know."""
    arguments = {}
    for key, value in settings.items():
        if key in APP:
            continue
        part = PARTS.get((kind, key))
        if part and isinstance(value, list):
            value = [build(layouts, part, one) for one in value]
        elif part:
            value = build(layouts, part, value)
        arguments[re.sub(r"([A-Z])", lambda m: "_" + m[1].lower(), key)] = value
    made = getattr(layouts, kind)(**arguments)
    unknown = set(settings) - APP - set(made._to_dict())
    assert not unknown, (kind, unknown)
    return made


def panels(tree):
    if isinstance(tree, str):
        return [tree]
    assert set(tree) <= {"first", "second", "direction", "splitPercentage"}, tree.keys()
    assert tree["direction"] in ("row", "column") and 0 < tree["splitPercentage"] < 100
    return panels(tree["first"]) + panels(tree["second"])


def layout(path):
    import foxglove.layouts as layouts

    with open(path, encoding="utf-8") as file:
        whole = json.load(file)
    assert set(whole) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    placed = panels(whole["layout"])
    assert sorted(placed) == sorted(whole["configById"]) and len(set(placed)) == len(placed)
    for identity, settings in whole["configById"].items():
        kind, _ = identity.split("!")
        panel, config = PANELS[kind]
        getattr(layouts, panel)(config=build(layouts, config, settings))
        print("panel", kind)


def texts(tree):
    """Every text in some JSON, keys included."""
    if isinstance(tree, str):
        yield tree
    elif isinstance(tree, list):
        for one in tree:
            yield from texts(one)
    elif isinstance(tree, dict):
        for key, value in tree.items():
            yield key
            yield from texts(value)


def found(message, path):
    """What Foxglove's message path finds: names after dots, indices in brackets."""
    for name, index in re.findall(r"\.(\w+)|\[(\d+)\]", path):
        message = message.get(name) if name else message[int(index)]
        if message is None:
            break
    return message


def paths(path, layout):
    with open(layout, encoding="utf-8") as file:
        named = sorted({text for text in texts(json.load(file)) if text.startswith("/")})
    messages = {}
    with open(path, "rb") as file:
        decoders = {}
        for schema, channel, message in make_reader(file).iter_messages():
            if schema.id not in decoders:
                decoders[schema.id] = decoder(schema)
            messages.setdefault(channel.topic, []).append(decoders[schema.id](message.data))
    for name in named:
        topic = re.match(r"[/\w]+", name)[0]
        heard = messages.get(topic, [])
        values = [found(message, name[len(topic) :]) for message in heard]
        if topic != name:
            values = [value for value in values if isinstance(value, (int, float, str))]
        print("path", name, len(heard), len(values))


functions = {"values": values, "schemas": schemas, "rest": rest, "layout": layout, "paths": paths}
functions[sys.argv[1]](*sys.argv[2:])
