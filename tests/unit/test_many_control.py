"""``simulate`` with a controller for many runs: what compiled runs and the command say is the same, errors
too; what compiled code does not know is left to the command."""

from __future__ import annotations

import re

import numpy as np
import pytest

from robodyn_cli import Mechanism
from robodyn_cli.over.study.rows import Points, Task
from robodyn_cli.over.study.runs import Compiled, make_one
from robodyn_cli.scene.load import Family
from tests.many import compare_all
from tests.mechanisms import CONFIGS

# single runs are compared with many to the last digits
pytestmark = pytest.mark.usefixtures("lasting_code")

PENDULUM, CART = CONFIGS / "double_pendulum.yaml", CONFIGS / "cart_pole_lqr.yaml"
FREE = (
    "expect={}",
    "torques=null",
    "simulate={duration: 0.5, samples: 26}",
    "initial.q={theta1: -1, theta2: 0.4}",
)
PD = "{type: pd, gains: {kp: 200, kd: 20}"
SINE = "reference: {type: joint, duration: 0.5, q: {theta1: 'sin(3*t) - 1', theta2: '0.4 + 0.2*t*t'}}"
SHORT = (  # it bends at its points and ends before the run
    "reference: {type: cubic, points: [{t: 0, q: {theta1: -1, theta2: 0.4}}, {t: 0.13, q: {theta1: -0.8, theta2: 0.3}}, "
    "{t: 0.31, q: {theta1: -1, theta2: 0.6}}]}"
)
LEFT = re.compile("a controller (samples at|holds where)|which may be others|equations of their own")
MASS = ("robot.links.link2.mass",)


@pytest.mark.parametrize(
    ("control", "keys"),
    [
        (f"{PD}}}", (*MASS, "control.gains.kp")),
        ("{type: pid, gains: {kp: 200, kd: 20, ki: 40}, limit: 150}", (*MASS, "control.gains.ki")),
        (f"{PD}, {SINE}}}", (*MASS, "control.gains.kd")),
        ("{type: computed_torque, gains: {kp: 100, kd: 20}, model: {set: {robot.links.link2.mass: 11}}}", MASS),
        ("{type: formulas, law: {theta1: 's.sum', theta2: '-5*qd.theta2'}, "
         "state: {sum: {start: 2, rate: '-40*q.theta1'}}}", MASS),
        (f"{PD}, {SINE}, period: 0.01, delay: 0.004, rate_limit: 3000}}", (*MASS, "control.gains.kd")),
        ("{type: pid, gains: {kp: 200, kd: 20, ki: 40}, period: 0.02, delay: 0.03, limit: 150}", (*MASS, "control.gains.ki")),
        (f"{PD}, period: 0.01, sensors: {{noise: 1e-4, rate_noise: 1e-3, seed: 4}}}}", (*MASS, "control.sensors.noise")),
        ("{type: computed_torque, gains: {kp: 100, kd: 20}, period: 0.02, sensors: {rates: differences}}", MASS),
        (f"{PD}, {SHORT}}}", (*MASS, "control.gains.kd")),
        ("{type: formulas, law: {theta1: '-5*qd.theta1 + s.sum', theta2: '-5*qd.theta2'}, "
         "state: {sum: {start: 2, rate: '-40*q.theta1'}}}", ("control.state.sum.start",)),
    ],
)  # fmt: skip
def test_every_figure_is_that_of_the_command(control: str, keys: tuple[str, ...]) -> None:
    family = Family(PENDULUM, (*FREE, f"control={control}"))
    made = 0 if keys[0].startswith("control.state") else None
    told = compare_all(Task(family, "simulate", keys, ()), 3, made=made)
    assert {"final", "error_estimate"} <= {key.partition(".")[0] for key in told}


LED = 'prescribed={theta1: "if(t<0.2, -1 + 0.3*sin(3*t), 0.9*cos(0.6)*(t-0.2) - 1 + 0.3*sin(0.6))"}'


