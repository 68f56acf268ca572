"""``simulate`` and ``deploy`` ended at any moment leave a whole result or none, and the directory can be used again."""

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

from robodyn_cli.results.hdf5 import read
from robodyn_cli.results.result import Result
from tests.cli.tool import CONFIGS, environment, files, invoke

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")

SCENES = {"simulate": "double_pendulum.yaml", "deploy": "four_bar_deploy.yaml"}
# many samples, so that there is something to write
SAMPLES = ("--set", "simulate.samples=20001")
# before the program has begun, an interrupt is Python's own affair
BEGIN = "import robodyn_cli.cli.main as m; print('up', flush=True); m.main()"
MOMENTS = 3


def begin(command: str, out: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", BEGIN, *words(command, out)], text=True, env=environment(),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "up\n"
    return process


def words(command: str, out: Path) -> list[str]:
    return [command, str(CONFIGS / SCENES[command]), *SAMPLES, "--out", str(out)]


@lru_cache
def whole(command: str) -> tuple[float, Result]:
    """Return how long a run takes that nobody disturbs, and its result."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        process = begin(command, Path(folder))
        started = time.monotonic()
        process.communicate(timeout=120)
        assert process.returncode == 0
        return time.monotonic() - started, read(Path(folder) / "result.h5")


def check_whole_or_none(command: str, out: Path) -> None:
    """Compare what has a final name with what a run leaves that nobody disturbs."""
    result, summary = out / "result.h5", out / "summary.json"
    if result.exists():
        mine, expected = read(result), whole(command)[1]
        assert mine.status == expected.status and set(mine.variables) == set(expected.variables)
        for path in ("time", "q", "tau"):
            assert np.array_equal(mine[path], expected[path]), path
    if summary.exists():
        assert json.loads(summary.read_text())["status"] == whole(command)[1].status
        assert result.exists()


@pytest.mark.parametrize("kind", ["SIGINT", "SIGKILL"])
@pytest.mark.parametrize("command", SCENES)
def test_ended_at_any_moment(command: str, kind: str, tmp_path: Path) -> None:
    number = getattr(signal, kind)
    duration, _ = whole(command)
    out = tmp_path / "out"
    moments = random.Random(f"{command} {kind}")
    codes = set()
    for k in range(MOMENTS):
        process = begin(command, out)
        time.sleep((k + moments.random()) / MOMENTS * duration)
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
        codes.add(process.returncode)
        assert process.returncode in ((0, 130) if kind == "SIGINT" else (0, -number)), said
        assert "Traceback" not in said
        check_whole_or_none(command, out)
    assert codes - {0}, "the signals all came too late"
    again = invoke(*words(command, out), "--no-plots", "--quiet")
    assert again.code == 0 and files(out) == {"result.h5", "summary.json"}
    check_whole_or_none(command, out)
