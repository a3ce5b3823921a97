"""What the whole image says of itself: its grey values, levels and energy, as JSON."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.work import Work
from tilepipe.pipelines.edges.layers import IMAGE_SUMMARY
from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.pipelines.edges.pass_bands import Photograph
from tilepipe.pipelines.edges.pass_fields import count_fields
from tilepipe.pipelines.edges.pass_levels import LevelScale

_MOST_UNRESOLVED = 1e-4
"""Share of sites that still want to change above which a warning is due."""


def write_summary(run: Work, photograph: Photograph, scale: LevelScale, fields: Ledger) -> Path:
    """Write ``edges.json`` into the state folder; warn when the cap on rounds has left much."""
    p: EdgeParameters = run.parameters
    found, model = count_fields(fields.each()), p.model(scale.noise)
    annealing = p.optimiser == "annealing"
    sites = 3 * run.raster.shape[0] * run.raster.shape[1]
    if found.unresolved > _MOST_UNRESOLVED * sites:
        sweeps = f"{p.sweeps} sweeps and " if annealing else ""
        warnings.warn(
            f"{found.unresolved:,} of {sites:,} sites still wanted to change after {sweeps}"
            f"{p.rounds} rounds; use --set rounds=n with a larger n",
            stacklevel=4,
        )
    values = {
        "grey": photograph.conversion,
        "band_weights": photograph.weights,
        "grey_range": [scale.darkest, scale.brightest],
        "level_values": [scale.darkest + mean / 255 * (scale.brightest - scale.darkest) for mean in scale.means],
        "noise_in_levels": scale.noise,
        "energy": found.terms.total(model),
        "energy_of_levels": found.terms.intensity(model),
        "energy_of_lines": found.terms.lines(model),
        # rounds of descent come after the sweeps
        **({"sweeps": p.sweeps} if annealing else {}),
        "most_rounds": p.rounds,
        "unresolved_sites": found.unresolved,
    }
    path = run.folder / IMAGE_SUMMARY.name
    path.write_text(json.dumps(values, indent=1) + "\n")
    return path
