"""``robodyn schema``."""

from __future__ import annotations

from robodyn_cli.cli.console import Console

EXAMPLES = (
    "schema",
    "schema > scene.schema.json",
)


def command() -> int:
    """Print the JSON Schema; return the exit code."""
    from robodyn_cli.scene.types import Scene
    from robodyn_cli.schema.json_schema import json_schema

    Console(as_json=True).data(json_schema(Scene, "Scene of robodyn"))
    return 0
