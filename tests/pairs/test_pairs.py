"""Scenes in which every pair of features meets; ``python -m tests.pairs`` goes on with triples."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

from robodyn_cli.control.registry import control_types
from robodyn_cli.forces.registry import force_types, joint_forces
from robodyn_cli.integration_methods import METHODS
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.loops.registry import loop_types
from robodyn_cli.motors.registry import gear_types, motor_types
from robodyn_cli.scene.nested_options import ReachOptions
from robodyn_cli.scene.robot_parts import Coupler
from robodyn_cli.scene.robot_types import Joint, Robot
from robodyn_cli.scene.types import DeployOptions, Outputs, Scene, SimulateOptions
from robodyn_cli.schema.fields import key_name
from robodyn_cli.trajectories.registry import trajectory_types
from tests.pairs import apart
from tests.pairs.covering import Case, Part, covering, sets_of
from tests.pairs.judge import judged
from tests.pairs.known import KNOWN
from tests.pairs.motions import FAMILIES, MOST, ROWS, families, scene
from tests.pairs.reasons import REASONS, reason_of

BLOCKS = 8


@lru_cache(maxsize=None)
def cases(row: str) -> list[Case]:
    return covering(families(row), list(apart.read(row)), MOST[row])


@lru_cache(maxsize=None)
def singles() -> dict[Part, dict[str, Any]]:
    """Return a scene for each feature."""
    return {(family, name): scene({family: name}) for family, names in FAMILIES.items() for name in names}


def maps(tree: Any) -> Iterator[Mapping[str, Any]]:
    """Return all maps of a tree of YAML."""
    if isinstance(tree, Mapping):
        yield tree
    for item in tree.values() if isinstance(tree, Mapping) else tree if isinstance(tree, list) else ():
        yield from maps(item)


# -- the features ------------------------------------------------------------------------------------------
KINDS = {
    "joint": joint_types, "loop": loop_types, "force": force_types, "trajectory": trajectory_types,
    "control": control_types, "motor": motor_types, "gear": gear_types,
}  # fmt: skip


@pytest.mark.parametrize("family", KINDS)
def test_every_kind_is_a_feature(family: str) -> None:
    """A kind that is new in a registry fails here until a feature has it."""
    found = {m["type"] for part, tree in singles().items() if part[0] == family for m in maps(tree) if "type" in m}
    assert set(KINDS[family]) <= found


def test_every_method_is_a_feature() -> None:
    assert set(FAMILIES["method"]) == set(METHODS)


@pytest.mark.parametrize("section", [Scene, Robot, Joint, SimulateOptions, DeployOptions, Outputs, ReachOptions, Coupler])
def test_every_key_is_in_a_feature(section: Any) -> None:
    """Of the sections that others hang in; a key that is new fails here until a feature has it."""
    keys = {key_name(field) for field in dataclasses.fields(section) if "kind" in field.metadata}
    if section is Joint:
        keys = (keys - {"forces"}) | set(joint_forces)
    found = {key for tree in singles().values() for m in maps(tree) for key in m}
    assert keys - found - NOT_FEATURES == set()


# keys that name files of another run, or say once more what another key says; `command` is each test's own
NOT_FEATURES = {"command", "prefix", "theta", "offset", "max_steps", "components", "axis2"}


@pytest.mark.parametrize("row", ROWS)
def test_every_pair_is_in_a_scene(row: str) -> None:
    """Each pair of features, but for those that are known to stay apart, is in a scene of the covering array."""
    groups = list(apart.read(row))
    together = [set(case.items()) for case in cases(row)]
    for pair in sets_of(families(row)):
        stays_apart = any(group <= set(pair) for group in groups)
        assert stays_apart or any(set(pair) <= case for case in together), pair


# -- the scenes ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("block", range(BLOCKS))
@pytest.mark.parametrize("row", ROWS)
def test_features_go_together(row: str, block: int, tmp_path: Path) -> None:
    for k, case in enumerate(cases(row)[block::BLOCKS]):
        commands = ROWS[row][0] if row != "still" else (ROWS[row][0][k % len(ROWS[row][0])],)
        for command in commands:
            _, found = judged(scene(case), command, tmp_path / "scene")
            left = [text for text in found if not any(words in text for words in KNOWN)]
            assert not left, f"{command} {' '.join('/'.join(part) for part in case.items())}: {left}"


@pytest.mark.parametrize("row", ROWS)
def test_what_stays_apart_is_refused_for_a_stated_reason(row: str) -> None:
    for group, reason in apart.read(row).items():
        assert reason in REASONS.values(), f"{sorted(group)}: {reason}"


def test_reasons_are_told_apart() -> None:
    assert reason_of("'trajectory' is missing") == "`inverse` needs a motion"
    assert reason_of("internal error") is None
