"""True error beside run time: the lecture's double pendulum over 10 s, and its four-bar until it locks.

    python benchmarks/double_pendulum.py [--quick] [--json FILE]

Each row is one method at one tolerance. Pendulum: the error is the largest of angles and rates at the end, against
a solution in extended precision. Four-bar: the error of the time of the lock, against a quadrature of the energy
integral (``lock_time``). Times are of a run by robodyn's integrators as other code calls them, compiling apart.
Beside them: scipy's ``solve_ivp`` with the same compiled right-hand side, and Pinocchio (with scipy), MuJoCo and
heyoka where they are installed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from typing import Any

import measure

measure.single_thread()

import arms  # noqa: E402
import native  # noqa: E402
import numpy as np  # noqa: E402

from robodyn_cli import load_scene  # noqa: E402
from robodyn_cli.formulations.index1 import index1  # noqa: E402
from robodyn_cli.formulations.system import EventFunction, System  # noqa: E402
from robodyn_cli.integrators.integrator import Event, Grid, Integrator, Options  # noqa: E402
from robodyn_cli.run.simulate import passive_coordinates, prepare  # noqa: E402
from robodyn_cli.run.singularity import passive_determinant  # noqa: E402

CONFIGS = measure.ROOT / "configs"
PENDULUM, FOUR_BAR = "double pendulum, 10 s", "four-bar to lock"
# angles and rates after 10 s (Taylor series in quadruple precision)
END = np.array([-1.62889639534036989, 0.477493006480734381, -1.42990244445507279, 2.56888649044476188])
# time of the lock (lock_time() below gives it to 25 digits)
LOCK = 12.28299560962995475530
TARGETS = (1e-3, 1e-7, 1e-10, 1e-12)

TOLERANCES = {
    "gauss": (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13),
    "dop853": (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-14),
    "dopri5": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11),
    "rodas5p": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11),
}
STEPS = (1e-2, 3e-3, 1e-3, 3e-4)  # of rk4

Run = Callable[[], Any]


def options_of(method: str, quick: bool) -> Iterator[tuple[str, Options]]:
    """Yield the settings that a method is run with, and their names."""
    every = 4 if quick else 1
    if method == "rk4":
        for step in STEPS[::every]:
            yield f"step {step:g}", Options(step=step)
    else:
        for rtol in TOLERANCES.get(method, TOLERANCES["dop853"])[::every]:
            yield f"rtol {rtol:.0e}", Options(rtol, 1e-2 * rtol)


# -- the double pendulum -------------------------------------------------------------------------------------


def pendulum() -> tuple[System, np.ndarray]:
    """Return the system and its state at t = 0."""
    setup = prepare(load_scene(CONFIGS / "double_pendulum.yaml"))
    return index1(setup.problem, work=False), np.concatenate([setup.assembled.q, setup.assembled.v])


def pendulum_run(integrator: Integrator, start: np.ndarray, options: Options) -> Run:
    def run() -> tuple[np.ndarray, int]:
        integrator.reset(0.0, start, options)
        integrator.advance(10.0)
        return integrator.state, integrator.counters.steps

    return run


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
    text = f'<mujoco><option gravity="0 -9.81 0" integrator="RK4"/><worldbody>{bodies}</body></body></worldbody></mujoco>'
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


def pendulum_runs(quick: bool) -> Iterator[tuple[str, str, Run]]:
    """Yield all runs of the double pendulum: engine, setting, call."""
    system, start = pendulum()
    for method in methods():
        integrator = Integrator(system, method)
        for setting, options in options_of(method, quick):
            yield f"robodyn {method}", setting, pendulum_run(integrator, start, options)
    tolerances = (1e-9,) if quick else (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
    yield from optional("scipy", lambda: scipy_runs(native.rates(system), start, "scipy", tolerances))
    if not quick:
        yield from optional("pinocchio", lambda: pinocchio_runs(start, (1e-6, 1e-9, 1e-12)))
        yield from optional("mujoco", lambda: mujoco_runs(start))
        yield from optional("heyoka", lambda: heyoka_runs(start, (1e-4, 1e-6, 1e-9, 1e-12, 2.3e-16)))


def optional(name: str, runs: Callable[[], Iterator[tuple[str, str, Run]]]) -> Iterator[tuple[str, str, Run]]:
    try:
        yield from runs()
    except ImportError:
        print(f"{name} is not installed: left out")


def methods() -> list[str]:
    from robodyn_cli.integrators.registry import methods

    return list(methods)


# -- the four-bar --------------------------------------------------------------------------------------------


def four_bar() -> tuple[System, np.ndarray]:
    """Return the system, the dead point as its event, and the closed state at t = 0."""
    setup = prepare(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    determinant = passive_determinant(setup.problem, passive_coordinates(setup.problem) or [])
    system = index1(setup.problem, events=(EventFunction("dead_point", determinant),), work=False)
    return system, np.concatenate([setup.assembled.q, setup.assembled.v])


def four_bar_run(integrator: Integrator, start: np.ndarray, options: Options) -> Run:
    grid = Grid(0.0, 20.0, 2)

    def run() -> tuple[float, int]:
        times: list[float] = []

        def on_event(event: Event) -> bool:
            times.append(event.time)
            return False

        integrator.reset(0.0, start, options)
        integrator.run(20.0, grid, lambda t, x: None, on_event)
        return times[0], integrator.counters.steps

    return run


def four_bar_runs(quick: bool) -> Iterator[tuple[str, str, Run]]:
    """Yield all runs of the four-bar: engine, setting, call."""
    system, start = four_bar()
    for method in methods():
        integrator = Integrator(system, method)
        for setting, options in options_of(method, quick):
            if options.step is None:
                yield f"robodyn {method}", setting, four_bar_run(integrator, start, options)
    yield from optional("scipy", lambda: four_bar_scipy(system, start, (1e-9,) if quick else (1e-6, 1e-9, 1e-12)))


def four_bar_scipy(system: System, start: np.ndarray, tolerances: Any) -> Iterator[tuple[str, str, Run]]:
    """scipy on the accelerations, loops closed by nothing but the accuracy of the integration."""
    from scipy.integrate import solve_ivp

    f, event = native.rates(system), native.switching(system)
    event.terminal = True  # type: ignore[attr-defined]
    for rtol in tolerances:

        def run(rtol: float = rtol) -> tuple[float, int]:
            found = solve_ivp(f, (0.0, 20.0), start, method="DOP853", rtol=rtol, atol=1e-2 * rtol, events=event)
            return found.t[-1], len(found.t) - 1

        yield "scipy DOP853", f"rtol {rtol:.0e}", run


def lock_time(digits: int = 30) -> Any:
    """Return the time of the lock from energy: t = integral of sqrt(J / 2 W) dtheta, to so many digits.

    With one degree of freedom and a spring alone, J(theta) theta'^2 / 2 = W(theta). W vanishes at the start and J
    grows without bound at the dead point; theta = start + u^2 and theta = end - u^2 make both integrands smooth.
    """
    import mpmath as mp

    with mp.workdps(digits + 10):
        crank, link = mp.mpf("1.241"), mp.mpf("1.2")
        m1, c1, I1, m2, c2, I2 = map(mp.mpf, ("20.15", "1.2", "9.6", "8.25", "0.6", "0.06"))
        first, preload, stiffness = map(mp.mpf, ("0.01", "1.96", "0.1"))
        last = 2 * mp.asin(link / crank)

        def inertia(theta: Any, gap: Any) -> Any:
            """Kinetic energy at theta' = 1, twice; gap = last - theta, which is not left to cancellation."""
            x, y = crank * mp.cos(theta), crank * mp.sin(theta)
            # pin, crank's end and ground pivot make an isosceles triangle with the angle ``base`` at both ends
            cosine = mp.sin(theta / 2) / mp.sin(last / 2)
            sine = mp.sqrt(mp.sin((last + theta) / 2) * mp.sin(gap / 2)) / mp.sin(last / 2)
            across, base = mp.atan2(-y, crank - x), mp.atan2(sine, cosine)
            a, b = across + base, across + mp.pi - base  # directions of coupler and follower
            da = -crank * mp.sin(theta - b) / (link * mp.sin(a - b))
            db = crank * mp.sin(theta - a) / (link * mp.sin(b - a))
            v2 = crank**2 + (c2 * da) ** 2 + 2 * crank * c2 * da * mp.cos(a - theta)
            return I1 + m1 * c1**2 + I2 * da**2 + m2 * v2 + (I2 + m2 * c2**2) * db**2

        def work_rate(x: Any) -> Any:
            """Work of the spring from the start over the angle x, divided by x."""
            return preload - stiffness / 2 * (2 * first + x)

        def early(u: Any) -> Any:
            return 2 * mp.sqrt(inertia(first + u**2, last - first - u**2) / (2 * work_rate(u**2)))

        def late(u: Any) -> Any:
            x = last - u**2 - first
            return 2 * u * mp.sqrt(inertia(last - u**2, u**2) / (2 * x * work_rate(x)))

        half = mp.sqrt((last - first) / 2)
        pieces = [half * k / 8 for k in range(9)]
        return mp.quad(early, pieces) + mp.quad(late, pieces)


