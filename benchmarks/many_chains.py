"""Many runs of random chains: how many times as fast as ``gauss`` Taylor series are, and where ``auto`` takes them.

    python benchmarks/many_chains.py [--scenes N] [--quick] [--json FILE]

Chains of one to four hinges in a plane or in space, with springs, dampers, smoothed friction and torques; runs differ
in a mass and a start. Each is made by ``gauss`` and by ``taylor12`` at 1e-8, ``taylor16`` at 1e-10. Errors are medians
over the runs of the largest of angles and rates at the end, against ``gauss`` at 1e-14. *Times as fast* is at equal
errors: a series that errs k times as much as ``gauss`` counts as k^(1/(order + 1)) times as slow. *Work* is what
``auto`` goes by where rates may change abruptly. Chains whose series are not written out are left out.
"""

from __future__ import annotations

import itertools
from typing import Any

import measure

measure.single_thread()

import numpy as np  # noqa: E402

from robodyn_cli import Mechanism, load_scene_text  # noqa: E402
from robodyn_cli.integration_methods import METHODS  # noqa: E402
from robodyn_cli.integrators.methods.gauss import Gauss  # noqa: E402
from robodyn_cli.integrators.methods.taylor import MOST  # noqa: E402
from robodyn_cli.kernels.series.rules import Series  # noqa: E402
from robodyn_cli.motion.build import build_motion  # noqa: E402
from robodyn_cli.motion.method import series_beside  # noqa: E402
from robodyn_cli.ready.integrable import integrable  # noqa: E402

FRICTION = ", friction: {coulomb: 0.3, transition_speed: 0.2}"
JOINTS = ("", "", ", damper: {damping: 0.4}", ", spring: {stiffness: 30}", FRICTION)
TORQUES = ("", "", "torques: {j0: 0.4*sin(3*t) - 0.1*tanh(j0)}")
KEYS = ["robot.links.l0.mass", "initial.q.j0"]
SERIES = {"taylor12": 1e-8, "taylor16": 1e-10}


def scene(seed: int, method: str, rtol: float) -> str:
    """Return a random chain as YAML."""
    rng = np.random.default_rng(seed)
    count, plane = int(rng.choice([1, 2, 2, 3, 3, 4])), rng.random() < 0.5
    joints, links = [], []
    for k in range(count):
        axis = [0, 0, 1] if plane else np.round(rng.normal(size=3), 2).tolist()
        com = np.round(rng.normal(size=3) * [0.4, 0.4, 0.4 * (not plane)], 2).tolist()
        place = f"origin: {{xyz: [{0.4 * (k > 0)}, 0, 0]}}"
        joints.append(f"{{name: j{k}, type: revolute, axis: {axis}, {place}{rng.choice(JOINTS)}}}")
        links.append(
            f"{{name: l{k}, mass: {rng.uniform(1, 3):.3f}, com: {com}, inertia: {{xx: 0.11, yy: 0.12, zz: 0.13}}}}"
        )
    start = ", ".join(f"j{k}: {rng.uniform(-0.5, 0.5):.3f}" for k in range(count))
    return f"""
schema: 1
command: simulate
gravity: {[0, -9.81, 0] if plane else [0.3, -9.81, -0.2]}
robot: {{joints: [{", ".join(joints)}], links: [{", ".join(links)}]}}
{rng.choice(TORQUES)}
initial: {{q: {{{start}}}}}
simulate: {{duration: 3, samples: 2, integrator: {method}, rtol: {rtol}, atol: {rtol / 100}, error_estimate: false}}
"""


def compared(seed: int, runs: int, repeats: int) -> list[dict[str, Any]]:
    """Return a row for each series that can make a scene's runs."""
    system = build_motion(integrable(load_scene_text(scene(seed, "auto", 1e-8)))).system
    program = system.dynamics.program
    if program.operations > MOST:
        return []
    values = np.array([2.0, 0.3]) * np.random.default_rng(seed).uniform(0.8, 1.2, (runs, 2))

    def ends(method: str, rtol: float) -> Any:
        mechanism = Mechanism(load_scene_text(scene(seed, method, rtol)), KEYS)

        def run() -> np.ndarray:
            found = mechanism.simulate_many(values, threads=1)
            assert found.ok.all()
            return np.hstack([found.q, found.qd])

        return run

    exact, rows = ends("gauss", 1e-14)(), []
    for name, rtol in SERIES.items():
        actions = {way: ends(way, rtol) for way in ("gauss", name)}
        errors = {way: float(np.median(np.abs(run() - exact).max(axis=1))) for way, run in actions.items()}
        times = measure.alternate(actions, repeats)
        order = METHODS[name].order
        worse = (max(errors[name], 1e-15) / max(errors["gauss"], 1e-15)) ** (1.0 / (order + 1))
        rows.append({
            "series": name, "scene": f"{seed}", "joints": system.nv, "operations": program.operations,
            "abrupt": Gauss.is_steep(system), "work": Series.of(program).work(order),
            "taken": series_beside(load_scene_text(scene(seed, "auto", rtol)), system) == name,
            "gauss_us": 1e6 * min(times["gauss"]) / runs, "gauss_error": errors["gauss"], "error": errors[name],
            "ratio": min(times["gauss"]) / min(times[name]) / worse,
        })  # fmt: skip
    return rows


def summary(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Return how many times as fast series are where ``auto`` takes them and where not, as a table."""
    table = [["series", "rates", "auto takes it", "chains", "least", "median", "most"]]
    for name, abrupt, taken in itertools.product(SERIES, (True, False), (True, False)):
        found = [r["ratio"] for r in rows if (r["series"], r["abrupt"], r["taken"]) == (name, abrupt, taken)]
        if found:
            spread = measure.Spread.of(found)
            words = "abrupt" if abrupt else "smooth", "yes" if taken else "no", str(len(found))
            table.append([name, *words, *(f"{x:.2f}" for x in (spread.least, spread.middle, spread.most))])
    return table


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--scenes", type=int, metavar="N", help="random chains (default: 60, 3 by --quick)")
    options = parser.parse_args()
    runs, repeats = (16, 2) if options.quick else (256, 5)
    measure.print_machine()
    with measure.reporting(options.json) as report:
        for seed in range(options.scenes or (3 if options.quick else 60)):
            with report.part(f"scene {seed}"):
                report.rows += compared(seed, runs, repeats)
        print("\nTimes as fast as gauss at equal errors\n")
        print(measure.table(summary(report.rows), left=3))
        cells = [
            [r["series"], r["scene"], str(r["joints"]), str(r["operations"]), "abrupt" if r["abrupt"] else "smooth",
             f"{r['work']:.0f}", "yes" if r["taken"] else "no", f"{r['gauss_us']:.1f}", f"{r['gauss_error']:.0e}",
             f"{r['error']:.0e}", f"{r['ratio']:.2f}"]
            for r in sorted(report.rows, key=lambda r: (r["series"], r["ratio"]))
        ]  # fmt: skip
        head = ["series", "scene", "joints", "operations", "rates", "work", "auto takes it", "us by gauss",
                "its error", "error", "times as fast"]  # fmt: skip
        print("\n" + measure.table([head, *cells], left=2))


if __name__ == "__main__":
    main()
