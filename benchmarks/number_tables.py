"""Code that reads the numbers of a scene from a table, beside code that has them inside.

    python benchmarks/number_tables.py [--quick] [--json FILE]

Both are of the same scene, in one process, and take turns; a ratio is the median over the turns. Operations are
those of the accelerations.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import measure

measure.single_thread()

import numpy as np  # noqa: E402

from robodyn_cli import load_scene  # noqa: E402
from robodyn_cli.equations import problem as equations  # noqa: E402
from robodyn_cli.formulations.build import build_system  # noqa: E402
from robodyn_cli.integrators.runtime.integrator import Integrator  # noqa: E402
from robodyn_cli.integrators.runtime.options import Options  # noqa: E402
from robodyn_cli.kernels.samples import SampleKernel  # noqa: E402
from robodyn_cli.model import build as models  # noqa: E402
from robodyn_cli.ready.prepare import prepare  # noqa: E402

CONFIGS = measure.ROOT / "configs"
SAMPLES = 1000
ARM = [f"robot.joints.q{k}.friction=null" for k in range(1, 8)]
START = "initial={q: {" + ", ".join(f"q{k}: {0.3 * k:.1f}" for k in range(1, 8)) + "}}"
OPTIONS = Options(1e-10, 1e-12)

Case = tuple[Callable[[], Any], int]


@contextlib.contextmanager
def folded() -> Iterator[None]:
    """Make numbers of the scene plain floats, which become part of the code."""
    with (
        mock.patch.object(equations, "with_places", lambda scene: scene),
        mock.patch.object(models, "with_places", lambda scene: scene),
    ):
        yield


def samples(name: str, what: str) -> Case:
    """Return inverse or forward dynamics at many samples, and its operations."""
    p = equations.Problem(load_scene(CONFIGS / f"{name}.yaml"))
    forces = np.array(p.graph.symbols([f"f{k}" for k in range(p.model.nv)], "p"), dtype=object)
    outputs = p.inverse_dynamics if what == "inverse" else p.free_accelerations(forces - p.bias)
    kernel = SampleKernel({"r": list(outputs)}, ["q", "v", "a", "p"])
    rng = np.random.default_rng(0)
    counts = kernel.program.inputs.items()
    inputs = {group: np.asfortranarray(rng.uniform(-1.0, 1.0, (SAMPLES, count))) for group, count in counts}
    inputs = {group: x[0] if group == "p" else x for group, x in inputs.items()}
    return lambda: kernel(**inputs), kernel.program.operations


def motion(name: str, end: float, *overrides: str) -> Case:
    """Return an integration to ``end``, and the operations of its accelerations."""
    setup = prepare(load_scene(CONFIGS / f"{name}.yaml", overrides))
    system = build_system(setup.problem, work=False)
    start = system.join(setup.assembled.q, setup.assembled.v)
    integrator = Integrator(system, "gauss")

    def run() -> None:
        integrator.reset(0.0, start, OPTIONS)
        integrator.advance(end)

    return run, system.dynamics.program.operations


CASES: dict[str, Callable[[], Case]] = {
    "2R inverse, 1 000 samples": lambda: samples("2r_circle", "inverse"),
    "2R forward, 1 000 samples": lambda: samples("2r_circle", "forward"),
    "7-joint inverse, 1 000 samples": lambda: samples("seven_joint_arm", "inverse"),
    "7-joint forward, 1 000 samples": lambda: samples("seven_joint_arm", "forward"),
    "double pendulum, 10 s": lambda: motion("double_pendulum", 10.0),
    "four-bar, 12 s": lambda: motion("four_bar_deploy", 12.0),
    "7-joint arm, 2 s": lambda: motion("seven_joint_arm", 2.0, *ARM, START),
    "Andrews' mechanism, 0.05 s": lambda: motion("benchmarks/andrews", 0.05),
    "Stewart platform, 1 s": lambda: motion("benchmarks/stewart_platform", 1.0),
}


def main() -> None:
    arguments = measure.command_line(__doc__).parse_args()
    with measure.reporting(arguments.json) as report:
        for name, case in CASES.items():
            with report.part(name):
                row = bench(name, case, 5 if arguments.quick else 60)
                report.rows.append(row)
                print(
                    f"{name:32s} {row['operations_inside']:6d} {row['operations_table']:6d} operations "
                    f"{row['us_inside']:9.2f} {row['us_table']:9.2f} us ratio {row['ratio']:.3f}",
                    flush=True,
                )


def bench(name: str, case: Any, turns: int) -> dict[str, Any]:
    """Return the row of a case."""
    table, operations = case()
    with folded():
        inside, before = case()
    times = measure.alternate({"inside": inside, "table": table}, turns)
    return {
        "case": name,
        "operations_inside": before,
        "operations_table": operations,
        "us_inside": 1e6 * min(times["inside"]),
        "us_table": 1e6 * min(times["table"]),
        "ratio": measure.median_ratio(times["table"], times["inside"]),
    }


if __name__ == "__main__":
    main()
