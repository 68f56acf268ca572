"""The terms that a scene needs and those left out, read off the equations and programs that its command builds.

    operations          of the program that the command's inner loop runs: torques (inverse), accelerations
    operations_general  of the same program with every constant of the scene a symbol

An operation is an addition, a multiplication, a division or a call of a function.
"""

from __future__ import annotations

import functools
import gc
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np

from robodyn_cli.commands import places
from robodyn_cli.decision import Decision
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.expr.graph import Scalar, count_operations, is_nonzero
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import Model
from robodyn_cli.over.commands import command_of
from robodyn_cli.over.plan.plane import Plane
from robodyn_cli.over.plan.terms import MECHANISM, Ledger, PlanEquations, Term
from robodyn_cli.over.plan.text import idle_constants, plural, render, unknown_data
from robodyn_cli.over.plan.variants import Variant, general
from robodyn_cli.registry import Registry
from robodyn_cli.results.summary import as_keys
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import zeros
from robodyn_cli.summaries.checks import Chosen, Kernel, LoopCosts, PlanReport
from robodyn_cli.summaries.facts import ABSENT

__all__ = ["plan", "render"]

# operations of all variants up to which they are built one by one, a second or two of work
LARGEST = 300_000
VARIANTS = 25


class Subject(Protocol):
    """A command's equations and programs, as the command builds them.

    inner : what the inner loop computes. problem : the equations. redundant : names of rows that follow from the others
    in every pose.
    """

    inner: str
    problem: Problem
    redundant: tuple[str, ...]

    def outputs(self, problem: Problem) -> list[Scalar]:
        """Return the expressions of the command's inner loop, for this problem or a variant of it."""

    def apart(self, here: Variant) -> dict[str, int]:
        """Return operations of other equations than the command's, by term; each in a graph that is gone then."""

    def terms(self, e: PlanEquations) -> Iterator[Term]:
        """Yield the terms of the command beside those of the mechanism: its stages, and the work around the inner
        loop."""

    def kernels(self) -> list[Kernel]:
        """Return the compiled programs."""

    def choices(self) -> list[Decision]:
        """Return the decisions of the builders."""

    def equation_36(self, ledger: Ledger) -> LoopCosts | None:
        """Return the operations of the loops, None where they are not counted."""


subjects: Registry[Callable[[sc.Scene], Subject]] = Registry("robodyn_cli", places("plan"))


@np.errstate(all="ignore")  # what absurd data make of the figures is no news for a terminal
def plan(scene: sc.Scene, command: str | None = None) -> dict[str, Any]:
    """Return the terms of the general problem that the command keeps and leaves out, ready for JSON.

    Parameters
    ----------
    command : one that has a plan; default: the scene's own.

    Returns
    -------
    ``status`` (``failed`` where data are missing); ``operations``, ``operations_general``; ``kept`` (term, reason,
    operations: what leaving it out would save); ``left_out`` (term, reason, operations_saved); ``kernels``;
    ``choices`` of the engine with their reasons; ``equation_36`` for mechanisms with loops; ``missing`` data,
    without which the command stops. Counts are None where single terms of a large model are not counted, and are
    ``operations_of`` torques or accelerations.

    Raises
    ------
    CapabilityError : the command has no plan, or cannot do this scene. GeometryError : its loops cannot close.
    """
    command = command or command_of(scene)
    subject = _subject_of(scene, command)
    problem, here = subject.problem, _variant_of(subject)
    everything, apart, acting = _first(subject, here)
    counted = _counted(everything)
    # before anything else is built in the same graph, so that the programs are those of the run
    kernels, choices, missing = _built(subject)
    outputs = subject.outputs(problem)
    needed, spare = unknown_data(problem.model, outputs)
    missing = list(dict.fromkeys([*needed, *missing]))
    ledger = Ledger(here, count_operations(outputs), functools.partial(_count, subject), counted)
    idle = _idle(subject) if counted else []
    equations = PlanEquations(here, problem, Plane(here.model), tuple(idle), tuple(spare), apart, acting)
    for term in itertools.chain(*(terms(equations) for terms in MECHANISM), subject.terms(equations)):
        ledger.enter(term)
    report = PlanReport(
        status="failed" if missing else "ok",
        command=command,
        title=problem.scene.title,
        mechanism=describe(problem, subject.redundant),
        operations=ledger.total,
        operations_general=everything,
        operations_of=subject.inner,
        ratio=round(everything / ledger.total, 3) if ledger.total else None,
        kept=ledger.kept,
        left_out=ledger.left_out,
        kernels=kernels,
        choices=[Chosen(d.choice, d.taken, d.reason, dict(d.operations) or ABSENT) for d in choices],
        missing=missing,
        not_given_and_not_needed=spare,
        given_without_effect=idle,
        terms_counted=ledger.counted,
        equation_36=subject.equation_36(ledger) or ABSENT,
    )
    return as_keys(report)


