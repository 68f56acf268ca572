"""The equations of motion of a scene file, in the form that was asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from robodyn_cli.scene.load import Family
from robodyn_cli.scene.units import in_joint, unit_of
from robodyn_cli.summaries.equations import EquationPart, EquationsReport, EquationSymbol, EquationTerm
from robodyn_cli.works.equations.latex import LatexForm, latex_of
from robodyn_cli.works.equations.names import Symbol
from robodyn_cli.works.equations.python import SympyForm, sympy_of
from robodyn_cli.works.equations.terms import terms_of
from robodyn_cli.works.equations.text import TextForm, text_of
from robodyn_cli.works.equations.tree import EquationFormula
from robodyn_cli.works.equations.writer import FormWriter
from robodyn_cli.works.equations.written import Written, written

FORMS: dict[str, tuple[type[FormWriter], Callable[[Written], str]]] = {
    "text": (TextForm, text_of),
    "latex": (LatexForm, latex_of),
    "sympy": (SympyForm, sympy_of),
}


def equations(
    path: Path, overrides: Sequence[str] = (), form: str = "text", as_numbers: bool = False
) -> EquationsReport:
    """Return the equations of motion of a scene.

    Parameters
    ----------
    form : one of ``FORMS``. as_numbers : whether numbers of the scene stand for themselves.

    Raises
    ------
    SceneError : the scene is wrong. Others as in ``terms_of``.
    """
    family = Family(path, overrides)
    w = written_of(family, as_numbers)
    kind, document = FORMS[form]
    writer = kind()

    def formula(x: EquationFormula) -> str:
        return writer.plain(writer.formula(x))

    def symbols(some: Sequence[Symbol]) -> list[str]:
        return [writer.symbol(s) for s in some]

    return EquationsReport(
        status="ok",
        title=w.title,
        form=form,
        expanded=w.expanded,
        positions=symbols(w.positions),
        rates=symbols(w.rates),
        accelerations=symbols(w.accelerations),
        torques=[formula(x) for x in w.unknown],
        terms={
            x.term.name: EquationTerm(
                x.term.meaning, list(x.term.rows), [[formula(entry) for entry in row] for row in x.rows]
            )
            for x in w.terms
        },
        where=[EquationPart(writer.symbol(s), formula(x)) for s, x in w.where],
        symbols=[
            EquationSymbol(writer.symbol(s), s.key, s.value, s.unit, s.place, s.meaning) for s in w.legend
        ],
        left_out=list(w.source.notes),
        document=document(w),
    )


def written_of(family: Family, as_numbers: bool = False) -> Written:
    """Return the equations of motion of a family's own scene as formulas."""
    scene = family.own
    terms = terms_of(scene)
    model = terms.problem.model
    joint_units = dict(zip(model.v_names, model.v_units))

    def unit(key: str) -> str:
        return in_joint(unit_of(family.root, key), key, joint_units)

    return written(scene.title or Path(scene.path).stem, terms, unit, as_numbers)
