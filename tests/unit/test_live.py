"""Structures that run in a page, under node: rules that are recorded, runs beside those of the program, what is refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene, simulate
from robodyn_cli.errors import RobodynError
from robodyn_cli.over.c99.asked_keys import asked_key
from robodyn_cli.over.c99.folder import export_c
from robodyn_cli.over.fmu.export import export_fmu
from robodyn_cli.over.live.judging import Judging
from robodyn_cli.over.live.pages import live_parts
from robodyn_cli.over.live.rules import Tape, plain
from robodyn_cli.over.live.structure import LiveStructure
from robodyn_cli.scene.load import Family
from tests.live import Ranges, disagreements, in_node, live_data, random_rows, run_live, run_many
from tests.mechanisms import CONFIGS
from tests.node import needs_node

RNG = np.random.default_rng(11)
JUDGE = "return data.rules.map(({ rule, inputs }) => judged(rule, inputs));"


def family_of(scene: str, overrides: Sequence[str] = ()) -> Family:
    return Family(CONFIGS / scene, list(overrides))


def judged_in_node(
    rules: Sequence[tuple[Any, Mapping[str, Any]]], folder: Path
) -> list[dict[str, np.ndarray]]:
    """Return the outputs of rules for inputs, worked off by the page's script."""
    data = [
        {"rule": rule, "inputs": {k: plain(np.ravel(x)) for k, x in inputs.items()}} for rule, inputs in rules
    ]
    script = "for (const r of data.rules) for (const k in r.inputs) r.inputs[k] = Float64Array.from(r.inputs[k], Number);\n"
    made = in_node({"rules": data}, script + JUDGE.replace("judged(rule, inputs)", PLAIN), folder)
    return [{k: np.array([float(v) for v in x]) for k, x in one.items()} for one in made]


PLAIN = "Object.fromEntries(Object.entries(judged(rule, inputs)).map(([k, x]) => [k, Array.from(x, String)]))"


# -- rules ----------------------------------------------------------------------------------------------
def operations(x: Any, A: Any, wide: Any) -> dict[str, Any]:
    """Return what rules may do, of vectors (3, 4) and matrices (2, 3, 3), (2, 2, 4)."""
    changed = x.copy()
    changed[:, [0, 2]] = np.maximum(x[:, [0, 2]], 0.1)
    changed[1] = 7.0
    square = A @ np.swapaxes(A, 1, 2) + 3.0 * np.eye(3)
    sigma, vectors = np.linalg.svd(wide, full_matrices=False)[1:]
    place = (sigma > 0.0).sum(axis=1)[:, None] - 1
    return {
        "changed": changed, "rows": np.concatenate([x[:, None], changed[:, None]], axis=1)[:, ::-1, 1:],
        "sums": x.sum(axis=0) + x.max(axis=(0, 1), initial=0.0) - x.min(axis=1)[:, None],
        "told": (x > 0.0) & ~(x > 0.5) | np.isnan(x), "all": (x < 9.0).all(axis=1), "any": (x < -1.0).any(axis=0),
        "chosen": np.where(np.isfinite(x), np.sqrt(np.abs(x)) ** 1.5, -x), "rounded": np.rint(4.0 * x), "sign": np.sign(x),
        "solved": np.linalg.solve(square, A), "det": np.linalg.det(A), "sorted": np.sort(x, axis=1),
        "inverse": np.linalg.pinv(wide, rcond=1e-12) @ wide, "sigma": sigma, "logarithm": np.log(np.exp(x) + 1.0),
        "least": np.take_along_axis(sigma, place, axis=1)[:, 0],
        "along": np.abs(np.take_along_axis(vectors, place[:, :, None], axis=1)[:, 0]),
    }  # fmt: skip


@needs_node
def test_all_operations_come_out_as_those_of_numpy(tmp_path: Path) -> None:
    inputs = {
        "x": RNG.normal(size=(3, 4)),
        "A": RNG.normal(size=(2, 3, 3)),
        "wide": RNG.normal(size=(2, 2, 4)),
    }
    inputs["x"][0, 1], inputs["x"][0, 2] = 0.625, -0.125  # halves, when they are rounded
    tape = Tape()
    recorded = operations(*(tape.input(name, RNG.normal(size=x.shape)) for name, x in inputs.items()))
    rule = {"code": tape.code, "outputs": {k: x.place for k, x in recorded.items()}}
    (got,) = judged_in_node([(rule, inputs)], tmp_path)
    for name, expected in operations(*inputs.values()).items():
        np.testing.assert_allclose(got[name], np.ravel(expected), rtol=1e-12, atol=1e-12, err_msg=name)


