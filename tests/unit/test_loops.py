"""The loop of a controller: against motions that a run shows, python-control, scipy and closed forms."""

from __future__ import annotations

import cmath
import json
import math
import re
import warnings
from pathlib import Path

import control
import numpy as np
import pytest
import scipy.io
import scipy.signal
from scipy.io import loadmat
from scipy.optimize import brentq
from scipy.signal import cont2discrete

from robodyn_cli import linearise, load_scene, simulate
from robodyn_cli.cli.commands.linearise import describe
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.statements import parse_expectation
from robodyn_cli.over.batch.criteria import judge
from robodyn_cli.results.export import export
from robodyn_cli.scene import load_scene_text
from robodyn_cli.works.loops.margins import StabilityMargins, margins
from robodyn_cli.works.loops.systems import StateSpace, sampled

CONFIGS = Path(__file__).parents[2] / "configs"
REACH = 12000  # points of the dense oracle


def arm(seed: int, law: str, more: str = "", joints: int = 3) -> str:
    """Return a random arm in space with springs and dampers, a motor at each joint."""
    random = np.random.default_rng(seed)
    names, pose = "abcde"[:joints], random.uniform(-0.5, 0.5, joints).tolist()
    lines = ["schema: 1", "gravity: [0.3, -0.4, -9.7]", "robot:", "  joints:"]
    for k, name in enumerate(names):
        axis, xyz = random.normal(size=3).tolist(), random.uniform(-0.4, 0.4, 3).tolist()
        kind = "prismatic" if k == 1 and seed % 2 else "revolute"
        lines.append(
            f"    - {{name: {name}, type: {kind}, axis: {axis}, origin: {{xyz: {xyz}}}, "
            f"damper: {{damping: {random.uniform(0.05, 1.0)}}}, spring: {{stiffness: {random.uniform(0, 20)}, rest: {pose[k]}}}}}"
        )
    lines.append("  links:")
    for name in names:
        xx, yy, zz = random.uniform(0.05, 0.1, 3)
        lines.append(
            f"    - {{name: L{name}, mass: {random.uniform(0.5, 3)}, com: {random.uniform(-0.2, 0.2, 3).tolist()}, "
            f"inertia: {{xx: {xx}, yy: {yy}, zz: {zz}, xy: 0.01, xz: -0.005, yz: 0.004}}}}"
        )
    q = ", ".join(f"{name}: {x}" for name, x in zip(names, pose))
    lines += [f"initial: {{q: {{{q}}}}}", f"control: {law}", "simulate: {duration: 0.4, samples: 41}", more]
    return "\n".join(lines)


LAWS = {
    "pd": "{type: pd, gains: {kp: 90, kd: 9}}",
    "pid": "{type: pid, gains: {kp: 90, kd: 9, ki: 40}}",
    "gravity, late": "{type: gravity, period: 0.01, delay: 0.013, gains: {kp: 60, kd: 6}}",
    "computed torque by differences": "{type: computed_torque, period: 0.01, gains: {kp: 100, kd: 20}, "
    "sensors: {rates: differences}}",
    "lqr, late": "{type: lqr, period: 0.02, delay: 0.02, gains: {q: 300, qd: 1, tau: 0.1}}",
    "feed forward": "{type: feed_forward, gains: {kp: 60, kd: 6}}",
    "pid by differences, late": "{type: pid, period: 0.01, delay: 0.004, gains: {kp: 60, kd: 6, ki: 30}, "
    "sensors: {rates: differences}}",
    "formulas": "{type: formulas, law: {a: -80*(q.a-ref.a)-8*qd.a-s.w, b: -70*(q.b-ref.b)-7*qd.b, "
    "c: -60*(q.c-ref.c)-6*qd.c}, state: {w: {rate: 'sin(q.a-ref.a) - 2*s.w'}}}",
}
STEP = 1e-5


