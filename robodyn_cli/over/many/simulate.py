"""``simulate`` for many runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.many.command import Rows
from robodyn_cli.over.many.integrate import Batch, Driven, integrate
from robodyn_cli.over.many.motions import MotionCommand, column_of
from robodyn_cli.over.many.record import ManyRuns
from robodyn_cli.over.many.single import number_of
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

ERRORS = {"error_estimate.q_end": "q", "error_estimate.qd_end": "qd"}


class Simulate(MotionCommand):
    """Motions over their duration; ends are the last states."""

    name = "simulate"

    def build(self, scene: Scene) -> Motion:
        return build_motion(integrable(scene))

    def gives(self, key: str) -> bool:
        return key == "final.time" or key.startswith(("final.q.", "final.qd.")) or key in ERRORS

    def drive(self, batch: Batch, method: str, samples: int) -> Driven:
        return integrate(batch, method, samples)

    def output(self, key: str, result: ManyRuns, rows: Rows) -> Array:
        if key in ERRORS:
            return _largest_error(result, ERRORS[key], rows)
        if key == "final.time":
            return result.time[rows]
        _, group, name = key.split(".", 2)
        return column_of(result, group, name, rows)

    def error_of(self, key: str, result: ManyRuns, rows: Rows) -> Array | float:
        parts = key.split(".")
        return _largest_error(result, parts[1], rows) if parts[0] == "final" and len(parts) > 2 else math.nan

    def single(self, scene: Scene) -> Result:
        from robodyn_cli.works.simulate import simulate

        return simulate(scene)

    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        final = summary.get("final")
        if isinstance(final, Mapping):
            result.time[row] = final["time"]
            result.q[row] = [final["q"][name] for name in result.q_names]
            result.qd[row] = [final["qd"][name] for name in result.qd_names]
            result.steps[row] = summary["counters"]["steps"]
        for key, group in ERRORS.items():
            errors = result.q_error if group == "q" else result.qd_error
            errors[row] = number_of(summary, key)


def _largest_error(result: ManyRuns, group: str, rows: Rows) -> Array:
    errors: Array = result.q_error if group == "q" else result.qd_error
    return errors[rows].max(axis=1, initial=0.0)
