"""Forward dynamics of open chains against closed forms, and its own error estimate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene, simulate
from robodyn_cli.errors import NumericalError, SceneError, SingularConfigurationError
from robodyn_cli.results.result import Result
from tests.mechanisms import (
    CONFIGS,
    close,
    failure,
    pendulum,
    run,
)

# the double pendulum after 10 s in extended precision
THETA = (-1.62889639534037, 0.47749300648073)
RATES = (-1.42990244445507, 2.56888649044476)


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


@pytest.mark.parametrize("step", [4e-3, 1e-3, 0.3, 100.0])
def test_error_estimate_of_fixed_steps(step: float, exact: Result) -> None:
    short = ("simulate.duration=0.5", "simulate.samples=11")
    result = pendulum(
        "simulate.integrator=rk4",
        f"simulate.step={step}",
        *(short if step > 0.1 else ("simulate.samples=201",)),
    )
    reference = exact if step < 0.1 else pendulum(*short)
    true = max(float(np.abs(result[path] - reference[path]).max()) for path in ("q", "qd"))
    assert true / 3 <= result.summary["error_estimate"]["state_max"] <= 3 * true


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
    close(few["q"][-1], many["q"][-1], 1e-12)


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


@pytest.mark.parametrize(
    ("joint", "gravity", "given"),
    [
        ("type: prismatic, axis: [1, 0, 0]", "[0, -9.81, 0]", ""),
        ("type: prismatic, axis: [0, 1, 0]", "[0, -9.81, 0]", ""),
        ("type: prismatic, axis: [1, 2, 2]", "[3, -9.81, 2]", ""),
        ("type: revolute, axis: [0, 0, 1]", "[0, 0, -9.81]", ", inertia: {zz: 0.1}, com: [0, 0, 0]"),
    ],
)
def test_data_that_the_motion_does_without_need_not_be_given(joint: str, gravity: str, given: str) -> None:
    """A cart has a mass and no more: where its centre lies shifts the potential energy by a constant."""
    text = f"""
gravity: {gravity}
robot:
  joints: [{{name: x, {joint}}}]
  links: [{{name: cart, mass: 2{given}}}]
initial: {{q: {{x: 0.1}}, qd: {{x: 0.3}}}}
simulate: {{duration: 0.5, samples: 11}}
"""
    found = run(text)
    whole = run(text.replace("mass: 2", "mass: 2, com: [0.4, 0.5, 0.6]") if not given else text)
    assert np.abs(found["q"] - whole["q"]).max() < 1e-12
    energy, other = found["energy/total"], whole["energy/total"]
    assert np.abs(np.ptp(energy)) < 1e-9 and np.abs((energy - energy[0]) - (other - other[0])).max() < 1e-9


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
