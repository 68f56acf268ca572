"""Many runs with other numbers: robodyn's compiled loops and lanes, heyoka's batches, CVODES, whole studies.

    python benchmarks/ensembles.py [--quick] [--json FILE]

Double pendulums start at random and have random masses; 10 s at 1e-9. heyoka integrates the formulas of
``peers/formulas.py`` with masses as parameters, one by one and in batches as wide as this processor's vectors, which
are its fastest. Stiff ones have a spring of 1e4 to 1e8 N m in the elbow. Four-bars have random springs, masses and
lengths, arrays of ten panels with ten latches random springs, masses and dampers; their error is the largest estimated
one of the time of a lock. Else the error is the median over the runs of the largest of angles and rates at the end,
against heyoka at 1e-15 (stiff: radau13 at 1e-12).
``auto`` takes Taylor series here. Times are of the processor, in turns; of threads and whole processes by the clock.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import measure

measure.single_thread()

import numpy as np  # noqa: E402
from cases import pendulum  # noqa: E402
from peers.formulas import pendulum_rates  # noqa: E402

from robodyn_cli import Mechanism, load_scene_text  # noqa: E402

MASSES = ["robot.links.link1.mass", "robot.links.link2.mass"]
SPRING = "robot.joints.theta2.spring.stiffness"
TOLERANCE, DURATION = 1e-9, 10.0
CHECKED = 100  # runs whose errors are known
TAILS = 1000  # the same where those of 99 % are asked for
CHANGE = 1e-7  # rad, that is followed to the end of a run
SIX_BAR = Path(__file__).parent / "six_bar.yaml"
ARRAY = Path(__file__).parent.parent / "configs" / "mechanisms" / "solar_array.yaml"


def scene(method: str, tolerance: float = TOLERANCE, stiff: bool = False, samples: int = 2) -> str:
    """Return a double pendulum as YAML."""
    forces = ", spring: {stiffness: 1e5}, friction: {viscous: 1e4}" if stiff else ""
    return f"""
schema: 1
command: simulate
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {{name: theta1, type: revolute, a: 1.0, alpha: 0, d: 0{", friction: {viscous: 1e4}" * stiff}}}
    - {{name: theta2, type: revolute, a: 1.0, alpha: 0, d: 0{forces}}}
  links:
    - {{name: link1, mass: 12.456, com: [0.773, 0, 0], com_frame: joint, inertia: {{zz: 1.042}}}}
    - {{name: link2, mass: 12.456, com: [0.583, 0, 0], com_frame: joint, inertia: {{zz: 1.042}}}}
initial: {{q: {{theta1: -90 deg, theta2: 0.1}}}}
simulate: {{duration: {DURATION}, samples: {samples}, integrator: {method}, rtol: {tolerance}, atol: {tolerance},
           error_estimate: false}}
