"""What tests of the program begin with."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from robodyn_cli.cli import console
from tests.cli.tool import PENDULUM

DAY = 86400.0


@pytest.fixture(scope="session", autouse=True)
def patience() -> Iterator[None]:
    """Let no run on a slow machine say how long it takes already."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(console, "LONG_SECONDS", DAY)
        yield


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Return the file of a scene that every command can do something with."""
    path = tmp_path / "scene.yaml"
    path.write_text(PENDULUM)
    return path
