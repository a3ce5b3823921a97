"""Reconciliation of `objects` on the device: the regions, heights and probabilities of the host."""

from __future__ import annotations

import numpy as np
import pytest

from tests.kernels.regions.test_merging import random_graph
from tilepipe.pipelines.objects.parameters import BorderWeights, ObjectParameters
from tilepipe.pipelines.objects.reconcile_regions import merge_regions


@pytest.mark.parametrize("border_weights", ["adjacency", "border", "contrast"])
def test_merged_regions_are_those_of_the_host(border_weights: BorderWeights) -> None:
    graph, _ = random_graph(5, 12)
    parameters = ObjectParameters(
        burn_in=1, draws=4, merge_height=1.0, merge_probability=0.3, minimum_area=3.0, border_weights=border_weights
    )  # fmt: skip
    sites = np.arange(12) * 3
    host, device = (
        merge_regions(graph, sites, parameters, resolution=1.0, backend=backend) for backend in ("numpy", "cupy")
    )
    assert host.rounds == device.rounds >= 1
    for name in ("region", "probability", "mean", "deviation"):
        assert type(getattr(device, name)) is np.ndarray
        np.testing.assert_array_equal(getattr(device, name), getattr(host, name), err_msg=name)
    np.testing.assert_array_equal(device.graph.edges, host.graph.edges)
    np.testing.assert_array_equal(device.graph.statistics.spread, host.graph.statistics.spread)
