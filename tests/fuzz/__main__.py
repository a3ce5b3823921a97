"""Fuzz readers one after the other, each in a process of its own, and say what breaks their law.

A process that dies, hangs or takes too much memory is told of by the input that did it, and another one goes on.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz.readers import READERS

_FINDINGS = "findings.json"
_ARTIFACT = re.compile(r"Test unit written to (\S+)")
_UNITS = re.compile(r"stat::number_of_executed_units:\s*(\d+)")


@dataclass
class Result:
    """What came of one reader: the place of each mistake with an input that shows it."""

    executions: int = 0
    seconds: float = 0.0
    findings: dict[str, str] = field(default_factory=dict)


def main() -> int:
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description=__doc__)
    parser.add_argument("readers", nargs="*", metavar="READER", help=f"of {', '.join(READERS)}; all by default")
    parser.add_argument("--seconds", type=int, default=60, help="for each reader (default: %(default)s)")
    parser.add_argument("--timeout", type=int, default=60, help="seconds for one input (default: %(default)s)")
    parser.add_argument("--memory", type=int, default=2048, help="MiB of a process (default: %(default)s)")
    parser.add_argument("--folder", type=Path, default=Path(".fuzz"), help="of inputs that are kept (default: .fuzz)")
    options = parser.parse_args()
    if unknown := sorted(set(options.readers) - set(READERS)):
        parser.error(f"no reader is called {unknown[0]}; choose of {', '.join(READERS)}")
    found = False
    for name in options.readers or READERS:
        result = fuzz(name, options.folder.resolve() / name, options)
        print(f"{name}: {result.executions:,} inputs in {result.seconds:.0f} s, {len(result.findings)} mistakes")
        for place, shown in result.findings.items():
            print(f"  {place}: {shown}")
        found |= bool(result.findings)
    return 1 if found else 0


def fuzz(name: str, folder: Path, options: argparse.Namespace) -> Result:
    """Fuzz a reader for so many seconds; inputs that led further are kept, and begun with the next time."""
    result, begin = Result(), time.monotonic()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _FINDINGS).unlink(missing_ok=True)
    while (left := options.seconds - (time.monotonic() - begin)) >= 1:
        limits = [f"-timeout={options.timeout}", f"-rss_limit_mb={options.memory}", f"-max_total_time={int(left)}"]
        command = [sys.executable, "-m", "tests.fuzz.process", name, str(folder), *limits]
        with open(folder / "log.txt", "w+b") as log:
            ended = subprocess.run(command, stdout=log, stderr=log, check=False)
            log.seek(0)
            said = log.read().decode("utf-8", "replace")
        units = _UNITS.search(said)
        result.executions += int(units[1]) if units else 0
        if ended.returncode == 0:
            break
        artifact = _ARTIFACT.search(said)
        if artifact is None and units is None:
            raise SystemExit(f"{name}: the process did not start; see {folder / 'log.txt'}")
        kept = folder / f"log-{len(result.findings)}.txt"
        os.replace(folder / "log.txt", kept)
        shown = artifact[1] if artifact else str(kept)
        result.findings[f"{Path(shown).name.partition('-')[0]}, see {kept.name}"] = shown
    if (folder / _FINDINGS).exists():
        result.findings |= json.loads((folder / _FINDINGS).read_text())
    result.seconds = time.monotonic() - begin
    return result


if __name__ == "__main__":
    raise SystemExit(main())
