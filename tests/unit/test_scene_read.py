"""Reading values: what is accepted, and for each spoiled key the exact place, the key and a helpful word."""

from __future__ import annotations

import dataclasses
import math

import pytest

from robodyn_cli.expr.formula import parse
from robodyn_cli.forces.friction import CoulombPair, Friction
from robodyn_cli.forces.registry import joint_forces
from robodyn_cli.forces.springs import Damper, Spring
from robodyn_cli.scene import load_scene_text
from robodyn_cli.scene.types import Baumgarte, Initial, Scene, Torque
from robodyn_cli.schema.fields import Inline, Kind, describe
from tests.unit.scene_text import SCENE, refusals, spoiled


def load(old: str = "", new: str = "") -> Scene:
    return load_scene_text(spoiled(old, new))


def test_the_scene_itself() -> None:
    scene = load()
    assert scene.schema == 1
    assert scene.gravity == (0.0, -9.81, 0.0)
    assert [j.type for j in scene.robot.joints] == ["revolute", "prismatic", "fixed"]
    assert scene.robot.joints[1].alpha == math.pi / 2
    assert scene.robot.joints[2].origin is not None
    assert scene.robot.joints[2].origin.xyz == (0.1, 0.0, 0.0)
    assert scene.robot.links[0].com == (0.5, 0.0, 0.0)
    assert scene.robot.links[1].com is None
    assert scene.robot.points["post"].at == (1.0, 0.0, 0.0)
    assert scene.torques["j1"].constant == 1.0
    assert scene.initial.q == {"j1": 0.1}


def test_absent_maps_are_empty_and_defaults_stand() -> None:
    scene = load()
    assert scene.prescribed == {} and scene.robot.frames == {} and scene.initial.qd == {}
    assert scene.loops == () and scene.actuated is None and scene.trajectory is None
    assert scene.simulate.integrator == "auto" and scene.simulate.rtol == 1e-10
    assert load("initial: {q: {j1: 0.1}}", "").initial == Initial()
    assert load("initial: {q: {j1: 0.1}}", "initial: {q: }").initial.q == {}


def test_links_and_parents_are_filled_in() -> None:
    joints = load().robot.joints
    assert [(j.link, j.parent) for j in joints] == [("l1", "base"), ("l2", "l1"), ("l3", "l1")]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2", 2.0),
        ("1e-3", 1e-3),
        ("pi/2", math.pi / 2),
        ("'2*pi*0.3'", 2 * math.pi * 0.3),
        ("sqrt(2)", math.sqrt(2.0)),
        ("2*sin(30 deg)", 1.0),
        ("'1.5'", 1.5),
    ],
)
def test_numbers_may_be_constant_formulas(text: str, value: float) -> None:
    assert load("a: 1.0", f"a: {text}").robot.joints[0].a == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("key", ["alpha", "offset"])
def test_angles_in_degrees(key: str) -> None:
    scene = load("a: 1.0, alpha: 0", f"a: 1.0, {key}: -(40 + 50) deg")
    assert getattr(scene.robot.joints[0], key) == -math.pi / 2


def test_joint_forces_are_keys_of_the_joint() -> None:
    written = "a: 1.0, damper: {damping: 3}, friction: {viscous: 0.1, coulomb: {positive: 1, negative: -2}}"
    joint = load("a: 1.0", written).robot.joints[0]
    assert joint.forces == (
        ("friction", Friction(viscous=0.1, coulomb=CoulombPair(1.0, -2.0))),
        ("damper", Damper(3.0)),
    )
    joint = load("a: 1.0", "a: 1.0, spring: {stiffness: 5, rest: 90 deg}").robot.joints[0]
    assert joint.forces == (("spring", Spring(5.0, math.pi / 2)),)
    assert load().robot.joints[0].forces == ()


def test_torques_are_numbers_formulas_or_tables() -> None:
    assert load("{j1: 1}", "{j1: 1 + 2}").torques["j1"].constant == 3.0
    formula = load("{j1: 1}", "{j1: 1 - k*j1 + 2*qd.j2*t}").torques["j1"]
    assert formula.names == {"p.k", "q.j1", "qd.j2", "t"}
    assert formula == parse("1 - p.k*q.j1 + 2*qd.j2*t")
    table = load("{j1: 1}", "{j1: {table: [[0, 1], [1, -1]]}}").torques["j1"]
    assert table == Torque(((0.0, 1.0), (1.0, -1.0)))


def test_either_kinds() -> None:
    assert load("", "simulate: {stabilisation: none}").simulate.stabilisation == "none"
    assert load("", "simulate: {stabilisation: {alpha: 1, beta: 2}}").simulate.stabilisation == Baumgarte(
        1.0, 2.0
    )


def test_whole_numbers() -> None:
    assert load("", "inverse: {samples: 1e5}").inverse.samples == 100_000
    assert isinstance(load("", "inverse: {samples: 1e5}").inverse.samples, int)


def test_null_stands_for_an_absent_key_where_absent_is_none() -> None:
    assert load("", "command: null\ntrajectory: ~\nactuated:\n").command is None


