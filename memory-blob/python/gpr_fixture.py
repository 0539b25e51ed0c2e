#!/usr/bin/env python3
"""Writes ../fixtures/gpr.json: what scikit-learn predicts for one given kernel, mean and latent deviation of each output.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt
    venv/bin/python gpr_fixture.py

Inputs are raw (px, px^2, rad); scikit-learn sees (x - offset) / scale, so that the fixture holds the scaling too. The
Rust test solves for the weights itself: it takes nothing from here but the data, the kernel and the answers.
"""

import json
import pathlib

import numpy
import sklearn
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

SEED = 20240612
SAMPLES, INPUTS, OUTPUTS, QUERIES = 60, 10, 14, 20


def main():
    rng = numpy.random.default_rng(SEED)
    offset = numpy.array([320.0, 240.0] * 4 + [8000.0, 0.0])
    scale = numpy.array([300.0] * 8 + [10000.0, 1.0])
    latent = rng.normal(size=(SAMPLES, INPUTS))
    x = offset + scale * latent
    queries = offset + scale * rng.normal(size=(QUERIES, INPUTS))
    mean = numpy.concatenate([numpy.zeros(6), [260.0, 180.0, 380.0, 180.0, 380.0, 300.0, 260.0, 300.0]])
    size = numpy.concatenate([numpy.full(6, 0.2), numpy.full(8, 80.0)])
    y = mean + size * numpy.sin(latent @ rng.normal(scale=0.4, size=(INPUTS, OUTPUTS)))

    lengths = numpy.linspace(0.8, 3.5, INPUTS)
    signal, noise = 1.3, 0.01
    kernel = ConstantKernel(signal) * RBF(lengths) + WhiteKernel(noise)
    # alpha is scikit-learn's own jitter, 0 here: the white kernel is the only noise
    fitted = GaussianProcessRegressor(kernel, alpha=0.0, optimizer=None).fit((x - offset) / scale, (y - mean) / size)
    predicted, deviation = fitted.predict((queries - offset) / scale, return_std=True)
    # the white kernel counts towards the deviation of a query: ours is of the latent function
    latent_deviation = numpy.sqrt(deviation[:, 0] ** 2 - noise)

    document = {
        "scikit_learn": sklearn.__version__,
        "numpy": numpy.__version__,
        "seed": SEED,
        "offset": offset.tolist(),
        "scale": scale.tolist(),
        "inputs": x.tolist(),
        "outputs": y.tolist(),
        "output_mean": mean.tolist(),
        "output_size": size.tolist(),
        "length_scale": lengths.tolist(),
        "signal_variance": signal,
        "noise_variance": noise,
        "queries": queries.tolist(),
        "mean": (mean + size * predicted).tolist(),
        "deviation": (latent_deviation[:, None] * size).tolist(),
    }
    path = pathlib.Path(__file__).resolve().parent.parent / "fixtures" / "gpr.json"
    path.write_text(json.dumps(document) + "\n")
    print(f"{path}: deviations {latent_deviation.min():.3f} to {latent_deviation.max():.3f}")


if __name__ == "__main__":
    main()
