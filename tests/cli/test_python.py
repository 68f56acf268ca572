"""Each command as a function of Python: its words, its answers, and what it refuses."""

from __future__ import annotations

import copy
import importlib.util
import inspect
import pickle
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer.main

import robodyn
import robodyn_cli
from robodyn_cli.cli.app import app
from robodyn_cli.cli.keywords import OF_TERMINALS, keywords
from robodyn_cli.commands import COMMANDS, python_name
from robodyn_cli.errors import RobodynError, SceneError
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import jsonable
from tests import user_script
from tests.cli.tool import CONFIGS, PENDULUM, ROOT, environment, invoke

GROUP: Any = typer.main.get_command(app)
CIRCLE = CONFIGS / "2r_circle.yaml"
FEW = {"inverse.samples": 21}


def words_of(command: str) -> dict[str, Any]:
    """Return what the parser of a command line takes, by the names of Python: its arguments and longest options."""
    found = {}
    for one in GROUP.get_command(None, command).params:
        longest = max(one.opts, key=len).lstrip("-")
        found[one.name if one.param_type_name == "argument" else python_name(longest)] = one
    return found


@pytest.mark.parametrize("command", COMMANDS)
def test_a_function_has_the_words_of_its_command_line(command: str) -> None:
    known = {one.name: one for one in keywords(command)}
    words = {name: one for name, one in words_of(command).items() if name not in OF_TERMINALS}
    assert known.keys() == words.keys()
    for name, one in known.items():
        assert one.is_argument == (words[name].param_type_name == "argument"), name
        assert one.is_required == words[name].required, name
        default = None if callable(words[name].default) else words[name].default
        assert one.is_required or (one.default or None) == (default or None), name
    function = getattr(robodyn, python_name(command))
    assert {*inspect.signature(function).parameters} >= {*known, "progress"}
    assert all(f"\n{name} : " in function.__doc__ for name in known)


def test_the_stub_is_that_of_the_commands() -> None:
    path = ROOT / "docs" / "make_python_stub.py"
    spec = importlib.util.spec_from_file_location("make_python_stub", path)
    assert spec is not None and spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    text = made.STUB.read_text(encoding="utf-8")
    assert text == made.stub(), "run python docs/make_python_stub.py"
    for name in set(robodyn.__all__) - {"__version__"}:
        assert f"def {name}(" in text or f" as {name}\n" in text or f"\n{name} = " in text, name
        assert getattr(robodyn, name) is getattr(robodyn, name)
    assert set(robodyn.__all__) <= set(dir(robodyn))


def test_a_script_of_a_user(capsys: pytest.CaptureFixture[str]) -> None:
    result, report = user_script.main()
    assert result.status == "ok" and report.ok


# -- answers -----------------------------------------------------------------------------------------------------
def without_times(summary: Any) -> Any:
    """Return a summary without what differs from run to run."""
    left_out = ("wall_time_s", "seconds", "run_id", "outputs", "scene_file")
    if isinstance(summary, dict):
        return {key: without_times(x) for key, x in summary.items() if key not in left_out}
    return [without_times(x) for x in summary] if isinstance(summary, list) else summary


ANSWERS: dict[str, tuple[list[str], Callable[[Path], Any]]] = {
    "inverse": (
        ["inverse", str(CIRCLE), "--set", "inverse.samples=21", "--no-plots"],
        lambda _: robodyn.inverse(CIRCLE, set=FEW),
    ),
    "simulate": (
        ["simulate", "SCENE", "--no-plots", "--no-error-estimate"],
        lambda scene: robodyn.simulate(scene, no_error_estimate=True),
    ),
    "statics": (
        ["statics", "SCENE", "--no-plots", "--set", "statics.find=balance"],
        lambda scene: robodyn.statics(str(scene), set={"statics": {"find": "balance"}}),
    ),
    "linearise": (
        ["linearise", "SCENE", "--no-plots", "--at", "j1=-90 deg, j2=0", "--input", "j1"],
        lambda scene: robodyn.linearise(scene, at={"j1": "-90 deg", "j2": 0}, input=["j1"]),
    ),
    "plan": (["plan", str(CIRCLE)], lambda _: robodyn.plan(CIRCLE)),
    "info": (
        ["info", "SCENE", "--at", "q=[0.1, 0.2]", "--no-plots"],
        lambda scene: robodyn.info(scene, at={"q": np.array([0.1, 0.2])}),
    ),
    "validate": (["validate", "SCENE"], lambda scene: robodyn.validate([scene])),
    "sweep": (
        ["sweep", str(CIRCLE), "--vary", "robot.links.link1.mass=[10, 12]", "--of", "peak_torque.theta1",
         "--no-plots", "--set", "inverse.samples=21"],
        lambda _: robodyn.sweep(
            CIRCLE, vary={"robot.links.link1.mass": [10, 12]}, of="peak_torque.theta1", set=FEW
        ),
    ),
    "crosscheck": (
        ["crosscheck", "SCENE", "--with", "pinocchio", "--command", "simulate"],
        lambda scene: robodyn.crosscheck(scene, with_="pinocchio", command="simulate"),
    ),
    "schema": (["schema"], lambda _: robodyn.schema()),
}  # fmt: skip


