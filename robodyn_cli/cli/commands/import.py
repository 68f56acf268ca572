"""``robodyn import``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from robodyn_cli.cli.options import Strict, Told, file, utf8
from robodyn_cli.cli.runner import warn

EXAMPLES = (
    "import configs/robots/lift_arm.urdf lift_arm.yaml",
    "import configs/robots/crank_rocker.sdf",
    "import robot.xml robot.yaml",
)


def command(
    description: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Robot to read: URDF, SDF or MJCF.", callback=file, show_default=False
        ),
    ],
    robot: Annotated[
        Path | None,
        typer.Argument(metavar="ROBOT.yaml", help="File to write; default: FILE.yaml.", show_default=False),
    ] = None,
    packages: Annotated[
        list[str] | None,
        typer.Option(
            "--package",
            metavar="NAME=DIR",
            parser=utf8,
            help="Folder of a package of meshes; others are looked for beside FILE and above it.",
        ),
    ] = None,
    strict: Strict = False,
    *,
    told: Told,
) -> int:
    """Write a URDF, SDF or MJCF as a robot in YAML, never over another file; return the exit code."""
    from robodyn_cli.results.atomic import write_new
    from robodyn_cli.scene.descriptions import load_description
    from robodyn_cli.scene.dialects import robot_yaml

    console = told.console
    folders = _folders(packages or ())
    path = robot or description.with_suffix(".yaml")
    with console.waiting(lambda: f"reading {description}"):
        document, scene = load_description(description, folders)
        warn(scene, strict, console)
        write_new(path, robot_yaml(document, str(path.parent)))
    moving = sum(joint.type != "fixed" for joint in scene.robot.joints)
    console.data({"status": "ok", "file": str(path), "links": len(scene.robot.links), "joints": moving})
    console.say(
        f"{path}: {len(scene.robot.links)} links, {moving} joints that move. In a scene: robot: {path.name}"
    )
    return 0


def _folders(packages: Sequence[str]) -> dict[str, str]:
    """Return the folders of packages by name."""
    from robodyn_cli.errors import CapabilityError, of_option

    folders = {}
    for text in packages:
        name, sign, folder = text.partition("=")
        if not (name and sign and Path(folder).is_dir()):
            raise of_option(
                f"--package {text!r}", "allowed: NAME=DIR with an existing folder", CapabilityError
            )
        folders[name] = folder
    return folders
