"""Arguments and options that the commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE.yaml", help="Scene to run.", show_default=False)]
OutDir = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="DIR", help="Output directory. [default: outputs/<scene>/<command>]"),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key of the scene, e.g. simulate.rtol=1e-12."),
]
NoPlots = Annotated[bool, typer.Option("--no-plots", help="Draw nothing.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the summary as JSON, alone, on standard output.")]
ReportAsJson = Annotated[
    bool, typer.Option("--json", help="Print the report as JSON, alone, on standard output.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
NoErrorEstimate = Annotated[
    bool, typer.Option("--no-error-estimate", help="Skip the second integration that estimates the error.")
]
Strict = Annotated[bool, typer.Option("--strict", help="Take warnings about the scene as errors.")]
