"""``statics`` for many runs: what runs side by side and the command say is the same, errors too; what is doubtful is left
to the command."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import Mechanism, load_scene, statics
from robodyn_cli.over.many.keys import value_of
from robodyn_cli.over.study.rows import Points, RunRows, Task
from robodyn_cli.over.study.runs import Compiled, beyond, make_one, suits
from robodyn_cli.scene.load import Family
from tests.many import compare_all, numbers_of
from tests.mechanisms import CONFIGS

SPRUNG = CONFIGS / "mechanisms" / "balanced_four_bar.yaml"
PENDULUM = CONFIGS / "double_pendulum.yaml"
AT_REST = ("expect={}", "command=statics")


def made(asked: Task, values: np.ndarray) -> RunRows:
    assert suits(asked)
    return Compiled(asked, 1).make(Points(np.arange(len(values)), values))


@pytest.mark.parametrize(
    ("path", "changes", "keys"),
    [
        (SPRUNG, (), ("robot.links.bar.mass", "robot.joints.crank.spring.stiffness")),
        (SPRUNG, ("initial.hold=[]",), ("robot.joints.coupler.a", "robot.joints.rocker.a")),
        (SPRUNG, ("initial.hold=[crank]",), ("robot.joints.coupler.a", "initial.q.crank")),
        (SPRUNG, ("statics.find=hold", "actuated=[crank]"), ("robot.joints.coupler.a", "initial.q.crank")),
        (SPRUNG, ("statics.find=hold",), ("robot.links.bar.com#1",)),
        (PENDULUM, ("initial.hold=[theta1]",), ("robot.links.link2.mass", "initial.q.theta1")),
        (CONFIGS / "benchmarks" / "andrews.yaml", (), ("robot.links.body3.mass",)),
    ],
)  # fmt: skip
def test_every_figure_is_that_of_the_command(
    path: Path, changes: tuple[str, ...], keys: tuple[str, ...]
) -> None:
    family = Family(path, (*AT_REST, *changes))
    told = compare_all(Task(family, "statics", keys, ()), 3)
    assert {"configuration", "torques_of_joints", "error_estimate", "equilibrium"} <= {
        k.partition(".")[0] for k in told
    }


def chain(rng: np.random.Generator) -> tuple[str, list[str]]:
    """Return a random chain of hinges and slides with weights, springs and torques, closed or open, and keys of it."""
    n, find = int(rng.integers(1, 5)), str(rng.choice(["balance", "balance", "hold"]))
    text = "schema: 1\nparameters: {push: 1.5}\ngravity: [0, -9.81, 0]\nrobot:\n  joints:\n"
    keys, links = ["parameters.push"], "  links:\n"
    for k in range(n):
        slides = k > 0 and rng.random() < 0.25
        kind, axis = ("prismatic", "[1, 0, 0]") if slides else ("revolute", "[0, 0, 1]")
        spring = f"{{stiffness: {rng.uniform(5, 200):.3f}, rest: {rng.uniform(-0.3, 0.3):.3f}}}"
        place = f"origin: {{xyz: [{0.5 if k else 0}, 0, 0]}}"
        text += f"    - {{name: j{k}, type: {kind}, axis: {axis}, {place}, spring: {spring}}}\n"
        com = f"[0.25, {rng.uniform(-0.1, 0.1):.3f}, 0]"
        links += f"    - {{name: l{k}, mass: {rng.uniform(0.5, 3):.3f}, com: {com}, inertia: {{zz: 0.1}}}}\n"
        keys += [f"robot.joints.j{k}.spring.stiffness", f"robot.links.l{k}.mass", f"initial.q.j{k}"]
    keys += [f"robot.joints.j{k}.origin.xyz#1" for k in range(1, n)]
    start = ", ".join(f"j{k}: {rng.uniform(-0.4, 0.4):.3f}" for k in range(n))
    text += f"{links}initial: {{q: {{{start}}}}}\ntorques: {{j0: 'push * cos(q.j0)'}}\nstatics: {{find: {find}}}\n"
    if rng.random() < 0.5:
        ends = f"[base.origin, l{n - 1}.com]"
        text += f"forces: [{{name: rope, type: spring, between: {ends}, stiffness: 30, length: 0.2}}]\n"
        keys.append("forces.rope.stiffness")
    if n > 2 and rng.random() < 0.5:
        text += f"loops: [{{name: bar, type: distance, between: [base.origin, l{n - 1}.com], length: 0.9}}]\n"
        keys.append("loops.bar.length")
    if rng.random() < 0.5:
        text += "outputs: {reactions: true}\n"
    return text, [str(key) for key in rng.choice(keys, size=min(3, len(keys)), replace=False)]


@pytest.mark.parametrize("seed", range(16))
def test_random_scenes(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    text, keys = chain(rng)
    path = tmp_path / "chain.yaml"
    path.write_text(text)
    family = Family(path, ("command=statics",))
    own = np.array([value_of(family, key) for key in keys], dtype=float)
    values = own * (1.0 + rng.uniform(-0.1, 0.1, (6, len(own))))
    _, summary = make_one(Task(family, "statics", (), ()), 0, np.empty(0))
    asked = Task(family, "statics", tuple(keys), tuple(numbers_of(summary)))
    asked = dataclasses.replace(asked, outputs=tuple(x for x in asked.outputs if x not in beyond(asked)))
    rows = made(asked, values)
    assert len(rows) or make_one(asked, 0, values[0])[0].rows["code"][0], text
    for run, row in zip(rows.runs.tolist(), rows.rows):
        one = make_one(asked, run, values[run])[0].rows[0]
        assert one["code"] == row["code"] == 0
        np.testing.assert_allclose(row["outputs"], one["outputs"], rtol=1e-9, atol=1e-9, err_msg=text)
        assert (np.isnan(row["errors"]) == np.isnan(one["errors"])).all()


@pytest.mark.parametrize("start", ["90 deg", "89.9999999 deg"])
def test_a_start_that_rounding_may_take_for_a_balance_is_left_to_the_command(start: str) -> None:
    changes = (*AT_REST, f"initial.q={{theta1: {start}, theta2: 0}}")
    asked = Task(Family(PENDULUM, changes), "statics", ("robot.links.link1.mass",), ("configuration.theta1",))
    assert not len(made(asked, np.array([[11.0], [12.0]])))


def test_what_finds_no_balance_is_left_to_the_command() -> None:
    """A torque beyond the largest moment of the weight."""
    changes = (*AT_REST, "torques={theta1: push}", "parameters={push: 1}", "initial.hold=[theta2]")
    asked = Task(Family(PENDULUM, changes), "statics", ("parameters.push",), ("configuration.theta1",))
    rows = made(asked, np.array([[1.0], [1e4], [2.0]]))
    assert rows.runs.tolist() == [0, 2]
    assert make_one(asked, 1, np.array([1e4]))[0].rows["code"][0] == 3


@pytest.mark.parametrize(("word", "count"), [("stable", 3), ("unstable", 0)])
def test_words_that_a_scene_expects_are_those_of_each_run(word: str, count: int) -> None:
    family = Family(SPRUNG, (f"expect={{equilibrium.stability: {word}}}",))
    asked = Task(family, "statics", ("robot.links.bar.mass",), ("configuration.crank",))
    rows = made(asked, np.array([[2.5], [3.0], [3.5]]))
    assert len(rows) == 3 and rows.rows["holds"].sum() == count
    held = Family(SPRUNG, ("statics.find=hold", "expect={equilibrium.stability: stable}"))
    assert not len(
        made(dataclasses.replace(asked, family=held), np.array([[2.5]]))
    )  # says nothing of stability


def test_mechanism_finds_balances() -> None:
    mechanism = Mechanism(SPRUNG, vary=["robot.links.bar.mass"])
    runs = mechanism.statics_many({"robot.links.bar.mass": [2.0, 3.0]}, of=["equilibrium.stiffness.0"])
    one = statics(load_scene(SPRUNG, ["robot.links.bar.mass=2"]))
    assert runs.ok.all() and not runs.one_by_one.any()
    np.testing.assert_allclose(runs.q[0], one["q"][0], atol=1e-12)
    assert runs.outputs["equilibrium.stiffness.0"][0] == pytest.approx(
        one.summary["equilibrium"]["stiffness"][0]
    )
    moved = mechanism.statics_many({"robot.links.bar.mass": [2.0]}, q=runs.q[:1])
    np.testing.assert_allclose(moved.q, runs.q[:1], atol=1e-12)
