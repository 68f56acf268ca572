"""Run a scene with other samples and other tolerances, and compare the figures of its summaries with their errors.

Which numbers are figures, and where their errors stand, is what the records of summaries declare: nothing is listed here.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from robodyn_cli.errors import RobodynError
from robodyn_cli.over.commands import execute
from robodyn_cli.scene.load import load_scene
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.tools.progress import Stopwatch, no_progress

TIMES = 10.0  # the errors together, beyond which no figure may move
OFTEN = 0.05  # part of the figures that may move by more than their errors together
ROUNDED = 1e-13  # part of a figure that two runs may differ by whatever is stated
TOLERANCES = ("1e-6", "1e-10")
PARTS = ("motor", "gear")
INTEGRATING = ("simulate", "deploy")


@dataclasses.dataclass(frozen=True)
class Figure:
    """A number of a summary with its error, None where none is stated. kind : its key with kinds of names in it."""

    kind: str
    value: float
    error: float | None


@dataclasses.dataclass(frozen=True)
class Move:
    """How far a figure is apart in two runs, over the errors that they state together; infinite where none is stated."""

    key: str
    kind: str
    runs: tuple[str, str]
    values: tuple[float, float]
    errors: tuple[float | None, float | None]
    ratio: float

    def __str__(self) -> str:
        (a, b), (off_a, off_b) = self.values, self.errors
        return f"{self.key}: {a!r} +- {off_a} with {self.runs[0]}, {b!r} +- {off_b} with {self.runs[1]}: {self.ratio:.3g}"


def figures_of(command: str, summary: Mapping[str, Any]) -> dict[str, Figure]:
    """Return the figures of a summary by key: what its records declare to be neither an error nor about the run."""
    leaves = {key: leaf_of(command, key) for key, _ in _numbers(summary)}
    errors = {error for leaf in leaves.values() if leaf is not None for error in leaf.errors}
    figures = {}
    everywhere = (
        [x for one in summary["drives"].values() for x in _parts(one, ())] if command == "size" else []
    )
    for key, value in _numbers(summary):
        leaf = leaves[key]
        if leaf is None or leaf.kind is not float or leaf.fact.about_run or key in errors:
            continue
        stated = [at for error in leaf.errors if (at := _at(summary, error.split("."))) is not None]
        names = dict(zip(leaf.names, (kinds[0] for kinds in leaf.kinds)))
        kind = ".".join(names.get(step, "N" if step.isdecimal() else step) for step in key.split("."))
        parts = [*everywhere, *_parts(summary, key.split("."))]
        name = re.sub(r"\.\d+\.", ".N.", key) if parts else key
        figures[" ".join([name, *parts])] = Figure(kind, value, max(stated) if stated else None)
    return figures


def _parts(tree: Any, steps: Sequence[str]) -> list[str]:
    """Return motors and gears that figures at some steps are about: those of other ones are other figures, wherever they
    stand in a list."""
    if isinstance(tree, list):
        return _parts(tree[int(steps[0])], steps[1:]) if steps else []
    if not isinstance(tree, Mapping):
        return []
    own = [str(tree[part]) for part in PARTS if part in tree]
    return own + (_parts(tree.get(steps[0]), steps[1:]) if steps else [])


def _numbers(tree: Any, place: str = "") -> Iterator[tuple[str, float]]:
    items = tree.items() if isinstance(tree, Mapping) else enumerate(tree) if isinstance(tree, list) else ()
    for name, value in items:
        key = f"{place}.{name}" if place else str(name)
        if isinstance(value, float):
            yield key, value
        else:
            yield from _numbers(value, key)


def _at(tree: Any, steps: Sequence[str]) -> float | None:
    """Return the number at some steps, whose names may have dots in them; None where there is none."""
    if not steps:
        return tree if isinstance(tree, float) else None
    if isinstance(tree, list):
        tree = {str(k): x for k, x in enumerate(tree)}
    for k in range(1, len(steps) + 1):
        name = ".".join(steps[:k])
        if isinstance(tree, Mapping) and name in tree:
            return _at(tree[name], steps[k:])
    return None


def settings(command: str, samples: int) -> dict[str, tuple[str, ...]]:
    """Return the overrides of the runs that are compared, by name."""
    section = "simulate" if command in INTEGRATING else "kinematics" if command == "kinematics" else "inverse"
    counts = (samples, 2 * samples + 1, 3 * samples - 1)
    runs = {f"{n} samples": (f"{section}.samples={n}",) for n in counts}
    if command not in INTEGRATING:
        return runs
    runs |= {f"rtol {rtol}": (f"simulate.samples={samples}", f"simulate.rtol={rtol}") for rtol in TOLERANCES}
    return {name: (*overrides, "simulate.error_estimate=true") for name, overrides in runs.items()}


def runs_of(
    path: Path, command: str, samples: int, given: Sequence[str] = ()
) -> dict[str, dict[str, Figure]]:
    """Return the figures of each run of a scene that comes to its end."""
    done = {}
    for name, overrides in settings(command, samples).items():
        try:
            scene = load_scene(path, [*given, *overrides])
            summary = execute(command, scene, no_progress, Stopwatch()).summary
        except RobodynError:
            continue
        done[name] = figures_of(command, summary)
    return done


def moves(runs: Mapping[str, Mapping[str, Figure]]) -> list[Move]:
    """Return how far each figure is apart in each two runs that have it."""
    found = []
    for one, two in combinations(runs, 2):
        for key in runs[one].keys() & runs[two].keys():
            a, b = runs[one][key], runs[two][key]
            apart = abs(a.value - b.value) - ROUNDED * max(abs(a.value), abs(b.value))
            if not apart > 0.0:
                ratio = 0.0
            elif a.error is None or b.error is None:
                ratio = math.inf
            else:
                ratio = apart / (a.error + b.error) if a.error + b.error > 0.0 else math.inf
            found.append(Move(key, a.kind, (one, two), (a.value, b.value), (a.error, b.error), ratio))
    return found
