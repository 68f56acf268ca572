"""Results as MCAP: transforms of links and frames, states of joints and events as messages of ROS 2.

Foxglove, Rerun and ``ros2 bag`` read the file. Times are those of the run, from its start on 1 January 1970.
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.observe.places import quaternions
from robodyn_cli.report.drawing.build import problem_of
from robodyn_cli.results.atomic import output_errors, written
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.works.functions.model import ModelFunctions

NAME = "result.mcap"
GROUND = "world"
SECOND = 10**9  # ns
INFO = 20  # level of ``rcl_interfaces/msg/Log``
RULE = "=" * 80
TIME = "int32 sec\nuint32 nanosec"
HEADER = "builtin_interfaces/Time stamp\nstring frame_id"
# type of the messages of a topic: its definition, and those of the types that it is made of
TYPES: dict[str, tuple[str, dict[str, str]]] = {
    "sensor_msgs/msg/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
        {"std_msgs/Header": HEADER, "builtin_interfaces/Time": TIME},
    ),
    "tf2_msgs/msg/TFMessage": (
        "geometry_msgs/TransformStamped[] transforms",
        {
            "geometry_msgs/TransformStamped": (
                "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
            ),
            "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
            "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
            "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
            "std_msgs/Header": HEADER,
            "builtin_interfaces/Time": TIME,
        },
    ),
    "rcl_interfaces/msg/Log": (
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\n"
        "uint32 line",
        {"builtin_interfaces/Time": TIME},
    ),
}
TOPICS = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/events": "rcl_interfaces/msg/Log",
}
Message = tuple[int, str, dict[str, Any]]  # time [ns], topic and contents


def export_mcap(result: Result, directory: Path) -> list[Path]:
    """Write a result into ``result.mcap`` in a directory, whole or not at all; return its path.

    Raises
    ------
    CapabilityError : a package is missing, or the result has no motion. OutputError : it cannot be written.
    """
    if importlib.util.find_spec("mcap_ros2") is None:
        raise CapabilityError("MCAP needs the package mcap-ros2-support: pip install 'robodyn[mcap]'")
    if "q" not in result or "time" not in result:
        raise CapabilityError(
            f"a result of '{result.command}' has no motion for MCAP; allowed: a result of inverse, simulate, deploy or "
            "kinematics"
        )
    if result.time[0] < 0.0:
        raise CapabilityError(f"MCAP has no times before 0; the result begins at {result.time[0]:.6g} s")
    from mcap_ros2.writer import Writer

    messages = sorted((*_states(result), *_transforms(result), *_events(result)), key=lambda m: m[0])
    with output_errors(directory):
        directory.mkdir(parents=True, exist_ok=True)
    target = directory / NAME
    with written(target) as temporary, open(temporary, "wb") as stream:
        writer = Writer(stream)
        schemas = {name: writer.register_msgdef(name, _definition(name)) for name in TOPICS.values()}
        for time, topic, message in messages:
            writer.write_message(topic, schemas[TOPICS[topic]], message, log_time=time)
        writer.finish()  # type: ignore[no-untyped-call]
    return [target]


def _definition(name: str) -> str:
    """Return the definition of a type of messages with those of its parts."""
    own, parts = TYPES[name]
    return "\n".join([own, *(f"{RULE}\nMSG: {part}\n{text}" for part, text in parts.items())])


def _stamp(time: float) -> tuple[int, dict[str, int]]:
    """Return a time [s] in ns, and as a stamp."""
    whole = round(time * SECOND)
    return whole, {"sec": whole // SECOND, "nanosec": whole % SECOND}


def _states(result: Result) -> Iterator[Message]:
    """Yield positions, rates and efforts of all columns of rates that are those of a position: attitudes are in the
    transforms."""
    q, named = result.variables["q"], result.variables.get("qd")
    names = [name for name in q.names if named is None or name in named.names]
    columns: dict[str, Array] = {}
    for key, path in (("position", "q"), ("velocity", "qd"), ("effort", "tau")):
        variable = result.variables.get(path)
        if variable is not None and set(names) <= set(variable.names):
            columns[key] = variable.data[:, [variable.names.index(name) for name in names]]
    for k, t in enumerate(result.time.tolist()):
        time, stamp = _stamp(t)
        values = {
            key: columns[key][k].tolist() if key in columns else []
            for key in ("position", "velocity", "effort")
        }
        yield time, "/joint_states", {"header": _header(stamp), "name": names, **values}


def _header(stamp: Mapping[str, int], frame: str = "") -> dict[str, Any]:
    return {"stamp": stamp, "frame_id": frame}


def _transforms(result: Result) -> Iterator[Message]:
    """Yield the poses of links and named frames in the world at each sample, as far as they are numbers."""
    poses = _poses(result)
    for k, t in enumerate(result.time.tolist()):
        time, stamp = _stamp(t)
        transforms = [
            {
                "header": _header(stamp, GROUND),
                "child_frame_id": name,
                "transform": {
                    "translation": dict(zip("xyz", p[k].tolist())),
                    "rotation": dict(zip("wxyz", u[k].tolist())),
                },
            }
            for name, (p, u) in poses.items()
            if np.isfinite(p[k]).all()
        ]
        yield time, "/tf", {"transforms": transforms}


def _poses(result: Result) -> dict[str, tuple[Array, Array]]:
    """Return positions (T, 3) [m] and unit quaternions (T, 4), scalar first, of links and frames in the world."""
    problem = problem_of(result)
    functions, poses = ModelFunctions(problem), {}
    for name in {**problem.model.links, **problem.model.frames}:
        p, R = functions.forward_kinematics(name, result["q"])
        poses[name] = p, quaternions(R)
    return poses


def _events(result: Result) -> Iterator[Message]:
    """Yield what happened: kind and facts as the text of a log."""
    for event in result.events:
        time, stamp = _stamp(max(float(event["time"]), 0.0))
        facts = {key: value for key, value in event.items() if key not in ("time", "name", "kind")}
        text = f"{event['kind']} {json.dumps(facts)}" if facts else str(event["kind"])
        log = {"stamp": stamp, "level": INFO, "name": str(event["name"]), "msg": text}
        yield time, "/events", {**log, "file": "", "function": "", "line": 0}
