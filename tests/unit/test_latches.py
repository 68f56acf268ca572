"""Several latches of a deployment, beside closed forms: which close, when, with what energy and load."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from robodyn_cli import Mechanism
from robodyn_cli.errors import NumericalError, RobodynError, SceneError
from robodyn_cli.report.drawing.build import make_drawing
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.works.deploy.deploy import deploy

INERTIA, TORQUE, AT = 0.5, 0.2, 1.2  # of one panel that a constant torque drives to its latch


def panel(**more: Any) -> dict[str, Any]:
    """Return a scene with one panel on a hinge, driven by a constant torque from rest at 0."""
    joint = {"name": "hinge", "type": "revolute", "axis": [0, 0, 1], **more.pop("joint", {})}
    tree = {
        "schema": 1, "gravity": [0, 0, 0],
        "robot": {"joints": [joint], "links": [{"name": "panel", "mass": 0, "inertia": {"zz": INERTIA}}]},
        "torques": {"hinge": TORQUE}, "initial": {"q": {"hinge": 0}},
        "simulate": {"duration": 10, "samples": 101, "rtol": 1e-11, "atol": 1e-13},
        "deploy": {"latches": [{"name": "catch", "joint": "hinge", "at": AT}]},
    }  # fmt: skip
    for key, value in more.items():
        tree[key] = {**tree.get(key, {}), **value} if isinstance(value, dict) else value
    return tree


def deployed(tree: dict[str, Any]) -> Result:
    return deploy(load_scene_text(yaml.safe_dump(tree)))


def near(summary: dict[str, Any], name: str, **expected: float) -> None:
    """Compare what a latch did; nothing is further off than it says, and than a few roundings."""
    own = summary["locks"][name]
    for key, value in expected.items():
        allowed = own["errors"][key] + 1e-13 * max(1.0, abs(value))
        assert abs(own[key] - value) <= allowed, (key, own[key], value, own["errors"][key])
        assert own["errors"][key] <= 1e-9


CLOSES = np.sqrt(2.0 * AT * INERTIA / TORQUE)
SPEED = TORQUE / INERTIA * CLOSES


def test_rigid_latch_stops_a_panel_and_takes_its_energy() -> None:
    result = deployed(panel())
    summary = result.summary
    assert result.status == "locked"
    near(summary, "catch", time=CLOSES, angle=AT, speed=SPEED, energy_lost=TORQUE * AT)
    near(summary, "catch", angular_impulse=INERTIA * SPEED)
    assert summary["final"]["q"]["hinge"] == AT and summary["final"]["qd"]["hinge"] == 0.0
    assert summary["lock"]["name"] == "catch" and summary["lock"]["time"] == summary["locks"]["catch"]["time"]
    assert summary["missed"] == {}
    assert summary["energy_drift"] < 1e-10


CONDITIONS = [{"at": {"hinge": AT}}, {"when": f"{AT} - hinge"}, {"at_limit": {"hinge": "upper"}}]


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("held", [{"joint": "hinge"}, {"between": ["base", "panel"]}])
def test_all_conditions_and_what_is_held_say_the_same(
    condition: dict[str, Any], held: dict[str, Any]
) -> None:
    latch = {"name": "catch", **held, **condition}
    joint = {"limits": {"upper": AT}}
    summary = deployed(panel(joint=joint, deploy={"latches": [latch]})).summary
    near(summary, "catch", time=CLOSES, speed=SPEED, energy_lost=TORQUE * AT)


OF_POINTS = [
    "tip.y - 0.7*sin(1.2)",
    "0.7*cos(1.2) - tip.x",
    "angle(tip, base.origin, base.mark) - 1.2",
    "length(tip, base.mark)^2 - 1.49 + 1.4*cos(1.2)",
]


@pytest.mark.parametrize("formula", OF_POINTS)
@pytest.mark.parametrize("held", [{"joint": "hinge"}, {"between": ["base", "panel"]}])
def test_a_latch_closes_where_a_formula_of_points_says(formula: str, held: dict[str, Any]) -> None:
    points = {"tip": {"link": "panel", "at": [0.7, 0, 0]}, "mark": {"link": "base", "at": [1, 0, 0]}}
    tree = panel(robot={"points": points}, deploy={"latches": [{"name": "catch", **held, "when": formula}]})
    near(deployed(tree).summary, "catch", time=CLOSES, angle=AT, speed=SPEED, energy_lost=TORQUE * AT)


@pytest.mark.parametrize("key", ["when", "release"])
def test_points_of_latches_exist(key: str) -> None:
    latch = {"name": "catch", "joint": "hinge", "at": AT, key: "tap.y - 0.5"}
    if key == "when":
        del latch["at"]
    with pytest.raises(
        SceneError, match=f"deploy.latches.0.{key}: formula 'tap.y - 0.5': unknown point 'tap'"
    ):
        load_scene_text(yaml.safe_dump(panel(deploy={"latches": [latch]})))


def test_latch_wins_over_a_rigid_stop_in_the_same_place() -> None:
    latch = {"name": "catch", "joint": "hinge", "at_limit": {"hinge": "upper"}}
    joint = {"limits": {"upper": AT, "stop": {"restitution": 0.8}}}
    tree = panel(joint=joint, deploy={"latches": [latch], "until": "end"})
    result = deployed(tree)
    near(result.summary, "catch", time=CLOSES, energy_lost=TORQUE * AT)
    assert result.summary["final"]["q"]["hinge"] == AT


def test_side_lets_a_latch_pass_the_other_way() -> None:
    tree = panel(initial={"q": {"hinge": 2.0}, "qd": {"hinge": -1.0}})
    up, down = ({**tree["deploy"]["latches"][0], "side": side} for side in ("up", "down"))
    a, v, back = TORQUE / INERTIA, 1.0, 2.0 - AT
    first = (v - np.sqrt(v * v - 2.0 * a * back)) / a
    near(deployed({**tree, "deploy": {"latches": [down]}}).summary, "catch", time=first)
    near(
        deployed({**tree, "deploy": {"latches": [up]}}).summary,
        "catch",
        time=(v + np.sqrt(v * v - 2.0 * a * back)) / a,
    )


def test_latch_that_opens_lets_the_panel_go_on_from_rest() -> None:
    opens, end = 5.0, 7.0
    latch = {"name": "catch", "joint": "hinge", "at": AT, "release": f"t - {opens}"}
    result = deployed(panel(simulate={"duration": end}, deploy={"latches": [latch], "until": "end"}))
    summary = result.summary
    assert result.status == "no_lock"
    near(summary, "catch", time=CLOSES, opened=opens)
    assert summary["final"]["q"]["hinge"] == pytest.approx(
        AT + 0.5 * TORQUE / INERTIA * (end - opens) ** 2, abs=1e-10
    )


def test_latch_that_has_opened_closes_again_when_it_is_passed_again() -> None:
    # from 3 s on I theta = s^2 / 2 - s^3 / 6 with s = t - 3, which is back at 0 after 3 s
    latch = {"name": "catch", "joint": "hinge", "at": 0.0, "release": "t - 3"}
    tree = panel(
        torques={"hinge": "4 - t"}, initial={"q": {"hinge": -0.1}}, deploy={"latches": [latch], "until": "end"},
        simulate={"duration": 12},
    )  # fmt: skip
    summary = deployed(tree).summary
    own = summary["locks"]["catch"]
    assert own["closings"] == 2 and "opened" not in own
    near(summary, "catch", time=6.0, speed=-1.5 / INERTIA)


def test_friction_stops_a_panel_short_of_its_latch() -> None:
    k, friction, start, at = 2.0, 0.3, -1.0, 0.8
    joint = {"spring": {"stiffness": k}, "friction": {"law": "set_valued", "coulomb": friction}}
    tree = panel(joint=joint, initial={"q": {"hinge": start}}, torques={"hinge": 0})
    tree["deploy"]["latches"][0]["at"] = at
    result = deployed(tree)
    assert result.status == "no_lock"
    missed = result.summary["missed"]["catch"]
    # the first half swing ends 2 F / k short of its start's mirror image
    reached = -start - 2.0 * friction / k
    assert abs(missed["nearest"] - (at - reached)) <= missed["errors"]["nearest"] + 1e-12
    assert missed["errors"]["nearest"] < 1e-10
    half = np.pi * np.sqrt(INERTIA / k)
    assert abs(missed["time"] - half) <= missed["errors"]["time"] + 1e-12


def test_undamped_spring_of_a_latch_bears_what_energy_gives() -> None:
    k = 80.0
    latch = {"name": "catch", "joint": "hinge", "at": AT, "hold": {"stiffness": k}}
    tree = panel(deploy={"latches": [latch], "until": "end"}, simulate={"duration": 4.0})
    result = deployed(tree)
    assert result.status == "locked"
    depth = (TORQUE + np.sqrt(TORQUE**2 + k * INERTIA * SPEED**2)) / k
    near(result.summary, "catch", time=CLOSES, peak_moment=k * depth)
    w = np.sqrt(k / INERTIA)
    when = CLOSES + (np.pi - np.arctan(w * SPEED / (TORQUE / INERTIA))) / w
    near(result.summary, "catch", peak_time=when)
    assert result.summary["locks"]["catch"]["rebounds"] == 1
    assert result.summary["energy_drift"] < 1e-9


@pytest.mark.parametrize("c", [0.5, 20.0])
def test_damped_spring_of_a_latch_beside_scipy(c: float) -> None:
    from scipy.integrate import solve_ivp

    k = 30.0
    latch = {"name": "catch", "joint": "hinge", "at": AT, "hold": {"stiffness": k, "damping": c}}
    result = deployed(panel(deploy={"latches": [latch], "until": "end"}, simulate={"duration": 6.0}))
    run = solve_ivp(
        lambda t, y: [y[1], (TORQUE - k * y[0] - c * y[1]) / INERTIA], (0, 1), [0, SPEED],
        rtol=1e-13, atol=1e-14, dense_output=True,
    )  # fmt: skip
    t = np.linspace(0, 1, 200_001)
    y = run.sol(t)
    free = np.flatnonzero((k * y[0] + c * y[1] < 0) | ((y[0] < 0) & (t > 0)))
    load = (k * y[0] + c * y[1])[: free[0] if len(free) else None]
    own = result.summary["locks"]["catch"]
    assert own["peak_moment"] == pytest.approx(load.max(), abs=1e-8)
    assert result.summary["energy_drift"] < 1e-9


def test_run_goes_on_to_the_first_peak_of_the_last_spring() -> None:
    k = 80.0
    latch = {"name": "catch", "joint": "hinge", "at": AT, "hold": {"stiffness": k}}
    result = deployed(panel(deploy={"latches": [latch]}))
    depth = (TORQUE + np.sqrt(TORQUE**2 + k * INERTIA * SPEED**2)) / k
    near(result.summary, "catch", time=CLOSES, peak_moment=k * depth)
    own = result.summary["locks"]["catch"]
    assert result.status == "locked" and "warnings" not in result.summary
    assert result.summary["termination"]["time"] == own["peak_time"] > own["time"]
    assert abs(result.summary["final"]["qd"]["hinge"]) < 1e-9 and own["rebounds"] == 0


def test_damper_that_bears_most_where_it_is_met_ends_the_run_there() -> None:
    latch = {"name": "catch", "joint": "hinge", "at": AT, "hold": {"stiffness": 1.0, "damping": 50.0}}
    summary = deployed(panel(deploy={"latches": [latch]})).summary
    near(summary, "catch", time=CLOSES, peak_moment=50.0 * SPEED, peak_time=CLOSES)
    assert summary["termination"]["time"] == summary["locks"]["catch"]["time"]


def test_largest_load_of_a_spring_is_that_of_all_its_closings() -> None:
    """The latch opens while the panel is on its way back; the second time it is met at a lower speed."""
    latch = {"name": "catch", "joint": "hinge", "at": AT, "hold": {"stiffness": 80.0, "damping": 4.0}}
    once = deployed(panel(deploy={"latches": [latch], "until": "catch"})).summary["locks"]["catch"]
    again = latch | {"release": "t - 3.5"}
    both = deployed(panel(deploy={"latches": [again], "until": "end"})).summary["locks"]["catch"]
    assert (once["closings"], both["closings"]) == (1, 2) and both["speed"] < 0.9 * once["speed"]
    for key in ("peak_moment", "peak_time"):
        assert both[key] == pytest.approx(once[key], abs=1e-9)


@pytest.mark.parametrize("samples", [3, 200])
def test_nearest_of_a_latch_counts_the_way_to_the_first_peak_of_another(samples: int) -> None:
    latch = {"name": "catch", "joint": "hinge", "at": AT, "hold": {"stiffness": 80.0}}
    far = {"name": "far", "joint": "hinge", "at": 1.9}
    summary = deployed(
        panel(deploy={"latches": [latch, far], "until": "catch"}, simulate={"samples": samples})
    ).summary
    missed, end = summary["missed"]["far"], summary["final"]["q"]["hinge"]
    assert abs(missed["nearest"] - (1.9 - end)) <= 1e-12 and missed["time"] == summary["termination"]["time"]


def test_load_that_still_grows_at_the_end_is_no_largest_load() -> None:
    latch = {"name": "catch", "joint": "hinge", "at": AT, "hold": {"stiffness": 5.0}}
    result = deployed(panel(deploy={"latches": [latch]}, simulate={"duration": float(CLOSES + 0.05)}))
    assert result.status == "locked" and "peak_moment" not in result.summary["locks"]["catch"]
    assert any("before the load in the spring" in text for text in result.summary["warnings"])


NEAREST = [
    ({"joint": "hinge", "when": "hinge - hinge^2 - 5"}, 4.75, 0.5),  # largest at 1/2, on the way
    ({"joint": "hinge", "at": -0.3}, 0.3, 0.0),
    ({"joint": "hinge", "at": 0.7, "side": "down"}, 0.0, 0.7),  # passed the other way
    ({"joint": "hinge", "when": "hinge - 0.7", "side": "down"}, 0.0, 0.7),
]


@pytest.mark.parametrize(("latch", "nearest", "at"), NEAREST)
def test_nearest_of_a_latch_that_is_missed_is_located(
    latch: dict[str, Any], nearest: float, at: float
) -> None:
    tree = panel(deploy={"latches": [{"name": "other", **latch}], "until": "end"}, simulate={"duration": 4.0})
    missed = deployed(tree).summary["missed"]["other"]
    assert abs(missed["nearest"] - nearest) <= missed["errors"]["nearest"] + 1e-12
    time = np.sqrt(2.0 * at * INERTIA / TORQUE)
    assert abs(missed["time"] - time) <= missed["errors"]["time"] + 1e-9
    assert missed["errors"]["nearest"] < 1e-9 and missed["errors"]["time"] < 1e-6


def test_nearest_of_a_dead_point_is_told_by_its_determinant() -> None:
    latch = {"name": "in_line", "between": ["coupler", "follower"], "at_dead_point": True}
    early = four_bar(latch, until="end")
    early["simulate"]["duration"] = (1.0 - 1e-6) * deploy(load_scene(FOUR_BAR)).summary["lock"]["time"]
    missed = deployed(early).summary["missed"]["in_line"]
    assert missed["time"] == pytest.approx(early["simulate"]["duration"], rel=1e-5)
    assert 0.0 < missed["errors"]["nearest"] < 1e-6 < missed["nearest"] < 0.1


def two_wings() -> dict[str, Any]:
    """Return two equal panels on both sides of a base, each with a latch."""
    tree = panel()
    joint, link = tree["robot"]["joints"][0], tree["robot"]["links"][0]
    joints = [{**joint, "name": name, "parent": "base"} for name in ("left", "right")]
    links = [{**link, "name": f"{name}_panel"} for name in ("left", "right")]
    latches = [{"name": f"{name}_catch", "joint": name, "at": AT} for name in ("left", "right")]
    return {
        **tree, "robot": {"joints": joints, "links": links}, "torques": {"left": TORQUE, "right": TORQUE},
        "initial": {"q": {"left": 0, "right": 0}}, "deploy": {"latches": latches},
    }  # fmt: skip


def test_latches_that_close_at_once_share_order_and_time() -> None:
    summary = deployed(two_wings()).summary
    for name in ("left_catch", "right_catch"):
        near(summary, name, time=CLOSES, energy_lost=2 * TORQUE * AT, angular_impulse=INERTIA * SPEED)
        assert summary["locks"][name]["order"] == 1
    assert summary["locks"]["left_catch"]["time"] == summary["locks"]["right_catch"]["time"]


def test_latches_that_hold_the_same_share_the_impulse_by_least_norm() -> None:
    tree = two_wings()
    tree["couplers"] = [{"name": "sync", "terms": {"left": 1, "right": -1}}]
    summary = deployed(tree).summary
    for name in ("left_catch", "right_catch"):
        near(summary, name, time=CLOSES, energy_lost=2 * TORQUE * AT, angular_impulse=INERTIA * SPEED)
    assert summary["final"]["qd"] == {"left": 0.0, "right": 0.0}


@pytest.mark.parametrize(
    "condition", [{"at": {"left": AT}}, {"when": f"left - {AT}"}, {"when": f"2*sin({AT} - right)"}]
)
def test_latches_that_close_at_once_share_whatever_closes_them(condition: dict[str, Any]) -> None:
    tree = two_wings()
    tree["couplers"] = [{"name": "sync", "terms": {"left": 1, "right": -1}}]
    tree["deploy"]["latches"][1] = {"name": "right_catch", "joint": "right", **condition}
    summary = deployed(tree).summary
    for name in ("left_catch", "right_catch"):
        near(summary, name, time=CLOSES, energy_lost=2 * TORQUE * AT, angular_impulse=INERTIA * SPEED)
    assert {own["order"] for own in summary["locks"].values()} == {1}


def test_run_goes_on_until_one_latch_is_closed() -> None:
    tree = two_wings()
    tree["torques"]["right"] = 4 * TORQUE
    tree["deploy"]["until"] = "right_catch"
    result = deployed(tree)
    assert result.status == "locked" and list(result.summary["locks"]) == ["right_catch"]
    missed = result.summary["missed"]["left_catch"]
    assert missed["nearest"] == pytest.approx(0.75 * AT, abs=1e-9)
    near(result.summary, "right_catch", time=CLOSES / 2)


# -- loops ------------------------------------------------------------------------------------------------
FOUR_BAR = "configs/four_bar_deploy.yaml"


def four_bar(*latches: dict[str, Any], **deploy_keys: Any) -> dict[str, Any]:
    with open(FOUR_BAR, encoding="utf-8") as file:
        tree: dict[str, Any] = yaml.safe_load(file)
    with open("configs/robots/four_bar.yaml", encoding="utf-8") as file:
        tree["robot"] = yaml.safe_load(file)
    del tree["expect"]
    return {**tree, "deploy": {"latches": list(latches), **deploy_keys}}


def test_latch_in_a_closure_does_what_the_latch_of_a_dead_point_does() -> None:
    one = deploy(load_scene(FOUR_BAR)).summary["lock"]
    latch = {"name": "pin_lock", "between": ["coupler", "follower"], "at_dead_point": True}
    summary = deployed(four_bar(latch)).summary
    own = summary["locks"]["pin_lock"]
    assert own["time"] == pytest.approx(one["time"], abs=1e-9)
    assert own["energy_lost"] == pytest.approx(one["latch"]["energy_lost"], rel=1e-6)
    assert own["angular_impulse"] == pytest.approx(one["latch"]["angular_impulse"], rel=1e-6)
    assert max(abs(x) for x in summary["final"]["qd"].values()) < 1e-12


def test_latched_closure_stays_as_it_is() -> None:
    latch = {"name": "pin_lock", "between": ["coupler", "follower"], "at": {"theta1": 1.5}}
    result = deployed(four_bar(latch, until="end"))
    after = result["q"][result.time > result.summary["locks"]["pin_lock"]["time"]]
    assert len(after) > 10 and np.ptp(after, axis=0).max() < 1e-9
    assert result.status == "locked"


def test_latch_of_the_input_in_its_dead_point_is_refused() -> None:
    latch = {"name": "crank_lock", "joint": "theta1", "at_dead_point": True}
    with pytest.raises(NumericalError, match="crank_lock.*torn open"):
        deployed(four_bar(latch))


def test_spring_in_a_closure_bears_by_how_much_its_links_turn() -> None:
    stiffness = 200.0
    latch = {
        "name": "pin", "between": ["coupler", "follower"], "at": {"theta1": 1.5}, "hold": {"stiffness": stiffness}
    }  # fmt: skip
    tree = four_bar(latch, until="end")
    tree["simulate"] |= {"duration": 12.0, "samples": 601}
    result = deployed(tree)
    own = result.summary["locks"]["pin"]

    def heading(link: str) -> np.ndarray:
        x, y, _ = (result[f"skeleton/{link}"][:, -1] - result[f"skeleton/{link}"][:, 0]).T
        return np.unwrap(np.arctan2(y, x))

    turn = heading("follower") - heading("coupler")
    at = np.interp(own["time"], result.time, turn)
    after = result.time > own["time"] + 0.02
    depth = np.abs(turn - at)[after]
    loads = np.abs(result["latch_loads"][after, 0])
    pushes = loads > 0.0
    np.testing.assert_allclose(loads[pushes], stiffness * depth[pushes], atol=2e-3 * stiffness * depth.max())
    assert own["peak_moment"] == pytest.approx(stiffness * depth[pushes].max(), rel=5e-3)
    assert result.summary["energy_drift"] < 1e-8 and own["energy_lost"] == 0.0


def of_torque(**simulate: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the panel under a controller, and under the same torque as a formula."""
    tree = panel(simulate={"duration": 8.0, **simulate}, initial={"q": {"hinge": 0}})
    del tree["torques"]
    led = {"type": "joint", "duration": 8.0, "q": {"hinge": "0.5*t"}}
    law = {"type": "pd", "joints": ["hinge"], "reference": led, "gains": {"kp": 4.0, "kd": 1.0}}
    return {**tree, "control": law}, {**tree, "torques": {"hinge": "4*(0.5*t - hinge) + 0.5 - qd.hinge"}}


