"""The plan: counts are those of compiled programs, and every reason is a fact of the scene."""

from __future__ import annotations

import dataclasses
import gc
import json
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest

from robodyn_cli.commands import SCENE_COMMANDS, places
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.expr.graph import Expr
from robodyn_cli.kernels.program import Program
from robodyn_cli.model.build import build_model
from robodyn_cli.over.plan import plan as plan_module
from robodyn_cli.over.plan.plan import plan, render
from robodyn_cli.over.plan.plane import Plane
from robodyn_cli.over.plan.variants import Variant
from robodyn_cli.results.summary import as_keys
from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.torques.dynamics import InverseDynamics
from robodyn_cli.works.inverse import inverse

CONFIGS = Path(__file__).parents[2] / "configs"
SCENES = sorted(CONFIGS.glob("*.yaml"))
ELBOW = "robot.joints.theta2.origin={rpy: [30 deg, 0, 0]}"


def load(name: str, *overrides: str) -> Scene:
    return load_scene(CONFIGS / f"{name}.yaml", overrides)


def planned(name: str, *overrides: str, command: str | None = None) -> dict[str, Any]:
    return plan(load(name, *overrides), command)


def entry(found: dict[str, Any], part: str, term: str) -> dict[str, Any]:
    """Return the one entry of ``kept`` or ``left_out`` whose term starts with these words."""
    matching = [e for e in found[part] if e["term"].startswith(term)]
    assert len(matching) == 1, f"{term!r} among {[e['term'] for e in found[part]]}"
    one: dict[str, Any] = matching[0]
    return one


def kept(found: dict[str, Any], term: str) -> int:
    operations: int = entry(found, "kept", term)["operations"]
    return operations


def saved(found: dict[str, Any], term: str) -> int:
    operations: int = entry(found, "left_out", term)["operations_saved"]
    return operations


def kernel(found: dict[str, Any], name: str) -> dict[str, Any]:
    one: dict[str, Any] = next(k for k in found["kernels"] if k["name"].startswith(name))
    return one


# -- the contract --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_every_scene_has_a_plan(path: Path) -> None:
    found = plan(load_scene(path))
    assert found == plan(load_scene(path)), "the same scene gives the same plan"
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert 0 < found["operations"] < found["operations_general"]
    assert found["missing"] == []
    assert found["kept"] and found["left_out"] and found["kernels"]
    for part, count in (("kept", "operations"), ("left_out", "operations_saved")):
        terms = [e["term"] for e in found[part]]
        assert len(set(terms)) == len(terms)
        for e in found[part]:
            assert e["term"] and e["reason"], e
            if path.stem == "stick_slip" and e["term"].startswith("closed loops"):
                continue  # a pin across two parallel slides contradicts itself, and is not counted
            assert isinstance(e[count], int) and e[count] >= 0, e
    assert not {e["term"] for e in found["kept"]} & {e["term"] for e in found["left_out"]}
    assert all(k["shape"] in ("unrolled", "rolled") for k in found["kernels"])
    assert (
        kernel(found, "torques (" if found["command"] == "inverse" else "accelerations")["operations"]
        == (found["operations"])
    )


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_text_fits_the_terminal(path: Path) -> None:
    found = plan(load_scene(path))
    lines = render(found).splitlines()
    assert max(len(line) for line in lines) <= 100
    assert all(line == line.rstrip() for line in lines)
    text = " ".join(render(found).split())
    for words in ("Kept", "Left out", "code for any scene", str(found["operations_general"])):
        assert words in text
    for e in (*found["kept"], *found["left_out"]):
        assert e["term"].split()[0] in text


def test_commands() -> None:
    assert planned("2r_circle")["command"] == "inverse"
    assert planned("four_bar_deploy", command="simulate")["command"] == "simulate"
    with pytest.raises(CapabilityError, match="allowed: inverse, simulate, deploy"):
        planned("2r_circle", command="stability")
    with pytest.raises(CapabilityError, match="closed loops"):
        planned("2r_circle", command="deploy")
    with pytest.raises(SceneError, match="trajectory"):
        planned("four_bar_deploy", command="inverse")


