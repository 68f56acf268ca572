"""Controllers that a user writes: by formulas, and as functions in Python."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from robodyn_cli.control.base import Follower, Problems, Situation
from robodyn_cli.errors import NumericalError, RobodynError, SceneError
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Formula, MapOf, Number, Section, key
from robodyn_cli.spatial.algebra import Array

SEEN = ("t", "q", "qd", "ref", "refd", "refdd", "s")


@record
class State:
    """A state of a controller."""

    start: float = key(Number(), default=0.0, doc="Its value at t = 0.")
    rate: Any = key(Formula(SEEN), default=None, doc="Its rate [1/s of its unit].")
    next: Any = key(Formula(SEEN), default=None, doc="Or, with a period: its value at the next sample.")


@record
class ByFormulas(Follower):
    """Torques by formulas in t, q.J, qd.J, the reference ref.J, refd.J and refdd.J, and states s.NAME."""

    numbers: ClassVar[tuple[str, ...]] = ("law", "state", "limit", "rate_limit", "sensors", "period")

    type: str = key(Choice(("formulas",)), doc="Kind of controller.")
    law: dict[str, Any] = key(MapOf(Formula(SEEN), of="joint"), unit="N m or N", doc="Torque of each joint.")
    state: dict[str, State] = key(
        MapOf(Section(State), of="state", minimum=0), default=None, doc="States of its own."
    )

    def problems(self) -> Problems:
        for name, state in self.state.items():
            if (state.rate is None) == (state.next is None):
                yield ("state", name), "needs either 'rate' or 'next'"
            elif state.next is not None and self.period is None:
                yield ("state", name, "next"), "goes with 'period'; without one the state needs its 'rate'"

    def states(self, joints: Sequence[str]) -> list[tuple[str, float]]:
        return [(name, float(state.start)) for name, state in self.state.items()]

    def torques(self, at: Situation) -> list[Any]:
        names = at.names()
        return [self.law[joint].evaluate(names) for joint in at.joints]

    def rates(self, at: Situation, asked: Sequence[Any], given: Sequence[Any]) -> list[Any]:
        names = at.names()
        return [state.rate.evaluate(names) for state in self.state.values()]

    def updated(self, at: Situation, asked: Sequence[Any], given: Sequence[Any], period: float) -> list[Any]:
        names = at.names()
        return [
            s + period * state.rate.evaluate(names) if state.next is None else state.next.evaluate(names)
            for s, state in zip(at.states, self.state.values())
        ]


@record
class InPython(Follower):
    """``tau = f(t, q, qd)``: called at each sample with the measured positions and rates of all joints.

    f is what ``simulate(scene, controller=f)`` is given. A run is integrated twice for its error estimate, each time
    from t = 0; where f has a method ``reset``, that is called before.
    """

    numbers: ClassVar[tuple[str, ...]] = ("limit", "rate_limit", "sensors", "period")

    type: str = key(Choice(("python",)), doc="Kind of controller.")
    function: Any = dataclasses.field(default=None, compare=False, repr=False)

    def problems(self) -> Problems:
        if self.period is None:
            yield ("period",), "is missing: a function in Python is called once a period"

    def torques(self, at: Situation) -> list[Any]:
        """Return what the function gave: an input of the update's program."""
        graph: Any = at.t.graph  # type: ignore[union-attr]
        return [graph.symbol(f"f.{name}", "asked", k) for k, name in enumerate(at.joints)]

    def call(self, time: float, q: Array, v: Array) -> Array:
        """Return the torques (n,) that the function gives for measured q (nq,) and v (nv,).

        Raises
        ------
        SceneError : there is no function. NumericalError : it raises something, or gives no finite torques.
        """
        if self.function is None:
            raise SceneError(
                "'python' needs a function: simulate(scene, controller=f) in Python; allowed on the "
                "command line: the other types",
                ("control.type",),
                key="control.type",
            )
        where, driven = f"at t = {time:.6g} s", len(self.joints or ())
        try:
            tau = np.asarray(self.function(time, q, v), dtype=float)
        except (RobodynError, KeyboardInterrupt, SystemExit):
            raise
        except Exception as error:
            message = f"the controller's function failed {where}: {type(error).__name__}: {error}"
            raise NumericalError(message, time=time, status="controller") from error
        if tau.shape != (driven,) or not np.isfinite(tau).all():
            message = (
                f"the controller's function gave {tau.tolist()!r} {where}; allowed: {driven} finite torques"
            )
            raise NumericalError(message, time=time, status="controller")
        return tau
