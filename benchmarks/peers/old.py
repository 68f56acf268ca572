"""The double pendulum with other people's integrators: settings and calls, for ``double_pendulum.py``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import arms
import numpy as np

Run = Callable[[], Any]


def scipy_runs(f: Any, start: np.ndarray, name: str, tolerances: Any) -> Iterator[tuple[str, str, Run]]:
    from scipy.integrate import solve_ivp

    for method in ("DOP853", "LSODA"):
        for rtol in tolerances:

            def run(method: str = method, rtol: float = rtol) -> tuple[np.ndarray, int]:
                found = solve_ivp(f, (0.0, 10.0), start, method=method, rtol=rtol, atol=1e-2 * rtol)
                return found.y[:, -1], len(found.t) - 1

            yield f"{name} {method}", f"rtol {rtol:.0e}", run


def pinocchio_runs(start: np.ndarray, tolerances: Any) -> Iterator[tuple[str, str, Run]]:
    import pinocchio as pin

    model = arms.pinocchio_model(arms.planar_2r())
    data, still = model.createData(), np.zeros(2)

    def f(t: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[2:], pin.aba(model, data, y[:2], y[2:], still)])

    yield from (x for x in scipy_runs(f, start, "Pinocchio, scipy", tolerances) if x[0].endswith("DOP853"))


def mujoco_runs(start: np.ndarray) -> Iterator[tuple[str, str, Run]]:
    import mujoco
    from mujoco import rollout

    bodies = ""
    arm = arms.planar_2r()
    for k in range(2):
        place, c, I = f"{arm.a[k]} 0 0", arm.com[k], np.diag(arm.inertia[k])
        bodies += (
            f'<body pos="{place}"><inertial pos="{c[0]} 0 0" mass="{arm.mass[k]}" '
            f'diaginertia="{I[0]} {I[1]} {I[2]}"/><joint type="hinge" axis="0 0 1"/>'
        )
    world = f"<worldbody>{bodies}</body></body></worldbody>"
    text = f'<mujoco><option gravity="0 -9.81 0" integrator="RK4"/>{world}</mujoco>'
    for step in (1e-2, 1e-3, 1e-4):
        model = mujoco.MjModel.from_xml_string(text)
        model.opt.timestep = step
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = start[:2], start[2:]
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        first = np.zeros(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, first, kind)

        def run(model: Any = model, data: Any = data, first: Any = first, step: float = step) -> Any:
            states, _ = rollout.rollout(model, [data], first[None], nstep=round(10.0 / step))
            return states[0, -1, 1:5], round(10.0 / step)

        yield "MuJoCo RK4", f"step {step:g}", run


def heyoka_runs(start: np.ndarray, tolerances: Any) -> Iterator[tuple[str, str, Run]]:
    import heyoka as hy

    arm = arms.planar_2r()
    m, I, (c1, c2), g = arm.mass[0], arm.inertia[0][2, 2], arm.com[:, 0], 9.81
    a, b, w, u = hy.make_vars("a", "b", "w", "u")
    k, d, e = m * c2, I + m * c2**2, 2 * I + m * (c1**2 + c2**2 + 1.0)
    cosine, sine = hy.cos(b), hy.sin(b)
    M11, M12 = e + 2 * k * cosine, d + k * cosine
    g2 = k * g * hy.cos(a + b)
    f1 = k * sine * (2 * w * u + u**2) - (m * c1 + m) * g * hy.cos(a) - g2
    f2 = -(k * sine * w**2) - g2
    det = M11 * d - M12**2
    rates = [(a, w), (b, u), (w, (d * f1 - M12 * f2) / det), (u, (M11 * f2 - M12 * f1) / det)]
    for tolerance in tolerances:
        series = hy.taylor_adaptive(rates, start, tol=tolerance)

        def run(series: Any = series) -> tuple[np.ndarray, int]:
            series.time = 0.0
            series.state[:] = start
            steps = series.propagate_until(10.0)[3]
            return series.state.copy(), steps

        yield "heyoka Taylor", f"tol {tolerance:.0e}", run
