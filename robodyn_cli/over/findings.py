"""What is wrong with a scene before it runs: the file itself, its bodies, its loops, data that its command needs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.errors import RobodynError, SceneError
from robodyn_cli.model.consistency import doubtful_parts
from robodyn_cli.over.commands import check, command_of, owners, place
from robodyn_cli.over.plan.text import listed_data
from robodyn_cli.scene.checks.check import key_place
from robodyn_cli.scene.load import Family, examine
from robodyn_cli.scene.text.nodes import Node, dotted, located, name_of, nearest
from robodyn_cli.scene.types import Scene
from robodyn_cli.summaries.checks import Finding


@np.errstate(all="ignore")  # what is found is said in words
def findings(path: Path, strict: bool = False, overrides: Sequence[str] = ()) -> list[Finding]:
    """Return all that is wrong with a scene file with some keys changed, errors first; warnings are errors with
    ``strict``."""
    examined = examine(path, overrides)
    if examined.scene is None or examined.root is None:
        return [_error(e) for e in examined.errors]
    scene, root = examined.scene, examined.root
    listed = [_error(e) for e in (*_trial(scene, root), *_varied(path, overrides, scene, root))]
    code = SceneError.exit_code if strict else 0
    for error in _physical(scene, root):
        listed.append(Finding("error" if strict else "warning", error.message, code, **_place(error)))
    return listed


def _error(error: RobodynError) -> Finding:
    return Finding("error", error.message, error.exit_code, **_place(error))


def _place(error: RobodynError) -> dict[str, Any]:
    return {key: error.details[key] for key in ("file", "line", "column", "key") if key in error.details}


def _physical(scene: Scene, root: Node) -> list[SceneError]:
    errors = [SceneError(text) for text in scene.warnings]
    errors += [_at(root, path, f"{name}: {text}") for path, name, text in doubtful_parts(scene)]
    return errors


def _at(root: Node, path: tuple[str | int, ...], message: str) -> SceneError:
    """Return an error at the node of a path, or at the nearest one above it."""
    return located(nearest(root, path), dotted(path), message)


def _trial(scene: Scene, root: Node) -> list[RobodynError]:
    """Try what the scene's command does before its first step."""
    given = scene.trajectory is not None or scene.initial.q or scene.loops or scene.couplers
    if scene.command is None and not given:
        return []  # a robot alone
    command = command_of(scene)
    try:
        return _missing(root, command, check(command, scene))
    except RobodynError as error:
        place(error, lambda: root, command)
        return _missing(root, command, error.details.get("missing", ())) or [error]


def _varied(path: Path, overrides: Sequence[str], scene: Scene, root: Node) -> Iterator[SceneError]:
    """Yield what `sweep` and `optimise` would refuse of the keys that vary, and of what is looked for."""
    sections = {"study": scene.study.vary, "search": {} if scene.search is None else scene.search.vary}
    if not any(sections.values()):
        return
    from robodyn_cli.over.many.keys import Allowed, understand
    from robodyn_cli.over.study.study import check_key, varied

    family = Family(path, overrides)
    for section, vary in sections.items():
        for key, variation in vary.items():
            asked = varied(key, variation)
            try:
                check_key(family, key, variation)
                ends = np.array(variation.arguments if section == "search" else ())[:, None]
                keys = [understand(family, key, asked)] if len(ends) else []
                for error in Allowed(family, keys, asked).refusals(ends).values():
                    raise error
            except SceneError as error:
                yield _at(root, key_place(root, (section, "vary"), key), error.beyond(asked))


def _missing(root: Node, command: str, names: Sequence[str]) -> list[RobodynError]:
    """Return an error for each link or payload that lacks data which the command needs."""
    errors: list[RobodynError] = []
    for path in owners(root, names):
        owner = name_of(nearest(root, path))
        here = [name for name in names if name.endswith(f" of {owner}")]
        message = f"{command} needs {listed_data(here)}, which the scene does not give"
        errors.append(_at(root, path, message))
    return errors
