"""Ten derivatives of the time at which the lecture's four-bar locks, beside the 20 runs of central differences.

    python benchmarks/sensitivities.py [--quick] [--json FILE]

Everything is built and compiled before it is timed. ``derivatives`` finds the lock, the integrator's steps, and the
derivatives along them once; ``with their errors`` finds them along two motions, as ``robodyn sensitivity`` does. The
runs are those of ``Mechanism.deploy_many`` on one thread, and of the scan of ``deploy``, without error estimates.
Errors are relative, the largest of the ten, against quadrature with 40 digits (``lock_time.py``); of differences with a
step of 1e-4 of each number.
"""

from __future__ import annotations

from pathlib import Path

import measure

measure.single_thread()

import numpy as np  # noqa: E402
from lock_time import NUMBERS, SLOPES  # noqa: E402

from robodyn_cli import Mechanism  # noqa: E402
from robodyn_cli.formulations.events import EventKind  # noqa: E402
from robodyn_cli.over.many.keys import understand  # noqa: E402
from robodyn_cli.over.sensitivity.motion.ends import BLOCKS, Ending, MotionSlopes  # noqa: E402
from robodyn_cli.scene.load import Family  # noqa: E402
from robodyn_cli.tools.progress import Stopwatch  # noqa: E402
from robodyn_cli.works.deploy.deploy import build_deployment  # noqa: E402
from robodyn_cli.works.deploy.scan import scan  # noqa: E402

SCENE = Path(__file__).parents[1] / "configs" / "four_bar_deploy.yaml"
KEYS = [key for key in NUMBERS if "#" not in key]
STEP = 1e-4


class Lock:
    """The lock of the four-bar and its derivatives."""

    def __init__(self) -> None:
        self.family = Family(SCENE, ["simulate.error_estimate=false"])
        self.motion = build_deployment(self.family.own, Stopwatch())
        self.function = next(e.value for e in self.motion.system.events if e.kind is EventKind.DEAD_POINT)
        self.mechanism = Mechanism(self.family, vary=KEYS)
        self.slopes = self.prepared()
        values = np.array([float(NUMBERS[key]) for key in KEYS])
        self.steps = STEP * values
        self.rows = np.concatenate([values + side * np.diag(self.steps) for side in (1.0, -1.0)])

    def time(self) -> float:
        """Return when it locks [s]."""
        found = scan(self.motion, self.motion.options, multipliers=False).dead_point
        assert found is not None
        return found[0]

    def prepared(self) -> MotionSlopes:
        keys = [understand(self.family, name) for name in KEYS]
        return MotionSlopes(
            self.motion, keys, [key.place for key in keys], Ending(self.time(), self.function)
        )

    def once(self) -> np.ndarray:
        """Return the derivatives from one motion."""
        self.time()
        self.slopes.until(self.slopes.ending)
        return self.slopes.once(self.motion.options, BLOCKS).values[0]

    def twice(self) -> np.ndarray:
        """Return the derivatives whose errors are known."""
        self.time()
        self.slopes.until(self.slopes.ending)
        return self.slopes.found()[0].time

    def differences(self) -> np.ndarray:
        """Return the derivatives by central differences."""
        times = self.mechanism.deploy_many(self.rows, of=["lock.time"], threads=1).time
        return (times[: len(KEYS)] - times[len(KEYS) :]) / (2.0 * self.steps)

    def one_by_one(self) -> None:
        for _ in range(2 * len(KEYS)):
            self.time()


def error(found: np.ndarray) -> float:
    """Return the largest relative error of derivatives."""
    truth = np.array([SLOPES[key] for key in KEYS])
    return float(np.max(np.abs(found / truth - 1.0)))


def main() -> None:
    options = measure.command_line(__doc__).parse_args()
    measure.print_machine()
    with measure.reporting(options.json) as report:
        lock = Lock()
        ways = {
            "derivatives": lock.once,
            "with their errors": lock.twice,
            "20 runs by deploy_many": lock.differences,
            "20 runs one by one": lock.one_by_one,
        }
        errors = {way: error(run()) for way, run in ways.items() if way != "20 runs one by one"}
        times = measure.alternate(ways, 3 if options.quick else 25)
        base = times["20 runs by deploy_many"]
        shown = [["way", "ms", "of the 20 runs", "error"]]
        for way, seconds in times.items():
            ms, ratio = 1e3 * measure.median(seconds), measure.median_ratio(seconds, base)
            report.rows.append({"way": way, "ms": ms, "of_differences": ratio, "error": errors.get(way)})
            told = f"{errors[way]:.1e}" if way in errors else ""
            shown.append([way, f"{ms:.2f}", f"{ratio:.2f}", told])
        print(measure.table(shown))


if __name__ == "__main__":
    main()