def test_a_controller_leads_a_panel_to_its_latch() -> None:
    own, other = (deployed(tree).summary["locks"]["catch"] for tree in of_torque())
    for key in ("time", "speed", "energy_lost", "angular_impulse"):
        assert own[key] == pytest.approx(other[key], abs=own["errors"][key] + other["errors"][key] + 1e-11)


def test_a_sampled_controller_leads_a_panel_to_its_latch() -> None:
    """The torque is constant between updates, so that the motion is a sequence of parabolas."""
    tree, _ = of_torque()
    tree["control"]["period"] = h = 0.1
    q, v, k = 0.0, 0.0, 0
    while True:
        a = (4.0 * (0.5 * k * h - q) + 0.5 - v) / INERTIA
        if q + v * h + 0.5 * a * h * h >= AT:
            break
        q, v, k = q + v * h + 0.5 * a * h * h, v + a * h, k + 1
    since = (-v + np.sqrt(v * v + 2.0 * a * (AT - q))) / a
    near(deployed(tree).summary, "catch", time=k * h + since, speed=v + a * since)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"latch": [{"between": ["base", "panel"]}]}, "latches"),
        ({"latches": [{"name": "a", "joint": "hinge", "at": 1}], "criterion": "latch"}, "does not go with 'latches'"),
        ({"latches": [{"name": "a", "joint": "hinge"}]}, "says when it closes nowhere"),
        ({"latches": [{"name": "a", "joint": "hinge", "at": 1, "when": "t - 1"}]}, "says when it closes twice"),
        ({"latches": [{"name": "a", "at": {"hinge": 1}}]}, "needs one of 'joint' and 'between'"),
        ({"latches": [{"name": "a", "between": ["base", "panel"], "at": 1}]}, "JOINT: POSITION"),
        ({"latches": [{"name": "a", "joint": "hing", "at": 1}]}, "did you mean 'hinge'"),
        ({"latches": [{"name": "a", "joint": "hinge", "at": 1}], "until": "b"}, "unknown latch 'b'"),
        ({"until": "end"}, "goes with 'latches'"),
        ({"latches": [{"name": "all", "joint": "hinge", "at": 1}]}, "has a meaning under 'until'"),
        ({"latches": [{"name": "a", "joint": "hinge", "at_limit": {"hinge": "upper"}}]}, "has no such limit"),
    ],
)  # fmt: skip
def test_what_does_not_fit_together_is_refused(change: dict[str, Any], message: str) -> None:
    tree = panel()
    tree["deploy"] = change
    with pytest.raises((SceneError, RobodynError), match=message.replace("(", r"\(")):
        load_scene_text(yaml.safe_dump(tree))


