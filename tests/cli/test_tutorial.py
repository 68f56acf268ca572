"""The notebook of the documentation: its cells run, and what they show is shown."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.tool import ROOT

NOTEBOOK = ROOT / "docs" / "tutorial.ipynb"
SHOWN = ("_repr_html_", "_repr_png_")


def run(source: str, names: dict[str, Any]) -> Any:
    """Run a cell as a kernel does; return the value of its last line, None where that is no expression."""
    tree = ast.parse(source, str(NOTEBOOK))
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, str(NOTEBOOK), "exec"), names)
    return (
        eval(compile(ast.Expression(last.value), str(NOTEBOOK), "eval"), names) if last is not None else None
    )


def test_the_tutorial_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    monkeypatch.chdir(NOTEBOOK.parent)
    before = sorted(Path().iterdir())
    names: dict[str, Any] = {}
    shown = []
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None, "stored without what it shows"
            value = run("".join(cell["source"]), names)
            views = [view() for kind in SHOWN if (view := getattr(value, kind, None)) is not None]
            shown += [len(view) for view in views if view is not None]
    assert sorted(Path().iterdir()) == before, "nothing is written"
    assert len(shown) == 11 and min(shown) > 5000, shown
    text = capsys.readouterr().out
    assert "peak torque 168.285 N m" in text and "locked at 12.2829956 s" in text
    assert "phase 60.27 deg" in text and "overshoot 0.042 %, settled after 0.8639 s" in text
    saved = names["weights"]["outputs/loop.cart.delay_margin"]
    assert np.all(np.diff(saved) > 0.0), "a weaker controller bears a later torque"
    found, fitted = names["found"], dict(zip(names["masses"], names["fitted"]))
    assert fitted == pytest.approx({key: slope["derivative"] for key, slope in found.items()}, rel=0.1)
