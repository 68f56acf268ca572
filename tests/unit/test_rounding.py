"""Printed errors of rounding against extended precision: mixed units, thin chains, bodies far from their joints.

Torques are compared with 60 digits, motions with a motion in extended precision whose equations keep every number of
the scene as a symbol, so that none is folded. Both are at the doubles that the scene gives.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest

from robodyn_cli import inverse, simulate
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.model.model import Model
from robodyn_cli.observe.rounding import Rounded, largest_difference
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.scene.types import Scene
from tests.unit.test_model_rounding import exact, exact_parts, far_bodies

mp = mpmath.mp.clone()
mp.dps = 60
LEAST, MOST = 0.1, 1e3  # times the true error
Long = np.longdouble


def chain(
    rng: Any, masses: Any, lengths: Any, inertias: Any, planar: bool = False, gravity: float = 9.81
) -> dict[str, Any]:
    """A chain of hinges about one axis, or about any of the three, with centres of mass beside the links."""
    joints, links = [], []
    for k, (mass, length, inertia) in enumerate(zip(masses, lengths, inertias)):
        axis = [0, 1, 0] if planar else np.eye(3)[int(rng.integers(3))].tolist()
        at = [float(lengths[k - 1]) if k else 0.0, 0.0, 0.0]
        joints.append({"name": f"j{k}", "type": "revolute", "axis": axis, "origin": {"xyz": at}})
        com = [length / 2, 0.0 if planar else 0.1 * length * float(rng.normal()), 0.0]
        moments = dict(zip(("xx", "yy", "zz"), (inertia * rng.uniform(1.0, 1.4, 3)).tolist()))
        links.append(
            {"name": f"l{k}", "mass": float(mass), "com": [float(x) for x in com], "inertia": moments}
        )
    return {"schema": 1, "gravity": [0, 0, -gravity], "robot": {"joints": joints, "links": links}}


def families(seed: int) -> dict[str, dict[str, Any]]:
    """Scenes without a motion: an ordinary arm, one in mixed units, a long thin one, a planar one."""
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.uniform([[-6], [-2], [-7]], [[6], [2], [5]], (3, 4))
    return {
        "ordinary": chain(rng, rng.uniform(0.5, 2, 3), rng.uniform(0.3, 1, 3), [0.05] * 3),
        "mixed": chain(rng, *sizes),
        "thin": chain(rng, [1.0] * 8, [0.3] * 8, [1e-9] * 8),
        "planar": chain(rng, [1.0] * 6, [0.3] * 6, [1e-3] * 6, planar=True),
    }


def led(scene: dict[str, Any], seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(100 + seed)
    q = {
        j["name"]: f"{rng.normal():.3f} + sin({rng.uniform(0.5, 3):.3f}*t)" for j in scene["robot"]["joints"]
    }
    return {**scene, "command": "inverse", "trajectory": {"type": "joint", "duration": 1, "q": q}}


def exact_torques(model: Model, q: Any, v: Any, a: Any) -> Any:
    """M a + C v + G (nv,) with 60 digits."""
    q, v, a, gravity = (
        exact(np.array([float(x) for x in y], dtype=object)) for y in (q, v, a, model.gravity)
    )
    whole, X = exact_parts(model, q)
    return rnea(whole, q, v, a, gravity, X)


def torque_ratio(scene: Scene) -> float:
    """Printed over true error of the torques."""
    found = inverse(scene, samples=5)
    model = Problem(scene).model
    true = 0.0
    for i in range(5):
        asked = exact_torques(model, *(found[path][i] for path in ("q", "qd", "qdd")))
        true = max(true, *(abs(float(x - mp.mpf(y))) for x, y in zip(asked, found["tau"][i].tolist())))
    printed = float(found.summary["error_estimate"]["torque_rounding"])
    return printed / max(true, 1e-300)


@pytest.mark.parametrize("seed", range(6))
def test_torques_are_off_by_no_more_than_is_said(seed: int) -> None:
    for name, scene in families(seed).items():
        ratio = torque_ratio(load_scene_text(json.dumps(led(scene, seed))))
        assert LEAST < ratio < MOST, (name, ratio)
    far = far_bodies(seed).replace("gravity: [0, 0, 0]", "gravity: [0, 0, -9.81]")
    names = [f"j{k}" for k in range(far.count("name: j"))]
    paths = ", ".join(f'{name}: "0.3 + sin({k + 1}*t)"' for k, name in enumerate(names))
    ratio = torque_ratio(
        load_scene_text(f"{far}\ntrajectory: {{type: joint, duration: 1, q: {{{paths}}}}}\n")
    )
    assert LEAST < ratio < MOST, ("far", ratio)


# -- motions -----------------------------------------------------------------------------------------------
def numbers_of(scene: Scene) -> dict[str, float]:
    """The numbers of bodies and gravity by the paths of ``build_model``."""
    found = {f"gravity.{k}": g for k, g in enumerate(scene.gravity)}
    for link in scene.robot.links:
        path = f"links.{link.name}"
        found[f"{path}.mass"] = link.mass or 0.0
        found |= {f"{path}.com.{k}": x or 0.0 for k, x in enumerate(link.com or ())}
        found |= {f"{path}.inertia.{k}": getattr(link.inertia, k) or 0.0 for k in ("xx", "yy", "zz")}
    return {name: value for name, value in found.items() if value}


def exact_rates(scene: Scene) -> Callable[[Any], Any]:
    """x-dot of x = (q, v) in extended precision."""
    numbers = numbers_of(scene)
    problem = Problem(scene, symbolic=list(numbers))
    rates = Evaluator(list(problem.forward.qdd))
    p, n = [Long(x) for x in numbers.values()], problem.model.nv

    def f(x: Any) -> Any:
        a = rates({"q": x[:n], "v": x[n:], "t": [Long(0)], "p": p})
        return np.concatenate([x[n:], np.array(a, dtype=Long)])

    return f


def extrapolated(f: Callable[[Any], Any], x: Any, duration: float, steps: int) -> Any:
    """Gragg, Bulirsch and Stoer's method of order 14 with fixed steps (Hairer, Norsett and Wanner 1993, II.9)."""
    counts, h = range(2, 16, 2), Long(duration) / steps
    for _ in range(steps):
        row: list[Any] = []
        for j, n in enumerate(counts):
            part = h / n
            before, now = x, x + part * f(x)
            for _ in range(1, n):
                before, now = now, before + 2 * part * f(now)
            row.append((now + before + part * f(now)) / 2)
            for i in range(j - 1, -1, -1):
                row[i] = row[i + 1] + (row[i + 1] - row[i]) / ((Long(counts[j]) / counts[i]) ** 2 - 1)
        x = row[0]
    return x


