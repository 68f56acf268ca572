"""Extremes of columns over a run: against closed forms, on both sides of events, and whatever the samples are."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipk

from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.integrators.runtime.options import Grid
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.driver import Driver
from robodyn_cli.observe.columns import chosen
from robodyn_cli.over.commands import execute
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.results.export import tables
from robodyn_cli.results.hdf5 import write
from robodyn_cli.scene.checks.columns import column_names, units_of_columns
from robodyn_cli.scene.checks.keys import places_of
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.solve.peaks import Windows
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.tools.progress import Stopwatch, no_progress
from robodyn_cli.works.kinematics import kinematics
from robodyn_cli.works.simulate import simulate
from tests.mechanisms import CONFIGS, SLIDER

G = 9.81
HEAD = "schema: 1\ngravity: [0, -9.81, 0]\n"
PENDULUM = f"""{HEAD}
robot:
  joints: [{{name: swing, type: revolute, axis: [0, 0, 1]}}]
  links: [{{name: rod, mass: 2, com: [0, -0.5, 0], inertia: {{zz: 0}}}}]
  points: {{tip: {{link: rod, at: [0, -1, 0]}}}}
initial: {{q: {{swing: 2.0}}}}
simulate: {{duration: 1.9, samples: 7}}
"""
BALL = f"""{HEAD}
robot:
  joints: [{{name: height, type: prismatic, axis: [0, 1, 0], limits: {{lower: 0, stop: {{restitution: 0.5}}}}}}]
  links: [{{name: ball, mass: 2, com: [0, 0, 0]}}]
  points: {{middle: {{link: ball, at: [0, 0.1, 0]}}}}
initial: {{q: {{height: 1.5}}}}
simulate: {{duration: 0.9, samples: 5}}
"""
OSCILLATOR = f"""{HEAD.replace("-9.81", "0")}
robot:
  joints:
    - {{name: x, type: prismatic, axis: [1, 0, 0], spring: {{stiffness: 50, rest: 1}}, friction: {{viscous: 6}}}}
  links: [{{name: mass, mass: 2, com: [0, 0, 0]}}]
