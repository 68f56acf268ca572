"""After the latch: the locked structure's motion and loads, and loads beyond what parts may bear."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from robodyn_cli import deploy, load_scene, load_scene_text, simulate
from robodyn_cli.cli.figure_words import figure_lines
from robodyn_cli.errors import SceneError
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.report.registry import applicable
from robodyn_cli.results.hdf5 import read
from robodyn_cli.results.hdf5 import write as write_result
from robodyn_cli.results.result import Result
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.works.deploy.growth import close_latch, locked
from tests.mechanisms import CONFIGS, SLIDER, close
from tests.unit.test_run_inverse_closed import FIVE_BAR

SCENE = CONFIGS / "mechanisms" / "four_bar_locked.yaml"
SPREAD = [
    "torques={a: 3, c: -3}", "actuated=[a, c]", "gravity=[0, -1, 0]", "simulate.duration=3", "simulate.samples=301",
    "initial.q={a: 1.9, b: -1.0, c: 1.2, d: 1.0}",
    "deploy={latch: {between: [upper_left, upper_right]}, after: continue}",
]  # fmt: skip


def stood(*overrides: str) -> Result:
    return deploy(load_scene(SCENE, ["simulate.samples=401", *overrides]))


def test_the_lecture_stands_as_a_truss(tmp_path) -> None:  # type: ignore[no-untyped-def]
    result = stood()
    after, lock = result.summary["after_lock"], result.summary["lock"]
    assert (
        result.status == "locked" and after["degrees_of_freedom"] == 0 and after["rows"] == ["latch.turn_z"]
    )
    assert result.time[-1] == 20.0 and np.all(np.diff(result.time) > 0.0)
    later = result.time > lock["time"]
    close(result["q"][later], np.tile(list(lock["angles"].values()), (later.sum(), 1)), 1e-9)
    assert np.abs(result["qd"][later]).max() < 1e-9
    # a beam of two equal weights on two pins, the latch in its middle
    bend = 8.25 * 0.01 * 2.4 / 4 * abs(np.cos(lock["angles"]["phi1"]))
    assert after["latch"]["moment_at_end"] == pytest.approx(bend, rel=1e-9)
    close(np.abs(result["loop_reactions/latch"][later, -1]), bend, 1e-9)
    assert np.all(result["loop_reactions/latch"][~later] == 0.0)
    rows = result.variables["constraints/multipliers"].names
    assert rows == ("pin.x", "pin.y", "latch.turn_z")
    assert np.all(result["constraints/multipliers"][~later, 2] == 0.0)
    # at rest the ground carries the weight
    close(result["base_wrench"][later, :3], [0.0, (20.15 + 2 * 8.25) * 0.01, 0.0], 1e-9)
    event = next(event for event in result.events if event["kind"] == "lock")
    assert event["name"] == "latch" and event["energy_lost"] == lock["latch"]["energy_lost"]
    write_result(result, tmp_path / "result.h5")
    assert read(tmp_path / "result.h5").variables["loop_reactions/latch"].data.shape == (len(result.time), 6)


def test_what_may_still_move_goes_on_moving() -> None:
    """A five-bar that locks to a four-bar, against a simulation of the mechanism with a weld in its place."""
    result = deploy(load_scene_text(FIVE_BAR, overrides=SPREAD))
    summary = result.summary
    assert summary["after_lock"]["degrees_of_freedom"] == 1 and summary["status"] == "locked"
    stop, latch = summary["lock"]["time"], summary["lock"]["latch"]
    assert latch["energy_lost"] > 0.0 and summary["after_lock"]["energy_drift"] < 1e-9
    q, v = summary["lock"]["angles"], latch["rates_after"]
    turn = q["c"] + q["d"] - q["a"] - q["b"]
    weld = (
        "loops=[{name: tip, type: revolute, between: [upper_left.end, upper_right.end]},"
        f"{{name: weld, type: fixed, between: [upper_left.end, upper_right.end], rpy: [0, 0, {turn!r}]}}]"
    )
    first = int(np.searchsorted(result.time, stop, side="right"))
    times = result.time[first:]
    same = simulate(load_scene_text(FIVE_BAR, overrides=[
        "torques={a: 3, c: -3}", "gravity=[0, -1, 0]", weld, f"initial={{q: {q}, qd: {v}}}",
        f"simulate={{duration: {float(times[0] - stop)!r}, samples: 2}}",
    ]))  # fmt: skip
    close(result["q"][first], same["q"][-1], 1e-8)
    close(result["qd"][first], same["qd"][-1], 1e-8)
    end = simulate(load_scene_text(FIVE_BAR, overrides=[
        "torques={a: 3, c: -3}", "gravity=[0, -1, 0]", weld, f"initial={{q: {q}, qd: {v}}}",
        f"simulate={{duration: {float(result.time[-1] - stop)!r}, samples: 2}}",
    ]))  # fmt: skip
    close(result["q"][-1], end["q"][-1], 1e-7)
    # the two links keep their attitude to each other
    held = result["q"][first:] @ np.array([-1.0, -1.0, 1.0, 1.0])
    close(held, turn, 1e-9)


@pytest.mark.parametrize(("between", "rows"), [
    (["disc", "bar"], ("latch.turn_z",)), (["base", "piston"], ("latch.x",)), (["bar", "piston"], ("latch.turn_z",)),
    (["base", "disc"], ("latch.turn_z",)),
])  # fmt: skip
def test_latches_on_hinges_slides_and_closures(between: list[str], rows: tuple[str, ...]) -> None:
    """Only what joints and closures leave open is locked, and the impulse brings the mechanism to rest."""
    setup = prepare(load_scene_text("schema: 1\n" + SLIDER, overrides=["initial.qd={crank: 3}"]))
    problem, q, v = setup.problem, setup.assembled.q, setup.assembled.v
    latch = locked(problem, between[0], between[1], q, 0.0)
    assert latch.freedom == 0 and len(latch.rows) == 1
    if between != ["base", "piston"]:
        assert latch.rows == rows
    else:
        assert latch.rows[0] in ("latch.x", "latch.y", "latch.z")
    impact = close_latch(problem, latch, q, v, 0.0)
    close(impact.qd_after, 0.0, 1e-12)
    assert impact.energy_lost > 0.0


def test_spatial_latch() -> None:
    """The spatial slider-crank, its cross locked to the slider: one freedom less."""
    setup = prepare(load_scene(CONFIGS / "benchmarks" / "spatial_slider_crank.yaml"))
    problem, q, v = setup.problem, setup.assembled.q, setup.assembled.v
    latch = locked(problem, "slider", "cross", q, 0.0)
    assert latch.freedom == 0 and len(latch.rows) == 1 and latch.rows[0].startswith("latch.turn")
    impact = close_latch(problem, latch, q, v, 0.0)
    before = 0.5 * v @ np.array([[float(x) for x in row] for row in _mass(problem, q)]) @ v
    assert impact.energy_lost == pytest.approx(before, rel=1e-9)


def _mass(problem, q):  # type: ignore[no-untyped-def]
    from robodyn_cli.expr.rebuild import evaluate

    flat = evaluate(list(problem.mass_matrix.ravel()), {"q": q.tolist(), "t": [0.0], "p": []})
    return np.array(flat, dtype=float).reshape(len(q), len(q))


DRIVEN = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1]}
    - {name: b, type: revolute, axis: [0, 0, 1], origin: {xyz: [1, 0, 0]}}
  links:
    - {name: upper, mass: 2, com: [0.5, 0, 0], inertia: {zz: 0.03}}
    - {name: fore, mass: 1, com: [0.4, 0, 0], inertia: {zz: 0.03}}
catalogue: {motors: {m1: {type: dc, torque_constant: 0.9, resistance: 0.6, voltage: 300, max_current: 90,
                          rated_current: 40, rotor_inertia: 5e-5}}}
drives: {a: {motor: m1}}
initial: {q: {a: 0.3, b: 0.6}}
deploy: {criterion: latch, latch: {between: [upper, fore], at: {b: 0.65}}}
simulate: {duration: 0.3, samples: 11}
"""


