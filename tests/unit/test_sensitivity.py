"""Sensitivities: closed forms, exact derivatives beside central differences on random scenes, switches, refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
import scipy.linalg
from typer.testing import CliRunner

from robodyn_cli import sensitivity
from robodyn_cli.cli.app import app
from robodyn_cli.errors import SceneError
from robodyn_cli.over.sensitivity.asked import AskedSlopes, prepare
from robodyn_cli.over.sensitivity.differences import EXACT, Slope, differences
from robodyn_cli.over.sensitivity.gradients import Gradients
from robodyn_cli.over.sensitivity.motion.variational import NEW, nodes_of, transfers
from robodyn_cli.over.sensitivity.report import exact_slopes, quotient
from robodyn_cli.results.hdf5 import read
from robodyn_cli.scene.load import Family, load_scene_text
from robodyn_cli.scene.units import in_joint
from tests.unit.test_latch_positions import AT, FOUR_BAR

CONFIGS = Path(__file__).parents[2] / "configs"

FALL = """
schema: 1
command: simulate
gravity: [0, 0, -9.81]
robot:
  joints: [{name: z, type: prismatic, parent: base, axis: [0, 0, 1]}]
  links: [{name: ball, mass: 2.0}]
initial: {q: {z: 0}, qd: {z: 1.0}}
simulate: {duration: 1.0, samples: 3, rtol: 1e-10, atol: 1e-12}
"""

# full inertias, a compliant stop, a torque that switches with the state and one that switches at a time that is a key
SWITCHING = """
schema: 1
command: simulate
gravity: [0.3, -9.81, 0.2]
parameters: {k: 8.0, off: -0.21, on: 0.53, f: 5.0}
robot:
  convention: standard
  joints:
    - {name: a, type: revolute, a: 1.0, alpha: 30 deg, d: 0.1, damper: {damping: 0.2}}
    - {name: b, type: revolute, a: 0.7, alpha: 0, d: 0, limits: {upper: 0.4, stop: {stiffness: 400}}}
  links:
    - {name: l1, mass: 2, com: [0.5, 0.02, 0.03], com_frame: joint,
       inertia: {xx: 0.02, yy: 0.2, zz: 0.21, xy: 0.01, xz: 0.002, yz: 0.004}}
    - {name: l2, mass: 1.3, com: [0.3, -0.02, 0.01], com_frame: joint,
       inertia: {xx: 0.01, yy: 0.1, zz: 0.12, xy: 0.005, xz: 0.001, yz: 0.002}}
