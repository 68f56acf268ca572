"""``robodyn sweep``."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robodyn_cli.cli import offers
from robodyn_cli.cli.console import Console
from robodyn_cli.cli.options import Jobs, SceneFile, SharedOptions, number, utf8, variations
from robodyn_cli.cli.runner import begun, output, publish, show, store
from robodyn_cli.cli.words import number as shown
from robodyn_cli.cli.words import stated, table
from robodyn_cli.commands import SAMPLERS
from robodyn_cli.errors import FAILED, of_option
from robodyn_cli.threads import cores

if TYPE_CHECKING:
    from types import TracebackType

    from robodyn_cli.over.study.study import Make, Study
    from robodyn_cli.report.registry import Drawings
    from robodyn_cli.results.in_memory import Output
    from robodyn_cli.results.result import Result
    from robodyn_cli.tools.progress import Stopwatch

MOST_CASES = 8  # shown on the terminal


EXAMPLES = (
    "sweep configs/2r_circle.yaml --vary 'robot.links.link2.mass=linspace(10, 20, 11)' "
    "--of peak_torque.theta1",
    "sweep configs/four_bar_deploy.yaml --vary 'robot.links.crank.mass=normal(20.15, 2 %)' -n 100 "
    "--of lock.time",
    "sweep configs/mechanisms/crane.yaml --vary 'control.gains.kd=linspace(100, 500, 5)' "
    "--of extremes.q.trolley.largest",
)


def command(
    scene: SceneFile,
    vary: Annotated[
        list[str] | None,
        typer.Option("--vary", metavar="KEY=SPEC", parser=utf8, autocompletion=offers.varied_keys,
                     help="Key of the scene and what it varies over, e.g. robot.links.link1.mass='normal(13, 5 %)'."),
    ] = None,
    n: Annotated[
        int | None,
        typer.Option("-n", metavar="N", parser=number("a whole number >= 1", lambda n: n >= 1, int),
                     help="Samples of the distributions."),
    ] = None,
    sampler: Annotated[
        str | None,
        offers.one_of("--sampler", *SAMPLERS, metavar="|".join(SAMPLERS), help="How samples are drawn.")
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option("--seed", metavar="S", parser=number("a whole number >= 0", lambda n: n >= 0, int),
                     help="Seed of the samples. [default: 0]"),
    ] = None,
    of: Annotated[
        list[str] | None,
        typer.Option("--of", metavar="KEY", autocompletion=offers.outputs(),
                     help="Output: a key of the summary, as in expect, e.g. lock.time."),
    ] = None,
    least_yield: Annotated[
        float | None,
        typer.Option("--yield", metavar="P", parser=number("a number from 0 to 1", lambda p: 0.0 <= p <= 1.0),
                     help="Share of runs that must hold what the scene expects; below it the exit code is 1."),
    ] = None,
    indices: Annotated[bool, typer.Option("--indices", help="Sobol indices, from N (keys + 2) runs.")] = False,
    jobs: Jobs = None,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", metavar="ADDRESS", parser=utf8,
                     help="Make the runs on a Dask cluster, e.g. tcp://host:8786, in place of this machine."),
    ] = None,
    *,
    shared: SharedOptions,
) -> int:  # fmt: skip
    """Run the study; return 0 even where runs failed, 1 below the yield."""
    from robodyn_cli.over.study.runs import cost_of, why_slow
    from robodyn_cli.over.study.study import AskedStudy, options_of, prepare
    from robodyn_cli.scene.load import Family
    from robodyn_cli.tools.progress import Stopwatch

    if scheduler is not None and jobs is not None:
        raise of_option(
            "--jobs", "does not go with --scheduler: each worker has the threads that it was started with"
        )
    console, watch = shared.console, Stopwatch()
    drawings = shared.drawings("sweep")
    target, family = shared.directory(scene, "sweep"), Family(scene, shared.overrides or ())
    options = options_of(
        family.own.study, vary=variations(vary) if vary else None, n=n, sampler=sampler,
        seed=seed, of=tuple(of) if of else None, least_yield=least_yield,
    )  # fmt: skip
    with console.waiting(lambda: "a study"), output(target, scene, console) as directory:
        study = prepare(AskedStudy(family, options, indices))
        if slow := why_slow(study.task):
            console.note(f"robodyn: {slow}; {cost_of(study.seconds)}")
        with begun(directory, console):
            maker = _maker(scheduler, jobs or cores(), console, study.seconds)
            result = _run(study, directory, maker, console, drawings, watch)
    judged = options.least_yield is not None
    show(result, directory, console, lambda summary, verbose: describe(summary, judged, verbose))
    return _judge(result.summary, options.least_yield, console)


@contextlib.contextmanager
def _maker(scheduler: str | None, jobs: int, console: Console, seconds: float) -> Iterator[Make]:
    """Give what makes runs: a cluster, or this machine with so many jobs. seconds : of the scene as it stands."""
    if scheduler is None:
        from robodyn_cli.over.study.runs import run_here

        yield lambda task, file: run_here(task, file, jobs, console.note, seconds)
        return
    from robodyn_cli.over.study.cluster import Cluster

    with Cluster(scheduler, console.note) as cluster:
        yield cluster.run


def _run(
    study: Study,
    directory: Output,
    maker: AbstractContextManager[Make],
    console: Console,
    drawn: Drawings | None,
    watch: Stopwatch,
) -> Result:
    """Make the runs and write what they give; return the result."""
    from robodyn_cli.over.study.report import earlier_rows, report
    from robodyn_cli.over.study.rows import RowFile
    from robodyn_cli.over.study.study import run_study
    from robodyn_cli.results.hdf5 import ResultWriter, read

    with RowFile(directory.path, study.task, study.design, study.rows_head) as file:
        if (earlier := earlier_rows(study, directory.path)) is not None:
            file.take_over(earlier)
            del earlier
        with maker as make, StudyProgress(console) as progress:
            run_study(study, file, make, progress)
        title = study.scene.title or study.task.command
        with ResultWriter(
            directory.result_path, command="sweep", title=title, scene_text=study.scene.text
        ) as writer:
            result = report(study, file, writer, progress.seconds)
            store(result, directory, writer)
        if drawn is not None or not directory.lasts:
            result.variables = read(directory.result_path).variables
        publish(result, directory, drawn, console, watch)
        file.forget()
    return result


class StudyProgress:
    """Shows how many runs are done, and the time left; as a context manager, says what an interrupt leaves."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.done = self.runs = 0
        self.start = time.perf_counter()
        self.before: int | None = None  # runs of an earlier study

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self.start

    def __enter__(self) -> StudyProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, KeyboardInterrupt) and self.done:
            self.console.note(
                f"robodyn: {self.done} of {self.runs} runs are done and kept; the same command goes on from there"
            )

    def __call__(self, done: int, runs: int) -> None:
        self.done, self.runs = done, runs
        if self.before is None:
            self.before = done
            if done:
                self.console.note(f"robodyn: {done} of {runs} runs are there from an earlier study")
        now = done - self.before
        left = self.seconds / now * (runs - done) if now else None
        self.console.count(done, runs, left)


