"""Controllers against closed forms: linear plants by the matrix exponential, arms by their error dynamics, LQR by
finite differences and scipy, limits and integrals by scipy's integrators."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are

from robodyn_cli import Mechanism, simulate
from robodyn_cli.cli.control_words import control_lines
from robodyn_cli.errors import NumericalError, RobodynError, SceneError
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.stepping import writer
from robodyn_cli.integrators.stepping.loop import write_run
from robodyn_cli.kernels.cache import REPORT
from robodyn_cli.kernels.lower import Programs
from robodyn_cli.motion.build import build_motion
from robodyn_cli.results.hdf5 import write
from robodyn_cli.scene import load_scene_text
from robodyn_cli.works.inverse import inverse
from tests.numeric import assert_close

M, K, C = 1.7, 23.0, 0.6  # of the cart
CART = f"""\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints: [{{name: x, type: prismatic, axis: [1, 0, 0], spring: {{stiffness: {K}}}, damper: {{damping: {C}}}}}]
  links: [{{name: cart, mass: {M}, com: [0, 0, 0], inertia: {{xx: 1, yy: 1, zz: 1}}}}]
initial: {{q: {{x: 0.3}}, qd: {{x: -0.2}}}}
"""
ARM = """\
schema: 1
gravity: [0.6, -1.2, -9.7]
robot:
  joints:
    - {name: a, type: revolute, axis: [0.1, 0.2, 1]}
    - {name: b, type: revolute, axis: [0, 1, 0.3], origin: {xyz: [0.1, 0, 0.3]}, damper: {damping: 0.3}}
    - {name: c, type: prismatic, axis: [1, 0.2, 0], origin: {xyz: [0.2, 0.1, 0]}, spring: {stiffness: 40}}
    - {name: d, type: revolute, axis: [0, 1, 0], origin: {xyz: [0.3, 0, 0.1]}}
    - {name: h, type: revolute, axis: [1, 0.1, 0], origin: {xyz: [0.1, 0.2, 0]}, rotor_inertia: 1e-4, gear_ratio: 50}
    - {name: f, type: revolute, axis: [0.3, 1, 0], origin: {xyz: [0.2, 0, 0]}}
    - {name: g, type: revolute, axis: [0, 0.2, 1], origin: {xyz: [0, 0.1, 0.1]}}
  links:
    - {name: A, mass: 4, com: [0.01, 0.02, 0.1], inertia: {xx: 0.3, yy: 0.4, zz: 0.5, xy: 0.02, xz: 0.03, yz: -0.01}}
    - {name: B, mass: 3, com: [0.1, 0.02, 0], inertia: {xx: 0.2, yy: 0.3, zz: 0.25, xy: 0.02, xz: 0.01, yz: -0.01}}
    - {name: CC, mass: 2, com: [0.1, -0.05, 0], inertia: {xx: 0.2, yy: 0.2, zz: 0.15, xy: 0.01, xz: 0.03, yz: 0.01}}
    - {name: D, mass: 2, com: [0.05, 0.02, 0.02], inertia: {xx: 0.1, yy: 0.2, zz: 0.15, xy: 0.02, xz: 0.01, yz: 0.01}}
    - {name: E, mass: 1, com: [0, 0.02, 0.03], inertia: {xx: 0.05, yy: 0.06, zz: 0.07, xy: 0.01, xz: 0.01, yz: -0.01}}
    - {name: F, mass: 1, com: [0.03, 0, 0.02], inertia: {xx: 0.04, yy: 0.05, zz: 0.03, xy: 0.002, xz: 0.003, yz: 0.001}}
    - {name: G, mass: 0.5, com: [0, 0.03, 0.04], inertia: {xx: 0.02, yy: 0.03, zz: 0.02, xy: 0.002, xz: 0.001, yz: 0.003}}
  points: {tip: {link: G, at: [0.02, 0.03, 0.1]}}
