"""Edges of an image: line fields and Nevatia–Babu beside Canny, LSD and EDLines; how fast, each in Mpx/s."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.edges.instances import Field, Floats, Grey
from benchmarks.kernels.scene import Band, over_bands
from benchmarks.measure.contest import Call, Case, Contestant, Unsuitable
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.mrf.edge_model import EdgeModel
from tilepipe_kernels.mrf.labels.intensity_field import intensity_field
from tilepipe_kernels.mrf.labels.minimise import halo as labels_halo
from tilepipe_kernels.mrf.lines.minimise import coupled_fields, line_field
from tilepipe_kernels.mrf.lines.minimise import halo as lines_halo
from tilepipe_kernels.mrf.search import DEFAULT, Search
from tilepipe_kernels.nevatia_babu.elements import count_magnitudes, thin_edges, threshold_from_histogram
from tilepipe_kernels.nevatia_babu.links import EdgeElements, find_elements, join_elements
from tilepipe_kernels.nevatia_babu.links import halo as links_halo
from tilepipe_kernels.nevatia_babu.masks import edge_responses
from tilepipe_kernels.nevatia_babu.tracing import trace_chains
from tilepipe_kernels.polylines.end_point_fit import fit_polylines

AIM = 10.0
"""Mpx/s of lines given labels, on all cores."""

LEVELS = 4
SIGMA = 1.4
"""Blur of both Canny detectors, in pixels."""
SHARE = 0.1
"""Of the pixels whose gradient exceeds Canny's upper threshold; twice as many exceed the lower one."""
TOLERANCE = 1.0
"""Pixels that Nevatia & Babu's straight lines may leave their elements by."""

LEGEND = (
    f"{LEVELS} levels, the parameters of Barbosa (1994). The first case starts from given levels, as the second half "
    "of the sequential form does; its peers get the levels too, as grey values. The others start from the grey image. "
    f"Both Canny detectors blur with σ = {SIGMA:g} and take thresholds that {SHARE:.0%} and {2 * SHARE:.0%} of the "
    "gradients exceed; these and the threshold of Nevatia–Babu are found before the clock starts."
)


class Fields(NamedTuple):
    """Levels, horizontal and vertical elements of an image."""

    labels: Field
    horizontal: Field
    vertical: Field


# ------------------------------------------------------------------------------------------------- ours