def motion_families(seed: int) -> dict[str, dict[str, Any]]:
    """Chains whose mass matrices are ill-conditioned, or that have masses of 1e6 kg beside some of 1e-6 kg."""
    rng = np.random.default_rng(seed)
    return {
        "ordinary": chain(rng, rng.uniform(0.5, 2, 2), rng.uniform(0.3, 1, 2), [0.05] * 2),
        "heavy outside": chain(rng, [1e-6, 1e6], [1.0, 1.0], [1e-7, 1e5], planar=True, gravity=0.0),
        "heavy inside": chain(rng, [1e6, 1.0, 1e-6], [1.0] * 3, [1e5, 1.0, 1e-7], planar=True, gravity=0.0),
        "light between": chain(rng, [1.0, 1e-9, 1.0], [0.5] * 3, [0.02, 2e-11, 0.02], planar=True),
    }


@pytest.mark.parametrize("seed", range(3))
def test_motions_are_off_by_no_more_than_is_said(seed: int) -> None:
    """At the tightest tolerance, where rounding is all that is left."""
    rng = np.random.default_rng(200 + seed)
    for name, robot in motion_families(seed).items():
        joints = [j["name"] for j in robot["robot"]["joints"]]
        q, qd = ({j: float(rng.normal()) for j in joints} for _ in range(2))
        options = {"duration": 0.5, "samples": 2, "rtol": 1e-14, "atol": 1e-16}
        scene = load_scene_text(json.dumps({**robot, "initial": {"q": q, "qd": qd}, "simulate": options}))
        found = simulate(scene)
        start = np.concatenate([found["q"][0], found["qd"][0]]).astype(Long)
        steps = 2 * found.summary["counters"]["steps"]
        asked = extrapolated(exact_rates(scene), start, 0.5, steps)
        end = np.concatenate([found["q"][-1], found["qd"][-1]])
        true = float(np.abs(end - asked).max())
        estimate = found.summary["error_estimate"]
        assert LEAST < estimate["state_max"] / max(true, 1e-300) < MOST, (name, true, estimate)
        assert estimate["state_max"] >= estimate["rounding_floor"]


