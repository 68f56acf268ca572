"""Units of FMI 3.0: what they say of themselves, and motions driven by an importer in C, beside those of the program."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import Mechanism, simulate
from robodyn_cli.cli.app import run
from robodyn_cli.scene.load import Family
from tests.exported_c import needs_compiler
from tests.fmu import SANITIZED, ExportedUnit, column
from tests.mechanisms import CONFIGS

PENDULUM = "double_pendulum.yaml"
AXES = ("x", "y", "z")


def family_of(scene: str, overrides: Sequence[str] = ()) -> Family:
    return Family(CONFIGS / scene, list(overrides))


@needs_compiler
def test_a_unit_gives_what_simulate_gives_for_any_step(tmp_path: Path) -> None:
    """Within both stated errors, with other values of keys; under sanitizers where the compiler has them."""
    overrides = ["simulate.duration=3", "outputs.signals={both: theta1 + theta2}", "outputs.reactions=true"]
    family = family_of(PENDULUM, overrides)
    keys = ["robot.links.link1.mass=5:25", "initial.q.theta2=-2:2"]
    try:
        unit = ExportedUnit(family, tmp_path, keys, flags=SANITIZED)
    except AssertionError:  # the compiler has no sanitizers
        unit = ExportedUnit(family, tmp_path, keys)
    assert [unit.kinds[x] for x in ("robot.links.link1.mass", "initial.q.theta2")] == [
        "parameter",
        "parameter",
    ]
    mechanism = Mechanism(family, vary=[x.partition("=")[0] for x in keys])
    runs = mechanism.simulate_many(np.array([[14.0, 0.4]]))
    names = mechanism.q_names
    ends = []
    for count in (2, 30, 1999):
        reached, values, _ = unit.run(
            3.0 / count, count, ["robot.links.link1.mass=14", "initial.q.theta2=0.4"]
        )
        assert reached == pytest.approx(3.0, rel=1e-12)
        for prefix, there, error in (("q", runs.q[0], runs.q_error[0]), ("qd", runs.qd[0], runs.qd_error[0])):
            own = column(values, names, prefix)
            allowed = column(values, names, f"error.{prefix}") + error + 1e-12 * np.abs(there).max()
            assert (np.abs(own - there) <= allowed).all()
            assert (column(values, names, f"error.{prefix}") < 1e-7).all()
        assert values["signals.both"] == pytest.approx(values["q.theta1"] + values["q.theta2"], rel=1e-14)
        ends.append([*column(values, names, "q"), *column(values, names, "qd")])
    np.testing.assert_allclose(ends[1:], [ends[0]] * 2, rtol=0, atol=1e-12)
    # accelerations, energies, points and reactions are those that the program stores
    values_set = ["robot.links.link1.mass=14", "initial.q.theta2=0.4"]
    stored = simulate(family_of(PENDULUM, [*overrides, *values_set]).own).variables
    compared = 0
    for path in ("qdd", "points/tip", "reactions/theta1", "reactions/theta2", "base_wrench"):
        parts = AXES if path.startswith("points") else stored[path].names
        own = column(values, parts, path.replace("/", "."))
        np.testing.assert_allclose(own, stored[path].data[-1], rtol=0, atol=1e-7, err_msg=path)
        compared += len(parts)
    assert compared >= 13
    assert values["energy.kinetic"] == pytest.approx(stored["energy/kinetic"].data[-1], rel=1e-9)


@needs_compiler
@pytest.mark.parametrize("control", [
    "{type: computed_torque, gains: {kp: 400, kd: 40}, period: 0.004, delay: 0.007, limit: {theta1: 300, theta2: 90}, "
    "model: {set: {robot.links.link2.mass: 11.856}}}",
    "{type: pid, gains: {kp: 900, kd: 60, ki: 90}}",
])  # fmt: skip
def test_a_controlled_motion_is_that_of_simulate_for_any_step(control: str, tmp_path: Path) -> None:
    """Sampled and continuous, following a motion that ends before the run does; under sanitizers."""
    motion = "{type: cubic, points: [{t: 0, q: {theta1: -90 deg, theta2: 0}}, {t: 0.3, q: {theta1: -80 deg, theta2: 0.2}}]}"
    overrides = [f"control={control}", f"trajectory={motion}", "simulate={duration: 0.5, samples: 51}"]
    family = family_of("controlled_arm.yaml", ["expect={}", *overrides])
    try:
        unit = ExportedUnit(family, tmp_path, ["robot.links.link1.mass=5:25"], flags=SANITIZED)
    except AssertionError:  # the compiler has no sanitizers
        unit = ExportedUnit(family, tmp_path, ["robot.links.link1.mass=5:25"])
    mass = "robot.links.link1.mass=14"
    result = simulate(family_of("controlled_arm.yaml", ["expect={}", *overrides, mass]).own)
    names, stored = ["theta1", "theta2"], result.variables
    stated = result.summary["error_estimate"]["state_max"]
    for count in (1, 7, 500):
        _, values, _ = unit.run(0.5 / count, count, [mass])
        for group, path in (("q", "q"), ("qd", "qd")):
            allowed = column(values, names, f"error.{group}") + stated + 1e-12
            apart = np.abs(column(values, names, group) - stored[path].data[-1])
            assert (apart <= allowed).all() and (allowed < 1e-8).all()
        for group in ("reference", "error", "torque"):
            own = column(values, names, f"control.{group}")
            np.testing.assert_allclose(own, stored[f"control/{group}"].data[-1], rtol=1e-8, atol=1e-8)
    with pytest.raises(RuntimeError, match="what the motion follows is known up to its duration"):
        unit.run(0.2, 3)


@needs_compiler
def test_set_points_are_what_the_controller_follows(tmp_path: Path) -> None:
    """A joint that goes on with a rate and one that jumps at half time: as a reference of formulas, sampled or not."""
    start, jump = -1.5, "@setpoint.theta2=0.2"
    for k, more in enumerate((", period: 0.005, delay: 0.002", "")):
        law = f"control={{type: pid, gains: {{kp: 900, kd: 60, ki: 90}}{more}}}"
        overrides = ["expect={}", "trajectory=null", law, "simulate={duration: 0.5, samples: 51}"]
        family = family_of(
            "controlled_arm.yaml", [*overrides, f"initial.q.theta1={start}", "initial.q.theta2=0"]
        )
        (tmp_path / str(k)).mkdir()
        unit = ExportedUnit(family, tmp_path / str(k), ["robot.links.link1.mass"], ["control.reference"])
        inputs = [name for name, kind in unit.kinds.items() if kind == "input"]
        assert inputs == [
            "setpoint.theta1",
            "setpoint_rate.theta1",
            "setpoint.theta2",
            "setpoint_rate.theta2",
        ]
        units = {v.attrib["name"]: v.attrib.get("unit") for v in unit.root.find("ModelVariables") or ()}
        assert [units[name] for name in inputs[:2]] == ["rad", "rad/s"]
        for count, rate in ((2, 0.4), (50, 0.0)):  # where rates are set, places are at communication points
            led = f'{{theta1: "{start} + {rate}*t", theta2: "if(t<0.25,0,0.2)"}}'
            known = simulate(
                family.with_values([f"control.reference={{type: joint, duration: 1, q: {led}}}"]).own
            )
            given = [f"setpoint_rate.theta1={rate}", jump, f"@setpoint.theta1={start + rate * 0.25}"]
            _, values, _ = unit.run(0.5 / count, count, given)
            for group in ("q", "qd"):
                own, error = (column(values, ["theta1", "theta2"], f"{x}{group}") for x in ("", "error."))
                there = known.variables[group].data[-1]
                allowed = error + known.summary["error_estimate"]["state_max"] + 1e-12
                assert (np.abs(own - there) <= allowed).all() and (allowed < 1e-8).all()
            assert values["control.reference.theta1"] == pytest.approx(start + 0.5 * rate, rel=1e-14)
        unit.run(0.25, 9)  # what is set has no end


@needs_compiler
def test_a_lock_ends_the_simulation_at_its_time(tmp_path: Path) -> None:
    unit = ExportedUnit(family_of("four_bar_deploy.yaml"), tmp_path, ["robot.links.crank.mass=10:40"])
    runs = Mechanism(family_of("four_bar_deploy.yaml"), vary=["robot.links.crank.mass"]).deploy_many(
        np.array([[25.0]])
    )
    for step in (3.0, 0.1):
        reached, values, _ = unit.run(step, 1000, ["robot.links.crank.mass=25"])
        assert abs(reached - runs.time[0]) <= values["error.time"] + runs.time_error[0] + 1e-12
        assert 0.0 < values["error.time"] < 1e-10
        names = unit.outputs
        assert "constraints.pin.x" in names and "points.pin_coupler.x" in names
        np.testing.assert_allclose(column(values, ["theta1", "phi2", "phi1"], "q"), runs.q[0], atol=1e-9)
        # both ends of the pin are at one place: the loop is closed
        ends = [[values[f"points.pin_{link}.{axis}"] for axis in "xy"] for link in ("coupler", "follower")]
        np.testing.assert_allclose(*ends, atol=1e-9)


@needs_compiler
def test_inputs_keep_to_what_the_scene_allows(tmp_path: Path) -> None:
    unit = ExportedUnit(family_of(PENDULUM), tmp_path, [], ["robot.links.link1.mass"])
    with pytest.raises(RuntimeError, match="link1.mass: a value is outside its range"):
        unit.run(0.1, 4, ["@robot.links.link1.mass=-1"])


def test_inputs_change_between_steps(tmp_path: Path) -> None:
    """A torque of zero that other tools set at 1 s: the motion of a torque that depends on time."""
    family = family_of(PENDULUM, ["torques.theta1=0.0", "simulate.duration=2"])
    unit = ExportedUnit(family, tmp_path, ["robot.links.link1.mass"], ["torques.theta1=-9:9"])
    assert unit.kinds["torques.theta1"] == "input"
    known = family_of(PENDULUM, ["torques.theta1='if(t<1,0,-3)'", "simulate.duration=2"])
    mechanism = Mechanism(known, vary=["robot.links.link1.mass"])
    runs = mechanism.simulate_many({"robot.links.link1.mass": [12.456]})
    for count in (10, 400):
        _, values, _ = unit.run(2.0 / count, count, ["@torques.theta1=-3"])
        own = np.array([*column(values, mechanism.q_names, "q"), *column(values, mechanism.q_names, "qd")])
        error = [
            *column(values, mechanism.q_names, "error.q"),
            *column(values, mechanism.q_names, "error.qd"),
        ]
        stated = np.array(error) + [*runs.q_error[0], *runs.qd_error[0]] + 1e-12
        assert (np.abs(own - [*runs.q[0], *runs.qd[0]]) <= stated).all()
        assert max(error) < 1e-7 and values["tau.theta1"] == -3.0


@needs_compiler
def test_fmpy_finds_nothing_wrong_and_runs_it(tmp_path: Path) -> None:
    fmpy = pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    unit = ExportedUnit(family_of("tumbling_body.yaml"), tmp_path)
    assert validate_fmu(str(unit.path)) == []
    result = fmpy.simulate_fmu(str(unit.path), output_interval=3.0, stop_time=12.0)
    runs = Mechanism(family_of("tumbling_body.yaml")).simulate_many(np.zeros((1, 0)))
    for k, name in enumerate(Mechanism(family_of("tumbling_body.yaml")).qd_names):
        allowed = result[f"error.qd.{name}"][-1] + runs.qd_error[0, k] + 1e-12 * np.abs(runs.qd[0]).max()
        assert abs(result[f"qd.{name}"][-1] - runs.qd[0, k]) <= allowed


@needs_compiler
def test_values_out_of_range_and_parameters_on_the_way_are_refused(tmp_path: Path) -> None:
    unit = ExportedUnit(family_of(PENDULUM), tmp_path, ["robot.links.link1.mass=5:25"])
    with pytest.raises(RuntimeError, match="link1.mass: a value is outside its range"):
        unit.run(0.1, 4, ["robot.links.link1.mass=30"])
    with pytest.raises(RuntimeError, match="link1.mass: parameters stay as they are"):
        unit.run(0.1, 4, ["@robot.links.link1.mass=20"])


REFUSED: dict[tuple[str, ...], str] = {
    ("bouncing_pendulum.yaml",): "contact states begin and change in Python",
    (
        "controlled_arm.yaml",
        "--set",
        "control.sensors.noise=1e-4",
    ): "leave as a unit of FMI: sensors are noisy",
    ("four_bar_prescribed.yaml",): "a motion is prescribed",
    ("mechanisms/four_bar_locked.yaml",): "goes on as the locked structure",
    (PENDULUM, "--key", "robot.joints.theta1.alpha=-1:1"): "alpha",
    (PENDULUM, "--input", "initial.q.theta1"): "allowed: numbers of the equations",
    (
        PENDULUM,
        "--input",
        "control.reference",
    ): "control.reference: no controller; allowed: a controller that follows",
    ("cart_pole_lqr.yaml", "--input", "control.reference"): "control.reference: control.type lqr; allowed",
    (
        "controlled_arm.yaml",
        "--input",
        "control.reference=0:1",
    ): "control.reference: a range; allowed: no range",
    (PENDULUM, "--input", "gravity.1=1:2"): "--input gravity.1: the scene's own value",
    (PENDULUM, "--input", "gravity.1=2:1"): "--input gravity.1=2:1: allowed",
    (PENDULUM, "--input", "robot.links.link1.mass=-1:20"): "--input robot.links.link1.mass: is too small",
    (PENDULUM, "--key", "robot.links.link1.mass=-1:20"): "--key robot.links.link1.mass: is too small",
    (PENDULUM, "--input", "simulate.duration"): "simulate.duration",
}


@pytest.mark.parametrize("given", REFUSED)
def test_what_cannot_leave_is_refused_by_name(given: Sequence[str], tmp_path: Path, capsys: Any) -> None:
    scene, *options = given
    out = tmp_path / "own.fmu"
    assert run(["export", str(CONFIGS / scene), "--fmu", str(out), *options]) == 2
    assert REFUSED[tuple(given)] in capsys.readouterr().err and not out.exists()


def test_the_command_writes_sources_where_there_is_no_compiler(
    tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    import shutil

    monkeypatch.setattr(shutil, "which", lambda name: None)
    out = tmp_path / "two_links.fmu"
    assert run(["export", str(CONFIGS / PENDULUM), "--fmu", str(out), "--key", "robot.links.link1.mass"]) == 0
    assert "sources alone" in capsys.readouterr().err
    with zipfile.ZipFile(out) as unit:
        names = set(unit.namelist())
        assert 'modelIdentifier="two_links"' in unit.read("modelDescription.xml").decode()
    assert {
        "modelDescription.xml",
        "sources/buildDescription.xml",
        "sources/fmu.c",
        "sources/two_links_loop.c",
    } <= names
    assert not any(name.startswith("binaries/") for name in names)


def test_options_that_do_not_go_together(tmp_path: Path, capsys: Any) -> None:
    scene = str(CONFIGS / PENDULUM)
    for options in (
        ["--fmu", "a.fmu", "--c", "b"],
        ["--input", "torques.theta1", "--c", "b"],
        ["--fmu", "a.fmu", "--loop"],
    ):
        assert run(["export", scene, *options]) == 2
        assert (
            "allowed: either --to KIND with --out DIR, or --c DIR, or --fmu FILE" in capsys.readouterr().err
        )
    assert run(["export", scene, "--fmu", str(tmp_path / "a.zip")]) == 2
    assert "a file that ends with .fmu" in capsys.readouterr().err
