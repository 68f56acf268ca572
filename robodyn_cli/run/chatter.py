"""Formulas that switch to and fro without end, as sign(rate) does where a joint sticks."""

from __future__ import annotations

from collections import deque

from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.integrator import Event

TIMES = 60  # switches of one formula ...
WITHIN = 1e-9  # ... within this part of the time so far (or of a second) are chatter


class ChatterGuard:
    """Follows the kinks that a run meets."""

    def __init__(self, system: System) -> None:
        self.system = system
        self._recent: dict[int, deque[float]] = {}

    def passes(self, event: Event) -> bool:
        """Tell whether an event is a kink, which concerns nobody else.

        Raises
        ------
        NumericalError : it happens again and again, and the motion gets nowhere.
        """
        function = self.system.events[event.index]
        if not function.kink:
            return False
        recent = self._recent.setdefault(event.index, deque(maxlen=TIMES))
        recent.append(event.time)
        if len(recent) == TIMES and event.time - recent[0] <= WITHIN * max(1.0, event.time):
            raise NumericalError(
                f"{function.name} switches to and fro without end at t = {event.time:.6g} s: the motion sticks where "
                "the formula jumps; replace the jump by a steep slope, as in tanh(x/0.001) for sign(x)",
                time=event.time, key=function.name, status="chatter",
            )  # fmt: skip
        return True
