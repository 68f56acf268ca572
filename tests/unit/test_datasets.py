"""Every dataset that a command writes says what it is: its unit, of each column where they differ, and its meaning."""

from __future__ import annotations

from pathlib import Path

import pytest

from robodyn_cli.commands import COMMANDS, STUDIED
from robodyn_cli.over.commands import execute
from robodyn_cli.over.sensitivity.report import sensitivity
from robodyn_cli.over.stability.stability import stability
from robodyn_cli.results import catalogue
from robodyn_cli.results.result import Result
from robodyn_cli.results.stated_errors import BESIDE, STATEMENTS, error_places, meaningful_error, stated_error
from robodyn_cli.scene.load import Family, load_scene
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.tools.progress import Stopwatch, no_progress
from robodyn_cli.works.assemble import assemble
from robodyn_cli.works.info import info
from robodyn_cli.works.linearise.linearise import linearise
from robodyn_cli.works.statics import statics

CONFIGS = Path(__file__).parents[2] / "configs"
FEW = ["inverse.samples=11", "simulate.samples=11", "simulate.error_estimate=false"]
EXAMPLES = [
    path
    for path in sorted(CONFIGS.rglob("*.yaml"))
    if path.parent.name != "benchmarks" and any(f"command: {name}\n" in path.read_text() for name in STUDIED)
]
MIXED = (" or ", ", ")  # between the units of columns


def check(result: Result) -> None:
    """Hold every dataset to the catalogue."""
    assert result.variables
    for path, variable in result.variables.items():
        entry = catalogue.lookup(path)
        assert entry is not None, path
        assert variable.units and variable.long_name and "SI" not in variable.units, path
        if variable.column_units:
            assert len(variable.column_units) == variable.data.shape[-1], path
            assert all(unit and not unit.startswith("that of") for unit in variable.column_units), path
        elif variable.names and variable.data.ndim > 1:
            assert not any(sign in variable.units for sign in MIXED), f"{path}: {variable.units}"


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_datasets_of_example_scenes(path: Path) -> None:
    scene = load_scene(path, [*FEW, "expect=null"])
    try:
        found = execute(scene.command, scene, no_progress, Stopwatch())
    except Exception as error:  # runs of examples that show a failure have a result up to it
        found = getattr(error, "result", None)
        assert isinstance(found, Result), error
    check(found)


def test_datasets_of_other_commands() -> None:
    chain, loops = CONFIGS / "double_pendulum.yaml", CONFIGS / "four_bar_deploy.yaml"
    check(info(loops))
    check(assemble(load_scene(loops, ["assemble.branches=true"])))
    check(linearise(load_scene(loops)))
    check(linearise(load_scene(chain, FEW), about="motion"))
    family = Family(CONFIGS / "2r_circle.yaml", [*FEW, "expect=null"])
    check(sensitivity(family, ["robot.links.link1.mass", "gravity#2"], ["peak_torque.theta1"]))
    short = load_scene(chain, ["simulate.duration=0.5"])
    check(stability(short, progress=no_progress, watch=Stopwatch(), quick=True))


def test_rows_of_couplers_have_the_units_of_their_joints() -> None:
    """A coupler of angles holds them by a moment, and is off by an angle; a loop is off by a length."""
    scene = load_scene(
        CONFIGS / "double_pendulum.yaml",
        [*FEW, "simulate.duration=0.1", "couplers=[{name: belt, terms: {theta1: 1, theta2: 2}}]", "initial.q.theta2=null",
         "initial.qd.theta2=null", "expect=null"],
    )  # fmt: skip
    found = execute("simulate", scene, no_progress, Stopwatch()).variables
    units = {
        name: found[f"constraints/{name}"].units
        for name in ("multipliers", "position_residual", "velocity_residual")
    }
    assert units == {"multipliers": "N m", "position_residual": "rad", "velocity_residual": "rad/s"}


def test_errors_of_datasets_are_those_of_datasets_that_exist() -> None:
    """What states the error of a dataset is known to the catalogue, and so is each dataset that has one."""
    paths = [entry.path for entry in catalogue.ENTRIES]
    for statement in STATEMENTS:
        for about in (*statement.about, *([statement.bounds] if statement.bounds else [])):
            assert any(path == about or path.startswith(f"{about}/") for path in paths), about
    for group in (*BESIDE, *BESIDE.values()):
        assert any(path == group or path.startswith(f"{group}/") for path in paths), group
    for path in catalogue.ENTRIES:
        for place in error_places(path.path):
            known = any(leaf_of(name, place) for name, row in COMMANDS.items() if row.summary)
            assert known or place.removeprefix("/") in paths, place
    assert error_places("outputs/KEY") == ["/errors/KEY"] and "error_estimate.q_max" in error_places("q")
    assert error_places("linear/poles_real") == ["/linear/poles_error"]


@pytest.mark.parametrize("find", ["balance", "hold"])
def test_datasets_of_one_sample_have_the_errors_of_their_columns(find: str) -> None:
    """Torques at rest have errors of their own, joint by joint, and not the force that is left."""
    found = statics(
        load_scene(CONFIGS / "parallelogram.yaml", [f"statics.find={find}", "gravity=[0, -9.81, 0]"])
    )
    closed = assemble(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    for result, paths in (
        (found, {"q": "configuration", "tau": "torques_of_joints", "constraints/multipliers": "multipliers"}),
        (closed, {"q": "configuration", "qd": "rates", "qdd": "accelerations"}),
    ):
        for path, key in paths.items():
            own = dict(zip(result.variables[path].names, stated_error(result, path).tolist()))
            assert own == result.summary["error_estimate"][key]
            assert any(own.values()) or path in ("qd", "qdd")
            assert meaningful_error(result, path) == max(own.values())
    assert "error_estimate.force_residual" not in error_places("tau")