@pytest.mark.parametrize("law", LAWS)
def test_the_loop_is_what_neighbouring_motions_do(law: str) -> None:
    """Two runs from states apart by a step: their difference is that of the closed loop's linear motion."""
    text = arm(5, LAWS[law])
    result = linearise(load_scene_text(text))
    loop, period = (
        result["loop/A"] - result["loop/B"] @ result["loop/C"],
        result.summary["closed_loop"].get("period"),
    )
    start = np.random.default_rng(1).normal(size=6)
    q = load_scene_text(text).initial.q
    # nothing pulls it away from a pose that the law does not hold against gravity, or not yet: before the first torque
    # comes, and while its integral grows
    falls = "held_back" in result.summary["closed_loop"] or "late" in law or "pid" in law
    level = ["gravity=[0, 0, 0]"] if falls else []
    result = linearise(load_scene_text(text, overrides=level))
    loop = result["loop/A"] - result["loop/B"] @ result["loop/C"]
    assert "held_back" not in result.summary["closed_loop"]
    runs = []
    for sign in (1.0, -1.0):
        at = {name: x + sign * STEP * dx for (name, x), dx in zip(q.items(), start)}
        rates = {name: sign * STEP * dv for name, dv in zip(q, start[3:])}
        # what is held stays the pose itself
        points = f"[{{t: 0, q: {json.dumps(q)}}}, {{t: 9, q: {json.dumps(q)}}}]"
        of = (
            [f"trajectory={{type: cubic, points: {points}}}"]
            if "lqr" not in law
            else [f"control.pose={json.dumps(q)}"]
        )
        scene = load_scene_text(
            text, overrides=[*level, *of, f"initial.q={json.dumps(at)}", f"initial.qd={json.dumps(rates)}"]
        )
        runs.append(simulate(scene))
    found = (np.concatenate([r["q"] for r in [runs[0]]] + [runs[0]["qd"]], axis=1)
             - np.concatenate([runs[1]["q"], runs[1]["qd"]], axis=1)) / (2.0 * STEP)  # fmt: skip
    x = np.zeros(len(loop))
    x[:6] = start
    names = result.variables["loop/A"].names
    for k, name in enumerate(names):
        if name.startswith("measured."):  # the first measurement is taken for the one before
            x[k] = start["abc".index(name.partition(".")[2])]
    wanted = []
    if period is None:
        from scipy.linalg import expm

        wanted = [(expm(t * loop) @ x)[:6] for t in runs[0].time]
        at_samples = found
    else:
        skip = round(period / 0.01)
        at_samples = found[::skip]
        for _ in range(len(at_samples)):
            wanted.append(x[:6].copy())
            x = loop @ x
    size = np.abs(wanted).max()
    np.testing.assert_allclose(at_samples, np.array(wanted), atol=2e-6 * size)