@pytest.mark.parametrize("command", sorted(set(SCENE_COMMANDS) - set(places("plan"))))
def test_what_has_no_plan_is_refused_by_name(command: str) -> None:
    scene = dataclasses.replace(load_scene(CONFIGS / "2r_circle.yaml"), command=command)
    with pytest.raises(CapabilityError, match=f"'{command}' has no plan; allowed: inverse, simulate, deploy"):
        plan(scene)
    assert plan(scene, "inverse")["operations_of"] == "torques"


def test_inverse_dynamics_of_loops_is_planned() -> None:
    found = planned("mechanisms/five_bar_circle")
    assert found["command"] == "inverse"
    assert kept(found, "loop pin with multipliers") > 0 and kept(found, "inverse kinematics") > 0
    assert "equation_36" not in found, "which is solved by forward dynamics only"
    assert not any(e["term"].startswith("closed loops") for e in found["left_out"])


# -- counts are those of what is compiled --------------------------------------------------------------------


@pytest.mark.parametrize("name", [p.stem for p in SCENES if load_scene(p).command == "inverse"])
def test_inverse_counts_what_is_evaluated(name: str) -> None:
    scene = load(name, "inverse.samples=11")
    found = plan(scene)
    torques = InverseDynamics(scene)
    assert found["operations"] == torques.operations
    assert isinstance(torques.code, Program)
    assert kernel(found, "torques (")["digest"] == torques.code.digest[:12]
    counters = inverse(scene).summary["counters"]
    everything = kernel(found, "torque terms")
    assert everything["operations"] == counters["operations"]
    assert (everything["engine"] == "compiled") == counters["compiled"]


def test_inverse_says_when_it_compiles() -> None:
    scene = load("seven_joint_arm", "inverse.samples=100000")
    assert inverse(scene).summary["counters"]["compiled"]
    assert kernel(plan(scene), "torque terms")["engine"] == "compiled"


# -- the three scenes ----------------------------------------------------------------------------------------


def test_in_its_plane_the_arm_needs_least() -> None:
    plane, tilted, weightless = (planned(f"arm_{name}") for name in ("in_plane", "tilted", "weightless"))
    assert weightless["operations"] < plane["operations"] < tilted["operations"] / 2
    assert len({f["operations_general"] for f in (plane, tilted, weightless)}) == 1
    assert saved(plane, "motion out of the plane") > plane["operations"]
    reason = entry(plane, "left_out", "motion out of the plane")["reason"]
    assert "all turning axes are parallel to z" in reason and "gravity lies in it" in reason
    idle = {f"{what} of {link}" for link in ("link1", "link2")
            for what in ("com[2]", *(f"inertia.{k}" for k in ("xx", "yy", "xy", "xz", "yz")))}  # fmt: skip
    assert set(plane["given_without_effect"]) == idle == set(weightless["given_without_effect"])
    assert (
        "inertia.xx, yy, xy, xz, yz of link1 and link2"
        in (entry(plane, "left_out", "full inertia")["reason"])
    )


def test_tilted_out_of_its_plane_the_arm_needs_the_rest() -> None:
    plane, tilted = planned("arm_in_plane"), planned("arm_tilted")
    out = kept(tilted, "motion out of the plane")
    assert out == tilted["operations"] - plane["operations"], "with parallel axes it is the arm in its plane"
    assert "30 deg" in entry(tilted, "kept", "motion out of the plane")["reason"]
    assert kept(tilted, "full inertia of bodies") > 0
    assert not any(name.endswith("link2") for name in tilted["given_without_effect"])


def test_weightless_there_is_no_gravity() -> None:
    plane, weightless = planned("arm_in_plane"), planned("arm_weightless")
    assert kept(plane, "gravity") == plane["operations"] - weightless["operations"]
    assert entry(weightless, "left_out", "gravity")["reason"] == "gravity is zero"
    assert saved(weightless, "gravity") >= kept(plane, "gravity") > 0