torques: {a: "if(a > off, 3*k, -k) + if(t > on, f, 0)", b: "k*sin(2*t)*a"}
initial: {q: {a: -0.3, b: 0.1}, qd: {a: 0.2, b: -0.4}}
simulate: {duration: 0.8, samples: 3, rtol: 1e-11, atol: 1e-13}
"""


def asked(scene: str | Path, to: list[str], of: list[str], *overrides: str) -> AskedSlopes:
    if isinstance(scene, Path):
        return prepare(Family(scene, overrides), to, of)
    return prepare(Family.of(load_scene_text(scene, overrides=overrides)), to, of)


def exact(question: AskedSlopes) -> dict[tuple[str, str], Slope]:
    """Exact derivatives by output and key."""
    found, _ = exact_slopes(question)
    return {(name, question.task.keys[k]): slope for (name, k), slope in found.items()}


def compare_with_differences(question: AskedSlopes, beyond: float = 3.0) -> None:
    """All derivatives are exact, and differ from central differences by no more than both say."""
    found, others = exact(question), differences(question, range(len(question.keys)), 1)
    for k, key in enumerate(question.task.keys):
        for name, other in zip(question.task.outputs, others[k]):
            slope = found[name, key]
            assert slope.method == EXACT
            apart, allowed = abs(slope.value - other.value), beyond * (slope.error + other.error)
            assert apart <= allowed, (name, key, slope, other)
            # a difference that knows nothing would prove nothing
            assert other.error <= 1e-5 * max(abs(other.value), 1e-3), (name, key, slope, other)


def test_blocks_have_order_ten() -> None:
    """Error against the matrix exponential, for a position and its rate, a further state and a constant drive."""
    rng = np.random.default_rng(3)
    A, B = rng.normal(size=(2, 3)), rng.normal(size=(2, 1))
    whole = np.zeros((4, 4))
    whole[0, 1], whole[1:3, :3], whole[1:3, 3:] = 1.0, A, B
    truth = scipy.linalg.expm(whole)[:3]
    errors = []
    for parts in (1, 2):
        nodes = nodes_of([NEW + 1] * parts)
        shape = nodes.shape
        ways, shares = transfers(
            np.broadcast_to(A, (*shape, 2, 3)),
            np.broadcast_to(B, (*shape, 2, 1)),
            np.full(parts, 1.0 / parts),
            1,
        )
        S = np.hstack([np.eye(3), np.zeros((3, 1))])
        for way, share in zip(ways, shares):
            S = way @ S + np.hstack([np.zeros((3, 3)), share])
        errors.append(np.abs(S - truth).max())
    assert errors[0] < 1e-6
    assert 2**9 < errors[0] / errors[1] < 2**12.5


def test_a_fall_has_a_closed_form() -> None:
    question = asked(
        FALL,
        ["initial.qd.z", "gravity.2", "simulate.duration", "robot.links.ball.mass"],
        ["final.q.z", "final.qd.z"],
    )
    found = exact(question)
    truth = {"initial.qd.z": (1.0, 1.0), "gravity.2": (0.5, 1.0), "simulate.duration": (1.0 - 9.81, -9.81)}
    for key, slopes in {**truth, "robot.links.ball.mass": (0.0, 0.0)}.items():
        for name, y in zip(("final.q.z", "final.qd.z"), slopes):
            assert found[name, key].value == pytest.approx(y, abs=1e-11)
            assert abs(found[name, key].value - y) <= found[name, key].error + 1e-15


def test_switches_are_crossed() -> None:
    to = ["parameters.k", "parameters.off", "parameters.on", "robot.joints.b.limits.upper", "initial.qd.b",
          "robot.joints.a.damper.damping", "robot.links.l2.inertia.xy"]  # fmt: skip
    compare_with_differences(asked(SWITCHING, to, ["final.q.a", "final.qd.b"]))


SOFT_STOP = """schema: 1
command: simulate
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1], limits: {lower: -1.2, stop: {stiffness: 900, damping: 5}}}
    - {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [0.6, 0, 0]}}
  links:
    - {name: l1, mass: 2, com: [0.3, 0, 0], inertia: {zz: 0.06}}
    - {name: l2, mass: 1, com: [0.25, 0, 0], inertia: {zz: 0.02}}
