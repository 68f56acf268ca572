"""The command line: one file a command, one line here."""

from __future__ import annotations

import sys

import typer

from robodyn_cli.cli import deploy, inverse, plan, simulate
from robodyn_cli.version import __version__

app = typer.Typer(
    name="robodyn",
    help="Inverse dynamics and simulation of robots and closed-loop mechanisms described in YAML.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.command("inverse")(inverse.command)
app.command("simulate")(simulate.command)
app.command("deploy")(deploy.command)
app.command("plan")(plan.command)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"robodyn {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    pass


def main() -> None:
    """Run the command line; the exit code is the contract's (docs/cli.md)."""
    # a reader that closes the pipe early (robodyn ... | head) is not an error of ours
    try:
        app()
    except BrokenPipeError:
        sys.stderr.close()
        raise SystemExit(0) from None
