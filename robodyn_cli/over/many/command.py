"""What many runs do: the part of a command that compiled code does, and the command itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.over.many.groups import Built
from robodyn_cli.over.many.keys import Key
from robodyn_cli.over.many.record import ManyRuns
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

Rows = NDArray[np.int64]
Own = TypeVar("Own", bound=Built)


@record
class Asked:
    """What is asked of runs.

    result : takes the rows; its outputs are the keys that are wanted. q, qd : initial states (N, nq), (N, nv) in place
    of the scene's. samples : at how many uniform times values are wanted. threads : that make runs.
    """

    result: ManyRuns
    q: Array | None
    qd: Array | None
    samples: int
    threads: int


class Command(ABC, Generic[Own]):
    """A command for many runs. Without state: one object serves all.

    sampled : columns of what samples hold, ``q`` as positions and all others as rates.
    """

    name: str
    sampled: tuple[str, ...] = ("q", "qd")

    @abstractmethod
    def structure(self, family: Family, keys: Sequence[Key], row: Array) -> Own:
        """Return what serves runs with such a row of values; raises what the command raises for it."""

    @abstractmethod
    def is_plain(self, key: str) -> bool:
        """Tell whether compiled code gives this key of the summary."""

    @abstractmethod
    def make(self, structure: Own, rows: Rows, asked: Asked) -> list[int]:
        """Make runs of one structure in compiled code; return those that are left to be made one by one."""

    @abstractmethod
    def with_samples(self, scene: Scene, samples: int) -> Scene:
        """Return a scene that asks for so many samples."""

    @abstractmethod
    def single(self, scene: Scene) -> Result:
        """Do the command for one scene."""

    @abstractmethod
    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        """Take the end of a run that was made by ``single`` into its row."""
