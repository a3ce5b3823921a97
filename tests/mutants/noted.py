"""A plugin of pytest that notes during which test a line runs, and how long each test takes.

What a fixture of several tests runs counts for all of them. Processes that a test starts are measured too: coverage
begins in each of them with the name of the test that pytest tells its children.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coverage
import pytest

FOLDER = "MUTANTS_NOTES"
"""Variable with the folder where each process of pytest leaves its notes."""

_seconds: dict[str, float] = {}
_passed: dict[str, bool] = {}
_uses: dict[str, list[str]] = {}
_shared: dict[str, float] = {}
_now = [""]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: Any) -> Iterator[None]:
    start = time.perf_counter()
    _enter(item.nodeid)
    _shared["now"] = 0.0
    try:
        return (yield)
    finally:
        _seconds[item.nodeid] = time.perf_counter() - start - _shared.pop("now")
        _enter("")


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any, request: Any) -> Iterator[Any]:
    if fixturedef.scope == "function":
        return (yield)
    outer, start = _now[0], time.perf_counter()
    _enter(_name(fixturedef))
    try:
        return (yield)
    finally:
        taken = time.perf_counter() - start
        _shared[_name(fixturedef)] = max(taken, _shared.get(_name(fixturedef), 0.0))
        if not outer.startswith("fixture "):
            _shared["now"] = _shared.get("now", 0.0) + taken
        _enter(outer)


def pytest_runtest_logreport(report: Any) -> None:
    _passed[report.nodeid] = _passed.get(report.nodeid, True) and report.outcome == "passed"


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[Any]) -> None:
    for item in items:
        found = getattr(item, "_fixtureinfo", None)
        defined = (each[-1] for each in found.name2fixturedefs.values()) if found else ()
        _uses[item.nodeid] = [_name(each) for each in defined if each.scope != "function"]


def pytest_sessionfinish() -> None:
    notes = {
        name: {"seconds": seconds + sum(_shared.get(used, 0.0) for used in _uses[name]), "uses": _uses[name]}
        for name, seconds in _seconds.items()
        if _passed.get(name)
    }
    Path(os.environ[FOLDER], f"notes-{os.getpid()}.json").write_text(json.dumps(notes))


def _enter(context: str) -> None:
    _now[0] = context
    if (measured := coverage.Coverage.current()) is not None:
        measured.switch_context(context)


def _name(fixturedef: Any) -> str:
    return f"fixture {fixturedef.baseid}::{fixturedef.argname}"
