"""Exact sensitivities of random scenes against central differences: ``python -m tests.proof.sensitivities``.

A seed gives a mechanism of ``tests.proof.families``, a command, some of its numbers as keys, and some outputs. Where the
derivative is exact, it and the extrapolated difference of ten runs may differ by no more than both say.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import json
import math
import time

import numpy as np

from robodyn_cli.errors import RobodynError
from robodyn_cli.model.build import build_model
from robodyn_cli.model.places import numbers_at_places
from robodyn_cli.over.sensitivity.asked import AskedSlopes, prepare
from robodyn_cli.over.sensitivity.differences import differences
from robodyn_cli.over.sensitivity.report import exact_slopes
from robodyn_cli.scene.load import Family, load_scene_text
from robodyn_cli.scene.types import Scene
from tests.proof import families

KEYS, OUTPUTS = 4, 5
KNOWN = 1e-4  # relative error of a difference above which it proves nothing
FACTOR = 10.0  # by which both errors together may be exceeded: they are estimates
COMMANDS = ("simulate", "simulate", "inverse", "kinematics", "statics")


@dataclasses.dataclass
class Finding:
    """One derivative of a scene, found both ways."""

    seed: int
    command: str
    family: str
    key: str
    output: str
    exact: float
    error: float
    difference: float
    difference_error: float
    verdict: str


def _settings(command: str, scene: Scene, rng: np.random.Generator) -> list[str]:
    """Return the options that turn a scene of ``simulate`` into one of another command."""
    if command == "simulate":
        return [
            "simulate.rtol=1e-11",
            "simulate.atol=1e-13",
            f"simulate.duration={rng.uniform(0.2, 0.6):.3f}",
        ]
    if command == "statics":
        return ["command=statics", "expect=null", f"statics.find={rng.choice(['hold', 'balance'])}"]
    names = [joint.name for joint in scene.robot.joints if joint.type in ("revolute", "prismatic", "helical")]
    led = list(scene.initial.hold) or names if scene.loops or scene.couplers else names
    starts = {name: scene.initial.q.get(name, 0.1) for name in led if name not in scene.prescribed}
    waves = ", ".join(
        f"{name}: '{q} + {rng.uniform(0.05, 0.2):.3f}*sin({rng.uniform(1, 4):.3f}*t)'"
        for name, q in starts.items()
    )
    settings = [
        f"command={command}",
        "expect=null",
        "torques={}",
        "inverse.samples=31",
        "kinematics.samples=31",
    ]
    return [*settings, f"trajectory={{type: joint, duration: 0.7, q: {{{waves}}}}}"] if starts else settings


def _outputs(command: str, scene: Scene, rng: np.random.Generator) -> list[str]:
    model = build_model(scene)
    v, q = model.v_names, model.q_names
    found = {
        "simulate": [*(f"final.q.{n}" for n in q), *(f"final.qd.{n}" for n in v)]
        + [
            f"extremes.{path}.{n}.{which}"
            for path, own in (("q", q), ("qd", v), ("qdd", v))
            for n in own
            for which in ("smallest", "largest", "final")
        ],
        "inverse": [f"{f}.{n}" for n in v for f in ("peak_torque", "rms_torque", "peak_speed")]
        + [f"joints.{n}.{f}" for n in v for f in ("energy", "energy_net", "torque_range.0")],
        "kinematics": [f"joints.{n}.{f}" for n in v for f in ("peak_speed", "peak_acceleration")]
        + [f"joints.{n}.{f}" for n in q for f in ("smallest", "largest")],
        "statics": [*(f"configuration.{n}" for n in q), *(f"torques_of_joints.{n}" for n in v)],
    }[command]
    return [str(x) for x in rng.permutation(found)[:OUTPUTS]]


def make(seed: int) -> tuple[str, AskedSlopes]:
    """Return the family and the question of a seed.

    Raises
    ------
    RobodynError : the scene is none of the command, or fails.
    """
    family, mechanism, rng = families.make(seed)
    command = str(rng.choice(COMMANDS))
    text = mechanism.scene()
    scene = load_scene_text(text)
    scene = load_scene_text(text, overrides=_settings(command, scene, rng))
    places = [place for place in numbers_at_places(scene) if "#" not in place and ".forces." not in place]
    keys = [str(x) for x in rng.permutation(places)[:KEYS]]
    return family, prepare(Family.of(scene), keys, _outputs(command, scene, rng))


def try_seed(seed: int) -> list[Finding]:
    """Return what both ways give for one scene."""
    try:
        family, asked = make(seed)
    except RobodynError:
        return []
    exact, why = exact_slopes(asked)
    others = differences(asked, sorted({k for _, k in exact}), 1)
    found = []
    for (output, k), slope in exact.items():
        other = others[k][asked.task.outputs.index(output)]
        verdict = _verdict(slope.value, slope.error, other.value, other.error)
        found.append(
            Finding(seed, asked.task.command, family, asked.task.keys[k], output, slope.value, slope.error,
                    other.value, other.error, verdict)
        )  # fmt: skip
    found += [Finding(seed, asked.task.command, family, asked.task.keys[k], "", math.nan, math.nan, math.nan,
                      math.nan, f"none: {reason}") for k, reason in why.items()]  # fmt: skip
    return found


def _verdict(exact: float, error: float, other: float, other_error: float) -> str:
    if not other_error <= KNOWN * max(abs(other), 1e-6):
        return "unknown" if abs(exact - other) > other_error else "agree"
    apart = abs(exact - other)
    if not apart <= FACTOR * (error + other_error) + 1e-12:
        return "differ"
    return "agree"


def main() -> int:
    """Run for some time and print what differs; return 1 where anything does."""
    parser = argparse.ArgumentParser(prog="python -m tests.proof.sensitivities", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scenes", type=int, default=10**9)
    parser.add_argument("--seconds", type=float, default=60.0)
    arguments = parser.parse_args()
    end, counts, worst = time.monotonic() + arguments.seconds, collections.Counter[str](), 0.0
    for seed in range(arguments.seed, arguments.seed + arguments.scenes):
        if time.monotonic() > end:
            break
        try:
            found = try_seed(seed)
        except Exception as error:
            found = [
                Finding(seed, "", "", "", "", 0.0, 0.0, 0.0, 0.0, f"crash {type(error).__name__}: {error}")
            ]
        for one in found:
            counts[f"{one.command} {one.verdict[:60]}"] += 1
            if one.verdict == "agree" and (known := one.error + one.difference_error) > 0.0:
                worst = max(worst, abs(one.exact - one.difference) / known)
            if one.verdict.startswith(("differ", "crash")):
                print(json.dumps(dataclasses.asdict(one)), flush=True)
    for name, count in sorted(counts.items()):
        print(f"{count:6} {name}")
    print(f"difference of both over the errors of both: at most {worst:.2g}")
    return int(any(name.endswith("differ") or "crash" in name for name in counts))


if __name__ == "__main__":
    raise SystemExit(main())
