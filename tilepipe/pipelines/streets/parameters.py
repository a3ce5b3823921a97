"""The parameters of `streets`, in ground units, with defaults that suit city streets."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

Model = Literal["curvature", "perona-malik-exponential", "perona-malik-rational"]


class StreetParameters(BaseModel):
    """Parameters of the streets pipeline.

    Lengths are in metres, areas in m², grey values on a scale of 0 to 255 to which the raster is stretched between
    two of its percentiles, so that the same values serve 8-bit, 16-bit and float intensity.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    # grey scale
    lowest_percentile: float = Field(1.0, ge=0, lt=100, description="percentile of the raster that becomes grey 0")
    highest_percentile: float = Field(99.0, gt=0, le=100, description="percentile that becomes grey 255")
    void_reach: float = Field(
        1.5,
        ge=0,
        description="small voids are bridged from the nearest value within this reach (m) for the analysis",
    )

    # diffusion
    diffusion_model: Model = Field("curvature", description="curvature (Barcelos et al. 2003) or Perona–Malik")
    diffusion_steps: int = Field(50, ge=0, le=1000, description="number of diffusion steps (n)")
    time_step: float = Field(0.5, gt=0, description="time step of the diffusion (dt)")
    conductance: float = Field(1.0, ge=0, le=1e06, description="k of g = 1/(1 + k·(gradient/edge_gradient)²)")
    edge_gradient: float | None = Field(
        None,
        ge=0.001,
        description="grey levels per pixel that make an edge; none = 0.6 of the raster's noise, at least 4",
    )
    gradient_sigma: float = Field(0.5, ge=0, le=50, description="Gaussian of the gradient (σ, m)")
    fidelity: float = Field(1.0, ge=0, le=1, description="pull towards the input at edges (λ)")

    # region growing
    rectangle_rows: int = Field(1, ge=1, le=99, description="rows of a rectangle, odd (row)")
    rectangle_columns: int = Field(1, ge=1, le=99, description="columns of a rectangle, odd (column)")
    tolerance: float = Field(4.0, ge=0, description="largest grey difference of neighbours in a region")
    minimum_size: float = Field(50.0, ge=0, description="smallest area of a region (m²)")
    darkness: float | None = Field(
        None,
        ge=0,
        le=255,
        description="only grey values up to this join a region; none = Otsu's threshold of the raster",
    )

    # selection
    minimum_contour: float = Field(150.0, ge=0, description="shortest outer and inner contour of a street region (m)")
    maximum_contour: float = Field(
        math.inf, gt=0, allow_inf_nan=True, description="longest contour of a street region (m)"
    )
    minimum_elongation: float = Field(8.0, ge=0, description="least length over width of a street region")
    maximum_mean_width: float = Field(25.0, gt=0, description="largest mean width of a street region (m)")
    maximum_height: float = Field(1.0, gt=0, description="with a height raster: highest above ground on a street (m)")
    ground_window: float = Field(
        40.0, gt=0, le=1000, description="with a height raster: wider than the widest roof (m)"
    )
    closing_radius: float = Field(1.0, ge=0, le=100, description="gaps of regions closed by a disc of this radius (m)")
    speck_size: float = Field(
        6.0, ge=0, le=200, description="holes that fit in a square of this side are filled: cars (m)"
    )
    opening_radius: float = Field(
        1.0, ge=0, le=100, description="whiskers of regions opened by a disc of this radius (m)"
    )

    # centerlines by ridge lines
    line_width: float = Field(
        16.0, gt=0, le=1000, description="width of the widest street (m); sets the scale of the lines"
    )
    line_sigma: float | None = Field(
        None, gt=0, le=1000, description="scale σ of the lines (m); none = line_width/(2√3)"
    )
    thresholds: Literal["contrast", "histogram", "absolute"] = Field(
        "contrast",
        description="how low and high are meant: share of the contrast, of the histogram, or grey per m²",
    )
    low: float = Field(0.2, gt=0, description="lower hysteresis threshold")
    high: float = Field(0.5, ge=0, description="upper hysteresis threshold")
    minimum_street_width: float = Field(
        4.0, gt=0, le=1000, description="narrowest street that must pass the thresholds (m)"
    )
    junction_distance: float = Field(8.0, ge=0, le=1000, description="junctions this near to each other become one (m)")
    minimum_length: float = Field(30.0, ge=0, le=1e06, description="shortest line or group of lines kept (m)")
    maximum_gap: float = Field(
        15.0, ge=0, le=1000, description="longest gap between a line's end and the next line closed (m)"
    )
    maximum_gap_angle: float = Field(30.0, ge=0, le=90, description="largest turn on closing a gap (degrees)")
    simplification: float = Field(0.2, ge=0, le=1000, description="tolerance of the lines' vertices (m), 0 = keep all")

    # centerlines by skeleton
    minimum_branch: float = Field(15.0, ge=0, le=1e06, description="shortest branch that pruning leaves (m) (length)")
    separation: float = Field(
        4.0, gt=0, le=1000, description="least distance of the two borders that a medial axis touches (m)"
    )
    maximum_width: float = Field(40.0, gt=0, le=1000, description="wider places hold no axis (m)")

    @field_validator("rectangle_rows", "rectangle_columns")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError(f"must be odd, so that a rectangle has a centre pixel: use {value - 1} or {value + 1}")
        return value

    @model_validator(mode="after")
    def _ordered(self) -> StreetParameters:
        if self.low > self.high:
            raise ValueError(f"low ({self.low}) must not exceed high ({self.high})")
        if self.lowest_percentile >= self.highest_percentile:
            raise ValueError("lowest_percentile must lie below highest_percentile")
        if self.minimum_contour > self.maximum_contour:
            raise ValueError("minimum_contour must not exceed maximum_contour")
        from tilepipe_kernels.image.diffusion import largest_stable_time_step

        bound = largest_stable_time_step(self.diffusion_model)
        if self.time_step > bound:
            raise ValueError(f"time_step {self.time_step} is unstable: use at most {bound} for {self.diffusion_model}")
        return self

    @property
    def sigma(self) -> float:
        """Scale σ of the ridge lines in metres: σ ≥ w/√3 for the half width w (Steger 1998, eq. 9)."""
        return self.line_sigma if self.line_sigma is not None else self.line_width / 2 / math.sqrt(3)

    def sigma_in_pixels(self, resolution: float) -> float:
        """Scale σ of the ridge lines in pixels of ``resolution`` metres, at least one pixel."""
        return max(1.0, self.sigma / resolution)

    def half_width_in_pixels(self, resolution: float) -> int:
        """Half the width of the widest place with an axis in whole pixels of ``resolution`` metres."""
        return max(2, math.ceil(self.maximum_width / resolution / 2))
