"""The error that runs report beside their true error: scenes, methods and tolerances.

    python benchmarks/error_estimates.py [--quick] [--json FILE] [SCENE.yaml ...]

The true error is that against a reference on which two methods at tight tolerance agree. Only runs count whose true
error can be told: above 100 times the rounding floor and ten times what the references disagree by, and below 1e-2
of the motion.
"""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import measure
import numpy as np

from robodyn_cli import load_scene
from robodyn_cli.errors import RobodynError
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.over.references import TrialReference
from robodyn_cli.over.stability.trial import Budget, reference, solve

ROOT = Path(__file__).resolve().parent.parent
TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13)
STEPS = (1 / 250, 1 / 1000, 1 / 4000)  # of a method without step control, as parts of the duration
FACTOR = 10.0


@dataclasses.dataclass(frozen=True)
class Row:
    """One run: what it reported and what was true; ``ratio`` is None where the true error cannot be told."""

    scene: str
    method: str
    setting: float
    true: float
    estimate: float | None
    floor: float
    ratio: float | None
    note: str
    cost: float


def scenes() -> list[Path]:
    """Return the scenes of the repository that can be simulated."""
    found = []
    for path in sorted([*ROOT.glob("configs/*.yaml"), *ROOT.glob("configs/benchmarks/*.yaml")]):
        try:
            scene = load_scene(path)
        except RobodynError:
            continue
        if scene.command in ("simulate", "deploy"):
            found.append(path)
    return found


def settings(
    method: str, duration: float, tolerances: Sequence[float]
) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield what is varied: tolerances, or steps."""
    if method in registry and not registry[method].adaptive:
        for part in STEPS:
            yield part * duration, {"step": part * duration}
    else:
        for tolerance in tolerances:
            yield tolerance, {"rtol": tolerance, "atol": 1e-2 * tolerance, "step": None}


def runs_of(
    path: Path,
    names: Iterable[str],
    tolerances: Sequence[float] | Mapping[str, Sequence[float]] = TOLERANCES,
    budget: Budget | None = None,
) -> Iterator[Row]:
    """Yield a row for each run of a scene; ``tolerances`` : of all methods, or by method."""
    budget = budget or Budget(500_000, 10.0)
    scene = load_scene(path)
    ref = reference(scene, Budget(2_000_000, 20.0))
    if ref is None:
        return
    for method in names:
        own = tolerances[method] if isinstance(tolerances, Mapping) else tolerances
        for setting, options in settings(method, scene.simulate.duration, own):
            done = solve(scene, budget, integrator=method, error_estimate=True, **options)
            if done.error is None and done.result is not None:
                yield judge(path.stem, method, setting, done, ref)


def judge(scene: str, method: str, setting: float, done: Any, ref: TrialReference) -> Row:
    """Return the row of a finished run."""
    report = done.result.summary["error_estimate"]
    count = len(ref.times)
    whole = count == len(done.times)
    apart = np.abs(done.states[:count] - ref.states)
    true = float(apart.max())
    estimate, floor = report.get("state_max"), report.get("rounding_floor", 0.0)
    doubt = 10.0 * float((10.0**-ref.digits * ref.scale).max())
    ranges = np.ptp(ref.states, axis=0)
    seconds = done.result.summary["wall_time_s"]
    cost = seconds["total"] / (seconds["total"] - seconds.get("error_estimate", 0.0))
    note = ""
    if not whole:
        note = "reference ends"
    elif true < 100.0 * floor or true < doubt:
        note = "at rounding"
    elif true > 1e-2 * float(ranges.max()):
        note = "not meaningful"
    ratio = None if note or estimate is None else estimate / true
    if estimate is None:
        note = note or report.get("reason", "none")
    return Row(scene, method, setting, true, estimate, floor, ratio, note, cost)


QUICK = ("double_pendulum", "four_bar_deploy", "tumbling_body")  # scenes of ``--quick``


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("scenes", nargs="*", type=Path)
    options = parser.parse_args()
    names = ["gauss", "dop853", "rodas5p"] if options.quick else list(registry)
    tolerances = TOLERANCES[1::2] if options.quick else TOLERANCES
    chosen = [path for path in scenes() if not options.quick or path.stem in QUICK]
    rows: list[Row] = []
    with measure.reporting(options.json) as report:
        for path in options.scenes or chosen:
            with report.part(path.stem):
                for row in runs_of(path, names, tolerances):
                    rows.append(row)
                    report.rows.append(dataclasses.asdict(row))
        print_rows(rows)


def print_rows(rows: list[Row]) -> None:
    told = [r for r in rows if r.ratio is not None]
    missed = [r for r in told if not 1.0 / FACTOR <= r.ratio <= FACTOR]  # type: ignore[operator]
    logs = [math.log10(max(r.ratio, 1e-12)) for r in told]  # type: ignore[type-var]
    low, middle, high = (10**x for x in (min(logs), statistics.median(logs), max(logs)))
    costs = [r.cost for r in rows]
    below = sum(r.ratio < 1.0 / FACTOR for r in missed)
    print(
        f"{len(rows)} runs of {len({r.scene for r in rows})} scenes, {len(told)} with an error that can be told"
    )
    print(f"estimate over true error: median {middle:.2f}, from {low:.2g} to {high:.2g}")
    print(f"outside a factor of {FACTOR:g}: {len(missed)}; below a tenth: {below}")
    print(
        f"time with the estimate over without: median {statistics.median(costs):.2f}, most {max(costs):.2f}"
    )
    for r in missed:
        words = f"true {r.true:.2e}, estimate {r.estimate:.2e}, ratio {r.ratio:.2g}"
        print(f"  {r.scene:24} {r.method:12} {r.setting:8.1e}  {words}")


if __name__ == "__main__":
    main()
