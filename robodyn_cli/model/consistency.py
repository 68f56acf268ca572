"""Physical consistency of a scene's bodies."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from robodyn_cli.errors import SceneError
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.scene.types import Inertia, Link, Scene

if TYPE_CHECKING:
    from robodyn_cli.scene.nested_options import DeployLatch

Path = tuple[str | int, ...]  # of keys, as in ``scene.text.nodes``


def refuse_immovable(scene: Scene) -> None:
    """Refuse a robot without a joint that moves.

    Raises
    ------
    SceneError
    """
    if not any(joint_types[joint.type].nv for joint in scene.robot.joints):
        raise SceneError(
            "all joints are fixed, so there are neither motions nor torques of joints", (scene.path, "robot.joints"),
            file=scene.path, key="robot.joints",
        )  # fmt: skip


def physical_warnings(scene: Scene) -> list[str]:
    """List what is doubtful: what the loader found, latches in each other's way, and inertias that cannot be.

    Those are not positive semi-definite or violate the triangle inequality. Only given data are judged; a planar scene
    that gives ``zz`` alone is fine.
    """
    return [*scene.warnings, *(f"{name}: {text}" for _, name, text in doubtful_parts(scene))]


def doubtful_parts(scene: Scene) -> list[tuple[Path, str, str]]:
    """List what is wrong with bodies and latches: the place in the scene, the name, and what it is."""
    return [*doubtful_bodies(scene), *(_doubtful_latches(scene) if scene.deploy.latches else ())]


def _doubtful_latches(scene: Scene) -> Iterator[tuple[Path, str, str]]:
    """Yield rigid latches that hold a joint, by its position, which another one holds too."""
    from robodyn_cli.model.build import moved_link, parent_link

    own: dict[str, tuple[DeployLatch, float]] = {}
    robot = scene.robot
    links = {
        frozenset((parent_link(robot, k), moved_link(robot, k))): joint.name
        for k, joint in enumerate(robot.joints)
    }
    for k, latch in enumerate(scene.deploy.latches):
        if latch.hold != "rigid" or latch.at_dead_point or latch.when is not None:
            continue
        held = latch.joint or links.get(frozenset(latch.between or ()))
        name, at = latch.position(robot)
        if held != name:
            continue
        other, place = own.setdefault(held, (latch, at))
        if other is latch:
            continue
        path = ("deploy", "latches", k)
        if place == at:
            yield (
                path,
                latch.name,
                f"holds joint {held!r} in the place in which {other.name!r} does: it bears nothing",
            )
        elif latch.release is None and other.release is None:
            yield (
                path,
                latch.name,
                f"holds joint {held!r} at {at:g}, and {other.name!r} does at {place:g}: whichever closes first keeps "
                "the other from its position",
            )


def doubtful_bodies(scene: Scene) -> list[tuple[Path, str, str]]:
    """List what is wrong with links and payloads: the place in the scene, the name of the body, and what it is."""
    bodies: list[tuple[Path, Link]] = [
        (("robot", "links", k), link) for k, link in enumerate(scene.robot.links)
    ]
    if scene.payloads:
        from robodyn_cli.model.parts import as_link

        bodies += [(("payloads", k), as_link(payload)) for k, payload in enumerate(scene.payloads)]
    return [((*path, "inertia"), link.name, text) for path, link in bodies for text in body_problems(link)]


def body_problems(link: Link) -> list[str]:
    """List what is wrong with a link's mass and inertia, and by how much (limits: Traversaro et al. 2016)."""
    I = link.inertia
    moments = {k: getattr(I, k) for k in ("xx", "yy", "zz")}
    texts = [
        f"inertia.{k} = {v:g} kg m^2 is negative" for k, v in moments.items() if v is not None and v < 0.0
    ]
    if link.mass == 0.0 and any(v for v in moments.values() if v is not None):
        texts.append("has inertia but no mass")
    if texts or any(v is None for v in moments.values()) or Inertia() == I:
        return texts
    import numpy as np

    xy, xz, yz = ((getattr(I, k) or 0.0) for k in ("xy", "xz", "yz"))
    tensor = np.array([[I.xx, xy, xz], [xy, I.yy, yz], [xz, yz, I.zz]], dtype=float)
    principal = np.linalg.eigvalsh(tensor)
    scale = float(np.abs(principal).max())
    if principal[0] < -1e-12 * scale:
        return [f"the inertia is not positive semi-definite: principal moment {principal[0]:.6g} kg m^2"]
    deficit = float(principal[2] - principal[0] - principal[1])
    if deficit > 1e-12 * scale:
        return [
            f"the principal moments {principal[0]:.6g}, {principal[1]:.6g}, {principal[2]:.6g} kg m^2 violate the "
            f"triangle inequality by {deficit:.3g}"
        ]
    return []
