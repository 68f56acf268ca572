"""``robodyn new``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.options import Quiet, utf8

if TYPE_CHECKING:
    from robodyn_cli.robots.collection import StarterRobot
    from robodyn_cli.scene.starters import Starter


def command(
    kind: Annotated[
        str | None,
        typer.Argument(
            metavar="[KIND]",
            show_default=False,
            help="inverse, joint, waypoints, stops, lines, table, path, simulate, body, loop, mechanism, kinematics, "
            "statics, assemble or deploy; none with --from.",
        ),
    ] = None,
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="File to write; default: KIND.yaml.", show_default=False),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="ROBOT",
            parser=utf8,
            help="A robot with the sources of its constants in place of KIND: planar_2r, planar_3r, scara, puma560, "
            "seven_joint_arm, cart_pole, furuta_pendulum, delta, five_bar, slider_crank, watt_six_bar, scissor_mast "
            "or stewart_platform.",
        ),
    ] = None,
    quiet: Quiet = False,
) -> int:
    """Write a starter, never over another file; return the exit code."""
    from robodyn_cli.errors import CapabilityError
    from robodyn_cli.results.atomic import write_new

    if robot is not None and file is None and kind is not None:
        file, kind = Path(kind), None
    if (kind is None) == (robot is None):
        raise CapabilityError(
            "needs either the kind of a scene or --from with a robot; see 'robodyn new --help'"
        )
    template = _robot(robot) if robot is not None else _starter(str(kind))
    path = file or Path(f"{robot or kind}.yaml")
    write_new(path, template.text(str(path)))
    Console(quiet=quiet).say(f"{path}: {template.title}. Run it: robodyn {template.command} {path}")
    return 0


def _robot(name: str) -> StarterRobot | Starter:
    from robodyn_cli.robots.collection import find_robot

    return find_robot(name)


def _starter(kind: str) -> StarterRobot | Starter:
    from robodyn_cli.scene.starters import find_starter

    return find_starter(kind)
