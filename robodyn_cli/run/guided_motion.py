"""The motion of a mechanism with loops from the motion of some of its joints, or of a point."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.kinematics import slice_q
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, GeometryError, SceneError, SingularConfigurationError
from robodyn_cli.expr.graph import Expr, Scalar, count_operations
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.model.model import Model
from robodyn_cli.record import record
from robodyn_cli.run.prescribed import check_prescribed, prescribed_starts
from robodyn_cli.solve.assembly import assemble, mechanism_size
from robodyn_cli.solve.guided import Guide, Place, Stuck
from robodyn_cli.solve.point_kinematics import PointKinematics
from robodyn_cli.trajectories.motion import JointMotion, TaskSpace

Array = NDArray[Any]
# seconds: an operation interpreted; compiling at all, and an operation of it
INTERPRETED, COMPILING, COMPILED = 2e-7, 35e-3, 80e-6
# what is asked at times (T,): values, rates and accelerations (T, k)
Asked = Callable[[Array], tuple[Array, Array, Array]]


@record
class Lead:
    """What leads a mechanism beside its loops and prescribed joints: joints, or a point, and how they move."""

    asked: Asked
    joints: tuple[str, ...] = ()
    point: str | None = None
    components: int = 3


@record
class GuidedMotion:
    """Motion at the samples that were reached, its worst residuals, and what it took.

    stopped : why the motion could not go on, None where it is whole.
    """

    times: Array
    motion: JointMotion
    residuals: dict[str, float]
    counters: dict[str, int]
    stopped: GeometryError | SingularConfigurationError | None = None


def lead_of(problem: Problem) -> Lead:
    """Return what the scene's trajectory leads; nothing where prescribed joints do."""
    scene = problem.scene
    trajectory: Any = scene.trajectory
    parameters = scene.parameters or {}
    if trajectory is None:
        return Lead(lambda times: (np.zeros((len(times), 0)),) * 3)
    if isinstance(trajectory, TaskSpace):
        some = trajectory.target(np.zeros(1), parameters)

        def point(times: Array) -> tuple[Array, Array, Array]:
            target = trajectory.target(times, parameters)
            return target.p, target.pd, target.pdd

        return Lead(point, point=trajectory.point, components=some.p.shape[1])
    both = [name for name in trajectory.joints if name in (scene.prescribed or {})]
    if both:
        raise SceneError(
            f"{scene.path}: joint {both[0]!r} moves by `trajectory` and by `prescribed`; leave it out of one of them",
            key=f"prescribed.{both[0]}",
        )

    refuse_quasi(problem.model, trajectory.joints)

    def joints(times: Array) -> tuple[Array, Array, Array]:
        found = trajectory.motion(times, trajectory.joints, parameters)
        return found.q, found.qd, found.qdd

    return Lead(joints, joints=tuple(trajectory.joints))


def refuse_quasi(model: Model, names: Sequence[str]) -> None:
    """Refuse to lead joints whose velocities are no rates of positions, and joints of several axes as a whole.

    Raises
    ------
    CapabilityError
    """
    for name in names:
        if name in model.joint_names and name not in model.v_names:
            columns = ", ".join(model.v_columns(name))
            raise CapabilityError(
                f"joint {name!r} of a mechanism with loops cannot be led as a whole: lead joints of one axis, or "
                f"single coordinates of it where they are rates of positions ({columns})"
            )


