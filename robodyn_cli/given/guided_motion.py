"""The motion of all joints of a mechanism with loops, from the motion of some joints or of a point."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from robodyn_cli.algorithms.bands import parts
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, GeometryError, SingularConfigurationError, listed
from robodyn_cli.given.loop_conditions import Lead, LoopConditions, leads_apart
from robodyn_cli.given.motion import Planned, plan_motion
from robodyn_cli.given.prescribed import check_prescribed, prescribed_starts
from robodyn_cli.loops.base import closure_of
from robodyn_cli.observe.places import in_world
from robodyn_cli.solve.closing.assembly import closed_start
from robodyn_cli.solve.closure import CLOSED, LEAST_ROUNDED, RANK, Numbers, mechanism_size, rank
from robodyn_cli.solve.guided import Guide, GuidedPlace, Stuck
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import rounded_up
from robodyn_cli.trajectories.led import led_joints, position_columns
from robodyn_cli.trajectories.motion import JointMotion

SURE = 1e-5  # smallest over largest singular value of J above which no rank is being lost
MOVED = 1e-6  # of the coordinate that a freedom moves most, from which on it moves another
AGREE = 1e-6  # of the largest rate asked for, up to which rates agree


def guided_motion(problem: Problem, lead: Lead, times: Array) -> Planned:
    """Return the motion at ``times`` (T,) that the loops and the led joints, or point, determine. A motion that cannot
    go on ends early, with the reason in ``stopped``.

    Raises
    ------
    GeometryError : the loops cannot close at the start. SingularConfigurationError : the start is singular.
    CapabilityError : less is led than the mechanism has degrees of freedom.
    """
    if leads_apart(problem):
        return _apart(problem, times)
    conditions = LoopConditions(problem, lead, times)
    guide = Guide(conditions)
    q = _start(problem, lead, conditions)
    try:
        now = guide.start(q, float(times[0]))
    except Stuck as stuck:
        _check_determined(problem, conditions, q, float(times[0]))
        raise explain(problem, conditions, stuck) from None
    _check_rates(problem, conditions, now)
    places, stuck_at = guide.follow(now, times)
    stopped = None if stuck_at is None else explain(problem, conditions, stuck_at)
    motion = _motion_of(places)
    counters = {"iterations": guide.iterations, "steps": guide.steps}
    reached = times[: len(places)]
    residuals = _residuals(conditions, places) if problem.model.closures else {}

    def near(times: Array, guess: Array) -> JointMotion | None:
        found, good = Guide(conditions.at_times(times)).near(guess, slice(None))
        return JointMotion(*map(np.asfortranarray, (found.q, found.qd, found.qdd))) if good.all() else None

    planned = Planned(
        reached,
        motion,
        residuals=residuals,
        counters=counters,
        stopped=stopped,
        near=near if conditions.together and stopped is None else None,
    )
    return with_target(problem, lead, planned)


def _motion_of(places: Sequence[GuidedPlace]) -> JointMotion:
    return JointMotion(*(np.asfortranarray([getattr(p, name) for p in places]) for name in ("q", "v", "a")))


def rounding_warnings(problem: Problem, planned: Planned) -> list[str]:
    """Return a warning where the loops stay open along a motion, as rows contradict each other by rounding."""
    left = planned.residuals.get("position", 0.0)
    if not left > LEAST_ROUNDED * mechanism_size(problem.model):
        return []
    return [
        f"the loops stay open by up to {rounded_up(left):.2g} m or rad: rows that follow from others contradict these "
        "by rounding in the data, and the motion is that of the others"
    ]


def with_target(problem: Problem, lead: Lead, planned: Planned) -> Planned:
    """Return the motion that a lead gave with where the point that leads, if one does, is asked to be."""
    if lead.led is None:
        return planned
    motion, wanted = planned.motion, lead.asked(planned.times)[0]
    R = wanted[:, 3:].reshape(-1, 3, 3) if lead.led.oriented else None
    target, axes = in_world(
        problem.model, lead.led.relative_to, wanted[:, : lead.led.components], R, motion.q
    )
    return dataclasses.replace(planned, point=lead.point, target=target, axes=axes, method="newton")


def _apart(problem: Problem, times: Array) -> Planned:
    """Return the motion of a chain that a point leads and loops do not touch; the joints that they tie rest, closed."""
    scene, numbers = problem.scene, Numbers(problem, ())
    check_prescribed(problem)
    given = {**scene.initial.q, **scene.trajectory.ik.guess, **prescribed_starts(scene)}
    closed, _ = closed_start(problem, given, tuple(position_columns(scene.prescribed)))
    start = dict(zip(problem.model.q_names, closed.tolist()))
    initial = dataclasses.replace(scene.initial, q=start)
    found = plan_motion(Problem(dataclasses.replace(scene, loops=(), couplers=(), initial=initial)), times)
    position = max(float(np.abs(numbers.eta(q, t)).max()) for q, t in zip(found.motion.q, found.times))
    return dataclasses.replace(found, residuals={"position": position, "velocity": 0.0, "acceleration": 0.0})


def _start(problem: Problem, lead: Lead, conditions: LoopConditions) -> Array:
    """Return a closed configuration in which the led joints are where their motion begins.

    Where rows contradict each other by rounding in the data, the conditions are told up to which residual they agree.
    """
    scene = problem.scene
    check_prescribed(problem)
    first = conditions.asked(0.0)[0]
    led = dict(zip(lead.positions, first.tolist()))
    guess = dict(scene.trajectory.ik.guess) if lead.led is not None else {}
    held = {**prescribed_starts(scene), **led}
    q, tolerance = closed_start(problem, {**scene.initial.q, **guess, **held}, tuple(held))
    if tolerance > CLOSED:
        conditions.same = conditions.singular = tolerance
    return q


def _check_determined(problem: Problem, conditions: LoopConditions, q: Array, t: float) -> None:
    """Refuse motions that do not determine the mechanism's motion.

    Raises
    ------
    CapabilityError
    """
    _, J = conditions.at(q, t)
    J = J * conditions.lengths / conditions.sizes[:, None]
    rows, model = len(conditions.names) - conditions.led, problem.model
    tolerance = max(RANK, conditions.singular)
    free = model.nv - rank(J[:rows], tolerance)
    if free > conditions.led:
        left = np.linalg.norm(np.linalg.svd(J)[2][rank(J, tolerance) :], axis=0)
        moved = dict.fromkeys(model.joint_of(int(k)) for k in np.flatnonzero(left > MOVED * left.max()))
        raise CapabilityError(
            f"the mechanism has {free} degrees of freedom there beside its prescribed joints, and the trajectory leads "
            f"{conditions.led}, which leaves {listed(list(moved))} free to move; allowed: lead {free} joints, or "
            "simulate, with what is led in 'prescribed', where the others move as their forces let them"
        )


def _check_rates(problem: Problem, conditions: LoopConditions, start: GuidedPlace) -> None:
    """Refuse motions whose rates contradict each other at a start that is not singular.

    Raises
    ------
    GeometryError
    """
    c, _ = conditions.rates(start.q, start.v, start.t)
    _, J = conditions.at(start.q, start.t)
    off = np.abs(J @ start.v - c) / conditions.sizes
    agree = off.max(initial=0.0) <= AGREE * np.abs(c / conditions.sizes).max(initial=0.0)
    if agree or not start.measure > SURE:
        return
    model, lead = problem.model, conditions.lead
    stay = {model.joint_of(model.v_names.index(name)) for name in lead.joints[1:]}
    hold = [name for name in problem.scene.initial.hold if name in stay]
    led = lead.point or ", ".join([*lead.joints, *led_joints(problem.scene.prescribed)])
    raise GeometryError(
        f"the motion asked for cannot be met at t = {start.t:.6g} s: "
        + (
            f"'initial.hold' keeps {', '.join(hold)} where it is, and then the loops do not let {lead.joints[0]} move"
            if hold
            else f"the rates led ({led}) contradict each other, since the loops leave less freedom than is led"
        ),
        time=start.t, row=conditions.names[int(off.argmax())], **({"key": "initial.hold"} if hold else {}),
    )  # fmt: skip


def explain(
    problem: Problem, conditions: LoopConditions, stuck: Stuck
) -> GeometryError | SingularConfigurationError:
    """Return why a motion cannot go on: with the row that is violated, or with joint and loop of the singular pose."""
    if stuck.row is not None:
        name, gap = stuck.row
        unit = (
            "m" if conditions.sizes[conditions.names.index(name)] != 1.0 or conditions.size == 1.0 else "rad"
        )
        return GeometryError(
            f"the motion asked for cannot be met at t = {stuck.time:.6g} s: {name} is off by {abs(gap):.3g} {unit} at "
            "best, since the loops leave less freedom than is led, or none there",
            time=stuck.time, row=name, residual=abs(gap),
        )  # fmt: skip
    rows, coordinates = stuck.weights
    joint = problem.model.joint_of(int(np.argmax(coordinates)))
    loops = rows[: len(conditions.names) - conditions.led]
    loop = closure_of(conditions.names[int(np.argmax(loops))]) if len(loops) else "none"
    last = stuck.last
    when = f"at t = {stuck.time:.9g} s"
    if last is not None and last.t < stuck.time:
        when = f"at t = {stuck.time:.9g} +- {rounded_up(stuck.time - last.t):.1e} s"
    angles = {} if last is None else {"q": last.q.tolist()}
    if last is not None and _bifurcates(conditions, last):
        return SingularConfigurationError(
            f"bifurcation {when}: the rows of loop {loop} lose rank and let joint {joint} go, so "
            "the mechanism may go on in more than one way",
            time=stuck.time, kind="bifurcation", joint=joint, loop=loop, **angles,
        )  # fmt: skip
    return SingularConfigurationError(
        f"singular configuration {when}: loop {loop} lets joint {joint} move without the input "
        "(a dead point), so its rate is not determined or without bound; the motion cannot go on from there",
        time=stuck.time, kind="dead_point", joint=joint, loop=loop, **angles,
    )  # fmt: skip


def _bifurcates(conditions: LoopConditions, last: GuidedPlace) -> bool:
    """Tell whether the loops themselves lose rank, as fast as all conditions together do. At a dead point of the led
    joints they keep it.
    """
    held = len(conditions.names) - conditions.led - len(conditions.prescribed)
    independent = last.J.shape[1] - conditions.led - len(conditions.prescribed)
    if not 0 < independent <= held:
        return False
    loops = [i for i in range(len(conditions.names) - conditions.led) if i not in conditions.prescribed]
    s = np.linalg.svd(last.J[loops], compute_uv=False)
    together = np.linalg.svd(last.J, compute_uv=False)
    return bool(s[independent - 1] < 10.0 * together[-1] and s[independent - 1] < 1e-2 * s[0])


def _residuals(conditions: LoopConditions, places: Sequence[GuidedPlace]) -> dict[str, float]:
    """Return the largest residuals of position, velocity and acceleration conditions over the samples."""
    largest = np.zeros(3)
    if conditions.together:
        for samples in parts((len(places), len(conditions.sizes), len(conditions.lengths))):
            q, v, a = (
                np.array([getattr(place, name) for place in places[samples]]) for name in ("q", "v", "a")
            )
            F, J = conditions.at_samples(q, samples)
            c, b = conditions.rates_at_samples(q, v, samples)
            rates = ((J @ x[..., None])[..., 0] - y for x, y in ((v, c), (a, b)))
            largest = np.maximum(largest, [np.abs(x).max(initial=0.0) for x in (F, *rates)])
        places = ()
    for place in places:
        F, J = conditions.at(place.q, place.t)
        c, b = conditions.rates(place.q, place.v, place.t)
        here = [np.abs(x).max(initial=0.0) for x in (F, J @ place.v - c, J @ place.a - b)]
        largest = np.maximum(largest, here)
    return dict(zip(("position", "velocity", "acceleration"), largest.tolist()))