initial: {q: {a: 0.3, b: 0.2}}
simulate: {duration: 2.5, samples: 26}
"""


@pytest.mark.parametrize("tolerance", ["1e-8", "1e-10"])
@pytest.mark.parametrize("method", ["gauss", "dop853", "dopri5"])
def test_integrations_come_to_switches_at_their_own_times(method: str, tolerance: str) -> None:
    """Off by their errors, which are far more than how far samples used to stay beside: at 1e-8 a seventh was lacking."""
    of, to = "final.qd.b", "robot.links.l2.mass"
    best = exact(asked(SOFT_STOP, [to], [of], "simulate.rtol=1e-12", "simulate.atol=1e-14"))[of, to]
    assert best.value == pytest.approx(
        -3490.66157794, abs=1e-7
    )  # by differences of runs: -3490.66158 +- 1e-6
    options = f"simulate.integrator={method}", f"simulate.rtol={tolerance}", "simulate.atol=1e-10"
    own = exact(asked(SOFT_STOP, [to], [of], *options))[of, to]
    assert abs(own.value - best.value) <= own.error + best.error < 1e-3


def random_scene(seed: int) -> tuple[str, list[str]]:
    """A chain of hinges and slides with full inertias, springs and a driven joint, and keys of it."""
    rng = np.random.default_rng(seed)
    joints, links, keys = [], [], []
    for k in range(3):
        kind = "prismatic" if rng.uniform() < 0.3 else "revolute"
        x, axis = rng.normal(size=3) * 0.3, rng.normal(size=3)
        joints.append(
            f"  - {{name: j{k}, type: {kind}, parent: {f'l{k - 1}' if k else 'base'}, link: l{k}, "
            f"origin: {{xyz: {x.tolist()}}}, axis: {axis.tolist()}, "
            f"spring: {{stiffness: {rng.uniform(2, 9)}, rest: 0.2}}, damper: {{damping: {rng.uniform(0.1, 0.5)}}}}}"
        )
        points = rng.normal(size=(6, 3)) * 0.1
        I = sum(p @ p * np.eye(3) - np.outer(p, p) for p in points)
        names = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
        inertia = ", ".join(f"{name}: {float(I[place])}" for name, place in names.items())
        com = (rng.normal(size=3) * 0.2).tolist()
        links.append(
            f"  - {{name: l{k}, mass: {rng.uniform(0.5, 2)}, com: {com}, com_frame: joint, inertia: {{{inertia}}}}}"
        )
        keys += [f"robot.links.l{k}.mass", f"robot.links.l{k}.com.1", f"robot.links.l{k}.inertia.xz",
                 f"robot.joints.j{k}.origin.xyz.2", f"robot.joints.j{k}.spring.stiffness", f"initial.q.j{k}"]  # fmt: skip
    text = "\n".join([
        "schema: 1", "command: simulate", "gravity: [1.0, -2.0, -9.0]", "parameters: {w: 3.1}", "robot:", "  joints:",
        *(f"  {line}" for line in joints), "  links:", *(f"  {line}" for line in links),
        'torques: {j1: "2*sin(w*t) - 0.3*j0"}', "initial: {q: {j0: 0.1, j1: -0.2, j2: 0.3}}",
        "simulate: {duration: 1, samples: 3, rtol: 1e-11, atol: 1e-13}",
    ])  # fmt: skip
    chosen = rng.choice(keys, 4, replace=False).tolist()
    return text, [*chosen, "parameters.w", "gravity.1"]


@pytest.mark.parametrize("seed", range(3))
def test_random_chains_agree_with_differences(seed: int) -> None:
    text, keys = random_scene(seed)
    compare_with_differences(asked(text, keys, ["final.q.j0", "final.qd.j2"]))


def test_the_lock_of_the_four_bar() -> None:
    """The angle at the lock is geometry; its time agrees with differences, initial closure included."""
    to = ["robot.joints.theta1.a", "robot.links.coupler.mass", "initial.q.theta1", "initial.q.phi1"]
    question = asked(
        CONFIGS / "four_bar_deploy.yaml", to, ["lock.time", "lock.angles.theta1", "lock.rates.phi1"]
    )
    found = exact(question)
    with mpmath.workdps(25):
        base, reach = mpmath.mpf("1.241"), mpmath.mpf("2.4")
        truth = float(mpmath.diff(lambda a: mpmath.acos((a * a + base**2 - reach**2) / (2 * a * base)), base))
    slope = found["lock.angles.theta1", "robot.joints.theta1.a"]
    assert abs(slope.value - truth) <= slope.error
    assert slope.value == pytest.approx(truth, rel=1e-8)
    assert abs(found["lock.time", "initial.q.phi1"].value) <= found["lock.time", "initial.q.phi1"].error
    mass = differences(question, [1], 1)[1]
    for name, other in zip(question.task.outputs, mass):
        own = found[name, "robot.links.coupler.mass"]
        assert abs(own.value - other.value) <= 3.0 * (own.error + other.error)
    time = found["lock.time", "robot.links.coupler.mass"].value
    assert time == pytest.approx(mass[0].value, rel=1e-8)


def test_latches_at_positions() -> None:
    """A boom in space and the four-bar; the position of the latch itself is structure, whose derivative is 1 / rate."""
    to = ["robot.joints.a.spring.stiffness"]
    of, tight = (
        ["lock.time", "lock.angles.a"],
        ["simulate.rtol=1e-12", "simulate.atol=1e-14", "deploy.after=stop"],
    )
    compare_with_differences(asked(AT, to, of, *tight))
    question = asked(CONFIGS / "four_bar_deploy.yaml", ["deploy.latch.at.theta1"], ["lock.time", "lock.rates.theta1"],
                     *FOUR_BAR, "expect={}")  # fmt: skip
    time, _ = differences(question, [0], 1)[0]
    assert time.value == pytest.approx(1.0 / question.outputs[1], rel=1e-8)
    mass = asked(
        CONFIGS / "four_bar_deploy.yaml", ["robot.links.crank.mass"], ["lock.time"], *FOUR_BAR, "expect={}"
    )
    compare_with_differences(mass)


def test_numbers_of_formulas_are_keys() -> None:
    """The spring of the four-bar is a number inside a formula; as a parameter it has the same derivative."""
    path, of = CONFIGS / "four_bar_deploy.yaml", ["lock.time"]
    inside = exact(asked(path, ["torques.theta1#2"], of))["lock.time", "torques.theta1#2"]
    outside = exact(
        asked(path, ["parameters.k"], of, "parameters={k: 0.1}", "torques.theta1='1.96 - k*theta1'")
    )["lock.time", "parameters.k"]
    assert inside.value == pytest.approx(outside.value, rel=1e-11)
    (slope,) = differences(asked(path, ["torques.theta1#2"], of), [0], 1)[0]
    assert slope.value == pytest.approx(inside.value, rel=1e-7)


def test_one_of_several_keys_may_need_narrower_steps() -> None:
    """A length moves the lock by thousands of times as much as a mass: its differences over wide steps tell little."""
    to, of = ["robot.links.coupler.mass", "robot.joints.phi2.a"], ["lock.time"]
    question = asked(CONFIGS / "four_bar_deploy.yaml", to, of)
    found, others = exact(question), differences(question, range(2), 1)
    for k, key in enumerate(to):
        assert others[k][0].value == pytest.approx(found[of[0], key].value, rel=1e-7)


def test_loops_in_other_formulations_agree() -> None:
    of, to = ["final.q.theta1", "final.qd.phi2"], ["robot.links.coupler.mass", "robot.joints.phi2.a"]
    path, settings = (
        CONFIGS / "four_bar_deploy.yaml",
        ["command=simulate", "simulate.duration=6", "expect={}"],
    )
    found = [
        exact(asked(path, to, of, *settings, f"simulate.stabilisation={name}"))
        for name in ("projection", "independent", "{alpha: 10, beta: 10}")
    ]
    for place, slope in found[0].items():
        for other in found[1:]:
            assert other[place].value == pytest.approx(slope.value, rel=2e-7)


@pytest.mark.parametrize("scene", ["spinning_top", "tumbling_body"])
def test_bodies_with_quaternions(scene: str) -> None:
    path = CONFIGS / f"{scene}.yaml"
    family = Family(path)
    link = family.own.robot.links[0]
    axis = next(
        name for name, x in zip(("xx", "yy", "zz"), (link.inertia.xx, link.inertia.yy, link.inertia.zz)) if x
    )
    from robodyn_cli.model.build import build_model

    rates = [f"final.qd.{name}" for name in build_model(family.own).v_names[:3]]
    settings = ["simulate.duration=0.3", "simulate.samples=3", "expect={}"]
    to = [f"robot.links.{link.name}.inertia.{axis}"]
    compare_with_differences_of(asked(path, to, rates, *settings))


def compare_with_differences_of(question: AskedSlopes) -> None:
    """As ``compare_with_differences``, where derivatives may be zero."""
    found = exact(question)
    for name, other in zip(question.task.outputs, differences(question, [0], 1)[0]):
        slope = found[name, question.task.keys[0]]
        assert abs(slope.value - other.value) <= 3.0 * (slope.error + other.error) + 1e-9


def test_tables_depend_on_knots_and_values() -> None:
    text = FALL.replace("initial:", "torques: {z: {table: [[0, 1], [0.3, 6], [0.7, 2], [1.5, 9]]}}\ninitial:")
    to = ["torques.z.table.1.0", "torques.z.table.1.1", "torques.z.table.3.1"]
    compare_with_differences(asked(text, to, ["final.q.z", "final.qd.z"]))


# -- inverse ---------------------------------------------------------------------------------------------------
def test_figures_of_torques() -> None:
    of = ["peak_torque.theta1", "rms_torque.theta1", "joints.theta2.energy", "joints.theta1.torque_range.0"]
    compare_with_differences(asked(CONFIGS / "2r_circle.yaml", ["robot.links.link2.com.0", "gravity.1"], of))


def test_a_number_of_a_prescribed_motion_changes_the_motion() -> None:
    """``inverse`` takes it as given, so the torques themselves do not show it."""
    question = asked(
        CONFIGS / "double_pendulum.yaml",
        ["prescribed.theta1#1", "robot.links.link1.mass"],
        ["rms_torque.theta1"],
        "command=inverse",
        "prescribed={theta1: '0.4*sin(t)', theta2: '0.3*t'}",
        "initial={}",
        "expect={}",
    )
    found, why = exact_slopes(question)
    assert list(found) == [("rms_torque.theta1", 1)]
    assert "a prescribed motion changes" in why[0]


# -- what has no exact derivative ------------------------------------------------------------------------------
TURNED = random_scene(4)[0].replace("origin: {xyz", "origin: {rpy: [0, 20 deg, 0.3], xyz")


def test_zeros_and_angles_are_numbers_too() -> None:
    compare_with_differences(asked(SWITCHING, ["robot.joints.a.alpha"], ["final.q.a", "final.qd.b"]))
    to = ["robot.joints.j1.origin.rpy.0", "robot.joints.j2.origin.rpy.1", "gravity.0", "robot.links.l1.com.1"]
    text = TURNED.replace("gravity: [1.0", "gravity: [0.0")
    com = text.partition("name: l1, mass")[2].partition("com: [")[2].partition("]")[0]
    own = com.split(", ")
    text = text.replace(com, f"{own[0]}, 0.0, {own[2]}")
    compare_with_differences(asked(text, to, ["final.q.j0", "final.qd.j2"]))


@pytest.mark.parametrize("key", ["robot.joints.j1.axis.0", "simulate.rtol"])
def test_structure_is_never_taken_for_a_number(key: str) -> None:
    found, why = exact_slopes(asked(random_scene(0)[0], [key], ["final.q.j0"]))
    assert not found and "structure" in why[0]


def test_a_spring_and_a_damper_of_zero() -> None:
    """What they would add to a fall z = t - g t^2 / 2: dz(1) = int (1 - s) force(s) ds / m."""
    passive = "axis: [0, 0, 1], spring: {stiffness: 0, rest: 0.3}, damper: {damping: 0}}"
    joint = "robot.joints.z"
    to = [f"{joint}.spring.stiffness", f"{joint}.damper.damping"]
    found = exact(asked(FALL.replace("axis: [0, 0, 1]}", passive), to, ["final.q.z"]))
    truth = [0.5 * (0.3 / 2 - 1 / 6 + 9.81 / 24), 0.5 * (-1 / 2 + 9.81 / 6)]
    for key, y in zip(to, truth):
        assert found["final.q.z", key].value == pytest.approx(y, rel=1e-10)


def test_one_key_does_not_stand_in_the_way_of_another() -> None:
    found, why = exact_slopes(asked(SWITCHING, ["simulate.rtol", "parameters.k"], ["final.q.a"]))
    assert list(found) == [("final.q.a", 1)] and list(why) == [0]


def test_impacts_are_left_to_differences() -> None:
    question = asked(CONFIGS / "bouncing_pendulum.yaml", ["gravity.1"], ["final.time"], "expect={}")
    found, why = exact_slopes(question)
    assert not found and "stops" in why[0]


# two links in space that follow a motion; {} : what controls them
CONTROLLED = (
    SWITCHING[: SWITCHING.index("torques:")].replace(
        "alpha: 0, d: 0, limits: {upper: 0.4, stop: {stiffness: 400}}", "alpha: 0, d: 0"
    )
    + """
