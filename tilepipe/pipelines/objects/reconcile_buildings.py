"""Buildings among the regions: two classes of what stands above the ground, told apart scene by scene, and a field.

What is higher above the ground than a building has to be is roof or vegetation.  Roofs are more even and straighter
than crowns, but by how much differs from survey to survey, so that no threshold serves two of them: a mixture of the
two classes is fitted to the regions of the scene.  What single regions leave open their neighbours decide, by a binary
Markov random field on the region graph (Ising model), which gives the probability of every region.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.work import Work
from tilepipe.pipelines.objects.leaf_features import Relief
from tilepipe.pipelines.objects.parameters import ObjectParameters
from tilepipe.pipelines.objects.reconcile_leaves import Leaves
from tilepipe.pipelines.objects.reconcile_regions import Merged
from tilepipe_kernels.core.arrays import Backend, to_backend, to_host
from tilepipe_kernels.core.components import connected_components
from tilepipe_kernels.heights.mixture import ClassPrior, fit_mixture
from tilepipe_kernels.regions.ising import field_marginals

ROOF = ClassPrior((math.log(0.1), math.log(0.15)), 0.8, 0.6, mean_weight=0.05, spread_weight=0.05)
CROWN = ClassPrior((math.log(0.8), math.log(0.8)), 0.6, 0.6, mean_weight=0.05, spread_weight=1.0)
"""Logarithms of planarity and bend in m.  Roofs are of many kinds, so the scene tells how they spread; a vegetation
that spread as far would take in the roofs of an old town."""

EVIDENCE_AREA = 80.0
"""Area in m² over which the surface says once what it is: about that of one roof or crown."""

COUPLING = 0.15
"""Log-odds by which each metre of border between regions of one height speaks for one class on both sides."""

STEP = 3.0
"""Height step in m, a storey, at which a border couples half as much."""


@dataclass(frozen=True)
class Buildings:
    """What is known of the regions 0 … n - 1 as buildings.

    Attributes
    ----------
    above
        Mean height above the ground in m, float64.
    highest_above
        Height of the highest pixel above the ground in m, float64.
    probability
        Probability that the region is a building's, float64.
    building
        Lowest region id (from 1 on) of the building that the region belongs to, uint32; 0 = none.
    """

    above: NDArray[np.float64]
    highest_above: NDArray[np.float64]
    probability: NDArray[np.float64]
    building: NDArray[np.uint32]


def tell_buildings(run: Work, leaves: Leaves, merged: Merged) -> Buildings | None:
    """Buildings among the regions, if they are asked for."""
    if leaves.relief is None:
        return None
    with run.timed("buildings"):
        return find_buildings(
            leaves,
            leaves.relief,
            merged,
            run.parameters,
            resolution=run.resolution,
            seed=run.options.seed,
            backend=run.backend_here,
        )


def find_buildings(
    leaves: Leaves,
    relief: Relief,
    merged: Merged,
    parameters: ObjectParameters,
    *,
    resolution: float,
    seed: int = 0,
    backend: Backend = "numpy",
) -> Buildings:
    """Tell buildings from the rest.

    Parameters
    ----------
    leaves, merged
        Leaves and regions of the raster.
    relief
        Of the leaves.
    parameters
        Of the pipeline.
    resolution
        Pixel size in m.
    seed
        Seed of the random numbers.
    backend
        Where to fit the classes and sample the field.
    """
    regions, region = merged.mean.size, merged.region
    pixels = leaves.statistics.count
    above = _means(relief.above, pixels, region, regions)
    highest_above = np.full(regions, -np.inf)
    np.maximum.at(highest_above, region, leaves.highest - (leaves.statistics.mean - relief.above))
    features = np.stack([_means(values, pixels, region, regions) for values in (relief.planarity, relief.bend)], axis=1)
    area = merged.graph.statistics.count * resolution**2
    raised = above >= parameters.minimum_building_height
    probability = np.zeros(regions)
    sites = leaves.first[_first_members(region, regions)]
    probability[raised] = _probabilities(merged, features, area, raised, sites, resolution, seed, backend)
    building = _joined(merged.graph.edges, probability > 0.5, area, parameters.minimum_building_area)
    return Buildings(above, highest_above, probability, building)


def _means(
    values: NDArray[np.float32], pixels: NDArray[np.float64], region: NDArray[np.int32], regions: int
) -> NDArray[np.float64]:
    """Mean over the leaves of each region by their pixels; NaN where no leaf knows it."""
    weight = np.where(np.isnan(values), 0.0, pixels)
    total = np.bincount(region, weight * np.nan_to_num(values.astype(np.float64)), regions)
    known = np.bincount(region, weight, regions)
    mean: NDArray[np.float64] = np.full(regions, np.nan)
    np.divide(total, known, out=mean, where=known > 0)
    return mean


def _first_members(region: NDArray[np.int32], regions: int) -> NDArray[np.int64]:
    first = np.empty(regions, np.int64)
    first[region[::-1]] = np.arange(region.size)[::-1]
    return first


def _probabilities(
    merged: Merged,
    features: NDArray[np.float64],
    area: NDArray[np.float64],
    raised: NDArray[np.bool_],
    sites: NDArray[np.int64],
    resolution: float,
    seed: int,
    backend: Backend,
) -> NDArray[np.float64]:
    """Probabilities of the raised regions: the mixture says what each is by itself, the field joins them."""
    features, area = features[raised], area[raised]
    known = np.isfinite(features).all(axis=1)
    of_known = to_backend(features[known], backend)
    mixture = fit_mixture(of_known, to_backend(area[known], backend), (ROOF, CROWN))
    evidence = np.zeros(known.size)
    evidence[known] = to_host(mixture.evidence(of_known)) * area[known] / EVIDENCE_AREA
    graph = merged.graph
    among = raised[graph.edges].all(axis=1)
    ends = graph.edges[among]
    step = graph.statistics.mean[ends[:, 0]] - graph.statistics.mean[ends[:, 1]]
    coupling = COUPLING * resolution * graph.length[among] / (1 + (step / STEP) ** 2)
    number = np.cumsum(raised, dtype=np.int32) - np.int32(1)
    field = (to_backend(array, backend) for array in (number[ends], coupling, evidence))
    return to_host(field_marginals(*field, sites=to_backend(sites[raised], backend), seed=seed))


def _joined(
    edges: NDArray[np.int32], chosen: NDArray[np.bool_], area: NDArray[np.float64], least: float
) -> NDArray[np.uint32]:
    """Lowest region id of each connected group of chosen regions that covers ``least`` m²; 0 = none."""
    pairs = edges[chosen[edges].all(axis=1)]
    group = connected_components(chosen.size, pairs.astype(np.int64))
    # components are numbered by their lowest region
    lowest = np.flatnonzero(np.diff(np.maximum.accumulate(group), prepend=-1))
    large = np.bincount(group, area) >= least
    return np.where(chosen & large[group], lowest[group] + 1, 0).astype(np.uint32)