initial: {{q: {{x: 0}}}}
simulate: {{duration: 8, samples: 9}}
outputs: {{signals: {{over: {{value: x - 1, unit: m}}}}}}
"""


def extremes(text: str, *names: str, **outputs: Any) -> dict[str, Any]:
    """Return the extremes of columns in a simulation."""
    scene = load_scene_text(text)
    asked = dataclasses.replace(scene.outputs, extremes=names, **outputs)
    found: dict[str, Any] = simulate(dataclasses.replace(scene, outputs=asked)).summary["extremes"]
    return found


def close(extreme: Any, name: str, expected: float, off: float = math.inf) -> None:
    """Judge one figure by its error, which is no more than ``off``."""
    error = extreme["errors"][name]
    assert abs(extreme[name] - expected) <= error + 1e-15 * abs(expected), (
        name,
        extreme[name],
        expected,
        error,
    )
    assert error <= off, (name, error)


# -- closed forms ------------------------------------------------------------------------------------------------
def test_of_a_pendulum_are_its_amplitude_and_half_its_period() -> None:
    found = extremes(
        PENDULUM, "q.swing", "qd.swing", "points/tip.y", "point_velocities/tip.length", "energy/total"
    )
    rate, half = math.sqrt(G / 0.5), 2.0 * ellipk(math.sin(1.0) ** 2) / math.sqrt(G / 0.5)
    fastest = math.sqrt(2.0) * rate * math.sqrt(1.0 - math.cos(2.0))
    swing, speed = found["q.swing"], found["qd.swing"]
    close(swing, "smallest", -2.0, 1e-9)
    close(swing, "smallest_time", half, 1e-6)
    close(swing, "largest", 2.0, 1e-9)
    close(speed, "smallest", -fastest, 1e-8)
    close(speed, "smallest_time", 0.5 * half, 1e-6)
    close(found["points/tip.y"], "smallest", -1.0, 1e-9)
    close(found["points/tip.y"], "largest", -math.cos(2.0), 1e-9)
    close(found["point_velocities/tip.length"], "largest", fastest, 1e-8)
    close(found["point_velocities/tip.length"], "smallest", 0.0, 1e-4)
    assert (swing["unit"], found["point_velocities/tip.length"]["unit"]) == ("rad", "m/s")
    assert found["energy/total"]["unit"] == "J"


def test_errors_of_peaks_hold_whatever_the_steps_are() -> None:
    """Between steps an integration errs erratically: what a single more accurate one agrees with may be off."""
    random, closed = np.random.default_rng(0), math.sqrt(G / 0.5)
    for method in 12 * ["dop853", "radau", "gauss", "taylor12"]:
        start, rtol = random.uniform(0.3, 2.5), 10.0 ** random.uniform(-9.0, -6.0)
        text = PENDULUM.replace("swing: 2.0", f"swing: {start}").replace(
            "samples: 7", f"samples: 7, integrator: {method}, rtol: {rtol}, atol: {1e-2 * rtol}"
        )
        found = extremes(text.replace("duration: 1.9", "duration: 4"), "q.swing", "qd.swing")
        fastest = closed * math.sqrt(2.0 * (1.0 - math.cos(start)))
        close(found["q.swing"], "smallest", -start)
        close(found["qd.swing"], "smallest", -fastest)
        close(found["qd.swing"], "largest", fastest)


def test_of_an_oscillator_is_its_overshoot() -> None:
    """m x'' + c x' + k (x - 1) = 0 from rest at 0: 1 + exp(-pi zeta / sqrt(1 - zeta^2)) at pi / omega_d."""
    found = extremes(OSCILLATOR, "q.x", "signals/over")
    omega, zeta = math.sqrt(50 / 2), 6 / (2 * math.sqrt(50 * 2))
    damped = omega * math.sqrt(1.0 - zeta**2)
    over = math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2))
    close(found["q.x"], "largest", 1.0 + over, 1e-9)
    close(found["q.x"], "largest_time", math.pi / damped, 1e-7)
    close(found["signals/over"], "largest", over, 1e-9)
    close(found["signals/over"], "smallest", -1.0, 1e-12)
    assert found["signals/over"]["unit"] == "m"


def test_of_a_bouncing_ball_are_the_values_on_both_sides_of_the_impact() -> None:
    found = extremes(BALL, "q.height", "qd.height", "qdd.height", "points/middle.y")
    fall = math.sqrt(2.0 * 1.5 / G)
    close(found["qd.height"], "smallest", -G * fall, 1e-9)
    close(found["qd.height"], "smallest_time", fall, 1e-9)
    close(found["qd.height"], "largest", 0.5 * G * fall, 1e-9)
    close(found["qd.height"], "largest_time", fall, 1e-9)
    close(found["q.height"], "smallest", 0.0, 1e-9)
    close(found["qdd.height"], "largest", -G, 1e-9)
    close(found["points/middle.y"], "largest", 1.6, 1e-12)
    later = 0.9 - fall
    close(found["q.height"], "final", 0.5 * G * fall * later - 0.5 * G * later**2, 1e-9)


SWITCH = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: x, type: prismatic, axis: [1, 0, 0]}]
  links: [{name: m, mass: 2}]
