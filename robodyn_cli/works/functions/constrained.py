"""Forward dynamics of mechanisms with loops, and its derivatives, at states that close the loops."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.equations.contact_joints import without_contacts
from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.linear.reduce import accelerations
from robodyn_cli.equations.linear.residuals import LAMBDA, Residuals
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, GeometryError, NumericalError, SingularConfigurationError
from robodyn_cli.formulations.independent import RowCombinations
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import PARAMETER_GROUP
from robodyn_cli.ready.prepare import solvable
from robodyn_cli.ready.singularity import rank_tolerances
from robodyn_cli.solve.closing.assembly import Assembled
from robodyn_cli.solve.closing.nearest import ClosedPose
from robodyn_cli.solve.closure import ROUNDED, Numbers, mechanism_size
from robodyn_cli.solve.independent_rows import independent_rows
from robodyn_cli.solve.load_sharing import constrained
from robodyn_cli.spatial.algebra import Array, identity, vector, zeros
from robodyn_cli.torques.dynamics import OUT, Arguments, StateFunction, timeless
from robodyn_cli.works.functions.derivatives import AccelerationDerivatives

CLOSED = (
    1e-4  # of the size of the mechanism (of rates: of the largest): loops that are open farther are refused
)
MANY = 256  # states, from which on equations are built for compiled elimination
HOLDS = 1e-9  # of the accelerations: rows that are off by more after elimination have lost rank
CHOICES = 16  # states at which combinations of redundant rows are chosen, at most


class Elimination:
    """Accelerations by equation (36) in compiled code, each state with a check of the rows.

    Parameters
    ----------
    problem : the mechanism. q : a closed pose (nq,), at which redundant rows are told from independent ones.
    rounded : whether what the loops lack there is rounding in the data, by which redundant rows contradict each other.

    Raises
    ------
    SingularConfigurationError : the loops lose rank there. NumericalError : the closed mechanism has no inertia there.
    """

    def __init__(self, problem: Problem, q: Array, rounded: bool = False) -> None:
        nv, names = problem.model.nv, problem.constraints.names
        pose = ClosedPose(q, ROUNDED) if rounded else ClosedPose(q)
        kept, redundant = independent_rows(Numbers(problem, problem.at_start), q, pose.rank_tolerance)
        assembled = Assembled(q, np.zeros(nv), 0.0, 0.0, kept, tuple(names[i] for i in redundant), pose)
        # the friction of a state has the sign of its rate, and nothing holds a joint
        moving = without_contacts(problem.model, {joint.v for joint in problem.contact_joints})
        own = Problem(problem.scene, model=moving)
        self.problem = own = solvable(own, assembled, moving)
        tau = vector(own.graph.symbols(own.model.v_names, "tau"))
        solved, _ = own.solution(own.independent_rows.gamma, sum(timeless(problem), tau))
        every = own.all_constraints
        gap = every.psi(nv) @ solved.qdd + np.array(every.gamma, dtype=object)
        outputs = {OUT: list(solved.qdd), "gap": list(gap), "gamma": every.gamma}
        self.kernel = SampleKernel(outputs, ("q", "v", "tau", PARAMETER_GROUP))
        self.choice = RowCombinations(own) if own.dependent else None
        self.size = max(1.0, mechanism_size(own.model))
        self.holds = ROUNDED if rounded else HOLDS

    def __call__(self, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
        """Return qdd (T, nv) of states, and whether it holds (T,): whether the rows have their rank there."""
        qdd, holds = np.zeros(v.shape), np.zeros(len(q), dtype=bool)
        tried = holds.copy()
        for _ in range(1 if self.choice is None else CHOICES):
            left = np.flatnonzero(~(holds | tried))
            if not len(left):
                break
            tried[left[0]] = True
            rows = {
                "q": q[left],
                "v": v[left],
                "tau": tau[left],
                PARAMETER_GROUP: self._parameters(q[left[0]]),
            }
            known = {name: array for name, array in rows.items() if name in self.kernel.program.inputs}
            values = self.kernel.evaluate(len(left), known)
            size = self.size * _largest(values[OUT]) + _largest(values["gamma"])
            good = _largest(values["gap"]) <= self.holds * size  # False for what is not a number
            qdd[left[good]], holds[left[good]] = values[OUT][good], True
        return qdd, holds

    def _parameters(self, q: Array) -> Array:
        """Return the parameters p of the equations, with combinations of redundant rows chosen at q (nq,)."""
        chosen = np.zeros(0) if self.choice is None else self.choice.choose(0.0, q, None)
        return np.concatenate([np.zeros(self.problem.parameter_count), chosen])


def _largest(x: Array) -> Array:
    """Return the largest magnitude in each row of an array (T, n)."""
    values: Array = np.abs(x).max(axis=1, initial=0.0)
    return values


class ConstrainedDynamics:
    """Accelerations that torques cause where loops and couplers hold, and the multipliers of these.

        M qdd + C qd + G = tau + tau_passive + tau_friction + tau_external + Psi^T lambda,   Psi qdd + gamma = 0

    Calling it takes q (T, nq), qd and tau (T, nv), or one state, and returns qdd (T, nv). q and qd must satisfy the
    loops. Rows may depend on each other: qdd is the same for all lambda. Friction has the exact sign of the rate.

    Few states, and those at which loops lose rank, are solved by singular values, many others by elimination in
    compiled code.

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
        self._gaps = StateFunction(problem, ("q", "qd"), gaps, eager=True)
        self._parts = StateFunction(problem, ("q", "qd"), self._residuals.parts, eager=True)
        self._slopes: StateFunction | None = None
        self._elimination: Elimination | None = None

    def __call__(self, q: Any, qd: Any, tau: Any) -> Array:
        """Return qdd (T, nv), or (nv,) of one state."""
        rows, one = self.arguments.rows((q, qd, tau))
        tolerance = self._refuse_open(rows)
        qdd, left = self._eliminated(rows, bool(len(tolerance)) and tolerance[0] == ROUNDED)
        if len(left):
            some = {name: array[left] for name, array in rows.items()}
            qdd[left] = accelerations(self._values(some), some["tau"], tolerance[left])[0]
        return qdd[0] if one else qdd

    def _eliminated(self, rows: dict[str, Array], rounded: bool) -> tuple[Array, Array]:
        """Return qdd (T, nv) as far as compiled elimination gives it, and the states that are left."""
        q, v, tau = rows.values()
        if len(q) < MANY:
            return np.zeros(v.shape), np.arange(len(q))
        if self._elimination is None:
            try:
                self._elimination = Elimination(self.problem, q[0], rounded)
            except (
                NumericalError,
                SingularConfigurationError,
            ):  # at this state; another may come first in the next call
                return np.zeros(v.shape), np.arange(len(q))
        qdd, holds = self._elimination(q, v, tau)
        return qdd, np.flatnonzero(~holds)

    def derivatives(self, q: Any, qd: Any, tau: Any) -> AccelerationDerivatives:
        """Return the derivatives of qdd at states, by steps dq, by rates dqd and by torques.

        d(M qdd + ...) = dtau + Psi^T d lambda, Psi d qdd = -d(Psi qdd + gamma), with the same M and Psi for all. Exact
        for changes that keep the loops closed: Psi dq = 0 and Psi dqd + d(Psi qd)/dq dq = 0.
        """
        rows, one = self.arguments.rows((q, qd, tau))
        tolerance = self._refuse_open(rows)
        values = self._values(rows)
        qdd, lam = accelerations(values, rows["tau"], tolerance)
        if self._slopes is None:
            names = ("q", "qd", "qdd", LAMBDA)
            self._slopes = StateFunction(self.problem, names, self._residuals.slopes, eager=True)
        slopes = self._slopes.evaluate({"q": rows["q"], "qd": rows["qd"], "qdd": qdd, LAMBDA: lam})
        samples, nv = qdd.shape
        unit = np.broadcast_to(identity(nv).astype(float), (samples, nv, nv))
        force = np.concatenate([-slopes["r_q"], -slopes["r_v"], unit], axis=2)
        gap = np.concatenate([-slopes["g_q"], -slopes["g_v"], np.zeros((samples, lam.shape[1], nv))], axis=2)
        solved, _ = constrained(values["M"], values["Psi"], force, gap, tolerance)
        parts = np.split(solved, 3, axis=2)
        return AccelerationDerivatives(*(part[0] if one else part for part in parts))

    def _values(self, rows: dict[str, Array]) -> dict[str, Array]:
        """Return M, load, Psi and gamma at states."""
        return self._parts.evaluate({name: rows[name] for name in ("q", "qd")})

    def _refuse_open(self, rows: dict[str, Array]) -> Array:
        """Return the ratio of singular values (T,) below which rows depend on each other."""
        gaps = self._gaps.evaluate({name: rows[name] for name in ("q", "qd")})
        size = max(1.0, mechanism_size(self.problem.model))
        fastest = float(np.abs(rows["qd"]).max(initial=0.0))
        for name, scale, quantity in (
            ("eta", size, "loops are open"),
            ("rate", size * fastest, "rates open the loops"),
        ):
            gap = np.abs(gaps[name])
            if gap.size and gap.max() > CLOSED * scale:
                state, row = np.unravel_index(int(np.argmax(gap)), gap.shape)
                raise GeometryError(
                    f"the {quantity} at state {state}: row {self.problem.constraints.names[row]!r} is off by "
                    f"{gap[state, row]:.3g} (SI units); allowed: states that satisfy the loops, as `assemble` "
                    "finds them"
                )
        return rank_tolerances(self.problem, np.abs(gaps["eta"]).max(axis=1, initial=0.0))


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
