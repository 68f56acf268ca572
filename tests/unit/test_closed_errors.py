"""Errors of closed states cover what fifty digits tell of four-bars, near dead points too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mpmath as mp
import numpy as np
import pytest
import yaml

from robodyn_cli.errors import GeometryError, NumericalError, SingularConfigurationError
from robodyn_cli.scene import load_scene_text
from robodyn_cli.works.assemble import assemble
from robodyn_cli.works.closed_branches import _within_a_turn
from robodyn_cli.works.linearise.linearise import _off_mode, linearise

JOINTS = ("first", "second", "third")
MASS = {"mass": 1, "com": [0, 0, 0], "com_frame": "joint", "inertia": {"zz": 1}}


def four_bar(lengths: Sequence[float], pivot: float, angles: Sequence[float], rate: float) -> str:
    """Return a crank with a coupler from the origin, and a rocker from (pivot, 0), whose ends meet."""
    joints = [
        {
            "name": name,
            "type": "revolute",
            "link": f"bar{k}",
            "parent": parent,
            "a": length,
            "alpha": 0,
            "d": 0,
        }
        for k, (name, parent, length) in enumerate(zip(JOINTS, ("base", "bar0", "base"), lengths))
    ]
    joints[2]["origin"] = {"xyz": [pivot, 0, 0]}
    scene = {
        "schema": 1,
        "gravity": [0, 0, 0],
        "robot": {
            "convention": "standard",
            "joints": joints,
            "links": [{"name": f"bar{k}", **MASS} for k in range(3)],
        },
        "loops": [{"name": "pin", "type": "revolute", "between": ["bar1.end", "bar2.end"]}],
        "initial": {"q": dict(zip(JOINTS, angles)), "qd": {"first": rate}, "hold": ["first"]},
        "assemble": {"branches": True},
    }
    return yaml.safe_dump(scene)


def exact(lengths: Sequence[float], pivot: float, q: Any, rate: float) -> tuple[Any, Any, Any, Any]:
    """Return q, v and v-dot of least norm of the closed four-bar near q, with a given angle and rate of the crank, and
    the Jacobian of its closure."""
    a, b, c = map(mp.mpf, lengths)
    first = mp.mpf(q[0])

    def ends(second: Any, third: Any) -> list[Any]:
        x = a * mp.cos(first) + b * mp.cos(first + second) - mp.mpf(pivot) - c * mp.cos(third)
        return [x, a * mp.sin(first) + b * mp.sin(first + second) - c * mp.sin(third)]

    second, third = mp.findroot(ends, (mp.mpf(q[1]), mp.mpf(q[2])))
    total = first + second
    one, two, three = ([-r * mp.sin(x), r * mp.cos(x)] for r, x in ((a, first), (b, total), (c, third)))
    J = mp.matrix([[one[i] + two[i], two[i], -three[i]] for i in (0, 1)])
    rest = mp.lu_solve(J[:, 1:], -J[:, 0] * rate)
    v = [mp.mpf(rate), rest[0], rest[1]]
    # e'' of each bar at constant rates: -rate^2 r e
    bars = ((a, first, v[0], 1), (b, total, v[0] + v[1], 1), (c, third, v[2], -1))
    gamma = mp.matrix([sum(-s * r * w**2 * f(x) for r, x, w, s in bars) for f in (mp.cos, mp.sin)])
    return [first, second, third], v, list(J.T * mp.lu_solve(J * J.T, -gamma)), J


def ratio(J: Any) -> Any:
    """Return the smallest over the largest singular value of a matrix of two rows."""
    sizes = mp.svd(J, compute_uv=False)
    return sizes[1] / sizes[0]


@pytest.mark.parametrize("seed", range(40))
def test_errors_cover_what_many_digits_tell(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lengths, pivot, rate = rng.uniform(0.4, 1.6, 3).tolist(), float(rng.uniform(0.3, 1.5)), 1.3
    angles = rng.uniform(-3.0, 3.0, 3)
    a, b, c = lengths
    if seed % 3 == 0:  # near a dead point: coupler and rocker almost in line
        reach = (b + c) * (1.0 - 10.0 ** -rng.uniform(2.0, 9.0))
        cosine = (a**2 + pivot**2 - reach**2) / (2.0 * a * pivot)
        angles[0] = np.arccos(np.clip(cosine, -1.0, 1.0))
    try:
        summary = assemble(load_scene_text(four_bar(lengths, pivot, angles.tolist(), rate))).summary
    except (GeometryError, SingularConfigurationError):
        pytest.skip("bars that do not reach, or in line")
    with mp.workdps(50):
        q, v, a_, J = exact(lengths, pivot, list(summary["configuration"].values()), rate)
        for key, true in (("configuration", q), ("rates", v), ("accelerations", a_)):
            stated = summary["error_estimate"][key]
            for name, value in zip(JOINTS, true):
                off = abs(float(mp.mpf(summary[key][name]) - value))
                assert off <= stated[name], (key, name, off, stated[name])
        rank = summary["mobility"]
        assert abs(float(mp.mpf(rank["smallest_kept"]) - ratio(J))) <= rank["smallest_kept_error"]
        for branch in summary["branches"]:
            q, _, _, J = exact(lengths, pivot, list(branch["configuration"].values()), rate)
            for key, true in (("singular_ratio", ratio(J[:, 1:])), ("determinant", mp.det(J[:, 1:]))):
                off = abs(float(mp.mpf(abs(branch[key])) - abs(true)))
                assert off <= branch[f"{key}_error"] < 1e-6, key
            for name, value in zip(JOINTS, q):
                assert abs(float(mp.mpf(branch["configuration"][name]) - value)) <= branch["errors"][name]
        assert max(summary["error_estimate"]["configuration"].values()) < 1e-7
        assert 0.0 < rank["smallest_kept_error"] < 1e-6


@pytest.mark.parametrize("seed", range(12))
def test_the_condition_number_of_the_inertia(seed: int) -> None:
    """A wheel beside a four-bar, near dead points too, where its crank is far from what turns."""
    rng = np.random.default_rng(seed)
    lengths, pivot, wheel = (
        rng.uniform(0.4, 1.6, 3).tolist(),
        float(rng.uniform(0.3, 1.5)),
        10.0 ** rng.uniform(-2, 3),
    )
    scene = yaml.safe_load(four_bar(lengths, pivot, rng.uniform(-3.0, 3.0, 3).tolist(), 0.0))
    robot, rest = scene["robot"], {"a": 0, "alpha": 0, "d": 0}
    robot["joints"].append({"name": "turn", "type": "revolute", "parent": "base", "link": "wheel", **rest})
    robot["links"].append({"name": "wheel", **MASS, "inertia": {"zz": float(wheel)}})
    scene["initial"]["q"]["turn"], scene["assemble"] = 0, {}
    try:
        summary = assemble(load_scene_text(yaml.safe_dump(scene))).summary
    except (GeometryError, SingularConfigurationError):
        pytest.skip("bars that do not reach, or in line")
    with mp.workdps(50):
        *_, J = exact(lengths, pivot, list(summary["configuration"].values())[:3], 0.0)
        n = mp.matrix([J[0, 1] * J[1, 2] - J[0, 2] * J[1, 1], J[0, 2] * J[1, 0] - J[0, 0] * J[1, 2],
                       J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]])  # fmt: skip
        M = mp.matrix([[2 + mp.mpf(lengths[0]) ** 2, 1, 0], [1, 1, 0], [0, 0, 1]])
        bars, turning = (n.T * M * n)[0] / (n.T * n)[0], mp.mpf(float(wheel))
        true = max(bars, turning) / min(bars, turning)
        off = abs(float(mp.mpf(summary["mass_condition"]) - true))
    assert off <= summary["mass_condition_error"] < 1e-6 * summary["mass_condition"], off


@pytest.mark.parametrize("seed", [1, 0, *range(2, 30)])
def test_the_state_of_a_linear_model_and_its_accelerations(seed: int) -> None:
    """The inertia is the same in all configurations, so accelerations follow from the rates by the loop alone."""
    rng = np.random.default_rng(seed)
    lengths, pivot, rate = rng.uniform(0.4, 1.6, 3).tolist(), float(rng.uniform(0.3, 1.5)), 1.3
    angles = rng.uniform(-3.0, 3.0, 3)
    a, b, c = lengths
    if seed % 3 == 0:
        reach = (b + c) * (1.0 - 10.0 ** -rng.uniform(2.0, 6.0))
        angles[0] = np.arccos(np.clip((a**2 + pivot**2 - reach**2) / (2.0 * a * pivot), -1.0, 1.0))
    try:
        found = linearise(load_scene_text(four_bar(lengths, pivot, angles.tolist(), rate)))
    except (GeometryError, SingularConfigurationError, NumericalError):
        pytest.skip("bars that do not reach, or in line")
    summary, off = found.summary, found.summary["error_estimate"]
    with mp.workdps(50):
        q, v, free, J = exact(lengths, pivot, list(summary["configuration"].values()), rate)
        M = mp.matrix([[2 + mp.mpf(a) ** 2, 1, 0], [1, 1, 0], [0, 0, 1]])
        # M a = J^T lambda with J a = J free
        way = mp.inverse(M) * J.T
        accelerations = way * mp.lu_solve(J * way, J * mp.matrix(free))
        for key, true, given in (
            ("configuration", q, list(summary["configuration"].values())),
            ("rates", v, list(summary["rates"].values())),
            ("accelerations", accelerations, list(summary["accelerations"].values())),
        ):
            for name, value, own in zip(JOINTS, true, given):
                assert abs(float(mp.mpf(float(own)) - value)) <= off[key][name], (key, name)
        largest = max(off["accelerations"].values())
        assert summary["largest_acceleration_error"] <= largest
        assert largest < (1e-9 if seed % 3 else 1e-4) * float(max(map(abs, accelerations)))


@pytest.mark.parametrize("real", [-2.0, -1e-3, 0.7])
@pytest.mark.parametrize("imaginary", [0.0, 3.0])
def test_figures_of_modes_are_off_by_what_their_pole_is(real: float, imaginary: float) -> None:
    s, off = complex(real, imaginary), 4e-4
    frequency, damping, time = _off_mode(s, off)
    for turn in np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 25)):
        other = s + off * turn
        assert abs(abs(other) - abs(s)) / (2.0 * np.pi) <= frequency * (1.0 + 1e-9)
        assert abs(other.real / abs(other) - s.real / abs(s)) <= damping
        assert abs(1.0 / abs(other.real) - 1.0 / abs(s.real)) <= time * (1.0 + 1e-9)
    assert _off_mode(complex(1e-5, 1.0), off)[2] is None


def test_open_chains_have_accelerations_that_are_off_by_rounding() -> None:
    text = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{name: a, type: revolute, axis: [0, 0, 1]}]
  links: [{name: l, mass: 1.3, com: [0.37, 0, 0], com_frame: joint, inertia: {zz: 0.21}}]
initial: {q: {a: ANGLE}}
"""
    ratios = []
    for angle in np.random.default_rng(1).uniform(-1.0, 1.0, 12).tolist():
        summary = linearise(load_scene_text(text.replace("ANGLE", repr(angle)))).summary
        with mp.workdps(50):
            m, c, inertia, g = map(mp.mpf, (1.3, 0.37, 0.21, 9.81))
            true = -m * g * c * mp.cos(mp.mpf(angle)) / (inertia + m * c**2)
            off = abs(float(mp.mpf(summary["accelerations"]["a"]) - true))
        ratios.append(off / summary["error_estimate"]["accelerations"]["a"])
        assert summary["largest_acceleration_error"] == summary["error_estimate"]["accelerations"]["a"]
    assert 1e-3 < max(ratios) <= 1.0


