"""What stands in the place of an output directory where results stay in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robodyn_cli.results.output_dir import RESULT_NAME, OutputDirectory


class InMemory:
    """Stands for the output directory of a run whose result stays in memory.

    What a run must have on the disk meanwhile, as the rows of a study, lies in a temporary folder until the end.
    """

    lasts = False
    warning = None
    outputs: Sequence[str] = ()
    run_id = ""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    @property
    def path(self) -> Path:
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="robodyn-")
        return Path(self._folder.name)

    new = path

    @property
    def result_path(self) -> Path:
        return self.path / RESULT_NAME

    def other_scene(self) -> Path | None:
        """There are no other results."""
        return None

    def __enter__(self) -> InMemory:
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the folder."""
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def replace_old(self, summary: Mapping[str, Any]) -> None:
        """There are no old files."""


Output = OutputDirectory | InMemory
