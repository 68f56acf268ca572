"""Error against run time of the methods of integration on five motions: the figures of choosing-an-integrator.md.

    python benchmarks/choosing.py [--repeats 5] [--figure docs/figures/choosing.png] [--quick] [--json FILE]

The error is the largest of any position over 257 samples, against the tightest run of another method; times are the
shortest of the repeats, without output and without compilation.
"""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import measure
import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.over.stability.scenes import HANGING, stiff_arm
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.scene.load import load_scene, load_scene_text

SAMPLES = 257
TOLERANCES = tuple(10.0**-k for k in range(2, 14))
COMPARED = ("gauss", "dop853", "dopri5", "radau13", "radau", "rodas5p", "rosenbrock23", "bdf")
LEVELS = (1e-3, 1e-6, 1e-9, 1e-12)
TOO_LONG = 300_000  # steps

STIFF = stiff_arm("stiff arm", 10.0, rest="0", start=HANGING)
PENDULUM = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints: [{name: hinge, type: revolute, a: 1, alpha: 0, d: 0}]
  links: [{name: bob, mass: 1, com: [1, 0, 0], com_frame: joint, inertia: {zz: 0}}]
initial: {q: {hinge: 0}, qd: {hinge: 0}}
"""


@dataclasses.dataclass
class Motion:
    """A motion to compare methods on; ``reference`` is a method and its tolerance."""

    title: str
    system: System
    start: np.ndarray
    end: float
    reference: tuple[str, float]


@dataclasses.dataclass
class Point:
    """One run: its error, its time [s], what it was asked for."""

    error: float
    seconds: float
    asked: float


def motion(title: str, scene: Any, end: float, reference: tuple[str, float]) -> Motion:
    setup = prepare(scene)
    system = build_system(setup.problem, work=False)
    return Motion(title, system, system.join(setup.assembled.q, setup.assembled.v), end, reference)


def arm() -> Any:
    """The seven-joint arm hanging on springless joints with a little damping, its motion taken out."""
    text = (measure.ROOT / "configs/seven_joint_arm.yaml").read_text()
    head = text[: text.index("trajectory:")].replace("command: inverse\n", "")
    lines = []
    for line in head.splitlines():
        start = line.find("friction:")
        if start < 0:
            lines.append(line)
        else:
            lines.append(line[:start] + "damper: {damping: 0.5}" + ("}" if "- {" in line else ""))
    q = "{q1: 0.1, q2: 0.4, q3: 0.3, q4: -1.2, q5: 0.2, q6: 1.4, q7: 0.3}"
    qd = "{" + ", ".join(f"q{k}: 0" for k in range(1, 8)) + "}"
    return load_scene_text("\n".join(lines) + f"\ninitial: {{q: {q}, qd: {qd}}}\n")


def motions() -> list[Motion]:
    configs = measure.ROOT / "configs"
    return [
        motion("double pendulum, 10 s", load_scene(configs / "double_pendulum.yaml"), 10.0, ("gauss", 1e-14)),
        motion("seven-joint arm, damped, 1 s", arm(), 1.0, ("radau13", 1e-14)),
        motion("stiff: spring 1e6, dampers 1e4, 10 s", load_scene_text(STIFF), 10.0, ("radau13", 1e-14)),
        motion("four-bar linkage, driven, 8 s", load_scene(configs / "four_bar_deploy.yaml"), 8.0, ("gauss", 1e-14)),
    ]  # fmt: skip


def solve(integrator: Integrator, m: Motion, options: Options) -> np.ndarray:
    """Return positions at the samples (SAMPLES, nq)."""
    rows: list[np.ndarray] = []
    integrator.reset(0.0, m.start, options)
    integrator.run(m.end, Grid.over(m.end, SAMPLES), lambda t, x: rows.append(x), watch=False)
    return m.system.split(np.concatenate(rows))[0]


def curve(
    m: Motion, method: str, exact: np.ndarray, repeats: int, tolerances: tuple[float, ...]
) -> list[Point]:
    """Return a method's runs over the tolerances; those that fail or take too long are left out."""
    integrator = Integrator(m.system, method)
    points = []
    for tolerance in tolerances:
        options = Options(tolerance, tolerance, max_steps=TOO_LONG)
        try:
            error = float(np.abs(solve(integrator, m, options) - exact).max())
            seconds = []
            for _ in range(repeats):
                integrator.reset(0.0, m.start, options)
                began = time.perf_counter()
                integrator.advance(m.end)
                seconds.append(time.perf_counter() - began)
        except NumericalError:
            continue
        measure.noted(method, seconds)
        points.append(Point(error, min(seconds), tolerance))
    return points


def best(points: list[Point], level: float) -> Point | None:
    """Return the quickest run whose error is at most the level."""
    able = [p for p in points if p.error <= level]
    return min(able, key=lambda p: p.seconds) if able else None


