"""The peers of the stability suite are given the right models, and their runs are told as what they are."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.over.references import TrialReference
from robodyn_cli.over.stability.cases import CASES, Case
from robodyn_cli.over.stability.scenes import LECTURE_ARM, scene, slider

ROOT = Path(__file__).parents[2]
NAMED = {case.name: case for case in CASES}
STOP = ", limits: {lower: 0, upper: 9, stop: {restitution: 0.5}}"


@pytest.fixture(scope="module")
def peers() -> Iterator[Any]:
    before = list(sys.path)
    sys.path.insert(0, str(ROOT / "benchmarks"))
    import stability_peers

    yield stability_peers
    sys.path[:] = before


def ball(peers: Any, height: float = 1.0) -> Any:
    """Return a mass that falls on a rigid stop."""
    text = slider("Mass on a rigid stop", 2.0, 1.0, "", f"{{q: {{y: {height}}}}}", keys=STOP)
    return peers.Mechanism(Case("ball", lambda quick: text, "bounces"))


def bouncing(t: float, height: float = 1.0, g: float = 9.81) -> tuple[float, float]:
    """Return height and rate of a mass dropped on a stop that halves its speed; every flight is half the one before."""
    now, speed = np.sqrt(2.0 * height / g), np.sqrt(2.0 * height * g)
    if t < now:
        return height - 0.5 * g * t * t, -g * t
    while speed > 1e-12:
        speed *= 0.5
        if t < now + 2.0 * speed / g:
            s = t - now
            return speed * s - 0.5 * g * s * s, speed - g * s
        now += 2.0 * speed / g
    return 0.0, 0.0


def test_rigid_stops_by_events(peers: Any) -> None:
    """Between solve_ivp's events the impacts are exact, and the mass comes to rest."""
    pytest.importorskip("pinocchio")
    times = np.linspace(0.0, 2.0, 257)
    runs = dict(peers.scipy.runs(ball(peers)))
    found = runs["scipy LSODA 1e-08"](times)
    wanted = np.array([bouncing(t) for t in times])
    assert np.abs(found - wanted).max() < 1e-6
    assert found[-1] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_a_joint_leaves_its_stop(peers: Any) -> None:
    """The arm's second link falls on its stop, rests there and leaves it, as robodyn says too."""
    pytest.importorskip("pinocchio")
    case = NAMED["rigid_stops"]
    mechanism = peers.Mechanism(case)
    ref = peers.reference(mechanism.scene, peers.BUDGET, False)
    states = dict(peers.scipy.runs(mechanism))["scipy LSODA 1e-08"](ref.times)
    assert (np.abs(states - ref.states) / ref.scale).max() < 1e-4
    resting = (ref.times > 0.7) & (ref.times < 2.4)
    assert np.all(ref.states[resting, 1] == pytest.approx(1.0)) and ref.states[-1, 1] < 0.0


def test_stiff_stops_are_met(peers: Any) -> None:
    mechanism = peers.Mechanism(NAMED["stiff_stops"])
    ref = peers.reference(mechanism.scene, peers.BUDGET, False)
    assert np.sum(np.diff(np.sign(ref.states[:, 1] - 1.0)) > 0) > 3


def test_rigid_stops_of_mujoco(peers: Any) -> None:
    """The joint's limit rebounds as it should, as far as a soft stop can."""
    pytest.importorskip("mujoco")
    times = np.linspace(0.0, 0.6, 601)
    states = dict(peers.mujoco.runs(ball(peers)))["MuJoCo RK4"](times)
    after = states[times > np.sqrt(2.0 / 9.81)]
    assert after[:, 1].max() == pytest.approx(0.5 * np.sqrt(2.0 * 9.81), rel=0.05)


def test_damping_of_a_rebound(peers: Any) -> None:
    for restitution in (0.9, 0.6, 0.2):
        z = peers.mujoco.damping_ratio(restitution)
        x, v, h = 0.0, -1.0, 1e-5
        while (force := -x - 2.0 * z * v) >= 0.0:
            v += h * force
            x += h * v
        assert v == pytest.approx(restitution, rel=1e-3)


def test_dry_friction_of_mujoco(peers: Any) -> None:
    """``frictionloss`` holds the arm where the set-valued law does."""
    pytest.importorskip("mujoco")
    mechanism = peers.Mechanism(NAMED["sticking_set_valued"])
    ref = peers.reference(mechanism.scene, peers.BUDGET, False)
    states = dict(peers.mujoco.runs(mechanism))["MuJoCo RK4"](ref.times)
    assert np.abs(states[-1, :2] - ref.states[-1, :2]).max() < 1e-2


