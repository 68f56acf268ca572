"""Stability regions, spectra, energy growth, Baumgarte's gains, and the report as a whole."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene, load_scene_text, simulate
from robodyn_cli.errors import CapabilityError, NumericalError, SceneError
from robodyn_cli.integration_methods import REPRESENTATIVES
from robodyn_cli.integrators.methods.explicit import DOP853, DOPRI5, RK4
from robodyn_cli.integrators.methods.stability_region import amplification, limits, radius
from robodyn_cli.integrators.registry import methods as registry
from robodyn_cli.motion.baumgarte import GainStudy
from robodyn_cli.motion.build import projected_motion
from robodyn_cli.over.stability import energy_growth
from robodyn_cli.over.stability.energy_growth import growth, growths, period
from robodyn_cli.over.stability.scenes import arm, slider
from robodyn_cli.over.stability.spectrum import Spectrum, reach
from robodyn_cli.over.stability.stability import along, at_start, stability, step_limits
from robodyn_cli.over.stability.trial import Budget, attempt, reference
from robodyn_cli.over.work_precision.work_precision import formulations
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.results.result import Result

CONFIGS = Path(__file__).parents[2] / "configs"
FEW = Budget(100_000, 5.0)
SPRING = slider("Mass on a spring", 50.0, 1.0, "-100*y", "{q: {y: 0.1}}", gravity="[0, 0, 0]")


def test_amplification_is_the_exponential_up_to_the_order() -> None:
    z = np.array([0.02 + 0.03j, -0.05, 0.04j])
    for table in (DOP853, DOPRI5, RK4):
        next_term = np.abs(z) ** (table.order + 1) / math.factorial(table.order + 1)
        assert np.all(np.abs(amplification(table, z) - np.exp(z)) < 2.0 * next_term + 1e-15)


def test_extents_of_regions_are_those_of_the_literature() -> None:
    # classical method: Hairer and Wanner (1996), IV.2, and 2 sqrt 2; DOPRI5 3.3; DOP853 some 6
    assert radius(RK4, -1.0)[0] == pytest.approx(2.785293563405282, abs=1e-6)
    assert radius(RK4, 1j)[0] == pytest.approx(2.0 * math.sqrt(2.0), abs=1e-6)
    assert radius(DOPRI5, -1.0)[0] == pytest.approx(3.3066, abs=1e-3)
    assert radius(DOP853, -1.0)[0] == pytest.approx(6.39, abs=1e-2)
    for table in (DOP853, DOPRI5, RK4):
        r = radius(table, np.exp(1j * np.linspace(0.6, 1.0, 9) * math.pi))
        inside = 0.999 * r * np.exp(1j * np.linspace(0.6, 1.0, 9) * math.pi)
        assert np.all(np.abs(amplification(table, inside)) <= 1.0 + 1e-8)


OSCILLATOR = slider("Oscillator", 10.0, 2.0, "-50*y - 4*qd.y", "{q: {y: 0.1}}", gravity="[0, 0, 0]")


def test_spectrum_of_a_damped_oscillator() -> None:
    # m = 2, c = 4, k = 50: lambda = -1 +- sqrt(1 - 25)
    found = at_start(prepare(load_scene_text(OSCILLATOR)))
    assert found is not None
    expected = -1.0 + 1j * math.sqrt(24.0)
    assert (
        np.abs(np.sort_complex(found.eigenvalues[0]) - np.array([expected.conjugate(), expected])).max()
        < 1e-12
    )
    assert found.fastest_decay == pytest.approx(1.0) and found.stiffness_ratio == pytest.approx(1.0 / 5.0)
    steps = {x.method: h for x, h in zip(limits(), found.step_limits[0])}
    direction = expected / abs(expected)
    assert steps["rk4"] == pytest.approx(radius(RK4, direction)[0] / 5.0, rel=1e-9)


def test_the_step_limit_is_where_a_fixed_step_breaks_down() -> None:
    stiff = load_scene_text(
        slider("Overdamped", 2.0, 1.0, "-100*y - 200*qd.y", "{q: {y: 0.1}}", gravity="[0, 0, 0]")
    )
    found = at_start(prepare(stiff))
    assert found is not None
    limit = next(x for x in limits() if x.method == "rk4").largest_step(found.eigenvalues[0])
    below, above = (attempt_fixed(stiff, factor * limit) for factor in (0.98, 1.05))
    assert below < 1e-1 < 1e3 < above


def cart_pole(mass: float) -> str:
    """A light cart is thrown to and fro within sqrt(mass) of each passage of its pole below."""
    return f"""
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {{name: x, type: prismatic, axis: [1, 0, 0]}}
    - {{name: q, type: revolute, axis: [0, 1, 0]}}
  links:
    - {{name: cart, mass: {mass}}}
    - {{name: pole, mass: 1, com: [0, 0, -1], inertia: {{yy: 0}}}}
