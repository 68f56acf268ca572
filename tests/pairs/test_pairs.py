"""Scenes in which every pair of features meets; ``python -m tests.pairs`` goes on with triples."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping
from functools import cache
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
from tests.pairs.draft import Draft
from tests.pairs.judge import ON_SCENES, built, by_other_commands, call, disagreements, judge, judged, write
from tests.pairs.known import KNOWN
from tests.pairs.motions import FAMILIES, MADE, MOST, ROWS, families, scene
from tests.pairs.reasons import REASONS, reason_of

BLOCKS = 8
PARTS = 5  # of what runs each of some scenes several times
WHOLE = 9  # one scene in so many is run as a whole


@cache
def cases(row: str) -> list[Case]:
    return covering(families(row), list(apart.read(row)), MOST[row])


@cache
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
    found = {
        m["type"] for part, tree in singles().items() if part[0] == family for m in maps(tree) if "type" in m
    }
    assert set(KINDS[family]) <= found


def test_every_method_is_a_feature() -> None:
    assert set(FAMILIES["method"]) == set(METHODS)


@pytest.mark.parametrize(
    "section", [Scene, Robot, Joint, SimulateOptions, DeployOptions, Outputs, ReachOptions, Coupler]
)
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
    """Every scene of ``simulate`` is built, as ``validate`` does; one in some of each row is run as a whole.

    ``python -m tests.pairs --array`` runs all.
    """
    commands = ROWS[row][0]
    for k, case in list(enumerate(cases(row)))[block::BLOCKS]:
        whole = k // BLOCKS % WHOLE == 0
        if not whole and row != "simulate":
            continue
        command = commands[k // (BLOCKS * WHOLE) % len(commands)]
        judged_by = judge if whole else built
        found = judged_by(scene(case), command, tmp_path / "scene")
        left = [text for text in found if not any(words in text for words in KNOWN)]
        assert not left, f"{command} {' '.join('/'.join(part) for part in case.items())}: {left}"


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("command", ["simulate", "inverse"])
def test_one_run_is_the_same_among_many(command: str, part: int, tmp_path: Path) -> None:
    for case in cases(command)[::40][part::PARTS]:
        assert not disagreements(scene(case), command, tmp_path / "scene"), case


EXPORTS = tuple(name for name in ON_SCENES if name.startswith("export "))


@pytest.mark.parametrize("part", range(2))
def test_other_commands_take_the_scenes(part: int, tmp_path: Path) -> None:
    for case in ({"form": "no_estimate"}, {"form": "studied"}, *cases("simulate")[::160])[part::2]:
        names = (
            "info",
            "plan",
            "equations",
            "crosscheck",
            "sensitivity",
            "check",
            "compare",
            "export",
            "crosscheck own",
            *EXPORTS,
        )
        assert not by_other_commands(scene(case), tmp_path / "scene", names), case


# -- what has gone wrong ---------------------------------------------------------------------------------------
FOUND: dict[str, tuple[str, Case]] = {
    "a controller with states and an effort": (
        "simulate",
        {"limit": "effort", "sampled": "period", "control": "pd"},
    ),
    "a formula beside a trajectory of formulas": (
        "inverse",
        {"prescribed": "formula", "trajectory": "joint"},
    ),
    "gains left to a run with prescribed joints alone": (
        "simulate",
        {"prescribed": "formula", "form": "studied"},
    ),
    "a short motion of a mechanism that is followed": (
        "simulate",
        {"coupler": "in_time", "sampled": "period"},
    ),
    "a short path that is followed": ("simulate", {"trajectory": "cartesian", "led": "trajectory"}),
}


def test_a_controller_without_joints_is_refused_with_its_outputs(tmp_path: Path) -> None:
    """The columns of a scene were asked for after its controller had been refused, and had no joints to tell."""
    case = {
        "control": "feed_forward", "force": "wrench", "form": "independent", "loop": "universal", "output": "design",
        "prescribed": "formula", "payload": "caught",
    }  # fmt: skip
    found = built(scene(case), "simulate", tmp_path / "scene")
    assert not found, found


@pytest.mark.parametrize("name", FOUND)
def test_what_went_wrong_runs(name: str, tmp_path: Path) -> None:
    command, case = FOUND[name]
    done, found = judged(scene(case), command, tmp_path / "scene")
    assert done.code == 0 and not found, f"{found} {done.err}"


def test_energies_that_are_not_finite_are_no_drift_of_zero(tmp_path: Path) -> None:
    four_bar = Path(__file__).parents[2] / "configs" / "four_bar_deploy.yaml"
    heavy = ("--set", "robot.links.crank.mass=1.7e308", "--set", "simulate={duration: 0.1, samples: 11}")
    done = call(["deploy", str(four_bar), *heavy, "--no-plots", "--out", "out"], tmp_path)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert done.code == 3 and "not finite" in done.message
    assert summary["energy_drift"] is None and summary["energy_drift_relative"] is None


@pytest.mark.parametrize("speed", [1e-3, 1e-50])
def test_a_low_limit_of_speed_is_kept(speed: float, tmp_path: Path) -> None:
    """Between coarse points the squared speed went below zero, and the time law had no value."""
    tree = scene({"trajectory": "fastest"})
    tree["trajectory"] |= {"path": MADE["circle"](Draft()), "speed": {"a": speed, "b": 2}}
    del tree["trajectory"]["points"], tree["trajectory"]["intervals"], tree["trajectory"]["path"]["ik"]
    done, found = judged(tree, "inverse", tmp_path / "scene")
    assert done.code == 0 and not found, f"{found} {done.err}"


@pytest.mark.parametrize("row", ROWS)
def test_what_stays_apart_is_refused_for_a_stated_reason(row: str) -> None:
    for group, reason in apart.read(row).items():
        assert reason in REASONS.values(), f"{sorted(group)}: {reason}"


def test_the_docs_print_the_reasons() -> None:
    page = (Path(__file__).parents[2] / "docs" / "scene.md").read_text(encoding="utf-8")
    printed = page.partition("<!-- apart -->\n")[2].partition("\n<!-- end -->")[0]
    assert printed.splitlines() == [f"- {reason}" for reason in dict.fromkeys(REASONS.values())]


def test_reasons_are_told_apart() -> None:
    assert reason_of("'trajectory' is missing") == "`inverse` needs a motion"
    assert reason_of("internal error") is None


# -- latches beside what changes a motion on its way --------------------------------------------------------------
BESIDE = [("payload", "gripped"), ("payload", "released"), ("form", "pass"), ("form", "independent"), ("method", "bdf"),
          ("method", "generalized_alpha")]  # fmt: skip


@pytest.mark.parametrize("asked", ["latches", "sprung"])
@pytest.mark.parametrize(("family", "name"), BESIDE)
@pytest.mark.parametrize("loop", [{}, {"loop": "revolute"}, {"coupler": "scene"}])
def test_latches_go_with_what_changes_a_motion(
    asked: str, family: str, name: str, loop: Case, tmp_path: Path
) -> None:
    done, found = judged(scene({"asked": asked, family: name, **loop}), "deploy", tmp_path / "scene")
    assert not found and done.code in (0, 1, 2), f"{found} {done.err}"
    may_be_refused = name == "generalized_alpha" or not loop
    assert done.code != 2 or may_be_refused, done.err


# -- figures that are asked for ------------------------------------------------------------------------------------
GIVES = {"extremes": "extremes", "reactions": "reactions", "design": "fluctuation", "spring": "motorisation"}


@pytest.mark.parametrize("asked", ["latches", "sprung", "latch", "after", "multipliers"])
@pytest.mark.parametrize("name", GIVES)
def test_every_deployment_has_the_figures_that_are_asked_for(asked: str, name: str, tmp_path: Path) -> None:
    family = "margin" if name == "spring" else "output"
    path = write(scene({"asked": asked, family: name, "loop": "revolute"}), tmp_path / "scene", "deploy")
    outcome = call(["deploy", str(path), "--no-plots", "--out", str(tmp_path / "out")], tmp_path)
    assert not outcome.finding and outcome.code in (0, 1), outcome.message
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary[GIVES[name]]
    if name == "reactions":
        assert all(x is not None for load in summary["reactions"]["largest"].values() for x in load.values())