@pytest.mark.parametrize("command", ANSWERS)
def test_a_function_answers_as_the_command_line(
    command: str, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words, call = ANSWERS[command]
    if command == "crosscheck":
        pytest.importorskip("pinocchio")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    found = call(scene)
    assert list((tmp_path / "here").iterdir()) == [], "what was not asked to be stored stays in memory"
    words = [str(scene) if word == "SCENE" else word for word in words]
    told = invoke(*words, *(["--json"] if command != "schema" else []))
    assert told.code == 0, told.err
    assert without_times(jsonable(found.summary)) == without_times(told.data)


def test_reports_are_maps_with_attributes_and_words(scene: Path) -> None:
    report = robodyn.validate([scene, "schema: 2\nextra: 1\n", {"schema": 1}])
    assert not report.ok and report.exit_code == 2
    assert report["scenes"][1]["scene"] == "<text>" and report.scenes[2].scene == "<dict>"
    assert str(report).splitlines()[0] == f"{scene}: ok" and "unknown key 'extra'" in str(report)
    with pytest.raises(AttributeError, match=r"no fact 'scene' \(did you mean 'scenes'\?\)"):
        _ = report.scene
    same = pickle.loads(pickle.dumps(report))
    assert same.summary == report.summary and str(same) == str(report)
    other = copy.deepcopy(report)
    other.summary["scenes"].clear()
    assert report.scenes and dict(report) == report.summary and "<pre>" in report._repr_html_()


def test_a_result_has_what_goes_on_from_it(scene: Path, tmp_path: Path) -> None:
    result = robodyn.simulate(scene, set={"simulate.duration": 0.2}, out=tmp_path / "run", no_plots=True)
    stored = robodyn.read_result(tmp_path / "run")
    assert result.compare(stored).ok and robodyn.compare(tmp_path / "run", result).ok
    other = robodyn.simulate(scene, set={"simulate.duration": 0.2, "gravity": [0, -9, 0]})
    assert result.compare(other).exit_code == 1
    assert Path(result.export("csv", tmp_path / "csv").files[0]).name == "samples.csv"
    movie = result.animate(speed=0.2, fps=5)
    assert movie.content is not None and movie.content.startswith(b"GIF8") and "<img" in movie._repr_html_()
    page = other.report(no_plan=True)
    assert page.content is not None and b"<!doctype html>" in page.content and "<iframe" in page._repr_html_()
    assert page.save(tmp_path / "page.html").read_bytes() == page.content and "file" not in page
    drawn = robodyn.plot([result, other], out=tmp_path / "plots", plots=["joint_angles"])
    assert [Path(x).name for x in drawn.files] == ["joint_angles.png"]
    again = pickle.loads(pickle.dumps(result))
    assert (again["q"] == result["q"]).all() and again.summary == result.summary
    with pytest.raises(SceneError, match="there are no criteria"):
        result.check()
    assert robodyn.check(result, {**user_scene(), "expect": {"final.q.j1": "> -9"}}).criteria[0].holds


def user_scene() -> dict[str, Any]:
    """Return the scene of this file as a map."""
    import yaml

    scene: dict[str, Any] = yaml.safe_load(PENDULUM)
    return scene


def test_results_below_a_directory(scene: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        robodyn.statics(scene, set={"statics.find": "balance"}, out=tmp_path / "all" / name, no_plots=True)
    found = robodyn.read_results(tmp_path / "all")
    assert list(found) == ["one", "two"] and all(x.status == "ok" for x in found.values())
    with pytest.raises(RobodynError, match="one the first"):
        robodyn.read_result(tmp_path / "all")
    assert robodyn_cli.read_result(str(tmp_path / "all" / "one" / "result.h5")).command == "statics"


def test_a_run_that_fails_half_way_brings_its_result(scene: Path) -> None:
    with pytest.raises(RobodynError) as failed:
        robodyn.simulate(scene, set={"torques": {"j1": "1/(t - 0.5)"}, "simulate.error_estimate": False})
    assert isinstance(failed.value.result, Result) and failed.value.exit_code == 3


# -- scenes and overrides ----------------------------------------------------------------------------------------
def test_scenes_and_overrides_of_every_kind_are_the_same(scene: Path) -> None:
    loaded = robodyn.load_scene(scene)
    for source in (PENDULUM, user_scene(), loaded):
        assert robodyn.load_scene(source) == loaded
    for overrides in (
        {"robot.links.l1.mass": np.float64(3.0), "simulate.samples": 5},
        {"robot": {"links": {"l1": {"mass": 3}}}, "simulate": {"samples": 5}},
        ["robot.links.l1.mass=3", "simulate.samples=5"],
    ):
        for source in (scene, PENDULUM, user_scene(), loaded):
            found = robodyn.load_scene(source, overrides)
            assert found.robot.links[0].mass == 3.0 and found.simulate.samples == 5
    assert robodyn.load_scene(scene, "title=a").title == "a"
    assert (
        robodyn.load_scene(scene, {"title": "a: [b]\n# no comment", "robot.points": {}}).title
        == "a: [b]\n# no comment"
    )


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda s: robodyn.simulate(), "scene is missing"),
        (lambda s: robodyn.simulate(s, 1), "2 arguments by place; allowed: scene, and options by name"),
        (lambda s: robodyn.simulate(s, scene=s), "scene is given twice"),
        (lambda s: robodyn.simulate(s, sett=1), r"unknown keyword 'sett' \(did you mean 'set'\?\)"),
        (lambda s: robodyn.simulate(s, json=True), "json is an option of terminals"),
        (lambda s: robodyn.simulate(s, strict="yes"), "strict: 'yes'; allowed: True or False"),
        (lambda s: robodyn.simulate(s, plots=["no_such"]), "plots: no plot 'no_such'"),
        (lambda s: robodyn.simulate(s, out=3), "out: 3; allowed: a path"),
        (lambda s: robodyn.simulate(s, set=3), "set: overrides 3: allowed"),
        (lambda s: robodyn.simulate(s, set={"a": object()}), "set: a: .* of type object is no data"),
        (lambda s: robodyn.simulate(s, set={"robot.links.l9.mass": 1}), "has no item named 'l9'"),
        (lambda s: robodyn.simulate("no such file.yaml"), "there is no such file"),
        (lambda s: robodyn.simulate(3), "3 of type int is no scene"),
        (lambda s: robodyn.simulate({"schema": 1, "robot": {1: 2}}), "robot: key 1 is no text"),
        (lambda s: robodyn.sweep(s, n=2.5), "n: '2.5'; allowed: a whole number >= 1"),
        (lambda s: robodyn.sweep(s, of={"a": 1}), "of: .* is a map"),
        (lambda s: robodyn.sweep(s, yield_=2), "yield_: '2'; allowed: a number from 0 to 1"),
        (lambda s: robodyn.size(s, margin=2), "margin: '2'; allowed: a number from 0 to 0.99"),
        (lambda s: robodyn.crosscheck(s), "with_ is missing"),
        (lambda s: robodyn.compare(s, 3), "baseline: 3; allowed: a path or a result"),
        (lambda s: robodyn.run([user_scene()]), "a scene in memory"),
        (lambda s: robodyn.inverse(robodyn.read_result), "is no scene"),
        (lambda s: robodyn.animate("nowhere", fps=0), "fps: '0'; allowed"),
        (lambda s: robodyn.animate("nowhere"), "nowhere"),
        (lambda s: robodyn.simulate(s, out=s), "a part of it, is a file"),
        (lambda s: robodyn.plot([]), r"results: nothing is given; allowed: RESULT"),
        (
            lambda s: robodyn.report("nowhere", file="page.txt"),
            r"file: 'page.txt'; allowed: a name that ends with .html",
        ),
    ],
)
def test_what_is_not_allowed(call: Callable[[Path], Any], message: str, scene: Path) -> None:
    with pytest.raises(RobodynError, match=message):
        call(scene)


