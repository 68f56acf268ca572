"""``robodyn crosscheck``: scenes agree with Pinocchio and MuJoCo, and a wrong model is found."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.cli.app import run
from robodyn_cli.errors import CapabilityError
from robodyn_cli.over.crosscheck import crosscheck as module
from robodyn_cli.over.crosscheck.crosscheck import ENGINES, crosscheck
from robodyn_cli.over.crosscheck.engine import PeerEngine
from robodyn_cli.over.crosscheck.engines import MUJOCO_KINDS as MUJOCO
from robodyn_cli.over.crosscheck.engines import PINOCCHIO_KINDS as PINOCCHIO
from robodyn_cli.scene.load import load_scene, load_scene_text
from tests.unit.test_moving_references import PRESCRIBED, scene, start_at

CONFIGS = Path(__file__).parents[2] / "configs"
SOLID = "mass: %g, com: [0.11, -0.07, 0.13], inertia: {xx: 0.05, yy: 0.06, zz: 0.04, xy: 0.004, xz: -0.003, yz: 0.006}"
JOINTS = {
    "revolute": ("axis: [0.2, 1, 0.3], damper: {damping: 0.2}, gear_ratio: -20, rotor_inertia: 1e-4", "0.3", "0.5"),
    "prismatic": ("axis: [1, 0.3, 0], spring: {stiffness: 40, rest: 0.1}, rotor_inertia: 0.05", "0.2", "-0.4"),
    "helical": ("axis: [0, 1, 0.3], pitch: 0.05, friction: {viscous: 0.3}", "-0.4", "0.6"),
    "cylindrical": ("axis: [0, 0.2, 1], rotor_inertia: {theta: 0.02}, damper: {d: {damping: 2}}", "[0.3, 0.1]", "[1, 0.2]"),
    "universal": ("axis: [1, 0, 0], axis2: [0, 0, 1], gear_ratio: {theta1: 9}, rotor_inertia: {theta1: 1e-3}", "[0.3, -0.5]", "[1, -2]"),
    "planar": ("axis: [0, 0, 1], spring: {x: {stiffness: 30}}", "[0.1, 0.2, 0.3]", "[0.2, -0.3, 1]"),
    "spherical": ("spring: {stiffness: 2}, friction: {viscous: 0.1, coulomb: 0.2, transition_speed: 0.1}", "{rpy: [0.3, -0.4, 0.5]}", "[1, -2, 0.5]"),
    "floating": ("damper: {rotation: {damping: 0.1}}", "{xyz: [0.1, 0, 0.2], rpy: [0.3, -0.4, 0.5]}", "[0.4, 0.1, -0.3, 1, -2, 0.5]"),
}  # fmt: skip


def chain(kinds: list[str]) -> str:
    """Return a chain of joints, with a branch of two links at its root."""
    joints, links, q, qd = [], [], [], []
    for k, kind in enumerate(kinds):
        keys, position, rate = JOINTS[kind]
        place = f"origin: {{xyz: [0.3, {0.1 * k}, -0.1], rpy: [0.2, {0.3 - 0.2 * k}, 0.4]}}"
        parent = "parent: l0, " if k == 2 else ""
        joints.append(f"    - {{name: j{k}, type: {kind}, {parent}link: l{k}, {place}, {keys}}}\n")
        links.append(f"    - {{name: l{k}, {SOLID % (1.0 + 0.3 * k)}}}\n")
        q.append(f"j{k}: {position}")
        qd.append(f"j{k}: {rate}")
    return (
        "schema: 1\ngravity: [0.3, -0.4, -9.7]\nrobot:\n  base: {rpy: [0.1, 0.2, 0.3]}\n  joints:\n" + "".join(joints)
        + "  links:\n" + "".join(links) + "  points: {tip: {link: l0, at: [0.2, 0.1, 0]}}\n"
        "forces: [{name: pull, type: force, at: tip, force: ['3*sin(5*t)', 2, 0]}]\n"
        f"initial: {{q: {{{', '.join(q)}}}, qd: {{{', '.join(qd)}}}}}\nsimulate: {{duration: 0.7, samples: 36}}\n"
    )  # fmt: skip


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", JOINTS)
def test_every_joint_moves_alike(kind: str, engine: str) -> None:
    """In a tree with a hinge before and behind it; masses, axes and inertias are those of nobody's example."""
    text = chain(["revolute", kind, "revolute"])
    if engine == "mujoco" and kind not in MUJOCO:
        with pytest.raises(CapabilityError, match=f"is {kind}, which is not built in MuJoCo"):
            crosscheck(load_scene_text(text), engine)
        return
    found = crosscheck(load_scene_text(text), engine)
    assert found.command == "simulate"
    for one in found.compared:
        assert one.agrees, one
        assert one.difference < 1e-7
        assert 0.0 < one.our_error < 1e-8
    assert "force pull" in found.handed_over
    assert set(PINOCCHIO) == set(JOINTS)


