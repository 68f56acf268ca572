"""What goes to standard output and what to standard error; progress; pipes that close; signals."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robodyn_cli.results.hdf5 import read
from robodyn_cli.results.output_dir import UNFINISHED_NAME
from tests.cli.tool import COMMAND, CONFIGS, PENDULUM, Done, environment, files, invoke, run, start

# a run of minutes: long enough to be stopped in the middle on any machine
LONG = ["--set", "simulate.duration=1e8", "--set", "simulate.samples=3", "--no-plots"]
STREAMED = [
    "--set",
    "simulate.duration=1e6",
    "--set",
    "simulate.samples=50_000_000".replace("_", ""),
    "--no-plots",
]


# -- streams -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("command", ["simulate", "inverse", "deploy", "plan"])
@pytest.mark.parametrize("options", [["--json"], ["--json", "--quiet"]], ids=" ".join)
def test_json_is_alone_on_standard_output_also_on_failure(
    command: str, options: list[str], tmp_path: Path
) -> None:
    where = [] if command == "plan" else ["--out", tmp_path]
    done = invoke(command, "missing.yaml", *options, *where)
    assert done.code == 2
    assert done.data["status"] == "failed"
    error = done.data["error"]
    assert error["exit_code"] == 2 and error["file"] == "missing.yaml" and error["message"] in done.err


def test_json_of_a_scene_error_has_the_place(scene: Path) -> None:
    scene.write_text(PENDULUM.replace("samples: 11", "samples: eleven"))
    error = invoke("simulate", scene, "--json").data["error"]
    line = PENDULUM.splitlines().index("simulate: {duration: 1, samples: 11}") + 1
    assert (error["file"], error["line"], error["key"]) == (str(scene), line, "simulate.samples")
    assert error["column"] > 1


def test_quiet_still_says_what_is_wrong(scene: Path) -> None:
    done = invoke("simulate", scene, "--quiet", "--set", "gravity=down")
    assert done.code == 2 and done.out == "" and done.err.startswith("robodyn: error: ")


def test_warnings_are_no_results(tmp_path: Path) -> None:
    words = ["--set", "robot.links.link1.inertia={xx: 0.1, yy: 0.1, zz: 5}", "--no-plots", "--out", tmp_path]
    loud = invoke("inverse", CONFIGS / "2r_circle.yaml", *words, "--json")
    assert loud.code == 0 and "warning" in loud.err and loud.data["status"] == "ok"
    assert invoke("inverse", CONFIGS / "2r_circle.yaml", *words, "--quiet").err == ""


def test_errors_are_one_line(scene: Path) -> None:
    done = invoke("simulate", scene, "--set", 'title="two\\nlines"', "--set", "robot.links.l1.mass=-1")
    assert done.code == 2 and len(done.err.splitlines()) == 1


# -- pipes -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("options", [[], ["--json"]], ids=["text", "json"])
def test_a_reader_that_goes_away_changes_nothing(options: list[str], scene: Path) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    process = start("simulate", scene, "--no-plots", *options, cwd=scene.parent, stdout=write_end)
    os.close(write_end)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0 and err == ""
    assert "result.h5" in files(scene.parent / "outputs" / "scene" / "simulate")


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams(closed: str, scene: Path) -> None:
    line = f"{sys.executable} -m robodyn_cli simulate {scene} --no-plots {closed}"
    done = subprocess.run(
        line, shell=True, cwd=scene.parent, env=environment(), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("words", [["--help"], ["simulate", "--help"], ["--version"], ["schema"], ["--show-completion", "bash"]], ids=" ".join)  # fmt: skip
def test_74_help_that_cannot_be_written(words: list[str]) -> None:
    with open("/dev/full", "w") as full:
        done = run(*words, stdout=full)
    assert done.code == 74 and done.err.startswith("robodyn: error: cannot write to standard output: ")
    assert done.err.count("\n") == 1


def test_help_for_a_reader_that_goes_away() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    process = start("--help", stdout=write_end)
    os.close(write_end)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")


# -- letters -----------------------------------------------------------------------------------------------
ACCENTED = PENDULUM.replace("title: Pendulum", "title: Pendel in M\u00fcnchen, \u00b5m")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_letters_that_the_terminal_has_not(encoding: str, scene: Path) -> None:
    scene.write_text(ACCENTED, encoding="utf-8")
    words = ["simulate", str(scene), "--no-plots"]
    process = subprocess.run(
        [*COMMAND, *words], cwd=scene.parent, capture_output=True, env=environment(PYTHONIOENCODING=encoding)
    )
    assert process.returncode == 0, process.stderr
    line = process.stdout.decode(encoding).splitlines()[0]
    assert line == (
        "Pendel in M\\xfcnchen, \\xb5m" if encoding == "ascii" else "Pendel in M\u00fcnchen, \u00b5m"
    )
    process = subprocess.run(
        [*COMMAND, *words, "--json"],
        cwd=scene.parent,
        capture_output=True,
        env=environment(PYTHONIOENCODING=encoding),
    )
    assert json.loads(process.stdout.decode(encoding))["title"] == "Pendel in M\u00fcnchen, \u00b5m"


def test_drawings_under_the_backend_of_a_notebook(scene: Path, tmp_path: Path) -> None:
    """It is not installed beside the program, and would be refused."""
    backend = environment(MPLBACKEND="module://no_such_package.backend")
    done = run("simulate", scene, "--out", tmp_path / "out", env=backend)
    assert done.code == 0 and "joint_angles.png" in files(tmp_path / "out"), done.err


# -- progress ----------------------------------------------------------------------------------------------
def on_a_terminal(words: list[str], seconds: float = 30.0) -> tuple[str, str]:
    """Run with standard error on a terminal; return what was seen there, and standard output."""
    parent, child = pty.openpty()
    process = start(*words, stderr=child, env=environment(TERM="xterm", COLUMNS="100"))
    os.close(child)
    seen = b""
    try:
        while chunk := os.read(parent, 4096):
            seen += chunk
    except OSError:
        pass  # the terminal ends with the process
    out, _ = process.communicate(timeout=seconds)
    os.close(parent)
    return seen.decode(), out


def test_progress_on_a_terminal(scene: Path, tmp_path: Path) -> None:
    words = [
        "simulate",
        str(scene),
        "--set",
        "simulate.duration=5e5",
        "--no-plots",
        "--json",
        "--out",
        str(tmp_path),
    ]
    seen, out = on_a_terminal(words)
    shares = [float(x) for x in re.findall(r"([0-9.]+) %", seen)]
    assert len(shares) >= 3 and max(shares) > 50.0
    assert seen.endswith("\r") or seen.rstrip(" ").endswith("\r")  # the line was taken away again
    assert json.loads(out)["status"] == "ok"


def test_no_progress_when_quiet(scene: Path, tmp_path: Path) -> None:
    words = [
        "simulate",
        str(scene),
        "--set",
        "simulate.duration=1e5",
        "--no-plots",
        "--quiet",
        "--out",
        str(tmp_path),
    ]
    assert on_a_terminal(words) == ("", "")


def test_no_progress_in_a_file(scene: Path, tmp_path: Path) -> None:
    done = run("simulate", scene, "--set", "simulate.duration=1e5", "--no-plots", "--out", tmp_path)
    # after 10 s, on a busy machine, a line of words says how far the run is
    assert done.code == 0 and "\r" not in done.err and "#" not in done.err


# -- signals -----------------------------------------------------------------------------------------------
def stopped(words: list[str], with_signal: int, when: Path, cwd: Path) -> tuple[Done, float]:
    """Run, send a signal a moment after a path has appeared, and return what happened and how long it took."""
    process = start(*words, cwd=cwd)
    limit = time.monotonic() + 30
    while not when.exists() and not list(when.parent.glob(when.name)):
        assert time.monotonic() < limit and process.poll() is None
        time.sleep(0.02)
    time.sleep(0.7)
    sent = time.monotonic()
    process.send_signal(with_signal)
    out, err = process.communicate(timeout=60)
    return Done(process.returncode, out, err), time.monotonic() - sent


@pytest.mark.parametrize("options", [LONG, STREAMED], ids=["few samples", "many samples"])
def test_130_interrupted(options: list[str], scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done, waited = stopped(
        ["simulate", str(scene), *options, "--out", str(out)], signal.SIGINT, out / ".lock", tmp_path
    )
    assert done.code == 130 and done.out == "" and done.err == "robodyn: error: interrupted\n"
    assert waited < 5.0
    assert files(out) <= {UNFINISHED_NAME}, "nothing half-written"
    assert run("simulate", scene, "--no-plots", "--out", out).code == 0
    assert files(out) == {"result.h5", "summary.json"}


def test_130_as_json(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["simulate", str(scene), *LONG, "--json", "--out", str(out)]
    done, _ = stopped(words, signal.SIGINT, out / ".lock", tmp_path)
    assert done.code == 130 and done.data["status"] == "failed" and done.data["error"]["exit_code"] == 130


def test_an_interrupt_during_a_deployment(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["deploy", str(CONFIGS / "four_bar_deploy.yaml"), "--set", "simulate.duration=1e7", "--no-plots",
             "--set", "deploy.criterion=multipliers", "--set", "deploy.growth=1e12", "--out", str(out)]  # fmt: skip
    done, waited = stopped(words, signal.SIGINT, out / ".lock", tmp_path)
    assert done.code == 130 and waited < 5.0 and files(out) == set()


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5])
def test_an_early_interrupt(delay: float, scene: Path) -> None:
    """While the program is still being loaded there is one line and the JSON too; before that it is Python's affair."""
    code = "import robodyn_cli.cli.main as m; m.interrupts.leave_at_once(); print('up', flush=True); m.main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "simulate", str(scene), *LONG, "--json"], cwd=scene.parent, text=True,
        env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "up\n"
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "robodyn: error: interrupted\n")
    error = {"kind": "KeyboardInterrupt", "message": "interrupted", "exit_code": 130}
    assert json.loads(out) == {"status": "failed", "error": error}


