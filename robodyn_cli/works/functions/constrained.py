"""Forward dynamics of mechanisms with loops at independent states, and its exact derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.linear.reduce import accelerations, constrained
from robodyn_cli.equations.linear.residuals import LAMBDA, Residuals
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, GeometryError
from robodyn_cli.solve.closure import mechanism_size
from robodyn_cli.spatial.algebra import Array, identity, zeros
from robodyn_cli.torques.dynamics import timeless
from robodyn_cli.torques.function import Arguments, StateFunction
from robodyn_cli.works.functions.derivatives import AccelerationDerivatives

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
        found, _ = constrained(values["M"], values["Psi"], force, gap)
        parts = np.split(found, 3, axis=2)
        return AccelerationDerivatives(*(part[0] if one else part for part in parts))

    def _values(self, rows: dict[str, Array]) -> dict[str, Array]:
        """Return M, load, Psi and gamma at states at which the loops are closed."""
        values = self._parts.evaluate({name: rows[name] for name in ("q", "qd")})
        size = mechanism_size(self.problem.model)
        self._refuse_open("loops are open", values["eta"], max(1.0, size))
        fastest = float(np.abs(rows["qd"]).max(initial=0.0))
        self._refuse_open("rates open the loops", values["rate"], max(1.0, size) * fastest)
        return values

    def _refuse_open(self, what: str, gaps: Array, size: float) -> None:
        worst = np.unravel_index(int(np.argmax(np.abs(gaps))), gaps.shape) if gaps.size else (0, 0)
        if gaps.size and abs(gaps[worst]) > CLOSED * size:
            row = self.problem.constraints.names[worst[1]]
            raise GeometryError(
                f"the {what} at state {worst[0]}: row {row!r} is off by {abs(gaps[worst]):.3g} (SI units); "
                "allowed: states that satisfy the loops, as `assemble` finds them"
            )


def _refuse(problem: Problem) -> None:
    """Raise the error of a mechanism whose accelerations do not follow from its state and torques."""
    what = "forward dynamics of samples"
    if problem.scene.prescribed:
        name = next(iter(problem.scene.prescribed))
        raise CapabilityError(f"{what} takes no prescribed joints ({name!r}); use `simulate`")
    if problem.constraints.rheonomic:
        name = problem.constraints.names[problem.constraints.rheonomic[0]]
        raise CapabilityError(f"{what} takes no couplers that depend on time ({name!r}); use `simulate`")
    if geared(problem.model):
        raise CapabilityError("gear losses depend on the drive, so they have no forward dynamics of samples")
