"""Arguments and options that several commands share, and their parsers."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
import os
import stat
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from robodyn_cli.cli import offers
from robodyn_cli.cli.console import Console
from robodyn_cli.cli.plot_options import (
    NoPlots,
    NoTitles,
    PlotFormat,
    PlotNames,
    PlotStyle,
    PlotWidth,
    drawn_by,
)
from robodyn_cli.cli.runner import SceneRun, default_directory
from robodyn_cli.errors import SceneError, of_option
from robodyn_cli.record import record

if TYPE_CHECKING:
    from robodyn_cli.expr.statements import Variation
    from robodyn_cli.report.registry import Drawings

Parsed = TypeVar("Parsed")


def utf8(value: str) -> str:
    """Return the value of an option as it is.

    Raises
    ------
    BadParameter : it is not text; Python has put marks in place of its bytes.
    """
    try:
        value.encode()
    except UnicodeEncodeError:
        raise typer.BadParameter(f"{os.fsencode(value)!r} is no text; allowed: text in UTF-8") from None
    return value


def number(
    allowed: str, fits: Callable[[float], bool], kind: Callable[[str], Any] = float
) -> Callable[[str], Any]:
    """Return the parser of a number: a function that takes a word. ``allowed`` describes the numbers for which
    ``fits`` is true. The function raises BadParameter for any other word.
    """

    def read(word: str) -> Any:
        try:
            value = kind(word)
        except SceneError as error:
            raise typer.BadParameter(f"{error.message}; allowed: {allowed}") from None
        except ValueError:
            value = math.nan
        if not fits(value):
            raise typer.BadParameter(f"{word!r}; allowed: {allowed}")
        return value

    return read


def quantity(unit: str) -> Callable[[str], float]:
    """Return a reader of numbers in a unit, or with one of their own: ``500 ms`` of seconds is 0.5.

    It raises SceneError for words that are no number, and for units of another kind.
    """

    def read(word: str) -> float:
        from robodyn_cli.expr import formula, units

        tree = formula.parse(str(word))  # typer gives defaults too
        if tree.constant is None:
            raise SceneError(f"{word!r} is not a number")
        if tree.dims is not None and (fault := units.fault(tree.dims, unit, word)):
            raise SceneError(fault)
        return tree.constant

    return read


def file(path: Any) -> Any:
    """Return the path of a scene, or the paths of several.

    Raises
    ------
    BadParameter : one is a pipe or a device, which might never end.
    """
    for one in path if isinstance(path, (list, tuple)) else [path]:
        try:
            mode = os.stat(one).st_mode if one is not None else stat.S_IFREG
        except (OSError, ValueError):
            continue  # reported where the file is opened
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise typer.BadParameter(f"{str(one)!r} is a pipe or a device; allowed: a file")
    return path


SceneFile = Annotated[
    Path, typer.Argument(metavar="SCENE.yaml", help="The scene.", callback=file, show_default=False)
]
SceneFiles = Annotated[
    list[str],
    typer.Argument(
        metavar="SCENE|GLOB|DIR", help="Scenes, patterns, folders.", callback=file, show_default=False
    ),
]
StoredResult = Annotated[
    Path,
    typer.Argument(metavar="RESULT", help="Output directory of a run, or its result.h5.", show_default=False),
]
StoredResults = Annotated[
    list[Path],
    typer.Argument(
        metavar="RESULT", help="Output directories of runs, or their result.h5.", show_default=False
    ),
]


OutDir = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="DIR", help="Output directory. [default: outputs/<scene>/<command>]"),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        parser=utf8,
        autocompletion=offers.keys,
        help="Override a key of the scene, e.g. simulate.rtol=1e-12.",
    ),
]


def _live_key(word: str) -> tuple[str, str, str]:
    key, _, span = word.rpartition("=")
    low, _, high = span.partition(":")
    if not (key and low and high):
        raise typer.BadParameter(f"{word!r}; allowed: KEY=LOW:HIGH")
    return key, low, high


LiveKeys = Annotated[
    list[Any],
    typer.Option(
        "--live",
        metavar="KEY=LOW:HIGH",
        parser=_live_key,
        autocompletion=offers.keys,
        help="Let the scene run in the page with other values of this key; repeat for more keys.",
        default_factory=list,
        show_default=False,
    ),
]
NoPlan = Annotated[
    bool,
    typer.Option("--no-plan", help="Leave the plan of the scene out, which takes longest of large ones."),
]
Jobs = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        "-j",
        metavar="N",
        parser=number("a whole number >= 1", lambda n: n >= 1, int),
        help="Processes at a time. [default: one per core]",
    ),
]

tolerance = number("a number >= 0", lambda x: 0.0 <= x < math.inf)
RelativeTolerance = Annotated[
    float,
    typer.Option(
        "--rtol", metavar="X", parser=tolerance, help="Allowed part of the column's largest magnitude."
    ),
]
AbsoluteTolerance = Annotated[
    float,
    typer.Option("--atol", metavar="X", parser=tolerance, help="Allowed in addition, in the dataset's unit."),
]
RTOL, ATOL = 1e-9, 1e-12


AsJson = Annotated[bool, typer.Option("--json", help="Print the summary as JSON, alone, on standard output.")]
ReportAsJson = Annotated[
    bool, typer.Option("--json", help="Print the report as JSON, alone, on standard output.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Print all figures, checks and costs, and the files written.")
]
NoErrorEstimate = Annotated[
    bool, typer.Option("--no-error-estimate", help="Skip the second integration that estimates the error.")
]
NO_ERROR_ESTIMATE = ("simulate.error_estimate=false",)  # the override that it stands for

Strict = Annotated[
    bool, typer.Option("--strict", help="Take warnings about the scene and the result as errors.")
]


@record
class Told:
    """The options of a command that prints a report.

    kept : takes what the command would print where a program in Python has called it; None on the command line. It is
    no option.
    """

    as_json: ReportAsJson = False
    quiet: Quiet = False
    kept: Any = None

    @property
    def console(self) -> Console:
        return self.kept or Console(self.as_json, self.quiet)


@record
class Printed:
    """A command that prints JSON and nothing else, and so needs no options."""

    kept: Any = None

    @property
    def console(self) -> Console:
        return self.kept or Console(as_json=True)


@record
class SharedOptions:
    """The options of a command on a scene: where its results go, keys that are set, what is drawn and printed."""

    out: OutDir = None
    overrides: Overrides = None
    no_plots: NoPlots = False
    plots: PlotNames = None
    format_: PlotFormat = "png"
    style: PlotStyle = "screen"
    width: PlotWidth = None
    no_titles: NoTitles = False
    as_json: AsJson = False
    quiet: Quiet = False
    verbose: Verbose = False
    kept: Any = None

    def drawings(self, command: str = "") -> Drawings | None:
        """Return which plots are drawn, of a command if it is named; None for none.

        Raises
        ------
        SceneError : the command never draws one that is asked for.
        """
        if self.no_plots:
            return None
        if self.plots and command:
            drawn_by(command, self.plots)
        from robodyn_cli.report.registry import Drawings

        return Drawings(self.plots, self.format_, self.style, self.width, self.no_titles)

    def directory(self, scene: Path | None, command: str) -> Path | None:
        """Return where the results of a command on a scene go; None where they stay in memory."""
        return self.out if self.out is not None or self.kept else default_directory(scene, command)

    @property
    def console(self) -> Console:
        return self.kept or Console(self.as_json, self.quiet, self.verbose)

    def job(
        self, command: str, scene: Path, strict: bool = False, changes: Sequence[str] = (), **more: Any
    ) -> SceneRun:
        """Return a run of a scene; changes : overrides that other options stand for; more : fields of ``SceneRun``."""
        overrides = [*(self.overrides or ()), *changes]
        return SceneRun(
            command, scene, self.directory(scene, command), overrides, self.drawings(command), strict, **more
        )


# a command has the options of one of these where it has a parameter of that class; ``with_shared`` puts them there
GROUPS = (SharedOptions, Told, Printed)
KEPT = "kept"


def with_shared(command: Callable[..., int]) -> Callable[..., int]:
    """Return a command that takes the options of a group one by one, in place of its parameter of that class.

    An option that the command declares itself, with a help or at a place of its own, goes to both. It takes ``kept``,
    which is no option, too.
    """
    own = inspect.signature(command, eval_str=True).parameters
    place, group = next((name, p.annotation) for name, p in own.items() if p.annotation in GROUPS)
    kinds = inspect.get_annotations(group, eval_str=True)
    shared = [
        inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=kinds[f.name])
        for f in dataclasses.fields(group)
        if f.name != KEPT
    ]

    @functools.wraps(command)
    def run(kept: Any = None, **values: Any) -> int:
        given = {option.name: values[option.name] for option in shared}
        rest = {name: value for name, value in values.items() if name in own}
        return command(**rest, **{place: group(**given, kept=kept)})

    parameters: list[inspect.Parameter] = []
    for name, parameter in own.items():
        if name == place:
            parameters += [option for option in shared if option.name not in own]
        else:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return run


def variations(texts: Sequence[str]) -> dict[str, Variation]:
    """Return what each key varies over.

    Raises
    ------
    SceneError : a text is not KEY=SPEC, or names a key that another one names.
    """
    from robodyn_cli.expr.statements import FORMS, parse_variation

    # other spellings of one key are found once the scene is read
    return pairs("--vary", texts, "KEY=SPEC", FORMS, parse_variation)


def pairs(
    option: str, texts: Sequence[str], form: str, allowed: str, parse: Callable[[str], Parsed]
) -> dict[str, Parsed]:
    """Return what follows on each name in the texts of an option, ``NAME=...``.

    Raises
    ------
    SceneError : a text has no such form, which ``allowed`` explains, or names what another one names.
    """
    found: dict[str, Parsed] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        if not name or not value:
            raise of_option(f"{option} {text}", f"is not {form}; {allowed}")
        if name in found:
            raise of_option(f"{option} {name}", "is given twice")
        try:
            found[name] = parse(value)
        except SceneError as error:
            raise of_option(f"{option} {name}", error.message) from error
    return found