control: CONTROL
trajectory: {type: quintic, points: [{t: 0, q: {a: -0.3, b: 0.1}}, {t: 0.5, q: {a: 0.2, b: 0.4}}]}
initial: {q: {a: -0.3, b: 0.15}, qd: {a: 0.2, b: -0.4}}
simulate: {duration: 0.7, samples: 3, rtol: 1e-11, atol: 1e-13}
"""
)


@pytest.mark.parametrize(
    ("control", "keys"),
    [
        ("type: pid, gains: {kp: 60, kd: 9, ki: 30}, limit: 14", ["control.gains.ki", "control.limit", "initial.q.b"]),
        ("type: computed_torque, gains: {kp: 100, kd: 20}, model: {set: {robot.links.l1.mass: 1.8}}", ["control.gains.kp"]),
        ("type: computed_torque, gains: {kp: 100, kd: 20}, model: {set: {robot.links.l2.mass: 1.0}}", ["control.gains.kd"]),
        ("type: pd, period: 0.01, gains: {kp: 60, kd: 9}", ["control.gains.kd", "initial.q.b"]),
        ("type: pid, period: 0.01, delay: 0.013, gains: {kp: 60, kd: 9, ki: 30}, limit: 14", ["control.gains.ki"]),
        ("type: pd, period: 0.01, delay: 0.004, gains: {kp: 60, kd: 9}, sensors: {rates: differences, noise: 1e-3}",
         ["control.gains.kd", "initial.qd.a"]),
    ],
)  # fmt: skip
def test_controllers_and_their_updates(control: str, keys: list[str]) -> None:
    """Continuous and sampled laws with limits, delays, integrators, noise, and rates from differences."""
    text = CONTROLLED.replace("CONTROL", f"{{{control}}}")
    compare_with_differences(asked(text, [*keys, "robot.links.l2.mass"], ["final.q.a", "final.qd.b"]))


def test_updates_are_differentiated_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a controller with hundreds of updates neither these nor the steps between them are looked at one by one."""
    samples, call = list[int](), Gradients.__call__
    monkeypatch.setattr(Gradients, "__call__", lambda self, n, *x: (samples.append(n), call(self, n, *x))[1])
    law = "{type: pid, period: 0.002, delay: 0.001, gains: {kp: 60, ki: 40, kd: 9}}"
    question = asked(CONTROLLED.replace("CONTROL", law), ["control.gains.kp"], ["final.q.a"])
    assert len(exact(question)) == 1
    parts = 2 * round(0.8 / 0.002)
    assert len(samples) < 20
    assert sum(samples) < 80 * parts


