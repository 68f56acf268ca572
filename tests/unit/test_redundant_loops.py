"""Closures that say things twice: overconstrained linkages, and planar ones whose plane lies obliquely in space."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robodyn_cli import load_scene, load_scene_text, simulate
from robodyn_cli.cli.words import multiplier_lines
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, GeometryError
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.motion.contact.checks import check_freedom
from robodyn_cli.over.stability.stability import eigenvalues
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import rotation_rpy
from tests.numeric import assert_close

BENCHMARKS = Path(__file__).parents[2] / "configs" / "benchmarks"

# opposite links alike; it moves only because a / sin(alpha) = b / sin(beta). The fourth link is the base.
BENNETT = """
schema: 1
gravity: [1, -9, -4]
robot:
  convention: standard
  joints:
    - {name: t1, type: revolute, a: 1, alpha: 30 deg, d: 0}
    - {name: t2, type: revolute, a: BLENGTH, alpha: 60 deg, d: 0}
    - {name: t3, type: revolute, a: 1, alpha: 30 deg, d: 0}
  links:
    - {name: A, mass: 1, com: [0.5, 0, 0], com_frame: joint, inertia: {xx: 0.01, yy: 0.1, zz: 0.1}}
    - {name: B, mass: 2, com: [0.8, 0, 0], com_frame: joint, inertia: {xx: 0.01, yy: 0.5, zz: 0.5}}
    - {name: C, mass: 1, com: [0.5, 0, 0], com_frame: joint, inertia: {xx: 0.01, yy: 0.1, zz: 0.1}}
  points: {pivot: {link: base, at: [-BLENGTH, 0, 0]}}
loops:
  - {name: last, type: revolute, between: [pivot, C.end], axis: [0, sqrt(3)/2, 1/2], axis2: [0, 0, 1]}
initial: {q: {t1: 80 deg}, qd: {t1: 2}, hold: [t1]}
simulate: {duration: 0.4, samples: 41, rtol: 1e-12, atol: 1e-12}
"""


def bennett(length: str = "sqrt(3)") -> Scene:
    return load_scene_text(BENNETT.replace("BLENGTH", length))


@lru_cache
def moved() -> Result:
    return simulate(bennett())


def test_redundant_rows_of_a_bennett_linkage_are_named() -> None:
    found = moved()
    redundant = found.summary["assembly"]["redundant_rows"]
    every = found.variables["constraints/multipliers"].names
    assert len(redundant) == 3 and {*redundant} < {*every}
    assert [*every] == [f"last.{row}" for row in ("x", "y", "z", "axis1", "axis2")]
    assert "least norm" in found.variables["constraints/multipliers"].long_name
    multipliers = found.summary["multipliers"]
    assert multipliers["unique"] is False and multipliers["choice"] == "least norm"
    assert multipliers["dependent"] == [{"loops": ["last"], "rows": [*every], "rank": 2}]
    told = " ".join(multiplier_lines(found.summary))
    assert f"redundant rows {', '.join(redundant)}: multipliers" in told, (
        "these, and no row that they follow from"
    )


def test_freedoms_left_by_loops_do_not_count_rounding_in_the_data() -> None:
    """Two rows that differ by 3e-8, as of a file with few digits, leave the freedom that one of them leaves."""
    psi = np.array([[1.0, 0.0, 0.0], [1.0, 3e-8, 0.0]])
    joints = [SimpleNamespace(name=f"j{v}", v=v, friction=True) for v in (1, 2)]
    assert not check_freedom(joints, psi, 1e-6)
    with pytest.raises(CapabilityError, match="in j1: loops"):
        check_freedom(joints, psi, 1e-10)
    held = [SimpleNamespace(name="j0", v=0, friction=True)]
    with pytest.raises(CapabilityError, match="in j0: loops"):
        check_freedom(held, psi, 1e-6)
    assert not check_freedom(joints, np.zeros((0, 3)), 1e-7)
    assert check_freedom(joints, np.array([[0.0, 1.0, -2.0]]), 1e-7), (
        "two joints, and one freedom between them"
    )


def test_a_bennett_linkage_satisfies_the_rows_left_out() -> None:
    problem = Problem(bennett())
    found = moved()
    for q, v in zip(found["q"], found["qd"]):
        at = {"q": q.tolist(), "v": v.tolist()}
        assert np.abs(evaluate(problem.constraints.eta, at)).max() < 1e-13
        psi = np.reshape(evaluate(list(problem.psi.ravel()), at), (5, 3))
        assert np.abs(psi @ v).max() < 1e-12


def test_a_bennett_linkage_moves_as_bennett_says() -> None:
    """t3 = -t1 and tan(t1/2) tan(t2/2) = sin((beta + alpha)/2) / sin((beta - alpha)/2); energy gives the rate."""
    found = moved()
    t1, t2, t3 = found["q"].T
    assert np.ptp(t1) > 0.4
    assert_close(np.sin((t1 + t3) / 2), np.zeros_like(t1), 1e-13, 1.0)
    expected = np.sin(np.pi / 4) / np.sin(np.pi / 12)
    ratio = np.sin(t1 / 2) * np.sin(t2 / 2) - expected * np.cos(t1 / 2) * np.cos(t2 / 2)
    assert_close(ratio, np.zeros_like(t1), 1e-12, 1.0)
    assert found.summary["energy_drift"] < 1e-10
    residual = found.summary["constraint_residual"]
    assert residual["position"] < 1e-14 and residual["velocity"] < 1e-13


def test_a_linkage_with_other_lengths_is_a_structure() -> None:
    with pytest.raises(GeometryError):
        simulate(
            load_scene_text(
                BENNETT.replace("BLENGTH", "1.7").replace("t1: 2}, hold: [t1]", "t1: 0}, hold: [t1]")
            )
        )


def oblique() -> Scene:
    """Return Drake's four-bar in a plane that no coordinate plane is parallel to."""
    rpy = (0.4, -0.7, 1.1)
    R = np.array(rotation_rpy(rpy), dtype=float)
    text = (BENCHMARKS / "drake_four_bar.yaml").read_text(encoding="utf-8")
    place = "origin: {{xyz: {}, rpy: {}}}".format
    text = text.replace("origin: {xyz: [2, 0, 0]}", place((R @ [2, 0, 0]).tolist(), list(rpy)))
    text = text.replace("parent: base, a: 4", f"parent: base, {place([0, 0, 0], list(rpy))}, a: 4", 1)
    return load_scene_text(text.replace("[0, -9.8, 0]", str((R @ [0, -9.8, 0]).tolist())))


