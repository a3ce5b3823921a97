"""A small change of a tiny module is seen by its test, one that no test runs is not, and what is counted is said."""

from __future__ import annotations

import ast
import subprocess

import pytest

from tests.mutants import trials
from tests.mutants.checkout import ROOT, copied
from tests.mutants.covering import Covering, from_table, measure
from tests.mutants.judged import Judgement, equivalent, judgements, outdated
from tests.mutants.making import Mutant, made, mutants, sample
from tests.mutants.page import page, wilson
from tests.mutants.places import of_no_effect, place
from tests.mutants.trials import KILLED, LATE, SURVIVED, UNCOVERED, Outcome, failing, from_line, to_line

MODULE = """from __future__ import annotations

MOST = 3


def larger(a: int | float, b: int) -> int:
    return a if a > b else b


def unused(a: int) -> int:
    return a + 1


def begun(count: int = 2) -> int:
    while count > 0:
        count -= 1
    return count + MOST


def made() -> list[int]:
    return [1 + 1]
"""

TESTS = """import subprocess, sys

import pytest

from small import begun, larger, made


@pytest.fixture(scope="module")
def shared():
    return made()


def test_begun():
    assert begun() == 3


@pytest.mark.parametrize("sign", ["|"])
def test_first(shared, sign):
    assert larger(1, 0) == 1


def test_second(shared):
    assert shared == [2]


def test_another_process():
    command = "import small; assert small.larger(1, 2) == 2"
    subprocess.run([sys.executable, "-c", command], check=True)


def test_that_fails():
    assert larger(1, 2) == 1
"""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    root = tmp_path_factory.mktemp("tiny") / "tiny"
    root.mkdir()
    (root / "small.py").write_text(MODULE)
    (root / "test_small.py").write_text(TESTS)
    subprocess.run(["git", "init", "-q"], cwd=root, check=True)
    with copied(root) as copy:
        covering = from_table(measure(copy, ".", ["test_small.py"]))
    with trials.trials(root, covering, 60) as here:
        yield here


def names(tests):
    return {test.partition("::test_")[2] for test in tests}


def test_lines_know_the_tests_that_run_them(tiny):
    covering = tiny.covering
    assert names(covering.seconds) == {"begun", "first[|]", "second", "another_process"}
    assert names(covering.tests("small.py", [7])) == {"first[|]", "another_process"}
    assert names(covering.tests("small.py", [21])) == {"first[|]", "second"}  # by the fixture of the module
    assert covering.tests("small.py", [11]) == set()


def test_of_the_fastest_tests_those_of_few_lines_come_first_and_those_of_a_file_together():
    lines = {1: frozenset({"a.py::1", "a.py::2", "b.py::1"}), 2: frozenset({"a.py::1", "a.py::2"}), 3: {"a.py::2"}}
    covering = Covering({"a.py::1": 3.0, "a.py::2": 1.0, "b.py::1": 2.0, "b.py::2": 9.0}, {"c.py": lines})
    assert covering.fastest(covering.seconds, 8) == ["b.py::1", "a.py::1", "a.py::2"]
    assert covering.fastest(covering.seconds, 4) == ["b.py::1", "a.py::2"]


@pytest.mark.parametrize(
    ("line", "before", "after", "ended", "by"),
    [
        (7, "a > b", "a < b", KILLED, {"first[|]", "another_process"}),
        (7, "a > b", "a >= b", SURVIVED, {""}),
        (11, "a + 1", "a - 1", UNCOVERED, {""}),
        (3, "MOST = 3", "MOST = 4", KILLED, {"begun"}),
        (14, "count: int = 2", "count: int = -1", KILLED, {"begun"}),
        (16, "count -= 1", "count += 1", LATE, {""}),
        (21, "[1 + 1]", "[1 - 1]", KILLED, {"second"}),
    ],
)
def test_a_mutant_ends_as_its_tests_say(tiny, monkeypatch, line, before, after, ended, by):
    monkeypatch.setattr(trials, "_SHORTEST", 2.0)
    outcome = tiny.outcome(Mutant("small.py", line, "by hand", 0), MODULE.replace(before, after, 1))
    assert outcome.ended == ended
    assert names([outcome.by]) <= by
    assert (tiny.copy / "small.py").read_text() == MODULE
    assert from_line(to_line(outcome)) == outcome


