"""Whether the sampler of `objects` has converged: diagnostics of the two variances, for people and programs."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

from tilepipe.engine.work import Work
from tilepipe.pipelines.objects.layers import CONVERGENCE
from tilepipe.pipelines.objects.reconcile_regions import Merged
from tilepipe_kernels.car_model.convergence import effective_sample_size, split_rhat
from tilepipe_kernels.car_model.model import Traces

LARGEST_RHAT = 1.1
"""Above it the halves of a trace disagree (Gelman et al. 2013, section 11.4)."""

LEAST_EFFECTIVE = 10.0
"""Fewer effective draws say too little of a variance."""


def diagnose(posterior: Traces, *, fixed_variance: bool) -> dict[str, Any]:
    """Mean, standard deviation, effective sample size and split-R̂ of the variances of the leaves' heights.

    Parameters
    ----------
    posterior
        Of the leaves, before anything merged.
    fixed_variance
        Whether σ² was given, so that it has no trace to judge.

    Returns
    -------
    dict
        ``converged``, ``draws``, and for each variance (m²) its figures and its trace.
    """
    traces = {"smoothness_v": posterior.smoothness}
    if not fixed_variance:
        traces["noise_sigma2"] = posterior.noise
    found: dict[str, Any] = {"converged": True, "draws": len(posterior.smoothness)}
    for name, trace in traces.items():
        effective, rhat = effective_sample_size(trace), split_rhat(trace)
        found["converged"] &= bool(rhat <= LARGEST_RHAT and effective >= LEAST_EFFECTIVE)
        found[name] = {
            "mean": float(trace.mean()),
            "deviation": float(trace.std()),
            "effective_sample_size": round(float(effective), 1),
            "split_rhat": round(float(rhat), 4),
            "trace": [float(f"{value:.6g}") for value in trace],
        }
    return found


def warning(found: dict[str, Any]) -> str | None:
    """One line when the sampler has not converged, saying what to do."""
    if found["converged"]:
        return None
    figures = ", ".join(
        f"{name}: R̂ {found[name]['split_rhat']:g}, effective sample size {found[name]['effective_sample_size']:g}"
        for name in ("smoothness_v", "noise_sigma2")
        if name in found
    )
    return f"the sampler has not converged ({figures}); raise burn_in and draws, or fix the variance"


def as_text(found: dict[str, Any]) -> str:
    """The diagnostics as the file ``convergence.json``."""
    return json.dumps(found, indent=1)


def write_convergence(run: Work, merged: Merged) -> Path:
    """Write the diagnostics of the sampler into the state folder; warn when it has not converged."""
    found = diagnose(merged.first, fixed_variance=run.parameters.variance is not None)
    if (text := warning(found)) is not None:
        warnings.warn(text, stacklevel=3)
    path = run.folder / CONVERGENCE.name
    path.write_text(as_text(found))
    return path