@pytest.mark.parametrize("engine", ENGINES)
def test_torques_agree(engine: str) -> None:
    joints = ["revolute", "universal", "prismatic", "cylindrical", "planar"]
    motion = (
        "trajectory: {type: joint, duration: 1, q: {j0: 'sin(2*t)', j1: {theta1: 0.4*t, theta2: 'cos(3*t)'}, j2: 0.1*t, "
        "j3: {theta: t^2, d: 0.2*t}, j4: {x: 0.1, y: 't^3', theta: 'sin(t)'}}}\ninverse: {samples: 101}\n"
    )
    found = crosscheck(load_scene_text(chain(joints) + motion), engine)
    assert found.command == "inverse"
    (tau,) = found.compared
    assert tau.agrees and tau.difference < 1e-11
    assert set(found.by_own_formulas) == {
        "damper of j0", "spring of j2", "damper of j3.d", "spring of j4.x",
    }  # fmt: skip
    assert found.handed_over == ["force pull"]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("seventh", ["revolute", "spherical"])
def test_torques_on_a_moving_table_agree(seventh: str, engine: str) -> None:
    """A tool follows a path on a table that a belt carries, both led by formulas."""
    position, attitude = start_at("work", PRESCRIBED, seventh)
    found = crosscheck(scene(position + attitude, "work", PRESCRIBED, seventh), engine)
    assert found.command == "inverse" and not found.by_own_formulas
    (tau,) = found.compared
    assert tau.agrees and tau.difference < 1e-11


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("path", ["four_bar_deploy.yaml"])
def test_loops_agree(path: str, engine: str) -> None:
    found = crosscheck(load_scene(CONFIGS / path, ["simulate.duration=5", "simulate.samples=101"]), engine)
    assert found.agrees
    assert max(one.difference for one in found.compared) < 1e-8


@pytest.mark.parametrize("engine", ENGINES)
def test_motions_are_compared_until_a_singular_pose(engine: str) -> None:
    """Behind it another motion is as good: three legs side by side, first flat at 0.714 s, of 1 s."""
    path = CONFIGS / "benchmarks/four_bar_n2.yaml"
    found = crosscheck(load_scene(path, ["simulate.duration=1", "simulate.samples=101"]), engine)
    assert found.agrees and found.compared_until == pytest.approx(0.71)
    assert max(one.difference for one in found.compared) < 1e-8
    short = crosscheck(load_scene(path, ["simulate.duration=0.5", "simulate.samples=51"]), engine)
    assert short.agrees and not isinstance(short.compared_until, float)


LOOP = """
schema: 1
gravity: [0.5, -9.81, 1]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1]}
    - {name: b, type: spherical, origin: {xyz: [0.6, 0, 0.1]}, friction: {viscous: 0.05}}
    - {name: c, type: revolute, parent: base, link: l2, origin: {xyz: [1, 0.2, 0], rpy: [0.3, 0, 0]}, axis: [0, 0, 1]}
  links:
    - {name: l0, mass: 2, com: [0.3, 0.02, 0], inertia: {xx: 0.02, yy: 0.07, zz: 0.08, xy: 0.002, xz: 0.001, yz: 0.003}}
    - {name: l1, mass: 1, com: [0.2, 0.01, 0.03], inertia: {xx: 0.01, yy: 0.03, zz: 0.035, xy: 0.002, xz: 0.001, yz: 0.003}}
    - {name: l2, mass: 3, com: [0.2, -0.05, 0.02], inertia: {xx: 0.02, yy: 0.07, zz: 0.08, xy: 0.002, xz: 0.001, yz: 0.003}}
  points: {hook: {link: l1, at: [0.5, 0.1, 0]}, pin: {link: l2, at: [0.4, 0, 0.05]}}
loops: [{name: join, type: %s, between: [hook, pin]%s}]
initial: {q: {a: 1.2, b: {rpy: [0.1, 0.2, -1.5]}, c: 1.4}, hold: [a]}
simulate: {duration: 0.5, samples: 26}
"""


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", ["spherical", "revolute"])
def test_spatial_loops_agree(kind: str, engine: str) -> None:
    axis = ", axis: [0.1, 0.2, 1]" if kind == "revolute" else ""
    text = LOOP % (kind, axis)
    if kind == "revolute":  # one freedom: the hinge of the crank may slide to let the loop close
        text = text.replace("name: c, type: revolute", "name: c, type: cylindrical").replace(
            "c: 1.4", "c: [1.4, 0]"
        )
    found = crosscheck(load_scene_text(text), engine)
    assert found.agrees, found.compared
    assert max(one.difference for one in found.compared) < 1e-7


