"""Damage to files and names, drawn at random: bytes, text, structure, types, numbers, nesting, encodings."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

NUMBERS = (
    *("0", "-0", "-1", "1e308", "-1e308", "1e-320", "1e999", "NaN", "Infinity", "-Infinity", ".nan", ".inf", "0x10"),
    *("9" * 400, "9" * 5000, "2147483648", "18446744073709551616", "1_000", "1:30:00", "true", "null", "''", "1e5000"),
)
TEXTS = (
    *("", " ", ".", "..", "/", "../../x", "a\0b", "a\nb", "a\x1b[31mb", "\u202egpj", "\ufeff", "\ud800", "\U0001f600"),
    *("x" * 300, "x" * 70_000, "=1+1", "@x", "{id}", "%s%n", "<script>", "&amp;", "'", '"', "CON", "C:\\x", "-", "--"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 1e308, 10**400, float("nan"), float("inf"), [], {}, [[]], [None], {"": None}, "x"),
    *([0] * 2000, [[1, 2]] * 500, "x" * 300, {"a": {"a": {"a": {}}}}, ["1", 2, [3]]),
)
LONGEST_NAME_BYTES = 255
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_TEXT = re.compile(rb'"[^"\n]{0,200}"')
_DEPTHS = (50, 1000, 100_000)

Damage = Callable[[bytes, np.random.Generator], bytes]


def damage(content: bytes, rng: np.random.Generator) -> bytes:
    """The content of a file with one kind of damage, seldom with two or three."""
    for _ in range(int(rng.choice([1, 2, 3], p=[0.75, 0.15, 0.1]))):
        content = KINDS[rng.integers(len(KINDS))](content, rng)
    return content


def draw_name(suffix: str, rng: np.random.Generator) -> str:
    """Name of a file: mostly a plain one, else one of :data:`TEXTS` as far as a file system takes it."""
    if rng.random() < 0.8:
        return f"x{suffix}"
    text = TEXTS[rng.integers(len(TEXTS))].replace("\0", "").replace("/", "_").replace("\ud800", "\udce9")
    name = text.encode("utf-8", "surrogateescape")[: LONGEST_NAME_BYTES - len(suffix)].decode(errors="surrogateescape")
    return f"{name or 'x'}{suffix}"


def _flip(content: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(content)
    for place in rng.integers(0, max(len(content), 1), int(rng.integers(1, 20))):
        if changed:
            changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: int(rng.integers(0, len(content) + 1))]


def _remove(content: bytes, rng: np.random.Generator) -> bytes:
    start, end = sorted(rng.integers(0, len(content) + 1, 2).tolist())
    return content[:start] + content[end:]


def _repeat(content: bytes, rng: np.random.Generator) -> bytes:
    start, end = sorted(rng.integers(0, len(content) + 1, 2).tolist())
    end = min(end, start + 2000)
    return content[:end] + content[start:end] * int(rng.integers(1, 50)) + content[end:]


def _insert(content: bytes, rng: np.random.Generator) -> bytes:
    place = int(rng.integers(0, len(content) + 1))
    return content[:place] + rng.bytes(int(rng.integers(1, 50))) + content[place:]


def _overwrite(content: bytes, rng: np.random.Generator) -> bytes:
    if len(content) < 8:
        return content
    place = int(rng.integers(0, len(content) - 4))
    value = (b"\0\0\0\0", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\0\0\0\x80", b"\x01\0\0\0")[rng.integers(5)]
    return content[:place] + value + content[place + 4 :]


def _change_match(pattern: re.Pattern[bytes], content: bytes, new: bytes, rng: np.random.Generator) -> bytes:
    found = list(pattern.finditer(content[:200_000]))
    if not found:
        return content
    chosen = found[rng.integers(len(found))]
    return content[: chosen.start()] + new + content[chosen.end() :]


def _number(content: bytes, rng: np.random.Generator) -> bytes:
    return _change_match(_NUMBER, content, NUMBERS[rng.integers(len(NUMBERS))].encode(), rng)


def _text(content: bytes, rng: np.random.Generator) -> bytes:
    text = TEXTS[rng.integers(len(TEXTS))]
    return _change_match(_TEXT, content, json.dumps(text).encode(), rng)


def _line(content: bytes, rng: np.random.Generator) -> bytes:
    lines = content.split(b"\n")
    chosen, other = rng.integers(0, len(lines), 2).tolist()
    kind = int(rng.integers(3))
    if kind == 0:
        del lines[chosen]
    elif kind == 1:
        lines.insert(chosen, lines[other])
    else:
        lines[chosen], lines[other] = lines[other], lines[chosen]
    return b"\n".join(lines)


def _encode(content: bytes, rng: np.random.Generator) -> bytes:
    kind = int(rng.integers(4))
    if kind == 0:
        return b"\xef\xbb\xbf" + content
    if kind == 1:
        return content.decode("latin-1").encode("utf-16")
    if kind == 2:
        return content.decode("latin-1").encode("utf-32-be")
    return content.replace(b"e", b"\xe9")


def _nest(content: bytes, rng: np.random.Generator) -> bytes:
    depth = _DEPTHS[rng.integers(len(_DEPTHS))]
    opening, closing = ((b"[", b"]"), (b'{"a":', b"}"), (b"<a>", b"</a>"), (b"- ", b""))[rng.integers(4)]
    wrapped = opening * depth + content + closing * depth
    return wrapped if rng.random() < 0.5 else _change_match(_NUMBER, content, opening * depth + closing * depth, rng)


def _alias(content: bytes, rng: np.random.Generator) -> bytes:
    levels = [b"a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    levels += [
        b"a%d: &a%d [%s]" % (n, n, b", ".join([b"*a%d" % (n - 1)] * 9)) for n in range(1, int(rng.integers(2, 9)))
    ]
    return b"\n".join(levels) + b"\n" + content


def _value(content: bytes, rng: np.random.Generator) -> bytes:
    """Another value at a random place of a JSON tree."""
    try:
        tree = json.loads(content)
    except (ValueError, RecursionError):
        return _number(content, rng)
    places = list(_places(tree))
    if not places:
        return json.dumps(VALUES[rng.integers(len(VALUES))]).encode()
    path = places[rng.integers(len(places))]
    parent = tree
    for key in path[:-1]:
        parent = parent[key]
    kind = rng.random()
    if kind < 0.7:
        parent[path[-1]] = VALUES[rng.integers(len(VALUES))]
    elif kind < 0.85:
        del parent[path[-1]]
    elif isinstance(parent, list):
        parent += [parent[path[-1]]] * int(rng.integers(1, 100))
    else:
        parent[TEXTS[rng.integers(len(TEXTS))]] = parent.pop(path[-1])
    return json.dumps(tree).encode()


def _places(tree: Any) -> Iterator[tuple[Any, ...]]:
    """Paths to the values of a JSON tree, level by level."""
    level: list[tuple[tuple[Any, ...], Any]] = [((), tree)]
    while level:
        following = []
        for path, value in level:
            children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
            following += [((*path, key), child) for key, child in children]
        yield from (path for path, _ in following)
        level = following


def _anything(content: bytes, rng: np.random.Generator) -> bytes:
    return (b"", b"\0", b"{}", b"[]", b"null", b"0", rng.bytes(300), b"\n" * 1000, b"%YAML 9\n---\n")[rng.integers(9)]


KINDS: tuple[Damage, ...] = (
    *(_flip, _cut, _remove, _repeat, _insert, _overwrite, _number, _number, _text, _text, _line, _encode, _nest),
    *(_alias, _value, _value, _value, _anything),
)
