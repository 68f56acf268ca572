"""Small scenes for batches, and a way to run them as a user would."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from robodyn_cli.over.batch.entries import BatchEntry, listed, load

ROOT = Path(__file__).parents[2]

ARM = """\
schema: 1
title: Pendulum
{command}
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints: [{{name: swing, type: revolute, a: 0.5}}]
  links: [{{name: rod, mass: 1.2, com: [0.25, 0, 0], com_frame: joint, inertia: {{zz: 0.025}}}}]
trajectory: {{type: joint, duration: {duration}, q: {{swing: "{motion}"}}}}
inverse: {{samples: {samples}}}
{rest}
"""


def arm(
    path: Path,
    rest: str = "",
    motion: str = "sin(t)",
    command: str = "command: inverse",
    samples: int = 21,
    duration: float = 2,
) -> Path:
    """Write a scene that runs in no time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        ARM.format(rest=rest, motion=motion, command=command, samples=samples, duration=duration),
        encoding="utf-8",
    )
    return path


def loaded(paths: Sequence[Path], out: Path) -> list[BatchEntry]:
    """Return the scenes of a batch, loaded."""
    found = listed(paths)
    load(found, out)
    return found


def words(command: str, *rest: object) -> list[str]:
    return [sys.executable, "-m", "robodyn_cli", command, *map(str, rest)]


def robodyn(command: str, *rest: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words(command, *rest), capture_output=True, text=True, cwd=cwd, timeout=120)


def run(*rest: object) -> tuple[int, dict[str, Any]]:
    """Run a batch without drawings; return its exit code and report by the names of the scenes."""
    done = CliRunner().invoke(app, ["run", *map(str, rest), "--no-plots", "--json"])
    report = json.loads(done.stdout)
    assert report.get("exit_code", done.exit_code) == done.exit_code
    return done.exit_code, {scene["name"]: scene for scene in report.get("scenes", [])}
