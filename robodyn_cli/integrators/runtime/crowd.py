"""Events that follow each other while time stands still."""

from __future__ import annotations

from collections import deque

from robodyn_cli.formulations.events import EventFunction

# chattering: so many steps with events within this part of the time so far (or of a second)
CROWD = 200
CROWDED = 1e-9


class Crowd:
    """The times of the last events."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=CROWD)

    def refuse(self, event: EventFunction, time: float) -> None:
        """Take note of an event in a step from ``time`` [s] on.

        Raises
        ------
        NumericalError : the event is one of a crowd.
        """
        self._times.append(time)
        if len(self._times) == CROWD and time - self._times[0] <= CROWDED * max(1.0, time):
            from robodyn_cli.integrators.event_location.events import chatter

            raise chatter(event, time)
