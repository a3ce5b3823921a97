"""Lazy operators of `edges`: levels, line elements between them, and Nevatia–Babu edge elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from numbers import Integral, Real
from typing import Any, Literal, get_args

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from tilepipe.accessor.blocks import BlockOperators
from tilepipe.errors import InputError
from tilepipe.tiling.grid import Tile
from tilepipe_kernels.image import grey_levels
from tilepipe_kernels.mrf.edge_model import MAXIMUM_LEVELS, EdgeModel
from tilepipe_kernels.mrf.labels.intensity_field import intensity_field
from tilepipe_kernels.mrf.labels.minimise import halo as labels_halo
from tilepipe_kernels.mrf.lines.minimise import halo as lines_halo
from tilepipe_kernels.mrf.lines.minimise import line_field
from tilepipe_kernels.mrf.search import MOST_ROUNDS, Search
from tilepipe_kernels.nevatia_babu.elements import halo as elements_halo
from tilepipe_kernels.nevatia_babu.elements import thin_edges
from tilepipe_kernels.nevatia_babu.masks import NO_DIRECTION, STEP_RESPONSE, edge_responses

LevelMethod = Literal["parallel", "messages", "icm", "annealing"]
LineMethod = Literal["parallel", "icm", "annealing"]

_NO_LEVEL = 255
"""Level and line elements at nodata."""


class EdgeOperators(BlockOperators):
    """Operators on greys and on levels."""

    def segment(
        self, *, means: Sequence[float], method: LevelMethod = "parallel", rounds: int = 24, **weights: Any
    ) -> xr.DataArray:
        """Levels of grey values by a Bayesian model; see `tilepipe_kernels.mrf.labels.intensity_field.intensity_field`.

        Parameters
        ----------
        means
            Grey value of each level, ascending, two at least.
        method
            ``parallel`` (HCF in rounds), ``messages``, ``icm`` or ``annealing``.
        rounds
            Most rounds; twice as many pixels around a chunk are read.
        weights
            Of the energy: ``potential``, ``beta``, ``sigma``; see `tilepipe_kernels.mrf.edge_model.EdgeModel`.

        Returns
        -------
        xarray.DataArray of uint8
            Level 0, 1, …; 255 = nodata.

        Raises
        ------
        InputError
            ``means``, the method, the rounds or a weight cannot be used.

        Examples
        --------
        A dark street and a bright roof, in each of which one pixel is noise.

        >>> import xarray as xr
        >>> import tilepipe.accessor
        >>> greys = xr.DataArray([[50, 48, 180, 178], [52, 125, 182, 180], [49, 51, 110, 181]], dims=("y", "x"))
        >>> greys.tilepipe.segment(means=[50, 180]).values.tolist()
        [[0, 0, 1, 1], [0, 0, 1, 1], [0, 0, 1, 1]]
        """
        _check_optimiser("segment", method, get_args(LevelMethod), rounds)
        greys = _checked_means(means)
        model, search = _edge_model(greys.size, weights), Search(method, int(rounds))

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            observed = grey_levels.to_levels(np.ascontiguousarray(block, np.float32), greys)
            found = intensity_field(observed, model, search=search, origin=tile.padded.origin)
            return found.labels[tile.core_in_padded.slices]

        return self.map_blocks("segment", function, labels_halo(search), np.uint8, _NO_LEVEL)

    def line_field(
        self, *, levels: int, method: LineMethod = "parallel", rounds: int = 24, **weights: Any
    ) -> xr.DataArray:
        """Line elements between the pixels of an array of levels; see `tilepipe_kernels.mrf.lines.minimise.line_field`.

        Parameters
        ----------
        levels
            Number of levels: the array holds 0 to one less; NaN, its nodata value and 255 are no data.
        method
            ``parallel`` (HCF in rounds), ``icm`` or ``annealing``.
        rounds
            Most rounds; they set how far around a chunk is read.
        weights
            Of the energy: ``alpha``, ``gamma``, ``xi``, ``zeta``; see `tilepipe_kernels.mrf.edge_model.EdgeModel`.

        Returns
        -------
        xarray.DataArray of uint8
            1 = edge below the pixel, 2 = edge to its right, 3 = both, 255 = nodata.

        Raises
        ------
        InputError
            The method, the rounds, ``levels`` or a weight cannot be used; when computed, that the array holds other
            values than levels.

        Examples
        --------
        >>> import numpy as np
        >>> import xarray as xr
        >>> import tilepipe.accessor
        >>> levels = xr.DataArray(np.repeat([[0, 0, 3, 3]], 4, axis=0).astype(np.uint8), dims=("y", "x"))
        >>> levels.tilepipe.line_field(levels=4).values[1].tolist()  # an edge to the right of column 1
        [0, 2, 0, 0]
        """
        _check_optimiser("line_field", method, get_args(LineMethod), rounds)
        model, search = _edge_model(levels, weights), Search(method, int(rounds))

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            labels = _checked_levels(block, levels)
            found = line_field(labels, model, search=search, origin=tile.padded.origin)
            lines = found.horizontal | found.vertical << 1
            lines[labels == _NO_LEVEL] = _NO_LEVEL
            return lines[tile.core_in_padded.slices]

        # one more, for the elements to the pixels of the neighbours
        return self.map_blocks("line_field", function, lines_halo(model, search) + 1, np.uint8, _NO_LEVEL)

    def nevatia_babu(self, *, threshold: float = 0.0) -> xr.DataArray:
        """Thinned edge elements by six masks; see `tilepipe_kernels.nevatia_babu.elements.thin_edges`.

        Parameters
        ----------
        threshold
            Least step across an edge, in the unit of the array.

        Returns
        -------
        xarray.DataArray of float32
            Step across the edge at edge elements, 0 elsewhere.

        Examples
        --------
        A step of 50 grey levels.

        >>> import numpy as np
        >>> import xarray as xr
        >>> import tilepipe.accessor
        >>> greys = xr.DataArray(np.tile(np.repeat([100.0, 150.0], 5), (9, 1)), dims=("y", "x"))
        >>> greys.tilepipe.nevatia_babu(threshold=10).values[4].tolist()
        [0.0, 0.0, 0.0, 0.0, 50.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        """

        def function(block: NDArray[Any], tile: Tile) -> NDArray[Any]:
            magnitude, direction = edge_responses(block)
            elements = thin_edges(magnitude, direction, threshold * STEP_RESPONSE)
            step = np.where(elements != NO_DIRECTION, magnitude / STEP_RESPONSE, 0)
            return step.astype(np.float32)[tile.core_in_padded.slices]

        return self.map_blocks("nevatia_babu", function, elements_halo(), np.float32)


def _checked_means(means: Sequence[float]) -> NDArray[np.float64]:
    """Grey values of the levels.

    Raises
    ------
    InputError
        They are too few or too many, not finite, or do not ascend.
    """
    greys = np.array(means, np.float64)
    if greys.ndim != 1 or not 2 <= greys.size <= MAXIMUM_LEVELS:
        raise InputError(f"means must be from 2 to {MAXIMUM_LEVELS} grey values, one for each level, not {greys.size}")
    if not (np.isfinite(greys).all() and (np.diff(greys) > 0).all()):
        raise InputError(f"means must be finite and ascend, not {means}")
    return greys


def _check_optimiser(operator: str, method: str, known: tuple[str, ...], rounds: int) -> None:
    """Check what all optimisers share.

    Raises
    ------
    InputError
        The operator has no such method, or the number of rounds is out of range.
    """
    if method not in known:
        raise InputError(f"{operator}: method must be one of {', '.join(known)}, not {method!r}")
    if not (isinstance(rounds, Integral) and 1 <= rounds <= MOST_ROUNDS):
        raise InputError(f"{operator}: rounds must be a whole number from 1 to {MOST_ROUNDS}, not {rounds!r}")


def _checked_levels(block: NDArray[Any], levels: int) -> NDArray[np.uint8]:
    """Levels of a block as uint8, 255 where there is none.

    Raises
    ------
    InputError
        The block holds other values than 0 to ``levels`` - 1.
    """
    missing = np.isnan(block) | (block == _NO_LEVEL)
    wrong = ~missing & ~((block >= 0) & (block < levels) & (block == np.floor(block)))
    if wrong.any():
        raise InputError(
            f"line_field: levels={levels} is for an array of 0 to {levels - 1} (255 = no data), and it holds "
            f"{block[wrong].max():g}; give the levels that segment has found, and as many as its means"
        )
    return np.where(missing, np.int16(_NO_LEVEL), block).astype(np.uint8)


def _edge_model(levels: int, weights: dict[str, Any]) -> EdgeModel:
    """The energy of the operators of edges.

    Raises
    ------
    InputError
        A weight is unknown, or a weight or the number of levels is out of its range.
    """
    known = [field.name for field in fields(EdgeModel) if field.name != "levels"]
    for name, value in weights.items():
        if name not in known:
            raise InputError(f"model of the edges has no weight {name}; it has {', '.join(known)}")
        if name != "potential" and not isinstance(value, Real):
            raise InputError(f"model of the edges: {name} must be a number, not {value!r}")
    try:
        return EdgeModel(levels=levels, **weights)
    except ValueError as error:
        raise InputError(f"model of the edges: {error}") from None