class LoopConditions:
    """Loops, prescribed joints and what is led, as conditions on numbers (see ``solve.guided.Conditions``)."""

    def __init__(self, problem: Problem, lead: Lead, times: Array) -> None:
        model = self.model = problem.model
        self.lead = lead
        rows = problem.constraints.rows
        self.size = mechanism_size(model)
        values: list[Scalar] = [row.eta for row in rows]
        J: list[Scalar] = [x for row in rows for x in row.psi]
        bias: list[Scalar] = [row.gamma for row in rows]
        names, lengths = [row.name for row in rows], [row.kind in ("force", "m") for row in rows]
        for name in lead.joints:
            place = model.v_names.index(name)
            values.append(problem.q[model.q_names.index(name)])
            J += [1.0 if k == place else 0.0 for k in range(model.nv)]
            bias.append(0.0)
            names.append(f"trajectory.{name}")
            lengths.append(model.v_units[place] == "m")
        if lead.point is not None:
            frame = model.points[lead.point]
            point = PointKinematics.of(model, problem.q, problem.v, frame, lead.components)
            values += point.p
            J += point.J
            for i in range(lead.components):
                rate = point.J_rate[i * model.nv : (i + 1) * model.nv]
                total: Scalar = 0.0
                for x, v in zip(rate, problem.v):
                    total = total + x * v
                bias.append(total)
                names.append(f"{lead.point}.{'xyz'[i]}")
                lengths.append(True)
        self.names = tuple(names)
        self.led = len(names) - len(rows)
        self.prescribed = problem.constraints.prescribed
        self.sizes = np.where(lengths, self.size, 1.0)
        self.lengths = np.array([self.size if unit == "m" else 1.0 for unit in model.v_units])
        # a sample takes about four evaluations
        self._here = _single(model, [*values, *J], 4 * len(times))
        self._rates = _single(model, [*(row.eta_t for row in rows), *bias], 4 * len(times))
        self._asked: dict[float, tuple[Array, Array, Array]] = {}
        found = lead.asked(times)
        for k, t in enumerate(times.tolist()):
            self._asked[t] = (found[0][k], found[1][k], found[2][k])

    def asked(self, t: float) -> tuple[Array, Array, Array]:
        """Return value, rate and acceleration (k,) of what is led."""
        if t not in self._asked:
            found = self.lead.asked(np.array([t]))
            self._asked[t] = (found[0][0], found[1][0], found[2][0])
        return self._asked[t]

    def at(self, q: Array, t: float) -> tuple[Array, Array]:
        found = self._here(q, np.zeros(self.model.nv), t)
        m = len(self.names)
        F = found[:m].copy()
        F[m - self.led :] -= self.asked(t)[0]
        return F, found[m:].reshape(m, self.model.nv)

    def rates(self, q: Array, v: Array, t: float) -> tuple[Array, Array]:
        found = self._rates(q, v, t)
        m = len(self.names)
        _, rate, acceleration = self.asked(t)
        rows = m - self.led
        c = np.concatenate([-found[:rows], rate])
        b = -found[rows:]
        b[rows:] += acceleration
        return c, b

    def step(self, q: Array, dq: Array) -> Array:
        out = q.copy()
        for body in self.model.bodies:
            moved = body.joint.integrate(slice_q(body, q), dq[body.v : body.v + body.joint.nv])
            out[body.q : body.q + body.joint.nq] = np.array(body.joint.normalise(moved), dtype=float)
        return out


def _single(model: Model, entries: Sequence[Scalar], calls: int) -> Callable[[Array, Array, float], Array]:
    """Return expressions as a function of one q, v and t; compiled where that pays over so many calls."""
    varying = [k for k, e in enumerate(entries) if isinstance(e, Expr)]
    constant = np.array([0.0 if isinstance(e, Expr) else float(e) for e in entries])
    operations = count_operations([entries[k] for k in varying])
    if not varying or operations * calls * INTERPRETED < COMPILING + operations * COMPILED:
        evaluator = Evaluator(entries)

        def interpreted(q: Array, v: Array, t: float) -> Array:
            return np.array(evaluator({"q": q.tolist(), "v": v.tolist(), "t": [t], "p": []}), dtype=float)

        return interpreted
    from robodyn_cli.kernels.samples import SampleKernel

    kernel = SampleKernel({"out": [entries[k] for k in varying]}, ("t", "q", "v"))
    # one sample fills all lanes of arrays that are in place already
    lanes = {"t": np.zeros(kernel.lanes)} | {
        name: np.zeros((kernel.lanes, n), order="F") for name, n in (("q", model.nq), ("v", model.nv))
    }

    def compiled(q: Array, v: Array, t: float) -> Array:
        lanes["t"][:], lanes["q"][:], lanes["v"][:] = t, q, v
        out = constant.copy()
        out[varying] = kernel.evaluate(kernel.lanes, lanes)["out"][0]
        return out

    return compiled


def guided_motion(problem: Problem, lead: Lead, times: Array) -> GuidedMotion:
    """Return the motion at ``times`` (T,) that the loops and what is led decide about.

    A motion that cannot go on ends early, with the reason in ``stopped``.

    Raises
    ------
    GeometryError : the loops cannot close at the start. SingularConfigurationError : the start is singular.
    CapabilityError : less is led than the mechanism has degrees of freedom.
    """
    conditions = LoopConditions(problem, lead, times)
    guide = Guide(conditions)
    q = _start(problem, lead, conditions)
    try:
        now = guide.start(q, float(times[0]))
    except Stuck as stuck:
        _check_determined(problem, conditions, q, float(times[0]))
        raise explain(problem, conditions, stuck) from None
    places, stopped = [now], None
    for t in times[1:].tolist():
        try:
            now = guide.advance(now, t)
        except Stuck as stuck:
            stopped = explain(problem, conditions, stuck)
            break
        places.append(now)
    motion = JointMotion(*(np.asfortranarray([getattr(p, name) for p in places]) for name in ("q", "v", "a")))
    counters = {"iterations": guide.iterations, "steps": guide.steps}
    return GuidedMotion(times[: len(places)], motion, _residuals(conditions, places), counters, stopped)


