"""Members of registries answer what the bases of their kinds declare, so that nobody asks whether they do."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping
from pathlib import Path

import pytest

from robodyn_cli.control.base import Controller
from robodyn_cli.control.registry import control_types
from robodyn_cli.forces.element import ForceElement, InJoint
from robodyn_cli.forces.registry import force_types, joint_forces
from robodyn_cli.loops.base import LoopClosure
from robodyn_cli.loops.registry import loop_types
from robodyn_cli.scene.load import load_scene
from robodyn_cli.trajectories.base import Lacks, TaskSpaceTrajectory, Trajectory
from robodyn_cli.trajectories.joint_space import JointSpaceTrajectory
from robodyn_cli.trajectories.registry import trajectory_types

CONFIGS = Path(__file__).parents[2] / "configs"
KINDS: dict[type, Mapping[str, type]] = {
    Trajectory: trajectory_types,
    InJoint: joint_forces,
    ForceElement: force_types,
    LoopClosure: loop_types,
    Controller: control_types,
}
MEMBERS = [(base, name) for base, registry in KINDS.items() for name in registry]


def answers(base: type) -> list[str]:
    """Return the names that a base declares for all of its kind."""
    return [name for cls in base.__mro__[:-1] for name in vars(cls) if not name.startswith("_")]


@pytest.mark.parametrize(("base", "name"), MEMBERS, ids=lambda x: getattr(x, "__name__", x))
def test_a_member_answers_what_its_base_declares(base: type, name: str) -> None:
    member = KINDS[base][name]
    assert issubclass(member, base)
    fields = {field.name for field in dataclasses.fields(member)}
    for answer in answers(base):
        assert hasattr(member, answer) or answer in fields, answer


@pytest.mark.parametrize(("base", "name"), MEMBERS, ids=lambda x: getattr(x, "__name__", x))
def test_a_field_wins_over_an_answer_of_the_same_name(base: type, name: str) -> None:
    """A property of a base would take the place of a field, and its value with it."""
    member = KINDS[base][name]
    values = {field.name: object() for field in dataclasses.fields(member)}
    made = member(**values)
    assert {name: inspect.getattr_static(made, name) for name in values} == values
    assert {name: getattr(made, name) for name in values} == values


def test_what_a_trajectory_lacks_says_what_it_gives() -> None:
    seen: set[Lacks] = set()
    for path in sorted(CONFIGS.rglob("*.yaml")):
        found = load_scene(path).trajectory if path.parent.name != "robots" else None
        if found is None:
            continue
        seen.add(found.lacks)
        assert found.in_time == (found.lacks in (Lacks.NOTHING, Lacks.JOINTS)), path
        assert found.least_time >= (found.lacks is Lacks.TIMES), path
        assert isinstance(found, TaskSpaceTrajectory) == (found.lacks is Lacks.JOINTS), path
        assert isinstance(found, JointSpaceTrajectory) == (found.lacks in (Lacks.NOTHING, Lacks.PARTS)), path
        assert (found.point is not None) == (found.ik is not None) == (found.lacks is Lacks.JOINTS), path
        assert bool(found.joints) or found.lacks, path
        assert not found.in_time or found.duration > 0.0, path
    assert {Lacks.NOTHING, Lacks.JOINTS, Lacks.TIMES} <= seen