BAD = {
    # unknown and missing keys
    "unknown top": (
        "",
        "§titel: x",
        "titel",
        "unknown key 'titel'",
        "did you mean 'title'",
        "allowed: schema",
    ),
    "unknown in joint": ("a: 1.0", "§aplha: 1.0", "robot.joints.0.aplha", "did you mean 'alpha'"),
    "unknown force": ("a: 1.0", "§frction: {}", "robot.joints.0.frction", "did you mean 'friction'"),
    "unknown in force": (
        "a: 1.0",
        "friction: {§viscos: 1}",
        "robot.joints.0.friction.viscos",
        "did you mean 'viscous'",
    ),
    "the holder is no key": ("a: 1.0", "§forces: {}", "robot.joints.0.forces", "unknown key"),
    "case": ("gravity", "§Gravity", "Gravity", "did you mean 'gravity'"),
    "missing top": (
        "schema: 1\ngravity: [0, -9.81, 0]\n",
        "§schema: 1\n",
        "",
        "'gravity' is missing",
        "schema, robot, gravity",
    ),
    "missing in joint": (
        "{name: j2, type: prismatic, ",
        "§{name: j2, ",
        "robot.joints.1",
        "'type' is missing",
        "needed here: name, type",
    ),
    "missing in force": ("a: 1.0", "spring: §{}", "robot.joints.0.spring", "'stiffness' is missing"),
    "missing in either": (
        "",
        "simulate: {stabilisation: §{alpha: 1}}",
        "simulate.stabilisation",
        "'beta' is missing",
    ),
    # numbers
    "boolean is no number": ("a: 1.0", "a: §true", "robot.joints.0.a", "value true", "allowed: a number [m]"),
    "empty number": (
        "gravity: [0, -9.81, 0]",
        "gravity: [0, §null, 0]",
        "gravity.1",
        "has no value; allowed: a number",
    ),
    "list for number": ("a: 1.0", "a: §[1]", "robot.joints.0.a", "value [1]"),
    "map for number": ("a: 1.0", "a: §{b: 1}", "robot.joints.0.a", "a map"),
    "words for number": ("a: 1.0", "a: §one metre", "robot.joints.0.a", "column 5", "'one metre'"),
    "unit for number": ("a: 1.0", "a: §1.0 kg", "robot.joints.0.a", "length in m expected, 1.0 kg is a mass"),
    "name in number": ("a: 1.0", "a: §k", "robot.joints.0.a", "is not a number: 'k' is part of it"),
    "deg for a length": (
        "a: 1.0",
        "a: §10 deg",
        "robot.joints.0.a",
        "length in m expected, 10 deg is an angle",
    ),
    "deg for gravity": ("-9.81", "§-9.81 deg", "gravity.1", "-9.81 deg is an angle"),
    "nan": ("-9.81", "§.nan", "gravity.1", "is not finite"),
    "inf": ("-9.81", "§-.inf", "gravity.1", "is not finite"),
    "overflow": ("-9.81", "§1e999", "gravity.1", "is not finite"),
    "nan in formula key": ("{j1: 1}", "{j1: §.nan}", "torques.j1", "is not finite"),
    "inf in initial": ("{j1: 0.1}", "{j1: §.inf}", "initial.q.j1", "is not finite"),
    "negative mass": ("mass: 1, com", "mass: §-1, com", "robot.links.0.mass", "too small", ">= 0"),
    "exclusive": (
        "",
        "simulate: {duration: §0}",
        "simulate.duration",
        "too small",
        "allowed: a number > 0 [s]",
    ),
    "too large": ("", "simulate: {rtol: §1}", "simulate.rtol", "too large", "<= 0.1"),
    "fraction": ("", "inverse: {samples: §10.5}", "inverse.samples", "not a whole number"),
    "few samples": ("", "inverse: {samples: §1}", "inverse.samples", "too small", ">= 2 and <= 100000000"),
    "version": ("schema: 1", "schema: §2", "schema", "is not known here (value 2)", "allowed: 1"),
    # other scalars
    "yes is no boolean": ("", "simulate: {error_estimate: §yes}", "simulate.error_estimate", "true or false"),
    "True is no boolean": (
        "",
        "simulate: {error_estimate: §True}",
        "simulate.error_estimate",
        "true or false",
    ),
    "number for text": ("", "title: §2024", "title", "put it in quotes"),
    "empty text": ("", "title:§\n", "title", "has no value"),
    "choice": ("standard", "§standart", "robot.convention", "did you mean 'standard'", "standard, modified"),
    "choice is a list": ("standard", "§[standard]", "robot.convention", "allowed: standard, modified"),
    "joint type": ("type: fixed", "type: §fix", "robot.joints.2.type", "allowed: revolute, prismatic, fixed"),
    "choice of either": (
        "at: end",
        "at: §ende",
        "robot.points.tip.at",
        "did you mean 'end'",
        "a list of 3 numbers",
    ),
    "shape of either": ("at: end", "at: §{x: 1}", "robot.points.tip.at", "allowed: origin, end, com"),
    # names
    "name": ("{name: j1,", "{name: §1j,", "robot.joints.0.name", "'1j' cannot be the name of a joint"),
    "name with a space": ("{name: l2,", "{name: §l 2,", "robot.links.1.name", "cannot be the name of a link"),
    "name with a slash": ("tip:", "§a/b:", "robot.points.a/b", "cannot be the name of a point"),
    "joint with a dash": ("{name: j1,", "{name: §j-1,", "robot.joints.0.name", "sign in formulas"),
    "joint called t": ("{name: j1,", "{name: §t,", "robot.joints.0.name", "has a meaning in formulas"),
    "joint called pi": ("{name: j1,", "{name: §pi,", "robot.joints.0.name", "has a meaning in formulas"),
    "parameter called e": ("{k: 0.1}", "{§e: 0.1}", "parameters.e", "has a meaning in formulas"),
    "parameter with a dash": ("{k: 0.1}", "{§k-k: 0.1}", "parameters.k-k", "sign in formulas"),
    # collections
    "short vector": ("[0, -9.81, 0]", "§[0, -9.81]", "gravity", "has 2 entries", "a list of 3 numbers"),
    "number for vector": ("[0, -9.81, 0]", "§9.81", "gravity", "a list of 3 numbers [m/s^2]"),
    "text in vector": ("[0, -9.81, 0]", "[0, 0, §z]", "gravity.2", "'z' is part of it"),
    "map for list": ("", "loops: §{name: pin}", "loops", "allowed: a list of"),
    "short list": ("", "deploy: {latch: {between: §[l1]}}", "deploy.latch.between", "has 1 entry", "2 names"),
    "long list": ("", "deploy: {latch: {between: §[l1, l2, l3]}}", "deploy.latch.between", "has 3 entries"),
    "list for map": ("{j1: 1}", "§[j1, 1]", "torques", "a map from names of joints"),
    "scalar for section": ("{q: {j1: 0.1}}", "§3", "initial", "is not a map", "q, qd, hold"),
    "list for section": ("{name: l2, mass: 1}", "§[l2, 1]", "robot.links.1", "is not a map"),
    "null for section": ("initial: {q: {j1: 0.1}}", "initial:§\n", "initial", "has no value"),
    "null for file": ("", "simulate: §null", "simulate", "has no value"),
    # kinds chosen by their type
    "no type": ("", "trajectory: §{point: tip}", "trajectory", "'type' is missing", "joint, quintic, cubic"),
    "wrong type": ("", "trajectory: {type: §circel}", "trajectory.type", "did you mean 'circle'"),
    "type is a list": ("", "trajectory: {type: §[circle]}", "trajectory.type", "allowed: joint, quintic"),
    "loop type": (
        "",
        "loops: [{name: p, type: §pin, between: [l1.end, l2.end]}]",
        "loops.0.type",
        "allowed: revolute",
    ),
    # formulas
    "formula syntax": (
        "{j1: 1}",
        "{j1: §1 +* 2}",
        "torques.j1",
        "formula '1 +* 2', column 4",
        "allowed: a number or",
    ),
    "formula name": ("{j1: 1}", "{j1: §2*j9}", "torques.j1", "column 3: unknown name 'j9'"),
    "formula function": ("{j1: 1}", "{j1: §sn(t)}", "torques.j1", "did you mean 'sin'"),
    "formula boolean": ("{j1: 1}", "{j1: §true}", "torques.j1", "value true"),
    "formula list": ("{j1: 1}", "{j1: §[1]}", "torques.j1", "allowed: a number or a formula"),
    "formula of a fixed joint": ("{j1: 1}", "{j1: §2*weld}", "torques.j1", "'weld' is fixed"),
    "only t": ("torques: {j1: 1}", "prescribed: {j1: §0.1*j2}", "prescribed.j1", "'j2' is not allowed here"),
    "python": ("{j1: 1}", "{j1: §\"__import__('os').getcwd()\"}", "torques.j1", "unexpected"),
}


