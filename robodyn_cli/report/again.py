"""Drawings of stored results, made again: all of one, or several over one another."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from robodyn_cli.errors import CapabilityError
from robodyn_cli.report.registry import Drawings, applicable, draw_all
from robodyn_cli.results.atomic import output_errors
from robodyn_cli.results.result import Result


def draw_again(
    results: Sequence[tuple[Path, Result]], directory: Path, drawings: Drawings
) -> tuple[list[Path], list[str]]:
    """Draw stored results into a directory; return the files, and the plots asked for that no data are there for.

    Raises
    ------
    CapabilityError : nothing can be drawn. OutputError : it cannot be written.
    """
    found = [result for _, result in results]
    if len(found) == 1:
        possible = applicable(found[0])
    else:
        from robodyn_cli.report.overlay import common_plots

        possible = common_plots(found)
    missing = [name for name in drawings.names or () if name not in possible]
    if not drawings.among(possible):
        whose = (
            "the result has no data for them"
            if len(found) == 1
            else "the results have no data in common for them"
        )
        raise CapabilityError(f"no plots: {whose}; possible: {', '.join(possible) or 'none'}")
    with output_errors(directory):
        directory.mkdir(parents=True, exist_ok=True)
    if len(found) == 1:
        return draw_all(found[0], directory, drawings), missing
    return _over(results, directory, drawings.among(possible), drawings.suffix), missing


def _over(
    results: Sequence[tuple[Path, Result]], directory: Path, names: Sequence[str], suffix: str
) -> list[Path]:
    from robodyn_cli.report.canvas import save
    from robodyn_cli.report.overlay import draw_over, labels_of
    from robodyn_cli.report.style import styled

    paths, found = zip(*results)
    labelled = dict(zip(labels_of(paths, [result.title for result in found]), found))
    with styled():
        return [save(draw_over(labelled, name), directory / f"{name}.{suffix}") for name in names]
