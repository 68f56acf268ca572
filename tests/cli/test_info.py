"""``robodyn info``: the matrices of a scene at one state, against closed forms."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from tests.cli.batch_scenes import arm

CONFIGS = Path(__file__).parents[2] / "configs"


def invoke(scene: Path, *words: object) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["info", str(scene), *map(str, words)])
    return done.exit_code, done.stdout


def report(scene: Path, *words: object) -> dict[str, Any]:
    code, output = invoke(scene, "--json", "--no-plots", *words)
    assert code == 0, output
    return dict(json.loads(output))


def test_planar_arm_in_closed_form() -> None:
    """Textbook equations of the planar 2R arm (Siciliano et al. 2009, section 7.3.2), links as in the config."""
    m, l, r1, r2, I = 12.456, 1.0, 0.773, 0.583, 1.042
    q1, q2, v1, v2, g = 0.3, 0.7, 0.5, -1.1, 9.81
    found = report(CONFIGS / "2r_circle.yaml", "--at", f"q=[{q1}, {q2}], qd=[{v1}, {v2}]")
    c2, h = math.cos(q2), -m * l * r2 * math.sin(q2)
    a, b = I + m * r1**2 + I + m * (l**2 + r2**2 + 2 * l * r2 * c2), I + m * (r2**2 + l * r2 * c2)
    M = np.array([[a, b], [b, I + m * r2**2]])
    C = np.array([[h * v2, h * (v1 + v2)], [-h * v1, 0.0]])
    G2 = m * g * r2 * math.cos(q1 + q2)
    J = np.array([
        [-math.sin(q1) - math.sin(q1 + q2), -math.sin(q1 + q2)], [math.cos(q1) + math.cos(q1 + q2), math.cos(q1 + q2)],
        [0, 0],
    ])  # fmt: skip
    tip = found["points"]["tip"]
    for actual, expected in (
        (found["mass_matrix"], M),
        (found["coriolis_matrix"], C),
        (list(found["gravity_torques"].values()), [m * g * (r1 + l) * math.cos(q1) + G2, G2]),
        (tip["jacobian"], J),
        (tip["velocity"], J @ [v1, v2]),
        (tip["singular_values"], np.linalg.svd(J)[1]),
        (found["mass_matrix_singular_values"], np.linalg.svd(M)[1]),
        (found["frames"]["link2"]["position"], tip["position"]),
    ):
        np.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-12)


def test_loops_are_closed_where_joints_are_put() -> None:
    found = report(CONFIGS / "four_bar_deploy.yaml", "--at", "theta1=60 deg")
    assert found["state"]["q"]["theta1"] == pytest.approx(math.pi / 3, abs=1e-15)
    p, f = (found["points"][name]["position"] for name in ("pin_coupler", "pin_follower"))
    np.testing.assert_allclose(p, f, atol=1e-12)
    assert found["constraints"]["rows"] == ["pin.x", "pin.y"]


def test_missing_data_are_null(tmp_path: Path) -> None:
    scene = arm(tmp_path / "arm.yaml")
    scene.write_text(scene.read_text().replace("inertia: {zz: 0.025}", "inertia: {}"))
    found = report(scene)
    assert found["mass_matrix"] == [[None]] and found["mass_matrix_singular_values"] is None
    assert found["gravity_torques"]["swing"] == pytest.approx(1.2 * 9.81 * 0.25)
    assert "singular values  not known" in invoke(scene, "--no-plots")[1]


@pytest.mark.parametrize("field", ["mass: 1.2", "com: [0.25, 0, 0]", "inertia: {zz: 0.025}"])
def test_data_may_miss_beside_a_prescribed_joint(field: str, tmp_path: Path) -> None:
    scene = arm(tmp_path / "arm.yaml")
    text = scene.read_text()
    assert field in text
    scene.write_text(
        text.replace(f"{field}, ", "").replace(f", {field}", "") + "\nprescribed: {swing: 0.1*t}\n"
    )
    assert report(scene)["mass_matrix"] == [[None]]


def test_markers_and_condition_are_told(tmp_path: Path) -> None:
    """A marker of 1e-9 kg on a joint of its own makes M badly conditioned; both are named."""
    scene = arm(tmp_path / "arm.yaml")
    text = scene.read_text()
    assert report(scene)["light_links"] == [] and report(scene)["mass_matrix_condition"] == 1.0
    marker = (
        "attach: [{link: marker, to: LINK, mass: 1e-9, com: [0, 0, 0], inertia: {zz: 1e-9}, joint: JOINT}]"
    )
    marker = marker.replace("JOINT", "{name: spin, type: revolute, axis: [0, 0, 1]}").replace("LINK", "rod")
    scene.write_text(text.replace("robot:\n", f"robot:\n  {marker}\n").replace("q: {", "q: {spin: 0, "))
    found = report(scene)
    sigma = found["mass_matrix_singular_values"]
    assert found["light_links"] == ["marker"] and found["mass_matrix_condition"] == sigma[0] / sigma[1] > 1e6
    printed = invoke(scene, "--no-plots")[1]
    assert "light links        marker: massless, or nearly so" in printed and "condition        " in printed


def test_tree_for_people() -> None:
    code, output = invoke(CONFIGS / "four_bar_deploy.yaml", "--no-plots")
    assert code == 0
    assert output.splitlines()[1:5] == [
        "  base",
        "  |-- theta1 (revolute, motor) -> crank, 20.15 kg",
        "  |   `-- phi2 (revolute) -> coupler, 8.25 kg",
        "  `-- phi1 (revolute) -> follower, 8.25 kg",
    ]


def test_drawing(tmp_path: Path) -> None:
    for name in ("2r_circle", "four_bar_deploy", "seven_joint_arm"):
        assert invoke(CONFIGS / f"{name}.yaml", "--out", tmp_path / name, "--quiet") == (0, "")
        assert {p.name for p in (tmp_path / name).iterdir()} >= {"state.png", "summary.json"}
        assert (tmp_path / name / "state.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("at", ["q=[1]", "q", "theta3=1", "q=[1, 2", "q.theta1=x", "q=1"])
def test_what_is_no_state(at: str) -> None:
    assert invoke(CONFIGS / "2r_circle.yaml", "--no-plots", "--at", at)[0] == 2


def test_the_state_is_said_back_with_its_units() -> None:
    """Who means degrees and does not write them sees it."""
    _, text = invoke(CONFIGS / "2r_circle.yaml", "--no-plots", "--at", "theta1=60", "--at", "theta2=60 deg")
    assert re.search(r"^  state +theta1 60 rad, theta2 1\.0472 rad$", text, re.MULTILINE)
    assert re.search(r"^  rates +theta1 0 rad/s, theta2 0 rad/s$", text, re.MULTILINE)
