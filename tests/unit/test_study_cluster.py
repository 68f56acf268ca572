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
def dask(tmp_path: Path) -> Iterator[Cluster]:
    with contextlib.ExitStack() as stack:
        yield Cluster(stack, tmp_path / "cache")


def sweep(*words: object) -> Any:
    return CliRunner().invoke(app, ["sweep", *map(str, words), "--no-plots"])


def same_rows(one: Path, other: Path) -> None:
    a, b = read(one / "result.h5"), read(other / "result.h5")
    assert list(a.variables) == list(b.variables)
    for name in a.variables:
        assert np.array_equal(a[name], b[name], equal_nan=True), name


def test_two_workers_one_of_them_killed_give_the_bits_of_this_machine(
    scene: Path, tmp_path: Path, dask: Cluster
) -> None:
    """Runs in compiled code, and whole commands, some of which fail."""
    workers = [dask.worker(), dask.worker()]
    for name, words in (
        ("compiled", [*VARY, "-n", 2500, "--of", "final.q.b"]),
        (
            "whole",
            [*VARY, "-n", 30, "--of", "energy_drift", "--vary", "robot.links.two.mass=normal(0.7, 0.5)"],
        ),
    ):
        here, there = tmp_path / f"{name} here", tmp_path / f"{name} there"
        assert sweep(scene, *words, "--out", here).exit_code == 0
        command = [sys.executable, "-m", "robodyn_cli", "sweep", str(scene), *map(str, words), "--no-plots",
                   "--scheduler", dask.address, "--out", str(there)]  # fmt: skip
        study = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        if name == "compiled":
            wait_for_rows(there)
            workers[0].kill()
        _, errors = study.communicate(timeout=120)
        assert study.returncode == 0, errors
        assert "Traceback" not in errors and "differ" not in errors
        same_rows(here, there)
        failures = json.loads((there / "summary.json").read_text())["failures"]
        assert ("2" in failures) == (name == "whole")


def test_a_worker_compiles_a_study_once(scene: Path, tmp_path: Path, dask: Cluster) -> None:
    def code() -> list[Any]:
        return list(cluster._code.values())

    def mark() -> int:
        for compiled in code():
            compiled.marked = True
        return len(code())

    dask.worker()
    words = [*VARY, "-n", 300, "--of", "final.q.b", "--scheduler", dask.address]
    with distributed.Client(dask.address, set_as_default=False) as client:
        assert sweep(scene, *words, "--out", tmp_path / "one").exit_code == 0
        assert list(client.run(mark).values()) == [1]
        assert sweep(scene, *words, "--out", tmp_path / "two").exit_code == 0
        assert list(client.run(lambda: [hasattr(x, "marked") for x in code()]).values()) == [[True]]
    same_rows(tmp_path / "one", tmp_path / "two")


def wait_for_rows(directory: Path) -> None:
    from robodyn_cli.over.study.rows import ROWS_NAME

    limit = time.monotonic() + 60
    while time.monotonic() < limit:
        with contextlib.suppress(OSError):
            if any((directory / ROWS_NAME).read_bytes()):
                return
        time.sleep(0.01)


def test_a_study_goes_on_when_the_scheduler_is_gone(scene: Path, tmp_path: Path, dask: Cluster) -> None:
    dask.worker()
    words = [*VARY, "-n", 2500, "--of", "final.q.b"]
    out, here = tmp_path / "out", tmp_path / "here"
    command = [sys.executable, "-m", "robodyn_cli", "sweep", str(scene), *map(str, words), "--no-plots",
               "--scheduler", dask.address, "--out", str(out)]  # fmt: skip
    study = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    wait_for_rows(out)
    dask.scheduler.kill()
    _, errors = study.communicate(timeout=120)
    assert study.returncode == 74 and "does not answer any more" in errors, errors
    assert "Traceback" not in errors
    done = sweep(scene, *words, "--out", out)
    assert done.exit_code == 0 and "runs are there from an earlier study" in done.output
    assert sweep(scene, *words, "--out", here).exit_code == 0
    same_rows(here, out)


KILLER = """
import os
from robodyn_cli.over.study import runs
from robodyn_cli.over.study.row import joined

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
        "energy_drift",
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
        (["--scheduler", dask.address, "--jobs", 2], "--jobs does not go with --scheduler"),
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
