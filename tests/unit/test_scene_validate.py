"""Checks that look at more than one key: what is refused, where the complaint points, what it proposes."""

from __future__ import annotations

import pytest

from robodyn_cli.scene import load_scene_text
from robodyn_cli.scene.load import examine
from tests.unit.scene_text import complaint, refusals, spoiled

PIN = "loops: [{{name: pin, type: revolute, between: [{}]}}]"

BAD = {
    # names
    "joint twice": ("{name: j2, type", "{name: §j1, type", "robot.joints.1.name", "joint 'j1' appears twice"),
    "link twice": (
        "{name: l2, mass: 1}",
        "{name: §l1, mass: 1}",
        "robot.links.1.name",
        "link 'l1' appears twice",
    ),
    "loop twice": (
        "",
        "loops:\n  - {name: a, type: revolute, between: [l1.end, l2.end]}\n"
        "  - {name: §a, type: revolute, between: [l1.end, l2.end]}",
        "loops.1.name",
        "loop 'a' appears twice",
    ),
    "link called base": ("{name: l3, ", "{name: §base, ", "robot.links.2.name", "is the ground"),
    "parameter is a joint": ("{k: 0.1}", "{§j1: 0.1}", "parameters.j1", "is a joint already"),
    # the tree
    "too few links": (
        "  links:",
        "    - §{name: j4, type: revolute, axis: [0, 0, 1]}\n  links:",
        "robot.joints.3",
        "joint 'j4' moves no link: there are only 3",
    ),
    "link without joint": (
        "    - {name: l3, mass: 1}",
        "    - {name: l3}\n    - §{name: l4}",
        "robot.links.3",
        "no joint",
    ),
    "unknown link": (
        "{name: j2, type",
        "{name: j2, link: §l22, type",
        "robot.joints.1.link",
        "did you mean 'l2'",
    ),
    "moves base": (
        "{name: j2, type",
        "{name: j2, link: §base, type",
        "robot.joints.1.link",
        "cannot move 'base'",
    ),
    "moved twice": (
        "{name: j2, type",
        "{name: j2, link: §l1, type",
        "robot.joints.1.link",
        "by joint 'j1' already",
    ),
    "moved twice by default": (
        "{name: j1, type: revolute, a: 1.0, alpha: 0, d: 0}\n    - {name: j2",
        "{name: j1, link: l2, type: revolute, a: 1.0, alpha: 0, d: 0}\n    - §{name: j2",
        "robot.joints.1.link",
        "'l2' is moved by joint 'j1' already",
    ),
    "unknown parent": ("parent: l1", "parent: §l9", "robot.joints.2.parent", "allowed: base, l1, l2, l3"),
    "own parent": (
        "{name: j2, type",
        "{name: j2, parent: §l2, type",
        "robot.joints.1.parent",
        "cycle: l2 -> l2",
    ),
    "cycle": (
        "{name: j1, type",
        "{name: j1, parent: §l2, type",
        "robot.joints.0.parent",
        "l1 -> l2 -> l1",
        "'loops'",
    ),
    # placement
    "no convention": (
        "  convention: standard\n  joints:",
        "  §joints:",
        "robot.convention",
        "joint 'j1' has D-H",
        "standard, modified",
    ),
    "axis beside D-H": ("a: 1.0", "a: 1.0, §axis: [0, 0, 1]", "robot.joints.0.axis", "D-H parameter 'a'"),
    "zero axis": ("a: 1.0, alpha: 0, d: 0", "axis: §[0, 0, 0]", "robot.joints.0.axis", "must not be zero"),
    "axis too short": (
        "a: 1.0, alpha: 0, d: 0",
        "axis: §[0, 0, 1e-300]",
        "robot.joints.0.axis",
        "has length 1e-300",
    ),
    "axis too long": ("a: 1.0, alpha: 0, d: 0", "axis: §[1e300, 0, 1]", "robot.joints.0.axis", "a direction"),
    "no placement": (
        "{name: j1, type: revolute, a: 1.0, alpha: 0, d: 0}",
        "§{name: j1, type: revolute}",
        "robot.joints.0",
        "D-H parameters (a, alpha, d, theta) or an 'axis'",
    ),
    "theta of revolute": ("a: 1.0", "a: 1.0, §theta: 1", "robot.joints.0.theta", "'offset'"),
    "d of prismatic": ("theta: 0", "theta: 0, §d: 1", "robot.joints.1.d", "'offset'"),
    "com_frame": (
        "{name: l1, mass: 1, com: [0.5, 0, 0], com_frame: joint}",
        "§{name: l1, mass: 1, com: [0.5, 0, 0]}",
        "robot.links.0",
        "'com_frame' is missing",
        "allowed: joint, link",
    ),
    "gear 0": ("a: 1.0", "a: 1.0, gear_ratio: §0", "robot.joints.0.gear_ratio", "must not be zero"),
    "deg of prismatic offset": (
        "theta: 0",
        "theta: 0, offset: §5 deg",
        "robot.joints.1.offset",
        "'deg'",
        "length in m expected",
    ),
    "deg of prismatic q": ("{q: {j1: 0.1}}", "{q: {j2: §5 deg}}", "initial.q.j2", "'deg' does not fit"),
    "deg of prismatic qd": ("{q: {j1: 0.1}}", "{qd: {j2: §5 deg}}", "initial.qd.j2", "'deg' does not fit"),
    # fixed joints
    "fixed friction": (
        "parent: l1",
        "parent: l1, §friction: {}",
        "robot.joints.2.friction",
        "'weld' is fixed",
    ),
    "fixed spring": (
        "parent: l1",
        "parent: l1, §spring: {stiffness: 1}",
        "robot.joints.2.spring",
        "'weld' is fixed",
    ),
    "fixed gear": (
        "parent: l1",
        "parent: l1, §gear_ratio: 1",
        "robot.joints.2.gear_ratio",
        "takes no 'gear_ratio'",
    ),
    "fixed rotor": (
        "parent: l1",
        "parent: l1, §rotor_inertia: 0",
        "robot.joints.2.rotor_inertia",
        "takes no",
    ),
    "fixed offset": ("parent: l1", "parent: l1, §offset: 0", "robot.joints.2.offset", "takes no 'offset'"),
    "fixed axis": ("parent: l1", "parent: l1, §axis: [0, 0, 1]", "robot.joints.2.axis", "takes no 'axis'"),
    "fixed in torques": ("{j1: 1}", "{§weld: 1}", "torques.weld", "no coordinate; allowed: j1, j2"),
    "fixed in prescribed": ("", "prescribed: {§weld: t}", "prescribed.weld", "no coordinate"),
    "fixed in actuated": ("", "actuated: [j1, §weld]", "actuated.1", "no coordinate"),
    "fixed in q": ("{q: {j1: 0.1}}", "{q: {§weld: 0.1}}", "initial.q.weld", "no coordinate"),
    "fixed in qd": ("{q: {j1: 0.1}}", "{qd: {§weld: 0.1}}", "initial.qd.weld", "no coordinate"),
    "fixed in hold": ("{q: {j1: 0.1}}", "{hold: [§weld]}", "initial.hold.0", "no coordinate"),
    # points
    "reserved origin": ("tip:", "§origin:", "robot.points.origin", "reserved"),
    "reserved end": ("tip:", "§end:", "robot.points.end", "reserved"),
    "reserved com": ("tip:", "§com:", "robot.points.com", "reserved"),
    "reserved frame": (
        "  points:",
        "  frames: {§end: {link: l1}}\n  points:",
        "robot.frames.end",
        "reserved",
    ),
    "point on no link": (
        "link: l2, at: end",
        "link: §l4, at: end",
        "robot.points.tip.link",
        "unknown link 'l4'",
    ),
    "end without D-H": (
        "link: l2, at: end",
        "link: l3, at: §end",
        "robot.points.tip.at",
        "no D-H",
        "named point",
    ),
    "end of base": ("link: l2, at: end", "link: base, at: §end", "robot.points.tip.at", "base.origin"),
    "com of base": ("link: l2, at: end", "link: base, at: §com", "robot.points.tip.at", "base.origin"),
    "com not given": (
        "link: l2, at: end",
        "link: l2, at: §com",
        "robot.points.tip.at",
        "add 'com' to that link",
    ),
    # loops
    "loop to no point": ("", PIN.format("l1.end, §tp"), "loops.0.between.1", "did you mean 'tip'"),
    "loop to a link": ("", PIN.format("l1.end, §l2"), "loops.0.between.1", "write 'l2.end'"),
    "loop to base": ("", PIN.format("l1.end, §base"), "loops.0.between.1", "write 'base.origin'"),
    "loop to no link": ("", PIN.format("§l11.end, l2.end"), "loops.0.between.0", "did you mean 'l1'"),
    "loop to no end": ("", PIN.format("l1.end, §l3.end"), "loops.0.between.1", "no D-H parameters"),
    "loop to no com": ("", PIN.format("l1.end, §l2.com"), "loops.0.between.1", "not given"),
    "loop to odd point": (
        "",
        PIN.format("l1.end, §l2.middle"),
        "loops.0.between.1",
        "unknown point 'l2.middle'",
    ),
    "loop to base.tip": ("", PIN.format("l1.end, §base.tip"), "loops.0.between.1", "fixed to 'l2'"),
    "loop on one link": ("", PIN.format("l2.end, tip").replace("[l2", "§[l2"), "loops.0.between", "on 'l2'"),
    "loop axis": (
        "",
        PIN.format("l1.end, l2.end").replace("}]", ", axis: §[0, 0, 0]}]"),
        "loops.0.axis",
        "must not be zero",
    ),
    # drives and the initial state
    "torque on no joint": ("{j1: 1}", "{§j3: 1}", "torques.j3", "unknown joint 'j3'", "allowed: j1, j2"),
    "torque beside actuated": (
        "torques: {",
        "actuated: [j2]\ntorques: {§",
        "torques.j1",
        "not in 'actuated'",
        ": j2",
    ),
    "torque and prescribed": ("torques: {", "prescribed: {j1: t}\ntorques: {§", "torques.j1", "prescribed"),
    "prescribed no joint": ("", "prescribed: {§jj: t}", "prescribed.jj", "unknown joint"),
    "actuated twice": ("", "actuated: [j1, §j1]", "actuated.1", "appears twice"),
    "table times": (
        "{j1: 1}",
        "{j1: {table: [[0, 1], [§0, 2]]}}",
        "torques.j1.table.1.0",
        "times must increase",
    ),
    "initial q": ("{q: {j1: 0.1}}", "{q: {§j11: 0.1}}", "initial.q.j11", "did you mean 'j1'"),
    "initial qd": ("{q: {j1: 0.1}}", "{qd: {§x: 0.1}}", "initial.qd.x", "unknown joint"),
    "hold": ("{q: {j1: 0.1}}", "{hold: [§x]}", "initial.hold.0", "unknown joint"),
    "hold twice": ("{q: {j1: 0.1}}", "{hold: [j1, §j1]}", "initial.hold.1", "appears twice"),
    # runs
    "rk4 without step": ("", "simulate: {integrator: §rk4}", "simulate.integrator", "'step' is missing"),
    "step without rk4": ("", "simulate: {step: §0.1}", "simulate.step", "integrator 'auto'", "rk4"),
    "latch": ("", "deploy: {latch: {between: [l1, §l4]}}", "deploy.latch.between.1", "unknown link 'l4'"),
    "latch on one link": (
        "",
        "deploy: {latch: {between: §[l1, l1]}}",
        "deploy.latch.between",
        "joins two links",
    ),
}