def _judge(summary: Mapping[str, Any], least: float | None, console: Console) -> int:
    """Return the exit code: 1 where fewer runs than asked for hold what is expected."""
    held = summary.get("yield")
    if least is None or held is None or held["share"] >= least:
        return 0
    console.error(f"the yield is {held['share']:.4g}; asked for was {least:g} (--yield)")
    return FAILED


def describe(summary: Mapping[str, Any], judged: bool, verbose: bool = True) -> str:
    """Return the summary of a study for the terminal; judged : whether it asks for a yield."""
    lines = [summary["title"]]
    drawn = ""
    if "sampler" in summary:
        design = "Saltelli's design of " if "sobol_indices" in summary else ""
        drawn = f", {design}{summary['sampler']} samples, seed {summary['seed']}"
    lines.append(
        f"  study              {summary['runs']} runs of {summary['of']}{drawn}, {summary['seconds']:.3g} s"
    )
    for key, given in summary["inputs"].items():
        unit = f" {given['unit']}" if given["unit"] not in ("", "1") else ""
        lines.append(f"  varied             {key}: {given['spec']}{unit}")
    for name, count in summary.get("series", {}).items():
        lines.append(
            f"  integrator         {name} of {count} runs side by side, as accurate as that of {summary['of']}"
        )
    failed = summary["failed"]
    codes = ", ".join(f"{count} with exit code {code}" for code, count in summary["failures"].items())
    lines.append(f"  failed             {_share(failed)}" + (f"; {codes}" if codes else ""))
    if judged and (held := summary.get("yield")) is not None:
        lines.append(f"  yield              {_share(held)} hold what the scene expects")
    lines += _spreads(summary)
    lines += _influences(summary) if verbose else []
    for case in summary["cases"][:MOST_CASES]:
        if not (verbose or "exit code" in case["why"]):
            continue
        lines += [f"  run {case['run']}: {case['why']}", f"    {case['command']}"]
    return "\n".join(lines)


