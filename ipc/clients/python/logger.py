#!/usr/bin/env python3
"""Logs a domain to pandas: a table each of features, twists and cycles, and where the time went.

    pip install -r ipc/clients/python/requirements-logger.txt
    python3 ipc/clients/python/logger.py --seconds 10 --out log        # log/features.csv, log/twist.csv, log/cycles.csv
    pip install -r ipc/clients/python/requirements-parquet.txt                        # for --format parquet
    python3 ipc/clients/python/logger.py --seconds 10 --out log --format parquet

Arrays become columns: points_0 is u of the first point, points_1 its v. Codes stay numbers; CONTRACT.md and
vpc_client.messages have their words. Starts at once and ends after --seconds, or after --cycles of the controller.
"""

import argparse
import importlib.util
import pathlib
import sys
import time

import vpc_client

try:
    import pandas
except ImportError:
    sys.exit("logger: pandas is missing; pip install -r ipc/clients/python/requirements-logger.txt")

SERVICES = ("vpc/features", "vpc/twist", "vpc/cycles")
PERCENTILES = (0.5, 0.95, 0.99, 1.0)


def row(message, head=""):
    """A message as columns."""
    columns = {}
    for name, _ in message._fields_:
        value = getattr(message, name)
        if isinstance(value, vpc_client.Stamp):
            # The head of the message has no prefix; other stamps are of what it refers to.
            columns.update(row(value, head if name == "stamp" else f"{head}{name}_"))
        elif hasattr(value, "__len__"):
            columns.update({f"{head}{name}_{i}": number for i, number in enumerate(value)})
        else:
            columns[head + name] = value
    return columns


def log(domain, seconds, cycles):
    """Everything that comes, as a table for each service, and how many messages were refused."""
    subscribers = {name: domain.subscribe(name) for name in SERVICES}
    print("logging", flush=True)
    rows = {name: [] for name in SERVICES}
    refused = 0
    end = time.monotonic() + seconds
    enough = False
    while not enough:
        # Once more after the last cycle: what it answers and what answered it were sent before it.
        enough = time.monotonic() >= end or len(rows["vpc/cycles"]) >= cycles
        for name, subscriber in subscribers.items():
            while True:
                try:
                    message = subscriber.receive()
                except vpc_client.BadMessage as error:
                    print(f"logger: {error}", file=sys.stderr)
                    refused += 1
                    continue
                if message is None:
                    break
                rows[name].append(row(message))
        time.sleep(1e-3)
    return {name: pandas.DataFrame(each) for name, each in rows.items()}, refused


def missed(table):
    """Messages that lie between those of a table; a publisher that restarted begins anew."""
    gaps = table["sequence"].diff().iloc[1:] - 1 if len(table) else table.get("sequence", [])
    return int(gaps[gaps > 0].sum()) if len(gaps) else 0


def latencies(tables):
    """Where the time went, us: one line a quantity, a column a percentile."""
    cycles, features = tables["vpc/cycles"], tables["vpc/features"]
    columns = {}
    if len(cycles):
        for name in ("wake_latency_ns", "receive_ns", "step_ns", "send_ns", "features_age_ns"):
            columns[name.removesuffix("_ns")] = cycles[name] / 1e3
    if len(features) and len(tables["vpc/twist"]):
        # A twist names what it answers by number and time of publication.
        answers = tables["vpc/twist"].merge(
            features,
            left_on=["features_sequence", "features_published_ns"],
            right_on=["sequence", "published_ns"],
            suffixes=("", "_features"),
        )
        columns["features to twist"] = (answers["published_ns"] - answers["published_ns_features"]) / 1e3
    return pandas.DataFrame({name: each.quantile(list(PERCENTILES)) for name, each in columns.items()}).T


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domain", help=f"directory of the domain [{vpc_client.default_directory()}]")
    parser.add_argument("--seconds", type=float, default=10.0, help="end after this time [%(default)s]")
    parser.add_argument("--cycles", type=float, default=float("inf"), help="end after this many cycles")
    parser.add_argument("--out", default="log", help="directory of the tables [%(default)s]")
    parser.add_argument("--format", choices=("csv", "parquet"), default="csv", help="[%(default)s]")
    arguments = parser.parse_args()
    if arguments.format == "parquet" and importlib.util.find_spec("pyarrow") is None:
        # Before anything is logged, not after.
        sys.exit("logger: pyarrow is missing; pip install -r ipc/clients/python/requirements-parquet.txt")
    with vpc_client.Domain(arguments.domain) as domain:
        tables, refused = log(domain, arguments.seconds, arguments.cycles)
    out = pathlib.Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    for name, table in tables.items():
        path = out / f"{name.removeprefix('vpc/')}.{arguments.format}"
        if arguments.format == "csv":
            table.to_csv(path, index=False)
        else:
            table.to_parquet(path, index=False, engine="pyarrow")
        print(f"{path}: {len(table)} messages, {missed(table)} missed")
    if refused:
        print(f"{refused} messages broke the contract and are not in the tables")
    report = latencies(tables)
    if len(report):
        report.columns = [f"p{100 * p:g}" if p < 1 else "max" for p in PERCENTILES]
        print(f"\nlatencies, us\n{report.to_string(float_format='%.1f')}")
    return 0 if len(tables["vpc/cycles"]) else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except vpc_client.VpcError as error:
        sys.exit(f"logger: {error}")
    except KeyboardInterrupt:
        sys.exit(130)
