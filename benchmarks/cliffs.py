"""Cliffs: what each command, and each study, takes for every example scene; the slowest ten, with their reason.

    python benchmarks/cliffs.py [--scenes NAME ...] [--commands NAME ...] [--most SECONDS] [--repeats N] [--quick]
                                [--json FILE]

Each figure is a process from start to end once all is compiled, in seconds of the processor: the median of several,
with their range (the first, which compiles, does not count). Plots are left out, but where they are the work. Every
command is tried on every scene, or on the result of the scene's own command; what refuses a scene has no row.
``sweep`` is of the scene's own command over its first mass, by the run. A process that takes
longer than ``--most`` is stopped and counts as that. The reason is what the run itself says: the stage of its summary
that took longest, of a study how many runs were whole commands. Commands whose work is many runs of every method
(``stability``, ``work-precision``) have a table of their own.
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
MOTIONS = ("inverse", "simulate", "deploy", "kinematics", "statics", "assemble", "reach", "linearise", "size")
# what stands after the scene, or in its place; {result} is a folder with the result of its own command, {out} a new one
WORDS = {
    **dict.fromkeys(MOTIONS, "{scene} --no-plots --out {out}"),
    **dict.fromkeys(("validate", "info", "plan"), "{scene}"),
    "sweep": "{scene} --no-plots --out {out} --vary {mass}=linspace({low},{high},50)",
    "sensitivity": "{scene} --no-plots --out {out} --to {mass} --of {figure}",
    "optimise": "{scene} --no-plots --out {out} --vary {mass}=uniform({low},{high}) --minimise {figure}",
    "equations": "{scene} --quiet",
    "crosscheck": "{scene} --no-plots --with mujoco",
    "export --c": "{scene} --c {out}",
    "export --loop": "{scene} --c {out} --loop",
    "export --fmu": "{scene} --fmu {out}.fmu",
    "export --to mjcf": "{scene} --to mjcf --out {out}",
    "export --to csv": "{result} --to csv --out {out}",
    "check": "{result}",
    "plot": "{result} --out {out}",
    "report": "{result} --file {out}.html",
    "animate": "{result} --file {out}.png",
    "stability": "{scene} --no-plots --out {out}",
    "work-precision": "{scene} --no-plots --out {out} --repeats 1",
}  # fmt: skip
METHODS = ("stability", "work-precision")
QUICK_COMMANDS = ("inverse", "simulate", "sweep")
# a figure of each command to derive and to search for
FIGURES = {"inverse": "rms_torque.{joint}", "simulate": "final.q.{joint}", "deploy": "lock.time"}
REFUSED = (2, 64)
QUICK = ("configs/2r_circle.yaml", "configs/double_pendulum.yaml")
WHOLE = re.compile(r"(\d+) of (\d+) runs were whole commands")


def scenes() -> list[Path]:
    """Return the example scenes that have a command of their own."""
    files = sorted((measure.ROOT / "configs").rglob("*.yaml"))
    return [file for file in files if re.search(r"^command:", file.read_text(encoding="utf-8"), re.M)]


def names_of(file: Path, command: str) -> dict[str, str]:
    """Return what the words of commands name of a scene: its first mass with a range about it, a joint, a figure."""
    from robodyn_cli import load_scene
    from robodyn_cli.errors import RobodynError

    try:
        scene = load_scene(file)
    except RobodynError:
        return {}
    found = {"joint": scene.robot.joints[0].name}
    link = next((x for x in scene.robot.links if x.mass), None)
    if link is not None:
        low, high = 0.99 * float(link.mass), 1.01 * float(link.mass)
        found |= {"mass": f"robot.links.{link.name}.mass", "low": str(low), "high": str(high)}
    if command in FIGURES:
        found["figure"] = FIGURES[command].format(**found)
    return found


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
    command: str, names: dict[str, str], options: argparse.Namespace, environment: dict[str, str]
) -> dict[str, Any] | None:
    """Return the row of a command on a scene; None where it does not take the scene."""
    runs = RUNS if command == "sweep" else 1

    def once() -> tuple[float, str, int]:
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "out"
            words = [word.format(**names, out=out) for word in WORDS[command].split()]
            seconds, said, code = process([command.split()[0], *words], options.most, environment)
            if code == 70:
                raise RuntimeError(f"{command}: {said.strip().splitlines()[-1]}")
            return seconds / runs, reason(out, said), code

    try:
        first = once()
    except KeyError:  # no mass to vary, no figure to derive
        return None
    if first[2] in REFUSED:
        return None
    name = str(Path(names["scene"]).relative_to(measure.ROOT))
    found = [first]
    if first[2] != STOPPED:
        found = measure.repeated(f"{command} {name}", once, lambda x: x[0], options.repeats)
    seconds, *ends, repeats = measure.Spread.of([x[0] for x in found])
    row = {"scene": name, "command": command, "seconds": seconds, "range": ends, "repeats": repeats}
    return {**row, "runs": runs, "reason": found[-1][1]}


def shown(rows: list[dict[str, Any]]) -> str:
    """Return the table of the slowest of these rows."""
    slowest = sorted(rows, key=lambda row: -row["seconds"])[:SHOWN]
    head = ["scene", "command", "most of it", "seconds a run"]
    return measure.table([head, *([r["scene"], r["command"], r["reason"], told(r)] for r in slowest)], left=3)


def told(row: dict[str, Any]) -> str:
    return measure.Spread(row["seconds"], *row["range"], row["repeats"]).told(".3g")


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--scenes", nargs="+", metavar="NAME", help="those whose path contains one of these")
    parser.add_argument("--commands", nargs="+", metavar="NAME", choices=WORDS, help="these alone")
    parser.add_argument(
        "--most", type=float, default=60.0, help="seconds by the clock that a process may take"
    )
    options = measure.with_repeats(parser)
    files = [measure.ROOT / name for name in QUICK] if options.quick else scenes()
    if options.scenes:
        files = [x for x in files if any(name in str(x) for name in options.scenes)]
    commands = options.commands or (QUICK_COMMANDS if options.quick else WORDS)
    measure.print_machine()
    with measure.reporting(options.json) as report, tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "ROBODYN_CACHE": f"{folder}/cache", "PYTHONPATH": measure.search_path()}
        for k, file in enumerate(files):
            own = re.findall(r"^command: *(\w+)", file.read_text(encoding="utf-8"), re.M)[0]
            result = f"{folder}/{k}"
            names = {**names_of(file, own), "scene": str(file)}
            made = process([own, str(file), "--no-plots", "--out", result], options.most, environment)
            if made[2] not in (*REFUSED, STOPPED):
                names["result"] = result
            for command in commands:
                with report.part(f"{command} {file.name}"):
                    row = measured(command, names, options, environment)
                    if row is not None:
                        report.rows.append(row)
        print("\n" + shown([row for row in report.rows if row["command"] not in METHODS]))
        by_methods = [row for row in report.rows if row["command"] in METHODS]
        if by_methods:
            print("\n" + shown(by_methods))


if __name__ == "__main__":
    main()
