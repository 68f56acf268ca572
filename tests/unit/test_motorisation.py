"""Margins of motorisation against closed forms, power balances by hand, and other samples; what is refused."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robodyn_cli import SceneError, deploy, inverse, load_scene, load_scene_text, simulate
from robodyn_cli.errors import CapabilityError
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.results.result import Result
from robodyn_cli.works.kinematics import kinematics
from tests.cli.tool import invoke

CONFIGS = Path(__file__).parents[2] / "configs"


def ratios(result: Result, kind: str) -> np.ndarray:
    """Return the curves (T, n) of ratios."""
    sides = (result[f"motorisation/{kind}_{side}"] for side in ("available", "resistance"))
    available, resistance = sides
    return np.asarray(available / resistance)


def test_the_hinge_of_the_example_in_closed_form() -> None:
    result = inverse(load_scene(CONFIGS / "deployable_hinge.yaml"))
    q, qdd = result["q"][:, 0], result["qdd"][:, 0]
    resistance = 3 * 0.25 + 3 * 0.15 * q
    drive = 2 * (math.radians(200) - q)
    inertia = 1.6 + 12 * 0.6**2
    np.testing.assert_allclose(ratios(result, "static")[:, 0], drive / resistance, rtol=1e-12)
    by_hand = (drive - 1.25 * np.maximum(0.0, inertia * qdd)) / resistance
    np.testing.assert_allclose(ratios(result, "dynamic")[:, 0], by_hand, rtol=1e-12)
    figures = result.summary["motorisation"]["hinge"]
    exact = 2 * math.radians(110) / (0.75 + 0.45 * math.pi / 2)
    assert abs(figures["ratio"] - exact) <= figures["errors"]["ratio"] <= 1e-9
    assert abs(figures["angle"] - math.pi / 2) <= figures["errors"]["angle"] <= 1e-4
    assert figures["met"] is True and figures["required"] == 2.0
    assert result.status == "ok"


def hinge(**given: Any) -> str:
    """Return the scene of a panel on a hinge, under gravity, led through an angle."""
    keys = {"k": 3.0, "rest": 2.6, "friction": 0.2, "viscous": 0.1, "cable": 0.1, "mass": 0.4, "angle": 1.5}
    keys |= {
        "duration": 2.0,
        "required": 1.0,
        "samples": 201,
        "factor": 3.0,
        "outside": 1.25,
        "gravity": 0.4,
        **given,
    }
    return """
schema: 1
gravity: [0, -{gravity}, 0]
robot:
  joints:
    - name: hinge
      type: revolute
      axis: [0, 0, 1]
      spring: {{stiffness: {k}, rest: {rest}, role: drive}}
      friction: {{coulomb: {friction}, viscous: {viscous}, transition_speed: 1.0e-4}}
  links: [{{name: panel, mass: {mass}, com: [0.3, 0, 0], inertia: {{zz: 0.05}}}}]
  points: {{one: {{link: base, at: origin}}, two: {{link: panel, at: origin}}}}
forces:
  - {{name: cable, type: torsional_spring, between: [one, two], stiffness: {cable}, rest: 0.5, role: harness}}
trajectory: {{type: quintic, points: [{{t: 0, q: {{hinge: 0}}}}, {{t: {duration}, q: {{hinge: {angle}}}}}]}}
motorisation:
  {{factors: {{friction: {factor}, harness: 2}}, outside: {{drive_inertia: {outside}, load: 1}}, required: {required}}}
