"""What families of arms with a closed form have in common."""

from __future__ import annotations

from typing import Protocol

from robodyn_cli.record import record
from robodyn_cli.solve.poses.screws import Screws
from robodyn_cli.spatial.algebra import Array


@record
class Branch:
    """One way to reach targets: its name, a word for each choice, and values (T, k) of the axes in their order.

    A target that is out of reach has the values of a pose near it.
    """

    name: tuple[str, ...]
    values: Array


class Family(Protocol):
    """Arms of one structure. words : for each choice, the words of its two sides; axes : of the arm."""

    @property
    def words(self) -> tuple[tuple[str, str], ...]: ...

    @property
    def screws(self) -> Screws: ...

    def branches(self, p: Array, R: Array) -> list[Branch]:
        """Return all ways to reach targets p (T, 3) and R (T, 3, 3) in base coordinates, R as a turn from zero."""
        ...
