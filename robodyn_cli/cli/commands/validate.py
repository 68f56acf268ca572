"""``robodyn validate``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.options import Overrides, SceneFiles, Strict, Told
from robodyn_cli.errors import worst

if TYPE_CHECKING:
    from robodyn_cli.summaries.checks import Finding


EXAMPLES = (
    "validate configs/*.yaml",
    "validate configs --strict",
    "validate configs/2r_circle.yaml --json",
)


def command(scenes: SceneFiles, told: Told, overrides: Overrides = None, strict: Strict = False) -> int:
    """List the errors of each scene; return the exit code of the worst finding."""
    from robodyn_cli.over.batch.reports import validation_of
    from robodyn_cli.over.batch.stored import gather, name_of
    from robodyn_cli.results.summary import as_keys
    from robodyn_cli.summaries.checks import SceneFindings

    console = told.console
    report, codes = [], []
    for path in gather(scenes):
        findings = _findings(path, overrides or (), strict, console)
        codes.append(worst(f.exit_code for f in findings))
        name = name_of(path)
        report.append(SceneFindings(name, codes[-1], findings))
        errors = sum(f.severity == "error" for f in findings)
        counts = {"error": errors, "warning": len(findings) - errors}
        words = [f"{n} {severity}{'s' if n > 1 else ''}" for severity, n in counts.items() if n]
        console.say(f"{name}: {', '.join(words) or 'ok'}")
        for finding in findings:
            console.say(f"  {finding.severity}: {finding.message}")
            if console.quiet and finding.severity == "error":
                console.error(finding.message)
    code = worst(codes)
    console.data(as_keys(validation_of(report, code)))
    return code


def _findings(path: Path, overrides: Sequence[str], strict: bool, console: Console) -> list[Finding]:
    from robodyn_cli.over.findings import findings

    with console.waiting(lambda: f"validating {path}"):
        return findings(path, strict, overrides)
