"""What ``equations`` prints for programs (``--json``)."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import ABSENT, ANY, Absent, fact


@record
class EquationSymbol:
    """A name in the equations."""

    symbol: str = fact("as it stands in them")
    name: str = fact("in Python")
    value: float | None = fact("of a number of the scene, in SI units; `null` of other names")
    unit: str = fact("of the value")
    key: str = fact("where the number stands in the scene")
    meaning: str = fact("in words")


@record
class EquationTerm:
    """A matrix or vector of the equations."""

    meaning: str = fact("what it is")
    rows: list[str] = fact("what its rows belong to")
    entries: list[list[str]] = fact("its entries by row, as formulas")


@record
class EquationPart:
    """A name for a part of the equations."""

    symbol: str = fact("the name")
    formula: str = fact("what it stands for, made of earlier names")


@record
class EquationsReport:
    """The equations of motion of a scene."""

    status: str = fact("`ok`")
    title: str = fact("title of the scene")
    form: str = fact("of the formulas: `text`, `latex` or `sympy`")
    expanded: bool = fact("whether they are sums of products of sines and cosines, without names for parts")
    positions: list[str] = fact("the coordinates q")
    rates: list[str] = fact("their rates, or those of the joints where they are no rates of coordinates")
    accelerations: list[str] = fact("rates of the rates")
    torques: list[str] = fact("torques of actuators that the scene does not give, 0 where there are none")
    terms: dict[str, EquationTerm] = fact(
        "those that are there: `M`, `C`, `G`, `tau` (that the scene gives), `F_passive`, `F_friction`, `F_external`, "
        "`F_gear`, `F_stops`, `eta`, `Psi`, `eta_t`, `gamma`, `qdot`",
        names=ANY,
    )
    where: list[EquationPart] = fact("names for parts, of larger models")
    symbols: list[EquationSymbol] = fact("numbers of the scene and other names")
    left_out: list[str] = fact("what acts in the scene and is no part of the equations")
    document: str = fact("all of it as it is printed: text, a LaTeX document, a module of Python")
    file: str | Absent = fact("file that it was written to", default=ABSENT)
