"""Time of sizing six joints against the whole example catalogue, as a process: python benchmarks/sizing.py [RUNS]

Six links in modified D-H with full inertias, in a motion of sines. Each joint has every motor of the catalogue with
every gear that fits it, and without one.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]

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


def main(runs: int) -> None:
    """Print the least time of so many runs, the first of which fills the cache of compiled code."""
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
        seconds, busy = [], []
        for _ in range(1 + runs):
            start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            code = subprocess.run(command, cwd=ROOT, capture_output=True).returncode
            seconds.append(time.perf_counter() - start)
            busy.append(resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before)
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    joints = summary["size"]["joints"].values()
    for key in ("combinations", "passing"):
        print(f"{key}: {[joint[key] for joint in joints]}")
    print(
        f"exit code {code}, {summary['size']['sweeps']} sweeps; the first run, which compiles: {seconds[0]:.2f} s"
    )
    print(
        f"then the least of {runs}: {min(seconds[1:]):.3f} s, {min(busy[1:]):.3f} s of them the processor's"
    )
    print({key: round(x, 3) for key, x in summary["wall_time_s"].items()})


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
