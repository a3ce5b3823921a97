"""A pipeline at work: what an interruption at its very end leaves."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.scenes import SCENES, pipeline, write_scene
from tilepipe.engine import publication
from tilepipe.engine.options import RunOptions
from tilepipe.engine.run_folder import is_finished, is_unfinished
from tilepipe.engine.work import run_pipeline
from tilepipe.io.files.record import STATE


@pytest.mark.parametrize("step", ["write_log", "remove_state"])
def test_an_interrupted_run_can_be_resumed_until_its_record_appears_and_is_finished_from_then_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    folder, scene = tmp_path / "run", write_scene(tmp_path)

    def run() -> list[Path]:
        params, options = SCENES["bright_spots"][0], RunOptions(tile=32, workers=1)
        return run_pipeline(pipeline("bright_spots"), scene, folder, params=params, options=options)

    with monkeypatch.context() as patched:
        patched.setattr(publication, step, interrupt)
        layers = [] if step == "write_log" else run()
        if not layers:
            with pytest.raises(KeyboardInterrupt):
                run()
            assert is_unfinished(folder)
    layers = layers or run()
    assert layers
    assert all(layer.is_file() for layer in layers)
    assert is_finished(folder)
    assert not (folder / STATE).exists()
