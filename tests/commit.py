"""Which state of the code a page of measurements is of."""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def commit(root: Path = ROOT) -> str:
    """Short name of the commit of a checkout; ``-dirty`` follows where files differ from it."""
    describe = ["git", "describe", "--always", "--dirty"]
    return subprocess.run(describe, cwd=root, capture_output=True, text=True, check=False).stdout.strip()
