"""Every reader keeps the law on its seeds and on changes of them; the same ones each time."""

from __future__ import annotations

from random import Random

import pytest

from tests.fuzz.reader import broken_law
from tests.fuzz.readers import READERS

CHANGES = 40


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
def test_what_a_file_holds_is_used_or_refused_by_one_line(tmp_path, reader):
    (tmp_path / "seeds").mkdir()
    seeds = reader.seeds(tmp_path / "seeds")
    for number, seed in enumerate(seeds):
        (tmp_path / f"seed{number}").mkdir()
        reader.read(seed, tmp_path / f"seed{number}")
    random = Random(1)
    for _ in range(CHANGES):
        error = broken_law(reader, reader.mutate(random.choice(seeds), random), tmp_path)
        if error is not None:
            raise error