test_refused_at_its_place = refusals(BAD)


GOOD = {
    "axis": ("a: 1.0, alpha: 0, d: 0", "axis: [0, 1, 0]"),
    "modified needs no com_frame": ("convention: standard", "convention: modified"),  # see test_accepted
    "offset": ("a: 1.0", "a: 1.0, offset: 5 deg"),
    "parent after": ("{name: j1, type", "{name: j1, parent: l3, link: l1, type"),
    "loop between chains": ("", PIN.format("l2.end, base.post")),
    "loop to a named point": ("", PIN.format("l1.com, tip")),
    "loop to the origin": ("", PIN.format("base.origin, l2.origin")),
    "torque on an actuated joint": ("torques:", "actuated: [j1]\ntorques:"),
    "latch to base": ("", "deploy: {latch: {between: [l2, base]}}"),
    "rk4": ("", "simulate: {integrator: rk4, step: 0.001}"),
    "frames": ("  points:", "  frames: {tool: {link: l2, at: end, rpy: [0, 0, 90 deg]}}\n  points:"),
}


@pytest.mark.parametrize("name", GOOD)
def test_accepted(name: str) -> None:
    old, new = GOOD[name]
    text = spoiled(old, new)
    if name == "parent after":  # weld carries l1, which carries j2; weld itself hangs on base
        text = text.replace("parent: l1", "parent: base")
    if name == "modified needs no com_frame":  # the far end of a link is a matter of the standard convention
        text = text.replace("at: end", "at: [1, 0, 0]")
    load_scene_text(text)


