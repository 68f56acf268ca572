"""The summary of ``optimise``: the values that were found, and what is known of them."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import ABSENT, ANY, OUTPUT, Absent, fact
from robodyn_cli.summaries.study import BESIDE, OF_KEY


@record
class FoundKey:
    """A key at the optimum."""

    value: float = fact("its value", BESIDE, errors=(".uncertainty",))
    unit: str = fact("its unit; empty where it is not known, as in a formula")
    uncertainty: float | None = fact(
        "how far the value may be off, to first order: what the errors of outputs and derivatives, and what is left of "
        "the conditions of the optimum, change it by; `null` where nothing determines it, or the run states no "
        "error of an output on which it depends; 0 at a bound that holds it",
        BESIDE,
    )
    low: float | Absent = fact("lower bound", BESIDE, default=ABSENT)
    high: float | Absent = fact("upper bound", BESIDE, default=ABSENT)
    choices: str | Absent = fact("the values that it may take, where it has no bounds", default=ABSENT)
    bounds: str | Absent = fact("its bounds as they are written, with their unit", default=ABSENT)
    at: str | Absent = fact("`lower bound` or `upper bound`, where it is at one", default=ABSENT)
    price: float | Absent = fact(
        "change of the goal as the bound that holds it moves by one unit of the key",
        "unit of the goal over that of the key", errors=(".price_error",), default=ABSENT,
    )  # fmt: skip
    price_error: float | Absent = fact("its error", "unit of the goal over that of the key", default=ABSENT)
    curvature: float | Absent | None = fact(
        "second derivative of the goal by the key, with its share in active constraints; `null` where it is not known",
        "unit of the goal over that of the key squared", errors=(".curvature_error",), default=ABSENT,
    )  # fmt: skip
    curvature_error: float | Absent | None = fact(
        "its error", "unit of the goal over that of the key squared", default=ABSENT
    )


@record
class FoundOutput:
    """An output of the run of the optimum."""

    value: float | None = fact("the number", BESIDE, errors=(".error",))
    unit: str = fact("its unit")
    error: float | None = fact("estimated error of this run; `null` where the run tells none", BESIDE)
    target: str | Absent = fact("what it is to be, where it is to reach a value", default=ABSENT)
    tolerance: float | Absent = fact(
        "how far it may be from its target: as asked, else the error of the run or 1e-6 of the size of the output",
        BESIDE, default=ABSENT,
    )  # fmt: skip
    met: bool | Absent = fact("whether it is within that", default=ABSENT)
    from_optimum: float | Absent | None = fact(
        "of what is least or largest: by how much the optimum nearby may be better, as constraints are kept with a "
        "little room, to first order, and errors of the run; `null` where it is not known", BESIDE, default=ABSENT,
    )  # fmt: skip


@record
class KeptLimit:
    """A constraint at the optimum."""

    limit: str = fact("what holds of the output")
    source: str = fact("`keep`, or `expect` of the scene")
    value: float | None = fact("the output", BESIDE, errors=(".error",))
    error: float | None = fact("its estimated error", BESIDE)
    holds: bool = fact("whether it holds")
    active: bool = fact("whether the output is at its limit, as near as the error of the run lets it come")
    price: float | Absent = fact(
        "change of the goal as the limit moves by one unit", "unit of the goal over that of the output",
        errors=(".price_error",), default=ABSENT,
    )  # fmt: skip
    price_error: float | Absent = fact(
        "its error", "unit of the goal over that of the output", default=ABSENT
    )


@record
class OtherOptimum:
    """The best of the other ends of starts."""

    goal: float = fact(
        "what was minimised, maximised or, of targets, the largest miss over its tolerance", BESIDE
    )
    holds: bool = fact("whether all constraints hold there")
    values: dict[str, float] = fact("of the keys", OF_KEY, names=ANY)
    starts: int = fact("starts that came to it")


@record
class SearchProof:
    """What shows that the values are the best."""

    text: str = fact("in words")
    first_order: float | Absent = fact(
        "largest derivative of the goal by a key that bounds and constraints leave, with keys from 0 to 1 between "
        "their bounds and the output over its size; 0 at an optimum", errors=(".first_order_error",), default=ABSENT,
    )  # fmt: skip
    first_order_error: float | Absent = fact("error of the derivatives", default=ABSENT)
    second_order: float | Absent = fact(
        "smallest eigenvalue of the second derivatives in the directions that stay free, scaled likewise; more than 0 "
        "at an optimum", errors=(".second_order_error",), default=ABSENT,
    )  # fmt: skip
    second_order_error: float | Absent = fact("its error", default=ABSENT)


@record
class SearchEffort:
    """What the search has made."""

    runs: int = fact("runs of the command, those of failed steps and of differences among them")
    derivatives: int = fact("points at which derivatives were computed exactly")
    combinations: int = fact("combinations of values of keys without bounds")
    starts: int = fact("points from which solvers began")
    same: int = fact("starts that came to the values of the result")
    failures: dict[str, int] = fact(
        "number of runs by exit code other than 0, or `0` where an output was lacking", names=ANY
    )
    reasons: dict[str, str] = fact("why the first of them failed, by exit code", names=ANY)
    seconds: float = fact("wall time", "s")


@record
class SearchSummary:
    """The summary of ``optimise``."""

    of: str = fact("the command of each run")
    goal: str = fact("what was looked for, in words")
    repeat: str = fact(
        "command line that repeats the run of the result: its `--set` have all values with all digits"
    )
    keys: dict[str, FoundKey] = fact("the values that were found", names=ANY)
    figures: dict[str, FoundOutput] = fact("outputs of that run", names=OUTPUT)
    limits: dict[str, KeptLimit] = fact("constraints", names=OUTPUT)
    left_out: dict[str, str] = fact(
        "what the scene expects and is no constraint, with the reason", names=OUTPUT
    )
    not_held: list[str] | Absent = fact("what the run of the result breaks", default=ABSENT)
    other: OtherOptimum | None = fact("the best of the other ends; `null` where all came to the same")
    proof: SearchProof = fact("what shows that the values are the best")
    not_exact: dict[str, str] = fact("keys with derivatives by differences, and why", names=ANY)
    search: SearchEffort = fact("what it took", errors=None)
