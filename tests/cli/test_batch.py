"""``robodyn run``: batches of scenes in processes of their own."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from robodyn_cli.cli import console
from robodyn_cli.cli.app import app
from robodyn_cli.errors import SceneError
from robodyn_cli.over.batch import entries as batch_entries
from robodyn_cli.over.batch.batch import Batch
from robodyn_cli.over.batch.entries import BatchEntry, unique_names
from robodyn_cli.over.batch.reports import junit, markdown, tally
from robodyn_cli.over.batch.stored import gather
from robodyn_cli.version import digest_of
from tests.cli.batch_scenes import ROOT, arm, loaded, robodyn, run
from tests.cli.tool import environment, invoke

PASSES = "expect: {status: ok, peak_torque.swing: < 100}"
FAILS = "expect: {peak_torque.swing: < 0.1, samples: 21}"


def test_a_batch_of_everything(tmp_path: Path) -> None:
    arm(tmp_path / "good.yaml", PASSES)
    arm(tmp_path / "fails.yaml", FAILS)
    arm(tmp_path / "unknown.yaml", "expect: {peak_torqe.swing: 1}")
    arm(tmp_path / "plain.yaml")
    arm(tmp_path / "sub" / "without.yaml", command="")
    (tmp_path / "broken.yaml").write_text("schema: [\n")
    (tmp_path / "sub" / "robot.yaml").write_text("joints: []\nlinks: []\n")
    out, xml, page = tmp_path / "out", tmp_path / "junit.xml", tmp_path / "summary.md"
    code, scenes = run(tmp_path, "--out", out, "-j", 2, "--junit", xml, "--markdown", page)
    assert code == 2
    assert {name: scene["exit_code"] for name, scene in scenes.items()} == {
        "good": 0, "plain": 0, "fails": 1, "unknown": 2, "without": 2, "broken": 2,
    }  # fmt: skip
    assert "did you mean 'peak_torque.swing'?" in scenes["unknown"]["message"]
    assert "key 'command' is missing" in scenes["without"]["message"]
    assert [c["holds"] for c in scenes["fails"]["criteria"]] == [False, True]
    assert (out / "good" / "inverse" / "result.h5").exists()

    suite = ElementTree.parse(xml).getroot()[0]
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("6", "1", "3")
    cases = {str(case.get("name")): case for case in suite}
    assert [node.tag for node in cases["good"]] == ["system-out"]
    failure = cases["fails"].find("failure")
    assert failure is not None and "expected < 0.1" in str(failure.get("message"))
    text = page.read_text()
    assert "6 scenes: 2 ok, 1 failed, 3 error" in text and "| fails | `peak_torque.swing` |" in text

    code, again = run(tmp_path / "good.yaml", tmp_path / "fails.yaml", "--out", out)
    assert code == 1, "an unchanged result is judged again"
    assert all(scene["unchanged"] for scene in again.values())


def test_lines_for_people(tmp_path: Path) -> None:
    arm(tmp_path / "a.yaml", PASSES)
    arm(tmp_path / "b.yaml", FAILS)
    done = robodyn("run", tmp_path, "--out", tmp_path / "out", "--no-plots")
    lines = done.stdout.splitlines()
    assert done.returncode == 1 and not done.stderr
    assert sum(line.startswith("ok      a  inverse") for line in lines) == 1
    assert any(line.startswith("        peak_torque.swing: ") for line in lines)
    assert lines[-1].startswith("2 scenes: 1 ok, 1 failed; ")
    assert not robodyn("run", tmp_path, "--out", tmp_path / "out", "--no-plots", "--quiet").stdout


def test_what_is_run_again(tmp_path: Path) -> None:
    path, out = arm(tmp_path / "a.yaml", PASSES), tmp_path / "out"

    def unchanged(*options: object) -> bool:
        code, scenes = run(path, "--out", out, *options)
        assert code == 0
        return bool(scenes["a"]["unchanged"])

    assert not unchanged()
    assert unchanged()
    assert not unchanged("--force")
    arm(path, PASSES + "\n# a comment changes nothing")
    assert unchanged()
    arm(path, PASSES, motion="cos(t)")
    assert not unchanged()
    result = out / "a" / "inverse" / "result.h5"
    result.write_bytes(result.read_bytes()[:2000])
    assert not unchanged()
    (out / "a" / "inverse" / "summary.json").unlink()
    assert not unchanged()
    assert unchanged()


def test_other_code_runs_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, out = arm(tmp_path / "a.yaml", PASSES), tmp_path / "out"
    assert run(path, "--out", out)[0] == 0
    (entry,) = loaded([path], out)
    assert batch_entries.finished(entry, drawn=[])
    assert batch_entries.finished(entry, drawn=[".png"]) is None, "drawings were not made"
    monkeypatch.setattr(batch_entries, "code_digest", lambda: "0" * 64)
    assert batch_entries.finished(entry, drawn=[]) is None, "the same version with other code"


def test_the_digest_of_code_knows_each_file_and_its_name(tmp_path: Path) -> None:
    package = tmp_path / "package"
    shutil.copytree(ROOT / "robodyn_cli" / "motors", package, ignore=shutil.ignore_patterns("__pycache__"))
    whole = digest_of(str(package))
    (package / "__pycache__").mkdir()
    (package / "__pycache__" / "heat.pyc").write_text("")
    assert digest_of(str(package)) == whole, "bytecode is made anew by whoever imports it"
    (package / "heat.py").rename(package / "warmth.py")
    renamed = digest_of(str(package))
    with open(package / "drive.py", "a") as stream:
        stream.write("\n")
    assert len({whole, renamed, digest_of(str(package))}) == 3


def test_failures_that_are_expected(tmp_path: Path) -> None:
    (tmp_path / "wild.yaml").write_text(
        (ROOT / "configs" / "four_bar_deploy.yaml").read_text()
        .replace("robots/", f"{(ROOT / 'configs' / 'robots').as_posix()}/")
        .replace("theta1: 0.01, phi1", "theta1: 3.0, phi1").partition("expect:")[0]
        + "expect: {exit_code: 5}\n"
    )  # fmt: skip
    code, scenes = run(tmp_path / "wild.yaml", "--out", tmp_path / "out")
    assert code == 0 and scenes["wild"]["verdict"] == "ok"
    text = (tmp_path / "wild.yaml").read_text().replace("exit_code: 5", "exit_code: 4, lock.time: 3")
    (tmp_path / "wild.yaml").write_text(text)
    code, scenes = run(tmp_path / "wild.yaml", "--out", tmp_path / "out")
    assert code == 5 and "does not close" in scenes["wild"]["message"]


def test_a_directory_in_use(tmp_path: Path) -> None:
    from robodyn_cli.results.output_dir import OutputDirectory

    path, out = arm(tmp_path / "a.yaml", PASSES), tmp_path / "out"
    with OutputDirectory(out / "a" / "inverse"):
        code, scenes = run(path, "--out", out)
    assert code == 2 and "in use" in scenes["a"]["message"]


# -- which scenes ----------------------------------------------------------------------------------------


def test_gather(tmp_path: Path) -> None:
    a, b = arm(tmp_path / "a.yaml"), arm(tmp_path / "sub" / "b.yml")
    arm(tmp_path / ".hidden" / "c.yaml")
    (tmp_path / "robot.yaml").write_text("joints: []\nlinks: []\n")
    (tmp_path / "notes.txt").write_text("schema: 1")
    assert gather([str(tmp_path)]) == [a, b]
    assert gather([str(tmp_path / "*.yaml")]) == [a]
    assert gather([str(tmp_path / "**" / "*.y*ml")]) == [a, b]
    assert gather([str(a), str(tmp_path), str(a)]) == [a, b]
    assert gather([str(tmp_path / "robot.yaml")]) == [tmp_path / "robot.yaml"], (
        "a file that is named is meant"
    )
    assert gather([str(tmp_path / "absent.yaml")]) == [tmp_path / "absent.yaml"]
    (tmp_path / "empty").mkdir()
    for word in (tmp_path / "empty", tmp_path / "*.json"):
        with pytest.raises(SceneError, match="allowed"):
            gather([str(word)])


def test_scenes_of_the_same_name_do_not_share_a_directory(tmp_path: Path) -> None:
    paths = [arm(tmp_path / folder / "a.yaml") for folder in ("x", "y/z")] + [arm(tmp_path / "y" / "b.yaml")]
    assert unique_names(paths) == ["x/a", "y/z/a", "b"]
    assert unique_names(paths[:1]) == ["a"]
    assert unique_names([tmp_path / "a.yaml", tmp_path / "a.yml", tmp_path / "b.yml"]) == [
        "a.yaml",
        "a.yml",
        "b",
    ]


# -- workers ---------------------------------------------------------------------------------------------


def with_worker(tmp_path: Path, code: str, count: int = 3) -> list[BatchEntry]:
    scenes = loaded([arm(tmp_path / f"s{k}.yaml", PASSES) for k in range(count)], tmp_path / "out")

    def worker(command: str, path: Path, directory: Path) -> list[str]:
        if path.stem != "s1":
            from robodyn_cli.cli.worker import command_line

            return command_line(None, [], command, path, directory)
        return [sys.executable, "-c", code]

    list(Batch(scenes, 2, worker, drawn=[], force=False).run())
    return scenes


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_results_of_a_namesake_are_not_replaced_in_silence(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for folder in ("x", "y"):
        arm(tmp_path / folder / "a.yaml", motion="sin(t)" if folder == "x" else "cos(t)")
        done = invoke("run", tmp_path / folder, "--no-plots", "--out", out)
        assert done.code == 0
        assert ("another scene" in done.err) == (folder == "y")
    assert str(tmp_path / "x" / "a.yaml") in done.err


def test_a_worker_that_is_killed_is_one_scene_lost(tmp_path: Path) -> None:
    scenes = with_worker(tmp_path, "import os; os.kill(os.getpid(), 9)")
    assert [e.exit_code for e in scenes] == [0, 70, 0]
    assert "signal 9" in scenes[1].message


def test_a_worker_that_ends_oddly(tmp_path: Path) -> None:
    scenes = with_worker(tmp_path, "import sys; print('out of luck', file=sys.stderr); sys.exit(99)")
    assert [e.exit_code for e in scenes] == [0, 70, 0]
    assert "code 99: out of luck" in scenes[1].message


def test_workers_end_with_the_batch(tmp_path: Path) -> None:
    from robodyn_cli.cli.worker import command_line

    path = arm(tmp_path / "long.yaml", samples=2_000_000)
    process = subprocess.Popen(
        command_line(None, [], "inverse", path, tmp_path / "out"), stdin=subprocess.PIPE
    )
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(30) == 130


# -- reports ---------------------------------------------------------------------------------------------


def test_reports_of_odd_names_and_messages() -> None:
    odd = BatchEntry(Path("a|b<c>&\x00.yaml"), 'a|b<c>&"\x00', exit_code=70, message="x\x1b[0m | <y>\nz")
    stopped = BatchEntry(Path("d.yaml"), "d", stopped=True)
    case = ElementTree.fromstring(junit([odd, stopped]))[0][0]
    assert str(case.get("name")).startswith('a|b<c>&"')
    page = markdown([odd, stopped])
    assert all(line.count("|") - line.count("\\|") == 6 for line in page.splitlines() if line.startswith("|"))
    assert tally([odd, stopped]) == "2 scenes: 1 error, 1 stopped"


# -- interrupts ------------------------------------------------------------------------------------------

posix = pytest.mark.skipif(sys.platform == "win32", reason="signals")


def start(tmp_path: Path, *options: object) -> subprocess.Popen[str]:
    words = [
        sys.executable,
        "-m",
        "robodyn_cli",
        "run",
        tmp_path / "scenes",
        "--out",
        tmp_path / "out",
        "--no-plots",
    ]
    return subprocess.Popen(
        [str(w) for w in [*words, "-j", 2, *options]],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def check_whole_or_none(out: Path) -> int:
    """Every result file under its name is whole; return how many there are."""
    from robodyn_cli.results.hdf5 import read

    found = list(out.rglob("result.h5"))
    for path in found:
        assert len(read(path).time) == 20_001
    for path in out.rglob("summary.json"):
        assert json.loads(path.read_text())["status"] == "ok"
    return len(found)


@posix
@pytest.mark.parametrize(
    "kind", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM] if os.name == "posix" else []
)
def test_killed_at_any_moment(kind: signal.Signals, tmp_path: Path) -> None:
    for k in range(4):
        arm(tmp_path / "scenes" / f"s{k}.yaml", PASSES, samples=20_001, motion=f"sin({k + 1}*t)")
    for delay in (0.15, 0.5, 0.9, 1.4):
        process = start(tmp_path)
        time.sleep(delay)
        process.send_signal(kind)
        process.communicate(timeout=60)
        assert process.returncode in (0, -kind, 130)
        check_whole_or_none(tmp_path / "out")
    limit = time.monotonic() + 20.0
    code, scenes = run(tmp_path / "scenes", "--out", tmp_path / "out")
    while code == 2 and time.monotonic() < limit:  # a worker of the killed batch is still on its way out
        code, scenes = run(tmp_path / "scenes", "--out", tmp_path / "out")
    assert code == 0 and check_whole_or_none(tmp_path / "out") == 4
    assert not list((tmp_path / "out").rglob("*.robodyn-tmp"))
    code, scenes = run(tmp_path / "scenes", "--out", tmp_path / "out")
    assert code == 0 and all(scene["unchanged"] for scene in scenes.values())


@posix
def test_interrupted(tmp_path: Path) -> None:
    from robodyn_cli.results.hdf5 import read

    arm(tmp_path / "scenes" / "short.yaml", PASSES)
    for k in range(2):
        arm(tmp_path / "scenes" / f"x{k}.yaml", samples=3_000_000)
    xml = tmp_path / "junit.xml"
    process = start(tmp_path, "--junit", xml)
    assert process.stdout is not None
    assert process.stdout.readline().startswith("ok      short")
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130 and "interrupted" in said
    suite = ElementTree.parse(xml).getroot()[0]
    assert (suite.get("skipped"), suite.get("errors")) == ("2", "0")
    # a worker may have been at its last word just then: what is there is whole
    found = {path.parents[1].name: read(path).status for path in (tmp_path / "out").rglob("result.h5")}
    assert "short" in found and set(found.values()) == {"ok"}


@posix
def test_interrupted_before_the_first_scene_runs(tmp_path: Path) -> None:
    """The report says of each scene that it was not done."""
    arm(tmp_path / "a.yaml")
    arm(tmp_path / "b.yaml")
    code = """