initial: {{q: {{x: 0, q: 1.2}}, qd: {{x: 0, q: 0}}}}
simulate: {{duration: 1.5}}
"""


def fixed_steps(scene: Any, method: str, step: float) -> tuple[int, int]:
    """Return how many steps were cut, and how many were taken."""
    options = dataclasses.replace(scene.simulate, integrator=method, step=step, error_estimate=False)
    counters = simulate(dataclasses.replace(scene, simulate=options)).summary["counters"]
    return counters["rejected"], counters["steps"]


@pytest.mark.parametrize("name", ["1e-3", "tumbling_body", "four_bar_deploy"])
def test_a_given_step_below_the_limit_of_its_iteration_is_never_cut(name: str) -> None:
    """At three times the limit steps are cut, and at half of it none is, however short the spike that decides."""
    light = name == "1e-3"
    scene = load_scene_text(cart_pole(1e-3)) if light else load_scene(CONFIGS / f"{name}.yaml")
    scene = dataclasses.replace(scene, simulate=dataclasses.replace(scene.simulate, duration=1.0))
    setup = prepare(scene)
    ref = reference(scene, FEW)
    assert ref is not None
    found = along(setup, ref)
    for limit in step_limits(found):
        if limit.method in ("gauss4", "implicit_midpoint"):
            assert limit.largest_step is not None
            assert fixed_steps(scene, limit.method, 0.5 * limit.largest_step)[0] == 0
            assert fixed_steps(scene, limit.method, 3.0 * limit.largest_step)[0] > 0


def test_data_that_are_missing_are_named() -> None:
    chain = "[{name: a, type: revolute, axis: [0, 0, 1]}, {name: b, type: prismatic, axis: [1, 0, 0]}]"
    robot = f"{{joints: {chain}, links: [{{name: l, mass: 1}}, {{name: m}}]}}"
    initial = "{q: {a: 0, b: 1}, qd: {a: 1}}"
    scene = load_scene_text(f"{{schema: 1, gravity: [0, 0, 0], robot: {robot}, initial: {initial}}}")
    with pytest.raises(SceneError, match="mass of m"):
        stability(scene, quick=True)


@pytest.mark.filterwarnings("error")
def test_iterations_of_rates_that_depend_on_nothing_have_no_limit() -> None:
    still = np.zeros((1, 2, 2))
    spring = np.array([[[0.0, 1.0], [-4.0, 0.0]]])
    damper = np.array([[[0.0, 1.0], [0.0, -5.0]]])
    slowly, fast = 1e-100 * damper, 1e120 * damper
    found = reach(np.concatenate([still, spring, damper, slowly, fast]), 1, 0.1)
    # s^2 4 = 0.1 and s 5 = 0.1
    expected = [math.sqrt(0.1 / 4.0), 0.1 / 5.0, 0.1 / 5e-100, 0.1 / 5e120]
    assert found[0] == np.inf and found[1:] == pytest.approx(expected, rel=1e-5)


def test_spikes_between_samples_are_seen() -> None:
    """The fastest rate of the motion goes as one over the mass of the cart, and lasts as short."""
    rates = []
    for mass in (1e-3, 1e-6):
        scene = load_scene_text(cart_pole(mass))
        ref = reference(scene, FEW)
        assert ref is not None
        found = along(prepare(scene), ref)
        assert found is not None
        rates.append(np.abs(found.eigenvalues).max() * mass)
    assert rates[1] == pytest.approx(rates[0], rel=0.1)


def attempt_fixed(scene, step: float) -> float:  # type: ignore[no-untyped-def]
    import dataclasses

    options = dataclasses.replace(scene.simulate, integrator="rk4", step=step, error_estimate=False)
    result = simulate(dataclasses.replace(scene, simulate=options))
    return float(np.abs(result["qd"][-1]).max())


def test_spectrum_of_a_four_bar_has_no_modes_across_its_constraints() -> None:
    setup = prepare(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    found = at_start(setup)
    assert found is not None and found.eigenvalues.shape == (1, 2)  # one degree of freedom
    # the one mode left: reduced mass and its derivative, by differences of the motion along the constraint
    assert np.all(np.isfinite(found.eigenvalues))


def test_spectrum_of_a_long_chain_agrees_with_the_exact_jacobian() -> None:
    from robodyn_cli.formulations.build import build_system
    from robodyn_cli.over.stability.scenes import chain
    from robodyn_cli.over.stability.spectrum import jacobians

    n = 31
    scene = load_scene_text(chain("chain", 1.0, [0.1] * n, [0.1] * n, {"q1": -1.0, "q7": 0.3}))
    setup = prepare(scene)
    x = np.concatenate([setup.assembled.q, setup.assembled.v + 0.1])[None, :]
    rolled = build_system(setup.problem, work=False)
    found = jacobians(setup.problem, rolled, np.zeros(1), x)[0]
    exact = jacobians(setup.problem, build_system(setup.problem, work=False, expanded=True), np.zeros(1), x)[
        0
    ]
    assert type(rolled.dynamics).__name__ == "Rolled"
    assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max()


def test_period_of_a_pendulum_and_growth_of_its_energy() -> None:
    scene = load_scene(CONFIGS / "benchmarks" / "simple_pendulum.yaml")
    ref = reference(scene, FEW)
    assert ref is not None and ref.digits > 10
    long = period(ref, None, scene.simulate.duration)
    found = {m: growth(scene, m, 1000 * long.seconds, Budget(2_000_000, 20.0)) for m in ("gauss", "dop853")}
    drift = found["dop853"].exponent
    assert drift is not None and abs(drift - 1.0) < 0.1  # not symplectic: the energy drifts steadily
    assert found["gauss"].largest < 1e-11 and (found["gauss"].exponent or 0.0) < 0.85  # rounding only


def test_slow_methods_are_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five times the fastest so far, but never less than two seconds nor more than the budget."""
    took = {"gauss": 1.0, "bdf": 4.0, "rk4": 0.01, "radau": 2.0}
    given = {}

    def faked(scene: Any, method: str, duration: float, budget: Budget) -> energy_growth.Growth:
        given[method] = budget.seconds
        status = "ok" if took[method] <= budget.seconds else "too_slow"
        return energy_growth.Growth(method, status, np.zeros(0), np.zeros(0), 0.0, 0, took[method])

    monkeypatch.setattr(energy_growth, "growth", faked)
    found = growths(load_scene_text(SPRING), list(took), 1.0, Budget(100, 15.0))
    assert given == {"gauss": 15.0, "bdf": 5.0, "rk4": 5.0, "radau": 2.0}
    assert [g.status for g in found] == ["ok"] * 4


