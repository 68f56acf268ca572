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

app.command("inverse")(inverse.command)
app.command("simulate")(simulate.command)
app.command("deploy")(deploy.command)
app.command("kinematics")(kinematics.command)
app.command("assemble")(assemble.command)
app.command("statics")(statics.command)
app.command("plan")(plan.command)
app.command("check")(check.command)
app.command("compare")(compare.command)
app.command("info")(info.command)
app.command("new")(new.command)
app.command("run")(run.command)
app.command("schema")(schema.command)
app.command("stability")(stability.command)
app.command("validate")(validate.command)
app.command("work-precision")(work_precision.command)


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