# -- going on ---------------------------------------------------------------------------------------------
def pair(**deploy_keys: Any) -> dict[str, Any]:
    """Return two panels in a chain; the first reaches its latch well before the second."""
    tree = panel()
    joint = {
        "name": "elbow",
        "type": "revolute",
        "axis": [0, 0, 1],
        "origin": {"xyz": [1, 0, 0]},
        "damper": {"damping": 0.1},
    }
    tree["robot"]["joints"].append(joint)
    tree["robot"]["links"].append({"name": "fore", "mass": 1.0, "com": [0.4, 0, 0], "inertia": {"zz": 0.1}})
    tree["torques"]["elbow"] = -0.02
    tree["initial"]["q"]["elbow"] = 2.0
    tree["deploy"]["latches"].append({"name": "lower", "joint": "elbow", "at": 0.5})
    tree["deploy"] |= deploy_keys
    tree["simulate"]["duration"] = 40
    return tree


def stored(tree: dict[str, Any], folder: Path) -> Result:
    from robodyn_cli.results.hdf5 import write

    result = deployed(tree)
    write(result, folder / "result.h5")
    return result


def test_deployment_goes_on_from_its_first_lock(tmp_path: Path) -> None:
    whole = deployed(pair())
    first = stored(pair(until="catch"), tmp_path)
    assert list(first.summary["locks"]) == ["catch"]
    again = pair()
    again["initial"]["from"] = str(tmp_path)
    rest = deployed(again)
    assert rest.status == "locked" and rest.summary["missed"] == {}
    carried = {
        "order": 0,
        "angle": AT,
        "redundant": False,
        "rebounds": 0,
        "closings": 0,
        "errors": {"angle": 1e-14 * AT},
        "unit": "rad",
    }
    assert rest.summary["locks"]["catch"] == carried
    own, other = rest.summary["locks"]["lower"], whole.summary["locks"]["lower"]
    assert own["time"] == pytest.approx(other["time"], abs=1e-9)
    assert own["energy_lost"] == pytest.approx(other["energy_lost"], abs=1e-9)
    assert np.ptp(rest["q"][:, 0]) == 0.0
    held = [e for e in rest.events if e["kind"] == "carried"]
    assert [(e["name"], e["time"]) for e in held] == [("catch", first.time[-1])]
    closed = {latch.vertices: latch.is_closed(rest.time[0]) for latch in make_drawing(rest).latches}
    assert sorted(closed.values()) == [False, True]


