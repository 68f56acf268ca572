"""Exudyn on any mechanism of revolute and prismatic joints that robodyn has read: rigid bodies in redundant
coordinates (Euler parameters), a joint object for each joint and closure, implicit integrators of index 3 and 2."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

FREE = {
    "Revolute": (5,),
    "Prismatic": (2,),
    "Fixed": (),
    "Spherical": (3, 4, 5),
}  # axes that a joint leaves free: three shifts, three turns


class Unsupported(Exception):
    """The mechanism has something that this translation cannot say."""


def number(x: Any, instead: float) -> float:
    """Return a number of the model, or what stands in where the scene need not say it."""
    return float(x) if isinstance(x, (int, float, np.floating)) else instead


class Mechanism:
    """robodyn's model at its start, as Exudyn needs it: bodies at their centres of mass, in base coordinates."""

    def __init__(self, problem: Any, q: np.ndarray, v: np.ndarray) -> None:
        from robodyn_cli.algorithms.kinematics import point_jacobian, poses, transforms
        from robodyn_cli.spatial.inertia import parallel_axis

        self.problem, self.model = problem, problem.model
        model = self.model
        self.pose = poses(model, transforms(model, q))
        self.mass, self.inertia, self.centre = [], [], []
        self.velocity, self.spin = [], []
        for k, body in enumerate(model.bodies):
            I = body.inertia
            m = number(I.m, 0.0)
            c = np.array([number(x, 0.0) / m if m else 0.0 for x in I.h])
            about = I.I - parallel_axis(I.h, c)
            diagonal = [number(about[i, i], np.nan) for i in range(3)]
            # what the motion does not depend on is set to what is known
            known = [x for x in diagonal if x == x]
            fill = max(known) if known else 1.0
            self.mass.append(m)
            self.inertia.append(
                np.array([[number(about[i, j], fill if i == j else 0.0) for j in range(3)] for i in range(3)])
            )
            self.centre.append(c)
            place = self.pose[k].point(c)
            linear, angular = point_jacobian(model, q, self.pose, k, place)
            self.velocity.append(np.asarray(linear @ v, dtype=float))
            self.spin.append(np.asarray(angular @ v, dtype=float))

    def centres(self, q: np.ndarray) -> np.ndarray:
        """Return the centres of mass (bodies, 3) at q."""
        from robodyn_cli.algorithms.kinematics import poses, transforms

        pose = poses(self.model, transforms(self.model, q))
        return np.array([pose[k].point(c) for k, c in enumerate(self.centre)], dtype=float)

    def local(self, frame: Any) -> np.ndarray:
        """Return a point fixed to a body relative to its centre of mass, or as it is in the base."""
        p = np.asarray(frame.p, dtype=float)
        return p if frame.body < 0 else p - self.centre[frame.body]

    def place(self, frame: Any) -> np.ndarray:
        p = np.asarray(frame.p, dtype=float)
        return p if frame.body < 0 else np.asarray(self.pose[frame.body].point(p), dtype=float)


