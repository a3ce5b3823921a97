"""Nonlinear diffusion: smooth within regions, keep the edges between them (`streets`, step 1)."""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form
from tilepipe_kernels.image.diffusion_loops import Terms, Window, load, run_steps

Model = Literal["curvature", "perona-malik-exponential", "perona-malik-rational"]

_CACHE_BYTES = 1_000_000
_MOST_STEPS_AT_ONCE = 8


def largest_stable_time_step(model: Model = "curvature") -> float:
    """Largest time step of the explicit scheme that makes no new extrema.

    Perona–Malik: a step is a mean of the five values with weights >= 0 while ``time_step <= 1/4``.
    Curvature: with frozen coefficients the central differences have the symbol ``-4 g`` at worst, so that
    ``time_step <= 1/2`` is stable in the 2-norm; `diffuse` secures the extrema themselves.

    Examples
    --------
    >>> from tilepipe_kernels.image.diffusion import largest_stable_time_step
    >>> largest_stable_time_step("curvature"), largest_stable_time_step("perona-malik-rational")
    (0.5, 0.25)
    """
    _check_model(model)
    return 0.5 if model == "curvature" else 0.25


def halo(steps: int, gradient_sigma: float = 1.0, model: Model = "curvature") -> int:
    """Pixels on each side on which a result depends: exact, `steps` times the radius of one step.

    One step of the curvature model needs the Gaussian, cut off at ``ceil(3 σ)``, at the four neighbours; one
    step of Perona–Malik needs the four neighbours.

    Examples
    --------
    >>> from tilepipe_kernels.image.diffusion import halo
    >>> halo(40, gradient_sigma=1.0)  # 40 steps of the curvature model, each of them seeing 3 + 1 pixels far
    160
    >>> halo(40, model="perona-malik-rational")
    40
    """
    _check_model(model)
    return steps * _reach(gradient_sigma, model)


