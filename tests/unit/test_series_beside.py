"""Many runs of open chains by Taylor series or ``dop853`` side by side, which ``auto`` takes, beside ``simulate``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import Mechanism, load_scene, load_scene_text, simulate
from robodyn_cli.kernels.compiler import machine
from robodyn_cli.over.many.command import ManyRuns
from robodyn_cli.over.many.keys import settings
from robodyn_cli.scene.types import Scene

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
KEYS = ["robot.links.l0.mass", "initial.q.j0"]
JOINTS = (
    "",
    ", friction: {viscous: 0.4}",
    ", friction: {coulomb: 0.3, transition_speed: 0.2}",
    ", spring: {stiffness: 30}",
)
# what series in lanes cannot do, by what it puts into a joint
OTHERS = {
    "a compliant stop": "limits: {upper: 0.4, stop: {stiffness: 2e3, damping: 5}}",
    "a rigid stop": "limits: {upper: 0.4, stop: {restitution: 0.3}}",
    "friction that sticks": "friction: {coulomb: 0.2, law: set_valued}",
}

pytestmark = [
    pytest.mark.skipif(machine().lanes == 1, reason="this processor has no vectors of doubles"),
    pytest.mark.usefixtures("lasting_code"),  # single runs are compared with many to the last digits
]


def chain(rng: np.random.Generator, count: int, rtol: float) -> str:
    """Return an open chain with springs, dampers, friction and torques, planar or in space."""
    plane = rng.random() < 0.5
    axes = [[0, 0, 1] if plane else np.round(rng.normal(size=3), 2).tolist() for _ in range(count)]
    joints = ", ".join(
        f"{{name: j{k}, type: revolute, axis: {axis}, origin: {{xyz: [{0.4 * (k > 0)}, 0, 0.1]}}{rng.choice(JOINTS)}}}"
        for k, axis in enumerate(axes)
    )
    links = ", ".join(
        f"{{name: l{k}, mass: {rng.uniform(1, 3):.3f}, com: {np.round(rng.normal(size=3) * 0.4, 2).tolist()}, "
        f"inertia: {{xx: 0.11, yy: 0.12, zz: 0.13, xy: 0.01}}}}"
        for k in range(count)
    )
    torques = rng.choice(["", "torques: {j0: 0.4*sin(3*t) - 0.1*tanh(j0)}"])
    start = ", ".join(f"j{k}: {rng.uniform(-0.5, 0.5):.3f}" for k in range(count))
    return f"""
schema: 1
command: simulate
gravity: [0.3, -9.81, -0.2]
robot: {{joints: [{joints}], links: [{links}]}}
{torques}
initial: {{q: {{{start}}}}}
simulate: {{duration: {rng.uniform(0.5, 3):.2f}, samples: 40, rtol: {rtol}, atol: {rtol / 100}}}
"""


@pytest.mark.parametrize("seed", range(6))
def test_runs_equal_the_command_within_the_sum_of_errors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rtol = float(rng.choice([1e-6, 1e-8, 1e-10, 1e-13]))
    text = chain(rng, 1 + seed % 4, rtol)
    values = np.array([2.0, 0.3]) * rng.uniform(0.8, 1.2, (9, 2))
    found = Mechanism(load_scene_text(text), KEYS).simulate_many(values, of=["final.q.j0"])
    assert found.ok.all() and not found.one_by_one.any()
    assert set(found.series) <= {12 if rtol > 3e-7 else 16, 8 if rtol >= 1e-9 else 0}
    if seed % 4 == 0:
        assert set(found.series) == {12 if rtol > 3e-7 else 16}
    for run in (0, 5):
        one = simulate(load_scene_text(text, overrides=settings(KEYS, values[run])))
        error = one.summary["error_estimate"]
        for own, there, name in ((found.q, one["q"], "q"), (found.qd, one["qd"], "qd")):
            both = getattr(found, f"{name}_error")[run].max() + error[f"{name}_end"]
            assert np.abs(own[run] - there[-1]).max() <= both < 1e3 * rtol, (run, name)
        assert found.errors["final.q.j0"][run] == found.q_error[run].max()


# two hinges at right angles: some 100 operations of the equations
CROSSED = """
schema: 1
command: simulate
gravity: [0, -9.81, 0]
robot:
  joints:
    - {{name: j0, type: revolute, axis: [0, 0, 1]{friction}}}
    - {{name: j1, type: revolute, axis: [1, 0, 0], origin: {{xyz: [0.4, 0, 0]}}}}
  links:
    - {{name: l0, mass: 2, com: [0.2, 0, 0], inertia: {{xx: 0.1, yy: 0.2, zz: 0.3}}}}
    - {{name: l1, mass: 1, com: [0, -0.3, 0.1], inertia: {{xx: 0.1, yy: 0.2, zz: 0.3}}}}
