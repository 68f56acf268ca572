"""Closing the loops where nothing is given, or nothing closes: half-turn traps, the least that is left, rounded data."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli import Mechanism, inverse, linearise, load_scene, load_scene_text, simulate, statics
from robodyn_cli.cli.commands.assemble import describe
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import GeometryError
from robodyn_cli.results.result import Result
from robodyn_cli.solve.closing.descent import Aligned, descend, starts_around
from robodyn_cli.solve.closure import CLOSED, ROUNDED, Numbers, newton
from robodyn_cli.works.assemble import assemble
from robodyn_cli.works.functions.constrained import MANY
from robodyn_cli.works.kinematics import kinematics
from tests.mechanisms import CONFIGS

AXES = ("[1, 0, 0]", "[0, 1, 0]", "[0, 0, 1]")


def chain(axes: str, loop: str, reach: float = 0.5) -> str:
    """Return an arm of revolute joints about the axes x, y, z, each ``reach`` along x from the last, with a loop."""
    joints, links = [], []
    for k, axis in enumerate(axes):
        origin = f", origin: {{xyz: [{reach}, 0, 0]}}" if k else ""
        parent = f"l{k - 1}" if k else "base"
        joints.append(
            f"    - {{name: j{k}, type: revolute, parent: {parent}, link: l{k}, axis: {AXES['xyz'.index(axis)]}{origin}}}"
        )
        links.append(
            f"    - {{name: l{k}, mass: 1, com: [0.1, 0, 0], inertia: {{xx: 0.01, yy: 0.01, zz: 0.01}}}}"
        )
    body = "\n".join(joints) + "\n  links:\n" + "\n".join(links)
    return f"schema: 1\ngravity: [0, 0, -9.81]\nrobot:\n  joints:\n{body}\n  points:\n" + loop


def weld(axes: str, at: str = "[0.3, 0.4, 0.2]", rpy: str = "[0.4, -1.1, 2.5]") -> str:
    last = len(axes) - 1
    return chain(
        axes,
        f"    goal: {{link: base, at: {at}}}\n    hand: {{link: l{last}, at: [0.3, 0, 0]}}\n"
        f"loops: [{{name: grip, type: fixed, between: [goal, hand], rpy: {rpy}}}]\n",
    )


def pinned(kind: str, axes: str = "zyxzyxz") -> str:
    last = len(axes) - 1
    return chain(
        axes,
        f"    goal: {{link: base, at: [0.3, 0.4, 0.2]}}\n    hand: {{link: l{last}, at: [0.3, 0, 0]}}\n"
        f"loops: [{{name: pin, type: {kind}, between: [goal, hand], axis: [0.3, -0.2, 1], axis2: [1, 0.5, 0.2]}}]\n",
    )


def numbers_of(text: str) -> Numbers:
    return Numbers(Problem(load_scene_text(text)), ())


def assembled(text: str, *overrides: str) -> Result:
    return assemble(load_scene_text(text, overrides=overrides))


# -- attitudes -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("text", [weld("zyxzyxz"), pinned("revolute")])
def test_rotation_vectors_have_their_own_jacobian(text: str) -> None:
    """Against central differences, from small angles to almost half a turn."""
    numbers = numbers_of(text)
    aligned, rng = Aligned(numbers), np.random.default_rng(3)
    largest = 0.0
    for q in starts_around(numbers, numbers.manifold.neutral(), list(range(numbers.nv)), np.pi, 4):
        v, h = rng.normal(size=numbers.nv), 1e-6
        F, J = aligned.at(q, 0.0)
        largest = max(largest, float(np.linalg.norm(F[3:])))
        if np.linalg.norm(F[3:]) < 3.1:  # it jumps at half a turn
            ahead, behind = (aligned.at(numbers.step(q, way * h * v), 0.0)[0] for way in (1, -1))
            np.testing.assert_allclose((ahead - behind) / (2 * h), J @ v, atol=1e-6)
    assert largest > 2.5


WELDS = [weld(axes) for axes in ("zyxzyxz", "xyzxyzxy", "zyzyxyz")]
PINS = [pinned(kind) for kind in ("revolute", "planar", "cylindrical")]


@pytest.mark.parametrize("text", [*WELDS, *PINS])
def test_sines_fall_into_half_turns_and_rotation_vectors_do_not(text: str) -> None:
    numbers = numbers_of(text)
    aligned, free = Aligned(numbers), range(numbers.nv)
    turned, closed = 0, 0
    for start in starts_around(numbers, numbers.manifold.neutral(), list(free), np.pi, 8):
        by_sines, residual = newton(numbers, start, free)
        turned += residual <= CLOSED and bool(numbers.turned(by_sines))
        near, _ = descend(aligned, start, free, aligned.sizes)
        q, residual = newton(numbers, near, free)
        closed += residual <= CLOSED and not numbers.turned(q)
    assert turned >= 3 and closed >= 10  # of 24; an arm near its full reach has other least gaps too


@pytest.mark.parametrize("text", [weld("zyxzyxz"), *PINS])
def test_what_holds_an_attitude_closes_from_nothing_as_it_is_meant(text: str) -> None:
    result = assembled(text)
    q = result["q"][0]
    numbers = numbers_of(text)
    F, _ = Aligned(numbers).at(q, 0.0)
    assert np.abs(F).max() < 1e-13 and not numbers.turned(q)
    alike = [row.attitude.cosine for row in numbers.rows if row.attitude is not None]
    np.testing.assert_allclose(Problem(load_scene_text(text)).numbers(alike, q), 1.0, atol=1e-12)
    assert result.summary["nearest"]["closed"] > 5
    assert result.summary["mobility"]["actual"] == 7 - len(numbers.rows)
    assert result.summary["tolerance"] == CLOSED
    assert "nearest to q = 0" in describe(result.summary) and "other branches may exist" in describe(
        result.summary
    )
    assert np.array_equal(q, assembled(text)["q"][0])  # the same each time


def test_simulate_starts_from_the_same_pose() -> None:
    text = weld("zyxzyxz")
    moved = simulate(load_scene_text(text + "simulate: {duration: 0.01, samples: 3}\n"))
    # what is recorded is put back onto the loops, which moves it by rounding
    assert np.abs(moved["q"][0] - assembled(text)["q"][0]).max() < 2e-15


def test_branches_of_a_closed_attitude_are_found_from_most_starts() -> None:
    """Steps on sines, which vanish at half a turn too, closed 1 of 48 starts and found 1 of these 8 ways."""
    text = weld("zyxzyx")
    summary = assembled(text + "assemble: {branches: true}\n").summary
    search, numbers = summary["branch_search"], numbers_of(text)
    assert search["closed"] > 0.8 * search["starts"] and search["found"] == len(summary["branches"]) >= 8
    poses = np.array([list(branch["configuration"].values()) for branch in summary["branches"]])
    for k, q in enumerate(poses):
        assert np.abs(numbers.relative(q)).max() < CLOSED and not numbers.turned(q)
        assert (
            np.abs(np.exp(1j * poses[:k]) - np.exp(1j * q)).max(axis=1, initial=0.0).min(initial=1.0) > 1e-3
        )


# -- the nearest ---------------------------------------------------------------------------------------------
BARS = """schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {{name: crank, type: revolute, parent: base, link: c, axis: [0, 0, 1]}}
    - {{name: coup, type: revolute, parent: c, link: k, axis: [0, 0, 1], origin: {{xyz: [0.1, 0, 0], rpy: {tilt}}}}}
    - {{name: rock, type: revolute, parent: base, link: r, axis: [0, 0, 1], origin: {{xyz: [0.25, 0, {off}]}}}}
  links:
    - {{name: c, mass: 1, com: [0.05, 0, 0], inertia: {{xx: 1e-3, yy: 1e-3, zz: 1e-3}}}}
    - {{name: k, mass: 1, com: [0.15, 0, 0], inertia: {{xx: 8e-3, yy: 8e-3, zz: 8e-3}}}}
    - {{name: r, mass: 1, com: [0.1, 0, 0], inertia: {{xx: 4e-3, yy: 4e-3, zz: 4e-3}}}}
  points: {{kp: {{link: k, at: [0.3, 0, 0]}}, rp: {{link: r, at: [0.2, 0, 0]}}}}
