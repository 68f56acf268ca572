"""Runs ended at any moment: an earlier run's files stay, or this one's replace them all, or a mix is recognised."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.errors import ResultFileError
from robodyn_cli.over.batch.stored import read_stored
from robodyn_cli.results.hdf5 import read
from robodyn_cli.results.output_dir import UNFINISHED_NAME
from tests.cli.tool import CONFIGS, environment, files, invoke

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")

# of commands a scene, and options: many samples where there is something to write
SCENES = {
    "simulate": ("double_pendulum.yaml", "--set", "simulate.samples=20001"),
    "inverse": ("2r_circle.yaml", "--set", "inverse.samples=20001"),
    "assemble": ("four_bar_deploy.yaml",),
}
# before the program has begun, an interrupt is Python's own affair
BEGIN = "import robodyn_cli.cli.main as m; print('up', flush=True); m.main()"
# one in each third of a run that writes much, one in each half of the others: without earlier files, and over them
MOMENTS = {"simulate": 3, "inverse": 3, "assemble": 2}
# an interrupt meets the compiled loop, kernels of samples, or a search in Python, of which each has one command here; what a killed process leaves is a matter of how files are written, in
# one way for all commands
ENDED = [*((command, "SIGINT") for command in SCENES), ("simulate", "SIGKILL"), ("inverse", "SIGKILL")]


def begin(command: str, out: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", BEGIN, *words(command, out)], text=True, env=environment(),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "up\n"
    return process


def words(command: str, out: Path) -> list[str]:
    scene, *options = SCENES[command]
    return [command, str(CONFIGS / scene), *options, "--out", str(out)]


def contents(directory: Path) -> dict[str, bytes]:
    return {
        path.name: path.read_bytes()
        for path in directory.iterdir()
        if path.is_file() and path.name != ".lock"
    }


@lru_cache
def whole(command: str) -> tuple[float, set[str]]:
    """Return how long a run takes that nobody disturbs, and the files that it leaves."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        process = begin(command, Path(folder))
        started = time.monotonic()
        process.communicate(timeout=120)
        assert process.returncode == 0
        return time.monotonic() - started, set(contents(Path(folder)))


def check(command: str, out: Path, old: dict[str, bytes]) -> str:
    """Tell what an ended run has left: nothing, old files, new ones, or a mix that says so."""
    if not out.exists() or not (found := contents(out)):
        return "nothing"
    if found == old:
        return "old"
    try:
        read_stored(out)
    except ResultFileError as error:
        assert "not of the same run" in error.message or "there is no result.h5" in error.message
        return "mixed"
    summary = json.loads((out / "summary.json").read_text()) if "summary.json" in found else {}
    if not summary:
        return "mixed"
    # a drawing of its own is the last that a run may leave behind beside the files of the one before
    assert set(found) == set(summary["outputs"]) == whole(command)[1]
    assert all(found[name] != old.get(name) for name in ("result.h5", "summary.json"))
    return "new"


@pytest.mark.parametrize(("command", "kind"), ENDED)
def test_ended_at_any_moment(command: str, kind: str, tmp_path: Path) -> None:
    number = getattr(signal, kind)
    duration, _ = whole(command)
    out = tmp_path / "out"
    moments = random.Random(f"{command} {kind}")
    codes = set()
    old: dict[str, bytes] = {}
    for k in range(MOMENTS[command]):
        process = begin(command, out)
        time.sleep((k + moments.random()) / MOMENTS[command] * duration)
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
        codes.add(process.returncode)
        assert process.returncode in ((0, 130) if kind == "SIGINT" else (0, -number)), said
        assert "Traceback" not in said
        verdict = check(command, out, old)
        assert verdict != "mixed" or process.returncode == -number
        assert verdict in ("old", "nothing") or process.returncode != 130 or "stay as they were" not in said
        if k == 0:
            assert invoke(*words(command, out), "--quiet").code == 0
            assert check(command, out, {}) == "new"
        old = contents(out)
    assert codes - {0}, "the signals all came too late"
    again = invoke(*words(command, out), "--no-plots", "--quiet")
    assert again.code == 0 and files(out) == {"result.h5", "summary.json"}


LONG = (
    *("simulate", str(CONFIGS / "double_pendulum.yaml"), "--set", "simulate.samples=600001"),
    *("--set", "simulate.duration=6", "--no-plots", "--no-error-estimate"),
)


def half_way(out: Path) -> subprocess.Popen[str]:
    """Begin a long run, and return when it has written some blocks of samples."""
    unfinished = out / UNFINISHED_NAME
    process = subprocess.Popen(
        [sys.executable, "-c", BEGIN, *LONG, "--out", str(out)], text=True, env=environment(),
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip
    limit = time.monotonic() + 60
    while not unfinished.exists() or unfinished.stat().st_size < 3 * 65536 * 5 * 8:
        assert process.poll() is None and time.monotonic() < limit
        time.sleep(0.002)
    return process


def test_a_long_run_that_was_interrupted_says_how_it_goes_on(tmp_path: Path) -> None:
    process = half_way(tmp_path)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130 and "the same command with --resume goes on from there" in said
    again = invoke(*LONG, "--resume", "--out", str(tmp_path))
    assert again.code == 0 and "anew" not in again.err


def test_a_long_run_that_was_killed_goes_on(tmp_path: Path) -> None:
    """The samples of the blocks that were written are the same bits, the others the same to the tolerance."""
    assert invoke(*LONG, "--out", str(tmp_path / "whole")).code == 0
    out = tmp_path / "out"
    process = half_way(out)
    process.kill()
    process.wait()
    assert not (out / "result.h5").exists()
    other = invoke(*LONG, "--set", "simulate.rtol=1e-9", "--resume", "--out", str(out))
    assert other.code == 2 and "other settings" in other.err
    again = invoke(*LONG, "--resume", "--out", str(out))
    assert again.code == 0 and "anew" not in again.err
    assert files(out) == {"result.h5", "summary.json"}
    whole, rest = (read(folder / "result.h5") for folder in (tmp_path / "whole", out))
    kept = 2 * 65536
    for name in ("time", "q", "qd"):
        found, expected = rest.variables[name].data, whole.variables[name].data
        np.testing.assert_array_equal(found[:kept], expected[:kept])
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)
    nothing = invoke(*LONG, "--resume", "--out", str(out))
    assert nothing.code == 0 and "anew" in nothing.err
