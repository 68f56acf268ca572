"""Random changes of scenes: keys, values, structure, formulas, units, absurd numbers, and text that is no YAML."""

from __future__ import annotations

import copy
import random
from collections.abc import Iterator
from typing import Any

import yaml

NUMBERS: tuple[Any, ...] = (
    0, 0.0, -0.0, 1, -1, 2, 1e-300, 1e-160, 1e-30, 1e-12, 1e-6, 1e6, 1e12, 1e30, 1e160, 1e300, -1e300,
    float("nan"), float("inf"), float("-inf"), 2**31, 2**63, -(2**63), 10**40, 0.1 + 0.2, 1e-9,
)  # fmt: skip
WORDS: tuple[Any, ...] = (
    None, True, False, "", " ", "-", "~", "null", "true", "x", "é", "\u2028", "base", "end", "origin", "auto", "none",
    "all", "world", "joint", "1e999", "0x10", "1_000", "1:30", "- 1", "a.b", "2026-01-01", [], {}, [[]], [1], [1, 2, 3],
    [0, 0, 0], [0, 0, 1], {"a": 1}, [None], "9" * 400, "(" * 60,
)  # fmt: skip
UNITS = (
    "deg",
    "rad",
    "m",
    "mm",
    "kg",
    "s",
    "N",
    "N m",
    "rpm",
    "rad/s",
    "deg/s",
    "Hz",
    "J",
    "turns",
    "%",
    "1/s",
)
# NAME stands for a joint of the scene
FORMULAS = (
    "t", "-t", "t^2", "sin(t)", "1/t", "1/(t-0.01)", "sqrt(t)", "sqrt(-t)", "sqrt(NAME)", "1/NAME", "log(t)", "log(0)",
    "exp(1000*t)", "exp(NAME)", "abs(t-0.01)", "sign(t-0.01)", "sign(NAME)", "if(t < 0.01, 1, 0)", "if(NAME > 0, 1, 1/0)",
    "atan2(0, 0)", "atan2(sin(t), cos(t))", "t^0.5", "t^-1", "(-1)^0.5", "0^0", "NAME^NAME", "qd.NAME", "qdd.NAME",
    "qd.NAME^2", "1/qd.NAME", "max(t, NAME)", "min()", "max(" + ", ".join(["t"] * 60) + ")", "step(t)", "tanh(1e6*t)",
    "t^1000", "1e308*10", "1e308*t*10", "sqrt((t-0.01)^2)", "floor(t)", "pi", "e", "p.k", "k", "q.", "2 deg", "t deg",
    "1 +", "((t)", "t t", "sin", "sin()", "sin(t, t)", "unknown(t)", "1e-320", "acos(2)", "acos(1 + t)", "asin(NAME)",
    "exp(-((t-0.01)/1e-5)^2)", "t/t", "sin(t)/t", "0*NAME", "NAME - NAME", "1e200*NAME", "nan", "inf", "t^NAME",
)  # fmt: skip
PIECES = (
    *"-:?,[]{}#&*!|>'\"%@`~\t\n ", "null", ".nan", "-.inf", "1e999", "&a ", "*a", "<<: ", "!!str ", "!!python/name:x ",
    "\n---\n", "include: ", "{}", "[]", "\x00", "\n  ", "\n- ", ": ", "\ufeff", "9" * 400, "deg", "1/0", "\x85", "é",
)  # fmt: skip

Path = tuple[Any, ...]


def places(tree: Any, path: Path = ()) -> Iterator[Path]:
    """Yield the path of everything in a tree, the tree itself first."""
    yield path
    if isinstance(tree, dict):
        for key in tree:
            yield from places(tree[key], (*path, key))
    elif isinstance(tree, list):
        for k in range(len(tree)):
            yield from places(tree[k], (*path, k))


def get(tree: Any, path: Path) -> Any:
    """Return what a path leads to."""
    for step in path:
        tree = tree[step]
    return tree


