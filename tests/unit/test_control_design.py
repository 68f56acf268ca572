"""What a controller is comes out: gains, Riccati matrices, poles, costs; against scipy, quadrature and the regression of
the torques that a run shows."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are

from robodyn_cli import inverse, linearise, simulate
from robodyn_cli.control.riccati import Cost, cost_of_period, disturbed, held, optimum, refuse_unsure
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.scene import load_scene_text

SEEDS = [3, 14, 159]


def scene_of(seed: int, control: str, more: str = ""):
    """Return a random arm of three axes in space, held about a pose by two motors at least."""
    random = np.random.default_rng(seed)
    joints, links = [], []
    for k, name in enumerate("abc"):
        axis = (random.normal(size=3)).tolist()
        kind = "prismatic" if k == 1 and seed % 2 else "revolute"
        origin = random.uniform(-0.4, 0.4, 3).tolist()
        joints.append(
            f"    - {{name: {name}, type: {kind}, axis: {axis}, origin: {{xyz: {origin}}}, "
            f"damper: {{damping: {random.uniform(0.1, 2.0)}}}, spring: {{stiffness: {random.uniform(1, 30)}}}}}"
        )
        xx, yy, zz = random.uniform(0.05, 0.1, 3)
        com = random.uniform(-0.2, 0.2, 3).tolist()
        links.append(
            f"    - {{name: L{name}, mass: {random.uniform(0.5, 3)}, com: {com}, "
            f"inertia: {{xx: {xx}, yy: {yy}, zz: {zz}, xy: 0.01, xz: -0.005, yz: 0.004}}}}"
        )
    pose = random.uniform(-0.5, 0.5, 3).tolist()
    q = f"{{a: {pose[0]}, b: {pose[1]}, c: {pose[2]}}}"
    text = "\n".join(
        [
            "schema: 1",
            "gravity: [0.3, -0.4, -9.7]",
            "robot:",
            "  joints:",
            *joints,
            "  links:",
            *links,
            f"initial: {{q: {q}}}",
            f"control: {control}",
            "simulate: {duration: 0.05, samples: 6}",
            more,
        ]
    )
    return load_scene_text(text)


def matrix(keys: dict) -> np.ndarray:
    return np.array([list(row.values()) for row in keys.values()])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("period", [None, 0.02])
def test_the_regulator_of_a_random_arm_is_that_of_scipy(seed: int, period: float | None) -> None:
    q, qd, tau = np.array([3.0, 50.0, 7.0]), np.array([0.1, 2.0, 0.3]), np.array([0.5, 0.02, 1.0])
    weights = ", ".join(
        f"{key}: {{{', '.join(f'{n}: {x}' for n, x in zip('abc', values))}}}"
        for key, values in (("q", q), ("qd", qd), ("tau", tau))
    )
    sampled = "" if period is None else f"period: {period}, "
    scene = scene_of(seed, f"{{type: lqr, {sampled}gains: {{{weights}}}}}")
    result = simulate(scene)
    own = result.summary["control"]
    plant = linearise(scene, about="hold")
    A, B, Q, R = plant["linear/A"], plant["linear/B"], np.diag([*q, *qd]), np.diag(tau)
    if period is None:
        P = solve_continuous_are(A, B, Q, R)
        K = np.linalg.solve(R, B.T @ P)
        poles = np.linalg.eigvals(A - B @ K)
    else:
        whole = expm(period * np.block([[A, B], [np.zeros((3, 9))]]))
        F, G = whole[:6, :6], whole[:6, 6:]
        P = solve_discrete_are(F, G, Q, R)
        K = np.linalg.solve(R + G.T @ P @ G, G.T @ P @ F)
        poles = np.linalg.eigvals(F - G @ K)
    assert list(own["gains"]) == list("abc") and list(own["riccati"]) == [*"abc", "qd.a", "qd.b", "qd.c"]
    for found, wanted, errors in (
        (matrix(own["gains"]), K, matrix(own["gain_errors"])),
        (matrix(own["riccati"]), P, matrix(own["riccati_errors"])),
    ):
        assert np.all(np.abs(found - wanted) <= 1e-9 * np.abs(wanted).max())
        assert np.all(np.abs(found - wanted) <= 2.0 * errors) and errors.max() < 1e-8 * np.abs(wanted).max()
    np.testing.assert_array_equal(result["control/gains"], matrix(own["gains"]))
    np.testing.assert_array_equal(result["control/riccati"], matrix(own["riccati"]))
    for pole in own["poles"]:
        gap = np.abs(poles - complex(pole["real"], pole["imaginary"])).min()
        assert gap <= 2.0 * pole["error"] + 1e-12 and pole["error"] < 1e-8
    assert own["equilibrium"]["q"] == scene.initial.q
    if period is None:  # the law of the run is this one
        x = (
            np.concatenate([result["q"], result["qd"]], axis=1)
            - np.r_[list(scene.initial.q.values()), 0, 0, 0]
        )
        holding = np.array(list(own["equilibrium"]["torques"].values()))
        np.testing.assert_allclose(result["control/torque"], holding - x @ matrix(own["gains"]).T, atol=1e-11)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_cost_of_a_period_is_the_integral_and_p_is_the_cost_of_a_sampled_motion(seed: int) -> None:
    random = np.random.default_rng(seed)
    A, B, period = random.normal(size=(4, 4)), random.normal(size=(4, 2)), 0.3
    cost = Cost(np.diag(random.uniform(0.1, 2.0, 4)), np.diag(random.uniform(0.1, 2.0, 2)), np.zeros((4, 2)))
    own = cost_of_period(A, B, cost, period)
    F, G = held(A, B, period)
    nodes, weights = np.polynomial.legendre.leggauss(30)

    def spent(x: np.ndarray, u: np.ndarray) -> float:
        total = 0.0
        for node, weight in zip(nodes, weights):
            f, g = held(A, B, 0.5 * period * (node + 1.0))
            y = f @ x + g @ u
            total += 0.5 * period * weight * float(y @ cost.Q @ y + u @ cost.R @ u)
        return total

    x, u = random.normal(size=4), random.normal(size=2)
    np.testing.assert_allclose(x @ own.Q @ x + 2 * x @ own.N @ u + u @ own.R @ u, spent(x, u), rtol=1e-12)
    best = optimum(A, B, own, period)
    first, total = x, 0.0
    for _ in range(200):
        total += spent(x, -best.K @ x)
        x = F @ x - G @ best.K @ x
    np.testing.assert_allclose(first @ best.P @ first, total, rtol=1e-9)
    np.testing.assert_allclose(best.L, F - G @ best.K)


W = 3.0
OSCILLATOR = np.array([[0.0, 1.0], [-(W**2), 0.0]]), np.array([[0.0], [1.0]])
INVERTED = np.array([[0.0, 1.0], [W**2, 0.0]]), np.array([[0.0], [1.0]])


@pytest.mark.parametrize(
    "system, period, integral, why",
    [
        # half a turn and a whole one: the samples of the mode are those of a constant
        (OSCILLATOR, math.pi / W, False, "0.5 turns on, is not reached by torques that are held"),
        (OSCILLATOR, 2.0 * math.pi / W, True, "1 turns on, is not reached by torques that are held"),
        (INVERTED, 12.0, True, r"the mode 3 1/s grows by a factor of 10\^16, .*shorter control.period"),
        (INVERTED, 300.0, False, r"the mode 3 1/s grows by a factor of 10\^391"),
        (INVERTED, 1e-14, False, "nothing moves by more than rounding; allowed: a longer control.period"),
    ],
)
def test_a_period_without_a_regulator_says_why(system: Any, period: float, integral: bool, why: str) -> None:
    cost = Cost(np.eye(2), np.eye(1), np.zeros((2, 1)))
    with pytest.raises(ValueError, match=why):
        optimum(*system, cost, period, integral)
    near = optimum(*system, cost, 0.31, integral)
    refuse_unsure(*system, near.K, 0.31, disturbed(*system, 1e-15 * np.abs(system[0])))
    assert np.abs(np.linalg.eigvals(near.L)).max() < 1.0


def test_modes_that_are_one_at_the_samples_cost_nothing_there() -> None:
    """Two oscillators, each with a force, apart by a turn a period: of their sum the samples show one."""
    period = 0.4
    A, B = np.zeros((4, 4)), np.zeros((4, 2))
    A[:2, 2:], B[2:] = np.eye(2), np.eye(2)
    A[2:, :2] = np.diag([-(W**2), -((W + math.tau / period) ** 2)])
    cost = Cost(np.zeros((4, 4)), np.eye(2), np.zeros((4, 2)))
    cost.Q[:2, :2] = 1.0
    with pytest.raises(ValueError, match="costs nothing at the samples; .*control.cost: integral"):
        optimum(A, B, cost, period)
    for best in (optimum(A, B, cost, period, integral=True), optimum(A, B, cost, 0.31)):
        assert np.abs(np.linalg.eigvals(best.L)).max() < 1.0


def test_gains_whose_loop_rounding_decides_about_are_refused() -> None:
    A, B = INVERTED
    with pytest.raises(ValueError, match="rounding decides whether the loop of the best gains is stable"):
        refuse_unsure(A, B, np.array([[W**2, 1.0]]), None, disturbed(A, B, 1e-15 * np.abs(A)))


def test_the_integral_is_what_a_fast_regulator_goes_to_and_samples_are_not() -> None:
    found = {
        key: matrix(simulate(scene_of(3, f"{{type: lqr, {key}, gains: {{q: 40, qd: 1}}}}")).summary["control"]["gains"])
        for key in ("cost: integral", "{period: 1e-4, cost: integral}"[1:-1], "period: 1e-4")
    }  # fmt: skip
    continuous, integral, samples = found.values()
    assert np.abs(integral - continuous).max() < 1e-2 * np.abs(continuous).max()
    assert (
        np.abs(samples - continuous).max() < 1e-2 * np.abs(continuous).max()
    )  # both weights alike are scaled
    with pytest.raises(SceneError, match=r"control.cost: 'samples' goes with 'period'"):
        scene_of(3, "{type: lqr, cost: samples, gains: {q: 40}}")


def test_gains_that_are_written_come_out_as_matrices_and_others_are_absent() -> None:
    pid = simulate(
        scene_of(3, "{type: pid, gains: {kp: 40, kd: {a: 1, b: 2, c: 3}, ki: 5}, period: 0.01, delay: 0.004}")
    )
    own = pid.summary["control"]
    assert own["gains"]["b"] == {
        "a": 0.0, "b": 40.0, "c": 0.0, "qd.a": 0.0, "qd.b": 2.0, "qd.c": 0.0,
        "integral.a": 0.0, "integral.b": 5.0, "integral.c": 0.0,
    }  # fmt: skip
    assert own["column_units"]["integral.b"] == "m s" and own["row_units"]["b"] == "N"
    assert float(pid["control/delay"]) == 0.004 and float(pid["control/period"]) == 0.01
    assert not {"poles", "riccati", "gain_errors", "equilibrium"} & own.keys()
    torque = simulate(scene_of(3, "{type: computed_torque, gains: {kp: 400, kd: 40}}")).summary["control"]
    assert torque["row_units"]["qdd.a"] == "rad/s^2" and [x["real"] for x in torque["poles"]] == [-20.0] * 6
    law = simulate(scene_of(3, "{type: formulas, law: {a: -q.a, b: -q.b, c: -q.c}}")).summary["control"]
    assert "gains" not in law


def test_a_table_for_a_controller_is_the_inverse_at_its_multiples() -> None:
    """The period divides the motion, does not, or is longer than it; other samples stay as they are."""
    scene = "schema: 1\ngravity: [0, -9.81, 0]\nrobot: robots/planar_2r.yaml\n"
    move = "trajectory: {type: quintic, points: [{t: 0, q: {theta1: 0, theta2: 0}}, {t: 1, q: {theta1: 0.5, theta2: -0.3}}]}"
    of = f"{scene}{move}\ninverse: {{samples: 101"
    path = Path(__file__).parents[2] / "configs" / "example.yaml"
    plain = inverse(load_scene_text(of + "}", path))
    for period, count in ((0.02, 51), (0.03, 34), (2.0, 1)):
        tabled = inverse(load_scene_text(f"{of}, period: {period}}}", path))
        np.testing.assert_array_equal(tabled["tau"], plain["tau"])
        times = tabled["feed_forward/time"]
        np.testing.assert_allclose(times, period * np.arange(count), atol=1e-15)
        if period == 0.02:
            np.testing.assert_allclose(tabled["feed_forward/tau"], plain["tau"][::2], rtol=1e-12, atol=1e-12)
        again = inverse(load_scene_text(of.replace("101", "1001") + "}", path))
        at = np.searchsorted(again.time, times - 1e-9)
        for name in ("q", "qd", "qdd", "tau"):
            np.testing.assert_allclose(tabled[f"feed_forward/{name}"], again[name][at], rtol=1e-9, atol=1e-9)
    with pytest.raises(CapabilityError, match="inverse.period"):
        inverse(load_scene_text(f"{of}, period: 1e-9}}", path))


@pytest.mark.parametrize("seed", range(3))
def test_the_equilibrium_of_a_regulator_has_errors_that_cover(seed: int) -> None:
    """Of a pendulum by hand."""
    random = np.random.default_rng(seed)
    mass, length, angle = random.uniform(0.3, 3.0, 3).round(4).tolist()
    text = (
        "schema: 1\ngravity: [0, -9.81, 0]\nrobot: {joints: [{name: a, type: revolute, axis: [0, 0, 1]}], links: "
        f"[{{name: rod, mass: {mass}, com: [{length}, 0, 0], inertia: {{zz: 0.3}}}}]}}\n"
        f"initial: {{q: {{a: {angle}}}}}\ncontrol: {{type: lqr}}\nsimulate: {{duration: 0.01, samples: 2}}\n"
    )
    own = simulate(load_scene_text(text)).summary["control"]["equilibrium"]
    off = own["errors"]["torques"]["a"]
    assert abs(own["torques"]["a"] - mass * 9.81 * length * math.cos(angle)) <= off < 1e-11
    assert own["errors"]["q"] == {"a": 0.0}


def test_a_pose_of_loops_is_known_as_far_as_they_close() -> None:
    """A parallelogram, closed from two guesses: its angles are those of the crank."""
    bars = "{mass: 1, com: [0.2, 0.01, 0], inertia: {zz: 0.02}}"
    own = []
    for guess in (0.61, 0.75):
        text = (
            "schema: 1\ngravity: [0, -9.81, 0]\nrobot:\n  joints:\n"
            "    - {name: a, type: revolute, axis: [0, 0, 1]}\n"
            "    - {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [0.4, 0, 0]}}\n"
            "    - {name: c, type: revolute, axis: [0, 0, 1], parent: base, origin: {xyz: [0.5, 0, 0]}}\n  links:\n"
            + "".join(f"    - {{name: {x}, {bars[1:]}\n" for x in ("crank", "coupler", "rocker"))
            + "  points: {pin1: {link: coupler, at: [0.5, 0, 0]}, pin2: {link: rocker, at: [0.4, 0, 0]}}\n"
            "loops: [{name: pin, type: revolute, between: [pin1, pin2]}]\n"
            f"initial: {{q: {{a: 0.7, b: -{guess}, c: {guess}}}, hold: [a]}}\n"
            "control: {type: lqr, joints: [a], pose: {a: 0.7}}\nsimulate: {duration: 0.01, samples: 2}\n"
        )
        own.append(simulate(load_scene_text(text)).summary["control"]["equilibrium"])
    for one in own:
        for name, true in (("a", 0.7), ("b", -0.7), ("c", 0.7)):
            assert abs(one["q"][name] - true) <= one["errors"]["q"][name] + 1e-16 < 1e-9
    one, other = own
    apart = abs(one["torques"]["a"] - other["torques"]["a"])
    assert apart <= one["errors"]["torques"]["a"] + other["errors"]["torques"]["a"] < 1e-9
