"""Many runs of random chains: how many times as fast as ``gauss`` methods in lanes are, and where ``auto`` takes them.

    python benchmarks/many_chains.py [--scenes N] [--quick] [--json FILE]

Chains of one to six hinges in a plane or in space, with springs, dampers, smoothed friction and torques; runs differ in
a mass and a start. Each is made by ``gauss`` and by ``taylor12`` at 1e-8, ``taylor16`` at 1e-10, and ``dop853`` at a
thirtieth of 1e-8 and of 1e-10, as ``auto`` has it. Errors are medians over the runs of the largest of angles and rates
at the end, against ``gauss`` at 1e-14. *Times as fast* is at equal errors: a method that errs k times as much as
``gauss`` counts as k^(1/(order + 1)) times as slow. *Work* is of a step of a series, by which ``auto`` goes where rates
may change abruptly. Series of chains with too many operations are left out.
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
from robodyn_cli.motion.method import SHARE, side_by_side  # noqa: E402
from robodyn_cli.ready.integrable import integrable  # noqa: E402

FRICTION = ", friction: {coulomb: 0.3, transition_speed: 0.2}"
JOINTS = ("", "", ", damper: {damping: 0.4}", ", spring: {stiffness: 30}", FRICTION)
TORQUES = ("", "", "torques: {j0: 0.4*sin(3*t) - 0.1*tanh(j0)}")
KEYS = ["robot.links.l0.mass", "initial.q.j0"]
WAYS = {  # method and tolerance of ``gauss``
    "taylor12": (("taylor12", 1.0), 1e-8), "taylor16": (("taylor16", 1.0), 1e-10),
    "dop853": (("dop853", SHARE), 1e-8), "dop853, tight": (("dop853", SHARE), 1e-10),
}  # fmt: skip


def scene(seed: int, method: str, rtol: float) -> str:
    """Return a random chain as YAML."""
    rng = np.random.default_rng(seed)
    count, plane = int(rng.choice([1, 2, 2, 3, 3, 4, 4, 6])), rng.random() < 0.5
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
    """Return a row for each method that can make a scene's runs side by side."""
    system = build_motion(integrable(load_scene_text(scene(seed, "auto", 1e-8)))).system
    program, steep = system.dynamics.program, Gauss.is_steep(system)
    values = np.array([2.0, 0.3]) * np.random.default_rng(seed).uniform(0.8, 1.2, (runs, 2))

    def ends(method: str, rtol: float) -> Any:
        mechanism = Mechanism(load_scene_text(scene(seed, method, rtol)), KEYS)

        def run() -> np.ndarray:
            found = mechanism.simulate_many(values, threads=1)
            assert found.ok.all()
            return np.hstack([found.q, found.qd])

        return run

    exact, rows = ends("gauss", 1e-14)(), []
    for name, (way, rtol) in WAYS.items():
        method, share = way
        series = method.startswith("taylor")
        if series and program.operations > MOST:
            continue
        actions = {"gauss": ends("gauss", rtol), name: ends(method, share * rtol)}
        errors = {who: float(np.median(np.abs(run() - exact).max(axis=1))) for who, run in actions.items()}
        times = measure.alternate(actions, repeats)
        order = METHODS[method].order
        worse = (max(errors[name], 1e-15) / max(errors["gauss"], 1e-15)) ** (1.0 / (order + 1))
        rows.append({
            "way": name, "scene": f"{seed}", "joints": system.nv, "operations": program.operations, "abrupt": steep,
            "work": Series.of(program).work(order) if series else float("nan"),
            "taken": side_by_side(load_scene_text(scene(seed, "auto", rtol)), system) == way,
            "gauss_us": 1e6 * min(times["gauss"]) / runs, "gauss_error": errors["gauss"], "error": errors[name],
            "ratio": min(times["gauss"]) / min(times[name]) / worse,
        })  # fmt: skip
    return rows


def summary(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Return how many times as fast methods are where ``auto`` takes them and where not, as a table."""
    table = [["method", "rates", "auto takes it", "chains", "least", "median", "most"]]
    for name, abrupt, taken in itertools.product(WAYS, (True, False), (True, False)):
        found = [r["ratio"] for r in rows if (r["way"], r["abrupt"], r["taken"]) == (name, abrupt, taken)]
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
            [r["way"], r["scene"], str(r["joints"]), str(r["operations"]), "abrupt" if r["abrupt"] else "smooth",
             f"{r['work']:.0f}" if np.isfinite(r["work"]) else "-",
             "yes" if r["taken"] else "no", f"{r['gauss_us']:.1f}", f"{r['gauss_error']:.0e}",
             f"{r['error']:.0e}", f"{r['ratio']:.2f}"]
            for r in sorted(report.rows, key=lambda r: (r["way"], r["ratio"]))
        ]  # fmt: skip
        head = ["method", "scene", "joints", "operations", "rates", "work", "auto takes it", "us by gauss",
                "its error", "error", "times as fast"]  # fmt: skip
        print("\n" + measure.table([head, *cells], left=2))


if __name__ == "__main__":
    main()