def test_arrays_are_a_motion() -> None:
    t = np.linspace(0.0, 1.0, 11)
    q, qd = np.column_stack([np.sin(t), np.cos(t)]), np.column_stack([np.cos(t), -np.sin(t)])
    without = {"expect": {}, **FEW}
    text = "trajectory={type: joint, duration: 1, q: {theta1: sin(t), theta2: cos(t)}}"
    right = robodyn.inverse(CIRCLE, set=[text, "expect={}", "inverse.samples=21"])["tau"]
    for arrays, error in (((t, q), 2e-2), ((t, q, qd), 0.3), ((t, q, qd, -q), 1e-4)):
        found = robodyn.inverse(CIRCLE, set={"trajectory": arrays, **without})
        assert np.abs(found["tau"] - right).max() < error
        assert "rows, interpolation" in found.summary["notes"][0]
    scene = {**user_scene(), "trajectory": (t, q)}
    assert (robodyn.load_scene(scene).trajectory.columns) == ("t", "j1", "j2")
    for wrong in ((t, q[1:]), (t,), (t, q, qd, q, q), (t, "x")):
        with pytest.raises(SceneError, match=r"trajectory: is no motion: .*allowed: \(t, q\)"):
            robodyn.load_scene(CIRCLE, {"trajectory": wrong})