# -- compiling -----------------------------------------------------------------------------------------------

READY = """
import sys, time
sys.path.insert(0, {folder!r})
import llvmlite.binding
import double_pendulum as bench
system, start = bench.{system}()
start = time.perf_counter()
bench.Integrator(system, {method!r})
print(time.perf_counter() - start)
"""


def compile_rows() -> list[dict[str, Any]]:
    """Return the seconds from equations to a run ready to start, by problem and method."""
    rows = []
    for work, system in ((PENDULUM, "pendulum"), (FOUR_BAR, "four_bar")):
        for method in methods():
            code = READY.format(folder=str(measure.ROOT / "benchmarks"), system=system, method=method)
            cold, cached = measure.cold_and_cached(code)
            rows.append({"work": work, "engine": f"robodyn {method}", "cold_s": cold, "cached_s": cached})
    return rows


# -- all -----------------------------------------------------------------------------------------------------


def bench(work: str, runs: Iterator[tuple[str, str, Run]], error_of: Callable[[Any], float],
          repeats: int) -> list[dict[str, Any]]:  # fmt: skip
    """Run everything once for its error, then in turns for its time."""
    calls: dict[tuple[str, str], Run] = {(engine, setting): run for engine, setting, run in runs}
    rows = []
    for (engine, setting), run in calls.items():
        end, steps = run()
        rows.append({"work": work, "engine": engine, "setting": setting, "error": error_of(end), "steps": steps})
    times = measure.alternate({str(key): run for key, run in calls.items()}, repeats, least=0.002)
    for row, seconds in zip(rows, times.values()):
        row["us"] = 1e6 * measure.median(seconds)
    return rows


