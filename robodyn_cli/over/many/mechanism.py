"""``Mechanism``: one scene, compiled once, run many times with other numbers."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.over.many.command import AskedRuns, BatchCommand, Making, ManyRuns
from robodyn_cli.over.many.groups import Built, Structures
from robodyn_cli.over.many.keys import Allowed, Key, understand
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.scene.units import refuse_doubles
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.threads import cores, one_at_a_time
from robodyn_cli.works.functions.model import ModelFunctions

Values = Mapping[str, Any] | Any
Start = tuple[Array | None, Array | None]


class Mechanism(ModelFunctions):
    """A scene as one compiled object, whose numbers may vary between runs.

    ``mass_matrix``, ``jacobian`` and the other functions of the model are of the scene as it stands.

    Parameters
    ----------
    scene : a scene, its family, or the path of its file.
    vary : keys of the scene, as in ``--set``, that vary between runs: masses, lengths, springs, ``parameters``, the
        initial state, the duration. Any key that holds a number may vary. A value that changes the structure (a mass of
        zero, an angle of a placement) gives its runs a structure of their own, which is built when it is met.
    keys : what these keys are, where that is known.

    Raises
    ------
    SceneError : the scene is wrong, or has no such key.
    """

    def __init__(
        self,
        scene: Scene | Family | str | os.PathLike[str],
        vary: Sequence[str] = (),
        keys: tuple[Key, ...] = (),
    ) -> None:
        self.family = Family.of(scene)
        super().__init__(self.family.own)
        refuse_doubles(self.family.root, vary, "vary")
        self.keys = keys or tuple(understand(self.family, name) for name in vary)
        self._allowed = Allowed(self.family, self.keys)
        self._structures: dict[str, Structures] = {}

    @property
    def scene(self) -> Scene:
        """The scene as it stands."""
        return self.family.own

    # -- many runs --------------------------------------------------------------------------------------
    def simulate_many(
        self,
        values: Values = None,
        *,
        q: Array | None = None,
        qd: Array | None = None,
        of: Sequence[str] = (),
        samples: int = 0,
        threads: int | None = None,
    ) -> ManyRuns:
        """Simulate many runs, each with its own steps, events and error estimate.

        Parameters
        ----------
        values : of the keys that vary, in SI units: arrays (N,) or numbers by key, or an array (N, keys).
        q, qd : initial positions (N, nq) [rad, m] and rates (N, nv) [1/s of these] in place of the scene's.
        of : keys of the summary of ``simulate`` that are wanted of each run.
        samples : at so many uniform times from the start to the end, states are wanted too.
        threads : that make runs; by default one for each processor. The result does not depend on it.

        Returns
        -------
        A row for each run. A run that fails is a row with its exit code and reason; the others go on.

        Raises
        ------
        CapabilityError : arrays of shapes that do not fit.
        """
        from robodyn_cli.over.many.simulate import Simulate

        if samples < 0 or samples == 1:
            raise CapabilityError(f"samples: {samples}; allowed: 0, for none, or 2 or more")
        return self._make(Simulate(), values, (q, qd), of, samples, threads)

    def deploy_many(
        self,
        values: Values = None,
        *,
        q: Array | None = None,
        qd: Array | None = None,
        of: Sequence[str] = (),
        threads: int | None = None,
    ) -> ManyRuns:
        """Deploy many times: simulate each run until it locks.

        Parameters, errors : as for ``simulate_many``; ``of`` names keys of the summary of ``deploy``.

        Returns
        -------
        A row for each run: the time of the lock with its estimated error, and the state there. A run that does not lock
        is a row with exit code 1.
        """
        from robodyn_cli.over.many.latched import command_for
        from robodyn_cli.over.many.simulate import Deploy

        return self._make(command_for(Deploy(), self.scene), values, (q, qd), of, 0, threads)

    def inverse_many(
        self, values: Values = None, *, of: Sequence[str] = (), samples: int | None = None
    ) -> ManyRuns:
        """Compute the torques that the scene's trajectory needs, with other numbers in each run.

        Parameters
        ----------
        values, of : as for ``simulate_many``; ``of`` names keys of the summary of ``inverse``.
        samples : number of uniform samples of the trajectory; default: the scene's ``inverse.samples``.

        Returns
        -------
        A row for each run. ``samples`` has times (N, M), q (N, M, nq), and qd, qdd and tau (N, M, nv) [N m or N];
        ``q`` and ``qd`` are those at the end. What changes the motion in other ways than lengths in loops do (paths of
        points of open chains, fastest motions) is computed run by run.

        Raises
        ------
        CapabilityError : arrays of shapes that do not fit, or fewer than two samples.
        """
        from robodyn_cli.over.many.inverse import InverseRuns

        count = self.scene.inverse.samples if samples is None else samples
        if count < 2:
            raise CapabilityError(f"samples: {count}; allowed: 2 or more")
        return self._make(InverseRuns(), values, (None, None), of, count, None)

    def statics_many(
        self, values: Values = None, *, q: Array | None = None, of: Sequence[str] = ()
    ) -> ManyRuns:
        """Find the balances of a scene, or the torques that hold it (``statics.find``), with other numbers in each run.

        Parameters, errors : as for ``simulate_many``; ``of`` names keys of the summary of ``statics``.

        Returns
        -------
        A row for each run; ``q`` is the configuration at rest.
        """
        from robodyn_cli.over.many.rest.statics import StaticsRuns

        return self._make(StaticsRuns(), values, (q, None), of, 0, None)

    @one_at_a_time
    def _make(
        self,
        command: BatchCommand[Any],
        values: Values,
        start: Start,
        of: Sequence[str],
        samples: int,
        threads: int | None,
    ) -> ManyRuns:
        self._refuse_impossible(command.name, of)
        rows = self._rows(values, start)
        q, qd = (self._start(x, names, len(rows)) for x, names in zip(start, (self.q_names, self.qd_names)))
        result = ManyRuns.empty(
            self._key_names, rows, (self.q_names, self.qd_names), of, command.sampled, samples
        )
        making, allowed = self._making(command, result, (q, qd), samples, threads or cores())
        making.one_by_one(making.compiled(allowed))
        return result

    @one_at_a_time
    def compiled(
        self, command: BatchCommand[Any], rows: Array, of: Sequence[str], threads: int
    ) -> tuple[ManyRuns, NDArray[np.int64]]:
        """Return runs with rows of values (N, keys), and the numbers of those that are left to the command itself."""
        result = ManyRuns.empty(self._key_names, rows, (self.q_names, self.qd_names), of)
        making, allowed = self._making(command, result, (None, None), 0, threads)
        return result, making.compiled(allowed)

    @one_at_a_time
    def structures(self, command: BatchCommand[Any], rows: Array) -> list[tuple[Built, NDArray[np.int64]]]:
        """Return the structures that serve rows of values (N, keys) in compiled code, with their rows' numbers."""
        groups = self.groups(command, rows)
        return [(own, group) for own, group in groups if own is not None and not own.obstacle]

    def groups(self, command: BatchCommand[Any], rows: Array) -> list[tuple[Built | None, NDArray[np.int64]]]:
        """Return all structures that rows of values (N, keys) have, with their rows' numbers; see ``Structures``."""
        return list(self._structures_of(command).groups(rows))

    def refusals(self, values: Array) -> dict[int, SceneError]:
        """Return the rows of values (N, keys) that the scene does not allow, with the errors."""
        return self._allowed.refusals(values)

    def _refuse_impossible(self, command: str, of: Sequence[str]) -> None:
        """Refuse outputs that no run can have.

        Raises
        ------
        CapabilityError
        """
        if not of:
            return
        from robodyn_cli.scene.checks.keys import key_names
        from robodyn_cli.summaries.keys import refusal

        for key in of:
            if wrong := refusal(command, key, key_names(self.scene), number=True):
                raise CapabilityError(f"of: {key!r}: {wrong}")

    @property
    def _key_names(self) -> list[str]:
        return [key.name for key in self.keys]

    def _making(
        self, command: BatchCommand[Any], result: ManyRuns, start: Start, samples: int, threads: int
    ) -> tuple[Making, NDArray[np.int64]]:
        """Return what makes the runs, and the numbers of those whose values are allowed."""
        refused = self.refusals(result.values)
        for row, error in refused.items():
            result.code[row], result.reason[row] = error.exit_code, error.message
        allowed = np.array([k for k in range(len(result)) if k not in refused], dtype=np.int64)
        asked = AskedRuns(result, *start, samples, threads)
        return Making(command, self._structures_of(command), asked), allowed

    def _structures_of(self, command: BatchCommand[Any]) -> Structures:
        if command.name not in self._structures:
            self._structures[command.name] = Structures(self.family, self.keys, command.structure)
        return self._structures[command.name]

    def _rows(self, values: Values, others: Sequence[Array | None]) -> Array:
        """Return rows of values (N, keys).

        Raises
        ------
        CapabilityError : keys or shapes that do not fit.
        """
        names = self._key_names
        if values is None:
            values = {}
        if not isinstance(values, Mapping):
            rows = np.array(values, dtype=float)
            if rows.ndim != 2 or rows.shape[1] != len(names):
                raise CapabilityError(
                    f"values have shape {rows.shape}; needed: (runs, {len(names)}), a column for each of {names}"
                )
            return rows
        if set(values) != set(names):
            raise CapabilityError(
                f"values are given of {list(values)}; needed: of each of {names}, which vary"
            )
        columns = [np.asarray(values[name], dtype=float) for name in names]
        lengths = {len(x) for x in (*columns, *others) if x is not None and np.ndim(x)}
        if len(lengths) > 1:
            raise CapabilityError(f"arrays of different lengths: {sorted(lengths)}")
        count = lengths.pop() if lengths else 1
        return (
            np.stack([np.broadcast_to(x, count) for x in columns], axis=1)
            if columns
            else np.zeros((count, 0))
        )

    @staticmethod
    def _start(x: Array | None, names: Sequence[str], count: int) -> Array | None:
        if x is None:
            return None
        array = np.asarray(x, dtype=float)
        if array.shape != (count, len(names)):
            raise CapabilityError(
                f"a start has shape {array.shape}; needed: ({count}, {len(names)}), a row for each run and a column "
                f"for each of {', '.join(names)}"
            )
        return array
