"""``robodyn export``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.interrupts import tidy_up_first
from robodyn_cli.cli.options import Overrides, Quiet, ReportAsJson, choice, file

OF_RESULTS = ("csv", "parquet", "mat", "npz")
OF_SCENES = ("urdf+", "extended-urdf", "mjcf", "sdf")
SCENES = (".yaml", ".yml", ".urdf", ".sdf", ".xml", ".mjcf")


def command(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT|SCENE.yaml",
            help="Output directory of a run, or its result.h5; or a scene, or the URDF, SDF or MJCF of a robot.",
            callback=file,
            show_default=False,
        ),
    ],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="KIND",
            parser=choice(*OF_RESULTS, *OF_SCENES),
            help="Of a result: csv, parquet, mat (MATLAB), npz. Of a scene: urdf+, extended-urdf, mjcf, sdf.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Where the files go.", show_default=False)
    ],
    overrides: Overrides = None,
    as_json: ReportAsJson = False,
    quiet: Quiet = False,
) -> int:
    """Write a stored result, or the robot of a scene, in another format; return the exit code."""
    console = Console(as_json, quiet)
    tidy_up_first()
    with console.waiting(lambda: "exporting"):
        files, notes = _files(source, to, out, overrides or ())
    for text in notes:
        console.note(f"robodyn: {text}")
    console.data({"status": "ok", "files": [str(path) for path in files], "notes": notes})
    console.say(f"{out}  ({', '.join(path.name for path in files)})")
    return 0


def _files(source: Path, to: str, out: Path, overrides: Sequence[str]) -> tuple[list[Path], list[str]]:
    """Write the files of a result or a scene, as the source is one; return them, and what there is to say.

    Raises
    ------
    CapabilityError : results have no robot, and scenes no samples. Others of what reads and writes them.
    """
    from robodyn_cli.errors import CapabilityError

    stored = source.is_dir() or source.suffix == ".h5"
    if stored if to in OF_SCENES else source.suffix in SCENES:
        of, kinds = ("a result", OF_RESULTS) if stored else ("a scene", OF_SCENES)
        raise CapabilityError(
            f"{source} is {of}, of which --to {to} writes nothing; allowed: {', '.join(kinds)}"
        )
    if overrides and stored:
        raise CapabilityError(f"{source} is a result, in which --set changes nothing; allowed: of scenes")
    if to in OF_RESULTS:
        from robodyn_cli.over.batch.stored import read_stored
        from robodyn_cli.results.export import export

        return export(read_stored(source), to, out), []
    from robodyn_cli.over.export.scene import export_robot
    from robodyn_cli.scene.load import load_robot

    return export_robot(load_robot(source, overrides), to, out)
