"""``robodyn run``: settings for all scenes, a time limit for each, reports that other programs read."""

from __future__ import annotations

import json
import re
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest

from robodyn_cli.commands import SCENE_COMMANDS
from robodyn_cli.over.batch import batch as batch_module
from robodyn_cli.over.batch.batch import Batch
from robodyn_cli.over.batch.entries import BatchEntry
from robodyn_cli.over.batch.reports import junit
from robodyn_cli.over.commands import execute, functions
from robodyn_cli.results.hdf5 import read
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.summaries.checks import JudgedCriterion
from robodyn_cli.tools.progress import Progress
from tests.cli.batch_scenes import arm, loaded, robodyn, run
from tests.cli.tool import PENDULUM
from tests.cli.tool import invoke as validated

PASSES = "expect: {status: ok, peak_torque.swing: < 100}"


# -- settings for all ------------------------------------------------------------------------------------
def test_settings_hold_for_all_scenes(tmp_path: Path) -> None:
    for name in "ab":
        arm(tmp_path / f"{name}.yaml", PASSES)
    out = tmp_path / "out"
    settings = ("--set", "inverse.samples=11", "--set", "title=a = b")
    code, scenes = run(tmp_path, "--out", out, *settings)
    assert code == 0
    for name in scenes:
        result = read(out / name / "inverse" / "result.h5")
        assert len(result.time) == 11 and result.title == "a = b"


def test_settings_are_part_of_what_is_finished(tmp_path: Path) -> None:
    path, out = arm(tmp_path / "a.yaml", PASSES), tmp_path / "out"

    def unchanged(*settings: str) -> bool:
        code, scenes = run(path, "--out", out, *settings)
        assert code == 0
        return bool(scenes["a"]["unchanged"])

    assert not unchanged("--set", "inverse.samples=11")
    assert unchanged("--set", "inverse.samples=11")
    assert not unchanged()
    assert not unchanged("--set", "inverse.samples=11")


def test_a_setting_that_does_not_fit_is_an_error_of_each_scene(tmp_path: Path) -> None:
    arm(tmp_path / "a.yaml", PASSES)
    arm(tmp_path / "b.yaml", PASSES.replace("100", "0"))
    code, scenes = run(tmp_path, "--out", tmp_path / "out", "--set", "inverse.sampels=5")
    assert code == 2
    assert all("did you mean 'samples'?" in scene["message"] for scene in scenes.values())
    code, scenes = run(tmp_path, "--out", tmp_path / "out", "--set", "expect.peak_torque.swing=< 50")
    assert code == 0, "criteria can be set too"


# -- a limit to the time ---------------------------------------------------------------------------------
def test_a_scene_over_its_time(tmp_path: Path) -> None:
    arm(tmp_path / "long.yaml", "expect: {exit_code: 3}", samples=30_000_000)
    xml = tmp_path / "junit.xml"
    start = time.monotonic()
    code, scenes = run(tmp_path, "--out", tmp_path / "out", "--timeout", "1.5", "--junit", xml)
    assert code == 3 and time.monotonic() - start < 15.0
    late = scenes["long"]
    assert late["verdict"] == "error" and "1.5 s" in late["message"] and "--timeout" in late["message"], (
        "not even a scene that is made to fail is made to be late"
    )
    left = {p.name for p in (tmp_path / "out" / "long").glob("inverse/*")} - {".lock"}
    assert not {name for name in left if not name.startswith(".")}
    assert ElementTree.parse(xml).getroot().get("errors") == "1"


def test_one_that_does_not_listen_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_module, "GRACE", 0.3)
    deaf = "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); time.sleep(60)"
    scenes = loaded([arm(tmp_path / "a.yaml", PASSES)], tmp_path / "out")
    start = time.monotonic()
    list(Batch(scenes, 1, lambda *_: [sys.executable, "-c", deaf], [], False, timeout=0.5).run())
    assert scenes[0].exit_code == 3 and time.monotonic() - start < 10.0


@pytest.mark.parametrize("limit", ["0", "-1", "nan", "inf", "soon"])
def test_what_is_no_time(limit: str, tmp_path: Path) -> None:
    done = robodyn("run", arm(tmp_path / "a.yaml"), f"--timeout={limit}")
    assert done.returncode == 2 and done.stderr.startswith("robodyn: error: ") and "--timeout" in done.stderr


# -- the worst exit code ---------------------------------------------------------------------------------
def test_the_worst_exit_code(tmp_path: Path) -> None:
    """One that fails is worse than none, 3 is worse than 1, 2 worse than 3."""
    arm(tmp_path / "good.yaml", PASSES)
    arm(tmp_path / "one.yaml", "expect: {peak_torque.swing: < 0.1}")
    (tmp_path / "three.yaml").write_text(PENDULUM + "command: simulate\ntorques: {j1: 1/(0.7 - t)}\n")
    (tmp_path / "two.yaml").write_text("schema: 1\n")
    out = ["--out", tmp_path / "out", "--timeout", "600"]
    codes = []
    for names in (["good"], ["good", "one"], ["good", "one", "three"], ["good", "one", "three", "two"]):
        codes.append(run(*(tmp_path / f"{name}.yaml" for name in names), *out)[0])
    assert codes == [0, 1, 3, 2]


