"""How a mechanism's q, v and z lie in the state that is integrated.

Integrators step x = (positions, rates, z) with d(positions)/dt = rates, and a general first-order part z-dot = r.
A joint whose v is the rate of its q goes into the former. One with quasi-velocities, q-dot = N(q) v (quaternions),
goes into z with both its q and its v:

    positions, rates : q and v of the joints with q-dot = v
    z                : q, v of each joint with quasi-velocities, then the further states (controllers, work)

Nothing is lost by that: a collocation method gives the same solution in acceleration form and in first-order form,
Gauss keeps |quaternion| as it does any quadratic invariant, and no method needs to know. The state is put back on
the joints' manifolds after each step (``Corrections.normalisation``).
"""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.rebuild import moved
from robodyn_cli.model.model import Model
from robodyn_cli.record import record


@record
class Layout:
    """Places in the integrator's state of the mechanism's q (nq), v (nv) and further states z.

    ordinary : how many velocities are rates of positions; these have places 0 to ordinary - 1 among the positions.
    """

    q: tuple[int, ...]
    v: tuple[int, ...]
    z: tuple[int, ...]
    ordinary: int

    @staticmethod
    def of(model: Model, others: int) -> Layout | None:
        """Return the layout for a model and so many further states; None where x = (q, v, z) as it stands."""
        if not any(body.joint.quasi for body in model.bodies):
            return None
        bodies = sorted(model.bodies, key=lambda b: b.v)
        n = sum(b.joint.nv for b in bodies if not b.joint.quasi)
        q, v = [0] * model.nq, [0] * model.nv
        position, place = 0, 2 * n
        for body in bodies:
            joint = body.joint
            if joint.quasi:
                for k in range(joint.nq):
                    q[body.q + k], place = place, place + 1
                for k in range(joint.nv):
                    v[body.v + k], place = place, place + 1
            else:
                for k in range(joint.nv):
                    q[body.q + k], v[body.v + k] = position, n + position
                    position += 1
        return Layout(tuple(q), tuple(v), tuple(range(place, place + others)), n)

    @property
    def size(self) -> int:
        """Length of the state."""
        return len(self.q) + len(self.v) + len(self.z)

    def symbol(self, place: int) -> tuple[str, int]:
        """Return the input group of the integrator and the position in it of a place in the state."""
        n = self.ordinary
        return ("q", place) if place < n else ("v", place - n) if place < 2 * n else ("z", place - 2 * n)

    def renamed(self, entries: Sequence[Scalar]) -> list[Scalar]:
        """Return expressions of the mechanism's symbols q, v, z as expressions of the integrator's."""
        groups = {"q": self.q, "v": self.v, "z": self.z}
        return moved(
            entries, lambda group, k: self.symbol(groups[group][k]) if group in groups else (group, k)
        )
