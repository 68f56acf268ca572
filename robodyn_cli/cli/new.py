"""``robodyn new``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from robodyn_cli.cli.console import Console, guarded
from robodyn_cli.cli.options import Quiet
from robodyn_cli.cli.parameters import argument


def command(
    kind: Annotated[
        str,
        argument(
            metavar="KIND",
            help="inverse, joint, waypoints, table, path, simulate, body, loop, mechanism, kinematics, statics, "
            "assemble or deploy.",
        ),
    ],
    file: Annotated[
        Path | None,
        argument(metavar="[FILE]", help="File to write; default: KIND.yaml."),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write a commented scene to begin with."""
    console = Console(quiet=quiet)

    def action() -> int:
        from robodyn_cli.errors import CapabilityError, OutputError, did_you_mean
        from robodyn_cli.scene.starters import STARTERS

        if kind not in STARTERS:
            hint = did_you_mean(kind, STARTERS)
            raise CapabilityError(f"unknown kind {kind!r}{hint}; allowed: {', '.join(STARTERS)}")
        starter, path = STARTERS[kind], file or Path(f"{kind}.yaml")
        try:
            with open(path, "x", encoding="utf-8") as stream:
                stream.write(starter.text(str(path)))
        except FileExistsError:
            raise OutputError(f"{path} exists already; choose another name, or remove it") from None
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror}") from error
        console.say(f"{path}: {starter.title}. Run it: robodyn {starter.command} {path}")
        return 0

    guarded(console, action)
