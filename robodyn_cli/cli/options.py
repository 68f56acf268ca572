"""Arguments and options that the commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from robodyn_cli.cli.parameters import argument, option

SceneFile = Annotated[Path, argument(metavar="SCENE.yaml", help="Scene to run.")]
OutDir = Annotated[
    Path | None,
    option("--out", "-o", metavar="DIR", help="Output directory. [default: outputs/<scene>/<command>]"),
]
Overrides = Annotated[
    list[str] | None,
    option("--set", metavar="KEY=VALUE", help="Override a key of the scene, e.g. simulate.rtol=1e-12."),
]
NoPlots = Annotated[bool, option("--no-plots", help="Draw nothing.")]
AsJson = Annotated[bool, option("--json", help="Print the summary as JSON, alone, on standard output.")]
ReportAsJson = Annotated[bool, option("--json", help="Print the report as JSON, alone, on standard output.")]
Quiet = Annotated[bool, option("--quiet", "-q", help="Print nothing but errors.")]
NoErrorEstimate = Annotated[
    bool, option("--no-error-estimate", help="Skip the second integration that estimates the error.")
]
Strict = Annotated[bool, option("--strict", help="Take warnings about the scene as errors.")]
