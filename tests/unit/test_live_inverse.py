"""Inverse dynamics and kinematics that run in a page, under node: their figures beside those of the program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import trapezoid

from robodyn_cli.errors import RobodynError
from robodyn_cli.over.live.figures import figures_rule, rounding_rule
from robodyn_cli.over.live.given import LiveInverse
from robodyn_cli.over.live.moving import LiveKinematics
from robodyn_cli.over.live.rules import plain
from robodyn_cli.over.many.keys import settings, value_of
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.scene.load import Family
from robodyn_cli.solve.load_sharing import Hold, borne, borne_least
from robodyn_cli.torques.checks import FIGURES, Loaded, torque_rounding
from robodyn_cli.works.kinematics import kinematics
from tests.live import Ranges, in_node, random_rows, run_live
from tests.mechanisms import CONFIGS
from tests.node import needs_node

RNG = np.random.default_rng(5)
JUDGE = """
return data.map(({ rule, tau, qd }) => {
  const found = judged(rule, { tau: Float64Array.from(tau, Number), qd: Float64Array.from(qd, Number) });
  return Object.fromEntries(Object.entries(found).map(([name, x]) => [name, Array.from(x, String)]));
});
"""


def waves(times: np.ndarray, columns: int) -> np.ndarray:
    """Return smooth functions of time (T, n)."""
    size, speed, begin = RNG.normal(size=(3, 4, columns))
    return np.asarray((size * np.sin(2.0 * speed * times[:, None, None] + begin)).sum(axis=1))


def with_gaps() -> np.ndarray:
    """Return times in stretches of their own steps, with two samples that lie close to each other between them."""
    return np.concatenate([np.linspace(0.0, 1.0 - 1e-7, 41), np.linspace(1.0 + 1e-7, 3.0, 41)])


TIMES = {
    "uniform": (np.linspace(0.0, 3.0, 101), ()),
    "breaks": (np.linspace(0.0, 3.0, 101), (30.4, 61.7)),
    "a break at a sample": (np.linspace(0.0, 3.0, 61), (30.0 * (1 - 1e-15), 30.0 * (1 + 1e-15))),
    "stretches": (with_gaps(), ()),
    "few samples": (np.linspace(0.0, 1.0, 5), ()),
}


@needs_node
def test_figures_of_a_page_are_those_of_python(tmp_path: Path) -> None:
    """Recorded along other functions than those that they are worked out of."""
    cases, known = [], []
    for times, breaks in TIMES.values():
        tau, qd = waves(times, 3), waves(times, 3)
        rule, _ = figures_rule(times, waves(times, 3), waves(times, 3), breaks)
        cases.append({"rule": rule, "tau": plain(tau.ravel()), "qd": plain(qd.ravel())})
        known.append({name: figure(Loaded(times, tau, qd, breaks)) for name, figure in FIGURES.items()})
    for name, got, expected in zip(TIMES, in_node(cases, JUDGE, tmp_path), known):
        for figure, (value, error) in expected.items():
            for key, own in ((figure, value), (f"{figure}.error", error)):
                found = np.array(got[key], dtype=float)
                np.testing.assert_allclose(found, own, rtol=1e-9, atol=1e-12, err_msg=f"{name}: {key}")


@needs_node
def test_jumps_that_nobody_stated_are_within_the_errors(tmp_path: Path) -> None:
    """Neither their place nor their size is known; columns without one keep their errors."""
    times, fine = np.linspace(0.0, 3.0, 101), np.linspace(0.0, 3.0, 30_001)
    size, at = RNG.normal(size=20), RNG.uniform(0.1, 2.9, 20)
    grow, begin = RNG.uniform(0.5, 3.0, 20), RNG.uniform(0.0, 6.0, 20)

    def function(t: np.ndarray) -> np.ndarray:
        beyond = t[:, None] > at
        jump = np.where(np.arange(20) < 10, beyond * size, beyond * (t[:, None] - at) * size)
        return np.asarray(np.sin(grow * t[:, None] + begin) + jump)

    tau, still = function(times), np.ones((101, 20))
    rule, _ = figures_rule(times, waves(times, 20), still, ())
    (found,) = in_node(
        [{"rule": rule, "tau": plain(tau.ravel()), "qd": plain(still.ravel())}], JUDGE, tmp_path
    )
    most = function(fine).max(axis=0)
    own, error = (np.array(found[key], dtype=float) for key in ("torque_range.1", "torque_range.1.error"))
    assert (np.abs(own - most) <= error + 1e-3 * np.abs(size) + 1e-6).all()
    net, off = (np.array(found[key], dtype=float) for key in ("energy_net", "energy_net.error"))
    assert (np.abs(net - trapezoid(function(fine), fine, axis=0)) <= off + 1e-4).all()


@pytest.mark.parametrize(("nv", "m", "n"), [(4, 3, 1), (5, 3, 2), (5, 4, 3), (4, 0, 4)])
def test_loads_are_borne_as_they_are_shared(nv: int, m: int, n: int) -> None:
    """By one solution where rows and actuators are just enough, and by that of least norm in any case."""
    psi, load = RNG.normal(size=(6, m, nv)), RNG.normal(size=(6, nv))
    if m == 4:
        psi[:, 3] = psi[:, 0] - psi[:, 1]  # a redundant row, and one actuator more than freedoms
    actuated = list(RNG.permutation(nv)[:n])
    each = [
        Hold.of(rows[None], actuated).share({"load": own[None]}).tau[0, actuated]
        for rows, own in zip(psi, load)
    ]
    known = np.array(each)
    np.testing.assert_allclose(borne_least(psi, actuated, load), known, atol=1e-10)
    if m + n == nv and m < 4:
        np.testing.assert_allclose(borne(psi, actuated, load), known, atol=1e-10)


# -- runs -----------------------------------------------------------------------------------------------
CASES: dict[str, tuple[str, Sequence[str], Ranges]] = {
    "a point on a circle": ("2r_circle.yaml", (), {"robot.links.link1.mass": (5.0, 20.0), "robot.links.link2.inertia.zz": (0.2, 5.0)}),
    "gravity and friction": ("2r_circle.yaml", ("robot.joints.theta1.friction.coulomb=3", "gravity=[0.1, -9.81, 0]"),
                             {"gravity.1": (-12.0, -4.0), "robot.joints.theta1.friction.coulomb": (1.0, 9.0)}),
    "a robot in space": ("benchmarks/puma560.yaml", (), {"robot.links.link3.mass": (1.0, 10.0), "robot.links.link2.mass": (5.0, 30.0)}),
    "a spring": ("search/spring_balance.yaml", (), {"forces.spring.stiffness": (20.0, 90.0), "robot.links.beam.mass": (1.0, 6.0)}),
    "a loop": ("mechanisms/flywheel.yaml", (), {"robot.links.piston.mass": (0.5, 3.0), "robot.links.bar.mass": (0.4, 3.0)}),
    "a loop with two actuators": ("mechanisms/five_bar_circle.yaml", (), {"robot.links.crank_left.mass": (1.0, 5.0),
                                  "robot.links.arm_right.mass": (0.5, 3.0), "robot.links.arm_left.inertia.zz": (0.02, 0.1)}),
    "lengths of a loop": ("mechanisms/flywheel.yaml", (), {"robot.joints.rod.origin.xyz.0": (0.06, 0.2), "robot.links.piston.mass": (0.5, 3.0)}),
    "lengths under a led point": ("mechanisms/five_bar_circle.yaml", (), {"robot.joints.left.a": (0.45, 0.6), "robot.joints.bend_right.a": (0.7, 0.9)}),
    "waypoints": ("2r_circle.yaml", ("trajectory={type: quintic, points: [{t: 0, q: {theta1: 0, theta2: 0}}, {t: 0.7, q: {theta1: 1, theta2: -1}},"
                  " {t: 2, q: {theta1: 0.3, theta2: 0.5}}]}",), {"robot.links.link1.mass": (5.0, 20.0)}),
    "more actuators than freedoms": ("mechanisms/flywheel.yaml", ("actuated=[crank, rod]",), {"robot.links.piston.mass": (0.5, 3.0)}),
}  # fmt: skip


FAR = {"lengths under a led point": 2}  # settings that may be too far from the scene's guess


def beyond(family: Family, live: LiveInverse, rows: np.ndarray, folder: Path) -> tuple[list[str], int]:
    """Return which figures of pages and of the program differ by more than both errors, and how many pages refuse."""
    figures = live.data()["figures"]
    keys = [f"joints.{f['name'].rpartition(' of ')[2]}.{f['of']}" for f in figures]
    runs = Mechanism(family, [key.key.name for key in live.keys]).inverse_many(rows, of=keys)
    wrong, refused = [], 0
    for row, page in enumerate(run_live(live, rows, folder)):
        if "refused" in page:
            refused += 1
            continue
        if runs.code[row]:
            wrong.append(f"{rows[row]}: the page answers, the program refuses: {runs.reason[row]}")
        for key, own in zip(keys, page["figures"]):
            value, error = runs.outputs[key][row], runs.errors[key][row]
            if not abs(own["value"] - value) <= own["error"] + error + 1e-12 * abs(value):
                wrong.append(f"{rows[row]}: {key} {own} and {value} +- {error}")
    return wrong, refused


@needs_node
@pytest.mark.parametrize("name", CASES)
def test_a_page_gives_what_the_program_gives(name: str, tmp_path: Path) -> None:
    scene, overrides, ranges = CASES[name]
    family = Family(CONFIGS / scene, list(overrides))
    live = LiveInverse(family, ranges)
    wrong, refused = beyond(family, live, np.vstack([live.row, random_rows(ranges, 9, 3)]), tmp_path)
    assert not wrong and refused <= FAR.get(name, 0), "\n".join(wrong)


@needs_node
@pytest.mark.parametrize(
    "name", ["a robot in space", "a loop with two actuators", "more actuators than freedoms"]
)
def test_rounding_is_as_large_as_the_program_says(name: str, tmp_path: Path) -> None:
    """Both are the largest of a few draws."""
    scene, overrides, ranges = CASES[name]
    live = LiveInverse(Family(CONFIGS / scene, list(overrides)), ranges)
    (page,) = run_live(live, live.row[None], tmp_path)
    known = torque_rounding(live.program, live.sampled)
    assert known is not None and 0.3 < page["rounding"] / known < 3.0


def test_rounding_is_recorded_as_python_has_it() -> None:
    load, psi = RNG.normal(size=(5, 3, 4)), RNG.normal(size=(5, 3, 3, 4))
    _, example = rounding_rule(load, psi, Hold.of(psi[0, :1], [2]))
    parts = zip(psi.reshape(-1, 1, 3, 4), load.reshape(-1, 1, 4))
    tau = np.array([Hold.of(rows, [2]).share({"load": own}).tau[0, 2] for rows, own in parts]).reshape(5, 3)
    np.testing.assert_allclose(example["rounding"], np.abs(tau[1:] - tau[0]).max() / 2.0**13, rtol=1e-9)


@needs_node
def test_settings_that_a_page_cannot_vouch_for_are_refused(tmp_path: Path) -> None:
    """The mass matrix is positive with a body's own inertia a little below zero, not with any; others are structure."""
    family = Family(CONFIGS / "2r_circle.yaml", ["robot.links.link1.inertia.zz=-0.5"])
    live = LiveInverse(family, {"robot.links.link1.inertia.zz": (-30.0, -0.1)})
    pages = run_live(live, np.array([[-0.5], [-25.0], [0.2]]), tmp_path)
    assert [page.get("reason") for page in pages] == [None, "definite", "range"]
    live = LiveInverse(Family(CONFIGS / "2r_circle.yaml"), {"robot.links.link1.inertia.zz": (-30.0, 5.0)})
    pages = run_live(live, np.array([[0.5], [-25.0], [0.0]]), tmp_path)
    assert [page.get("reason") for page in pages] == [None, "structure", "special"]


