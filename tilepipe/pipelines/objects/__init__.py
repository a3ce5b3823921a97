"""Object and building polygons from lidar heights (Galvanin et al. 2007).

Here stands what the command line shows of the pipeline without importing it.
"""

from __future__ import annotations

from tilepipe.engine.inputs import Input

SUMMARY = "Object polygons from lidar heights, and the probability of every boundary between them."

INPUTS: tuple[Input, ...] = ()
