"""The robots of ``robodyn new --from``: they run, meet their expectations, and agree with closed forms."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import ForwardDynamics, load_scene_text, simulate, statics
from robodyn_cli.over.findings import findings
from robodyn_cli.robots.collection import FOLDER, ROBOTS, find_robot
from tests.cli.tool import invoke

ROOT = Path(__file__).parents[2]
G = 9.81


@pytest.mark.parametrize("name", ROBOTS)
def test_every_robot_runs(name: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    done = invoke("new", "--from", name, path)
    robot = find_robot(name)
    assert done.code == 0 and f"Run it: robodyn {robot.command} {path}" in done.out
    text = path.read_text(encoding="utf-8")
    assert f"#   robodyn {robot.command} {path}\n" in text and "include:" not in text
    ran = invoke("run", path, "--no-plots", "--out", tmp_path / "out")
    assert ran.code == 0 and "1 scene: 1 ok" in ran.out, ran.out + ran.err
    if name != "puma560":  # two of its bodies are as they were measured
        assert findings(path, strict=True) == []


@pytest.mark.parametrize("name", ROBOTS)
def test_every_robot_says_where_its_constants_are_from(name: str) -> None:
    text = find_robot(name).scene
    comments = " ".join(line for line in text.splitlines() if line.lstrip().startswith("#"))
    assert any(
        word in comments for word in ("Source", "Corke and Armstrong-Helouvry", "of the lecture", "crank.f")
    )


def test_the_list_is_that_of_the_folder_and_of_the_help() -> None:
    assert {path.stem for path in FOLDER.glob("*.yaml")} == set(ROBOTS)
    text = " ".join(invoke("new", "--help").out.split())
    assert all(name in text for name in ROBOTS)
    named = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in named for name in ROBOTS)


def test_robots_of_the_examples_are_up_to_date() -> None:
    subprocess.run([sys.executable, str(ROOT / "docs" / "make_robots.py"), "--check"], check=True)


def test_usage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert invoke("new", "--from", "cart_pole").code == 0 and (tmp_path / "cart_pole.yaml").exists()
    assert invoke("new", "--from", "cart_pole").code == 74
    for words in (["--from", "cart_pol"], [], ["simulate", "x.yaml", "--from", "cart_pole"]):
        done = invoke("new", *words)
        assert done.code == 2 and ("did you mean 'cart_pole'" in done.err or "needs the kind" in done.err)


# -- closed forms --------------------------------------------------------------------------------------------
def scene(name: str, *overrides: str):  # type: ignore[no-untyped-def]
    return load_scene_text(find_robot(name).scene, overrides=list(overrides))


def test_the_cart_pole_is_florians() -> None:
    """His equations (21) to (24) without friction of the cart; his angle turns the other way."""
    M, m, half, mu = 1.0, 0.1, 0.5, 2e-6
    for theta, w, F in ((0.1, 0.5, 3.0), (1.2, -2.0, -1.0), (-2.5, 4.0, 0.0)):
        found = ForwardDynamics(scene("cart_pole"))(
            np.array([[0.3, -theta]]), np.array([[0.7, -w]]), np.array([[F, 0.0]])
        )[0]
        s, c = np.sin(theta), np.cos(theta)
        push = (-F - m * half * w * w * s) / (M + m)
        angular = (G * s + c * push - mu * w / (m * half)) / (half * (4 / 3 - m * c * c / (M + m)))
        linear = (F + m * half * (w * w * s - angular * c)) / (M + m)
        assert np.abs(found - [linear, -angular]).max() < 1e-12 * np.abs(found).max()


def test_the_furuta_pendulum_at_rest_falls_as_a_rod_on_a_bar() -> None:
    """M from the kinetic energy of two rods; at rest only the weight of the pendulum acts."""
    ma, la, mp, lp, angle = 0.095, 0.085, 0.024, 0.129, 0.7
    J = 4.6e-6 + ma * la * la / 3 + mp * la * la + mp * lp * lp / 3 * np.sin(angle) ** 2
    M = np.array(
        [[J, mp * la * lp / 2 * np.cos(angle)], [mp * la * lp / 2 * np.cos(angle), mp * lp * lp / 3]]
    )
    expected = np.linalg.solve(M, [0.01, -mp * G * lp / 2 * np.sin(angle)])
    found = ForwardDynamics(scene("furuta_pendulum"))(
        np.array([[0.2, angle]]), np.zeros((1, 2)), np.array([[0.01, 0.0]])
    )[0]
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("foot", [0.94, 0.7])
def test_the_screw_of_the_scissor_mast_does_the_work_of_lifting(foot: float) -> None:
    """All bars at theta: V = m g h with h = sin(theta), s = cos(theta); the bars' middles are at 1/2, 3/2 and 5/2 h."""
    found = statics(scene("scissor_mast", "statics={find: hold}", f"initial.q.s={foot}", "initial.hold=[s]"))
    weight = G * (2 * 3 * (0.5 + 1.5 + 2.5) + 20 * 3)
    force = -weight * foot / np.sqrt(1 - foot * foot)
    assert abs(found.summary["torques_of_joints"]["s"] - force) < 1e-9 * abs(force)


def test_the_arms_of_the_delta_robot_share_the_weight() -> None:
    """In the middle each arm does a third of the work that lowers the platform, rods and arms."""
    found = statics(scene("delta", "statics={find: hold}", "initial.hold=[x, y, z]"))
    torques, q = found.summary["torques_of_joints"], found.summary["configuration"]["arm1"]
    R, r, a, b, mp, mr, ma = 0.2, 0.045, 0.235, 0.8, 0.4, 0.25, 0.6
    X = R - r + a * np.cos(q)
    elbow = -a * np.cos(q)  # dz of the elbow / dq
    platform = elbow - X * a * np.sin(q) / np.sqrt(b * b - X * X)
    work = G * (mp * platform / 3 + mr * (platform + elbow) / 2 + ma * elbow / 2)
    for arm in ("arm1", "arm2", "arm3"):
        assert abs(torques[arm] - work) < 1e-9 * abs(work)


def test_the_cart_pole_is_upright_at_zero() -> None:
    result = simulate(scene("cart_pole", "initial.q.theta=0.001 deg", "simulate.duration=0.2"))
    assert abs(result["points/tip"][0, 1] - 1.0) < 1e-9
