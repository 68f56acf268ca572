"""What kind of quantity a formula is, as far as the units of its numbers and what is known of its names say.

A number without a unit may be of any kind: in ``2*tip.x`` it may be a stiffness. So only quantities of which a unit in
the formula tells the kind are held to others: ``tip.x - 5 s`` is refused, ``q.arm + qd.arm`` is not.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping

from robodyn_cli.errors import SceneError
from robodyn_cli.expr import formula_tree as tree
from robodyn_cli.expr import units
from robodyn_cli.record import record

_KEEPING = ("abs", "min", "max")  # functions whose values are of the kind of their arguments
_TIME = units.table()["s"].dims


@record
class FormulaQuantity:
    """The kind of a value, as powers of the bases.

    dims : None where it is not known. stated : whether a unit in the formula tells it. scaled : whether a number with a
    unit is a factor of it, so that other factors need none. named : whether names are part of it.
    """

    dims: units.Dims | None = None
    stated: bool = False
    scaled: bool = False
    named: bool = True

    @property
    def is_free(self) -> bool:
        """Whether it may stand beside any other: a plain number, or one of which nothing is known."""
        return self.dims is None or (not self.stated and self.dims == units.PLAIN)

    def plus(self, other: FormulaQuantity) -> FormulaQuantity:
        """Return the kind of a sum; of values that are compared, too.

        Raises
        ------
        SceneError : the kinds differ, and a unit says so.
        """
        named = self.named or other.named
        if self.is_free or other.is_free:
            return dataclasses.replace(other if self.is_free else self, named=named)
        assert self.dims is not None and other.dims is not None
        if self.dims == other.dims:
            return FormulaQuantity(
                self.dims, self.stated or other.stated, self.scaled and other.scaled, named
            )
        # the angle in the length of an arc, r theta, is written nowhere
        if (named and units.alike(self.dims, other.dims)) or not (self.stated or other.stated):
            return FormulaQuantity()
        return FormulaQuantity(units.combined("+", self.dims, other.dims))

    def times(self, other: FormulaQuantity, op: str = "*") -> FormulaQuantity:
        """Return the kind of a product or quotient.

        ``5 N m * t`` and ``30 deg * tip.x`` are meant a second and a metre, as ``2*tip.x`` may be: unknown.
        """
        named, scaled = self.named or other.named, self.scaled or other.scaled
        if self.dims is None or other.dims is None or (named and not scaled):
            return FormulaQuantity()
        for one, beside in ((self, other), (other, self)):
            assert beside.dims is not None
            is_angle = units.alike(beside.dims, units.PLAIN)
            if not one.stated and one.dims != units.PLAIN and (is_angle or one.dims == _TIME):
                return FormulaQuantity()
        return FormulaQuantity(units.combined(op, self.dims, other.dims), scaled, scaled, named)

    def to_the(self, power: float, of_what: str) -> FormulaQuantity:
        """Return the kind of a power; SceneError where a stated one has none, as sqrt(2 m)."""
        try:
            return FormulaQuantity(
                units.raised(self.dims, power, of_what), self.stated, self.scaled, self.named
            )
        except SceneError:
            if self.stated and not self.named:
                raise
            return FormulaQuantity()


_BY_GROUP = {"q": "", "ref": "", "qd": "/s", "refd": "/s", "refdd": "/s^2"}


def unit_of_name(name: str, coordinates: Mapping[str, str]) -> str:
    """Return the unit of a canonical name of a formula, empty where it is not known.

    coordinates : ``rad`` or ``m`` by column of q or v.
    """
    function, of_points, _ = name.partition("(")
    if of_points:
        rate = (tree.AXES.get(function) or tree.OF_POINTS[function][1]) == "qd"
        return "rad" if function == "angle" else "m/s" if rate else "m"
    group, _, column = name.partition(".")
    own = coordinates.get(column, "")
    if own and group in _BY_GROUP:
        return own + _BY_GROUP[group] if own != "1" else ""
    return {"t": "s", "length": "m", "rate": "m/s"}.get(name, "")


def quantity_of(node: tree.FormulaNode, names: Mapping[str, units.Dims]) -> FormulaQuantity:
    """Return the kind of a formula from those of its canonical names, as far as these are known.

    Raises
    ------
    SceneError : lengths and masses do not add up.
    """
    inner = functools.partial(quantity_of, names=names)
    if isinstance(node, tree.Num):
        return FormulaQuantity(
            node.unit or units.PLAIN, node.unit is not None, node.unit is not None, named=False
        )
    if isinstance(node, tree.Identifier):
        return FormulaQuantity(names.get(node.name))
    if isinstance(node, tree.Negative):
        return inner(node.operand)
    if isinstance(node, tree.Chain):
        kind = inner(node.first)
        for op, other in node.rest:
            kind = kind.plus(inner(other)) if op in "+-" else kind.times(inner(other), op)
        return kind
    if isinstance(node, tree.Power):
        base, exponent = inner(node.base), node.exponent
        inner(exponent)
        if isinstance(exponent, tree.Num):
            return base.to_the(exponent.number, "^")
        return base if base.is_free else FormulaQuantity()
    if isinstance(node, tree.If):
        inner(node.left).plus(inner(node.right))
        return inner(node.yes).plus(inner(node.no))
    assert isinstance(node, tree.Call)
    kinds = [inner(argument) for argument in node.arguments]
    if node.function == "sqrt":
        return kinds[0].to_the(0.5, "sqrt")
    if node.function in _KEEPING:
        return functools.reduce(FormulaQuantity.plus, kinds)
    return FormulaQuantity(units.PLAIN, named=any(kind.named for kind in kinds))
