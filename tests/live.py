"""Runs of a page under node, beside those of the program."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.over.live.structure import LiveStructure
from robodyn_cli.over.many.command import ManyRuns
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.scene.load import Family
from tests.node import run_node
from tests.source import PACKAGE

SCRIPTS = [PACKAGE / "report" / "page" / f"{name}.js" for name in ("rules", "runner", "given", "sweep")]
RUN = """
const runner = await Runner.of(data.live, Uint8Array.from(Buffer.from(data.code, 'base64')));
return data.rows.map((row) => runner.run(row));
"""
Ranges = Mapping[str, tuple[float, float]]


def live_data(live: LiveStructure) -> dict[str, Any]:
    """Return what a page gets of a structure."""
    made = live.module()
    data = {**live.data(), "code": {"imports": list(made.imports), "constants": made.constants}}
    return {"live": data, "code": base64.b64encode(made.code).decode()}


def in_node(data: Mapping[str, Any], script: str, folder: Path) -> Any:
    scripts = "\n".join(["class Chart {}", *(path.read_text() for path in SCRIPTS)])  # which draws
    return run_node(scripts + script, data, folder)


def run_live(live: LiveStructure, rows: np.ndarray, folder: Path) -> list[dict[str, Any]]:
    """Return the runs of a page with rows of values (N, keys)."""
    return list(in_node({**live_data(live), "rows": rows.tolist()}, RUN, folder))


def random_rows(ranges: Ranges, count: int, seed: int) -> np.ndarray:
    low, high = np.array(list(ranges.values())).T
    return np.asarray(np.random.default_rng(seed).uniform(low, high, (count, len(low))))


def run_many(family: Family, ranges: Ranges, rows: np.ndarray, **options: Any) -> ManyRuns:
    """Return the same runs by the program."""
    mechanism = Mechanism(family, list(ranges))
    make = mechanism.deploy_many if family.own.command == "deploy" else mechanism.simulate_many
    return make(rows, **options)


def disagreements(pages: Sequence[Mapping[str, Any]], runs: ManyRuns) -> tuple[list[str], int]:
    """Return where pages and the program disagree beyond their errors and 1e-12 of the size, and how many runs were
    refused by the page."""
    wrong, refused = [], 0
    for k, page in enumerate(pages):
        if "refused" in page:
            refused += 1
            continue
        if runs.code[k]:
            wrong.append(f"{runs.values[k]}: the page answers, the program refuses: {runs.reason[k]}")
            continue
        pairs = {
            "time": (page["time"], runs.time[k], page["time_error"], runs.time_error[k]),
            "q": (page["q"], runs.q[k], page["q_error"], runs.q_error[k]),
            "qd": (page["v"], runs.qd[k], page["v_error"], runs.qd_error[k]),
        }
        for name, (own, other, error, stated) in pairs.items():
            apart = np.abs(np.array(own) - other)
            allowed = np.array(error) + np.nan_to_num(stated) + 1e-12 * np.max(np.abs(other), initial=0.0)
            if not (apart <= allowed).all():
                wrong.append(f"{runs.values[k]}: {name} {own} and {other}, apart {apart}, allowed {allowed}")
    return wrong, refused