def dense(loop: StateSpace) -> tuple[float, float, float, float]:
    """Return the margins of a loop by brackets on a dense grid: gain up and down, phase, largest sensitivity there."""
    top = loop.last_frequency if loop.period else 1e5
    w = np.geomspace(1e-5, top, REACH)
    w = w[w < top * (1.0 - 1e-9)]
    y = loop.at(w)[:, 0, 0]

    def at(x: float) -> complex:
        return complex(loop.at(np.array([x]))[0, 0, 0])

    def root(f, k: int) -> float:
        return brentq(f, w[k], w[k + 1], xtol=1e-300, rtol=1e-15)

    gains = [at(root(lambda x: at(x).imag, k)) for k in np.flatnonzero(y.imag[1:] * y.imag[:-1] < 0.0)]
    gains += [at(x) for x in ([0.0, top] if loop.period else [0.0])]
    real = [
        -1.0 / g.real for g in gains if g.real < 0.0 and abs(g.imag) < 1e-7 * abs(g) and 1e-11 < abs(g) < 1e11
    ]
    a = np.log(np.abs(y))
    turns = [
        cmath.phase(-at(root(lambda x: math.log(abs(at(x))), k)))
        for k in np.flatnonzero(a[1:] * a[:-1] < 0.0)
    ]
    return (
        min((g for g in real if g >= 1.0), default=math.inf), max((g for g in real if g < 1.0), default=0.0),
        min(turns, key=abs, default=math.inf), float((1.0 / np.abs(1.0 + y)).max()),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_margins_of_random_arms_are_those_of_dense_brackets_and_of_python_control(seed: int) -> None:
    law = list(LAWS.values())[seed + 1 if seed < 4 else 1]
    result = linearise(load_scene_text(arm(seed, law)))
    assert result.summary["closed_loop"]["stability"] == "stable"
    whole = StateSpace(*(result[f"loop/{x}"] for x in "ABCD"), result.summary["closed_loop"].get("period"))
    for k, (_, own) in enumerate(result.summary["loop"].items()):
        opened = whole.closed(but=k)
        up, down, turn, peak = dense(opened)
        for key, wanted in (("gain_margin", up), ("gain_reduction", down), ("phase_margin", turn)):
            found = math.inf if own[key] is None else own[key]
            assert found == wanted or abs(found - wanted) < 1e-9 * max(1.0, abs(wanted)), key
            assert own["errors"][key] < 1e-8 * max(1.0, abs(wanted)) or math.isinf(wanted)
        assert peak <= own["sensitivity_peak"] * (1 + 1e-12) and own["sensitivity_peak"] <= peak * (1 + 1e-4)
        if whole.period is None:  # polynomials of sampled loops lose too many digits
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                of = control.ss(opened.A, opened.B, opened.C, opened.D)
                gain, phase, _, _, w, _ = control.stability_margins(of, returnall=True)
            least = min(phase, key=abs, default=math.inf)
            if math.isfinite(least):
                assert abs(math.radians(least) - own["phase_margin"]) < 1e-9
                assert (
                    abs(w[list(phase).index(least)] - own["phase_frequency"]) < 1e-8 * own["phase_frequency"]
                )
            true = [g for g in gain if 1.0 <= g < 1e11]
            if true:
                assert abs(min(true) - own["gain_margin"]) < 1e-8 * own["gain_margin"]


def single(A, B, C, period: float | None = None) -> StabilityMargins:
    A, B, C = (np.array(x, dtype=float) for x in (A, B, C))
    return margins(StateSpace(A, B, C, np.zeros((1, 1)), period), [])


def test_margins_in_closed_form() -> None:
    # k / (s (s + 1)^2): crosses the axis at w = 1, where it is -k / 2
    third = ([[0, 1, 0], [0, -1, 1], [0, 0, -1]], [[0], [0], [1]], [[0.5, 0, 0]])
    of = single(*third)
    assert (
        abs(of.gain.value - 4.0) < 1e-12
        and abs(of.gain.frequency - 1.0) < 1e-12
        and of.reduction.value == 0.0
    )
    # first order k / (s + 1): no gain makes it unstable
    first = single([[-1]], [[1]], [[3]])
    assert math.isinf(first.gain.value) and abs(first.phase.frequency - math.sqrt(8)) < 1e-12
    assert abs(first.phase.value - (math.pi - math.atan(math.sqrt(8)))) < 1e-12
    assert abs(first.delay.value - first.phase.value / math.sqrt(8)) < 1e-12
    assert first.sensitivity.value == 1.0 and math.isinf(first.sensitivity.frequency)
    # less than 1 everywhere: neither phase nor delay; nothing at all
    low = single([[-1]], [[1]], [[0.5]])
    assert math.isinf(low.phase.value) and math.isinf(low.delay.value) and math.isinf(low.gain.value)
    none = single([[-1]], [[1]], [[0]])
    assert math.isinf(none.gain.value) and none.reduction.value == 0.0 and none.sensitivity.value == 1.0
    # unstable plant k / (s - 1), k = 3: the gain may fall to a third, which is met at w = 0
    falls = single([[1]], [[1]], [[3]])
    assert abs(falls.reduction.value - 1.0 / 3.0) < 1e-15 and falls.reduction.frequency == 0.0
    # non-minimum phase k (1 - s) / (s + 1)^2 with k = 0.5: -k / 2 ... at w = sqrt(3)
    of = single([[0, 1], [-1, -2]], [[0], [1]], [[0.5, -0.5]])
    assert abs(of.gain.frequency - math.sqrt(3)) < 1e-12 and abs(of.gain.value - 4.0) < 1e-12
    # three crossings: conditionally stable, margins on both sides
    k, A = 40.0, np.zeros((4, 4))
    A[0, 1] = A[1, 2] = 1.0
    A[2, 3], A[3, 3] = 1.0, -20.0
    up = single(A, [[0], [0], [0], [1]], [[k * 4, k * 4, k, 0]])
    assert up.gain.value > 1.0 > up.reduction.value > 0.0
    # a sampled integrator k T / (z - 1): unstable from k T = 2, at pi / T
    of = single([[1.0]], [[0.1]], [[4.0]], 0.1)
    assert abs(of.gain.value - 5.0) < 1e-12 and abs(of.gain.frequency - math.pi / 0.1) < 1e-9


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.013, 0.047])
def test_a_sampled_plant_is_that_of_scipy_late_by_any_delay(delay: float) -> None:
    """Against scipy's hold at a period that divides delay and period."""
    random, period, fine = np.random.default_rng(2), 0.02, 0.001
    A, B = random.normal(size=(4, 4)), random.normal(size=(4, 2))
    whole, rest = divmod(round(delay / fine), 20)
    full, given = sampled(A, B, period, whole, rest * fine)
    F, G, *_ = cont2discrete((A, B, np.eye(4), np.zeros((4, 2))), fine)
    inputs = random.normal(size=(12, 2))
    x, state = np.zeros(4), np.zeros(len(full))
    for k, u in enumerate(inputs):
        np.testing.assert_allclose(state[:4], x, atol=1e-12)
        state = full @ state + given @ u
        for j in range(20):
            due = (k * 20 + j - round(delay / fine)) // 20
            x = F @ x + G @ (inputs[due] if due >= 0 else np.zeros(2))


