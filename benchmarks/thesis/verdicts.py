"""Whether the three conclusions of Barbosa (1994) hold, by a fixed rule.

A conclusion says that one of two treatments beats the other.  It is tried on pairs of runs that differ in nothing
else, by two measures each: a pair is won if one measure is better and none worse, lost if one is worse and none
better, and open otherwise; `CLOSE` values count as equal.  The conclusion holds if at least `MOST` of the pairs are
won, it does not if at most 1 - `MOST` are, and the finding is mixed in between.

1. "The reciprocal model gives better results in the continuity of the lines detected": the pairs have the same
   scene, way and number of levels; F1 of the borders of roads and their unbroken stretch.
2. "Joint optimisation does not lead to results as good as factorised": same scene, potential and number of levels;
   the same two measures.
3. "A far smaller number of false detections" than with the classical method: the run of figures 24 and 25 against
   Nevatia & Babu with the threshold at the corner of their histogram, and with that of equal recall; length of the
   false detections, that is, on no border of a road, and F1.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from benchmarks.thesis.results import COMPARED, CORNER, MATCHED, Results
from benchmarks.thesis.runs import Form, Run
from benchmarks.thesis.scores import Score

CLOSE = 0.02
"""Relative difference up to which two values count as equal."""

MOST = 0.75

Outcome = Literal["won", "lost", "open"]
Verdict = Literal["holds", "does not hold", "mixed"]

CONCLUSIONS = (
    "1. reciprocal beats quadratic",
    "2. sequential beats integrated",
    "3. Bayesian beats classical",
)


@dataclass(frozen=True)
class Measure:
    """A field of `Score`, and whether less of it is better."""

    field: str
    less: bool = False

    def compare(self, ours: Score, theirs: Score) -> int:
        """1 if ours is better, -1 if theirs is, 0 if they are close."""
        a, b = getattr(ours, self.field), getattr(theirs, self.field)
        if abs(a - b) <= CLOSE * max(abs(a), abs(b)):
            return 0
        return 1 if (a < b) == self.less else -1


F1, STRETCH, FALSE = Measure("f1"), Measure("stretch"), Measure("false", less=True)


@dataclass(frozen=True)
class Finding:
    """How the pairs of a conclusion came out."""

    outcomes: tuple[Outcome, ...]

    @property
    def won(self) -> int:
        """Number of pairs won."""
        return self.outcomes.count("won")

    @property
    def lost(self) -> int:
        """Number of pairs lost."""
        return self.outcomes.count("lost")

    @property
    def verdict(self) -> Verdict:
        """What follows."""
        share = self.won / len(self.outcomes)
        return "holds" if share >= MOST else "does not hold" if share <= 1 - MOST else "mixed"

    @property
    def line(self) -> str:
        """For tables."""
        return f"**{self.verdict}** ({self.won} won, {self.lost} lost of {len(self.outcomes)})"


def compare(ours: Score, theirs: Score, measures: Sequence[Measure]) -> Outcome:
    """Outcome of a pair."""
    signs = {measure.compare(ours, theirs) for measure in measures} - {0}
    return "won" if signs == {1} else "lost" if signs == {-1} else "open"


def judge(results: Sequence[Results], form: Form) -> tuple[Finding, Finding, Finding]:
    """The findings for the three conclusions in one form of the optimiser, over scenes with known truth."""
    potentials, ways, classical = [], [], []
    for result in results:
        for way, levels in itertools.product(("sequential", "integrated"), (2, 4)):
            pair = [result.runs[form, Run(way, levels, each)].score for each in ("reciprocal", "quadratic")]
            potentials.append(compare(pair[0], pair[1], (F1, STRETCH)))
        for potential, levels in itertools.product(("reciprocal", "quadratic"), (2, 4)):
            pair = [result.runs[form, Run(each, levels, potential)].score for each in ("sequential", "integrated")]
            ways.append(compare(pair[0], pair[1], (F1, STRETCH)))
        bayesian = result.runs[form, COMPARED].score
        for rule in ((CORNER, ""), (MATCHED, form.key)):
            classical.append(compare(bayesian, result.classical[rule].score, (FALSE, F1)))
    return Finding(tuple(potentials)), Finding(tuple(ways)), Finding(tuple(classical))


def lower_energies(results: Sequence[Results], form: Form) -> tuple[int, int]:
    """In how many pairs the sequential run ended at a lower energy than the integrated one, and how many there are."""
    pairs = [
        [result.runs[form, Run(way, levels, potential)].energy for way in ("sequential", "integrated")]
        for result in results
        for potential, levels in itertools.product(("reciprocal", "quadratic"), (2, 4))
    ]
    return sum(sequential < integrated for sequential, integrated in pairs), len(pairs)
