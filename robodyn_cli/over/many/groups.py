"""Runs in groups of one structure: what is built for one row of values, and which other rows it serves."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import RobodynError
from robodyn_cli.expr.fixed import Witness
from robodyn_cli.expr.many import ManyNumbers, Recipe
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.over.many.keys import NUMBER, STRUCTURE, Key
from robodyn_cli.scene.load import Family
from robodyn_cli.spatial.algebra import Array

FARTHER = 2.0
ALONG = 0.01  # of the largest distance along a key: a row as far as this was away along it
TRIES = 5  # rows, from the farthest on, until something can be built with one
MOST_PATTERNS = 64  # whose structures are kept
ALIKE = 1e-9  # relative difference of numbers that were computed in two ways


class Built:
    """What is built for one row of values of some keys, and serves others through its tables of numbers.

    Parameters
    ----------
    tables : of all programs. witnesses : comparisons of numbers that were made while they were built.
    obstacle : why runs are made one by one all the same; nothing if they are not.

    starts : whether the scene itself has a start; else runs have to be given theirs. bound : why runs that are given
    other starts are made one by one; nothing if they are not.
    follows : whether its numbers follow from the keys, so that what is built elsewhere has to confirm them.
    """

    def __init__(
        self, keys: Sequence[Key], row: Array, tables: Tables, witnesses: Sequence[Witness], obstacle: str
    ) -> None:
        self.keys, self.row, self.tables, self.obstacle = keys, row, tables, obstacle
        self.starts, self.bound = True, ""
        self._varying = [(k, key) for k, key in enumerate(keys) if key.sort == NUMBER]
        self.follows = bool(self._varying)
        self.recipe = Recipe([key.place for _, key in self._varying])
        self.deciding = self.recipe.deciding(witnesses)
        self._last: tuple[Array, ManyNumbers] | None = None  # asked for, by rows: several ask for the same
        self._confirmed = np.zeros(len(row))  # how far from its own row another one has been built

    def numbers(self, values: Array) -> ManyNumbers:
        """Return the numbers of the scene for rows of values (N, keys)."""
        last = self._last
        if last is None or last[0].shape != values.shape or not (last[0] == values).all():
            given = {key.place: key.scale * values[:, k] for k, key in self._varying}
            last = self._last = values, ManyNumbers(self.recipe, given, len(values))
        return last[1]

    def column(self, place: str, values: Array) -> Array | None:
        """Return the values of the key that is a start or an option of this name; None where none varies."""
        return next(
            (
                k.scale * values[:, j]
                for j, k in enumerate(self.keys)
                if k.place == place and k.sort != NUMBER
            ),
            None,
        )

    def fits(self, values: Array) -> NDArray[np.bool_]:
        """Return for which rows (N, keys) every comparison turns out as it did for this structure's own."""
        return self.numbers(values).decided_alike(self.deciding)

    def confirmed(self, values: Array, build: Callable[[Array], Built]) -> NDArray[np.bool_]:
        """Tell for which rows (N, keys) what is built for other rows has the numbers that this structure gives.

        Asked at far rows with which something can be built, until one of them was away along each key, and again where
        rows are more than FARTHER times as far along a key.
        """
        away = np.abs(values - self.row)
        near: NDArray[np.bool_] = np.ones(len(values), dtype=bool)
        if not self.follows:
            return near
        while not (near := (away / FARTHER <= self._confirmed).all(axis=1)).all():
            left = away[~near]
            farthest = left.max(axis=0)
            share = np.where(left / FARTHER <= self._confirmed, 0.0, left / np.maximum(farthest, 1e-300))
            order = np.argsort(-share.sum(axis=1), kind="stable")
            row, other = self._built_elsewhere(values[~near][order], build)
            if other is None:  # of nothing farther that can be built
                return near
            if not self.has_numbers_of(other):
                return np.zeros(len(values), dtype=bool)
            along = share[order[row]] >= min(ALONG, 1.0 / len(farthest))
            if not along.any():
                return np.ones(len(values), dtype=bool)
            reached = farthest if row == 0 else left[order[row]]
            self._confirmed = np.where(along, np.maximum(self._confirmed, reached), self._confirmed)
        return near

    @staticmethod
    def _built_elsewhere(values: Array, build: Callable[[Array], Built]) -> tuple[int, Built | None]:
        """Return the first of some rows (N, keys) with which something can be built, and that; None where nothing can.

        Tried are the first row, that in the middle, and so on, each half as far from the last one.
        """
        for tried in range(TRIES):
            row = len(values) - 1 - (len(values) - 1) // 2**tried
            with contextlib.suppress(RobodynError):
                return row, build(values[row])
        return 0, None

    def has_numbers_of(self, other: Built) -> bool:
        """Tell whether the numbers of another structure, for its own row, are those that this one gives for it."""
        if other.tables.digest != self.tables.digest or other.obstacle != self.obstacle:
            return False
        own = table_rows(self.tables, self.numbers(other.row[None]))[0]
        with np.errstate(all="ignore"):  # what is not finite is not alike
            scale = np.abs(own) + np.abs(other.tables.numbers)
            return bool(np.all(np.abs(own - other.tables.numbers) <= ALIKE * scale))


