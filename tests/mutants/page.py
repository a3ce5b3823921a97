"""The page about a sample: the score of each folder, and what survived."""

from __future__ import annotations

import math
import platform
from collections import Counter
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from tests.commit import commit
from tests.mutants.judged import Judgement, equivalent
from tests.mutants.trials import KILLED, LATE, SURVIVED, UNCOVERED, Outcome

_CONFIDENCE = 1.959964
"""Quantile of the normal distribution for 95 %."""


_WHAT = """\
Each mutant is one small change of the code (an operator, a number, a condition, a decorator), tried by the tests that
run its line and, where it survives them, by others that run its file. A test that takes ten times as long as it should
has seen it too. Left out are annotations and `TYPE_CHECKING`, which nothing runs, `strict` of `zip` and `frozen` of
`dataclass`, which only assert, and equality that becomes identity, which depends on the interpreter. *Equivalent* are
those in `tests/mutants/judged.toml`, which nobody could see; the score is of the others, with its 95 % interval
(Wilson). *Not covered* counts as survived.
"""


def wilson(killed: int, of: int) -> tuple[float, float]:
    """95 % interval of a share by Wilson's score.

    Parameters
    ----------
    killed
        Successes.
    of
        Trials, at least one.
    """
    share, z = killed / of, _CONFIDENCE
    middle, scale = share + z * z / (2 * of), 1 + z * z / of
    spread = z * math.sqrt(share * (1 - share) / of + z * z / (4 * of * of))
    return max(0.0, (middle - spread) / scale), min(1.0, (middle + spread) / scale)


def page(command: str, root: Path, counts: dict[str, int], outcomes: Sequence[Outcome], known: list[Judgement]) -> str:
    """Markdown of a sample.

    Parameters
    ----------
    command
        That made it.
    root
        Of the checkout.
    counts
        Number of all mutants, by folder.
    outcomes
        Of the sample.
    known
        Mutants that are judged to change nothing.
    """
    lines = [
        "# Mutants",
        "",
        f"`{command}` at {commit(root)}; Python {platform.python_version()}, "
        f"cosmic-ray {version('cosmic-ray')}, pytest {version('pytest')}.",
        "",
        *_WHAT.splitlines(),
        "",
        "| folder | mutants | tried | killed | timed out | survived | not covered | equivalent | score |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---|",
    ]
    lines += [
        _row(folder, counts[folder], [each for each in outcomes if _is_in(each, folder)], known) for folder in counts
    ]
    if len(counts) > 1:
        lines.append(_row("all", sum(counts.values()), outcomes, known))
    alive = [each for each in outcomes if each.ended in (SURVIVED, UNCOVERED)]
    open_ones = [each for each in alive if equivalent(each.mutant, known) is None]
    lines += ["", "## Survivors", "", *(_survivor(each) for each in open_ones)]
    lines += ["", "## Equivalent", ""]
    lines += [
        f"{_survivor(each)}: {found.why}" for each in alive if (found := equivalent(each.mutant, known)) is not None
    ]
    return "\n".join(lines).rstrip() + "\n"


def _is_in(outcome: Outcome, folder: str) -> bool:
    return Path(outcome.mutant.path).is_relative_to(folder)


def _row(name: str, count: int, outcomes: Sequence[Outcome], known: list[Judgement]) -> str:
    ended = Counter(
        "equivalent" if each.ended in (SURVIVED, UNCOVERED) and equivalent(each.mutant, known) else each.ended
        for each in outcomes
    )
    killed, of = ended[KILLED] + ended[LATE], len(outcomes) - ended["equivalent"]
    low, high = wilson(killed, of) if of else (0.0, 1.0)
    score = f"{killed / of:.1%} ({low:.1%} to {high:.1%})" if of else "–"
    numbers = (ended[each] for each in (KILLED, LATE, SURVIVED, UNCOVERED, "equivalent"))
    return f"| `{name}` | {count:,} | {len(outcomes)} | {' | '.join(map(str, numbers))} | {score} |"


def _survivor(outcome: Outcome) -> str:
    mutant = outcome.mutant
    unseen = ", not covered" if outcome.ended == UNCOVERED else ""
    return f"- {mutant.path}:{mutant.line}, {mutant.operator}{unseen}: ``{mutant.before}`` → ``{mutant.after}``"
