"""``statics`` for many runs: balances of all of them at once on the equations of one; torques that hold poses."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.contact_joints import contact_joints
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import RobodynError
from robodyn_cli.expr.fixed import witnessed
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.many import Expressions, ManyNumbers
from robodyn_cli.given.loop_conditions import LoopConditions, nothing_led, velocity_places
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.kernels.program import make_program
from robodyn_cli.observe.reactions import REACTION_GROUPS, ReactionSamples, figures_of_runs
from robodyn_cli.observe.rounding import DRAWS
from robodyn_cli.over.batch.criteria import lookup
from robodyn_cli.over.many.command import AskedRuns, BatchCommand, ManyRuns, Rows, error_of, number_of
from robodyn_cli.over.many.groups import Built, first_of
from robodyn_cli.over.many.keys import Key, settings
from robodyn_cli.over.many.start import starts_of
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import as_keys
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closing.assembly import Assembled
from robodyn_cli.solve.closing.balance import balances, first_steps
from robodyn_cli.solve.closure import RANK, newton_of_many
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Absent, PeakLoads
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.works.equilibria import (
    AtRest,
    RestForces,
    at_balance,
    is_within,
    load_at_rest,
    rows_that_stay,
    staying,
)
from robodyn_cli.works.rest.errors import ErrorsOfBalances, OffAtRest, with_errors
from robodyn_cli.works.rest.terms import ForcesAtRest, RestTerms, RoundedLoads
from robodyn_cli.works.statics import (
    assembled_at_rest,
    errors_of_holding,
    held_by_actuators,
    holding_joints,
    problem_of,
    statics,
    summarise,
    terms_at_rest,
    terms_that_hold,
)

ENTRIES = 4_000_000  # of evaluated arrays at a time: 32 MB
STEPS = 60  # to a balance; runs that need more are left to the command
WEAK = 1e-9  # part of the largest stiffness below which rounding may decide where a balance is
LOADS, TERMS = "loads", "terms/"
Which = NDArray[np.bool_]  # of the runs (N,)
# a configuration at rest with its errors, eta (m,) and Psi (m, nv) of its loops
Still = tuple[AtRest, OffAtRest, tuple[Array, Array]]
NEARLY = 1e-6  # rad, or part of the size, up to which a start beside a balance may have been meant as that


@record
class _Start:
    """The start of the structure's own row (see ``start.Begun``); nothing moves at rest, whatever rates are given."""

    problem: Problem
    assembled: Assembled

    @property
    def scene(self) -> Scene:
        scene = self.problem.scene
        return dataclasses.replace(scene, initial=dataclasses.replace(scene.initial, qd={}))


class StaticsStructure(Built):
    """The equations at rest of a scene with one row of values.

    Raises
    ------
    RobodynError : there are no statics with these values.
    """

    def __init__(self, family: Family, keys: Sequence[Key], row: Array) -> None:
        with witnessed() as witnesses:
            problem = self.problem = problem_of(family.scene(settings([key.name for key in keys], row)))
            self.begun = _Start(problem, assembled_at_rest(problem))
            self.balances = problem.scene.statics.find == "balance"
            lead = staying(problem, self.begun.assembled.q) if self.balances else nothing_led()
            self.conditions = LoopConditions(problem, lead, np.zeros(1))
            self.reactions = ReactionSamples(problem, 1) if problem.scene.outputs.reactions else None
            outputs: dict[str, Sequence[Scalar]] = {"here": self.conditions.entries()[0]}
            if self.balances:
                forces = RestForces(problem, self.conditions)
                p = forces.parameters, problem.at_start
                self.terms = RestTerms(
                    self.conditions, load_at_rest(problem), list(problem.actuator_torques), forces.slopes, p
                )
                outputs["slopes"] = forces.slopes
            else:
                self.terms = terms_that_hold(problem, self.conditions)
                outputs |= {f"{TERMS}{name}": term for name, term in terms_at_rest(problem).items()}
            outputs |= {"load": self.terms.load, "tau": self.terms.tau}
            if self.reactions is not None:
                loads = self.reactions.function.outputs
                self.of_loads = RoundedLoads({path: loads[path] for path in self.reactions.of_parts})
                outputs[LOADS] = [x for own in self.reactions.function.outputs.values() for x in own]
            # without names from the scene, scenes with equal equations share their tables
            program = make_program({f"o{k}": x for k, x in enumerate(outputs.values())}, REACTION_GROUPS)
        self.expressions = {name: Expressions(x) for name, x in outputs.items()}
        self.size = max(len(x.code) for x in self.expressions.values()) + program.operations
        super().__init__(keys, row, Tables([program]), witnesses, obstacle(self.begun, keys))

    def runs(self, values: Array, q: Array | None) -> RunsAtRest:
        """Return the runs with rows of values (N, keys). q : initial positions (N, nq) in place of the scene's."""
        starts = starts_of(self, self.begun, values, q)
        return RunsAtRest(self, self.numbers(values), starts.q, starts.sound)