"""
NAMES = tuple("abcdhfg")
MOTION = "{type: joint, duration: 2, q: {" + ", ".join(
    f"{name}: '{0.1 * k} + 0.3*sin({1 + 0.3 * k}*t)'" for k, name in enumerate(NAMES)
) + "}}"  # fmt: skip


def made(text: str, *settings: str):
    return load_scene_text(text, overrides=settings)


def cart(control: str, duration: float = 1.0, samples: int = 101, more: str = ""):
    return made(f"{CART}control: {control}\nsimulate: {{duration: {duration}, samples: {samples}}}\n{more}")


def arm(control: str, duration: float = 1.0, start: str = "", more: str = ""):
    initial = start or "{" + ", ".join(f"{name}: {0.1 * k + 0.05}" for k, name in enumerate(NAMES)) + "}"
    return made(
        f"{ARM}initial: {{q: {initial}}}\ncontrol: {control}\nsimulate: {{duration: {duration}, samples: 201}}\n{more}"
    )


def step_of(h: float) -> tuple[np.ndarray, np.ndarray]:
    """x(h) = F x + G u of the cart under a force u that is held."""
    whole = np.zeros((3, 3))
    whole[0, 1], whole[1, :] = 1.0, [-K / M, -C / M, 1.0 / M]
    found = expm(h * whole)
    return found[:2, :2], found[:2, 2]


def error_of(result) -> float:
    return max(1e-13, 20.0 * result.summary["error_estimate"]["state_max"])


# -- sampled ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("delay", [0.0, 0.02, 0.013, 0.004])
def test_a_sampled_pd_on_a_linear_plant_is_its_discrete_closed_form(delay: float) -> None:
    T, kp, kd, wanted = 0.01, 60.0, 7.0, 0.3
    result = simulate(cart(f"{{type: pd, period: {T}, delay: {delay}, gains: {{kp: {kp}, kd: {kd}}}}}"))
    whole, rest = divmod(round(delay / T, 9), 1.0)
    x, pending, acts = np.array([0.3, -0.2]), [0.0] * int(whole), 0.0
    for k in range(100):
        assert_close(result["q"][k, 0], x[0], 1e-12 + error_of(result))
        assert_close(result["qd"][k, 0], x[1], 1e-11 + error_of(result))
        pending.append(kp * (wanted - x[0]) - kd * x[1])
        new = pending.pop(0)
        for h, u in ((rest * T, acts), ((1.0 - rest) * T, new)):
            F, G = step_of(h)
            x = F @ x + G * u
        acts = new
    assert result.summary["control"]["updates"] == 101


def test_a_long_delay_compiles_as_fast_as_a_short_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its torques on the way are looped over, which changes no figure but by rounding."""

    def written(delay: float) -> int:
        scene = made(CART, f"control={{type: pd, period: 0.01, delay: {delay}, gains: {{kp: 9, kd: 1}}}}")
        return len(write_run(build_motion(scene).system, methods["gauss"], Programs(True)))

    assert written(2.0) < 2.0 * written(0.1)
    delayed = "{type: pd, period: 0.01, delay: 0.4, gains: {kp: 9, kd: 1}}"
    looped = simulate(cart(delayed))
    monkeypatch.setattr(writer, "LONG", 1000)
    unrolled = simulate(cart(delayed))
    assert_close(looped["q"], unrolled["q"], 1e-13)
    assert_close(looped["control/torque"], unrolled["control/torque"], 1e-12)


def test_samples_at_an_update_show_what_it_sets() -> None:
    result = simulate(cart("{type: pd, period: 0.02, gains: {kp: 60, kd: 7}}", samples=51))
    u = 60.0 * (0.3 - result["q"][:, 0]) - 7.0 * result["qd"][:, 0]
    assert_close(result["control/torque"][:, 0], u, 1e-11)
    assert_close(result["control/torque"], result["tau"], 0.0)


def test_sensors_limits_and_a_function_in_python_make_the_same_run() -> None:
    """Rounding, rates by differences, saturation and a rate limit, once in compiled code and once by hand."""
    T, step, most, slope = 0.01, 0.004, 9.0, 400.0
    keys = f"period: {T}, sensors: {{resolution: {step}, rates: differences}}, rate_limit: {slope}, limit: {most}"
    result = simulate(
        cart(f"{{type: pid, {keys}, gains: {{kp: 200, kd: 4, ki: 90, anti_windup: 3}}}}", 2.0, 201)
    )

    x, last, integral, u = np.array([0.3, -0.2]), None, 0.0, 0.0
    for k in range(200):
        assert_close(result["q"][k, 0], x[0], 1e-10)
        seen = step * np.rint(x[0] / step)
        rate = 0.0 if last is None else (seen - last) / T
        last = seen
        asked = 200.0 * (0.3 - seen) - 4.0 * rate + integral
        given = min(max(min(max(asked, -most), most), u - slope * T), u + slope * T)
        integral += T * (90.0 * (0.3 - seen) + 3.0 * (given - asked))
        u = given
        F, G = step_of(T)
        x = F @ x + G * u
    assert result.summary["control"]["saturated"]["x"] > 0.0