torques: {x: "if(x > 0.3, 3 - 2*x, -1 - x)"}
initial: {q: {x: 1}, qd: {x: -1.5}}
simulate: {duration: 4, samples: SAMPLES}
"""


@pytest.mark.parametrize("samples", [5, 301])
def test_of_a_force_that_the_state_switches_are_the_values_on_both_sides(samples: int) -> None:
    found = extremes(SWITCH.replace("SAMPLES", str(samples)), "tau.x", "qdd.x", "q.x")
    assert found["q.x"]["smallest"] < 0.3
    close(found["tau.x"], "largest", 3.0 - 2.0 * 0.3, 1e-9)
    close(found["qdd.x"], "largest", 0.5 * (3.0 - 2.0 * 0.3), 1e-9)


def test_the_largest_height_behind_an_impact_is_that_of_its_rebound() -> None:
    """Thrown down from 0.3 m so fast that it comes back higher: e^2 (v^2 + 2 g h) / 2 g, by the restitution e."""
    thrown = BALL.replace("q: {height: 1.5}", "q: {height: 0.3}, qd: {height: -9}").replace("0.9,", "1.2,")
    up = 0.5 * math.sqrt(81.0 + 2.0 * G * 0.3)
    height = extremes(thrown, "q.height")["q.height"]
    close(height, "largest", up**2 / (2.0 * G), 1e-8)
    close(height, "largest_time", (2.0 * up - 9.0) / G + up / G, 1e-7)


def test_of_a_slider_crank_are_its_dead_points() -> None:
    scene = load_scene_text(f"""schema: 1
{SLIDER.partition("torques:")[0]}
initial: {{q: {{crank: 0.2, rod: -0.3, slide: 1.1}}}}
kinematics: {{samples: 201, sweep: {{joint: crank, start: 0.2, stop: 6.4, rate: 2}}}}
outputs: {{extremes: [q.slide]}}
""")
    slide = kinematics(scene).summary["extremes"]["q.slide"]
    close(slide, "largest", 1.2, 1e-8)
    close(slide, "smallest", 0.6, 1e-8)
    close(slide, "smallest_time", (math.pi - 0.2) / 2.0, 1e-5)
    assert slide["unit"] == "m"


# -- whatever the samples are --------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["bouncing_pendulum", "stick_slip", "catching_arm", "four_bar_deploy"])
def test_extremes_do_not_depend_on_samples(name: str) -> None:
    """The samples of a run are not those from which its extremes follow."""
    path = CONFIGS / f"{name}.yaml"
    own = load_scene(path)
    joint = own.robot.joints[0].name
    asked = f"outputs.extremes=[q.{joint}, qd.{joint}, qdd.{joint}]"
    command = own.command or "simulate"
    one, two = (
        execute(
            command,
            load_scene(path, [asked, f"simulate.samples={n}", "expect={}", "simulate.duration=0.7"]
                       if command == "simulate" else [asked, f"simulate.samples={n}", "expect={}"]),
            no_progress, Stopwatch(),
        ).summary["extremes"]
        for n in (23, 47)
    )  # fmt: skip
    for column, x in one.items():
        for key in ("smallest", "largest", "final"):
            error = x["errors"][key] + two[column]["errors"][key]
            assert abs(x[key] - two[column][key]) <= error + 1e-14 * abs(x[key]), (column, key)


def test_samples_of_stretches_are_those_of_the_same_steps() -> None:
    """Samples between knots come from the same integration, events included, as uniform ones."""
    motion = build_motion(
        integrable(load_scene(CONFIGS / "bouncing_pendulum.yaml", ["simulate.duration=1.0"]))
    )
    knots = np.array([0.0, 0.013, 0.4, 0.41, 0.77, 1.0])
    grid = Grid.between(knots, 8)
    times = grid.times(0, grid.count)
    assert np.all(np.diff(times) > 0.0) and times[-1] == 1.0 and np.isin(knots, times).all()
    driver = Driver.of(motion)
    driver.start(0.0, motion.start)
    met: list[Any] = []
    driver.met = driver.integrator.met = met
    states = driver.samples(1.0, grid)
    assert len(states) == grid.count and len(met) >= 2
    assert any(np.abs(event.behind - event.before).max() > 0.1 for event in met)
    for k in (3, 17, 30, 39):
        other = Driver.of(motion.with_own_watchers())
        other.start(0.0, motion.start)
        alone = other.samples(1.0, Grid(float(times[k]), 1.0, 1))
        np.testing.assert_allclose(states[k], alone[0], rtol=1e-12, atol=1e-13)


# -- the polynomials --------------------------------------------------------------------------------------------------
def test_peaks_of_pieces_are_found_with_their_errors() -> None:
    def function(t: Any) -> Any:
        return np.column_stack([np.sin(3.0 * t), np.exp(-t) * np.cos(5.0 * t), np.full_like(t, 2.0)])

    ends = [0.0, 0.7, 0.7 + 1e-9, 2.0, 3.1]
    parts = []
    for k, (a, b) in enumerate(zip(ends, ends[1:])):
        t = np.linspace(a, b, 41 if b - a > 1e-6 else 2)
        parts.append((t, function(t) + 10.0 * k, a, b))
    windows = Windows(parts)
    dense = np.concatenate([function(np.linspace(a, b, 200001)) + 10.0 * k
                            for k, (a, b) in enumerate(zip(ends, ends[1:]))])  # fmt: skip
    for k in range(3):
        least, off, _, _ = windows.best(-1.0, k)
        most, unsure, _, _ = windows.best(1.0, k)
        assert abs(least - dense[:, k].min()) <= off + 1e-9 and off < 1e-8
        assert abs(most - dense[:, k].max()) <= unsure + 1e-9 and unsure < 1e-8


def test_errors_of_times_cover_peaks_that_are_as_large() -> None:
    t = np.linspace(0.0, 2.0 * math.pi, 161)
    high = Windows([(t, np.sin(2.0 * t)[:, None], 0.0, t[-1])])
    _, _, time, off = high.best(1.0, 0)
    assert time == pytest.approx(math.pi / 4, abs=1e-6) and off >= math.pi * (1.0 - 1e-6)
    lower = Windows([(t, (np.sin(2.0 * t) - 1e-4 * t)[:, None], 0.0, t[-1])])
    assert lower.best(1.0, 0)[3] < 1e-3 and lower.best(1.0, 0, 1e-3)[3] > 3.0


@pytest.mark.parametrize("seed", range(4))
def test_windows_that_are_passed_over_hold_no_peak(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is found is the same to the bit as when all windows are looked at, for smooth and rough samples."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 3.0, 257)
    phases, rates = rng.uniform(0.0, 6.3, (12, 3)), rng.uniform(0.5, 40.0, (12, 3))
    y = np.sin(t[:, None, None] * rates + phases).sum(axis=1) + rng.choice([0.0, 1e-3, 1.0]) * rng.normal(
        size=(257, 3)
    )
    jump = rng.normal(size=3)
    parts = [(t[:129], y[:129], 0.0, 1.502), (t[129:], y[129:] + jump, 1.502, 3.0)]
    found = [
        [Windows(parts).best(sign, k, doubt) for sign in (-1.0, 1.0) for k in range(3)]
        for doubt in (0.0, 0.3)
    ]
    monkeypatch.setattr("robodyn_cli.solve.peaks.BEYOND", np.inf)
    looked = [
        [Windows(parts).best(sign, k, doubt) for sign in (-1.0, 1.0) for k in range(3)]
        for doubt in (0.0, 0.3)
    ]
    for own, all_of_them in zip(found, looked):
        np.testing.assert_allclose(own, all_of_them, rtol=1e-14, atol=1e-14)


def test_a_single_sample_between_jumps_says_that_it_does_not_know() -> None:
    parts = [
        (np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), 0.0, 1.0),
        (np.array([1.5]), np.array([[5.0]]), 1.0, 2.0),
    ]
    value, error, _, _ = Windows(parts).best(1.0, 0)
    assert value == 5.0 and error > 1.0


# -- what is asked, and how -------------------------------------------------------------------------------------------
def test_expectations_ask_for_what_they_name() -> None:
    scene = load_scene_text(
        PENDULUM + "command: simulate\nexpect: {extremes.reactions/swing.force.largest: < 90}\n"
    )
    assert scene.outputs.extremes == ("reactions/swing.force",) and scene.outputs.reactions
    assert simulate(scene).summary["extremes"]["reactions/swing.force"]["unit"] == "N"


def test_signals_that_count_from_a_time_on_are_cut_there() -> None:
    """What is left of an oscillation after a time, for settling: x = 0.1 - 0.1 e^(-2 t) (cos(w t) + 2/w sin(w t))."""
    text = """