def test_a_tilted_base_alone_loads_the_bearings() -> None:
    upright, leaning = planned("arm_in_plane"), planned("arm_in_plane", "robot.base={rpy: [30 deg, 0, 0]}")
    assert leaning["operations"] == upright["operations"]
    assert (
        "4.9 m/s^2 across the plane loads the bearings"
        in (entry(leaning, "left_out", "motion out of the plane")["reason"])
    )
    lying = planned("arm_in_plane", "gravity=[0, 0, -9.81]")
    assert "(0, 0, -9.81) m/s^2 loads no joint" in entry(lying, "left_out", "gravity")["reason"]
    assert lying["operations"] == planned("arm_weightless")["operations"]


def test_what_is_not_given_is_asked_for_only_where_it_is_needed() -> None:
    plane = planned("2r_circle")
    assert "inertia.xx of link2" in plane["not_given_and_not_needed"] and plane["missing"] == []
    assert plane["status"] == "ok"
    tilted = planned("2r_circle", ELBOW)
    assert tilted["status"] == "failed"
    others = ("xx", "yy", "xy", "xz", "yz")
    assert tilted["missing"] == [f"inertia.{k} of link2" for k in others]
    assert tilted["not_given_and_not_needed"] == [f"inertia.{k} of link1" for k in others]
    assert tilted["kernels"] == [], "nothing can be compiled"
    assert "cannot run: its equations need inertia.xx, yy, xy, xz, yz of link2" in render(tilted)
    with pytest.raises(SceneError, match=r"inertia\.xx of link2"):
        InverseDynamics(load("2r_circle", ELBOW))


# -- terms ---------------------------------------------------------------------------------------------------

FORCES = (
    ("viscous friction", "friction={viscous: 0.3}"),
    ("Coulomb friction", "friction={coulomb: 2.0, transition_speed: 0.01}"),
    ("joint springs", "spring={stiffness: 4.0, rest: 0.2}"),
    ("joint dampers", "damper={damping: 0.2}"),
    ("rotor inertia", "rotor_inertia=0.01"),
)


@pytest.mark.parametrize("command", ["inverse", "simulate"])
@pytest.mark.parametrize(("term", "change"), FORCES, ids=[t for t, _ in FORCES])
def test_joint_terms_cost_what_they_add(term: str, change: str, command: str) -> None:
    without = planned("arm_in_plane", command=command)
    one = planned("arm_in_plane", f"robot.joints.theta1.{change}", command=command)
    assert kept(one, term) == one["operations"] - without["operations"], "with its work, where it does any"
    assert "theta1" in entry(one, "kept", term)["reason"]
    assert saved(without, term) > 0


def test_drives() -> None:
    free = planned("double_pendulum")
    assert saved(free, "actuator torques") > 0 and saved(free, "work integral") > 0
    assert saved(free, "prescribed motion") > 0
    driven = planned("double_pendulum", 'torques={theta1: "2*sin(3*t)"}')
    assert kept(driven, "actuator torques") == driven["operations"] - free["operations"]
    assert "theta1" in entry(driven, "kept", "actuator torques")["reason"]
    assert kept(driven, "work integral") > 0
    assert entry(driven, "kept", "time as an input") and entry(free, "left_out", "time as an input")


def test_single_joints_have_no_coriolis_forces() -> None:
    text = """
        schema: 1
        gravity: [0, -9.81, 0]
        robot:
          joints: [{name: j, type: revolute, axis: [0, 0, 1]}]
          links: [{name: l, mass: 2, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 0.1}}]
        initial: {q: {j: 0.1}}
    """
    found = plan(load_scene_text(text))
    assert found["command"] == "simulate"
    assert "one joint alone" in entry(found, "left_out", "centrifugal")["reason"]
    assert (
        "the turning axis is parallel to z" in entry(found, "left_out", "motion out of the plane")["reason"]
    )


