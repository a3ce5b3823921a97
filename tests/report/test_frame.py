"""Scale bars and pens."""

from __future__ import annotations

import pytest

from tilepipe.report.frame import round_length
from tilepipe.report.map import pen


@pytest.mark.parametrize(("longest", "bar"), [(9.9, 5), (10, 10), (0.3, 0.2), (4999, 2000)])
def test_scale_bars_are_round(longest: float, bar: float) -> None:
    assert round_length(longest) == pytest.approx(bar)


def test_the_pen_follows_scale_and_density() -> None:
    near, far = pen(0.1, 0.01), pen(1.0, 0.01)
    assert near[0] > 2 * far[0]
    assert near[1] == far[1] == 1
    dense, carpet = pen(1.0, 0.15), pen(1.0, 0.5)
    assert far[0] > dense[0] > carpet[0] > 0
    assert dense[1] == pytest.approx(1)
    assert 0.3 <= carpet[1] < 1
    assert pen(1.0, 50.0) == (carpet[0], 0.3)
