"""Mutants of valid files.

A mutant starts from a seed, a folder of valid files, and changes one of them once to four times: as a tree (a value of
another kind, an entry dropped, doubled, renamed, two subtrees exchanged), as the tokens of an expression, or as bytes.
"""

import copy
import csv
import io
import json
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import NamedTuple

import tomli_w

MOST = 4  # mutations of one mutant
DEEP = (1, 10, 100, 1000, 20000)  # levels, or times that something is repeated

TOKENS = re.compile(r"\s+|\w+\.?\w*(?:[eE][-+]?\d+)?|\*\*|.", re.DOTALL)
ESCAPE = "().__class__.__base__.__subclasses__()"
TEXTS = (
    "", " ", "\n", "a\nb", "\r", "\t", "\0", "\x1b[31m", "\u202e", "\u2028", "\ud800", "\ufeff", "é", "𝑥", "٣", "1_000",
    "../up", "/abs/path", "..", ".", "~", "C:\\x", "a/b", "a.b", ".b", "a.", "__class__", "class", "np", "nan", "inf",
    "-inf", "1e999", "0x10", "1j", "true", "{u}", "{0}", "%s", "$(id)", "`id`", "*/", "--", "<script>", "' \" \\",
    "x" * 200, "9" * 5000, "y" * 100000, "rate x", "delay x", "level 2 x", "rate", "sensor_x.a", "0*9**9**9",
)  # fmt: skip
NUMBERS = (
    0, 1, -1, 2, 0.0, -0.0, 0.5, 1e300, -1e300, 1e-300, 5e-324, float("nan"), float("inf"), -float("inf"), 63, 64, 65,
    1 << 31, 1 << 53, 1 << 63, -(1 << 63), 1 << 64, 10**9, 10**30, 10**400,
)  # fmt: skip
OTHERS = (True, False, [], {}, [[]], [0], ["x"], {"": ""}, {"x": 1}, {"value": 1.0}, [1.0, "m"])
PIECES = (
    "x", "0", "1", "2.5", "1e400", "10**400", "9**9**9", "(0*9**9**9)", "1_000", "0x10", "1j", "'text'", 'f"{x}"',
    "+", "-", "*", "/", "**", "//", "%", "@", "<<", "<", "==", "=", ":=", ",", ";", ":", "(", ")", "[", "]", "{", "}",
    ".", "~", "not ", " and ", " if 1 else ", " for x in (1,)", "lambda: ", "lambda x: ", "*x", "True", "None", "...",
    "#", "\\", "b''", "\n", "\0", "ｘ", "٣", "\ud800", "np", "np.pi", "eval('1')", "__import__('os').system('id')",
    ESCAPE, f"{ESCAPE}[0]", "open('/tmp/x', 'w')", "sin", "sin(", "sin()", "min(1)", "max(1, 2, 3)", "sin(x=1)",
    "sin(*[1])", "when(0, 1)", "when(1)", "orifice(1, 2, 3)", "exp(1e9)", "log(0)", "sqrt(-1)", "(1/0)", "(0**-1)",
    "((-8)**0.5)",
)  # fmt: skip
CHUNKS = (
    b"", b"\0", b"\xff", b"\xc3", b"\xed\xa0\x80", b"\xef\xbb\xbf", b"\n", b"\r\n", b"\r", b'"', b"'", b'"""', b",",
    b";", b"[", b"]", b"{", b"}", b"=", b"#", b"\\u0000", b"\\ud800", b"\x1b[31m", "\u202e".encode(), b"nan",
    b"1e999", b"_", b"9" * 5000, b"[" * 20000, b"{" * 20000, b'{"a":' * 20000, b"((" * 5000, b"a." * 5000, b" ",
)  # fmt: skip


# ---- trees


class Place(NamedTuple):
    """Where a value of a tree stands: in a table under its key, in a list under its index."""

    holder: dict | list
    key: str | int

    @property
    def value(self):
        return self.holder[self.key]

    def put(self, value) -> None:
        self.holder[self.key] = value


def _place(rng: Random, tree) -> Place | None:
    """Some place, wherever a walk from the root ends: what stands high is as likely as what there is much of."""
    place = None
    while tree and isinstance(tree, dict | list) and (place is None or rng.random() < 0.85):
        place = Place(tree, rng.choice(list(tree)) if isinstance(tree, dict) else rng.randrange(len(tree)))
        tree = place.value
    return place


def _find(rng: Random, tree, fits: Callable) -> Place | None:
    """Some place whose value fits."""
    tries = (_place(rng, tree) for _ in range(20))
    return next((p for p in tries if fits(p.value)), None)