class Pd:
    """PD in Python, which counts its calls."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def reset(self) -> None:
        self.times = []

    def __call__(self, t: float, q: np.ndarray, qd: np.ndarray) -> list[float]:
        self.times.append(t)
        return [60.0 * (0.3 - q[0]) - 7.0 * qd[0]]


def test_a_function_in_python_is_called_once_a_period() -> None:
    plain = made(f"{CART}simulate: {{duration: 1, samples: 101}}\n")
    f = Pd()
    found = simulate(plain, controller=f, period=0.01)
    compiled = simulate(cart("{type: pd, period: 0.01, gains: {kp: 60, kd: 7}}"))
    assert_close(found["q"], compiled["q"], 1e-13)
    assert_close(np.array(f.times), 0.01 * np.arange(101), 1e-15)
    assert found.summary["error_estimate"]["state_max"] < 1e-11


@pytest.mark.parametrize(
    "function, message",
    [
        (lambda t, q, qd: 1 / (q[0] - q[0]) if t > 0.1 else [0.0], "failed at t = 0.11 s"),
        (lambda t, q, qd: [0.0, 1.0], "allowed: 1 finite torques"),
        (lambda t, q, qd: [math.nan if t > 0.1 else 0.0], "allowed: 1 finite torques"),
    ],
)
def test_a_function_that_fails_ends_the_run(function, message: str) -> None:
    with np.errstate(all="raise"), pytest.raises(NumericalError, match=message):
        simulate(made(f"{CART}simulate: {{duration: 1, samples: 11}}\n"), controller=function, period=0.01)


def test_noise_is_the_same_whatever_the_steps() -> None:
    noisy = "{type: pd, period: 0.01, gains: {kp: 60, kd: 7}, sensors: {noise: 0.01, rate_noise: 0.1, seed: SEED}}"
    first = simulate(cart(noisy.replace("SEED", "5")))
    short = simulate(made(f"{CART}control: {noisy.replace('SEED', '5')}\n"
                          "simulate: {duration: 1, samples: 101, integrator: rk4, step: 0.0007}\n"))  # fmt: skip
    other = simulate(cart(noisy.replace("SEED", "6")))
    assert_close(first["control/torque"], short["control/torque"], 1e-7)
    assert np.abs(first["q"] - other["q"]).max() > 1e-4
    rng = np.random.Generator(np.random.Philox(5)).standard_normal((2, 2))
    u = 60.0 * (0.3 - (0.3 + 0.01 * rng[0, 0])) - 7.0 * (-0.2 + 0.1 * rng[0, 1])
    assert_close(first["control/torque"][0, 0], u, 1e-12)


# -- continuous ------------------------------------------------------------------------------------------------
def test_a_continuous_pd_on_a_linear_plant() -> None:
    result = simulate(cart("{type: pd, gains: {kp: 60, kd: 7}}"))
    A = np.array([[0.0, 1.0], [-(K + 60.0) / M, -(C + 7.0) / M]])
    rest = np.array([60.0 * 0.3 / (K + 60.0), 0.0])
    x = np.array([rest + expm(A * t) @ (np.array([0.3, -0.2]) - rest) for t in result["time"]])
    assert_close(result["q"][:, 0], x[:, 0], error_of(result))
    assert_close(result["control/error"][:, 0], 0.3 - x[:, 0], error_of(result))


@pytest.mark.parametrize("windup, wanted", [(None, 40.0 / 30.0), (0.0, 0.0), (8.0, 8.0)])
def test_integrals_give_way_at_limits(windup: float | None, wanted: float) -> None:
    own = "" if windup is None else f", anti_windup: {windup}"
    reference = "{type: joint, duration: 4, q: {x: '0.3 + 0.4*sin(2*t)'}}"
    result = simulate(
        cart(
            f"{{type: pid, limit: 11, reference: {reference}, gains: {{kp: 30, kd: 3, ki: 40{own}}}}}",
            4.0,
            401,
        )
    )

    def rate(t: float, y: np.ndarray) -> list[float]:
        x, v, s = y
        e, ed = 0.3 + 0.4 * math.sin(2 * t) - x, 0.8 * math.cos(2 * t) - v
        asked = 30.0 * e + 3.0 * ed + s
        u = min(max(asked, -11.0), 11.0)
        return [v, (u - K * x - C * v) / M, 40.0 * e + wanted * (u - asked)]

    exact = solve_ivp(
        rate, (0, 4), [0.3, -0.2, 0.0], "DOP853", result["time"], rtol=1e-11, atol=1e-13, max_step=2e-3
    )
    assert_close(result["q"][:, 0], exact.y[0], 1e-7)
    assert_close(result["control/states"][:, 0], exact.y[2], 1e-5)
    assert 0.1 < result.summary["control"]["saturated"]["x"] < 4.0


def test_a_controller_by_formulas_with_a_state_is_the_pid() -> None:
    motion = "{type: joint, duration: 4, q: {x: '0.3 + 0.4*sin(2*t)'}}"
    pid = simulate(cart(f"{{type: pid, reference: {motion}, gains: {{kp: 30, kd: 3, ki: 40}}}}", 2.0))
    law = "{x: '30*(ref.x - q.x) + 3*(refd.x - qd.x) + s.sum'}"
    own = simulate(
        cart(
            f"{{type: formulas, reference: {motion}, law: {law}, state: {{sum: {{rate: '40*(ref.x - x)'}}}}}}",
            2.0,
        )
    )
    assert_close(own["q"], pid["q"], error_of(pid))


def test_a_state_by_its_next_value_and_a_signal() -> None:
    keys = "state: {n: {start: 2, next: 's.n + 1'}}, law: {x: '0.1*s.n - 7*qd.x'}"
    signals = "outputs: {signals: {power: {value: 'tau.x*qd.x', unit: W}, twice: '2*s.n'}}"
    result = simulate(cart(f"{{type: formulas, period: 0.01, {keys}}}", more=signals))
    assert_close(result["control/states"][:, 0], 3.0 + np.arange(101), 0.0)
    assert_close(result["signals/twice"], 2.0 * (3.0 + np.arange(101)), 0.0)
    assert_close(result["signals/power"], result["tau"][:, 0] * result["qd"][:, 0], 1e-14)
    assert result.variables["signals/power"].units == "W"


# -- arms ------------------------------------------------------------------------------------------------------
def test_computed_torque_with_the_exact_model_leaves_linear_errors() -> None:
    kp, kd = 30.0, 7.0
    result = simulate(arm(f"{{type: computed_torque, reference: {MOTION}, gains: {{kp: {kp}, kd: {kd}}}}}"))
    A = np.array([[0.0, 1.0], [-kp, -kd]])
    error = result["control/error"]
    rates = np.array([0.3 * (1 + 0.3 * k) for k in range(7)])
    for k in range(7):
        start = np.array([error[0, k], rates[k]])
        exact = np.array([(expm(A * t) @ start)[0] for t in result["time"]])
        assert_close(error[:, k], exact, error_of(result))


def test_a_payload_that_the_model_does_not_know() -> None:
    """At rest kp e is what the model lacks of gravity."""
    scene = arm("{type: gravity, gains: {kp: 900, kd: 120}, model: {set: {robot.links.G.mass: 2.5}}}", 25.0)
    result = simulate(scene)
    assert np.abs(result["qd"][-1]).max() < 1e-6
    q = result["q"][-1]
    other = made(scene.text, "control=null", "robot.links.G.mass=2.5")
    gravity = [
        problem.numbers(problem.bias - problem.newton_euler([0] * 7, [0] * 7, None), q)
        for problem in (build_motion(s).problem for s in (made(scene.text, "control=null"), other))
    ]
    spring = np.array([0, 0, 40.0 * q[2], 0, 0, 0, 0])
    assert_close(900.0 * result["control/error"][-1] + gravity[1], gravity[0] + spring, 1e-3)


def test_torques_of_the_inverse_reproduce_the_motion_of_an_arm() -> None:
    start = "{" + ", ".join(f"{name}: {0.1 * k}" for k, name in enumerate(NAMES)) + "}"
    rates = ", ".join(f"{name}: {0.3 * (1 + 0.3 * k)}" for k, name in enumerate(NAMES))
    scene = arm(f"{{type: feed_forward, reference: {MOTION}}}", 1.0, start)
    scene = made(scene.text, f"initial.qd={{{rates}}}")
    result = simulate(scene)
    assert np.abs(result["control/error"]).max() < error_of(result)
    torques = inverse(made(scene.text, f"trajectory={MOTION}", "inverse.samples=401", "control=null"))
    assert_close(result["tau"], torques["tau"][:201], 1e-7)


def test_a_path_of_a_point_is_followed_by_joints_and_by_the_point() -> None:
    planar = """\
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: p, type: revolute, a: 1.0, alpha: 0, d: 0}
    - {name: r, type: revolute, a: 0.8, alpha: 0, d: 0}
  links: [{name: l1, com_frame: link, mass: 2, com: [-0.5, 0.01, 0], inertia: {zz: 0.2}}, {name: l2, com_frame: link, mass: 1, com: [-0.4, 0, 0], inertia: {zz: 0.1}}]
  points: {tip: {link: l2, at: end}}
