"""What is worked out of a controller before the equations are built."""

from __future__ import annotations

import dataclasses

import numpy as np

from robodyn_cli.errors import SceneError
from robodyn_cli.ready.doors import at_rest
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.ready.reference import with_joint_reference
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import RANK
from robodyn_cli.solve.load_sharing import allowed_motions


def with_controller_ready(scene: Scene) -> Scene:
    """Return the scene with what its controller follows as a motion of joints, and the numbers of its law.

    Raises
    ------
    SceneError : there is no such regulator, or the driven joints do not command the mechanism. Others from closing the
    loops, and from ``with_joint_reference``.
    """
    scene = with_joint_reference(scene)
    if scene.control.type == "lqr":
        from robodyn_cli.ready.regulator import with_regulator

        return with_regulator(scene)
    if scene.control.shares and (scene.loops or scene.couplers):
        return _with_directions(scene)
    return scene


def _with_directions(scene: Scene) -> Scene:
    """Return the scene whose controller knows which accelerations its joints can have, where they are too many.

    Raises
    ------
    SceneError : the driven joints do not command all freedoms of the mechanism at the start.
    """
    setup = prepare(at_rest(scene))
    model, joints = setup.problem.model, scene.control.joints
    psi = setup.problem.numbers(setup.problem.psi, setup.assembled.q)
    N, _ = allowed_motions(psi[None])
    U, s, _ = np.linalg.svd(N[0][[model.v_names.index(name) for name in joints]])
    freedom, commanded = N.shape[2], int((s > RANK).sum())
    if commanded < freedom:
        raise SceneError(
            f"{scene.path}: control.joints: the mechanism has {freedom} degrees of freedom, and at the start the "
            f"driven joints ({', '.join(joints)}) command {commanded} of them; {scene.control.type!r} needs as many "
            "independent ones, in 'control.joints' or 'actuated'",
            file=scene.path, key="control.joints",
        )  # fmt: skip
    if len(joints) == freedom:
        return scene
    directions = tuple(map(tuple, U[:, :freedom].tolist()))
    return dataclasses.replace(scene, control=dataclasses.replace(scene.control, directions=directions))
