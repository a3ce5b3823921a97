"""Regions of a whole raster from the region tables of its tiles, joined across the seams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.work import Work
from tilepipe.errors import InputError
from tilepipe.pipelines.streets.parameters import StreetParameters
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import TileGrid
from tilepipe.tiling.numbering import Numbering
from tilepipe.tiling.seams import seam_sides
from tilepipe_kernels.core.components import connected_components
from tilepipe_kernels.regions.region_table import contour_length

SUMMED = ("count", "horizontal_cracks", "vertical_cracks", "grey_sum")
"""Columns of a tile's region table that add up; all are integers, so the order of tiles does not matter."""


LOOKUP = "lookup.npy"
"""File in the state folder: published id of every local region number, tile after tile; 0 = none."""

_MOST_REGIONS = 1 << 24
"""Region ids travel with the points of lines as float32."""


@dataclass(frozen=True)
class Regions:
    """All regions of a raster, ordered by their first pixel.

    Attributes
    ----------
    first
        Lowest global index (row-major, in rectangles) of each region, int64.
    area
        Ground area in m².
    contour
        Length of outer and inner contours in m.
    mean_grey
        Mean grey value (0–255).
    component
        Region of every local feature number, see `Numbering`, int64.
    numbering
        The local feature numbers of all tiles.
    """

    first: NDArray[np.int64]
    area: NDArray[np.float64]
    contour: NDArray[np.float64]
    mean_grey: NDArray[np.float64]
    component: NDArray[np.int64]
    numbering: Numbering

    @property
    def mean_width(self) -> NDArray[np.float64]:
        """Mean width in m of a ribbon of the same area and contour: 2·area/contour."""
        return 2 * self.area / self.contour

    @property
    def elongation(self) -> NDArray[np.float64]:
        """Length over width of a ribbon of the same area and contour: contour²/(4·area)."""
        return self.contour**2 / (4 * self.area)

    def lookup(self, selected: NDArray[np.bool_]) -> NDArray[np.uint32]:
        """Published region id (1, 2, … by first pixel; 0 = not selected) of every local feature number."""
        ids = np.where(selected, np.cumsum(selected), 0).astype(np.uint32)
        return ids[self.component]


def find_regions(run: Work, segmented: Ledger) -> Regions:
    """Regions of the raster; the published ids of those that are streets go to the state folder for later passes.

    Raises
    ------
    InputError
        When there are more street regions than ids.
    """
    with run.timed("reconcile regions"):
        p: StreetParameters = run.parameters
        grid, facts = run.state("labels").grid, segmented.all_facts()
        rectangle = (p.rectangle_rows * run.resolution, p.rectangle_columns * run.resolution)
        regions = reconcile_regions(grid, facts, tolerance=p.tolerance, rectangle=rectangle)
        selected = select_streets(regions, p)
        if np.count_nonzero(selected) >= _MOST_REGIONS:
            raise InputError(f"more than {_MOST_REGIONS:,} street regions; raise minimum_size or minimum_contour")
        np.save(run.folder / LOOKUP, regions.lookup(selected))
        return regions


def select_streets(regions: Regions, parameters: StreetParameters) -> NDArray[np.bool_]:
    """Which regions are streets: by size, contour length, elongation and mean width (step 3 of the method)."""
    p = parameters
    with np.errstate(divide="ignore", invalid="ignore"):
        return (
            (regions.area >= p.minimum_size)
            & (regions.contour >= p.minimum_contour)
            & (regions.contour <= p.maximum_contour)
            & (regions.elongation >= p.minimum_elongation)
            & (regions.mean_width <= p.maximum_mean_width)
        )


