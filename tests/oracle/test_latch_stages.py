"""Stages of deployables, each from a stored run of the one before, beside closed forms; what runs say of latches that
earlier ones have closed, and of those that others make needless."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.integrate import quad

from robodyn_cli.cli.commands.deploy import describe
from robodyn_cli.errors import SceneError
from robodyn_cli.over.findings import findings
from robodyn_cli.results.hdf5 import write
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.works.deploy.deploy import deploy
from tests.unit.test_latches import panel

EXPLORE = int(os.environ.get("ROBODYN_EXPLORE", "0"))
SEEDS = range(5) if not EXPLORE else range(1000, 1000 + 15 * EXPLORE)
ORACLE = 2e-11  # s and J: what the quadrature and the closing of loops leave


def deployed(tree: dict[str, Any]) -> Result:
    return deploy(load_scene_text(yaml.safe_dump(tree)))


def kept(tree: dict[str, Any], folder: Path) -> Result:
    folder.mkdir(exist_ok=True)
    result = deployed(tree)
    write(result, folder / "result.h5")
    return result


class Mast:
    """A mast of bars that cross each other in pairs, unfolded by a spring between the lowest ones; its one freedom is
    the angle theta of bar a1 with the ground."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.stages = int(rng.integers(2, 6))
        self.length, self.mass, self.stiffness = (
            rng.uniform(0.3, 2.0),
            rng.uniform(0.1, 3.0),
            rng.uniform(0.2, 4.0),
        )
        self.inertia = self.mass * self.length**2 / rng.uniform(11.0, 14.0)
        self.angles = np.radians([rng.uniform(8, 14), rng.uniform(30, 45), rng.uniform(55, 75)])

    def scene(self) -> dict[str, Any]:
        n, whole, axis = self.stages, self.length, [0, 0, 1]
        half, folded = 0.5 * whole, float(np.pi - 2.0 * self.angles[0])
        parents = {"a1": "base", "b1": "A1"} | ({"a2": "B1", "b2": "A1"} if n > 1 else {})
        parents |= {f"{x}{k}": f"{y}{k - 1}" for k in range(3, n + 1) for x, y in (("a", "B"), ("b", "A"))}
        joints = [
            {
                "name": name, "type": "revolute", "axis": axis, "parent": parent, "link": name.upper(),
                "origin": {"xyz": [0 if name == "a1" else half if name in ("b1", "a2") else whole, 0, 0]},
                **({"spring": {"stiffness": float(self.stiffness)}} if name == "b1" else {}),
            }
            for name, parent in parents.items()
        ]  # fmt: skip
        links = [
            {
                "name": joint["link"], "mass": float(self.mass), "com": [0 if joint["name"] == "b1" else half, 0, 0],
                "inertia": {"zz": float(self.inertia)},
            }
            for joint in joints
        ]  # fmt: skip
        points = {
            f"p{x}{k}": {"link": f"{x.upper()}{k}", "at": [half, 0, 0]} for x in "ab" for k in range(2, n + 1)
        }
        loops = [
            {"name": f"pin{k}", "type": "revolute", "between": [f"pa{k}", f"pb{k}"]} for k in range(2, n + 1)
        ]
        start = {"a1": float(self.angles[0])} | {
            name: (folded if name[0] == "b" else -folded) for name in parents if name != "a1"
        }
        return {
            "schema": 1, "command": "deploy", "gravity": [0, 0, 0],
            "robot": {"joints": joints, "links": links, "points": points}, "loops": loops,
            "couplers": [{"name": "roller", "terms": {"a1": 2, "b1": 1}, "value": "pi"}], "actuated": ["a1"],
            "initial": {"q": start, "hold": ["a1"]}, "simulate": {"duration": 60, "samples": 61},
        }  # fmt: skip

    def latches(self, stage: int, **more: Any) -> list[dict[str, Any]]:
        """Return a latch in each pair of bars, where theta comes to the angle of a stage."""
        at = float(np.pi - 2.0 * self.angles[stage])
        joints = ["b1", *(f"a{k}" for k in range(2, self.stages + 1))]
        return [{"name": f"s{j}", "joint": j, "at": at if j == "b1" else -at, **more} for j in joints]

    def inertia_at(self, theta: float) -> float:
        across, up = 0.25 * np.sin(theta) ** 2, np.cos(theta) ** 2
        heights = (np.arange(1, self.stages + 1) - 0.5) ** 2
        return float(2.0 * (self.mass * self.length**2 * (across + heights * up) + self.inertia).sum())

    def gained(self, first: float, last: float) -> float:
        """Return the energy [J] that the spring gives from one angle to another."""
        return float(0.5 * self.stiffness * ((np.pi - 2.0 * first) ** 2 - (np.pi - 2.0 * last) ** 2))

    def time(self, first: float, last: float) -> float:
        """Return the time [s] from rest at one angle to another; theta = first + u^2."""
        seconds, _ = quad(
            lambda u: 2.0 * u * np.sqrt(self.inertia_at(first + u * u) / (2.0 * self.gained(first, first + u * u)))
            if u else 0.0,
            0.0, np.sqrt(last - first), epsabs=1e-13, epsrel=1e-13,
        )  # fmt: skip
        return float(seconds)


