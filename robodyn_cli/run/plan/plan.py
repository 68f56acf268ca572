"""What a scene needs and what is left out, from the graphs that its command compiles.

    operations          of the program that the command's inner loop runs: torques (inverse), accelerations
    operations_general  of the same program with every constant of the scene a symbol

An operation is an addition, a multiplication, a division or a call of a function.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.equations.plan_facts import Facts, idle_constants, plural, unknown_data
from robodyn_cli.equations.plan_terms import (
    Ledger,
    element_terms,
    fixed_links,
    force_terms,
    geometry_terms,
    loop_terms,
    rigid_body_terms,
)
from robodyn_cli.equations.plan_variants import general
from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.variant import Variant
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import count_operations
from robodyn_cli.model.build import build_model
from robodyn_cli.run.plan.forward import Forward
from robodyn_cli.run.plan.inverse import Inverse
from robodyn_cli.run.plan.text import render
from robodyn_cli.scene import types as sc

__all__ = ["plan", "render"]

COMMANDS = ("inverse", "simulate", "deploy")
# operations of all variants up to which they are built one by one, a second or two of work
LARGEST = 300_000
VARIANTS = 25


def command_of(scene: sc.Scene) -> str:
    """Return the command that a scene is made for."""
    if scene.command in COMMANDS:
        return str(scene.command)
    return "inverse" if scene.trajectory is not None else "simulate"


@np.errstate(all="ignore")  # what absurd data make of the figures is no news for a terminal
def plan(scene: sc.Scene, command: str | None = None) -> dict[str, Any]:
    """Return what the command keeps and leaves out of the general problem, ready for JSON.

    Parameters
    ----------
    command : ``inverse``, ``simulate`` or ``deploy``; default: the scene's own.

    Returns
    -------
    ``operations``, ``operations_general``; ``kept`` (term, reason, operations: what leaving it out would
    save); ``left_out`` (term, reason, operations_saved); ``kernels``; ``choices`` of the engine with their
    reasons; ``equation_36`` for mechanisms with loops; ``missing`` data, without which the command stops.
    Counts are None where single terms of a large model are not counted.

    Raises
    ------
    CapabilityError : the command cannot do this scene. GeometryError : its loops cannot close.
    """
    command = command or command_of(scene)
    if command not in COMMANDS:
        raise CapabilityError(f"{command!r} has no plan; allowed: {', '.join(COMMANDS)}")
    subject: Inverse | Forward = Inverse(scene) if command == "inverse" else Forward(scene, command)
    problem = subject.problem
    outputs = subject.outputs(problem)
    missing, spare = unknown_data(problem.model, outputs)
    total = count_operations(outputs)
    kernels = [] if missing else subject.kernels()
    scene = problem.scene
    variant = Variant(scene, build_model(scene), rows=subject.kept_rows, dependent=problem.dependent)

    def count(v: Variant) -> int:
        return count_operations(subject.outputs(v.problem()))

    everything = count(general(variant))
    counted = everything * VARIANTS <= LARGEST
    ledger = Ledger(variant, Facts(variant.model), count, total, counted)
    idle: list[str] = []
    if counted:
        idle = idle_constants(
            scene, lambda model: subject.outputs(Problem(scene, model=model, dependent=problem.dependent))
        )
    subject.stages(ledger)
    rigid_body_terms(ledger, problem)
    geometry_terms(ledger, idle, spare)
    fixed_links(ledger, problem)
    loop_terms(ledger, problem, forward=command != "inverse")
    force_terms(ledger)
    element_terms(ledger)
    subject.more_terms(ledger)
    found = {
        "command": command,
        "title": scene.title,
        "mechanism": describe(problem, len(subject.redundant)),
        "operations": total,
        "operations_general": everything,
        "ratio": round(everything / total, 3) if total else None,
        "kept": ledger.kept,
        "left_out": ledger.left_out,
        "kernels": kernels,
        "choices": subject.choices(),
        "missing": missing,
        "not_given_and_not_needed": spare,
        "given_without_effect": idle,
        "terms_counted": counted,
    }
    if problem.model.loops:
        found["equation_36"] = subject.equation_36(ledger)
    return found


def describe(problem: Problem, redundant: int) -> str:
    """Return the mechanism in a few words."""
    model = problem.model
    parts = [
        plural(len(model.bodies), "moving body").replace("bodys", "bodies"),
        plural(len(model.joint_names), "joint"),
    ]
    if model.loops:
        parts.append(plural(len(model.loops), "loop"))
        rows = len(problem.working.rows)
        every = len(problem.constraints.rows) + len(problem.constraints.dropped)
        every += 0 if problem.dependent else redundant
        parts.append(f"{plural(rows, 'constraint row')} of {every}")
    else:
        branching = len({b.parent for b in model.bodies}) < len(model.bodies)
        parts.append("an open tree" if branching else "an open chain")
    fixed = sum(j.type == "fixed" for j in problem.scene.robot.joints)
    if fixed:
        parts.append(f"{plural(fixed, 'fixed link')} merged into the parent")
    return ", ".join(parts)
