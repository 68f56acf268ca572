"""The command line as a user meets it: in this process where that is the same, else in one of its own."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from robodyn_cli.cli.app import app

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"
COMMAND = [sys.executable, "-m", "robodyn_cli"]

PENDULUM = """\
schema: 1
title: Pendulum
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: j1, type: revolute, a: 1.0, alpha: 0, d: 0}
    - {name: j2, type: revolute, a: 1.0, alpha: 0, d: 0}
  links:
    - {name: l1, mass: 1, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
    - {name: l2, mass: 1, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
  points: {tip: {link: l2, at: end}}
initial: {q: {j1: -1, j2: 0.3}}
simulate: {duration: 1, samples: 11}
"""


@dataclasses.dataclass
class Done:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def data(self) -> Any:
        """Standard output as the one JSON document that it must be."""
        return json.loads(self.out)


def invoke(*words: str | Path) -> Done:
    """Run a command in this process."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return Done(result.exit_code, result.stdout, result.stderr)


def environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


def start(*words: str | Path, cwd: Path | None = None, **more: Any) -> subprocess.Popen[str]:
    """Start a command in a process of its own."""
    more.setdefault("stdout", subprocess.PIPE)
    more.setdefault("stderr", subprocess.PIPE)
    more.setdefault("env", environment())
    return subprocess.Popen([*COMMAND, *map(str, words)], cwd=cwd, text=True, **more)


def run(*words: str | Path, cwd: Path | None = None, **more: Any) -> Done:
    """Run a command in a process of its own."""
    process = start(*words, cwd=cwd, **more)
    out, err = process.communicate(timeout=120)
    return Done(process.returncode, out or "", err or "")


def files(directory: Path) -> set[str]:
    """Return the names in a directory, but for the lock."""
    return {path.name for path in directory.iterdir()} - {".lock"}
