"""The led joints or point of a mechanism, and its loops, as conditions on positions, rates and accelerations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Expr, Scalar, count_operations, is_nonzero
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.given.prescribed import refuse_both
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.observe.evaluation import compiling
from robodyn_cli.record import record
from robodyn_cli.solve.closure import mechanism_size
from robodyn_cli.solve.guided import SAME, SINGULAR
from robodyn_cli.solve.inverse_kinematics import moving_reference, target_of
from robodyn_cli.solve.point_kinematics import Led, PointKinematics, what_is_left
from robodyn_cli.spatial.algebra import Array, dot
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.trajectories.joint_space import JointSpaceTrajectory
from robodyn_cli.trajectories.led import led_joints, position_columns
from robodyn_cli.trajectories.motion import PoseMotion

INTERPRETED = 2e-7  # seconds that an operation on plain numbers takes
# the given motion at times (T,): values, rates and accelerations (T, k)
Asked = Callable[[Array], tuple[Array, Array, Array]]


@record
class Lead:
    """The joints, or the point, that lead a mechanism beside its prescribed joints, and their motion.

    joints : the columns of v that are led; positions : those of q, which the values asked are for. point, led : the
    name of the point or frame, and what of it is led; the values asked are those of a point or of a pose then.
    """

    asked: Asked
    joints: tuple[str, ...] = ()
    positions: tuple[str, ...] = ()
    point: str | None = None
    led: Led | None = None

    @staticmethod
    def of_columns(model: Model, columns: Sequence[str], asked: Asked) -> Lead:
        """Return the lead of joints by their columns of q."""
        joints = [
            (name,) if name in model.v_names else model.v_columns(name.rpartition(".")[0]) for name in columns
        ]
        return Lead(asked, tuple(dict.fromkeys(x for own in joints for x in own)), tuple(columns))

    @staticmethod
    def staying(model: Model, columns: Sequence[str], q: Sequence[float], rate: float = 0.0) -> Lead:
        """Return the lead of joints that stay at q, but for the first column, which moves on from there at a rate."""

        def asked(times: Array) -> tuple[Array, Array, Array]:
            values, rates = np.tile(q, (len(times), 1)), np.zeros((len(times), len(lead.joints)))
            if rate:
                values[:, 0] += rate * times
                rates[:, 0] = rate
            return values, rates, np.zeros_like(rates)

        lead = Lead.of_columns(model, columns, asked)
        return lead


def nothing_led() -> Lead:
    """Return the lead of a mechanism whose motion its loops and prescribed joints determine alone."""
    return Lead(lambda times: (np.zeros((len(times), 0)),) * 3)


def lead_of(problem: Problem) -> Lead:
    """Return the joints or the point that the scene's trajectory leads; none without a trajectory."""
    scene = problem.scene
    trajectory: JointSpaceTrajectory | TaskSpaceTrajectory | None = scene.trajectory
    parameters = scene.parameters
    if trajectory is None:
        return nothing_led()
    if isinstance(trajectory, TaskSpaceTrajectory):
        some = target_of(problem.model, trajectory, np.zeros(1), parameters)

        def point(times: Array) -> tuple[Array, Array, Array]:
            target = target_of(problem.model, trajectory, times, parameters)
            return target.values, target.rates, target.accelerations

        frame, moving = problem.model.place(trajectory.point), moving_reference(problem.model, trajectory)
        led = Led(frame, some.p.shape[1], isinstance(some, PoseMotion), moving)
        return Lead(point, point=trajectory.point, led=led)
    refuse_both(scene)
    columns = position_columns(trajectory.joints)

    def joints(times: Array) -> tuple[Array, Array, Array]:
        motion = trajectory.motion(times, columns, parameters)
        return motion.q, motion.qd, motion.qdd

    return Lead.of_columns(problem.model, columns, joints)


def leads_apart(problem: Problem) -> bool:
    """Tell whether a point is led by joints that no loop or coupler ties, to each other or to others.

    Then it moves as in an open chain, of which more joints than it needs may be led by criteria, and what is tied, a
    gripper's fingers, rests. Not where a prescribed motion moves what is tied.
    """
    trajectory, model = problem.scene.trajectory, problem.model
    if not isinstance(trajectory, TaskSpaceTrajectory) or not model.closures:
        return False
    moving = moving_reference(model, trajectory)
    ends = [model.place(trajectory.point).body, *([] if moving is None else [moving.body])]
    chain = {model.bodies[k].joint_name for end in ends for k in model.path_to(end)}
    tied = {model.joint_of(k) for row in problem.constraints.loop_rows for k in row.entries}
    drives = any(is_nonzero(row.eta_t) for row in problem.constraints.loop_rows)
    return not drives and not tied & {*chain, *led_joints(problem.scene.prescribed)}


