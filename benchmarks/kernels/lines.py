"""Line points and linked lines after Steger, and their peers."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.kernels.scene import LINE_CONTRAST, LINE_WIDTH, LOW, SIGMA, Band, Scene, over_bands
from benchmarks.measure.contest import Call, Case, Contestant
from tilepipe_kernels.network import tracing
from tilepipe_kernels.ridges.links import LINK_RADIUS, link_points
from tilepipe_kernels.ridges.points import LinePoints, line_points
from tilepipe_kernels.ridges.ridges import halo as ridges_halo
from tilepipe_kernels.ridges.width import line_widths


def points_case(scene: Scene) -> Case:
    """Hessian of Gaussian, its larger eigenvalue and the sub-pixel line points at σ = 4, on the raw intensity."""
    return Case(
        f"Hessian and line points, σ = {SIGMA:g}",
        "Mpx/s",
        scene.megapixels,
        scene.size**2 * 4,
        [
            Contestant("tilepipe line_points", lambda: _line_points(scene), ours=True),
            Contestant("OpenCV sepFilter2D recipe", lambda: _opencv(scene), note="same eigenvalue and point test"),
            Contestant("skimage hessian_matrix_eigvals", lambda: _eigenvalues(scene), serial=True, note="no points"),
            Contestant("skimage sato", lambda: _sato(scene), serial=True, note="no points"),
        ],
        aim=60,
    )


def _line_points(scene: Scene) -> Call:
    image = scene.grey
    halo = ridges_halo(SIGMA)

    def run(workers: int) -> Any:
        def band(rows: Band) -> LinePoints:
            core = np.zeros((rows.high - rows.low, scene.size), np.uint8)
            core[rows.core] = 1
            return line_points(image[rows.padded], SIGMA, low=LOW, mask=core)

        return over_bands(band, scene.size, halo, workers)

    return run


def _opencv(scene: Scene) -> Call:
    """Separable derivative filters and the closed form of the eigenvalue, as a user writes it with OpenCV."""
    import cv2

    image = scene.grey
    x = np.arange(-16, 17, dtype=np.float64)
    gauss = np.exp(-x * x / (2 * SIGMA**2))
    gauss /= gauss.sum()
    first, second = -x / SIGMA**2 * gauss, (x * x / SIGMA**4 - 1 / SIGMA**2) * gauss
    half, tiny = np.float32(0.5), np.float32(1e-12)

    def run(workers: int) -> Any:
        cv2.setNumThreads(workers)

        def filtered(across: Any, down: Any) -> Any:
            return cv2.sepFilter2D(image, cv2.CV_32F, across, down, borderType=cv2.BORDER_REPLICATE)

        r_x, r_y = filtered(first, gauss), filtered(gauss, first)
        r_xx, r_xy, r_yy = filtered(second, gauss), filtered(first, first), filtered(gauss, second)
        difference = (r_xx - r_yy) * half
        response = (r_xx + r_yy) * half + np.sqrt(difference * difference + r_xy * r_xy)
        n_x, n_y = r_xy, response - r_xx
        curvature = r_xx * n_x * n_x + 2 * r_xy * n_x * n_y + r_yy * n_y * n_y
        t = -(r_x * n_x + r_y * n_y) / (curvature + tiny)
        return response, np.nonzero((np.abs(t * n_x) <= half) & (np.abs(t * n_y) <= half) & (response > LOW))

    return run


def _eigenvalues(scene: Scene) -> Call:
    from skimage.feature import hessian_matrix, hessian_matrix_eigvals

    image = scene.grey / np.float32(255)
    return lambda workers: hessian_matrix_eigvals(
        hessian_matrix(image, sigma=SIGMA, order="rc", use_gaussian_derivatives=True)
    )


def _sato(scene: Scene) -> Call:
    from skimage.filters import sato

    image = scene.grey / np.float32(255)
    return lambda workers: sato(image, sigmas=[SIGMA], black_ridges=True)


def linked_case(scene: Scene) -> Case:
    """Lines linked from points, with their widths, on the raw intensity."""
    return Case(
        "linked lines with widths",
        "Mpx/s",
        scene.megapixels,
        scene.size**2 * 4,
        [
            Contestant("tilepipe ridges and tracing", lambda: _linked(scene), ours=True),
            Contestant("ridge-detector", lambda: _ridge_detector(scene), serial=True, share=1 / 16, note="a 16th"),
        ],
        aim=15,
    )


def _linked(scene: Scene) -> Call:
    image = scene.grey
    halo = ridges_halo(SIGMA, 2 * LINE_WIDTH)

    def run(workers: int) -> Any:
        def band(rows: Band) -> Any:
            block = image[rows.padded]
            core = np.zeros(block.shape, np.uint8)
            radius = LINK_RADIUS
            core[max(0, rows.core.start - radius) : rows.core.stop + radius] = 1
            points = line_points(block, SIGMA, low=LOW, mask=core)
            links = np.zeros(block.shape, np.uint8)
            links[points.row, points.col] = link_points(points)
            inside = (points.row >= rows.core.start) & (points.row < rows.core.stop)
            points = points.take(np.flatnonzero(inside & (links[points.row, points.col] > 0)))
            widths = line_widths(block, points, SIGMA, maximum_width=2 * LINE_WIDTH)
            window = (rows.core.start, 0, rows.core.stop, scene.size)
            return widths, tracing.trace(links, window, (rows.low, 0), scene.size)

        return over_bands(band, scene.size, halo, workers)

    return run


def _ridge_detector(scene: Scene) -> Call:
    from ridge_detector import RidgeDetector

    part = slice(0, scene.size // 4)
    colour = np.repeat(scene.grey_bytes[part, part, None], 3, axis=2)

    def run(workers: int) -> Any:
        detector = RidgeDetector(
            line_widths=[int(LINE_WIDTH)], low_contrast=int(LINE_CONTRAST), high_contrast=90, min_len=40, max_len=0,
            dark_line=True, estimate_width=True, extend_line=False, correct_pos=False,
        )  # fmt: skip
        detector.detect_lines(colour)
        return detector

    return run