inverse: {{samples: {samples}}}
initial: {{q: {{hinge: 0}}}}
simulate: {{duration: 0.8, samples: {samples}}}
""".format(**keys)


POSITIVE = st.floats(0.05, 1.0)


@settings(max_examples=15, deadline=None)
@given(
    k=st.floats(1.0, 5.0), rest=st.floats(1.6, 3.0), friction=POSITIVE, viscous=POSITIVE, cable=POSITIVE, mass=POSITIVE,
    duration=st.floats(0.5, 5.0), required=st.floats(0.1, 3.0), sign=st.sampled_from([-1.0, 1.0]),
)  # fmt: skip
def test_random_hinges_in_closed_form(sign: float, **keys: float) -> None:
    """The least of both ratios, on a fine grid by hand, is the one told, within its error; so is the verdict."""
    angle, rest = sign * 1.5, sign * keys["rest"]
    result = inverse(load_scene_text(hinge(**{**keys, "rest": rest, "angle": angle})))
    s = np.linspace(0.0, 1.0, 40_001)
    q = angle * s**3 * (10 - 15 * s + 6 * s**2)
    qd = angle * 30 * s**2 * (1 - s) ** 2 / keys["duration"]
    qdd = angle * 60 * s * (1 - s) * (1 - 2 * s) / keys["duration"] ** 2
    gravity = np.maximum(0.0, sign * keys["mass"] * 0.4 * 0.3 * np.cos(q))
    cable = 2 * np.maximum(0.0, sign * keys["cable"] * (q - 0.5))
    inertia = 1.25 * np.maximum(0.0, sign * (0.05 + keys["mass"] * 0.09) * qdd)
    drive = sign * keys["k"] * (rest - q) - gravity
    static = drive / (3 * keys["friction"] + cable)
    dynamic = (drive - inertia) / (3 * (keys["friction"] + keys["viscous"] * np.abs(qd)) + cable)
    figures = result.summary["motorisation"]["hinge"]
    for kind, curve in (("static", static), ("dynamic", dynamic)):
        own, least = figures[kind], float(curve.min())
        assert abs(own["ratio"] - least) <= own["errors"]["ratio"] + 1e-6 * (1 + abs(least)), kind
        at = float(s[int(curve.argmin())]) * keys["duration"]
        assert abs(own["time"] - at) <= own["errors"]["time"] + 1e-3 * keys["duration"], kind
        assert abs(own["angle"] - np.interp(at, s * keys["duration"], q)) <= own["errors"]["angle"] + 1e-3
    least = min(float(static.min()), float(dynamic.min()))
    assert figures["ratio"] == min(figures["static"]["ratio"], figures["dynamic"]["ratio"])
    if abs(least - keys["required"]) > 1e-3:
        assert figures["met"] is (least > keys["required"])
        assert result.status == ("ok" if least > keys["required"] else "undersized")


CRANK = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: crank, type: revolute, axis: [0, 0, 1], friction: {coulomb: 0.3, transition_speed: 1.0e-3}}
    - name: knee
      type: revolute
      axis: [0, 0, 1]
      origin: {xyz: [0.2, 0, 0]}
      friction: {coulomb: 0.1, transition_speed: 1.0e-3}
    - {name: slide, type: prismatic, parent: base, axis: [1, 0, 0], damper: {damping: 2}}
  links:
    - {name: arm, mass: 0.3, com: [0.1, 0, 0], inertia: {zz: 1.0e-3}}
    - {name: rod, mass: 0.5, com: [0.25, 0, 0], inertia: {zz: 4.0e-3}}
    - {name: block, mass: 1, com: [0, 0, 0]}
  points:
    eye: {link: rod, at: [0.5, 0, 0]}
    pin: {link: block, at: origin}
    post: {link: base, at: [1, 0, 0]}
loops: [{name: loop, type: revolute, between: [eye, pin]}]
forces: [{name: pull, type: spring, between: [pin, post], stiffness: 60, length: 0.1, role: drive}]
motorisation: {factors: {friction: 3}, required: 1.5, joints: [JOINT]}
initial: {q: {crank: 120 deg, knee: -140 deg, slide: 0.3}, hold: [crank]}
kinematics: {sweep: {joint: crank, start: 120 deg, stop: 40 deg, rate: 0.5}, samples: 161}
simulate: {duration: 0.15, samples: 151}
"""


@pytest.mark.parametrize("joint", ["crank", "knee", "slide"])
def test_a_slider_crank_by_its_power_balance(joint: str) -> None:
    """Onto whichever joint, the ratio is the spring's power over that of friction, factored."""
    result = kinematics(load_scene_text(CRANK.replace("JOINT", joint)))
    (crank, knee, slide), (w, u, v) = result["q"].T, result["qd"].T
    np.testing.assert_allclose(slide, 0.2 * np.cos(crank) + 0.5 * np.cos(crank + knee), atol=1e-12)
    power = 60 * (1.0 - slide - 0.1) * v
    friction = 3 * (0.3 * np.abs(w) + 0.1 * np.abs(u))
    np.testing.assert_allclose(ratios(result, "static")[:, 0], power / friction, rtol=1e-9)
    figures = result.summary["motorisation"]
    assert list(figures) == [joint]
    least = float((power / friction).min())
    assert abs(figures[joint]["ratio"] - least) <= figures[joint]["errors"]["ratio"] + 1e-6
    assert "dynamic" not in figures[joint]


