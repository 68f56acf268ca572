"""A scene's robot for another format: what the format has not is refused, what no equation needs is listed."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, listed
from robodyn_cli.forces.friction import Friction, Gear
from robodyn_cli.forces.springs import Spring
from robodyn_cli.model.build import build_model
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model, unknown_among
from robodyn_cli.over.export.robot import (
    ExportedCoupler,
    ExportedFrames,
    ExportedLink,
    ExportedRobot,
    floats,
    fresh,
    kept_origins,
    links_of,
    loops_of,
)
from robodyn_cli.record import record
from robodyn_cli.registry import Registry
from robodyn_cli.scene.types import Inertia, Link, Robot, Scene
from robodyn_cli.spatial.algebra import Array

CLOSED = 1e-12  # residual [m, rad] of loops that count as closed in a pose


@record
class Format:
    """What a format can hold.

    name : as files of it are called. joints, loops : kinds. turned : kinds of joint whose links need the joint's axes.
    along : kinds with several coordinates whose forces and limits it has, coordinate by coordinate. springs : whether
    joints may have some. in_space : whether dampers of balls. assembled : whether poses of links must close the loops.
    limits : those that it has. reserved : names that no link may have. by_effort : whether an effort of 0 says that a
    joint has no motor.
    write : f(robot, what there is to say, to which it adds) -> texts by name of file.
    problems : what else it cannot hold, one text each.
    """

    name: str
    joints: tuple[str, ...]
    loops: tuple[str, ...]
    write: Callable[[ExportedRobot, list[str]], dict[str, str]]
    problems: Callable[[ExportedRobot], Iterator[str]]
    turned: tuple[str, ...] = ()
    along: tuple[str, ...] = ()
    springs: bool = False
    in_space: bool = False
    assembled: bool = False
    limits: tuple[str, ...] = ("lower", "upper", "speed", "effort")
    reserved: tuple[str, ...] = ()
    by_effort: bool = False


formats: Registry[Format] = Registry(
    "robodyn_cli.over.export",
    {
        "urdf+": "urdf:URDF_PLUS",
        "extended-urdf": "urdf:EXTENDED_URDF",
        "mjcf": "mjcf:MJCF",
        "sdf": "sdf:SDF",
    },
)


def export_robot(scene: Scene, kind: str, directory: Path) -> tuple[list[Path], list[str]]:
    """Write a scene's robot in a format of ``formats`` into a directory; return the files, and what there is to say.

    Raises
    ------
    CapabilityError : with everything that the format has not; a file would replace what the robot is read from.
    OutputError : it cannot be written.
    """
    from robodyn_cli.results.atomic import output_errors, write_bytes

    form = formats[kind]
    robot, notes = exported(scene, form)
    texts = form.write(robot, notes)
    read = {os.path.realpath(path) for path in (scene.path, *scene.sources)}
    for name in texts:
        if os.path.realpath(directory / name) in read:
            raise CapabilityError(
                f"{directory / name} is what the robot is read from; allowed: another directory (--out)"
            )
    with output_errors(directory):
        directory.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        write_bytes(directory / name, text.encode())
    return [directory / name for name in texts], notes


def exported(scene: Scene, form: Format) -> tuple[ExportedRobot, list[str]]:
    """Return a scene's robot with all numbers, and what there is to say of it.

    Raises
    ------
    CapabilityError : with everything that the format has not.
    """
    model = build_model(dataclasses.replace(scene, robot=filled(scene)), merge=False)
    refused = _refused(scene, model, form)
    if refused:
        raise _refusal(scene, form, refused)
    notes = made_up(scene)
    reference = _reference(scene, model, form, notes)
    dh = [joint.name for joint in scene.robot.joints if joint.has_dh]
    frames = ExportedFrames(model, form.turned, dh, reference)
    links = {link.joint: link for link in links_of(model, frames, _limits(scene, model, form, notes))}
    ordered = tuple(links[joint.name] for joint in scene.robot.joints)
    if np.array_equal(reference, Manifold(model).neutral()):
        ordered = kept_origins(scene, ordered, form.turned)
    else:
        ordered = tuple(_from(reference, model, link) for link in ordered)
    if form.by_effort and scene.actuated is not None:
        ordered = tuple(_without_motors(ordered, scene.actuated, notes))
    robot = ExportedRobot(
        os.path.splitext(os.path.basename(scene.path))[0] or "robot",
        np.array(floats(np.array(model.base.E, dtype=float).T @ np.array(model.gravity, dtype=float))),
        ordered,
        loops_of(model, frames),
        tuple(coupler_of(scene, coupler, model, reference) for coupler in scene.couplers),
        scene.actuated,
    )
    robot = renamed(robot, form, notes)
    problems = [*form.problems(robot)]
    if problems:
        raise _refusal(scene, form, problems)
    notes += _left_out(scene, dh)
    return robot, notes


def _refusal(scene: Scene, form: Format, problems: Iterable[str]) -> CapabilityError:
    return CapabilityError(f"{form.name} cannot hold it: " + "; ".join(problems), (scene.path,))


# -- what is refused ---------------------------------------------------------------------------------------
def _refused(scene: Scene, model: Model, form: Format) -> list[str]:
    """Return what acts on the motion and the format has not, each reason once with all that it is about."""
    reasons: dict[str, list[str]] = {}
    for name, reason in _refusals(scene, model, form):
        reasons.setdefault(reason, []).append(name)
    return [f"{', '.join(names)}: {reason}" for reason, names in reasons.items()]


def _refusals(scene: Scene, model: Model, form: Format) -> Iterator[tuple[str, str]]:
    """Yield elements, and why the format cannot hold each."""
    for joint in scene.robot.joints:
        if joint.type not in form.joints:
            yield f"joint {joint.name!r}", f"{joint.type} (allowed: {', '.join(form.joints)})"
    for loop in model.loops:
        kind = loop.element.type
        if kind not in form.loops:
            holders = [name for name in formats if kind in formats[name].loops]
            there = f"; in {' or '.join(holders)} it can be" if holders else ""
            yield f"loop {loop.name!r}", f"{kind} (allowed: {', '.join(form.loops)}){there}"
    moving = [name for name, point in scene.robot.points.items() if point.motion is not None]
    for loop in scene.loops:
        if any(end.rpartition(".")[2] in moving for end in loop.between):
            yield f"loop {loop.name!r}", "ends at a point of the ground that moves"
    for coupler in scene.couplers:
        if coupler.value is not None and "t" in coupler.value.names:
            yield f"coupler {coupler.name!r}", "its value changes in time"
    for force in model.forces:
        yield f"force {force.name!r}", "forces between bodies are not in the format"
    for payload in scene.payloads:
        yield f"payload {payload.name!r}", "masses that are picked up or carried are not in the format"
    for body in model.bodies:
        for one in body.forces:
            if problem := _force_problem(one, body.joint.type, body.joint.nv, form):
                yield f"{one.kind} of {one.name!r}", problem


def _force_problem(force: Any, kind: str, nv: int, form: Format) -> str:
    """Return why a format cannot hold a force in a joint, empty where it can."""
    element = force.element
    if isinstance(element, Gear):
        return "losses of gears are not in the format"
    if force.kind == "limits":
        return "how stops give way is not in the format (limits without 'stop' are)"
    if isinstance(element, Spring) and (force.in_space or not form.springs):
        return "springs are not in the format" + (" for motions in space" if force.in_space else "")
    if isinstance(element, Friction) and element.dry:
        plus, minus = element.levels()
        if (
            plus != -minus
            or element.static is not None
            or element.stribeck_speed is not None
            or force.in_space
        ):
            return "the format has one level of Coulomb friction, for both directions, of one coordinate"
    if force.in_space and not (form.in_space and kind == "spherical"):
        return f"the format has none in a joint of type {kind}"
    if nv > 1 and not force.in_space and kind not in form.along:
        return f"the format has none in a joint of type {kind}"
    return ""


# -- what is made up, and listed ---------------------------------------------------------------------------
def made_up(scene: Scene) -> list[str]:
    """Return what there is to say of data that the scene does not give.

    Raises
    ------
    CapabilityError : the equations of motion need some of them.
    """
    terms = Problem(scene).rigid_terms()
    missing = unknown_among([x for term in terms.values() for x in np.ravel(term)])
    if missing:
        raise CapabilityError(
            f"the motion depends on data that the scene does not give: {listed(sorted(set(missing)))}",
            (scene.path,),
        )
    links = zip(scene.robot.links, filled(scene).links)
    names = [new.name for old, new in links if _differs(old, new)]
    text = "data that the scene does not give, and no motion depends on, are made up in links"
    return [f"{text} {listed(names)}"] if names else []


def filled(scene: Scene) -> Robot:
    """Return the robot with numbers in place of data that are not given."""
    return dataclasses.replace(scene.robot, links=tuple(_completed(link) for link in scene.robot.links))


def _differs(old: Link, new: Link) -> bool:
    """Tell whether a link got numbers that do not follow from what is given."""
    if (new.mass or any(getattr(new.inertia, k) for k in ("xx", "yy", "zz"))) and old != new:
        given = (old.inertia.xx, old.inertia.yy, old.inertia.zz)
        return old.com is None or old.mass is None or None in given
    return False


def _completed(link: Link) -> Link:
    """Return a link with all numbers; no result depends on those that are made up."""
    given = link.inertia
    moments = [x for x in (given.xx, given.yy, given.zz) if x is not None]
    mass = 0.0 if link.mass is None else link.mass
    usual = max(moments) if moments else 1e-3 * mass
    filled = {
        name: (usual if name in ("xx", "yy", "zz") else 0.0)
        if getattr(given, name) is None
        else getattr(given, name)
        for name in ("xx", "yy", "zz", "xy", "xz", "yz")
    }
    if mass == 0.0 and not moments:
        filled = {name: x or 0.0 for name, x in filled.items()}
    return dataclasses.replace(link, mass=mass, com=link.com or (0.0, 0.0, 0.0), inertia=Inertia(**filled))


def _limits(scene: Scene, model: Model, form: Format, notes: list[str]) -> dict[str, dict[str, float]]:
    """Return the limits that formats have, by coordinate; the others are listed."""
    limits: dict[str, dict[str, float]] = {}
    left = []
    for joint in scene.robot.joints:
        for name in (joint.name, *model.v_columns(joint.name)):
            own = scene.robot.limits_of(name) if name not in limits else None
            if own is None:
                continue
            given = {
                k: getattr(own, k) for k in ("lower", "upper", "speed", "acceleration", "jerk", "effort")
            }
            given = {k: x for k, x in given.items() if x is not None}
            kept = name == joint.name or joint.type in form.along
            limits[name] = {
                k: float(x) for k, x in given.items()
                if kept and k in form.limits and not isinstance(x, (tuple, list))
            }  # fmt: skip
            left += [f"{k} of {name}" for k in given if k not in limits[name]]
    if left:
        notes.append(f"left out, for the format has no such limits: {listed(left)}")
    return limits


def _without_motors(
    links: Iterable[ExportedLink], actuated: Collection[str], notes: list[str]
) -> Iterator[ExportedLink]:
    """Yield the links with an effort of 0 in joints without a motor; of some kinds that cannot be said."""
    left = []
    for link in links:
        if link.joint in actuated or not link.coordinates:
            yield link
        elif len(link.coordinates) > 1 or link.coordinates[0].rotor_inertia:
            left += [link.joint]
            yield link
        else:
            (one,) = link.coordinates
            still = dataclasses.replace(one, limits={**one.limits, "effort": 0.0})
            yield dataclasses.replace(link, coordinates=(still,))
    if left:
        notes.append(f"left out, that they have no motor: {listed(left)}")


def _left_out(scene: Scene, dh: list[str]) -> Iterator[str]:
    """Yield what is no part of a robot's equations, and so left out, and what becomes of frames."""
    robot = scene.robot
    shapes = sum(len(link.visual) for link in robot.links)
    parts = [
        *([f"{shapes} shapes of links"] if shapes else []),
        *([f"{len(robot.points)} points"] if robot.points else []),
        *([f"{len(robot.frames)} frames"] if robot.frames else []),
    ]
    sections = ("initial", "torques", "control", "prescribed", "trajectory")
    empty = {"initial": type(scene.initial)()}
    parts += [key for key in sections if getattr(scene, key) and getattr(scene, key) != empty.get(key)]
    if parts:
        yield f"left out, for it is no part of the equations of the robot: {', '.join(parts)}"
    if dh:
        yield f"links of joints with D-H parameters have the frames of their joints: {listed(dh)}"
    smooth = [
        joint.name
        for joint in robot.joints
        for _, force in joint.forces
        if isinstance(force, Friction) and force.is_smoothed
    ]
    if smooth:
        yield f"Coulomb friction is written as its level, without 'transition_speed': {listed(smooth)}"


