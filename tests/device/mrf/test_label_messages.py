"""Messages on the device: the beliefs of the oracle, the labels of the CPU, bands that do not show."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.kernels.mrf.test_labels import costs
from tests.naive.mrf.labels import Problem
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.mrf.labels import messages
from tilepipe_kernels.mrf.labels.messages import message_labels
from tilepipe_kernels.mrf.labels.problem import labelling
from tilepipe_kernels.mrf.labels.scales import coarser

MISSING = 0.15
"""Share of pixels without data."""


def uploaded(problem: dict[str, Any]) -> dict[str, Any]:
    return {name: to_device(array) for name, array in problem.items()}


@pytest.mark.parametrize(("labels", "kinds", "weighted", "origin"),
                         [(2, 1, False, (0, 0)), (3, 2, True, (70000, 5)), (5, 3, False, (3, 8))])  # fmt: skip
def test_labels_are_those_of_the_oracle(labels: int, kinds: int, weighted: bool, origin: tuple[int, int]) -> None:
    problem = costs(labels, (6, 7), labels, kinds, MISSING, weighted)
    naive = Problem(origin=origin, **{"tables" if name == "pairwise" else name: v for name, v in problem.items()})
    made = labelling(**uploaded(problem), origin=origin)
    found = message_labels(made, 3)
    assert on_device(found)
    framed = to_host(found).reshape(-1, made.stride)[1:-1, 1:-1]
    for site, belief in naive.messages(3).items():
        assert framed[site] == int(np.argmin(belief))


@pytest.mark.parametrize(("shape", "labels", "weighted"), [((9, 12), 3, False), ((11, 6), 4, True), ((4, 5), 18, True)])
def test_labels_are_those_of_the_cpu(shape: tuple[int, int], labels: int, weighted: bool) -> None:
    problem = costs(1, shape, labels, 2, MISSING, weighted)
    for scales in (0, 2):
        for origin in ((0, 0), (5, 3)):
            here, there = labelling(**problem, origin=origin), labelling(**uploaded(problem), origin=origin)
            np.testing.assert_array_equal(to_host(message_labels(there, 2, scales)), message_labels(here, 2, scales))


@pytest.mark.parametrize("weighted", [True, False])
def test_coarser_grid_is_that_of_the_cpu(weighted: bool) -> None:
    problem = costs(2, (7, 10), 3, 4, MISSING, weighted)
    for origin in ((0, 0), (0, 1), (7, 6)):
        here = coarser(labelling(**problem, origin=origin))
        there = coarser(labelling(**uploaded(problem), origin=origin))
        for name, expected in here._asdict().items():
            found = getattr(there, name)
            if isinstance(expected, np.ndarray):
                assert on_device(found)
            np.testing.assert_array_equal(to_host(found), expected, err_msg=name)


def test_bands_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    made = labelling(**uploaded(costs(3, (24, 4), 2, 2, MISSING, True)), origin=(7, 8))
    whole = {scales: to_host(message_labels(made, 1, scales)) for scales in (0, 1)}
    monkeypatch.setattr(messages, "_DEVICE_BAND_BYTES", 1)
    for scales, expected in whole.items():
        np.testing.assert_array_equal(to_host(message_labels(made, 1, scales)), expected)