def test_a_simulated_slider_crank_has_its_damping_in_the_dynamic_ratio() -> None:
    result = simulate(load_scene_text(CRANK.replace("JOINT", "slide")))
    slide, (w, u, v) = result["q"][:, 2], result["qd"].T
    friction = (3 * (0.3 * np.abs(w) + 0.1 * np.abs(u)))[1:]
    power, lost = (60 * (1.0 - slide - 0.1) * v)[1:], (3 * 2 * v**2)[1:]
    np.testing.assert_allclose(ratios(result, "dynamic")[1:, 0], power / (friction + lost), rtol=1e-9)
    np.testing.assert_allclose(ratios(result, "static")[1:, 0], power / friction, rtol=1e-9)


def test_errors_cover_other_samples_and_tolerances() -> None:
    """Of a simulated motion: with other samples and a looser tolerance the figures move less than they say."""
    fine = simulate(load_scene_text(hinge(samples=801))).summary["motorisation"]["hinge"]
    for changes in (["simulate.samples=77"], ["simulate.rtol=1e-5", "simulate.atol=1e-7"]):
        other = simulate(load_scene_text(hinge(samples=801), overrides=changes)).summary["motorisation"][
            "hinge"
        ]
        for kind in ("static", "dynamic"):
            for key in ("ratio", "time", "angle"):
                off = abs(other[kind][key] - fine[kind][key])
                assert off <= other[kind]["errors"][key] + fine[kind]["errors"][key], (changes, kind, key)


def test_two_samples_say_little() -> None:
    """Errors of figures of two samples cover what those of many say, or are not known."""
    for run, key in ((simulate, "simulate"), (inverse, "inverse")):
        many, few = (
            run(load_scene_text(hinge(), overrides=[f"{key}.samples={n}"])).summary["motorisation"]["hinge"]
            for n in (2001, 2)
        )
        for kind in ("static", "dynamic"):
            error = few[kind]["errors"]["ratio"]
            assert error is None or abs(few[kind]["ratio"] - many[kind]["ratio"]) <= error


def test_a_panel_that_never_moves_is_driven_where_its_spring_pulls() -> None:
    text = hinge(friction=9.0, gravity=0).replace("viscous: 0.1, transition_speed: 1.0e-4", "law: set_valued")
    result = simulate(load_scene_text(text))
    assert not result["qd"].any()
    figures = result.summary["motorisation"]["hinge"]
    # the cable, free at 0.5 rad, helps
    assert figures["ratio"] == pytest.approx(3.0 * 2.6 / 27.0, rel=1e-11)
    assert result.status == "undersized"


def test_a_controller_drives_with_what_it_gives() -> None:
    text = hinge(k=0.0).replace("{stiffness: 0.0", "{stiffness: 1.0e-30") + (
        "control: {type: pd, gains: {kp: 20, kd: 2}, reference: {type: quintic, points: "
        "[{t: 0, q: {hinge: 0}}, {t: 0.8, q: {hinge: 1.5}}]}}\n"
    )
    result = simulate(load_scene_text(text))
    q, qd, tau = (result[name][:, 0] for name in ("q", "qd", "tau"))
    sign = np.sign(qd)
    gravity = np.maximum(0.0, sign * 0.4 * 0.4 * 0.3 * np.cos(q))
    cable = 2 * np.maximum(0.0, sign * 0.1 * (q - 0.5))
    by_hand = (sign * tau - gravity) / (3 * (0.2 + 0.1 * np.abs(qd)) + cable)
    moving = np.abs(qd) > 1e-6
    np.testing.assert_allclose(ratios(result, "dynamic")[moving, 0], by_hand[moving], rtol=1e-9, atol=1e-9)


