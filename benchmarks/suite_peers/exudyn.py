"""A case in Exudyn: trees in minimal coordinates (``ObjectKinematicTree``), plane loops as bodies with joints.

Springs and dampers are the tree's own. Dry friction and rigid stops come from ``CoordinateSpringDamperExt``: bristles
or a steep slope, and stiff limit stops. Everything else is a Python function of the tree.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from robodyn_cli.algorithms.composite import crba
from suite_peers import exudyn_plane
from suite_peers.case import Clock, Mechanism, Run, TooSlow
from suite_peers.mujoco import damping_ratio
from tests.engines import mass_properties, real

SOLVERS = (("gen.-alpha", "GeneralizedAlpha"), ("trapezoidal", "TrapezoidalIndex2"))
LEAST_STEPS, STEP = 4000, 1e-3
BRISTLE, BRISTLE_DAMPING = 1e8, 1e6  # N m/rad, N m s/rad: what holds a joint that sticks
CONTACT = 8.0  # steps that an impact on a rigid stop lasts


def runs(case: Mechanism) -> Iterator[tuple[str, Run]]:
    """Yield the implicit integrators of index 3 and 2, with steps of a millisecond, or 4000 in all."""
    import exudyn as exu

    make = exudyn_plane.build if case.model.loops else build

    def run(times: np.ndarray, kind: str) -> np.ndarray:
        each = max(1, round(max(LEAST_STEPS, times[-1] / STEP) / (len(times) - 1)))
        system, read = make(case, times[1] / each)
        clock = Clock()
        system.SetPreStepUserFunction(lambda mbs, t: not clock.up)
        system.Assemble()
        settings = exu.SimulationSettings()
        t = settings.timeIntegration
        t.endTime, t.numberOfSteps, t.verboseMode = times[-1], each * (len(times) - 1), 0
        t.generalizedAlpha.spectralRadius = 0.9
        settings.solutionSettings.writeSolutionToFile = False
        settings.solutionSettings.sensorsWritePeriod = times[1]
        settings.displayStatistics = settings.displayComputationTime = False
        system.SolveDynamic(settings, solverType=getattr(exu.DynamicSolverType, kind))
        if clock.up:
            raise TooSlow
        found = read()
        if len(found) < len(times):
            raise ArithmeticError("the solver gives up")
        return found[: len(times)]

    for name, kind in SOLVERS:
        yield f"Exudyn {name}", functools.partial(run, kind=kind)


def build(case: Mechanism, step: float) -> tuple[Any, Callable[[], np.ndarray]]:
    """Return the system of an open tree, and what reads its states (T, 2 nv) in our order."""
    import exudyn as exu
    from exudyn import itemInterface as items

    kinds = {"revolute": exu.JointType.RevoluteZ, "prismatic": exu.JointType.PrismaticZ}
    bodies, order = case.model.bodies, [body.v for body in case.model.bodies]
    system = exu.SystemContainer().AddSystem()
    n = len(bodies)
    places, centres = exu.Vector3DList(), exu.Vector3DList()
    inertias, turns = exu.Matrix3DList(), exu.Matrix3DList()
    masses = []
    for body in bodies:
        m, c, I = mass_properties(body)
        places.Append(real(body.X_tree.r))
        turns.Append(real(body.X_tree.E).T)
        centres.Append(c)
        inertias.Append(I)
        masses.append(m)
    node = system.AddNode(
        items.NodeGenericODE2(
            referenceCoordinates=[0.0] * n, initialCoordinates=list(case.q[order]),
            initialCoordinates_t=list(case.v[order]), numberOfODE2Coordinates=n,
        )
    )  # fmt: skip
    more: dict[str, Any] = {}
    if not case.plain:

        def others(mbs: Any, t: float, item: int, q: Any, v: Any) -> Any:
            x, xd = np.empty(n), np.empty(n)
            x[order], xd[order] = q, v
            return list((case.torques(t, x, xd) - case.passive(x, xd))[order])

        more["forceUserFunction"] = others
    system.AddObject(
        items.ObjectKinematicTree(
            nodeNumber=node, jointTypes=[kinds[b.joint.type] for b in bodies], linkParents=[b.parent for b in bodies],
            jointTransformations=turns, jointOffsets=places, linkInertiasCOM=inertias, linkCOMs=centres,
            linkMasses=masses, gravity=list(real(case.model.gravity)), baseOffset=[0.0] * 3,
            jointPControlVector=list(case.k[order]), jointDControlVector=list(case.c[order]),
            jointPositionOffsetVector=list(case.rest[order]), jointVelocityOffsetVector=[0.0] * n, **more,
        )
    )  # fmt: skip
    _joints(case, system, node, step)
    outputs = exu.OutputVariableType
    sensors = [
        system.AddSensor(items.SensorNode(nodeNumber=node, storeInternal=True, outputVariableType=kind))
        for kind in (outputs.Coordinates, outputs.Coordinates_t)
    ]
    place = np.argsort(order)
    return system, lambda: np.concatenate(
        [system.GetSensorStoredData(s)[:, 1:][:, place] for s in sensors], axis=1
    )


def _joints(case: Mechanism, system: Any, node: int, step: float) -> None:
    """Add friction and stops of joints."""
    from exudyn import itemInterface as items

    if not (case.coulomb.any() or case.rigid):
        return
    ground = system.AddNode(items.NodePointGround())
    fixed = system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=ground, coordinate=0))
    for k, body in enumerate(case.model.bodies):
        j = body.v
        more: dict[str, Any] = {}
        if case.coulomb[j]:
            more["dynamicFrictionForce"] = case.coulomb[j]
            if case.speed:
                more["frictionProportionalZone"] = case.speed
            else:
                more.update(stickingStiffness=BRISTLE, stickingDamping=BRISTLE_DAMPING)
        stop = case.stops[j]
        if stop is not None:
            lower, upper, restitution = stop
            w = np.pi / (CONTACT * step)
            m = effective_inertia(case, j)
            more.update(
                useLimitStops=True, limitStopsLower=lower, limitStopsUpper=upper, limitStopsStiffness=m * w**2,
                limitStopsDamping=2.0 * damping_ratio(restitution) * m * w,
            )  # fmt: skip
        if not more:
            continue
        if "stickingStiffness" in more or "useLimitStops" in more:
            # the first of its data is the direction of sliding, which has to be right at the start
            data = [float(np.sign(case.v[j])), 0.0, 0.0]
            more["nodeNumber"] = system.AddNode(
                items.NodeGenericData(initialCoordinates=data, numberOfDataCoordinates=3)
            )
        turning = system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=k))
        system.AddObject(
            items.ObjectConnectorCoordinateSpringDamperExt(markerNumbers=[fixed, turning], **more)
        )


def effective_inertia(case: Mechanism, j: int) -> float:
    """Return the inertia [kg m^2] that an impulse on joint j meets at its upper stop: damping fits one pose only."""
    q = case.q.copy()
    q[j] = case.stops[j][1]  # type: ignore[index]
    return float(1.0 / np.linalg.inv(real(crba(case.model, q)))[j, j])
