"""True error beside run time: the lecture's double pendulum over 10 s, and its four-bar until it locks.

    python benchmarks/double_pendulum.py [--quick] [--json FILE]

Each row is one method at one tolerance. Pendulum: the error is the largest of angles and rates at the end,
against a solution in quadruple precision. Four-bar: the error of the time of the lock, against a quadrature
of the energy integral (``lock_time.py``). Times are of a run by robodyn's integrators as other code calls
them, compiling apart. Beside them: scipy's ``solve_ivp`` with the same compiled right-hand side; other engines are
in ``against_peers.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import measure

measure.single_thread()

import numpy as np  # noqa: E402
import peers.scipy  # noqa: E402
from cases import FourBar  # noqa: E402
from cases import pendulum as pendulum_case  # noqa: E402
from lock_time import LOCK  # noqa: E402
from peers.robodyn import four_bar_system, swing, to_lock  # noqa: E402

from robodyn_cli import load_scene  # noqa: E402
from robodyn_cli.formulations.build import build_system  # noqa: E402
from robodyn_cli.formulations.system import System  # noqa: E402
from robodyn_cli.integrators.runtime.integrator import Integrator  # noqa: E402
from robodyn_cli.integrators.runtime.options import Options  # noqa: E402
from robodyn_cli.ready.prepare import prepare  # noqa: E402

CONFIGS = measure.ROOT / "configs"
PENDULUM, FOUR_BAR = "double pendulum, 10 s", "four-bar to lock"
TARGETS = (1e-3, 1e-7, 1e-10, 1e-12)

TOLERANCES = {
    "gauss": (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13),
    "dop853": (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-14),
    "dopri5": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11),
    "rodas5p": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11),
    "rosenbrock23": (1e-6, 1e-7, 1e-8),
    "bdf": (1e-6, 1e-7, 1e-8, 1e-9, 1e-10),
    "radau": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10),
    "radau9": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11),
    "radau13": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11),
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
    return build_system(setup.problem, work=False), np.concatenate([setup.assembled.q, setup.assembled.v])


def error_at_end(y: np.ndarray) -> float:
    return float(np.abs(y - pendulum_case("plain").reference[-1]).max())


def pendulum_runs(quick: bool) -> Iterator[tuple[str, str, Run]]:
    """Yield all runs of the double pendulum: engine, setting, call."""
    case = pendulum_case("plain")
    system, start = pendulum()
    for method in methods():
        integrator = Integrator(system, method)
        for setting, options in options_of(method, quick):
            run, _ = swing(integrator, start, options, case)
            yield f"robodyn {method}", setting, run
    every = 3 if quick else 1
    for entry in list(peers.scipy.entries(case))[::every]:
        yield entry.engine, entry.setting, entry.run


def methods() -> list[str]:
    from robodyn_cli.integrators.registry import methods

    # those that need a constant mass matrix are not for these scenes
    return [m for m in methods if m in TOLERANCES or m == "rk4"]


# -- the four-bar --------------------------------------------------------------------------------------------


def four_bar_runs(quick: bool) -> Iterator[tuple[str, str, Run]]:
    """Yield all runs of the four-bar: engine, setting, call."""
    system, start = four_bar_system()
    for method in methods():
        integrator = Integrator(system, method)
        for setting, options in options_of(method, quick):
            if options.step is None:
                yield f"robodyn {method}", setting, to_lock(integrator, start, options)
    for entry in list(peers.scipy.entries(FourBar()))[: 5 : 2 if quick else 1]:
        yield entry.engine, entry.setting, entry.run


# -- compiling -----------------------------------------------------------------------------------------------

READY = """
import sys, time
sys.path.insert(0, {folder!r})
import llvmlite.binding
import double_pendulum as bench
system, start = bench.{system}()
start = time.process_time()
bench.Integrator(system, {method!r})
print(time.process_time() - start)
"""


def compile_rows() -> list[dict[str, Any]]:
    """Return the seconds from equations to a run ready to start, by problem and method."""
    rows = []
    folder = str(measure.ROOT / "benchmarks")
    for work, system in ((PENDULUM, "pendulum"), (FOUR_BAR, "four_bar_system")):
        for method in methods():
            code = READY.format(folder=folder, system=system, method=method)
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
        rows.append(
            {"work": work, "engine": engine, "setting": setting, "error": error_of(end), "steps": steps}
        )
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
    options = measure.command_line(__doc__).parse_args()
    repeats = 3 if options.quick else 15
    measure.print_machine()
    print(f"medians of {repeats} alternating repeats")
    with measure.reporting(options.json) as report:
        report.more["repeats"] = repeats
        for work, runs, error_of, meaning in (
            (PENDULUM, pendulum_runs, error_at_end, "error"),
            (FOUR_BAR, four_bar_runs, lambda t: abs(t - LOCK), "error of the time [s]"),
        ):
            with report.part(work):
                rows = bench(work, runs(options.quick), error_of, repeats)
                report.rows += rows
                print(f"\n{work}\n")
                head = [["engine", "setting", meaning, "us", "steps"]]
                lines = [
                    [r["engine"], r["setting"], f"{r['error']:.1e}", f"{r['us']:.4g}", str(r["steps"])]
                    for r in rows
                ]
                print(measure.table(head + lines, left=2))
                print("\nmicroseconds to a true error of at most\n")
                print(measure.table(reached(rows)), flush=True)
        if not options.quick:
            compiling = report.more["compiling"] = compile_rows()
            print("\nseconds to compile, and to load what is cached\n")
            lines = [
                [r["work"], r["engine"], f"{r['cold_s']:.3f}", f"{r['cached_s']:.4f}"] for r in compiling
            ]
            print(measure.table([["work", "engine", "cold", "cached"], *lines], left=2))


if __name__ == "__main__":
    main()