def test_quiet_prints_errors_alone(tmp_path: Path) -> None:
    arm(tmp_path / "good.yaml", PASSES)
    arm(tmp_path / "one.yaml", "expect: {peak_torque.swing: < 0.1}")
    (tmp_path / "two.yaml").write_text("schema: 1\n")
    done = robodyn("run", tmp_path, "--out", tmp_path / "out", "--quiet", "--no-plots")
    assert done.returncode == 2 and done.stdout == ""
    first, second, end = sorted(done.stderr.split("\n"), reverse=True)
    assert first.startswith("robodyn: error: two: ") and not end
    assert second.startswith("robodyn: error: one: peak_torque.swing") and "< 0.1" in second


# -- commands --------------------------------------------------------------------------------------------
def test_the_commands_of_scenes_exist(tmp_path: Path) -> None:
    for name in SCENE_COMMANDS:
        assert functions[name].__name__ == name
    (entry_of_none,) = loaded([arm(tmp_path / "a.yaml", command="")], tmp_path / "out")
    assert entry_of_none.message.endswith(f"allowed: {', '.join(SCENE_COMMANDS)}")


def test_an_analysis_is_a_command_of_a_scene_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from robodyn_cli.tools.progress import Stopwatch

    path = tmp_path / "swing.yaml"
    path.write_text(PENDULUM + "command: stability\n")
    assert validated("validate", tmp_path).code == 0
    (entry,) = loaded([path], tmp_path / "out")
    assert entry.command == "stability" and entry.scene is not None
    given = {}

    def stand_in(scene: Scene, progress: Progress, watch: Stopwatch) -> Result:
        with watch.stage("stability"):
            given["scene"] = scene
        return Result("stability", "", "ok", scene.text)

    monkeypatch.setitem(functions, "stability", stand_in)
    watch = Stopwatch()
    assert execute("stability", entry.scene, lambda done, total: None, watch).status == "ok"
    assert given["scene"] is entry.scene and "stability" in watch.report()


# -- reports ---------------------------------------------------------------------------------------------
# elements of the schema of Jenkins' xUnit plugin (junit-10.xsd), the strictest reader, as far as they serve here:
# attributes that must be there, others that may be, children
JUNIT: dict[str, tuple[set[str], set[str], set[str]]] = {
    "testsuites": (set(), {"name", "tests", "failures", "errors", "time"}, {"testsuite"}),
    "testsuite": ({"name", "tests", "failures", "errors"}, {"skipped", "time"}, {"testcase"}),
    "testcase": ({"name"}, {"classname", "time"}, {"failure", "error", "skipped", "system-out"}),
    "failure": (set(), {"message", "type"}, set()),
    "error": (set(), {"message", "type"}, set()),
    "skipped": (set(), {"message", "type"}, set()),
    "system-out": (set(), set(), set()),
}


def test_junit_is_what_its_readers_know() -> None:
    """Elements, attributes and children are those of the strictest schema; the sums add up."""
    failed = JudgedCriterion("lock.time", "1 +- 0.1", 2.0, False, "2")
    done = [
        BatchEntry(Path("a.yaml"), "a", seconds=1.5),
        BatchEntry(Path("b.yaml"), "b", exit_code=1, criteria=[failed], unchanged=True),
        BatchEntry(Path("c.yaml"), "c", exit_code=70, message="x"),
        BatchEntry(Path("d.yaml"), "d", exit_code=2),
        BatchEntry(Path("e.yaml"), "e", stopped=True),
    ]
    root = ElementTree.fromstring(junit(done))
    assert root.tag == "testsuites"
    for node in root.iter():
        needed, more, children = JUNIT[node.tag]
        assert needed <= set(node.attrib) <= needed | more, node.tag
        assert {child.tag for child in node} <= children, node.tag
        if node.tag == "testcase":
            assert node.get("classname")
            assert sum(child.tag != "system-out" for child in node) <= 1
        if node.tag in ("failure", "error"):
            assert node.get("message"), "a reader shows the message alone"
    for node in (root, root[0]):
        counts = [int(str(node.get(k))) for k in ("tests", "failures", "errors")]
        assert counts == [5, 1, 2] and re.fullmatch(r"\d+\.\d+", str(node.get("time")))
    assert root[0].get("skipped") == "1"
    assert [len(list(root.iter(tag))) for tag in ("testcase", "failure", "error", "skipped")] == [5, 1, 2, 1]


def test_json_of_a_batch(tmp_path: Path) -> None:
    arm(tmp_path / "a.yaml", "expect: {peak_torque.swing: < 0.1}")
    done = robodyn("run", tmp_path, "--out", tmp_path / "out", "--no-plots", "--json")
    report = json.loads(done.stdout)
    assert (report["status"], report["exit_code"], done.returncode) == ("failed", 1, 1)
    assert report["scenes"][0]["criteria"][0]["holds"] is False
