"""Loops that are closed elsewhere for other values: where that starts, and its steps as rules."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.live.rules import Tape, plain
from robodyn_cli.over.many.start import Starts
from robodyn_cli.ready.prepare import held_columns
from robodyn_cli.solve import closure
from robodyn_cli.solve.closing.together import ChosenPose, ManyClosing
from robodyn_cli.solve.closure import capped, least_steps

LIMITS = ("ITERATIONS", "HALVINGS", "PATIENT", "TINY", "CLOSED")  # of ``newton_of_many``
MOST_STARTS = 2000  # numbers of starts from which loops are closed, which a page has to bring along


def closing_of(motion: Motion, numbers: ManyNumbers, starts: Sequence[tuple[str, str]]) -> ManyClosing | None:
    """Return what closes the loops of a motion for other numbers and starts (group, column); None where they stay
    closed as they are."""
    problem, initial = motion.problem, motion.scene.initial
    if not problem.constraints.rows:
        return None
    given = {"q": {*initial.q}, "qd": {*initial.qd}}
    for group, column in starts:
        given[group].add(column)
    closing = ManyClosing(problem, numbers, given["q"], given["qd"], held_columns(motion.scene, problem))
    return closing if closing.varies or starts else None


def closing_data(closing: ManyClosing) -> dict[str, Any]:
    """Return coordinates that are missing and free, which rows are lengths, and where closing starts."""
    stages, room = [], MOST_STARTS
    for k, starts in enumerate(closing.stages):
        columns = closing.free if k else closing.missing
        room -= len(starts) * len(columns)
        if k and room < 0:
            break
        parts = plain(starts[:, columns].ravel())
        stages.append({"columns": columns, "starts": len(starts), "parts": parts})
    return {
        "missing": closing.missing, "free": closing.free, "long": closing.long.astype(int).tolist(),
        "stages": stages, **{name: getattr(closure, name) for name in LIMITS},
    }  # fmt: skip


def record_closing(
    closing: ManyClosing, starts: Starts, keep: Callable[[str, Tape, Mapping[str, Any]], None]
) -> None:
    """Record the steps of ``ManyClosing.close``, with examples at the structure's own start."""
    q, one = starts.q, np.ones(1)
    (eta, psi), cosines = closing.at_runs(q), np.ones((1, len(closing.long)))

    def taped() -> tuple[Tape, ManyClosing]:
        tape = Tape()
        return tape, closing.sized(tape.input("size", closing.size))

    for name, columns in (("missing", closing.missing), ("free", closing.free)):
        if columns:
            tape, scaled = taped()
            F = tape.input("eta", eta + 1e-3) / scaled.sizes
            J = tape.input("psi", psi)[:, :, columns] * scaled.lengths[:, None, columns]
            moves = capped(least_steps(J / scaled.sizes[:, :, None], -F)) * scaled.lengths[:, columns]
            keep(f"step.{name}", tape, {"step": moves @ np.eye(closing.nv)[columns]})
    tape, scaled = taped()
    part = tape.input("part", np.zeros((1, closing.nv)))
    keep("begin", tape, {"q": tape.input("q", q) + scaled.lengths * part})
    if closing.missing:
        tape = Tape()
        keep("wrapped", tape, {"q": closing.wrapped(tape.input("q", q))})
    tape, scaled = taped()
    examples: dict[str, Any] = {"q": q, "distance": one, "full": one, "sure": one}
    given = {name: tape.input(f"best.{name}", x) for name, x in examples.items()}
    there = {"q": q, "eta": eta, "psi": psi, "cosines": cosines}
    here = {name: tape.input(name, x) for name, x in there.items()}
    choice = scaled.preferred(ChosenPose(**given), tape.input("start", q), **here)
    keep("preferred", tape, {f"best.{name}": getattr(choice, name) for name in given})
    tape, scaled = taped()
    rates, sound = scaled.rates_of_closed(
        *(tape.input(name, x) for name, x in (("eta", eta), ("psi", psi), ("v", starts.v)))
    )
    sure = tape.input("best.sure", one) * tape.input("best.full", one) > 0.0
    keep("closed", tape, {"v": rates, "good": sound & sure})
