"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

# Where there is no GPU numba simulates one; it reads this when it is first imported.
if os.environ.get("TILEPIPE_GPU", "0") in ("", "0"):
    os.environ.setdefault("NUMBA_ENABLE_CUDASIM", "1")

import pytest
from hypothesis import settings

# Where CI is set every run draws the same examples; elsewhere each run looks at new ones.
settings.register_profile("tilepipe", max_examples=25, deadline=None, derandomize="CI" in os.environ, print_blob=True)
settings.load_profile("tilepipe")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real sample data; tests that need it are skipped where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the real sample data are not here ({folder})")
    return folder


def pytest_sessionfinish() -> None:
    """Keep the types of all grids that were simulated where `tests.device.compile_for_gpu` looks for them."""
    folder = os.environ.get("TILEPIPE_LAUNCHED")
    if folder:
        from tests.device.compile_for_gpu import keep

        keep(Path(folder))
