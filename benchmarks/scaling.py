"""What each command costs over the number of joints or loops: whole processes, nothing compiled before.

    python benchmarks/scaling.py                            chains, trees and windows; table and exponents
    python benchmarks/scaling.py --commands info inverse    some commands
    python benchmarks/scaling.py --sizes 10 100 --most 60   some sizes; a process may take a minute
    python benchmarks/scaling.py --repeats 5                medians of five processes, with their range
    python benchmarks/scaling.py --recursions               inverse and forward dynamics of long chains, us a sample
    python benchmarks/scaling.py --quick                    two small sizes
    python benchmarks/scaling.py --scene tree 100           print a scene

Chains and trees have random axes, prismatic joints among them, full inertias and offset centres of mass; windows are
the N-four-bar. Every figure is a process from start to end with an empty cache: seconds of the processor and the most
memory at a time. Exponents, of both, are slopes of the logarithms between the two largest sizes, of what is above a
process that does nothing. Each is the median of several processes; what takes longer than a minute in all has fewer.

``--recursions`` takes chains of revolute joints, in one process on one core: calls of few samples, whose arrays stay in
the processor's cache, and of many, which go through memory. Minimum of the calls within a second; the exponent is that
of a line through all sizes.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import measure
import numpy as np

SIZES = (10, 30, 100, 300, 1000)
WINDOWS = (5, 10, 20, 40, 80, 160)
JOINTS = [100, 300, 1000]  # of ``--recursions``
SAMPLES = (64, 2048)
OF_TREES = ("validate", "plan", "info", "inverse", "simulate", "kinematics", "statics")
OF_WINDOWS = ("validate", "plan", "info", "assemble", "kinematics", "statics", "simulate", "deploy")
MOMENTS = (("xx", 0, 0), ("yy", 1, 1), ("zz", 2, 2), ("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2))
SHORT = {
    "inverse": "inverse: {samples: 101}",
    "simulate": "simulate: {duration: 0.05, samples: 6}",
    "statics": "statics: {find: hold}",
}


def tree(n: int, command: str, chain: bool) -> str:
    """Return the scene of an open chain, or of a tree in which a third of the links hang on one further in."""
    rng = np.random.default_rng(n)
    joints, links, names = [], [], [f"j{k}" for k in range(n)]
    for k in range(n):
        parent = k - 1 if chain or rng.uniform() > 0.3 else int(rng.integers(-1, k))
        kind = "revolute" if rng.uniform() < 0.8 else "prismatic"
        axis, xyz, rpy = rng.normal(size=3), rng.uniform(-0.3, 0.3, 3), rng.uniform(-1, 1, 3)
        joints.append(
            f"    - {{name: j{k}, type: {kind}, parent: {f'l{parent}' if parent >= 0 else 'base'}, link: l{k}, "
            f"axis: {_row(axis / np.linalg.norm(axis))}, origin: {{xyz: {_row(xyz)}, rpy: {_row(rpy)}}}}}"
        )
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        moments = turn @ np.diag(rng.uniform(0.010, 0.019, 3)) @ turn.T
        inertia = ", ".join(f"{name}: {moments[i, j]:.9f}" for name, i, j in MOMENTS)
        links.append(
            f"    - {{name: l{k}, mass: {rng.uniform(0.5, 2):.6f}, com: {_row(rng.uniform(-0.1, 0.1, 3))}, "
            f"inertia: {{{inertia}}}}}"
        )
    zeros, ones = (f"{{{', '.join(f'{name}: {x}' for name in names)}}}" for x in (0.1, 0.5))
    motion = f"trajectory: {{type: quintic, points: [{{t: 0, q: {zeros}}}, {{t: 1, q: {ones}}}]}}"
    lines = ["schema: 1", "gravity: [0, 0, -9.81]", "robot:", "  joints:", *joints, "  links:", *links]
    if command in ("inverse", "kinematics"):
        lines += [motion]
    else:
        lines += [f"initial: {{q: {zeros}}}"]
    if command == "statics":
        lines += [f"actuated: [{', '.join(names)}]"]
    return "\n".join([*lines, SHORT.get(command, ""), ""])


def windows(n: int, command: str) -> str:
    """Return the N-four-bar of n windows: legs on the ground and bars between their ends, driven at the first leg."""
    joints, links, points, loops, q = [], [], [], [], []
    rod = "mass: 1, com: [0.5, 0, 0], inertia: {zz: 1/12}"
    for k in range(n + 1):
        joints.append(f"    - {{name: leg{k}, type: revolute, parent: base, link: L{k}, "
                      f"origin: {{xyz: [{k}, 0, 0]}}, axis: [0, 0, 1]}}")  # fmt: skip
        links.append(f"    - {{name: L{k}, {rod}}}")
        points.append(f"    T{k}: {{link: L{k}, at: [1, 0, 0]}}")
        q.append(f"leg{k}: 70 deg")
        if k < n:
            joints.append(f"    - {{name: bar{k}, type: revolute, parent: L{k}, link: C{k}, "
                          f"origin: {{xyz: [1, 0, 0]}}, axis: [0, 0, 1]}}")  # fmt: skip
            links.append(f"    - {{name: C{k}, {rod}}}")
            points.append(f"    R{k}: {{link: C{k}, at: [1, 0, 0]}}")
            q.append(f"bar{k}: -70 deg")
            loops.append(f"  - {{name: window{k}, type: revolute, between: [R{k}, T{k + 1}]}}")
    own = {
        **SHORT,
        "kinematics": "kinematics: {sweep: {joint: leg0, start: 70 deg, stop: 100 deg, rate: 1}}",
        "deploy": "torques: {leg0: 4}\nsimulate: {duration: 0.5, samples: 51}\n"
        "deploy: {latch: {between: [L0, C0]}}",
    }.get(command, "")
    return "\n".join([
        "schema: 1", "gravity: [0, -9.81, 0]", "robot:", "  joints:", *joints, "  links:", *links,
        "  points:", *points, "loops:", *loops, "actuated: [leg0]",
        f"initial: {{q: {{{', '.join(q)}}}, hold: [leg0]}}", own, "",
    ])  # fmt: skip


def scene(kind: str, n: int, command: str) -> str:
    return windows(n, command) if kind == "windows" else tree(n, command, kind == "chain")


def _row(x: Any) -> str:
    return f"[{', '.join(f'{v:.9f}' for v in x)}]"


def cost(text: str, command: str, most: float) -> tuple[float, float, str]:
    """Return seconds of the processor, megabytes, and what went wrong (empty where nothing did)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.yaml"
        path.write_text(text)
        words = [sys.executable, "-m", "robodyn_cli", command, str(path)]
        if command not in ("validate", "plan", "info"):
            words += ["--no-plots", "--out", f"{folder}/out"]
        environment = {**os.environ, "ROBODYN_CACHE": f"{folder}/cache", "PYTHONPATH": str(measure.ROOT)}
        with open(f"{folder}/said", "w+") as said:
            process = subprocess.Popen(
                words, stdout=subprocess.DEVNULL, stderr=said, env=environment,
                preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (int(most), int(most) + 5)),
            )  # fmt: skip
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            said.seek(0)
            errors = [line for line in said.read().splitlines() if "error" in line]
    # a mechanism that does not lock in time is as good a run of deploy
    done = (0, 1) if command == "deploy" else (0,)
    wrong = "" if process.returncode in done else f"exit {process.returncode} {' '.join(errors)[:100]}"
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, wrong


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--commands", nargs="*", default=[])
    parser.add_argument("--kinds", nargs="*", default=["chain", "tree", "windows"])
    parser.add_argument("--sizes", nargs="*", type=int, default=[])
    parser.add_argument("--most", type=float, default=120.0, help="seconds a process may take")
    parser.add_argument("--recursions", action="store_true")
    parser.add_argument("--scene", nargs="*", help="KIND N [COMMAND]: print a scene")
    options = measure.with_repeats(parser)
    if options.scene:
        kind, n, *command = options.scene
        print(scene(kind, int(n), command[0] if command else "info"))
        return
    measure.print_machine()
    sizes = options.sizes or ([2, 4] if options.quick else [])
    with measure.reporting(options.json) as report:
        if options.recursions:
            report.rows += recursions(sizes or JOINTS)
            return
        floor = cost(scene("chain", 2, "validate"), "validate", options.most)[:2]
        for kind in options.kinds:
            for command in OF_WINDOWS if kind == "windows" else OF_TREES:
                if options.commands and command not in options.commands:
                    continue
                with report.part(f"{kind} {command}"):
                    chosen = sizes or (WINDOWS if kind == "windows" else SIZES)
                    report.rows.append(over_sizes(kind, command, chosen, options, floor))


