"""How actuators and loops share a load; errors name joints and loops.

Inverse dynamics of mechanisms with loops: actuator torques and multipliers that a motion needs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from robodyn_cli.equations.gears import geared, losses_along
from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import Outputs
from robodyn_cli.errors import CapabilityError, SceneError, SingularConfigurationError, listed
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.given.guided_motion import guided_motion
from robodyn_cli.given.loop_conditions import Lead, lead_of, leads_apart, velocity_places
from robodyn_cli.given.motion import Planned, motion_duration
from robodyn_cli.loops.base import Row
from robodyn_cli.model.model import TORQUE
from robodyn_cli.observe.observe import add_rows
from robodyn_cli.observe.singular_values import singular_values
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import rank_tolerances
from robodyn_cli.solve.load_sharing import Hold, LostRank, Unbalanced, accelerations, share
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.torques.dynamics import StateFunction
from robodyn_cli.torques.program import AlongMotion, InverseProgram, LoopSamples, Sampled, expressions_of
from robodyn_cli.trajectories.led import led_joints
from robodyn_cli.trajectories.registry import trajectory_types

PASSIVE = (  # what goes where actuators cannot give a motion
    "a motion that the passive freedoms take by themselves, or simulate, with what is led in 'prescribed', where they "
    "move as their forces let them"
)
SHOWN = 1e-6  # of the largest load left, from which on a joint is told with it


def refuse_idle_gears(problem: Problem, driven: Sequence[int]) -> None:
    """Refuse gears with losses in joints without an actuator, on which nothing says what the gear passes on.

    Raises
    ------
    CapabilityError
    """
    for _, gear in geared(problem.model):
        if gear.v not in driven:
            raise CapabilityError(
                f"joint {gear.name!r} has a gear with losses but no actuator (`actuated`), so no load goes through the "
                "gear; allowed there: friction",
                joint=gear.name,
            )


@contextmanager
def telling(problem: Problem, driven: Sequence[int], times: Array, q: Array) -> Iterator[None]:
    """Tell what ``solve.load_sharing`` finds with names of joints and loops.

    Parameters
    ----------
    driven : velocity coordinates with an actuator. times, q : of the samples (T,), (T, nq).

    Raises
    ------
    CapabilityError : passive freedoms have a load. SingularConfigurationError : loops or actuators
    lose their hold at a sample.
    """
    try:
        yield
    except Unbalanced as lacking:
        when = f" at t = {float(times[lacking.sample]):.9g} s"
        raise unbalanced(problem, lacking, driven, PASSIVE, when) from None
    except LostRank as lost:
        raise lost_rank(problem, lost, times, q) from None


def unbalanced(
    problem: Problem, lacking: Unbalanced, driven: Sequence[int], allowed: str, when: str = ""
) -> CapabilityError:
    """Return the error of a load that passive freedoms do not let the actuators give, with what is left of it.

    allowed : what is, in words. when : it is, likewise.
    """
    model = problem.model
    worst = int(np.abs(lacking.left).argmax())
    size = np.abs(lacking.left) / np.abs(lacking.left).max()
    moved = list(dict.fromkeys(model.joint_of(int(k)) for k in np.flatnonzero(size > SHOWN)))
    names = ", ".join(dict.fromkeys(model.joint_of(k) for k in driven)) or "none"
    most = f"{abs(float(lacking.left[worst])):.6g} {TORQUE[model.v_units[worst]]} in joint {model.joint_of(worst)!r}"
    others = [name for name in moved if name != model.joint_of(worst)]
    return CapabilityError(
        f"the mechanism has {lacking.freedom} degrees of freedom, and its actuated joints ({names}) command "
        f"{lacking.commanded} of them: at best their torques leave {most}{when}"
        + (f" (a motion that moves {listed(others)} too)" if others else "")
        + f"; allowed: more joints in 'actuated', {allowed}",
        key="actuated", residual=abs(float(lacking.left[worst])), joint=model.joint_of(worst),
    )  # fmt: skip


def unbalanced_by_a_key(problem: Problem, lacking: Unbalanced, driven: Sequence[int]) -> CapabilityError:
    """Return the error of a derivative with respect to a key with which passive freedoms do not stay balanced."""
    return unbalanced(
        problem, lacking, driven, "or keys that leave the passive freedoms balanced", " for a change of 1"
    )


def lost_rank(problem: Problem, lost: LostRank, times: Array, q: Array) -> SingularConfigurationError:
    """Return the error of a sample at which loops or actuators lose their hold, with loop and joint."""
    time, where = float(times[lost.sample]), q[lost.sample].tolist()
    worst = int(np.argmax(lost.weights))
    if lost.what == "actuators":
        joint = problem.model.joint_of(worst)
        when = f"at t = {time:.9g} s"
        if lost.passed:
            when = f"between t = {time:.9g} s and {float(times[lost.sample + 1]):.9g} s"
        return SingularConfigurationError(
            f"dead point of the actuators {when}: joint {joint} moves without them, so no finite torques "
            "give it the acceleration asked for; actuate another joint, or more",
            time=time, kind="dead_point", joint=joint, q=where,
        )  # fmt: skip
    row = problem.constraints.loop_rows[worst]
    return SingularConfigurationError(
        f"bifurcation at t = {time:.9g} s: the rows of loop {row.closure} lose rank there ({row.name}), so the "
        "multipliers are not unique and the mechanism may go on in more than one way",
        time=time, kind="bifurcation", loop=row.closure, row=row.name, q=where,
    )  # fmt: skip


def _rounded(problem: Problem, eta: Array) -> float:
    """Return the ratio of singular values below which rows depend on each other that lack eta (T, m)."""
    return float(rank_tolerances(problem.model, np.abs(eta).max(initial=0.0)))


def build_closed(problem: Problem) -> ClosedLoops:
    """Return the program of a mechanism: its torques share the load with the multipliers of its loops.

        B tau + Psi^T lambda = M qdd + h - tau_passive - tau_friction

    The motion is that of the joints or of the point in ``trajectory``, or of prescribed joints; the loops decide
    about the other joints, at position, velocity and acceleration level.

    Raises
    ------
    SceneError : no motion, or no actuator. CapabilityError : a gear with losses that nothing drives.
    """
    scene = problem.scene
    lead = lead_of(problem)
    duration, actuated = _duration(scene), actuated_joints(problem, lead)
    refuse_idle_gears(problem, velocity_places(problem.model, actuated))
    rows = problem.constraints.loop_rows
    parts = expressions_of(problem)
    parts["others"] |= _loop_outputs(problem, rows)
    return ClosedLoops(problem, duration, **parts, lead=lead, actuated=actuated, rows=rows)


def _loop_outputs(problem: Problem, rows: tuple[Row, ...]) -> Outputs:
    return {
        "psi": [x for row in rows for x in row.psi],
        "gamma": [row.gamma for row in rows],
        "M": list(problem.mass_matrix.ravel()),
        "eta": [row.eta for row in rows],
        "eta_t": [row.eta_t for row in rows],
    }


class ClosedTorques:
    """The actuators' torques (T, nv) of q, qd and qdd (T, n); how a load is shared is kept while q is the same array.

    Gears with losses, and what depends on time, are left to others.
    """

    def __init__(self, program: ClosedLoops) -> None:
        problem = program.problem
        load = [sum(parts) for parts in zip(*program.terms.values())]
        self.load = StateFunction(problem, ("q", "qd", "qdd"), {"load": load})
        rows = {"psi": [list(row.psi) for row in program.rows], "eta": [row.eta for row in program.rows]}
        self.rows = StateFunction(problem, ("q",), rows)
        self.problem, self.driven = problem, velocity_places(problem.model, program.actuated)
        self.last: tuple[Array, Hold] | None = None

    def __call__(self, q: Array, qd: Array, qdd: Array) -> Array:
        if self.last is None or self.last[0] is not q:
            self.last = q, self.hold(q, np.zeros(len(q)))
        with telling(self.problem, self.driven, np.zeros(len(q)), q):
            return self.last[1].share({"load": self.load(q, qd, qdd)["load"]}).tau

    def hold(self, q: Array, times: Array) -> Hold:
        """Return how a load can be shared at q (T, nq); times (T,) : for messages.

        Raises
        ------
        SingularConfigurationError : loops or actuators lose their hold.
        """
        with telling(self.problem, self.driven, times, q):
            rows = self.rows(q)
            return Hold.of(rows["psi"], self.driven, _rounded(self.problem, rows["eta"]))


@record
class ClosedLoops(InverseProgram):
    """Inverse dynamics of a mechanism.

    Torques are zero in joints without an actuator; where there are more actuators than degrees of freedom they are
    of least norm, and so are multipliers of redundant rows.

    lead : the joints or the point that the trajectory leads. actuated : joints with an actuator. rows : those of the
    loops.
    """

    lead: Lead
    actuated: tuple[str, ...]
    rows: tuple[Row, ...]

    def plan(self, times: Array) -> Planned:
        guided = guided_motion(self.problem, self.lead, times)
        if guided.stopped is not None:
            raise guided.stopped
        return guided

    def evaluate(self, planned: Planned, function: AlongMotion) -> Sampled:
        motion, times = planned.motion, planned.times
        p = self.parameters(times)
        arrays = function.along(times, motion, p)
        psi = arrays["psi"].reshape(len(times), len(self.rows), self.problem.model.nv)
        driven = velocity_places(self.problem.model, self.actuated)
        with telling(self.problem, driven, times, motion.q):
            shared = share(psi, driven, self.loads(arrays), _rounded(self.problem, arrays["eta"]))
        terms = dict(shared.terms)
        if geared(self.problem.model):
            lost = self._losses(self.loads(arrays), shared.tau, motion.qdd, motion.qd)
            arrays["torque_terms/gear"] = terms["gear"] = -lost
            arrays["dissipation"] = arrays["dissipation"] + (lost * motion.qd).sum(axis=1)[:, None]
        # closures to a ground that moves do work at the rate -lambda eta_t
        work = (shared.multipliers * arrays["eta_t"]).sum(axis=1)[:, None]
        arrays["dissipation"] = arrays["dissipation"] - work
        loops = LoopSamples(psi, shared, planned.residuals, self.actuated, driven)
        return Sampled(times, motion, p, terms, arrays, planned.counters, loops)

    def _losses(self, loads: Mapping[str, Array], tau: Array, a: Array, v: Array) -> Array:
        """Return the torques (T, nv) of the losses of gears, with the actuators' torques tau if there were none."""
        friction = -loads["friction"] if "friction" in loads else np.zeros_like(tau)
        return losses_along(self.problem.model, tau, friction, a, v)

    @property
    def shared_by(self) -> list[Scalar]:
        return list(self.others["psi"])

    def shared(self, loads: Mapping[str, Array], by: Array, sampled: Sampled, places: Array) -> Array | None:
        assert sampled.loops is not None
        psi = by.reshape(len(by), len(self.rows), self.problem.model.nv)
        try:
            tau = share(psi, sampled.loops.driven, loads, sampled.loops.shared.tolerance).tau
        except (LostRank, Unbalanced):
            return None
        if not geared(self.problem.model):
            return tau
        again = np.resize(places, len(tau))
        motion = sampled.motion
        return tau - self._losses(loads, tau, motion.qdd[again], motion.qd[again])

    def forward(self, sampled: Sampled, numbers: ManyNumbers | None = None) -> tuple[Array, Array]:
        # solves for the free motion with M and h, which the torques did not use
        assert sampled.loops is not None
        psi, arrays = sampled.loops.psi, sampled.arrays
        nv = psi.shape[2]
        M, bias = arrays["M"].reshape(-1, nv, nv), arrays["bias"]
        tolerance = sampled.loops.shared.tolerance
        qdd = accelerations(M, sampled.applied - bias, psi, arrays["gamma"], tolerance)
        return qdd, accelerations(M, -bias, psi, 0.0 * arrays["gamma"], tolerance)

    def row_multipliers(self, sampled: Sampled) -> Array:
        # those of prescribed joints are torques of their actuators here
        assert sampled.loops is not None
        out = np.zeros((len(sampled.times), len(self.problem.constraints.rows)))
        out[:, self.problem.constraints.of_loops] = sampled.loops.shared.multipliers
        return out

    def add_loops(self, result: Result, sampled: Sampled) -> None:
        assert sampled.loops is not None
        psi, arrays = sampled.loops.psi, sampled.arrays
        velocity = np.einsum("tmv,tv->tm", psi, sampled.motion.qd) + arrays["eta_t"]
        columns = {
            "constraints/multipliers": sampled.loops.shared.multipliers,
            "constraints/position_residual": arrays["eta"],
            "constraints/velocity_residual": velocity,
        }
        add_rows(result, self.rows, columns, not sampled.loops.shared.unique_multipliers)
        for path, data in singular_values(psi).items():
            result.add(path, data)


