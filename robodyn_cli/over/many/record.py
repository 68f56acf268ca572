"""What many runs gave."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.record import mutable_record
from robodyn_cli.spatial.algebra import Array


@mutable_record
class ManyRuns:
    """What many runs gave, a row each.

    values : of the keys (N, keys). code : exit code that the command would have; reason : why a run failed. time :
    where it ended [s], with its estimated error where an event ended it. q, qd : positions (N, nq) and rates (N, nv)
    there [rad or m, 1/s of these], columns as in ``q_names`` and ``qd_names``. q_error, qd_error : their estimated
    errors. outputs, errors : (N,) by key of the summary, as far as they were asked for. steps : of the integration.
    one_by_one : which runs were made by the driver in Python. samples : times (N, M) [s], positions (N, M, nq) and
    rates (N, M, nv), where they were asked for; of inverse dynamics qdd and tau (N, M, nv) too.

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
    one_by_one: NDArray[np.bool_]
    outputs: dict[str, Array]
    errors: dict[str, Array]
    samples: dict[str, Array]

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
            np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool),
            {key: nothing() for key in of}, {key: nothing() for key in of}, grid if samples else {},
        )  # fmt: skip
