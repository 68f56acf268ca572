"""``robodyn validate``."""

from __future__ import annotations

from typing import Annotated

from robodyn_cli.cli.console import Console, guarded
from robodyn_cli.cli.options import Quiet, ReportAsJson, Strict
from robodyn_cli.cli.parameters import argument


def command(
    scenes: Annotated[
        list[str],
        argument(metavar="SCENE...|GLOB|DIR", help="Scenes, patterns, folders."),
    ],
    as_json: ReportAsJson = False,
    quiet: Quiet = False,
    strict: Strict = False,
) -> None:
    """Check scenes and list all that is wrong."""
    console = Console(as_json, quiet)

    def action() -> int:
        import json

        from robodyn_cli.run.batch.findings import findings, worst
        from robodyn_cli.run.batch.gather import gather

        report = []
        for path in gather(scenes):
            found = findings(path, strict)
            code = worst([f.exit_code for f in found])
            report.append({"scene": str(path), "exit_code": code, "findings": [f.as_dict() for f in found]})
            errors = sum(f.severity == "error" for f in found)
            counts = {"error": errors, "warning": len(found) - errors}
            words = [f"{n} {what}{'s' if n > 1 else ''}" for what, n in counts.items() if n]
            console.say(f"{path}: {', '.join(words) or 'ok'}")
            for finding in found:
                console.say(f"  {finding.severity}: {finding.message}")
                if quiet and finding.severity == "error":
                    console.error(finding.message)
        total = worst([int(str(r["exit_code"])) for r in report])
        status = "ok" if total == 0 else "failed"
        console.data(
            json.dumps({"status": status, "exit_code": total, "scenes": report}, ensure_ascii=False, indent=2)
        )
        return total

    guarded(console, action)