def test_links_on_fixed_joints_are_merged() -> None:
    text = """
        schema: 1
        gravity: [0, -9.81, 0]
        robot:
          joints:
            - {name: j, type: revolute, axis: [0, 0, 1]}
            - {name: weld, type: fixed, origin: {xyz: [0.5, 0, 0], rpy: [0, 0, 0.3]}}
          links:
            - {name: l, mass: 2, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
            - {name: tool, mass: 1, com: [0.1, 0, 0], com_frame: joint, inertia: {zz: 0.01}}
        initial: {q: {j: 0.1}}
    """
    found = plan(load_scene_text(text))
    assert saved(found, "links on fixed joints") > 0
    assert "1 fixed link merged" in found["mechanism"]
    assert found["operations"] < 10, "as for the pendulum alone"


MOUNTED = """
    schema: 1
    gravity: [0, -9.81, 0]
    robot:
      joints:
        - {name: mount, type: fixed, origin: {xyz: [0.1, 0, 0], rpy: [0, 0, 0.3]}}
        - {name: plate, type: fixed, origin: {xyz: [0.2, 0, 0]}}
        - {name: j1, type: revolute, axis: [0, 0, 1], origin: {xyz: [0.1, 0, 0]}}
        - {name: j2, type: revolute, axis: [0, 0, 1], origin: {xyz: [0.5, 0, 0]}}
      links:
        - {name: foot, mass: 1}
        - {name: shelf, mass: 1}
        - {name: upper, mass: 2, com: [0.2, 0, 0], inertia: {zz: 0.1}}
        - {name: lower, mass: 1, com: [0.2, 0, 0], inertia: {zz: 0.1}}
    initial: {q: {j1: 0.1, j2: 0.2}}
"""
ON_JOINTS = {
    "latch": "deploy: {until: end, latches: [{name: last, joint: j2, at: 0.5}]}\nsimulate: {duration: 1}",
    "control": "simulate: {duration: 1}\ncontrol: {type: gravity}",
    "prescribed": "prescribed: {j2: 0.2 + sin(t)}\nsimulate: {duration: 1}",
    "torques": "torques: {j2: 0.1 - 0.2*qd.j2}\nsimulate: {duration: 1}",
}


@pytest.mark.parametrize("feature", ON_JOINTS)
def test_links_that_are_fixed_first_shift_no_column(feature: str) -> None:
    """Joints without a coordinate have no column, in the model that keeps their links apart too."""
    scene = load_scene_text(dedent(MOUNTED) + ON_JOINTS[feature])
    merged, apart = (build_model(scene, merge=merge) for merge in (True, False))
    for names in ("joint_names", "q_names", "v_names", "q_units", "v_units"):
        assert getattr(merged, names) == getattr(apart, names)
    found = plan(scene, "deploy" if feature == "latch" else "simulate")
    assert entry(found, "left_out", "links on fixed joints")["operations_saved"] >= 0


@pytest.mark.parametrize("hold", ["rigid", "{stiffness: 30, damping: 0.2}"])
def test_latches_between_links_that_a_loop_joins(hold: str) -> None:
    """The equations without a loop, and those of a serial chain, have no latch across it."""
    scene = load_scene(
        CONFIGS / "mechanisms/four_bar_locked.yaml",
        [
            "deploy.latch=null",
            f"deploy={{until: end, latches: [{{name: l, between: [coupler, follower], when: t - 1, hold: {hold}}}]}}",
        ],
    )
    assert kept(plan(scene, "deploy"), "loop pin with multipliers") > 0


def test_spatial_arm() -> None:
    found = planned("seven_joint_arm")
    assert kept(found, "motion out of the plane") > found["operations"] / 2
    assert "90 deg" in entry(found, "kept", "motion out of the plane")["reason"]
    assert saved(found, "oblique directions of joints") > 0
    assert entry(found, "kept", "gears")["operations"] == 0
    assert {n.split(" of ")[1] for n in found["given_without_effect"]} == {"link1"}, "it only turns about z"


# -- closed loops --------------------------------------------------------------------------------------------


