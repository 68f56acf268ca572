"""What stands side by side on a page of several results: rows that compare something, of what was run."""

from __future__ import annotations

from pathlib import Path

from robodyn_cli.report.figures import shown_units
from robodyn_cli.report.page.compared import compared, without_loners
from robodyn_cli.report.page.page import Shown, make_page
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.kinematics import kinematics
from tests.unit.synthetic_results import four_bar_result

CONFIGS = Path(__file__).parents[2] / "configs"


def arm(*overrides: str) -> Result:
    return inverse(load_scene(CONFIGS / "2r_circle.yaml", ["inverse.samples=101", *overrides]))


def test_the_command_is_the_one_that_was_run() -> None:
    """The scene names `inverse`; a run of another command, which may have failed, is of that one."""
    failed = kinematics(load_scene(CONFIGS / "2r_circle.yaml"))
    failed.status = "failed"
    by_name = {one.name: one for one in compared([arm(), failed])}
    assert by_name["command"].values == ["inverse", "kinematics"] and by_name["command"].mark == "differ"
    assert "command" not in {one.name for one in compared([arm(), arm()])}


def test_parts_of_another_robot_are_not_compared() -> None:
    """Links of two robots share names; their masses are of other things. What only one robot has is no row."""
    results = [
        arm(),
        arm("robot.links.link1.mass=14"),
        inverse(load_scene(CONFIGS / "benchmarks/puma560.yaml")),
    ]
    found = compared(results)
    given = {one.name: one.values for one in found if one.given}
    assert given["robot.joints"] == ["theta1, theta2", "theta1, theta2", "q1, q2, q3, q4, q5, q6"]
    assert [name for name in given if name.startswith("robot.links")] == ["robot.links.link1.mass"]
    assert given["gravity"] == ["[0, -9.81, 0]", "[0, -9.81, 0]", "[0, 0, -9.81]"]
    names = {one.name for one in found}
    shown = {one.name for one in without_loners(found, results)}
    assert names - shown and all(name.startswith(("joints.q", "points.")) for name in names - shown)
    assert {"joints.theta1.peak_torque", "joints.theta2.peak_torque"} <= shown
    # of one robot a blank tells that a run has no such figure
    same = compared(results[:2])
    assert without_loners(same, results[:2]) == same
    page = make_page([Shown(f"r{k}", result) for k, result in enumerate(results)])
    assert f"{len(names - shown)} figures that one result alone can have stand with it" in page


def test_a_number_has_one_unit_where_joints_and_rows_tell_it() -> None:
    """Multipliers of pins in a plane are forces, and joints that turn have no metres; of mixed ones both are told."""
    result = four_bar_result(60)
    result.add("qd", 0.0 * result["q"], units="rad/s", names=("theta1", "phi1", "phi2"))
    unit_of = shown_units(result)
    assert unit_of("tolerances.atol") == "rad, rad/s" and unit_of("locks.latch.speed") == "rad/s"
    assert unit_of("error_estimate.q_max") == "rad" and unit_of("lock.multipliers.at_lock") == "N"
    assert (
        unit_of("constraint_residual.position") == "m"
        and unit_of("constraint_residual.redundant") == "m or rad"
    )
    result.summary["overload"] = {"quantity": "moment", "limit": 3.0}
    assert unit_of("overload.limit") == "N m"
    loads, rates = result.variables["constraints/multipliers"], result.variables["qd"]
    loads.column_units, rates.column_units = ("N", "N m"), ("rad/s", "rad/s", "m/s")
    unit_of = shown_units(result)
    assert (
        unit_of("lock.multipliers.at_lock") == "N and N m" and unit_of("error_estimate.q_max") == "rad or m"
    )
    row = loads.names[1]
    assert unit_of(f"lock.latch.impulse.{row}") == "N m s"