def test_third_run_knows_the_latches_that_the_first_has_closed(tmp_path: Path) -> None:
    """The second one carries them on; the hinge, which is pulled, would move if its latch were open."""
    stored(pair(until="catch"), tmp_path)
    for end in (None, 80.0):
        again = pair(until="lower" if end is None else "end")
        again["initial"]["from"] = str(tmp_path)
        again["simulate"]["duration"] = end or again["simulate"]["duration"]
        last = stored(again, tmp_path)
    names = {e["name"] for e in last.events if e["kind"] == "carried"}
    assert names == {"catch", "lower"} and np.ptp(last["q"], axis=0).max() == 0.0


def test_simulation_goes_on_with_the_locked_mechanism(tmp_path: Path) -> None:
    from robodyn_cli.works.simulate import simulate

    stored(pair(until="catch"), tmp_path)
    tree = pair()
    tree["initial"]["from"] = str(tmp_path)
    result = simulate(load_scene_text(yaml.safe_dump(tree)))
    assert result.time[-1] == tree["simulate"]["duration"] and result.status == "ok"
    assert np.ptp(result["q"][:, 0]) == 0.0
    assert [lock["order"] for lock in result.summary["locks"].values()] == [0, 1]


def test_stage_that_is_released_starts_from_a_lock_without_the_joints_that_are_gone(tmp_path: Path) -> None:
    first = stored(pair(), tmp_path)
    tree = pair()
    tree["robot"]["joints"].pop(0)
    base = tree["robot"]["links"].pop(0)
    assert base["name"] == "panel"
    del tree["torques"]["hinge"], tree["initial"]["q"]["hinge"]
    tree["deploy"] = {"latches": [{"name": "other", "joint": "elbow", "at": 0.1}], "until": "end"}
    tree["simulate"]["duration"] = 80
    tree["initial"] = {"from": str(tmp_path)}
    result = deployed(tree)
    told = " ".join(result.summary["warnings"])
    assert "joints of the stored run that this scene does not have: hinge" in told
    assert "catch, lower" in told and "open" in told
    # the first sample is that of the lock, those behind it keep to the grid
    assert result.time[0] == first.time[-1] and result["q"][0, 0] == first.summary["final"]["q"]["elbow"]
    count, step = 80.0 / (tree["simulate"]["samples"] - 1), result.time[1:-1]
    np.testing.assert_allclose(step / count, np.round(step / count), atol=1e-9)
    assert "other" in result.summary["locks"]