def test_a_rule_may_not_branch_on_values() -> None:
    x = Tape().input("x", np.ones(3))
    with pytest.raises(TypeError, match="branches on values"):
        bool(x.max() > 0.0)
    assert (x > 0.0).any() and not (x > 0.0).all()  # no short cut is taken


@needs_node
@pytest.mark.parametrize("scene", ["double_pendulum.yaml", "four_bar_deploy.yaml"])
def test_recorded_rules_say_what_python_says(scene: str, tmp_path: Path) -> None:
    """Along the run of the scene itself, with the numbers of which they were recorded."""
    key = "initial.q.theta1"
    value = {"double_pendulum.yaml": (-2.0, 2.0), "four_bar_deploy.yaml": (0.008, 0.1)}[scene]
    judging = Judging(LiveStructure(family_of(scene), {key: value}), 60)
    rules = judging.data()["rules"]
    assert len(rules) >= 8
    got = judged_in_node([(rules[name], judging.examples[name][0]) for name in rules], tmp_path)
    for (name, (_, outputs)), own in zip(judging.examples.items(), got):
        for output, expected in outputs.items():
            known = np.ravel(expected).astype(float)
            if name == "beside":  # along a line: both ways are as good
                known, own[output] = np.abs(known), np.abs(own[output])
            scale = np.max(np.abs(known[np.isfinite(known)]), initial=1e-300)
            np.testing.assert_allclose(
                own[output], known, rtol=1e-9, atol=1e-12 * scale, err_msg=f"{name} {output}"
            )


# -- runs -----------------------------------------------------------------------------------------------
MASSES = {"robot.links.link1.mass": (8.0, 17.0), "robot.links.link2.mass": (9.0, 15.0)}
CASES: dict[str, tuple[str, Sequence[str], Ranges, int]] = {
    # scene, settings, ranges, how many settings may be left to the command
    "masses and starts": ("double_pendulum.yaml", (), {**MASSES, "initial.q.theta2": (-2.0, 2.0), "initial.qd.theta1": (-2.0, 2.0)}, 0),
    "lengths": ("double_pendulum.yaml", (), {"robot.joints.theta1.a": (0.7, 1.4)}, 0),
    "explicit, torque": ("double_pendulum.yaml", ("simulate.integrator=dop853", "torques.theta1=2*sin(3*t)", "simulate.rtol=1e-8"), MASSES, 0),
    "may be stiff": ("double_pendulum.yaml", ("robot.joints.theta1.damper.damping=0.5",), {"robot.joints.theta1.damper.damping": (0.1, 300.0)}, 18),
    "friction": ("double_pendulum.yaml", ("robot.joints.theta2.friction.coulomb=0.5", "robot.joints.theta2.friction.transition_speed=0.05"),
                 {"robot.joints.theta2.friction.coulomb": (0.1, 1.0)}, 0),
    "rest at first": ("double_pendulum.yaml", ("initial.q.theta2=0.3",), {"initial.q.theta1": (-1.5707963267948966, -1.0)}, 0),
    "lock": ("four_bar_deploy.yaml", (), {"robot.links.crank.mass": (10.0, 40.0), "robot.links.coupler.mass": (4.0, 16.0)}, 0),
    "lock from elsewhere": ("four_bar_deploy.yaml", (), {"initial.q.theta1": (0.008, 0.3)}, 0),
    "lock of other lengths": ("four_bar_deploy.yaml", (), {"robot.joints.theta1.a": (1.2, 1.28), "initial.q.theta1": (0.008, 0.3)}, 5),
    "loop in space": ("benchmarks/spatial_slider_crank.yaml", (), {"robot.links.slider.mass": (1.0, 3.0)}, 0),
    "loop with a rate": ("benchmarks/rbd_four_bar.yaml", (), {"robot.links.link1.mass": (0.4, 2.0)}, 0),
    "controller": ("double_pendulum.yaml", ("simulate.duration=3", "control={type: pid, gains: {kp: 300, kd: 30, ki: 50}}",
                   "trajectory={type: quintic, points: [{t: 0, q: {theta1: 0, theta2: 0}}, {t: 3, q: {theta1: -1, theta2: 0.5}}]}"),
                   {"robot.links.link1.mass": (8.0, 17.0), "control.gains.kp": (100.0, 500.0)}, 0),
    "computed torque": ("double_pendulum.yaml", ("simulate.duration=3", "control={type: computed_torque, gains: {kp: 100, kd: 20}}",
                        "trajectory={type: joint, duration: 3, q: {theta1: -1, theta2: 0.5*cos(t)}}"), MASSES, 0),
    "sampled controller": ("controlled_arm.yaml", (), {"robot.links.link1.mass": (8.0, 17.0), "control.gains.kp": (300.0, 500.0)}, 0),
    "reference that ends": ("controlled_arm.yaml", ("control={type: pid, gains: {kp: 900, kd: 60, ki: 90}}",), {"control.gains.kp": (700.0, 1000.0)}, 0),
    "prescribed": ("double_pendulum.yaml", ("initial={q: {theta2: 0.4}}", "simulate.duration=1", "prescribed={theta1: 'if(t<0.4, -0.3*t, -0.12 - 0.3*sin(t - 0.4))'}"), {"robot.links.link2.mass": (9.0, 15.0)}, 0),
    "body in space": ("tumbling_body.yaml", ("simulate.duration=4",), {"robot.links.handle.inertia.yy": (0.0045, 0.0055)}, 0),
}  # fmt: skip


