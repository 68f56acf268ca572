"""What many runs of one command do and give: the part that compiled code does, and each run by the command itself."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import INTERNAL, RobodynError
from robodyn_cli.over.batch.criteria import exit_code, lookup_number
from robodyn_cli.over.many.groups import Built, Structures
from robodyn_cli.over.many.keys import Key, settings
from robodyn_cli.record import mutable_record, record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.checks.columns import asking
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.keys import leaf_of

Rows = NDArray[np.int64]
STATUS = "status"
TOO_SMALL = "a drive, or a margin of motorisation, is too small"
Own = TypeVar("Own", bound=Built)


@record
class AskedRuns:
    """What is asked of runs.

    result : takes the rows; its outputs are the keys that are wanted. q, qd : initial states (N, nq), (N, nv) in place
    of the scene's. samples : at how many uniform times values are wanted. threads : that make runs.
    """

    result: ManyRuns
    q: Array | None
    qd: Array | None
    samples: int
    threads: int


class BatchCommand(ABC, Generic[Own]):
    """A command for many runs. Without state: one object serves all.

    sampled : columns of what samples hold, ``q`` as positions and all others as rates. words : what keys of the summary
    say in every run that compiled code makes and that ends as it should, missed : in others. slow : why keys that begin
    so take a whole command. judges : whether compiled code knows when drives or margins of motorisation are too small.
    """

    name: str
    words: Mapping[str, Any] = {}
    missed: Mapping[str, Any] = {}
    slow: Mapping[str, str] = {}
    judges = False
    sampled: tuple[str, ...] = ("q", "qd")

    @abstractmethod
    def structure(self, family: Family, keys: Sequence[Key], row: Array) -> Own:
        """Return what serves runs with such a row of values; raises what the command raises for it."""

    @abstractmethod
    def is_plain(self, key: str) -> bool:
        """Tell whether compiled code gives this key of the summary."""

    @abstractmethod
    def make(self, structure: Own, rows: Rows, asked: AskedRuns) -> list[int]:
        """Make runs of one structure in compiled code; return those that are left to be made one by one."""

    @abstractmethod
    def with_samples(self, scene: Scene, samples: int) -> Scene:
        """Return a scene that asks for so many samples."""

    @abstractmethod
    def single(self, scene: Scene) -> Result:
        """Do the command for one scene."""

    @abstractmethod
    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        """Take the end of a run that was made by ``single`` into its row."""


@mutable_record
class ManyRuns:
    """What many runs gave, a row each.

    values : of the keys (N, keys). code : exit code that the command would have; reason : why a run failed. time :
    where it ended [s], with its estimated error where an event ended it. q, qd : positions (N, nq) and rates (N, nv)
    there [rad or m, 1/s of these], columns as in ``q_names`` and ``qd_names``. q_error, qd_error : their estimated
    errors. outputs, errors : (N,) by key of the summary, as far as they were asked for. steps : of the integration.
    series : order of the Taylor series, or 8 of ``dop853``, that made a run side by side with others, 0 where it was
    the method that the command itself takes. one_by_one : which runs were made by the driver in Python. samples :
    times (N, M) [s], positions (N, M, nq) and rates (N, M, nv), where they were asked for; of inverse dynamics qdd and
    tau (N, M, nv) too.
    left : why runs were left to the command, and how many.

    What a run does not have is nan.
    """

    keys: tuple[str, ...]
    values: Array
    q_names: tuple[str, ...]
    qd_names: tuple[str, ...]
    code: NDArray[np.int64]
    reason: list[str]
    time: Array
    time_error: Array
    q: Array
    qd: Array
    q_error: Array
    qd_error: Array
    steps: NDArray[np.int64]
    series: NDArray[np.int64]
    one_by_one: NDArray[np.bool_]
    outputs: dict[str, Array]
    errors: dict[str, Array]
    samples: dict[str, Array]
    left: dict[str, int] = dataclasses.field(default_factory=dict)

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Which runs ended as they should."""
        return self.code == 0

    def __repr__(self) -> str:
        """Return one line; the arrays of many runs would fill screens."""
        failed = int(np.count_nonzero(self.code))
        return f"ManyRuns({len(self)} runs, {failed} failed, of {', '.join(self.keys) or 'the scene as it stands'})"

    def __len__(self) -> int:
        return len(self.values)

    def take(self, row: int, run: Ended) -> None:
        """Take what a run came to into its row, but for its end."""
        self.code[row], self.reason[row] = run.code, run.reason
        for key, column in self.outputs.items():
            column[row], self.errors[key][row] = number_of(run.summary, key), error_of(run.summary, key)

    def end_of(self, group: str, name: str, rows: Rows) -> Array:
        """Return a position or a rate (``q``, ``theta1``) at the ends of rows, nan where there is none of that name."""
        names = self.q_names if group == "q" else self.qd_names
        if name not in names:
            return np.full(len(rows), np.nan)
        column: Array = getattr(self, group)[rows, names.index(name)]
        return column

    def largest_error(self, group: str, rows: Rows) -> Array:
        """Return the largest error of positions (``q``) or rates at the ends of rows."""
        largest: Array = getattr(self, f"{group}_error")[rows].max(axis=1, initial=0.0)
        return largest

    @staticmethod
    def empty(
        keys: Any, values: Array, names: tuple[Any, Any], of: Any, sampled: Any = (), samples: int = 0
    ) -> ManyRuns:
        """Return rows without anything in them.

        names : columns of q and of qd. sampled : what is kept at so many samples, ``q`` and others with its rates'
        columns.
        """
        count, (nq, nv) = len(values), (len(n) for n in names)

        def nothing(*shape: int) -> Array:
            array = np.empty((count, *shape))
            array.fill(np.nan)  # takes a third of the time of ``np.full``, which counts for a run at a time
            return array

        grid = {"time": nothing(samples), **{n: nothing(samples, nq if n == "q" else nv) for n in sampled}}
        return ManyRuns(
            tuple(keys), values, tuple(names[0]), tuple(names[1]),
            np.full(count, -1), [""] * count, nothing(), nothing(), nothing(nq), nothing(nv), nothing(nq), nothing(nv),
            np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool),
            {key: nothing() for key in of}, {key: nothing() for key in of}, grid if samples else {},
        )  # fmt: skip


