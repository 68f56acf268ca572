"""Forward dynamics against closed forms, other formulations of the same mechanism, and its own error estimate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import InverseDynamics, load_scene, load_scene_text, simulate
from robodyn_cli.errors import NumericalError, RobodynError, SceneError, SingularConfigurationError
from robodyn_cli.results.result import Result
from tests.planar_bodies import GROUND, Motor, Pin, PlanarBodies, Slide, turned

CONFIGS = Path(__file__).parents[2] / "configs"
# the double pendulum after 10 s in extended precision
THETA = (-1.62889639534037, 0.47749300648073)
RATES = (-1.42990244445507, 2.56888649044476)


def pendulum(*overrides: str) -> Result:
    return simulate(load_scene(CONFIGS / "double_pendulum.yaml", overrides))


def run(text: str, *overrides: str) -> Result:
    return simulate(load_scene_text("schema: 1\n" + text, overrides=overrides))


def failure(text: str, *overrides: str) -> RobodynError:
    with pytest.raises(RobodynError) as caught:
        run(text, *overrides)
    return caught.value


def close(got: Any, expected: Any, tolerance: float) -> None:
    assert np.abs(np.asarray(got) - np.asarray(expected)).max() <= tolerance


# -- the double pendulum ----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("overrides", "tolerance"),
    [
        ((), 1e-8),
        (("simulate.rtol=3e-14", "simulate.atol=3e-14"), 1e-11),
        (("simulate.integrator=gauss", "simulate.rtol=1e-6", "simulate.atol=1e-6"), 1e-3),
        (("simulate.integrator=dop853",), 1e-7),
        (("simulate.integrator=dop853", "simulate.rtol=3e-14", "simulate.atol=3e-14"), 1e-11),
        (("simulate.integrator=dopri5", "simulate.rtol=1e-11"), 1e-6),
        (("simulate.integrator=rk4", "simulate.step=2e-4"), 1e-8),
        (("simulate.integrator=rodas5p",), 1e-6),
    ],
    ids=lambda x: " ".join(x).replace("simulate.", "") if isinstance(x, tuple) else "",
)
def test_state_after_ten_seconds(overrides: tuple[str, ...], tolerance: float) -> None:
    result = pendulum(*overrides)
    close(result["q"][-1], THETA, tolerance)
    close(result["qd"][-1], RATES, tolerance)
    assert result.summary["termination"] == {"reason": "duration", "time": 10.0}


@pytest.fixture(scope="module")
def exact() -> Result:
    return pendulum("simulate.rtol=3e-14", "simulate.atol=3e-14", "simulate.samples=201")


@pytest.mark.parametrize("method", ["gauss", "dop853", "dopri5", "rodas5p"])
@pytest.mark.parametrize("rtol", [1e-5, 1e-7, 1e-9, 1e-10])
def test_error_estimate_brackets_the_error(method: str, rtol: float, exact: Result) -> None:
    result = pendulum(
        f"simulate.integrator={method}",
        f"simulate.rtol={rtol}",
        f"simulate.atol={rtol / 100}",
        "simulate.samples=201",
    )
    estimate = result.summary["error_estimate"]
    for key, path in (("q_max", "q"), ("qd_max", "qd")):
        true = float(np.abs(result[path] - exact[path]).max())
        assert true / 10 <= estimate[key] <= 10 * true, (key, true, estimate[key])
        assert estimate[key] <= estimate["state_max"]


@pytest.mark.parametrize("step", [4e-3, 1e-3])
def test_error_estimate_of_fixed_steps(step: float, exact: Result) -> None:
    result = pendulum("simulate.integrator=rk4", f"simulate.step={step}", "simulate.samples=201")
    true = max(float(np.abs(result[path] - exact[path]).max()) for path in ("q", "qd"))
    assert true / 2 <= result.summary["error_estimate"]["state_max"] <= 2 * true


def test_error_estimate_at_the_limit_of_precision_says_so() -> None:
    estimate = pendulum("simulate.rtol=3e-14", "simulate.atol=3e-14").summary["error_estimate"]
    assert 1e-15 < estimate["state_max"] < 1e-11 and "steps" in estimate["method"]


def test_error_estimate_can_be_left_out() -> None:
    assert pendulum("simulate.error_estimate=false").summary["error_estimate"] is None


@pytest.mark.parametrize(
    ("duration", "samples"), [(10.0, 1001), (0.7, 11), (1 / 3, 2), (1e-9, 5), (3.3, 100), (2.0, 20001)]
)
def test_samples_are_uniform_and_end_at_the_duration(duration: float, samples: int) -> None:
    result = pendulum(f"simulate.duration={duration!r}", f"simulate.samples={samples}")
    assert result.time.shape == (samples,)
    np.testing.assert_allclose(result.time, np.linspace(0.0, duration, samples), rtol=1e-15, atol=0.0)
    assert result.time[-1] == duration
    assert all(v.data.shape[0] == samples for v in result.variables.values())


def test_samples_do_not_depend_on_how_many_there_are() -> None:
    few, many = pendulum("simulate.samples=11"), pendulum("simulate.samples=1001")
    close(few["q"][:10], many["q"][:1000:100], 1e-11)
    assert np.array_equal(few["q"][-1], many["q"][-1]) or abs(few["q"][-1] - many["q"][-1]).max() < 1e-12


# -- one joint: closed forms ------------------------------------------------------------------------------
ONE = """
gravity: {gravity}
robot:
  joints:
    - {{name: j, type: {type}, axis: [0, 0, 1], {joint}}}
  links: [{{name: body, mass: 2, com: [0.3, 0, 0], inertia: {{zz: 0.5}}}}]
{drives}
initial: {{q: {{j: 0.4}}, qd: {{j: {rate}}}}}
simulate: {{duration: 3, samples: 61, rtol: 1e-12, atol: 1e-13}}
"""
J = 0.5 + 2 * 0.3**2  # about the joint


def one(
    joint: str = "", drives: str = "", kind: str = "revolute", gravity: str = "[0, 0, 0]", rate: float = 0.0
) -> Result:
    return run(ONE.format(type=kind, joint=joint, drives=drives, gravity=gravity, rate=rate))


def damped(t: np.ndarray, m: float, c: float, k: float, f: float, q0: float, v0: float) -> np.ndarray:
    """Return the solution of m q'' + c q' + k q = f."""
    roots = np.roots([m, c, k]).astype(complex)
    offset = f / k
    weights = np.linalg.solve(np.array([[1, 1], roots]), np.array([q0 - offset, v0], dtype=complex))
    return offset + np.real(sum(w * np.exp(r * t) for w, r in zip(weights, roots)))