loops: [{{name: pin, type: revolute, between: [kp, rp]}}]
simulate: {{duration: 0.3, samples: 4}}
"""


def test_the_nearest_to_zero_is_taken() -> None:
    """Against all configurations of a four-bar: crank angles on a fine grid, both branches by two circles."""
    result = assembled(BARS.format(tilt="[0, 0, 0]", off="0"))
    theta = np.linspace(-np.pi, np.pi, 400001)
    elbow = 0.1 * np.array([np.cos(theta), np.sin(theta)])
    d = np.array([[0.25], [0.0]]) - elbow
    r = np.hypot(*d)
    along = (r**2 + 0.3**2 - 0.2**2) / (2 * r)
    high = np.sqrt(np.where(along**2 < 0.3**2, 0.3**2 - along**2, np.nan))
    least = np.inf
    for side in (1, -1):
        pin = elbow + along * d / r + side * high * np.array([-d[1], d[0]]) / r
        coup = np.arctan2(*(pin - elbow)[::-1]) - theta
        rock = np.arctan2(pin[1], pin[0] - 0.25)
        coup = (coup + np.pi) % (2 * np.pi) - np.pi
        least = min(least, float(np.nanmin(np.sqrt(theta**2 + coup**2 + rock**2))))
    assert result.summary["nearest"]["distance"] == pytest.approx(least, abs=1e-8)
    assert float(np.linalg.norm(result["q"][0])) == pytest.approx(least, abs=1e-8)


def test_a_given_value_is_a_start() -> None:
    text = BARS.format(tilt="[0, 0, 0]", off="0")
    assert "nearest" not in assembled(text, "initial.q={crank: 0.4}").summary


# -- what does not close -------------------------------------------------------------------------------------
def test_the_least_over_all_rows_is_told() -> None:
    """One joint: the least of |p - goal|^2 + angle^2 is that of a function of one variable."""
    x, y, yaw = 0.5, 0.1, 0.9
    text = weld("z", f"[{x}, {y}, 0.05]", f"[0, 0, {yaw}]")
    theta = np.linspace(-np.pi, np.pi, 2000001)
    squares = (0.3 * np.cos(theta) - x) ** 2 + (0.3 * np.sin(theta) - y) ** 2 + 0.05**2 + (theta - yaw) ** 2
    best = int(np.argmin(squares))
    gap = np.sqrt(squares[best] - (theta[best] - yaw) ** 2)
    with pytest.raises(GeometryError, match=r"'grip' does not close from any of \d+ starts") as caught:
        assembled(text)
    details, message = caught.value.details, caught.value.message
    assert caught.value.exit_code == 5
    assert details["residual"] == pytest.approx(np.sqrt(squares[best]), rel=1e-4)
    assert details["gap"] == pytest.approx(gap, rel=1e-4)
    assert f"{details['residual']:.5g}" in message and "proves nothing" in message
    assert "whatever" not in message


def test_the_loop_with_the_largest_part_is_named() -> None:
    text = chain(
        "zyxzyxz",
        "    near: {link: base, at: [0.2, 0.3, 0.1]}\n    far: {link: base, at: [9, 0, 0]}\n"
        "    hand: {link: l6, at: [0.3, 0, 0]}\n    elbow: {link: l3, at: [0.2, 0, 0]}\n"
        "loops:\n  - {name: low, type: spherical, between: [near, elbow]}\n"
        "  - {name: high, type: spherical, between: [far, hand]}\n",
    )
    with pytest.raises(GeometryError, match="'high' does not close") as caught:
        assembled(text)
    numbers = numbers_of(text)
    eta = numbers.eta(np.array(caught.value.details["q"]))
    assert caught.value.details["residual"] == pytest.approx(float(np.linalg.norm(eta)), rel=1e-9)
    assert caught.value.details["gap"] == pytest.approx(float(np.linalg.norm(eta[3:])), rel=1e-9)
    assert "over all loops" in caught.value.message


# -- rounded data --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("initial", ["initial={}", "initial={q: {crank: 0.5}, hold: [crank]}"])
@pytest.mark.parametrize(
    ("tilt", "off"), [("[3e-8, -2e-8, 0]", "3e-8"), ("[0, 0, 0]", "-3e-8"), ("[0, 3e-8, 0]", "0")]
)
def test_redundant_rows_that_contradict_by_rounding(tilt: str, off: str, initial: str) -> None:
    """A plane mechanism in space whose data are rounded: it moves, and what it lacks is told."""
    result = assembled(BARS.format(tilt=tilt, off=off), initial)
    summary, mobility = result.summary, result.summary["mobility"]
    assert summary["tolerance"] == ROUNDED == mobility["rank_tolerance"]
    assert 5e-9 < summary["residual_by_loop"]["pin"] < 1e-7
    assert (mobility["rank"], mobility["actual"]) == (2, 1)
    assert mobility["smallest_kept"] > 1e-2 and mobility["largest_dropped"] < 1e-6
    exact = assembled(BARS.format(tilt="[0, 0, 0]", off="0"), f"initial.q.crank={result['q'][0, 0]}",
                      f"initial.q.coup={result['q'][0, 1]}", "initial.hold=[crank]")  # fmt: skip
    np.testing.assert_allclose(result["q"][0], exact["q"][0], atol=1e-6)
    assert exact.summary["tolerance"] == CLOSED and exact.summary["residual"]["position"] < 1e-15


def test_a_freedom_is_not_spent_on_rounding() -> None:
    """With a ball the tilt closes an offset exactly, but only where the coupler stands at asin(off / (0.3 tilt))."""
    text = BARS.format(tilt="[2e-7, 0, 0]", off="3e-8").replace(
        "type: revolute, between", "type: spherical, between"
    )
    summary = assembled(text, "initial={q: {crank: 0.5, coup: 0, rock: 1}}").summary
    assert summary["tolerance"] == ROUNDED and summary["mobility"]["actual"] == 1
    assert summary["mobility"]["largest_dropped"] > 1e-8
    exact = assembled(
        BARS.format(tilt="[0, 0, 0]", off="0"), "initial={q: {crank: 0.5, coup: 0, rock: 1}}"
    ).summary
    for joint, angle in exact["configuration"].items():
        assert summary["configuration"][joint] == pytest.approx(angle, abs=1e-6)


def test_what_closes_exactly_stays_exact() -> None:
    """Rows that nearly depend on each other where the mechanism is near a singular pose hide nothing."""
    near = "initial={q: {theta1: 1e-6, phi2: -1e-6, phi1: 1e-6}, hold: [theta1]}"
    result = assemble(load_scene(CONFIGS / "parallelogram.yaml", (near,)))
    assert result.summary["tolerance"] == CLOSED and result.summary["residual"]["position"] < 1e-15


@pytest.mark.parametrize("rubs", [False, True], ids=["smooth", "friction in all pins"])
def test_rounded_data_move_as_exact_ones(rubs: bool) -> None:
    start = "initial={q: {crank: 0.5}, hold: [crank]}"
    ends = []
    for tilt, off in (("[3e-8, -2e-8, 0]", "3e-8"), ("[0, 0, 0]", "0")):
        text = BARS.format(tilt=tilt, off=off)
        if rubs:
            text = text.replace(", axis: [", ", friction: {law: set_valued, coulomb: 0.02}, axis: [")
        scene = load_scene_text(text, overrides=(start,))
        ends.append(simulate(scene)["q"][-1])
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-5)
    assert abs(ends[0][0] - 0.5) > 0.1


def test_rounded_data_have_the_same_nearest_pose_as_exact_ones() -> None:
    """It was a pose far off, where rounding looked like a row of its own; the mirrored pose is as near."""
    rounded, exact = (
        assembled(BARS.format(tilt=tilt, off=off))
        for tilt, off in (("[3e-8, -2e-8, 0]", "3e-8"), ("[0, 0, 0]", "0"))
    )
    assert rounded.summary["tolerance"] == ROUNDED and rounded.summary["mobility"]["actual"] == 1
    np.testing.assert_allclose(np.abs(rounded["q"][0]), np.abs(exact["q"][0]), atol=1e-6)
    assert rounded.summary["nearest"]["distance"] == pytest.approx(
        exact.summary["nearest"]["distance"], abs=1e-6
    )


@pytest.mark.parametrize("kind", ["revolute", "spherical"])
def test_rounded_data_are_led_and_balanced_as_exact_ones(kind: str) -> None:
    """Torques and motion of a led motion, what holds a pose, the balance and the modes are those of data without
    rounding, far nearer than the loops close; how far they stay open is told."""
    moves = "trajectory={type: joint, duration: 1, q: {crank: '0.5 + 1.3*t + 0.2*sin(4*t)'}}"
    holds, at = ("statics={find: hold}", "actuated=[crank]"), "initial={q: {crank: 0.5}, hold: [crank]}"
    answers: list[list[np.ndarray]] = []
    for tilt, off in (("[5e-8, 4e-8, 0]", "-8e-8"), ("[0, 0, 0]", "0")):
        text = BARS.format(tilt=tilt, off=off).replace("type: revolute, between", f"type: {kind}, between")
        led = inverse(load_scene_text(text, overrides=(moves, "inverse.samples=41")))
        held = statics(load_scene_text(text, overrides=(at, *holds)))
        rests = statics(load_scene_text(text, overrides=("initial={q: {crank: 0.5}}",)))
        modes = linearise(load_scene_text(text, overrides=(at, "torques={crank: 0.3}"))).summary["modes"]
        poles = np.array([[mode["real"], mode["imaginary"]] for mode in modes])
        answers.append([led["q"], led["tau"], held["tau"], rests["q"], poles])
        gap = led.summary["constraint_residual"]["position"]
        assert (1e-9 < gap < 1e-6) == ("e-8" in tilt)
        assert any("loops stay open" in text for text in led.summary.get("warnings", ())) == ("e-8" in tilt)
        assert held.summary["equilibrium"]["torques"] == "unique"
    for rounded, exact in zip(*answers):
        np.testing.assert_allclose(rounded, exact, atol=1e-10)
    assert kinematics(load_scene_text(text, overrides=("prescribed.crank=0.5+0.3*t",)))["q"][-1, 0] == (
        pytest.approx(0.59, abs=1e-9)
    )


@pytest.mark.parametrize("seed", range(6))
def test_a_joint_aside_does_not_make_rounding_a_row(seed: int) -> None:
    """Where only a joint that no loop ties has a value, a ball's tiny row is rounding as it is from nothing."""
    rng = np.random.default_rng(seed)
    tilt, off = (rng.uniform(-8e-8, 8e-8, n) for n in (2, 1))
    text = BARS.format(tilt=f"[{tilt[0]:.3g}, {tilt[1]:.3g}, 0]", off=f"{off[0]:.3g}")
    text = text.replace("type: revolute, between", "type: spherical, between")
    aside = "    - {name: aside, type: revolute, parent: base, link: flag, axis: [0, 0, 1]}\n"
    flag = "    - {name: flag, mass: 1, com: [0.1, 0, 0], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}\n"
    text = text.replace("  links:", aside + "  links:").replace("  points:", flag + "  points:")
    summary = assembled(text, "initial={q: {aside: 0.3}}").summary
    assert (summary["mobility"]["rank"], summary["mobility"]["actual"]) == (2, 2)
    assert summary["tolerance"] == ROUNDED and summary["mobility"]["largest_dropped"] < 1e-6