@record
class Ended:
    """What a run came to: its summary, its exit code, why it failed, its result; nothing where it did not begin."""

    summary: Mapping[str, Any]
    code: int
    reason: str
    result: Result | None


def ended(run: Callable[[], Result]) -> Ended:
    """Make a run; whatever ends it is part of what it came to."""
    try:
        result = run()
    except RobodynError as error:
        if not isinstance(error.result, Result):
            return Ended({}, error.exit_code, error.message, None)
        result, code = error.result, error.exit_code
        summary = {**result.summary, **result.head, "error": error.facts}
    except Exception as fault:  # of the program, in one run: the others stay as they are
        return Ended({}, INTERNAL, f"{type(fault).__name__}: {fault}", None)
    else:
        summary = {**result.summary, **result.head}
        code = exit_code(summary)
    return Ended(summary, code, _reason(summary, code), result)


def _reason(summary: Mapping[str, Any], code: int) -> str:
    """Return why a run failed; nothing where it did not."""
    error = summary.get("error")  # of `reach` how far it is off
    if isinstance(error, Mapping):
        return str(error["message"])
    if code == 0:
        return ""
    small = summary["status"] == "undersized"
    return TOO_SMALL if small else str(summary["termination"]["reason"])


def number_of(summary: Mapping[str, Any], key: str) -> float:
    """Return a number of a summary; nan where it has none there."""
    value = lookup_number(summary, key)
    return math.nan if value is None else value


def error_of(summary: Mapping[str, Any], key: str) -> float:
    """Return the estimated error of a number of a summary, the largest of those that its declaration names; nan where
    the summary tells none."""
    leaf = leaf_of(summary["command"], key) if summary else None
    errors = (number_of(summary, error) for error in leaf.errors) if leaf is not None else ()
    return max((x for x in errors if not math.isnan(x)), default=math.nan)


OWN_EQUATIONS = (
    "their values make equations of their own, as one that is zero or cancels another is no part of them"
)
OTHER_KEYS = "compiled code does not give all that is asked for"
VERDICT = "limits of drives, or margins of motorisation, decide the exit code"
DOUBTFUL = "they do not start or end as the others, or look doubtful in compiled code"


class Making:
    """Makes rows of runs of one mechanism.

    Parameters
    ----------
    command : what the runs do.
    """

    def __init__(self, command: BatchCommand[Any], structures: Structures, asked: AskedRuns) -> None:
        self.command, self.structures, self.asked = command, structures, asked

    @property
    def result(self) -> ManyRuns:
        """The rows."""
        return self.asked.result

    def compiled(self, rows: Rows) -> Rows:
        """Make these rows in compiled code; return those that are left to be made one by one."""
        plain = all(self.command.is_plain(key) for key in self.result.outputs)
        scene = self.structures.family.own
        judged = scene.drives or scene.motorisation is not None
        beside = VERDICT if judged and not self.command.judges else "" if plain else OTHER_KEYS
        left: list[int] = []
        q = self.asked.q
        positions = None if q is None else dict(zip(self.result.q_names, q[rows].T))
        for structure, group in self.structures.groups(self.result.values[rows], positions):
            here = rows[group]
            none = self.structures.unbuilt or OWN_EQUATIONS
            why = none if structure is None else structure.obstacle or self._bound(structure) or beside
            own = (
                here.tolist() if why or structure is None else self.command.make(structure, here, self.asked)
            )
            if own:
                self.result.left[why or DOUBTFUL] = self.result.left.get(why or DOUBTFUL, 0) + len(own)
            left += own
        return np.array(sorted(left), dtype=np.int64)

    def _bound(self, structure: Built) -> str:
        """Return why runs are made one by one that are given their starts; nothing where none are."""
        return structure.bound if self.asked.q is not None or self.asked.qd is not None else ""

    def one_by_one(self, rows: Rows) -> None:
        """Make these rows as the command does."""
        for row in rows.tolist():
            self._alone(row)

    def _alone(self, row: int) -> None:
        """Make one run as the command does."""
        result = self.result
        result.one_by_one[row] = True
        run = ended(lambda: self.command.single(self._scene(row)))
        result.take(row, run)
        if run.result is None:
            return
        summary, own = run.summary, run.result
        if self.asked.samples and len(own.time) == self.asked.samples:
            result.samples["time"][row] = own.time
            for name in self.command.sampled:
                result.samples[name][row] = own[name]
        self.command.read(summary, result, row)

    def _scene(self, row: int) -> Scene:
        """Return the scene of one run."""
        result, structures = self.result, self.structures
        scene = structures.family.scene(settings(result.keys, result.values[row]))
        scene = asking(scene, result.outputs)
        initial, q, qd = scene.initial, self.asked.q, self.asked.qd
        if q is not None:
            initial = dataclasses.replace(initial, q=dict(zip(result.q_names, q[row].tolist())))
        if qd is not None:
            initial = dataclasses.replace(initial, qd=dict(zip(result.qd_names, qd[row].tolist())))
        if self.asked.samples:
            scene = self.command.with_samples(scene, self.asked.samples)
        return dataclasses.replace(scene, initial=initial)