@pytest.mark.parametrize(
    ("control", "reason"),
    [
        ("type: lqr, pose: {a: -0.3, b: 0.1}, gains: {q: 10, qd: 1, tau: 0.05}", "has no derivative"),
        ("type: pd, period: 0.01, gains: {kp: 60, kd: 9}, sensors: {resolution: 1e-4}", "encoders"),
    ],
)  # fmt: skip
def test_what_a_controller_leaves_to_differences(control: str, reason: str) -> None:
    """Gains that follow from the model by an equation of their own, and rounded measurements."""
    text = CONTROLLED.replace("CONTROL", f"{{{control}}}")
    if "lqr" in control:
        text = text.replace(text[text.index("trajectory:") : text.index("initial:")], "")
    found, why = exact_slopes(asked(text, ["robot.links.l2.mass"], ["final.q.a"]))
    assert not found and reason in why[0]


# -- bad input -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("to", "of", "message"),
    [
        (
            "robot.links.bell.mass",
            "final.q.z",
            "--to robot.links.bell.mass: has no item named 'bell'",
        ),
        ("robot.links.ball.name", "final.q.z", "<text>:7:18: robot.links.ball.name: the scene has no number"),
        ("initial.q", "final.q.z", "initial.q: the scene has no number there"),
        ("simulate.samples", "final.q.z", "--to simulate.samples"),
        ("torques.z#1", "final.q.z", "so there is no #1"),
        ("gravity.2", "final.q.x", "--of final.q.x"),
        ("gravity.2", "status", "is not a number"),
        ("gravity.2", "", "no output is named"),
    ],
)
def test_bad_input(to: str, of: str, message: str) -> None:
    with pytest.raises(SceneError) as caught:
        asked(FALL, [to], [of] if of else [])
    assert message in caught.value.message


