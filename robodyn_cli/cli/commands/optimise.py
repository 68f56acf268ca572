"""``robodyn optimise``."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robodyn_cli.cli import offers
from robodyn_cli.cli.options import (
    Jobs,
    SceneFile,
    SharedOptions,
    number,
    pairs,
    utf8,
    variations,
)
from robodyn_cli.cli.runner import begun, output, publish, show, store
from robodyn_cli.cli.words import error_text, stated, table
from robodyn_cli.cli.words import number as shown
from robodyn_cli.errors import OF_STATUS, SceneError, of_option
from robodyn_cli.threads import cores

if TYPE_CHECKING:
    from types import TracebackType

    from robodyn_cli.cli.console import Console
    from robodyn_cli.expr.statements import Expectation

KEEP = re.compile(r"\s*([^<>=\s]+)\s*((?:<|>).*)", re.DOTALL)
BETWEEN = re.compile(r"\s*([^<>=\s]+)\s*=\s*(.*\.\..*)", re.DOTALL)


EXAMPLES = (
    "optimise configs/search/spring_balance.yaml",
    "optimise configs/2r_circle.yaml --vary 'trajectory.center#1=uniform(0.9, 1.3)' "
    "--minimise rms_torque.theta1",
    "optimise configs/four_bar_deploy.yaml --vary 'torques.theta1#1=uniform(1.5, 4)' --minimise lock.time "
    "--keep 'lock.rates.phi1 <= 1.5'",
)


def command(
    scene: SceneFile,
    vary: Annotated[
        list[str] | None,
        typer.Option("--vary", metavar="KEY=SPEC", parser=utf8, autocompletion=offers.varied_keys,
                     help="Key of the scene and its bounds, 'uniform(low, high)', or its choices, '[a, b]'."),
    ] = None,
    minimise: Annotated[
        str | None,
        typer.Option("--minimise", metavar="OUTPUT", parser=utf8, autocompletion=offers.outputs(),
                     help="Output that is to be least."),
    ] = None,
    maximise: Annotated[
        str | None,
        typer.Option("--maximise", metavar="OUTPUT", parser=utf8, autocompletion=offers.outputs(),
                     help="Output that is to be largest."),
    ] = None,
    reach: Annotated[
        list[str] | None,
        typer.Option("--reach", metavar="OUTPUT=VALUE", parser=utf8, autocompletion=offers.outputs("="),
                     help="Output and the value that it is to have, e.g. lock.time=2 or 'lock.time=2 +- 1e-3'."),
    ] = None,
    keep: Annotated[
        list[str] | None,
        typer.Option("--keep", metavar="OUTPUT<=VALUE", parser=utf8, autocompletion=offers.outputs(),
                     help="Constraint, e.g. 'peak_torque.theta1 <= 20', or '>=', or 'OUTPUT = a .. b'."),
    ] = None,
    starts: Annotated[
        int | None,
        typer.Option("--starts", metavar="N", parser=number("a whole number >= 1", lambda n: n >= 1, int),
                     help="Points from which the search begins. [default: 4]"),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option("--seed", metavar="S", parser=number("a whole number >= 0", lambda n: n >= 0, int),
                     help="Seed of these points. [default: 0]"),
    ] = None,
    jobs: Jobs = None,
    *,
    shared: SharedOptions,
) -> int:  # fmt: skip
    """Search; return 1 where a constraint does not hold at the best point, or a target is missed."""
    from robodyn_cli.over.search.asked import options_of, prepare
    from robodyn_cli.over.search.journal import SearchJournal
    from robodyn_cli.over.search.points import PointMaker
    from robodyn_cli.over.search.report import report
    from robodyn_cli.over.search.search import run_search
    from robodyn_cli.scene.load import Family
    from robodyn_cli.tools.progress import Stopwatch

    watch = Stopwatch()
    console, drawings = shared.console, shared.drawings("optimise")
    target, family = shared.directory(scene, "optimise"), Family(scene, shared.overrides or ())
    start, progress = time.perf_counter(), SearchProgress(console)
    options = options_of(
        family.own.search,
        {"vary": variations(vary or ()), "minimise": minimise, "maximise": maximise, "reach": _targets(reach or ()),
         "keep": _limits(keep or ()), "starts": starts, "seed": seed},
    )  # fmt: skip
    with console.waiting(lambda: progress.doing), output(target, scene, console) as directory:
        search = prepare(family, options)
        with begun(directory, console):
            with SearchJournal(directory.path, search.digest) as journal, progress:
                if journal.taken:
                    console.note(f"robodyn: {journal.taken} runs are there from an earlier search")
                maker = PointMaker(search, jobs or cores(), journal, progress)
                ended = run_search(search, maker, progress.reached)
                result = report(ended, maker, time.perf_counter() - start)
            store(result, directory)
            publish(result, directory, drawings, console, watch)
            journal.forget()
    show(result, directory, console, describe)
    for text in result.summary.get("not_held", ()):
        console.error(f"no point that was found holds all that is asked: {text}")
    return OF_STATUS[result.status]


class SearchProgress:
    """Tells how far a search is, and how many runs are made; as a context manager, says what an interrupt leaves."""

    def __init__(self, console: Console) -> None:
        self.console, self.runs = console, 0

    @property
    def doing(self) -> str:
        return "a search"

    def reached(self, done: float, total: float, unit: str = "s") -> None:
        """Show how many solvers have ended, or how many runs of all are made."""
        runs = "" if unit == "runs" else f", {self.runs} runs"
        self.console.progress(done, total, unit + runs)

    def __enter__(self) -> SearchProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.console.clear()
        if isinstance(error, KeyboardInterrupt) and self.runs:
            self.console.note(
                f"robodyn: {self.runs} runs are done and kept; the same command goes on from there"
            )

    def __call__(self, runs: int) -> None:
        self.runs = runs


def _targets(texts: Sequence[str]) -> dict[str, Expectation]:
    """Return the values that outputs are to have.

    Raises
    ------
    SceneError : a text is not OUTPUT=VALUE, or names an output that another one names.
    """
    from robodyn_cli.expr.statements import parse_expectation

    allowed = "allowed: OUTPUT=VALUE, 'OUTPUT=VALUE +- TOLERANCE'"
    given = pairs("--reach", texts, "OUTPUT=VALUE", allowed, parse_expectation)
    return {name: parse_expectation(target.text, name) for name, target in given.items()}


def _limits(texts: Sequence[str]) -> dict[str, Expectation]:
    """Return the constraints.

    Raises
    ------
    SceneError : a text is no inequality, or names an output that another one names.
    """
    from robodyn_cli.expr.statements import parse_expectation

    limits: dict[str, Expectation] = {}
    for text in texts:
        match = KEEP.fullmatch(text) or BETWEEN.fullmatch(text)
        if match is None:
            raise of_option(
                f"--keep {text}",
                "is no inequality; allowed: 'OUTPUT <= VALUE', '<', '>=', '>', 'OUTPUT = a .. b'",
            )
        name, value = match.groups()
        if name in limits:
            raise of_option(
                f"--keep {name}", f"is given twice; allowed: once, with both bounds: '{name} = a .. b'"
            )
        try:
            limits[name] = parse_expectation(value, name)
        except SceneError as error:
            raise of_option(f"--keep {name}", error.message) from error
    return limits


def describe(summary: Mapping[str, Any], verbose: bool = True) -> str:
    """Return the summary for the terminal."""
    effort = summary["search"]
    lines = [summary["title"], f"  goal               {summary['goal']}"]
    failed = ", ".join(f"{count} with exit code {code}" for code, count in effort["failures"].items())
    starts = effort["starts"]
    derived = f", with exact derivatives at {effort['derivatives']} points" if effort["derivatives"] else ""
    lines.append(
        f"  search             {effort['runs']} runs of {summary['of']}{derived}, {starts} start{'s' * (starts != 1)}, "
        f"{effort['seconds']:.3g} s" + (f"; failed: {failed}" if failed else "")
    )
    rows = [["key", "value", "unit", "bounds", "price of the bound"]]
    for name, key in summary["keys"].items():
        bounds = key.get("choices") or key["bounds"]
        at = f" ({key['at']})" if "at" in key else ""
        rows.append([name, _number(key["value"], key["uncertainty"]), _unit(key["unit"]), bounds + at,
                     _priced(key)])  # fmt: skip
    lines.append(table(_without_empty(rows)))
    rows = [["output", "value", "unit", "asked for", "price of the limit"]]
    for name, found in summary["figures"].items():
        rows.append(
            [
                name,
                _number(found["value"], found["error"]),
                _unit(found["unit"]),
                *_asked(summary, name),
            ]
        )
    lines.append(table(_without_empty(rows)))
    lines.append(f"  proof              {summary['proof']['text']}")
    if verbose and (other := summary["other"]) is not None:
        values = ", ".join(f"{key} = {shown(x)}" for key, x in other["values"].items())
        reaches = any("met" in found for found in summary["figures"].values())
        goal = f"{shown(other['goal'])}{' tolerances off the targets' if reaches else ''}"
        lines.append(
            f"  next best          {goal} from {other['starts']} of the starts, with {values}"
            + ("" if other["holds"] else "; a constraint does not hold there")
        )
    for code, text in effort["reasons"].items():
        lines.append(f"  failing runs       exit code {code}: {text}")
    if verbose:
        lines += [f"  no constraint      expect {name}: {why}" for name, why in summary["left_out"].items()]
        lines += [f"  by differences     {name}: {why}" for name, why in summary["not_exact"].items()]
    return "\n".join([*lines, f"  {summary['repeat']}"])


def _without_empty(rows: list[list[str]]) -> list[list[str]]:
    """Return a table without the last column where no row has anything there."""
    return rows if any(row[-1] for row in rows[1:]) else [row[:-1] for row in rows]


def _asked(summary: Mapping[str, Any], name: str) -> tuple[str, str]:
    """Return what is asked for of an output, and what its limit costs."""
    found, limit = summary["figures"][name], summary["limits"].get(name)
    if "target" in found:
        within = f", within {error_text(found['tolerance'])}" if "tolerance" in found else ""
        return found["target"] + (f" (met{within})" if found.get("met") else " (missed)"), ""
    if limit is None:
        return summary["goal"].partition(" ")[0], ""
    held = "" if limit["holds"] else " (broken)"
    return limit["limit"] + (" (active)" if limit["active"] else held), _priced(limit)


def _priced(facts: Mapping[str, Any]) -> str:
    if "price" not in facts:
        return ""
    return stated(facts["price"], facts["price_error"])


def _number(value: float | None, error: float | None) -> str:
    """Return a figure, with many digits where its error is not known."""
    return shown(value, 12) if error is None else stated(value, error)


def _unit(unit: str) -> str:
    return unit if unit not in ("", "1") else "-"