@needs_node
@pytest.mark.parametrize("name", CASES)
def test_a_page_gives_what_the_program_gives(name: str, tmp_path: Path) -> None:
    """Within both stated errors and 1e-12 of the size; and never an answer where the program has none."""
    scene, overrides, ranges, most_left = CASES[name]
    family = family_of(scene, overrides)
    live = LiveStructure(family, ranges)
    rows = np.vstack([live.row, random_rows(ranges, 19, 5)])
    pages = run_live(live, rows, tmp_path)
    wrong, refused = disagreements(pages, run_many(family, ranges, rows))
    assert not wrong, "\n".join(wrong)
    assert refused <= most_left, [page.get("refused") for page in pages]


# settings of which runs that amplify rounding, or err by a few bad steps, once came to the same wrong end twice
UNLUCKY = {
    "loop with a rate": [1.6296272, 1.83355811, 1.77807573, 0.63357916, 0.71801721],
    "friction": [0.29050727, 0.65790643, 0.17480797, 0.59534471],
}


@needs_node
@pytest.mark.parametrize("name", UNLUCKY)
def test_chance_does_not_make_errors_small(name: str, tmp_path: Path) -> None:
    scene, overrides, ranges, _ = CASES[name]
    family, rows = family_of(scene, overrides), np.array(UNLUCKY[name])[:, None]
    wrong, refused = disagreements(
        run_live(LiveStructure(family, ranges), rows, tmp_path), run_many(family, ranges, rows)
    )
    assert not wrong and not refused, "\n".join(wrong)


@needs_node
def test_samples_of_a_page_are_those_of_the_program(tmp_path: Path) -> None:
    family = family_of("double_pendulum.yaml", ["simulate.samples=101"])
    live = LiveStructure(family, MASSES)
    (page,) = run_live(live, live.row[None], tmp_path)
    runs = run_many(family, MASSES, live.row[None], samples=101)
    np.testing.assert_allclose(page["times"], runs.samples["time"][0], rtol=1e-14)
    np.testing.assert_allclose(np.array(page["columns"][:2]).T, runs.samples["q"][0], atol=1e-9)


@needs_node
def test_times_of_events_that_a_run_passes(tmp_path: Path) -> None:
    """Where the torque that a controller asks for comes to its limit or falls below it, as samples of the program say."""
    limits = np.array([100.0, 50.0])
    overrides = [
        "simulate.duration=1", "control={type: pd, gains: {kp: 300, kd: 30}, limit: {theta1: 100, theta2: 50}}",
        "trajectory={type: joint, duration: 3, q: {theta1: -1, theta2: 0.5*cos(t)}}",
    ]  # fmt: skip
    family = family_of("double_pendulum.yaml", overrides)
    live = LiveStructure(family, MASSES)
    (page,) = run_live(live, live.row[None], tmp_path)
    own = run_many(family, MASSES, live.row[None], samples=20001).samples
    time, q, qd = own["time"][0], own["q"][0], own["qd"][0]
    wanted = np.stack([np.full_like(time, -1.0), 0.5 * np.cos(time)], axis=1)
    rates = np.stack([np.zeros_like(time), -0.5 * np.sin(time)], axis=1)
    beyond = np.abs(300.0 * (wanted - q) + 30.0 * (rates - qd)) > limits
    changes = np.flatnonzero((beyond[1:] != beyond[:-1]).any(axis=1))
    passed = [event["time"] for event in page["passed"]]
    assert len(passed) == len(changes) >= 4
    for k, met in zip(changes, passed):
        assert time[k] <= met <= time[k + 1]
    assert all(0.0 < event["error"] < 1e-10 for event in page["passed"])


