"""Each key of a scene has an example in docs/scene.md, and examples that are whole scenes run."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

import pytest

from robodyn_cli import load_scene_text
from robodyn_cli.over.commands import execute
from robodyn_cli.scene.read import Reader
from robodyn_cli.scene.text import attach as attachments
from robodyn_cli.scene.text.nodes import Mapping
from robodyn_cli.tools.progress import Stopwatch, no_progress
from tests.unit.test_docs import ROOT, YAML_BLOCKS, completed, reference

HERE = str(ROOT / "configs" / "example.yaml")
WHOLE = [(page, block) for page, block, _ in YAML_BLOCKS if "schema: 1\n" in block]


@lru_cache
def shown() -> set[tuple[str, str]]:
    """Return the keys that the examples of docs/scene.md write themselves, each with the section it is in."""
    found: set[tuple[str, str]] = set()
    inner = Reader.section

    def section(self: Reader, kind: Any, node: Any, *rest: Any) -> Any:
        if isinstance(node, Mapping):
            # what stands in the lines that complete an example, or in a file that it names, does not count
            found.update(
                (kind.cls.__name__, key.text)
                for key, _ in node.entries
                if key.source.name == HERE and key.line > first
            )
        return inner(self, kind, node, *rest)

    def attached(robot: Any, item: Any, *rest: Any) -> Any:
        # attachments have become joints and links by the time they are read
        found.update(("Attachment", key.text) for key, _ in item.entries)
        return attach(robot, item, *rest)

    attach = attachments._attached
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Reader, "section", section)
        patch.setattr(attachments, "_attached", attached)
        for page, block, base in YAML_BLOCKS:
            if page == "scene.md":
                text = completed(block, base)
                first = text.count("\n") - block.count("\n")
                load_scene_text(text, HERE)
                if re.search(r"type: table, file: ", block):
                    # a file has become columns and rows by the time it is read
                    found.add(("TableTrajectory", "file"))
                if "{mesh: " in block:
                    found.add(("Shape", "mesh"))  # likewise
                if "  attach:" in block:
                    found.add(("Robot", "attach"))
    return found


@pytest.mark.parametrize("name", reference().sections())
def test_every_key_has_an_example(name: str) -> None:
    keys = set(reference().keys(reference().sections()[name]))
    missing = {key for key in keys if (name, key) not in shown()}
    assert not missing, f"docs/scene.md shows no example of {', '.join(sorted(missing))}"


def test_there_are_whole_scenes() -> None:
    assert any(page == "scene.md" for page, _ in WHOLE)


@pytest.mark.parametrize(("page", "block"), WHOLE)
def test_whole_scenes_run(page: str, block: str) -> None:
    scene = load_scene_text(block, HERE)
    assert scene.command is not None, "a whole scene says what to do with it"
    assert execute(scene.command, scene, no_progress, Stopwatch()).status in ("ok", "locked")