# -- doubts, and errors that follow from others ----------------------------------------------------------------
TURNS = (
    "schema: 1\ngravity: [0, 0, -9.81]\nrobot:\n  joints:\n"
    "    - {name: a, type: revolute, axis: [0, 0, 1], origin: {rpy: [0, 0, ANGLE]}}\n"
    "    - {name: s, type: prismatic, axis: [1, 0, 0]}\n"
    "  links: [{name: one, mass: 1}, {name: two, mass: 1}]\n"
    "initial: {q: {a: START, s: 60}}\n"
)


@pytest.mark.parametrize(("angle", "start"), [("-60", "0"), ("0", "-60"), ("90", "45")])
def test_degrees_without_their_unit_are_doubted(angle: str, start: str) -> None:
    doubts = load_scene_text(TURNS.replace("ANGLE", angle).replace("START", start)).warnings
    assert len(doubts) == (angle != "0") + (start != "0")
    assert all("is in radians" in text and " deg" in text for text in doubts)


@pytest.mark.parametrize("angle", ["6.28", "-60 deg", "'-60'", "3*pi"])
def test_angles_that_are_meant_are_not_doubted(angle: str) -> None:
    assert not load_scene_text(TURNS.replace("ANGLE", angle).replace("START", angle)).warnings


def test_a_section_with_an_unreadable_key_is_not_checked_further() -> None:
    """Without its latch ``criterion: latch`` would seem to lack one."""
    latches = "deploy: {criterion: latch, after: continue, latch: [{between: [l1, l2], at: {j1: 1}}]}"
    refusal = complaint(
        TURNS.replace("ANGLE", "0").replace("START", "0") + f"command: deploy\n{latches}\n"
    ).message
    assert "deploy.latch: is a list; a list goes under 'latches'" in refusal


