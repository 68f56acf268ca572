"""Exact derivatives of inverse and forward dynamics, with loops at independent states; the regressor of the inertial
parameters, and places of frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.composite import coriolis
from robodyn_cli.algorithms.kinematics import world_jacobian
from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.linear.reduce import accelerations, constrained
from robodyn_cli.equations.linear.residuals import LAMBDA, Residuals, by_steps, by_symbols
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, GeometryError, unknown_data
from robodyn_cli.expr.calculus import substitute
from robodyn_cli.expr.graph import is_nonzero, is_number
from robodyn_cli.model.model import Body, FixedFrame
from robodyn_cli.record import record
from robodyn_cli.solve.closure import mechanism_size
from robodyn_cli.spatial.algebra import Array, Matrix, Vector, identity, matrix, vector, zeros
from robodyn_cli.spatial.inertia import RigidInertia
from robodyn_cli.torques.build import open_problem
from robodyn_cli.torques.dynamics import Arguments, StateFunction, forward_problem, timeless


def frame_jacobian(problem: Problem, frame: FixedFrame) -> Matrix:
    """Return J (6, nv) of a frame in world axes: rows of the angular velocity, then of its origin's velocity.

    J v is the frame's twist (w, v) as ``frames/NAME/twist`` of a result has it.
    """
    linear, angular = world_jacobian(problem.model, problem.q, problem.pose, frame)
    return np.concatenate([angular, linear])


def centre_of_mass(problem: Problem) -> Vector:
    """Return the centre of mass of all moving bodies (3,), world coordinates: sum h / sum m."""
    mass, moment = 0.0, zeros(3)
    for k, body in enumerate(problem.model.bodies):
        pose, inertia = problem.pose[k], body.inertia
        mass = mass + inertia.m
        moment = moment + inertia.m * pose.p + pose.R @ inertia.h
    return problem.model.base.point(moment / mass)


OF_BODY = (
    ("mass", "kg"), ("mx", "kg m"), ("my", "kg m"), ("mz", "kg m"), ("Ixx", "kg m^2"), ("Iyy", "kg m^2"),
    ("Izz", "kg m^2"), ("Ixy", "kg m^2"), ("Ixz", "kg m^2"), ("Iyz", "kg m^2"),
)  # fmt: skip
GROUP = "inertial"


@record
class InertialParameters:
    """What the torques of rigid bodies depend on linearly, in the order of the regressor's columns.

    names : ``LINK.mass``, ``LINK.mx`` to ``LINK.mz``, the first moments, and ``LINK.Ixx`` to ``LINK.Iyz``, the inertia
    about the origin of the joint that carries the link, all in that joint's axes, turning with the link, and with what
    is fixed to it; ``COLUMN.rotor``, N^2 J of a joint's rotor. values : (P,), those of the scene. units : SI.
    """

    names: tuple[str, ...]
    values: Array
    units: tuple[str, ...]


@record
class Regressor:
    """Y (nv, P) as expressions, with M a + C v + G = Y p, and the parameters p (P,)."""

    Y: Matrix
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: tuple[Any, ...]

    @staticmethod
    def of(problem: Problem) -> Regressor:
        """Return the regressor: the torques of a tree with symbols for parameters, differentiated by them."""
        columns = [c for body in problem.model.bodies for c in _of_body(problem, body)]
        symbols = problem.graph.symbols([name for name, _, _ in columns], GROUP)
        rest = iter(symbols)
        bodies = tuple(_with_symbols(body, rest) for body in problem.model.bodies)
        tree = dataclasses.replace(problem.model, bodies=bodies)
        tau = rnea(tree, problem.q, problem.v, problem.a, problem.gravity, problem.X)
        Y = by_symbols(tau, symbols)
        return Regressor(Y, *zip(*columns))

    def parameters(self) -> InertialParameters:
        """Return the scene's parameters; what it does not give is 0 where no torque depends on it.

        Raises
        ------
        SceneError : it does not give what torques depend on.
        """
        used = [any(is_nonzero(x) for x in column) for column in self.Y.T]
        missing = [n for n, x, needed in zip(self.names, self.values, used) if needed and not is_number(x)]
        if missing:
            raise unknown_data(missing)
        values = np.array([float(x) if is_number(x) else 0.0 for x in self.values])
        return InertialParameters(self.names, values, self.units)


def _of_body(problem: Problem, body: Body) -> Iterator[tuple[str, str, Any]]:
    """Give name, unit and value of a body's parameters."""
    I = body.inertia
    values = (I.m, *I.h, *(I.I[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))))
    for (name, unit), value in zip(OF_BODY, values):
        yield f"{body.name}.{name}", unit, value
    for k, rotor in enumerate(body.rotors, start=body.v):
        if is_nonzero(rotor):
            unit = "kg m^2" if problem.model.v_units[k] == "rad" else "kg"
            yield f"{problem.model.v_names[k]}.rotor", unit, rotor


