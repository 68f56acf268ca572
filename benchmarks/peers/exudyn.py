"""Exudyn: trees in minimal coordinates (``ObjectKinematicTree``), the four-bar as plane bodies with joints."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import arms
import numpy as np
from cases import Chain, Entry, FourBar

from peers.mujoco import aligned


def _settings(exu: Any, end: float, steps: int | None, tolerance: float = 0.0) -> Any:
    settings = exu.SimulationSettings()
    t = settings.timeIntegration
    t.endTime, t.verboseMode = end, 0
    settings.solutionSettings.writeSolutionToFile = False
    settings.solutionSettings.sensorsWritePeriod = 1e9
    settings.displayStatistics = settings.displayComputationTime = False
    t.generalizedAlpha.spectralRadius = 0.9
    if steps is not None:
        t.numberOfSteps, t.automaticStepSize = steps, False
    else:
        t.numberOfSteps, t.automaticStepSize = 1, True
        t.absoluteTolerance = t.relativeTolerance = tolerance
        t.minimumStepSize, t.initialStepSize = 1e-12, 1e-3
    return settings


def _tree(case: Chain) -> Any:
    import exudyn as exu
    from exudyn import itemInterface as items

    arm, n = case.arm, case.n
    container = exu.SystemContainer()
    system = container.AddSystem()
    places, centres = exu.Vector3DList(), exu.Vector3DList()
    inertias, turns = exu.Matrix3DList(), exu.Matrix3DList()
    for k in range(n):
        turn, place = arms.placement(arm, k)
        places.Append(place)
        centres.Append(arm.com[k])
        inertias.Append(arm.inertia[k])
        turns.Append(turn)
    node = system.AddNode(
        items.NodeGenericODE2(
            referenceCoordinates=[0.0] * n, initialCoordinates=list(case.start),
            initialCoordinates_t=[0.0] * n, numberOfODE2Coordinates=n,
        )
    )  # fmt: skip
    more = {}
    if case.k.any() or case.c.any():
        more = {
            "jointPControlVector": list(case.k), "jointDControlVector": list(case.c),
            "jointPositionOffsetVector": [0.0] * n, "jointVelocityOffsetVector": [0.0] * n,
        }  # fmt: skip
    system.AddObject(
        items.ObjectKinematicTree(
            nodeNumber=node, jointTypes=[exu.JointType.RevoluteZ] * n, linkParents=list(range(-1, n - 1)),
            jointTransformations=turns, jointOffsets=places, linkInertiasCOM=inertias, linkCOMs=centres,
            linkMasses=list(arm.mass), gravity=list(arm.gravity), baseOffset=[0.0] * 3, **more,
        )
    )  # fmt: skip
    return container, system, node


def entries(case: Any) -> Iterator[Entry]:
    import exudyn as exu

    if isinstance(case, FourBar):
        yield from _to_lock(case)
        return
    solvers = exu.DynamicSolverType
    jobs: list[tuple[str, Any, int | None, float]] = []
    if case.stiff:
        jobs += [("generalized-alpha", solvers.GeneralizedAlpha, n, 0.0) for n in (1000, 10000, 100000)]
        jobs += [("trapezoidal", solvers.TrapezoidalIndex2, n, 0.0) for n in (1000, 10000)]
    else:
        jobs += [("DOPRI5", solvers.DOPRI5, None, tol) for tol in (1e-6, 1e-8, 1e-10, 1e-12)]
        jobs += [("RK67", solvers.RK67, round(case.duration * n), 0.0) for n in (30, 100, 300, 1000)]
    for name, kind, steps, tolerance in jobs:
        run = _swing(case, kind, steps, tolerance)
        path = _swing(case, kind, steps, tolerance, sampled=True) if case.whole else None
        setting = f"step {case.duration / steps:g}" if steps else f"tol {tolerance:.0e}"
        yield Entry(f"Exudyn {name}", setting, run, path)


def _swing(case: Chain, kind: Any, steps: int | None, tolerance: float, sampled: bool = False) -> Any:
    """Return a run that is built anew and solved; only solving is timed, by ``seconds`` of the function."""
    import exudyn as exu
    from exudyn import itemInterface as items

    container, system, node = _tree(case)
    sensors = []
    settings = _settings(exu, case.duration, steps, tolerance)
    if sampled:
        settings.solutionSettings.sensorsWritePeriod = case.duration / (steps or 10000)
        kinds = exu.OutputVariableType
        sensors = [
            system.AddSensor(items.SensorNode(nodeNumber=node, storeInternal=True, outputVariableType=kind))
            for kind in (kinds.Coordinates, kinds.Coordinates_t)
        ]
    system.Assemble()
    first = np.concatenate([np.array(case.start), np.zeros(case.n)])

    def run() -> Any:
        system.systemData.SetTime(0.0)
        system.systemData.SetODE2Coordinates(first[: case.n])
        system.systemData.SetODE2Coordinates_t(first[case.n :])
        system.SolveDynamic(settings, solverType=kind)
        if sampled:
            q, v = (system.GetSensorStoredData(s) for s in sensors)
            return q[:, 0], np.concatenate([q[:, 1:], v[:, 1:]], axis=1)
        y = system.systemData
        taken = steps or int(system.sys.get("dynamicSolver").it.currentStepIndex if system.sys else 0)
        return np.concatenate([y.GetODE2Coordinates(), y.GetODE2Coordinates_t()]), taken

    run.keep = container  # type: ignore[attr-defined]
    return run


def _to_lock(case: FourBar) -> Iterator[Entry]:
    import exudyn as exu

    solvers = exu.DynamicSolverType
    for name, kind in (
        ("generalized-alpha, index 3", solvers.GeneralizedAlpha),
        ("trapezoidal, index 2", solvers.TrapezoidalIndex2),
    ):
        for steps in (1240, 12400):
            yield Entry(f"Exudyn {name}", f"step {12.4 / steps:g}", _unfold(case, kind, steps))


def _unfold(case: FourBar, kind: Any, steps: int) -> Any:
    import exudyn as exu
    from exudyn import itemInterface as items

    l0, l1, l2, l3 = case.lengths
    r, q = case.com, case.angles
    container = exu.SystemContainer()
    system = container.AddSystem()
    ground = system.AddObject(items.ObjectGround())
    origins = [np.zeros(2), l1 * np.array([np.cos(q[0]), np.sin(q[0])]), np.array([l0, 0.0])]
    nodes, bodies = [], []
    for k in range(3):
        centre = origins[k] + r[k] * np.array([np.cos(q[k]), np.sin(q[k])])
        nodes.append(
            system.AddNode(
                items.NodeRigidBody2D(
                    referenceCoordinates=[*centre, q[k]],
                    initialCoordinates=[0.0] * 3,
                    initialVelocities=[0.0] * 3,
                )
            )
        )
        bodies.append(
            system.AddObject(
                items.ObjectRigidBody2D(
                    physicsMass=case.mass[k], physicsInertia=case.inertia[k], nodeNumber=nodes[k]
                )
            )
        )

    def marker(body: int, x: float) -> int:
        return int(system.AddMarker(items.MarkerBodyPosition(bodyNumber=body, localPosition=[x, 0, 0])))

    for ends in (
        (marker(ground, 0.0), marker(bodies[0], -r[0])),
        (marker(bodies[0], l1 - r[0]), marker(bodies[1], -r[1])),
        (marker(bodies[1], l2 - r[1]), marker(bodies[2], l3 - r[2])),
        (marker(ground, l0), marker(bodies[2], -r[2])),
    ):
        system.AddObject(items.ObjectJointRevolute2D(markerNumbers=list(ends)))
    fixed = system.AddMarker(
        items.MarkerNodeCoordinate(nodeNumber=system.AddNode(items.NodePointGround()), coordinate=0)
    )
    turning = system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=2))
    system.AddObject(
        items.ObjectConnectorCoordinateSpringDamper(
            markerNumbers=[fixed, turning], stiffness=case.torque[1], damping=0.0
        )
    )
    # the node's coordinate counts from the start
    load = case.torque[0] - case.torque[1] * q[0]
    system.AddLoad(items.LoadCoordinate(markerNumber=turning, load=load))
    sensors = [
        system.AddSensor(
            items.SensorNode(
                nodeNumber=node, storeInternal=True, outputVariableType=exu.OutputVariableType.Coordinates
            )
        )
        for node in nodes[1:]
    ]
    system.Assemble()
    settings = _settings(exu, 12.4, steps)
    settings.solutionSettings.sensorsWritePeriod = 12.4 / steps
    zeros = np.zeros(9)

    def run() -> tuple[float, int]:
        system.systemData.SetTime(0.0)
        system.systemData.SetODE2Coordinates(zeros)
        system.systemData.SetODE2Coordinates_t(zeros)
        system.SolveDynamic(settings, solverType=kind)
        coupler, follower = (system.GetSensorStoredData(s) for s in sensors)
        return aligned(coupler[:, 0], coupler[:, 3] + q[1] - follower[:, 3] - q[2]), steps

    run.keep = container  # type: ignore[attr-defined]
    return run