def _foreign(rng: Random):
    """A value that nobody expects."""
    return copy.deepcopy(rng.choice(rng.choice((TEXTS, NUMBERS, OTHERS))))


def _replace(rng: Random, tree) -> None:
    _place(rng, tree).put(_foreign(rng))


def _borrow(rng: Random, tree) -> None:
    _place(rng, tree).put(copy.deepcopy(_place(rng, tree).value))


def _drop(rng: Random, tree) -> None:
    place = _place(rng, tree)
    del place.holder[place.key]


def _double(rng: Random, tree) -> None:
    holder, key = place = _place(rng, tree)
    if isinstance(holder, dict):
        holder[f"{key}_2" if rng.random() < 0.5 else rng.choice(TEXTS)] = copy.deepcopy(place.value)
    else:
        holder.insert(key, copy.deepcopy(place.value))


def _rename(rng: Random, tree) -> None:
    holder, key = _place(rng, tree)
    if isinstance(holder, list):
        return _borrow(rng, tree)
    others = [k for k in holder if k != key] or [key]
    new = rng.choice((rng.choice(TEXTS), key[:-1], key.upper(), rng.choice(others), f"{key}.x", f"sensor_{key}"))
    entries = [(new if k == key else k, v) for k, v in holder.items()]
    holder.clear()
    holder.update(entries)


def _swap(rng: Random, tree) -> None:
    one, other = _place(rng, tree), _place(rng, tree)
    first, second = copy.deepcopy(one.value), copy.deepcopy(other.value)
    other.put(first)
    if one.holder is not first:
        one.put(second)


CHANGES = (
    lambda v: v * 1.01, lambda v: v * 0.9, lambda v: v * 2, lambda v: v + 1, lambda v: v - 1, lambda v: -v,
    lambda v: v * 0, lambda v: v * 1e300, lambda v: v * 1e-300, int, float, str, bool,
)  # fmt: skip


def _number(value):
    """The number that a value is, or that it spells in a CSV; None if it is none."""
    if isinstance(value, str) and re.fullmatch(r"-?\d+(\.\d*)?(e[-+]?\d+)?", value):
        return float(value)
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def _scale(rng: Random, tree) -> None:
    place = _find(rng, tree, lambda value: _number(value) is not None)
    if place is None:
        return _replace(rng, tree)
    number = _number(place.value)
    try:
        changed = rng.choice(CHANGES)(number)
    except (OverflowError, ValueError):  # of inf, nan, and integers that no float holds
        changed = -number
    place.put(f"{changed}" if isinstance(place.value, str) else changed)


def _nudge(rng: Random, tree) -> None:
    """A number a little larger: a change that most readers accept, so that what follows is reached."""
    place = _find(rng, tree, lambda value: isinstance(_number(value), float))
    if place is not None:
        larger = _number(place.value) * 1.001
        place.put(f"{larger}" if isinstance(place.value, str) else larger)


def _respell(rng: Random, tree) -> None:
    place = _find(rng, tree, lambda value: isinstance(value, str))
    if place is None:
        return _replace(rng, tree)
    if rng.random() < 0.6:
        place.put(_expression(rng, place.value))
    else:
        at = rng.randint(0, len(place.value))
        place.put(place.value[:at] + rng.choice(TEXTS)[:200] + place.value[at:])


def _nest(rng: Random, tree) -> None:
    place = _place(rng, tree)
    value = place.value
    for _ in range(rng.choice((1, 2, 50))):
        value = [value] if rng.random() < 0.7 else {"x": value}
    place.put(value)


ON_TREES = (_replace, _borrow, _drop, _double, _rename, _swap, _scale, _scale, _nudge, _nudge, _nudge, _respell, _nest)


# ---- expressions and bytes


ON_TOKENS = ("piece", "insert", "drop", "double", "swap", "name", "name", "operator", "number", "wrap", "long")
AROUND = (("(", ")"), ("-", ""), ("sin(", ")"), ("abs(", ")"), ("2**(", ")"), ("", "**2"))