def documented_lines() -> list[str]:
    """Return the lines of the documentation that read exported files: .mat, then .json."""
    page = (CONFIGS.parent / "docs" / "cli.md").read_text(encoding="utf-8")
    return re.findall(r"<!-- file: result\.\w+ -->\n```python\n(.*?)```", page, re.DOTALL)


@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (1, 2), (2, 1), (2, 2)])
def test_the_lines_for_mat_take_models_of_any_shape(
    inputs: int, outputs: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ["theta1", "theta2"]
    scene = load_scene(CONFIGS / "double_pendulum.yaml")
    result = linearise(scene, inputs=names[:inputs], outputs=names[:outputs], period=0.01)
    export(result, "mat", tmp_path)
    monkeypatch.chdir(tmp_path)
    known: dict = {"scipy": scipy, "control": control}
    exec(documented_lines()[0], known)
    plant = known["plant"]
    assert plant.dt == 0.01
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(plant, name), result[f"discrete/{name}"])


def test_a_loop_keeps_its_own_period_beside_that_of_the_plant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop is sampled as its controller is, whatever ``period`` asks of the plant."""
    scene = load_scene(CONFIGS / "controlled_arm.yaml")
    result = linearise(scene, period=0.1, delay=0.03)
    assert (result["discrete/period"], result["discrete/delay"]) == (0.1, 0.03)
    assert (result["loop/period"], result["loop/delay"]) == (0.002, 0.001)
    export(result, "json", tmp_path)
    monkeypatch.chdir(tmp_path)
    known: dict = {"scipy": scipy, "json": json}
    exec(documented_lines()[1], known)
    assert known["loop"].dt == 0.002
    assert "loop/period" not in linearise(load_scene_text(arm(5, LAWS["pd"])))


def test_objects_of_python_control_and_scipy_from_exported_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = linearise(load_scene(CONFIGS / "controlled_arm.yaml"), outputs=["theta2", "power"])
    export(result, "mat", tmp_path)
    export(result, "json", tmp_path)
    m = loadmat(tmp_path / "result.mat", simplify_cells=True)["data"]["discrete"]
    system = control.ss(m["A"], m["B"], m["C"], m["D"], m["period"])
    assert system.dt == 0.002 and m["delay"] == 0.001 and system.ninputs == 2 and system.noutputs == 2
    j = json.loads((tmp_path / "result.json").read_text())["variables"]
    plant = control.ss(*(np.array(j[f"linear/{x}"]["data"]) for x in "ABCD"))
    F, G, _, _, _ = cont2discrete((plant.A, plant.B, plant.C, plant.D), 0.001)
    # the torque of the sample before acts for half of the period, then the new one
    np.testing.assert_allclose(system.A[:4, :4], F @ F, atol=1e-12)
    np.testing.assert_allclose(system.A[:4, 4:], F @ G, atol=1e-12)
    np.testing.assert_allclose(system.B[:4], G, atol=1e-12)
    assert float(np.array(j["discrete/period"]["data"])) == 0.002
    blocks = documented_lines()
    assert len(blocks) == 2 and all(len(block.strip().split("\n")) == 2 for block in blocks)
    monkeypatch.chdir(tmp_path)
    known: dict = {"scipy": scipy, "control": control, "json": json, "numpy": np}
    for block in blocks:
        exec(block, known)
    assert known["plant"].dt == 0.002 and known["loop"].dt == 0.002 and known["loop"].A.shape == (8, 8)


def test_a_loop_that_is_not_stable_has_no_margin_and_infinite_ones_are_larger_than_any() -> None:
    scene = load_scene_text(arm(5, "{type: pd, period: 0.3, gains: {kp: 9000, kd: 9}}"))
    own = linearise(scene).summary
    assert own["closed_loop"]["stability"] == "unstable" and own["closed_loop"]["sensitivity_peak"] is None
    assert all(x["gain_margin"] == 1.0 and x["phase_margin"] == 0.0 for x in own["loop"].values())
    first = {
        "loop.a.gain_margin": parse_expectation("> 2"),
        "loop.a.phase_margin": parse_expectation("> 0.1"),
    }
    assert not any(one.holds for one in judge(first, own))
    calm = linearise(load_scene_text(arm(5, LAWS["pd"]))).summary
    assert calm["loop"]["a"]["gain_margin"] is None  # without a delay nothing turns it so far
    assert all(one.holds for one in judge(first, calm))
    assert not judge({"loop.a.gain_margin": parse_expectation("1 .. 9")}, calm)[0].holds


def test_where_the_loop_is_taken() -> None:
    """The end of the reference, the pose of the regulator, the start, and a balance of joints that nothing drives."""
    scene = load_scene(CONFIGS / "controlled_arm.yaml")
    end = linearise(scene).summary
    assert end["about"] == "controller" and "reference" in end["closed_loop"]["about"]
    np.testing.assert_allclose(list(end["configuration"].values()), np.radians([40.0, -30.0]), atol=1e-12)
    start = linearise(scene, about="state").summary
    np.testing.assert_allclose(list(start["configuration"].values()), np.radians([-90.0, 0.0]), atol=1e-12)
    pose = linearise(load_scene(CONFIGS / "cart_pole_lqr.yaml")).summary
    assert pose["configuration"] == {"cart": 0.0, "pole": 0.0} and "held_back" not in pose["closed_loop"]
    crane = linearise(load_scene(CONFIGS / "mechanisms" / "crane.yaml")).summary
    assert abs(crane["configuration"]["rope"]) < 1e-9 and crane["closed_loop"]["stability"] == "stable"
    with pytest.raises(SceneError, match="the scene has none"):
        linearise(load_scene(CONFIGS / "double_pendulum.yaml"), about="controller")
    with pytest.raises(SceneError, match="--delay: goes with --period"):
        linearise(load_scene(CONFIGS / "double_pendulum.yaml"), delay=0.1)
    plain = linearise(load_scene(CONFIGS / "double_pendulum.yaml"), period=0.1, delay=0.05)
    assert plain["discrete/A"].shape == (6, 6) and "loop" not in plain.summary
    own = plain.summary["discrete"]
    assert (own["period"], own["delay"]) == (0.1, 0.05)
    assert [x["name"] for x in own["states"]] == list(plain.variables["discrete/A"].names)
    told = next(line for line in describe(plain.summary).split("\n") if "/discrete" in line)
    assert "0.1 s, 0.05 s late" in told and "2 of its 6 states are inputs on their way" in told
    assert "/discrete" not in describe(linearise(load_scene(CONFIGS / "double_pendulum.yaml")).summary)
    # what the plant does alone is no word about the loop
    assert "without control    unstable" in describe(end) and "  stability" not in describe(end)


def test_the_whole_loop_of_several_inputs() -> None:
    result = linearise(load_scene_text(arm(5, LAWS["gravity, late"])))
    w, S = result["loop/frequency"], result["loop/sensitivity"]
    whole = StateSpace(*(result[f"loop/{x}"] for x in "ABCD"), 0.01)
    L = whole.at(w)
    np.testing.assert_allclose(S, np.linalg.svd(np.linalg.inv(np.eye(3) + L), compute_uv=False), rtol=1e-8)
    np.testing.assert_allclose(result["loop/singular_values"], np.linalg.svd(L, compute_uv=False), rtol=1e-9)
    peak = result.summary["closed_loop"]["sensitivity_peak"]
    assert S.max() <= peak * (1 + 1e-12) < S.max() * 1.01


def test_a_mode_beside_the_loop_may_stay_where_it_is() -> None:
    """A ball below a driven joint turns freely about the vertical: a pole at 1 that the loop neither has nor minds."""
    text = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints: [{name: a, type: revolute, axis: [0, 1, 0]}, {name: ball, type: spherical, origin: {xyz: [0, 0, -0.5]}}]
  links:
    - {name: A, mass: 2, com: [0, 0, -0.2], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
    - {name: B, mass: 1, com: [0, 0, -0.2], inertia: {xx: 0.05, yy: 0.06, zz: 0.02}}
initial: {q: {a: 0}}
control: {type: pid, joints: [a], gains: {kp: 80, kd: 9, ki: 10}, period: 0.01, delay: 0.004}
"""
    own = linearise(load_scene_text(text)).summary
    assert own["closed_loop"]["stability"] in ("stable", "marginal")
    peak = own["loop"]["a"]["sensitivity_peak"]
    assert peak is None or 1.0 <= peak < 10.0