"""
    circle = (
        "{type: circle, point: tip, center: [1.1, 0.2], radius: 0.2, duration: 3, ik: {branch: elbow_down}}"
    )
    follow = f"{planar}control: {{type: feed_forward, reference: {circle}, gains: {{kp: 400, kd: 60}}}}\n"
    made_motion = inverse(made(f"{planar}trajectory: {circle}\n"))
    q, qd = made_motion["q"][0], made_motion["qd"][0]
    state = f"initial: {{q: {{p: {q[0]!r}, r: {q[1]!r}}}, qd: {{p: {qd[0]!r}, r: {qd[1]!r}}}}}\n".replace(
        "np.float64", ""
    )
    run = "simulate: {duration: 2, samples: 201}\n"
    joints = simulate(made(follow + state + run))
    assert np.abs(joints["control/error"]).max() < 1e-9
    t = joints["time"]
    phi = 2.0 * math.pi * t / 3.0
    assert_close(joints["points/tip"][:, 0], 1.1 + 0.2 * np.cos(phi), 1e-9)
    task = f"control: {{type: task_pd, reference: {circle}, gains: {{kp: 900, kd: 90}}}}\n"
    point = simulate(made(planar + task + state + run))
    assert point.variables["control/error"].names == ("tip.x", "tip.y")
    assert_close(point["control/reference"][:, 0], 1.1 + 0.2 * np.cos(phi), 1e-11)
    # J^T F with the Jacobian of the textbook, and gravity by hand
    q1, q12 = point["q"][:, 0], point["q"].sum(axis=1)
    J = np.array(
        [
            [-np.sin(q1) - 0.8 * np.sin(q12), -0.8 * np.sin(q12)],
            [np.cos(q1) + 0.8 * np.cos(q12), 0.8 * np.cos(q12)],
        ]
    )
    wanted_rate = 0.2 * 2.0 * math.pi / 3.0 * np.array([-np.sin(phi), np.cos(phi)])
    v = np.einsum("ijt,tj->it", J, point["qd"])
    force = 900.0 * point["control/error"].T + 90.0 * (wanted_rate - v)
    second = 9.81 * 0.4 * np.cos(q12)
    first = 9.81 * (2 * (0.5 * np.cos(q1) - 0.01 * np.sin(q1)) + np.cos(q1)) + second
    assert_close(point["tau"], (np.einsum("ijt,it->jt", J, force) + [first, second]).T, 1e-7)


# -- LQR -------------------------------------------------------------------------------------------------------
CART_POLE = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: x, type: prismatic, axis: [1, 0, 0]}
    - {name: th, type: revolute, axis: [0, 1, 0]}
  links:
    - {name: cart, mass: 1.3, com: [0, 0, 0], inertia: {xx: 1, yy: 1, zz: 1}}
    - {name: pole, mass: 0.4, com: [0, 0, 0.5], inertia: {xx: 0.03, yy: 0.03, zz: 0.01}}
initial: {q: {x: 0.1, th: 0.15}}
simulate: {duration: 6, samples: 301}
"""