def obstacle(begun: _Start, keys: Sequence[Key]) -> str:
    """Return why runs are made one by one; nothing where their balances are found together."""
    problem = begun.problem
    model = problem.model
    reasons = {
        "joints of several axes move": model.nq != model.nv or model.q_names != model.v_names,
        "joints are prescribed": bool(problem.scene.prescribed),
        "rows of the loops depend on each other": bool(problem.dependent or begun.assembled.redundant),
        "rigid stops bound the configuration": any(joint.stops for joint in contact_joints(model)),
        "payloads are gripped or released": bool(model.switched),
        "limits of joints vary": any(".limits." in key.name for key in keys),
    }
    return first_of(reasons)


class RunsAtRest:
    """Conditions and forces of runs, each with its own numbers (see ``balance.ManyAtRest``).

    Parameters
    ----------
    q : closed configurations (N, nq) that they start from. sound : for which of them (N,) that is sure.
    """

    def __init__(self, structure: StaticsStructure, numbers: ManyNumbers, q: Array, sound: Which) -> None:
        self.structure, self.numbers, self.q, self.sound = structure, numbers, q, sound
        conditions = self._conditions = structure.conditions
        self.problem, self.lengths, self.sizes = structure.problem, conditions.lengths, conditions.sizes
        self.tolerance = RANK  # what closes but for rounding goes to the command
        self._free, self._at_start = structure.terms.p
        names = self.problem.model.q_names
        self._held = [names.index(name) for name in conditions.lead.positions]

    def evaluate(self, name: str, q: Array, lam: Array | None = None, p: Sequence[float] = ()) -> Array:
        """Return outputs of the structure (N, n) at q (N, nq), multipliers (N, m) and parameters."""
        still = [np.zeros(len(q))] * q.shape[1]
        groups = {"q": list(q.T), "v": still, "a": still, "t": still[:1], "p": p}
        rows = [] if lam is None else list(lam.T)
        return self.numbers.evaluate(self.structure.expressions[name], groups | {"lam": rows})

    def at_runs(self, q: Array) -> tuple[Array, Array]:
        """Return F (N, m) and J (N, m, nv) of the loops and of what is held."""
        return self._conditions.lacking(self.evaluate("here", q), q, self.q[:, self._held])

    def part(self, rows: NDArray[np.intp]) -> RunsAtRest:
        return RunsAtRest(self.structure, self.numbers.rows(rows), self.q[rows], self.sound[rows])

    def jacobian(self, q: Array) -> Array:
        return self.at_runs(q)[1]

    def moved(self, q: Array, dq: Array) -> tuple[Array, Array]:
        return newton_of_many(self, q + dq, range(len(self.lengths)))

    def load(self, q: Array) -> Array:
        return self.evaluate("load", q, p=self._free)

    def step(self, q: Array, dq: Array) -> Array:
        return q + dq

    def terms(self, q: Array) -> ForcesAtRest:
        F, J = self.at_runs(q)
        return ForcesAtRest(F, J, self.load(q), self.evaluate("tau", q, p=self._at_start))

    def rounding(self, q: Array, lam: Array) -> ForcesAtRest:
        return self.structure.terms.rounding(q, lam, self.numbers)

    def stiffness(self, q: Array, lam: Array) -> Array:
        K = self.evaluate("slopes", q, lam, self._free)
        return np.swapaxes(K.reshape(len(q), q.shape[1], -1), 1, 2)

    def at_rest(self) -> list[Still | None]:
        """Return the configurations at rest; None where that is doubtful."""
        return self._balanced() if self.structure.balances else self._held_by_actuators()

    def _balanced(self) -> list[Still | None]:
        problem, first = self.problem, first_steps(self, self.q)
        ends = balances(self, self.q, STEPS)
        there = np.array([end.q for end in ends])
        tau, J = self.evaluate("tau", there, p=problem.at_start), self.jacobian(there)
        eta, psi = self.loops(there)
        off = ErrorsOfBalances(self, rows_that_stay(problem, J.shape[1]))(there)
        found: list[Still | None] = []
        for k, end in enumerate(ends):
            sizes = np.abs(end.stiffness)
            sure = off[k].sure and (not len(sizes) or sizes.min() > WEAK * sizes.max())
            stays = np.abs((end.q - self.q[k]) / self.lengths).max() < NEARLY
            # where a start may be meant as a balance, rounding decides whether one that is not stable is left
            certain = end.stability in ("stable", "rigid") and (first[k] > NEARLY or stays)
            # beyond limits the command looks for a balance within them
            good = self.sound[k] and end.converged and sure and certain and is_within(problem, end.q)
            state = at_balance(problem, end, tau[k], J[k]) if good else None
            found.append((state, off[k], (eta[k], psi[k])) if state is not None else None)
        return found

    def _held_by_actuators(self) -> list[Still | None]:
        problem, (eta, psi) = self.problem, self.loops(self.q)
        names = [name for name in self.structure.expressions if name.startswith(TERMS)]
        terms = {name[len(TERMS) :]: self.evaluate(name, self.q, p=problem.at_start) for name in names}
        states: dict[int, AtRest] = {}
        for k in np.flatnonzero(self.sound).tolist():
            own = {name: x[k] for name, x in terms.items()}
            with contextlib.suppress(RobodynError, np.linalg.LinAlgError):  # the command names it
                gap = float(np.abs(eta[k]).max(initial=0.0))
                states[k] = held_by_actuators(problem, self.q[k], own, psi[k], gap)
        found: list[Still | None] = [None] * len(self.q)
        if not states:
            return found
        lam, tau = np.zeros(eta.shape), np.zeros(self.q.shape)
        for k, state in states.items():
            lam[k], tau[k] = state.lam, state.tau
        columns = velocity_places(problem.model, holding_joints(problem))
        errors = errors_of_holding(problem, self, problem.constraints.of_loops, columns)
        for k, off in enumerate(errors(self.q, lam, tau)):
            if off is not None and k in states:
                found[k] = states[k], off, (eta[k], psi[k])
        return found

    def loops(self, q: Array) -> tuple[Array, Array]:
        """Return eta (N, m) and Psi (N, m, nv) of the loops."""
        F, J = self.at_runs(q)
        rows = self.problem.constraints.of_loops
        return F[:, rows], J[:, rows]

    def loads(self, found: Sequence[Still | None]) -> list[PeakLoads | Absent]:
        """Return the loads of joints and closures, where the scene has them."""
        samples, problem = self.structure.reactions, self.problem
        if samples is None:
            return [ABSENT] * len(found)
        loops = problem.constraints.of_loops
        q = np.repeat(self.q[:, None], DRAWS + 1, axis=1)
        lam = np.zeros((*q.shape[:2], len(problem.constraints.rows)))
        for k, still in enumerate(found):
            if still is not None:
                state, off, _ = still
                q[k] = np.vstack([state.q, off.beside.q])
                lam[k][:, loops] = np.vstack([state.lam, off.beside.lam[:, loops]])
        data = np.stack([self.evaluate(LOADS, q[:, j], lam[:, j]) for j in range(DRAWS + 1)], axis=1)
        cuts = np.cumsum([len(names) for names in samples.names.values()])[:-1]
        each = [dict(zip(samples.names, np.split(own, cuts, axis=1))) for own in data]
        parts = [{path: own[path] for path in samples.of_parts} for own in each]
        peaks = figures_of_runs(
            np.zeros(1), [{path: x[:1] for path, x in own.items()} for own in parts], samples.names
        )
        noise = self.structure.of_loads(q[:, 0], lam[:, 0], problem.model.nv, self.numbers)
        return [
            ABSENT
            if still is None
            else samples.described(with_errors(peaks[k], parts[k], samples.names, still[1].beside, noise[k]))
            for k, still in enumerate(found)
        ]


