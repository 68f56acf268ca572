"""Why a run could not go on, in words.

Fixed steps that an event cuts.

Events that follow each other while time stands still.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.events import EventFunction
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.memory import Status, resolution
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


@record
class Stopped:
    """Where the stepping loop stopped before its end: time [s], step tried [s], state (nx,)."""

    status: Status
    time: float
    step: float
    state: Array
    options: Options

    def error(self, system: System, p: Array) -> NumericalError:
        """Return the error to raise, for a system with parameters p."""
        return NumericalError(self._words(system, p), time=self.time, status=self.status.name.lower())

    def _words(self, system: System, p: Array) -> str:
        where = f"at t = {self.time:.6g} s"
        if self.status is Status.MAX_STEPS:
            return (
                f"more than {self.options.max_steps} steps, stopped {where}; `simulate.max_steps` allows more"
            )
        if self.status is Status.NOT_FINITE:
            return f"the state stops being finite {where}"
        if self.status is Status.NOT_SOLVED:
            words = f"the equations of a step of {self.step:.3g} s have no solution nearby"
            return f"{words} {where}; allowed: a shorter simulate.step"
        if not np.all(np.isfinite(rates_at(system, self.time, self.state, p))):
            return f"the equations of motion give no finite accelerations {where}"
        hint = ""
        if self.options.atol == 0.0 and np.any(self.state == 0.0):
            hint = "; with 'atol: 0' a quantity at zero may have no error at all; allowed: an 'atol' such as 1e-12"
        return f"the step size became too small {where} (step {self.step:.3g} s){hint}"


def rates_at(system: System, time: float, state: Array, p: Array) -> Array:
    """Return accelerations and z rates (nv + nz,) at a state (nx,), slowly, without a compiler."""
    nq, nv, y = system.nq, system.nv, state[:, None]
    groups = {"t": np.array([[time]]), "q": y[:nq], "v": y[nq : nq + nv], "z": y[nq + nv :], "p": p[:, None]}
    return system.dynamics.values(groups)


CLOSE = 1e-9  # of a fixed step before a jump: a step from there may see the other side
PART = 1e-2  # of what is left to a jump is left again by a step towards it


class Approach:
    """Where steps end before an event.

    step : fixed [s], None without. halves : whether a step that is cut is cut in two.
    """

    def __init__(self, step: float | None, halves: bool) -> None:
        self.step, self.halves = step, halves
        self.last = math.nan

    def stopover(self, start: float, time: float, jumps: bool) -> float | None:
        """Return where a step from ``start`` that an event cuts at ``time`` ends before it, None where it goes there.

        A stage at the end of a step that ends at a jump of the rates may lie beyond it, so steps come close first.
        An event cuts a step to the same length whatever the step asked for: a second integration goes there in two.
        """
        if self.step is None:
            return None
        left = time - start
        if self.halves and start != self.last:
            left *= 0.5
        elif jumps and left > CLOSE * self.step + resolution(start, time):
            left *= PART
        else:
            return None
        self.last = time - left
        return self.last


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