def test_loops_and_the_rows_that_vanish() -> None:
    found = planned("four_bar_deploy")
    assert "pin.x and pin.y" in entry(found, "kept", "loop pin with multipliers")["reason"]
    vanishing = entry(found, "left_out", "loop pin: 3 rows")
    assert vanishing["term"].endswith("pin.z, pin.axis1 and pin.axis2") and vanishing["operations_saved"] > 0
    block = found["equation_36"]
    open_tree = planned("four_bar_deploy", "loops=[]", command="simulate")
    assert block["open_tree"] == open_tree["operations"]
    assert block["loop_terms"] == found["operations"] - open_tree["operations"]
    assert block["projection_of_positions"] == kernel(found, "projection of positions")["operations"]
    assert saved(found, "Baumgarte's terms") > 0
    assert kept(found, "event: dead point") > 0
    assert saved(open_tree, "closed loops and their multipliers") > 0
    assert "equation_36" not in open_tree


def test_the_four_bar_costs_little_more_than_an_open_chain() -> None:
    block = planned("four_bar_deploy")["equation_36"]
    assert block["ratio"] == round(block["operations"] / block["open_chain_of_as_many_joints"], 3)
    assert block["ratio"] <= 1.5  # masses at joints save the open chain more than the loop


def test_stabilisation_is_one_or_the_other() -> None:
    projected = planned("four_bar_deploy", command="simulate")
    damped = planned("four_bar_deploy", "simulate.stabilisation={alpha: 5, beta: 5}", command="simulate")
    assert damped["operations"] > projected["operations"]
    assert kept(damped, "Baumgarte's terms") == damped["operations"] - projected["operations"]
    assert saved(damped, "projection") == kept(projected, "projection")
    assert not any(k["name"].startswith("projection") for k in damped["kernels"])
    neither = planned("four_bar_deploy", "simulate.stabilisation=none", command="simulate")
    assert neither["operations"] == projected["operations"]
    assert "asks for none" in entry(neither, "left_out", "projection")["reason"]


def test_redundant_rows_are_named() -> None:
    # a planar four-bar whose axes are no coordinate axis: rows out of its plane do not vanish, but depend
    axis = "axis: [1, 2, 2]"
    link = "mass: 1, com: [0.2, 0.2, -0.3], com_frame: link, inertia: {xx: 0.1, yy: 0.1, zz: 0.1}"
    text = f"""
        schema: 1
        gravity: [0, 0, -9.81]
        robot:
          joints:
            - {{name: a, type: revolute, parent: base, {axis}}}
            - {{name: b, type: revolute, parent: crank, {axis}, origin: {{xyz: [0.4, 0.4, -0.6]}}}}
            - {{name: c, type: revolute, parent: base, {axis}, origin: {{xyz: [2, -1, 0]}}}}
          links: [{{name: crank, {link}}}, {{name: coupler, {link}}}, {{name: follower, {link}}}]
          points: {{p: {{link: coupler, at: [2, -1, 0]}}, q: {{link: follower, at: [0.4, 0.4, -0.6]}}}}
        loops: [{{name: pin, type: revolute, between: [p, q], {axis}}}]
        initial: {{q: {{a: 0.5, b: -0.5, c: 0.5}}}}
    """
    found = plan(load_scene_text(text))
    assert kept(found, "combination of dependent rows") > 0
    assert "follow from the other rows" in entry(found, "kept", "combination of dependent rows")["reason"]
    assert "2 constraint rows of 5" in found["mechanism"]


# -- large models --------------------------------------------------------------------------------------------


def long_chain(n: int, more: str) -> str:
    """Return the scene of a chain of n revolute joints."""
    place = "a: 0.3, alpha: 90 deg, d: 0.1"
    joints = "\n".join(f"    - {{name: q{k}, type: revolute, {place}}}" for k in range(n))
    inertia = "inertia: {xx: 0.1, yy: 0.1, zz: 0.1, xy: 0, xz: 0, yz: 0}"
    links = "\n".join(
        f"    - {{name: l{k}, mass: 1, com: [-0.1, 0.02, 0], com_frame: link, {inertia}}}" for k in range(n)
    )
    head = "schema: 1\ngravity: [0, 0, -9.81]\nrobot:\n  convention: standard\n  joints:\n"
    return f"{head}{joints}\n  links:\n{links}\n{more}"