def put(tree: Any, path: Path, value: Any) -> None:
    """Replace what a path leads to."""
    get(tree, path[:-1])[path[-1]] = value


def cut(tree: Any, path: Path) -> None:
    """Take out what a path leads to."""
    del get(tree, path[:-1])[path[-1]]


class Mutator:
    """Changes scenes at random; ``trees`` are good scenes, whose parts go into others."""

    def __init__(self, trees: list[dict[str, Any]], rng: random.Random) -> None:
        self.rng = rng
        self.parts: dict[Any, list[Any]] = {}
        for tree in trees:
            for path in places(tree):
                if path and isinstance(path[-1], str):
                    self.parts.setdefault(path[-1], []).append(get(tree, path))
        self.keys = sorted(self.parts)

    def scene(self, tree: dict[str, Any]) -> dict[str, Any]:
        """Return a copy of a scene with one to four changes."""
        found = copy.deepcopy(tree)
        changes = (self._value, self._scaled, self._formula, self._drop, self._part, self._key, self._swap, self._twice,
                   self._foreign)  # fmt: skip
        for _ in range(self.rng.choice((1, 1, 1, 2, 2, 3, 4))):
            try:
                self.rng.choices(changes, (3, 6, 4, 2, 2, 1, 1, 1, 1))[0](found)
            except (IndexError, KeyError, TypeError):
                continue  # a change that this scene has no place for
        return found

    def within(self, tree: dict[str, Any]) -> dict[str, Any]:
        """Return a copy of a scene with numbers that it could have as well: most pass every check and are run."""
        found = copy.deepcopy(tree)
        numbers = [p for p in places(found) if isinstance(get(found, p), float)]
        for path in self.rng.sample(numbers, min(len(numbers), self.rng.choice((1, 2, 4, 8)))):
            near = self.rng.uniform(0.7, 1.4)
            put(found, path, get(found, path) * self.rng.choice((near, near, near, -1.0, 0.1, 10.0)))
        return found

    def text(self, tree: dict[str, Any]) -> str:
        """Return the text of a scene with pieces put in, taken out or moved."""
        text, rng = dump(tree), self.rng
        for _ in range(rng.randint(1, 3)):
            at, other = rng.randint(0, len(text)), rng.randint(0, len(text))
            end = min(len(text), at + rng.choice((0, 0, 1, 3, 12)))
            piece = rng.choice((rng.choice(PIECES), text[other : other + rng.randint(0, 60)]))
            text = text[:at] + piece + text[end:]
        return text

    def override(self, tree: dict[str, Any]) -> str:
        """Return a text for ``--set``."""
        rng = self.rng
        path = ".".join(str(step) for step in rng.choice(list(places(tree))[1:]))
        if rng.random() < 0.15:
            path = rng.choice(
                (path + ".x", path[:-1], "." + path, "", rng.choice(self.keys), path.upper(), path + ".")
            )
        value = self.any_value(tree)
        shown = rng.choice(
            (str(value), yaml.safe_dump(value, default_flow_style=True).strip(), rng.choice(PIECES))
        )
        return f"{path}{rng.choice(('=', '=', '=', '=', '', '==', ' = '))}{shown}"

    def any_value(self, tree: Any) -> Any:
        """Return a value for any place: a number, a word, a formula, a quantity with a unit, a part of a scene."""
        rng = self.rng
        kind = rng.randrange(6)
        if kind < 2:
            return rng.choice(NUMBERS)
        if kind == 2:
            return rng.choice(WORDS)
        if kind == 3:
            return self._formula_text(tree)
        if kind == 4:
            return f"{rng.choice((1, -2.5, 90, 1e9, 1e-9))} {rng.choice(UNITS)}"
        return copy.deepcopy(rng.choice(self.parts[rng.choice(self.keys)]))

    def _leaf(self, tree: Any, kinds: tuple[type, ...]) -> Path:
        found = [
            p
            for p in places(tree)
            if p and isinstance(get(tree, p), kinds) and not isinstance(get(tree, p), bool)
        ]
        return self.rng.choice(found)

    def _any(self, tree: Any) -> Path:
        return self.rng.choice(list(places(tree))[1:])

    def _value(self, tree: Any) -> None:
        put(tree, self._leaf(tree, (int, float, str)), self.any_value(tree))

    def _scaled(self, tree: Any) -> None:
        path = self._leaf(tree, (int, float))
        factor = self.rng.choice((0.5, 2, -1, 10.0 ** self.rng.randint(-12, 12), self.rng.uniform(0, 2)))
        put(tree, path, float(get(tree, path)) * factor)

    def _formula_text(self, tree: Any) -> str:
        joints = (tree.get("robot") or {}).get("joints") if isinstance(tree.get("robot"), dict) else None
        names = [j.get("name", "x") for j in joints or [] if isinstance(j, dict)] or ["x"]
        return self.rng.choice(FORMULAS).replace("NAME", str(self.rng.choice(names)))

    def _formula(self, tree: Any) -> None:
        if self.rng.random() < 0.4:
            joints = [j["name"] for j in tree["robot"]["joints"]]
            key = self.rng.choice(("torques", "prescribed", "trajectory"))
            value: Any = {self.rng.choice(joints): self._formula_text(tree)}
            tree[key] = value if key != "trajectory" else {"type": "joint", "duration": 0.02, "q": value}
        else:
            put(tree, self._leaf(tree, (int, float, str)), self._formula_text(tree))

    def _drop(self, tree: Any) -> None:
        cut(tree, self._any(tree))

    def _part(self, tree: Any) -> None:
        """Put another scene's value of the same key."""
        path = self.rng.choice([p for p in places(tree) if p and p[-1] in self.parts])
        put(tree, path, copy.deepcopy(self.rng.choice(self.parts[path[-1]])))

    def _key(self, tree: Any) -> None:
        """Misspell a key."""
        path = self.rng.choice([p for p in places(tree) if p and isinstance(p[-1], str)])
        value, key = get(tree, path), path[-1]
        cut(tree, path)
        get(tree, path[:-1])[self.rng.choice((key[:-1], key + "s", key.upper(), 3, None, "", f" {key}"))] = (
            value
        )

    def _swap(self, tree: Any) -> None:
        first, second = self._any(tree), self._any(tree)
        a, b = copy.deepcopy(get(tree, first)), copy.deepcopy(get(tree, second))
        put(tree, first, b)
        put(tree, second, a)

    def _twice(self, tree: Any) -> None:
        """Repeat an entry of a list."""
        items = get(tree, self._leaf(tree, (list,)))
        items.insert(self.rng.randint(0, len(items)), copy.deepcopy(self.rng.choice(items)))

    def _foreign(self, tree: Any) -> None:
        """Put a part of another scene where it may not belong."""
        maps = [p for p in places(tree) if isinstance(get(tree, p), dict)]
        key = self.rng.choice(self.keys)
        get(tree, self.rng.choice(maps))[key] = copy.deepcopy(self.rng.choice(self.parts[key]))


def dump(tree: Any) -> str:
    """Return a tree as YAML."""
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    return yaml.dump(tree, Dumper=dumper, sort_keys=False, allow_unicode=True, default_flow_style=None)


def spoil(data: bytes, rng: random.Random) -> bytes:
    """Return bytes with some changed, taken out or put in."""
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5, 20))):
        at = rng.randint(0, max(0, len(found) - 1))
        kind = rng.randrange(5)
        if kind < 2 and found:
            found[at] = rng.randrange(256)
        elif kind == 2:
            del found[at : at + rng.choice((1, 2, 8, 100))]
        elif kind == 3:
            found[at:at] = rng.choice(
                (b"\x00", b"\xff\xfe", b",,", b"\n", b"nan", b"1e999", b'"', b"-", b"\xc3")
            )
        elif rng.random() < 0.2:
            del found[at:]
    return bytes(found)
