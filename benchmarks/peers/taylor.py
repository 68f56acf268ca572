"""heyoka: Taylor series, compiled; formulas derived by hand, those of the arm from robodyn's graph."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from cases import Entry, FourBar, Wanted

from peers.formulas import four_bar_rates, graph_rates, pendulum_rates

STIFF_TOLERANCES = (1e-6, 2.2e-16)
TOLERANCES = (*(10.0**-k for k in range(3, 16)), 2.2e-16)


def setting(tolerance: float) -> str:
    return f"tol {tolerance:.0e}"


def entries(case: Any) -> Iterator[Entry]:
    import heyoka as hy

    if case.key == "light":
        return  # some 1e10 steps: its rates are 1e10 1/s
    if isinstance(case, FourBar):
        yield from _to_lock(hy, case)
        return
    n = case.n
    x = hy.make_vars(*[f"x{k:02d}" for k in range(2 * n)])
    rates = pendulum_rates(case, x, hy.sin, hy.cos) if n == 2 else graph_rates(case, x, hy.sin, hy.cos)
    # compact mode: without it the arm would compile for minutes
    options = {"compact_mode": n > 2}
    asked = STIFF_TOLERANCES if case.stiff else TOLERANCES
    for tolerance in Wanted.of(asked, setting):
        series = hy.taylor_adaptive(list(zip(x, rates)), case.y0, tol=tolerance, **options)

        def run(series: Any = series) -> tuple[np.ndarray, int]:
            series.time = 0.0
            series.state[:] = case.y0
            steps = series.propagate_until(case.duration)[3]
            return series.state.copy(), steps

        def path(series: Any = series) -> tuple[np.ndarray, np.ndarray]:
            series.time = 0.0
            series.state[:] = case.y0
            times = np.concatenate([[0.0], case.times])
            return times, series.propagate_grid(times)[-1]

        yield Entry("heyoka Taylor", setting(tolerance), run, path if case.whole else None)


def _to_lock(hy: Any, case: FourBar) -> Iterator[Entry]:
    x = hy.make_vars("a", "b", "c", "u", "v", "w")
    rates = four_bar_rates(case, x, hy.sin, hy.cos)
    start = np.concatenate([case.angles, np.zeros(3)])
    for tolerance in TOLERANCES:
        event = hy.t_event(hy.sin(x[1] - x[2]), direction=hy.event_direction.any)
        series = hy.taylor_adaptive(list(zip(x, rates)), start, t_events=[event], tol=tolerance)

        def run(series: Any = series) -> tuple[float, int]:
            series.time = 0.0
            series.state[:] = start
            series.reset_cooldowns()
            steps = series.propagate_until(20.0)[3]
            return series.time, steps

        yield Entry("heyoka Taylor", setting(tolerance), run)