def test_a_prescribed_motion_is_that_of_the_command() -> None:
    """It bends at 0.2 s; a key in its own numbers is left to the command."""
    family = Family(PENDULUM, (*FREE[:-1], "initial={q: {theta2: 0.4}}", LED))
    told = compare_all(Task(family, "simulate", MASS, ()), 3)
    assert "error_estimate" in {key.partition(".")[0] for key in told}
    family = Family(
        PENDULUM,
        (
            *FREE[:-1],
            "initial={q: {theta2: 0.4}}",
            "parameters={rate: 0.3}",
            "prescribed={theta1: rate*t - 1}",
        ),
    )
    compare_all(Task(family, "simulate", ("parameters.rate",), ()), 2, made=0)


def test_sines_of_other_frequencies_are_those_of_the_command() -> None:
    """They have no times that steps end at, whatever their numbers are; with a kink they do, and are left to it."""
    for formula, made in (("amp*sin(w*t) - 0.1*cos(7*t)*t", 3), ("amp*abs(sin(w*t))", 0)):
        family = Family(PENDULUM, (*FREE, "parameters={amp: 2, w: 9}", f"torques.theta1={formula}"))
        compare_all(Task(family, "simulate", ("parameters.amp", "parameters.w"), ()), 3, part=0.3, made=made)


def test_a_regulator_whose_gains_follow_from_the_numbers() -> None:
    """Each run has gains of its own, which are found from its masses."""
    changes = ("expect={}", "control.period=null", "simulate={duration: 0.5, samples: 26}")
    asked = Task(
        Family(CART, changes), "simulate", ("robot.links.rod.mass",), ("final.q.cart", "final.q.pole")
    )
    values = np.array([[0.3], [0.4], [0.5]])
    rows = Compiled(asked, 1).make(Points(np.arange(3), values))
    for run, row in zip(rows.runs.tolist(), rows.rows):
        one = make_one(asked, run, values[run])[0].rows[0]
        np.testing.assert_allclose(row["outputs"], one["outputs"], rtol=0, atol=1e-8)


def test_limits_that_bind_and_let_go() -> None:
    """Runs that come near to switching twice at a time may be left to the command."""
    control = f"{PD}, limit: {{theta1: 120, theta2: 20}}}}"
    keys, of = (*MASS, "control.limit.theta1"), ("final.q.theta1", "final.qd.theta2")
    asked = Task(Family(PENDULUM, (*FREE, f"control={control}")), "simulate", keys, of)
    values = np.column_stack([np.linspace(10.0, 13.0, 8), np.linspace(110.0, 140.0, 8)])
    rows = Compiled(asked, 1).make(Points(np.arange(8), values))
    assert len(rows)
    for run, row in list(zip(rows.runs.tolist(), rows.rows))[:3]:
        one = make_one(asked, run, values[run])[0].rows[0]
        assert (np.abs(row["outputs"] - one["outputs"]) <= 1e-11 + row["errors"] + one["errors"]).all()
        np.testing.assert_allclose(row["errors"], one["errors"], rtol=2.0, atol=1e-13)


@pytest.mark.parametrize(
    ("control", "key", "made"),
    [
        (f"{PD}, period: 0.01}}", "control.period", 0),  # other samples
        (f"{PD}, {SHORT}}}", "simulate.duration", 0),  # of whose reference other times may be left
        (f"{PD}}}", "initial.q.theta1", 0),  # the pose that is held is the start
        (f"{PD}}}", "initial.qd.theta1", 2),
    ],
)
def test_what_is_left_to_the_command(control: str, key: str, made: int) -> None:
    asked = Task(Family(PENDULUM, (*FREE, f"control={control}")), "simulate", (key,), ("final.q.theta1",))
    compiled = Compiled(asked, 1)
    assert len(compiled.make(Points(np.arange(2), np.array([[0.2], [0.45]])))) == made
    assert all(LEFT.search(why) for why in compiled.left)


def test_starts_in_place_of_the_scenes_are_held_too() -> None:
    family = Family(PENDULUM, (*FREE, f"control={PD}}}"))
    runs = Mechanism(family).simulate_many(q=np.array([[-1.0, 0.4], [-0.5, 0.3]]))
    one = Family(PENDULUM, (*FREE, f"control={PD}}}", "initial.q={theta1: -0.5, theta2: 0.3}"))
    there = Mechanism(one).simulate_many()
    np.testing.assert_allclose(runs.q[1], there.q[0], atol=1e-12)