def test_a_deployment_that_locks_with_too_small_a_margin_is_undersized() -> None:
    friction = "robot.joints.phi1.friction={coulomb: 0.01, transition_speed: 1e-3}"
    for required, status in ((1e-3, "locked"), (1e9, "undersized")):
        latch = ["deploy.criterion=latch", "deploy.latch={between: [coupler, follower], at: {theta1: 2.5}}"]
        changes = ["expect={}", friction, f"motorisation={{required: {required}}}", *latch]
        result = deploy(load_scene(CONFIGS / "four_bar_deploy.yaml", changes))
        figures = result.summary["motorisation"]["theta1"]
        assert figures["decides"] == "phi1.friction"
        n = int(np.argmin(np.abs(result.time - figures["time"])))
        by_hand = (1.96 - 0.1 * result["q"][n, 0]) / (0.01 * abs(result["qd"][n, 2] / result["qd"][n, 0]))
        assert figures["ratio"] == pytest.approx(by_hand, rel=0.02)
        assert result.status == status
        assert result.summary["lock"] is not None


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_second_run_that_locks_before_the_last_sample_of_the_first() -> None:
    """Multipliers are large enough at a sample, or a step of the scan behind it: the second run's times went back."""
    friction = "robot.joints.phi1.friction={coulomb: 0.01, transition_speed: 1e-3}"
    changes = ["expect={}", friction, "motorisation={required: 1e-3}", "deploy.criterion=multipliers"]
    result = deploy(load_scene(CONFIGS / "four_bar_deploy.yaml", [*changes, "simulate.samples=1001"]))
    figures, lock = result.summary["motorisation"]["theta1"], result.summary["lock"]
    assert np.diff(result.time).min() > 0.0 and result.time[-1] == lock["time"]
    assert 0.0 < figures["errors"]["ratio"] < figures["ratio"] and figures["errors"]["time"] < 0.1
    assert 0.0 < lock["multipliers"]["errors"]["at_lock"] < 0.1 * lock["multipliers"]["at_lock"]


@pytest.mark.parametrize("rtol", [1e-9, 3e-10, 1e-10, 1e-11])
def test_the_margin_of_a_joint_is_nothing_at_its_dead_point(rtol: float) -> None:
    """On whichever side of it rounding ends the run, and the second one."""
    friction = "robot.joints.phi1.friction={coulomb: 0.01, transition_speed: 1e-3}"
    changes = ["expect={}", friction, "motorisation={required: 0.5}", f"simulate.rtol={rtol}"]
    for samples in (21, 2001):
        result = deploy(
            load_scene(CONFIGS / "four_bar_deploy.yaml", [*changes, f"simulate.samples={samples}"])
        )
        figures, lock = result.summary["motorisation"]["theta1"], result.summary["lock"]
        assert abs(figures["ratio"]) <= figures["errors"]["ratio"] < 0.5 and figures["ratio"] < 1e-7
        assert abs(figures["time"] - lock["time"]) <= figures["errors"]["time"] < 1e-3
        assert result.status == "undersized"


def test_torques_with_a_role_are_those_of_their_formula() -> None:
    plain = hinge() + "torques: {hinge: '0.3 - 0.1*qd.hinge'}\n"
    named = hinge() + "torques: {hinge: {formula: '0.3 - 0.1*qd.hinge', role: load}}\n"
    one, two = (simulate(load_scene_text(text)) for text in (plain, named))
    np.testing.assert_array_equal(one["q"], two["q"])
    assert one.summary["motorisation"]["hinge"]["static"] != two.summary["motorisation"]["hinge"]["static"]


def test_the_verdict_is_the_exit_code(tmp_path: Path) -> None:
    for required, code in ((0.1, 0), (50.0, 1)):
        (tmp_path / "scene.yaml").write_text(hinge(required=required))
        done = invoke("inverse", tmp_path / "scene.yaml", "--out", tmp_path / "out")
        assert done.code == code
        assert ("TOO LITTLE" in done.out) is (code == 1)
        assert (tmp_path / "out" / "motorisation.png").exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("role: harness", "role: cable", "robot|forces.*role.*allowed: drive, inertia, spring"),
        (
            "factors: {friction: 3.0",
            "factors: {fricton: 3.0",
            "unknown role 'fricton' .did you mean 'friction'",
        ),
        ("factors: {friction", "factors: {load: 1, friction", "'load' stands in 'factors' too"),
        ("required: 1.0", "required: 0", "motorisation.required"),
        ("required: 1.0", "joints: [hing]", "unknown joint or coordinate 'hing'"),
    ],
)
def test_what_is_wrong_is_told(old: str, new: str, words: str) -> None:
    assert old in hinge()
    with pytest.raises(SceneError, match=words):
        load_scene_text(hinge().replace(old, new))


