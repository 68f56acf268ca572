"""``robodyn new``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.options import Quiet


def command(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            show_default=False,
            help="inverse, joint, waypoints, table, path, simulate, body, loop, mechanism, kinematics, statics, "
            "assemble or deploy.",
        ),
    ],
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="File to write; default: KIND.yaml.", show_default=False),
    ] = None,
    quiet: Quiet = False,
) -> int:
    """Write a starter, never over another file; return the exit code."""
    from robodyn_cli.errors import CapabilityError, did_you_mean
    from robodyn_cli.results.atomic import write_new
    from robodyn_cli.scene.starters import STARTERS

    console = Console(quiet=quiet)
    if kind not in STARTERS:
        hint = did_you_mean(kind, STARTERS)
        raise CapabilityError(f"unknown kind {kind!r}{hint}; allowed: {', '.join(STARTERS)}")
    starter, path = STARTERS[kind], file or Path(f"{kind}.yaml")
    write_new(path, starter.text(str(path)))
    console.say(f"{path}: {starter.title}. Run it: robodyn {starter.command} {path}")
    return 0