def test_joint_that_moves_is_not_left_behind(tmp_path: Path) -> None:
    stored(pair(until="catch"), tmp_path)
    tree = pair()
    tree["robot"]["joints"].pop()
    tree["robot"]["links"].pop()
    del tree["torques"]["elbow"]
    tree["initial"] = {"from": str(tmp_path)}
    tree["deploy"]["latches"].pop()
    with pytest.raises(SceneError, match="elbow.*moves at"):
        deployed(tree)


def test_deployment_with_one_latch_is_not_gone_on_from(tmp_path: Path) -> None:
    from robodyn_cli.results.hdf5 import write

    write(deploy(load_scene(FOUR_BAR)), tmp_path / "result.h5")
    with pytest.raises(SceneError, match="deployment with one 'latch'"):
        deployed(
            {**four_bar({"name": "a", "joint": "theta1", "at": 1.0}), "initial": {"from": str(tmp_path)}}
        )


def test_spring_of_a_latch_that_opens_takes_its_energy_along() -> None:
    latch = {
        "name": "catch",
        "joint": "hinge",
        "at": AT,
        "hold": {"stiffness": 30, "damping": 1},
        "release": "t - 2.6",
    }
    result = deployed(panel(deploy={"latches": [latch], "until": "end"}, simulate={"duration": 4.0}))
    assert result.status == "no_lock" and result.summary["locks"]["catch"]["opened"] == pytest.approx(2.6)
    assert result.summary["energy_drift"] < 1e-9


