"""Where the meshes of a URDF lie, and which of its shapes a link is drawn with."""

from __future__ import annotations

import os
from collections.abc import Mapping

from robodyn_cli.scene.urdf.elements import UrdfLink, UrdfRobot, UrdfShape

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
    folders = [folder]
    while (parent := os.path.dirname(folders[-1])) != folders[-1]:
        folders.append(parent)
    return folders


def missing_meshes(robot: UrdfRobot, urdf: str, packages: Mapping[str, str]) -> list[str]:
    """Return the meshes that are not there, each once, as ``FILE:LINE: NAME``."""
    lines: dict[str, str] = {}
    for shape in (shape for link in robot.links for shape in link.shapes if shape.kind == "mesh"):
        if shape.file not in lines and mesh_file(shape.file, urdf, packages) is None:
            lines[shape.file] = f"{urdf}:{shape.element.place.line}: {shape.file}"
    return list(lines.values())


def drawn_shapes(link: UrdfLink, urdf: str, packages: Mapping[str, str]) -> list[tuple[UrdfShape, str]]:
    """Return the shapes that a link is drawn with, with the files of those that are meshes.

    They are those of ``visual``; where there are none, or a mesh among them is not there or in a format that is not
    read, they are those of ``collision``, if all of these can be drawn.
    """
    visual, collision = (
        [(shape, _file(shape, urdf, packages)) for shape in shapes if shape.kind]
        for shapes in (link.visual, link.collision)
    )
    seen, tested = (
        bool(shapes) and all(file is not None and _is_read(file) for _, file in shapes)
        for shapes in (visual, collision)
    )
    chosen = collision if tested and not seen else visual
    return [(shape, file) for shape, file in chosen if file is not None]


def _file(shape: UrdfShape, urdf: str, packages: Mapping[str, str]) -> str | None:
    """Return the file of a shape, empty for one without, None where it is not there."""
    return mesh_file(shape.file, urdf, packages) if shape.kind == "mesh" else ""


def _is_read(file: str) -> bool:
    from robodyn_cli.scene.mesh.files import is_readable

    return not file or is_readable(file)
