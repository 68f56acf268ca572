"""A plane mechanism with loops in Exudyn: bodies in redundant coordinates, a joint object for each joint and loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import poses, transforms
from suite_peers.case import Mechanism, Refused
from tests.engines import mass_properties, real


def build(case: Mechanism, step: float) -> tuple[Any, Callable[[], np.ndarray]]:
    """Return the system, and what reads its states (T, 2 nv) in our order; the bodies start at rest."""
    import exudyn as exu
    from exudyn import itemInterface as items

    model = case.model
    if (
        any(body.joint.type != "revolute" for body in model.bodies)
        or np.any(real(model.gravity))
        or np.any(case.v)
    ):
        raise Refused("no plane model")
    pose = poses(model, transforms(model, case.q))
    system = exu.SystemContainer().AddSystem()
    ground = system.AddObject(items.ObjectGround())
    fixed = _coordinate(system, system.AddNode(items.NodePointGround()), 0)
    nodes: list[int] = []
    bodies: list[int] = []
    centres: list[np.ndarray] = []
    angles = absolute(case, case.q)
    for k, body in enumerate(model.bodies):
        m, c, I = mass_properties(body)
        centres.append(c)
        place = [*real(pose[k].point(c))[:2], angles[k]]
        nodes.append(system.AddNode(items.NodeRigidBody2D(referenceCoordinates=place)))
        rigid = items.ObjectRigidBody2D(physicsMass=m, physicsInertia=I[2, 2], nodeNumber=nodes[k])
        bodies.append(system.AddObject(rigid))

    def pin(ends: list[tuple[int, np.ndarray]]) -> None:
        markers = [
            system.AddMarker(
                items.MarkerBodyPosition(
                    bodyNumber=ground if k < 0 else bodies[k],
                    localPosition=list(p if k < 0 else p - centres[k]),
                )
            )
            for k, p in ends
        ]
        system.AddObject(items.ObjectJointRevolute2D(markerNumbers=markers))

    for k, body in enumerate(model.bodies):
        pin([(body.parent, real(body.X_tree.r)), (k, np.zeros(3))])
        _torque(case, system, k, nodes, fixed)
    for loop in model.loops:
        pin([(frame.body, real(frame.p)) for frame in (loop.first, loop.second)])
    outputs = exu.OutputVariableType
    sensors = [
        [
            system.AddSensor(items.SensorNode(nodeNumber=node, storeInternal=True, outputVariableType=kind))
            for node in nodes
        ]
        for kind in (outputs.Coordinates, outputs.Coordinates_t)
    ]

    def read() -> np.ndarray:
        found = []
        for start, group in zip((angles, np.zeros(len(nodes))), sensors):
            turned = np.stack([system.GetSensorStoredData(s)[:, 3] for s in group], axis=1) + start
            joints = np.empty_like(turned)
            for k, body in enumerate(model.bodies):
                joints[:, body.v] = turned[:, k] - (turned[:, body.parent] if body.parent >= 0 else 0.0)
            found.append(joints)
        return np.concatenate(found, axis=1)

    return system, read


def absolute(case: Mechanism, q: np.ndarray) -> np.ndarray:
    """Return the angles of the bodies from the x axis of the base (bodies,)."""
    found: list[float] = []
    for body in case.model.bodies:
        found.append(q[body.v] + (found[body.parent] if body.parent >= 0 else 0.0))
    return np.array(found)


def _coordinate(system: Any, node: int, coordinate: int) -> int:
    from exudyn import itemInterface as items

    return int(system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=coordinate)))


def _torque(case: Mechanism, system: Any, k: int, nodes: list[int], fixed: int) -> None:
    """Add the torque in a joint, which in these scenes depends on the joint's own angle and rate alone."""
    from exudyn import itemInterface as items

    body = case.model.bodies[k]
    if body.joint_name not in case.scene.torques:
        return
    j = body.v

    def force(mbs: Any, t: float, item: int, turned: float, rate: float, *rest: float) -> float:
        q, v = np.zeros_like(case.q), np.zeros_like(case.v)
        q[j], v[j] = case.q[j] + turned, rate
        return -float(case.torques(t, q, v)[j])

    before = fixed if body.parent < 0 else _coordinate(system, nodes[body.parent], 2)
    system.AddObject(
        items.ObjectConnectorCoordinateSpringDamper(
            markerNumbers=[before, _coordinate(system, nodes[k], 2)], springForceUserFunction=force
        )
    )
