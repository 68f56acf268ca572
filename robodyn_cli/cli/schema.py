"""``robodyn schema``."""

from __future__ import annotations

from robodyn_cli.cli.console import Console, guarded


def command() -> None:
    """Print the JSON Schema of scenes, for editors."""

    def action() -> int:
        import json

        from robodyn_cli.scene.types import Scene
        from robodyn_cli.schema.json_schema import json_schema

        console.data(json.dumps(json_schema(Scene, "Scene of robodyn"), ensure_ascii=False, indent=2))
        return 0

    console = Console(as_json=True)
    guarded(console, action)
