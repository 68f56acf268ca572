"""Bodies that cannot exist are told from those at the limit."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import inverse, load_scene_text, simulate
from robodyn_cli.errors import SceneError
from robodyn_cli.model.consistency import body_problems
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Inertia, Link, Scene
from robodyn_cli.works.info import info
from tests.random_models import random_inertia, random_rotation


def link(m: float, I: np.ndarray) -> Link:
    names = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    return Link("body", mass=m, inertia=Inertia(**{k: float(I[place]) for k, place in names.items()}))


@pytest.mark.parametrize(
    ("m", "moments", "problem"),
    [
        (1.0, (1.0, 1.0, 1.0), ""),
        (1.0, (1.0, 2.0, 3.0), ""),  # a flat body: exactly at the limit
        (1.0, (0.0, 2.0, 2.0), ""),  # a thin rod
        (0.0, (0.0, 0.0, 0.0), ""),  # a massless link is legal
        (1.0, (0.0, 0.0, 0.0), ""),  # so is a point mass
        (1.0, (1.0, 1.0, 2.5), r"triangle inequality by 0\.5"),
        (1.0, (-0.1, 2.0, 2.0), r"not positive semi-definite: principal moment -0\.1"),
        (0.0, (0.4, 0.4, 0.4), "inertia but no mass"),
        # on the scale of the body, small or large
        (1.0, (1e-13, 1e-13, 2.5e-13), r"triangle inequality by 5e-14"),
        (1.0, (1e6, 2e6, 3e6), ""),
        (1.0, (0.0, 2e6, 2e6), ""),
    ],
)
def test_what_no_body_can_have_is_named_with_its_size(
    m: float, moments: tuple[float, ...], problem: str
) -> None:
    R = random_rotation(np.random.default_rng(1))
    found = body_problems(link(m, R @ np.diag(moments) @ R.T))
    assert len(found) == bool(problem)
    assert all(re.search(problem, text) for text in found)


def test_sums_of_point_masses_are_consistent() -> None:
    for seed in range(20):
        m, _, I = random_inertia(np.random.default_rng(seed))
        assert body_problems(link(float(m), I)) == []


TWO = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1]}
    - {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [1, 0, 0]}}
  links:
    - {name: A, mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.1}}
    - {name: B, mass: 1, com: [0.5, 0, 0], inertia: {zz: INERTIA}}
initial: {q: {a: 0, b: 0.3}}
simulate: {duration: 0.1, samples: 3}
trajectory: {type: joint, duration: 1, q: {a: t, b: "0.2 + t^2"}}
"""


@pytest.mark.parametrize(("run", "b"), [(simulate, 0.3), (inverse, 0.2)])
def test_inertias_of_no_robot_are_refused_where_they_enter(run: Callable[[Scene], Result], b: float) -> None:
    """det M = (0.1 + 0.25 + 1) (0.25 + I) - (cos(b) / 2)^2 decides, not the sign of I."""
    least = 0.25 * np.cos(b) ** 2 / 1.35 - 0.25
    assert least < 0.0
    for inertia in (least + 1e-4, -0.001, 0.0):
        assert run(load_scene_text(TWO.replace("INERTIA", str(inertia)))).status == "ok"
    for inertia in (least - 1e-4, -0.3, -5.0):
        with pytest.raises(SceneError, match=r"robot\.links\.1\.inertia: B.*joint '[ab]' is negative"):
            run(load_scene_text(TWO.replace("INERTIA", str(inertia))))


def test_identified_parameters_are_a_robot() -> None:
    """Part of the lower link's inertia may be counted with the upper one: M is the same, and single bodies odd."""
    plain = load_scene_text(TWO.replace("INERTIA", "0.05"))
    # all mass of B at its joint counts with A; its first moment m c stays, by a centre of mass far off a small mass
    m, h, about_joint = 1e-3, 0.5, 0.05 + 0.25
    other = TWO.replace(
        "mass: 1, com: [0.5, 0, 0], inertia: {zz: INERTIA}",
        f"mass: {m}, com: [{h / m}, 0, 0], inertia: {{zz: {about_joint - h * h / m}}}",
    )
    A = f"mass: {2 - m}, com: [{(0.5 + 1 - m) / (2 - m)}, 0, 0], inertia: {{zz: "
    A += f"{0.1 + 0.25 + (1 - m) - (0.5 + 1 - m) ** 2 / (2 - m)}}}"
    other = other.replace("mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.1}", A)
    same = load_scene_text(other)
    assert body_problems(same.robot.links[1])
    np.testing.assert_allclose(inverse(same)["tau"], inverse(plain)["tau"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(simulate(same)["q"], simulate(plain)["q"], rtol=1e-8, atol=1e-9)


def test_a_doubtful_inertia_beside_missing_data(tmp_path: Path) -> None:
    """Who needs the data names them; ``info`` of the rest goes on."""
    text = TWO.replace("B, mass: 1, com", "B, com").replace("INERTIA", "-5")
    with pytest.raises(SceneError, match="mass of B"):
        simulate(load_scene_text(text))
    (tmp_path / "scene.yaml").write_text(text)
    assert info(tmp_path / "scene.yaml").status == "ok"