def _expression(rng: Random, text: str) -> str:
    """`text` with one token, or all of it, changed."""
    tokens = TOKENS.findall(text) or [""]
    at = rng.randrange(len(tokens))
    names = [t for t in tokens if t.isidentifier()] or ["x"]
    match rng.choice(ON_TOKENS):
        case "piece":
            tokens[at] = rng.choice(PIECES)
        case "insert":
            tokens.insert(at, rng.choice(PIECES))
        case "drop":
            del tokens[at]
        case "double":
            tokens.insert(at, tokens[at])
        case "swap":
            other = rng.randrange(len(tokens))
            tokens[at], tokens[other] = tokens[other], tokens[at]
        case "name":
            where = [i for i, t in enumerate(tokens) if t.isidentifier()] or [at]
            tokens[rng.choice(where)] = rng.choice((*names, "1.5"))
        case "operator":
            where = [i for i, t in enumerate(tokens) if t in "+-*/"] or [at]
            tokens[rng.choice(where)] = rng.choice(("+", "-", "*", "/", "**"))
        case "number":
            tokens.append(rng.choice(("+", "-", "*", "/", "**")) + repr(rng.choice(NUMBERS[:16])))
        case "wrap":
            before, after = rng.choice(AROUND)
            times = rng.choice(DEEP)
            tokens = [before * times, *tokens, after * times]
        case "long":
            tokens += [f" {rng.choice('+-*')} {rng.choice(names)}"] * rng.choice(DEEP)
    return "".join(tokens)


def _bytes(rng: Random, data: bytes) -> bytes:
    """`data` with one place changed, whatever it means."""
    at = rng.randint(0, len(data))
    span = min(rng.choice((1, 1, 2, 8, 100)), len(data) - at)
    match rng.choice(("flip", "digit", "digit", "insert", "delete", "truncate", "repeat", "line", "exchange")):
        case "flip":
            return data[:at] + bytes(b ^ (1 << rng.randrange(8)) for b in data[at : at + 1]) + data[at + 1 :]
        case "digit":
            digits = [m.start() for m in re.finditer(rb"\d", data[:20000])] or [at]
            at = rng.choice(digits)
            return data[:at] + str(rng.randrange(10)).encode() + data[at + 1 :]
        case "insert":
            return data[:at] + rng.choice(CHUNKS) + data[at:]
        case "delete":
            return data[:at] + data[at + span :]
        case "truncate":
            return data[:at]
        case "repeat":
            return data[:at] + data[at : at + span] * rng.choice((2, 3, 1000)) + data[at + span :]
        case "line":
            lines = data.splitlines(keepends=True) or [b""]
            lines.insert(rng.randint(0, len(lines)), rng.choice(lines))
            return b"".join(lines)
    other = rng.randint(0, len(data))
    at, other = sorted((at, other))
    return data[:at] + data[other:] + data[at:other]


# ---- files


class Format(NamedTuple):
    """How the bytes of a file are a tree. parse: bytes -> tree. dump: (tree, original bytes) -> bytes."""

    parse: Callable
    dump: Callable


def _csv(tree) -> str:
    rows = (row if isinstance(row, list) else [row] for row in tree)
    return "".join(",".join(map(str, row)) + "\n" for row in rows)


def _tensors(tree, data: bytes) -> bytes:
    """A safetensors file with another head."""
    head = json.dumps(tree).encode("utf-8", "surrogatepass")
    return len(head).to_bytes(8, "little") + head + data[8 + int.from_bytes(data[:8], "little") :]


def _text(dump: Callable) -> Callable:
    return lambda tree, data: dump(tree).encode("utf-8", "surrogatepass")


FORMATS = {
    ".toml": Format(lambda data: tomllib.loads(data.decode()), _text(tomli_w.dumps)),
    ".json": Format(json.loads, _text(json.dumps)),
    ".csv": Format(lambda data: list(csv.reader(io.StringIO(data.decode()))), _text(_csv)),
    ".safetensors": Format(lambda data: json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")]), _tensors),
}
"""By suffix; any other file is one expression."""


@dataclass(frozen=True)
class Mutant:
    """A folder of files, of which `changed` is not as it was; story: what was done to it."""

    files: Mapping[str, bytes] = field(repr=False)
    changed: str
    story: tuple[str, ...]


def mutant(rng: Random, seed: Mapping[str, bytes], targets: tuple[str, ...]) -> Mutant:
    """`seed`, file name -> bytes, with one of the `targets` changed."""
    name = rng.choice([t for t in targets if t in seed])
    data, kind, story = seed[name], FORMATS.get(Path(name).suffix), []
    times = rng.choice((1, 1, 1, 1, 1, 2, 2, 3, MOST))
    if rng.random() < 0.25:
        for _ in range(times):
            data = _bytes(rng, data)
        story.append(f"{times} times bytes")
    elif kind is None:
        text = data.decode()
        for _ in range(times):
            text = _expression(rng, text)
        data = text.encode("utf-8", "surrogatepass")
        story.append(f"{times} times tokens")
    else:
        tree = kind.parse(data)
        for _ in range(times):
            change = rng.choice(ON_TREES)
            if tree:
                change(rng, tree)
                story.append(change.__name__.strip("_"))
        data = kind.dump(tree, data)
    return Mutant({**seed, name: data}, name, tuple(story))