def test_what_cannot_be_judged_is_refused() -> None:
    with pytest.raises(SceneError, match="nothing drives"):
        inverse(load_scene_text(hinge().replace("role: drive", "role: spring")))
    with pytest.raises(SceneError, match="needs one of 'table' and 'formula'"):
        load_scene_text(hinge() + "torques: {hinge: {role: drive}}\n")
    geared = hinge().replace("spring:", "gear: {efficiency: 0.8, transition_speed: 0.01}\n      spring:")
    with pytest.raises(CapabilityError, match="losses of gears"):
        simulate(load_scene_text(geared))
    payload = "payloads: [{name: part, at: two, mass: 0.1, until: {time: 0.1}}]\n"
    with pytest.raises(CapabilityError, match="payloads that come and go"):
        inverse(load_scene_text(hinge() + payload))


DRIVEN = """
schema: 1
gravity: [0, -{gravity}, 0]
catalogue:
  motors:
    m: {{type: envelope, rotor_inertia: 1.0e-5, peak: [[0, 0.3], [{top}, {least}]], continuous: [[0, 0.1], [{top}, 0.01]]}}
  gears: {{g: {{type: gear, ratio: {turns}, efficiency: {efficiency}, peak_torque: {peak}, max_speed: {fastest}}}}}
robot:
  joints:
    - {{name: hinge, type: revolute, axis: [0, 0, 1], friction: {{coulomb: 0.2, viscous: 0.1, transition_speed: 1.0e-4}}}}
  links: [{{name: panel, mass: 0.4, com: [0.3, 0, 0], inertia: {{zz: 0.05}}}}]
drives: {{hinge: {{motor: m, gear: g, mass_on: none, count: 2}}}}
trajectory: {{type: quintic, points: [{{t: 0, q: {{hinge: 0}}}}, {{t: 2, q: {{hinge: {angle}}}}}]}}
motorisation: {{factors: {{friction: 3}}, outside: {{drive_inertia: 1.25, load: 1}}}}
inverse: {{samples: {samples}}}
"""


@settings(max_examples=15, deadline=None)
@given(
    gravity=st.floats(0.0, 20.0), top=st.floats(30.0, 200.0), least=st.floats(0.0, 0.25), turns=st.floats(10.0, 80.0),
    efficiency=st.floats(0.5, 1.0), peak=st.floats(5.0, 20.0), fastest=st.floats(30.0, 300.0),
    angle=st.sampled_from([-1.5, 1.5]), samples=st.sampled_from([41, 301]),
)  # fmt: skip
def test_random_drives_give_what_motor_and_gear_can(angle: float, samples: int, **keys: float) -> None:
    """Both ratios by hand: two motors on their envelope, through a gear that bears so much and turns so fast."""
    result = inverse(load_scene_text(DRIVEN.format(angle=angle, samples=samples, **keys)))
    sign, s = np.sign(angle), np.linspace(0.0, 1.0, 200_001)
    q, qd = angle * s**3 * (10 - 15 * s + 6 * s**2), angle * 30 * s**2 * (1 - s) ** 2 / 2
    qdd = angle * 60 * s * (1 - s) * (1 - 2 * s) / 4

    def available(rate: np.ndarray) -> np.ndarray:
        speed = keys["turns"] * np.abs(rate)
        torque = np.interp(speed, [0, keys["top"]], [0.3, keys["least"]], right=0.0)
        torque = np.minimum(keys["efficiency"] * keys["turns"] * torque, keys["peak"])
        return 2 * np.where(speed > keys["fastest"], 0.0, torque)

    weight = np.maximum(0.0, sign * 0.4 * keys["gravity"] * 0.3 * np.cos(q))
    inertia = np.maximum(0.0, sign * (0.05 + 0.4 * 0.09 + 2e-5 * keys["turns"] ** 2) * qdd)
    static = (available(0 * qd) - weight) / (3 * 0.2)
    dynamic = (available(qd) - weight - 1.25 * inertia) / (3 * (0.2 + 0.1 * np.abs(qd)))
    figures = result.summary["motorisation"]["hinge"]
    for kind, curve in (("static", static), ("dynamic", dynamic)):
        own, least = figures[kind], float(curve.min())
        if own["errors"]["ratio"] is not None:
            assert abs(own["ratio"] - least) <= own["errors"]["ratio"] + 1e-5 * (1 + abs(least)), kind


