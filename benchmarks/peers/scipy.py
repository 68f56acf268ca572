"""scipy's ``solve_ivp``: with robodyn's compiled right-hand side, and with Pinocchio's algorithms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import arms
import numpy as np
from cases import Entry, FourBar

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)


def entries(case: Any) -> Iterator[Entry]:
    """Yield runs on robodyn's accelerations; the four-bar's loop is closed by nothing but their accuracy."""
    import native

    from peers.robodyn import chain_system, four_bar_system

    system, start = four_bar_system() if isinstance(case, FourBar) else chain_system(case)
    event = None
    if isinstance(case, FourBar):
        event = native.switching(system)
        event.terminal = True  # type: ignore[attr-defined]
    kinds = ("LSODA", "Radau") if case.stiff else ("DOP853", "LSODA")
    yield from solve(native.rates(system), start, case, "scipy", kinds, event)


def pinocchio_entries(case: Any) -> Iterator[Entry]:
    """Yield runs on ``pinocchio.aba``, or ``constraintDynamics`` for the four-bar."""
    if isinstance(case, FourBar):
        yield from _pinocchio_to_lock(case)
        return
    import pinocchio as pin

    model = arms.pinocchio_model(case.arm)
    data, n = model.createData(), case.n

    def f(t: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[n:], pin.aba(model, data, y[:n], y[n:], -case.k * y[:n] - case.c * y[n:])])

    kinds = ("LSODA",) if case.stiff else ("DOP853",)
    yield from solve(f, case.y0, case, "Pinocchio, scipy", kinds)


def solve(
    f: Any, start: np.ndarray, case: Any, name: str, kinds: Sequence[str], event: Any = None
) -> Iterator[Entry]:
    from scipy.integrate import solve_ivp

    end = 20.0 if event else case.duration
    for kind in kinds:
        for rtol in TOLERANCES:
            options = {"method": kind, "rtol": rtol, "atol": 1e-2 * rtol, "events": event}

            def run(options: Any = options) -> tuple[Any, int]:
                found = solve_ivp(f, (0.0, end), start, **options)
                return (found.t[-1] if event else found.y[:, -1]), len(found.t) - 1

            def path(options: Any = options) -> tuple[np.ndarray, np.ndarray]:
                found = solve_ivp(f, (0.0, end), start, t_eval=case.times, **options)
                return found.t, found.y.T

            yield Entry(f"{name} {kind}", f"rtol {rtol:.0e}", run, path if case.whole else None)


def _pinocchio_to_lock(case: FourBar) -> Iterator[Entry]:
    import pinocchio as pin

    l0, l1, l2, l3 = case.lengths
    model = pin.Model()
    model.gravity.linear = np.zeros(3)

    def body(parent: int, x: float, k: int) -> int:
        joint: int = model.addJoint(
            parent, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([x, 0, 0])), f"j{k}"
        )
        inertia = pin.Inertia(case.mass[k], np.array([case.com[k], 0, 0]), case.inertia[k] * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        return joint

    crank = body(0, 0.0, 0)
    coupler, follower = body(crank, l1, 1), body(0, l0, 2)
    ends = (pin.SE3(np.eye(3), np.array([x, 0, 0])) for x in (l2, l3))
    pin_joint = pin.RigidConstraintModel(
        pin.ContactType.CONTACT_3D, model, coupler, next(ends), follower, next(ends), pin.ReferenceFrame.LOCAL
    )
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    models.append(pin_joint)
    datas.append(pin_joint.createData())
    data = model.createData()
    pin.initConstraintDynamics(model, data, models, datas)
    settings = pin.ProximalSettings(1e-14, 1e-10, 10)  # three rows in a plane: one is redundant
    torque = np.zeros(3)

    def f(t: float, y: np.ndarray) -> np.ndarray:
        torque[0] = case.torque[0] - case.torque[1] * y[0]
        rates = pin.constraintDynamics(model, data, y[:3], y[3:], torque, models, datas, settings)
        return np.concatenate([y[3:], rates])

    def aligned(t: float, y: np.ndarray) -> float:
        return float(np.sin(y[0] + y[1] - y[2]))

    aligned.terminal = True  # type: ignore[attr-defined]
    a, b, c = case.angles
    yield from solve(f, np.array([a, b - a, c, 0, 0, 0]), case, "Pinocchio, scipy", ("DOP853",), aligned)
