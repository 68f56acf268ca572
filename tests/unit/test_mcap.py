"""MCAP of results: what a reader of ROS 2 messages finds in the file is the motion."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robodyn_cli import load_scene, load_scene_text
from robodyn_cli.cli.app import run
from robodyn_cli.over.batch.stored import read_stored
from robodyn_cli.over.commands import execute
from robodyn_cli.over.export.mcap import export_mcap
from robodyn_cli.results.hdf5 import write
from robodyn_cli.results.result import Result
from robodyn_cli.tools.progress import Stopwatch, no_progress
from tests.mechanisms import CONFIGS

BODIES = """
schema: 1
command: simulate
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: float, type: floating, parent: base}
    - {name: ball, type: spherical, origin: {xyz: [0.3, 0, 0.1]}}
    - {name: pin, type: revolute, axis: [0, 1, 0], origin: {xyz: [0, 0.2, 0], rpy: [0.3, 0.1, -0.4]}}
  links:
    - {name: a, mass: 2, com: [0.1, 0.05, 0], inertia: {xx: 0.1, yy: 0.2, zz: 0.25}}
    - {name: b, mass: 1, com: [0.1, 0, 0], inertia: {xx: 0.05, yy: 0.06, zz: 0.07}}
    - {name: c, mass: 1, com: [0, 0.1, 0], inertia: {xx: 0.02, yy: 0.03, zz: 0.04}}
  points: {tip: {link: c, at: [0.1, 0.2, 0.3]}}
  frames: {hand: {link: c, at: [0.1, 0.2, 0.3], rpy: [0.1, 0.2, 0.3]}}
initial:
  q: {float: {xyz: [0.1, 0.2, 0.3], rpy: [0.3, -0.2, 1]}, ball: {rpy: [0.1, 0.2, -0.3]}, pin: 0.5}
  qd: {pin: 4, ball: {wx: 2, wy: -1, wz: 3}, float: {wx: 1, wy: 5, wz: 0.2}}
simulate: {duration: 1.5, samples: 31}
"""


def messages(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Return times [ns] and messages by topic."""
    reader = pytest.importorskip("mcap_ros2.reader")
    found: dict[str, list[tuple[int, Any]]] = {}
    for message in reader.read_ros2_messages(str(path)):
        found.setdefault(message.channel.topic, []).append((message.log_time_ns, message.ros_msg))
    return found


def result_of(text: str) -> Result:
    scene = load_scene_text(text)
    assert scene.command is not None
    return execute(scene.command, scene, no_progress, Stopwatch())


def test_transforms_carry_points_to_where_the_result_has_them(tmp_path: Path) -> None:
    result = result_of(BODIES)
    (path,) = export_mcap(result, tmp_path)
    found = messages(path)
    assert len(found["/tf"]) == len(result.time)
    before: dict[str, np.ndarray] = {}
    for k, (time, message) in enumerate(found["/tf"]):
        assert time == round(1e9 * result.time[k])
        poses = {x.child_frame_id: x.transform for x in message.transforms}
        assert {"a", "b", "c", "hand"} <= set(poses)
        for name, at, path_of in (
            ("c", (0.1, 0.2, 0.3), "points/tip"),
            ("hand", (0, 0, 0), "frames/hand/position"),
        ):
            p, u = poses[name].translation, poses[name].rotation
            R = Rotation.from_quat([u.x, u.y, u.z, u.w])
            np.testing.assert_allclose(R.apply(at) + [p.x, p.y, p.z], result[path_of][k], atol=1e-12)
            turned = np.array([u.x, u.y, u.z, u.w])
            assert turned @ before.get(name, turned) > 0.0
            before[name] = turned


def test_joints_that_have_angles_are_in_joint_states(tmp_path: Path) -> None:
    result = result_of(BODIES)
    states = messages(export_mcap(result, tmp_path)[0])["/joint_states"]
    q, qd = (result.variables[name] for name in ("q", "qd"))
    for k, (time, state) in enumerate(states):
        assert time == 10**9 * state.header.stamp.sec + state.header.stamp.nanosec
        assert "pin" in state.name and not any("qw" in name or name.endswith(".wx") for name in state.name)
        for name, x, v in zip(state.name, state.position, state.velocity):
            assert x == q.data[k, q.names.index(name)] and v == qd.data[k, qd.names.index(name)]


def test_events_and_efforts_of_a_deployment(tmp_path: Path) -> None:
    scene = load_scene(CONFIGS / "mechanisms" / "solar_array.yaml", ["simulate.samples=21"])
    result = execute("deploy", scene, no_progress, Stopwatch())
    found = messages(export_mcap(result, tmp_path)[0])
    told = [(log.name, log.msg.partition(" ")[0]) for _, log in found["/events"]]
    assert told == [(event["name"], event["kind"]) for event in result.events] and len(told) > 1
    assert [time for time, _ in found["/events"]] == sorted(
        round(1e9 * event["time"]) for event in result.events
    )


def test_what_has_no_motion_or_no_package_is_refused_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    stored = write(Result("sweep", "runs", "ok", ""), tmp_path / "result.h5")
    assert run(["export", str(stored), "--to", "mcap", "--out", str(out)]) == 2
    assert "has no motion for MCAP" in capsys.readouterr().err
    moved = tmp_path / "moved"
    assert run(["inverse", str(CONFIGS / "2r_circle.yaml"), "--out", str(moved), "--no-plots", "-q"]) == 0
    assert run(["export", str(moved), "--to", "mcap", "--out", str(tmp_path / "bag"), "--json"]) == 0
    assert len(messages(tmp_path / "bag" / "result.mcap")["/tf"]) == len(read_stored(moved).time)
    capsys.readouterr()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.delitem(sys.modules, "mcap_ros2.writer", raising=False)
    assert run(["export", str(moved), "--to", "mcap", "--out", str(out)]) == 2
    assert "pip install 'robodyn[mcap]'" in capsys.readouterr().err and not out.exists()
