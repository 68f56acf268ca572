"""Motions that loops and a lead determine, for other lengths, in a page: Newton's method at all samples at once, from
the motion of the scene, and what says that the motion found is the one that the command follows."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.over.live.closing import LIMITS
from robodyn_cli.over.live.figures import Rule, rule_of
from robodyn_cli.over.live.keys import cannot
from robodyn_cli.over.live.rules import Tape
from robodyn_cli.over.many.guides import ATTITUDE, Guided, ManyMotions
from robodyn_cli.solve import closure
from robodyn_cli.solve.closure import CLOSED, capped, least_steps
from robodyn_cli.solve.guided import MISS, newton_moves, regular_places, same_branch
from robodyn_cli.solve.sparse import ROUNDS, SETTLED
from robodyn_cli.spatial.algebra import Array

STAGES = (1, 4, 16)  # parts of the way from the scene's own values to others, tried one after another
FROM_GUESS = 0.4  # rad, or part of the mechanism's size: from farther the command may not find what is led
ALIKE = 1e-6  # rad, or part of the mechanism's size, by which two ways to the first sample differ at most


class LoopMotion:
    """The motion of a mechanism with keys that change its lengths.

    Parameters
    ----------
    guided : its equations. motion : with the values of the scene, of one run.

    Raises
    ------
    CapabilityError : a page does not follow such motions.
    """

    def __init__(self, guided: Guided, motion: ManyMotions, where: str) -> None:
        self.guided, self.problem, self.times = guided, guided.problem, guided.times
        self.q, self.v, self.a = (x[0] for x in (motion.q, motion.v, motion.a))
        self.conditions = guided.conditions
        lead = self.conditions.lead
        if lead.led is not None and lead.led.oriented:
            raise CapabilityError("a frame's attitude is led", cannot(where))
        model = self.problem.model
        self.free = [k for k, name in enumerate(model.q_names) if name not in lead.positions]

    def equations(self) -> dict[str, dict[str, Any]]:
        """Return the equations along the motion, by name."""
        problem = self.problem
        rows = problem.constraint_rows
        here, rates = self.conditions.entries()
        found: dict[str, dict[str, Any]] = {"here": {"here": list(here)}, "rates": {"rates": list(rates)}}
        if rows:
            found["loops"] = {
                "eta": [row.eta for row in rows], "psi": [x for row in rows for x in row.psi],
                "cosines": [row.cosine for row in rows],
            }  # fmt: skip
        return found

    def data(self) -> dict[str, Any]:
        """Return what a page needs beside code and rules."""
        conditions, model = self.conditions, self.problem.model
        rows = len(self.problem.constraint_rows)
        sizes = {
            "sizes": conditions.sizes[:rows].tolist(),
            **{name: getattr(closure, name) for name in LIMITS},
        }
        return {
            "start": self.guided.start.tolist(), "closing": sizes if rows and self.free else None,
            "stages": list(STAGES), "rounds": ROUNDS, "settled": SETTLED, "nq": model.nq, "nv": model.nv,
        }  # fmt: skip

    # -- rules ----------------------------------------------------------------------------------------
    def rules(self) -> dict[str, tuple[Rule, dict[str, Any]]]:
        """Return the rules of one motion, with the values of their examples."""
        found = {
            "moves": self._moves(slice(None)),
            "moves.start": self._moves(slice(0, 1)),
            "placed": self._placed(),
        }
        found["carried"], found["followed"] = self._carried(), self._followed()
        if self.problem.constraint_rows:
            found["begun"] = self._begun()
            if self.free:
                found["step.free"] = self._closing()
        return found

    def _begun(self) -> tuple[Rule, dict[str, Any]]:
        """Return the rule whether the first sample is found as the command finds it: loops close from the guess, and
        what is led is not far from there."""
        tape, conditions, rows = Tape(), self.conditions, len(self.problem.constraint_rows)
        cosines, eta = (tape.input(name, np.full(rows, x)) for name, x in (("cosines", 1.0), ("eta", 0.0)))
        q, closed = (tape.input(name, self.q[0]) for name in ("q", "closed"))
        lengths = conditions.lengths[conditions.manifold.position >= 0]
        good: Any = (cosines >= ATTITUDE).all() & (np.abs(eta / conditions.sizes[:rows]) <= CLOSED).all()
        return rule_of(tape, {"good": good & (np.abs(q - closed) / lengths < FROM_GUESS).all()})

    def _closing(self) -> tuple[Rule, dict[str, Any]]:
        """Return the rule of a step that closes the loops at the first sample."""
        conditions, rows, nv = self.conditions, len(self.problem.constraint_rows), self.problem.model.nv
        tape, psi = Tape(), self._here_of(slice(0, 1))[1][:, :rows]
        eta, own = tape.input("eta", np.full((1, rows), 1e-3)), tape.input("psi", psi)
        sizes, lengths = conditions.sizes[:rows], conditions.lengths[self.free]
        step = capped(least_steps(own[:, :, self.free] * lengths / sizes[:, None], -eta / sizes)) * lengths
        return rule_of(tape, {"step": (step @ np.eye(nv)[self.free])[0]})

    def _here(self, part: slice) -> Array:
        """Return the first of the entries (T, n) along the motion of the scene."""
        here, q = self.guided.here, self.q[part]
        groups = {"q": list(q.T), "v": list(np.zeros_like(q).T), "t": [self.times[part]], "p": []}
        runs = np.repeat(self.guided.built.row[None], len(q), axis=0)  # type: ignore[attr-defined]
        return self.guided.built.numbers(runs).evaluate(here, groups)

    def _here_of(self, part: slice) -> tuple[Array, Array]:
        return self.conditions.lacking(
            self._here(part), self.q[part], self.conditions.lead.asked(self.times[part])[0]
        )

    def _lacking(self, tape: Tape, part: slice) -> tuple[Any, Any, Any]:
        """Return positions, F and J of a rule."""
        q: Any = tape.input("q", self.q[part])
        here: Any = tape.input("here", self._here(part))
        return q, *self.conditions.lacking(here, q, self.conditions.lead.asked(self.times[part])[0])

    def _moves(self, part: slice) -> tuple[Rule, dict[str, Any]]:
        tape = Tape()
        q, F, J = self._lacking(tape, part)
        moves: Any = newton_moves(self.conditions, q, F, J)
        return rule_of(tape, {"moves": moves, "most": np.abs(moves).max()})

    def _moving(self, tape: Tape) -> tuple[Any, Any, Any]:
        """Return J, and c and b of J v = c and J v-dot = b."""
        rates: Any = tape.input("rates", np.zeros((len(self.times), len(self.conditions.entries()[1]))))
        _, _, J = self._lacking(tape, slice(None))
        return J, *self.conditions.moving(rates, *self.conditions.lead.asked(self.times)[1:])

    def _placed(self) -> tuple[Rule, dict[str, Any]]:
        tape = Tape()
        J, c, _ = self._moving(tape)
        return rule_of(tape, {"v": least_steps(J, c)})

    def _carried(self) -> tuple[Rule, dict[str, Any]]:
        tape = Tape()
        J, _, b = self._moving(tape)
        return rule_of(tape, {"a": least_steps(J, b)})

    def _followed(self) -> tuple[Rule, dict[str, Any]]:
        """Return the rule whether the motion is regular, on one branch, and begins where loops close at the start."""
        tape, conditions = Tape(), self.conditions
        q, F, J = self._lacking(tape, slice(None))
        v, a, start = (
            tape.input(name, x) for name, x in (("v", self.v), ("a", self.a), ("start", self.q[0]))
        )
        regular, scaled = regular_places(conditions, F, J)
        h = np.diff(self.times)[:, None]
        guess: Any = q[:-1] + h * v[:-1] + 0.5 * h * h * a[:-1]
        lengths = conditions.lengths[conditions.manifold.position >= 0]
        near = np.abs(q[1:] - guess) / lengths < MISS
        good = regular.all() & near.all() & (np.abs(q[0] - start) / lengths < ALIKE).all()
        return rule_of(tape, {"good": good & same_branch(scaled[:-1], scaled[1:]).all()})
