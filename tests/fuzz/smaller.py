"""Make a case that shows a fault smaller: leave out what the fault does not need."""

from __future__ import annotations

import copy
import time
from pathlib import Path

import yaml

from tests.fuzz.cases import Case, try_case
from tests.fuzz.mutate import cut, dump, get, places

SECONDS = 60.0


def smaller(case: Case, finding: str, folder: Path, seconds: float) -> Case:
    """Return a case with the same finding and as few parts of the scene as a minute of trying gets to."""
    try:
        tree = yaml.safe_load(case.files["scene.yaml"])
    except (KeyError, yaml.YAMLError, ValueError):
        return case
    end = time.monotonic() + SECONDS
    changed = True
    while changed and time.monotonic() < end:
        changed = False
        for path in sorted(list(places(tree))[1:], key=len):
            trial = copy.deepcopy(tree)
            try:
                get(trial, path)
                cut(trial, path)
            except (KeyError, IndexError, TypeError):
                continue  # went with something above it
            found = Case(
                case.command, {**case.files, "scene.yaml": dump(trial).encode(errors="replace")}, case.words
            )
            if time.monotonic() < end and try_case(found, folder, seconds).finding == finding:
                tree, case, changed = trial, found, True
    return case
