"""Where the meshes of a URDF lie. They are for pictures: nothing of the equations depends on them."""

from __future__ import annotations

import os
from collections.abc import Mapping

from robodyn_cli.scene.urdf.elements import UrdfRobot

PACKAGE = "package://"


def mesh_file(name: str, urdf: str, packages: Mapping[str, str]) -> str | None:
    """Return the file that a mesh's name means, None where it is not there.

    Parameters
    ----------
    name : as in the URDF: ``package://NAME/PATH``, ``file:///PATH``, or a path from the URDF's folder.
    urdf : path of the URDF.
    packages : folders by name of package; others are looked for beside the URDF and in the folders above it.
    """
    folder = os.path.dirname(os.path.abspath(urdf))
    if name.startswith(PACKAGE):
        package, _, rest = name.removeprefix(PACKAGE).partition("/")
        if package in packages:
            tried = [os.path.join(packages[package], rest)]
        else:
            tried = [os.path.join(above, *parts) for above in _above(folder) for parts in ((package, rest), (rest,))
                     if len(parts) == 2 or os.path.basename(above) == package]  # fmt: skip
    else:
        tried = [os.path.join(folder, name.removeprefix("file://"))]
    return next((os.path.normpath(path) for path in tried if os.path.isfile(path)), None)


def _above(folder: str) -> list[str]:
    """Return a folder and those above it."""
    found = [folder]
    while (parent := os.path.dirname(found[-1])) != found[-1]:
        found.append(parent)
    return found


def missing_meshes(robot: UrdfRobot, urdf: str, packages: Mapping[str, str]) -> list[str]:
    """Return the meshes that are not there, each once, as ``FILE:LINE: NAME``."""
    found: dict[str, str] = {}
    for link in robot.links:
        for element, name in link.meshes:
            if name not in found and mesh_file(name, urdf, packages) is None:
                found[name] = f"{urdf}:{element.place.line}: {name}"
    return list(found.values())
