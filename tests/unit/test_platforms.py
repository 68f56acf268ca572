"""What macOS and Windows do otherwise, as far as it can be put in the place of what this system does."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from robodyn_cli.cli.app import run
from robodyn_cli.foreign import file_stem
from robodyn_cli.over.batch.entries import unique_names
from robodyn_cli.results.atomic import write_new
from tests.cli.tool import CONFIGS, ROOT, environment

ARM, PENDULUM = str(CONFIGS / "2r_circle.yaml"), str(CONFIGS / "double_pendulum.yaml")


@pytest.fixture
def held_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Windows: what this process has open is neither removed nor replaced."""
    if not os.path.isdir("/proc/self/fd"):
        pytest.skip("open files cannot be listed")

    def refuse(*paths: object) -> None:
        held = {os.path.realpath(f"/proc/self/fd/{n}") for n in os.listdir("/proc/self/fd")}
        for path in map(str, paths):
            if os.path.isfile(path) and os.path.realpath(path) in held:
                raise PermissionError(errno.EACCES, "in use", path)

    for name, count in (("replace", 2), ("rename", 2), ("unlink", 1), ("remove", 1)):
        real = getattr(os, name)

        def guarded(*words: object, _real: object = real, _count: int = count, **more: object) -> object:
            if not more:
                refuse(*words[:_count])
            return _real(*words, **more)  # type: ignore[operator]

        monkeypatch.setattr(os, name, guarded)


@pytest.mark.parametrize(
    "words",
    [
        ["simulate", PENDULUM, "--set", "simulate.samples=200001", "--no-error-estimate"],
        ["sweep", ARM, "--vary", "robot.links.link2.mass=linspace(10, 20, 3)", "--of", "peak_torque.theta1"],
    ],
    ids=lambda words: words[0],
)
def test_files_are_closed_before_they_are_removed(words: list[str], tmp_path: Path, held_files: None) -> None:
    """No file of an unfinished run is left, from which the next one would go on."""
    assert run([*words, "--out", str(tmp_path), "--no-plots", "--quiet"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {".lock", "result.h5", "summary.json"}


WINDOWS = """
import os, signal, sys, types
import ctypes, multiprocessing, numpy, platform, subprocess, tempfile, threading, typer  # these are this system's own
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None
locked = types.ModuleType("msvcrt")
locked.LK_NBLCK, locked.LK_UNLCK, locked.locking = 1, 2, lambda descriptor, how, count: None
sys.modules["msvcrt"] = locked
for module, names in {
    os: ("fork", "O_NOFOLLOW", "O_NONBLOCK", "sched_getaffinity", "WNOHANG"),
    signal: ("SIGALRM", "SIGKILL", "SIGHUP", "alarm", "pthread_kill", "pthread_sigmask"),
}.items():
    for name in names:
        delattr(module, name)
sys.platform = "win32"
from robodyn_cli.cli.main import prepare_process
prepare_process()
from robodyn_cli.cli.app import run
out = sys.argv[1]
codes = [
    run(["inverse", "configs/2r_circle.yaml", "--out", out, "--no-plots"]),
    run(["check", out]),
    run(["simulate", "configs/double_pendulum.yaml", "--out", out + "/s", "--no-plots"]),
    run(["equations", "configs/2r_circle.yaml"]),
]
print(codes, file=sys.stderr)
"""


def test_without_what_windows_lacks(tmp_path: Path) -> None:
    """Modules, functions and signals of POSIX are gone, the terminal knows cp1252, and Python has no UTF-8 mode."""
    old = environment(PYTHONUTF8="0", PYTHONIOENCODING="cp1252", LC_ALL="C", PYTHONCOERCECLOCALE="0")
    words = [sys.executable, "-c", WINDOWS, str(tmp_path / "out")]
    done = subprocess.run(words, cwd=ROOT, env=old, capture_output=True)
    assert done.stderr.decode("cp1252").splitlines()[-1:] == ["[0, 0, 0, 0]"], done.stderr
    assert "peak torque" in done.stdout.decode("cp1252")


def test_names_of_files_that_other_systems_take_for_one(tmp_path: Path) -> None:
    assert unique_names([tmp_path / "x" / "Arm.yaml", tmp_path / "y" / "arm.yaml"]) == ["x/Arm", "y/arm"]
    assert (file_stem("aux"), file_stem("Com1.x"), file_stem("auxiliary")) == ("_aux", "_Com1.x", "auxiliary")


def test_a_new_file_where_there_are_no_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_links(*words: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", no_links)
    write_new(tmp_path / "a.yaml", "schema: 1\n")
    assert [path.name for path in tmp_path.iterdir()] == ["a.yaml"]
    assert (tmp_path / "a.yaml").read_text() == "schema: 1\n"