def test_torques_shared_by_loops_have_a_figure_too() -> None:
    found = inverse(load_scene("configs/mechanisms/five_bar_circle.yaml"), samples=21)
    off = found.summary["error_estimate"]["torque_rounding"]
    assert 1e-17 < off < 1e-12


def test_a_difference_that_cancels_shows() -> None:
    """(x + y) - y for y = 1e8 is known to half a unit of 1e8."""
    x, y = Problem(load_scene("configs/double_pendulum.yaml")).q
    off = largest_difference(Rounded([(x + y) - y])({"q": np.array([[0.3, 1e8]])}))
    assert off is not None and 1e-10 < off < 3e-8


# -- loops ---------------------------------------------------------------------------------------------------
def nearly_folded(bend: float, unit: float) -> tuple[str, list[float]]:
    """A four-bar whose coupler and rocker are bent against each other by ``bend`` only, so that rows nearly depend."""
    crank, rocker, ground, angle = unit, 1.2 * unit, 2.0 * unit, 1.0
    across = np.array([ground - crank * np.cos(angle), -crank * np.sin(angle)])
    coupler = float(np.hypot(*across)) - rocker + 0.5 * bend**2 * unit
    along = float(np.arctan2(across[1], across[0]))
    axis = "type: revolute, axis: [0, 0, 1]"
    text = f"""
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {{name: t1, {axis}}}
    - {{name: t2, {axis}, origin: {{xyz: [{crank!r}, 0, 0]}}}}
    - {{name: t3, parent: base, {axis}, origin: {{xyz: [{ground!r}, 0, 0]}}}}
  links:
    - {{name: l1, mass: 1, com: [{crank / 2!r}, 0, 0], inertia: {{zz: {0.1 * unit**2!r}}}}}
    - {{name: l2, mass: 1, com: [{coupler / 2!r}, 0, 0], inertia: {{zz: {0.1 * unit**2!r}}}}}
    - {{name: l3, mass: 1, com: [{rocker / 2!r}, 0, 0], inertia: {{zz: {0.1 * unit**2!r}}}}}
  points: {{A: {{link: l2, at: [{coupler!r}, 0, 0]}}, B: {{link: l3, at: [{rocker!r}, 0, 0]}}}}
loops: [{{name: pin, type: revolute, between: [A, B]}}]
initial:
  q: {{t1: {angle}, t2: {along - angle + 0.7 * bend!r}, t3: {along + np.pi - 0.2 * bend!r}}}
  hold: [t1]
simulate: {{duration: 0.02, samples: 5, rtol: 1e-13, atol: 1e-15}}
"""
    return text.replace("np.float64(", "").replace(")", ""), [crank, coupler, rocker, ground]


def closing_error(lengths: list[float], q: Any) -> float:
    """How far t2 and t3 are from where t1 puts them, to first order, from the gap of 60 digits."""
    a, b, c, d = (mp.mpf(x) for x in lengths)
    t1, t2, t3 = (mp.mpf(float(x)) for x in q)
    gap = mp.matrix(
        [
            a * mp.cos(t1) + b * mp.cos(t1 + t2) - d - c * mp.cos(t3),
            a * mp.sin(t1) + b * mp.sin(t1 + t2) - c * mp.sin(t3),
        ]
    )
    J = mp.matrix(
        [
            [-b * mp.sin(t1 + t2), c * mp.sin(t3)],
            [b * mp.cos(t1 + t2), -c * mp.cos(t3)],
        ]
    )
    return max(abs(float(x)) for x in mp.lu_solve(J, gap))


@pytest.mark.parametrize("bend", [1e-1, 1e-2, 1e-4, 1e-6])
def test_loops_that_hardly_determine_their_joints(bend: float) -> None:
    """Closing them is worse by one over the bend; the printed error of positions covers that."""
    for unit in (1.0, 1e3, 1e-4):
        text, lengths = nearly_folded(bend, unit)
        found = simulate(load_scene_text(text))
        true = max(closing_error(lengths, q) for q in found["q"])
        assert found.summary["error_estimate"]["q_max"] > LEAST * true, (bend, unit, true)