@pytest.mark.parametrize(
    ("corner", "keys"),
    [
        ("largest speed of the gear", {"top": 200.0, "peak": 1e3, "fastest": 43.7}),
        ("largest speed of the motor", {"top": 43.7, "peak": 1e3, "fastest": 300.0}),
        ("what the gear bears", {"top": 90.0, "peak": 10.3, "fastest": 300.0}),
    ],
)
def test_margins_are_cut_at_corners_of_the_envelope(corner: str, keys: dict[str, float]) -> None:
    """With few samples none is near the corner, at which the ratio jumps or has a peak; it is right there too."""
    more = {"gravity": 2.0, "least": 0.1, "turns": 50.0, "efficiency": 0.8, **keys}
    own = {
        samples: inverse(load_scene_text(DRIVEN.format(angle=1.5, samples=samples, **more))).summary[
            "motorisation"
        ]["hinge"]["dynamic"]
        for samples in (41, 83, 122, 4001)
    }
    for one, two in itertools.combinations(own.values(), 2):
        assert max(x["errors"]["ratio"] for x in (one, two)) < 1e-3 * (1.0 + abs(one["ratio"])), corner
        assert abs(one["ratio"] - two["ratio"]) <= one["errors"]["ratio"] + two["errors"]["ratio"], corner


def test_what_is_asked_of_a_drive_is_not_what_it_can_give() -> None:
    """In a simulation too a joint with a drive has its envelope; a torque that asks for more changes nothing."""
    keys = {
        "gravity": 1.0,
        "top": 200.0,
        "least": 0.1,
        "turns": 50.0,
        "efficiency": 1.0,
        "peak": 20.0,
        "fastest": 300.0,
    }
    text = DRIVEN.format(angle=1.5, samples=11, **keys)
    ratios = {}
    for torque in ("1.5", "1.5 + 0*t"):
        scene = (
            text
            + f"torques: {{hinge: {torque}}}\ninitial: {{q: {{hinge: 0}}}}\nsimulate: {{duration: 0.5}}\n"
        )
        ratios[torque] = simulate(load_scene_text(scene)).summary["motorisation"]["hinge"]["static"]["ratio"]
    assert list(ratios.values()) == [pytest.approx((2 * 50 * 0.3 - 0.4 * 0.3) / 0.6, rel=1e-9)] * 2


def test_a_drive_at_rest_is_judged_against_what_acts_on_its_joint() -> None:
    keys = {
        "gravity": 10.0,
        "top": 200.0,
        "least": 0.1,
        "turns": 50.0,
        "efficiency": 1.0,
        "peak": 20.0,
        "fastest": 300.0,
    }
    text = DRIVEN.format(angle=1.5, samples=11, **keys).replace("hinge: 1.5}", "hinge: 0}")
    own = inverse(load_scene_text(text.replace("outside: {drive_inertia: 1.25, load: 1}", "joints: [hinge]")))
    ratio = own.summary["motorisation"]["hinge"]["ratio"]
    assert ratio == pytest.approx(2 * 50 * 0.3 / (0.4 * 10 * 0.3 + 3 * 0.2), rel=1e-9)


@pytest.mark.parametrize("command", ["inverse", "simulate"])
def test_many_runs_have_the_exit_code_of_the_verdict(command: str) -> None:
    mechanism = Mechanism(
        load_scene_text(hinge().replace("duration: 0.8", "duration: 0.2")), ["motorisation.required"]
    )
    runs = getattr(mechanism, f"{command}_many")([[0.1], [500.0]])
    assert runs.code.tolist() == [0, 1] and runs.reason[0] == "" and runs.reason[1]
    whole = sum(runs.left.values())  # runs of simulate, whose margins are found on samples
    assert whole == 2 * (command == "simulate") and all("margins of motorisation" in x for x in runs.left)