def test_a_formula_is_no_number() -> None:
    with pytest.raises(
        SceneError, match=r"yaml:11:19: torques.theta1: the scene has no number there; .* KEY#n"
    ):
        asked(CONFIGS / "four_bar_deploy.yaml", ["torques.theta1"], ["lock.time"])


def test_from_python() -> None:
    result = sensitivity(load_scene_text(FALL), ["gravity.2", "initial.qd.z"], ["final.q.z"])
    assert result["derivatives/final.q.z"] == pytest.approx([0.5, 1.0], abs=1e-11)
    assert result.variables["derivatives/final.q.z"].column_units == ("m/(m/s^2)", "m/(m/s)")


def test_units_of_derivatives() -> None:
    assert quotient("s", "kg") == "s/kg"
    assert quotient("N m", "kg m^2") == "N m/(kg m^2)"
    assert quotient("rad", "1") == "rad"
    assert quotient("s", "") == "s/(unit of the key)"
    assert quotient("", "1/s") == "(unit of the output)/(1/s)"


def test_units_are_those_of_the_joint() -> None:
    joints = {"turn": "rad", "slide": "m"}
    assert in_joint("N m/rad or N/m", "robot.joints.slide.spring.stiffness", joints) == "N/m"
    assert in_joint("N m s/rad or N s/m", "robot.joints.turn.damper.damping", joints) == "N m s/rad"
    assert in_joint("rad or m", "control.sensors.noise.slide", joints) == "m"
    assert in_joint("N m or N", "control.limit", joints, ["turn", "slide"]) == "N m or N"
    assert in_joint("N m or N", "control.limit", joints, ["turn"]) == "N m"
    assert in_joint("s, N m or N", "torques.slide.table.1.0", joints) == "s"
    assert in_joint("s, N m or N", "torques.slide.table.1.1", joints) == "N"
    question = asked(FALL.replace("axis: [0, 0, 1]}", "axis: [0, 0, 1], spring: {stiffness: 2, rest: 0}}"),
                     ["robot.joints.0.spring.stiffness"], ["final.q.z"])  # fmt: skip
    assert question.units == ("N/m",)