def test_latch_cannot_stop_what_is_prescribed() -> None:
    tree = two_wings()
    tree["couplers"] = [{"name": "sync", "terms": {"left": 1, "right": -1}}]
    tree["prescribed"], tree["torques"] = {"left": "0.5*t"}, {}
    tree["deploy"]["latches"].pop(0)
    with pytest.raises(NumericalError, match="right_catch.*prescribed motion or loops force on"):
        deployed(tree)


def test_what_slips_from_the_start_on_is_told_once() -> None:
    rough = {"friction": {"coulomb": 0.05, "law": "set_valued"}}
    result = deployed(panel(joint=rough))
    assert [(event["time"], event["kind"]) for event in result.events][:1] == [(0.0, "slip")]
    assert result.summary["transitions"]["slip"] == 1


def test_what_does_not_go_with_latches_is_refused() -> None:
    tree = panel(prescribed={"hinge": "0.5*t"}, torques={})
    tree["torques"] = {}
    with pytest.raises(RobodynError, match="hold"):
        deployed(tree)
    latch = {"name": "catch", "joint": "hinge", "at_dead_point": True}
    with pytest.raises(RobodynError, match="at_dead_point"):
        deployed(panel(deploy={"latches": [latch]}))


def test_arrays_in_step_go_on_from_their_locks(tmp_path: Path) -> None:
    """Latches share the one freedom that couplers leave, and what some of them hold others hold already."""
    from robodyn_cli.results.hdf5 import write

    path = Path(__file__).resolve().parents[2] / "configs/mechanisms/solar_array_in_step.yaml"
    write(deploy(load_scene(path, ["expect={}"])), tmp_path / "result.h5")
    on = [f"initial.from={tmp_path}", "deploy.until=end", "expect={}", "simulate.duration=20"]
    result = deploy(load_scene(path, on))
    assert result.status == "locked" and float(np.abs(result["qd"]).max()) < 1e-9