def _with_symbols(body: Body, symbols: Iterator[Any]) -> Body:
    """Return a body whose parameters are the next symbols."""
    m, hx, hy, hz, xx, yy, zz, xy, xz, yz = (next(symbols) for _ in OF_BODY)
    I = matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    armature: Sequence[Any] = [next(symbols) if is_nonzero(x) else 0.0 for x in body.rotors]
    return dataclasses.replace(
        body, inertia=RigidInertia(m, vector([hx, hy, hz]), I), parts=(), armature=tuple(armature)
    )


@record
class TorqueDerivatives:
    """Derivatives of tau(q, qd, qdd), each (T, nv, nv) or (nv, nv): row i of the torque, column k of the variable.

    dq : by steps along the joints' manifolds, which are q itself where q-dot = v. dqd, dqdd : by rates and
    accelerations; dqdd is M.
    """

    dq: Array
    dqd: Array
    dqdd: Array


@record
class AccelerationDerivatives:
    """Derivatives of qdd(q, qd, tau), each (T, nv, nv) or (nv, nv), as ``TorqueDerivatives``; dtau is M^-1."""

    dq: Array
    dqd: Array
    dtau: Array


@record
class Changes:
    """tau of inverse dynamics (nv,), with d tau / dq by steps and d tau / dv (nv, nv)."""

    tau: Vector
    by_q: Matrix
    by_v: Matrix

    @staticmethod
    def of(problem: Problem) -> Changes:
        """Return the derivatives with as few operations as may be: a quarter fewer than those of tau as it stands.

        The tree has base parameters. Where q-dot = v, d(C v) / dv = 2 C, for Christoffel's symbols are symmetric in
        the two indices that C v sums over.
        """
        tree, v = problem.lumped, problem.v
        rigid = rnea(tree, problem.q, v, problem.a, problem.gravity, problem.X)
        other = sum(timeless(problem), zeros(problem.model.nv))
        quasi = any(body.joint.quasi for body in tree.bodies)
        by_v = by_symbols(rigid, v) if quasi else 2.0 * coriolis(tree, problem.q, v, problem.X)
        tau = rigid - other
        return Changes(tau, by_steps(problem, tau), by_v - by_symbols(other, v))


def torque_derivatives(problem: Problem) -> dict[str, Matrix]:
    """Return d tau / dq, d tau / dv and d tau / da of inverse dynamics, by the names of ``TorqueDerivatives``."""
    changes = Changes.of(open_problem(problem, "inverse dynamics"))
    inertia = by_symbols(changes.tau, problem.a) if geared(problem.model) else problem.mass_matrix
    return {"dq": changes.by_q, "dqd": changes.by_v, "dqdd": inertia}


def acceleration_derivatives(problem: Problem) -> dict[str, Matrix]:
    """Return d a / dq, d a / dv and d a / d tau of forward dynamics, by the names of ``AccelerationDerivatives``.

    d a / dx = -M^-1 d ID / dx at a = FD(q, v, tau) for x = q, v, and d a / d tau = M^-1, with one factor of M
    (Carpentier and Mansard 2018, "Analytical derivatives of rigid body dynamics algorithms", section IV).
    """
    model = forward_problem(problem).model
    nv, tau = model.nv, vector(problem.graph.symbols(model.v_names, "tau"))
    changes = Changes.of(problem)
    factor = LdlFactor.of(problem.mass_matrix, problem.elimination_order)
    a = factor.solve(sum(timeless(problem), tau - problem.bias))
    here = substitute(
        [*changes.by_q.flat, *changes.by_v.flat], {symbol.index: x for symbol, x in zip(problem.a, a)}
    )
    of_q, of_v = np.array([-x for x in here], dtype=object).reshape(2, nv, nv)
    solved = [solve_columns(factor, right) for right in (of_q, of_v, identity(nv))]
    return dict(zip(("dq", "dqd", "dtau"), solved))


def solve_columns(factor: LdlFactor, right: Matrix) -> Matrix:
    """Return A^-1 B (n, k)."""
    return np.stack([factor.solve(column) for column in right.T], axis=1)


CLOSED = (
    1e-4  # of the size of the mechanism (of rates: of the largest): loops that are open farther are refused
)