def diffuse(
    block: ArrayLike,
    *,
    steps: int,
    time_step: float,
    conductance: float,
    gradient_sigma: float = 1.0,
    fidelity: float = 1.0,
    model: Model = "curvature",
    core: Window | None = None,
) -> NDArray[np.float32]:
    """Smooth an image by nonlinear diffusion, explicit Euler.

    ``"curvature"`` (Barcelos, Boaventura & Silva 2003)::

        u_t = g |∇u| div(∇u/|∇u|) - λ (1 - g)(u - I),    g = 1 / (1 + k |∇(G_σ * u)|²),    u(0) = I

    ``"perona-malik-exponential"`` and ``"perona-malik-rational"`` (Perona & Malik 1990, eq. 7)::

        u_t = Σ over the 4 neighbours of c(d) d,    c = exp(-(d/K)²)  or  1 / (1 + (d/K)²)

    The mixed derivative gives some neighbours negative weights, so central differences of the curvature term
    can overshoot at noisy pixels although the equation itself makes no new extrema.  Each step of that model
    is therefore limited to the range of u in the 3 x 3 neighbourhood and of I at the pixel.

    Parameters
    ----------
    block
        Grey values, shape (rows, columns), any real dtype, on a 0..255 scale (k and K depend on it).  Values
        that are not finite are nodata: they stay missing (NaN) and neither give nor take; a missing
        neighbour, or one outside the block, counts as equal to the centre, also in each of the two
        one-dimensional Gaussian sums.  An array of a device stays there, and the result is the same to the bit.
    steps
        Number of time steps.
    time_step
        At most `largest_stable_time_step`.
    conductance
        k >= 0 of the curvature model, per squared grey level; edge threshold K > 0 of Perona–Malik.
    gradient_sigma
        Standard deviation σ of the Gaussian, pixels; 0 = none.  Curvature model only.
    fidelity
        λ in [0, 1].  Curvature model only.
    model
        Which equation.
    core
        Window (first row, end row, first column, end column) of the block that is wanted; each step then
        computes only what the following steps need of it.  None = all.

    Returns
    -------
    ndarray of float32
        The smoothed core.

    Raises
    ------
    ValueError
        For an unstable time step (the message names the bound), a parameter out of range, a block that is not
        a two-dimensional real array, a core outside the block.

    Examples
    --------
    A noisy dark street (about 40) beside a noisy bright roof (about 200): each becomes even, and the border stays.

    >>> import numpy as np
    >>> from tilepipe_kernels.image.diffusion import diffuse
    >>> grey = np.array([[36, 44, 40, 204, 196, 200], [44, 36, 42, 196, 204, 198], [38, 42, 40, 202, 198, 200]])
    >>> smooth = diffuse(grey, steps=20, time_step=0.25, conductance=20, model="perona-malik-exponential")
    >>> smooth[1].round().astype(int).tolist()
    [40, 40, 40, 200, 200, 200]
    """
    image: Any = block if on_device(block) else np.asarray(block)
    if image.ndim != 2 or image.dtype.kind not in "buif":
        raise ValueError(f"diffuse needs a two-dimensional real block, not {image.dtype} of shape {image.shape}")
    _check_parameters(steps, time_step, conductance, gradient_sigma, fidelity, model)
    xp = namespace(image)
    rows, columns = image.shape
    r0, r1, c0, c1 = (0, rows, 0, columns) if core is None else (int(edge) for edge in core)
    if not (0 <= r0 <= r1 <= rows and 0 <= c0 <= c1 <= columns):
        raise ValueError(f"core {core} does not lie in the block of {rows} x {columns} pixels")
    if r0 == r1 or c0 == c1:
        empty: NDArray[np.float32] = xp.empty((r1 - r0, c1 - c0), xp.float32)
        return empty

    image = xp.ascontiguousarray(image, dtype=xp.float32)
    terms = _terms(time_step, conductance, gradient_sigma, fidelity, model)
    if on_device(image):
        smoothed: NDArray[np.float32] = device_form(__name__).run_steps(image, (r0, r1, c0, c1), int(steps), terms)
        return smoothed
    reach = terms.reach
    padded = _padded_width(columns + 2 * reach)
    # A step in flight needs `reach` rows of the image and twice as many turning ones in the cache.
    at_once = max(1, min(_MOST_STEPS_AT_ONCE, steps, _CACHE_BYTES // (4 * padded * (3 * reach + 6))))
    turning = np.empty((rows + at_once * (reach + 1) + 1, padded), np.float32)
    whole = load(turning, image, reach)
    first = run_steps(turning, image, whole, (r0, r1, c0, c1), int(steps), at_once, terms)
    slots = (first + np.arange(r0, r1)) % (turning.shape[0] - 1)
    result: NDArray[np.float32] = turning[slots, reach + c0 : reach + c1]
    return result


def _terms(
    time_step: float, conductance: float, gradient_sigma: float, fidelity: float, model: Model
) -> Terms:  # fmt: skip
    curvature = model == "curvature"
    # Bounded, so that every product of the rules is finite in float32 for grey levels up to a million.
    strength = min(conductance, 1e10) if curvature else max(conductance, 1e-15) ** -2
    return Terms(
        model=get_args(Model).index(model),
        reach=_reach(gradient_sigma, model),
        weights=_gaussian_weights(gradient_sigma if curvature else 0.0),
        time_step=np.float32(time_step),
        strength=np.float32(strength),
        fidelity=np.float32(fidelity),
    )


def _reach(gradient_sigma: float, model: Model) -> int:
    return math.ceil(3 * gradient_sigma) + 1 if model == "curvature" else 1


def _padded_width(width: int) -> int:
    """Width of a stored row: whole cache lines; near rows must not fall together modulo a 4 KiB page."""
    lines = -(-width // 16)
    while not 4 < lines % 64 < 60:
        lines += 1
    return 16 * lines


def _gaussian_weights(sigma: float) -> NDArray[np.float32]:
    """Weights of the centre and of one neighbour at distance 1, 2, ...; centre + 2 x the others = 1."""
    distance = np.arange(math.ceil(3 * sigma) + 1)
    weights = np.exp(-0.5 * (distance / max(sigma, 1e-9)) ** 2)
    weights = (weights / (2 * weights.sum() - 1)).astype(np.float32)
    weights[0] = 1 - 2 * weights[1:].sum(dtype=np.float64)
    return np.asarray(weights, np.float32)


def _check_model(model: str) -> None:
    if model not in get_args(Model):
        raise ValueError(f"unknown diffusion model {model!r}; choose one of {', '.join(get_args(Model))}")


def _check_parameters(
    steps: int, time_step: float, conductance: float, gradient_sigma: float, fidelity: float, model: Model
) -> None:
    _check_model(model)
    bound = largest_stable_time_step(model)
    if not 0 < time_step <= bound:
        raise ValueError(f"time_step {time_step} is not stable; the {model} model needs 0 < time_step <= {bound}")
    if steps < 0:
        raise ValueError(f"steps must be 0 or more, not {steps}")
    if not math.isfinite(conductance) or conductance < 0 or (conductance == 0 and model != "curvature"):
        raise ValueError(f"conductance must be a positive number, not {conductance}")
    if not 0 <= gradient_sigma < math.inf:
        raise ValueError(f"gradient_sigma must be 0 or more pixels, not {gradient_sigma}")
    if not 0 <= fidelity <= 1:
        raise ValueError(f"fidelity must lie between 0 and 1, not {fidelity}")
