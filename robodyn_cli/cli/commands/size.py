"""``robodyn size``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

from robodyn_cli.cli import offers
from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict, number
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import cost_lines, margin_text, table
from robodyn_cli.cli.words import number as digits
from robodyn_cli.errors import of_option
from robodyn_cli.motors.registry import motor_types

BY = ("cost", "mass")


def describe(summary: Mapping[str, Any], verbose: bool = True, figures: Sequence[str] = ()) -> str:
    """Return what was found: how much there was to choose from, the drives, and how to write them into the scene."""
    sized = summary["size"]
    rows = [["joint", "combinations", "suffice", "best margin", "of limit"]]
    for name, joint in sized["joints"].items():
        best = joint["best"]
        limit = best["decides"].replace("_", " ")
        counts = str(joint["combinations"]), str(joint["passing"])
        rows.append([name, *counts, margin_text(best["margin"], best["margin_error"]), limit])
    drives = summary["drives"]
    written = [f"    {name}: {_written(drive)}" for name, drive in drives.items()]
    how = f"smallest {sized['by']} {'of all combinations' if sized['proven'] else 'joint by joint'}"
    enough = all(drive["passes"] for drive in drives.values())
    return "\n".join(
        [
            f"{summary['title']}",
            *figures,
            *([table(rows)] if verbose else []),
            f"  all drives         {how if enough else 'not enough'}; {sized['sweeps']} sweeps over the joints",
            *_remarks(sized["joints"], drives),
            f"  in the scene       drives:{'' if enough else '  # not enough'}",
            *written,
            *cost_lines(summary, verbose),
        ]
    )


def _remarks(joints: Mapping[str, Any], drives: Mapping[str, Any]) -> list[str]:
    """Return a line for each joint whose motion nothing bears, with what lacks, and for each that needs nothing."""
    lines = []
    for name, joint in joints.items():
        best, left = joint["best"], drives[name]["least_margin"]
        count, use, most = joint["combinations"], 1.0 - best["margin"], 1.0 - left
        parts = " + ".join(best[key] for key in ("motor", "gear") if best[key] is not None)
        limit, margin = best["decides"].replace("_", " "), f" with a margin of {digits(100.0 * left, 3)} %"
        if not joint["passing"]:
            lines.append(
                f"  joint {name!r}: none of {count} combinations bears its motion{margin if left else ''}; the "
                f"nearest, {parts}, takes {digits(use / most, 3)} times what its limit {limit!r} allows"
            )
        elif use == 0.0:
            lines.append(f"  joint {name!r} needs nothing: it neither moves nor bears a load in this motion")
    return lines


def _written(drive: Mapping[str, Any]) -> str:
    parts = {key: drive[key] for key in ("motor", "gear", "brake") if drive[key] is not None}
    if drive["count"] > 1:
        parts["count"] = drive["count"]
    return "{" + ", ".join(f"{key}: {value}" for key, value in parts.items()) + "}"


EXAMPLES = (
    "size configs/2r_circle.yaml",
    "size configs/2r_circle.yaml --types brushless --margin 0.2",
    "size configs/2r_circle.yaml --by mass --thorough",
)


def command(
    scene: SceneFile,
    by: Annotated[
        str, offers.one_of("--by", *BY, metavar="|".join(BY), help="What is to be small.")
    ] = "cost",
    margin: Annotated[
        float | None,
        typer.Option(
            "--margin",
            metavar="X",
            parser=number("a number from 0 to 0.99", lambda x: 0.0 <= x <= 0.99),
            help="Part of every limit that is to be left. [default: the `margin` of each drive]",
            show_default=False,
        ),
    ] = None,
    types: Annotated[
        str | None,
        typer.Option(
            "--types",
            metavar="TYPE,...",
            autocompletion=offers.listed_of(offers.begun_by(motor_types)),
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
    kinds = tuple(kind.strip() for kind in types.split(",")) if types is not None else ()
    for kind in kinds:
        if kind not in motor_types:
            raise of_option("--types", f"unknown kind of motor {kind!r}; allowed: {', '.join(motor_types)}")
    own = {"by": by, "margin": margin, "types": kinds, "thorough": thorough}
    job = shared.job("size", scene, strict, options=own)
    return run_scene(job, shared.console, describe)
