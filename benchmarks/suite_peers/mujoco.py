"""A case in MuJoCo: loops by equalities, dry friction by ``frictionloss``, rigid stops by joint limits.

All three are soft constraints there. They are made as hard as the step allows: impedance close to 1, and time constants
of two steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from suite_peers.case import Clock, Mechanism, Run
from tests.engines import real, to_mujoco

INTEGRATORS = (
    ("Euler", "mjINT_EULER"),
    ("implicitfast", "mjINT_IMPLICITFAST"),
    ("RK4", "mjINT_RK4"),
)
STEP = 2e-3  # the engine's default
HARD = [0.9999, 0.9999, 1e-3, 0.5, 2.0]  # impedance; the default of 0.9 to 0.95 gives way
CONTACT = 8.0  # steps that an impact lasts


def damping_ratio(restitution: float) -> float:
    """Return the damping ratio of a spring and damper that never pull, for a restitution (Schwager, Poeschel 2007)."""

    def rebound(z: float) -> float:
        w = np.sqrt(1.0 - z * z)
        turn = np.arctan2(2.0 * z * w, 1.0 - 2.0 * z * z)
        return float(np.exp(-z / w * (np.pi - turn)))

    low, high = 0.0, 0.999
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rebound(middle) > restitution else (low, middle)
    return low


def build(case: Mechanism, step: float) -> tuple[Any, Any, np.ndarray]:
    """Return model, data and the places of our coordinates in MuJoCo's."""
    import mujoco

    plain = to_mujoco(case.model)
    spec = mujoco.MjSpec.from_string(plain.text)
    for loop in case.model.loops:
        names = []
        for side, frame in (("first", loop.first), ("second", loop.second)):
            body = spec.worldbody if frame.body < 0 else spec.body(f"body{frame.body}")
            names.append(f"{loop.name} {side}")
            body.add_site(name=names[-1], pos=real(frame.p))
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_CONNECT, objtype=mujoco.mjtObj.mjOBJ_SITE, name1=names[0], name2=names[1],
            solref=[2.0 * step, 1.0], solimp=HARD,
        )  # fmt: skip
    for body in case.model.bodies:
        joint, stop = spec.joint(body.joint_name), case.stops[body.v]
        if case.coulomb[body.v]:
            joint.frictionloss = case.coulomb[body.v]
            joint.solref_friction, joint.solimp_friction = [2.0 * step, 1.0], HARD
        if stop is not None:
            lower, upper, restitution = stop
            joint.limited, joint.range = True, [lower, upper]
            z, w = damping_ratio(restitution), np.pi / (CONTACT * step)
            # the direct form: stiffness and damping per unit of inertia
            joint.solref_limit, joint.solimp_limit = [-(w**2), -2.0 * z * w], HARD
    model = spec.compile()
    model.jnt_stiffness[plain.index], model.dof_damping[plain.index] = case.k, case.c
    model.qpos_spring[plain.index] = case.rest
    return model, mujoco.MjData(model), plain.index


def runs(case: Mechanism) -> Iterator[tuple[str, Run]]:
    """Yield the engine's integrators at its default step, or a thousandth of the duration."""
    import mujoco

    for name, kind in INTEGRATORS:

        def run(times: np.ndarray, kind: str = kind) -> np.ndarray:
            step = min(STEP, times[-1] / 1000.0)
            each = int(np.ceil(times[1] / step))
            model, data, index = build(case, times[1] / each)
            model.opt.integrator = getattr(mujoco.mjtIntegrator, kind)
            model.opt.timestep = times[1] / each
            data.qpos[index], data.qvel[index] = case.q, case.v
            rows, clock = [], Clock()
            for k in range(len(times)):
                rows.append(np.concatenate([data.qpos[index], data.qvel[index]]))
                if k + 1 == len(times):
                    break
                for _ in range(each):
                    if case.stiffening is not None:
                        stiffness, rest, damping, torque = case.stiffening(data.time)
                        model.jnt_stiffness[index], model.qpos_spring[index] = stiffness, rest
                        model.dof_damping[index], data.qfrc_applied[index] = damping, torque
                    elif not case.plain:
                        q, v = data.qpos[index], data.qvel[index]
                        data.qfrc_applied[index] = case.torques(data.time, q, v) - case.passive(q, v)
                    mujoco.mj_step(model, data)
                clock.check()
            return np.array(rows)

        yield f"MuJoCo {name}", run
