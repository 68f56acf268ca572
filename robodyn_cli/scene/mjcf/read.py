"""Read an MJCF: its text within bounds, MuJoCo's compiler, and the tree that stands for ``robot`` in a scene."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator

from robodyn_cli.errors import listed
from robodyn_cli.scene.dialects import Description, Packages
from robodyn_cli.scene.mjcf.acting import Acting
from robodyn_cli.scene.mjcf.compiled import HELD, LIMITS, WARNED, MjcfModel, compiled
from robodyn_cli.scene.mjcf.source import source_text
from robodyn_cli.scene.mjcf.tree import robot_tree
from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.urdf.xml import XmlElement

_ELSEWHERE = (LIMITS, WARNED, HELD)


def read_mjcf(root: XmlElement, faults: Faults, packages: Packages) -> Description | None:
    """Return the robot of an MJCF, None where there are faults; see ``dialects``.

    Raises
    ------
    SceneError : what the file says is not allowed, or the package mujoco is not there.
    """
    source = source_text(root, faults)
    model = compiled(source, faults) if source is not None else None
    if source is None or model is None:
        return None
    _refuse_fluid(model, faults)
    acting = Acting(model)
    tree = robot_tree(model, acting, faults)
    if faults.found:
        return None
    name = root.place.source.name
    return Description(
        name,
        tree,
        _heading(model, acting),
        tuple(_notes(model, acting)),
        tuple(_warnings(model)),
        (*source.files, *model.files),
    )


def _refuse_fluid(model: MjcfModel, faults: Faults) -> None:
    for key in ("density", "viscosity"):
        value = float(getattr(model.model.opt, key))
        if value:
            with faults:
                raise model.source.root.error(
                    f"<option {key}> is {value:g}: the fluid acts on the motion, and is not read; allowed: 0"
                )


def _heading(model: MjcfModel, acting: Acting) -> tuple[str, ...]:
    m = model.model
    kinds = Counter(acting.types)
    joints = ", ".join(f"{n} {kind}" for kind, n in kinds.items()) or "none"
    return (
        f"{model.source.root.attributes.get('model', '') or 'Robot'}, from "
        f"{os.path.basename(model.source.root.place.source.name)} by `robodyn import`. SI units, angles in radians.",
        f"{m.nbody - 1} bodies of {float(sum(m.body_mass)):.6g} kg in all; joints: {joints}",
        "The poses of the MJCF are q = 0: what it counts from ref is that much more. Each link has the axes of its "
        "body, and its origin where the joint that turns it is; inertias are about the centre of mass.",
    )


def _notes(model: MjcfModel, acting: Acting) -> Iterator[str]:
    m = model.model
    on = acting.is_on("gravity", "GRAVITY")
    gravity = [float(x) if on else 0.0 for x in m.opt.gravity]
    free = [
        model.name("joint", j) or model.name("body", int(m.jnt_bodyid[j]))
        for j, kind in enumerate(acting.types)
        if kind == "free"
    ]
    texts = {
        "left out, for no equation reads it": ", ".join(
            f"{n} <{tag}>" for tag, n in model.source.left.items()
        ),
        "gravity in the file, which that of the scene replaces": f"[{', '.join(f'{x:g}' for x in gravity)}]",
        "free joints": listed(free),
        HELD: listed(model.left.get(HELD, [])),
    }
    yield from (f"{title}: {names}" for title, names in texts.items() if names)
    if m.neq:
        yield "left out: solref and solimp, by which equalities give way; they are exact here"
    for title, names in model.left.items():
        if title not in _ELSEWHERE:
            each = Counter(names)
            yield f"left out: {title}: {listed([f'{name} ({n})' if n > 1 else name for name, n in each.items()])}"


def _warnings(model: MjcfModel) -> Iterator[str]:
    m = model.model
    if LIMITS in model.left:
        yield f"{LIMITS}, which are left out: {listed(model.left[LIMITS])}"
    yield from (f"{WARNED}: {said}" for said in model.left.get(WARNED, ()))
    carried = [model.name("body", b) for b in range(m.nbody) if m.body_gravcomp[b]]
    if carried:
        yield f"bodies with gravcomp, on which the gravity of the scene acts in full: {listed(carried)}"
    placed = [model.name("body", b) for b in range(m.nbody) if m.body_mocapid[b] >= 0]
    if placed:
        yield f"mocap bodies, which stand still: {listed(placed)}"
