"""Time of sizing six joints against the whole example catalogue, as a process.

    python benchmarks/sizing.py [RUNS] [--quick] [--json FILE]

Six links in modified D-H with full inertias, in a motion of sines. Each joint has every motor of the catalogue with
every gear that fits it, and without one.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import measure

SIZES = ((12.0, 0.3), (8.0, 0.4), (5.0, 0.35), (2.5, 0.15), (1.5, 0.12), (0.6, 0.08))
INERTIA = {"xx": 0.3, "yy": 1.0, "zz": 1.1, "xy": 0.02, "xz": -0.03, "yz": 0.01}
ALPHAS = (0.0, -1.5707963267948966, 0.0, 1.5707963267948966, -1.5707963267948966, 1.5707963267948966)


def scene() -> str:
    """Return the scene."""
    joints, links, motion = [], [], []
    for k, ((mass, length), alpha) in enumerate(zip(SIZES, ALPHAS), start=1):
        a = 0.0 if k in (1, 2, 5, 6) else SIZES[k - 2][1]
        joints.append(f"    - {{name: q{k}, type: revolute, a: {a}, alpha: {alpha}, d: {0.05 * k}}}")
        I = mass * length**2 / 12
        inertia = ", ".join(f"{key}: {part * I}" for key, part in INERTIA.items())
        com = [0.4 * length, 0.02 * length, -0.05 * length]
        links.append(
            f"    - {{name: link{k}, mass: {mass}, com: {com}, com_frame: joint, inertia: {{{inertia}}}}}"
        )
        motion.append(f'q{k}: "{0.3 * k - 1.0:.3g} + 0.6*sin({0.8 + 0.15 * k:.3g}*t)"')
    head = ["schema: 1", "title: Six joints", "command: size", "gravity: [0, 0, -9.81]"]
    robot = ["robot:", "  convention: modified", "  joints:", *joints, "  links:", *links]
    end = [
        "trajectory:",
        "  type: joint",
        "  duration: 6",
        f"  q: {{{', '.join(motion)}}}",
        "inverse: {samples: 1001}",
    ]
    return "\n".join([*head, *robot, *end, ""])


def bench(runs: int) -> dict[str, Any]:
    """Return the least time of so many runs after a first, which fills the cache of compiled code."""
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder) / "six.yaml", Path(folder) / "out"
        path.write_text(scene(), encoding="utf-8")
        command = [
            sys.executable,
            "-m",
            "robodyn_cli",
            "size",
            str(path),
            "--no-plots",
            "--quiet",
            "--out",
            str(out),
        ]
        environment = {**os.environ, "PYTHONPATH": measure.search_path()}
        seconds, busy = [], []
        for _ in range(1 + runs):
            start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            code = subprocess.run(command, env=environment, stdout=subprocess.PIPE).returncode
            seconds.append(time.perf_counter() - start)
            busy.append(resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before)
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    measure.noted("size", seconds[1:])
    joints = summary["size"]["joints"].values()
    return {
        "exit_code": code, "sweeps": summary["size"]["sweeps"], "first_s": seconds[0], "s": min(seconds[1:]),
        "cpu_s": min(busy[1:]), "parts_s": summary["wall_time_s"],
        **{key: [joint[key] for joint in joints] for key in ("combinations", "passing")},
    }  # fmt: skip


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("runs", nargs="?", type=int, default=5)
    options = parser.parse_args()
    runs = 1 if options.quick else options.runs
    measure.print_machine()
    with measure.reporting(options.json) as report:
        row = bench(runs)
        report.rows.append(row)
        print(f"combinations {row['combinations']}, passing {row['passing']}")
        print(f"exit code {row['exit_code']}, {row['sweeps']} sweeps")
        print(f"the first run, which compiles: {row['first_s']:.2f} s")
        print(f"then the least of {runs}: {row['s']:.3f} s, {row['cpu_s']:.3f} s of them the processor's")
        print({key: round(x, 3) for key, x in row["parts_s"].items()})


if __name__ == "__main__":
    main()
