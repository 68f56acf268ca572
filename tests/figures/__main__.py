"""More than CI has time for: ``python -m tests.figures --seed 1 --seconds 600 --out DIR``.

Scenes are those of ``configs`` and random ones of ``tests.pairs``; each is run with other samples and tolerances. Poses of
random arms (``reach``) are compared with those of fifty digits. Printed
is a table of all figures by kind: how many were compared, how many moved by more than their errors, and by more than ten
times these, or without an error; with the worst of each.
"""

from __future__ import annotations

import argparse
import collections
import json
import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from robodyn_cli.errors import RobodynError
from robodyn_cli.over.commands import command_of
from robodyn_cli.scene.checks.columns import column_names
from robodyn_cli.scene.load import load_scene
from tests.figures.judge import OFTEN, TIMES, Move, moves, runs_of
from tests.figures.reached import reached_moves
from tests.fuzz.cases import _clock
from tests.pairs.apart import read
from tests.pairs.judge import write
from tests.pairs.motions import ROWS, families, scene

CONFIGS = Path(__file__).parents[2] / "configs"
SAMPLES = (11, 31, 101)
DURATIONS = (0.05, 0.4, 1.0)
FEATURES = 5  # of a random scene, at most
SIZED = 4  # one of so many scenes of inverse dynamics is of ``size``
ARMS = 8  # one of so many seeds is an arm that reaches a pose
EXTREMES = (
    "q.b", "qd.b", "qdd.b", "tau.b", "points/tip.x", "point_velocities/tip.length", "reactions/b.force",
    "base_wrench.fx", "energy/total",
)  # fmt: skip
TOO_LONG = 30.0  # s, of all runs of a scene


def random_scene(seed: int) -> tuple[str, dict[str, Any], int]:
    """Return a command, the tree of a random scene, and a number of samples."""
    random_ = random.Random(seed)
    row = random_.choice(list(ROWS))
    of_row, groups = families(row), list(read(row))
    case: dict[str, str] = {}
    for family in random_.sample(list(of_row), random_.randint(1, FEATURES)):
        more = {**case, family: random_.choice(of_row[family])}
        if not any(group <= set(more.items()) for group in groups):
            case = more
    tree = scene(case)
    tree.setdefault("outputs", {}).setdefault("reactions", True)
    tree["simulate"]["duration"] = random_.choice(DURATIONS)
    command = random_.choice(ROWS[row][0])
    if command == "inverse" and seed % SIZED == 0:
        command = "size"
    return command, tree, random.Random(seed).choice(SAMPLES)


def with_extremes(path: Path, command: str) -> tuple[str, ...]:
    """Return the overrides that ask for extremes of columns that a scene has."""
    if command not in ("simulate", "deploy", "kinematics"):
        return ()
    try:
        own = load_scene(path, [f"command={command}", "expect={}"])
    except RobodynError:
        return ()
    known = column_names(own, tuple(own.robot.points))
    return (f"outputs.extremes={json.dumps([name for name in EXTREMES if name in known])}",)


def table(found: list[Move]) -> tuple[str, bool]:
    """Return how figures moved by kind, worst first, and whether any moved too far or too often."""
    by_kind: dict[str, list[Move]] = collections.defaultdict(list)
    for move in found:
        by_kind[move.kind].append(move)
    bad, lines = False, [f"{'figure':48} compared  beyond  ten times  no error"]
    for kind, own in sorted(by_kind.items(), key=lambda item: -max(x.ratio for x in item[1])):
        silent = sum(x.ratio == float("inf") and None in x.errors for x in own)
        beyond = [x for x in own if x.ratio > 1.0]
        ten = [x for x in own if x.ratio > TIMES]
        bad |= bool(ten) or len(beyond) > OFTEN * len(own)
        if beyond:
            lines.append(f"{kind:48} {len(own):8} {len(beyond):7} {len(ten) - silent:10} {silent:9}")
            lines.append(f"    {max(own, key=lambda x: x.ratio)}")
    beyond = sum(x.ratio > 1.0 for x in found)
    lines.append(f"{len(by_kind)} kinds of figures, {len(found)} compared, {beyond} beyond their errors")
    return "\n".join(lines), bad


def main() -> int:
    """Run; return 1 where a figure moved too far or too often."""
    parser = argparse.ArgumentParser(prog="python -m tests.figures", description=__doc__)
    parser.add_argument("--seed", type=int, default=1, help="the first seed")
    parser.add_argument("--scenes", type=int, default=sys.maxsize)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument(
        "--configs", action="store_true", help="the scenes of configs, in place of random ones"
    )
    parser.add_argument("--command", action="append", help="only this one")
    parser.add_argument("--out", type=Path, help="a file that takes a line for each figure that moved")
    arguments = parser.parse_args()
    end, found = time.monotonic() + arguments.seconds, []
    with tempfile.TemporaryDirectory() as folder:
        for name, command, compared in _scenes(arguments, Path(folder) / "scene"):
            if time.monotonic() > end:
                break
            if arguments.command and command not in arguments.command:
                continue
            try:
                with _clock(TOO_LONG):
                    own = compared()
            except KeyboardInterrupt:
                continue
            found += own
            if arguments.out:
                with arguments.out.open("a") as file:
                    file.writelines(json.dumps([name, command, str(x)]) + "\n" for x in own if x.ratio > 1.0)
    text, bad = table(found)
    print(text)
    return 1 if bad else 0


def _of_scene(path: Path, command: str, samples: int) -> list[Move]:
    return moves(runs_of(path, command, samples, with_extremes(path, command)))


def _scenes(
    arguments: argparse.Namespace, folder: Path
) -> Iterator[tuple[str, str, Callable[[], list[Move]]]]:
    """Yield name and command of each scene, and what compares its figures."""
    if arguments.configs:
        for path in sorted(CONFIGS.rglob("*.yaml")):
            try:
                command = command_of(load_scene(path))
            except RobodynError:
                continue
            yield str(path.relative_to(CONFIGS)), command, partial(_of_scene, path, command, 101)
        return
    for seed in range(arguments.seed, min(sys.maxsize, arguments.seed + arguments.scenes)):
        if seed % ARMS == 0:
            yield str(seed), "reach", partial(reached_moves, seed // ARMS)
            continue
        command, tree, samples = random_scene(seed)
        yield str(seed), command, partial(_of_scene, write(tree, folder, command), command, samples)


if __name__ == "__main__":
    sys.exit(main())
