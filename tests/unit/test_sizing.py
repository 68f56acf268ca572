"""``size`` against what ``inverse`` says of every combination."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.cli.app import run
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.motors.drive import Drive
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.size.candidates import Responses
from robodyn_cli.works.size.search import DriveSearch
from robodyn_cli.works.size.size import size

CONFIGS = Path(__file__).parents[2] / "configs"
ARM = """
schema: 1
gravity: [1.3, -2.1, -9.2]
robot:
  joints:
    - {name: a, type: revolute, axis: [0.2, 0.3, 1], origin: {xyz: [0.1, 0, 0.3], rpy: [0.2, -0.1, 0.4]}}
    - {name: s, type: prismatic, axis: [1, 0.2, 0], origin: {xyz: [0.4, 0.1, 0], rpy: [0.3, 0, 0.1]}}
    - {name: b, type: revolute, axis: [0, 1, 0.4], origin: {xyz: [0.1, 0.3, 0.2], rpy: [0, 0.5, 0]}}
  links:
    - {name: A, mass: 3.0, com: [0.2, 0.05, -0.1], com_frame: joint, inertia: {xx: 0.2, yy: 0.3, zz: 0.25, xy: 0.02, xz: -0.01, yz: 0.03}}
    - {name: S, mass: 2.0, com: [0.1, -0.05, 0.1], com_frame: joint, inertia: {xx: 0.1, yy: 0.2, zz: 0.15, xy: 0.01, xz: 0.02, yz: -0.03}}
    - {name: B, mass: 1.0, com: [0.3, 0.02, 0.04], com_frame: joint, inertia: {xx: 0.05, yy: 0.06, zz: 0.07, xy: 0.004, xz: 0.003, yz: 0.002}}
trajectory:
  type: joint
  duration: 3
  q: {a: "0.8*sin(2*pi*t/3)", s: "0.3 + 0.1*cos(2*pi*t/3)", b: "0.5*sin(4*pi*t/3) + 0.2*cos(2*pi*t/3)"}
inverse: {samples: 601}
catalogue:
  motors:
    large: {type: dc, mass: 2.7, cost: 30, torque_constant: 0.2, resistance: 0.9, voltage: 90, max_current: 60, rotor_inertia: 3e-4, coulomb: 0.01, viscous: 2e-5, thermal: {winding_resistance: 0.4, housing_resistance: 0.6, winding_time: 20, housing_time: 900, max_temperature: 150}}
    small: {type: dc, mass: 0.7, cost: 10, torque_constant: 0.1, resistance: 0.7, voltage: 48, max_current: 30, rated_current: 6, rotor_inertia: 5e-5}
    steps: {type: stepper, mass: 1.5, cost: 9, rotor_inertia: 8e-5, pull_out: [[0, 2.4], [40, 2.0], [190, 0.5]]}
  gears:
    g40: {type: gear, ratio: 40, efficiency: 0.8, back_driving: 0.5, inertia: 1e-4, mass: 0.9, cost: 5, peak_torque: 90, rated_torque: 60, max_speed: 400}
    g9: {type: gear, ratio: 9, efficiency: 0.93, inertia: 3e-5, mass: 0.5, cost: 3, peak_torque: 60}
    screw: {type: ball_screw, lead: 0.02, efficiency: 0.9, inertia: 2e-4, mass: 0.8, cost: 4}
  brakes:
    k: {holding_torque: 3, inertia: 5e-5, mass: 0.4, cost: 2}
