"""``robodyn compare``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from robodyn_cli.cli.console import Console, guarded
from robodyn_cli.cli.options import Quiet, ReportAsJson
from robodyn_cli.cli.parameters import argument, option

if TYPE_CHECKING:
    from robodyn_cli.results.compare import Difference


def command(
    result: Annotated[
        Path,
        argument(metavar="RESULT", help="Output directory of a run, or its result.h5."),
    ],
    baseline: Annotated[
        Path,
        argument(metavar="BASELINE", help="What it is compared with, likewise."),
    ],
    rtol: Annotated[
        float, option("--rtol", min=0.0, help="Allowed part of the column's largest magnitude.")
    ] = 1e-9,
    atol: Annotated[
        float, option("--atol", min=0.0, help="Allowed in addition, in the dataset's unit.")
    ] = 1e-12,
    as_json: ReportAsJson = False,
    quiet: Quiet = False,
) -> None:
    """Compare two results dataset by dataset."""
    console = Console(as_json, quiet)

    def action() -> int:
        import json

        from robodyn_cli.results.compare import compare
        from robodyn_cli.results.summary import jsonable
        from robodyn_cli.run.batch.stored import read_stored

        found = compare(read_stored(result), read_stored(baseline), rtol=rtol, atol=atol)
        rows = [as_dict(item) for item in found.differences]
        status = "ok" if found.agrees else "failed"
        report = {"status": status, "rtol": rtol, "atol": atol, "datasets": jsonable(rows)}
        console.data(json.dumps(report, ensure_ascii=False, indent=2))
        width = max((len(item.path) for item in found.differences), default=0)
        for item in found.differences:
            console.say(f"{item.verdict:<8} {item.path:<{width}}  {describe(item)}".rstrip())
        bad = sum(item.verdict not in ("equal", "extra") for item in found.differences)
        count = len(found.differences)
        console.say(
            f"{count} datasets: {f'{bad} differ' if bad else 'all agree'} (rtol {rtol:g}, atol {atol:g})"
        )
        return 0 if found.agrees else 1

    guarded(console, action)


def describe(item: Difference) -> str:
    """Return the worst sample of a dataset in words."""
    if item.verdict in ("missing", "extra"):
        return "only in the baseline" if item.verdict == "missing" else "only in the result"
    if item.detail or item.error == 0.0:
        return item.detail
    column = f" of {item.column}" if item.column else ""
    time = f" at t = {item.time:.9g} s" if item.time is not None else ""
    return (
        f"worst {item.error:.3g}{column}{time}: {item.value:.12g} instead of {item.expected:.12g} "
        f"({item.ratio:.2g} of what is allowed)"
    )


def as_dict(item: Difference) -> dict[str, Any]:
    """Return what ``--json`` shows; values only where values were compared."""
    found: dict[str, Any] = {"path": item.path, "verdict": item.verdict}
    if item.verdict in ("equal", "differs"):
        found |= {
            "error": item.error, "ratio": item.ratio, "value": item.value, "expected": item.expected,
            "time": item.time, "column": item.column or None,
        }  # fmt: skip
    elif item.detail:
        found["detail"] = item.detail
    return found
