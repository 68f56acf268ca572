"""Empty things: each command gives a result or says in one message why there is none."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from tests.pairs.draft import ARM, INERTIA
from tests.pairs.judge import against_validate, call, not_finite, write
from tests.pairs.motions import scene

RIGID: dict[str, Any] = {
    "schema": 1,
    "gravity": [0, 0, -9.81],
    "robot": {"joints": [{"name": "a", "type": "fixed"}],
              "links": [{"name": "block", "mass": 1, "com": [0, 0, 0.1], "inertia": INERTIA}]},
}  # fmt: skip
MOTION = {
    "trajectory": {"type": "joint", "duration": 1, "q": {}},
    "inverse": {"samples": 2},
    "kinematics": {"samples": 2},
}
MAPS = ("parameters", "torques", "drives", "prescribed", "outputs", "expect", "study", "initial", "simulate", "inverse",
        "deploy", "assemble", "kinematics", "statics", "catalogue", "control", "trajectory", "reach", "search")  # fmt: skip
LISTS = ("loops", "forces", "payloads", "couplers", "actuated")


def emptied(*keys: str, value: Any) -> dict[str, Any]:
    return {**scene({}), **{key: copy.deepcopy(value) for key in keys}}


EMPTY: dict[str, dict[str, Any]] = {
    "no joint moves": RIGID,
    "no joint moves, with a motion": {**RIGID, **MOTION},
    "no joint moves, prescribed": {**RIGID, "prescribed": {}, "initial": {"q": {}}, "actuated": []},
    "no joint moves, a reach": {**RIGID, "reach": {"frame": "block", "position": [0, 0, 0]}},
    "no joint moves, all attached": {
        **RIGID,
        "robot": {**RIGID["robot"], "attach": [{"link": "x", "to": "a", "mass": 1}]},
    },
    "one link": {
        **ARM,
        "robot": {k: v[:1] for k, v in ARM["robot"].items() if k != "points"},
        "initial": {"q": {"a": 0}},
    },
    "two samples": {**scene({}), **{name: {"samples": 2} for name in ("simulate", "inverse", "kinematics")}},
    "one sample": {**scene({}), **{name: {"samples": 1} for name in ("simulate", "inverse", "kinematics")}},
    "no duration": {**scene({}), "simulate": {"duration": 0}},
    "a motion without a duration": {
        **scene({}),
        "trajectory": {"type": "joint", "duration": 0, "q": {"a": 0, "b": 0}},
    },
    "a motion that stays": {
        **scene({}),
        "trajectory": {"type": "joint", "duration": 1, "q": {"a": 0, "b": 0}},
    },
    "no links": {**scene({}), "robot": {"joints": [], "links": []}},
    "nothing": {},
    **{f"{key}: {{}}": emptied(key, value={}) for key in MAPS},
    **{f"{key}: []": emptied(key, value=[]) for key in LISTS},
    **{f"{key}: null": emptied(key, value=None) for key in (*MAPS, *LISTS)},
    "all maps": emptied(*MAPS[:9], value={}),
    "all lists": emptied(*LISTS, value=[]),
}
COMMANDS = ("inverse", "kinematics", "statics", "assemble", "reach", "linearise", "deploy", "info", "plan")
# they compile: for what is more than an empty key
DEAR = ("simulate", "size", "stability")
# for an empty key, which is read alike for all: two commands where it is empty, the other two where it is null
OFTEN = {"null": ("inverse", "reach"), "{}": ("deploy", "plan"), "[]": ("deploy", "plan")}


@pytest.mark.parametrize("name", EMPTY)
def test_empty_things_give_a_result_or_a_message(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBODYN_DEBUG", "1")
    for command in OFTEN.get(name.partition(": ")[2], (*COMMANDS, *DEAR)):
        path = write(EMPTY[name], tmp_path / "scene", command if command not in ("info", "plan") else None)
        options = ["--no-plots", "--out", "out"] if command != "plan" else ["--for", "inverse"]
        done = call(
            [command, "scene.yaml", *options, *(["--quick"] if command == "stability" else [])],
            tmp_path / "scene",
        )
        assert not done.finding and done.code in (0, 1, 2, 3, 4, 5), f"{command}: {done.finding}\n{done.err}"
        if command not in ("info", "plan"):
            assert done.code in (0, 1) or done.message, f"{command} ends with {done.code} without a word"
            assert not against_validate(path, command, done), command
            if done.code in (0, 1):
                assert not not_finite(tmp_path / "scene" / "out")


NOTHING: list[Any] = [{"t": t, "q": {}} for t in (0, 0.5, 1)]
WAITING: list[Any] = [NOTHING[0], {**NOTHING[1], "dwell": 0.2}, NOTHING[2]]
OF_NO_JOINT: dict[str, dict[str, Any]] = {
    **{kind: {"type": kind, "points": NOTHING} for kind in ("quintic", "cubic", "monotone")},
    **{f"{kind}, waiting": {"type": kind, "points": WAITING} for kind in ("quintic", "cubic", "monotone")},
    "fourier": {"type": "fourier", "offset": {}, "period": 1, "duration": 1},
    "sequence": {
        "type": "sequence",
        "segments": [{"type": "quintic", "points": NOTHING}, MOTION["trajectory"]],
    },
}


@pytest.mark.parametrize("kind", OF_NO_JOINT)
def test_a_motion_of_no_joint_passes_time(kind: str, tmp_path: Path) -> None:
    write({**RIGID, **MOTION, "trajectory": OF_NO_JOINT[kind]}, tmp_path / "scene")
    done = call(["kinematics", "scene.yaml", "--no-plots", "--out", "out"], tmp_path / "scene")
    assert done.code == 0 and not done.finding, done.err


@pytest.mark.parametrize("command", ["info", "statics", "kinematics"])
def test_a_robot_without_joints_is_drawn(command: str, tmp_path: Path) -> None:
    write({**RIGID, **MOTION}, tmp_path / "scene")
    done = call([command, "scene.yaml", "--out", "out"], tmp_path / "scene")
    assert done.code == 0 and not done.finding, done.err