@pytest.mark.parametrize("engine", ENGINES)
def test_couplers_agree(engine: str) -> None:
    """A gear with an offset between turns, in a loop too."""
    text = LOOP % ("spherical", "")
    joint = "    - {name: d, type: revolute, parent: base, link: l3, axis: [0, 1, 0.2]}\n  links:\n"
    link = "    - {name: l3, mass: 1, com: [0.1, 0, 0.2], inertia: {xx: 0.02, yy: 0.03, zz: 0.02}}\n  points:"
    text = text.replace("  links:\n", joint).replace("  points:", link)
    text += "couplers: [{name: gear, terms: {d: 1, a: -0.5}, value: 0.3}]\n"
    found = crosscheck(load_scene_text(text), engine)
    assert found.agrees, found.compared
    assert max(one.difference for one in found.compared) < 1e-7
    timed = text.replace("value: 0.3", "value: 0.3*t")
    with pytest.raises(CapabilityError, match=r"couplers whose value changes in time \(gear\)"):
        crosscheck(load_scene_text(timed), engine)


def test_a_wrong_mass_is_found(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An engine whose model is 1e-6 too heavy differs by far more than the errors, and the exit code says so."""
    pytest.importorskip("pinocchio")
    right = module.translate

    def heavier(scene: object, simulated: bool) -> object:
        found = right(scene, simulated)  # type: ignore[arg-type]
        body = found.model.bodies[0]
        inertia = dataclasses.replace(
            body.inertia, m=body.inertia.m * (1 + 1e-6), h=body.inertia.h * (1 + 1e-6)
        )
        bodies = (dataclasses.replace(body, inertia=inertia), *found.model.bodies[1:])
        return dataclasses.replace(found, model=dataclasses.replace(found.model, bodies=bodies))

    path = tmp_path / "arm.yaml"
    path.write_text(chain(["revolute", "prismatic"]))
    assert run(["crosscheck", str(path), "--with", "pinocchio", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "ok"
    monkeypatch.setattr(module, "translate", heavier)
    assert run(["crosscheck", str(path), "--with", "pinocchio"]) == 1
    assert "DIFFER" in capsys.readouterr().out


FLIPPING = """schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{name: a, type: revolute, axis: [0, 0, 1]}, {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [1, 0, 0]}}]
  links: [{name: l1, mass: 1, com: [1, 0, 0], inertia: {zz: 0.1}}, {name: l2, mass: 1, com: [1, 0, 0], inertia: {zz: 0.1}}]
