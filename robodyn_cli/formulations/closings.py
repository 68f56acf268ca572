"""Latches that compiled code closes by an impulse, so that a run goes on there without Python."""

from __future__ import annotations

from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.equations.latches import TOGETHER, without_held
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.functions import absolute, maximum
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.layout import Layout
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import dot, zeros


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
            renamed = iter(layout.renamed([x for values in outputs.values() for x in values]))
            outputs = {name: [next(renamed) for _ in values] for name, values in outputs.items()}
        places = [(row.place, row.q, row.v) for row in problem.latches]
        return Closings(make_program(outputs, STATE_GROUPS), *(tuple(x) for x in zip(*places)))  # type: ignore[arg-type]

    @property
    def digest(self) -> str:
        """Key of everything that decides the compiled code."""
        return f"{self.program.digest} {self.first} {self.q} {self.v}"


def are_plain(problem: Problem) -> bool:
    """Tell whether an impulse that follows from M alone closes each latch: all are rigid, stay closed, close by the
    position of a joint, and each holds a joint of its own in an open chain."""
    own = [row.v for row in problem.latches if row.rigid and row.opens is None and row.closing is not None]
    beside = problem.contact_joints or problem.all_constraints.rows
    return 0 < len(problem.latches) == len({v for v in own if v is not None}) and not beside


def closing_alone(problem: Problem) -> dict[str, list[Scalar]]:
    """Return what follows where one plain latch closes, whose parameters say already that it holds.

        M (v+ - v) = Lambda,   v+ = 0 where a latch holds,   Lambda = 0 elsewhere

    Returns
    -------
    values (k,) : what passes zero where each closes. q (k,) : where it holds its coordinate. v (nv,) : v+. impulses
    (k,) : Lambda of what each holds. lost : energy [J]. apart : positive unless another one closes at the same instant,
    or comes to rest by it. waited : how many of those that the run waits for are open, 1 where it goes on in any case.
    """
    latches, q, v, until = problem.latches, problem.q, problem.v, problem.scene.deploy.until
    held = zeros(len(v))
    for row in latches:
        held[row.v] = row.hold
    M, f, _ = without_held(problem, problem.mass_matrix @ (held * v), zeros(0, len(v)))
    after = (v + LdlFactor.of(M, problem.elimination_order).solve(f)) * (1.0 - held)
    impulses, near = problem.mass_matrix @ (after - v), TOGETHER * maximum(problem.t, 1.0)
    own: dict[str, list[Scalar]] = {name: [] for name in ("values", "q", "impulses", "apart")}
    for row in latches:
        assert row.closes is not None and row.q is not None and row.v is not None and row.closing is not None
        distance = absolute(row.closes) - near * absolute(v[row.closing])
        own["values"].append(row.closes)
        own["q"].append(q[row.q] - row.closes if row.is_own else q[row.q])
        own["impulses"].append(impulses[row.v])
        own["apart"] += [row.closed + distance, row.closed + absolute(after[row.closing])]
    waited = sum((1.0 - row.closed for row in latches if until in ("all", row.name)), float(until == "end"))
    return {**own, "v": list(after), "lost": [-0.5 * dot(held * v, impulses)], "waited": [waited]}