def build(m: Mechanism, extra: Callable[[Any, list[int], int, Mechanism], None] | None) -> Any:
    """Return container, system and bodies."""
    import exudyn as exu
    from exudyn.utilities import RigidBodyInertia

    model, scene = m.model, m.problem.scene
    if scene.prescribed or model.forces:
        raise Unsupported("prescribed motions or forces on bodies")
    if scene.torques and extra is None:
        raise Unsupported("actuator torques")
    container = exu.SystemContainer()
    system = container.AddSystem()
    ground = system.CreateGround()
    bodies: list[int] = []
    gravity = [float(x) for x in model.gravity]
    for k, body in enumerate(model.bodies):
        if body.forces or number(body.armature, 1.0):
            raise Unsupported(f"forces in joint {body.joint_name}")
        bodies.append(
            system.CreateRigidBody(
                referencePosition=np.asarray(m.pose[k].point(m.centre[k]), dtype=float),
                referenceRotationMatrix=np.asarray(m.pose[k].R, dtype=float),
                initialVelocity=list(m.velocity[k]),
                initialAngularVelocity=list(m.spin[k]),
                inertia=RigidBodyInertia(m.mass[k], m.inertia[k]),
                gravity=gravity,
            )
        )

    def item(k: int) -> int:
        return ground if k < 0 else bodies[k]

    for k, body in enumerate(model.bodies):
        kind = type(body.joint).__name__
        if kind not in FREE:
            raise Unsupported(f"joint type {kind}")
        system.CreateGenericJoint(
            itemNumbers=[item(body.parent), bodies[k]],
            position=np.asarray(m.pose[k].p, dtype=float),
            rotationMatrixAxes=np.asarray(m.pose[k].R, dtype=float),
            constrainedAxes=[int(axis not in FREE[kind]) for axis in range(6)],
            show=False,
        )
    rows = m.problem.constraints.rows
    for loop in model.loops:
        ends = [item(loop.first.body), item(loop.second.body)]
        kind = type(loop.element).__name__
        count = sum(row.name.startswith(loop.name + ".") for row in rows)
        if kind == "DistanceLoop":
            system.CreateDistanceConstraint(
                itemNumbers=ends, localPosition0=m.local(loop.first), localPosition1=m.local(loop.second),
                distance=loop.element.length, show=False,
            )  # fmt: skip
        elif kind in ("RevoluteLoop", "SphericalLoop") and count in (2, 3):
            # a planar pin: its other rows would repeat what the tree says
            system.CreateGenericJoint(
                itemNumbers=ends, position=m.place(loop.first), constrainedAxes=[1, 1, int(count == 3), 0, 0, 0],
                show=False,
            )  # fmt: skip
        elif kind == "FixedLoop" and count == 6:
            system.CreateGenericJoint(
                itemNumbers=ends, position=m.place(loop.first), constrainedAxes=[1] * 6, show=False
            )
        else:
            raise Unsupported(f"loop {loop.name}")
    if extra is not None:
        extra(system, bodies, ground, m)
    return container, system, bodies


def andrews(system: Any, bodies: list[int], ground: int, m: Mechanism) -> None:
    """Add the drive on the crank and the spring between body 3 and the ground."""
    names = m.model.links
    crank = names["body1"].body
    system.CreateTorque(itemNumber=bodies[crank], loadVector=[0, 0, 0.033])
    link = names["body3"]
    D = np.asarray(link.p + link.R @ np.array([0.02, -0.018, 0.0]), dtype=float) - m.centre[link.body]
    system.CreateSpringDamper(
        itemNumbers=[bodies[link.body], ground], localPosition0=D, localPosition1=[0.014, 0.072, 0.0],
        referenceLength=0.07785, stiffness=4530.0, show=False,
    )  # fmt: skip


EXTRAS = {"andrews": andrews}


def solve(m: Mechanism, name: str, duration: float, samples: int, kind: str, steps: int) -> Callable[[], Any]:
    """Return a run that gives centres of mass at ``samples`` + 1 instants, the solver's seconds and its iterations."""
    import exudyn as exu
    from exudyn import itemInterface as items

    from peers.exudyn import _settings

    def run() -> tuple[np.ndarray, float, int]:
        import time

        _, system, bodies = build(m, EXTRAS.get(name))
        sensors = [
            system.AddSensor(
                items.SensorBody(
                    bodyNumber=b, storeInternal=True, outputVariableType=exu.OutputVariableType.Position
                )
            )
            for b in bodies
        ]
        system.Assemble()
        settings = _settings(exu, duration, steps)
        settings.solutionSettings.sensorsWritePeriod = duration / samples
        began = time.process_time()
        system.SolveDynamic(settings, solverType=getattr(exu.DynamicSolverType, kind))
        took = time.process_time() - began
        paths = np.array([system.GetSensorStoredData(s)[:, 1:4] for s in sensors])
        solver = system.sys.get("dynamicSolver")
        iterations = int(solver.it.newtonStepsCount) if solver is not None else 0
        return np.swapaxes(paths, 0, 1), took, iterations

    return run
