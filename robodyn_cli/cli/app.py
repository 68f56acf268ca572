"""The command line: one file a command, one line here."""

from __future__ import annotations

import typer

from robodyn_cli.cli import (
    assemble,
    check,
    compare,
    deploy,
    info,
    inverse,
    kinematics,
    new,
    plan,
    run,
    schema,
    simulate,
    stability,
    statics,
    validate,
    work_precision,
)
from robodyn_cli.cli.parameters import for_typer
from robodyn_cli.cli.usage import Commands
from robodyn_cli.version import __version__

app = typer.Typer(
    name="robodyn",
    cls=Commands,
    help="Inverse dynamics and simulation of robots and closed-loop mechanisms described in YAML.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.command("inverse")(for_typer(inverse.command))
app.command("simulate")(for_typer(simulate.command))
app.command("deploy")(for_typer(deploy.command))
app.command("kinematics")(for_typer(kinematics.command))
app.command("assemble")(for_typer(assemble.command))
app.command("statics")(for_typer(statics.command))
app.command("plan")(for_typer(plan.command))
app.command("check")(for_typer(check.command))
app.command("compare")(for_typer(compare.command))
app.command("info")(for_typer(info.command))
app.command("new")(for_typer(new.command))
app.command("run")(for_typer(run.command))
app.command("schema")(for_typer(schema.command))
app.command("stability")(for_typer(stability.command))
app.command("validate")(for_typer(validate.command))
app.command("work-precision")(for_typer(work_precision.command))


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"robodyn {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    pass