def finite_differences(scene) -> tuple[np.ndarray, np.ndarray]:
    """A and B of the cart and pole upright, by central differences of its accelerations."""
    problem = build_motion(made(scene.text, "control=null")).problem
    qdd = problem.forward.qdd
    h = 1e-5

    def rate(x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[2:], problem.numbers(list(qdd), x[:2], v=x[2:])])

    A = np.array([(rate(h * e) - rate(-h * e)) / (2 * h) for e in np.eye(4)]).T
    B = np.zeros((4, 1))
    B[2:, 0] = np.linalg.inv(problem.numbers(problem.mass_matrix, np.zeros(2)))[:, 0]
    return A, B


@pytest.mark.parametrize("period", [None, 0.02])
def test_lqr_has_the_gains_of_scipy(period: float | None) -> None:
    keys = "" if period is None else f"period: {period}, "
    scene = made(
        f"{CART_POLE}control: {{type: lqr, {keys}joints: [x], pose: {{x: 0, th: 0}}, gains: {{q: {{x: 3, th: 9}}, qd: 0.5, tau: 0.2}}}}\n"
    )
    result = simulate(scene)
    A, B = finite_differences(scene)
    Q, R = np.diag([3.0, 9.0, 0.5, 0.5]), np.array([[0.2]])
    if period is None:
        gain = B.T @ solve_continuous_are(A, B, Q, R) / 0.2
    else:
        whole = np.zeros((5, 5))
        whole[:4, :4], whole[:4, 4:] = A, B
        F, G = np.split(expm(whole * period)[:4], [4], axis=1)
        P = solve_discrete_are(F, G, Q, R)
        gain = np.linalg.solve(R + G.T @ P @ G, G.T @ P @ F)
    state = np.concatenate([result["q"], result["qd"]], axis=1)
    at = slice(None) if period is None else slice(None, None, 1)
    assert_close(result["tau"][at, 0], -(state[at] @ gain[0]), 2e-6)
    assert result.variables["control/error"].names == ("x", "th")
    assert_close(result["control/error"], -result["q"], 1e-14)
    tracking = result.summary["control"]["tracking"]
    assert (tracking["x"]["unit"], tracking["th"]["unit"]) == ("m", "rad")
    assert_close(tracking["th"]["peak"], np.abs(result["q"][:, 1]).max(), 1e-5)
    assert np.abs(state[-1]).max() < 0.02