SLOW = {"equilibrium.iterations": "it counts the steps of a single run"}


class StaticsRuns(BatchCommand[StaticsStructure]):
    """Configurations at rest; ends are these."""

    name = "statics"
    words: Mapping[str, Any] = {
        "equilibrium.stability": "stable",
        "equilibrium.torques": "unique",
        "equilibrium.multipliers": "unique",
    }
    slow = SLOW
    judges = True  # they bear nothing at rest

    def structure(self, family: Family, keys: Sequence[Key], row: Array) -> StaticsStructure:
        return StaticsStructure(family, keys, row)

    def is_plain(self, key: str) -> bool:
        leaf = leaf_of("statics", key)
        known = leaf is not None and leaf.is_number and leaf.key.partition(".")[0] != "counters"
        return key not in SLOW and (known or key in self.words)

    def with_samples(self, scene: Scene, samples: int) -> Scene:
        return scene

    @np.errstate(all="ignore")  # what is not finite is left to the command, which names it
    def make(self, structure: StaticsStructure, rows: Rows, asked: AskedRuns) -> list[int]:
        left: list[int] = []
        size = max(1, ENTRIES // max(structure.size, 1))
        for first in range(0, len(rows), size):
            part = rows[first : first + size]
            try:
                left += self._make(structure, part, asked)
            except np.linalg.LinAlgError:
                left += part.tolist()
        return left

    def _make(self, structure: StaticsStructure, rows: Rows, asked: AskedRuns) -> list[int]:
        result = asked.result
        runs = structure.runs(result.values[rows], None if asked.q is None else asked.q[rows])
        found = runs.at_rest()
        loaded = any(key.startswith("reactions.") for key in result.outputs)
        loads = runs.loads(found) if loaded else [ABSENT] * len(found)
        each = zip(rows.tolist(), found, loads)
        return [row for row, own, peaks in each if own is None or not self._keep(result, row, own, peaks)]

    def _keep(self, result: ManyRuns, row: int, still: Still, loads: PeakLoads | Absent) -> bool:
        """Write a run into its row, unless it says something else than it should."""
        state, off, loops = still
        summary = {"command": self.name, **as_keys(summarise(state, off, loads, loops))}
        expect = state.problem.scene.expect
        words = all(lookup(summary, key) == word for key, word in self.words.items() if key in expect)
        outputs = {key: number_of(summary, key) for key in result.outputs}
        if not words or not np.isfinite([*outputs.values(), *state.q, *state.tau]).all():
            return False
        for key, value in outputs.items():
            result.outputs[key][row], result.errors[key][row] = value, error_of(summary, key)
        result.code[row], result.time[row] = 0, 0.0
        result.q[row], result.qd[row] = state.q, 0.0
        return True

    def single(self, scene: Scene) -> Result:
        return statics(scene)

    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        if (own := summary.get("configuration")) is not None:
            result.time[row], result.q[row], result.qd[row] = 0.0, [own[x] for x in result.q_names], 0.0
