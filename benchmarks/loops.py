"""Mechanisms with loops: the error that each formulation reaches, its steps, evaluations and time, beside Exudyn.

    python benchmarks/loops.py [--scenes NAME ...] [--quick] [--json FILE]

Scenes are those of ``configs/benchmarks`` that simulate closed loops. The error is the largest of the position of
any body's centre of mass [m] at 257 instants, against the reference that ``robodyn work-precision`` would use: two
methods at tight tolerance, over the time for which they agree. Formulations come from the same place, so that new
ones appear here by themselves. Exudyn integrates the bodies in redundant coordinates with its implicit methods for
index 3 (generalized-alpha) and index 2 (trapezoidal); it needs `pip install robodyn[peers]`.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import measure

measure.single_thread()

import numpy as np  # noqa: E402
from peers.exudyn_loops import Mechanism, Unsupported, solve  # noqa: E402

from robodyn_cli import load_scene  # noqa: E402
from robodyn_cli.errors import CapabilityError, NumericalError, RobodynError  # noqa: E402
from robodyn_cli.integrators.runtime.integrator import Integrator  # noqa: E402
from robodyn_cli.integrators.runtime.options import Grid, Options  # noqa: E402
from robodyn_cli.motion.build import projected_motion  # noqa: E402
from robodyn_cli.over.references import TrialReference, agreed  # noqa: E402
from robodyn_cli.over.work_precision.entries import LONGEST  # noqa: E402
from robodyn_cli.over.work_precision.work_precision import formulations, reference  # noqa: E402
from robodyn_cli.ready.prepare import prepare  # noqa: E402

FOLDER = measure.ROOT / "configs" / "benchmarks"
TOLERANCES = (1e-4, 1e-7, 1e-10, 1e-13)
SOLVERS = (("GeneralizedAlpha", "generalized-alpha, index 3"), ("TrapezoidalIndex2", "trapezoidal, index 2"))
INTERVALS = 256
PROBE = 20_000  # steps; more of them mean that a singular pose is not passed
EXPLICIT = (("dop853", 3e-14), ("dopri5", 1e-13))
STEPS = (INTERVALS * 4, INTERVALS * 40)
INDEX3 = "generalized_alpha"


def scenes(names: list[str]) -> list[tuple[str, Any]]:
    """Return the benchmark scenes that simulate mechanisms with loops."""
    found = []
    for path in sorted(FOLDER.glob("*.yaml")):
        if names and path.stem not in names:
            continue
        scene = load_scene(path)
        if scene.command == "simulate" and scene.loops:
            found.append((path.stem, scene))
    return found


def measured(report: measure.Report, name: str, scene: Any, quick: bool) -> list[dict[str, Any]]:
    """Return the rows of one scene."""
    setup = prepare(scene)
    problem = setup.problem
    duration = scene.simulate.duration
    projected = projected_motion(scene)
    motions, _ = formulations(projected, scene.simulate.stabilisation)
    systems = {name: motion.system for name, motion in motions.items()}
    main = projected.system
    start = main.join(setup.assembled.q, setup.assembled.v)
    passing = scene.simulate.singular == "pass"
    ref = explicit_reference(main, start, duration) if passing else reference(projected, duration)[0]
    mechanism = Mechanism(problem, setup.assembled.q, setup.assembled.v)
    nq = problem.model.nq
    right = np.array([mechanism.centres(x[:nq]) for x in ref.states])
    method = "dop853" if passing else "gauss"
    common = {"scene": name, "until": ref.until, "digits": round(ref.digits, 1)}
    rows = []
    for formulation, system in systems.items():
        start = system.join(setup.assembled.q, setup.assembled.v)
        integrator = Integrator(system, method)
        for rtol in TOLERANCES[:: 2 if quick else 1]:
            row = {**common, "engine": f"{formulation}, {method}", "setting": f"rtol {rtol:.0e}"}
            asked = Options(rtol, 1e-2 * rtol, max_steps=LONGEST)
            row.update(own_run(integrator, system, start, asked, ref, right, mechanism, nq, quick))
            rows.append(row)
    # the same method and steps as Exudyn's, on the loops at index 3
    whole = INTERVALS * float(ref.times[1])
    start = main.join(setup.assembled.q, setup.assembled.v)
    try:
        integrator = Integrator(main, INDEX3)
    except CapabilityError as error:
        print(f"{name}: {error}", file=sys.stderr)
        integrator = None
    for steps in STEPS[: 1 if quick else 2] if integrator is not None else ():
        row = {**common, "engine": f"index 3, {INDEX3}", "setting": f"step {whole / steps:.2g}"}
        asked = Options(step=whole / steps, max_steps=LONGEST)
        row.update(own_run(integrator, main, start, asked, ref, right, mechanism, nq, quick))
        rows.append(row)
    # the reference may vouch for a part of the time only; its instants stay
    if report.has("exudyn"):
        with report.part(f"Exudyn, {name}"):
            rows += exudyn_rows(name, whole, common, mechanism, right, quick)
    return rows


def explicit_reference(system: Any, start: Any, duration: float) -> TrialReference:
    """Return a reference for scenes that run into singular poses, up to shortly before the first one."""
    try:
        found = [_states(system, start, duration, how) for how in EXPLICIT]
    except (
        NumericalError
    ) as error:  # of either: a method may get past the pose by a step that happens to be long
        return explicit_reference(system, start, 0.95 * float(error.details["time"]))
    grid = Grid.over(duration, INTERVALS + 1)
    x, y = found
    scale = np.maximum(np.ptp(x, axis=0), 1e-12)
    ref = agreed(grid.times(0, INTERVALS + 1), x, y, scale, 1e-5, ("dop853", "dopri5"))
    assert ref is not None, "dop853 and dopri5 do not agree on anything"
    return ref


def _states(system: Any, start: Any, duration: float, how: tuple[str, float]) -> np.ndarray:
    method, tolerance = how
    integrator, rows = Integrator(system, method), []
    integrator.reset(0.0, start, Options(tolerance, tolerance, max_steps=PROBE))
    integrator.run(
        duration, Grid.over(duration, INTERVALS + 1), lambda t, x: rows.append(x.copy()), watch=False
    )
    return np.concatenate(rows)


def own_run(
    integrator: Any,
    system: Any,
    start: Any,
    options: Options,
    ref: Any,
    right: Any,
    m: Mechanism,
    nq: int,
    quick: bool,
) -> dict[str, Any]:
    found: list[np.ndarray] = []
    try:
        integrator.reset(0.0, start, options)
        grid = Grid.over(ref.until, len(ref.times))
        integrator.run(ref.until, grid, lambda t, x: found.append(x.copy()), watch=False)
        q = system.split(np.concatenate(found))[0]
        times = []
        for _ in range(2 if quick else 7):
            integrator.reset(0.0, start, options)
            began = time.process_time()
            integrator.advance(ref.until)
            times.append(time.process_time() - began)
    except RobodynError as error:
        return {"error": float("nan"), "steps": 0, "evaluations": 0, "ms": float("nan"), "note": str(error)}
    measure.noted("robodyn", times)
    counters = integrator.counters
    centres = np.array([m.centres(x) for x in q])
    return {
        "error": float(np.abs(centres - right).max()), "steps": counters.steps,
        "evaluations": counters.evaluations, "ms": 1e3 * measure.median(times),
    }  # fmt: skip


def exudyn_rows(
    name: str, duration: float, common: dict[str, Any], m: Mechanism, right: Any, quick: bool
) -> list[dict[str, Any]]:
    rows = []
    instants = len(right)
    for kind, label in SOLVERS:
        for steps in STEPS[: 1 if quick else 2]:
            row: dict[str, Any] = {
                **common, "engine": f"Exudyn {label}", "setting": f"step {duration / steps:.2g}"
            }  # fmt: skip
            try:
                run = solve(m, name, duration, INTERVALS, kind, steps)
                found = [run()]
                if not quick and found[0][1] < 0.3:
                    found += [run(), run()]
            except Unsupported as error:
                print(f"{name}: Exudyn's model lacks {error}", file=sys.stderr)
                return []
            except Exception as error:
                print(f"{name}: Exudyn {label}: {error}", file=sys.stderr)
                rows.append(
                    {**row, "error": float("nan"), "steps": steps, "evaluations": 0, "ms": float("nan")}
                )
                continue
            path = found[0][0][:instants]
            error = float(np.abs(path - right).max()) if len(path) == instants else float("nan")
            row.update(
                error=error,
                steps=steps,
                evaluations=found[0][2],
                ms=1e3 * measure.median([f[1] for f in found]),
            )
            rows.append(row)
    return rows


def print_scene(name: str, rows: list[dict[str, Any]]) -> None:
    print(f"\n{name}, {rows[0]['until']:g} s, reference to {rows[0]['digits']} digits\n")
    head = [["formulation, method", "setting", "error m", "steps", "evaluations", "ms"]]
    body = [
        [
            row["engine"], row["setting"], f"{row['error']:.1e}", str(row["steps"]), str(row["evaluations"]),
            f"{row['ms']:.3g}",
        ]
        for row in rows
    ]  # fmt: skip
    print(measure.table(head + body, left=2), flush=True)


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--scenes", nargs="+", default=[], help="names of files in configs/benchmarks")
    options = parser.parse_args()
    measure.print_machine()
    with measure.reporting(options.json) as report:
        for name, scene in scenes(options.scenes):
            with report.part(name):
                rows = measured(report, name, scene, options.quick)
                report.rows += rows
                print_scene(name, rows)


if __name__ == "__main__":
    main()