def test_rounded_data_are_accelerated_as_exact_ones() -> None:
    """A row of singular value 3e-8 is no row: with it the mechanism could not move. Few states and many."""
    start = "initial={q: {crank: 0.5}, hold: [crank], qd: {crank: 1}}"
    answers = []
    for tilt, off in (("[3e-8, -2e-8, 0]", "3e-8"), ("[0, 0, 0]", "0")):
        scene = load_scene_text(BARS.format(tilt=tilt, off=off), overrides=(start,))
        run, dynamics = simulate(scene), Mechanism(scene).forward_dynamics
        q, v = (np.tile(run[name], (MANY // 4, 1)) for name in ("q", "qd"))
        tau = np.tile([0.3, -0.2, 0.1], (len(q), 1))
        answers += [dynamics(q[:4], v[:4], tau[:4]), dynamics(q, v, tau)[:4]]
    for answer in answers:
        np.testing.assert_allclose(answer, answers[-1], atol=1e-6)
    assert np.abs(answers[-1]).max() > 10.0


def test_a_whole_pose_closed_but_for_rounding_stays() -> None:
    text = BARS.format(tilt="[3e-8, -2e-8, 0]", off="3e-8")
    q = assembled(text, "initial={q: {crank: 0.5}, hold: [crank]}")["q"][0] + [0.0, 2e-7, -1e-7]
    given = {name: float(x) for name, x in zip(("crank", "coup", "rock"), q)}
    result = assembled(text, f"initial.q={given}")
    np.testing.assert_array_equal(result["q"][0], q)
    assert 2e-8 < result.summary["residual_by_loop"]["pin"] < 2e-7


def test_rounding_does_not_choose_the_pose() -> None:
    """A tilt of 1e-6 looks like a rank of 3 on another branch; what is nearest stays nearest."""
    poses = []
    for tilt in ("[0, 3e-8, 0]", "[0, 1e-6, 0]"):
        text = BARS.format(tilt=tilt, off="3e-8").replace(
            "type: revolute, between", "type: spherical, between"
        )
        poses.append(assembled(text, "initial={}")["q"][0])
    np.testing.assert_allclose(poses[1], poses[0], atol=1e-5)


def test_more_than_rounding_is_refused() -> None:
    with pytest.raises(GeometryError, match="a gap of 3e-05 m remains"):
        assembled(BARS.format(tilt="[0, 0, 0]", off="3e-5"), "initial.q.crank=0.5")


# -- freedoms that nothing drives ----------------------------------------------------------------------------
def test_the_spin_of_a_rod_between_balls() -> None:
    text = """schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: crank, type: revolute, parent: base, link: c, axis: [0, 0, 1]}
    - {name: ball, type: spherical, parent: c, link: rod, origin: {xyz: [0.1, 0, 0]}}
    - {name: slide, type: prismatic, parent: base, link: s, axis: [1, 0, 0]}
  links:
    - {name: c, mass: 1, com: [0.05, 0, 0], inertia: {xx: 1e-3, yy: 1e-3, zz: 1e-3}}
    - {name: rod, mass: 1, com: [0.2, 0, 0], inertia: {xx: 1e-4, yy: 4e-3, zz: 4e-3}}
    - {name: s, mass: 1}
  points: {tip: {link: rod, at: [0.4, 0, 0]}, pin: {link: s, at: [0, 0, 0.05]}}
loops: [{name: ball2, type: spherical, between: [tip, pin]}]
actuated: [crank]
"""
    result = assembled(text)
    assert result.summary["undriven"] == [{"count": 1, "joints": ["ball"]}]
    assert "undriven" not in assembled(text.replace("actuated: [crank]\n", "")).summary


def test_light_links_are_told_by_the_condition_of_the_inertia() -> None:
    """Two slides across each other, the first of which carries both masses."""
    text = """schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: x, type: prismatic, parent: base, link: a, axis: [1, 0, 0]}
    - {name: y, type: prismatic, parent: a, link: b, axis: [0, 1, 0]}
  links: [{name: a, mass: 0.5}, {name: b, mass: 1e-9}]
loops: [{name: table, type: planar, between: [base.origin, b.origin], axis: [0, 0, 1]}]
"""
    summary = assembled(text).summary
    assert summary["mass_condition"] == pytest.approx((0.5 + 1e-9) / 1e-9, rel=1e-12)
    assert "accelerations lose 9 digits" in describe(summary)
    assert "accelerations lose" not in describe(assembled(text.replace("1e-9", "1.0")).summary)