schema: 1
command: simulate
gravity: [0, 0, 0]
robot:
  joints: [{name: slide, type: prismatic, axis: [1, 0, 0], spring: {stiffness: 100, rest: 0.1}, damper: {damping: 4}}]
  links: [{name: block, mass: 1}]
initial: {q: {slide: 0}}
simulate: {duration: 4, samples: 11}
outputs:
  signals: {late: "if(t < START s, 0, abs(slide - 100 mm))", band: "step(t - START)*(slide - 0.1)"}
  extremes: [signals/late, signals/band]
"""
    for start in (0.7, 1.6, 2.345):
        result = simulate(load_scene_text(text.replace("START", str(start))))
        w, t = math.sqrt(96.0), np.linspace(start, 4.0, 2_000_001)
        left = -0.1 * np.exp(-2 * t) * (np.cos(w * t) + 2 / w * np.sin(w * t))
        late, band = (result.summary["extremes"][f"signals/{name}"] for name in ("late", "band"))
        for own, most, least in ((late, np.abs(left).max(), 0.0), (band, left.max(), min(left.min(), 0.0))):
            assert abs(own["largest"] - most) <= own["errors"]["largest"] + 1e-10 <= 1e-3
            assert abs(own["smallest"] - least) <= own["errors"]["smallest"] + 1e-10 <= 1e-3


def test_a_plain_run_has_no_extremes() -> None:
    scene = load_scene_text(PENDULUM)
    assert scene.outputs.extremes == () and "extremes" not in simulate(scene).summary


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("outputs: {extremes: [q.swng]}", "did you mean 'q.swing'"),
        ("outputs: {extremes: [points/tp.x]}", "did you mean 'points/tip.x'"),
        ("outputs: {extremes: [swing]}", "no column 'swing'"),
        ("expect: {extremes.q.swng.largest: 1}", "did you mean 'extremes.q.swing.largest'"),
        ("expect: {extremes.q.swing.largst: 1}", "did you mean 'extremes.q.swing.largest'"),
        ("expect: {extremes.q.swing: 1}", "holds several values"),
        ("study: {of: [extremes.tau.wing.largest]}", "did you mean 'extremes.tau.swing.largest'"),
    ],
)
def test_columns_that_no_run_has_are_refused_with_the_nearest(text: str, words: str) -> None:
    with pytest.raises(SceneError, match=r"(?s)extremes") as refused:
        load_scene_text(f"{PENDULUM}command: simulate\n{text}\n")
    assert words in refused.value.message


def test_kinematics_has_no_forces() -> None:
    with pytest.raises(SceneError, match="no column 'tau.crank'"):
        load_scene(
            CONFIGS / "mechanisms" / "four_bar_kinematics.yaml", ["outputs.extremes=[tau.crank]", "expect={}"]
        )


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("controlled_arm", ["outputs.reactions=true", "simulate.duration=0.02"]),
        ("four_bar_deploy", ["outputs.reactions=true"]),
        ("cart_pole_lqr", ["simulate.duration=0.02"]),
        ("mechanisms/four_bar_kinematics", []),
        ("stick_slip", ["simulate.duration=0.02"]),
    ],
)
def test_the_columns_of_a_scene_are_those_of_its_runs(name: str, given: list[str]) -> None:
    """Names that are known before the run are those of its table of samples, but for lengths and what is left out."""
    scene = load_scene(CONFIGS / f"{name}.yaml", [*given, "expect={}"])
    result = execute(scene.command or "", scene, no_progress, Stopwatch())
    known = set(column_names(scene, places_of(scene)))
    real = {column.label for column in tables(result)["samples"]}
    left_out = (
        "time",
        "constraints/",
        "singularity/",
        "skeleton/",
        "control/states",
        "drives/",
        "limits/",
        "targets/",
    )
    assert not {x for x in real - known if not x.startswith(left_out)}
    assert not {x for x in known - real if not x.startswith(("reactions/", "loop_reactions/", "force_wrenches/", "base_wrench"))
                and x.rpartition(".")[2] != "length"
                and x not in ("energy/work",) and not x.startswith("control/")}  # fmt: skip
    for column, unit in units_of_columns(scene, places_of(scene)).items():
        made = chosen(result.variables, column)
        assert made is None or made.unit == unit or column.startswith("signals/"), column


@pytest.mark.parametrize(
    ("key", "bound", "words"),
    [
        ("extremes.q.swing.largest", "< 5 mm", "angle in rad expected"),
        ("extremes.qd.swing.final", "< 5 mm/s", "angular rate in rad/s expected"),
        ("extremes.tau.swing.smallest", "-5 N .. 5 N", "torque in N m expected"),
        ("extremes.reactions/swing.fx.largest", "< 5 N m", "force in N expected"),
        ("extremes.energy/kinetic.largest", "< 5 W", "in J expected"),
        ("extremes.q.swing.largest_time", "1 m", "time in s expected"),
        ("extremes.q.swing.errors.largest", "< 1 mm", "angle in rad expected"),
        ("extremes.signals/height.largest", "< 5 deg", "length in m expected"),
    ],
)
def test_bounds_of_another_kind_than_their_column_are_refused(key: str, bound: str, words: str) -> None:
    signals = "outputs: {signals: {height: {value: 0.3*q.swing, unit: m}, bare: 2*q.swing}}"
    head = f"{PENDULUM}command: simulate\n{signals}\n"
    for section in (
        f'expect: {{{key}: "{bound}"}}',
        f'search: {{reach: {{{key}: "{bound.partition("..")[0].strip("< ")}"}}}}',
    ):
        with pytest.raises(SceneError) as refused:
            load_scene_text(f"{head}{section}\n")
        assert key in refused.value.message and words in refused.value.message
    load_scene_text(f'{head}expect: {{extremes.signals/bare.largest: "< 5 kg", {key}: < 3}}\n')


def test_the_key_of_a_column_has_its_unit() -> None:
    leaf = leaf_of("simulate", "extremes.reactions/swing.force.largest")
    assert leaf is not None and leaf.names == ("reactions/swing.force",)
    assert leaf.unit({"reactions/swing.force": "N"}) == "N" and leaf.is_number
    assert leaf.errors == ("extremes.reactions/swing.force.errors.largest",)


def test_many_runs_have_extremes_of_compiled_runs() -> None:
    mechanism = Mechanism(load_scene_text(PENDULUM), ["initial.q.swing"])
    runs = mechanism.simulate_many([[1.0], [2.0]], of=["extremes.q.swing.smallest"])
    np.testing.assert_allclose(runs.outputs["extremes.q.swing.smallest"], [-1.0, -2.0], atol=1e-9)
    assert not runs.one_by_one.any() and np.all(runs.errors["extremes.q.swing.smallest"] < 1e-9)


NAMES = (
    "q.swing",
    "qd.swing",
    "qdd.swing",
    "point_accelerations/tip.length",
    "reactions/swing.force",
    "energy/kinetic",
)


def test_a_run_that_goes_on_has_the_extremes_of_its_own_part(tmp_path: Path) -> None:
    """Of both parts together they are those of the whole run; each states its own, within the errors of both."""
    whole = extremes(PENDULUM, *NAMES, reactions=True)
    text = PENDULUM.replace("duration: 1.9", "duration: 0.8")
    asked = dataclasses.replace(load_scene_text(text).outputs, extremes=NAMES)
    first = simulate(
        dataclasses.replace(load_scene_text(text), outputs=dataclasses.replace(asked, reactions=True))
    )
    write(first, tmp_path / "first.h5")
    later = PENDULUM.replace("{q: {swing: 2.0}}", f"{{from: {tmp_path / 'first.h5'}}}")
    second = extremes(later, *NAMES, reactions=True)
    for name in NAMES:
        one, two, both = first.summary["extremes"][name], second[name], whole[name]
        for side, better in (("smallest", min), ("largest", max)):
            of = better(one, two, key=lambda x, side=side: x[side])
            off = of["errors"][side] + both["errors"][side] + 1e-9 * (1 + abs(both[side]))
            assert abs(of[side] - both[side]) <= off, (name, side)
        assert (
            abs(two["final"] - both["final"]) <= two["errors"]["final"] + both["errors"]["final"] + 1e-9 * 20
        )


def test_rows_of_many_runs_and_sweeps_are_those_of_single_runs() -> None:
    keys = [f"extremes.{name}.{side}" for name in NAMES for side in ("smallest", "largest_time", "final")]
    starts = [1.0, 2.0, 2.9]
    runs = Mechanism(load_scene_text(PENDULUM), ["initial.q.swing"]).simulate_many(
        [[x] for x in starts], of=keys
    )
    for row, start in enumerate(starts):
        own = extremes(PENDULUM.replace("swing: 2.0", f"swing: {start}"), *NAMES, reactions=True)
        for key in keys:
            name, _, side = key.removeprefix("extremes.").rpartition(".")
            error = own[name]["errors"][side]
            off = (error or 0.0) + runs.errors[key][row]
            assert abs(runs.outputs[key][row] - own[name][side]) <= off, (key, start)
            # runs side by side round otherwise than a run alone
            assert runs.errors[key][row] == pytest.approx(error, rel=1e-3, abs=1e-13)
    assert not runs.one_by_one.any()


def test_any_of_many_equal_swings_may_be_the_largest_but_none_beyond_the_run() -> None:
    found = extremes(PENDULUM.replace("duration: 1.9", "duration: 60"), *NAMES, reactions=True)
    for own in found.values():
        for side in ("smallest_time", "largest_time"):
            assert own["errors"][side] <= max(own[side], 60.0 - own[side])
    assert any(own["errors"]["largest_time"] > 20.0 for own in found.values())


def test_a_run_of_more_steps_than_are_looked_into_has_no_errors_between_samples(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Polynomials through samples of many steps told -5 +- 3 m of a point that is half a metre from its joint."""
    long = PENDULUM.replace("duration: 1.9", "duration: 400")
    full = extremes(long, *NAMES, reactions=True)
    monkeypatch.setattr("robodyn_cli.motion.between.extremes.MOST", 2**9)
    scene = load_scene_text(long)
    asked = dataclasses.replace(scene.outputs, extremes=NAMES, reactions=True)
    summary = simulate(dataclasses.replace(scene, outputs=asked)).summary
    assert any("more steps than are looked into" in text for text in summary["warnings"])
    for name, own in summary["extremes"].items():
        sure = full[name]
        assert set(own["errors"].values()) == {None} and sure["errors"]["largest"] is not None
        span = sure["largest"] - sure["smallest"]
        for side in ("smallest", "largest"):
            beyond = (own[side] - sure[side]) * (1.0 if side == "largest" else -1.0)
            assert -0.05 * span <= beyond <= sure["errors"][side] + 1e-9 * span, (name, side)
    load = summary["reactions"]["largest"]["swing"]
    assert (
        load["force_error"] is None
        and 0.9 < load["peak_force"] / full["reactions/swing.force"]["largest"] <= 1.0
    )
    runs = Mechanism(load_scene_text(long), ["initial.q.swing"]).simulate_many(
        [[2.0]], of=["extremes.q.swing.largest"]
    )
    assert np.isnan(runs.errors["extremes.q.swing.largest"][0])


def test_runs_of_which_none_comes_to_its_end_have_no_extremes() -> None:
    scene = load_scene_text(PENDULUM, overrides=["simulate.max_steps=3"])
    keys = ["extremes.q.swing.largest", "reactions.largest.swing.peak_force"]
    runs = Mechanism(scene, ["initial.q.swing"]).simulate_many([[1.0], [2.0]], of=keys)
    assert not runs.ok.any() and all(np.isnan(runs.outputs[key]).all() for key in keys)


def test_validate_tells_of_a_dead_point_into_which_a_mechanism_is_driven() -> None:
    """As the command does; a motion that ends before it has extremes, and so has one that loads drive."""
    from robodyn_cli.over.commands import check

    for given, refused in (([], True), (["simulate.duration=11.4"], False), (["prescribed=null"], False)):
        scene = load_scene(
            CONFIGS / "four_bar_prescribed.yaml", [*given, "outputs.extremes=[q.phi2]", "expect={}"]
        )
        if refused:
            with pytest.raises(CapabilityError, match="driven into a dead point"):
                check("deploy", scene)
            with pytest.raises(CapabilityError, match="driven into a dead point"):
                execute("deploy", scene, no_progress, Stopwatch())
        else:
            check("deploy", scene)