def test_a_run_that_is_cut_off_keeps_its_samples() -> None:
    """Whoever is told the progress may end a run; the growth of its error is then known up to there."""
    scene = load_scene_text(SPRING, overrides=["simulate.integrator=rk4", "simulate.step=1e-5"])

    def enough(time: float, duration: float) -> None:
        if time > 1.0:
            raise NumericalError("enough", time=time)

    with pytest.raises(NumericalError, match="enough") as caught:
        simulate(scene, progress=enough)
    times = caught.value.result.time  # type: ignore[attr-defined]
    assert times[-1] > 1.0 and len(times) > 20 and np.diff(times).max() < 0.06


def test_automatic_gains_are_the_smallest_that_keep_the_drift_below_the_error() -> None:
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml", ["simulate.rtol=1e-6", "simulate.atol=1e-8"])
    found = GainStudy(projected_motion(scene))
    chosen = found.choose()
    assert chosen.met and chosen.drift <= chosen.integration_error
    assert chosen.alpha == chosen.beta == pytest.approx(chosen.factor / chosen.step)
    assert (
        chosen.factor == 2.0**-12
        or found.outcome(chosen.alpha / 2, chosen.beta / 2).drift > chosen.integration_error
    )


def test_fixed_steps_limit_the_gains_as_the_stability_region_says() -> None:
    scene = load_scene(
        CONFIGS / "four_bar_deploy.yaml",
        ["simulate.integrator=rk4", "simulate.step=0.02", "simulate.duration=10"],
    )
    found = GainStudy(projected_motion(scene))
    # the drift's modes are -alpha +- sqrt(alpha^2 - beta^2): with beta small the fast one is -2 alpha
    limit = 2.785 / (2.0 * 0.02)
    assert (
        np.isfinite(found.outcome(0.95 * limit, 1.0).drift) and found.outcome(0.95 * limit, 1.0).drift < 1e-2
    )
    assert not found.outcome(1.1 * limit, 1.0).drift < 1e-2