def over_sizes(
    kind: str, command: str, sizes: Any, options: argparse.Namespace, floor: tuple[float, float]
) -> dict[str, Any]:
    """Return the costs of a command over sizes, up to the first at which something goes wrong; print them.

    floor : seconds and megabytes of a process that does nothing.
    """
    row: dict[str, Any] = {"kind": kind, "command": command, "seconds": {}, "megabytes": {}, "wrong": {}}
    row["range"] = {}
    spreads: dict[str, list[str]] = {"seconds": [], "megabytes": []}
    for n in sizes:
        text = scene(kind, n, command)
        found = measure.repeated(
            f"{kind} {command} {n}",
            lambda text=text: cost(text, command, options.most),
            lambda one: one[0],
            options.repeats,
        )
        seconds, memory = (measure.Spread.of([one[k] for one in found]) for k in (0, 1))
        row["seconds"][n], row["megabytes"][n] = round(seconds.middle, 2), round(memory.middle)
        row["range"][n] = [round(seconds.least, 2), round(seconds.most, 2)]
        wrong = "!" * bool(found[-1][2])
        spreads["seconds"].append(seconds.told(".2f") + wrong)
        spreads["megabytes"].append(memory.told(".0f") + wrong)
        if wrong:
            row["wrong"][n] = found[-1][2]
            break
    good = [n for n in row["seconds"] if n not in row["wrong"]]
    row["exponent"] = exponent(row["seconds"], good, floor[0], 0.1)
    row["exponent_of_memory"] = exponent(row["megabytes"], good, floor[1], 5.0)
    for unit, slope in (("seconds", "exponent"), ("megabytes", "exponent_of_memory")):
        cells = [*spreads[unit], *["-"] * (len(sizes) - len(spreads[unit]))]
        print(f"{kind} {command}, {unit}:", ", ".join(cells) + f"; exponent {row[slope]}", flush=True)
    print(*row["wrong"].values(), sep="\n", end="\n" if row["wrong"] else "", flush=True)
    return row