def refuse_quasi(model: Model, name: str) -> None:
    """Refuse to sweep a joint of several axes as a whole, or a coordinate that is no rate of a position.

    Raises
    ------
    CapabilityError
    """
    if name in model.joint_names and name not in model.v_names:
        columns = ", ".join(model.v_columns(name))
        raise CapabilityError(
            f"joint {name!r} cannot be swept as a whole: sweep a joint of one axis, or a single coordinate of it where "
            f"that is the rate of a position ({columns})",
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
        self._velocities = [model.v_names.index(name) for name in lead.joints]
        self._positions = [model.q_names.index(name) for name in lead.positions]
        for name, place in zip(lead.joints, self._velocities):
            J += [1.0 if k == place else 0.0 for k in range(model.nv)]
            bias.append(0.0)
            names.append(f"trajectory.{name}")
            lengths.append(model.v_units[place] == "m")
        if lead.led is not None:
            point = PointKinematics.of(model, problem.q, problem.v, lead.led)
            values += point.p
            J += point.J
            axes = [*"xyz"[: lead.led.components], *(("rx", "ry", "rz") if lead.led.oriented else ())]
            for i, axis in enumerate(axes):
                rate = point.J_rate[i * model.nv : (i + 1) * model.nv]
                bias.append(dot(rate, problem.v))
                names.append(f"{lead.point}.{axis}")
                lengths.append(len(axis) == 1)
        self.same, self.singular = SAME, SINGULAR
        self.names = tuple(names)
        self.led = len(names) - len(rows)
        self._problem, self._values_of, self._J = problem, values, J
        self._bias = [*(row.eta_t for row in rows), *bias]
        self._values = len(values)  # none of led joints; of a pose its axes, in the place of three rows
        self.prescribed = problem.constraints.prescribed
        self.sizes = np.where(lengths, self.size, 1.0)
        self.lengths = np.array([self.size if unit == "m" else 1.0 for unit in model.v_units])
        # a sample takes about four evaluations
        self._here, self._rates = (_Entries(model, x, 4 * len(times)) for x in self.entries())
        self._ask(times)

    def _ask(self, times: Array) -> None:
        self._asked: dict[float, tuple[Array, Array, Array]] = {}
        self._times, self._at_times = times, self.lead.asked(times)
        wanted = self._at_times
        for k, t in enumerate(times.tolist()):
            self._asked[t] = (wanted[0][k], wanted[1][k], wanted[2][k])

    def at_times(self, times: Array) -> LoopConditions:
        """Return the same conditions for samples at other times (T,)."""
        other = copy(self)
        other._ask(times)
        return other

    def asked(self, t: float) -> tuple[Array, Array, Array]:
        """Return values (k,), rates and accelerations (m,) of the led joints or point."""
        if t not in self._asked:
            wanted = self.lead.asked(np.array([t]))
            self._asked[t] = (wanted[0][0], wanted[1][0], wanted[2][0])
        return self._asked[t]

    def at(self, q: Array, t: float) -> tuple[Array, Array]:
        outputs = self._here(q, np.zeros(self.model.nv), t)
        m = len(self.names)
        rows, values, wanted = m - self.led, self._values, self.asked(t)[0]
        if self.lead.led is not None:
            left = what_is_left(wanted, outputs[rows:values], self.lead.led.oriented)
        else:
            there = q.copy()
            there[self._positions] = wanted
            left = self.manifold.difference(q, there)[self._velocities]
        return np.concatenate([outputs[:rows], -left]), outputs[values:].reshape(m, self.model.nv)

    def rates(self, q: Array, v: Array, t: float) -> tuple[Array, Array]:
        outputs = self._rates(q, v, t)
        m = len(self.names)
        _, rate, acceleration = self.asked(t)
        rows = m - self.led
        c = np.concatenate([-outputs[:rows], rate])
        b = -outputs[rows:]
        b[rows:] += acceleration
        return c, b

    @property
    def together(self) -> bool:
        """Whether samples can be evaluated side by side: no joint has quasi-velocities."""
        return not self.manifold.quasi

    def at_samples(self, q: Array, samples: slice) -> tuple[Array, Array]:
        """Return F (T, m) and J (T, m, nv) at positions q (T, nq) of some of the motion's samples."""
        outputs = self._here.at_samples(q, np.zeros((len(q), self.model.nv)), self._times[samples])
        return self.lacking(outputs, q, self._at_times[0][samples])

    def lacking(self, outputs: Array, q: Array, wanted: Array) -> tuple[Array, Array]:
        """Return F (T, m) and J (T, m, nv) from the first of ``entries`` at positions q, and values asked (T, k)."""
        m, values = len(self.names), self._values
        rows = m - self.led
        if self.lead.led is not None:
            left = what_is_left(wanted, outputs[:, rows:values], self.lead.led.oriented)
        else:
            left = wanted - q[:, self._positions]
        return np.hstack([outputs[:, :rows], -left]), outputs[:, values:].reshape(len(q), m, self.model.nv)

    def rates_at_samples(self, q: Array, v: Array, samples: slice) -> tuple[Array, Array]:
        """Return c and b (T, m) at positions q (T, nq) and rates v (T, nv) of some of the motion's samples."""
        outputs = self._rates.at_samples(q, v, self._times[samples])
        return self.moving(outputs, *(x[samples] for x in self._at_times[1:]))

    def moving(self, outputs: Array, rate: Array, acceleration: Array) -> tuple[Array, Array]:
        """Return c and b (T, m) from the second of ``entries``, and rates and accelerations asked (T, k)."""
        rows = len(self.names) - self.led
        b = -outputs[:, rows:]
        b[:, rows:] += acceleration
        return np.hstack([-outputs[:, :rows], rate]), b

    def entries(self) -> tuple[list[Scalar], list[Scalar]]:
        """Return the expressions that decide: values and J row by row; of rates and accelerations, eta_t and bias."""
        return [*self._values_of, *self._J], self._bias

    def levels(self) -> tuple[list[Scalar], list[Scalar], list[Scalar], list[Scalar]]:
        """Return expressions of the loops' rows, which are zero, and of what is led.

        Values (none of led joints; of a pose its axes, in the place of three rows), rates J v + eta_t (m,),
        accelerations J v-dot + gamma (m,), and J (m nv,).
        """
        problem, values, J, others = self._problem, self._values_of, self._J, self._bias
        m, nv = len(self.names), self.model.nv
        eta_t, bias = [*others[: m - self.led], *[0.0] * self.led], others[m - self.led :]
        rows = [J[i * nv : (i + 1) * nv] for i in range(m)]
        rates = [dot(row, problem.v) + x for row, x in zip(rows, eta_t)]
        accelerations = [dot(row, problem.a) + x for row, x in zip(rows, bias)]
        return values, rates, accelerations, J

    def step(self, q: Array, dq: Array) -> Array:
        return self.manifold.normalise(self.manifold.integrate(q, dq))


class _Entries:
    """Expressions as a function of q, v and t, of one sample or of several; compiled where that pays over so many
    calls."""

    def __init__(self, model: Model, entries: Sequence[Scalar], calls: int) -> None:
        self._varying = [k for k, e in enumerate(entries) if isinstance(e, Expr)]
        self._constant = np.array([0.0 if isinstance(e, Expr) else float(e) for e in entries])
        operations = count_operations([entries[k] for k in self._varying])
        self._evaluator: Evaluator | None = None
        if not self._varying or operations * calls * INTERPRETED < compiling(operations):
            self._evaluator = Evaluator(entries)
            return
        from robodyn_cli.kernels.samples import SampleKernel, of_one_sample

        self._kernel = SampleKernel({"out": [entries[k] for k in self._varying]}, ("t", "q", "v"))
        self._of_one = of_one_sample(self._kernel, t=1, q=model.nq, v=model.nv)

    def __call__(self, q: Array, v: Array, t: float) -> Array:
        """Return the entries (n,) at one q (nq,), v (nv,) and t."""
        if self._evaluator is not None:
            inputs = {"q": q.tolist(), "v": v.tolist(), "t": [t], "p": []}
            return np.array(self._evaluator(inputs), dtype=float)
        out = self._constant.copy()
        out[self._varying] = self._of_one(t=t, q=q, v=v)["out"]
        return out

    def at_samples(self, q: Array, v: Array, t: Array) -> Array:
        """Return the entries (T, n) at q (T, nq), v (T, nv) and t (T,)."""
        out = np.tile(self._constant, (len(q), 1))
        if self._evaluator is not None:
            inputs = {"q": list(q.T), "v": list(v.T), "t": [t], "p": []}
            with np.errstate(all="ignore"):
                for k, x in enumerate(self._evaluator(inputs)):
                    out[:, k] = x
        else:
            out[:, self._varying] = self._kernel.evaluate(len(q), {"t": t, "q": q, "v": v})["out"]
        return out


def velocity_places(model: Model, names: Sequence[str]) -> list[int]:
    """Return the velocity coordinates of joints and of single columns (``slide``, ``slide.z``), each once."""
    places: list[int] = []
    for name in names:
        columns = (name,) if name in model.v_names else model.v_columns(name)
        places += [model.v_names.index(column) for column in columns]
    return list(dict.fromkeys(places))
