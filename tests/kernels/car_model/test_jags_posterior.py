"""The sampler against JAGS on the same graph and data: posterior means, deviations and edge probabilities."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tilepipe_kernels.car_model.convergence import effective_sample_size, split_rhat
from tilepipe_kernels.car_model.model import CarModel, Priors
from tilepipe_kernels.car_model.sampler import sample

RECORDED = json.loads((Path(__file__).parent / "jags_posterior.json").read_text())
DRAWS = 20_000


@pytest.mark.parametrize("case", range(len(RECORDED["cases"])))
def test_agrees_with_jags(case: int) -> None:
    graph, found = RECORDED["graph"], RECORDED["cases"][case]
    edges = np.array(graph["edges"], np.int32)
    weights = np.array(graph["weights"][found["weights"]], np.float32)
    data = (np.array(values, float) for values in (graph["count"], found["mean"], found["spread"]))
    model = CarModel(edges, weights, *data, priors=Priors())
    posterior = sample(model, burn_in=500, draws=DRAWS, tolerance=RECORDED["tolerance"], seed=3)
    expected = found["posterior"]
    for trace, name in ((posterior.smoothness, "v"), (posterior.noise, "s2")):
        assert split_rhat(trace) < 1.01
        error = np.hypot(trace.std() / np.sqrt(effective_sample_size(trace)), expected[name]["mean_error"])
        assert abs(trace.mean() - expected[name]["mean"]) < 5 * error
        assert trace.std() == pytest.approx(expected[name]["sd"], rel=0.1)
    x = expected["x"]
    # draws of the heights are nearly independent: the pixels decide; a factor of three leaves room
    error = np.hypot(3 * posterior.sd / np.sqrt(DRAWS), x["mean_error"])
    assert (np.abs(posterior.mean - np.array(x["mean"])) < 5 * error).all()
    np.testing.assert_allclose(posterior.sd, x["sd"], rtol=0.06)
    close = expected["close"]
    assert posterior.same is not None
    np.testing.assert_allclose(posterior.same, close["probability"], atol=0.02)
