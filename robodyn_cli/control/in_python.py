"""A controller that is a function in Python, which ``simulate(scene, controller=f)`` takes."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import numpy as np

from robodyn_cli.control.base import Follower, Problems, Situation
from robodyn_cli.errors import NumericalError, RobodynError, SceneError
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, key
from robodyn_cli.spatial.algebra import Array


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
                "control.type: 'python' needs a function: simulate(scene, controller=f) in Python; allowed on the "
                "command line: the other types",
                key="control.type",
            )
        where, driven = f"at t = {time:.6g} s", len(self.joints or ())
        try:
            found = np.asarray(self.function(time, q, v), dtype=float)
        except (RobodynError, KeyboardInterrupt, SystemExit):
            raise
        except Exception as error:
            what = f"the controller's function failed {where}: {type(error).__name__}: {error}"
            raise NumericalError(what, time=time, status="controller") from error
        if found.shape != (driven,) or not np.isfinite(found).all():
            what = (
                f"the controller's function gave {found.tolist()!r} {where}; allowed: {driven} finite torques"
            )
            raise NumericalError(what, time=time, status="controller")
        return found
