"""Studies on a Dask cluster: a real scheduler and worker processes, one of which is killed."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from robodyn_cli.over.study import cluster
from robodyn_cli.results.hdf5 import read

distributed = pytest.importorskip("distributed")
ROOT = Path(__file__).parents[2]
PENDULUMS = """
schema: 1
command: simulate
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, parent: base, axis: [0, 0, 1]}
    - {name: b, type: revolute, axis: [0, 1, 1], origin: {xyz: [0.4, 0.1, 0]}}
  links:
    - {name: one, mass: 1.3, com: [0.4, 0.1, 0], inertia: {xx: 0.03, yy: 0.02, zz: 0.04, xy: 0.001}}
    - {name: two, mass: 0.7, com: [0.1, 0.2, 0.05], inertia: {xx: 0.01, yy: 0.02, zz: 0.02, yz: 0.002}}
initial: {q: {a: 20 deg, b: 0.3}}
simulate: {duration: 1, samples: 11, integrator: dopri5}
"""
VARY = ["--vary", "robot.links.one.mass=normal(1.3, 10 %)", "--vary", "initial.q.a=uniform(5 deg, 60 deg)"]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "pendulums.yaml"
    path.write_text(PENDULUMS)
    return path


class Cluster:
    """A scheduler and workers as processes of their own, started as the documentation says."""

    def __init__(self, stack: contextlib.ExitStack, cache: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{port}"
        self._stack, self._cache = stack, cache
        self.scheduler = self.start("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")

    def start(self, what: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", what, *options]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "ROBODYN_CACHE": str(self._cache),
                       "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}  # fmt: skip
        process = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process

    def worker(self) -> subprocess.Popen[bytes]:
        return self.start("worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard")


@pytest.fixture
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A cluster whose processes share compiled code with those of other tests."""
    with contextlib.ExitStack() as stack:
        yield Cluster(stack, tmp_path_factory.getbasetemp() / "code of clusters")


def sweep(*words: object) -> Any:
    return CliRunner().invoke(app, ["sweep", *map(str, words), "--no-plots"])


def same_rows(one: Path, other: Path) -> None:
    a, b = read(one / "result.h5"), read(other / "result.h5")
    assert list(a.variables) == list(b.variables)
    for name in a.variables:
        assert np.array_equal(a[name], b[name], equal_nan=True), name


def remote(dask: Cluster, scene: Path, words: list[Any], out: Path) -> subprocess.Popen[str]:
    """Start a study on the cluster, as a process of its own."""
    command = [sys.executable, "-m", "robodyn_cli", "sweep", str(scene), *map(str, words), "--no-plots",
               "--scheduler", dask.address, "--out", str(out)]  # fmt: skip
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def ended(study: subprocess.Popen[str], code: int) -> str:
    """Return what a study said that has ended, with this exit code."""
    _, errors = study.communicate(timeout=120)
    assert study.returncode == code and "Traceback" not in errors, errors
    return errors


def wait_for_rows(directory: Path) -> None:
    from robodyn_cli.over.study.rows import ROWS_NAME

    limit = time.monotonic() + 60
    while time.monotonic() < limit:
        with contextlib.suppress(OSError):
            if (directory / ROWS_NAME).read_bytes().strip(b"\0"):
                return
        time.sleep(0.01)


COMPILED = [*VARY, "-n", 2500, "--of", "final.q.b"]
WHOLE = [
    *VARY,
    "-n",
    16,
    "--of",
    "error_estimate.at_rounding",
    "--vary",
    "robot.links.two.mass=normal(0.7, 0.5)",
]