def table_rows(tables: Tables, numbers: ManyNumbers) -> Array:
    """Return the tables of numbers (N, n) of all programs of a run."""
    columns = [numbers.table(p.numbers or (0.0,)) for p in tables.programs]
    return np.concatenate(columns, axis=1)


def first_of(reasons: Mapping[str, bool]) -> str:
    """Return the first reason that holds, as an ``obstacle``; nothing where none does."""
    return next((reason for reason, holds in reasons.items() if holds), "")


Build = Callable[[Family, Sequence[Key], Array], Built]
Positions = Mapping[str, Array]  # (N,) of each coordinate [rad or m]


class Structures:
    """All structures of a mechanism, found as runs ask for them.

    Parameters
    ----------
    build : makes the structure of a scene with one row of values of the keys; raises RobodynError.
    """

    def __init__(self, family: Family, keys: Sequence[Key], build: Build) -> None:
        self.family, self.keys, self._make = family, list(keys), build
        self._is_structure = np.array([key.sort == STRUCTURE for key in keys], dtype=bool)
        most = max((len(key.special) for key in keys), default=0)
        self._special = np.full((len(keys), most), np.nan)
        for row, key in zip(self._special, keys):
            row[: len(key.special)] = key.special
        self._found: dict[tuple[float, ...], list[Built]] = {}
        self.unbuilt = ""  # why nothing is built for rows of the last group without a structure

    def groups(
        self, values: Array, positions: Positions | None = None
    ) -> Iterator[tuple[Built | None, NDArray[np.int64]]]:
        """Yield rows of values (N, keys) in groups of one structure: it, and the numbers of its rows.

        positions : that are given of each run, where the scene may have none.

        Rows without a structure, since nothing can be built with their values, or since what is built does not confirm
        the numbers of a structure that seems to fit, are to be run as scenes of their own.
        """
        if not len(values):
            return
        patterns = self._patterns(values)
        if (patterns == patterns[0]).all():
            yield from self._split(values, np.arange(len(values)), self._known(patterns[0]), positions)
            return
        different, which = np.unique(patterns, axis=0, return_inverse=True)
        for k, pattern in enumerate(different):
            yield from self._split(
                values, np.flatnonzero(which.ravel() == k), self._known(pattern), positions
            )

    def _known(self, pattern: Array) -> list[Built]:
        """Return the structures that rows of a pattern have had; of patterns those that came last are kept."""
        key = tuple(pattern.tolist())
        known = self._found.pop(key, [])
        self._found[key] = known
        if len(self._found) > MOST_PATTERNS:
            del self._found[next(iter(self._found))]
        return known

    def _patterns(self, values: Array) -> Array:
        """Return what of each row is structure: values of keys that are, and special ones of others."""
        special = self._is_structure | (values[:, :, None] == self._special).any(axis=2)
        return np.where(special, values, np.inf)

    def _split(
        self, values: Array, rows: NDArray[np.int64], known: list[Built], positions: Positions | None
    ) -> list[tuple[Built | None, NDArray[np.int64]]]:
        groups: list[tuple[Built | None, NDArray[np.int64]]] = []
        alone: list[int] = []
        untried, self.unbuilt = [x for x in known if x.starts or positions is not None], ""
        while len(rows):
            build = partial(self._build, start=_of_row(positions, rows[0]))
            try:
                structure = untried.pop(0) if untried else build(values[rows[0]])
            except RobodynError as error:
                self.unbuilt = f"equations for many runs cannot be built ({error.message})"
                alone.append(int(rows[0]))
                rows = rows[1:]
                continue
            fits = structure.fits(values[rows])
            own = rows[fits]
            if structure not in known:
                known.append(structure)
                if not len(own):  # a comparison that is not decided by the numbers alone
                    own, fits[0] = rows[:1], True
            sure = structure.confirmed(values[own], build)
            if sure.any():
                groups.append((structure, own[sure]))
            alone += own[~sure].tolist()
            rows = rows[~fits]
        if alone:
            groups.append((None, np.array(alone, dtype=np.int64)))
        return groups

    def _build(self, row: Array, start: dict[str, float] | None) -> Built:
        try:
            return self._make(self.family, self.keys, row)
        except RobodynError:
            if start is None:
                raise
        structure = self._make(self.family.starting_at(start), self.keys, row)
        structure.starts = False
        return structure


def _of_row(positions: Positions | None, row: int) -> dict[str, float] | None:
    """Return the positions of a run, None where they are not given or no numbers."""
    own = {} if positions is None else {name: float(x[row]) for name, x in positions.items()}
    return own if own and np.isfinite(list(own.values())).all() else None
