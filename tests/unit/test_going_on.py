"""Runs that go on from a stored one: the same motion as a run without a break, and clear refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.errors import CapabilityError, RobodynError, SceneError
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.going_on import Journal
from robodyn_cli.over.commands import execute
from robodyn_cli.results.hdf5 import write
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene
from robodyn_cli.tools.progress import Stopwatch, no_progress
from robodyn_cli.works.simulate import simulate

ROOT = Path(__file__).parents[2]
NAME = "samples"
SCENES = {
    # open chain; loops; floating joint; sticking; impacts; losses with work; prescribed joint
    "configs/double_pendulum.yaml": (2.0, 1e-8),
    "configs/benchmarks/slider_crank.yaml": (2.0, 1e-7),
    "configs/tumbling_body.yaml": (2.0, 1e-8),
    "configs/stick_slip.yaml": (4.0, 1e-8),
    "configs/bouncing_pendulum.yaml": (3.0, 1e-7),
    "configs/four_bar_prescribed.yaml": (2.0, 1e-7),
    "configs/benchmarks/four_bar_n2.yaml": (1.8, 1e-6),
}


def run(scene: str, *changes: str) -> Result:
    return simulate(load_scene(ROOT / scene, list(changes)))


@pytest.mark.parametrize("at", [0.25, 0.6])
@pytest.mark.parametrize("scene", SCENES)
def test_a_run_in_two_parts_is_the_run_without_a_break(scene: str, at: float, tmp_path: Path) -> None:
    duration, tolerance = SCENES[scene]
    end, middle = f"simulate.duration={duration}", at * duration
    whole = run(scene, end, "simulate.samples=41")
    part = run(scene, f"simulate.duration={middle}", "simulate.samples=11")
    write(part, tmp_path / "result.h5")
    rest = run(scene, end, "simulate.samples=41", f"initial.from={tmp_path}")
    times, again = whole.variables["time"].data, rest.variables["time"].data
    first = int(np.argmin(np.abs(times - middle)))
    np.testing.assert_allclose(again, times[first:], rtol=1e-14)
    for name in ("q", "qd", "energy/total", "energy/work"):
        if name in whole.variables:
            np.testing.assert_allclose(
                rest.variables[name].data, whole.variables[name].data[first:],
                rtol=tolerance, atol=tolerance, err_msg=name,
            )  # fmt: skip
    # the estimate holds for what this run adds
    assert rest.summary["error_estimate"]["state_max"] < 10 * tolerance


def test_fixed_steps_give_the_same_bits(tmp_path: Path) -> None:
    changes = ["simulate.integrator=rk4", "simulate.step=0.125", "simulate.duration=2", "simulate.samples=9"]
    whole = run("configs/double_pendulum.yaml", *changes)
    write(whole, tmp_path / "result.h5")
    rest = run("configs/double_pendulum.yaml", *changes, f"initial.from={tmp_path}", "initial.at=0.75")
    for name in ("q", "qd"):
        np.testing.assert_array_equal(rest.variables[name].data, whole.variables[name].data[3:])


def test_positions_need_not_be_given_again(tmp_path: Path) -> None:
    text = (ROOT / "configs/double_pendulum.yaml").read_text(encoding="utf-8")
    short = tmp_path / "short.yaml"
    text = text.replace("robots/planar_2r.yaml", str(ROOT / "configs/robots/planar_2r.yaml"))
    kept = [line for line in text.splitlines() if not line.startswith("initial:")]
    assert len(kept) < len(text.splitlines())
    short.write_text("\n".join([*kept, "initial: {from: result.h5, at: 0.5}"]), encoding="utf-8")
    whole = run("configs/double_pendulum.yaml", "simulate.duration=1", "simulate.samples=11")
    write(whole, tmp_path / "result.h5")
    rest = simulate(load_scene(short, ["simulate.duration=1", "simulate.samples=11"]))
    np.testing.assert_allclose(rest.variables["q"].data, whole.variables["q"].data[5:], rtol=1e-8, atol=1e-8)


REFUSED = {
    "no such file": ("configs/double_pendulum.yaml", ["initial.from=nowhere.h5"]),
    "no sample at 0.123 s": ("configs/double_pendulum.yaml", ["initial.at=0.123"]),
    "the end on the same clock": ("configs/double_pendulum.yaml", ["simulate.duration=0.5"]),
    "`from` names none": ("configs/double_pendulum.yaml", ["initial.from=null", "initial.at=1"]),
    "has no coordinate": ("configs/tumbling_body.yaml", []),
    r"has no joint 'theta3' \(did you mean 'theta2'\?\); it has theta1, theta2": (
        "configs/double_pendulum.yaml",
        ["robot.joints.theta2.name=theta3", "initial.q=null", "initial.qd=null", "expect={}"],
    ),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_gone_on_from(words: str, tmp_path: Path) -> None:
    stored = run("configs/double_pendulum.yaml", "simulate.duration=1", "simulate.samples=11")
    write(stored, tmp_path / "result.h5")
    scene, changes = REFUSED[words]
    with pytest.raises(SceneError, match=words):
        run(scene, "simulate.duration=2", f"initial.from={tmp_path}", *changes)


def test_loops_of_another_size_are_refused(tmp_path: Path) -> None:
    scene = "configs/benchmarks/slider_crank.yaml"
    write(run(scene, "simulate.duration=0.5", "simulate.samples=11"), tmp_path / "result.h5")
    name = next(iter(load_scene(ROOT / scene).robot.points))
    with pytest.raises(RobodynError, match="are off by"):
        run(scene, "simulate.duration=1", f"initial.from={tmp_path}", f"robot.points.{name}.at=[0.37, 0, 0]")


def test_other_commands_do_not_go_on(tmp_path: Path) -> None:
    scene = load_scene(ROOT / "configs/four_bar_deploy.yaml", [f"initial.from={tmp_path}"])
    with pytest.raises(SceneError, match="'deploy' goes on from a stored run with 'deploy.latches' alone"):
        execute("deploy", scene, no_progress, Stopwatch())


class Killed(Exception):
    """What stands for the end of the process."""


LONG = {
    # plain; loops and a prescribed joint; a floating body with a stiff method
    "configs/double_pendulum.yaml": [
        "simulate.duration=2",
        "robot.joints.theta2.limits={speed: 0.5, lower: -1}",
    ],
    "configs/four_bar_prescribed.yaml": ["simulate.duration=1"],
    "configs/tumbling_body.yaml": ["simulate.duration=2", "simulate.integrator=radau13"],
}


@pytest.mark.parametrize("torn", [0, 1000])
@pytest.mark.parametrize("scene", LONG)
def test_a_run_that_was_killed_goes_on(
    scene: str, torn: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``torn`` : bytes that the last block lacks, because the process ended while it was written."""
    monkeypatch.setattr(Driver.run, "__defaults__", (50, True))  # samples in a block
    loaded = load_scene(ROOT / scene, [*LONG[scene], "simulate.samples=501"])
    whole = simulate(loaded)
    path = tmp_path / NAME

    def end(done: float, duration: float) -> None:
        if done > 0.6 * duration:
            raise Killed

    with pytest.raises(Killed), Journal(path, loaded) as journal:
        simulate(loaded, progress=end, journal=journal)
    if torn:
        path.write_bytes(path.read_bytes()[:-torn])
    with Journal(path, loaded, resume=True) as journal:
        assert journal.taken
        kept = sum(len(block.t) for block in journal.blocks())
        assert 200 < kept < 450
        rest = simulate(loaded, journal=journal)
    np.testing.assert_array_equal(rest.variables["time"].data, whole.variables["time"].data)
    for name in ("q", "qd", "energy/total"):
        found, expected = rest.variables[name].data, whole.variables[name].data
        np.testing.assert_array_equal(found[:kept], expected[:kept])
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)
    assert rest.summary["samples"] == 501
    # all of the run is counted; the step with which it goes on is chosen anew
    assert whole.summary["counters"]["steps"] <= rest.summary["counters"]["steps"] + 2
    assert rest.summary["error_estimate"]["state_max"] < 1e-7
    # of limits that joints passed before the run was killed, with their times
    warnings = whole.summary.get("warnings", [])
    assert rest.summary.get("warnings", []) == warnings
    assert ("passes its" in str(warnings)) == ("limits" in str(LONG[scene]))


def test_the_blocks_of_another_run_are_refused(tmp_path: Path) -> None:
    path, scene = tmp_path / NAME, ROOT / "configs/double_pendulum.yaml"
    first = load_scene(scene, ["simulate.duration=1", "simulate.samples=11"])
    with Journal(path, first) as journal:
        simulate(first, journal=journal)
    with pytest.raises(SceneError, match="another scene, other settings"):
        Journal(path, load_scene(scene, ["simulate.duration=2"]), resume=True)
    assert not Journal(path, first).taken
    assert not Journal(tmp_path / "none", first, resume=True).taken


def test_a_run_whose_contacts_change_does_not_go_on(tmp_path: Path) -> None:
    scene = load_scene(ROOT / "configs/stick_slip.yaml", ["simulate.duration=1", "simulate.samples=11"])
    with Journal(tmp_path / NAME, scene) as journal:
        simulate(scene, journal=journal)
    with (
        Journal(tmp_path / NAME, scene, resume=True) as journal,
        pytest.raises(CapabilityError, match="--resume"),
    ):
        simulate(scene, journal=journal)