test_refused_at_its_place = refusals(BAD)


def test_every_kind_of_every_key_can_be_described() -> None:
    """A new kind of value needs words for messages, and every key needs a sentence for the reference."""
    seen: set[type] = set()

    def visit(cls: type) -> None:
        if cls in seen:
            return
        seen.add(cls)
        for field in dataclasses.fields(cls):
            kind = field.metadata.get("kind")
            if kind is None:
                continue
            assert describe(kind, field.metadata["unit"]) != "a value", (cls, field.name)
            assert field.metadata["doc"].endswith("."), (cls, field.name)
            follow(kind)

    def follow(kind: Kind) -> None:
        if isinstance(kind, Inline):
            assert all(name in describe(kind) for name in joint_forces)
        registry = getattr(kind, "registry", None)
        for cls in registry().values() if registry else ():
            visit(cls)
        if hasattr(kind, "cls"):
            visit(kind.cls)
        for inner in getattr(kind, "kinds", ()):
            follow(inner)
        if hasattr(kind, "item"):
            follow(kind.item)

    visit(Scene)
    assert len(seen) > 20


def test_scenes_with_the_same_values_are_equal() -> None:
    assert load() == load_scene_text(SCENE.replace("1.0", "1"), path="elsewhere.yaml")
    assert load() != load("a: 1.0", "a: 1.1")