def reconcile_regions(
    grid: TileGrid, facts: list[Facts], *, tolerance: float, rectangle: tuple[float, float]
) -> Regions:
    """Join the regions of all tiles across the seams.

    Parameters
    ----------
    grid
        Tiling of the grid of rectangles.
    facts
        Facts of each tile: the region table (`SUMMED` and ``first``), the ``contacts`` of regions that reach a seam,
        and the edges ``label`` and ``grey``.
    tolerance
        Largest grey difference of two adjacent rectangles of one region.
    rectangle
        Height and width of a rectangle in metres.

    Returns
    -------
    Regions
        The regions of the raster, the same for every tiling.
    """
    numbering = Numbering.of_counts(np.array([f["count"].size for f in facts], dtype=np.int64))
    joins, contacts = _seam_contacts(grid, facts, numbering, tolerance)
    component = connected_components(numbering.total, joins)
    size = int(component.max()) + 1 if component.size else 0
    sums = {name: np.zeros(size, np.int64) for name in SUMMED}
    for name in SUMMED:
        np.add.at(sums[name], component, np.concatenate([f[name] for f in facts]).astype(np.int64))
    for vertical, pairs in contacts.items():
        _add_seam_cracks(sums["vertical_cracks" if vertical else "horizontal_cracks"], component, pairs)
    _take_back_inner_cracks(sums, component, facts, numbering)
    first = np.full(size, np.iinfo(np.int64).max)
    np.minimum.at(first, component, np.concatenate([f["first"] for f in facts]).astype(np.int64))
    order = np.argsort(first, kind="stable")
    rank = np.empty(size, np.int64)
    rank[order] = np.arange(size)
    count = sums["count"][order]
    height, width = rectangle
    return Regions(
        first=first[order],
        area=count.astype(np.float64) * (height * width),
        contour=contour_length(sums["horizontal_cracks"][order], sums["vertical_cracks"][order], height, width),
        mean_grey=sums["grey_sum"][order] / (256.0 * np.maximum(count, 1)),
        component=rank[component],
        numbering=numbering,
    )


def _seam_contacts(
    grid: TileGrid, facts: list[Facts], numbering: Numbering, tolerance: float
) -> tuple[NDArray[np.int64], dict[bool, NDArray[np.int64]]]:
    """Pairs of features that are one, and all pairs in contact on horizontal and vertical seams (-1 = no feature)."""
    joins: list[NDArray[np.int64]] = [np.empty((0, 2), np.int64)]
    contacts: dict[bool, list[NDArray[np.int64]]] = {False: [joins[0]], True: [joins[0]]}
    for (seam, a, b), (_, grey_a, grey_b) in zip(
        seam_sides(grid, facts, "label"), seam_sides(grid, facts, "grey"), strict=True
    ):
        pairs = np.stack([numbering.globalise(seam.first, a), numbering.globalise(seam.second, b)], axis=1)
        near = np.abs(grey_a - grey_b) <= np.float32(tolerance)
        joins.append(np.unique(pairs[near & (pairs >= 0).all(axis=1)], axis=0))
        contacts[seam.vertical].append(pairs[(pairs >= 0).any(axis=1)])
    return np.concatenate(joins), {vertical: np.concatenate(found) for vertical, found in contacts.items()}


def _add_seam_cracks(cracks: NDArray[np.int64], component: NDArray[np.int64], pairs: NDArray[np.int64]) -> None:
    """Count a pixel side on a seam for each region that has something else on its other side."""
    sides = np.where(pairs >= 0, component[np.maximum(pairs, 0)], -1)
    apart = sides[sides[:, 0] != sides[:, 1]]
    for column in apart.T:
        np.add.at(cracks, column[column >= 0], 1)


def _take_back_inner_cracks(
    sums: dict[str, NDArray[np.int64]], component: NDArray[np.int64], facts: list[Facts], numbering: Numbering
) -> None:
    """Cracks between two parts of one tile that a seam has united are no contour: both parts had counted them."""
    for tile, found in enumerate(facts):
        contacts = found["contacts"]
        a, b = (component[numbering.globalise(tile, contacts[:, side])] for side in (0, 1))
        same = a == b
        np.subtract.at(sums["horizontal_cracks"], a[same], 2 * contacts[same, 2])
        np.subtract.at(sums["vertical_cracks"], a[same], 2 * contacts[same, 3])
