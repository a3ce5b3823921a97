"""Histories of one run folder: runs, faults, resumes, replacements, damage, dead workers, two drivers, new inputs."""

from __future__ import annotations

import random
import shutil
from contextlib import suppress
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from tests.faults import scenes
from tests.faults.points import FAULTS, Fault, Points
from tests.faults.simulator import CALM, EXPECTED, simulated
from tests.faults.tiles import Task
from tests.laws import layer_bytes
from tests.scenes import write_raster
from tilepipe.engine.run_lock import LOCK
from tilepipe.errors import InputError
from tilepipe.io.files.record import RECORD, STATE, read_record

NAME = "bright_spots"
OTHER_THRESHOLD = scenes.SCENES[NAME][1]["threshold"]

_expected: dict[tuple[bool, int], dict[str, bytes]] = {}


class Histories(RuleBasedStateMachine):
    """Whatever has happened before: a folder that says it is finished holds what its record says, and nothing else."""

    def __init__(self) -> None:
        super().__init__()
        self.home = Path(mkdtemp())
        self.runs = self.home / "runs"
        self.runs.mkdir()
        self.out = self.runs / "out"
        self.version = 0
        self.handed_out: list[Task] = []
        self.raster = self._write_input()

    def _write_input(self) -> Path:
        values = np.zeros((48, 64), np.float32)
        values[10:20, 5:60] = 120 + 10 * self.version
        values[25:40, 30 - self.version : 34] = 200
        return write_raster(self.home / "scene.tif", values)

    def _expected(self, other: bool) -> dict[str, bytes]:
        key = other, self.version
        if key not in _expected:
            scenes.run(NAME, self.raster, self.home / "calm", other=other)
            _expected[key] = layer_bytes(self.home / "calm")
            shutil.rmtree(self.home / "calm")
        return _expected[key]

    def _run(self, fault: Fault, seed: int, other: bool, overwrite: bool) -> BaseException | None:
        with suppress(*EXPECTED), simulated(Points(self.runs, fault, seed), seed, self.handed_out):
            try:
                scenes.run(NAME, self.raster, self.out, other=other, overwrite=overwrite)
            except EXPECTED as error:
                return error
        return None

    @rule(
        point=st.integers(0, 160), kind=st.sampled_from(FAULTS), seed=st.integers(0, 99), other=st.booleans(),
        overwrite=st.booleans(),
    )  # fmt: skip
    def run_with_a_fault(self, point: int, kind: str, seed: int, other: bool, overwrite: bool) -> None:
        """Run or resume, with something that goes wrong; it may come after the end."""
        self._run(Fault(point, kind), seed, other, overwrite)

    @rule(seed=st.integers(0, 99), other=st.booleans(), overwrite=st.booleans())
    def run_calmly(self, seed: int, other: bool, overwrite: bool) -> None:
        """Run or resume; what is refused is refused for a reason that the user can see."""
        error = self._run(CALM, seed, other, overwrite)
        if error is not None:
            assert not overwrite
            assert "finished run" in str(error)
            return
        assert layer_bytes(self.out) == self._expected(other)
        assert sorted(item.name for item in self.out.iterdir() if item.name.startswith(".")) == []

    @rule(seed=st.integers(0, 99))
    def damage(self, seed: int) -> None:
        """Cut, garble or remove a file of an unfinished run; a folder without its mark would be somebody else's."""
        chosen = random.Random(seed)
        files = sorted(path for path in self.out.glob(f"{STATE}/**/*") if path.is_file() and path.name != LOCK)
        if files:
            path = chosen.choice(files)
            if chosen.random() < 0.3:
                path.unlink()
            else:
                data = bytearray(path.read_bytes())
                path.write_bytes(data[: len(data) // 2] if chosen.random() < 0.5 else bytes(len(data)))

    @rule()
    def change_the_input(self) -> None:
        """Other pixels under the same name."""
        self.version = (self.version + 1) % 3
        self._write_input()

    @rule(seed=st.integers(0, 99))
    def second_driver(self, seed: int) -> None:
        """A run in a folder where another one is at work is refused, and harms nothing."""
        points = Points(self.runs, CALM)
        tried: list[str] = []

        def begin_another(kind: str) -> bool:
            if kind == "task" and not tried:
                tried.append("")
                with pytest.raises(InputError) as refusal:
                    scenes.run(NAME, self.raster, self.out, other=True, overwrite=True)
                tried[0] = str(refusal.value)
            return False

        points.arrives = begin_another  # type: ignore[method-assign]
        with suppress(InputError), simulated(points, seed, self.handed_out):
            scenes.run(NAME, self.raster, self.out, overwrite=True)
        assert not tried or "another process is at work" in tried[0]

    @invariant()
    def what_is_finished_is_whole(self) -> None:
        """A record stands beside the layers of its parameters, whatever raster they were made of."""
        if (self.out / RECORD).exists() and not (self.out / STATE).exists():
            other = read_record(self.out / RECORD)["parameters"]["threshold"] == OTHER_THRESHOLD
            versions = [layers for key, layers in _expected.items() if key[0] == other]
            found = layer_bytes(self.out)
            assert not versions or found in versions or not self._all_versions(other)

    def _all_versions(self, other: bool) -> bool:
        return {version for chosen, version in _expected if chosen == other} == {0, 1, 2}

    def teardown(self) -> None:
        """In the end a run that replaces everything works."""
        assert self._run(CALM, 0, False, True) is None
        assert layer_bytes(self.out) == self._expected(False)
        shutil.rmtree(self.home)


TestHistories = Histories.TestCase
TestHistories.settings = settings(
    max_examples=12,
    stateful_step_count=10,
    deadline=None,
    report_multiple_bugs=False,
    phases=(Phase.explicit, Phase.reuse, Phase.generate),
    suppress_health_check=[HealthCheck.too_slow],
)
