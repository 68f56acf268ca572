"""What tests of the program begin with."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.tool import PENDULUM


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Return the file of a scene that every command can do something with."""
    path = tmp_path / "scene.yaml"
    path.write_text(PENDULUM)
    return path
