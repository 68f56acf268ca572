"""The equations of motion of a scene as formulas with names."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.works.equations.expand import ExpandedFormulas, TooLong
from robodyn_cli.works.equations.names import Symbol, SymbolNames
from robodyn_cli.works.equations.terms import FORCES, MotionTerm, Terms
from robodyn_cli.works.equations.tree import EquationFormula, Temporaries, name, symbols_of

MOST_EXPANDED = 3  # joints


@record
class WrittenTerm:
    """One matrix or vector: its entries by row, and one list of columns for each."""

    term: MotionTerm
    rows: tuple[tuple[EquationFormula, ...], ...]

    @property
    def is_matrix(self) -> bool:
        return self.term.entries.ndim == 2


@record
class Written:
    """Equations as formulas.

    where : names for parts of them, each made of earlier ones; none where they are expanded. unknown : torques of
    actuators that the scene does not give (nv,), zero where there is none. names : what inputs of the graph are called.
    """

    title: str
    source: Terms
    terms: tuple[WrittenTerm, ...]
    where: tuple[tuple[Symbol, EquationFormula], ...]
    expanded: bool
    positions: tuple[Symbol, ...]
    rates: tuple[Symbol, ...]
    accelerations: tuple[Symbol, ...]
    unknown: tuple[EquationFormula, ...]
    multipliers: tuple[Symbol, ...]
    names: SymbolNames

    @property
    def inputs(self) -> dict[str, Symbol]:
        """All symbols that the formulas hold, but for temporaries, by key."""
        found = symbols_of(self._formulas())
        for symbol, _ in self.where:
            found.pop(symbol.key, None)
        return found

    @property
    def legend(self) -> list[Symbol]:
        """The symbols that need to be explained: numbers of the scene, switches, torques."""
        motion = {s.key for s in (*self.positions, *self.rates, *self.accelerations)}
        return [s for key, s in self.inputs.items() if key not in motion]

    def _formulas(self) -> Iterator[EquationFormula]:
        for term in self.terms:
            for row in term.rows:
                yield from row
        for _, formula in self.where:
            yield formula
        yield from self.unknown

    def term(self, wanted: str) -> WrittenTerm | None:
        return next((x for x in self.terms if x.term.name == wanted), None)

    @property
    def forces(self) -> list[str]:
        """The kinds of forces that act."""
        return [x for x in FORCES if self.term(f"F_{x}") is not None]


def written(title: str, terms: Terms, unit_of: Callable[[str], str], as_numbers: bool = False) -> Written:
    """Return the equations as formulas: expanded up to three joints, with temporaries beyond, or where they would
    be too long.

    unit_of : unit of the key of a number. as_numbers : whether numbers of the scene stand for themselves.
    """
    problem = terms.problem
    outputs = {x.name: list(x.entries.flat) for x in terms.terms}

    def names() -> SymbolNames:
        made = SymbolNames(problem.model, [float(x) for x in problem.scene.gravity], unit_of, as_numbers)
        for order, group in enumerate((problem.q, problem.v, problem.a)):
            for k, x in enumerate(group):
                made.symbol(*x.value) if order == 0 else made.rate(k, order)
        return made

    made: Any = None
    if len(problem.model.bodies) <= MOST_EXPANDED:
        try:
            made = ExpandedFormulas(names(), outputs)
        except TooLong:
            made = None
    expanded = made is not None
    made = made or Temporaries(names(), outputs)
    own = made.names
    rows = problem.constraints.names
    return Written(
        title=title,
        source=terms,
        terms=tuple(WrittenTerm(x, _rows(x, made.formulas[x.name])) for x in terms.terms),
        where=tuple(made.where),
        expanded=expanded,
        positions=tuple(own.symbol(*x.value) for x in problem.q),
        rates=tuple(own.rate(k, 1) for k in range(problem.model.nv)),
        accelerations=tuple(own.rate(k, 2) for k in range(problem.model.nv)),
        unknown=tuple(
            name(own.torque(k)) if k in terms.asked else EquationFormula("number", (), 0.0)
            for k in range(problem.model.nv)
        ),
        multipliers=tuple(own.multiplier(k, row) for k, row in enumerate(rows)),
        names=own,
    )


def _rows(term: MotionTerm, entries: list[EquationFormula]) -> tuple[tuple[EquationFormula, ...], ...]:
    columns = term.entries.shape[1] if term.entries.ndim == 2 else 1
    return tuple(tuple(entries[k : k + columns]) for k in range(0, len(entries), columns))