@pytest.mark.parametrize("seed", SEEDS)
def test_next_stage_of_a_mast_goes_on_when_its_last_latch_opens(seed: int, tmp_path: Path) -> None:
    """Latches that share one freedom open at the same instant, within roundings of it, or one after another; the mast
    stands until the last one does, and noise in what they held closes none of them again."""
    rng = np.random.default_rng([seed, 21])
    mast = Mast(rng)
    first, middle, last = mast.angles
    tree = mast.scene() | {"deploy": {"latches": mast.latches(1)}}
    stage = kept(tree, tmp_path)
    time, lost = mast.time(first, middle), mast.gained(first, middle)
    for own in stage.summary["locks"].values():
        assert abs(own["time"] - time) <= own["errors"]["time"] + ORACLE and own["order"] == 1
        assert abs(own["energy_lost"] - lost) <= own["errors"]["energy_lost"] + ORACLE * max(1.0, lost)
    assert [own["redundant"] for own in stage.summary["locks"].values()].count(False) == 1

    opens = 1.2 * time + rng.choice([0.0, 1e-15, 1e-13, 1e-9, 0.3]) * rng.uniform(0.5, 2.0, mast.stages)
    latches = mast.latches(1)
    for latch, at in zip(latches, opens.tolist()):
        latch["release"] = f"t - {at!r}"
    fin = {"name": "fin", "joint": "b1", "at": float(np.pi - 2.0 * last)}
    tree |= {"deploy": {"latches": [*latches, fin], "until": "fin"}, "initial": {"from": str(tmp_path)}}
    tree["simulate"]["duration"] = float(opens.max()) + 60.0
    tree["outputs"] = {"reactions": True, "extremes": ["latch_loads.sb1", "q.a1"]}
    summary = deployed(tree).summary
    assert summary["status"] == "locked" and "warnings" not in summary, summary.get("warnings")
    own, expected = summary["locks"]["fin"], float(opens.max()) + mast.time(middle, last)
    assert abs(own["time"] - expected) <= own["errors"]["time"] + ORACLE * expected
    lost = mast.gained(middle, last)
    assert abs(own["energy_lost"] - lost) <= own["errors"]["energy_lost"] + ORACLE * max(1.0, lost)
    for latch, at in zip(latches, opens.tolist()):
        carried = summary["locks"][latch["name"]]
        assert carried["order"] == 0 and abs(carried["opened"] - at) <= 1e-13 * at and "time" not in carried
    least = summary["extremes"]["q.a1"]
    assert abs(least["smallest"] - middle) <= least["errors"]["smallest"] + 1e-12
    assert least["errors"]["smallest"] < 1e-5


@pytest.mark.parametrize("singular", ["stop", "pass"])
def test_a_stop_before_a_singular_pose_is_met_first(singular: str) -> None:
    """The bars of a mast would come in line behind the stop: the way there is not looked for past it."""
    from robodyn_cli.works.simulate import simulate

    mast = Mast(np.random.default_rng([1010, 21]))
    tree = mast.scene()
    at = float(np.pi - 2.0 * mast.angles[2])
    tree["robot"]["joints"][1]["limits"] = {"lower": at, "stop": {"restitution": 0}}
    tree["simulate"] |= {"singular": singular, "duration": mast.time(*mast.angles[::2]) + 2.0, "samples": 11}
    result = simulate(load_scene_text(yaml.safe_dump(tree | {"command": "simulate"})))
    assert result.status == "ok" and abs(result["q"][-1, 1] - at) < 1e-12
    (hit,) = [event for event in result.events if event["kind"] == "impact"]
    assert abs(hit["time"] - mast.time(*mast.angles[::2])) < 1e-9


def test_a_latch_that_is_slow_to_leave_its_position_is_not_closed_there_by_rounding() -> None:
    """Beside its position the panel creeps: a second passes until it is further off than rounding."""
    tree = panel(torques={"hinge": 1e-13}, simulate={"duration": 100.0}, initial={"q": {"hinge": 1.2}})
    result = deployed(tree)
    assert result.status == "no_lock" and list(result.summary["missed"]) == ["catch"]


# -- what earlier runs have closed ------------------------------------------------------------------------
def array(*names: str, **latch: Any) -> dict[str, Any]:
    """Return three panels without friction on parallel hinges, whose constant torques close latches at 1 rad."""
    axis, torques = [0, 0, 1], {"one": 1.0, "two": 0.3, "three": 0.05}
    joints = [
        {"name": name, "type": "revolute", "axis": axis, "parent": "base", "link": f"p{name}"}
        for name in torques
    ]
    links = [{"name": f"p{name}", "mass": 0, "inertia": {"zz": 0.5}} for name in torques]
    return {
        "schema": 1, "command": "deploy", "gravity": [0, 0, 0], "robot": {"joints": joints, "links": links},
        "torques": torques, "initial": {"q": dict.fromkeys(torques, 0.0)},
        "simulate": {"duration": 20, "samples": 2001},
        "deploy": {"latches": [{"name": f"l{x}", "joint": x, "at": 1.0, **latch} for x in torques]},
    }  # fmt: skip