def test_what_a_failing_test_says_does_not_count(tiny):
    assert names(failing(tiny.copy, ["test_small.py::test_begun", "test_small.py::test_that_fails"])) == {"that_fails"}
    assert names(failing(tiny.copy, ["test_small.py::test_begun", "test_small.py::test_gone"])) == {"begun", "gone"}


def test_places():
    text = (
        "X = 1\n"
        "class A:\n"
        "    y = 2\n"
        "    @b\n"
        "    def f(self, n: int = 3) -> None:\n"
        "        try:\n"
        "            g(\n"
        "                n)\n"
        "        except E:\n"
        "            pass\n"
        "@dataclass(frozen=True)\n"
        "class B: pass\n"
        "def h(é: 'ö' | 1): return zip(é, strict=True)\n"
    )
    tree = ast.parse(text)
    assert place(tree, 8).lines == {7, 8}
    assert place(tree, 8).scope == set()
    assert place(tree, 9).lines == {9}
    assert place(tree, 4).scope == place(tree, 3).scope == set(range(6, 11))
    assert place(tree, 1).scope == {*range(6, 11), 13}
    spans = [(begin, end) for begin, end in of_no_effect(tree, text) if begin[0] > 10]
    assert sorted(spans) == [((11, 18), (11, 22)), ((13, 9), (13, 16)), ((13, 40), (13, 44))]


def test_every_operator_but_those_of_what_never_runs(tmp_path):
    pytest.importorskip("cosmic_ray")
    (tmp_path / "small.py").write_text(MODULE)
    found = mutants(tmp_path, "small.py")
    assert {mutant.line for mutant in found} == {3, 7, 11, 14, 15, 16, 17, 21}
    assert not {mutant for mutant in found if mutant.line == 6}
    first = list(sample(tmp_path, found, 12, 1))
    assert first == list(sample(tmp_path, found, 12, 1)) != list(sample(tmp_path, found, 12, 2))
    assert len(first) == len({mutant for mutant, _ in first}) == 12
    for mutant, mutated in first:
        changed = [after for after in mutated.splitlines() if after not in MODULE.splitlines()]
        assert [" ".join(each.split()) for each in changed] == [mutant.after]
        assert made(tmp_path, mutant) == (mutant, mutated)


def test_the_page_counts_what_is_neither_equivalent_nor_killed(tmp_path):
    pytest.importorskip("cosmic_ray")
    ends = [KILLED, KILLED, LATE, SURVIVED, UNCOVERED, SURVIVED]
    outcomes = [Outcome(Mutant("a/b.py", n, "op", 0, f"line {n}", "new"), end) for n, end in enumerate(ends)]
    told = page("scripts/mutants", tmp_path, {"a": 100}, outcomes, [Judgement("a/b.py", "line 5", "it is the same")])
    assert "| `a` | 100 | 6 | 2 | 1 | 1 | 1 | 1 | 60.0% (23.1% to 88.2%) |" in told
    assert "a/b.py:4, op, not covered: ``line 4`` → ``new``" in told
    assert "a/b.py:5, op: ``line 5`` → ``new``: it is the same" in told


def test_interval_of_a_share():
    # Newcombe (1998), Statistics in Medicine 17, table I: 81 of 263, and 0 of 20
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(0, 20) == pytest.approx((0, 0.1611), abs=5e-5)


def test_the_list_is_of_lines_that_are_there():
    assert outdated(ROOT, judgements()) == []
    assert all(each.why for each in judgements())
    one = Judgement("a.py", "x = 1", "why", ["x = 2"])
    assert equivalent(Mutant("a.py", 3, "op", 0, "x = 1", "x = 2"), [one]) == one
    assert equivalent(Mutant("a.py", 3, "op", 0, "x = 1", "x = 0"), [one]) is None
    assert outdated(ROOT, [one]) == [one]
