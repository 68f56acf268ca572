"""Expressions as rounding might make them, staged: the equations of ``observe/rounding.py`` as code for elsewhere.

Each result is multiplied by a factor, which is an input; with factors of 1 the outputs are as they are. Numbers of the
scene are computed from the keys in the same code, so that their rounding counts too.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.expr.fixed import Fixed, places
from robodyn_cli.expr.graph import Expr, Graph, Scalar
from robodyn_cli.expr.many import Recipe
from robodyn_cli.expr.rebuild import apply
from robodyn_cli.observe.rounding import PATTERNS, Rounded, RoundedNumbers
from robodyn_cli.over.live.code import behind_python

GIVEN, FACTORS = "given", "factors"  # groups of symbols: values of keys, and what results are multiplied by


class StagedNumbers(RoundedNumbers):
    """Numbers of a graph as expressions of the keys.

    given : symbols of the keys, by place in the scene.
    """

    def __init__(self, recipe: Recipe, given: Mapping[str, Expr], factors: Any) -> None:
        super().__init__(None, factors)
        self.recipe, self.given = recipe, given

    def _given(self, x: Fixed) -> Any:
        if x.op == "literal":
            return self.given.get(x.args[0], float(x))
        if self.recipe.varies(x):
            raise behind_python(place for place in places([x]) if place in self.given)
        return float(x)

    def apply(self, node: Expr, args: Sequence[Any]) -> Any:
        return apply(node, args)


def staged(rounded: Rounded, sizes: Mapping[str, int], recipe: Recipe, places: Sequence[str]) -> list[Scalar]:
    """Return the outputs as expressions of symbols in the same groups, of the keys (``given``) and of ``factors``.

    Parameters
    ----------
    sizes : of the groups. places : of the keys, in their order.

    Raises
    ------
    CapabilityError : a number follows from a key in Python.
    """
    graph = Graph()
    symbols = {group: graph.symbols([f"{group}{k}" for k in range(n)], group) for group, n in sizes.items()}
    given = dict(zip(places, graph.symbols(list(places), GIVEN)))
    factors = itertools.cycle(graph.symbols([f"factor{k}" for k in range(PATTERNS)], FACTORS))
    numbers = StagedNumbers(recipe, given, factors)
    return rounded.made(lambda group, position: symbols[group][position], numbers, factors)