# -- the command -----------------------------------------------------------------------------------------------
def test_the_command_ranks_and_stores(tmp_path: Path) -> None:
    scene = tmp_path / "fall.yaml"
    scene.write_text(FALL)
    options: list[Any] = [
        "sensitivity",
        str(scene),
        "--of",
        "final.q.z",
        "--out",
        str(tmp_path / "out"),
        "--json",
    ]
    for key in ("robot.links.ball.mass", "gravity.2", "initial.qd.z", "initial.q.z"):
        options += ["--to", key]
    done = CliRunner().invoke(app, options)
    assert done.exit_code == 0, done.output
    summary = json.loads(done.stdout)
    slopes = summary["sensitivities"]["final.q.z"]
    assert list(slopes)[:2] == ["gravity.2", "initial.qd.z"]  # 4.9 against 1.0 of the fall
    assert slopes["gravity.2"]["unit"] == "m/(m/s^2)"
    assert slopes["gravity.2"]["normalised"] == pytest.approx(0.5 * -9.81 / (1.0 - 0.5 * 9.81))
    assert slopes["initial.q.z"]["method"] == EXACT and slopes["initial.q.z"]["normalised"] is None
    result = read(tmp_path / "out" / "result.h5")
    stored = result.variables["derivatives/final.q.z"]
    assert list(stored.names) == ["robot.links.ball.mass", "gravity.2", "initial.qd.z", "initial.q.z"]
    assert stored.data == pytest.approx([0.0, 0.5, 1.0, 1.0], abs=1e-11)
    assert np.all(result["exact/final.q.z"] == 1.0)
    assert (tmp_path / "out" / "sensitivity_tornado.png").stat().st_size > 5000
