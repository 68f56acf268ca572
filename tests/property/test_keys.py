"""One grammar of keys: whatever number a scene writes, each option that takes a key addresses it alike."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.over.commands import execute
from robodyn_cli.over.many.keys import setting
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.over.sensitivity.report import sensitivity
from robodyn_cli.scene.load import NO_FILE, Family, load_scene_text
from robodyn_cli.scene.text.nodes import dotted
from robodyn_cli.scene.text.numbers import WrittenNumber, numbers_in
from robodyn_cli.scene.types import Scene
from robodyn_cli.scene.units import refuse_doubles, unit_of, written_number
from robodyn_cli.schema.fields import Section
from robodyn_cli.tools.progress import Stopwatch, no_progress

CONFIGS = Path(__file__).parents[2] / "configs"
EXAMPLES = sorted(path for path in CONFIGS.rglob("*.yaml") if "command:" in path.read_text())
SEEDS = range(4)  # half of them simulations
TRIED = 3  # numbers of a scene that are run
MOST = 60  # numbers of a scene that are set, each of which reads the scene again
# of which no figure depends, or whose keys have dots in them
FIXED = ("schema", "simulate.samples", "inverse.samples", "study", "expect", "search")
HELD = 1e-6  # relative, of a derivative against a difference of runs with steps of 1e-4


def random_scene(seed: int) -> str:
    """Return a short arm that is simulated, or moved along a trajectory, with numbers of every kind in it."""
    rng = np.random.default_rng(seed)

    def x(low: float = 0.2, high: float = 2.0) -> float:
        return round(float(rng.uniform(low, high)), 4)

    joints, links = [], []
    for k, kind in enumerate(["revolute", rng.choice(["revolute", "prismatic"])]):
        origin = f"{{xyz: [{x()}, {x()}, {x()}], rpy: [{x()}, {math.degrees(x()):.3f} deg, pi/{k + 3}]}}"
        spring = f"spring: {{stiffness: {x(1, 9)}, rest: {x(-0.3, 0.3)}}}, damper: {{damping: {x()}}}"
        joints.append(
            f"    - {{name: j{k}, type: {kind}, axis: [{x()}, {x()}, {x()}], origin: {origin}, {spring}}}"
        )
        inertia = ", ".join(f"{axis}: {x(1, 1.5)}" for axis in ("xx", "yy", "zz"))
        links.append(
            f"    - {{name: l{k}, mass: {x(1, 4)}, com: [{x(-0.2)}, {x()}, {x()}], inertia: {{{inertia}}}}}"
        )
    if seed % 2:
        run = f"""command: inverse
trajectory: {{type: joint, duration: {x(0.5, 1)}, q: {{j0: {x()}*sin({x(1, 3)}*t), j1: "{x()} + {x()}*t^2"}}}}
inverse: {{samples: 21}}"""
    else:
        run = f"""command: simulate