def test_spring_and_damper() -> None:
    result = one("spring: {stiffness: 7, rest: 0.1}, damper: {damping: 0.6}", rate=-1.0)
    close(result["q"][:, 0], damped(result.time, J, 0.6, 7, 0.7, 0.4, -1.0), 1e-10)
    assert result.summary["energy_drift"] < 1e-10 and "energy/work" in result
    assert np.all(result["tau"] == 0.0)
    close(result["energy/potential"], 3.5 * (result["q"][:, 0] - 0.1) ** 2, 1e-12)


def test_a_spring_without_losses_keeps_its_energy() -> None:
    result = one("spring: {stiffness: 7}")
    assert "energy/work" not in result and result.summary["energy_drift"] < 1e-10
    assert result.summary["energy_balance"] == "kinetic + potential"


def test_prismatic_mass_on_a_spring_hangs() -> None:
    result = one("spring: {stiffness: 50}, damper: {damping: 3}", kind="prismatic", gravity="[0, 0, -9.81]")
    close(result["q"][:, 0], damped(result.time, 2, 3, 50, -2 * 9.81, 0.4, 0.0), 1e-10)
    assert result.variables["q"].units == "m" and result.variables["tau"].units == "N"
    assert result.summary["energy_drift"] < 1e-9


@pytest.mark.parametrize("ratio", [1.0, 50.0, -120.0])
@pytest.mark.parametrize("side", ["joint", "motor"])
def test_rotor_gear_and_viscous_friction(ratio: float, side: str) -> None:
    result = one(
        f"gear_ratio: {ratio}, rotor_inertia: 1e-4, friction: {{viscous: 2e-4, side: {side}}}",
        "torques: {j: 1.5}", rate=2.0,
    )  # fmt: skip
    inertia, b = J + ratio**2 * 1e-4, 2e-4 * (ratio**2 if side == "motor" else 1.0)
    speed = 1.5 / b + (2.0 - 1.5 / b) * np.exp(-b / inertia * result.time)
    close(result["qd"][:, 0], speed, 1e-10 * max(1.0, abs(speed).max()))
    assert np.all(result["tau"] == 1.5)


def test_coulomb_friction_is_smoothed_over_the_transition_speed() -> None:
    from scipy.integrate import solve_ivp

    friction = "friction: {coulomb: {positive: 0.8, negative: -0.3}, viscous: 0.05, transition_speed: 0.02}"
    result = one(friction, 'torques: {j: "0.6*cos(4*t)"}', rate=0.5)

    def rate(t: float, y: np.ndarray) -> list[float]:
        level = 0.8 if y[1] > 0 else 0.3
        return [y[1], (0.6 * np.cos(4 * t) - 0.05 * y[1] - level * np.tanh(y[1] / 0.02)) / J]

    exact = solve_ivp(rate, (0, 3), [0.4, 0.5], method="DOP853", rtol=1e-12, atol=1e-13, t_eval=result.time)
    close(result["qd"][:, 0], exact.y[1], 1e-8)
    assert result.summary["energy_drift"] < 1e-8


def test_coulomb_friction_needs_a_transition_speed() -> None:
    text = ONE.format(type="revolute", joint="friction: {coulomb: 1}", drives="", gravity="[0, 0, 0]", rate=0)
    error = failure(text)
    assert error.exit_code == 2 and "joint j" in error.message and "transition_speed" in error.message