def test_baumgarte_without_gains() -> None:
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml", ["simulate.stabilisation=baumgarte"])
    result = simulate(scene)
    plain = simulate(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    assert result.summary["baumgarte"]["met"]
    assert result.summary["constraint_residual"]["position"] < 1e-10
    assert np.abs(result["q"] - plain["q"]).max() < 1e-9


@pytest.mark.parametrize("integrator", ["rk4"])
def test_a_breakdown_names_time_joint_and_quantity(integrator: str) -> None:
    text = arm("stiff", 10.0, second=", spring: {stiffness: 1e6}, damper: {damping: 1e4}")
    scene = load_scene_text(text.replace("samples: 1001", "samples: 101, integrator: rk4, step: 0.01"))
    with pytest.raises(NumericalError) as caught:
        simulate(scene)
    details = caught.value.details
    assert details["time"] > 0.0 and details["joint"] in ("theta1", "theta2") and details["quantity"]
    assert details["joint"] in caught.value.message
    kept = caught.value.result
    assert isinstance(kept, Result)
    assert kept.status == "failed" and np.all(np.isfinite(kept["q"]))


def test_trials_tell_what_methods_do() -> None:
    scene = load_scene_text(arm("stiff", 10.0, second=", spring: {stiffness: 1e6}, damper: {damping: 1e4}"))
    ref = reference(scene, FEW, stiff=True)
    assert ref is not None
    found = {m: attempt(scene, m, ref, Budget(5_000, 5.0)) for m in ("auto", "rodas5p", "dop853", "rk4")}
    assert found["auto"].status == found["rodas5p"].status == "stable"
    assert found["dop853"].status == "too_slow" and found["rk4"].status == "diverged"
    assert (
        found["rk4"].joint is not None
        and found["auto"].relative is not None
        and found["auto"].relative < 1e-6
    )


@pytest.mark.parametrize("method", ["rodas5p", "radau13"])
def test_samples_of_a_stiff_run_are_as_good_as_its_steps(method: str) -> None:
    """Between steps a stiff component must not show the rounding error of its rate."""
    scene = load_scene_text(
        arm("light tip", 2.0, ", damper: {damping: 1e4}", ", spring: {stiffness: 1e6, rest: 40 deg}, damper: {damping: 1e4}",
            1e-6, start="{q: {theta1: 0, theta2: 45 deg}}")
    )  # fmt: skip
    scene = dataclasses.replace(scene, simulate=dataclasses.replace(scene.simulate, integrator=method))
    result = simulate(scene)
    late = result.time > 1.0
    # settled: the spring's joint rests within what gravity's 1e-11 of deflection leaves
    assert result.summary["integrator"] == method
    assert np.abs(result["q"][late, 1] - math.radians(40)).max() < 1e-9


def test_report_of_a_scene() -> None:
    result = stability(load_scene(CONFIGS / "four_bar_deploy.yaml", ["simulate.duration=5"]), quick=True)
    summary = result.summary
    assert {m["method"] for m in summary["methods"]} == {"auto", *(set(REPRESENTATIVES) & set(registry))}
    assert summary["reference"]["digits"] > 8
    assert summary["methods"][0]["status"] == "stable"
    assert summary["baumgarte"]["own"]["chosen"]["met"]
    assert result["baumgarte/fixed/drift"].shape == (7, 7)
    assert {x["method"] for x in summary["step_limits"]} >= {"gauss", "dop853", "dopri5", "rk4"}


def test_gains_are_not_chosen_where_rows_depend_on_each_other() -> None:
    scene = load_scene(CONFIGS / "benchmarks" / "bennett.yaml", ["simulate.stabilisation=baumgarte"])
    with pytest.raises(CapabilityError, match="depend on each other"):
        simulate(scene)
    plain = load_scene(CONFIGS / "benchmarks" / "bennett.yaml")
    systems, gains = formulations(projected_motion(plain), plain.simulate.stabilisation)
    assert list(systems) == ["projection", "none"] and gains is None


def test_an_oscillation_slower_than_the_scene_is_that_of_the_spectrum() -> None:
    """i omega = 0.1 rad/s in a scene of 5 s; rounding of a free motion is none."""

    def told(omega: float) -> tuple[float, str]:
        poles = np.array([[1j * omega, -1j * omega]])
        found = period(None, Spectrum(np.zeros(1), poles, np.ones(1), 1, True, 5.0), 5.0)
        return found.seconds, found.source

    assert told(0.1)[0] == pytest.approx(2 * np.pi / 0.1) and "longer than the scene" in told(0.1)[1]
    assert told(1e-8)[0] == 5.0 and "nothing in it oscillates" in told(1e-8)[1]