import os, signal, sys
import robodyn_cli.over.batch.entries as entries
from robodyn_cli.cli import interrupts
from robodyn_cli.cli.app import run
whole = entries.load_scene
def interrupted(*arguments):
    os.kill(os.getpid(), signal.SIGINT)
    return whole(*arguments)
entries.load_scene = interrupted
interrupts.leave_at_once()
interrupts.end(run(sys.argv[1:]))
"""
    xml = tmp_path / "junit.xml"
    words = ["run", str(tmp_path), "--out", str(tmp_path / "out"), "--junit", str(xml), "--json"]
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, env=environment()
    )
    assert done.returncode == 130 and done.stderr == "robodyn: error: interrupted\n"
    assert json.loads(done.stdout)["error"]["exit_code"] == 130
    suite = ElementTree.parse(xml).getroot()[0]
    assert (suite.get("tests"), suite.get("skipped"), suite.get("errors")) == ("2", "2", "0")


@posix
@pytest.mark.parametrize("form", ["--junit {}", "--junit={}"])
def test_interrupted_while_it_is_being_loaded(form: str, tmp_path: Path) -> None:
    """The report replaces that of an earlier batch, which would say that all was well."""
    xml, note = tmp_path / "junit.xml", tmp_path / "notes.md"
    xml.write_text("<testsuites/>")
    code = """
import os, signal, sys
from robodyn_cli.cli import interrupts
interrupts.leave_at_once()
os.kill(os.getpid(), signal.SIGINT)
"""
    words = ["run", str(tmp_path), *form.format(xml).split(), "--markdown", str(note), "--json"]
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, env=environment()
    )
    assert done.returncode == 130 and done.stderr == "robodyn: error: interrupted\n"
    assert json.loads(done.stdout)["error"]["exit_code"] == 130
    suite = ElementTree.parse(xml).getroot()[0]
    assert (suite.get("tests"), suite.get("skipped")) == ("1", "1")
    assert "interrupted" in note.read_text() and not list(tmp_path.glob("*.tmp"))


def test_one_scene_is_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(console, "LONG_SECONDS", 0.01)
    scene = arm(tmp_path / "good.yaml")
    said = CliRunner().invoke(app, ["run", str(scene), "--out", str(tmp_path / "out"), "--no-plots"]).stderr
    assert " s: 1 scene\n" in said
