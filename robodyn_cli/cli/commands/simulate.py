"""``robodyn simulate``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robodyn_cli.cli.options import NO_ERROR_ESTIMATE, NoErrorEstimate, SceneFile, SharedOptions, Strict
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import (
    balance_lines,
    cost_lines,
    motorisation_lines,
    multiplier_lines,
    number,
)

if TYPE_CHECKING:
    from robodyn_cli.scene.load import GivenScene
    from robodyn_cli.scene.types import Scene


def describe(summary: Mapping[str, Any], verbose: bool = True, figures: Sequence[str] = ()) -> str:
    """Return the summary of a simulation."""
    given = ", ".join(f"{k} {v:.4g}" for k, v in summary.get("tolerances", {}).items())
    tolerances = f" ({given})" if verbose else ""
    lines = [
        f"{summary['title']}",
        f"  simulated          {number(summary['termination'].get('time'))} s, {summary['samples']} samples, "
        f"{summary['integrator']}{tolerances}",
        *figures,
        *multiplier_lines(summary),
        *_of_controller(summary, verbose),
        *_happenings(summary),
        *balance_lines(summary),
        *motorisation_lines(summary),
        *cost_lines(summary, verbose),
    ]
    return "\n".join(lines)


def _of_controller(summary: Mapping[str, Any], verbose: bool) -> list[str]:
    """Return lines about the controller, where there is one."""
    if "control" not in summary:
        return []
    from robodyn_cli.cli.control_words import control_lines

    return control_lines(summary["control"], verbose)


def _happenings(summary: Mapping[str, Any]) -> list[str]:
    """Return lines about latches and payloads, where there are some."""
    if "locks" not in summary and "payloads" not in summary:
        return []
    from robodyn_cli.cli.latch_words import latch_lines, payload_lines

    return [*latch_lines(summary), *payload_lines(summary)]


EXAMPLES = (
    "simulate configs/double_pendulum.yaml",
    "simulate configs/double_pendulum.yaml --set initial.q.theta2='90 deg' --set simulate.duration=20 "
    "--out outputs/long",
    "simulate configs/cart_pole_lqr.yaml --out outputs/cart",
)


def in_python(
    scene: GivenScene, overrides: Sequence[str], controller: Any = None, period: float | None = None
) -> tuple[Scene, Sequence[str]]:
    """Return the scene with a function ``f(t, q, qd)`` as its controller, sampled every ``period`` seconds.

    Beside it the overrides that are left to apply: none where they say what controller the function takes the place of.
    """
    from robodyn_cli.scene.load import load_scene
    from robodyn_cli.works.in_python import controlled_by

    loaded = load_scene(scene)
    if controller is None and period is None:
        return loaded, overrides
    if loaded.control is not None or any(text.partition("=")[0].strip() == "control" for text in overrides):
        loaded, overrides = load_scene(loaded, overrides), ()
    return controlled_by(loaded, controller, period), overrides


def command(
    scene: SceneFile,
    shared: SharedOptions,
    strict: Strict = False,
    no_error_estimate: NoErrorEstimate = False,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Go on with a long run that was killed, from its last written block."),
    ] = False,
) -> int:
    """Run the simulation, from its start or from where it was killed."""
    job = shared.job("simulate", scene, strict, NO_ERROR_ESTIMATE if no_error_estimate else (), resume=resume)
    return run_scene(job, shared.console, describe)