def test_an_uncontrollable_pair_is_refused() -> None:
    two = CART_POLE.replace("    - {name: th,", "    - {name: th, parent: base,")
    with pytest.raises(SceneError, match="cannot be stabilised"):
        simulate(made(f"{two}control: {{type: lqr, joints: [x], pose: {{x: 0, th: 0}}}}\n"))


@pytest.mark.parametrize("period", ["", ", period: 0.01"])
@pytest.mark.parametrize("gains", ["q: {x: 0, th: 10}", "q: {x: 0, th: 10}, qd: 0"])
def test_a_mode_that_costs_nothing_is_refused(gains: str, period: str) -> None:
    """The cart may stand anywhere at no cost, so that nothing would bring it back."""
    control = f"{{type: lqr, joints: [x], pose: {{x: 0, th: 0}}, gains: {{{gains}}}{period}}}"
    with pytest.raises(SceneError, match="neither grows nor decays and costs nothing"):
        simulate(made(f"{CART_POLE}control: {control}\n"))


def test_poles_of_a_design_say_that_they_are_without_the_delay() -> None:
    control = "{type: lqr, joints: [x], pose: {x: 0, th: 0}, gains: {q: 10, qd: 1}, period: 0.01"
    for delay, told in ((", delay: 0.02", True), ("", False)):
        result = simulate(
            made(f"{CART_POLE.replace('duration: 6', 'duration: 0.1')}control: {control}{delay}}}\n")
        )
        lines = "\n".join(control_lines(result.summary["control"]))
        assert "poles of the loop" in lines and ("of the design, without the delay" in lines) == told