@pytest.mark.parametrize("engine", ["mujoco", "scipy"])
def test_loops(peers: Any, engine: str) -> None:
    """Away from its fold the four-bar moves alike everywhere, and its loop stays closed."""
    pytest.importorskip({"mujoco": "mujoco", "scipy": "pinocchio"}[engine])
    case = NAMED["four_bar_folded"]
    text = case.text(True).replace("theta1: 1e-6, phi1: 1.02e-6", "theta1: 0.1, phi1: 0.102")
    mechanism = peers.Mechanism(case, text.replace("duration: 20", "duration: 2"))
    ref = peers.reference(mechanism.scene, peers.BUDGET, False)
    name = {"mujoco": "MuJoCo RK4", "scipy": "scipy Radau 1e-08"}[engine]
    states = dict(getattr(peers, engine).runs(mechanism))[name](ref.times)
    bound = {"mujoco": 1e-3, "scipy": 1e-6}[engine]
    assert (np.abs(states - ref.states) / ref.scale).max() < bound
    assert mechanism.gaps(states).max() < bound


def test_what_a_run_is_called(peers: Any) -> None:
    times = np.linspace(0.0, 1.0, 3)
    right = np.ones((3, 2))
    ref = TrialReference(times, right, np.ones(2), 1.0, 12.0, 1e-12, ("gauss", "dop853"))

    def told(run: Any) -> str:
        return str(peers.shown(peers.judged(*peers.outcome(run, times), ref)))

    def refused(times: Any) -> Any:
        raise peers.Refused("no rigid impact")

    def slow(times: Any) -> Any:
        raise peers.TooSlow

    def fails(times: Any) -> Any:
        raise ArithmeticError("step too small")

    assert told(lambda times: right + 1e-5) == "1e-05"
    assert told(lambda times: right + 0.1) == "1e-01 !"
    assert told(lambda times: right * np.nan) == "not finite"
    assert (told(refused), told(slow), told(fails)) == ("no rigid impact", "too slow", "gives up")


def test_the_branch_of_a_parallelogram(peers: Any) -> None:
    mechanism = peers.Mechanism(NAMED["start_near_singular"])
    names = mechanism.model.q_names

    def told(crank: float, coupler: float, follower: float) -> tuple[str, float]:
        state = np.zeros((1, 6))
        for name, value in (("theta1", crank), ("phi2", coupler), ("phi1", follower)):
            state[0, names.index(name)] = value
        found = peers.passage({"status": "stable", "relative": None}, state, mechanism)
        return str(peers.shown(found)).split(", gap")[0], found["gap"]

    crank = np.pi + 0.2
    assert told(crank, -crank, crank) == ("parallelogram", pytest.approx(0.0, abs=1e-12))
    # the other closure: the coupler mirrored at the line from its joint to the follower's pivot
    tip = np.array([np.cos(crank), np.sin(crank)])
    to_pivot = np.array([2.0, 0.0]) - tip
    coupler = 2.0 * np.arctan2(to_pivot[1], to_pivot[0])
    end = tip + 2.0 * np.array([np.cos(coupler), np.sin(coupler)]) - np.array([2.0, 0.0])
    follower = float(np.arctan2(end[1], end[0]))
    assert told(crank, coupler - crank, follower) == ("antiparallelogram", pytest.approx(0.0, abs=1e-12))
    torn = told(crank, -crank, crank + 0.5)
    assert torn == ("torn", pytest.approx(2.0 * np.sin(0.25)))


def test_what_an_engine_cannot_be_given(peers: Any) -> None:
    body = LECTURE_ARM % (", limits: {lower: -9, upper: 9, stop: {stiffness: 1e4}}", "", 1.0, 1.0, 1.0, 1.0)
    text = scene("Soft stops", body, "{q: {theta1: 0, theta2: 0}}", 1.0)
    with pytest.raises(peers.Refused, match="Limits"):
        peers.Mechanism(Case("soft", lambda quick: text, ""))


def test_script(tmp_path: Path) -> None:
    """Cases with and without a reference; robodyn's own part is in both."""
    file = tmp_path / "peers.json"
    command = [sys.executable, str(ROOT / "benchmarks" / "stability_peers.py"), "--json", str(file)]
    command += ["--cases", "gravity_alone,start_near_singular"]
    printed = subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.PIPE, text=True).stdout
    rows = {row["case"]: row for row in json.loads(file.read_text(encoding="utf-8"))["rows"]}
    assert set(rows) == {"gravity_alone", "start_near_singular"}
    assert rows["start_near_singular"]["runs"]["robodyn auto"]["words"] == "stops"
    assert rows["gravity_alone"]["runs"]["robodyn auto"]["relative"] < 1e-12
    assert "| gravity_alone | 0e+00 |" in printed and "| start_near_singular | stops |" in printed
