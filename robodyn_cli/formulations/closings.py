"""Latches that compiled code closes by an impulse, so that a run goes on there without Python."""

from __future__ import annotations

from robodyn_cli.equations.latches import are_plain, closing_alone
from robodyn_cli.equations.problem import Problem
from robodyn_cli.formulations.layout import Layout
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.record import record


@record
class Closings:
    """The latches of a system that compiled code closes, each by itself.

    program : see ``closing_alone``. first : of each latch's parameters, ``FIELDS``. q, v : coordinates that they hold.
    """

    program: Program
    first: tuple[int, ...]
    q: tuple[int, ...]
    v: tuple[int, ...]

    @staticmethod
    def of(problem: Problem, layout: Layout | None) -> Closings | None:
        """Return them where all latches are plain."""
        if not are_plain(problem):
            return None
        outputs = closing_alone(problem)
        if layout is not None:
            outputs = {name: layout.renamed(values) for name, values in outputs.items()}
        places = [(row.place, row.q, row.v) for row in problem.latches]
        return Closings(make_program(outputs, STATE_GROUPS), *(tuple(x) for x in zip(*places)))  # type: ignore[arg-type]

    @property
    def digest(self) -> str:
        """Key of everything that decides the compiled code."""
        return f"{self.program.digest} {self.first} {self.q} {self.v}"
