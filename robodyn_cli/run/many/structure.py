"""One structure for many runs: its motion is built once, and says which runs have that structure too."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import RobodynError
from robodyn_cli.expr.fixed import witnessed
from robodyn_cli.expr.many import Expressions, ManyNumbers, Recipe
from robodyn_cli.formulations.events import EventKind
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.fleet import Fleet
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.run.driver.motion import Motion
from robodyn_cli.run.many.keys import NUMBER, OPTION, STRUCTURE, Key, settings
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

FARTHER = 2.0
ALIKE = 1e-9  # relative difference of numbers that were computed in two ways


class Buildable(Protocol):
    """What a structure needs of a command."""

    def build(self, scene: Scene) -> Motion: ...
    def obstacle(self, motion: Motion) -> str: ...


class Structure:
    """The motion of a scene with one row of values.

    Parameters
    ----------
    command : makes a motion of a scene.

    Raises
    ------
    RobodynError : there is no motion with these values.
    """

    def __init__(self, family: Family, keys: Sequence[Key], row: Array, command: Buildable) -> None:
        self.keys, self.row = keys, row
        scene = family.scene(settings([key.name for key in keys], row))
        with witnessed() as witnesses:
            self.motion = command.build(scene)
            self.tables = methods[self.motion.choice.method].tables(self.motion.system)
        self.recipe = Recipe([key.place for key in keys if key.sort == NUMBER])
        self._deciding = self.recipe.deciding(witnesses)
        self.obstacle = obstacle(self.motion, self._times_vary()) or command.obstacle(self.motion)
        self._fleets: dict[tuple[str, bool], Fleet] = {}
        self._last: tuple[Array, ManyNumbers] | None = None  # asked for, by rows: several ask for the same
        self._confirmed = np.zeros(len(row))  # how far from its own row another one has been built

    def _times_vary(self) -> bool:
        """Tell whether functions of time may switch at other times, or over another duration, in other runs."""
        sections = ("parameters.", "torques.", "forces.")
        return any(
            key.sort == OPTION or (key.sort == NUMBER and key.place.startswith(sections)) for key in self.keys
        )

    def numbers(self, values: Array) -> ManyNumbers:
        """Return the numbers of the scene for rows of values (N, keys)."""
        if self._last is None or not np.array_equal(self._last[0], values):
            given = {k.place: values[:, j] for j, k in enumerate(self.keys) if k.sort == NUMBER}
            self._last = values, ManyNumbers(self.recipe, given, len(values))
        return self._last[1]

    def column(self, place: str, values: Array) -> Array | None:
        """Return the values of the key that is a start or an option of this name; None where none varies."""
        return next(
            (values[:, j] for j, k in enumerate(self.keys) if k.place == place and k.sort != NUMBER), None
        )

    def fits(self, values: Array) -> NDArray[np.bool_]:
        """Return for which rows (N, keys) every comparison turns out as it did for this structure's own."""
        return self.numbers(values).decided_alike(self._deciding)

    def is_confirmed(self, values: Array, build: Callable[[Array], Structure]) -> bool:
        """Tell whether what is built for other rows (N, keys) has the numbers that this structure gives.

        Asked at the row farthest from its own, and again where rows are more than FARTHER times as far.
        """
        away = np.abs(values - self.row)
        if not any(key.sort == NUMBER for key in self.keys) or np.all(away <= FARTHER * self._confirmed):
            return True
        far = int(np.argmax((away / np.maximum(away.max(axis=0), 1e-300)).sum(axis=1)))
        try:
            other = build(values[far])
        except RobodynError:
            return False
        self._confirmed = np.maximum(self._confirmed, away.max(axis=0))
        return self._has_numbers_of(other)

    def _has_numbers_of(self, other: Structure) -> bool:
        """Tell whether the numbers of another structure, for its own row, are those that this one gives for it."""
        if other.tables.digest != self.tables.digest or other.obstacle != self.obstacle:
            return False
        own = table_rows(self.tables, self.numbers(other.row[None]))[0]
        scale = np.abs(own) + np.abs(other.tables.numbers)
        return bool(np.all(np.abs(own - other.tables.numbers) <= ALIKE * scale))

    def fleet(self, method: str, watch: bool = True) -> Fleet:
        """Return the compiled code of a method."""
        key = method, watch
        if key not in self._fleets:
            # what is only noted on the way ends no run
            system = self.motion.system.watched_by(lambda e: None if e.kind is EventKind.MARK else e.owner)
            passing = [k for k, e in enumerate(system.events) if e.is_discontinuity]
            self._fleets[key] = Fleet(system, method, np.zeros(1), watch, passing)
        return self._fleets[key]

    @cached_property
    def energies(self) -> Expressions:
        """Kinetic and potential energy as expressions."""
        from robodyn_cli.run.observation.observe import potential_energy

        return Expressions([self.motion.problem.kinetic, potential_energy(self.motion.problem)])

    @cached_property
    def psi_of_loops(self) -> Expressions:
        """Psi of the loops' rows, row by row."""
        problem = self.motion.problem
        return Expressions(problem.psi[problem.constraints.of_loops].ravel().tolist())

    @cached_property
    def jacobian(self) -> Expressions:
        """The Jacobian of (q, v, z)-dot, row by row."""
        return Expressions(self.motion.system.jacobian.J.ravel().tolist())