def test_a_crank_that_is_led_has_rates_with_errors() -> None:
    """As the test above has them of a crank with a given rate."""
    ratios = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        lengths, pivot, rate = rng.uniform(0.4, 1.6, 3).tolist(), float(rng.uniform(0.3, 1.5)), 1.3
        angles = rng.uniform(-3.0, 3.0, 3).tolist()
        scene = yaml.safe_load(four_bar(lengths, pivot, angles, rate))
        scene["prescribed"] = {"first": f"{angles[0]!r} + {rate!r}*t"}
        scene["initial"] = {"q": dict(zip(JOINTS[1:], angles[1:]))}
        scene["assemble"] = {}
        try:
            summary = assemble(load_scene_text(yaml.safe_dump(scene))).summary
        except (GeometryError, SingularConfigurationError):
            continue
        with mp.workdps(50):
            q, v, _, _ = exact(lengths, pivot, list(summary["configuration"].values()), rate)
            for key, true in (("configuration", q), ("rates", v)):
                for name, value in zip(JOINTS, true):
                    off, stated = (
                        abs(float(mp.mpf(summary[key][name]) - value)),
                        summary["error_estimate"][key][name],
                    )
                    assert off <= stated < 1e-9, (key, name, off, stated)
                    ratios += [off / stated] if stated else []
    assert len(ratios) > 20 and max(ratios) > 1e-2


def test_angles_of_branches_are_within_half_a_turn() -> None:
    turned = _within_a_turn(np.array([-4.0, 4.0, 1.0, -4.0]), [True, True, True, False])
    assert turned == pytest.approx([2 * np.pi - 4.0, 4.0 - 2 * np.pi, 1.0, -4.0], abs=1e-15)
