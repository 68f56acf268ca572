"""Numbers that the script of a page writes: the same as those that stand in its tables."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np

from robodyn_cli.report.page.tables import Quantity, written
from robodyn_cli.summaries.facts import rounded_up
from tests.node import needs_node, run_node

WORDS = (files("robodyn_cli.report.page") / "words.js").read_text(encoding="utf-8")


@needs_node
def test_the_script_writes_numbers_with_errors_as_tables_do(tmp_path: Path) -> None:
    random = np.random.default_rng(7)
    values = random.normal(size=600) * 10.0 ** random.integers(-12, 12, 600)
    errors = 10.0 ** random.uniform(-16, 8, 600)
    fixed = [(9.1455, 17.4), (-4e-14, 9e-12), (0.0, 2e-9), (12.5, 2e-9), (1.0, 0.3), (250.0, 999.9), (1e-9, 1e-9),
             (123456.0, 1000.0), (-3e20, 1e12), (7.0, 1e-300)]  # fmt: skip
    pairs = [*zip(values.tolist(), errors.tolist()), *fixed]
    script = f"{WORDS}\nreturn data.map(([x, error]) => [stated(x, error, 'N·m'), roundedUp(error, 2)]);"
    for (x, error), (told, up) in zip(pairs, run_node(script, pairs, tmp_path), strict=True):
        assert told == written(Quantity(x, "N m", error)), (x, error)
        assert up == rounded_up(error)
