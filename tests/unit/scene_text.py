"""A small scene to spoil, and the place where the complaint must point."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.scene import load_scene_text
from robodyn_cli.scene.text.nodes import Faults, Mapping, Node, Scalar, Sequence, Source
from robodyn_cli.scene.text.yaml_text import compose

FILE = "bad.yaml"
MARK = "§"

SCENE = """\
schema: 1
gravity: [0, -9.81, 0]
parameters: {k: 0.1}
robot:
  convention: standard
  joints:
    - {name: j1, type: revolute, a: 1.0, alpha: 0, d: 0}
    - {name: j2, type: prismatic, a: 0, alpha: 90 deg, theta: 0}
    - {name: weld, type: fixed, parent: l1, origin: {xyz: [0.1, 0, 0]}}
  links:
    - {name: l1, mass: 1, com: [0.5, 0, 0], com_frame: joint}
    - {name: l2, mass: 1}
    - {name: l3, mass: 1}
  points:
    tip: {link: l2, at: end}
    post: {link: base, at: [1, 0, 0]}
torques: {j1: 1}
initial: {q: {j1: 0.1}}
"""


def plain(node: Node) -> Any:
    """Return a tree as Python values."""
    if isinstance(node, Mapping):
        return {key.text: plain(value) for key, value in node.entries}
    if isinstance(node, Sequence):
        return [plain(item) for item in node.items]
    assert isinstance(node, Scalar)
    return node.value


def composed(text: str) -> Node:
    """Return the tree of a YAML text that has no faults."""
    faults = Faults()
    root = compose(text, Source("test.yaml", "."), faults)
    assert not faults.found
    return root


def spoiled(old: str, new: str, scene: str = SCENE) -> str:
    """Return the scene with ``old``, which stands there once, replaced; an empty ``old`` appends."""
    if not old:
        return scene + new
    assert scene.count(old) == 1, old
    return scene.replace(old, new)


def unmarked(text: str) -> tuple[str, int, int]:
    """Return the text without its mark, and the mark's line and column."""
    assert text.count(MARK) == 1
    before, after = text.split(MARK)
    return before + after, before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1


def complaint(text: str, overrides: tuple[str, ...] = (), path: str = FILE) -> SceneError:
    """Return the error of a scene that must not load."""
    with pytest.raises(SceneError) as caught:
        load_scene_text(text, path, overrides)
    assert "\n" not in caught.value.message
    assert {"file", "line", "column", "key"} <= set(caught.value.details)
    return caught.value


def check_place(marked: str, key: str, *fragments: str) -> None:
    """Check that the scene is refused at the mark, for this key, with these words."""
    text, line, column = unmarked(marked)
    error = complaint(text)
    prefix = f"{FILE}:{line}:{column}: " + (f"{key}: " if key else "")
    assert error.message.startswith(prefix), f"{error.message!r} does not start with {prefix!r}"
    expected = {"file": FILE, "line": line, "column": column, "key": key}
    assert {name: error.details[name] for name in expected} == expected
    for fragment in fragments:
        assert fragment in error.message[len(prefix) :], error.message


def refusals(cases: dict[str, tuple[str, ...]]) -> Callable[[str], None]:
    """Return the test that each case is refused at its place.

    cases : by name, what is replaced, by what, with a mark; the key that is complained of, words of the message.
    """

    @pytest.mark.parametrize("name", cases)
    def test(name: str) -> None:
        old, new, key, *words = cases[name]
        check_place(spoiled(old, new), key, *words)

    return test