def _duration(scene: Scene) -> float:
    """Return the length of the motion.

    Raises
    ------
    SceneError : nothing moves.
    """
    if scene.trajectory is not None or scene.prescribed:
        return motion_duration(scene)
    raise SceneError(
        f"key 'trajectory' is missing: inverse dynamics needs a motion, of as many joints as the "
        f"mechanism has degrees of freedom, or of a point or frame (kinds: {', '.join(trajectory_types)}); "
        "or prescribe joints",
        (scene.path,),
        key="trajectory",
    )


def actuated_joints(problem: Problem, lead: Lead) -> tuple[str, ...]:
    """Return the joints that have an actuator: ``actuated``, else those that are led or have torques.

    Where a point is led by joints that no loop ties: all but the joint that each coupler names first, its follower.

    Raises
    ------
    SceneError : a point is led and 'actuated' is missing.
    """
    scene = problem.scene
    if scene.actuated is not None:
        return scene.actuated
    if leads_apart(problem) and not scene.loops:
        followers = {next(iter(coupler.terms)) for coupler in (*scene.couplers, *scene.robot.couplers)}
        return tuple(name for name in problem.model.joint_names if name not in followers)
    led = (*lead.joints, *led_joints(scene.prescribed))
    joints = tuple(dict.fromkeys(led if led else scene.torques))
    if not joints:
        raise SceneError(
            "a point is led, so the scene must say which joints drive the mechanism: key 'actuated'",
            (scene.path,),
            key="actuated",
        )
    return joints
