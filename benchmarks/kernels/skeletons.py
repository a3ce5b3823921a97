"""Skeletons and their pruning, and their peers."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.kernels.scene import BRANCH, CAP, SEPARATION, Band, Scene, over_bands
from benchmarks.measure.contest import Call, Case, Contestant
from tilepipe_kernels.network import skeleton, tracing
from tilepipe_kernels.network.build import build_network, line_batch
from tilepipe_kernels.network.cleaning import Cleaning
from tilepipe_kernels.network.fragment_table import summarise


def skeleton_case(scene: Scene) -> Case:
    """Centerlines of the street mask; mask in, skeleton and distance out."""
    return Case(
        "skeleton",
        "Mpx/s",
        scene.megapixels,
        scene.size**2 * 6,
        [
            Contestant("tilepipe medial_axis", lambda: _ours(scene), ours=True, note="Euclidean, with distance"),
            Contestant("skimage skeletonize", lambda: _skeletonize(scene), serial=True, note="no distance"),
            Contestant("skimage medial_axis", lambda: _medial_axis(scene), serial=True, note="with distance"),
            Contestant("OpenCV ximgproc thinning", lambda: _thinning(scene), note="no distance"),
        ],
        aim=40,
    )


def _ours(scene: Scene) -> Call:
    mask = scene.mask

    def run(workers: int) -> Any:
        def band(rows: Band) -> Any:
            found = skeleton.medial_axis_and_distance(
                mask[rows.padded], cap=CAP, separation=SEPARATION, origin=(rows.low, 0)
            )
            return [part[rows.core] for part in found]

        return over_bands(band, scene.size, skeleton.halo(CAP), workers)

    return run


def _skeletonize(scene: Scene) -> Call:
    from skimage.morphology import skeletonize

    mask = scene.mask
    return lambda workers: skeletonize(mask)


def _medial_axis(scene: Scene) -> Call:
    from skimage.morphology import medial_axis

    mask = scene.mask
    return lambda workers: medial_axis(mask, return_distance=True, rng=0)


def _thinning(scene: Scene) -> Call:
    import cv2

    mask = scene.mask.astype(np.uint8) * 255

    def run(workers: int) -> Any:
        cv2.setNumThreads(workers)
        return cv2.ximgproc.thinning(mask, thinningType=cv2.ximgproc.THINNING_ZHANGSUEN)

    return run


def pruning_case(scene: Scene) -> Case:
    """Graph of the skeleton without branches of less than 15 m; skeleton in, lines out."""
    return Case(
        "graph and pruning",
        "Mpx/s",
        scene.megapixels,
        scene.size**2 * 2,
        [
            Contestant("tilepipe tracing and network", lambda: _network(scene), ours=True),
            Contestant("skan prune_paths", lambda: _skan(scene), serial=True),
        ],
        aim=40,
    )


def _network(scene: Scene) -> Call:
    axis = scene.skeleton
    rules = Cleaning(minimum_branch=BRANCH)

    def run(workers: int) -> Any:
        def band(rows: Band) -> tracing.Fragments:
            links = skeleton.skeleton_links(axis[rows.padded])
            return tracing.trace(links, (rows.core.start, 0, rows.core.stop, scene.size), (rows.low, 0), scene.size)

        fragments = over_bands(band, scene.size, 2, workers)
        tables = [summarise(part, scene.size) for part in fragments]

        def load(tile: int) -> Any:
            return fragments[tile], {}

        network = build_network(tables, scene.size, load, rules)
        return network, line_batch(network, load, 0, len(network))

    return run


def _skan(scene: Scene) -> Call:
    from skan import Skeleton, summarize

    axis = scene.skeleton

    def run(workers: int) -> Any:
        graph = Skeleton(axis)
        branches = summarize(graph, separator="_")
        short = (branches.branch_type == 1) & (branches.branch_distance < BRANCH)
        return graph.prune_paths(list(branches.index[short]))

    return run
