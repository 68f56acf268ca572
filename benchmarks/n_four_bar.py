"""N-four-bar (IFToMM benchmark A02 for any N): operations and time per step against the number of loops.

    python benchmarks/n_four_bar.py                    5 to 160 loops, table, plot in docs/images
    python benchmarks/n_four_bar.py --loops 5 10       some, no plot
    python benchmarks/n_four_bar.py --quick            2, 4 and 6 loops, no plot
    python benchmarks/n_four_bar.py --scene 40         print the scene

Time per step is that of the classical method of order 4 at a fixed step of 1 ms with projection, so that a step is
the same work for every N: four accelerations, one projection of positions and one of velocities. The error is that
of dop853 at rtol 1e-10 after 0.4 s, against the reduced equation of the parallelogram's one freedom.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import measure

SIZES = (5, 10, 20, 40, 80, 160)
QUICK = (2, 4, 6)
STEP = 1e-3
END = 0.4  # before the first pose in which all bars are horizontal
REPEATS = 15


def scene(n: int) -> str:
    """Return the mechanism of n windows: n + 1 upright legs, n couplers, uniform rods of 1 m and 1 kg."""
    rod = "mass: 1, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 1/12}"
    joints, links, loops, q = [], [], [], []
    for k in range(n + 1):
        place = f"origin: {{xyz: [{k}, 0, 0]}}, " if k else ""
        joints.append(f"    - {{name: leg{k}, type: revolute, parent: base, {place}a: 1, alpha: 0, d: 0}}")
        links.append(f"    - {{name: L{k}, {rod}}}")
        q.append(f"leg{k}: 90 deg")
        if k < n:
            joints.append(f"    - {{name: bar{k}, type: revolute, parent: L{k}, a: 1, alpha: 0, d: 0}}")
            links.append(f"    - {{name: C{k}, {rod}}}")
            q.append(f"bar{k}: -90 deg")
            loops.append(f"  - {{name: window{k}, type: revolute, between: [C{k}.end, L{k + 1}.end]}}")
    return "\n".join([
        "schema: 1", f"title: N-four-bar, N = {n}", "command: simulate", "gravity: [0, -9.81, 0]",
        "robot:", "  convention: standard", "  joints:", *joints, "  links:", *links,
        "  points: {B0: {link: L0, at: end}}",
        "loops:", *loops, f"initial: {{q: {{{', '.join(q)}}}, qd: {{leg0: -1}}, hold: [leg0]}}",
        f"simulate: {{duration: {END}, samples: 41, integrator: dop853, rtol: 1e-10, atol: 1e-12, singular: pass}}", "",
    ])  # fmt: skip


def exact(n: int) -> float:
    """Return the leg's angle at the end: [(n+1)/3 + n] theta'' = -9.81 [(n+1)/2 + n] cos theta."""
    import numpy as np
    from scipy.integrate import solve_ivp

    ratio = -9.81 * ((n + 1) / 2 + n) / ((n + 1) / 3 + n)
    found = solve_ivp(
        lambda t, y: [y[1], ratio * np.cos(y[0])],
        (0, END),
        [np.pi / 2, -1],
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
    )
    return float(found.y[0, -1])


def bench(n: int) -> dict[str, Any]:
    import numpy as np

    from robodyn_cli import load_scene_text
    from robodyn_cli.formulations.build import build_system
    from robodyn_cli.integrators.runtime.integrator import Integrator
    from robodyn_cli.integrators.runtime.options import Options
    from robodyn_cli.ready.prepare import prepare

    start = time.process_time()
    setup = prepare(load_scene_text(scene(n)))
    system = build_system(setup.problem)
    program, positions, velocities = system.dynamics.program, system.positions, system.velocities
    assert positions is not None and velocities is not None
    equations = time.process_time() - start
    state = system.join(setup.assembled.q, setup.assembled.v)
    start = time.process_time()
    steps = Integrator(system, "rk4")
    compiled = time.process_time() - start
    spent = []
    for _ in range(REPEATS):
        steps.reset(0.0, state, Options(step=STEP))
        start = time.process_time()
        steps.advance(END)
        spent.append((time.process_time() - start) / steps.counters.steps)
    measure.noted(f"{n} loops", spent)
    accurate = Integrator(system, "dop853")
    accurate.reset(0.0, state, Options(rtol=1e-10, atol=1e-12))
    accurate.advance(END)
    legs = system.split(accurate.state)[0][::2]
    return {
        "loops": n, "joints": setup.problem.model.nv, "rows": len(setup.problem.constraints.rows),
        "operations": program.operations,
        "operations_of_a_step": 4 * program.operations + positions.operations + velocities.operations,
        "us_per_step": 1e6 * min(spent), "equations_s": equations, "compile_s": compiled,
        "error": float(np.abs(legs - exact(n)).max()),
    }  # fmt: skip


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw operations and time of a step against the number of loops, with lines of slope one."""
    import numpy as np

    from robodyn_cli.report import format, style

    import matplotlib.pyplot as plt  # isort: skip

    n = np.array([row["loops"] for row in rows], dtype=float)
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.4), constrained_layout=True)
    panels = (("operations_of_a_step", "operations of a step", 0), ("us_per_step", "time of a step [µs]", 1))
    for ax, (key, label, colour) in zip(axes, panels):
        y = np.array([row[key] for row in rows])
        ax.loglog(n, y, "o-", color=style.COLOURS[colour], label="measured", zorder=3)
        ax.loglog(n, y[0] * n / n[0], "--", color=style.GREY, linewidth=1.0, label="proportional to N")
        ax.set_xticks(n, [f"{x:.0f}" for x in n])
        ax.minorticks_off()
        ax.set_xlabel("loops N")
        ax.set_ylabel(label)
        ax.grid(True, which="major", linewidth=0.4, alpha=0.5)
        ax.legend(frameon=False, loc="upper left")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=format.current().dpi)


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--loops", type=int, nargs="+", default=None, help="numbers of loops")
    parser.add_argument("--scene", type=int, help="print the scene with so many loops, and nothing else")
    parser.add_argument(
        "--plot", help="draw into this file (default for the whole series: docs/images/n_four_bar.png)"
    )
    options = parser.parse_args()
    if options.scene is not None:
        print(scene(options.scene), end="")
        return
    measure.single_thread()
    measure.print_machine()
    with measure.reporting(options.json) as report:
        for n in options.loops or (QUICK if options.quick else SIZES):
            with report.part(f"{n} loops"):
                report.rows.append(bench(n))
        print(measure.table([HEAD, *map(cells, report.rows)], left=0))
        whole = options.loops is None and not options.quick
        image = options.plot or (str(measure.ROOT / "docs" / "images" / "n_four_bar.png") if whole else None)
        if image:
            draw(report.rows, Path(image))


HEAD = [
    "loops", "joints", "rows", "operations", "a step", "µs a step", "µs a step and loop", "equations s",
    "compile s", "error rad",
]  # fmt: skip


def cells(r: dict[str, Any]) -> list[str]:
    return [
        str(r["loops"]), str(r["joints"]), str(r["rows"]), str(r["operations"]), str(r["operations_of_a_step"]),
        f"{r['us_per_step']:.3g}", f"{r['us_per_step'] / r['loops']:.3f}", f"{r['equations_s']:.2f}",
        f"{r['compile_s']:.2f}", f"{r['error']:.1e}",
    ]  # fmt: skip


if __name__ == "__main__":
    main()
