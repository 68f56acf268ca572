"""The functions of a model: mass matrix, Coriolis matrix, dynamics and their derivatives, kinematics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from robodyn_cli.model.model import FixedFrame
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.threads import ThreadSafe, once, one_at_a_time
from robodyn_cli.torques.dynamics import ForwardDynamics, InverseDynamics, StateFunction

if TYPE_CHECKING:
    from robodyn_cli.given.poses.inverse_kinematics import InverseKinematics
    from robodyn_cli.scene.types import Scene
    from robodyn_cli.torques.dynamics import ForwardDynamics, InverseDynamics
    from robodyn_cli.works.functions.constrained import ConstrainedDynamics
    from robodyn_cli.works.functions.derivatives import (
        AccelerationDerivatives,
        InertialParameters,
        Regressor,
        TorqueDerivatives,
    )


class ModelFunctions(ThreadSafe):
    """The functions of a model, each compiled when it is first called.

    All take states: q (T, nq) [rad or m, quaternions scalar first], qd, qdd (T, nv) [1/s and 1/s^2 of rad or m],
    tau (T, nv) [N m or N], a row for each of T states, columns as in ``q_names`` and ``qd_names``. One state may be
    given as (nq,) and (nv,); its result has no leading axis T. Where q-dot is not qd (spherical and floating joints)
    qd is that of the joint: body axes, see docs/scene.md. Results are column-ordered, and arguments that are
    (``order="F"``) are read in place. Several threads may call them.

    M, C, G, regressor and kinematics of a mechanism with loops are those of its tree, the loops opened: its motion also
    obeys Psi(q) qd = 0, with Psi from ``constraint_jacobian``. Its forward dynamics has the forces of the loops in it;
    inverse dynamics takes open chains, for loops share the load.

    Raises
    ------
    CapabilityError : arrays of shapes that do not fit, and what a function does not take. SceneError : data are needed
    that the scene does not give, or there is no such frame.
    """

    def __init__(self, source: Scene | Problem) -> None:
        super().__init__()
        self._source = source
        self._functions: dict[str, StateFunction] = {}
        self._places: dict[str, tuple[Problem, FixedFrame]] = {}

    @once
    def _problem(self) -> Problem:
        return self._source if isinstance(self._source, Problem) else Problem(self._source)

    @property
    def q_names(self) -> tuple[str, ...]:
        """Columns of positions."""
        return self._problem.model.q_names

    @property
    def qd_names(self) -> tuple[str, ...]:
        """Columns of rates, accelerations and torques."""
        return self._problem.model.v_names

    def _function(
        self, name: str, takes: Sequence[str], entries: Callable[[], Any], problem: Problem | None = None
    ) -> StateFunction:
        """Return the function of a name, compiled from what ``entries()`` gives when it is first asked for.

        entries : arrays of expressions by name, or one array that goes by the name of the function.
        """
        function = self._functions.get(name)
        return self._built(name, takes, entries, problem) if function is None else function

    @one_at_a_time
    def _built(
        self, name: str, takes: Sequence[str], entries: Callable[[], Any], problem: Problem | None
    ) -> StateFunction:
        if name not in self._functions:
            outputs = entries()
            named = outputs if isinstance(outputs, dict) else {name: outputs}
            self._functions[name] = StateFunction(problem or self._problem, takes, named, eager=True)
        return self._functions[name]

    @one_at_a_time
    def _place(self, frame: str) -> tuple[Problem, FixedFrame]:
        """Return a frame, and the equations that know it."""
        from robodyn_cli.given.poses.targets import find_frame, with_frame

        if not isinstance(frame, str):
            raise SceneError(f"frame {frame!r:.60} is no name; allowed: a named point or frame, or a link")
        if frame not in self._places:
            problem = with_frame(self._source, frame) if "." in frame else self._problem
            self._places[frame] = problem, find_frame(problem.model, frame)
        return self._places[frame]

    # -- dynamics ---------------------------------------------------------------------------------------
    def mass_matrix(self, q: Any) -> Array:
        """Return the joint-space mass matrix M (T, nv, nv) [kg m^2, kg m or kg], rotors included.

        Kinetic energy is qd^T M qd / 2; symmetric, positive definite. Composite bodies, Featherstone (2008), table 6.2.
        """
        return self._function("M", ("q",), lambda: self._problem.mass_matrix)(q)["M"]

    def coriolis(self, q: Any, qd: Any) -> Array:
        """Return the Coriolis matrix C (T, nv, nv): C qd are the velocity terms of the torques.

        Of all such matrices it is that of Christoffel's symbols: M-dot = C + C^T, so M-dot - 2 C is skew-symmetric.
        Echeandia and Wensing (2021). ``coriolis_torques`` gives the product alone, in half the operations.
        """
        from robodyn_cli.algorithms.composite import coriolis

        p = self._problem
        return self._function("C", ("q", "qd"), lambda: coriolis(p.rigid, p.q, p.v, p.X))(q, qd)["C"]

    def coriolis_torques(self, q: Any, qd: Any) -> Array:
        """Return C qd (T, nv) [N m or N], centrifugal and Coriolis terms, by one Newton-Euler pass."""
        return self._function("Cv", ("q", "qd"), lambda: self._problem.rigid_terms()["coriolis"])(q, qd)["Cv"]

    def gravity(self, q: Any) -> Array:
        """Return G (T, nv) [N m or N]: the torques that hold the weight of the bodies, the gradient of its energy."""
        return self._function("G", ("q",), lambda: self._problem.gravity_torques)(q)["G"]

    @once
    def inverse_dynamics(self) -> InverseDynamics:
        """Torques tau (T, nv) of samples (q, qd, qdd): M qdd + C qd + G less springs, friction and forces."""
        return InverseDynamics(self._problem)

    @once
    def forward_dynamics(self) -> ForwardDynamics | ConstrainedDynamics:
        """Accelerations qdd (T, nv) of samples (q, qd, tau), the inverse of ``inverse_dynamics``.

        Of a mechanism with loops those under the forces of the loops, which q and qd must satisfy.
        """
        if self._problem.model.closures:
            from robodyn_cli.works.functions.constrained import ConstrainedDynamics

            return ConstrainedDynamics(self._problem)

        return ForwardDynamics(self._problem)

    def inverse_dynamics_derivatives(self, q: Any, qd: Any, qdd: Any) -> TorqueDerivatives:
        """Return the exact derivatives of ``inverse_dynamics``: dq, dqd and dqdd = M, each (T, nv, nv).

        Where q-dot is not qd, dq is by steps along the joint's manifold, in the coordinates of qd: body axes. Coulomb
        friction counts as constant, also at rest.
        """
        from robodyn_cli.works.functions.derivatives import TorqueDerivatives, torque_derivatives

        function = self._function("dID", ("q", "qd", "qdd"), lambda: torque_derivatives(self._problem))
        return TorqueDerivatives(**function(q, qd, qdd))

    def forward_dynamics_derivatives(self, q: Any, qd: Any, tau: Any) -> AccelerationDerivatives:
        """Return the exact derivatives of ``forward_dynamics``: dq, dqd and dtau = M^-1, each (T, nv, nv).

        dqdd/dx = -M^-1 dtau/dx at qdd (Carpentier and Mansard 2018); otherwise as ``inverse_dynamics_derivatives``.
        With loops exact for changes that keep them closed, Psi dq = 0 and Psi dqd + d(Psi qd)/dq dq = 0; dtau is
        what the loops leave of M^-1.
        """
        if self._problem.model.closures:
            with self.lock:
                return cast("ConstrainedDynamics", self.forward_dynamics).derivatives(q, qd, tau)
        from robodyn_cli.works.functions.derivatives import AccelerationDerivatives, acceleration_derivatives

        function = self._function("dFD", ("q", "qd", "tau"), lambda: acceleration_derivatives(self._problem))
        return AccelerationDerivatives(**function(q, qd, tau))

    # -- parameters -------------------------------------------------------------------------------------
    @once
    def _regressor(self) -> Regressor:
        from robodyn_cli.works.functions.derivatives import Regressor

        return Regressor.of(self._problem)

    def regressor(self, q: Any, qd: Any, qdd: Any) -> Array:
        """Return Y (T, nv, P) with Y p = M qdd + C qd + G for the parameters p of ``inertial_parameters``.

        Columns in which no torque depends on its parameter are zero.
        """
        return self._function("Y", ("q", "qd", "qdd"), lambda: self._regressor.Y)(q, qd, qdd)["Y"]

    @once
    def inertial_parameters(self) -> InertialParameters:
        """The parameters (P,) of ``regressor`` by name, with the scene's values."""
        return self._regressor.parameters()

    # -- kinematics -------------------------------------------------------------------------------------
    def forward_kinematics(self, frame: str, q: Any) -> tuple[Array, Array]:
        """Return position (T, 3) [m] and rotation (T, 3, 3) of a frame in the world; columns are the frame's axes.

        frame : a named point or frame, a link, or a place such as ``LINK.end``.
        """
        from robodyn_cli.algorithms.kinematics import world_pose

        problem, place = self._place(frame)

        def entries() -> Any:
            pose = world_pose(problem.model, problem.pose, place)
            return {"p": pose.p, "R": pose.R}

        values = self._function(f"pose of {frame}", ("q",), entries, problem)(q)
        return values["p"], values["R"]

    def jacobian(self, frame: str, q: Any) -> Array:
        """Return J (T, 6, nv) of a frame: J qd is its twist in world axes.

        Rows 0 to 2 are its angular velocity [rad/s], rows 3 to 5 the velocity of its origin [m/s], as in
        ``frames/NAME/twist`` of a result. Siciliano et al. (2009), equation 3.30.

        frame : as of ``forward_kinematics``.
        """
        from robodyn_cli.works.functions.derivatives import frame_jacobian

        problem, place = self._place(frame)
        name = f"jacobian of {frame}"
        return self._function(name, ("q",), lambda: frame_jacobian(problem, place), problem)(q)[name]

    def inverse_kinematics(self, frame: str, **asked: Any) -> InverseKinematics:
        """Joint positions that bring a frame to poses; ``asked`` as of ``InverseKinematics``."""
        from robodyn_cli.given.poses.inverse_kinematics import InverseKinematics

        return InverseKinematics(self._source, frame, **asked)

    def centre_of_mass(self, q: Any) -> Array:
        """Return the centre of mass of all moving links (T, 3) [m], world coordinates."""
        from robodyn_cli.works.functions.derivatives import centre_of_mass

        return self._function("com", ("q",), lambda: centre_of_mass(self._problem))(q)["com"]

    def constraint_jacobian(self, q: Any) -> Array:
        """Return Psi (T, m, nv) of the loops and couplers: Psi qd = 0; (T, 0, nv) of an open chain."""

        def entries() -> Any:
            rows, nv = self._problem.constraints.loop_rows, self._problem.model.nv
            return np.array([row.psi for row in rows], dtype=object).reshape(len(rows), nv)

        return self._function("Psi", ("q",), entries)(q)["Psi"]
