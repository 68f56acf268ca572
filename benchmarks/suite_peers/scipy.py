"""A case in scipy's ``solve_ivp`` with Pinocchio's accelerations.

Loops are closed by ``constraintDynamics``, on accelerations alone. Dry friction goes by the sign of the rate. At a
rigid stop a terminal event ends the run, the rate is reversed and the next run begins; slower than ``RESTING`` the
joint stays on its stop for as long as that pushes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from suite_peers.case import Clock, Mechanism, Run
from tests.engines import real, to_pinocchio

METHODS = (("RK45", 1e-3), ("LSODA", 1e-8), ("Radau", 1e-8))
RESTING = 1e-6  # rad/s: rebounds slower than this are none
CLEARANCE = 1e-9  # rad: a joint that leaves its stop meets it again only so far beyond it, not by rounding
Rates = Callable[[float, np.ndarray], np.ndarray]


class Accelerations:
    """Accelerations of a case: free, with closed loops, or with a joint held."""

    def __init__(self, case: Mechanism) -> None:
        import pinocchio as pin

        self.pin, self.case = pin, case
        self.built = built = to_pinocchio(case.model)
        self.held: int | None = None
        if not case.model.loops:
            return
        self.models, self.datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for loop in case.model.loops:
            ends: list[Any] = []
            for frame in (loop.first, loop.second):
                joint = 0 if frame.body < 0 else built.body[frame.body]
                ends += [joint, pin.SE3(np.eye(3), real(frame.p))]
            pair = pin.RigidConstraintModel(
                pin.ContactType.CONTACT_3D, built.model, *ends, pin.ReferenceFrame.LOCAL
            )
            self.models.append(pair)
            self.datas.append(pair.createData())
        pin.initConstraintDynamics(built.model, built.data, self.models, self.datas)
        # three rows in a plane, of which one is redundant: solved by proximal iterations. A larger regularisation than
        # this one gives way near a fold, where the smallest eigenvalue of J M^-1 J^T is as small
        self.settings = pin.ProximalSettings(1e-12, 1e-14, 100)

    def __call__(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        b, pin = self.built, self.pin
        state = b.to(q), b.to(v), b.to(self.case.torques(t, q, v))
        if self.case.model.loops:
            a = pin.constraintDynamics(b.model, b.data, *state, self.models, self.datas, self.settings)
            return b.ours(a)
        a = b.ours(pin.aba(b.model, b.data, *state))
        if self.held is None:
            return a
        column = self.column(q, self.held)
        return a - column * (a[self.held] / column[self.held])

    def column(self, q: np.ndarray, j: int) -> np.ndarray:
        """Return a column of the inverse mass matrix: what a unit impulse on joint j does to the rates."""
        b = self.built
        inverse = self.pin.computeMinverse(b.model, b.data, b.to(q))
        return b.ours_square(np.triu(inverse) + np.triu(inverse, 1).T)[:, j]


def runs(case: Mechanism) -> Iterator[tuple[str, Run]]:
    """Yield an explicit method at its default tolerance, and two for stiff problems at 1e-8."""
    accelerations = Accelerations(case)
    n = case.model.nv
    for method, rtol in METHODS:
        atol = 1e-6 if rtol == 1e-3 else 1e-2 * rtol

        def run(
            times: np.ndarray, method: str = method, rtol: float = rtol, atol: float = atol
        ) -> np.ndarray:
            clock = Clock()

            def rates(t: float, y: np.ndarray) -> np.ndarray:
                clock.check()
                return np.concatenate([y[n:], accelerations(t, y[:n], y[n:])])

            options = {"method": method, "rtol": rtol, "atol": atol}
            start = np.concatenate([case.q, case.v])
            if case.rigid:
                return _between_stops(accelerations, rates, start, times, options)
            return _solve(rates, start, times, options).y.T

        yield f"scipy {method} {rtol:.0e}", run


def _solve(rates: Rates, start: np.ndarray, times: np.ndarray, options: dict[str, Any], **more: Any) -> Any:
    from scipy.integrate import solve_ivp

    found = solve_ivp(rates, (times[0], times[-1]), start, t_eval=times, **options, **more)
    if not found.success:
        raise ArithmeticError(found.message)
    return found


def _between_stops(
    accelerations: Accelerations, rates: Rates, start: np.ndarray, times: np.ndarray, options: dict[str, Any]
) -> np.ndarray:
    """Return the states (T, 2n) of a run with one joint between rigid stops, restarted at each impact."""
    case = accelerations.case
    n = case.model.nv
    j = next(k for k, stop in enumerate(case.stops) if stop is not None)
    lower, upper, restitution = case.stops[j]  # type: ignore[misc]

    def reaches(bound: float, side: float) -> Any:
        met = bound + (CLEARANCE if side == left else 0.0) * side

        def event(t: float, y: np.ndarray) -> float:
            return float(y[j] - met)

        event.terminal, event.direction = True, side  # type: ignore[attr-defined]
        return event

    def pushes(side: float) -> Any:
        def event(t: float, y: np.ndarray) -> float:
            held, accelerations.held = accelerations.held, None
            free = accelerations(t, y[:n], y[n:])[j]
            accelerations.held = held
            return float(side * free)

        event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
        return event

    rows, now, y = [start], times[0], np.array(start)
    side, left = 0.0, 0.0  # of the stop on which the joint rests; of the one that it has just left
    while True:
        ahead = times[times > now]
        accelerations.held = j if side else None
        events = [pushes(side)] if side else [reaches(lower, -1.0), reaches(upper, 1.0)]
        found = _solve(rates, y, np.concatenate([[now], ahead]), options, events=events)
        rows += list(found.y.T[1:])
        if found.status == 0:
            accelerations.held = None
            return np.array(rows)
        which = next(k for k, t in enumerate(found.t_events) if len(t))
        now, y = float(found.t_events[which][0]), found.y_events[which][0].copy()
        left = side
        if side:
            side = 0.0
            continue
        column = accelerations.column(y[:n], j)
        y[j] = (lower, upper)[which]
        rebound = restitution if abs(y[n + j]) * restitution > RESTING else 0.0
        y[n:] -= column * ((1.0 + rebound) * y[n + j] / column[j])
        if rebound == 0.0:
            side, y[n + j] = (-1.0, 1.0)[which], 0.0