def _subject_of(scene: sc.Scene, command: str) -> Subject:
    """Return what the command plans of a scene."""
    if command not in subjects:
        raise CapabilityError(f"{command!r} has no plan; allowed: {', '.join(subjects)}", key="command")
    return subjects[command](scene)


def _built(subject: Subject) -> tuple[list[Kernel], list[Decision], list[str]]:
    """Return the compiled programs and the decisions, or the data without which they cannot be made."""
    try:
        return subject.kernels(), subject.choices(), []
    except SceneError as error:
        if "missing" not in error.details:
            raise
        return [], [], list(error.details["missing"])


def _variant_of(subject: Subject) -> Variant:
    """Return the subject's equations, ready to be changed, on a model of their own."""
    problem = subject.problem
    rows = problem.constraints.names if subject.redundant and not problem.dependent else None
    return Variant(
        problem.scene,
        build_model(problem.scene),
        rows=rows,
        dependent=problem.dependent,
        braces=problem.braces,
    )


def _count(subject: Subject, variant: Variant) -> int:
    """Return the operations of the inner loop for a variant."""
    return count_operations(subject.outputs(variant.problem()))


def _general(subject: Subject, here: Variant) -> int:
    """Return the operations of code for any scene."""
    with here.apart() as own:
        return _count(subject, general(own))


def _acting(here: Variant) -> frozenset[str]:
    """Return which of the rigid bodies' terms load a joint in any pose."""
    with here.apart() as own:
        problem = own.problem()
        coriolis = problem.newton_euler(problem.v, zeros(problem.model.nv), None)
        terms = {"coriolis": coriolis, "gravity": problem.gravity_torques}
        return frozenset(name for name, term in terms.items() if any(map(is_nonzero, term)))


def _counted(everything: int) -> bool:
    """Tell whether single terms are counted of equations of so many operations."""
    return everything * VARIANTS <= LARGEST


def _first(subject: Subject, here: Variant) -> tuple[int, dict[str, int], frozenset[str]]:
    """Return the operations of code for any scene, those of equations apart, and the terms that act, counted one after
    another, so that of a large scene one set of equations is there at a time."""
    everything = _general(subject, here)
    # a controller and its equations hold each other
    held = here.scene.control is not None and not _counted(everything)
    _collect(held)
    apart = subject.apart(here)
    _collect(held)
    acting = _acting(here)
    _collect(held)
    return everything, apart, acting


def _collect(held: bool) -> None:
    """Free equations that nobody needs any more, where they are ``held`` by each other."""
    # arrays hide from the collector what they hold, and go in its first pass themselves
    for _ in range(2 if held else 0):
        gc.collect()


def _idle(subject: Subject) -> list[str]:
    """Return given data of the links that have no effect."""
    own = subject.problem

    def outputs(model: Model) -> list[Scalar]:
        return subject.outputs(Problem(own.scene, model=model, dependent=own.dependent, braces=own.braces))

    return idle_constants(own.scene, outputs)


def describe(problem: Problem, redundant: Sequence[str]) -> str:
    """Return the mechanism in a few words."""
    model = problem.model
    parts = [plural(len(model.bodies), "moving body"), plural(len(model.joint_names), "joint")]
    if model.closures:
        rows, given = len(problem.independent_rows.rows), problem.constraints
        every = len(given.rows) + len(given.dropped) + (0 if problem.dependent else len(redundant))
        parts += [plural(len(model.loops), "loop")] if model.loops else []
        parts += [plural(len(model.couplers), "coupler")] if model.couplers else []
        parts.append(f"{plural(rows, 'constraint row')} of {every}")
    else:
        branching = len({b.parent for b in model.bodies}) < len(model.bodies)
        parts.append("an open tree" if branching else "an open chain")
    if fixed := sum(j.type == "fixed" for j in problem.scene.robot.joints):
        parts.append(f"{plural(fixed, 'fixed link')} merged into the parent")
    return ", ".join(parts)