@pytest.mark.parametrize("data", ["known", "missing"])
def test_of_a_large_model_one_set_of_equations_is_there_at_a_time(
    data: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those that are counted apart are gone when the command's are built, without the collector of cycles, and nothing
    is built in their place later."""
    built, seen = plan_module._built, []
    gc.collect()
    gc.disable()

    def nodes() -> int:
        return sum(type(one) is Expr for one in gc.get_objects())

    def watched(subject: Any) -> Any:
        seen.append(nodes())
        found = built(subject)
        seen.append(nodes())
        return found

    monkeypatch.setattr(plan_module, "_built", watched)
    monkeypatch.setattr(plan_module, "as_keys", lambda report: seen.append(nodes()) or as_keys(report))
    n, others = 100, nodes()
    inertia = {"known": "{xx: 0.1, yy: 0.1, zz: 0.1, xy: 0, xz: 0, yz: 0}", "missing": "{zz: 0.1}"}
    text = long_chain(n, "").replace(inertia["known"], inertia[data])
    try:
        found = plan(load_scene_text(text.replace("alpha: 90 deg, d: 0.1", "alpha: 0 deg, d: 0")), "simulate")
    finally:
        gc.enable()
    assert not found["terms_counted"] and not found["missing"]
    before, own, end = (count - others for count in seen)
    assert before < 50 * n, "the general equations are gone"
    assert own > 200 * n and end < 1.2 * own


def test_accelerations_of_a_large_model_are_built_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """For the choice of the way to them, and for the counts; those of other equations are in other graphs."""
    solved: list[Problem] = []  # which keeps them, so that no two have the same identity
    ways = Problem.ways_to_accelerations

    def counted(problem: Problem, f: Any) -> Any:
        solved.append(problem)
        return ways(problem, f)

    monkeypatch.setattr(Problem, "ways_to_accelerations", counted)
    found = plan(load_scene_text(long_chain(40, "")), "simulate")
    assert solved and len(set(map(id, solved))) == len(solved)
    (choice,) = (c for c in found["choices"] if c["choice"] == "accelerations")
    assert choice["operations"] == {"articulated bodies": found["operations"]}


def test_large_models_are_counted_as_a_whole_only(monkeypatch: pytest.MonkeyPatch) -> None:
    n = 100
    motion = ", ".join(f"q{k}: 0.1*t" for k in range(n))
    tail = f"trajectory: {{type: joint, duration: 1, q: {{{motion}}}}}\n"
    scene = load_scene_text(long_chain(n, tail))
    built: list[int] = []
    problem = Variant.problem

    def count(variant: Variant) -> Any:
        built.append(1)
        return problem(variant)

    monkeypatch.setattr(Variant, "problem", count)
    found = plan(scene)
    assert len(built) <= 2
    compiled = InverseDynamics(scene)
    torques = kernel(found, "torques (")
    assert (torques["shape"], torques["operations"]) == (compiled.shape, compiled.operations)
    assert not found["terms_counted"] and found["operations_general"] > found["operations"] > 1000
    assert all(e["operations_saved"] in (None, 0) for e in found["left_out"])
    assert "not counted one by one" in render(found)


@pytest.mark.parametrize("size", [1e-160, 9.81, 1e160])
def test_the_plane_of_a_slide_holds_its_gravity(size: float) -> None:
    scene = load_scene_text(
        f"""
schema: 1
gravity: [0, {size}, {-0.5 * size}]
robot:
  joints: [{{name: slide, type: prismatic, axis: [0, 0, 1]}}]
  links: [{{name: bar, mass: 1}}]
initial: {{q: {{slide: 0}}}}
"""
    )
    normal = Plane(build_model(scene)).normal
    assert normal is not None
    np.testing.assert_allclose(np.abs(normal), (1.0, 0.0, 0.0), atol=1e-12)
    assert plan(scene, "simulate")
