"""Accelerations of a mechanism with loops in other engines, each as fast as it goes from Python on one thread.

MuJoCo and Drake keep their own settings: equalities of the one are soft, a step of the other is as long as in its
tutorials. Exudyn has the bodies in redundant coordinates; what is timed is its solution for initial accelerations.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np

from peers import exudyn_loops
from robodyn_cli.errors import CapabilityError
from robodyn_cli.model.model import FixedFrame
from robodyn_cli.over.crosscheck.drake import OwnDrake
from robodyn_cli.over.crosscheck.engine import directions, translate
from robodyn_cli.over.crosscheck.engines import InPinocchio
from robodyn_cli.over.crosscheck.own_engines import OwnMujoco
from robodyn_cli.over.crosscheck.own_settings import with_masses
from robodyn_cli.ready.singularity import rank_tolerance
from robodyn_cli.solve.closure import ROUNDED

PROXIMAL = (1e-14, 1e-8, 50)  # accuracy, mu and rounds of Pinocchio's solver
ALLOWED, DIGITS = 1e-9, 1e-14  # of the largest acceleration, times the condition
BUILT = 4  # states for which Exudyn's bodies are placed


class Given:
    """A mechanism and states for other engines: q (T, nq), v (T, nv) and torques tau (T, nv).

    exact : accelerations (T, nv) by the null space of the rows, with Pinocchio's M, h and Jacobians. condition (T,) :
    of M along the motions that the rows leave. allowed (T,) : errors, of the largest acceleration at a state.
    """

    def __init__(self, scene: Any, problem: Any, q: Any, v: Any, tau: Any) -> None:
        self.translated = translate(scene, True)
        self.light = translate(with_masses(scene, self.translated.model)[0], True)
        handed = self.translated.evaluator(smooth=True)
        given = [{"t": [0.0], "q": a.tolist(), "v": b.tolist(), "p": []} for a, b in zip(q, v)]
        self.problem, self.q, self.v = problem, q, v
        self.tau = tau + np.array([handed(x) for x in given], dtype=float)
        plain = np.array([self.translated.plain(a, b) for a, b in zip(q, v)])
        self.all_torques = self.tau + plain
        self.peer = InPinocchio(self.translated.model)
        self.loops, self.couplers = self.translated.model.loops, self.translated.couplers
        self.tolerance = [rank_tolerance(problem, x) for x in q]
        self.exact = np.array([self.accelerations(k, self.all_torques[k]) for k in range(len(q))])
        self.condition, self.allowed = np.array([self._condition(k) for k in range(len(q))]).T

    def accelerations(self, k: int, tau: Any) -> Any:
        """Return the exact accelerations (nv,) at a state under torques."""
        state = (self.q[k], self.v[k], tau)
        return self.peer.accelerations(state, self.loops, self.couplers, self.tolerance[k])

    def _condition(self, k: int) -> tuple[float, float]:
        q = self.q[k]
        rows = [*(self.peer._rows(loop, q, self.v[k])[0] for loop in self.loops), self.couplers]
        _, s, Vt = np.linalg.svd(np.concatenate(rows))
        rank = int((s > self.tolerance[k] * s.max(initial=0.0)).sum())
        free = Vt[rank:]
        condition = float(np.linalg.cond(free @ self.peer.mass_matrix(q) @ free.T)) if len(free) else 1.0
        allowed = max(ALLOWED, DIGITS * condition)
        # rows that contradict each other by rounding in the file give as many answers as there are choices of rows
        return condition, max(allowed, ROUNDED * s[0] / s[rank - 1]) if self.tolerance[
            k
        ] == ROUNDED else allowed


class PeerDynamics:
    """What a peer answers.

    error (T,) : of its accelerations, of the largest at each state. evaluate : all of ``count`` states, to be timed.
    """

    def __init__(self, apart: Any, exact: Any, count: int, evaluate: Callable[[], Any]) -> None:
        self.error = np.abs(apart).max(axis=1) / np.abs(exact[: len(apart)]).max(axis=1)
        self.count, self.evaluate = count, evaluate


def pinocchio(given: Given, timed: int, samples: int) -> PeerDynamics:
    """``constraintDynamics`` with the closures as constraints, state by state: there is no call for many.

    Raises
    ------
    CapabilityError : a closure is neither a point nor a pose, or there are couplers.
    """
    pin, peer = importlib.import_module("pinocchio"), given.peer
    if len(given.couplers):
        raise CapabilityError("Pinocchio has no couplers")
    models = pin.StdVec_RigidConstraintModel()
    for loop in given.loops:
        free = directions(loop).shape[1]
        if {f"{loop.name}.axis1", f"{loop.name}.axis2"} <= set(given.problem.constraints.dropped):
            free = 0  # in a planar mechanism the rows of the axis vanish
        if free not in (0, 3):
            raise CapabilityError(f"Pinocchio has no closure {loop.element.type}")
        kind = pin.ContactType.CONTACT_6D if free else pin.ContactType.CONTACT_3D
        places = [
            (peer.joint[frame.body], pin.SE3(np.array(frame.R, float), np.array(frame.p, float)))
            for frame in (loop.first, loop.second)
        ]
        models.append(pin.RigidConstraintModel(kind, peer.model, *places[0], *places[1], pin.LOCAL))
    datas = pin.StdVec_RigidConstraintData()
    datas.extend(model.createData() for model in models)
    pin.initConstraintDynamics(peer.model, peer.data, models, datas)
    settings = pin.ProximalSettings(*PROXIMAL)
    states = [peer._to(*x) for x in zip(given.q, given.v, given.all_torques)]

    def one(q: Any, v: Any, tau: Any) -> Any:
        return pin.constraintDynamics(peer.model, peer.data, q, v, tau, models, datas, settings)

    def loop_over() -> None:
        for state in states[:timed]:
            one(*state)

    a = np.array([peer.in_our_order(np.array(one(*x))) for x in states])
    return PeerDynamics(a - given.exact, given.exact, timed, loop_over)


def mujoco(given: Given, timed: int, samples: int) -> PeerDynamics:
    """``mj_forward``; timed are single steps of Euler's method from each state, in C by ``rollout``."""
    rollout = importlib.import_module("mujoco.rollout")
    peer = OwnMujoco(given.light, None)
    mj, model, data = peer.mj, peer.model, peer.data
    mj.set_mju_user_warning(lambda text: None)  # or a file of warnings would be written
    model.opt.disableflags |= int(mj.mjtDisableBit.mjDSBL_EULERDAMP)  # no second factors in the step
    full, force = mj.mjtState.mjSTATE_FULLPHYSICS, mj.mjtState.mjSTATE_QFRC_APPLIED
    states, forces, answers = [], [], []
    for q, v, tau in zip(given.q, given.v, given.tau):
        mj.mj_resetData(model, data)
        answers.append(peer.free_accelerations(q, v, tau))
        for kind, into in ((full, states), (force, forces)):
            into.append(np.zeros(mj.mj_stateSize(model, kind)))
            mj.mj_getState(model, data, into[-1], kind)
    times = -(-samples // timed)
    start, control = (np.tile(x[:timed], (times, 1))[:samples] for x in (states, forces))

    def steps() -> None:
        rollout.rollout(model, data, start, control[:, None], control_spec=int(force), nstep=1)

    return PeerDynamics(np.array(answers) - given.exact, given.exact, samples, steps)


def drake(given: Given, timed: int, samples: int) -> PeerDynamics:
    """A step of the discrete plant from each state, and the change of the velocities in it."""
    peer = OwnDrake(given.light, None)
    states, answers = [], []
    force = peer.plant.get_applied_generalized_force_input_port()
    for q, v, tau in zip(given.q, given.v, given.tau):
        peer.start(q, v)
        T = peer._turn(q)
        both = peer.plant.GetPositionsAndVelocities(peer.context)
        states.append((both, (T @ tau)[peer.v_places]))
        answers.append(peer.advance(tau)[2])

    def steps() -> None:
        for both, tau in states[:timed]:
            peer.plant.SetPositionsAndVelocities(peer.context, both)
            force.FixValue(peer.context, tau)
            peer.plant.EvalUniquePeriodicDiscreteUpdate(peer.context)

    return PeerDynamics(np.array(answers) - given.exact, given.exact, timed, steps)


def exudyn(given: Given, timed: int, samples: int) -> PeerDynamics:
    """The solver's initial accelerations, compared at the centres of mass; without torques in joints.

    Raises
    ------
    CapabilityError : a joint, closure or force that the translation does not know.
    """
    exu = importlib.import_module("exudyn")
    exu.SuppressWarnings(True)
    exu.SetWriteToConsole(False)
    if len(given.couplers):
        raise CapabilityError("couplers are not built in Exudyn")
    settings = importlib.import_module("peers.exudyn")._settings(exu, 1.0, 1000)
    answers, exact, kept = [], [], []
    for q, v in list(zip(given.q, given.v))[:BUILT]:
        bodies = exudyn_loops.Mechanism(given.problem, q, v)
        try:
            container, system, _ = exudyn_loops.build(bodies, None)
        except exudyn_loops.Unsupported as error:
            raise CapabilityError(str(error)) from None
        system.Assemble()
        solver = exu.MainSolverImplicitSecondOrder()
        begun = solver.InitializeSolver(system, settings)
        a = np.array(system.systemData.GetODE2Coordinates_tt(exu.ConfigurationType.Current))
        if not begun or not a.any():  # it goes on with zeros where its Jacobian is singular
            raise CapabilityError("the Jacobian is singular")
        kept.append((container, system, solver))
        answers.append(a.reshape(len(bodies.mass), -1)[:, :3].ravel())
        qdd = given.accelerations(len(exact), given.translated.plain(q, v))
        places = (given.peer.place(q, v, FixedFrame(k, c, np.eye(3))) for k, c in enumerate(bodies.centre))
        exact.append(np.concatenate([place.J[3:] @ qdd + place.a[3:] for place in places]))
    _, system, solver = kept[0]

    def initial() -> None:
        solver.InitializeSolverInitialConditions(system, settings)

    return PeerDynamics(np.array(answers) - np.array(exact), np.array(exact), 1, initial)


PEERS: dict[str, Callable[[Given, int, int], PeerDynamics]] = {
    "pinocchio": pinocchio,
    "mujoco": mujoco,
    "pydrake": drake,
    "exudyn": exudyn,
}
