"""The led joints or point of a mechanism, and its loops, as conditions on positions, rates and accelerations."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.expr.graph import Expr, Scalar, count_operations
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.record import record
from robodyn_cli.run.observation.evaluation import compiling
from robodyn_cli.solve.closure import mechanism_size
from robodyn_cli.solve.inverse_kinematics import target_of
from robodyn_cli.solve.point_kinematics import PointKinematics, what_is_left
from robodyn_cli.spatial.algebra import Array, dot
from robodyn_cli.trajectories.motion import JointSpace, PoseMotion, TaskSpace

INTERPRETED = 2e-7  # seconds that an operation on plain numbers takes
# the given motion at times (T,): values, rates and accelerations (T, k)
Asked = Callable[[Array], tuple[Array, Array, Array]]


@record
class Lead:
    """The joints, or the point, that lead a mechanism beside its prescribed joints, and their motion.

    components : of the point's position that are led. oriented : whether the axes at the point are led too; the values
    asked are those of a pose then.
    """

    asked: Asked
    joints: tuple[str, ...] = ()
    point: str | None = None
    components: int = 3
    oriented: bool = False


def nothing_led() -> Lead:
    """Return the lead of a mechanism whose motion its loops and prescribed joints determine alone."""
    return Lead(lambda times: (np.zeros((len(times), 0)),) * 3)


def lead_of(problem: Problem) -> Lead:
    """Return the joints or the point that the scene's trajectory leads; none without a trajectory."""
    scene = problem.scene
    trajectory: JointSpace | TaskSpace | None = scene.trajectory
    parameters = scene.parameters
    if trajectory is None:
        return nothing_led()
    if isinstance(trajectory, TaskSpace):
        some = target_of(problem.model, trajectory, np.zeros(1), parameters)

        def point(times: Array) -> tuple[Array, Array, Array]:
            target = target_of(problem.model, trajectory, times, parameters)
            return target.values, target.rates, target.accelerations

        oriented = isinstance(some, PoseMotion)
        return Lead(point, point=trajectory.point, components=some.p.shape[1], oriented=oriented)
    both = [name for name in trajectory.joints if name in scene.prescribed]
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
                f"single coordinates of it where they are rates of positions ({columns})",
                joint=name,
            )


class LoopConditions:
    """Loops, prescribed joints and the lead as conditions on numbers (see ``solve.guided.MotionConditions``)."""

    def __init__(self, problem: Problem, lead: Lead, times: Array) -> None:
        model = self.model = problem.model
        self.manifold = Manifold(model)
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
            frame = model.place(lead.point)
            point = PointKinematics.of(model, problem.q, problem.v, frame, lead.components, lead.oriented)
            values += point.p
            J += point.J
            axes = [*"xyz"[: lead.components], *(("rx", "ry", "rz") if lead.oriented else ())]
            for i, axis in enumerate(axes):
                rate = point.J_rate[i * model.nv : (i + 1) * model.nv]
                bias.append(dot(rate, problem.v))
                names.append(f"{lead.point}.{axis}")
                lengths.append(len(axis) == 1)
        self.names = tuple(names)
        self.led = len(names) - len(rows)
        self._expressions = problem, values, J, [*(row.eta_t for row in rows), *bias]
        self._values = len(values)  # of a pose its axes, in the place of three rows
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
        """Return values (k,), rates and accelerations (m,) of the led joints or point."""
        if t not in self._asked:
            found = self.lead.asked(np.array([t]))
            self._asked[t] = (found[0][0], found[1][0], found[2][0])
        return self._asked[t]

    def at(self, q: Array, t: float) -> tuple[Array, Array]:
        found = self._here(q, np.zeros(self.model.nv), t)
        m = len(self.names)
        rows, values = m - self.led, self._values
        wanted, here = self.asked(t)[0], found[rows:values]
        left = what_is_left(wanted, here) if self.lead.oriented else wanted - here
        return np.concatenate([found[:rows], -left]), found[values:].reshape(m, self.model.nv)

    def rates(self, q: Array, v: Array, t: float) -> tuple[Array, Array]:
        found = self._rates(q, v, t)
        m = len(self.names)
        _, rate, acceleration = self.asked(t)
        rows = m - self.led
        c = np.concatenate([-found[:rows], rate])
        b = -found[rows:]
        b[rows:] += acceleration
        return c, b

    def levels(self) -> tuple[list[Scalar], list[Scalar], list[Scalar], list[Scalar]]:
        """Return expressions of what is led, and of the loops' rows, which are zero: values (of a pose its axes, in the
        place of three rows), rates J v + eta_t (m,), accelerations J v-dot + gamma (m,); and J (m nv,).
        """
        problem, values, J, others = self._expressions
        m, nv = len(self.names), self.model.nv
        eta_t, bias = [*others[: m - self.led], *[0.0] * self.led], others[m - self.led :]
        rows = [J[i * nv : (i + 1) * nv] for i in range(m)]
        rates = [dot(row, problem.v) + x for row, x in zip(rows, eta_t)]
        accelerations = [dot(row, problem.a) + x for row, x in zip(rows, bias)]
        return values, rates, accelerations, J

    def step(self, q: Array, dq: Array) -> Array:
        return self.manifold.normalise(self.manifold.integrate(q, dq))


def _single(model: Model, entries: Sequence[Scalar], calls: int) -> Callable[[Array, Array, float], Array]:
    """Return expressions as a function of one q, v and t; compiled where that pays over so many calls."""
    varying = [k for k, e in enumerate(entries) if isinstance(e, Expr)]
    constant = np.array([0.0 if isinstance(e, Expr) else float(e) for e in entries])
    operations = count_operations([entries[k] for k in varying])
    if not varying or operations * calls * INTERPRETED < compiling(operations):
        evaluator = Evaluator(entries)

        def interpreted(q: Array, v: Array, t: float) -> Array:
            return np.array(evaluator({"q": q.tolist(), "v": v.tolist(), "t": [t], "p": []}), dtype=float)

        return interpreted
    from robodyn_cli.kernels.samples import SampleKernel, of_one_sample

    kernel = SampleKernel({"out": [entries[k] for k in varying]}, ("t", "q", "v"))
    here = of_one_sample(kernel, t=1, q=model.nq, v=model.nv)

    def compiled(q: Array, v: Array, t: float) -> Array:
        out = constant.copy()
        out[varying] = here(t=t, q=q, v=v)["out"]
        return out

    return compiled


def velocity_places(model: Model, names: Sequence[str]) -> list[int]:
    """Return the velocity coordinates of joints and of single columns (``slide``, ``slide.z``), each once."""
    found: list[int] = []
    for name in names:
        columns = (name,) if name in model.v_names else model.v_columns(name)
        found += [model.v_names.index(column) for column in columns]
    return list(dict.fromkeys(found))