PENDULUM = """\
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{name: a, type: revolute, axis: [0, 0, 1], damper: {damping: 0.15}}]
  links: [{name: rod, mass: 1.5, com: [0.4, 0, 0], inertia: {zz: 0.03}}]
trajectory: {type: joint, duration: 3, q: {a: "0.7"}}
initial: {q: {a: 0}}
simulate: {duration: 3, samples: 31}
control: {type: """
INERTIA, LOAD = 0.03 + 1.5 * 0.4**2, 1.5 * 9.81 * 0.4
FALLING = LOAD * math.sin(0.7)  # of its torque by the angle


@pytest.mark.parametrize("period", [None, 0.01])
def test_the_states_of_a_law_are_taken_where_they_rest(period: float | None) -> None:
    """A law that is no straight line in its state: by hand at s = 0.7, where the state rests, not at 0, its start."""
    change = "rate: 60*(a - s.f)" if period is None else "next: s.f + 0.5*(a - s.f)"
    more = "" if period is None else f", period: {period}"
    law = f"40*sin(ref.a) - 40*sin(s.f) - 6*qd.a + {LOAD}*cos(ref.a)"
    own = linearise(
        load_scene_text(f"{PENDULUM}formulas{more}, law: {{a: '{law}'}}, state: {{f: {{{change}}}}}}}")
    )
    slope = 40.0 * math.cos(0.7)
    if period is None:
        A = [[0, 1, 0], [FALLING / INERTIA, -6.15 / INERTIA, -slope / INERTIA], [60, 0, -60]]
    else:
        plant = (
            np.array([[0.0, 1.0], [FALLING / INERTIA, -0.15 / INERTIA]]),
            np.array([[0.0], [1.0 / INERTIA]]),
        )
        F, G, *_ = cont2discrete((*plant, np.eye(2), np.zeros((2, 1))), period)
        A = np.block([[F + G @ [[0.0, -6.0]], -slope * G], [np.array([[0.5, 0.0]]), np.array([[0.5]])]])
    poles = [complex(x["real"], x["imaginary"]) for x in own.summary["closed_loop"]["poles"]]
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(np.linalg.eigvals(A)), rtol=1e-10)
    assert "held_back" not in own.summary["closed_loop"]
    # still, the loop has the slope of the state and that of gravity: the gain may fall to where they are equal
    assert abs(own.summary["loop"]["a"]["gain_reduction"] - FALLING / slope) < 1e-12