@pytest.mark.parametrize(
    ("torque", "impulse"),
    [
        ("3*sin(5*t)", lambda t: 3 / 5 * (1 - np.cos(5 * t))),
        ("2 - t^2", lambda t: 2 * t - t**3 / 3),
        ("4*exp(-2*t)", lambda t: 2 * (1 - np.exp(-2 * t))),
        ("if(t < 1.2345, 5, -2)", lambda t: 5 * np.minimum(t, 1.2345) - 2 * np.maximum(t - 1.2345, 0)),
        ("step(t - 0.7)*3", lambda t: 3 * np.maximum(t - 0.7, 0)),
        ("abs(t - 1)", lambda t: 0.5 + (t - 1) * abs(t - 1) / 2),
        ("min(t, 2)", lambda t: np.where(t < 2, t**2 / 2, 2 * t - 2)),
        ("a*t + b", lambda t: t**2 - t),
        ("p.a*t + p.b", lambda t: t**2 - t),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_torque_formulas_in_time(torque: str, impulse: Any) -> None:
    result = one(drives=f'parameters: {{a: 2, b: -1}}\ntorques: {{j: "{torque}"}}')
    close(result["qd"][:, 0], impulse(result.time) / J, 1e-9)
    assert result.summary["energy_drift"] < 1e-8


@pytest.mark.parametrize("method", ["gauss", "dop853", "dopri5", "rodas5p"])
def test_a_pulse_shorter_than_any_step_is_not_missed(method: str) -> None:
    drives = 'torques: {j: "1000*(step(t - 1.23456) - step(t - 1.23556))"}'
    text = ONE.format(type="revolute", joint="", drives=drives, gravity="[0, 0, 0]", rate=0.5)
    result = run(text, f"simulate.integrator={method}")
    expected = 0.5 + np.clip(result.time - 1.23456, 0, 0.001) * 1000 / J
    close(result["qd"][:, 0], expected, 1e-8)
    assert result.summary["energy_drift"] < 1e-7


@pytest.mark.parametrize("method", ["gauss", "dop853"])
def test_a_square_wave(method: str) -> None:
    from scipy.integrate import quad

    text = ONE.format(
        type="revolute", joint="", gravity="[0, 0, 0]", rate=0, drives='torques: {j: "sign(sin(20*t))"}'
    )
    result = run(text, f"simulate.integrator={method}")
    half = np.pi / 20
    for k in range(0, 61, 12):
        t = float(result.time[k])
        whole, rest = divmod(t, 2 * half)
        close(result["qd"][k, 0], (rest if rest < half else 2 * half - rest) / J, 1e-9)
        assert whole >= 0 and quad(lambda x: x, 0, 1)[0] == 0.5


def test_a_force_that_switches_with_the_state() -> None:
    """A particle on a potential of two slopes: parabolas, joined where it crosses the kink."""
    result = one(drives='torques: {j: "if(q.j > 0, -3, 5)"}', rate=0.0)
    # from rest at 0.4 to zero, over to the other side and back: the period of a bouncing ball on both sides
    fall = np.sqrt(2 * 0.4 * J / 3)
    speed = 3 / J * fall
    other = speed / (5 / J)
    period = 2 * fall + 2 * other
    phase = result.time % period
    first = phase < fall
    last = phase >= period - fall
    q = np.where(first, 0.4 - 1.5 / J * phase**2, -speed * (phase - fall) + 2.5 / J * (phase - fall) ** 2)
    q = np.where(last, 0.4 - 1.5 / J * (period - phase) ** 2, q)
    close(result["q"][:, 0], q, 1e-9)
    assert result.summary["energy_drift"] < 1e-9 and result.summary["counters"]["events"] >= 4


def test_dry_friction_as_a_sign_passes_through_reversals() -> None:
    result = one("spring: {stiffness: 20}", 'torques: {j: "-0.3*sign(qd.j)"}')
    turns = result["q"][:, 0]
    # each half swing is a cosine about a centre that jumps by twice 0.3 / 20
    w, left, t = np.sqrt(20 / J), 0.4, result.time
    half = np.pi / w
    k = np.floor(t / half)
    amplitude = left - 0.015 * (2 * k + 1)
    exact = (-1) ** k * (amplitude * np.cos(w * (t - k * half)) + 0.015)
    close(turns, exact, 1e-9)


def test_a_joint_that_sticks_where_its_formula_jumps_is_an_error_that_says_so() -> None:
    text = ONE.format(
        type="revolute", joint="", drives='torques: {j: "-5*sign(qd.j)"}', gravity="[0, 0, 0]", rate=1
    )
    error = failure(text)
    assert isinstance(error, NumericalError) and error.details["time"] == pytest.approx(J / 5, abs=1e-6)
    assert "torques.j" in error.message and "tanh" in error.message
    assert error.result.time[-1] <= J / 5 + 1e-6  # type: ignore[attr-defined]


def test_torque_table_with_kinks() -> None:
    times, values = np.array([-1.0, 0.5, 0.75, 2.0]), np.array([0.0, 3.0, -2.0, 1.0])
    rows = ", ".join(f"[{t}, {x}]" for t, x in zip(times, values))
    result = one(drives=f"torques: {{j: {{table: [{rows}]}}}}")
    fine = np.unique(np.concatenate([np.linspace(0, 3, 60001), times]))
    fine = fine[fine >= 0]
    tau = np.interp(fine, times, values)  # held beyond the ends
    work = np.concatenate([[0], np.cumsum(0.5 * np.diff(fine) * (tau[1:] + tau[:-1]))])
    close(result["qd"][:, 0], np.interp(result.time, fine, work) / J, 1e-9)
    close(result["tau"][:, 0], np.interp(result.time, times, values), 1e-12)


def test_torque_that_depends_on_the_state() -> None:
    result = one(drives='torques: {j: "-3*q.j - 0.4*qd.j + k"}\nparameters: {k: 0.9}', rate=1.0)
    close(result["q"][:, 0], damped(result.time, J, 0.4, 3, 0.9, 0.4, 1.0), 1e-10)
    close(result["tau"][:, 0], -3 * result["q"][:, 0] - 0.4 * result["qd"][:, 0] + 0.9, 1e-12)


def test_stiff_spring_and_damper() -> None:
    result = one("spring: {stiffness: 1e6, rest: 0.4}, damper: {damping: 1e4}", "torques: {j: 100}")
    close(result["q"][:, 0], damped(result.time, J, 1e4, 1e6, 100 + 0.4e6, 0.4, 0.0), 1e-10)


# -- one mechanism, two ways of writing it ----------------------------------------------------------------
STANDARD = """
gravity: [0.5, -3, -9.81]
robot:
  convention: standard
  joints:
    - {name: a, type: revolute, a: 0.3, alpha: 1.1, d: 0.2}
    - {name: b, type: revolute, a: 0.5, alpha: -0.4, d: -0.1, offset: 0.3}
    - {name: c, type: prismatic, a: 0.1, alpha: 0.7, theta: 0.2, offset: 0.25}
    - {name: d, type: revolute, a: 0.2, alpha: 0, d: 0.15}
  links:
    - {name: l1, mass: 2, com: [0.1, 0.02, 0.03], com_frame: joint, inertia: {xx: 0.02, yy: 0.03, zz: 0.04, xy: 0.001}}
    - {name: l2, mass: 1.5, com: [0.2, 0.01, 0], com_frame: joint, inertia: {xx: 0.01, yy: 0.04, zz: 0.04, yz: 0.002}}
    - {name: l3, mass: 1, com: [0.1, 0, 0.1], com_frame: joint, inertia: {xx: 0.01, yy: 0.02, zz: 0.02}}
    - {name: l4, mass: 0.7, com: [0.05, 0.05, 0.05], com_frame: joint, inertia: {xx: 0.01, yy: 0.01, zz: 0.01}}
  points: {tip: {link: l4, at: end}}
torques: {a: "2*sin(t)", c: 12}
initial: {q: {a: 0.1, b: -0.2, c: 0.05, d: 1.0}, qd: {a: 0.3, d: -1}}
simulate: {duration: 1, samples: 21}
"""
# the same in Craig's convention: a and alpha belong to the axis before, d to the joint itself, so that what a
# link has is counted from a frame that is d (or, sliding, the offset) further along its axis
MODIFIED = """
gravity: [0.5, -3, -9.81]
robot:
  convention: modified
  joints:
    - {name: a, type: revolute, a: 0, alpha: 0, d: 0.2}
    - {name: b, type: revolute, a: 0.3, alpha: 1.1, d: -0.1, offset: 0.3}
    - {name: c, type: prismatic, a: 0.5, alpha: -0.4, theta: 0.2, offset: 0.25}
    - {name: d, type: revolute, a: 0.1, alpha: 0.7, d: 0.15}
  links:
    - {name: l1, mass: 2, com: [0.1, 0.02, -0.17], com_frame: link, inertia: {xx: 0.02, yy: 0.03, zz: 0.04, xy: 0.001}}
    - {name: l2, mass: 1.5, com: [0.2, 0.01, 0.1], com_frame: link, inertia: {xx: 0.01, yy: 0.04, zz: 0.04, yz: 0.002}}
    - {name: l3, mass: 1, com: [0.1, 0, 0.1], com_frame: link, inertia: {xx: 0.01, yy: 0.02, zz: 0.02}}
    - {name: l4, mass: 0.7, com: [0.05, 0.05, -0.1], com_frame: link, inertia: {xx: 0.01, yy: 0.01, zz: 0.01}}
  points: {tip: {link: l4, at: [0.2, 0, 0]}}
torques: {a: "2*sin(t)", c: 12}
initial: {q: {a: 0.1, b: -0.2, c: 0.05, d: 1.0}, qd: {a: 0.3, d: -1}}
simulate: {duration: 1, samples: 21}
"""


@pytest.fixture(scope="module")
def arm() -> Result:
    return run(STANDARD)


def same_motion(first: Result, second: Result, tolerance: float = 1e-9) -> None:
    for path in ("q", "qd", "qdd", "tau", "points/tip", "energy/kinetic"):
        close(first[path], second[path], tolerance)


def test_both_conventions_give_one_motion(arm: Result) -> None:
    same_motion(arm, run(MODIFIED))
    assert arm.summary["energy_drift"] < 1e-8


def test_a_tilted_base_is_turned_gravity(arm: Result) -> None:
    rpy = np.array([0.4, -0.7, 1.3])
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    R = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ [[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]
    R = R @ [[1, 0, 0], [0, cr, -sr], [0, sr, cr]]
    gravity = (R @ [0.5, -3, -9.81]).tolist()
    tilted = run(STANDARD, f"gravity={gravity}", f"robot.base={{rpy: {rpy.tolist()}, xyz: [1, 2, 3]}}")
    for path in ("q", "qd", "tau"):
        close(arm[path], tilted[path], 1e-9)
    close(tilted["points/tip"], arm["points/tip"] @ R.T + [1, 2, 3], 1e-9)


def test_origin_and_axis_say_the_same_as_dh() -> None:
    dh = run(
        """
gravity: [0, 0, -9.81]
robot:
  convention: standard
  joints:
    - {name: a, type: revolute, a: 0.4, alpha: 90 deg, d: 0}
    - {name: b, type: revolute, a: 0.3, alpha: 0, d: 0}
  links:
    - {name: l1, mass: 1, com: [0.2, 0, 0.1], com_frame: joint, inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
    - {name: l2, mass: 1, com: [0.1, 0, 0], com_frame: joint, inertia: {xx: 0.1, yy: 0.2, zz: 0.2}}
  points: {tip: {link: l2, at: end}}
initial: {q: {a: 0, b: 0.3}, qd: {a: 1}}
simulate: {duration: 1, samples: 11}
"""
    )
    placed = run(
        """
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 2]}
    - {name: b, type: revolute, axis: [0, -1, 0], origin: {xyz: [0.4, 0, 0]}}
  links:
    - {name: l1, mass: 1, com: [0.2, 0, 0.1], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
    - {name: l2, mass: 1, com: [0.1, 0, 0], inertia: {xx: 0.1, yy: 0.2, zz: 0.2}}
  points: {tip: {link: l2, at: [0.3, 0, 0]}}
initial: {q: {a: 0, b: 0.3}, qd: {a: 1}}
simulate: {duration: 1, samples: 11}
"""
    )
    same_motion(dh, placed)


WELDED = """
gravity: [0, -9.81, 0]
robot:
  joints:
    - {{name: j1, type: revolute, axis: [0, 0, 1]}}
    {weld}
    - {{name: j2, type: revolute, axis: [0, 0, 1], parent: {carrier}, link: l2, origin: {{xyz: {place}}}}}
  links:
    {links}
    - {{name: l2, mass: 1, com: [0.5, 0, 0], inertia: {{zz: 0.1}}}}
  points: {{tip: {{link: l2, at: [1, 0, 0]}}}}
initial: {{q: {{j1: 0.3, j2: -1}}}}
simulate: {{duration: 2, samples: 21}}
"""


def test_fixed_joints_weld() -> None:
    parts = run(
        WELDED.format(
            weld="- {name: w, type: fixed, parent: l1, link: arm, origin: {xyz: [0.7, 0.1, 0], rpy: [0, 0, 90 deg]}}",
            carrier="arm",
            place="[0.2, 0, 0]",
            links="- {name: l1, mass: 2, com: [0.3, 0, 0], inertia: {zz: 0.2}}\n"
            "    - {name: arm, mass: 3, com: [0.1, 0.2, 0], inertia: {zz: 0.3}}",
        )
    )
    # the second part in the frame of the first: turned by 90 deg about (0.7, 0.1)
    com = np.array([0.7, 0.1]) + [-0.2, 0.1]
    centre = (2 * np.array([0.3, 0]) + 3 * com) / 5
    inertia = 0.5 + 2 * np.sum((centre - [0.3, 0]) ** 2) + 3 * np.sum((centre - com) ** 2)
    whole = run(
        WELDED.format(
            weld="",
            carrier="l1",
            place="[0.7, 0.3, 0]",
            links=f"- {{name: l1, mass: 5, com: [{centre[0]}, {centre[1]}, 0], inertia: {{zz: {inertia}}}}}",
        )
    )
    # the second joint's zero is turned along with its carrier
    close(parts["qd"][0], whole["qd"][0], 0.0)
    whole = run(
        WELDED.format(
            weld="",
            carrier="l1",
            place="[0.7, 0.3, 0], rpy: [0, 0, 90 deg]",
            links=f"- {{name: l1, mass: 5, com: [{centre[0]}, {centre[1]}, 0], inertia: {{zz: {inertia}}}}}",
        )
    )
    same_motion(parts, whole)
    assert parts["q"].shape[1] == 2


def test_order_of_the_joints_is_that_of_the_columns() -> None:
    text = """
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: second, type: revolute, axis: [0, 0, 1], parent: upper, link: lower, origin: {xyz: [1, 0, 0]}}
    - {name: first, type: revolute, axis: [0, 0, 1], parent: base, link: upper}
  links:
    - {name: upper, mass: 12.456, com: [0.773, 0, 0], inertia: {zz: 1.042}}
    - {name: lower, mass: 12.456, com: [0.583, 0, 0], inertia: {zz: 1.042}}
initial: {q: {first: -90 deg, second: 45 deg}}
simulate: {duration: 10, samples: 3}
"""
    result = run(text)
    assert result.variables["q"].names == ("second", "first")
    close(result["q"][-1], THETA[::-1], 1e-8)


# -- trees, against absolute coordinates ------------------------------------------------------------------
TREE = """
gravity: [1, -9.81, 0]
robot:
  joints:
    - {name: trunk, type: revolute, axis: [0, 0, 1]}
    - {name: left, type: revolute, axis: [0, 0, 1], parent: body, link: la, origin: {xyz: [0.5, 0.2, 0]}}
    - {name: right, type: revolute, axis: [0, 0, 1], parent: body, link: ra, origin: {xyz: [0.5, -0.2, 0]}}
    - {name: hand, type: revolute, axis: [0, 0, 1], parent: la, link: lh, origin: {xyz: [0.4, 0, 0]}}
  links:
    - {name: body, mass: 4, com: [0.25, 0, 0], inertia: {zz: 0.3}}
    - {name: la, mass: 1, com: [0.2, 0, 0], inertia: {zz: 0.02}}
    - {name: ra, mass: 1.5, com: [0.25, 0.05, 0], inertia: {zz: 0.03}}
    - {name: lh, mass: 0.5, com: [0.1, 0, 0], inertia: {zz: 0.005}}
torques: {left: "2*sin(3*t)", hand: "-0.3*qd.hand", trunk: 4}
initial: {q: {trunk: -1.2, left: 0.5, right: -0.4, hand: 0.2}, qd: {right: 2}}
simulate: {duration: 1.5, samples: 16}
"""


def test_a_tree_with_branches() -> None:
    result = run(TREE)
    bodies = PlanarBodies(
        masses=[4, 1, 1.5, 0.5],
        inertias=[0.3, 0.02, 0.03, 0.005],
        pins=[
            Pin(GROUND, (0, 0), 0, (-0.25, 0)),
            Pin(0, (0.25, 0.2), 1, (-0.2, 0)),
            Pin(0, (0.25, -0.2), 2, (-0.25, -0.05)),
            Pin(1, (0.2, 0), 3, (-0.1, 0)),
        ],
        motors=[
            Motor(GROUND, 0, lambda t, a, w: 4.0),
            Motor(0, 1, lambda t, a, w: 2 * np.sin(3 * t)),
            Motor(1, 3, lambda t, a, w: -0.3 * w),
        ],
        gravity=(1, -9.81),
    )
    angles = np.array([-1.2, -0.7, -1.6, -0.5])
    rates = np.array([0, 0, 2.0, 0])
    trunk = turned(angles[0], (0.25, 0))
    shoulder = {1: turned(angles[0], (0.5, 0.2)), 2: turned(angles[0], (0.5, -0.2))}
    places = [trunk, shoulder[1] + turned(angles[1], (0.2, 0)), shoulder[2] + turned(angles[2], (0.25, 0.05))]
    places.append(shoulder[1] + turned(angles[1], (0.4, 0)) + turned(angles[3], (0.1, 0)))
    arm = turned(angles[2], (0.25, 0.05))
    v = np.zeros(12)
    v[6:9] = [-2 * arm[1], 2 * arm[0], 2.0]
    x = np.concatenate([[*p, a] for p, a in zip(places, angles)])
    eta, psi, _ = bodies.constraints(x, v)
    assert np.abs(eta).max() < 1e-12 and np.abs(psi @ v).max() < 1e-12
    moved, _ = bodies.run(x, v, result.time)
    absolute = moved[:, 2::3]
    relative = np.column_stack(
        [
            absolute[:, 0],
            absolute[:, 1] - absolute[:, 0],
            absolute[:, 2] - absolute[:, 0],
            absolute[:, 3] - absolute[:, 1],
        ]
    )
    assert rates[2] == result["qd"][0, 2]
    close(result["q"], relative, 1e-8)
    assert result.summary["energy_drift"] < 1e-8


# -- loops ------------------------------------------------------------------------------------------------
SLIDER = """
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: crank, type: revolute, a: 0.3, alpha: 0, d: 0}
    - {name: rod, type: revolute, a: 0.9, alpha: 0, d: 0}
    - {name: slide, type: prismatic, parent: base, link: piston, a: 0, alpha: 0, theta: 0, origin: {rpy: [0, 90 deg, 0]}}
  links:
    - {name: disc, mass: 3, com: [0.1, 0, 0], com_frame: joint, inertia: {zz: 0.2}}
    - {name: bar, mass: 1, com: [0.45, 0, 0], com_frame: joint, inertia: {zz: 0.07}}
    - {name: piston, mass: 2, com: [0, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
loops: [{name: pin, type: revolute, between: [bar.end, piston.origin], axis: [0, 0, 1], axis2: [-1, 0, 0]}]
torques: {crank: 5}
initial: {q: {crank: 0.2, rod: -0.3, slide: 1.1}, hold: [crank]}
simulate: {duration: 3, samples: 31}
"""


def test_slider_crank() -> None:
    result = run(SLIDER)
    bodies = PlanarBodies(
        masses=[3, 1, 2],
        inertias=[0.2, 0.07, 0.1],
        pins=[
            Pin(GROUND, (0, 0), 0, (-0.1, 0)),
            Pin(0, (0.2, 0), 1, (-0.45, 0)),
            Pin(1, (0.45, 0), 2, (0, 0)),
        ],
        slides=[Slide(2, (1, 0))],
        motors=[Motor(GROUND, 0, lambda t, a, w: 5.0)],
        gravity=(0, -9.81),
    )
    crank, rod, slide = result["q"][0]
    angles = [crank, crank + rod, 0.0]
    places = [turned(crank, (0.1, 0)), turned(crank, (0.3, 0)) + turned(angles[1], (0.45, 0)), (slide, 0.0)]
    x = np.concatenate([[*p, a] for p, a in zip(places, angles)])
    eta, _, _ = bodies.constraints(x, np.zeros(9))
    assert np.abs(eta).max() < 1e-12
    moved, _ = bodies.run(x, np.zeros(9), result.time)
    close(result["q"][:, [0, 2]], moved[:, [2, 6]], 1e-8)
    close(result["q"][:, 1], moved[:, 5] - moved[:, 2], 1e-8)
    assert result.summary["constraint_residual"]["position"] < 1e-14
    assert result.summary["energy_drift"] < 1e-7


# Watt's six-bar: two four-bars that share the rocker; the second loop also closes between two branches
SIX_BAR = """
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: crank, type: revolute, parent: base, a: 0.4, alpha: 0, d: 0}
    - {name: c1, type: revolute, parent: link1, a: 1.2, alpha: 0, d: 0}
    - {name: rocker, type: revolute, parent: base, a: 0.9, alpha: 0, d: 0, origin: {xyz: [1.0, 0, 0]}}
    - {name: c2, type: revolute, parent: link3, a: 1.1, alpha: 0, d: 0}
    - {name: out, type: revolute, parent: base, a: 0.8, alpha: 0, d: 0, origin: {xyz: [2.1, 0, 0]}}
  links:
    - {name: link1, mass: 2, com: [0.2, 0, 0], com_frame: joint, inertia: {zz: 0.05}}
    - {name: link2, mass: 1, com: [0.6, 0, 0], com_frame: joint, inertia: {zz: 0.12}}
    - {name: link3, mass: 1.5, com: [0.45, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
    - {name: link4, mass: 1, com: [0.55, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
    - {name: link5, mass: 1, com: [0.4, 0, 0], com_frame: joint, inertia: {zz: 0.06}}
loops:
  - {name: first, type: revolute, between: [link2.end, link3.end]}
  - {name: second, type: revolute, between: [link4.end, link5.end]}
torques: {crank: "6 - 0.5*qd.crank"}
initial: {q: {crank: 1.0, c1: -0.6, rocker: 1.4, c2: -1.4, out: 1.4}, hold: [crank]}
simulate: {duration: 2, samples: 21}
"""


def test_six_bar_with_two_loops() -> None:
    result = run(SIX_BAR)
    lengths, masses = [0.4, 1.2, 0.9, 1.1, 0.8], [2, 1, 1.5, 1, 1]
    bodies = PlanarBodies(
        masses=masses,
        inertias=[0.05, 0.12, 0.1, 0.1, 0.06],
        pins=[
            Pin(GROUND, (0, 0), 0, (-0.2, 0)),
            Pin(0, (0.2, 0), 1, (-0.6, 0)),
            Pin(GROUND, (1.0, 0), 2, (-0.45, 0)),
            Pin(2, (0.45, 0), 3, (-0.55, 0)),
            Pin(GROUND, (2.1, 0), 4, (-0.4, 0)),
            Pin(1, (0.6, 0), 2, (0.45, 0)),
            Pin(3, (0.55, 0), 4, (0.4, 0)),
        ],
        motors=[Motor(GROUND, 0, lambda t, a, w: 6.0 - 0.5 * w)],
        gravity=(0, -9.81),
    )

    def absolute(q: np.ndarray) -> np.ndarray:
        return np.array([q[0], q[0] + q[1], q[2], q[2] + q[3], q[4]])

    angles = absolute(result["q"][0])
    starts = [np.zeros(2), turned(angles[0], (0.4, 0)), np.array([1.0, 0]), None, np.array([2.1, 0])]
    starts[3] = starts[2] + turned(angles[2], (0.9, 0))
    x = np.concatenate([[*(s + turned(a, (l / 2, 0))), a] for s, a, l in zip(starts, angles, lengths)])
    eta, _, _ = bodies.constraints(x, np.zeros(15))
    assert np.abs(eta).max() < 1e-12
    moved, rates = bodies.run(x, np.zeros(15), result.time)
    close([absolute(q) for q in result["q"]], moved[:, 2::3], 1e-7)
    # the multipliers of our cuts are those of the last two pins
    for k in (0, 10, 20):
        _, lam = bodies.accelerations(result.time[k], moved[k], rates[k])
        close(result["constraints/multipliers"][k], lam[10:], 1e-6)
    assert result.summary["energy_drift"] < 1e-8
    assert result.variables["constraints/multipliers"].names == ("first.x", "first.y", "second.x", "second.y")


BRANCH = """
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {{name: carrier, type: revolute, parent: base, a: 0.5, alpha: 0, d: 0}}
    - {{name: crank, type: revolute, parent: frame, a: 0.3, alpha: 0, d: 0}}
    - {{name: coupler, type: revolute, parent: l1, a: 0.8, alpha: 0, d: 0}}
    - {{name: rocker, type: revolute, parent: frame, a: 0.5, alpha: 0, d: 0, origin: {{xyz: [0.7, 0, 0]}}}}
  links:
    - {{name: frame, mass: 3, com: [0.3, 0, 0], com_frame: joint, inertia: {{zz: 0.4}}}}
    - {{name: l1, mass: 1, com: [0.15, 0, 0], com_frame: joint, inertia: {{zz: 0.02}}}}
    - {{name: l2, mass: 1, com: [0.4, 0, 0], com_frame: joint, inertia: {{zz: 0.06}}}}
    - {{name: l3, mass: 1, com: [0.25, 0, 0], com_frame: joint, inertia: {{zz: 0.03}}}}
loops: [{{name: pin, type: revolute, between: {between}}}]
torques: {{crank: 1.5}}
initial: {{q: {{carrier: -1, crank: 0.8, coupler: -0.3, rocker: 1.2}}, hold: [carrier, crank]}}
simulate: {{duration: 1.5, samples: 16}}
"""


def test_a_loop_inside_a_branch() -> None:
    result = run(BRANCH.format(between="[l2.end, l3.end]"))
    bodies = PlanarBodies(
        masses=[3, 1, 1, 1],
        inertias=[0.4, 0.02, 0.06, 0.03],
        pins=[
            Pin(GROUND, (0, 0), 0, (-0.3, 0)),
            Pin(0, (0.2, 0), 1, (-0.15, 0)),
            Pin(1, (0.15, 0), 2, (-0.4, 0)),
            Pin(0, (0.9, 0), 3, (-0.25, 0)),
            Pin(2, (0.4, 0), 3, (0.25, 0)),
        ],
        motors=[Motor(0, 1, lambda t, a, w: 1.5)],
        gravity=(0, -9.81),
    )
    carrier, crank, coupler, rocker = result["q"][0]
    angles = np.array([carrier, carrier + crank, carrier + crank + coupler, carrier + rocker])
    end = turned(carrier, (0.5, 0))
    places = [
        turned(carrier, (0.3, 0)),
        end + turned(angles[1], (0.15, 0)),
        end + turned(angles[1], (0.3, 0)) + turned(angles[2], (0.4, 0)),
        turned(carrier, (1.2, 0)) + turned(angles[3], (0.25, 0)),
    ]
    x = np.concatenate([[*p, a] for p, a in zip(places, angles)])
    moved, _ = bodies.run(x, np.zeros(12), result.time)
    close(result["q"][:, 0], moved[:, 2], 1e-8)
    close(result["q"][:, 0] + result["q"][:, 3], moved[:, 11], 1e-8)


def test_the_order_of_between_turns_the_multipliers_and_nothing_else() -> None:
    one_way, other_way = (run(BRANCH.format(between=b)) for b in ("[l2.end, l3.end]", "[l3.end, l2.end]"))
    close(one_way["q"], other_way["q"], 1e-9)
    close(one_way["constraints/multipliers"], -other_way["constraints/multipliers"], 1e-7)


# a spatial loop with one degree of freedom against every count: three of its five rows are redundant
TWIST, SKEW = 0.5, 1.1
LONG = np.sin(SKEW) / np.sin(TWIST)
BENNETT = f"""
gravity: [0, 0, -9.81]
robot:
  convention: standard
  joints:
    - {{name: j1, type: revolute, a: 1, alpha: {TWIST}, d: 0}}
    - {{name: j2, type: revolute, a: {LONG}, alpha: {SKEW}, d: 0}}
    - {{name: j3, type: revolute, a: 1, alpha: {TWIST}, d: 0}}
  links:
    - {{name: l1, mass: 1, com: [0.5, 0, 0.1], com_frame: joint, inertia: {{xx: 0.01, yy: 0.1, zz: 0.1}}}}
    - {{name: l2, mass: 1, com: [0.5, 0, 0.1], com_frame: joint, inertia: {{xx: 0.01, yy: 0.1, zz: 0.1}}}}
    - {{name: l3, mass: 1, com: [0.5, 0, 0.1], com_frame: joint, inertia: {{xx: 0.01, yy: 0.1, zz: 0.1}}}}
  points: {{anchor: {{link: base, at: [{-LONG}, 0, 0]}}}}
loops:
  - name: ring
    type: revolute
    between: [l3.end, base.anchor]
    axis2: [0, {np.sin(SKEW)}, {np.cos(SKEW)}]
initial: {{q: {{j1: 1.0}}, hold: [j1]}}
simulate: {{duration: 5, samples: 101}}
"""


def test_bennett_linkage() -> None:
    result = run(BENNETT)
    assembly = result.summary["assembly"]
    assert len(assembly["redundant_rows"]) == 3 and not assembly["vanishing_rows"]
    q = result["q"]
    # Bennett (1903): opposite angles are equal, and neighbours satisfy tan tan = const
    close(q[:, 0] + q[:, 2], 0.0, 1e-12)
    ratio = np.sin((SKEW + TWIST) / 2) / np.sin((SKEW - TWIST) / 2)
    close(np.tan(q[:, 0] / 2) * np.tan(q[:, 1] / 2), ratio, 1e-8)
    assert np.ptp(q[:, 0]) > 1.0 and result.summary["energy_drift"] < 1e-7


def test_a_planar_loop_tilted_in_space_moves_as_in_its_plane(tmp_path: Path) -> None:
    text = (CONFIGS / "robots" / "four_bar.yaml").read_text()
    text = text.replace("parent: base, a: 1.241", "parent: base, origin: {rpy: [0.5, 0.3, 0]}, a: 1.241")
    foot = np.array([np.cos(0.3), 0, -np.sin(0.3)]) * 1.241
    text = text.replace(
        "origin: {xyz: [1.241, 0, 0]}", f"origin: {{xyz: {foot.tolist()}, rpy: [0.5, 0.3, 0]}}"
    )
    for zz in ("9.6", "0.06"):
        text = text.replace(f"{{zz: {zz}}}", f"{{xx: 0, yy: {zz}, zz: {zz}}}")
    (tmp_path / "tilted.yaml").write_text(text)
    overrides = ["simulate.duration=6", "simulate.samples=13"]
    flat = simulate(load_scene(CONFIGS / "four_bar_deploy.yaml", overrides))
    tilted = simulate(
        load_scene(CONFIGS / "four_bar_deploy.yaml", [*overrides, f"robot={tmp_path}/tilted.yaml"])
    )
    close(flat["q"], tilted["q"], 1e-10)
    assert len(tilted.summary["assembly"]["redundant_rows"]) == 3
    assert len(flat.summary["assembly"]["vanishing_rows"]) == 3
    assert not flat.summary["assembly"]["redundant_rows"]


@pytest.mark.parametrize("stabilisation", ["none", "{alpha: 10, beta: 10}", "{alpha: 0, beta: 0}"])
def test_stabilisations_give_the_motion_of_projection(stabilisation: str) -> None:
    overrides = ["simulate.duration=10", "simulate.samples=21"]
    scene = CONFIGS / "four_bar_deploy.yaml"
    projected = simulate(load_scene(scene, overrides))
    other = simulate(load_scene(scene, [*overrides, f"simulate.stabilisation={stabilisation}"]))
    close(projected["q"], other["q"], 1e-8)
    assert projected.summary["constraint_residual"]["position"] < 1e-14
    assert other.summary["constraint_residual"]["position"] < 1e-8


def test_drift_of_the_loops_is_reported_where_nothing_holds_them() -> None:
    scene = load_scene(
        CONFIGS / "four_bar_deploy.yaml",
        ["simulate.duration=10", "simulate.rtol=1e-4", "simulate.atol=1e-5", "simulate.stabilisation=none",
         "simulate.integrator=dopri5"],
    )  # fmt: skip
    result = simulate(scene)
    residual = np.abs(result["constraints/position_residual"]).max()
    assert residual > 1e-8
    assert result.summary["constraint_residual"]["position"] == residual


# -- prescribed joints ------------------------------------------------------------------------------------
DRIVEN = """
gravity: [0, -9.81, 0]
robot: {robot}
prescribed: {{theta1: "0.5*sin(2*t) - 1"}}
torques: {{theta2: "3*cos(t)"}}
initial: {{q: {{theta2: 0.3}}}}
simulate: {{duration: 4, samples: 81}}
"""


def test_a_prescribed_joint_follows_and_its_torque_is_that_of_inverse_dynamics() -> None:
    robot = CONFIGS / "robots" / "planar_2r.yaml"
    result = run(DRIVEN.format(robot=robot))
    t = result.time
    close(result["q"][:, 0], 0.5 * np.sin(2 * t) - 1, 1e-13)
    close(result["qd"][:, 0], np.cos(2 * t), 1e-12)
    close(result["qdd"][:, 0], -2 * np.sin(2 * t), 1e-11)
    arm = load_scene_text(f"schema: 1\ngravity: [0, -9.81, 0]\nrobot: {robot}\n")
    tau = InverseDynamics(arm)(result["q"], result["qd"], result["qdd"])
    close(result["tau"], tau, 1e-9)
    close(result["tau"][:, 1], 3 * np.cos(t), 1e-12)
    assert result.summary["energy_drift"] < 1e-8 * np.abs(result["energy/work"]).max()


def test_all_joints_prescribed_is_inverse_dynamics() -> None:
    robot = CONFIGS / "robots" / "planar_2r.yaml"
    text = DRIVEN.format(robot=robot).replace('torques: {theta2: "3*cos(t)"}', "")
    text = text.replace('- 1"}', '- 1", theta2: "0.3 + t"}')
    result = run(text)
    close(result["q"][:, 1], 0.3 + result.time, 1e-13)
    arm = load_scene_text(f"schema: 1\ngravity: [0, -9.81, 0]\nrobot: {robot}\n")
    close(result["tau"], InverseDynamics(arm)(result["q"], result["qd"], result["qdd"]), 1e-9)


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("{theta2: 0.3}", "{theta1: 0.2, theta2: 0.3}", 2, ("initial.q.theta1", "0.2", "-1")),
        ("0.5*sin(2*t) - 1", "sqrt(t)", 3, ("prescribed.theta1", "rate")),
        ("0.5*sin(2*t) - 1", "1/t", 3, ("prescribed.theta1", "t = 0")),
        ("0.5*sin(2*t) - 1", "t^1.5", 3, ("prescribed.theta1", "acceleration")),
        ("{theta2: 0.3}}", "{theta2: 0.3}, qd: {theta1: 5}}", 5, ("rates", "prescribed.theta1", "rad/s")),
        ("0.5*sin(2*t) - 1", "1/(t - 2)^2", 3, ("t = ",)),
        ("0.5*sin(2*t) - 1", "abs(t - 1)", 2, ("prescribed.theta1", "rate", "t = 1 s", "from -1 to 1")),
        ("0.5*sin(2*t) - 1", "if(t < 1.5, 0, 0.2)", 2, ("prescribed.theta1", "position", "t = 1.5 s")),
        ("0.5*sin(2*t) - 1", "min(t, 3)", 2, ("rate", "t = 3 s")),
    ],
)
def test_prescribed_motion_that_cannot_be(old: str, new: str, code: int, words: tuple[str, ...]) -> None:
    text = DRIVEN.format(robot=CONFIGS / "robots" / "planar_2r.yaml")
    assert text.count(old) == 1
    error = failure(text.replace(old, new), "simulate.max_steps=20000")
    assert error.exit_code == code, error.message
    for word in words:
        assert word in error.message


@pytest.mark.parametrize(
    "motion", ["if(t < 1, 0, (t - 1)^2)", "max(t - 1, 0)^3", "abs(sin(t))^3", "abs(t - 5)"]
)
def test_prescribed_motions_may_have_kinks_in_their_acceleration(motion: str) -> None:
    text = DRIVEN.format(robot=CONFIGS / "robots" / "planar_2r.yaml").replace("0.5*sin(2*t) - 1", motion)
    result = run(text)
    assert result.summary["energy_drift"] < 1e-7 * max(1.0, np.abs(result["energy/work"]).max())
    assert result.summary["error_estimate"]["state_max"] < 1e-8


def test_a_crank_driven_through_the_dead_point_names_it() -> None:
    with pytest.raises(SingularConfigurationError) as caught:
        simulate(load_scene(CONFIGS / "four_bar_prescribed.yaml"))
    error = caught.value
    assert "dead point" in error.message and "theta1" in error.message
    crank = 2 * np.arcsin(1.2 / 1.241)
    assert error.details["time"] == pytest.approx(np.sqrt((crank - 0.01) / 0.02), abs=1e-9)
    result = error.result  # type: ignore[attr-defined]
    assert result.status == "failed" and 11.0 < result.time[-1] <= error.details["time"]


# -- what must fail, and how ------------------------------------------------------------------------------
BARE = """
gravity: [0, -9.81, 0]
robot:
  joints:
    - {{name: j1, type: revolute, axis: [0, 0, 1]}}
    - {{name: j2, type: {kind}, axis: {axis}, origin: {{xyz: [1, 0, 0]}}{more}}}
  links:
    - {{name: l1, {first}}}
    - {{name: l2, {second}}}
initial: {{q: {{j1: -1, j2: {angle}}}}}
simulate: {{duration: 1, samples: 11}}
"""
SOLID = "mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.1}"
POINT = "mass: 1, com: [1, 0, 0], inertia: {zz: 0}"


def bare(
    first: str,
    second: str,
    kind: str = "revolute",
    axis: str = "[0, 0, 1]",
    angle: float = 0.3,
    more: str = "",
) -> str:
    return BARE.format(first=first, second=second, kind=kind, axis=axis, angle=angle, more=more)


@pytest.mark.parametrize(
    ("text", "joint"),
    [
        (bare("mass: 0", "mass: 0"), "j2"),
        (bare(SOLID, "mass: 0"), "j2"),
        (bare(SOLID, "mass: 0", kind="prismatic", axis="[1, 0, 0]"), "j2"),
        (bare(SOLID, "mass: 2, com: [0, 0, 0], inertia: {zz: 0}"), "j2"),  # all mass on the axis
        (bare("mass: 0", POINT, angle=0.0), "j1"),  # a point mass at full stretch
        (bare("mass: 0", POINT, angle=np.pi), "j1"),
    ],
)
def test_a_singular_mass_matrix_names_the_joint(text: str, joint: str) -> None:
    error = failure(text)
    assert isinstance(error, NumericalError) and error.exit_code == 3
    assert f"joint {joint!r}" in error.message and "singular" in error.message
    assert error.details["joint"] == joint


@pytest.mark.parametrize(
    "text",
    [
        bare("mass: 0", SOLID),  # the mass further out suffices
        bare("mass: 0", POINT),
        bare(SOLID, "mass: 0", more=", rotor_inertia: 0.01"),
        bare(SOLID, "mass: 0", more=", rotor_inertia: 1e-6, gear_ratio: 100"),
    ],
)
def test_massless_links_that_are_no_trouble(text: str) -> None:
    result = run(text, "simulate.duration=0.05")
    assert np.all(np.isfinite(result["qdd"])) and result.summary["energy_drift"] < 1e-9


def test_a_mass_matrix_that_becomes_singular_is_to_blame() -> None:
    error = failure(bare("mass: 0", POINT))
    assert error.exit_code == 3 and "mass matrix" in error.message and "'j1'" in error.message


@pytest.mark.parametrize(
    ("torque", "time"),
    [
        ("100*exp(q.j1*q.j1)", None),
        ("1/(1 - t)", 1.0),
        ("sqrt(0.5 - t)", 0.5),
        ("1/t", 0.0),
        ("tan(t*pi)", 0.5),
    ],
)
def test_a_motion_that_blows_up_keeps_what_came_before(torque: str, time: float | None) -> None:
    text = bare(SOLID, SOLID) + f'torques: {{j1: "{torque}"}}\n'
    error = failure(text, "simulate.duration=2", "simulate.samples=201")
    assert isinstance(error, NumericalError) and "t = " in error.message
    result = error.result  # type: ignore[attr-defined]
    assert result.status == "failed" and result.summary["termination"]["reason"] == error.message
    times = result.time
    assert len({v.data.shape[0] for v in result.variables.values()}) == 1
    assert np.all(np.isfinite(result["q"])) and np.all(np.diff(times) > 0)
    if time is not None:
        assert times[-1] == pytest.approx(time, abs=1e-6) and error.details["time"] == pytest.approx(
            time, abs=1e-6
        )


def test_too_many_steps() -> None:
    with pytest.raises(NumericalError, match="more than 7 steps"):
        pendulum("simulate.max_steps=7")


def test_an_open_chain_needs_all_positions() -> None:
    with pytest.raises(SceneError, match="'j2' has no initial position"):
        run(bare(SOLID, SOLID).replace(", j2: 0.3", ""))


def test_unknown_data_are_named() -> None:
    with pytest.raises(SceneError, match=r"mass of l1"):
        run(bare("com: [0.5, 0, 0], inertia: {zz: 0.1}", SOLID))


def test_the_parallelogram_stops_at_its_flat_pose_unless_told_to_pass() -> None:
    scene = CONFIGS / "parallelogram.yaml"
    with pytest.raises(SingularConfigurationError) as caught:
        simulate(load_scene(scene))
    # constant torque on a constant inertia: crank, follower, and the coupler at the cranks' ends
    exact = np.sqrt(2 * np.radians(150) * (1 / 3 + 1 / 3 + 2))
    assert caught.value.details["time"] == pytest.approx(exact, abs=1e-7)
    assert caught.value.exit_code == 4 and "simulate.singular" in caught.value.message
    passed = simulate(load_scene(scene, ["simulate.singular=pass", "simulate.error_estimate=false"]))
    assert passed.time[-1] == 5.0


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_sizes_of_clocks_and_of_bridges(scale: float) -> None:
    """Lengths, masses and times scaled together give the same angles."""
    mass, inertia = scale**3, scale**5
    text = f"""
gravity: [0, {-9.81 * scale}, 0]
robot:
  joints:
    - {{name: j1, type: revolute, axis: [0, 0, 1]}}
    - {{name: j2, type: revolute, axis: [0, 0, 1], origin: {{xyz: [{scale}, 0, 0]}}}}
  links:
    - {{name: l1, mass: {12.456 * mass}, com: [{0.773 * scale}, 0, 0], inertia: {{zz: {1.042 * inertia}}}}}
    - {{name: l2, mass: {12.456 * mass}, com: [{0.583 * scale}, 0, 0], inertia: {{zz: {1.042 * inertia}}}}}
initial: {{q: {{j1: -90 deg, j2: 45 deg}}}}
simulate: {{duration: 10, samples: 3}}
"""
    close(run(text)["q"][-1], THETA, 1e-8)