def _share(share: Mapping[str, float]) -> str:
    between = f" ({100 * share['low']:.3g} to {100 * share['high']:.3g} %)" if "low" in share else ""
    return f"{100 * share['share']:.4g} % of the runs{between}"


def _spreads(summary: Mapping[str, Any]) -> list[str]:
    """Return the table of the outputs: of samples their spread, of a grid the extremes; each with its error.

    Where runs lack an output, as a time that never comes, it says in how many: these figures are those of the others.
    """
    columns = {"mean": "mean", "sd": "sd"} | {name: f"quantiles.{name}" for name in ("5 %", "50 %", "95 %")}
    if "sampler" not in summary:
        columns = {"least": "minimum", "greatest": "maximum"}
    lacking = {
        key: summary["runs"] - (spread["runs"] if spread else 0) for key, spread in summary["results"].items()
    }
    told = any(lacking.values())
    rows = [["output", *columns, "as it stands", "unit", *(["no value in"] if told else [])]]
    for key, spread in summary["results"].items():
        own = [f"results.{key}.{name}" for name in (*columns.values(), "nominal")]
        unit = spread["unit"] if spread is not None else ""
        without = [f"{lacking[key]} of {summary['runs']} runs"] if told else []
        rows.append([key, *(_with_error(summary, name) for name in own), _unit(unit), *without])
    lines = [table(rows)]
    if any(spread is not None and "confidence" in spread for spread in summary["results"].values()):
        lines.append(
            "  errors             with 95 % confidence, runs' own errors included; none where runs are too few to tell"
        )
    return lines


def _with_error(summary: Mapping[str, Any], key: str) -> str:
    """Return a figure and the largest of the errors that its declaration names."""
    from robodyn_cli.over.batch.criteria import lookup_number
    from robodyn_cli.summaries.keys import leaf_of

    value, leaf = lookup_number(summary, key), leaf_of("sweep", key)
    if value is None:
        return "-"
    errors = [
        x
        for name in (leaf.errors if leaf is not None else ())
        if (x := lookup_number(summary, name)) is not None
    ]
    if not errors:
        return shown(value)
    return stated(value, max(errors))


def _unit(unit: str) -> str:
    """Return a unit as a table shows it."""
    return "-" if unit == "1" else unit


def _influences(summary: Mapping[str, Any]) -> list[str]:
    lines = []
    for key, influences in summary["influence"].items():
        indices = (summary.get("sobol_indices") or {}).get(key)
        if not influences or len(influences) < 2:
            continue
        head = ["influence on " + key, "5 to 95 %", "rank correlation"]
        rows = [[*head, "Sobol first", "total"] if indices else head]
        for name, one in influences.items():
            row = [name, f"{one['swing']:+.4g}", f"{one['rank_correlation']:+.3f}"]
            if indices:
                row += [_index(indices[name], "first"), _index(indices[name], "total")]
            rows.append(row)
        lines.append(table(rows))
    return lines


def _index(index: Mapping[str, float], order: str) -> str:
    return f"{index[order]:.3f} ({index[order + '_low']:.3f} to {index[order + '_high']:.3f})"