def reached(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Return a table of the shortest time, by engine, in which each of ``TARGETS`` was reached."""
    lines = [["engine", *(f"{target:.0e}" for target in TARGETS)]]
    for engine in dict.fromkeys(row["engine"] for row in rows):
        cells = []
        for target in TARGETS:
            good = [row["us"] for row in rows if row["engine"] == engine and row["error"] <= target]
            cells.append(f"{min(good):.4g}" if good else "-")
        lines.append([engine, *cells])
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few settings and repeats, scipy the only peer")
    parser.add_argument("--json", metavar="FILE", help="write the rows to FILE")
    options = parser.parse_args()
    repeats = 3 if options.quick else 15
    rows = bench(PENDULUM, pendulum_runs(options.quick), lambda y: float(np.abs(y - END).max()), repeats)
    rows += bench(FOUR_BAR, four_bar_runs(options.quick), lambda t: abs(t - LOCK), repeats)
    compiling = [] if options.quick else compile_rows()
    measure.print_machine()
    print(f"medians of {repeats} alternating repeats")
    for work, what in ((PENDULUM, "error"), (FOUR_BAR, "error of the time [s]")):
        mine = [row for row in rows if row["work"] == work]
        print(f"\n{work}\n")
        head = [["engine", "setting", what, "us", "steps"]]
        lines = [[r["engine"], r["setting"], f"{r['error']:.1e}", f"{r['us']:.4g}", str(r["steps"])] for r in mine]
        print(measure.table(head + lines, left=2))
        print("\nmicroseconds to a true error of at most\n")
        print(measure.table(reached(mine)))
    if compiling:
        print("\nseconds to compile, and to load what is cached\n")
        lines = [[r["work"], r["engine"], f"{r['cold_s']:.3f}", f"{r['cached_s']:.4f}"] for r in compiling]
        print(measure.table([["work", "engine", "cold", "cached"], *lines], left=2))
    measure.write_json(options.json, rows, compiling=compiling, repeats=repeats)


if __name__ == "__main__":
    sys.exit(main())