def _joined(parts: Sequence[tuple[Field, Field, Field]]) -> Fields:
    return Fields(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


def lines_of(labels: Field, model: EdgeModel, workers: int) -> Fields:
    """Line elements given labels, a band of rows per thread."""

    def band(rows: Band) -> tuple[Field, Field, Field]:
        block = labels[rows.padded]
        found = line_field(block, model, origin=(rows.low, 0))
        return block[rows.core], found.horizontal[rows.core], found.vertical[rows.core]

    return _joined(over_bands(band, len(labels), lines_halo(model), workers))


def sequential(observed: Floats, model: EdgeModel, workers: int, search: Search = DEFAULT) -> Fields:
    """Labels first and lines then."""

    def band(rows: Band) -> tuple[Field, Field, Field]:
        origin = (rows.low, 0)
        labels = intensity_field(observed[rows.padded], model, search=search, origin=origin).labels
        found = line_field(labels, model, origin=origin)
        return labels[rows.core], found.horizontal[rows.core], found.vertical[rows.core]

    halo = labels_halo(search) + lines_halo(model)
    return _joined(over_bands(band, len(observed), halo, workers))


def integrated(observed: Floats, model: EdgeModel, workers: int) -> Fields:
    """Labels and lines at once."""

    def band(rows: Band) -> tuple[Field, Field, Field]:
        found = coupled_fields(observed[rows.padded], model, origin=(rows.low, 0))
        return found.labels[rows.core], found.horizontal[rows.core], found.vertical[rows.core]

    return _joined(over_bands(band, len(observed), lines_halo(model, integrated=True), workers))


def babu_threshold(grey: Floats) -> float:
    """Threshold of Nevatia & Babu's elements that the pipeline takes: the corner of the histogram."""
    magnitude, direction = edge_responses(grey)
    counts = count_magnitudes(magnitude, thin_edges(magnitude, direction))
    return threshold_from_histogram(counts)


def babu_elements(grey: Floats, threshold: float, workers: int) -> EdgeElements:
    """Nevatia & Babu's linked elements."""

    def band(rows: Band) -> EdgeElements:
        core = (rows.core.start, rows.core.stop, 0, grey.shape[1])
        return find_elements(grey[rows.padded], threshold, core, (rows.low, 0), grey.shape[1])

    return join_elements(over_bands(band, len(grey), links_halo(), workers))


def babu_lines(grey: Floats, threshold: float, workers: int) -> Polylines:
    """Nevatia & Babu's straight lines, with vertices (row, column)."""
    elements = babu_elements(grey, threshold, workers)
    return fit_polylines(trace_chains(elements).polylines(elements), TOLERANCE)


# ------------------------------------------------------------------------------------------------- peers


def canny_opencv(image: Field, share: float = SHARE) -> Callable[[], Field]:
    """OpenCV's Canny with thresholds by the share of the gradients above them; 255 = edge."""
    import cv2

    def gradients() -> tuple[NDArray[np.int16], NDArray[np.int16]]:
        blurred = cv2.GaussianBlur(image, (0, 0), SIGMA)
        return cv2.Sobel(blurred, cv2.CV_16S, 1, 0), cv2.Sobel(blurred, cv2.CV_16S, 0, 1)

    low, high = _thresholds(np.hypot(*(g.astype(np.float32) for g in gradients())), share)
    return lambda: cv2.Canny(*gradients(), low, high, L2gradient=True)


def _thresholds(magnitude: NDArray[Any], share: float) -> tuple[float, float]:
    low, high = np.quantile(magnitude, [1 - 2 * share, 1 - share])
    return float(low), float(high)


def canny_skimage(image: Field, share: float = SHARE) -> Callable[[], NDArray[np.bool_]]:
    """scikit-image's Canny with thresholds of the same kind."""
    from scipy.ndimage import sobel
    from skimage.feature import canny
    from skimage.filters import gaussian

    grey = image.astype(np.float32)
    blurred = gaussian(grey, SIGMA, preserve_range=True)
    low, high = _thresholds(np.hypot(sobel(blurred, 0), sobel(blurred, 1)), share)
    return lambda: canny(grey, SIGMA, low_threshold=low, high_threshold=high)


def lsd(image: Field) -> NDArray[np.float32]:
    """Segments of OpenCV's LSD (von Gioi et al. 2010): x, y, x, y."""
    import cv2

    if not hasattr(cv2, "createLineSegmentDetector"):
        raise Unsuitable("not in this OpenCV")
    return _segments(cv2.createLineSegmentDetector().detect(image)[0])


def edlines(image: Field) -> NDArray[np.float32]:
    """Segments of OpenCV's EDLines (Akinlar & Topal 2011): x, y, x, y."""
    import cv2

    if not hasattr(cv2, "ximgproc"):
        raise Unsuitable("needs opencv-contrib")
    drawing = cv2.ximgproc.createEdgeDrawing()
    drawing.detectEdges(image)
    return _segments(drawing.detectLines())


def _segments(found: Any) -> NDArray[np.float32]:
    return np.empty((0, 4), np.float32) if found is None else np.asarray(found, np.float32).reshape(-1, 4)


# ------------------------------------------------------------------------------------------------- cases


def _opencv(make: Callable[[], Callable[[], Any]]) -> Callable[[], Call]:
    def build() -> Call:
        import cv2

        call = make()

        def run(workers: int) -> Any:
            cv2.setNumThreads(workers)
            return call()

        return run

    return build


def _serial(make: Callable[[], Callable[[], Any]]) -> Callable[[], Call]:
    def build() -> Call:
        call = make()
        return lambda workers: call()

    return build


def given_levels_case(grey: Grey) -> Case:
    """Line elements of given levels."""
    observed, model = grey.observed(LEVELS), EdgeModel(LEVELS)
    labels = intensity_field(observed, model).labels
    steps = (labels * (255 // (LEVELS - 1))).astype(np.uint8)
    contestants = [
        Contestant("tilepipe line_field", lambda: lambda workers: lines_of(labels, model, workers), ours=True),
        Contestant("OpenCV Canny", _opencv(lambda: canny_opencv(steps))),
        Contestant("skimage Canny", _serial(lambda: canny_skimage(steps)), serial=True),
    ]
    # a level read, two elements written
    return Case("lines given levels", "Mpx/s", labels.size / 1e6, 3 * labels.size, contestants, AIM)


def edges_case(grey: Grey) -> Case:
    """Edge elements or pixels of the image."""
    observed, model = grey.observed(LEVELS), EdgeModel(LEVELS)
    threshold = babu_threshold(grey.values)
    contestants = [
        Contestant("tilepipe, levels and then lines", lambda: lambda n: sequential(observed, model, n), ours=True),
        Contestant("tilepipe, integrated", lambda: lambda n: integrated(observed, model, n), ours=True),
        Contestant(
            "tilepipe Nevatia–Babu", lambda: lambda n: babu_elements(grey.values, threshold, n), ours=True,
            note="elements linked",
        ),
        Contestant("OpenCV Canny", _opencv(lambda: canny_opencv(grey.bytes))),
        Contestant("skimage Canny", _serial(lambda: canny_skimage(grey.bytes)), serial=True),
    ]  # fmt: skip
    return Case("edges of the image", "Mpx/s", observed.size / 1e6, 7 * observed.size, contestants)


def straight_case(grey: Grey) -> Case:
    """Straight lines of the image."""
    threshold = babu_threshold(grey.values)
    contestants = [
        Contestant("tilepipe Nevatia–Babu", lambda: lambda n: babu_lines(grey.values, threshold, n), ours=True),
        Contestant("OpenCV LSD", _serial(lambda: lambda: lsd(grey.bytes)), serial=True),
        Contestant("OpenCV EDLines", _serial(lambda: lambda: edlines(grey.bytes)), serial=True),
    ]
    return Case("straight lines of the image", "Mpx/s", grey.values.size / 1e6, 4 * grey.values.size, contestants)


CASES = (given_levels_case, edges_case, straight_case)
