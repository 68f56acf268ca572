"""Peak memory and time of whole sweeps of short double pendulums: 10^4, 10^5 and 10^6 runs.

    python benchmarks/study_memory.py [--repeats N] [--quick] [--json FILE]

Each is a process of its own, ``robodyn sweep --no-plots`` with random masses and starts; compiled code is in the cache.
Memory is the largest resident set that the system counted, pages of files included. Figures are medians of several
processes, with their range.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import ensembles
import measure

DURATION = 0.05  # s, so that a million runs end soon
VARY = {
    "robot.links.link1.mass": "uniform(10, 15)",
    "robot.links.link2.mass": "uniform(10, 15)",
    "initial.q.theta1": "uniform(-2, -1)",
}


def sweep(scene: Path, runs: int, environment: dict[str, str]) -> dict[str, float]:
    """Return the seconds and the peak memory [MB] of a sweep, and the bytes that it left."""
    with tempfile.TemporaryDirectory() as out:
        vary = [word for key, spec in VARY.items() for word in ("--vary", f"{key}={spec}")]
        line = [sys.executable, "-m", "robodyn_cli", "sweep", str(scene), *vary, "-n", str(runs), "--of",
                "final.q.theta1", "--no-plots", "-q", "--out", f"{out}/out"]  # fmt: skip
        start = time.perf_counter()
        child = os.posix_spawn(sys.executable, line, environment)
        _, status, usage = os.wait4(child, 0)
        seconds = time.perf_counter() - start
        assert status == 0
        size = Path(out, "out", "result.h5").stat().st_size
    return {"runs": runs, "seconds": seconds, "peak_MB": usage.ru_maxrss / 1024, "result_MB": size / 1e6}


def over_repeats(found: list[dict[str, float]]) -> dict[str, Any]:
    """Return the row of several sweeps: medians, and the range of each figure."""
    spreads = {key: measure.Spread.of([x[key] for x in found]) for key in found[0]}
    medians: dict[str, Any] = {key: spread.middle for key, spread in spreads.items()}
    return {
        **medians,
        "repeats": len(found),
        "range": {key: x[1:3] for key, x in spreads.items() if key != "runs"},
    }


def shown(row: dict[str, Any], key: str, form: str) -> str:
    return measure.Spread(row[key], *row["range"][key], row["repeats"]).told(form)


def main() -> None:
    chosen = measure.with_repeats(measure.command_line(__doc__))
    measure.print_machine()
    with measure.reporting(chosen.json) as report, tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "pendulum.yaml"
        text = ensembles.scene("dopri5", 1e-6).replace(
            f"duration: {ensembles.DURATION}", f"duration: {DURATION}"
        )
        scene.write_text(text.replace("error_estimate: false", "error_estimate: true"))
        environment = {**os.environ, "ROBODYN_CACHE": f"{folder}/cache", "PYTHONPATH": measure.search_path()}
        sweep(scene, 100, environment)
        for runs in (100, 1000) if chosen.quick else (10**4, 10**5, 10**6):
            with report.part(f"{runs} runs"):
                found = measure.repeated(
                    f"{runs} runs",
                    lambda runs=runs: sweep(scene, runs, environment),
                    lambda one: one["seconds"],
                    chosen.repeats,
                )
                report.rows.append(over_repeats(found))
        head = ["runs", "peak memory [MB]", "time [s]", "runs/s", "result.h5 [MB]"]
        body = [
            [f"{r['runs']:.0f}", shown(r, "peak_MB", ".0f"), shown(r, "seconds", ".1f"),
             f"{r['runs'] / r['seconds']:.0f}", f"{r['result_MB']:.1f}"]
            for r in report.rows
        ]  # fmt: skip
        print(measure.table([head, *body]))


if __name__ == "__main__":
    main()
