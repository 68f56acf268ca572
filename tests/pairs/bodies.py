"""Features of the mechanism: how the robot is written, joints, loops, couplers, forces, limits, drives, payloads.

A feature is a function that adds itself to a draft, under its name in the map of its family. A scene has at most one of
each family; families are applied in the order in which they stand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from tests.pairs.draft import INERTIA, Draft

Feature = Callable[[Draft], None]
URDF = """\
<robot name="arm">
  <link name="ground"/>
  <link name="upper"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.4 0 0"/><mass value="1"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="a" type="revolute"><parent link="ground"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="60" velocity="20"/></joint>
  <joint name="b" type="continuous"><origin xyz="1 0 0"/><parent link="upper"/><child link="fore"/><axis xyz="0 0 1"/>
    <dynamics damping="0.2"/></joint>
</robot>
"""


def _keys(**keys: Any) -> Feature:
    """Return the feature that writes keys of the scene."""

    def write(draft: Draft) -> None:
        draft.tree.update(keys)

    return write


def _put(key: str, **value: Any) -> Feature:
    """Return the feature that writes a key of the joint in focus."""
    return lambda draft: draft.put(key, value)


# -- how the robot is written ------------------------------------------------------------------------------
def _dh(convention: str) -> Feature:
    def write(draft: Draft) -> None:
        robot = draft.robot
        robot["convention"] = convention
        for k, joint in enumerate(robot["joints"]):
            joint.pop("axis"), joint.pop("origin", None)
            lengths = (1, 0.8) if convention == "standard" else (0, 1)
            joint |= {"a": lengths[k], "alpha": 0, "d": 0}
        for link in robot["links"]:
            link["com_frame"] = "joint"
        if convention == "standard":
            robot["points"]["tip"] = {"link": "fore", "at": "end"}
            draft.end = [0, 0, 0]

    return write


def _urdf(draft: Draft) -> None:
    draft.tree["arm.urdf"] = URDF  # written beside the scene
    draft.tree["robot"] = {"include": "arm.urdf", "points": draft.robot["points"]}
    draft.attached = True
    draft.kinds = {"root_joint": "fixed", "a": "revolute", "b": "revolute"}


def _attach(draft: Draft) -> None:
    robot = draft.robot
    joint, link = robot["joints"].pop(), robot["links"].pop()
    draft.attached = True
    draft.add_joint(joint | {"parent": "upper"}, link)


def _placed(draft: Draft) -> None:
    draft.robot["base"] = {"quaternion": [0.5, 0.5, 0.5, 0.5], "xyz": [0, 0, 0.1]}
    draft.robot["frames"] = {"tool": {"link": "fore", "at": [0.8, 0, 0], "rpy": [0, 0, 0.3]}}
    draft.tip = [0.0, 1.452625, 1.022180]  # axes x, y, z of the base are y, z, x of the world


ROBOT: dict[str, Feature] = {
    "standard": _dh("standard"),
    "modified": _dh("modified"),
    "urdf": _urdf,
    "attach": _attach,
    "motors": lambda draft: draft.robot.update(actuated=None),  # see ``scene``
    "base": _placed,
    "parameters": _keys(parameters={"k": 2.0}),
    "units": lambda draft: draft.robot["links"][-1].update(
        mass="800 gram", com=["400 mm", 0, 0], inertia={**INERTIA, "zz": "400 kg cm^2"}
    ),
    "visual": lambda draft: draft.robot["links"][-1].update(
        visual=[{"box": [0.1, 0.1, 0.1]}, {"sphere": 0.1}]
    ),
}


# -- kinds of joint: one more link, whose joint is the one that features of joints are put on ----------------
def _joint(kind: str) -> Feature:
    def add(draft: Draft) -> None:
        joint: dict[str, Any] = {
            "name": "f",
            "type": kind,
            "parent": "fore",
            "origin": {"xyz": [0.3, 0.1, 0]},
        }
        if kind not in ("spherical", "floating", "fixed"):
            joint["axis"] = [0, 0, 1]
        if kind == "helical":
            joint["pitch"] = 0.01
        link = {"name": "hand", "mass": 0.5, "com": [0.1, 0.02, 0.05], "inertia": INERTIA}
        draft.focus = draft.add_joint(joint, link)

    return add


JOINT = {
    kind: _joint(kind)
    for kind in (
        "fixed",
        "revolute",
        "prismatic",
        "helical",
        "cylindrical",
        "universal",
        "planar",
        "spherical",
        "floating",
    )
}


# -- loops: the arm has a third link, and is closed ----------------------------------------------------------
def _loop(kind: str, led: int = 1, four: bool = False, place: str = "scene", **keys: Any) -> Feature:
    """Return the feature of a closure.

    led : degrees of freedom of the closed arm. four : with three links the arm would be a structure. place : what the
    closure belongs to.
    """

    def close(draft: Draft) -> None:
        names = ["c", "d"][: 1 + four]
        for k, name in enumerate(names):
            joint = {"name": name, "type": "revolute", "axis": [0, 0, 1], "parent": ["fore", "third"][k],
                     "origin": {"xyz": [draft.end, [0.6, 0, 0]][k]}}  # fmt: skip
            link = {"name": ["third", "last"][k], "mass": 0.7, "com": [0.3, 0, 0], "inertia": INERTIA}
            draft.add_joint(joint, link)
        draft.starts |= {"b": -1.0, "c": -1.0, "d": -0.8}
        draft.robot["points"] |= {
            "pin": {"link": "last" if four else "third", "at": [0.6, 0, 0]},
            "post": {"link": "base", "at": [1.3, -0.1, 0]},
        }
        where = draft.robot if place == "robot" else draft.tree
        where.setdefault("loops", []).append(
            {"name": "loop", "type": kind, "between": ["post", "pin"], **keys}
        )
        draft.led = [name for name in draft.moving() if name not in ("b", "c", "d")]
        if led == 2:
            draft.led.insert(1, "b")
            x, y = 1.567210, -0.219854
            draft.tip = [x, y] if len(draft.tip) == 2 else [0.0, x, y + 0.1]
        draft.tree["initial"] = {"hold": [name for name in draft.led if name != "root_joint"]}

    return close


X = [1, 0, 0]
LOOP = {
    "revolute": _loop("revolute"),
    "prismatic": _loop("prismatic", axis=X, rpy=[0, 0, -1.5]),
    "cylindrical": _loop("cylindrical"),
    "universal": _loop("universal", axis=[0, 0, 1], axis2=X),
    "spherical": _loop("spherical", place="robot"),
    "planar": _loop("planar", axis=X, axis2=X),
    "fixed": _loop("fixed", four=True, rpy=[0, 0, -2.2]),
    "point_on_line": _loop("point_on_line", 2, axis=X),
    "point_on_plane": _loop("point_on_plane", 2, axis=[0, 1, 0]),
    "distance": _loop("distance", 2, length=0.4),
}


# -- couplers -----------------------------------------------------------------------------------------------
def _coupler(place: str, value: Any) -> Feature:
    def couple(draft: Draft) -> None:
        for name in ("m", "n"):
            draft.add_joint({"name": name, "type": "prismatic", "parent": "upper", "axis": [0, 1, 0]},
                            {"name": f"finger_{name}", "mass": 0.2, "com": [0, 0, 0], "inertia": INERTIA})  # fmt: skip
        draft.starts["n"] = 0.12
        where = draft.robot if place == "robot" else draft.tree
        where.setdefault("couplers", []).append(
            {"name": "mimic", "terms": {"m": 1, "n": -1}, **({"value": value} if value else {})}
        )
        draft.led = [*(name for name in draft.followed() if name not in ("m", "n")), "m"]
        draft.section("initial").setdefault("hold", []).append("m")

    return couple


COUPLER = {
    "scene": _coupler("scene", 0),
    "in_time": _coupler("scene", "0.01*sin(t)"),
    "robot": _coupler("robot", 0),
}


# -- forces -------------------------------------------------------------------------------------------------
def _force(**keys: Any) -> Feature:
    return lambda draft: draft.listed("forces").append({"name": "load", **keys})


def _between(kind: str, **keys: Any) -> Feature:
    return _force(type=kind, between=["hook", "tip"], **keys)


def _shaken(draft: Draft) -> None:
    draft.robot["points"]["hook"]["motion"] = [0, "0.02*sin(9*t)", 0]
    _between("spring", stiffness=20)(draft)


ROWS = [[0, 0, 0, 0], [0.02, 1, 2, 0], [1, 1, 0, 0]]
FORCE = {
    "spring": _between("spring", stiffness=20, length=0.5, damping=1),
    "nonlinear_spring": _between("nonlinear_spring", tension="20*(length - 0.5) + 2*rate"),
    "spring_tables": _between("nonlinear_spring", tension={"table": [[0, -5], [1, 0], [4, 40]]},
                              damping={"table": [[-5, -5], [0, 0], [5, 9]]}),
    "torsional_spring": _between("torsional_spring", stiffness=3, rest=0.2, damping=0.1),
    "constant_force": _between("constant_force", force=5),
    "bushing": _between("bushing", stiffness=[20, 20, 20, 2, 2, 2], damping=[1, 1, 1, 0.1, 0.1, 0.1]),
    "force": _force(type="force", at="tip", force=[1, "2*sin(t)", 0]),
    "wrench": _force(type="wrench", at="tip", frame="body", moment=[0, 0, "-0.1*qd.a"], force=[1, 0, 0]),
    "force_table": _force(type="force", at="tip", force={"table": ROWS}),
    "moving_point": _shaken,
}  # fmt: skip
FRICTION = {
    "viscous": _put("friction", viscous=0.3),
    "coulomb": _put("friction", coulomb=0.5, transition_speed=0.01),
    "stribeck": _put("friction", coulomb=0.5, static=0.8, stribeck_speed=0.1, transition_speed=0.01),
    "two_levels": _put("friction", coulomb={"positive": 0.5, "negative": -0.4}, transition_speed=0.01),
    "set_valued": _put("friction", coulomb=0.5, static=0.7, law="set_valued"),
}
PASSIVE = {
    "spring": _put("spring", stiffness=5),
    "damper": _put("damper", damping=0.4),
    "gear": _put("gear", efficiency=0.8, transition_speed=0.01),
}
LIMIT = {
    "position": _put("limits", lower=-3, upper=3),
    "speed": _put("limits", speed=50),
    "acceleration": _put("limits", acceleration=5000, jerk=1e7),
    "effort": _put("limits", effort=40),
    "exceeded": lambda draft: draft.put("limits", {"lower": draft.beside(1e-3), "upper": 3}),
}


def _stop(**keys: Any) -> Feature:
    return lambda draft: draft.put("limits", {"lower": draft.beside(5e-4), "stop": keys})


SOFT = {"stiffness": 2000, "damping": 5}
STOP = {
    "compliant": _stop(**SOFT),
    "hunt_crossley": _stop(**SOFT, law="hunt_crossley", exponent=1.5),
    "rigid": _stop(restitution=0.5),
}


# -- drives ---------------------------------------------------------------------------------------------------
HEAT = {
    "winding_resistance": 1.1,
    "housing_resistance": 2.4,
    "winding_time": 30,
    "housing_time": 1100,
    "max_temperature": 125,
}
ELECTRIC = {"torque_constant": 0.9, "resistance": 0.6, "voltage": 300, "max_current": 90, "rated_current": 40,
            "rotor_inertia": 5e-5, "thermal": HEAT}  # fmt: skip
MOTORS: dict[str, dict[str, Any]] = {
    "dc": {**ELECTRIC, "coulomb": 0.01, "viscous": 1e-5, "cost": 3},
    "brushless": {**ELECTRIC, "inductance": 1e-3, "pole_pairs": 4, "cost": 4},
    "stepper": {
        "pull_out": [[0, 90], [400, 60]],
        "current": 4.2,
        "resistance": 0.5,
        "thermal": HEAT,
        "cost": 2,
    },
    "envelope": {
        "peak": [[0, 90], [900, 60]],
        "continuous": [[0, 60], [900, 40]],
        "rotor_inertia": 1e-5,
        "cost": 1,
    },
}
GEARS: dict[str, dict[str, Any]] = {
    "gear": {"ratio": 3, "efficiency": 0.9, "inertia": 1e-5, "cost": 1, "mass": 0.1},
    "belt": {"motor_radius": 0.02, "joint_radius": 0.05, "efficiency": 0.95, "cost": 1},
    "ball_screw": {"lead": 0.02, "efficiency": 0.9, "cost": 1},
}


def _motor(kind: str) -> Feature:
    def drive(draft: Draft) -> None:
        draft.section("catalogue").setdefault("motors", {})["m1"] = {"type": kind, **MOTORS[kind]}
        # a joint with several coordinates takes no motor, and stands beside one that has it
        name = draft.focus["name"] if draft.focus["name"] in draft.single() else "a"
        draft.section("drives")[name] = {"motor": "m1"}

    return drive


def _gear(kind: str) -> Feature:
    def drive(draft: Draft) -> None:
        if "drives" not in draft.tree:
            MOTOR["envelope"](draft)
        drives, gear = draft.tree["drives"], {"type": kind, **GEARS[kind]}
        slides = draft.kinds[next(iter(drives))] == "prismatic"
        if kind == "ball_screw" and not slides:
            draft.add_joint({"name": "s", "type": "prismatic", "parent": "upper", "axis": [0, 1, 0]},
                            {"name": "nut", "mass": 0.2, "com": [0, 0, 0], "inertia": INERTIA})  # fmt: skip
            drives["s"] = drives.pop(next(iter(drives)))
            if draft.led is not None:
                draft.led.append("s")
        elif kind == "belt" and slides:
            del gear["joint_radius"]
        draft.section("catalogue")["gears"] = {"g1": gear}
        next(iter(drives.values()))["gear"] = "g1"

    return drive


def _brake(draft: Draft) -> None:
    if "drives" not in draft.tree:
        MOTOR["envelope"](draft)
    draft.section("catalogue")["brakes"] = {"b1": {"holding_torque": 90, "inertia": 1e-6}}
    next(iter(draft.tree["drives"].values())).update(brake="b1", mass=0.3, margin=0.05)


def _rotor(draft: Draft) -> None:
    if draft.focus["type"] == "spherical":
        draft.focus["rotor_inertia"] = 1e-3
        return
    several = draft.column() != draft.focus["name"]
    part = draft.column().partition(".")[2]
    for key, value in (("gear_ratio", 5), ("rotor_inertia", 1e-3)):
        draft.focus[key] = {part: value} if several else value


MOTOR = {kind: _motor(kind) for kind in MOTORS}
GEAR: dict[str, Feature] = {kind: _gear(kind) for kind in GEARS} | {"brake": _brake, "rotor": _rotor}


# -- payloads ----------------------------------------------------------------------------------------------------
def _payload(**keys: Any) -> Feature:
    part = {"name": "part", "at": "tip", "mass": 0.4, "inertia": INERTIA}
    return lambda draft: draft.listed("payloads").append({**part, **keys})


PAYLOAD = {
    "carried": _payload(com=[0.02, 0, 0]),
    "gripped": _payload(**{"from": {"time": 0.02}, "velocity": [0.1, 0.2, 0]}),
    "released": _payload(until={"time": 0.03}),
    "caught": _payload(**{"from": {"when": "t - 0.021"}, "until": {"when": "t - 0.04"}}),
    "thrown": _payload(
        until={"when": "tip.y - tip.y + t - 0.035"}, range={"through": [0, "-200 cm", 0], "normal": [0, 1, 0]}
    ),
}

BODIES: dict[str, Mapping[str, Feature]] = {
    "robot": ROBOT, "joint": JOINT, "loop": LOOP, "coupler": COUPLER, "force": FORCE, "friction": FRICTION,
    "passive": PASSIVE, "limit": LIMIT, "stop": STOP, "motor": MOTOR, "gear": GEAR, "payload": PAYLOAD,
}  # fmt: skip
