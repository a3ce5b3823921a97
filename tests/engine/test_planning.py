"""A plan counts all that is held at once: every worker's tile with its halo, and what each process needs by itself."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from pydantic import BaseModel

from tilepipe.engine.options import RunOptions
from tilepipe.engine.pipeline import Pass, Pipeline, Setting
from tilepipe.engine.planning import Plan, plan_run
from tilepipe.errors import InputError

HALO, BYTES, TILE, SHAPE = 10, 7, 100, (450, 700)


class Nothing(BaseModel):
    """No parameters."""


def nothing(context: Any, tile: Any) -> dict[str, Any]:
    return {}


def recipe(run: Any) -> Any:
    return []


HUNGRY = Pass("hungry", nothing, halo=HALO, bytes_per_pixel=BYTES)
PIPELINE = Pipeline(
    name="x",
    summary="",
    parameters=Nothing,
    passes=(replace(HUNGRY, name="modest", bytes_per_pixel=1), HUNGRY),
    layers=(),
    recipe=recipe,
)


def plan(workers: int, executor: str = "threads", **changed: Any) -> Plan:
    setting = replace(Setting(Nothing(), SHAPE, 1.0, TILE, frozenset(), {}), **changed)
    return plan_run(PIPELINE, setting, RunOptions(tile=setting.tile, workers=workers, executor=executor))


def test_each_worker_holds_a_tile_with_its_halo() -> None:
    for workers in (1, 2, 6):
        modest, hungry = plan(workers).passes
        assert hungry.memory == (TILE + 2 * HALO) ** 2 * BYTES * workers
        assert modest.memory == hungry.memory // BYTES
        assert hungry.halo == HALO and hungry.overhead == pytest.approx(1.2**2 - 1)


def test_the_hungriest_pass_of_all_workers_decides() -> None:
    one, six = plan(1), plan(6)
    assert six.memory - one.memory == 5 * (TILE + 2 * HALO) ** 2 * BYTES
    assert one.memory - one.least_memory == one.passes[1].memory


def test_each_process_has_an_interpreter() -> None:
    alone = plan(3).memory
    a, b = (plan(workers, "processes").memory - plan(workers).memory for workers in (1, 3))
    assert a > 100 << 20 and b == 3 * a
    assert plan(3, "tcp://host:8786").memory == alone, "the memory of others is theirs"


def test_no_more_workers_than_tiles_work_and_no_tile_is_larger_than_the_raster() -> None:
    whole = plan(6, tile=4096)
    assert (whole.tiles, whole.workers) == (1, 1)
    assert whole.passes[1].memory == SHAPE[0] * SHAPE[1] * BYTES and whole.passes[1].overhead == 0


def test_more_pixels_tiles_and_seams_need_more() -> None:
    usual = plan(1)
    assert usual.tiles == 5 * 7
    finer = plan(1, tile=50)
    assert finer.seam_memory > usual.seam_memory > plan(1, tile=4096).seam_memory
    # a seam has two sides
    short, long = (plan(1, shape=(rows, 1000), tile=500) for rows in (100, 200))
    assert (short.tiles, long.tiles) == (2, 2) and long.seam_memory - short.seam_memory == 100 * 2 * 160
    # and a tile has an entry in the ledger
    three = plan(1, shape=(100, 1500), tile=500)
    assert three.seam_memory - short.seam_memory == 100 * 2 * 160 + (64 << 10)
    wider = plan(1, shape=(SHAPE[0], 2 * SHAPE[1]))
    assert wider.export_memory - usual.export_memory == SHAPE[1] * (16 << 10)


def test_a_run_is_refused_from_the_first_byte_that_is_missing() -> None:
    found = plan(2)
    found.check(RunOptions(memory=found.memory))
    with pytest.raises(InputError, match="a smaller --tile than 2048, or fewer workers than 2"):
        found.check(RunOptions(memory=found.memory - 1))
    with pytest.raises(InputError, match=r"a smaller --tile than 2048$"):
        plan(1).check(RunOptions(memory=plan(1).memory - 1))
    with pytest.raises(InputError, match="smaller --tile"):
        found.check(RunOptions(memory=found.least_memory))
    with pytest.raises(InputError, match="whatever the tiles"):
        found.check(RunOptions(memory=found.least_memory - 1))


def test_what_is_needed_never_seems_to_be_what_is_allowed() -> None:
    found = plan(1)
    whole = replace(found, seam_memory=found.seam_memory + (1 << 20) - found.memory % (1 << 20))
    allowed, needed = f"{(whole.memory >> 20) - 1} MiB", f"{whole.memory >> 20} MiB"
    with pytest.raises(InputError, match=f"needs about {needed} but --memory is {allowed};"):
        whole.check(RunOptions(memory=whole.memory - 1))
    least = replace(whole, seam_memory=whole.seam_memory - whole.least_memory % (1 << 20))
    allowed, needed = f"{(least.least_memory >> 20) - 1} MiB", f"{least.least_memory >> 20} MiB"
    with pytest.raises(InputError, match=f"at least {needed} whatever .* --memory is {allowed};"):
        least.check(RunOptions(memory=least.least_memory - 1))
    large = replace(found, passes=(replace(found.passes[1], memory=3 << 20),))
    with pytest.raises(InputError, match="about 3 MiB of the GPU's memory, which has 2 MiB;"):
        large.check_device((3 << 20) - 1, RunOptions())


def test_tiles_fit_into_the_memory_of_a_device_to_the_byte() -> None:
    found = plan(2)
    found.check_device(found.passes[1].memory, RunOptions())
    with pytest.raises(InputError, match=r"pass hungry needs about .* or fewer workers than 2"):
        found.check_device(found.passes[1].memory - 1, RunOptions())


def test_there_is_room_for_one_more_process_only_if_it_fits() -> None:
    found = plan(2)
    interpreter = plan(1, "processes").memory - plan(1).memory
    assert replace(found, limit=found.memory + interpreter).has_room
    assert not replace(found, limit=found.memory + interpreter - 1).has_room


def test_a_plan_for_people_tells_widths_before_heights() -> None:
    usual = replace(plan(2), seam_memory=3 << 20, gathered_memory=5 << 20, limit=2 << 30, elsewhere=("a.tif",))
    assert usual.text().splitlines() == [
        "x: 700 × 450 pixels of 1 m (0.3 Mpx), 35 tiles of 100 × 100",
        "pass         halo (px)  read twice      memory",
        "modest              10         44%      29 KiB",
        "hungry              10         44%     197 KiB",
        "export                                 171 MiB",
        "peak memory about 680 MiB with 2 workers (libraries 500 MiB, global facts 8 MiB); limit 2.0 GiB",
        "reads a.tif",
    ]
    assert plan(1).text().count(" with 1 worker (") == 1
    more = replace(usual, most_gathered=usual.gathered_memory + 1, workers=1, wanted=2, limit=usual.memory - 1)
    text = more.text()
    assert ", at most 680 MiB whatever the raster holds; limit 679 MiB" in text
    assert "\n1 worker of 2 that the cores allow: --memory holds no more" in text
    assert text.endswith("\nthis is more than --memory allows: the run would be refused")
    exact = replace(usual, most_gathered=usual.gathered_memory, limit=usual.memory).text()
    assert "at most" not in exact and "refused" not in exact and "allow" not in exact


def test_fewer_workers_hold_as_much_each() -> None:
    three = plan(3)
    assert [three.with_workers(count).memory for count in (1, 2, 3)] == [plan(count).memory for count in (1, 2, 3)]
    for count in (1, 2, 3):
        enough = three.with_workers(count).memory_with(99)
        assert replace(three, limit=enough).workers_within(99) == count
        assert replace(three, limit=enough - 1).workers_within(99) == count - 1


def test_what_is_measured_is_in_the_plan() -> None:
    """Of libraries alone a process holds hundreds of megabytes; `scripts/bench memory` compares the whole."""
    whole = plan(1, shape=(3, 3))
    assert whole.export_memory == (160 << 20) + 3 * (16 << 10)
    assert whole.memory - whole.passes[1].memory - whole.export_memory - whole.seam_memory - whole.gathered_memory == (
        500 << 20
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"passes": ()}, "declares no pass"),
        ({"passes": (HUNGRY, HUNGRY)}, "declares the pass 'hungry' twice"),
        ({"passes": (replace(HUNGRY, halo=-1),)}, "pass 'hungry' of pipeline 'x' has no halo"),
        ({"passes": (replace(HUNGRY, bytes_per_pixel=-1),)}, "pass 'hungry' of pipeline 'x' has no bytes_per_pixel"),
        ({"passes": (replace(HUNGRY, halo=0, bytes_per_pixel=0),)}, ""),
        ({"passes": (replace(HUNGRY, halo=lambda setting: 3),)}, ""),
    ],
)
def test_a_declaration_is_whole(changes: dict[str, Any], message: str) -> None:
    if message:
        with pytest.raises(ValueError, match=message):
            replace(PIPELINE, **changes)
    else:
        assert replace(PIPELINE, **changes).passes == changes["passes"]
