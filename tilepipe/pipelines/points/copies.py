"""Clouds that overlap but count coordinates in different steps: copies of their points cannot all be told."""

from __future__ import annotations

import numpy as np

from tilepipe.io.clouds.cloud import Cloud
from tilepipe.pipelines.points.plan import GridPlan

_CONGRUENT = 1e-3
"""Largest difference of two offsets from whole steps that is taken for rounding, in steps."""


def unlike_steps(a: Cloud, b: Cloud) -> bool:
    """Whether a point can have other coordinates in one cloud than its copy in another: other scales, or odd offsets.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import laspy
    >>> from tilepipe.io.clouds.cloud import read_cloud
    >>> from tilepipe.pipelines.points.copies import unlike_steps
    >>> cloud = laspy.create()
    >>> cloud.x, cloud.y, cloud.z = [1.0], [2.0], [3.0]
    >>> cloud.write("cloud.las")
    >>> cloud = read_cloud("cloud.las")
    >>> unlike_steps(cloud, replace(cloud, offsets=(100.0, 0.0, 0.0)))  # a whole number of its steps of 0.01
    False
    >>> unlike_steps(cloud, replace(cloud, scales=(1.0, 1.0, 1.0)))
    True
    """
    if a.scales != b.scales:
        return True
    shifts = (np.array(a.offsets) - b.offsets) / a.scales
    return bool((np.abs(shifts - np.rint(shifts)) > _CONGRUENT).any())


def told_of_copies(plan: GridPlan) -> str | None:
    """What to tell of clouds whose copies of points may weigh twice; None where there are none.

    Names the two that overlap most, by the area of the boxes of their points.
    """
    if not plan.overlapping.any():
        return None
    boxes, owners = plan.extent.boxes, plan.extent.owners
    most, found, pairs = 0, None, 0
    for number, box in enumerate(boxes):
        lowest, highest = np.maximum(box[0], boxes[number + 1 :, 0]), np.minimum(box[1], boxes[number + 1 :, 1])
        areas = np.prod(np.maximum(highest - lowest + 1, 0), axis=1)
        for other in np.flatnonzero(areas).tolist():
            a, b = (plan.job.clouds[owners[each]] for each in (number, number + 1 + other))
            if unlike_steps(a, b):
                pairs += 1
                if areas[other] > most:
                    most, found = int(areas[other]), (a, b)
    if found is None:
        return None
    a, b = found
    hectares = most * plan.job.resolution**2 / 1e4
    others = f", and {pairs - 1:,} other pairs likewise" if pairs > 1 else ""
    return (
        f"{a.path} and {b.path} overlap by {hectares:,.4g} ha but count coordinates in different steps{others}: points "
        "that both hold may weigh twice; write all clouds with one scale and offset, or without buffers"
    )