def test_a_planar_mechanism_modelled_in_space_moves_as_in_its_plane() -> None:
    space, plane = simulate(oblique()), simulate(load_scene(BENCHMARKS / "drake_four_bar.yaml"))
    assert len(space.summary["assembly"]["redundant_rows"]) == 3
    assert plane.summary["assembly"]["redundant_rows"] == []
    assert_close(space["q"], plane["q"], 1e-10)
    assert_close(space["qd"], plane["qd"], 1e-10)
    assert_close(space["qdd"], plane["qdd"], 1e-9)
    assert_close(space["energy/total"], plane["energy/total"], 1e-10, 1e3)
    residual = space.summary["constraint_residual"]
    assert residual["position"] < 6e-12 and residual["velocity"] < 6e-12 * np.abs(space["qd"]).max()


TILT = [0.4, -0.7, 1.1]
STICKING = "friction: {coulomb: 3, law: set_valued}"
STOPPED = (
    "friction: {coulomb: 0.8, law: set_valued}, limits: {lower: -2.5, upper: 1.3, stop: {restitution: 0.5}}"
)


def four_bar(contact: str, rate: float, rpy: list[float]) -> Scene:
    """Return a four-bar in a plane that is turned with all that acts on it; only in the world's are rows left out."""
    turn = Rotation.from_euler("xyz", rpy)
    down, far = (turn.apply(x).tolist() for x in ([0, -9.81, 0], [1.5, 0, 0]))
    body = "mass: 1, com: [0.5, 0, 0], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}"
    return load_scene_text(f"""
schema: 1
gravity: {down}
robot:
  joints:
    - {{name: a, type: revolute, axis: [0, 0, 1], origin: {{rpy: {rpy}}}, {contact}}}
    - {{name: b, type: revolute, axis: [0, 0, 1], origin: {{xyz: [1, 0, 0]}}, friction: {{viscous: 0.05}}}}
    - {{name: c, type: revolute, axis: [0, 0, 1], parent: base, link: rock, origin: {{xyz: {far}, rpy: {rpy}}}}}
  links: [{{name: crank, {body}}}, {{name: coupler, {body}}}, {{name: rock, {body}}}]
  points: {{p: {{link: coupler, at: [2, 0, 0]}}, r: {{link: rock, at: [1.6, 0, 0]}}}}
loops: [{{name: pin, type: revolute, between: [p, r], axis: [0, 0, 1]}}]
initial: {{q: {{a: 1}}, qd: {{a: {rate}}}}}
simulate: {{duration: 6, samples: 121}}
""")


@pytest.mark.parametrize(
    ("contact", "rate", "kinds"), [(STICKING, 0, {"slip", "stick"}), (STOPPED, 2, {"slip", "impact"})]
)
def test_sticking_and_stops_where_rows_depend_on_each_other(
    contact: str, rate: float, kinds: set[str]
) -> None:
    """Holding torques and impacts are those of the same mechanism in the world's plane, which has no such rows."""
    flat, tilted = (simulate(four_bar(contact, rate, rpy)) for rpy in ([0.0, 0.0, 0.0], TILT))
    assert tilted.summary["multipliers"]["renewals"] > 0 and flat.summary["multipliers"]["unique"]
    assert kinds <= {*flat.summary["transitions"]}
    assert flat.summary["transitions"] == tilted.summary["transitions"]
    for name in ("q", "qd", "qdd", "tau", "energy/kinetic", "energy/work"):
        size = max(np.abs(flat[name]).max(), 1e-9)
        assert np.abs(flat[name] - tilted[name]).max() < 1e-8 * size, name
    assert tilted.summary["energy_drift_relative"] < 1e-8


def test_the_spectrum_where_rows_depend_on_each_other() -> None:
    """That of the mechanism in the world's plane, at the same state; the combination of the rows does not matter."""
    damped = "friction: {viscous: 0.1}"
    flat, tilted = (prepare(four_bar(damped, 2, rpy)) for rpy in ([0.0, 0.0, 0.0], TILT))
    assert tilted.problem.dependent and not flat.problem.dependent
    q, v = flat.assembled.q[None], flat.assembled.v[None]
    one, other = (eigenvalues(setup, np.zeros(1), q, v) for setup in (flat, tilted))
    assert one is not None and other is not None
    assert_close(np.sort_complex(one.eigenvalues), np.sort_complex(other.eigenvalues), 1e-10)
