"""The variational equations of a motion: how its states change with keys of the scene.

    x-dot = f(t, x, k),  S = dx/dk:  S-dot = f_x S + f_k

(Hairer, Norsett and Wanner 1993, "Solving Ordinary Differential Equations I", section I.14). The equations are those
without any stabilisation: the loops hold for all k, so S satisfies their derivatives by itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.by_keys import ByKeys
from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.system import System
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.record import record
from robodyn_cli.run.driver.motion import Motion
from robodyn_cli.spatial.algebra import Array


@record
class Slopes:
    """Expressions at one point: values (n,), derivatives by the state (n, nx), by keys (n, K), by time (n,)."""

    values: Array
    state: Array
    keys: Array
    time: Array


@record
class Point:
    """A point of a motion: time t, x (nx,), x-dot, S (nx, K), and the rates of x-dot and S."""

    t: float
    x: Array
    rate: Array
    S: Array
    rate_rate: Array
    S_rate: Array

    def moved(self, dt: float) -> Point:
        """Return the point a very short time later."""
        x, rate, S = self.x + dt * self.rate, self.rate + dt * self.rate_rate, self.S + dt * self.S_rate
        return dataclasses.replace(self, t=self.t + dt, x=x, rate=rate, S=S)


@record
class Linearised:
    """Equations at times t (T,) and states x (T, nx): x-dot (T, nx), and for the rates of v and z their derivatives by
    the state, A (T, nr, nx), by keys, B (T, nr, K), and by time (T, nr).

    nq : positions, which lead x.
    """

    t: Array
    x: Array
    rate: Array
    A: Array
    B: Array
    time: Array
    nq: int

    def point(self, k: int, S: Array) -> Point:
        """Return sample k as a point of the motion with S = dx/dk there."""
        rate, lead = self.rate[k], slice(self.nq, 2 * self.nq)
        rate_rate = np.concatenate([rate[lead], self.A[k] @ rate + self.time[k]])
        S_rate = np.concatenate([S[lead], self.A[k] @ S + self.B[k]])
        return Point(float(self.t[k]), self.x[k], rate, S, rate_rate, S_rate)


class Variational:
    """The equations of a motion with their derivatives by the state and by numbers at places of the scene.

    Parameters
    ----------
    places : of the numbers, such as ``robot.links.link1.mass``; an empty one stands for a key that is no number of the
        equations.

    Raises
    ------
    CapabilityError : an operation, or a number, has no derivative.
    """

    def __init__(self, motion: Motion, places: Sequence[str]) -> None:
        self.system = _plain(motion)
        self.keys = len(places)
        self._by_keys = ByKeys({place: k for k, place in enumerate(places) if place})
        self._known: dict[tuple[int, ...], tuple[Any, ...]] = {}  # gradients, by the identity of expressions
        rates = self.system.rates
        rows = self._gradients(rates)
        self._entries = [(i, k) for i, row in enumerate(rows) for k in row]
        outputs = {"f": rates, "J": [x for row in rows for x in row.values()]}
        self.kernel = SampleKernel({name: x for name, x in outputs.items() if x}, STATE_GROUPS)

    def _gradients(self, outputs: Sequence[Scalar]) -> list[dict[int, Scalar]]:
        """Return the derivatives of expressions: columns are the state's, those of keys, then time."""
        system, n = self.system, self.system.size
        first = {"q": 0, "v": system.nq, "z": system.nq + system.nv, "t": n + self.keys}
        symbols = [e for e in free_symbols(outputs) if e.value[1] in first]
        columns = [first[e.value[1]] + e.value[2] for e in symbols]
        many = len(symbols)

        def slopes(x: float) -> dict[int, Scalar]:
            return {many + k: slope for k, slope in self._by_keys(x).items()}

        found = jacobian(outputs, symbols, slopes)
        return [{columns[k] if k < many else n + k - many: x for k, x in row.items()} for row in found]

    def along(self, t: Array, x: Array) -> Linearised:
        """Return the equations linearised at times t (T,) and states x (T, nx).

        Raises
        ------
        CapabilityError : something there is not finite.
        """
        system, n = self.system, self.system.size
        found = self._evaluate(t, x)
        J = np.zeros((len(t), n - system.nq, n + self.keys + 1))
        if self._entries:
            rows, columns = np.array(self._entries).T
            J[:, rows, columns] = found["J"]
        rate = np.concatenate([x[:, system.nq : system.nq + system.nv], found["f"]], axis=1)
        if not (np.isfinite(J).all() and np.isfinite(rate).all()):
            raise CapabilityError("derivatives along the motion are not finite")
        return Linearised(t, x, rate, J[:, :, :n], J[:, :, n:-1], J[:, :, -1], system.nq)

    def _evaluate(self, t: Array, x: Array) -> dict[str, Array]:
        partition = self.system.partition
        if partition is None:
            return self.kernel.evaluate(len(t), self.system.own_groups(t, x, np.zeros(0)))
        # accelerations on the constraints do not depend on the combination of dependent rows, if only it has full rank
        parts = []
        for k in range(len(t)):
            p = np.zeros(partition.first + partition.count)
            p[partition.first :] = partition.choose(float(t[k]), self.system.split(x[k])[0], None)
            parts.append(self.kernel.evaluate(1, self.system.own_groups(t[k : k + 1], x[k : k + 1], p)))
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def slopes(self, outputs: Sequence[Scalar], t: float, x: Array) -> Slopes:
        """Return the derivatives of expressions of the integrator's symbols at time t and state x (nx,)."""
        n = self.system.size
        identity = tuple(map(id, outputs))
        if identity not in self._known:
            rows = self._gradients(outputs)
            places = [(i, k) for i, row in enumerate(rows) for k in row]
            self._known[identity] = (
                outputs,
                places,
                Evaluator([*outputs, *(e for row in rows for e in row.values())]),
            )
        _, places, evaluate = self._known[identity]
        values = evaluate(self.system.own_groups([t], x, np.zeros(0)))
        found = np.zeros((len(outputs), n + self.keys + 1))
        for place, value in zip(places, values[len(outputs) :]):
            found[place] = value
        return Slopes(np.array(values[: len(outputs)]), found[:, :n], found[:, n:-1], found[:, -1])


def _plain(motion: Motion) -> System:
    """Return the equations of a motion as they are: no stabilisation, no events, no work."""
    return build_system(motion.problem, "none", work=False, expanded=True)
