"""The parameters of `objects`, in ground units, with defaults that suit city surfaces."""

from __future__ import annotations

import math
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

BorderWeights = Literal["adjacency", "border", "contrast"]


class ObjectParameters(BaseModel):
    """Parameters of the objects pipeline: lengths and heights in metres, areas in m²."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    # quadtree
    split_deviation: float = Field(
        0.35, gt=0, le=1000, description="a square is split while its heights deviate by more than this (σ0, m)"
    )
    smallest_leaf: float = Field(1.0, gt=0, description="side of the smallest square (m)")
    largest_leaf: float = Field(32.0, gt=0, description="side of the largest square (m)")

    # Bayesian model and its sampler
    border_weights: BorderWeights = Field(
        "adjacency", description="weight of neighbours: all one (adjacency), by border length, or by contrast"
    )
    variance: float | None = Field(None, gt=0, description="variance of heights in a region (σ²); none = learned")
    burn_in: int = Field(10, ge=0, le=100_000, description="sweeps before the first draw")
    draws: int = Field(80, ge=4, le=100_000, description="draws of the posterior")
    thinning: int = Field(1, ge=1, le=1000, description="sweeps from one draw to the next")

    # merging
    merge_height: float = Field(0.5, gt=0, description="regions whose heights differ by at most this are one (δ, m)")
    merge_probability: float = Field(
        0.5, gt=0, le=1, description="neighbours merge when they are one with at least this probability"
    )
    merge_rounds: int = Field(60, ge=0, le=1000, description="most rounds of merging")

    # polygons
    minimum_area: float = Field(
        4.0,
        ge=0,
        description="smaller regions, and those below four smallest squares, join their most similar neighbour (m²)",
    )
    simplification: float = Field(0.75, ge=0, description="tolerance of the borders' vertices (m); 0 = pixel steps")
    regularisation: float = Field(
        0.0, ge=0, le=1000, description="largest move of a building's corner to make walls right-angled (m); 0 = off"
    )

    # buildings
    buildings: bool = Field(True, description="recognise buildings and write them as a layer of their own")
    minimum_building_height: float = Field(
        2.5, gt=0, description="a building's roof is at least this high above the ground (m)"
    )
    minimum_building_area: float = Field(10.0, ge=0, description="smallest building (m²)")
    largest_building: float = Field(
        80.0, gt=0, le=1000, description="what is wider than this on its narrower side is ground (m)"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.smallest_leaf > self.largest_leaf:
            raise ValueError(f"smallest_leaf {self.smallest_leaf} exceeds largest_leaf {self.largest_leaf}")
        return self

    def smallest_region(self, resolution: float) -> float:
        """Area of the smallest region in pixels of ``resolution`` metres."""
        if self.minimum_area == 0:
            return 0.0
        smallest, _ = self.leaf_sides(resolution)
        return max(self.minimum_area / resolution**2, 4.0 * smallest**2)

    def leaf_sides(self, resolution: float) -> tuple[int, int]:
        """Sides of the smallest and the largest square in pixels: powers of two, the nearest not above."""
        smallest, largest = (
            1 << max(0, math.floor(math.log2(side / resolution) + 1e-9))
            for side in (self.smallest_leaf, self.largest_leaf)
        )
        return smallest, largest
