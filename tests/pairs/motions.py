"""Features of what a scene moves and asks: trajectories, prescribed joints, controllers, starts, methods, outputs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from robodyn_cli.integration_methods import METHODS, REPRESENTATIVES
from tests.pairs.bodies import BODIES, Feature, _keys
from tests.pairs.draft import DURATION, VELOCITIES, Draft


# -- torques, starts ---------------------------------------------------------------------------------------
def _torques(value: Any) -> Feature:
    def drive(draft: Draft) -> None:
        draft.section("torques")["a"] = value

    return drive


TORQUE = {
    "formula": _torques("1 - 0.1*qd.a"),
    "table": _torques({"table": [[0, 0], [0.02, 2], [1, 2]]}),
    "points": _torques("0.2*tip.y - 0.1*speed(tip) + 0.05*angle(hook, tip, base.origin) - 0.1*fore.com.vx"),
}


def _start(**rates: Any) -> Feature:
    def begin(draft: Draft) -> None:
        draft.section("initial")["qd"] = dict(rates)

    return begin


def _attitudes(write: Any) -> Feature:
    def begin(draft: Draft) -> None:
        q = draft.q(draft.moving())
        for name in draft.moving():
            if draft.kinds[name] in VELOCITIES:
                q[name] = {**{k: v for k, v in q[name].items() if k == "xyz"}, **write}
        draft.section("initial")["q"] = q

    return begin


INITIAL = {
    "rates": _start(a=0.2),
    "rotation_vector": _attitudes({"rotation_vector": [0.1, 0.2, 0.1]}),
    "quaternion": _attitudes({"quaternion": [0.8, 0.6, 0, 0]}),
    "by_list": lambda draft: draft.section("initial").update(
        q={n: list(v.values()) if isinstance(v, dict) and not set(v) & {"rpy", "xyz"} else v
           for n, v in draft.q(draft.moving()).items()}
    ),
    "beyond_a_turn": lambda draft: draft.starts.update(a=0.3 + 6.283185307179586),
}  # fmt: skip


# -- prescribed joints ---------------------------------------------------------------------------------------
def _by_formula(draft: Draft) -> None:
    name = draft.focus["name"] if draft.kinds[draft.focus["name"]] != "fixed" else "a"
    draft.section("prescribed")[name] = draft.formula(name)
    draft.led = [other for other in draft.followed() if other != name]


def _by_trajectory(draft: Draft) -> None:
    draft.tree["prescribed"] = "trajectory"
    if "trajectory" not in draft.tree:
        TRAJECTORY["quintic"](draft)


# -- trajectories --------------------------------------------------------------------------------------------
def _in_formulas(draft: Draft) -> dict[str, Any]:
    return {"type": "joint", "duration": DURATION, "q": {n: draft.formula(n) for n in draft.followed()}}


def _through(kind: str) -> Any:
    def write(draft: Draft) -> dict[str, Any]:
        names = draft.followed()
        return {
            "type": kind,
            "points": [{"t": s * DURATION, "q": draft.q(names, 0.2 * s)} for s in (0, 0.5, 1)],
        }

    return write


def _from_stop_to_stop(kind: str) -> Any:
    def write(draft: Draft) -> dict[str, Any]:
        names = draft.followed()
        bounds = {"speed": 1, "acceleration": 40, **({"jerk": 4000} if kind == "s_curve" else {})}
        keys = {key: {n: draft.by_velocity(n, value) for n in names} for key, value in bounds.items()}
        return {"type": kind, **keys, "points": [{"q": draft.q(names, s)} for s in (0.0, 0.1)]}

    return write


def _fourier(draft: Draft) -> dict[str, Any]:
    names = draft.followed()
    sine = dict.fromkeys(draft.single(), 0.01)
    return {"type": "fourier", "period": 1, "duration": DURATION, "offset": draft.q(names), "sine": [sine]}


def _sequence(draft: Draft) -> dict[str, Any]:
    one, two = _through("quintic")(draft), _through("cubic")(draft)
    two["points"] = [{"t": p["t"], "q": q["q"]} for p, q in zip(two["points"], two["points"][::-1])]
    return {"type": "sequence", "repeat": 2, "segments": [one, two]}


def _fastest(draft: Draft) -> dict[str, Any]:
    names = draft.followed()
    bounds = {"speed": 2, "acceleration": 40}
    keys = {key: {n: draft.by_velocity(n, value) for n in names} for key, value in bounds.items()}
    return {
        "type": "fastest",
        "intervals": 8,
        **keys,
        "points": [{"q": draft.q(names, s)} for s in (0.0, 0.1)],
    }


def _table(draft: Draft) -> dict[str, Any]:
    columns, start, end = [], [], []
    for name in draft.followed():
        kind, values = draft.kinds[name], (draft.at(name, 0.0), draft.at(name, 0.1))
        if kind in VELOCITIES:
            places = ["x", "y", "z"] if kind == "floating" else []
            columns += [f"{name}.{part}" for part in (*places, "qw", "qx", "qy", "qz")]
            start += [*([0.1, 0.05, -0.1] if places else []), 1.0, 0.0, 0.0, 0.0]
            end += [*([0.11, 0.05, -0.1] if places else []), 0.99999, 0.001, 0.002, 0.0]
        elif isinstance(values[0], dict):
            columns += [f"{name}.{part}" for part in values[0]]
            start += values[0].values()
            end += values[1].values()
        else:
            columns.append(name)
            start.append(values[0])
            end.append(values[1])
    rows = [[k * DURATION / 5, *(x + (y - x) * (k / 5) ** 2 for x, y in zip(start, end))] for k in range(6)]
    return {"type": "table", "columns": ["t", *columns], "rows": rows}


IK = {"method": "newton"}  # from the start


def _circle(draft: Draft) -> dict[str, Any]:
    x, y, *z = draft.tip
    place = {"center": [x, y - 0.1, *z], "start": "90 deg"}
    if z:  # in the plane y-z of the world
        place = {"center": [x, y, z[0] + 0.1], "normal": [1, 0, 0], "start": "-90 deg"}
    return {
        "type": "circle",
        "point": "tip",
        "radius": 0.1,
        "duration": DURATION,
        "turns": 0.02,
        **place,
        "ik": IK,
    }


def _path(draft: Draft) -> dict[str, Any]:
    x, y, z = [*draft.tip, 0.0][:3]
    line = {"type": "line", "to": [x, y - 0.002, z]}
    return {"type": "path", "point": "tip", "law": "quintic", "start": {"position": [x, y, z]},
            "segments": [{**line, "duration": DURATION}], "ik": IK}  # fmt: skip


def _cartesian(draft: Draft) -> dict[str, Any]:
    x, y, *z = draft.tip
    return {"type": "cartesian", "point": "tip", "position": [x, f"{y} - 0.01*sin(t)", *z], "duration": DURATION,
            "ik": IK}  # fmt: skip


MADE: dict[str, Any] = {
    "joint": _in_formulas,
    **{kind: _through(kind) for kind in ("quintic", "cubic", "monotone")},
    **{kind: _from_stop_to_stop(kind) for kind in ("trapezoid", "s_curve")},
    "fourier": _fourier, "sequence": _sequence, "fastest": _fastest, "table": _table, "circle": _circle,
    "path": _path, "cartesian": _cartesian,
}  # fmt: skip


def _trajectory(kind: str) -> Feature:
    def lead(draft: Draft) -> None:
        draft.tree["trajectory"] = MADE[kind](draft)

    return lead


def _none(draft: Draft) -> None:
    draft.tree.pop("trajectory", None)


# a scene without a feature of this family follows formulas, so that every command has a motion
def _turning(draft: Draft) -> None:
    """Write a motion in which one joint makes a whole turn and the others swing with it, and ask for a flywheel."""
    turning = [name for name in draft.single() if draft.kinds[name] == "revolute"]
    rate = 2.0 * math.pi / DURATION
    swings = json.dumps({name: draft.formula(name) for name in draft.followed()})
    q = json.loads(swings.replace("3*t", f"{rate!r}*t"))
    if turning:
        q[turning[0]] = f"0.3 + {rate!r}*t"
    draft.tree["trajectory"] = {"type": "joint", "duration": DURATION, "q": q}
    draft.section("inverse")["flywheel"] = {"joint": (turning or ["a"])[0], "fluctuation": 0.1}


TRAJECTORY: dict[str, Feature] = {
    "none": _none, **{kind: _trajectory(kind) for kind in MADE}, "turning": _turning,
}  # fmt: skip
# formulas take joints away from what a trajectory leads, and so come before it
PRESCRIBED = {"formula": _by_formula}
LED = {"trajectory": _by_trajectory}


# -- controllers ------------------------------------------------------------------------------------------------
def _control(kind: str, **keys: Any) -> Feature:
    def write(draft: Draft) -> None:
        control = draft.section("control")
        control |= {"type": kind, **keys}
        _driven(draft)
        if kind == "formulas":
            control["joints"] = ["a"]
        if kind == "pd":
            draft.section("outputs")["response"] = True
        if kind == "task_pd":
            control["reference"] = MADE["circle"](draft)

    return write


def _driven(draft: Draft) -> None:
    """Let the controller of a mechanism drive what motions lead, and nothing that has several coordinates."""
    if draft.closed or draft.tree.get("couplers") or "couplers" in draft.robot:
        draft.tree["control"]["joints"] = draft.single()


def _lqr(draft: Draft) -> None:
    draft.section("control").update(type="lqr", gains={"q": 10, "qd": 1, "tau": 0.1})
    _driven(draft)


STATE = {"sum": {"start": 0.1, "rate": "0.3 - a"}}
CONTROL = {
    "pd": _control("pd", gains={"kp": 20, "kd": 2}),
    "pid": _control("pid", gains={"kp": 20, "kd": 2, "ki": 5}),
    "gravity": _control("gravity", gains={"kp": 20, "kd": 2}),
    "computed_torque": _control("computed_torque", gains={"kp": 40, "kd": 4}),
    "feed_forward": _control("feed_forward", gains={"kp": 20, "kd": 2}),
    "task_pd": _control("task_pd", gains={"kp": 50, "kd": 5}),
    "lqr": _lqr,
    "formulas": _control("formulas", law={"a": "20*(ref.a - a) - 2*qd.a + s.sum"}, state=STATE),
    "of_points": _control("formulas", law={"a": "5*(1 - tip.x) - tip.vx - 0.1*speed(tip)"}),
    "python": _control("python", period=0.01),
}


def _held(**keys: Any) -> Feature:
    """Return a feature of a controller that is there; of a PD controller where there is none yet."""

    def write(draft: Draft) -> None:
        if "control" not in draft.tree:
            CONTROL["pd"](draft)
        draft.tree["control"].update(keys)

    return write


SAMPLED = {
    "period": _held(period=0.01),
    "delay": _held(period=0.01, delay=0.004),
    "rate_limit": _held(period=0.01, rate_limit=500),
    "noise": _held(period=0.01, sensors={"resolution": 1e-4, "noise": 1e-4, "rates": "differences"}),
    "limit": _held(limit=3),
    "model": _held(model={"set": {"gravity": [0, -9.5, 0]}, "friction": False}),
    "reference": lambda draft: _held(reference=MADE["quintic"](draft))(draft),
}


# -- how it is integrated -------------------------------------------------------------------------------------------
def _simulated(**keys: Any) -> Feature:
    return lambda draft: draft.section("simulate").update(keys)


def _method(name: str) -> Feature:
    return _simulated(integrator=name, **({"step": 0.005} if METHODS[name].fixed_step else {}))


METHOD = {name: _method(name) for name in METHODS}
FORM = {
    "independent": _simulated(stabilisation="independent"),
    "baumgarte": _simulated(stabilisation={"alpha": 20, "beta": 20}),
    "studied": _simulated(stabilisation="baumgarte"),
    "none": _simulated(stabilisation="none"),
    "pass": _simulated(singular="pass"),
    "no_estimate": _simulated(error_estimate=False),
    "loose": _simulated(rtol=1e-4, atol=1e-6, max_step=0.01),
}


# -- what is asked ---------------------------------------------------------------------------------------------------
def _signals(draft: Draft) -> None:
    signals: dict[str, Any] = {"power": {"value": "tau.a*qd.a", "unit": "W"}, "reach": "length(tip, hook)"}
    signals |= {
        "height": "tip.z - fore.com.y",
        "rate": "tip.vx",
        "speed": "speed(tip)",
        "turn": "angle(hook, tip, fore.com)",
    }
    if "control" in draft.tree:
        signals["lag"] = "ref.a - a"
    draft.section("outputs")["signals"] = signals


def _extremes(draft: Draft) -> None:
    """Ask for extremes of columns that every motion has."""
    draft.section("outputs")["extremes"] = ["qdd.b", "points/tip.length", "point_velocities/tip.x"]


def _design(draft: Draft) -> None:
    """Ask for kinematic design, shaking forces, fluctuation of speed, and plots over a joint."""
    one, *others = draft.single() or ["b"]
    pairs = {"ratios": {"r": [others[0], one]}} if others else {}
    draft.section("kinematics")["design"] = {
        "poles": {"p": ["fore", "base"]}, "curves": ["tip"], "pressure": {"f": ["hook", "tip"]}, **pairs,
    }  # fmt: skip
    draft.section("inverse")["shaking"] = "hook"
    draft.section("simulate")["fluctuation"] = [one]
    draft.section("outputs")["abscissa"] = one


OUTPUT = {
    "extremes": _extremes,
    "design": _design,
    "reactions": _keys(outputs={"reactions": True}),
    "world": _keys(outputs={"reactions": True, "reaction_axes": "world"}),
    "signals": _signals,
    "expect": _keys(expect={"status": "ok"}),
    "unmet": _keys(expect={"status": "perfect"}),
    "study": _keys(study={"vary": {"robot.links.fore.mass": [0.9, 1.1]}}),
    "search": _keys(search={"vary": {"robot.links.fore.mass": "uniform(0.9, 1.1)"}, "starts": 1}),
    "title": _keys(title="A <scene> of pairs, 100 %"),
}


def _latch(**keys: Any) -> Feature:
    def lock(draft: Draft) -> None:
        draft.tree["deploy"] = {"criterion": "latch", **keys}
        draft.tree["deploy"]["latch"] = {"between": ["upper", "fore"], "at": {"b": draft.starts["b"] - 1e-4}}

    return lock


def _at_limit(draft: Draft) -> None:
    draft.put("limits", {"lower": draft.beside(5e-4)})
    joint, *coordinate = draft.column().split(".")
    side: Any = {coordinate[0]: "lower"} if coordinate else "lower"
    latch = {"between": ["upper", "base"], "at_limit": {joint: side}}
    draft.tree["deploy"] = {"criterion": "latch", "latch": latch}


def _latches(until: str = "end", loads: Any = None, **keys: Any) -> Feature:
    """Return the feature that writes two latches: of joint b at a position, and of the links at a time."""

    def write(draft: Draft) -> None:
        near = draft.starts["b"] - 1e-4
        first = {"name": "one", "joint": "b", "at": near, "side": "down", **keys}
        second = {
            "name": "two",
            "between": ["upper", "fore"],
            "when": "t - 0.03",
            "side": "up",
            "release": "t - 0.04",
        }
        draft.tree["deploy"] = {
            "latches": [first, second],
            "until": until,
            **({"loads": loads} if loads else {}),
        }

    return write


def _latch_at_limit(draft: Draft) -> None:
    _at_limit(draft)
    limit = draft.tree["deploy"]["latch"]["at_limit"]
    draft.tree["deploy"] = {"latches": [{"name": "one", "between": ["upper", "base"], "at_limit": limit}]}


ASKED = {
    "latches": _latches(),
    "sprung": _latches("one", {"b": {"force": 1e-3}}, hold={"stiffness": 50, "damping": 0.2}),
    "latch_at_limit": _latch_at_limit,
    "latch_dead_point": _keys(
        deploy={"latches": [{"name": "one", "between": ["upper", "fore"], "at_dead_point": True}]}
    ),
    "dead_point": _keys(deploy={"criterion": "dead_point"}),
    "multipliers": _keys(deploy={"criterion": "multipliers", "limit": 1e-3}),
    "either": _keys(deploy={"criterion": "either", "growth": 2, "latch": {"between": ["upper", "fore"]}}),
    "latch": _latch(),
    "after": _latch(after="continue", loads={"latch": {"moment": 1e-3}}),
    "at_limit": _at_limit,
    "hold": _keys(statics={"find": "hold"}),
    "sweep": lambda draft: draft.section("kinematics").update(
        sweep={"joint": "a", "start": 0.3, "stop": 0.32},
        transmission=["hook", "tip", "base.origin"],
        at=[0.0, 0.013],
    ),
    "position": lambda draft: draft.tree.update(reach={"frame": "tip", "position": [*draft.tip, 0.0][:3]}),
    "branch": lambda draft: draft.tree.update(
        reach={"frame": "tip", "position": [*draft.tip, 0.0][:3], "components": "xy", "branch": "elbow_down"}
    ),
    "orientation": _keys(
        reach={"frame": "fore", "orientation": {"rpy": [0, 0, 0.9]}, "criterion": "away_from_limits"}
    ),
    "branches": _keys(assemble={"branches": True, "starts": 5}),
}


# -- margins of motorisation ---------------------------------------------------------------------------------------
def _opener(draft: Draft) -> None:
    draft.listed("forces").append(
        {"name": "opener", "type": "spring", "between": ["hook", "tip"], "stiffness": 30, "role": "drive"}
    )
    draft.tree["motorisation"] = {"factors": {"friction": 3, "drive_inertia": 1.1}, "outside": {"load": 1}}


def _motor_torque(draft: Draft) -> None:
    draft.section("torques").setdefault("a", {"formula": "40 - qd.a", "role": "drive"})
    draft.tree["motorisation"] = {"required": 2, "joints": ["a"]}


MARGIN = {"spring": _opener, "torque": _motor_torque}


FAMILIES: dict[str, Mapping[str, Feature]] = {
    **BODIES, "torque": TORQUE, "initial": INITIAL, "prescribed": PRESCRIBED, "trajectory": TRAJECTORY, "led": LED,
    "control": CONTROL, "sampled": SAMPLED, "method": METHOD, "form": FORM, "output": OUTPUT, "asked": ASKED, "margin": MARGIN,
}  # fmt: skip


# commands, and the families that they read: in each row every pair of features meets
ROWS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "simulate": (("simulate",), tuple(f for f in FAMILIES if f not in ("trajectory", "asked"))),
    "inverse": (
        ("inverse", "kinematics"),
        (*BODIES, "initial", "prescribed", "trajectory", "output", "margin"),
    ),
    "still": (
        ("deploy", "statics", "linearise", "reach", "assemble"),
        ("robot", "joint", "loop", "coupler", "force", "passive", "limit", "stop", "payload", "torque", "initial",
         "prescribed", "asked", "margin"),
    ),
}  # fmt: skip


# features in a scene of a row
MOST = {"simulate": 12, "inverse": 10, "still": 8}


def families(row: str) -> dict[str, list[str]]:
    """Return the names of the features of a row by family; of the methods one of each family of methods."""
    return {f: list(REPRESENTATIVES if f == "method" else FAMILIES[f]) for f in ROWS[row][1]}


def scene(features: Mapping[str, str]) -> dict[str, Any]:
    """Return the tree of the scene with a feature of each of some families."""
    draft = Draft()
    for family, members in FAMILIES.items():
        if family in features:
            members[features[family]](draft)
        elif family == "trajectory" and draft.followed():
            members["joint"](draft)
    if draft.closed or "coupler" in features:
        driven = draft.tree.get("prescribed")
        draft.tree["actuated"] = [*draft.followed(), *(driven if isinstance(driven, dict) else ())]
    if "actuated" in draft.robot:
        draft.robot["actuated"] = draft.tree.pop("actuated", draft.moving())
    draft.section("initial").setdefault("q", draft.q(draft.moving()))
    if "reach" not in draft.tree:
        ASKED["position"](draft)
    if "deploy" not in draft.tree and not draft.closed:
        ASKED["latch"](draft)
    return draft.tree
