"""The runs of Barbosa (1994): both fields by Highest Confidence First, and Nevatia & Babu's lines."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.image.grey_levels import LARGEST_GREY, to_levels
from tilepipe_kernels.image.histogram import class_means
from tilepipe_kernels.mrf.edge_energy import energy
from tilepipe_kernels.mrf.edge_model import EdgeModel
from tilepipe_kernels.mrf.labels.intensity_field import intensity_field
from tilepipe_kernels.mrf.lines.minimise import coupled_fields, line_field
from tilepipe_kernels.mrf.search import Search
from tilepipe_kernels.nevatia_babu.elements import count_magnitudes, thin_edges, threshold_from_histogram
from tilepipe_kernels.nevatia_babu.links import EdgeElements, find_elements, join_elements
from tilepipe_kernels.nevatia_babu.masks import NO_DIRECTION, edge_responses
from tilepipe_kernels.nevatia_babu.tracing import ElementChains, trace_chains
from tilepipe_kernels.polylines.end_point_fit import fit_polylines

Grey = NDArray[np.float32]
Field = NDArray[np.uint8]
Result = TypeVar("Result")
Way = Literal["sequential", "integrated"]
Potential = Literal["reciprocal", "quadratic"]

LINE_TOLERANCE = 1.0
"""Pixels that Nevatia & Babu's straight lines may leave their elements by."""


@dataclass(frozen=True)
class Form:
    """A form of the optimiser.

    Attributes
    ----------
    key, title
        For tables and for people.
    method
        Of the intensity and the line field.
    sure
        Whether elements between equal labels start as 0.
    """

    key: str
    title: str
    method: Literal["serial", "parallel"]
    sure: bool


PLAIN = Form("plain", "plain: serial HCF, all sites uncommitted at first, as in the thesis", "serial", False)
SURE = Form("sure", "sure: serial HCF, elements between equal labels 0 at first", "serial", True)
OURS = Form("ours", "ours: parallel HCF, elements between equal labels 0 at first", "parallel", True)
FORMS = (PLAIN, SURE, OURS)


@dataclass(frozen=True)
class Run:
    """One of the eight ways to treat an image."""

    way: Way
    levels: int
    potential: Potential

    @property
    def title(self) -> str:
        """For tables and pictures."""
        return f"{self.way}, {self.levels} levels, {self.potential}"


RUNS = tuple(
    Run(way, count, potential)
    for way, count, potential in itertools.product(("sequential", "integrated"), (2, 4), ("reciprocal", "quadratic"))
)
"""The eight runs of an image, in the order of the thesis's figures; for two images sixteen."""


@dataclass(frozen=True)
class Outcome:
    """What a run gave.

    Attributes
    ----------
    labels, horizontal, vertical
        uint8 (rows, columns), as in `edge_model`.
    energy
        U of all three.
    seconds
        The fastest of the repetitions.
    unresolved
        Sites that still wanted to change at the cap on the rounds.
    """

    labels: Field
    horizontal: Field
    vertical: Field
    energy: float
    seconds: float
    unresolved: int


def observed(grey: Grey, count: int) -> Grey:
    """Grey values in units of a level; the levels are the means of the classes of least variance."""
    histogram = np.bincount(np.rint(grey).astype(np.int64).ravel(), minlength=int(LARGEST_GREY) + 1)
    return to_levels(grey, class_means(histogram, count))


def execute(run: Run, form: Form, grey: Grey, repetitions: int = 1) -> Outcome:
    """Make a run with the thesis's parameters.

    Parameters
    ----------
    run, form
        What to do and how.
    grey
        float32 (rows, columns), 0–255.
    repetitions
        The fields are found so often; the fastest counts.
    """
    y = observed(grey, run.levels)
    model, search = EdgeModel(levels=run.levels, potential=run.potential), Search(form.method, sure=form.sure)

    def fields() -> tuple[Field, Field, Field, int]:
        if run.way == "integrated":
            both = coupled_fields(y, model, search=search)
            return both.labels, both.horizontal, both.vertical, both.unresolved
        first = intensity_field(y, model, search=search)
        lines = line_field(first.labels, model, search=search)
        return first.labels, lines.horizontal, lines.vertical, first.unresolved + lines.unresolved

    (x, h, v, unresolved), seconds = fastest(fields, repetitions)
    return Outcome(x, h, v, energy(y, x, h, v, model), seconds, unresolved)


def fastest(call: Callable[[], Result], repetitions: int) -> tuple[Result, float]:
    """Result of a call and the seconds of the fastest repetition."""
    best = np.inf
    for _ in range(repetitions):
        start = time.perf_counter()
        result = call()
        best = min(best, time.perf_counter() - start)
    return result, best


# ------------------------------------------------------------------------------------------------- classical


@dataclass(frozen=True)
class Classical:
    """Nevatia & Babu's lines of an image.

    Attributes
    ----------
    threshold
        Of the magnitude.
    elements
        Edge elements above it, linked.
    chains
        What was traced: lone elements are in none.
    polylines
        The straight lines that approximate the chains, with vertices (row, column).
    seconds
        The fastest of the repetitions.
    """

    threshold: float
    elements: EdgeElements
    chains: ElementChains
    polylines: Polylines
    seconds: float


def magnitudes(grey: Grey) -> Grey:
    """Magnitudes of all edge elements of an image, ascending."""
    size, direction = edge_responses(grey)
    elements = thin_edges(size, direction)
    return np.sort(size[elements != NO_DIRECTION])


def classical(grey: Grey, threshold: float | None = None, repetitions: int = 1) -> Classical:
    """Nevatia & Babu's method, from the masks to straight lines.

    Parameters
    ----------
    grey
        float32 (rows, columns).
    threshold
        Of the magnitude; None: the corner of its histogram, found anew in each repetition.
    repetitions
        The fastest counts.
    """

    def lines() -> tuple[float, EdgeElements, ElementChains, Polylines]:
        limit = threshold
        if limit is None:
            size, direction = edge_responses(grey)
            counts = count_magnitudes(size, thin_edges(size, direction))
            limit = threshold_from_histogram(counts)
        elements = join_elements([find_elements(grey, limit)])
        chains = trace_chains(elements)
        return limit, elements, chains, fit_polylines(chains.polylines(elements), LINE_TOLERANCE)

    result, seconds = fastest(lines, repetitions)
    return Classical(*result, seconds)


def thresholds(grey: Grey, count: int = 48) -> Iterator[float]:
    """Thresholds that keep evenly spread shares of an image's edge elements, all at first."""
    sizes = magnitudes(grey)
    yield 0.0
    for share in np.arange(1, count) / count:
        yield float(sizes[int(share * sizes.size)])