def test_what_is_no_function_is_refused() -> None:
    with pytest.raises(SceneError, match="the controller is no function .value 3.; allowed: simulate"):
        simulate(made(CART_POLE), controller=3, period=0.01)


# -- bad input -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "control, message",
    [
        ("{type: pd, gains: {kp: 1}, period: 3}", "control.period: is longer than the run"),
        ("{type: pd, gains: {kp: 1}, period: 0}", "control.period: is too small"),
        ("{type: pd, gains: {kp: 1}, delay: 0.1}", "control.delay: goes with 'period'"),
        ("{type: pd, gains: {kp: 1}, period: 0.1, delay: 7}", "control.delay: is longer than the run"),
        ("{type: pd, gains: {kp: {y: 1}}}", "unknown joint of this controller 'y'"),
        ("{type: pd, gains: {kp: -1}}", "control.gains.kp: is too small"),
        ("{type: pd, joints: [y], gains: {kp: 1}}", "unknown joint with one coordinate 'y'"),
        ("{type: bang}", "control.type: unknown choice 'bang'"),
        ("{type: pd, gains: {kp: 1}, reference: {type: joint, duration: 1, q: {y: t}}}", "control.reference"),
        ("{type: formulas, law: {x: s.a}}", "unknown name 's.a'"),
        ("{type: formulas, law: {x: 1}, state: {a: {}}}", "needs either 'rate' or 'next'"),
        ("{type: python}", "control.period: is missing"),
        ("{type: task_pd, gains: {kp: 1}}", "follows a path of a point"),
        ("{type: gravity, model: {set: {robot.links.wheel.mass: 1}}}", "control.model.set"),
        ("{type: pd, period: 0.1, gains: {kp: 1}, sensors: {resolution: 0}}", "control.sensors.resolution"),
    ],
)
def test_bad_input_is_named(control: str, message: str) -> None:
    with pytest.raises(RobodynError) as refused:
        simulate(cart(control))
    assert message in refused.value.message


def test_a_signal_of_a_controller_needs_one() -> None:
    with pytest.raises(SceneError, match="of a controller, and there is none"):
        made(f"{CART}outputs: {{signals: {{e: 'ref.x - x'}}}}\n")


# -- mechanisms, contact, going on -------------------------------------------------------------------------------
FOUR_BAR = f"""\
schema: 1
gravity: [0, -9.81, 0]
robot: {Path(__file__).parents[2]}/configs/robots/four_bar.yaml
loops: [{{name: pin, type: revolute, between: [coupler.end, follower.end]}}]
actuated: [theta1]
"""
QUINTIC = "{type: quintic, points: [{t: 0, q: {theta1: 1.0}}, {t: 1, q: {theta1: 1.6}}]}"


def test_torques_of_the_inverse_reproduce_the_motion_of_a_mechanism() -> None:
    """By a table, whose straight lines are off by h^2 / 8 tau'' between its rows."""
    torques = inverse(made(f"{FOUR_BAR}trajectory: {QUINTIC}\ninverse: {{samples: 2001}}\n"))
    names = torques.variables["q"].names
    start = ", ".join(f"{name}: {x!r}" for name, x in zip(names, torques["q"][0].tolist()))
    tau = torques["tau"][:, torques.variables["tau"].names.index("theta1")]
    rows = ", ".join(f"[{t!r}, {x!r}]" for t, x in zip(torques["time"].tolist(), tau.tolist()))
    run = f"initial: {{q: {{{start}}}, hold: [theta1]}}\nsimulate: {{duration: 1, samples: 201}}\n"
    found = simulate(made(f"{FOUR_BAR}{run}torques: {{theta1: {{table: [{rows}]}}}}\n"))
    bend = np.abs(np.diff(tau, 2)).max() / 8.0
    assert_close(found["q"], torques["q"][::10], 50.0 * bend + 1e-8)


