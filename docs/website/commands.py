"""What the site adds to the page of each command: its help, its examples, what it draws and what its summary holds."""

from __future__ import annotations

from pathlib import Path

from robodyn_cli.commands import COMMANDS
from website.gallery import figure, names, picture
from website.pages import Site
from website.runs import Shot, examples
from website.text import slug

LONGEST_OUTPUT = 40  # lines
CLI = "docs/cli.md"
# sections of summaries that are not named after a command
SIMULATED, JSON = "simulate-and-deploy", "what-other-commands-print-as-json"


def add_commands(site: Site, out: Path, shots: list[Shot]) -> None:
    """Add to the page of each command; ``shots`` have been run."""
    for command in COMMANDS:
        page = site.pages[f"commands/{command}.md"]
        page.below = head(command, out, shots)
        page.after = foot(site, command)


def head(command: str, out: Path, shots: list[Shot]) -> str:
    """Return what stands above the options of a command."""
    lines = "\n".join(f"robodyn {line}" for line in examples(command))
    parts = [COMMANDS[command].help, f"```sh\n{lines}\n```"]
    own = [shot for shot in shots if shot.command == command]
    first = next((shot for line in examples(command) for shot in own if shot.words == line), None)
    if first:
        printed = first.printed(out).splitlines()
        cut = ["  ..."] if len(printed) > LONGEST_OUTPUT else []
        parts.append(
            "The first of them prints\n\n```text\n" + "\n".join([*printed[:LONGEST_OUTPUT], *cut]) + "\n```"
        )
        drawn = first.pictures(out)
        order = [name for name in names(COMMANDS[command].plots) if name in drawn]
        if order:
            kind = "mechanism" if "mechanism" in order else order[0]
            words = f"[{kind}](../gallery/plots.md#{kind}), one of the plots that it draws"
            parts.append(
                figure(f"../{picture(first, kind)}", words=words, alt=f"{kind} by robodyn {first.words}")
            )
    return "\n\n".join(parts)


def foot(site: Site, command: str) -> str:
    """Return what stands below the options of a command."""
    row, parts = COMMANDS[command], []
    if row.plots:
        links = ", ".join(f"[{kind}](../gallery/plots.md#{kind})" for kind in dict.fromkeys(names(row.plots)))
        parts.append(f"## Plots\n\nOf these it draws what the result has the data for: {links}.")
    if row.summary:
        own = site.homes.get((CLI, slug(command)), site.homes[CLI, SIMULATED] if row.run else None)
        if own:
            parts.append(f"## Summary\n\nThe keys of its `summary.json` are in [summary.json](../{own[0]}).")
        else:
            home, anchor = site.homes[CLI, JSON]
            parts.append(
                f"## JSON\n\nThe keys of what it prints with `--json` are [here](../{home}#{anchor})."
            )
    return "\n\n".join(parts) + "\n" if parts else ""
