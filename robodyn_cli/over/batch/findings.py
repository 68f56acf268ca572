"""What is wrong with a scene before it runs: the file itself, its bodies, its loops, data that its command needs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.commands import COMMANDS
from robodyn_cli.errors import RobodynError, SceneError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.rolled import Rolled
from robodyn_cli.model.consistency import doubtful_bodies
from robodyn_cli.model.model import Model
from robodyn_cli.motion.build import payload_watchers
from robodyn_cli.observe.rounding import few
from robodyn_cli.over.commands import execute
from robodyn_cli.over.placing import owners, place
from robodyn_cli.over.plan.data import unknown_data
from robodyn_cli.over.plan.words import listed_data
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.ready.mass_matrix import refuse_indefinite
from robodyn_cli.ready.prepare import passive_coordinates, prepare, refuse_changes
from robodyn_cli.ready.singularity import passive_determinant
from robodyn_cli.record import record
from robodyn_cli.results.summary import ABSENT, Absent
from robodyn_cli.scene.load import examine
from robodyn_cli.scene.text.nodes import Node, dotted, located, name_of, nearest
from robodyn_cli.scene.types import Scene
from robodyn_cli.tools.progress import no_progress
from robodyn_cli.tools.stopwatch import Stopwatch
from robodyn_cli.trajectories.motion import JointMotion
from robodyn_cli.works.inverse import program_of

# at most so many samples of a trajectory are tried
TRIED = 501


@record
class Finding:
    """One thing that is wrong: ``severity`` is ``error`` or ``warning``, the message begins with the place.

    The fields are keys of the report; those of the place are there as far as it is known.
    """

    severity: str
    message: str
    exit_code: int
    file: str | Absent = ABSENT
    line: int | Absent = ABSENT
    column: int | Absent = ABSENT
    key: str | Absent = ABSENT


@np.errstate(all="ignore")  # what is found is said in words
def findings(path: Path, strict: bool = False) -> list[Finding]:
    """Return all that is wrong with a scene file, errors first; warnings are errors with ``strict``."""
    examined = examine(path)
    if examined.scene is None or examined.root is None:
        return [_error(e) for e in examined.errors]
    scene, root = examined.scene, examined.root
    found = [_error(e) for e in _trial(scene, root)]
    code = SceneError.exit_code if strict else 0
    for error in _physical(scene, root):
        found.append(Finding("error" if strict else "warning", error.message, code, **_place(error)))
    return found


def _error(error: RobodynError) -> Finding:
    return Finding("error", error.message, error.exit_code, **_place(error))


def _place(error: RobodynError) -> dict[str, Any]:
    return {key: error.details[key] for key in ("file", "line", "column", "key") if key in error.details}


def _physical(scene: Scene, root: Node) -> list[SceneError]:
    found = [SceneError(text) for text in scene.warnings]
    found += [_at(root, path, f"{name}: {text}") for path, name, text in doubtful_bodies(scene)]
    return found


def _at(root: Node, path: tuple[str | int, ...], message: str) -> SceneError:
    """Return an error at the node of a path, or at the nearest one above it."""
    return located(nearest(root, path), dotted(path), message)


def _trial(scene: Scene, root: Node) -> list[RobodynError]:
    """Try what the scene's command does before it computes anything."""
    command = scene.command or ("inverse" if scene.trajectory is not None else None)
    if command is None and (scene.loops or scene.couplers or scene.initial.q):
        command = "simulate"
    try:
        if command == "inverse":
            model, outputs = _inverse(scene)
        elif command is not None and COMMANDS[command].brief:
            try:
                execute(command, scene, no_progress, Stopwatch())
            except RobodynError as error:
                if getattr(error, "result", None) is None:  # else it ran, and ended on the way
                    raise
            return []
        elif command is not None:
            model, outputs = _forward(scene, command)
        else:
            return []
    except RobodynError as error:
        if "missing" in error.details:
            return _missing(root, command or "", error.details["missing"])
        place(error, lambda: root, command or "")
        return [error]
    return _missing(root, command, unknown_data(model, outputs)[0])


def _missing(root: Node, command: str, names: Sequence[str]) -> list[RobodynError]:
    """Return an error for each link or payload that lacks data which the command needs."""
    found: list[RobodynError] = []
    for path in owners(root, names):
        owner = name_of(nearest(root, path))
        here = [name for name in names if name.endswith(f" of {owner}")]
        what = f"{command} needs {listed_data(here)}, which the scene does not give"
        found.append(_at(root, path, what))
    return found


def _inverse(scene: Scene) -> tuple[Model, list[Scalar]]:
    program = program_of(scene)
    planned = program.plan(min(TRIED, scene.inverse.samples))
    refuse_indefinite(program.problem.scene, planned.motion.q[few(len(planned.times))])
    model, outputs = program.problem.model, [x for term in program.terms.values() for x in term]
    if not unknown_data(model, outputs)[0]:
        first = JointMotion(*(x[:1] for x in (planned.motion.q, planned.motion.qd, planned.motion.qdd)))
        times = planned.times[:1]
        program.compile(1).along(times, first, program.parameters(times))
    return model, outputs


def _forward(scene: Scene, command: str) -> tuple[Model, list[Scalar]]:
    if command == "deploy":
        from robodyn_cli.works.deploy.deploy import refuse_open_chain

        refuse_open_chain(scene)
        refuse_changes(scene, command)
    problem = prepare(integrable(scene)).problem
    payload_watchers(problem)
    if command == "deploy" and scene.deploy.criterion != "multipliers":
        passive_determinant(problem, passive_coordinates(problem))
    dynamics = build_system(problem, "none", work=False).dynamics
    # loops over bodies have asked for what they need when they were made
    outputs = dynamics.forces if isinstance(dynamics, Rolled) else dynamics.expressions()[0]
    return problem.model, list(outputs)
