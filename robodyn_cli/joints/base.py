"""What a joint knows about itself.

To add a joint, write a file with a subclass and one line in the registry. No other part asks for the kind of a joint.
The checklist, which the conformance tests run over every registered joint:

1. ``transform(q)``: X from the frame before the joint to the body's frame, textbook sign.
2. ``S``: motion subspace in body coordinates, (6, nv), angular rows first.
3. ``S_rate(q, qd)``: dS/dt in body coordinates, entry by entry (zero for constant S).
4. ``velocity_map(q, v)``: q-dot from v; the identity unless the velocities are ``quasi``.
5. ``integrate(q, dq)``, ``difference(q0, q1)``, ``normalise(q)``: steps on the joint's own manifold.
6. ``divided(inertia)``: what of a body's inertia stays and what may be counted to the parent, or None;
   ``parent_inertia(inertia)``: all that may be, where that takes differences.
7. ``units`` and ``names`` of q, ``v_units`` and ``v_names`` of v, where they differ from those of q.
8. ``angle(q)``: how far it turns about its z axis, or None where it may turn about others.
9. ``needs`` and ``takes``: keys by which a scene places it; ``by_dh`` and ``dh_variable`` where D-H parameters do.
10. ``freedoms``: what forces in the joint act on; its coordinates, unless the velocities are ``quasi``.
"""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Transform, Vector, matrix, vector, zeros
from robodyn_cli.spatial.inertia import RigidInertia


@record
class Freedom:
    """A part of a joint's motion that forces in the joint act on: a coordinate, or a rotation or translation in space.

    name : its key in the scene, '' where a joint has no other. q, v : places among the joint's own, slices in space.
    unit : ``rad`` or ``m``.
    """

    name: str
    q: Any
    v: Any
    unit: str

    @property
    def in_space(self) -> bool:
        """Whether it is a rotation or translation in any direction."""
        return isinstance(self.v, slice)


class Joint:
    """A kind of joint with ``nq`` position and ``nv`` velocity coordinates.

    quasi : q-dot is not v but ``velocity_map(q, v)``. units : of q, ``rad``, ``m`` or ``1``; v_units : ``rad`` or
    ``m``, per second that of v. names, v_names : what a coordinate is called behind the joint's name
    (``ball.qw``); a joint with one coordinate goes by its own name. v_units, v_names : as units and names by default.
    subspace : columns of S where it is constant. needs, takes : keys of the scene, of ``axis``, ``axis2``, ``pitch``,
    that must or may stand beside ``origin``. by_dh : whether D-H parameters may place it instead. dh_variable : the D-H
    parameter that is q: ``theta`` of a joint that only turns about its z axis, ``d`` of one that only slides along it.
    pitch : advance along its axis [m/rad].
    """

    type: ClassVar[str] = ""
    nq: ClassVar[int] = 0
    nv: ClassVar[int] = 0
    quasi: ClassVar[bool] = False
    units: ClassVar[tuple[str, ...]] = ()
    v_units: ClassVar[tuple[str, ...]] = ()
    names: ClassVar[tuple[str, ...]] = ()
    v_names: ClassVar[tuple[str, ...]] = ()
    subspace: ClassVar[tuple[tuple[float, ...], ...]] = ()
    needs: ClassVar[tuple[str, ...]] = ()
    takes: ClassVar[tuple[str, ...]] = ("axis",)
    by_dh: ClassVar[bool] = False
    pitch: float = 0.0
    dh_variable: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        """Give velocities the units and names of positions where the class states no others."""
        cls.v_units = cls.v_units or cls.units
        cls.v_names = cls.v_names or cls.names

    @staticmethod
    def coordinates(joint: str, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the columns of q or v of a joint: its own name where ``names`` is empty."""
        return tuple(f"{joint}.{name}" for name in names) or (joint,)

    @property
    def freedoms(self) -> tuple[Freedom, ...]:
        """What forces in the joint act on."""
        names = self.names or ("",) * self.nv
        return tuple(Freedom(name, k, k, self.units[k]) for k, name in enumerate(names))

    def transform(self, q: Vector) -> Transform:
        """Return X from the frame before the joint to the body frame, at position ``q`` (nq,)."""
        raise NotImplementedError

    def S(self, q: Vector) -> Any:
        """Return the motion subspace (6, nv), body coordinates, angular rows first."""
        return matrix(self.subspace).T if self.subspace else zeros(6, 0)

    def S_rate(self, q: Vector, qd: Vector) -> Any:
        """Return dS/dt (6, nv) in body coordinates, entry by entry; zero where S is constant."""
        return zeros(6, self.nv)

    def divided(self, inertia: RigidInertia) -> tuple[RigidInertia, RigidInertia] | None:
        """Return a body's inertia as the part that stays and a part I' that may be counted to the parent, None if there
        is none.

        I' S = 0, and X(q)^T I' X(q) is the same at every q: the joint neither moves it nor changes its place. Each
        number is in one of the two, so that nothing is subtracted.
        """
        return None

    def parent_inertia(self, inertia: RigidInertia) -> RigidInertia | None:
        """Return all of a body's inertia that may be counted to the parent, None if there is nothing."""
        parts = self.divided(inertia)
        return None if parts is None else parts[1]

    def angle(self, q: Vector) -> Any:
        """Return the angle [rad] by which the joint has turned about its z axis, counted without end.

        None for a joint that can turn about another axis.
        """
        return None

    def velocity_map(self, q: Vector, v: Vector) -> Vector:
        """Return q-dot (nq,) for joint velocity ``v`` (nv,)."""
        return v

    def neutral(self) -> list[float]:
        """Return the position (nq,) at which the transform is the identity."""
        return [0.0] * self.nq

    def integrate(self, q: Vector, dq: Vector) -> Vector:
        """Return the position reached from ``q`` with constant velocity ``dq`` (nv,) in unit time."""
        return vector([a + b for a, b in zip(q, dq)])

    def difference(self, q0: Vector, q1: Vector) -> Vector:
        """Return the velocity (nv,) that leads from q0 to q1 in unit time."""
        return vector([b - a for a, b in zip(q0, q1)])

    def normalise(self, q: Vector) -> Vector:
        """Return ``q`` put back on its manifold."""
        return q