REDUNDANT = """
schema: 1
command: deploy
gravity: [0, 0, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1], spring: {stiffness: 3, rest: 20 deg}, damper: {damping: 0.3}}
    - name: b
      type: revolute
      axis: [0, 0, 1]
      origin: {xyz: [1, 0, 0]}
      spring: {stiffness: 2, rest: -20 deg}
  links:
    - {name: one, mass: 4, com: [0.5, 0, 0], inertia: {zz: 0.34}}
    - {name: two, mass: 4, com: [0.5, 0, 0], inertia: {zz: 0.34}}
couplers: [{name: c1, terms: {a: 2, b: 1}}, {name: c2, terms: {a: 1, b: 0.5}}]
initial: {q: {a: -90 deg}, hold: [a]}
simulate: {duration: 4, samples: 81}
outputs: {reactions: true, extremes: [qdd.a]}
deploy: {until: end, latches: [{name: latch, joint: a, at: 0}]}
"""


def test_a_latched_structure_with_redundant_rows_has_no_acceleration() -> None:
    """What the latch holds counts in the multipliers of least norm: the structure at rest pulls at nothing, and the
    couplers share the torque of the second spring, x + y / 2 = k r, along the coefficients of their rows."""
    result = deploy(load_scene_text(REDUNDANT))
    after = result.time > result.summary["locks"]["latch"]["time"] + 1e-6
    assert after.sum() > 20
    np.testing.assert_allclose(result["qdd"][after], 0.0, atol=1e-12)
    np.testing.assert_allclose(result["base_wrench"][after], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        result["constraints/multipliers"][after] @ [1.0, 0.5], 2 * math.radians(20), rtol=1e-9
    )
    load = -(3 * math.radians(20) + 4 * math.radians(20))
    np.testing.assert_allclose(result["latch_loads"][after, 0], load, rtol=1e-9)
    assert abs(result.summary["extremes"]["qdd.a"]["final"]) <= 1e-12