def renamed(robot: ExportedRobot, form: Format, notes: list[str]) -> ExportedRobot:
    """Return a robot no link of which has a name that the format keeps for itself."""
    names = [link.name for link in robot.links]
    new = {name: fresh(name, (*names, *form.reserved)) for name in names if name in form.reserved}
    if not new:
        return robot
    notes.append("links with new names: " + ", ".join(f"{name} is {x}" for name, x in new.items()))
    links = (
        dataclasses.replace(
            link, name=new.get(link.name, link.name), parent=new.get(link.parent, link.parent)
        )
        for link in robot.links
    )
    loops = []
    for loop in robot.loops:
        first, second = (dataclasses.replace(end, link=new.get(end.link, end.link)) for end in loop.ends)
        loops.append(dataclasses.replace(loop, ends=(first, second)))
    return dataclasses.replace(robot, links=tuple(links), loops=tuple(loops))


# -- positions ---------------------------------------------------------------------------------------------
def _reference(scene: Scene, model: Model, form: Format, notes: list[str]) -> Array:
    """Return the positions (nq,) of the poses that are written: all neutral, or those of the closed start.

    Raises
    ------
    GeometryError : the loops do not close.
    """
    neutral = Manifold(model).neutral()
    if not (form.assembled and model.loops):
        return neutral
    from robodyn_cli.ready.prepare import prepare
    from robodyn_cli.solve.closure import Numbers

    if np.abs(Numbers(Problem(scene), ()).eta(neutral)).max() <= CLOSED:
        return neutral
    setup = prepare(scene)
    q = setup.assembled.q
    values = ", ".join(f"{name} {x:.6g}" for name, x in zip(setup.problem.model.q_names, q))
    notes.append(
        f"poses of {form.name} are those of closed loops, so joints count from the start of the scene: {values}"
    )
    return q


def _from(reference: Array, model: Model, link: Any) -> Any:
    """Return a link whose limits and springs count from the reference."""
    body = model.body_of(link.joint)
    if body.joint.quasi:
        return link
    moved = []
    for one, q in zip(link.coordinates, reference[body.q : body.q + body.joint.nq]):
        limits = {k: x - float(q) if k in ("lower", "upper") else x for k, x in one.limits.items()}
        moved.append(dataclasses.replace(one, limits=limits, rest=one.rest - float(q)))
    return dataclasses.replace(link, coordinates=tuple(moved))


def coupler_of(scene: Scene, coupler: Any, model: Model, reference: Array) -> ExportedCoupler:
    """Return a coupler of coordinates that count from a reference (nq,)."""
    parameters = {f"p.{name}": x for name, x in scene.parameters.items()}
    value = 0.0 if coupler.value is None else float(coupler.value.evaluate(parameters))
    terms = {name: float(x) for name, x in coupler.terms.items()}
    value -= sum(x * float(reference[model.body_of(name).q]) for name, x in terms.items())
    return ExportedCoupler(coupler.name, terms, value + 0.0)