"""


class Ensemble:
    """Random double pendulums: masses (N, 2) [kg], starts (N, 2) [rad]."""

    def __init__(self, count: int) -> None:
        rng = np.random.default_rng(0)
        self.masses = rng.uniform(10.0, 15.0, (count, 2))
        self.q = np.stack([-np.pi / 2 + rng.uniform(-1, 1, count), rng.uniform(-1, 1, count)], axis=1)

    def ours(self, method: str, tolerance: float = TOLERANCE) -> Callable[..., np.ndarray]:
        mechanism = Mechanism(load_scene_text(scene(method, tolerance)), MASSES)

        def run(threads: int = 1, runs: int | None = None) -> np.ndarray:
            found = mechanism.simulate_many(self.masses[:runs], q=self.q[:runs], threads=threads)
            assert found.ok.all() and found.one_by_one.mean() < 0.001
            return np.hstack([found.q, found.qd])

        return run

    def in_python(self, method: str) -> Callable[[], np.ndarray]:
        """Return a plain loop over one object."""
        mechanism = Mechanism(load_scene_text(scene(method)), MASSES)

        def run() -> np.ndarray:
            rows = []
            for k in range(len(self.q)):
                found = mechanism.simulate_many(self.masses[k : k + 1], q=self.q[k : k + 1], threads=1)
                rows.append(np.hstack([found.q[0], found.qd[0]]))
            return np.array(rows)

        return run

    @staticmethod
    def widest() -> int:
        """Return how many runs heyoka makes at once where it is fastest: a vector's lanes."""
        import heyoka as hy

        return int(hy.recommended_simd_size())

    def heyoka(self, batch: int, tolerance: float, runs: int | None = None) -> Callable[[], np.ndarray]:
        import heyoka as hy

        case = pendulum("plain")
        symbols = np.empty(2, dtype=object)
        symbols[:] = hy.par[0], hy.par[1]
        case = dataclasses.replace(case, arm=dataclasses.replace(case.arm, mass=symbols))
        x = hy.make_vars("a", "b", "c", "d")
        equations = list(zip(x, pendulum_rates(case, x, hy.sin, hy.cos)))
        starts = np.hstack([self.q, np.zeros_like(self.q)])[:runs]
        masses = self.masses[:runs]
        if batch == 1:
            one = hy.taylor_adaptive(equations, starts[0], pars=masses[0], tol=tolerance)

            def single() -> np.ndarray:
                rows = []
                for start, mass in zip(starts, masses):
                    one.time = 0.0
                    one.state[:], one.pars[:] = start, mass
                    one.propagate_until(DURATION)
                    rows.append(one.state.copy())
                return np.array(rows)

            return single
        first, pars = (np.ascontiguousarray(x[:batch].T) for x in (starts, masses))
        many = hy.taylor_adaptive_batch(equations, first, pars=pars, tol=tolerance)

        def batches() -> np.ndarray:
            rows = []
            for k in range(0, len(starts) - batch + 1, batch):
                many.set_time(0.0)
                many.state[:], many.pars[:] = starts[k : k + batch].T, masses[k : k + batch].T
                many.propagate_until(DURATION)
                rows.append(many.state.T.copy())
            return np.concatenate(rows)

        return batches

    def growth(self, runs: int) -> np.ndarray:
        """Return how many times as large a small change of the start is at the end of runs (runs,)."""
        ends = []
        for moved in (np.zeros(2), np.array([CHANGE, 0.0]), np.array([0.0, CHANGE])):
            other = copy.copy(self)
            other.q = self.q + moved
            ends.append(other.ours("gauss", 1e-12)(runs=runs))
        return np.maximum(*(errors_of(end, ends[0]) for end in ends[1:])) / CHANGE


def error_of(found: np.ndarray, reference: np.ndarray) -> float:
    """Return the median of the errors of the runs."""
    return float(np.median(errors_of(found, reference)))