def test_latches_are_carried_from_stage_to_stage(tmp_path: Path) -> None:
    tree = array(hold={"stiffness": 40.0, "damping": 2.0})
    kept(tree | {"deploy": tree["deploy"] | {"until": "lone"}}, tmp_path / "a")
    on = tree | {"initial": {"from": str(tmp_path / "a")}, "deploy": tree["deploy"] | {"until": "ltwo"}}
    kept(on, tmp_path / "b")
    on = tree | {"initial": {"from": str(tmp_path / "b")}}
    last = deployed(on).summary
    assert {name: own["order"] for name, own in last["locks"].items()} == {"lone": 0, "ltwo": 0, "lthree": 1}
    whole = deployed(tree | {"deploy": tree["deploy"] | {"until": "lthree"}}).summary
    assert abs(last["locks"]["lthree"]["time"] - whole["locks"]["lthree"]["time"]) < 1e-9
    # each pushes on its spring from then on, and comes to rest under its own torque
    for name, torque in (("lone", 1.0), ("ltwo", 0.3)):
        own = last["locks"][name]
        assert torque < own["peak_moment"] <= whole["locks"][name]["peak_moment"] + 1e-9
        assert own["errors"]["peak_moment"] < 1e-6 and "energy_lost" not in own
    told = describe(json.loads(json.dumps(last)) | {"title": "", "counters": {}, "status": "locked"})
    assert "closed from the start on, loaded by up to" in told


@pytest.mark.parametrize("until", ["all", "lone"])
def test_waiting_for_what_is_closed_is_refused(until: str, tmp_path: Path) -> None:
    kept(array(), tmp_path)
    tree = array() | {"initial": {"from": str(tmp_path)}}
    tree["deploy"]["until"] = until
    with pytest.raises(
        SceneError, match=f"deploy.until: {until}.*closed already in the stored run.*allowed: end"
    ):
        deployed(tree)
    for latch in tree["deploy"]["latches"]:  # it opens, turns back and closes again
        latch["release"] = f"t - {15.0!r}"
    tree["torques"] = {"one": "1 - 3*step(t - 15) + 9*step(t - 16)", "two": 0.3, "three": 0.05}
    if until == "lone":
        result = deployed(tree)
        own = result.summary["locks"]["lone"]
        assert result.status == "locked" and own["order"] == 1 and own["closings"] == 1 and own["time"] > 16.0


# -- latches that others make needless --------------------------------------------------------------------
def told_by(tree: dict[str, Any], folder: Path) -> list[str]:
    """Return what ``validate`` says of latches."""
    (folder / "scene.yaml").write_text(yaml.safe_dump(tree))
    return [one.message for one in findings(folder / "scene.yaml") if "deploy.latches" in one.message]


def test_two_latches_in_one_place_are_told(tmp_path: Path) -> None:
    latches = [
        {"name": "k", "joint": "hinge", "at": 1.2},
        {"name": "l", "between": ["base", "panel"], "at": {"hinge": 1.2}},
    ]
    tree = panel(deploy={"latches": latches})
    (message,) = told_by(tree, tmp_path)
    assert "l: holds joint 'hinge' in the place in which 'k' does" in message
    summary = deployed(tree).summary
    one, other = summary["locks"].values()
    assert (one["redundant"], other["redundant"]) == (False, True)
    whole = deployed(panel()).summary["locks"]["catch"]["angular_impulse"]
    assert one["angular_impulse"] + other["angular_impulse"] == pytest.approx(whole, rel=1e-12)


def test_latches_of_one_joint_at_different_places_are_told(tmp_path: Path) -> None:
    latches = [{"name": "k", "joint": "hinge", "at": 1.2}, {"name": "l", "joint": "hinge", "at": 0.7}]
    (message,) = told_by(panel(deploy={"latches": latches}), tmp_path)
    assert "l: holds joint 'hinge' at 0.7, and 'k' does at 1.2: whichever closes first" in message
    latches[1]["release"] = "t - 5"
    assert told_by(panel(deploy={"latches": latches}), tmp_path) == []
    latches[1] = {"name": "l", "joint": "hinge", "at": 0.7, "hold": {"stiffness": 3.0}}
    assert told_by(panel(deploy={"latches": latches}), tmp_path) == []


@pytest.mark.parametrize("formula", [5, "p - 1", "2*pi", "3 rad"])
@pytest.mark.parametrize("key", ["when", "release"])
def test_conditions_that_never_change_are_refused(key: str, formula: Any) -> None:
    latch = {"name": "catch", "joint": "hinge", "at": 1.2, key: formula}
    if key == "when":
        del latch["at"]
    with pytest.raises(SceneError, match=f"deploy.latches.0.{key}: never passes zero"):
        deployed(panel(parameters={"p": 3.0}, deploy={"latches": [latch]}))
    payload = {"name": "load", "at": "panel.origin", "mass": 1.0, "until": {"when": formula}}
    with pytest.raises(SceneError, match="payloads.0.until.when: never passes zero"):
        deployed(panel(parameters={"p": 3.0}, payloads=[payload]))