@pytest.mark.parametrize("after", ["stop", "continue"])
def test_drives_of_a_deployment_have_figures_that_depend_on_no_samples(after: str) -> None:
    """The lock is no sample of the grid; both motions count, up to it and behind it."""
    runs = [
        deploy(load_scene_text(DRIVEN, overrides=[f"deploy.after={after}", f"simulate.samples={n}"]))
        for n in (11, 42)
    ]
    one, two = (run.summary["drives"]["a"] for run in runs)
    assert runs[0].summary["lock"] is not None and runs[0].status == runs[1].status == "locked"
    assert "drives" in applicable(runs[0]) and leaf_of("deploy", "drives.a.joint.peak_torque") is not None
    printed = "\n".join(figure_lines(runs[0], verbose=False)).splitlines()
    assert any(line.lstrip().startswith("a ") and " m1 " in line for line in printed), printed
    for name in ("peak_torque", "rms_torque", "peak_speed"):
        error = one["joint"]["errors"][name]
        assert one["joint"][name] == pytest.approx(two["joint"][name], rel=1e-9, abs=2.0 * error), name
    size = (np.abs(run["qdd"][:, 0]).max() * 5e-5 for run in runs)
    assert one["joint"]["peak_torque"] >= max(size) * (1.0 - 1e-9), (
        "of the rotor alone: nothing else drives the joint"
    )


