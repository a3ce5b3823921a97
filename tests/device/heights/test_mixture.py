"""The mixture of two classes on the device."""

from __future__ import annotations

import numpy as np

from tests.kernels.heights.test_mixture import PRIORS
from tilepipe_kernels.core.arrays import on_device, to_device, to_host
from tilepipe_kernels.heights.mixture import fit_mixture


def test_fit_and_evidence_are_those_of_the_host() -> None:
    random = np.random.default_rng(0)
    features = np.concatenate([random.normal(-2, 0.6, (30, 2)), random.normal(0.3, 0.4, (20, 2))])
    weight = random.random(50)
    expected = fit_mixture(features, weight, PRIORS, most_steps=3)
    found = fit_mixture(to_device(features), to_device(weight), PRIORS, most_steps=3)
    for name in ("share", "mean", "covariance"):
        assert not on_device(getattr(found, name))
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-10)
    evidence = found.evidence(to_device(features))
    assert on_device(evidence)
    np.testing.assert_allclose(to_host(evidence), expected.evidence(features), rtol=1e-8, atol=1e-10)


def test_no_items_leave_the_priors() -> None:
    found = fit_mixture(to_device(np.empty((0, 2))), to_device(np.empty(0)), PRIORS)
    assert found.mean.tolist() == [[-2.0, -2.0], [0.0, 0.0]]
