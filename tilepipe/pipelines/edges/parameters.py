"""The parameters of `edges`; those of the model are in the unit of one grey level, as the paper's are."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from tilepipe.pipelines.edges.pass_bands import Grey
from tilepipe_kernels.mrf.annealing import Annealing
from tilepipe_kernels.mrf.edge_model import EdgeModel
from tilepipe_kernels.mrf.search import Search

Potential = Literal["reciprocal", "quadratic"]
Scheme = Literal["sequential", "integrated"]
Optimiser = Literal["parallel", "messages", "icm", "annealing"]


class EdgeParameters(BaseModel):
    """Parameters of the edges pipeline: lengths in metres unless said otherwise."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    # grey levels
    grey: Grey = Field("automatic", description="grey value of several bands: automatic, luminance or principal")
    lowest_percentile: float = Field(1.0, ge=0, lt=100, description="percentile of the image that becomes grey 0")
    highest_percentile: float = Field(99.0, gt=0, le=100, description="percentile that becomes grey 255")
    levels: int = Field(4, ge=2, le=64, description="grey levels to which the image is reduced (K)")

    # model
    potential: Potential = Field("reciprocal", description="f(d): reciprocal, -1/(1 + |d|), or quadratic, d²")
    scheme: Scheme = Field("sequential", description="levels first and lines then (sequential), or both (integrated)")
    noise: float | None = Field(
        None, gt=0, le=100, description="noise in grey levels (σ); none = the image's own, at least 0.3"
    )
    smoothness: float = Field(1.0, ge=0, le=100, description="weight of equal neighbours (β)")
    step_weight: float = Field(0.5, ge=0, le=100, description="weight of steps that no line element marks (α)")
    continuity: float = Field(0.1, ge=0, le=100, description="weight of lines that end (γ)")
    corners: float = Field(0.1, ge=0, le=100, description="weight of corners (ξ)")
    parallels: float = Field(0.5, ge=0, le=100, description="weight of parallel lines side by side (ζ)")

    # optimisation
    optimiser: Optimiser = Field(
        "parallel",
        description="parallel (HCF in rounds), messages (HCF that starts with levels found by messages: lower "
        "energies, far lower with many levels), icm or annealing",
    )
    rounds: int = Field(24, ge=1, le=1000, description="most rounds for each field; sets the halo of the tiles")
    sweeps: int = Field(100, ge=1, le=10_000, description="sweeps of annealing; set the halo of the tiles")

    # edge lines
    simplification: float = Field(
        0.15, ge=0, le=0.5, description="tolerance of the lines' vertices in pixels; lines stay within 0.35 more"
    )
    minimum_length: float = Field(5.0, ge=0, le=1e06, description="shortest edge line, or group of lines that meet (m)")
    minimum_street_width: float = Field(4.0, gt=0, le=1000, description="narrowest street between two edges (m)")
    maximum_street_width: float = Field(25.0, gt=0, le=1000, description="widest street between two edges (m)")
    minimum_street_length: float = Field(15.0, ge=0, le=1e06, description="shortest border of a street (m)")
    maximum_street_angle: float = Field(
        10.0, gt=0, le=45, description="largest angle of the two borders of a street (degrees)"
    )

    # Nevatia–Babu
    nevatia_babu: bool = Field(True, description="find edges by the classical method as well")
    edge_share: float | None = Field(
        None,
        gt=0,
        le=1,
        description="share of the thinned edge elements kept; none = corner of their histogram (Rosin)",
    )
    edge_tolerance: float = Field(1.0, gt=0, le=100, description="tolerance of its straight lines in pixels")
    minimum_edge_length: float = Field(5.0, ge=0, le=1e06, description="shortest of its lines (m)")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.lowest_percentile >= self.highest_percentile:
            raise ValueError("lowest_percentile must lie below highest_percentile")
        if self.minimum_street_width > self.maximum_street_width:
            raise ValueError("minimum_street_width must not exceed maximum_street_width")
        return self

    def model(self, noise: float = 1.0) -> EdgeModel:
        """The energy of an image of so much noise, in the letters of its equations."""
        return EdgeModel(
            levels=self.levels,
            potential=self.potential,
            alpha=self.step_weight,
            gamma=self.continuity,
            xi=self.corners,
            zeta=self.parallels,
            beta=self.smoothness,
            sigma=noise,
        )

    def search(self, seed: int = 0) -> Search:
        """How the levels are searched for."""
        return Search(self.optimiser, self.rounds, Annealing(self.sweeps, seed=seed))

    def line_search(self, seed: int = 0) -> Search:
        """How the lines are searched for; messages are between levels."""
        search = self.search(seed)
        return replace(search, method="parallel") if search.method == "messages" else search
