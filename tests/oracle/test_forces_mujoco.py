"""Springs between bodies and forces on them, against MuJoCo's tendons and applied forces on random trees."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robodyn_cli.algorithms.kinematics import transforms
from robodyn_cli.equations.elements import Elements
from robodyn_cli.expr.formula import FormulaTree
from robodyn_cli.forces.springs import LinearSpring
from robodyn_cli.forces.wrench import PointWrench
from robodyn_cli.model.model import BASE, Force
from tests.engines import MujocoModel, to_mjcf, to_mujoco
from tests.numeric import assert_close
from tests.oracle.cases import tree

mujoco = pytest.importorskip("mujoco")


@pytest.mark.parametrize(("n", "seed"), [(3, 0), (5, 1), (8, 2), (8, 3)])
def test_a_spring_between_any_two_bodies_is_a_tendon(n: int, seed: int) -> None:
    model, s = tree(n, seed)
    rng = np.random.default_rng(seed)
    pairs = [tuple(int(x) for x in rng.choice(np.arange(BASE, n), 2, replace=False)) for _ in range(3)]
    laws = [tuple(float(x) for x in rng.uniform(0.5, 30.0, size=2)) + (0.7,) for _ in pairs]
    forces, tendons = [], []
    for i, ((a, b), (k, c, length)) in enumerate(zip(pairs, laws)):
        element = LinearSpring(f"s{i}", "spring", ("", ""), stiffness=k, length=length, damping=c)
        forces.append(Force(f"s{i}", element, (model.frames[f"frame{a}"], model.frames[f"frame{b}"])))
        tendons.append(
            f'<spatial stiffness="{k!r}" damping="{c!r}" springlength="{length!r}">'
            f'<site site="frame{a}"/><site site="frame{b}"/></spatial>'
        )
    text = to_mjcf(model).replace("</mujoco>", f"<tendon>{''.join(tendons)}</tendon></mujoco>")
    engine = to_mujoco(model)
    loaded = mujoco.MjModel.from_xml_string(text)
    m = MujocoModel(loaded, mujoco.MjData(loaded), engine.index, engine.body, text)
    m.set_state(s.q, s.qd)
    model = dataclasses.replace(model, forces=tuple(forces))
    elements = Elements(model, transforms(model, list(s.q)), list(s.q), list(s.qd), {}, 0.0)
    ours = elements.torques["passive"]
    theirs = m.ours(m.data.qfrc_passive)
    assert_close(ours, theirs, 1e-12)
    # springs are MuJoCo's only potential energy beside gravity's
    mujoco.mj_energyPos(loaded, m.data)
    total = float(m.data.energy[0])
    loaded.tendon_stiffness[:] = 0.0
    mujoco.mj_energyPos(loaded, m.data)
    assert abs(elements.potential - (total - float(m.data.energy[0]))) < 1e-9 * abs(total)


@pytest.mark.parametrize(("n", "seed"), [(1, 0), (5, 1), (12, 2)])
@pytest.mark.parametrize("frame", ["world", "body"])
def test_a_wrench_on_a_body(n: int, seed: int, frame: str) -> None:
    model, s = tree(n, seed)
    rng = np.random.default_rng([n, seed])
    engine = to_mujoco(model)
    engine.set_state(s.q, s.qd)
    force, moment = rng.normal(size=3), rng.normal(size=3)
    place = model.frames[f"frame{n - 1}"]
    numbers = [tuple(FormulaTree.number(float(x)) for x in values) for values in (force, moment)]
    element = PointWrench("w", "wrench", "", force=numbers[0], moment=numbers[1], frame=frame)
    model = dataclasses.replace(model, forces=(Force("w", element, (place,)),))
    elements = Elements(model, transforms(model, list(s.q)), list(s.q), list(s.qd), {}, 0.0)
    site = engine.data.site(f"frame{n - 1}")
    if frame == "body":
        R = np.array(site.xmat).reshape(3, 3)
        force, moment = R @ force, R @ moment
    expected = np.zeros(n)
    mujoco.mj_applyFT(
        engine.model, engine.data, force, moment, np.array(site.xpos), engine.body[n - 1], expected
    )
    assert_close(elements.torques["external"], engine.ours(expected), 1e-12)