def energies(periods: int) -> dict[str, list[tuple[float, float, float]]]:
    """Return (seconds, largest energy error over the run, over its first hundredth) of a pendulum by fixed steps."""
    m = motion("pendulum", load_scene_text(PENDULUM), 0.0, ("gauss", 1e-14))
    period = 2.3602  # s, of the pendulum of 1 m released horizontally
    found: dict[str, list[tuple[float, float, float]]] = {}
    for method in (k for k in methods if not methods[k].adaptive):
        integrator = Integrator(m.system, method)
        for parts in (16, 32, 64, 128, 256, 512):
            rows: list[np.ndarray] = []
            try:
                times = []
                for _ in range(3):
                    integrator.reset(0.0, m.start, Options(step=period / parts))
                    began = time.perf_counter()
                    integrator.advance(periods * period)
                    times.append(time.perf_counter() - began)
                seconds = min(times)
                integrator.reset(0.0, m.start, Options(step=period / parts))
                grid = Grid.over(periods * period, periods * 16 + 1)
                integrator.run(periods * period, grid, lambda t, x: rows.append(x), watch=False)  # noqa: B023
            except NumericalError:
                continue
            q, v = np.concatenate(rows).T
            energy = np.abs(0.5 * v * v + 9.81 * np.sin(q)) / 9.81
            found.setdefault(method, []).append(
                (seconds, float(energy.max()), float(energy[: len(energy) // 100].max()))
            )
    return found


def draw(results: dict[str, dict[str, list[Point]]], energy: dict[str, Any], path: str) -> None:
    """Draw errors over run times, a panel a motion, and the energy over long times."""
    import matplotlib.pyplot as plt

    from robodyn_cli.report.style import DASHES, marked_style

    figure, axes = plt.subplots(3, 2, figsize=(9.5, 10.5), layout="constrained")
    for ax, (title, curves) in zip(axes.flat, results.items()):
        for k, name in enumerate(COMPARED):
            points = [p for p in curves.get(name, []) if 1e-15 < p.error < 1.0]
            ax.loglog(
                [1e3 * p.seconds for p in points], [p.error for p in points], ls=DASHES[k], ms=4, label=name,
                **marked_style(k),
            )  # fmt: skip
        ax.set(title=title, xlabel="run time [ms]", ylabel="largest error of a joint position [rad]")
        ax.grid(True, which="major", color="#dedede", lw=0.6)
    ax = axes.flat[4]
    for k, (name, points) in enumerate(energy.items()):
        ax.loglog([1e3 * p[0] for p in points], [p[1] for p in points], ls=DASHES[k % 8], ms=4, label=name,
                  **marked_style(k))  # fmt: skip
    ax.set(
        title="pendulum, 1000 periods, fixed steps",
        xlabel="run time [ms]",
        ylabel="largest energy error / (m g l)",
    )
    ax.grid(True, which="major", color="#dedede", lw=0.6)
    ax = axes.flat[5]
    ax.axis("off")
    first = ax.legend(
        *axes.flat[0].get_legend_handles_labels(), title="with step control", loc="upper left", frameon=False
    )
    ax.add_artist(first)
    ax.legend(
        *axes.flat[4].get_legend_handles_labels(), title="with a fixed step", loc="upper right", frameon=False
    )
    figure.savefig(path, dpi=80)


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--figure", default="")
    chosen = parser.parse_args()
    repeats, tolerances = (1, TOLERANCES[1::5]) if chosen.quick else (chosen.repeats, TOLERANCES)
    results: dict[str, dict[str, list[Point]]] = {}
    with measure.reporting(chosen.json) as report:
        for m in motions():
            with report.part(m.title):
                method, tight = m.reference
                exact = solve(Integrator(m.system, method), m, Options(tight, tight))
                curves = {k: curve(m, k, exact, repeats, tolerances) for k in COMPARED}
                results[m.title] = curves
                report.rows += [
                    {"work": m.title, "method": k, **dataclasses.asdict(p)}
                    for k, x in curves.items()
                    for p in x
                ]
                print_motion(m.title, curves)
        periods = 50 if chosen.quick else 1000
        energy = energies(periods)
        report.more["energy"] = energy
        print(
            f"\npendulum over {periods} periods, 64 steps a period: largest energy error / (m g l), "
            "and in the first hundredth\n"
        )
        print("| method | whole run | first hundredth | time [ms] |\n|---|---|---|---|")
        for name, points in energy.items():
            if len(points) > 2:
                seconds, whole, start = points[2]
                print(f"| `{name}` | {whole:.1e} | {start:.1e} | {1e3 * seconds:.3g} |")
        if chosen.figure:
            draw(results, energy, chosen.figure)


def print_motion(title: str, curves: dict[str, list[Point]]) -> None:
    print(f"\n{title}: run time [ms] to an error of at most ... (rtol = atol)\n")
    print(f"| method | {' | '.join(f'{x:.0e}' for x in LEVELS)} |\n|---|{'---|' * len(LEVELS)}")
    for name, points in curves.items():
        cells = [best(points, x) for x in LEVELS]
        text = [f"{1e3 * p.seconds:.3g} ({p.asked:.0e})" if p else "-" for p in cells]
        print(f"| `{name}` | {' | '.join(text)} |", flush=True)


if __name__ == "__main__":
    main()
