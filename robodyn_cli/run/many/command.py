"""What many runs do: the part of a command that compiled code does, and the command itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.results.result import Result
from robodyn_cli.run.driver.motion import Motion
from robodyn_cli.run.many.integrate import Batch, Driven
from robodyn_cli.run.many.record import ManyRuns
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

Rows = NDArray[np.int64]


class Command(ABC):
    """A command for many runs. Without state: one object serves all."""

    name: str

    @abstractmethod
    def build(self, scene: Scene) -> Motion:
        """Return the motion of a scene; raises what the command raises for it."""

    def obstacle(self, motion: Motion) -> str:
        """Return why runs of a motion are made one by one, beside what holds for all commands; nothing if not."""
        return ""

    @abstractmethod
    def is_plain(self, key: str) -> bool:
        """Tell whether ``output`` gives this key of the summary."""

    @abstractmethod
    def drive(self, batch: Batch, method: str, samples: int) -> Driven:
        """Make the runs of a batch."""

    @abstractmethod
    def output(self, key: str, result: ManyRuns, rows: Rows) -> Array:
        """Return a plain key of the summary for rows whose ends are in the result."""

    @abstractmethod
    def error_of(self, key: str, result: ManyRuns, rows: Rows) -> Array | float:
        """Return the estimated error of a key for such rows, nan where there is none."""

    @abstractmethod
    def single(self, scene: Scene) -> Result:
        """Do the command for one scene."""

    @abstractmethod
    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        """Take the end of a run that was made by ``single`` into its row."""


def column_of(result: ManyRuns, group: str, name: str, rows: Rows) -> Array:
    """Return a position or a rate (``q``, ``theta1``) of rows, nan where there is none of that name."""
    names = result.q_names if group == "q" else result.qd_names
    if name not in names:
        return np.full(len(rows), np.nan)
    found: Array = getattr(result, group)[rows, names.index(name)]
    return found
