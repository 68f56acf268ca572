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
_ANY = ("sign", "step")  # functions of values of any kind; those of angles and plain numbers are all others
_MOST_KINDS = 16  # that a product of many times may be of
_TIME = units.table()["s"].dims


@record
class FormulaQuantity:
    """The kind of a value, as powers of the bases.

    kinds : those that it may be of, its own first; none where it is not known. stated : whether a unit in the formula
    tells it. scaled : whether a number with a unit is a factor of it, so that other factors need none. named : whether
    names are part of it.
    """

    kinds: tuple[units.Dims, ...] = ()
    stated: bool = False
    scaled: bool = False
    named: bool = True

    @property
    def is_free(self) -> bool:
        """Whether it may stand beside any other: a plain number, or one of which nothing is known."""
        return not self.kinds or (not self.stated and self.kinds == (units.PLAIN,))

    def fits(self, dims: units.Dims) -> bool:
        """Tell whether it may be of a kind; the angle in the length of an arc, r theta, is written nowhere."""
        is_number = not self.scaled and units.PLAIN in self.kinds
        return not self.stated or is_number or any(units.alike(kind, dims) for kind in self.kinds)

    def plus(self, other: FormulaQuantity) -> FormulaQuantity:
        """Return the kind of a sum; of values that are compared, too.

        Raises
        ------
        SceneError : the kinds differ, and a unit says so.
        """
        named = self.named or other.named
        if self.is_free or other.is_free:
            return dataclasses.replace(other if self.is_free else self, named=named)
        stated, scaled = self.stated or other.stated, self.scaled and other.scaled
        mine, theirs = (x.kinds if x.scaled else x.kinds[:1] for x in (self, other))
        common = [kind for kind in mine if kind in theirs]
        if common:
            # t - 2 s may be meant as a plain number where t may
            common += [kind for kind in (*self.kinds, *other.kinds) if kind == units.PLAIN and not scaled]
            return FormulaQuantity(tuple(dict.fromkeys(common)), stated, scaled, named)
        if stated and not (named and any(units.alike(a, b) for a in mine for b in theirs)):
            units.combined("+", mine[0], theirs[0])
        return FormulaQuantity()

    def times(self, other: FormulaQuantity, op: str = "*") -> FormulaQuantity:
        """Return the kind of a product or quotient.

        ``30 deg * tip.x`` may be meant a metre, and ``2*tip.x`` may be anything.
        """
        named, scaled = self.named or other.named, self.scaled or other.scaled
        if not self.kinds or not other.kinds or (named and not scaled):
            return FormulaQuantity()
        products = [units.combined(op, a, b) or units.PLAIN for a in self.kinds for b in other.kinds]
        for one, beside in ((self, other), (other, self)):
            if not one.stated and all(units.alike(kind, units.PLAIN) for kind in beside.kinds):
                products += beside.kinds
        kinds = tuple(dict.fromkeys(products))
        return FormulaQuantity(kinds if len(kinds) < _MOST_KINDS else (), scaled, scaled, named)

    def to_the(self, power: float, of_what: str) -> FormulaQuantity:
        """Return the kind of a power; SceneError where a stated one has none, as sqrt(2 m)."""
        kinds = []
        for kind in self.kinds:
            try:
                kinds.append(units.raised(kind, power, of_what) or units.PLAIN)
            except SceneError:
                if self.stated and not self.named:
                    raise
        return dataclasses.replace(self, kinds=tuple(kinds))

    def of_function(self, name: str) -> FormulaQuantity:
        """Return the kind of a function such as the sine.

        Raises
        ------
        SceneError : it is asked of a length.
        """
        needs_number = name not in _ANY and self.scaled and bool(self.kinds)
        if needs_number and not any(units.alike(kind, units.PLAIN) for kind in self.kinds):
            raise SceneError(
                f"{name} takes a number or an angle, not a quantity in {units.written(self.kinds[0])}"
            )
        return FormulaQuantity((units.PLAIN,), named=self.named)


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
            (node.unit or units.PLAIN,), node.unit is not None, node.unit is not None, named=False
        )
    if isinstance(node, tree.Identifier):
        dims = names.get(node.name)
        # 5 N m * t is meant a second
        return FormulaQuantity(() if dims is None else (dims, units.PLAIN) if dims == _TIME else (dims,))
    if isinstance(node, tree.Negative):
        return inner(node.operand)
    if isinstance(node, tree.Chain):
        kind = inner(node.first)
        for op, other in node.rest:
            kind = kind.plus(inner(other)) if op in "+-" else kind.times(inner(other), op)
        return kind
    if isinstance(node, tree.Power):
        base, exponent = inner(node.base), node.exponent
        inner(exponent).of_function("^")
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
    if node.function == "atan2":
        return kinds[0].plus(kinds[1]).of_function("sign")
    return kinds[0].of_function(node.function)
