"""``robodyn schema``."""

from __future__ import annotations

from robodyn_cli.cli.options import Printed

EXAMPLES = (
    "schema",
    "schema > scene.schema.json",
)


def command(printed: Printed) -> int:
    """Print the JSON Schema; return the exit code."""
    from robodyn_cli.scene.types import Scene
    from robodyn_cli.schema.json_schema import json_schema

    printed.console.data(json_schema(Scene, "Scene of robodyn"))
    return 0