def _start(problem: Problem, lead: Lead, conditions: LoopConditions) -> Array:
    """Return a closed configuration in which the led joints are where their motion begins."""
    scene = problem.scene
    check_prescribed(problem)
    first = conditions.asked(0.0)[0]
    led = dict(zip(lead.joints, first.tolist())) if lead.joints else {}
    ik = getattr(scene.trajectory, "ik", None)
    guess = dict(ik.guess) if ik is not None and lead.point is not None else {}
    held = {**prescribed_starts(scene), **led}
    given = {**(scene.initial.q or {}), **guess, **held}
    return assemble(problem, given, {}, tuple(held)).q


def _check_determined(problem: Problem, conditions: LoopConditions, q: Array, t: float) -> None:
    """Refuse motions that leave the mechanism freedom.

    Raises
    ------
    CapabilityError
    """
    _, J = conditions.at(q, t)
    J = J * conditions.lengths / conditions.sizes[:, None]
    rows = len(conditions.names) - conditions.led
    free = problem.model.nv - rank(J[:rows])
    if free > conditions.led:
        raise CapabilityError(
            f"the mechanism has {free} degrees of freedom there beside its prescribed joints, and the trajectory leads "
            f"{conditions.led}; lead {free} joints"
        )


def rank(J: Array) -> int:
    """Return the rank of a matrix in comparable units."""
    if not J.size:
        return 0
    s = np.linalg.svd(J, compute_uv=False)
    return int((s > 1e-8 * max(float(s[0]), 1e-300)).sum())


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
    joint = coordinate_name(problem.model, int(np.argmax(coordinates)))
    loops = rows[: len(conditions.names) - conditions.led]
    loop = conditions.names[int(np.argmax(loops))].rsplit(".", 1)[0] if len(loops) else "none"
    last = stuck.last
    angles = {} if last is None else {"q": last.q.tolist()}
    if last is not None and _bifurcates(conditions, last):
        return SingularConfigurationError(
            f"bifurcation at t = {stuck.time:.9g} s: the rows of loop {loop} lose rank and let joint {joint} go, so "
            "the mechanism may go on in more than one way",
            time=stuck.time, kind="bifurcation", joint=joint, loop=loop, **angles,
        )  # fmt: skip
    return SingularConfigurationError(
        f"singular configuration at t = {stuck.time:.9g} s: loop {loop} lets joint {joint} move without the input "
        "(a dead point), so its rate is not determined or without bound; the motion cannot go on from there",
        time=stuck.time, kind="dead_point", joint=joint, loop=loop, **angles,
    )  # fmt: skip


def _bifurcates(conditions: LoopConditions, last: Place) -> bool:
    """Tell whether it is the loops themselves that lose rank, as fast as all conditions together do.

    At a dead point of what is led they keep it.
    """
    held = len(conditions.names) - conditions.led - len(conditions.prescribed)
    independent = last.J.shape[1] - conditions.led - len(conditions.prescribed)
    if not 0 < independent <= held:
        return False
    loops = [i for i in range(len(conditions.names) - conditions.led) if i not in conditions.prescribed]
    s = np.linalg.svd(last.J[loops], compute_uv=False)
    together = np.linalg.svd(last.J, compute_uv=False)
    return bool(s[independent - 1] < 10.0 * together[-1] and s[independent - 1] < 1e-2 * s[0])


def velocity_places(model: Model, names: Sequence[str]) -> list[int]:
    """Return the velocity coordinates of joints and of single columns (``slide``, ``slide.z``), each once."""
    found: list[int] = []
    for name in names:
        columns = (name,) if name in model.v_names else model.v_columns(name)
        found += [model.v_names.index(column) for column in columns]
    return list(dict.fromkeys(found))


def coordinate_name(model: Model, index: int) -> str:
    """Return the joint that a velocity coordinate belongs to."""
    return next(b.joint_name for b in model.bodies if b.v <= index < b.v + b.joint.nv)


def _residuals(conditions: LoopConditions, places: Sequence[Place]) -> dict[str, float]:
    """Return the largest residuals of position, velocity and acceleration conditions over the samples."""
    found = np.zeros(3)
    for place in places:
        F, J = conditions.at(place.q, place.t)
        c, b = conditions.rates(place.q, place.v, place.t)
        here = [np.abs(x).max(initial=0.0) for x in (F, J @ place.v - c, J @ place.a - b)]
        found = np.maximum(found, here)
    return dict(zip(("position", "velocity", "acceleration"), found.tolist()))