"""
GEARS: dict[str, list[str | None]] = {"a": [None, "g40", "g9"], "s": ["screw"], "b": [None, "g40", "g9"]}
MOTORS = ["large", "small", "steps"]


def table(result: Any, joint: str) -> dict[tuple[str, str | None], float]:
    """Return the margin of each combination of a joint."""
    sized = result.summary["size"]["joints"][joint]
    return {
        (sized["motors"][int(motor)], sized["gears"][int(gear)]): margin
        for motor, gear, _, _, margin in result[f"candidates/{joint}"].tolist()
    }


def with_drives(chosen: dict[str, tuple[str, str | None]], more: str = "") -> str:
    drives = ", ".join(
        f"{n}: {{motor: {m}{'' if g is None else f', gear: {g}'}{more}}}" for n, (m, g) in chosen.items()
    )
    return f"{ARM}drives: {{{drives}}}\n"


@pytest.mark.parametrize(
    ("turn", "more"),
    list(enumerate(["", ", brake: k, count: 2, coupling_inertia: 1.0e-4", ", mass_on: none, ambient: 40"])),
)
def test_margins_are_those_of_inverse_with_each_combination(turn: int, more: str) -> None:
    """Every combination of every joint, the others as chosen: the same margins, the same verdicts.

    With each setting a third of them, in which each motor and each gear is; all with the three together.
    """
    start = {"a": ("large", "g40"), "s": ("large", "screw"), "b": ("small", "g9")}
    result = size(load_scene_text(with_drives(start, more)))
    assert result.summary["size"]["margin_difference"] < 1e-9
    chosen = {n: (d["motor"], d["gear"]) for n, d in result.summary["drives"].items()}
    for joint in chosen:
        margins = table(result, joint)
        assert set(margins) == set(itertools.product(MOTORS, GEARS[joint]))
        for parts, margin in margins.items():
            motor, gear = parts
            if (MOTORS.index(motor) + GEARS[joint].index(gear)) % 3 != turn:
                continue
            text = with_drives({**chosen, joint: parts}, more)
            found = inverse(load_scene_text(text)).summary["drives"][joint]
            if margin >= 0.0 or found["margin"] >= 0.0:
                assert margin == pytest.approx(found["margin"], abs=1e-9), (joint, parts)


@pytest.mark.parametrize(("by", "other"), [("cost", "mass"), ("mass", "cost")])
def test_what_is_chosen_is_the_cheapest_or_lightest_that_bears_it(by: str, other: str) -> None:
    result = size(load_scene_text(ARM), by=by, margin=0.1)
    assert any((result[f"candidates/{n}"][:, 4] < 0.1).sum() > 2 for n in "asb")
    for joint, drive in result.summary["drives"].items():
        data = result[f"candidates/{joint}"]
        prices = {"cost": data[:, 2], "mass": data[:, 3]}
        bears = data[:, 4] >= 0.1
        assert bears.sum() == result.summary["size"]["joints"][joint]["passing"]
        assert drive["passes"] and drive[by] == prices[by][bears].min()
        equal = bears & (prices[by] == drive[by])
        assert drive[other] == prices[other][equal].min()
        front = result.summary["size"]["joints"][joint]["front"]
        assert front[0]["motor"] == drive["motor"] and front[-1]["margin"] == data[:, 4].max()
        pairs = [(one[by], one["margin"]) for one in front]
        assert pairs == sorted(pairs) and len({m for _, m in pairs}) == len(pairs)
        for price, margin in zip(prices[by][bears], data[bears, 4]):
            assert any(p <= price and m >= margin for p, m in pairs)
    again = size(load_scene_text(ARM), by=by, margin=0.1)
    assert again.summary["size"] == result.summary["size"] and again.scene_text == result.scene_text
    # the scene of the result, run again, has these drives
    assert inverse(load_scene_text(result.scene_text)).summary["drives"] == result.summary["drives"]


def test_what_there_is_to_choose_from_is_checked_before_anything_is_chosen() -> None:
    with pytest.raises(SceneError, match=r"catalogue.motors.small: has no continuous envelope"):
        load_scene_text(ARM.replace("rated_current: 6, ", ""))


def test_torques_are_linear_in_masses_and_inertias() -> None:
    """Of an arm, and of five bars whose two cranks share the load: far from the values that they were found with."""
    rng = np.random.default_rng(4)
    five = load_scene(CONFIGS / "mechanisms" / "five_bar_circle.yaml", ["outputs.reactions=false"])
    arm = load_scene_text(ARM)
    for scene, joints in ((arm, ("a", "s", "b")), (five, ("left", "right"))):
        responses = Responses.of(scene, {name: Drive(motor="") for name in joints})
        masses, inertias = rng.uniform(0.1, 20.0, len(joints)), rng.uniform(0.01, 9.0, len(joints))
        units = {"s": "gear: m, "} if scene is arm else {}
        drives = {
            name: f"{{motor: m, {units.get(name, '')}mass: {m!r}, coupling_inertia: {I!r}}}"
            for name, m, I in zip(joints, masses.tolist(), inertias.tolist())
        }
        catalogue = "{motors: {m: {type: envelope, peak: [[0, 1], [1, 1]], continuous: [[0, 1], [1, 1]]}}, gears: {m: {type: belt, motor_radius: 1}}}"
        settings = [f"catalogue={catalogue}", *(f"drives.{n}={x}" for n, x in drives.items())]
        changed = load_scene_text(scene.text, str(CONFIGS / "x.yaml"), settings)
        tau = inverse(changed)["tau"]
        found = responses.tau.at(masses, inertias)
        assert np.abs(found - tau).max() < 1e-11 * np.abs(tau).max()


def random_scene(rng: np.random.Generator, joints: int, motors: int, gears: int, samples: int) -> str:
    """Return an arm with mixed axes, full inertias and centres of mass off the axes, in a random motion; its catalogue
    has motors whose price, mass and torque go together loosely."""
    names = [f"j{k}" for k in range(joints)]
    lines = [
        "schema: 1",
        f"gravity: {[float(x) for x in rng.normal(0, 3, 3) - [0, 0, 9]]}",
        "robot:",
        "  joints:",
    ]
    for name in names:
        axis, xyz, rpy = ([float(x) for x in rng.normal(0, s, 3)] for s in (1.0, 0.3, 0.8))
        lines.append(
            f"    - {{name: {name}, type: revolute, axis: {axis}, origin: {{xyz: {xyz}, rpy: {rpy}}}}}"
        )
    lines.append("  links:")
    for name in names:
        A = rng.normal(0, 0.1, (3, 3))
        I = (A @ A.T + np.trace(A @ A.T) * np.eye(3) / 2).tolist()
        com = [float(x) for x in rng.normal(0, 0.15, 3)]
        inertia = ", ".join(
            f"{k}: {I['xyz'.index(k[0])]['xyz'.index(k[1])]!r}" for k in ("xx", "yy", "zz", "xy", "xz", "yz")
        )
        lines.append(
            f"    - {{name: l{name}, mass: {rng.uniform(1, 4)!r}, com: {com}, com_frame: joint, inertia: {{{inertia}}}}}"
        )
    q = ", ".join(
        f'{n}: "{rng.normal()!r}*sin({rng.uniform(1, 3)!r}*t + {rng.uniform(0, 6)!r})"' for n in names
    )
    lines += [
        f"trajectory: {{type: joint, duration: 2, q: {{{q}}}}}",
        f"inverse: {{samples: {samples}}}",
        "catalogue:",
        "  motors:",
    ]
    for k in range(motors):
        peak = 10 ** rng.uniform(-0.7, 1.2)
        price, mass = peak**0.6 * rng.uniform(5, 15), peak**0.8 * rng.uniform(0.4, 2.5)
        lines.append(f"    m{k}: {{type: envelope, cost: {price!r}, mass: {mass!r}, rotor_inertia: {1e-4 * peak!r}, "
                     f"peak: [[0, {peak!r}], [300, {peak / 2!r}]], continuous: [[0, {peak / 2.5!r}], [300, {peak / 5!r}]]}}")  # fmt: skip
    lines.append("  gears:")
    for k in range(gears):
        ratio = 3.0 * 3.0**k * rng.uniform(0.8, 1.2)
        lines.append(
            f"    g{k}: {{type: gear, ratio: {ratio!r}, efficiency: 0.85, mass: {rng.uniform(0.3, 2)!r}, cost: {rng.uniform(2, 12)!r}}}"
        )
    return "\n".join([*lines, ""])


def least_of_all(search: Any, by: str) -> float:
    """Return the smallest sum of prices of all combinations of all joints, in which every drive bears its motion with
    the masses of the others; inf where there is none. Arms: no drive feels those further in."""
    names = list(search.candidates)[::-1]
    prices = {n: (one.costs if by == "cost" else one.masses).ravel() for n, one in search.candidates.items()}

    def least(k: int, masses: dict[str, float]) -> float:
        if k == len(names):
            return 0.0
        margins = search.margins_under(names[k], {**dict.fromkeys(names, 0.0), **masses}).ravel()
        found, below = np.inf, {}
        for place in np.flatnonzero(margins >= 0.0):
            mass = float(search.candidates[names[k]].masses.flat[place])
            if mass not in below:
                below[mass] = least(k + 1, {**masses, names[k]: mass})
            found = min(found, float(prices[names[k]][place]) + below[mass])
        return found

    return least(0, {})


@pytest.mark.parametrize("by", ["cost", "mass"])
def test_nothing_is_cheaper_or_lighter_than_what_is_proven(by: str) -> None:
    """Random arms against all combinations; those in which the cheapest further out is not the cheapest of all too."""
    better, none = 0, 0
    told: list[str] = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        joints = int(rng.integers(2, 4))
        text = random_scene(rng, joints, int(rng.integers(4, 7)), 3, 101)
        scene = load_scene_text(text)
        drives = {f"j{k}": Drive(motor="") for k in range(joints)}
        search = DriveSearch.of(Responses.of(scene, drives), drives, scene.catalogue, by)
        search.run(told.append)
        true = least_of_all(search, by)
        alone = (
            sum(float(search.prices(n)[0][search.chosen[n]]) for n in drives) if search.all_pass else np.inf
        )
        result = size(scene, by=by)
        assert result.summary["size"]["proven"] == np.isfinite(true)
        assert (result.status == "ok") == np.isfinite(true)
        assert result.summary["size"]["margin_difference"] < 1e-9 * max(
            1.0, *(abs(d["margin"]) for d in result.summary["drives"].values())
        )
        if np.isfinite(true):
            assert result.summary["size"][by] == pytest.approx(true, rel=1e-12)
            better += alone > true * (1.0 + 1e-9)
        none += not np.isfinite(true)
    assert "joint 1 of 2, sweep 1 over the joints" in told
    # the lightest further out asks least of those further in
    assert none <= 2 and (better >= 1 or by == "mass"), (better, none)


def test_a_pair_is_the_cheapest_by_inverse_of_all_pairs() -> None:
    """The margins are those of ``inverse`` with both drives in the scene."""
    text = random_scene(np.random.default_rng(5), 2, 2, 2, 61)
    scene = load_scene_text(text)
    found = size(scene).summary
    motors, gears = list(scene.catalogue.motors), [None, *scene.catalogue.gears]
    parts = list(itertools.product(motors, gears))
    costs = []
    for pair in itertools.product(parts, parts):
        drives = ", ".join(
            f"j{k}: {{motor: {m}{'' if g is None else f', gear: {g}'}}}" for k, (m, g) in enumerate(pair)
        )
        figures = inverse(load_scene_text(f"{text}drives: {{{drives}}}\n")).summary["drives"]
        if all(one["passes"] for one in figures.values()):
            costs.append(sum(one["cost"] for one in figures.values()))
    assert costs and found["size"]["cost"] == pytest.approx(min(costs), rel=1e-12) and found["size"]["proven"]


def test_a_mechanism_with_loops() -> None:
    scene = load_scene(
        CONFIGS / "mechanisms" / "five_bar_circle.yaml",
        ["drives={left: {motor: servo0p64_3000, brake: brake2}, right: {motor: servo0p64_3000}}"],
    )
    result = size(scene, by="mass")
    assert result.status == "ok" and result.summary["size"]["margin_difference"] < 1e-9
    assert (
        result.summary["drives"]["left"]["brake"] == "brake2"
        and "brake" in result.summary["drives"]["left"]["limits"]
    )


def test_a_gear_with_losses_in_a_joint_that_nothing_is_sought_for() -> None:
    """Losses follow from what the actuators of a mechanism share, at each of the samples."""
    scene = load_scene(
        CONFIGS / "mechanisms" / "five_bar_circle.yaml",
        ["drives={left: {motor: servo0p64_3000}}", "robot.joints.right.gear={efficiency: 0.7}"],
    )
    found = size(scene, by="mass")
    assert found.status == "ok" and found.summary["size"]["margin_difference"] < 1e-9
    assert "right" not in found.summary["drives"] and found.summary["drives"]["left"]["mass"] > 0.0


def test_payloads_that_come_and_go() -> None:
    """What drives bear changes with what is carried, in the search as in the run that follows it."""
    load = "{name: box, at: tip, mass: 4, com: [0.1, 0, 0], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}, from: {time: 0.7}, until: {time: 1.9}}"
    points = "  points: {tip: {link: B, at: [0.2, 0.1, 0]}}\n"
    text = ARM.replace("trajectory:", f"{points}payloads: [{load}]\ntrajectory:", 1)
    loaded, free = size(load_scene_text(text)).summary, size(load_scene_text(ARM)).summary
    assert loaded["size"]["margin_difference"] < 1e-9
    assert loaded["joints"]["s"]["peak_torque"] > 1.2 * free["joints"]["s"]["peak_torque"]


def test_heavier_motors_further_out_make_the_inner_ones_bear_more() -> None:
    """The shoulder of the lecture's arm is sized with the elbow's drive on its link."""
    carried = size(load_scene(CONFIGS / "2r_circle.yaml"))
    free = size(load_scene(CONFIGS / "2r_circle.yaml", [
        f"drives.{n}={{motor: dc63_300w, mass_on: none}}" for n in ("theta1", "theta2")
    ]))  # fmt: skip
    mass = carried.summary["drives"]["theta2"]["mass"]
    more = carried["drives/load"][:, 0] - free["drives/load"][:, 0]
    q, qdd = carried["q"][:, 0], carried["qdd"][:, 0]
    # a point mass at the end of the first link, 1 m from the shoulder
    assert np.allclose(more, mass * (9.81 * np.cos(q) + qdd), rtol=0, atol=1e-9)


def test_where_nothing_is_strong_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = ARM.replace("mass: 1.0", "mass: 400.0")
    result = size(load_scene_text(text))
    assert result.status == "undersized"
    sized = result.summary["size"]["joints"]["a"]
    assert sized["passing"] == 0 and sized["front"] == []
    assert result.summary["size"]["margin_difference"] < 1e-9 * abs(result.summary["drives"]["a"]["margin"])
    path = tmp_path / "heavy.yaml"
    path.write_text(text, encoding="utf-8")
    assert run(["size", str(path), "--no-plots", "--quiet", "--out", str(tmp_path / "out")]) == 1
    capsys.readouterr()
    assert run(["size", str(path), "--no-plots", "--margin", "0.5", "--out", str(tmp_path / "out")]) == 1
    printed, best = capsys.readouterr().out, sized["best"]
    assert (
        f"joint 'a': none of {sized['combinations']} combinations bears its motion with a margin of 50 %"
        in printed
    )
    factor, limit = (1.0 - best["margin"]) / 0.5, best["decides"].replace("_", " ")
    assert f"takes {factor:.3g} times what its limit {limit!r} allows" in printed
    assert "# not enough" in printed and "smallest cost" not in printed


def test_a_joint_that_needs_nothing_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "still.yaml"
    path.write_text(
        "schema: 1\nrobot:\n  joints: [{name: a, type: revolute, axis: [0, 0, 1]}]\n"
        "  links: [{name: l, mass: 3, com: [0.5, 0, 0], inertia: {zz: 0.1}}]\ngravity: [0, 0, 0]\n"
        "trajectory: {type: joint, duration: 2, q: {a: 0.3}}\n"
    )
    assert run(["size", str(path), "--no-plots", "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("size\n") and "joint 'a' needs nothing" in printed


@pytest.mark.parametrize("a", ["0.3", "0.02*sin(pi*t)^3"])
def test_a_limit_that_decides_is_one_of_the_drive(a: str) -> None:
    """Of equal uses too, where nothing is used: the dearer gear has a limit that the motor alone has not."""
    text = (
        "schema: 1\nrobot:\n  joints: [{name: a, type: revolute, axis: [0, 0, 1]}]\n"
        "  links: [{name: l, mass: 3, com: [0.5, 0, 0], inertia: {zz: 0.1}}]\ngravity: [0, 0, 0]\n"
        f"trajectory: {{type: joint, duration: 2, q: {{a: {a}}}}}\ncatalogue:\n  motors:\n"
        "    m: {type: dc, mass: 1, cost: 1, torque_constant: 0.1, resistance: 1, voltage: 24, max_current: 30, rated_current: 6}\n"
        "  gears: {g: {type: gear, ratio: 5, efficiency: 0.9, mass: 1, cost: 2, peak_torque: 9, max_speed: 900}}\n"
    )
    summary = size(load_scene_text(text)).summary
    drive, sized = summary["drives"]["a"], summary["size"]["joints"]["a"]
    assert sized["front"][0]["gear"] is None and sized["front"][0]["decides"] == drive["decides"]
    for one in (sized["best"], *sized["front"]):
        limits = {"peak", "continuous"} | ({"gear_peak", "gear_speed"} if one["gear"] else set())
        assert one["decides"] in limits and one["margin_error"] is not None


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "arm.yaml"
    path.write_text(ARM, encoding="utf-8")
    assert run(["size", str(path), "--by", "mass", "--margin", "0.2", "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["command"] == "size" and summary["size"]["by"] == "mass"
    assert all(drive["margin"] >= 0.2 == drive["least_margin"] for drive in summary["drives"].values())
    for name, drive in summary["drives"].items():
        assert f"    {name}: {{motor: {drive['motor']}" in printed
    assert {"size_front.png", "drives.png"} <= set(summary["outputs"])
    assert run(["size", str(path), "--by", "price", "--no-plots", "--out", str(tmp_path / "o2")]) == 2
    assert "'--by': 'price'; allowed: cost, mass" in capsys.readouterr().err


def test_kinds_of_motor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = size(load_scene_text(ARM), types=("stepper",))
    assert {drive["motor"] for drive in result.summary["drives"].values()} == {"steps"}
    path = tmp_path / "arm.yaml"
    path.write_text(ARM, encoding="utf-8")
    assert run(["size", str(path), "--types", "dc, servo", "--no-plots", "--out", str(tmp_path / "out")]) == 2
    assert "unknown kind of motor 'servo'; allowed: dc, brushless" in capsys.readouterr().err


def test_what_cannot_be_sized() -> None:
    with pytest.raises(SceneError, match="joint 'a' says by 'gear_ratio' what drives it"):
        size(load_scene_text(ARM.replace("name: a, ", "name: a, gear_ratio: 3, ")))
    with pytest.raises(SceneError, match="joint 'b' says by 'gear' what drives it"):
        size(load_scene_text(ARM.replace("name: b, ", "name: b, gear: {efficiency: 0.5}, ")))
    with pytest.raises(SceneError, match="no motor and gear for joint 's'"):
        size(
            load_scene_text(
                ARM.replace(
                    "    screw: {type: ball_screw, lead: 0.02, efficiency: 0.9, inertia: 2e-4, mass: 0.8, cost: 4}\n",
                    "",
                )
            )
        )
    with pytest.raises(CapabilityError, match="type fastest follow from the torques"):
        size(load_scene(CONFIGS / "trajectories" / "fastest_2r.yaml"))
    with pytest.raises(SceneError, match="no joint is driven"):
        size(load_scene_text(ARM + "actuated: []\n"))