SLOW = """
import sys, time
try:
    print("importing", flush=True)
    time.sleep(0.5)
except BaseException:
    pass  # as some compiled modules do
"""


def test_an_interrupt_during_an_import_is_not_lost(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    code = """
import sys
from robodyn_cli.cli import interrupts
from robodyn_cli.cli.console import guarded
def command():
    interrupts.tidy_up_first()
    import slow, time
    time.sleep(30)
interrupts.leave_at_once()
interrupts.end(guarded(command)())
"""
    env = environment()
    env["PYTHONPATH"] += f"{os.pathsep}{tmp_path}"
    process = subprocess.Popen(
        [sys.executable, "-c", code], env=env, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None and process.stdout.readline() == "importing\n"
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (130, "robodyn: error: interrupted\n")


@pytest.mark.parametrize("kill", [signal.SIGKILL, signal.SIGTERM])
def test_killed_leaves_nothing_under_a_final_name(kill: int, scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done, _ = stopped(["simulate", str(scene), *STREAMED, "--out", str(out)], kill, out / ".new.*", tmp_path)
    assert done.code == -kill
    assert all(name.startswith(".") for name in files(out))
    # the next run takes over the directory and sweeps
    assert run("simulate", scene, "--no-plots", "--out", out).code == 0
    assert files(out) == {"result.h5", "summary.json"}
    assert read(out / "result.h5").status == "ok"


def test_two_runs_into_one_directory(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = start("simulate", scene, *LONG, "--out", out)
    try:
        limit = time.monotonic() + 30
        while not (out / ".lock").exists() or not (out / ".lock").read_text():
            assert time.monotonic() < limit
            time.sleep(0.02)
        second = run("simulate", scene, "--no-plots", "--out", out)
        assert second.code == 2 and "in use" in second.err and str(first.pid) in second.err
    finally:
        first.send_signal(signal.SIGINT)
        first.communicate(timeout=60)
    assert first.returncode == 130