def test_a_mechanism_with_loops_is_led_by_its_driven_joint() -> None:
    start = "initial: {q: {theta1: 1.0, phi1: 1.6}, hold: [theta1]}\nsimulate: {duration: 3, samples: 301}\n"
    control = f"control: {{type: pid, period: 0.002, joints: [theta1], reference: {QUINTIC}, gains: {{kp: 4000, kd: 400, ki: 9000}}}}\n"
    found = simulate(made(FOUR_BAR + control + start))
    assert abs(found["q"][-1, found.variables["q"].names.index("theta1")] - 1.6) < 2e-3
    assert found.summary["constraint_residual"]["position"] < 1e-10


def test_a_stuck_joint_breaks_away_when_a_sample_asks_for_more() -> None:
    """The held force grows by 1 N a sample; the friction holds up to 4 N, so the cart starts with the fifth."""
    text = CART.replace(
        "spring: {stiffness: 23.0}, damper: {damping: 0.6}", "friction: {coulomb: 4.0, law: set_valued}"
    )
    assert "set_valued" in text
    text = text.replace("x: -0.2", "x: 0.0")
    law = "control: {type: formulas, period: 0.1, law: {x: s.n + 0.5}, state: {n: {start: -1, next: s.n + 1}}}\n"
    found = simulate(made(f"{text}{law}simulate: {{duration: 0.6, samples: 61}}\n"))
    t, x, v, u = found["time"], 0.3, 0.0, found["control/torque"][:, 0]
    for k in range(60):
        force = u[k] - 4.0 if u[k] > 4.0 else 0.0
        x, v = x + 0.01 * v + 0.5e-4 * force / M, v + 0.01 * force / M
        assert_close(found["q"][k + 1, 0], x, 1e-9)
    assert v > 0.0 and found["qd"][int(0.49 / 0.6 * 60), 0] == 0.0, t


def test_a_run_goes_on_with_the_states_of_its_controller(tmp_path: Path) -> None:
    keys = "period: 0.01, delay: 0.013, sensors: {noise: 0.002, rates: differences}, gains: {kp: 60, kd: 2, ki: 30}"
    whole = cart(f"{{type: pid, {keys}}}", 1.0, 101)
    write(simulate(made(whole.text, "simulate.duration=0.5", "simulate.samples=51")), tmp_path / "result.h5")
    rest = simulate(made(whole.text, f"initial.from={tmp_path}"))
    first = simulate(whole)
    assert_close(rest["q"], first["q"][50:], 1e-12)
    assert_close(rest["control/states"], first["control/states"][50:], 1e-10)
    with pytest.raises(SceneError, match="states of a controller"):
        simulate(made(whole.text, f"initial.from={tmp_path}", "control.delay=0"))


def test_many_runs_have_sampled_controllers() -> None:
    """Gains, the plant's mass and the model's vary; each run is that of the command."""
    scene = arm(f"{{type: computed_torque, period: 0.01, reference: {MOTION}, gains: {{kp: 30, kd: 7}}, "
                "model: {set: {robot.links.G.mass: 0.9}}}", 0.2)  # fmt: skip
    keys = ["robot.links.G.mass", "control.gains.kp", "control.model.set.robot.links.G.mass"]
    rows = np.array([[0.5, 30.0, 0.9], [0.7, 90.0, 0.4]])
    found = Mechanism(scene, vary=keys).simulate_many(rows)
    assert found.ok.all() and not found.one_by_one.any()
    for row, q in zip(rows.tolist(), found.q):
        single = simulate(made(scene.text, *(f"{key}={x!r}" for key, x in zip(keys, row))))
        assert_close(q, single["q"][-1], 1e-12)


def test_a_model_with_another_mass_compiles_nothing() -> None:
    """Also where the model's mass happens to be that of the mechanism."""
    scene = arm(f"{{type: computed_torque, period: 0.01, reference: {MOTION}, gains: {{kp: 30, kd: 7}}, "
                "model: {set: {robot.links.G.mass: 0.9}}}", 0.2)  # fmt: skip
    simulate(scene)
    before = REPORT.compiled, REPORT.cached
    for value in (0.5, 0.7, 2.0):
        simulate(
            made(
                scene.text, f"control.model.set.robot.links.G.mass={value}", f"control.period={0.01 * value}"
            )
        )
    assert (REPORT.compiled, REPORT.cached) == before