HOLDING = {
    "pid": ("pid, gains: {kp: 30, ki: 40, kd: 4}", {}),
    "sampled pid": ("pid, period: 0.02, delay: 0.013, sensors: {rates: differences}, gains: {kp: 30, ki: 40, kd: 4}", {}),
    "pid without an integral": ("pid, gains: {kp: 30, kd: 4}", {"held_back": {"a": -LOAD * math.cos(0.7)}}),
    "sampled pid without an integral": (
        "pid, period: 0.02, gains: {kp: 30, kd: 4}", {"held_back": {"a": -LOAD * math.cos(0.7)}}),
    "integrator beside a lag": (
        "formulas, law: {a: 30*(ref.a - a) + s.i + 80*(s.f - a)}, "
        "state: {i: {rate: 20*(ref.a - a)}, f: {rate: 10*(a - s.f)}}", {}),
    "integrator that acts by a sine": (
        "formulas, law: {a: 30*(ref.a - a) - 3*qd.a + 9*sin(s.i)}, state: {i: {rate: 2*(ref.a - a)}}", {}),
    "integrator that is too weak": (
        "formulas, law: {a: 30*(ref.a - a) - 3*qd.a + 3*sin(s.i)}, state: {i: {rate: 2*(ref.a - a)}}",
        {"held_back": {"a": 3.0 - LOAD * math.cos(0.7)}}),
    "leaking integral": (
        "formulas, law: {a: 30*(ref.a - a) - 3*qd.a + s.i}, state: {i: {rate: 20*(ref.a - a) - s.i}}",
        {"held_back": {"a": -LOAD * math.cos(0.7)}}),
    "a clock": (
        "formulas, law: {a: 30*(ref.a - a) - 3*qd.a + s.i - s.c}, state: {i: {rate: 20*(ref.a - a)}, c: {rate: 1}}",
        {"restless": ["c"]}),
    "limited": ("pid, limit: 3, gains: {kp: 30, ki: 40, kd: 4}",
                {"held_back": {"a": 3.0 - LOAD * math.cos(0.7)}, "saturated": ["a"]}),
    "limited above": ("pid, limit: 5, gains: {kp: 30, ki: 40, kd: 4}", {}),
}  # fmt: skip