def test_a_scene_that_was_changed_is_run_but_has_no_text_to_override(scene: Path) -> None:
    import dataclasses

    loaded = robodyn.load_scene(scene)
    changed = dataclasses.replace(loaded, gravity=(0.0, 0.0, 0.0))
    assert robodyn.simulate(changed)["q"][-1] == pytest.approx(np.array([-1.0, 0.3]))
    for call in (lambda: robodyn.simulate(changed, set={"title": "x"}), lambda: robodyn.sweep(changed)):
        with pytest.raises(SceneError, match="was changed in Python"):
            call()


def test_a_function_as_controller_takes_overrides_too(scene: Path) -> None:
    result = robodyn.simulate(
        scene, controller=lambda t, q, v: (1.0, 0.0), period=0.1,
        set={"simulate.duration": 0.3, "simulate.error_estimate": False},
    )  # fmt: skip
    assert result.summary["control"]["period"] == 0.1 and result["tau"][1:-1, 0] == pytest.approx(1.0)
    assert robodyn.load_scene(result.scene_text).control is not None


def test_a_function_takes_the_place_of_a_controller_that_is_taken_out(scene: Path) -> None:
    """``set`` holds before the function, and where there is no controller to take out, too."""
    own = {"simulate.duration": 0.3, "simulate.error_estimate": False}
    law = {"type": "pd", "gains": {"kp": 9, "kd": 1}}
    led = robodyn.load_scene(scene, {"control": law})
    calls = {"controller": lambda t, q, v: (1.0, 0.0), "period": 0.1}
    for start in (led, scene):
        result = robodyn.simulate(start, set={**own, "control": None}, **calls)
        assert result["tau"][1:-1, 0] == pytest.approx(1.0) and result["time"][-1] == 0.3
        assert result.summary["control"]["period"] == 0.1
    with pytest.raises(SceneError, match="controller of type 'pd'"):
        robodyn.simulate(led, set=own, **calls)


def test_warnings_are_those_of_python(scene: Path) -> None:
    light = {"robot.links.l1.inertia.zz": 1e-9, "simulate.duration": 0.01}
    with pytest.warns(robodyn.RobodynWarning, match="l1"):
        robodyn.simulate(
            scene,
            set={**light, "robot.links.l1.inertia": {"xx": 1, "yy": 1, "zz": 3, "xy": 0, "xz": 0, "yz": 0}},
        )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robodyn.simulate(scene, set={"simulate.duration": 0.01})


# -- where it runs -----------------------------------------------------------------------------------------------
def test_an_import_loads_nothing_heavy() -> None:
    code = "import sys, robodyn; print(*(x for x in ('numpy', 'typer', 'scipy', 'matplotlib', 'h5py') if x in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.strip() == ""


def test_a_script_without_a_guard_is_run_once(tmp_path: Path, scene: Path) -> None:
    """Processes of a study do not run the script again, and an own backend of matplotlib stays."""
    script = tmp_path / "script.py"
    script.write_text(
        "import matplotlib, robodyn\n"
        "matplotlib.use('svg')\n"
        "print('once')\n"
        f"study = robodyn.sweep({str(scene)!r}, vary={{'robot.links.l1.mass': 'linspace(1, 2, 16)'}}, of='freedoms', jobs=2,\n"
        "                      set={'command': 'linearise'})\n"
        "print(*study['outputs/freedoms'])\n"
        f"robodyn.simulate({str(scene)!r}, set={{'simulate.duration': 0.1}})._repr_html_()\n"
        "print(matplotlib.get_backend())\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, env=environment(PYTHONPATH=str(ROOT))
    )
    assert done.stdout.split() == ["once", *["2.0"] * 16, "svg"], done.stderr


def test_threads_get_the_answers_of_one(scene: Path) -> None:
    alone = robodyn.simulate(scene)["q"]
    found: list[Any] = []
    threads = [threading.Thread(target=lambda: found.append(robodyn.simulate(scene)["q"])) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 2 and all((q == alone).all() for q in found)
