"""``robodyn size``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import cost_line, drive_lines, margin_text, number, table
from robodyn_cli.errors import SceneError
from robodyn_cli.motors.registry import motor_types

BY = ("cost", "mass")


def describe(summary: Mapping[str, Any]) -> str:
    """Return what was found: how much there was to choose from, the drives, and how to write them into the scene."""
    sized = summary["size"]
    rows = [["joint", "combinations", "bear it", "best margin", "of limit"]]
    for name, joint in sized["joints"].items():
        best = joint["best"]
        limit = best["decides"].replace("_", " ")
        counts = str(joint["combinations"]), str(joint["passing"])
        rows.append([name, *counts, margin_text(best["margin"]), limit])
    drives = summary["drives"]
    written = [f"    {name}: {_written(drive)}" for name, drive in drives.items()]
    how = "of all combinations" if sized["proven"] else "joint by joint"
    total = f"cost {number(sized['cost'])}, mass {number(sized['mass'])} kg, smallest {sized['by']} {how}"
    return "\n".join(
        [
            f"{summary['title']}",
            table(rows),
            *drive_lines(summary),
            f"  all drives         {total}; {sized['sweeps']} sweeps over the joints",
            "  in the scene       drives:",
            *written,
            cost_line(summary),
        ]
    )


def _written(drive: Mapping[str, Any]) -> str:
    parts = {key: drive[key] for key in ("motor", "gear", "brake") if drive[key] is not None}
    if drive["count"] > 1:
        parts["count"] = drive["count"]
    return "{" + ", ".join(f"{key}: {value}" for key, value in parts.items()) + "}"


def command(
    scene: SceneFile,
    by: Annotated[str, typer.Option("--by", metavar="cost|mass", help="What is to be small.")] = "cost",
    margin: Annotated[
        float | None,
        typer.Option(
            "--margin",
            min=0.0,
            max=0.99,
            help="Part of every limit that is to be left. [default: the `margin` of each drive]",
            show_default=False,
        ),
    ] = None,
    types: Annotated[
        str | None,
        typer.Option(
            "--types",
            metavar="TYPE,...",
            help="Kinds of motor to choose from. [default: all]",
            show_default=False,
        ),
    ] = None,
    thorough: Annotated[
        bool,
        typer.Option(
            "--thorough",
            help="Try combinations of all joints together until none is better, for some minutes at most.",
        ),
    ] = False,
    *,
    shared: SharedOptions,
    strict: Strict = False,
) -> int:
    """Size the drives of a scene; return the exit code, 1 where nothing bears the motion of a joint."""
    if by not in BY:
        raise SceneError(f"--by: unknown choice {by!r}; allowed: {', '.join(BY)}")
    kinds = tuple(kind.strip() for kind in types.split(",")) if types is not None else ()
    for kind in kinds:
        if kind not in motor_types:
            raise SceneError(f"--types: unknown kind of motor {kind!r}; allowed: {', '.join(motor_types)}")
    own = {"by": by, "margin": margin, "types": kinds, "thorough": thorough}
    job = shared.job("size", scene, strict, options=own)
    return run_scene(job, shared.console, describe)
