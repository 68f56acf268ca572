"""Cliffs: what each command, and a study of it, takes for every example scene; the slowest ten, with their reason.

    python benchmarks/cliffs.py [--scenes NAME ...] [--most SECONDS] [--repeats N] [--quick] [--json FILE]

Each figure is a process from start to end once all is compiled, in seconds of the processor: the median of several,
with their range (the first, which compiles, does not count). Plots are left out. There are the scene's own command,
``info``, ``plan``, ``validate``, and ``sweep`` of its command over its first mass, by the run. A process that takes
longer than ``--most`` is stopped and counts as that. The reason is what the run itself says: the stage of its summary
that took longest, of a study how many runs were whole commands.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import measure

SHOWN = 10
STOPPED = -1  # exit code of a process that takes too long
RUNS = 50
LOOKS = ("validate", "info", "plan")
QUICK = ("configs/2r_circle.yaml", "configs/double_pendulum.yaml")
WHOLE = re.compile(r"(\d+) of (\d+) runs were whole commands")


def scenes() -> list[Path]:
    """Return the example scenes that have a command of their own."""
    files = sorted((measure.ROOT / "configs").rglob("*.yaml"))
    return [file for file in files if re.search(r"^command:", file.read_text(encoding="utf-8"), re.M)]


def mass_of(file: Path) -> str | None:
    """Return the first mass of a scene that a study can vary, with its range; None where there is none."""
    from robodyn_cli import load_scene
    from robodyn_cli.errors import RobodynError

    try:
        scene = load_scene(file)
    except RobodynError:
        return None
    link = next((x for x in scene.robot.links if x.mass), None)
    if link is None:
        return None
    return (
        f"robot.links.{link.name}.mass=linspace({0.99 * float(link.mass)}, {1.01 * float(link.mass)}, {RUNS})"
    )


def process(line: list[str], most: float, environment: dict[str, str]) -> tuple[float, str, int]:
    """Return the processor's seconds of a process and its children, what it said, and its exit code."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "robodyn_cli", *line]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=most)
        said, code = done.stderr + done.stdout, done.returncode
    except subprocess.TimeoutExpired:
        return most, "stopped", STOPPED
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, said, code


def reason(out: Path, said: str) -> str:
    """Return why a run took as long as it did, in its own words."""
    whole = WHOLE.search(said)
    if whole is not None:
        why = re.search(r"to whole commands: ([^;\n]*)", said)
        return f"{whole[1]} of {whole[2]} runs are whole commands" + (f": {why[1]}" if why else "")
    file = out / "summary.json"
    seconds = json.loads(file.read_text(encoding="utf-8")).get("wall_time_s") if file.exists() else None
    stages = {k: v for k, v in seconds.items() if k != "total"} if isinstance(seconds, dict) else {}
    if said == "stopped":
        return "longer than is waited for"
    return max(stages, key=stages.__getitem__, default="") if stages else ""


def measured(
    file: Path, command: str, options: argparse.Namespace, environment: dict[str, str]
) -> dict[str, Any] | None:
    """Return the row of a command on a scene; None where it does not take the scene."""
    runs, more = 1, ["--no-plots"]
    if command in LOOKS:
        more = []
    elif command == "sweep":
        mass = mass_of(file)
        if mass is None:
            return None
        runs, more = RUNS, ["--no-plots", "--vary", mass]

    def once() -> tuple[float, str, int]:
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "out"
            place = [] if command in LOOKS else ["--out", str(out)]
            seconds, said, code = process([command, str(file), *more, *place], options.most, environment)
            if code == 70:
                raise RuntimeError(f"{command} {file.name}: {said.strip().splitlines()[-1]}")
            return seconds / runs, reason(out, said), code

    first = once()
    if first[2] in (1, 2, 64):
        return None
    name = str(file.relative_to(measure.ROOT))
    found = [first]
    if first[2] != STOPPED:
        found = measure.repeated(f"{command} {name}", once, lambda x: x[0], options.repeats)
    seconds, *ends, repeats = measure.Spread.of([x[0] for x in found])
    row = {"scene": name, "command": command, "seconds": seconds, "range": ends, "repeats": repeats}
    return {**row, "runs": runs, "reason": found[-1][1]}


def told(row: dict[str, Any]) -> str:
    return measure.Spread(row["seconds"], *row["range"], row["repeats"]).told(".3g")


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--scenes", nargs="+", metavar="NAME", help="those whose path contains one of these")
    parser.add_argument(
        "--most", type=float, default=60.0, help="seconds by the clock that a process may take"
    )
    options = measure.with_repeats(parser)
    files = [measure.ROOT / name for name in QUICK] if options.quick else scenes()
    if options.scenes:
        files = [x for x in files if any(name in str(x) for name in options.scenes)]
    measure.print_machine()
    with measure.reporting(options.json) as report, tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "ROBODYN_CACHE": cache, "PYTHONPATH": measure.search_path()}
        for file in files:
            own = re.search(r"^command: *(\w+)", file.read_text(encoding="utf-8"), re.M)
            commands = [own[1] if own else "simulate", "sweep"]
            for command in commands if options.quick else [*commands, *LOOKS]:
                with report.part(f"{command} {file.name}"):
                    row = measured(file, command, options, environment)
                    if row is not None:
                        report.rows.append(row)
        slowest = sorted(report.rows, key=lambda row: -row["seconds"])[:SHOWN]
        head = ["scene", "command", "most of it", "seconds a run"]
        body = [[r["scene"], r["command"], r["reason"], told(r)] for r in slowest]
        print("\n" + measure.table([head, *body], left=3))


if __name__ == "__main__":
    main()