@needs_node
def test_settings_that_a_page_cannot_vouch_for_are_refused_with_their_reason(tmp_path: Path) -> None:
    """A centre of mass that is put back onto its joint cancels: other equations, noticed by compiled comparisons."""
    overrides = ["robot.links.link2.com=[-0.583, 0, 0]", "robot.links.link2.com_frame=link"]
    ranges = {"robot.joints.theta2.a": (0.5, 1.2), "initial.q.theta1": (-3.0, 3.0)}
    live = LiveStructure(family_of("double_pendulum.yaml", overrides), ranges)
    rows = np.array([[0.583, 1.0], [0.9, 1.0], [0.9, 4.0], [0.4, 1.0]])
    reasons = [page.get("reason") for page in run_live(live, rows, tmp_path)]
    assert reasons == ["structure", None, "range", "range"]


@needs_node
def test_inertias_that_no_body_has_are_left_to_the_command(tmp_path: Path) -> None:
    ranges = {"robot.links.link1.inertia.zz": (-1e3, 1e3)}
    live = LiveStructure(family_of("double_pendulum.yaml", ["robot.links.link1.inertia.zz=0.2"]), ranges)
    reasons = [page.get("reason") for page in run_live(live, np.array([[0.3], [-1e3]]), tmp_path)]
    assert reasons == [None, "definite"]


@needs_node
def test_a_motion_without_a_lock_is_no_answer(tmp_path: Path) -> None:
    family = family_of("four_bar_deploy.yaml", ["simulate.duration=11"])
    live_one = family_of("four_bar_deploy.yaml", ["simulate.duration=13"])
    ranges = {"robot.links.crank.mass": (10.0, 40.0)}
    with pytest.raises(RobodynError, match="its own run is left to the command"):
        LiveStructure(family, ranges).data()
    live = LiveStructure(live_one, ranges)
    page, other = run_live(live, np.array([[40.0], [11.0]]), tmp_path)
    assert page["reason"] == "no lock" and 10.0 < other["time"] < 12.3


SCAN = """
const runner = await Runner.of(data.live, Uint8Array.from(Buffer.from(data.code, 'base64')));
let points = [];
for (const _ of scanned(runner, data.row, data.k, 24, (found) => { points = found; }, 7)) ;
const plain = (part) => ({ ...part, reasons: [...part.reasons] });
return { points: points.map(({ x, refused }) => ({ x, refused })), parts: refusedParts(points).map(plain) };
"""


@needs_node
def test_parts_of_a_range_that_are_left_to_the_command_are_found(tmp_path: Path) -> None:
    """Where crank and ground are nearly as long the loops pass near a loss of rank; just as long, at a distance."""
    family, ranges = family_of("four_bar_deploy.yaml"), {"robot.joints.theta1.a": (1.2405, 1.2415)}
    live = LiveStructure(family, ranges)
    found = in_node({**live_data(live), "row": live.row.tolist(), "k": 0}, SCAN, tmp_path)
    points, parts = found["points"], found["parts"]
    x = [point["x"] for point in points]
    assert x == sorted(set(x)) and x[0] == 1.2405 and x[-1] == 1.2415
    assert len(parts) >= 2 and all(part["reasons"] == ["ended"] for part in parts)
    edges = [e for part in parts for e in (part["from"], part["to"]) if 1.2405 < e < 1.2415]
    sharp = 1e-3 / 24 / 2**7
    assert len(edges) >= 2
    for edge in edges:
        rows = np.array([[edge - sharp], [edge + sharp]])
        refused = ["refused" in page for page in run_live(live, rows, tmp_path)]
        assert refused[0] != refused[1], edge
    for point in points:
        inside = any(part["from"] <= point["x"] <= part["to"] for part in parts)
        assert inside == bool(point["refused"])