@pytest.mark.parametrize("joint", ["crank", "knee", "slide"])
def test_a_motor_at_a_crank_brings_its_power_to_whichever_joint(joint: str) -> None:
    """The spring's power, and that of a motor on its envelope, over that of friction, factored."""
    motor = """
catalogue:
  motors: {m: {type: envelope, peak: [[0, 0.4], [100, 0.1]], continuous: [[0, 0.1], [100, 0.1]]}}
  gears: {g: {type: gear, ratio: 30, efficiency: 0.7}}
drives: {crank: {motor: m, gear: g, mass_on: none}}
"""
    for command, run in (("static", kinematics), ("dynamic", simulate)):
        result = run(load_scene_text(CRANK.replace("JOINT", joint) + motor))
        slide, (w, u, v) = result["q"][1:, 2], result["qd"][1:].T
        rate = 0.0 if command == "static" else np.abs(30 * w)
        power = 60 * (1.0 - slide - 0.1) * v + 0.7 * 30 * np.where(
            rate > 100, 0, 0.4 - 0.003 * rate
        ) * np.abs(w)
        lost = 3 * (0.3 * np.abs(w) + 0.1 * np.abs(u)) + (3 * 2 * v**2 if command == "dynamic" else 0.0)
        np.testing.assert_allclose(ratios(result, command)[1:, 0], power / lost, rtol=1e-9)


BACK_AND_FORTH = """
schema: 1
gravity: [0, -{g}, 0]
robot:
  joints:
    - name: hinge
      type: revolute
      axis: [0, 0, 1]
      spring: {{stiffness: {k}, rest: {rest}, role: drive}}
      friction: {{coulomb: {c}, viscous: 0.2, transition_speed: 1.0e-4}}
  links: [{{name: panel, mass: {m}, com: [0.3, 0, 0], inertia: {{zz: 0.05}}}}]
trajectory:
  type: quintic
  points: [{{t: 0, q: {{hinge: {a}}}}}, {{t: 1.3, q: {{hinge: {b}}}}}, {{t: 2.9, q: {{hinge: {d}}}}}]
motorisation: {{factors: {{friction: 2}}, outside: {{drive_inertia: 1.25}}, required: 0.1}}
inverse: {{samples: {n}}}
"""


@settings(max_examples=6, deadline=None)
@given(
    g=st.sampled_from([2.0, 9.81]), k=st.floats(0.5, 5.0), rest=st.floats(-2.0, 2.0), c=POSITIVE, m=POSITIVE,
    a=st.floats(-1.2, 1.2), b=st.floats(-1.2, 1.2), d=st.floats(-1.2, 1.2),
)  # fmt: skip
# it goes back at once, by 1e-10 rad
@example(g=2.0, k=1.0, rest=0.0, c=1.0, m=1.0, a=0.76953125, b=0.50390625, d=-0.34375)
def test_least_ratios_where_a_rate_or_a_torque_changes_sign(**keys: float) -> None:
    """Gravity begins to resist and friction turns back within the motion: place and value are those of other samples."""
    found = []
    for n in (101, 332, 1501):
        result = inverse(load_scene_text(BACK_AND_FORTH.format(n=n, **keys)))
        found.append(result.summary["motorisation"]["hinge"])
    for kind, (one, two) in itertools.product(("static", "dynamic"), itertools.pairwise(found)):
        for name in ("ratio", "time", "angle"):
            if (x := one[kind][name]) is None or (y := two[kind][name]) is None:
                continue
            off, more = (each[kind]["errors"][name] for each in (one, two))
            if off is not None and more is not None:
                assert abs(x - y) <= off + more + 1e-12 * abs(y), (kind, name)


def test_the_least_ratio_at_a_bend_is_known_well() -> None:
    """Gravity begins to resist on the way down, at q = -pi / 2: the ratio has a corner there, which samples miss."""
    keys = {"g": 2.0, "k": 0.7, "rest": 2.0, "c": 0.3, "m": 1.0, "a": 0.2, "b": -2.4, "d": 1.0}
    exact = -0.7 * (2.0 + 0.5 * math.pi) / (2 * 0.3)
    for n in (301, 1501):
        result = inverse(load_scene_text(BACK_AND_FORTH.format(n=n, **keys)))
        one = result.summary["motorisation"]["hinge"]["static"]
        assert abs(one["ratio"] - exact) <= one["errors"]["ratio"] <= 1e-6 * abs(exact)
        assert abs(one["angle"] + 0.5 * math.pi) <= one["errors"]["angle"] <= 1e-3
