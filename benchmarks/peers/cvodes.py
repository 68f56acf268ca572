"""CasADi with CVODES: the same formulas, the exact Jacobian from CasADi."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from cases import Entry, FourBar, Wanted

from peers.formulas import graph_rates, pendulum_rates

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14)


def setting(rtol: float) -> str:
    return f"rtol {rtol:.0e}"


def entries(case: Any) -> Iterator[Entry]:
    import casadi as ca

    if isinstance(case, FourBar):
        return  # its integrators have no events
    y = ca.SX.sym("y", 2 * case.n)
    x = [y[k] for k in range(2 * case.n)]
    rates = pendulum_rates(case, x, ca.sin, ca.cos) if case.n == 2 else graph_rates(case, x, ca.sin, ca.cos)
    ode = {"x": y, "ode": ca.vertcat(*rates)}
    for kind in ("bdf",) if case.stiff else ("adams", "bdf"):
        for rtol in Wanted.of(TOLERANCES, setting):
            options = {
                "linear_multistep_method": kind, "max_num_steps": 10**7, "reltol": rtol, "abstol": 1e-2 * rtol
            }  # fmt: skip
            integrator = ca.integrator("run", "cvodes", ode, 0.0, case.duration, options)

            def run(integrator: Any = integrator) -> tuple[np.ndarray, int]:
                end = np.array(integrator(x0=case.y0)["xf"]).ravel()
                return end, int(integrator.stats().get("nsteps", 0))

            def path(options: Any = options) -> tuple[np.ndarray, np.ndarray]:
                sampled = ca.integrator("run", "cvodes", ode, 0.0, list(case.times), options)
                return case.times, np.array(sampled(x0=case.y0)["xf"]).T

            yield Entry(f"CasADi CVODES {kind}", setting(rtol), run, path if case.whole else None)
