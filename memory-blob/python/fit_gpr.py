#!/usr/bin/env python3
"""Refits the Gaussian process of a memory with scikit-learn and writes a complete memory file.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt
    venv/bin/python fit_gpr.py IN.vpcmem OUT.vpcmem

Reads and writes with stock safetensors, following ../FORMAT.md; what `vpc-memory verify OUT` accepts, `vpcd` runs. The
samples stay as they are, byte for byte; tensors `gpr.*`, probes and digests are new. This script computes the answers of the
probes with scikit-learn and an exhaustive search, so a reader that accepts the file agrees with both.
"""

import argparse
import hashlib
import json
import os
import time

import numpy
import sklearn
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

FAR = 1e150  # fills rows of no sample; far from every query, and finite when squared
LANES = 8  # rows of the process in a block
TWIST = 6  # entries of an output before the way point
PROBES = 8
SCHEMA = "3"


def up(count, of):
    return -(-count // of) * of


def padded(rows, shape, fill):
    """`rows` in the low corner of an array of `shape`."""
    whole = numpy.full(shape, fill)
    whole[tuple(slice(0, size) for size in rows.shape)] = rows
    return whole


class Memory:
    """The samples of a file: scaled inputs, raw outputs, and where they come from, in the order of the file."""

    def __init__(self, path):
        self.tensors = load_file(path)
        with safe_open(path, "numpy") as file:
            self.metadata = file.metadata()
        if self.metadata.get("format") != "vpc-memory" or self.metadata.get("schema") != SCHEMA:
            raise SystemExit(f"{path}: format and schema are not vpc-memory and {SCHEMA}")
        n, p, count = (int(self.metadata[key]) for key in ("inputs", "outputs", "samples"))
        self.offset, self.scale = self.tensors["scaling"][:, :n]
        self.x = self.tensors["samples.x"].transpose(0, 2, 1).reshape(-1, n)[:count]
        self.y = self.tensors["samples.y"][:count, :p]
        self.trajectory, self.step = self.tensors["samples.origin"][:, :count]

    def constant_mean(self):
        """m = (0, s*): that of the file's process, or, where it has none, the way points at the ends of trajectories,
        which come to rest at the goal."""
        p = self.y.shape[1]
        if "gpr.mean" in self.tensors:
            return self.tensors["gpr.mean"][:p]
        order = numpy.lexsort((self.step, self.trajectory))
        last = order[numpy.append(numpy.diff(self.trajectory[order]) != 0, True)]
        return numpy.concatenate([numpy.zeros(TWIST), numpy.median(self.y[last, TWIST:], axis=0)])


def fit(memory, arguments):
    """The process over a sub-sample: hyper-parameters by likelihood on some of its rows, weights on all of them."""
    rng = numpy.random.default_rng(arguments.seed)
    count = min(arguments.samples, len(memory.x))
    # evenly along all trajectories, in the order of time
    order = numpy.lexsort((memory.step, memory.trajectory))
    kept = order[numpy.linspace(0, len(order) - 1, count).round().astype(int)]
    x, mean = memory.x[kept], memory.constant_mean()
    residual = memory.y[kept] - mean
    size = numpy.sqrt((residual**2).mean(axis=0))
    size[size == 0.0] = 1.0  # an output that never leaves its mean has no size to learn from

    free = ConstantKernel(1.0, (1e-2, 1e4)) * RBF(numpy.ones(x.shape[1]), (1e-2, 1e3)) + WhiteKernel(1e-2, (1e-6, 1e1))
    some = rng.permutation(count)[: arguments.likelihood_samples]
    search = GaussianProcessRegressor(free, n_restarts_optimizer=arguments.restarts, random_state=arguments.seed)
    kernel = search.fit(x[some], residual[some] / size).kernel_
    # alpha is scikit-learn's own jitter, 0 here: the white kernel is the only noise
    process = GaussianProcessRegressor(kernel, alpha=0.0, optimizer=None).fit(x, residual / size)
    return process, x, mean, size


def nearest(memory, queries):
    """The answers of 1-NN, by comparing with every sample."""
    rows = [((memory.x - query) ** 2).sum(axis=1).argmin() for query in queries]
    return memory.y[rows]


def probes(memory, process, mean, size, rng):
    """Inputs between two samples each, inside the data and on no sample, and the answers to them."""
    pairs = rng.integers(len(memory.x), size=(PROBES, 2))
    raw = memory.offset + memory.scale * (memory.x[pairs[:, 0]] + (memory.x[pairs[:, 1]] - memory.x[pairs[:, 0]]) / 3)
    scaled = (raw - memory.offset) / memory.scale
    n8, p8 = up(raw.shape[1], 8), up(len(mean), 8)
    return {
        "probes.x": padded(raw, (PROBES, n8), 0.0),
        "probes.knn": padded(nearest(memory, scaled), (PROBES, p8), 0.0),
        "probes.gpr": padded(mean + size * process.predict(scaled), (PROBES, p8), 0.0),
    }


def process_tensors(process, x, mean, size, with_factor):
    count, n = x.shape
    lengths = process.kernel_.k1.k2.length_scale
    blocks, n8, p8 = up(count, LANES) // LANES, up(n, 8), up(len(mean), 8)
    rows = padded(x / lengths, (blocks * LANES, n), FAR)
    tensors = {
        "gpr.x": rows.reshape(blocks, LANES, n).transpose(0, 2, 1),
        "gpr.lambda": padded(process.alpha_ * size, (blocks * LANES, p8), 0.0),
        "gpr.length_scale": padded(lengths, (n8,), 1.0),
        "gpr.mean": padded(mean, (p8,), 0.0),
        "gpr.output_scale": padded(size, (p8,), 1.0),
    }
    if with_factor:
        packed = process.L_[numpy.tril_indices(count)]
        tensors["gpr.cholesky"] = padded(packed, (up(len(packed), 8),), 0.0)
    return tensors


def digest(metadata, tensors):
    """Of the whole header, as FORMAT.md says."""
    by_bytes = lambda name: name.encode()
    lines = [f"{key}={metadata[key]}\n" for key in sorted(metadata, key=by_bytes)]
    lines += [f"{name}:[{','.join(map(str, tensors[name].shape))}]\n" for name in sorted(tensors, key=by_bytes)]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def write(path, tensors, metadata):
    # the writer of safetensors 0.8.0 stores arrays in Fortran order as if they were in C order, without an error
    tensors = {name: numpy.ascontiguousarray(data, dtype="<f8") for name, data in tensors.items()}
    for name, data in tensors.items():
        metadata[f"sha256.{name}"] = hashlib.sha256(data.tobytes()).hexdigest()
    metadata["digest"] = digest(metadata, tensors)
    beside = f"{path}.{os.getpid()}.tmp"
    try:
        save_file(tensors, beside, metadata)
        back = load_file(beside)
        for name, data in tensors.items():
            if not numpy.array_equal(back[name], data):
                raise SystemExit(f"{path}: tensor {name} is not read back as it was written")
        os.replace(beside, path)
    finally:
        if os.path.exists(beside):
            os.remove(beside)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", help="memory whose samples are fitted")
    parser.add_argument("target", help="memory to write")
    parser.add_argument("--samples", type=int, default=800, help="rows of the process (800)")
    parser.add_argument("--likelihood-samples", type=int, default=250, help="rows that choose the kernel (250)")
    parser.add_argument("--restarts", type=int, default=1, help="further starts of that search (1)")
    parser.add_argument("--seed", type=int, default=1, help="of sub-sampling, restarts and probes (1)")
    parser.add_argument("--no-variance", action="store_true", help="leave out the factor for variances")
    arguments = parser.parse_args()

    memory = Memory(arguments.source)
    begin = time.monotonic()
    process, x, mean, size = fit(memory, arguments)
    seconds = time.monotonic() - begin
    tensors = {name: data for name, data in memory.tensors.items() if not name.startswith(("gpr.", "probes."))}
    tensors |= process_tensors(process, x, mean, size, not arguments.no_variance)
    tensors |= probes(memory, process, mean, size, numpy.random.default_rng(arguments.seed))

    kept = ("format", "task", "inputs", "outputs", "samples")
    metadata = {key: memory.metadata[key] for key in kept}
    provenance = json.loads(memory.metadata.get("provenance", "{}"))
    provenance["refit"] = {"tool": f"fit_gpr.py, scikit-learn {sklearn.__version__}", "seed": arguments.seed}
    metadata |= {
        "schema": SCHEMA,
        "gpr_samples": str(len(x)),
        "kernel": "rbf",
        "signal_variance": repr(float(process.kernel_.k1.k1.constant_value)),
        "noise_variance": repr(float(process.kernel_.k2.noise_level)),
        "provenance": json.dumps(provenance),
    }
    write(arguments.target, tensors, metadata)
    print(f"{arguments.target}: {len(memory.x)} samples, {len(x)} in the process, {seconds:.1f} s, {process.kernel_}")


if __name__ == "__main__":
    main()