def test_what_a_second_run_does_not_confirm_has_no_error(tmp_path: Path) -> None:
    """A swing that turns where the latch is, and one that goes beyond it three seconds later: whether the first is
    caught is for rounding to say."""
    tree = panel(joint={"spring": {"stiffness": 1.0}}, torques={"hinge": "0.02*t*cos(1.69*t)"})
    tree["initial"]["qd"] = {"hinge": 0.3}
    tree["simulate"].update(integrator="dopri5", rtol=1e-5, atol=1e-5, duration=20)
    catch, low, high = tree["deploy"]["latches"][0], 0.1, 0.4
    for _ in range(60):
        catch["at"] = 0.5 * (low + high)
        summary = deployed(tree).summary
        lock = summary["locks"]["catch"]
        if "warnings" in summary:
            break
        assert lock["errors"]["time"] < 1e-2 * lock["time"]
        low, high = (catch["at"], high) if lock["time"] < 2.0 else (low, catch["at"])
    assert any("latch 'catch' closes at t = " in told for told in summary["warnings"])
    assert set(lock["errors"].values()) == {None}
    assert summary["lock"]["time_error"] is None and "not known" in summary["lock"]["time_error_method"]
    assert set(summary["lock"]["errors"].values()) == {None}
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    many = Mechanism(path, ["simulate.duration"]).deploy_many([[20.0]], of=["locks.catch.time"])
    assert many.time[0] == lock["time"] and many.one_by_one[0]
    assert np.isnan([many.time_error[0], many.errors["locks.catch.time"][0]]).all()