parameters: {{k: {x()}}}
torques: {{j0: "k*sin({x(1, 3)}*t) - {x()}*q.j0", j1: {x()}}}
initial: {{q: {{j0: {x(5, 30)} deg, j1: {x(-0.2, 0.2)}}}, qd: {{j0: {x()}, j1: {x()}}}}}
simulate: {{duration: {x(0.3, 0.5)}, samples: 3}}"""
    lines = [
        "schema: 1",
        f"gravity: [0, {x()}, -9.81]",
        "robot:",
        "  joints:",
        *joints,
        "  links:",
        *links,
        run,
    ]
    return "\n".join(lines) + "\n"


def family_of(seed: int) -> Family:
    return Family.of(load_scene_text(random_scene(seed)))


def keys_of(family: Family) -> list[tuple[str, WrittenNumber]]:
    """Return the keys of all numbers that a scene writes: of those in formulas and constants with their count."""
    found, counts = [], {}
    for number in numbers_in(family.root, Section(Scene)):
        key = dotted(number.path)
        if key.startswith(FIXED):  # their keys have dots in them
            continue
        counts[key] = counts.get(key, 0) + 1
        found.append((f"{key}#{counts[key]}" if number.inside else key, number))
    return found


def bare(scene: Scene) -> Scene:
    """Return a scene without the text that it was read from."""
    return dataclasses.replace(scene, text="", sources=(), path="", notes=(), warnings=())


def check_numbers(family: Family) -> None:
    """Fail unless numbers of a scene are addressed by their keys: all, or, of a large one, some in the same order."""
    found = keys_of(family)
    assert found
    for key, number in found[:: -(-len(found) // MOST)]:
        assert bare(family.scene([setting(key, number.value)])) == bare(family.own), key
        base = key.partition("#")[0]
        written = written_number(family.root, key if number.inside else f"{key}#1")
        assert written is not None and written.value == number.value, key
        assert number.inside or unit_of(family.root, f"{base}#1") == unit_of(family.root, base)
        with pytest.raises(SceneError, match="given twice"):
            refuse_doubles(family.root, [base, f"{base}#1"], "--to")


@pytest.mark.parametrize("seed", SEEDS)
def test_every_number_is_addressed_and_stays_when_it_is_set_to_itself(seed: int) -> None:
    check_numbers(family_of(seed))


@pytest.mark.parametrize("path", EXAMPLES[::8], ids=lambda path: path.stem)
def test_every_number_of_example_scenes_is_addressed(path: Path) -> None:
    check_numbers(Family(path))


def chosen(seed: int) -> list[tuple[str, float]]:
    """Return some numbers that a run depends on, those in formulas among them, with their values."""
    every = [(key, n) for key, n in keys_of(family_of(seed)) if not key.startswith(FIXED)]
    inside = [item for item in every if item[1].inside]
    rng = np.random.default_rng(seed)
    some = [every[k] for k in rng.choice(len(every), TRIED - 1, replace=False)]
    return [(key, n.value) for key, n in dict([*some, inside[seed % len(inside)]]).items()]


def outputs_of(scene: Scene) -> list[str]:
    return ["rms_torque.j0"] if scene.command == "inverse" else ["final.q.j0"]


def run_with(family: Family, key: str, value: float) -> Any:
    result = execute(family.own.command, family.scene([setting(key, value)]), no_progress, Stopwatch())
    if family.own.command == "inverse":
        return result.summary["joints"]["j0"]["rms_torque"]
    return result.summary["final"]["q"]["j0"]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_key_that_varies_gives_what_setting_it_gives(seed: int) -> None:
    family = family_of(seed)
    (of,) = outputs_of(family.own)
    for key, value in chosen(seed):
        values = [value, 1.003 * value + 1e-4]
        mechanism = Mechanism(load_scene_text(random_scene(seed)), vary=[key])
        many = mechanism.inverse_many if family.own.command == "inverse" else mechanism.simulate_many
        runs = many({key: np.array(values)}, of=[of])
        assert runs.ok.all(), (key, runs.reason)
        own = [run_with(family, key, x) for x in values]
        assert runs.outputs[of] == pytest.approx(own, rel=1e-8, abs=1e-9), key


@pytest.mark.parametrize("seed", SEEDS)
def test_derivatives_are_slopes_of_runs_or_say_why_not(seed: int) -> None:
    family = family_of(seed)
    of = outputs_of(family.own)
    some = chosen(seed)
    found = sensitivity(family, [key for key, _ in some], of).summary["sensitivities"][of[0]]
    for key, value in some:
        slope = found[key]
        if slope["derivative"] is None:
            assert slope["reason"], key
            continue
        step = 1e-4 * (abs(value) or 1.0)
        quotient = (run_with(family, key, value + step) - run_with(family, key, value - step)) / (2.0 * step)
        scale = max(abs(quotient), abs(slope["derivative"]))
        assert slope["derivative"] == pytest.approx(quotient, abs=HELD * scale + 1e-7), key


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("torques.j0#9", "has 2 numbers"),
        ("torqes.j0#1", "has no key 'torqes' (did you mean 'torques'?)"),
        ("torques.j2#1", "has no key 'j2'; allowed: j0, j1"),
        ("robot.links.l7#1", "has no item named 'l7'; allowed: l0, l1"),
        ("simulate.rtol#1", "is not written in the scene"),
        ("command#1", "has no numbers"),
    ],
)
def test_options_refuse_a_key_alike(key: str, message: str) -> None:
    text = random_scene(0)
    refusals = []
    for attempt in (
        lambda: load_scene_text(text, NO_FILE, [f"{key}=1"]),
        lambda: Mechanism(load_scene_text(text), vary=[key]),
        lambda: sensitivity(family_of(0), [key], ["final.q.j0"]),
    ):
        with pytest.raises(SceneError) as caught:
            attempt()
        refusals.append(caught.value.message)
    assert all(message in refusal for refusal in refusals), refusals