class ConstrainedDynamics:
    """Accelerations that torques cause where loops and couplers hold, and the multipliers of these.

        M qdd + C qd + G = tau + tau_passive + tau_friction + tau_external + Psi^T lambda,   Psi qdd + gamma = 0

    Calling it takes q (T, nq), qd and tau (T, nv), or one state, and returns qdd (T, nv). q and qd must satisfy the
    loops. Rows may depend on each other: qdd is the same for all lambda. Friction has the exact sign of the rate.

    Raises
    ------
    CapabilityError : prescribed joints, couplers that depend on time, gears with losses, forces that depend on time.
    GeometryError : a state at which the loops are open.
    """

    def __init__(self, problem: Problem) -> None:
        _refuse(problem)
        self.problem = problem
        self.arguments = Arguments.of(problem, ("q", "qd", "tau"))
        forces = sum(timeless(problem), zeros(problem.model.nv))
        self._residuals = Residuals(problem, forces, ())
        gaps = {
            "eta": np.array(problem.constraints.eta, dtype=object),
            "rate": np.array(problem.constraints.velocity_residual(problem.v), dtype=object),
        }
        self._parts = StateFunction(problem, ("q", "qd"), {**self._residuals.parts, **gaps})
        self._slopes: StateFunction | None = None

    def __call__(self, q: Any, qd: Any, tau: Any) -> Array:
        """Return qdd (T, nv), or (nv,) of one state."""
        rows, one = self.arguments.rows((q, qd, tau))
        qdd, _ = accelerations(self._values(rows), rows["tau"])
        return qdd[0] if one else qdd

    def derivatives(self, q: Any, qd: Any, tau: Any) -> AccelerationDerivatives:
        """Return the derivatives of qdd at states, by steps dq, by rates dqd and by torques.

        d(M qdd + ...) = dtau + Psi^T d lambda, Psi d qdd = -d(Psi qdd + gamma), with the same M and Psi for all. Exact
        for changes that keep the loops closed: Psi dq = 0 and Psi dqd + d(Psi qd)/dq dq = 0.
        """
        rows, one = self.arguments.rows((q, qd, tau))
        values = self._values(rows)
        qdd, lam = accelerations(values, rows["tau"])
        if self._slopes is None:
            self._slopes = StateFunction(self.problem, ("q", "qd", "qdd", LAMBDA), self._residuals.slopes)
        slopes = self._slopes.evaluate({"q": rows["q"], "qd": rows["qd"], "qdd": qdd, LAMBDA: lam})
        samples, nv = qdd.shape
        unit = np.broadcast_to(identity(nv).astype(float), (samples, nv, nv))
        force = np.concatenate([-slopes["r_q"], -slopes["r_v"], unit], axis=2)
        gap = np.concatenate([-slopes["g_q"], -slopes["g_v"], np.zeros((samples, lam.shape[1], nv))], axis=2)
        solved, _ = constrained(values["M"], values["Psi"], force, gap)
        parts = np.split(solved, 3, axis=2)
        return AccelerationDerivatives(*(part[0] if one else part for part in parts))

    def _values(self, rows: dict[str, Array]) -> dict[str, Array]:
        """Return M, load, Psi and gamma at states at which the loops are closed."""
        values = self._parts.evaluate({name: rows[name] for name in ("q", "qd")})
        size = mechanism_size(self.problem.model)
        self._refuse_open("loops are open", values["eta"], max(1.0, size))
        fastest = float(np.abs(rows["qd"]).max(initial=0.0))
        self._refuse_open("rates open the loops", values["rate"], max(1.0, size) * fastest)
        return values

    def _refuse_open(self, quantity: str, gaps: Array, size: float) -> None:
        worst = np.unravel_index(int(np.argmax(np.abs(gaps))), gaps.shape) if gaps.size else (0, 0)
        if gaps.size and abs(gaps[worst]) > CLOSED * size:
            row = self.problem.constraints.names[worst[1]]
            raise GeometryError(
                f"the {quantity} at state {worst[0]}: row {row!r} is off by {abs(gaps[worst]):.3g} (SI units); "
                "allowed: states that satisfy the loops, as `assemble` finds them"
            )


def _refuse(problem: Problem) -> None:
    """Raise the error of a mechanism whose accelerations do not follow from its state and torques."""
    task = "forward dynamics of samples"
    if problem.scene.prescribed:
        name = next(iter(problem.scene.prescribed))
        raise CapabilityError(f"{task} takes no prescribed joints ({name!r}); use `simulate`")
    if problem.constraints.rheonomic:
        name = problem.constraints.names[problem.constraints.rheonomic[0]]
        raise CapabilityError(f"{task} takes no couplers that depend on time ({name!r}); use `simulate`")
    if geared(problem.model):
        raise CapabilityError("gear losses depend on the drive, so they have no forward dynamics of samples")
