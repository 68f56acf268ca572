"""Robots in other formats: as a description, and as a scene that holds nothing else."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from robodyn_cli.scene.load import examine_root, load_scene
from robodyn_cli.scene.text.includes import Includer, is_xml
from robodyn_cli.scene.text.nodes import Node, Scalar, Source, located, mapping, scalar, sequence
from robodyn_cli.scene.text.yaml_text import read_text
from robodyn_cli.scene.types import Robot, Scene
from robodyn_cli.schema.fields import OrFile, Section

if TYPE_CHECKING:
    from robodyn_cli.scene.dialects import Description


def load_description(
    path: str | os.PathLike[str],
    packages: Mapping[str, str] | None = None,
    overrides: Sequence[str] = (),
) -> tuple[Description, Scene]:
    """Return the robot of a file in another format, and a checked scene that holds nothing else.

    packages : folders of packages of meshes, by name. overrides : as of ``load_scene``, of the scene.

    Raises
    ------
    SceneError : the first thing that is not allowed, with file and line.
    """
    name = os.fspath(path)
    place = Scalar(Source(name, ".", positions=False), 1, 1, "", None)
    found: list[Description] = []

    def open_root(includer: Includer) -> Node:
        includer.packages = packages or {}
        robot = includer.include(OrFile(Section(Robot), robot=True), scalar(place, name), ())
        found.extend(includer.descriptions)
        if not found:
            raise located(
                place, "", "this is no URDF, SDF or MJCF, whose first character is '<'; allowed: one of them"
            )
        gravity = sequence(place, [scalar(place, 0)] * 3)
        values = {"schema": scalar(place, 1), "gravity": gravity, "robot": robot}
        return mapping(place, [(scalar(place, key), value) for key, value in values.items()])

    scene = examine_root(open_root, name, overrides).checked()
    return found[0], scene


def load_robot(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
    """Return the scene of a file, or of a robot in another format one with gravity along -z, 9.81 m/s^2.

    Raises
    ------
    SceneError : as of ``load_scene`` and ``load_description``.
    """
    given = isinstance(path, (Scene, Mapping)) or "\n" in os.fspath(path)
    if given or not is_xml(read_text(os.fspath(path), None, "", os.fspath(path))):
        return load_scene(path, overrides)
    return load_description(path, overrides=("gravity=[0, 0, -9.81]", *overrides))[1]
