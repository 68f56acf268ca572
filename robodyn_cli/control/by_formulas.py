"""A controller by formulas, with states of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from robodyn_cli.control.base import Follower, Problems, Situation
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Formula, MapOf, Number, Section, key

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
    state: dict[str, State] = key(MapOf(Section(State), of="state"), default=None, doc="States of its own.")

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
