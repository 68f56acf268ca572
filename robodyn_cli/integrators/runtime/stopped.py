"""Why a run could not go on, in words."""

from __future__ import annotations

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.layout import Status
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
            return f"more than {self.options.max_steps} steps, stopped {where}"
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