LOST = """\
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{name: j1, type: revolute, axis: [0, 0, 1]}, {name: j2, type: revolute, axis: [0, 0, 1], origin: {xyz: [1, 0, 0]}}]
  links: [{name: l1, mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.1}}, {name: l2, mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.1}}]
  points: POINTS
trajectory: {type: circle, point: tip, center: [1, 1], radius: 0.1, duration: 1, ik: {branch: elbow_up}}
forces: [{name: s, type: spring, between: [base.origin, tip], stiffness: 3}]
outputs: {signals: {height: tip.y}}
"""


@pytest.mark.parametrize(
    "points", ["3", "{tip: {link: l2, at: sideways}}", "{tip: {link: [l2], at: [1, 0, 0]}}"]
)
def test_references_to_a_point_that_cannot_be_read_are_not_refused(points: str) -> None:
    (error,) = examine(LOST.replace("POINTS", points)).errors
    assert error.details["key"].startswith("robot.points")


def test_references_to_a_point_that_there_is_not_are_refused() -> None:
    found = examine(LOST.replace("POINTS", "{top: {link: l2, at: [1, 0, 0]}}")).errors
    assert len(found) == 3 and all("unknown point 'tip'" in e.message for e in found), found


def test_a_name_is_listed_once() -> None:
    links = "links: [{name: base}, {name: l2, mass: 1, com: [0.5, 0, 0]}]"
    robot = f"schema: 1\nrobot:\n  joints: [{{name: j, type: revolute, axis: [0, 0, 1]}}]\n  {links}\n"
    found = examine(robot + "  points: {tip: {link: l3, at: [1, 0, 0]}}\n").errors
    assert any(e.message.endswith("unknown link 'l3'; allowed: base, l2") for e in found), found
