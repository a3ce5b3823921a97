"""What lines would score by chance: matches with a truth moved aside mean nothing, so their share is what they say.

Where lines are dense, most of any truth lies near one of them.  A score says something by as much as it exceeds this.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tilepipe.evaluate.segment_matching import close_pairs, covered_length, lengths, matched, segments

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

# Of no two the same direction or length: streets of one direction and width would hold all matches or none.
_LENGTHS = np.array([8.0, -10.0, 12.0, -14.0])
_ANGLES = np.radians([22.5, 67.5, 112.5, 157.5])

OFFSETS = np.stack([_LENGTHS * np.cos(_ANGLES), _LENGTHS * np.sin(_ANGLES)], axis=1)
"""The four moves of the truth in x and y, 8 to 14 times the tolerance each; a negative length is the way back."""


class ChanceScore(NamedTuple):
    """Score against a truth moved aside, mean over `OFFSETS`.

    Attributes
    ----------
    precision
        Matched length of the result / length of the result; NaN when the result is empty.
    recall
        Matched length of the moved truths / their length; NaN where no truth is left in the area.
    """

    precision: float
    recall: float


def by_chance(
    result: ArrayLike,
    truth: ArrayLike,
    *,
    tolerance: float,
    area: BaseGeometry | None = None,
    direction_tolerance: float | None = None,
) -> ChanceScore:
    """Score `result`, shapely lines, against `truth`, shapely lines, moved by each of `OFFSETS` times `tolerance`.

    Parameters
    ----------
    result, truth, area, direction_tolerance
        As for `tilepipe.evaluate.lines.evaluate_lines`; the truth is clipped after its move, so that what lay
        beyond the area takes the place of what has left it.
    tolerance
        Largest distance of a match, positive, in the unit of the coordinates.

    Examples
    --------
    Lines 4 m apart: more than half of their length lies within 2 m of the same lines moved anywhere.

    >>> import numpy as np
    >>> import shapely
    >>> from tilepipe.evaluate.chance import by_chance
    >>> y = np.arange(0, 100, 4)
    >>> lines = shapely.linestrings(np.stack([np.stack([0 * y, y], 1), np.stack([0 * y + 100, y], 1)], 1))
    >>> by_chance(lines, lines, tolerance=2.0).precision > 0.5
    True
    """
    import shapely

    a = segments(result, area)
    lines = np.atleast_1d(np.asarray(truth, dtype=object))
    result_length = float(lengths(a).sum())
    matched_result = matched_truth = truth_length = 0.0
    for offset in tolerance * OFFSETS:
        b = segments(shapely.transform(lines, lambda points, offset=offset: points + offset), area)
        if not len(b):
            continue
        pairs = close_pairs(a, b, tolerance, direction_tolerance)
        matched_result += covered_length(matched(a, b, pairs, tolerance), a)
        matched_truth += covered_length(matched(b, a, pairs[::-1], tolerance), b)
        truth_length += float(lengths(b).sum())
    return ChanceScore(
        precision=matched_result / (len(OFFSETS) * result_length) if result_length else math.nan,
        recall=matched_truth / truth_length if truth_length else math.nan,
    )
