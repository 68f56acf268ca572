"""Inverse dynamics in a page: a motion that keys do not change, as data, and the torques along it, as code."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.commands import places
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.given.motion import Planned
from robodyn_cli.model.model import TORQUE
from robodyn_cli.observe.rounding import DRAWS, ENLARGED, PATTERNS, UNIT, Rounded, few
from robodyn_cli.over.live.code import StateEquations
from robodyn_cli.over.live.figures import (
    Rule,
    borne_rule,
    figures_rule,
    is_determined,
    named_figures,
    rounding_rule,
    rule_of,
)
from robodyn_cli.over.live.follow import LoopMotion
from robodyn_cli.over.live.inertia import has_doubtful_inertia
from robodyn_cli.over.live.judging import REASONS
from robodyn_cli.over.live.keys import LiveMotion, cannot, columns
from robodyn_cli.over.live.picture import picture_of
from robodyn_cli.over.live.rounding import FACTORS, GIVEN, staged
from robodyn_cli.over.live.rules import Tape, plain
from robodyn_cli.over.many.command import VERDICT
from robodyn_cli.over.many.groups import first_of
from robodyn_cli.over.many.inverse import InverseRuns
from robodyn_cli.over.many.torques import InverseStructure
from robodyn_cli.ready.mass_matrix import INDEFINITE, negative_part
from robodyn_cli.registry import Registry
from robodyn_cli.scene.load import Family
from robodyn_cli.solve.load_sharing import Hold
from robodyn_cli.solve.quadrature import DIFFERED, HIDDEN, POINTS, Breaks, doubts
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.torques.checks import breaks_of, turning
from robodyn_cli.torques.program import Sampled
from robodyn_cli.works.inverse import evaluated, looked_at

SAMPLES = (201, 401, 801)  # along a motion, as many as tell its figures, but for more that its knots ask for
MOST_NUMBERS = 40_000  # of a motion in a page, some 10 bytes each
CLEARLY = 0.1  # of the differences of samples that would show a jump where nothing says that there is one
GROUPS = [["tau", "torques", ""], ["q", "positions", ""], ["v", "rates", "/s"]]


def given_commands() -> dict[str, InverseRuns]:
    """Return the commands along given motions whose runs a page makes, by name."""
    batches: Registry[Any] = Registry("robodyn_cli", places("batch"), made=True)
    return {name: own for name, own in batches.items() if isinstance(own, InverseRuns)}


class LiveInverse(LiveMotion):
    """The torques along the motion of a scene, with some keys that vary within ranges, see ``LiveScene``."""

    def __init__(self, family: Family, ranges: Mapping[str, tuple[float, float]]) -> None:
        super().__init__(family, ranges, given_commands())
        scene = family.own
        if why := first_of({VERDICT: bool(scene.drives) or scene.motorisation is not None}):
            raise CapabilityError(why, cannot(self.where))
        self.structure = self._built(self.mechanism, InverseStructure)
        self.program = self.structure.program
        self.problem = self.program.problem
        model = self.problem.model
        self.sizes = {"t": 1, "q": model.nq, "v": model.nv, "a": model.nv}
        self.driven = self.structure.driven
        self.planned, self.sampled = self._along(scene.inverse.samples)
        self.times = self.planned.times
        self.shared = self._shared()
        self.followed = self._followed()
        self._find_what_decides()

    def _along(self, most: int) -> tuple[Planned, Sampled]:
        """Return the motion at as few samples as tell its figures clearly, and what is evaluated there.

        most : samples, at most.

        Raises
        ------
        CapabilityError : no page holds so many.
        """
        for samples in [*(n for n in SAMPLES if n < most), most]:
            planned = looked_at(self.program, samples, self.structure.planned)
            count, size = len(planned.times), sum(self.sizes.values())
            if count * size > MOST_NUMBERS:
                raise CapabilityError(
                    f"its torques take {count} samples of {size} numbers; allowed: "
                    f"{MOST_NUMBERS} numbers in all",
                    cannot(self.where),
                )
            sampled = evaluated(self.program, planned)
            tau, qd = sampled.tau[:, self.driven], planned.motion.qd[:, self.driven]
            breaks = breaks_of(self.problem, planned.times, planned.motion)
            if told_clearly(planned.times, np.column_stack([tau, qd, tau * qd]), breaks):
                break
        return planned, sampled

    def _shared(self) -> Hold | None:
        """Return how actuators and loops share loads along the motion; None of an open chain.

        Raises
        ------
        CapabilityError : only some loads can be borne.
        """
        loops = self.sampled.loops
        if loops is None:
            return None
        if loops.shared.commanded < loops.shared.freedom:
            raise CapabilityError(
                f"its actuators command {loops.shared.commanded} of "
                f"{loops.shared.freedom} degrees of freedom, so that they bear some loads alone",
                cannot(self.where),
            )
        return Hold.of(loops.psi, self.driven, loops.shared.tolerance)

    def _followed(self) -> LoopMotion | None:
        """Return the motion of a mechanism with keys that change it.

        Raises
        ------
        CapabilityError : its torques do not follow from it here.
        """
        if self.structure.lead is None or self.shared is None:
            return None
        guided = self.structure.guide(self.times)
        if not guided.varies:
            return None
        losing = [self.problem.model.joint_of(k) for k in sorted(turning(self.problem))]
        reasons = {
            f"keys change when {', '.join(losing)}, which lose energy, turn back": bool(losing),
            "keys change how more actuators, or rows of loops, than it takes share the load": not is_determined(
                self.shared
            ),
        }
        motion = guided.follow(self.row[None])
        reasons["its own motion is left to the command"] = not motion.good[0]
        if why := first_of(reasons):
            raise CapabilityError(why, cannot(self.where))
        return LoopMotion(guided, motion, self.where)

    # -- code -----------------------------------------------------------------------------------------
    @cached_property
    def equations(self) -> dict[str, StateEquations]:
        """Equations along the motion, by name."""
        program, problem = self.program, self.problem
        terms, rows = list(program.terms.values()), program.shared_by
        entries = [*(x for term in terms for x in term), *rows]
        found = staged(Rounded(entries), self.sizes, self.structure.recipe, self._places)
        nv = self.sizes["v"]
        load: list[Scalar] = [
            sum(found[i * nv + k] for i in range(1, len(terms))) + found[k] for k in range(nv)
        ]
        outputs: dict[str, dict[str, Any]] = {"load": {"load": load}}
        if rows:
            outputs["load"]["psi"] = found[len(terms) * nv :]
        if has_doubtful_inertia(problem.scene, self.structure.recipe):
            outputs["inertia"] = {"mass": problem.mass_matrix.ravel().tolist()}
            if rows:
                outputs["inertia"]["psi"] = list(rows)
        if self.followed is not None:
            outputs |= self.followed.equations()
        if picture := picture_of(self.family.own, problem):
            outputs["picture"] = picture
        return self._with_places({**self.sizes, GIVEN: len(self.keys), FACTORS: PATTERNS}, outputs)

    # -- data -----------------------------------------------------------------------------------------
    @property
    def tau(self) -> Array:
        """The torques of the scene itself (T, n) of joints with an actuator."""
        return self.sampled.tau[:, self.driven]

    @cached_property
    def recorded(self) -> dict[str, tuple[Rule, dict[str, Any]]]:
        """The rules of the figures, each with the values of its example."""
        motion, loops = self.planned.motion, self.sampled.loops
        breaks = breaks_of(self.problem, self.times, motion)
        at = few(len(self.times))
        draws = np.repeat(np.sum(list(self.sampled.terms.values()), axis=0)[None, at], DRAWS + 1, axis=0)
        psi = None if loops is None else np.repeat(loops.psi[None, at], DRAWS + 1, axis=0)
        found = {
            "figures": figures_rule(self.times, self.tau, motion.qd[:, self.driven], breaks),
            "rounding": rounding_rule(draws, psi, self.shared),
        }
        if self.followed is not None and loops is not None:
            load = np.sum(list(self.sampled.terms.values()), axis=0)
            found |= {**self.followed.rules(), "borne": borne_rule(load, loops.psi, self.driven)}
        if "inertia" in self.equations:
            found["definite"] = self._definite(at)
        return found

    def _definite(self, at: Array) -> tuple[Rule, dict[str, Any]]:
        """Return the rule whether the mass matrix is positive at a few samples."""
        problem, tape, n = self.problem, Tape(), self.sizes["v"]
        q = self.planned.motion.q[at]
        M = np.array([problem.numbers(problem.mass_matrix, x) for x in q]).reshape(len(q), n, n)
        rows: Any = np.zeros((len(q), 0, n))
        if self.sampled.loops is not None:
            rows = tape.input("psi", self.sampled.loops.psi[at])
        good: Any = negative_part(tape.input("mass", M), rows) <= INDEFINITE
        return rule_of(tape, {"good": good.all()})

    def data(self) -> dict[str, Any]:
        """Return what a page needs beside the code."""
        model, motion = self.problem.model, self.planned.motion
        size, at = sum(self.sizes.values()), few(len(self.times))
        rows = np.column_stack([self.times, motion.q, motion.qd, motion.qdd])
        q, v = 1, 1 + model.nq
        names, units = ([x[k] for k in self.driven] for x in (model.v_names, model.v_units))
        torques = [TORQUE[unit] for unit in units]
        kinds = [
            {"torque": t, "speed": f"{u}/s", "power": "W", "energy": "J"} for t, u in zip(torques, units)
        ]
        return {
            "title": self.family.own.title, "duration": float(self.times[-1]), "locks": False, "groups": GROUPS,
            "keys": [self._key_data(key, model) for key in self.keys],
            "tau": columns(names, torques, range(size, size + len(names))),
            "q": columns(model.q_names, model.q_units, range(q, v)),
            "v": columns(model.v_names, model.v_units, range(v, v + model.nv)),
            "size": size, "factors": PATTERNS, "motion": plain(rows.ravel()), "few": at.tolist(),
            "rates": [v + k for k in self.driven], "weights": plain(self._weights()),
            "follow": None if self.followed is None else self.followed.data(),
            "draws": {"count": DRAWS, "unit": ENLARGED * UNIT},
            "outputs": {name: own.program.sizes for name, own in self.equations.items()},
            "numbers": plain(self.tables.numbers), "points": list(model.points), "start": {"closing": None},
            "figures": named_figures(names, kinds), "reasons": {**REASONS, **GIVEN_REASONS},
            "rules": {name: rule for name, (rule, _) in self.recorded.items()},
        }  # fmt: skip

    def _weights(self) -> Array:
        """Return W (T, n, nv) with tau = W u of loads u, flat; nothing of an open chain."""
        hold = self.shared
        if hold is None or hold.inverse is None or self.followed is not None:
            return np.zeros(0)
        return np.einsum("taf,tvf->tav", hold.inverse, hold.N).ravel()


def told_clearly(times: Array, y: Array, breaks: Breaks) -> bool:
    """Tell whether samples y (T, n) are so close that they will tell of jumps for other values of keys, too."""
    if len(y) < 2 * POINTS:
        return True
    rough, _ = doubts(times, y, breaks)
    return bool(
        (
            rough.max(axis=0) <= np.maximum(CLEARLY * HIDDEN * np.ptp(y, axis=0), DIFFERED * np.abs(y).max())
        ).all()
    )


# why a page leaves values to the command, by what did not hold
GIVEN_REASONS = {
    "finite": "a torque is not finite",
    "follow": "the loops do not close along the whole motion, or come near a singular pose or another branch",
    "borne": "actuators and loops come near a pose in which they lose their hold",
    "definite": "the mass matrix is not positive: there are no bodies with these inertias",
}
