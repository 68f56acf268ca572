"""Derivatives of the numbers of a scene by its keys.

A ``Fixed`` remembers how it was computed, so its derivative follows by the chain rule from the rules of ``calculus``.
It is made of such numbers again: code of derivatives serves other values of the keys too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.calculus import SparseRow, rules
from robodyn_cli.expr.fixed import Fixed
from robodyn_cli.expr.graph import is_nonzero


class ByKeys:
    """d number / d place for places in the scene, as sparse rows {column: derivative}.

    Parameters
    ----------
    columns : of the places, such as ``robot.links.link1.mass``.

    Raises
    ------
    CapabilityError : on use, where a number follows from a place by a function without a derivative (base inertial
        parameters).
    """

    def __init__(self, columns: Mapping[str, int]) -> None:
        self.columns = dict(columns)
        self._known: dict[
            int, tuple[Any, SparseRow]
        ] = {}  # by identity, with the number, so that it stays its own

    def __call__(self, x: float) -> SparseRow:
        """Return the derivatives of one number."""
        if not isinstance(x, Fixed):
            return {}
        if x.op == "literal":
            column = self.columns.get(x.args[0])
            return {} if column is None else {column: 1.0}
        known = self._known.get(id(x))
        if known is None:
            known = self._known[id(x)] = x, self._of(x)
        return known[1]

    def _of(self, x: Fixed) -> SparseRow:
        if x.op == "entry":
            if any(self(y) for y in x.args[0]):
                raise CapabilityError("a base inertial parameter has no derivative by its numbers")
            return {}
        inner = [self(a) for a in x.args]
        found: SparseRow = {}
        if not any(inner):
            return found
        for k, partial in rules(x.op, x.args, x):
            for column, entry in inner[k].items():
                found[column] = found.get(column, 0.0) + partial * entry
        return {column: e for column, e in found.items() if is_nonzero(e)}
