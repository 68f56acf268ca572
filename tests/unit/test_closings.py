"""Latches that compiled code closes: the impulse is that of the general way in Python, and many runs are the command's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from robodyn_cli import Mechanism, load_scene_text
from robodyn_cli.formulations.closings import Closings
from robodyn_cli.over.many import latched
from robodyn_cli.scene.load import load_scene
from robodyn_cli.works.deploy.deploy import deploy
from tests.panels import Panels
from tests.unit.test_latched_many import KEYS, OF, compare, rows, three_panels, written

# single runs are compared with many to the last digits
pytestmark = pytest.mark.usefixtures("lasting_code")

ARRAY = Path("configs/mechanisms/solar_array.yaml")


def satellite() -> dict[str, Any]:
    """A free body with two wings, the second of which has a panel that slides out."""
    spring = {"spring": {"stiffness": 0.4, "rest": 1.0}, "damper": {"damping": 0.05}}
    plain = {"xy": 0, "xz": 0, "yz": 0}
    panel = {"com": [0.5, 0, 0], "inertia": {**plain, "xx": 0.01, "yy": 0.2, "zz": 0.2}}
    hinge = {"type": "revolute", "parent": "bus", "axis": [0, 0, 1], **spring}
    joints = [
        {"name": "free", "type": "floating", "link": "bus"},
        {"name": "left", "link": "wing", "origin": {"xyz": [0.5, 0, 0.1]}, **hinge},
        {"name": "right", "link": "other", "origin": {"xyz": [-0.5, 0, 0]}, **hinge},
        {"name": "slide", "type": "prismatic", "parent": "other", "link": "tip", "axis": [1, 0, 0], **spring},
    ]
    links = [
        {"name": "bus", "mass": 20, "com": [0, 0, 0], "inertia": {**plain, "xx": 2, "yy": 2, "zz": 3}}, {"name": "wing", "mass": 3, **panel},
        {"name": "other", "mass": 2, **panel}, {"name": "tip", "mass": 1, **panel},
    ]  # fmt: skip
    latches = [
        {"name": f"hold_{k}", "joint": k, "at": x} for k, x in (("left", 0.0), ("right", 0.1), ("slide", 0.7))
    ]
    return {
        "schema": 1, "command": "deploy", "gravity": [0, 0, 0], "robot": {"joints": joints, "links": links},
        "initial": {"q": {"free": {"xyz": [0, 0, 0], "rpy": [0, 0, 0]}, "left": -1.5, "right": -1.4, "slide": 0.0},
                    "qd": {"free": {"wx": 0.1, "wz": 0.2}}},
        "simulate": {"duration": 60, "samples": 61}, "deploy": {"latches": latches},
    }  # fmt: skip


def flat(record: Any) -> dict[str, float]:
    """Return the numbers of a tree of records by their keys."""
    if not isinstance(record, dict):
        return {"": float(record)} if isinstance(record, (int, float)) else {}
    return {f"{name}.{key}": x for name, inner in record.items() for key, x in flat(inner).items()}


@pytest.mark.parametrize(
    "tree", [three_panels(), satellite(), Panels.random(np.random.default_rng(8), 6).scene()]
)
def test_the_impulse_is_that_of_the_general_way(
    tree: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene_text(yaml.safe_dump(tree))
    own = deploy(scene)
    monkeypatch.setattr(Closings, "of", staticmethod(lambda problem, layout: None))
    other = deploy(scene)
    assert own.summary["status"] == other.summary["status"] == "locked"
    assert [e["name"] for e in own.events] == [e["name"] for e in other.events]
    for name, lock in own.summary["locks"].items():
        errors, figures, others = lock.pop("errors"), flat(lock), flat(other.summary["locks"][name])
        for key, value in figures.items():
            allowed = 2.0 * errors.get(key.rstrip("."), 0.0) + 1e-12 * abs(value)
            assert abs(value - others[key]) <= allowed, (name, key)
    allowed = 2.0 * own.summary["error_estimate"]["state_max"]
    for path in ("q", "qd"):
        np.testing.assert_allclose(own[path], other[path], rtol=0.0, atol=allowed)
    assert own.summary["energy_drift_relative"] < 1e-9


def test_the_last_impulse_is_the_angular_momentum_of_the_straight_array() -> None:
    """I = sum 0.34 + 4 (k + 1/2)^2 of ten panels about the first hinge."""
    lock = deploy(load_scene(ARRAY)).summary["locks"]["latch1"]
    momentum = (10 * 0.34 + 4.0 * sum((k + 0.5) ** 2 for k in range(10))) * abs(lock["speed"])
    assert lock["order"] == 10 and lock["angular_impulse"] == pytest.approx(momentum, rel=1e-14)


@pytest.mark.parametrize("until", ["all", "end", "latch1"])
def test_runs_in_compiled_code_alone_are_those_of_the_command(
    until: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: Any, k: int) -> None:
        raise AssertionError(f"run {k} goes from event to event in Python")

    monkeypatch.setattr(latched._Runner, "make", refuse)
    tree = three_panels()
    tree["deploy"]["until"] = until
    of = (
        *OF,
        "missed.latch1.nearest",
        "missed.latch1.errors.time",
        "counters.rejected",
        "counters.evaluations",
    )
    compare(written(tree, tmp_path), KEYS, rows(tree, KEYS), of, alone=False)


def test_runs_with_simultaneous_closings_are_made_in_python(tmp_path: Path) -> None:
    """Two arrays that are alike, side by side: their latches close together."""
    tree = satellite()
    robot = tree["robot"]
    robot["joints"] = [
        {**joint, "parent": "base", "origin": {"xyz": [k, 0, 0]}}
        for k, joint in enumerate(robot["joints"][1:3])
    ]
    robot["links"] = [{**robot["links"][1], "name": name} for name in ("wing", "other")]
    tree["initial"] = {"q": {"left": -1.5, "right": -1.5}}
    tree["deploy"]["latches"] = [{"name": f"hold_{k}", "joint": k, "at": 0.0} for k in ("left", "right")]
    summary = deploy(load_scene_text(yaml.safe_dump(tree))).summary
    assert [lock["order"] for lock in summary["locks"].values()] == [1, 1]
    keys, of = (
        ("robot.joints.left.damper.damping",),
        ("locks.hold_left.time", "locks.hold_right.order", "lock.time"),
    )
    compare(written(tree, tmp_path), keys, np.array([[0.05], [0.051]]), of, alone=False)


def test_a_latch_in_its_position_at_the_start_is_left_to_python(tmp_path: Path) -> None:
    tree = three_panels()
    tree["initial"]["q"]["hinge1"] = tree["deploy"]["latches"][1]["at"]
    compare(written(tree, tmp_path), KEYS[:2], rows(tree, KEYS[:2]), OF[:6], alone=False)


def test_bits_do_not_depend_on_threads_or_other_runs(tmp_path: Path) -> None:
    tree = three_panels()
    mechanism, values = Mechanism(written(tree, tmp_path), KEYS[:3]), rows(tree, KEYS[:3])
    one, two = (mechanism.deploy_many(values, of=OF[:6], threads=n) for n in (1, 2))
    alone = mechanism.deploy_many(values[2:3], of=OF[:6], threads=1)
    for key in OF[:6]:
        np.testing.assert_array_equal(one.outputs[key], two.outputs[key])
        np.testing.assert_array_equal(one.outputs[key][2:3], alone.outputs[key])
    np.testing.assert_array_equal(one.q_error, two.q_error)


def test_samples_move_no_closing(tmp_path: Path) -> None:
    """A sample within the step to an event makes that step be taken twice; the event is what was found before."""
    tree, found = three_panels(), []
    few = np.array([tree["robot"]["joints"][0]["spring"]["stiffness"], tree["robot"]["links"][1]["mass"]])
    values, of = (
        few * np.random.default_rng(1).uniform(0.9, 1.1, (40, 2)),
        [f"locks.latch{k}.time" for k in range(3)],
    )
    for tree["simulate"]["samples"] in (2, 601, 2001):
        runs = Mechanism(written(tree, tmp_path), KEYS[:2]).deploy_many(values, of=of)
        assert runs.ok.all() and not runs.one_by_one.any()
        assert max(errors.max() for errors in runs.errors.values()) < 1e-6
        found.append(np.array(list(runs.outputs.values())))
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])
    compare(written(tree, tmp_path), KEYS[:2], values[:2], OF, alone=False)