def errors_of(found: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return the largest error at the end of those runs that both have."""
    count = min(len(found), len(reference))
    return np.asarray(np.abs(found[:count] - reference[:count]).max(axis=1))


def double_pendulums(count: int, repeats: int, heyoka: bool) -> list[dict[str, Any]]:
    ensemble = Ensemble(count)
    actions = {f"robodyn {m}": ensemble.ours(m) for m in ("auto", "dop853", "gauss")}
    actions["robodyn gauss, a loop in Python"] = ensemble.in_python("gauss")
    if heyoka:
        batch = ensemble.widest()
        batches = f"heyoka, batches of {batch}"
        actions[batches] = ensemble.heyoka(batch, TOLERANCE)
        actions["heyoka, one by one"] = ensemble.heyoka(1, TOLERANCE)
        reference = ensemble.heyoka(1, 1e-15, CHECKED)()
    else:
        reference = ensemble.ours("gauss", 1e-13)(runs=CHECKED)
    times = measure.alternate(actions, repeats)
    rows = []
    for name, action in actions.items():
        seconds = measure.median(times[name])
        error = error_of(action(), reference)
        rows.append(
            {"work": "double pendulums", "way": name, "runs": count, "seconds": seconds, "error": error}
        )
        if heyoka:
            rows[-1]["to_batch"] = measure.median_ratio(times[batches], times[name])
    return rows


def work_precision(count: int, repeats: int) -> list[dict[str, Any]]:
    """Return runs a second and true errors over tolerances, of runs side by side and of heyoka's batches, and how many
    times as fast these are at the same median and at the same 99 % error.

    Motions are chaotic, some more than others: tails are also told of errors over the growth of a small change.
    """
    ensemble = Ensemble(count)
    batch = ensemble.widest()
    batches = f"heyoka, batches of {batch}"
    tolerances = {
        "dop853": (1e-7, 1e-9, 1e-11, 1e-13), "gauss": (1e-5, 1e-7, 1e-9, 1e-11),
        "auto": (1e-6, 3e-8, 1e-9, 1e-11), "taylor12": (1e-6, 1e-7, 1e-8), "taylor16": (1e-8, 1e-10, 3e-11),
    }  # fmt: skip
    actions = {(f"robodyn {m}", t): ensemble.ours(m, t) for m, ts in tolerances.items() for t in ts}
    actions |= {(batches, 10.0**-k): ensemble.heyoka(batch, 10.0**-k) for k in range(5, 14)}
    known_runs = min(count, TAILS)
    reference, growth = ensemble.heyoka(1, 1e-16, known_runs)(), ensemble.growth(known_runs)
    times = measure.alternate(actions, repeats)
    rows: list[dict[str, Any]] = []
    for (way, tolerance), action in actions.items():
        errors = errors_of(action(), reference)
        (error, error_99), own = (
            np.quantile(x, (0.5, 0.99)) for x in (errors, errors / growth[: len(errors)])
        )
        rows.append({"way": way, "tolerance": tolerance, "runs": count, "seconds": min(times[way, tolerance]),
                     "error": float(error), "error_99": float(error_99), "tail": float(error_99 / error),
                     "tail_over_growth": float(own[1] / own[0])})  # fmt: skip
    for kind in ("error", "error_99"):
        known = sorted((r[kind], r["seconds"]) for r in rows if r["way"] == batches)
        errors, seconds = np.log(np.array(known)).T
        for row in rows:
            inside = known[0][0] <= row[kind] <= known[-1][0]
            same = np.exp(np.interp(np.log(row[kind]), errors, seconds)) if inside else np.nan
            row[f"to_batch_{kind}"] = float(same / row["seconds"])
    return rows


def told(ratio: float) -> str:
    """Return a ratio in words, a dash where heyoka's errors are all larger or smaller."""
    return f"{ratio:.2f}" if np.isfinite(ratio) else "-"


def threads(count: int, repeats: int) -> dict[str, Any]:
    """Return how much faster two threads are than one, by the clock."""
    run = Ensemble(count).ours("dop853")
    run(2)
    ratios = []
    for _ in range(repeats):
        start = time.perf_counter()
        run(1)
        middle = time.perf_counter()
        run(2)
        ratios.append((middle - start) / (time.perf_counter() - middle))
    return {"threads": max(ratios)}


def stiff(count: int, repeats: int, casadi: bool) -> list[dict[str, Any]]:
    springs = np.logspace(4, 8, count)

    def ours(method: str, tolerance: float) -> Callable[[], np.ndarray]:
        mechanism = Mechanism(load_scene_text(scene(method, tolerance, stiff=True)), [SPRING])

        def run() -> np.ndarray:
            found = mechanism.simulate_many({SPRING: springs}, threads=1)
            return np.hstack([found.q, found.qd])

        return run

    actions = {f"robodyn {method}": ours(method, 1e-8) for method in ("radau13", "rodas5p")}
    if casadi:
        actions["CasADi, CVODES"] = _cvodes(springs)
    times = measure.alternate(actions, repeats)
    reference = ours("radau13", 1e-12)()
    return [
        {"work": "stiff double pendulums", "way": name, "runs": count, "seconds": measure.median(times[name]),
         "error": error_of(action(), reference)}
        for name, action in actions.items()
    ]  # fmt: skip


def _cvodes(springs: np.ndarray) -> Callable[[], np.ndarray]:
    import casadi as ca

    case = pendulum("stiff")
    y, spring = ca.SX.sym("y", 4), ca.SX.sym("k")
    x = [y[k] for k in range(4)]
    rates = pendulum_rates(case, x, ca.sin, ca.cos, spring)
    ode = {"x": y, "p": spring, "ode": ca.vertcat(*rates)}
    options = {"linear_multistep_method": "bdf", "max_num_steps": 10**7, "reltol": 1e-8, "abstol": 1e-10}
    integrator = ca.integrator("run", "cvodes", ode, 0.0, DURATION, options)
    start = [-np.pi / 2, 0.1, 0.0, 0.0]
    return lambda: np.array([np.array(integrator(x0=start, p=k)["xf"]).ravel() for k in springs])


def four_bars(count: int, repeats: int) -> list[dict[str, Any]]:
    """The lecture's four-bar to its lock, with random springs, masses and lengths."""
    text = (Path(__file__).parent.parent / "configs" / "four_bar_deploy.yaml").read_text(encoding="utf-8")
    text = text.replace("1.96 - 0.1*theta1", "1.96 - k*theta1") + "parameters: {k: 0.1}\n"
    keys = ["parameters.k", "robot.links.crank.mass", "robot.links.coupler.mass", "robot.joints.theta1.a"]
    wide = np.array([0.05, 0.05, 0.05, 1e-4])
    nominal = np.array([0.1, 20.15, 8.25, 1.241])
    values = nominal * np.random.default_rng(0).uniform(1 - wide, 1 + wide, (count, 4))
    path = str(Path(__file__).parent.parent / "configs" / "four_bar_deploy.yaml")
    rows = []
    for name, tolerance, estimate in (("with error estimate", 1e-8, "true"), ("without", 1e-8, "false")):
        own = [f"simulate.rtol={tolerance}", f"simulate.error_estimate={estimate}"]
        mechanism = Mechanism(load_scene_text(text, path, own), keys)

        def run(mechanism: Mechanism = mechanism) -> Any:
            return mechanism.deploy_many(values, threads=1)

        seconds = measure.median(measure.alternate({name: run}, repeats)[name])
        found = run()
        assert found.ok.all()
        error = float(np.nanmax(found.time_error)) if estimate == "true" else float("nan")
        rows.append({"work": "four-bars to their lock", "way": f"robodyn gauss, {name}", "runs": count,
                     "seconds": seconds, "error": error})  # fmt: skip
    return rows


def panels(count: int, repeats: int) -> list[dict[str, Any]]:
    """Solar arrays of ten panels to the last of their ten latches, with random springs, masses and dampers."""
    keys = ["robot.joints.hinge1.spring.stiffness", "robot.joints.hinge5.spring.stiffness",
            "robot.links.panel3.mass", "robot.joints.hinge8.damper.damping"]  # fmt: skip
    values = np.array([6.0, 2.7, 4.0, 0.11]) * np.random.default_rng(0).uniform(0.95, 1.05, (count, 4))
    last, rows = ("locks.latch1.time",), []
    for name, estimate in (("with error estimate", "true"), ("without", "false")):
        text = ARRAY.read_text(encoding="utf-8")
        scene = load_scene_text(text, str(ARRAY), [f"simulate.error_estimate={estimate}"])
        mechanism = Mechanism(scene, keys)

        def run(mechanism: Mechanism = mechanism) -> Any:
            return mechanism.deploy_many(values, threads=1, of=last)

        seconds = measure.median(measure.alternate({name: run}, repeats)[name])
        found = run()
        assert found.ok.all() and not found.one_by_one.any()
        error = float(found.errors[last[0]].max()) if estimate == "true" else float("nan")
        rows.append({"work": "arrays of ten panels, ten latches", "way": f"robodyn gauss, {name}", "runs": count,
                     "seconds": seconds, "error": error})  # fmt: skip
    return rows


# -- whole processes --------------------------------------------------------------------------------------
def command(words: list[str], cache: str) -> float:
    """Return the seconds of a command by the clock."""
    return stages(words, cache)["whole"]


def stages(words: list[str], cache: str) -> dict[str, float]:
    """Return the seconds of a command by the clock, and of its stages as its summary tells them."""
    environment = {**os.environ, "ROBODYN_CACHE": cache, "PYTHONPATH": measure.search_path()}
    with tempfile.TemporaryDirectory() as out:
        line = [sys.executable, "-m", "robodyn_cli", *words, "--no-plots", "-q", "--out", f"{out}/out"]
        start = time.perf_counter()
        subprocess.run(line, env=environment, check=True)
        whole = time.perf_counter() - start
        told = json.loads(next(Path(out).rglob("summary.json")).read_text(encoding="utf-8"))
        return {**told.get("wall_time_s", {}), "whole": whole}


def one_array(turns: int) -> dict[str, float]:
    """Return the seconds of the array as it stands, the least of some turns: whole commands without compiled code and
    with all of it, and there the run with its error estimate."""
    with tempfile.TemporaryDirectory() as folder:
        caches = [f"{folder}/{turn}" for turn in range(turns)]
        cold, warm = ([stages(["deploy", str(ARRAY)], cache) for cache in caches] for _ in range(2))
    run = min(each["integrate"] + each["error_estimate"] for each in warm)
    return {"cold": min(x["whole"] for x in cold), "cached": min(x["whole"] for x in warm), "run": run}


def studies(count: int, turns: int) -> list[dict[str, Any]]:
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pendulum.yaml"
        path.write_text(scene("auto", samples=1001).replace("error_estimate: false", "error_estimate: true"))
        swing = ["--vary", f"{MASSES[0]}=uniform(10, 15)", "-n", str(count), "--of", "final.q.theta1"]
        springs = ["--vary", "forces.0.stiffness=linspace(1, 3, 100)", "--of", "final.q.a1"]
        for name, file, study, warm in (
            (f"sweep of {count} double pendulums, warm cache", path, swing, True),
            ("sweep of 100 springs of a six-bar, cold cache", SIX_BAR, springs, False),
        ):
            singles, wholes = [], []
            for turn in range(turns):
                shared = f"{folder}/shared"
                single, whole = ([f"{folder}/a{turn}", f"{folder}/b{turn}"], [shared, shared])[warm]
                if warm and not turn:
                    command(["sweep", str(file), *study], shared)
                singles.append(command(["simulate", str(file)], single))
                wholes.append(command(["sweep", str(file), *study], whole))
            rows.append({"work": name, "single": min(singles), "study": min(wholes)})
    return rows


def main() -> None:
    chosen = measure.command_line(__doc__).parse_args()
    count, repeats = (96, 2) if chosen.quick else (10_000, 5)
    measure.print_machine()
    with measure.reporting(chosen.json) as report:
        heyoka, casadi = report.has("heyoka"), report.has("casadi")
        with report.part("two threads"):
            report.more |= threads(count, repeats)
            print(f"\nTwo threads: {report.more['threads']:.2f} times one, by the clock\n", flush=True)
        for name, bench in (
            ("double pendulums", lambda: double_pendulums(count, repeats, heyoka)),
            ("stiff double pendulums", lambda: stiff(20 if chosen.quick else 1000, repeats, casadi)),
            ("four-bars to their lock", lambda: four_bars(count, repeats)),
            ("arrays of ten panels", lambda: panels(count, 1 if chosen.quick else 3)),
        ):
            with report.part(name):
                report.rows += bench()
        if report.rows:
            print(measure.table([
                ["work", "way", "runs", "runs/s", "median error", "to heyoka's batch"],
                *([r["work"], r["way"], str(r["runs"]), f"{r['runs'] / r['seconds']:.0f}",
                   f"{r['error']:.1e}" if np.isfinite(r["error"]) else "-",
                   f"{r['to_batch']:.2f}" if "to_batch" in r else "-"] for r in report.rows),
            ], left=2), flush=True)  # fmt: skip
        with report.part("whole studies"):
            whole = report.more["studies"] = studies(count, 1 if chosen.quick else 3)
            print("\n" + measure.table([
                ["whole process", "one run [s]", "study [s]", "ratio"],
                *([r["work"], f"{r['single']:.2f}", f"{r['study']:.2f}", f"{r['study'] / r['single']:.1f}"]
                  for r in whole),
            ]), flush=True)  # fmt: skip
        with report.part("one array"):
            one = report.more["array"] = one_array(1 if chosen.quick else 3)
            print(
                f"\nOne array of ten panels: {one['cold']:.2f} s without compiled code, {one['cached']:.2f} s with it; "
                f"the run with its error estimate takes {1e3 * one['run']:.0f} ms of that",
                flush=True,
            )
        with report.part("error over run time"):
            precise = report.more["work_precision"] = (
                work_precision(max(count // 5, 200), repeats) if heyoka else []
            )
            print("\n" + measure.table([
                ["double pendulums", "tolerance", "runs/s", "median error", "to heyoka", "99 % error", "to heyoka",
                 "99 % / median", "over growth"],
                *([r["way"], f"{r['tolerance']:.0e}", f"{r['runs'] / r['seconds']:.0f}",
                   f"{r['error']:.1e}", told(r["to_batch_error"]),
                   f"{r['error_99']:.1e}", told(r["to_batch_error_99"]), f"{r['tail']:.0f}",
                   f"{r['tail_over_growth']:.0f}"] for r in precise),
            ]))  # fmt: skip


if __name__ == "__main__":
    main()