def table_rows(tables: Tables, numbers: ManyNumbers) -> Array:
    """Return the tables of numbers (N, n) of all programs of a run."""
    columns = [numbers.table(p.numbers or (0.0,)) for p in tables.programs]
    return np.hstack(columns)


def obstacle(motion: Motion, times_vary: bool) -> str:
    """Return why runs of a motion are made one by one, by the driver in Python; nothing where compiled code does.

    times_vary : whether other runs may have functions of time with other features.
    """
    system, problem = motion.system, motion.problem
    constraints = problem.constraints
    begins = any(watcher.sets_start for watcher in motion.watchers)
    reasons = {
        "a long chain is integrated by loops over its bodies": system.dynamics.any_size,
        "independent coordinates or rows are chosen along the motion": system.partition is not None,
        "contact states begin and change in Python": begins or bool(system.parameters),
        "steps have to end at times that formulas or tables give": bool(system.breakpoints)
        or any(times_vary or not found.resolved for _, found in problem.switching.time_structures),
        "a motion is prescribed": bool(constraints.rheonomic),
        "rows of the loops depend on each other": bool(problem.dependent or motion.assembled.redundant),
        "Baumgarte's gains are found by trial runs": motion.gains is not None,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


class Structures:
    """All structures of a mechanism, found as runs ask for them."""

    def __init__(self, family: Family, keys: Sequence[Key], command: Buildable) -> None:
        self.family, self.keys, self.command = family, list(keys), command
        self._found: dict[tuple[float, ...], list[Structure]] = {}

    def groups(self, values: Array) -> list[tuple[Structure | None, NDArray[np.int64]]]:
        """Return rows of values (N, keys) in groups of one structure: it, and the numbers of its rows.

        Rows without a structure, since nothing can be built with their values, or since what is built does not confirm
        the numbers of a structure that seems to fit, are to be run as scenes of their own.
        """
        groups: list[tuple[Structure | None, NDArray[np.int64]]] = []
        patterns = self._patterns(values)
        _, first, which = np.unique(patterns, axis=0, return_index=True, return_inverse=True)
        for k, start in enumerate(first):
            rows = np.flatnonzero(which.ravel() == k)
            known = self._found.setdefault(tuple(patterns[start].tolist()), [])
            groups += self._split(values, rows, known)
        return groups

    def _patterns(self, values: Array) -> Array:
        """Return what of each row is structure: values of keys that are, and which keys are at a special one."""
        columns = [
            values[:, k] if key.sort == STRUCTURE else np.isin(values[:, k], key.special).astype(float)
            for k, key in enumerate(self.keys)
        ]
        return np.stack([*columns, np.zeros(len(values))], axis=1)

    def _split(
        self, values: Array, rows: NDArray[np.int64], known: list[Structure]
    ) -> list[tuple[Structure | None, NDArray[np.int64]]]:
        groups: list[tuple[Structure | None, NDArray[np.int64]]] = []
        alone: list[int] = []
        untried = list(known)
        while len(rows):
            try:
                structure = untried.pop(0) if untried else self._build(values[rows[0]])
            except RobodynError:
                alone.append(int(rows[0]))
                rows = rows[1:]
                continue
            fits = structure.fits(values[rows])
            own = rows[fits]
            if structure not in known:
                known.append(structure)
                if not len(own):  # a comparison that is not decided by the numbers alone
                    own, fits[0] = rows[:1], True
            if len(own) and structure.is_confirmed(values[own], self._build):
                groups.append((structure, own))
            else:
                alone += own.tolist()
            rows = rows[~fits]
        if alone:
            groups.append((None, np.array(alone, dtype=np.int64)))
        return groups

    def _build(self, row: Array) -> Structure:
        return Structure(self.family, self.keys, row, self.command)
