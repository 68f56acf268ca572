"""The loop of a controller and its mechanism about a pose: plant, also sampled, and law, opened at the torques."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from robodyn_cli.control.lqr import reached
from robodyn_cli.control.riccati import ROUNDED, disturbed
from robodyn_cli.equations.control.linear import AtLimits, LinearLaw, Unlimited, linear_law, without_bounds
from robodyn_cli.equations.linear.poles import poles_of
from robodyn_cli.equations.linear.reduce import Linear, held_by, linearise_states
from robodyn_cli.equations.linear.residuals import Residuals, States
from robodyn_cli.equations.problem import Problem
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.record import record
from robodyn_cli.scene.types import Ready, Scene
from robodyn_cli.solve.closure import rank
from robodyn_cli.solve.independent_rows import RANK_TOLERANCE
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.works.loops.pose import holding
from robodyn_cli.works.loops.systems import StateSpace, sampled, sampled_apart

OFF = 1e-9  # of the torques that hold a pose: rounding
BLIND = 1e-8  # a mode this weakly reached or shown, relative, is none of the loop


@record
class Standing:
    """How a law holds a pose: torques by joint that it gives there less what holds it, as far as it does not; the
    torque at the limit of joints whose limit cuts what it asks for."""

    left: dict[str, float]
    saturated: dict[str, float]


@record
class ControlLoop:
    """A loop that is opened at the torques of its joints: u in, what the law gives for it, with the sign turned, out.

    names : of its states. law : about the pose. neighbours : loops that are apart by as much as rounding may be.
    poles, errors : of the closed loop, in 1/s, or of a sampled one per sample. later : of a sampled loop the one opened
    at an input that comes later by less than a period [s], and its neighbours.
    """

    joints: tuple[str, ...]
    names: tuple[str, ...]
    law: LinearLaw
    system: StateSpace
    neighbours: tuple[StateSpace, ...]
    poles: Array
    errors: Array
    standing: Standing
    later: Callable[[int, float], Iterator[StateSpace]]

    @property
    def stability(self) -> str:
        """``stable``, ``unstable``, ``marginal``: a mode of the loop neither decays nor grows; ``saturated``: there the
        limits cut what the law asks for, so that it does not act on what moves."""
        if self.standing.saturated:
            return "saturated"
        sampled_ = self.system.period is not None
        beyond = np.abs(self.poles) - 1.0 if sampled_ else self.poles.real
        if (beyond > self.errors).any():
            return "unstable"
        A = self.system.A - self.system.B @ self.system.C
        near = self.poles[np.abs(beyond) <= self.errors]
        own = (
            s for s in near if reached(A, self.system.B, s, BLIND) and reached(A.T, self.system.C.T, s, BLIND)
        )
        return "stable" if next(own, None) is None else "marginal"


def loop_of(
    scene: Scene, equations: Residuals, states: States, places: tuple[int, ...], about: str
) -> ControlLoop:
    """Return the loop of a scene's controller, made ready, about a state of the equations of its mechanism.

    about : what state that is; only that at the start has not the torques that hold it.

    Raises
    ------
    RobodynError : the controller cannot be made ready there.
    """
    plant: Any = equations.problem
    model = plant.model
    held = holding(scene, dict(zip(model.q_names, states.q[0].tolist())))
    ready = Ready(without_bounds(integrable(held)))
    keep = _independent(equations, states) if plant.dependent else plant.keep_rows
    problem = Problem(ready, keep_rows=keep, braces=plant.braces)
    control = Unlimited(problem)
    linear = linearise_states(equations, states, control.places, places)
    still = held_by(equations, states, control.places, places)[0] if about == "state" else states
    needed = still.tau[0][control.places]
    law = linear_law(control, states, linear, needed)
    names = [model.v_names[k] for k in places]
    standing = _standing(control, law.torques, needed, linear.dq[0][control.places])
    if standing.saturated:
        law = linear_law(AtLimits(problem, standing.saturated), states, linear, needed)
    return assembled_loop(control, law, linear, [*names, *(f"qd.{name}" for name in names)], standing)


def _standing(control: Unlimited, asked: Array, needed: Array, ways: Array) -> Standing:
    """Return how torques (n,) that a law asks for hold a pose; needed (n,) : what does. ways (n, f) : motions of its
    joints by the freedoms."""
    given, saturated = asked.copy(), {}
    for k, most in enumerate(control.bounds):
        if most is not None and not most[0] < asked[k] < most[1]:
            given[k] = np.clip(asked[k], *most)
            saturated[control.joints[k]] = float(given[k])
    off = given - needed
    scale = OFF * max(1.0, float(np.abs(needed).max(initial=0.0)))
    if np.abs(ways.T @ off).max(initial=0.0) <= scale * max(1.0, float(np.abs(ways).max(initial=0.0))):
        return Standing({}, saturated)
    left = {name: float(x) for name, x in zip(control.joints, off) if abs(x) > scale}
    return Standing(left, saturated)


def _independent(equations: Residuals, states: States) -> list[int]:
    """Return rows of the loops that imply the others at a state."""
    from scipy.linalg import qr

    psi = equations.values(states)["Psi"][0]
    order = qr(psi.T, mode="r", pivoting=True)[1]
    return sorted(order[: rank(psi, RANK_TOLERANCE)].tolist())


def assembled_loop(
    control: Unlimited, law: LinearLaw, linear: Linear, names: Sequence[str], standing: Standing
) -> ControlLoop:
    """Return the loop of a plant and a law."""
    A, B = linear.A[0], linear.B[0]
    apart = list(zip([(A, B), *disturbed(A, B, linear.rounding[0])], [law, *_neighbours(law)]))
    systems = [_opened(control, a, b, near) for (a, b), near in apart]

    def later(k: int, delay: float) -> Iterator[StateSpace]:
        return (_opened(control, a, b, near, (k, delay)).closed(but=k) for (a, b), near in apart)

    system, *others = systems
    closed = [one.A - one.B @ one.C for one in systems]
    rounding = np.max([np.abs(x - closed[0]) for x in closed[1:]], axis=0)
    poles, errors = poles_of(closed[0], rounding)
    delayed = control.whole + (control.rest > 0.0) if control.period is not None else 0
    waiting = [f"delayed{k + 1}.{name}" for k in range(delayed) for name in control.joints]
    return ControlLoop(
        control.joints,
        (*names, *waiting, *law.names),
        law,
        system,
        tuple(others),
        poles,
        errors,
        standing,
        later,
    )


def _neighbours(law: LinearLaw) -> list[LinearLaw]:
    random = np.random.default_rng(1)

    def off(x: Array) -> Array:
        moved: Array = x * (1.0 + ROUNDED * random.choice([-1.0, 1.0], x.shape))
        return moved

    return [
        dataclasses.replace(law, K=off(law.K), H=off(law.H), S=off(law.S), Z=off(law.Z)) for _ in range(4)
    ]


def _opened(
    control: Unlimited, A: Array, B: Array, law: LinearLaw, more: tuple[int, float] | None = None
) -> StateSpace:
    """Return L: states of the plant, torques on their way, states of the law.

    more : an input, and by how much less than a period [s] it comes later than the others.
    """
    n, s = len(A), len(law.Z)
    if control.period is None:
        full, given = A, B
    elif more is not None:
        late = [(control.whole, float(control.rest))] * B.shape[1]
        carry, rest = divmod(float(control.rest) + more[1], float(control.period))
        late[more[0]] = (control.whole + int(carry), rest)
        full, given = sampled_apart(A, B, float(control.period), late)
    else:
        full, given = sampled(A, B, float(control.period), control.whole, float(control.rest))
    size = len(full)
    whole = np.zeros((size + s, size + s))
    whole[:size, :size] = full
    whole[size:, :n], whole[size:, size:] = law.S, law.Z
    C = np.zeros((len(law.K), size + s))
    C[:, :n], C[:, size:] = law.K, law.H
    period = None if control.period is None else float(control.period)
    return StateSpace(
        whole, np.concatenate([given, np.zeros((s, given.shape[1]))]), C, np.zeros((len(C), len(C))), period
    )
