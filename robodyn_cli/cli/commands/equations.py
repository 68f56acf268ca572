"""``robodyn equations``."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from robodyn_cli.cli.options import Overrides, SceneFile, Told
from robodyn_cli.cli.runner import placed

EXAMPLES = (
    "equations configs/2r_circle.yaml",
    "equations configs/four_bar_deploy.yaml --latex --file four_bar.tex",
    "equations configs/double_pendulum.yaml --numbers --set robot.links.link1.mass=2",
    "equations configs/benchmarks/puma560.yaml --sympy --file puma.py",
)


def command(
    scene: SceneFile,
    latex: Annotated[bool, typer.Option("--latex", help="As a LaTeX document.")] = False,
    text: Annotated[bool, typer.Option("--text", help="As text for the terminal. [default]")] = False,
    sympy: Annotated[
        bool, typer.Option("--sympy", help="As a module of Python that makes them in SymPy.")
    ] = False,
    numbers: Annotated[
        bool, typer.Option("--numbers", help="With the numbers of the scene in place of their names.")
    ] = False,
    file: Annotated[
        Path | None,
        typer.Option(
            "--file", metavar="FILE", help="Write them to a file, never over another.", show_default=False
        ),
    ] = None,
    overrides: Overrides = None,
    *,
    told: Told,
) -> int:
    """Print the equations of motion that the program uses, or write them to a file; return the exit code."""
    from robodyn_cli.errors import CapabilityError, of_option
    from robodyn_cli.results.atomic import write_new
    from robodyn_cli.results.summary import as_keys
    from robodyn_cli.works.equations.report import equations

    asked = [name for name, wanted in (("latex", latex), ("text", text), ("sympy", sympy)) if wanted]
    if len(asked) > 1:
        raise of_option(f"--{asked[0]} and --{asked[1]}", "allowed: one form at a time", CapabilityError)
    console = told.console
    with console.waiting(lambda: "writing equations"), placed(scene, overrides or (), "info"):
        report = equations(scene, overrides or (), asked[0] if asked else "text", numbers)
    if file is not None:
        write_new(file, f"{report.document.rstrip()}\n")
        report = dataclasses.replace(report, file=str(file))
    console.data(as_keys(report))
    console.say(report.document if file is None else str(file))
    return 0
