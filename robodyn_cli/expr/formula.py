"""Formulas of the YAML: text to a small immutable tree, evaluated on numbers, arrays or graph expressions."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from robodyn_cli.errors import NumericalError, SceneError, did_you_mean, shown
from robodyn_cli.expr.formula_tree import (
    AXES,
    CONSTANTS,
    OF_POINTS,
    QUALIFIERS,
    FormulaNode,
    Identifier,
    Num,
    fail,
)
from robodyn_cli.expr.graph import Expr
from robodyn_cli.record import record

if TYPE_CHECKING:
    from robodyn_cli.expr.units import Dims

MAX_LENGTH = 10_000

# words that cannot name a joint or a parameter: they would change the meaning of a formula
RESERVED = frozenset({"t", "deg", "if", *CONSTANTS})
# what a force between two points may depend on by these names
OWN = ("length", "rate")


@record
class FormulaTree:
    """A parsed formula; equal when the trees are equal.

    text : as written.
    names : free identifiers with the column of their first use; canonical (``t``, ``q.NAME``, ``qd.NAME``,
        ``p.NAME``, ``length(A, B)``, ``x(A)`` for ``A.x``) after ``resolve``.
    unit_words : words of units in it, with the column of their first use. where : what an error says of its place.
    """

    root: FormulaNode
    text: str = dataclasses.field(compare=False)
    columns: Mapping[str, int] = dataclasses.field(default_factory=dict, compare=False, repr=False)
    unit_words: Mapping[str, int] = dataclasses.field(default_factory=dict, compare=False, repr=False)
    where: Mapping[str, Any] = dataclasses.field(default_factory=dict, compare=False, repr=False)

    @staticmethod
    def number(value: float) -> FormulaTree:
        """Return the constant formula."""
        return FormulaTree(Num(float(value)), repr(float(value)))

    @property
    def names(self) -> frozenset[str]:
        """Free identifiers."""
        return frozenset(self.columns)

    @property
    def constant(self) -> float | None:
        """The value, where it depends on nothing."""
        return self.root.number if isinstance(self.root, Num) else None

    @property
    def dims(self) -> Dims | None:
        """The unit of a constant, as powers of the bases; None where it was written without one."""
        return self.root.unit if isinstance(self.root, Num) else None

    def evaluate(self, env: Mapping[str, Any]) -> Any:
        """Return the value with ``env`` giving each name a float, an array or a graph expression.

        Raises
        ------
        NumericalError : the value is not defined there (division by zero, log of a negative number).
        """
        try:
            return self.root.value(env)
        except (ArithmeticError, ValueError) as error:
            if any(isinstance(env.get(name), Expr) for name in self.columns) and isinstance(
                error, ValueError
            ):
                raise
            at = ", ".join(f"{name} = {env[name]!r}" for name in sorted(self.columns))
            raise NumericalError(
                f"formula {shown(self.text)} has no value at {at}: {error}", **self.where
            ) from error

    def resolve(
        self,
        joints: Collection[str],
        parameters: Collection[str] = (),
        variables: Collection[str] = ("t", "q", "qd"),
        rates: Collection[str] | None = None,
        states: Collection[str] = (),
    ) -> FormulaTree:
        """Return the formula with canonical names: ``t``, ``q.JOINT``, ``qd.JOINT``, ``p.PARAMETER``.

        ``joints`` are the columns of q (``ball.qw`` is one), ``rates`` those of v where they differ, ``states`` those
        of a controller (``s.NAME``); its reference is ``ref.JOINT``, ``refd.JOINT``, ``refdd.JOINT``.

        Raises
        ------
        SceneError : a name that is unknown, or not among ``variables``.
        """
        self._refuse_clashes(parameters, "parameter")
        self._refuse_clashes(joints, "joint")
        canonical = {name: name for name in self.columns if _is_own(name, variables)}
        rates = joints if rates is None else rates
        known = {"p": parameters, "q": joints, "qd": rates, "s": states}
        known |= {"ref": joints, "refd": rates, "refdd": rates, "tau": rates}
        for name, column in self.columns.items():
            if name in canonical:
                continue
            if name.endswith(")"):
                fail(
                    self.text,
                    column,
                    f"{_as_written(name)!r} is not allowed here; allowed: {_listed([*variables])}",
                    self.where,
                )
            group, dot, rest = name.partition(".")
            if name == "t" or (dot and rest in known[group]):
                canonical[name] = name
            elif name in parameters:
                canonical[name] = f"p.{name}"
            elif name in joints:
                canonical[name] = f"q.{name}"
            if name in canonical and canonical[name].partition(".")[0] in (*variables, "p"):
                continue
            options = [x for x in ("t",) if x in variables] + [*parameters]
            options += [f"{x}.{name}" for x in QUALIFIERS if x in variables for name in known[x]]
            fault = f"{name!r} is not allowed here" if name in canonical else f"unknown name {name!r}"
            hint = did_you_mean(name, [*options, *(joints if "q" in variables else ())])
            fail(self.text, column, f"{fault}{hint}; allowed: {_listed(options)}", self.where)

        def renamed(node: FormulaNode) -> FormulaNode:
            return Identifier(canonical.get(node.name, node.name)) if isinstance(node, Identifier) else node

        return dataclasses.replace(
            self,
            root=self.root.rebuilt(renamed),
            columns={canonical[name]: column for name, column in self.columns.items()},
        )

    def _refuse_clashes(self, names: Collection[str], kind: str) -> None:
        """Refuse a unit whose word names something of a kind, too."""
        for word, column in self.unit_words.items():
            if word in names:
                clash = f"{word!r} is a unit here, and the name of a {kind}"
                fail(self.text, column, f"{clash}; write '*' or '/ (' for the {kind}", self.where)


def _is_own(name: str, variables: Collection[str]) -> bool:
    """Tell whether a name is a function of points, or a variable of a force, that a formula may contain."""
    if name.endswith(")"):
        function = name.partition("(")[0]
        return (AXES[function] if function in AXES else OF_POINTS[function][1]) in variables
    return name in OWN and name in variables


def points_of(name: str) -> tuple[str, ...]:
    """Return the points of ``length(A, B)``, ``x(A)``; none of other names."""
    return tuple(name.partition("(")[2].removesuffix(")").split(", ")) if name.endswith(")") else ()


def _as_written(name: str) -> str:
    """Return ``A.x`` for the name ``x(A)``, others as they are."""
    axis, _, point = name.removesuffix(")").partition("(")
    return f"{point}.{axis}" if axis in AXES and point else name


def parse(text: str) -> FormulaTree:
    """Parse a formula.

    Parameters
    ----------
    text : the formula.

    Raises
    ------
    SceneError : naming the text, the column and what was unexpected there.
    """
    from robodyn_cli.expr.formula_parser import Parser  # a scene of plain numbers needs none

    if len(text) > MAX_LENGTH:
        raise SceneError(f"formula of {len(text)} characters; allowed: at most {MAX_LENGTH}")
    parser = Parser(text)
    root = parser.whole()
    return FormulaTree(root, text, parser.names, parser.units)


def formulas_in(value: Any) -> Iterator[FormulaTree]:
    """Yield the formulas in records, maps and lists."""
    return (formula for _, formula in formulas_at(value))


def formulas_at(
    value: Any, path: tuple[str | int, ...] = ()
) -> Iterator[tuple[tuple[str | int, ...], FormulaTree]]:
    """Yield the formulas in records, maps and lists, with the keys that lead to them."""
    if isinstance(value, FormulaTree):
        yield path, value
        return
    inner: Iterable[tuple[str | int, Any]] = ()
    if isinstance(value, Mapping):
        inner = value.items()
    elif isinstance(value, (list, tuple)):
        inner = enumerate(value)
    elif dataclasses.is_dataclass(value):
        inner = (
            (f.metadata.get("name") or f.name, getattr(value, f.name)) for f in dataclasses.fields(value)
        )
    for key, entry in inner:
        yield from formulas_at(entry, (*path, key))


def _listed(names: list[str]) -> str:
    if not names:
        return "numbers only"
    return ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