# -- what cannot leave ----------------------------------------------------------------------------------
REFUSED: dict[str, tuple[str, Sequence[str], Ranges, str]] = {
    "another command": ("seven_joint_arm.yaml", (), {}, "cannot run in a page; allowed: simulate, deploy"),
    "contacts": ("bouncing_pendulum.yaml", (), {}, "contact states begin and change in Python"),
    "noise": ("controlled_arm.yaml", ("control.sensors.noise=1e-4",), {}, "sensors are noisy"),
    "times": ("controlled_arm.yaml", (), {"control.period": (0.001, 0.004)}, "a controller samples at other times"),
    "designed gains": ("cart_pole_lqr.yaml", (), {"robot.links.rod.mass": (0.05, 0.5)}, "its controller follows from the keys by computations"),
    "keys of given motions": ("double_pendulum.yaml", ("initial={q: {theta2: 0.4}}", "parameters={rate: 0.3}", "prescribed={theta1: rate*t}"), {"parameters.rate": (0.1, 0.5)}, "which may be others with parameters.rate"),
    "given motions": ("four_bar_prescribed.yaml", (), {}, "a motion is prescribed"),
    "partitions": ("benchmarks/bennett.yaml", (), {}, "independent coordinates or rows are chosen"),
    "structure": ("double_pendulum.yaml", (), {"robot.joints.theta1.alpha": (-1.0, 1.0)}, "alpha is 0 in this scene, where the equations"),
    "options": ("double_pendulum.yaml", (), {"simulate.duration": (5.0, 20.0)}, "--live simulate.duration: it is an option of the run; allowed: numbers"),
    "times of formulas": ("double_pendulum.yaml", ("parameters={w: 3}", "torques.theta1=abs(sin(w*t))"), {"parameters.w": (2.0, 4.0)},
                          "steps have to end at times .* others with parameters.w"),
    "a crowd of events": ("double_pendulum.yaml", ("torques.theta1=0.01*abs(sin(500*theta1))",), {},
                          "left to the command from t = .* s on: what happens to torques.theta1 there"),
    "not allowed": ("double_pendulum.yaml", (), {"robot.links.link1.mass": (-1.0, 20.0)}, r"allowed: a number >= 0 \[kg\]"),
    "turned ends": ("double_pendulum.yaml", (), {"robot.links.link1.mass": (20.0, 5.0)}, "allowed: LOW:HIGH with LOW below HIGH"),
    "without the scene": ("double_pendulum.yaml", (), {"robot.links.link1.mass": (1.0, 2.0)}, "the scene's own value 12.456 lies outside 1:2"),
    "no such key": ("double_pendulum.yaml", (), {"robot.links.link1.weight": (1.0, 2.0)}, "unknown key 'weight'"),
    "no errors": ("double_pendulum.yaml", ("simulate.error_estimate=false",), {}, "no errors are estimated"),
    "goes on": ("mechanisms/four_bar_locked.yaml", (), {}, "goes on as the locked structure"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_leave_is_refused_by_name(name: str) -> None:
    scene, overrides, ranges, words = REFUSED[name]
    with pytest.raises(RobodynError, match=words):
        LiveStructure(family_of(scene, overrides), ranges).data()


@pytest.mark.parametrize(
    "asked, words",
    [
        (("robot.links.link1.mass", "robot.links.link1.mass"), "--live robot.links.link1.mass: is given twice$"),
        (("robot.links.0.mass", "robot.links.link1.mass"), "--live robot.links.link1.mass: is given twice, also as"),
        (("nonsense",), "^--live nonsense: unknown key 'nonsense'"),
    ],
)  # fmt: skip
def test_keys_of_a_page_are_refused_by_its_own_option(asked: Sequence[str], words: str) -> None:
    result = simulate(load_scene(CONFIGS / "double_pendulum.yaml", overrides=["simulate.samples=3"]))
    with pytest.raises(RobodynError, match=words):
        live_parts([result], [(key, "8", "17") for key in asked])


@pytest.mark.parametrize("target", ["c", "fmu"])
def test_starts_are_asked_for_once(target: str, tmp_path: Path) -> None:
    family, asked = family_of("double_pendulum.yaml"), [asked_key("initial.q.theta1=-2:2")] * 2
    with pytest.raises(RobodynError, match="--key initial.q.theta1: is given twice"):
        if target == "c":
            export_c(family, asked, tmp_path / "c", loop=True)
        else:
            export_fmu(family, tmp_path / "a.fmu", asked)


def test_code_that_needs_what_browsers_do_not_have_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from robodyn_cli.over.live import keys

    monkeypatch.setattr(keys, "LIBRARY", frozenset())
    live = LiveStructure(family_of("double_pendulum.yaml", ["torques.theta1=exp(-t)*sinh(theta1)"]), MASSES)
    with pytest.raises(RobodynError, match="browsers have no function exp, sinh"):
        live_data(live)