initial: {q: {a: 1.5, b: 0.5}}
simulate: {duration: %g, samples: 101}
"""


def test_errors_larger_than_the_motion_prove_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A double pendulum that turns over is known for a while alone; behind it any other one would agree as well."""
    pytest.importorskip("pinocchio")
    path = tmp_path / "flipping.yaml"
    path.write_text(FLIPPING % 3.0)
    assert run(["crosscheck", str(path), "--with", "pinocchio", "--json"]) == 0
    assert all(one["agrees"] for one in json.loads(capsys.readouterr().out)["compared"])
    path.write_text(FLIPPING % 60.0)
    assert run(["crosscheck", str(path), "--with", "pinocchio", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "open"
    for one in found["compared"]:
        assert one["agrees"] is None and one["difference"] <= one["allowed"] > one["size"] > 1.0
    assert run(["crosscheck", str(path), "--with", "pinocchio"]) == 1
    assert "q proves nothing" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["simulate", "inverse"])
def test_answers_that_stay_at_zero_agree(command: str) -> None:
    """They have no size, but that the other ones stay there too tells something."""
    pytest.importorskip("pinocchio")
    text = (FLIPPING % 1.0).replace("-9.81", "0").replace("1.5", "0").replace("0.5}", "0}")
    text += "trajectory: {type: joint, duration: 1, q: {a: 0, b: 0}}\n"
    found = crosscheck(load_scene_text(text), "pinocchio", command)
    assert found.status == "ok" and all(one.size == 0.0 for one in found.compared)


def test_motions_that_begin_beside_a_singular_pose_are_not_compared() -> None:
    path = CONFIGS / "benchmarks/four_bar_n2.yaml"
    sparse = load_scene(path, ["simulate.duration=2", "simulate.samples=3"])
    with pytest.raises(CapabilityError, match="before its second sample"):
        crosscheck(sparse, ENGINES[0])


def test_what_cannot_be_asked_is_listed() -> None:
    stop = "limits: {upper: 1, stop: {restitution: 0.5}}, "
    text = chain(["revolute", "revolute"]).replace("axis: [0.2, 1, 0.3], ", f"axis: [0.2, 1, 0.3], {stop}", 1)
    with pytest.raises(CapabilityError, match=r"rigid stops \(j0\)"):
        crosscheck(load_scene_text(text), "pinocchio")
    with pytest.raises(CapabilityError, match="'join' of type point_on_plane"):
        crosscheck(load_scene_text(LOOP % ("point_on_plane", ", axis: [0, 0, 1]")), "mujoco")
    with pytest.raises(CapabilityError, match="inverse dynamics of loops and couplers"):
        crosscheck(load_scene_text(LOOP % ("spherical", "")), "mujoco", "inverse")


@pytest.mark.parametrize("engine", ENGINES)
def test_inertias_that_an_engine_does_not_take(engine: str) -> None:
    """A part of a body, whose inertia about an axis that it does not turn about is negative."""
    text = """schema: 1\ncommand: inverse\ngravity: [0, 0, -9.81]
robot:
  joints: [{name: a, type: revolute, parent: base, link: A, axis: [0, 0, 1]}]
  links: [{name: A, mass: 1, com: [0, 0, 0], inertia: {xx: -0.2, yy: 0.1, zz: 0.1}}]
trajectory: {type: joint, duration: 1, q: {a: sin(t)}}
inverse: {samples: 5}"""
    with pytest.raises(CapabilityError, match="does not take"):
        crosscheck(load_scene_text(text), engine)


def test_links_that_mujoco_does_not_take_are_named() -> None:
    """Those of the Puma: one without mass, one whose measured moments no body has. MuJoCo itself names a line of XML."""
    with pytest.raises(CapabilityError) as refused:
        crosscheck(load_scene(CONFIGS / "benchmarks" / "puma560.yaml"), "mujoco")
    told = refused.value.message
    assert "'link1' (mass 0 kg, principal moments 0, 0, 0.35 kg m^2), 'link3' (mass 4.8 kg" in told
    assert "none of them above the sum of the others" in told and "link2" not in told and "line" not in told


def test_commands_that_are_not_compared_are_refused_by_name() -> None:
    scene = dataclasses.replace(load_scene_text(chain(["revolute"])), command="statics")
    with pytest.raises(
        CapabilityError, match="compares inverse and simulate, and the scene's command is 'statics'"
    ):
        crosscheck(scene, "pinocchio")
    assert module.compared_command(dataclasses.replace(scene, command="deploy")) == "simulate"


@pytest.mark.parametrize("engine", ENGINES)
def test_a_missing_engine_is_named(engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, engine, None)
    with pytest.raises(CapabilityError, match=r"pip install 'robodyn\[oracle\]'"):
        crosscheck(load_scene_text(chain(["revolute"])), engine)


def test_engines_agree_on_the_parts() -> None:
    """Mass matrix, torques, accelerations, and the frames of loops: each engine against the other."""
    pytest.importorskip("pinocchio")
    scene = load_scene_text(chain(["spherical", "universal", "planar"]))
    asked = module.translate(scene, True)
    one, other = (module._engine(name)(asked.model) for name in ENGINES)
    assert isinstance(one, PeerEngine) and isinstance(other, PeerEngine)
    rng = np.random.default_rng(1)
    for _ in range(5):
        q, v, a = (
            rng.normal(size=asked.model.nq),
            rng.normal(size=asked.model.nv),
            rng.normal(size=asked.model.nv),
        )
        q[:4] /= np.linalg.norm(q[:4])
        assert np.abs(one.torques(q, v, a) - other.torques(q, v, a)).max() < 1e-11
        tau = one.torques(q, v, a)
        assert np.abs(other.free_accelerations(q, v, tau) - a).max() < 1e-9
        frame = asked.model.points["tip"]
        for engine in (one, other):
            engine.bring(q, v)
        here, there = one.places([frame]), other.places([frame])
        for name in ("p", "R", "J", "a", "w"):
            assert np.abs(getattr(here, name) - getattr(there, name)).max() < 1e-11, name
        assert np.abs(one.mass_matrix() - other.mass_matrix()).max() < 1e-12