@pytest.mark.parametrize("kind", HOLDING)
def test_what_a_law_holds_with_its_states_at_rest(kind: str) -> None:
    law, wanted = HOLDING[kind]
    own = linearise(load_scene_text(f"{PENDULUM}{law}}}")).summary
    told = {key: own["closed_loop"].get(key) for key in ("held_back", "saturated", "restless")}
    assert told == {
        key: pytest.approx(wanted[key], abs=1e-6) if key == "held_back" and key in wanted else wanted.get(key)
        for key in told
    }
    assert (own["closed_loop"]["stability"] == "saturated") == ("saturated" in wanted)
    if "saturated" in wanted:
        assert own["loop"]["a"]["gain_margin"] == 1.0
    if "without an integral" in kind:  # it has the poles of a pd
        pd = linearise(load_scene_text(f"{PENDULUM}{law.replace('pid', 'pd')}}}")).summary
        assert own["closed_loop"]["poles"] == pd["closed_loop"]["poles"]


def test_the_goal_of_a_controller_moves_what_the_start_holds() -> None:
    """A crank that is held while the loop closes at the start turns where the driven slide goes: by the triangle."""
    text = """\
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: crank, type: revolute, axis: [0, 0, 1]}
    - {name: rod, type: revolute, axis: [0, 0, 1], origin: {xyz: [0.15, 0, 0]}}
    - {name: slide, type: prismatic, axis: [1, 0, 0], parent: base, damper: {damping: 8}}
  links:
    - {name: cr, mass: 0.8, com: [0.07, 0, 0], inertia: {zz: 0.003}}
    - {name: rd, mass: 0.5, com: [0.25, 0, 0], inertia: {zz: 0.012}}
    - {name: pis, mass: 1.1, com: [0, 0, 0], inertia: {zz: 0.01}}
  points: {rend: {link: rd, at: [0.5, 0, 0]}}
loops: [{name: wrist, type: revolute, between: [rend, pis.origin]}]
actuated: [slide]
initial: {q: {crank: 30 deg, rod: -40 deg, slide: 0.6}, hold: [crank]}
simulate: {duration: 2, samples: 41}
control: {type: gravity, gains: {kp: 900, kd: 60}}
trajectory: {type: joint, duration: 1, q: {slide: "0.58"}}
"""
    q = linearise(load_scene_text(text)).summary["configuration"]
    assert abs(q["slide"] - 0.58) < 1e-9
    assert abs(q["crank"] - math.acos((0.15**2 + 0.58**2 - 0.5**2) / (2 * 0.15 * 0.58))) < 1e-9


