"""Keys of numbers as they are written (``KEY#n``) with units behind them: ways of studies, derivatives, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.over.c99.asked_keys import asked_key
from robodyn_cli.over.c99.keys import parametrised
from robodyn_cli.over.many.keys import NUMBER, OPTION, START, understand
from robodyn_cli.over.sensitivity.asked import prepare
from robodyn_cli.over.sensitivity.report import exact_slopes
from robodyn_cli.over.study.rows import Points, Task
from robodyn_cli.over.study.runs import Compiled, make_one
from robodyn_cli.scene.load import Family, load_scene_text

TEXT = """
schema: 1
command: simulate
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1], spring: {stiffness: 0.2 N m/deg, rest: -10 deg}}
    - {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [500 mm, 0, 0]}}
  links:
    - {name: l1, mass: 800 gram, com: [250 mm, 0, 0], inertia: {zz: 3 kg cm^2}}
    - {name: l2, mass: 1, com: [0.3, 0, 0], inertia: {zz: 0.01}}
initial: {q: {a: 20 deg, b: 30 deg}}
simulate: {duration: 500 ms, samples: 11}
torques: {b: "30 N mm * sin(a)"}
"""
SCALES = {
    "robot.joints.a.spring.stiffness#1": (NUMBER, 180.0 / np.pi, 0.2),
    "robot.joints.a.spring.rest#1": (NUMBER, -np.pi / 180.0, 10.0),
    "robot.joints.b.origin.xyz#1": (NUMBER, 1e-3, 500.0),
    "robot.links.l1.mass#1": (NUMBER, 1e-3, 800.0),
    "robot.links.l1.inertia.zz#1": (NUMBER, 1e-4, 3.0),
    "torques.b#1": (NUMBER, 1e-3, 30.0),
    "initial.q.a#1": (START, np.pi / 180.0, 20.0),
    "simulate.duration#1": (OPTION, 1e-3, 500.0),
}


def family() -> Family:
    return Family.of(load_scene_text(TEXT))


def test_a_number_with_a_unit_behind_it_is_a_number_of_the_equations() -> None:
    for name, (sort, scale, _) in SCALES.items():
        key = understand(family(), name)
        assert (key.sort, key.scale) == (sort, pytest.approx(scale, rel=1e-14)), name


def test_runs_of_written_numbers_are_those_of_whole_commands() -> None:
    task = Task(family(), "simulate", tuple(SCALES), ("final.q.a", "final.qd.b"))
    values = np.array([[0.9, 1.05], [1.1, 0.97]])[:, np.arange(len(SCALES)) % 2] * [
        x for *_, x in SCALES.values()
    ]
    compiled = Compiled(task, 1)
    made = compiled.make(Points(np.arange(2), values))
    assert len(made) == 2 and not compiled.left
    for run, row in zip(made.runs.tolist(), made.rows):
        alone = make_one(task, run, values[run])[0].rows[0]
        np.testing.assert_allclose(row["outputs"], alone["outputs"], rtol=1e-10)


def test_derivatives_by_written_numbers_are_those_by_keys_times_their_units() -> None:
    names = [name for name in SCALES if name not in ("torques.b#1", "simulate.duration#1")]
    plain = [name.partition("#")[0] + (".0" if "xyz" in name else "") for name in names]
    written, si = (exact_slopes(prepare(family(), keys, ["final.q.b"]))[0] for keys in (names, plain))
    for k, name in enumerate(names):
        expected = SCALES[name][1] * si["final.q.b", k].value
        assert written["final.q.b", k].value == pytest.approx(expected, rel=1e-9), name


def test_a_unit_is_not_doubled() -> None:
    for value in ("450 mm", "2 m", "(3 mm)"):
        with pytest.raises(SceneError, match="with its unit behind it .* allowed: a number, in mm"):
            load_scene_text(TEXT, overrides=[f"robot.joints.b.origin.xyz#1={value}"])
    load_scene_text(TEXT, overrides=["robot.links.l2.mass#1=900 gram"])


def test_bounds_of_exported_keys_take_units() -> None:
    one = asked_key("robot.links.l1.mass=700 gram:0.9 kg")
    assert (one.low, one.high, one.unit) == (0.7, 0.9, "kg")
    written = parametrised(family(), [asked_key("robot.joints.b.origin.xyz#1=400:600")]).keys[0]
    assert (written.low, written.high) == pytest.approx((0.4, 0.6), rel=1e-14)
    for wrong in ("400 mm:600 kg", "a:b", "1", "2:1"):
        with pytest.raises(CapabilityError, match="LOW:HIGH"):
            asked_key(f"robot.links.l1.mass={wrong}")
    with pytest.raises(SceneError, match="mass in kg expected"):
        parametrised(family(), [asked_key("robot.links.l1.mass=700 mm:900 mm")])
