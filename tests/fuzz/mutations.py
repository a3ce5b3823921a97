"""Changes of bytes, of texts and of JSON that readers are likely to stumble over."""

from __future__ import annotations

import json
import re
import struct
from random import Random
from typing import Any

WHOLE = (0, 1, 2, 3, 127, 255, 256, 32767, 65535, 65536, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, 1 << 40, (1 << 63) - 1)
"""Numbers around the ends of the types that files use."""

REAL = (0.0, -0.0, 1.0, -1.0, 1e-320, 1e300, 1.7e308, float("inf"), float("-inf"), float("nan"))

WORDS = (
    *(str(number) for number in (*WHOLE, -1, 1 << 64, 10**30)),
    *("nan", "inf", "-inf", "1e400", "1e-400", "1e308", "0.5", "true", "null", "[]", "{}", '""', "''", "None"),
    *("a\0b", "\n", "\u2028", "é", "x" * 300, "..", "/", "//", ":", "EPSG:4326", "EPSG:0", "EPSG:28992"),
)

VALUES: tuple[Any, ...] = (
    *(None, True, False, "", "a", "a\nb", "\0", "\u2028", "x" * 300, [], [[]], {}, {"": ""}, 0.5, 1e308, float("nan")),
    *(*WHOLE, -1, 1 << 64, [0], [-1, -1], [1 << 40, 1 << 40], ["a"], "|O", "float32", "<f8", "<M8[s]", "EPSG:4326"),
)

_TOKEN = re.compile(r"\s+|[A-Za-z_]+|[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|\"[^\"]*\"|'[^']*'|.", re.DOTALL)


def mutated_bytes(content: bytes, random: Random) -> bytes:
    """Content with a few bits, numbers or pieces changed, or cut short."""
    changed = bytearray(content)
    for _ in range(random.randint(1, 4)):
        place = random.randrange(len(changed) + 1)
        kind = random.randrange(6)
        if kind == 0 and place < len(changed):
            changed[place] ^= 1 << random.randrange(8)
        elif kind in (1, 2):
            _put(changed, place, _packed(random))
        elif kind == 3:
            del changed[place : place + random.choice((1, 2, 8, 64))]
        elif kind == 4:
            changed[place:place] = changed[place : place + random.choice((1, 2, 8, 64))]
        elif random.random() < 0.2:
            del changed[place:]
    return bytes(changed)


def _packed(random: Random) -> bytes:
    order = random.choice("<>")
    if random.random() < 0.2:
        return struct.pack(f"{order}d", random.choice(REAL))
    kind, size = random.choice((("B", 8), ("H", 16), ("I", 32), ("Q", 64)))
    return struct.pack(order + kind, random.choice(WHOLE) % (1 << size))


def _put(content: bytearray, place: int, piece: bytes) -> None:
    """Overwrite, without making longer."""
    piece = piece[: max(len(content) - place, 0)]
    content[place : place + len(piece)] = piece


def mutated_field(content: bytes, place: int, kind: str, random: Random) -> bytes:
    """Content with one number of a known place and type changed."""
    changed = bytearray(content)
    size = struct.calcsize(kind)
    value = random.choice(REAL) if kind[-1] == "d" else random.choice((*WHOLE, random.getrandbits(8))) % (1 << 8 * size)
    _put(changed, place, struct.pack(kind, value))
    return bytes(changed)


def mutated_text(content: bytes, random: Random) -> bytes:
    """A text of which words, numbers or quoted parts are replaced, repeated, exchanged or left out."""
    if random.random() < 0.15:
        return mutated_bytes(content, random)
    tokens = _TOKEN.findall(content.decode("utf-8", "replace"))
    for _ in range(random.randint(1, 3)):
        if not tokens:
            break
        place, other = random.randrange(len(tokens)), random.randrange(len(tokens))
        kind = random.randrange(5)
        if kind <= 1:
            word, quote = random.choice(WORDS), tokens[place][:1]
            tokens[place] = f"{quote}{word}{quote}" if quote in ("'", '"') and kind else word
        elif kind == 2:
            tokens[place], tokens[other] = tokens[other], tokens[place]
        elif kind == 3:
            tokens[place:place] = tokens[min(place, other) : max(place, other)][:200] * random.choice((1, 1, 1, 20))
        else:
            del tokens[place : place + random.choice((1, 1, 8))]
    return "".join(tokens)[: 1 << 16].encode("utf-8", "replace")


def mutated_json(content: bytes, random: Random) -> bytes:
    """JSON of which a value is another, or is missing; any text where it is none."""
    try:
        root = [json.loads(content)]
    except ValueError:
        return mutated_text(content, random)
    if random.random() < 0.1:
        return mutated_text(content, random)
    for _ in range(random.randint(1, 2)):
        where, key = random.choice([(root, 0), *_places(root[0])])
        if random.random() < 0.15 and where is not root:
            del where[key]
        else:
            where[key] = random.choice(VALUES)
    return json.dumps(root[0]).encode()


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Each container within a value with each of its keys."""
    keys = list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    return [place for key in keys for place in [(value, key), *_places(value[key])]]
