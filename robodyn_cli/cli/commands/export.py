"""``robodyn export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.interrupts import tidy_up_first
from robodyn_cli.cli.options import Quiet, ReportAsJson, StoredResult, choice

KINDS = ("csv", "parquet", "mat", "npz")


def command(
    result: StoredResult,
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="KIND",
            parser=choice(*KINDS),
            help="csv, parquet, mat (MATLAB) or npz.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Where the files go.", show_default=False)
    ],
    as_json: ReportAsJson = False,
    quiet: Quiet = False,
) -> int:
    """Write a stored result in another format; return the exit code."""
    from robodyn_cli.over.batch.stored import read_stored
    from robodyn_cli.results.export import export

    console = Console(as_json, quiet)
    tidy_up_first()
    with console.waiting(lambda: "exporting"):
        files = export(read_stored(result), to, out)
    console.data({"status": "ok", "files": [str(path) for path in files]})
    console.say(f"{out}  ({', '.join(path.name for path in files)})")
    return 0
