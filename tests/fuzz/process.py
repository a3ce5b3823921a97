"""The process that fuzzes one reader: `python -m tests.fuzz.process READER FOLDER OPTION_OF_LIBFUZZER...`."""

from __future__ import annotations

import hashlib
import json
import resource
import sys
import tempfile
import traceback
from pathlib import Path
from random import Random

import atheris

with atheris.instrument_imports(include=["tilepipe.io", "tilepipe.engine"]):
    from tests.fuzz.reader import broken_law, place_of
    from tests.fuzz.readers import READERS


def main(name: str, folder: Path, *options: str) -> None:
    reader = READERS[name]
    corpus, findings = folder / "corpus", folder / "findings.json"
    corpus.mkdir(exist_ok=True)
    (folder / "seeds").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        for number, seed in enumerate(reader.seeds(Path(place))):
            (folder / "seeds" / str(number)).write_bytes(seed)
            # what is loaded at the first use counts for no input
            broken_law(reader, seed, Path(place))
    known: dict[str, str] = json.loads(findings.read_text()) if findings.exists() else {}
    work = Path(tempfile.mkdtemp())
    _limit_memory(options)

    def test(content: bytes) -> None:
        error = broken_law(reader, content, work)
        # it goes on, for one mistake would else hide all others
        if error is not None and (where := place_of(error)) not in known:
            shown = folder / f"finding-{hashlib.sha256(content).hexdigest()[:16]}"
            shown.write_bytes(content)
            shown.with_suffix(".txt").write_text("".join(traceback.format_exception(error)))
            known[where] = str(shown)
            findings.write_text(json.dumps(known))

    def mutate(content: bytes, most: int, number: int) -> bytes:
        random = Random(number)
        if random.random() < 0.25:
            return bytes(atheris.Mutate(content, most))
        return reader.mutate(content, random)[:most]

    arguments = [sys.argv[0], *options, "-print_final_stats=1", f"-artifact_prefix={folder}/", "-max_len=262144"]
    atheris.Setup([*arguments, str(corpus), str(folder / "seeds")], test, custom_mutator=mutate)
    atheris.Fuzz()


def _limit_memory(options: tuple[str, ...]) -> None:
    """What asks for more memory than the limit of libFuzzer is refused it, though it would never touch it."""
    limit = next(int(option.partition("=")[2]) for option in options if option.startswith("-rss_limit_mb="))
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + (limit << 20), resource.RLIM_INFINITY))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), *sys.argv[3:])