@pytest.mark.parametrize("samples", [1501, 31])
def test_loads_without_bound_have_no_largest_one(samples: int) -> None:
    """Towards a dead point that is driven into they are as large as the last sample is near to it: 13 kN, or 30 N."""
    result = deploy(
        load_scene(
            CONFIGS / "four_bar_prescribed.yaml",
            ["outputs.reactions=true", "motorisation={}", "drives={theta1: {motor: m1}}",
             f"simulate.samples={samples}", f"catalogue={yaml.safe_load(DRIVEN)['catalogue']}"],
        )
    )  # fmt: skip
    assert result.status == "locked" and not {"drives", "motorisation", "reactions"} & set(result.summary)
    (warning,) = (text for text in result.summary["warnings"] if "no bound" in text)
    assert "no largest loads, figures of drives or margins" in warning
    assert np.abs(result["reactions/phi1"]).max() > 1.0, "the samples have them"


def test_a_stop_between_two_samples_makes_no_peak_of_a_drive() -> None:
    """What a rotor bears is largest at the start; far samples said more, from behind the stop that is met in between."""
    stop = "limits: {lower: 0.2995, stop: {stiffness: 2000, damping: 5}}, spring: {stiffness: 5}"
    text = DRIVEN.replace("axis: [0, 0, 1]}", f"axis: [0, 0, 1], {stop}}}", 1)
    for samples in (5, 11, 60):
        run = simulate(
            load_scene_text(text, overrides=["simulate.duration=0.05", f"simulate.samples={samples}"])
        )
        joint = run.summary["drives"]["a"]["joint"]
        assert joint["peak_torque"] == pytest.approx(5e-5 * abs(run["qdd"][0, 0]), rel=1e-9)
        assert joint["peak_torque_time"] <= joint["errors"]["peak_torque_time"] < 1e-4


@pytest.mark.parametrize("rtol", ["1e-6", "1e-8", "1e-10"])
def test_a_moment_that_is_zero_but_for_rounding_has_an_error_that_says_so(rtol: str) -> None:
    """At rest nothing turns the latch, but other loads, of some newtons, round."""
    summary = deploy(
        load_scene(CONFIGS / "four_bar_deploy.yaml", ["deploy.after=continue", f"simulate.rtol={rtol}"])
    ).summary
    load = summary["after_lock"]["latch"]
    for name in ("peak_moment", "moment_at_end"):
        assert abs(load[name]) <= load["errors"][name] < 1e-12


def test_loads_beyond_their_limit_are_an_overload() -> None:
    result = stood("deploy.loads={pin: {force: 100}, theta1: {moment: 1000}}")
    over = result.summary["overload"]
    assert result.status == "overload" and (over["name"], over["quantity"]) == ("pin", "force")
    force = np.linalg.norm(result["loop_reactions/pin"][:, :3], axis=1)
    assert over["largest"] == pytest.approx(force.max())
    close = stood("deploy.loads={pin: {force: 100}}", "simulate.samples=20001")
    force = np.linalg.norm(close["loop_reactions/pin"][:, :3], axis=1)
    k = int(np.argmax(force > 100))
    assert over["time_error"] < 0.01
    assert close.time[k - 1] - over["time_error"] <= over["time"] <= close.time[k] + over["time_error"]
    latch = stood("deploy.loads={latch: {moment: 0.04}}")
    assert latch.summary["overload"]["name"] == "latch" and latch.summary["overload"]["time"] > 13.0
    assert stood("deploy.loads={pin: {force: 1e5}}").status == "locked"


def test_what_is_refused() -> None:
    with pytest.raises(SceneError, match="needs a latch"):
        load_scene(CONFIGS / "double_pendulum.yaml", ["deploy.after=continue"])
    with pytest.raises(SceneError, match="unknown joint or closure 'pim'"):
        stood("deploy.loads={pim: {force: 1}}")