def test_workers_and_the_scheduler_come_and_go(scene: Path, tmp_path: Path, dask: Cluster) -> None:
    """Processes take long to start, so one cluster serves: two workers, one of them killed, give the bits of this
    machine; the other compiles a study once; the study goes on here when the scheduler is gone.
    """
    first, _ = dask.worker(), dask.worker()
    with distributed.Client(dask.address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
    here, there, out = tmp_path / "here", tmp_path / "there", tmp_path / "out"
    assert sweep(scene, *COMPILED, "--out", here).exit_code == 0
    study = remote(dask, scene, COMPILED, there)
    wait_for_rows(there)
    first.kill()
    assert "differ" not in ended(study, 0)
    same_rows(here, there)
    assert "2" not in failures(there)
    _compiled_once(scene, tmp_path, dask)

    # whole commands, some of which fail
    assert sweep(scene, *WHOLE, "--out", tmp_path / "whole here").exit_code == 0
    assert "differ" not in ended(remote(dask, scene, WHOLE, tmp_path / "whole there"), 0)
    same_rows(tmp_path / "whole here", tmp_path / "whole there")
    assert "2" in failures(tmp_path / "whole there")

    study = remote(dask, scene, COMPILED, out)
    wait_for_rows(out)
    dask.scheduler.kill()
    assert "does not answer any more" in ended(study, 74)
    done = sweep(scene, *COMPILED, "--out", out)
    assert done.exit_code == 0 and "runs are there from an earlier study" in done.output
    same_rows(here, out)


def failures(directory: Path) -> dict[str, int]:
    found: dict[str, int] = json.loads((directory / "summary.json").read_text())["failures"]
    return found


def _compiled_once(scene: Path, tmp_path: Path, dask: Cluster) -> None:
    """Check that the second of two equal studies finds the code of the first in the one worker."""

    def code() -> list[Any]:
        return list(cluster._code.values())

    def mark() -> int:
        for compiled in code():
            compiled.marked = True
        return len(code())

    words = [*VARY, "-n", 300, "--of", "final.q.b", "--scheduler", dask.address]
    with distributed.Client(dask.address, set_as_default=False) as client:
        assert sweep(scene, *words, "--out", tmp_path / "one").exit_code == 0
        assert list(client.run(mark).values()) == [1]
        assert sweep(scene, *words, "--out", tmp_path / "two").exit_code == 0
        assert list(client.run(lambda: [hasattr(x, "marked") for x in code()]).values()) == [[True]]
    same_rows(tmp_path / "one", tmp_path / "two")


KILLER = """
import os
from robodyn_cli.over.study import runs
from robodyn_cli.over.study.rows import joined

def deadly(task, points):
    if (points.values == 2.0).any():
        os._exit(1)
    made = [runs.make_one(task, int(run), values)[0] for run, values in zip(points.runs, points.values)]
    return joined(made)

runs.make_alone = deadly
"""


def test_the_run_with_which_workers_die_is_a_row(
    scene: Path, tmp_path: Path, dask: Cluster, monkeypatch: Any
) -> None:
    """Workers with a nanny are started again, as users start them."""
    killer = tmp_path / "killer.py"
    killer.write_text(KILLER)
    dask.start("worker", dask.address, "--nthreads", "1", "--no-dashboard", "--preload", str(killer))
    words = [
        "--vary",
        "robot.links.one.mass=linspace(1, 3, 5)",
        "--of",
        "error_estimate.at_rounding",
        "--out",
        tmp_path / "out",
    ]
    done = sweep(scene, *words, "--scheduler", dask.address)
    assert done.exit_code == 0, done.output
    assert read(tmp_path / "out" / "result.h5")["runs/exit_code"].tolist() == [0, 0, 70, 0, 0]
    assert "the process of this run was ended from outside" in done.output


def test_other_processors_are_named() -> None:
    said: list[str] = []
    found = cluster.Cluster("tcp://host:1", said.append)
    found._tell(cluster.Host.own())
    assert not said
    for _ in range(2):
        found._tell(cluster.Host(2, False, "Linux glibc 2.1"))
    (text,) = said
    assert "2 lanes without fused multiply-add, Linux glibc 2.1" in text and "not its rows to the bit" in text


def test_what_is_no_cluster_is_refused(scene: Path, tmp_path: Path, dask: Cluster, monkeypatch: Any) -> None:
    monkeypatch.setattr(cluster, "CONNECT", 0.5)
    words = [scene, *VARY, "-n", 3, "--of", "final.q.b", "--out", tmp_path / "out"]
    for more, part in (
        (["--scheduler", "tcp://127.0.0.1:1"], "no scheduler answers there"),
        (["--scheduler", "nonsense://x"], "no scheduler answers there"),
        (["--scheduler", dask.address, "--jobs", 2], "--jobs: does not go with --scheduler"),
    ):
        done = sweep(*words, *more)
        assert done.exit_code == 2 and part in done.output, done.output
    monkeypatch.setattr(cluster, "CONNECT", 3.0)
    done = sweep(*words, "--scheduler", dask.address)
    assert done.exit_code == 2 and "it has no workers; start one: dask worker tcp://" in done.output, (
        done.output
    )
    monkeypatch.setitem(sys.modules, "distributed", None)
    done = sweep(*words, "--scheduler", dask.address)
    assert done.exit_code == 2 and "pip install 'robodyn[cluster]'" in done.output
