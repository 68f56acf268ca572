"""Drake: a continuous ``MultibodyPlant`` with its integrators, discrete (SAP) where loops are closed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import arms
import numpy as np
from cases import Chain, Entry, FourBar

from peers.mujoco import aligned


def chain_plant(case: Chain) -> Any:
    from pydrake.math import RigidTransform, RotationMatrix
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import (
        FixedOffsetFrame,
        RevoluteJoint,
        RevoluteSpring,
        RotationalInertia,
        SpatialInertia,
    )

    arm = case.arm
    plant = MultibodyPlant(0.0)
    plant.mutable_gravity_field().set_gravity_vector(arm.gravity)
    parent = plant.world_body()
    for k in range(case.n):
        I = arm.inertia[k]
        about = RotationalInertia(I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
        inertia = SpatialInertia.MakeFromCentralInertia(arm.mass[k], arm.com[k], about)
        body = plant.AddRigidBody(f"body{k}", inertia)
        turn, place = arms.placement(arm, k)
        offset = RigidTransform(RotationMatrix(turn), place)
        frame = plant.AddFrame(FixedOffsetFrame(f"frame{k}", parent.body_frame(), offset))
        joint = plant.AddJoint(RevoluteJoint(f"q{k}", frame, body.body_frame(), [0, 0, 1], damping=case.c[k]))
        if case.k[k]:
            plant.AddForceElement(RevoluteSpring(joint, 0.0, case.k[k]))
        parent = body
    plant.Finalize()
    return plant


def entries(case: Any) -> Iterator[Entry]:
    from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

    if isinstance(case, FourBar):
        yield from _to_lock(case)
        return
    plant = chain_plant(case)
    if case.stiff:
        jobs = [("radau3", a) for a in (1e-3, 1e-6)]
        jobs += [("runge_kutta3", a) for a in (1e-3,) if case.key == "stiff"]
    else:
        jobs = [("runge_kutta3", a) for a in (1e-3, 1e-6)] + [
            ("runge_kutta5", a) for a in (1e-6, 1e-9, 1e-12)
        ]
    for scheme, accuracy in jobs:

        def simulator(scheme: str = scheme, accuracy: float = accuracy) -> tuple[Any, Any, Any]:
            simulator = Simulator(plant)
            context = simulator.get_mutable_context()
            ResetIntegratorFromFlags(simulator, scheme, 0.1)
            integrator = simulator.get_mutable_integrator()
            integrator.set_target_accuracy(accuracy)
            plant.SetPositions(context, case.start)
            plant.SetVelocities(context, np.zeros(case.n))
            simulator.Initialize()
            return simulator, context, integrator

        def state(context: Any) -> np.ndarray:
            return np.concatenate([plant.GetPositions(context), plant.GetVelocities(context)])

        def run(make: Any = simulator) -> tuple[np.ndarray, int]:
            simulator, context, integrator = make()
            simulator.AdvanceTo(case.duration)
            return state(context), integrator.get_num_steps_taken()

        def path(make: Any = simulator) -> tuple[np.ndarray, np.ndarray]:
            simulator, context, _ = make()
            found = []
            for t in case.times:
                simulator.AdvanceTo(t)
                found.append(state(context))
            return case.times, np.array(found)

        yield Entry(f"Drake {scheme}", f"accuracy {accuracy:.0e}", run, path if case.whole else None)


def _to_lock(case: FourBar) -> Iterator[Entry]:
    """The ball constraint exists for discrete plants only."""
    from pydrake.math import RigidTransform
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import (
        FixedOffsetFrame,
        RevoluteJoint,
        RevoluteSpring,
        RotationalInertia,
        SpatialInertia,
    )
    from pydrake.systems.analysis import Simulator

    l0, l1, l2, l3 = case.lengths
    for step in (1e-2, 1e-3):
        plant = MultibodyPlant(step)
        plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
        bodies = [
            plant.AddRigidBody(
                f"body{k}",
                SpatialInertia.MakeFromCentralInertia(
                    case.mass[k], [case.com[k], 0, 0], RotationalInertia(*[case.inertia[k]] * 3)
                ),
            )
            for k in range(3)
        ]
        world = plant.world_body()
        joints = []
        for k, (parent, x) in enumerate(((world, 0.0), (bodies[0], l1), (world, l0))):
            offset = RigidTransform([x, 0, 0])
            frame = plant.AddFrame(FixedOffsetFrame(f"frame{k}", parent.body_frame(), offset))
            joints.append(plant.AddJoint(RevoluteJoint(f"q{k}", frame, bodies[k].body_frame(), [0, 0, 1])))
        plant.AddForceElement(RevoluteSpring(joints[0], 0.0, case.torque[1]))
        plant.AddJointActuator("crank", joints[0])
        plant.AddBallConstraint(bodies[1], [l2, 0, 0], bodies[2], [l3, 0, 0])
        plant.Finalize()
        angles = case.angles
        first = [angles[0], angles[1] - angles[0], angles[2]]
        count = round(12.4 / step)

        def run(
            plant: Any = plant, first: Any = first, step: float = step, count: int = count
        ) -> tuple[float, int]:
            simulator = Simulator(plant)
            context = simulator.get_mutable_context()
            plant.get_actuation_input_port().FixValue(context, [case.torque[0]])
            plant.SetPositions(context, first)
            simulator.Initialize()
            path = np.zeros((count, 3))
            for k in range(count):
                simulator.AdvanceTo((k + 1) * step)
                path[k] = plant.GetPositions(context)
            times = step * np.arange(1, count + 1)
            return aligned(times, path[:, 0] + path[:, 1] - path[:, 2]), count

        yield Entry("Drake SAP, ball", f"step {step:g}", run)