@pytest.mark.parametrize(
    ("period", "delay", "gains"), [(0.02, 0.013, (30, 4)), (0.1, 0.0, (18, 1.5)), (0.05, 0.0, (20, 6))]
)
def test_the_delay_margin_under_a_hold_is_where_the_exact_model_has_a_pole_on_the_circle(
    period: float, delay: float, gains: tuple[float, float]
) -> None:
    """Against scipy's hold over a part of a period, by hand: the largest pole is inside up to the margin, and then out."""
    kp, kd = gains
    law = f"gravity, period: {period}, delay: {delay}, gains: {{kp: {kp}, kd: {kd}}}"
    own = linearise(load_scene_text(f"{PENDULUM}{law}}}")).summary["loop"]["a"]
    A = np.array([[0.0, 1.0], [FALLING / INERTIA, -0.15 / INERTIA]])
    K = np.array([kp + FALLING, kd])  # the law gives gravity where it is: its slope counts

    def held(time: float) -> tuple[np.ndarray, np.ndarray]:
        if time <= 0.0:
            return np.eye(2), np.zeros((2, 1))
        return cont2discrete((A, np.array([[0.0], [1.0 / INERTIA]]), np.eye(2), np.zeros((2, 1))), time)[:2]

    def beyond(late: float) -> float:
        whole = math.floor(late / period)
        (F, G), (_, new) = held(period), held(period - (late - whole * period))
        M = np.zeros((3 + whole, 3 + whole))
        M[:2, :2], M[2, :2] = F, -K
        acting = [
            -K @ np.eye(2, 3 + whole),
            *np.eye(3 + whole)[2:],
        ]  # the torque of this sample, of the last, ...
        M[:2] += new @ acting[whole][None] + (G - new) @ acting[whole + 1][None]
        M[3:, 2:-1] += np.eye(whole)
        return float(np.abs(np.linalg.eigvals(M)).max() - 1.0)

    margin = own["delay_margin"]
    steps = np.linspace(0.0, 0.999 * margin, 60)
    assert all(beyond(delay + x) < 0.0 for x in steps) and beyond(delay + 1.001 * margin) > 0.0
    wanted = brentq(beyond, delay + 0.99 * margin, delay + 1.01 * margin, xtol=1e-15) - delay
    assert abs(margin - wanted) < 1e-11 and 0.0 < own["errors"]["delay_margin"] < 1e-10


def test_poles_where_torques_are_at_their_limits_are_those_with_constant_ones() -> None:
    """Of a pendulum by hand: its own, and that of the integral, which gives way by ki / kp; the other joint is held."""
    own = linearise(load_scene_text(f"{PENDULUM}pid, limit: 3, gains: {{kp: 30, ki: 40, kd: 4}}}}"))
    assert own.summary["closed_loop"]["stability"] == "saturated"
    assert "with these torques as they are" in describe(own.summary)
    plant = np.roots([INERTIA, 0.15, -FALLING])
    poles = [complex(x["real"], x["imaginary"]) for x in own.summary["closed_loop"]["poles"]]
    np.testing.assert_allclose(np.sort(np.real(poles)), np.sort([*plant.real, -40.0 / 30.0]), rtol=1e-10)
    law = "{type: gravity, gains: {kp: 90, kd: 9}, limit: {b: 1e-3}, reference: {type: joint, duration: 0.4, q: {a: '0.3', b: '0.4', c: '0.2'}}}"
    free, held = (
        linearise(load_scene_text(arm(5, law), overrides=more)) for more in (["control.limit=null"], [])
    )
    assert held.summary["closed_loop"]["saturated"] == ["b"]
    K = free["loop/gains"].copy()
    K[1] = 0.0
    A = free["linear/A"] - free["linear/B"] @ K
    poles = [complex(x["real"], x["imaginary"]) for x in held.summary["closed_loop"]["poles"]]
    np.testing.assert_allclose(
        np.sort_complex(np.round(poles, 9)), np.sort_complex(np.round(np.linalg.eigvals(A), 9)), atol=1e-7
    )