def recursions(sizes: list[int]) -> list[dict[str, Any]]:
    """Measure inverse (RNEA) and forward dynamics (ABA) of chains by loops over their bodies; print each row."""
    from robodyn_cli import load_scene_text
    from robodyn_cli.kernels.rolled.kernels import RolledForwardDynamics, RolledInverseDynamics
    from robodyn_cli.model.build import build_model

    texts = {n: tree(n, "simulate", chain=True).replace("prismatic", "revolute") for n in sizes}
    models = {n: build_model(load_scene_text(text)) for n, text in texts.items()}
    rows = []
    for name, kernel in (("RNEA", RolledInverseDynamics), ("ABA", RolledForwardDynamics)):
        for samples in SAMPLES:
            found = {n: microseconds(kernel(models[n]), n, samples) for n in sizes}
            slope = float(np.polyfit(np.log(list(found)), np.log(list(found.values())), 1)[0])
            rows.append({"recursion": name, "samples": samples, "us": found, "exponent": round(slope, 2)})
            cells = [f"{n} joints {us:.2f} us" for n, us in found.items()]
            print(f"{name} of {samples} samples:", ", ".join(cells), f"; exponent {slope:.2f}", flush=True)
    return rows


def microseconds(call: Any, joints: int, samples: int) -> float:
    """Return the least time of a call, by sample [us of the processor]."""
    rng = np.random.default_rng(joints)
    q, v, x = (np.asfortranarray(rng.uniform(-1, 1, (samples, joints))) for _ in range(3))
    call(q, v, x)
    times, begun = [], time.process_time()
    while time.process_time() - begun < 1.0:
        start = time.process_time()
        call(q, v, x)
        times.append(time.process_time() - start)
    return 1e6 * min(times) / samples


def exponent(costs: dict[int, float], sizes: list[int], floor: float, least: float) -> str:
    """Return the slope between the two largest sizes, where they cost more by ``least`` than starting does."""
    if len(sizes) < 2:
        return "-"
    a, b = sizes[-2:]
    low, high = costs[a] - floor, costs[b] - floor
    return f"{math.log(high / low) / math.log(b / a):.2f}" if min(low, high) > least else "-"


if __name__ == "__main__":
    main()