initial: {{q: {{j0: 0.3, j1: 0.5}}}}
simulate: {{duration: 1, samples: 40, rtol: 1e-6, atol: 1e-8}}
"""


@pytest.mark.parametrize(("friction", "order"), [(JOINTS[2], 12), (JOINTS[1], 8)], ids=["abrupt", "smooth"])
def test_larger_chains_take_series_where_rates_may_change_abruptly(friction: str, order: int) -> None:
    text = CROSSED.format(friction=friction)
    values = np.array([[2.0, 0.3], [2.2, 0.2]])
    found = Mechanism(load_scene_text(text), KEYS).simulate_many(values)
    assert found.ok.all() and set(found.series) == {order}
    one = simulate(load_scene_text(text, overrides=settings(KEYS, values[1])))
    both = found.q_error[1].max() + one.summary["error_estimate"]["q_end"]
    assert np.abs(found.q[1] - one["q"][-1]).max() <= both < 1e-5


def test_a_named_series_is_the_same_to_the_bit() -> None:
    """Alone and among others, of this name or of none."""
    text = chain(np.random.default_rng(8), 1, 1e-10)
    values = np.array([2.0, 0.3]) * np.random.default_rng(1).uniform(0.8, 1.2, (9, 2))
    chosen = Mechanism(load_scene_text(text), KEYS).simulate_many(values)
    assert set(chosen.series) == {16}
    named = load_scene_text(text, overrides=["simulate.integrator=taylor16"])
    are_the_same(named, chosen, values)


def test_a_named_explicit_method_is_the_same_to_the_bit() -> None:
    """At a thirtieth of the tolerances; tolerances that are told are the scene's."""
    text = chain(np.random.default_rng(8), 4, 1e-8)
    values = np.array([2.0, 0.3]) * np.random.default_rng(1).uniform(0.8, 1.2, (9, 2))
    chosen = Mechanism(load_scene_text(text), KEYS).simulate_many(values, of=["tolerances.rtol"])
    assert set(chosen.series) == {8} and set(chosen.outputs["tolerances.rtol"]) == {1e-8}
    options = [f"simulate.{key}={value / 30.0!r}" for key, value in (("rtol", 1e-8), ("atol", 1e-10))]
    named = load_scene_text(text, overrides=["simulate.integrator=dop853", *options])
    are_the_same(named, chosen, values)


def are_the_same(named: Scene, chosen: ManyRuns, values: np.ndarray) -> None:
    for rows in (slice(None), slice(3, 4)):
        found = Mechanism(named, KEYS).simulate_many(values[rows])
        assert not found.series.any()  # that is what the command takes, too
        for name in ("q", "qd", "steps"):
            np.testing.assert_array_equal(getattr(found, name), getattr(chosen, name)[rows])


@pytest.mark.parametrize(
    "key", ["counters.steps", "error_estimate.steps", "energy_drift", "error_estimate.q_max"]
)
def test_what_tells_of_steps_or_samples_is_that_of_the_command(key: str) -> None:
    text = chain(np.random.default_rng(8), 1, 1e-10)
    found = Mechanism(load_scene_text(text), KEYS).simulate_many([[2.0, 0.3]], of=[key])
    assert not found.series.any()
    one = simulate(load_scene_text(text, overrides=settings(KEYS, np.array([2.0, 0.3]))))
    section, _, name = key.rpartition(".")
    there = one.summary[section][name] if section else one.summary[name]
    assert found.outputs[key][0] == pytest.approx(there, rel=1e-2 if "error" in key else 1e-6, abs=1e-15)


def test_runs_that_series_leave_are_made_by_the_method_of_the_command() -> None:
    """A run that its steps do not bring to the end in time is not failed before that method has tried."""
    text = chain(np.random.default_rng(8), 1, 1e-10)
    options = ["simulate.max_steps=14"]
    found = Mechanism(load_scene_text(text, overrides=options), KEYS).simulate_many([[2.0, 0.3]])
    assert found.ok.all() and not found.series.any() and not found.one_by_one.any()


@pytest.mark.parametrize("words", OTHERS.values(), ids=list(OTHERS))
def test_events_are_met_by_the_method_of_the_command(words: str) -> None:
    text = chain(np.random.default_rng(8), 1, 1e-10).replace("name: j0,", f"name: j0, {words},", 1)
    found = Mechanism(load_scene_text(text), KEYS).simulate_many([[2.0, 0.3]])
    one = simulate(load_scene_text(text, overrides=settings(KEYS, np.array([2.0, 0.3]))))
    assert found.ok.all() and not found.series.any()
    np.testing.assert_allclose(found.q[0], one["q"][-1], rtol=0, atol=1e-12)


def test_loops_are_closed_by_the_method_of_the_command() -> None:
    scene = load_scene(CONFIGS / "parallelogram.yaml", ["command=simulate", "simulate.duration=0.3"])
    assert not Mechanism(scene).simulate_many().series.any()