REFUSED: dict[str, tuple[str, Sequence[str], str, str]] = {
    "drives": ("2r_drives.yaml", (), "robot.links.link1.mass", "limits of drives, or margins of motorisation"),
    "lengths that change the motion": ("2r_circle.yaml", (), "robot.joints.theta1.a", "a point of an open chain is led, so lengths"),
    "lengths where more actuators act than it takes": ("mechanisms/flywheel.yaml", ("actuated=[crank, rod]",), "robot.joints.rod.origin.xyz.0",
                                                       "than it takes share the load"),
    "lengths that move when friction turns": ("mechanisms/flywheel.yaml", ("robot.joints.rod.friction={coulomb: 0.1}",), "robot.joints.rod.origin.xyz.0",
                                              "rod, which lose energy, turn back"),
    "what is asked of the motion": ("2r_circle.yaml", (), "trajectory.radius", "--live trajectory.radius: it decides which equations there are"),
    "the least time": ("trajectories/fastest_2r.yaml", (), "robot.links.link1.mass", "limits of torques or paths decide the motion"),
    "parameters of the motion": ("2r_circle.yaml", ("parameters={speed: 1}", "trajectory={type: joint, duration: 2, q: {theta1: speed*t, theta2: 1}}",
                                 "torques.theta1=0.5*speed"), "parameters.speed", "parameters may change the motion"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_leave_is_refused_by_name(name: str) -> None:
    scene, overrides, key, words = REFUSED[name]
    family = Family(CONFIGS / scene, list(overrides))
    value = value_of(family, key) or 0.0
    with pytest.raises(RobodynError, match=words):
        LiveInverse(family, {key: (value - 0.01, value + 0.01)}).data()


# -- kinematics -----------------------------------------------------------------------------------------
MOVING: dict[str, tuple[str, Sequence[str], Ranges, bool]] = {
    # scene, settings, ranges, whether some settings have no motion
    "crank-rocker": ("mechanisms/four_bar_kinematics.yaml", (), {"robot.joints.crank.a": (0.2, 0.9), "robot.joints.coupler.a": (0.8, 1.6)}, True),
    "poles and dead points": ("mechanisms/kinematic_design.yaml", (), {"robot.joints.rocker.origin.xyz.0": (0.9, 1.1)}, False),
    "a point that is led": ("mechanisms/five_bar_circle.yaml", ("command=kinematics", "expect={}"),
                            {"robot.joints.left.a": (0.45, 0.6), "robot.joints.bend_right.a": (0.7, 0.9)}, False),
    "an open chain": ("arm_in_plane.yaml", ("command=kinematics", "expect={}"), {"robot.joints.theta2.a": (0.5, 1.2)}, False),
}  # fmt: skip


def told(summary: Mapping[str, Any], live: LiveKinematics, of: str, entry: int) -> tuple[float | None, float]:
    """Return a figure of a summary, and its error."""
    section, _, figure = of.partition(".")
    if section == "joints":
        own = summary["joints"][live.problem.model.v_names[entry]]
    elif section == "points":
        own = summary["points"][live.points[entry]]
    else:
        own = summary["singular_ratio" if section == "ratio" else "transmission_angle"]
    error = own["errors"][figure] if "errors" in own else own[f"{figure}_error"]
    return own[figure], error or 0.0


@needs_node
@pytest.mark.parametrize("name", MOVING)
def test_motions_of_a_page_are_those_of_the_command(name: str, tmp_path: Path) -> None:
    """And never one where the command has none."""
    scene, overrides, ranges, some = MOVING[name]
    family = Family(CONFIGS / scene, list(overrides))
    live = LiveKinematics(family, ranges)
    rows, figures = np.vstack([live.row, random_rows(ranges, 9, 4)]), live.data()["figures"]
    wrong, refused = [], 0
    for row, page in zip(rows, run_live(live, rows, tmp_path)):
        try:
            summary = kinematics(family.scene(settings(list(ranges), row))).summary
        except RobodynError:
            summary = None
        refused += "refused" in page
        assert (summary is None) == ("refused" in page), f"{row}: {page.get('refused', 'the page answers')}"
        if summary is None:
            continue
        for figure, own in zip(figures, page.get("figures", [])):
            value, error = told(summary, live, figure["of"], figure["entry"])
            if value is not None and not abs(own["value"] - value) <= own["error"] + error + 1e-12 * abs(
                value
            ):
                wrong.append(f"{row}: {figure['name']} {own} and {value} +- {error}")
    assert not wrong, "\n".join(wrong)
    assert bool(refused) == some
