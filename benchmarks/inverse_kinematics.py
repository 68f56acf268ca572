"""Inverse kinematics of 1 000 random reachable poses, beside Pinocchio's and the Robotics Toolbox's solvers.

    python benchmarks/inverse_kinematics.py [--quick] [--json FILE]

Three arms: Puma 560, a UR, and a 7-joint arm; no limits. Each solver gets the same poses and begins at the same
position. A pose counts as solved where the forward kinematics of Pinocchio, at the joint positions found, is within
1e-10 m and rad of it. Times are microseconds a pose on one thread: for robodyn the median over calls with all poses at
once (compiling is not part of it), for the others, which take one pose at a time, the mean over them. The Robotics
Toolbox is compared where it is installed (``pip install roboticstoolbox-python``).
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import measure

measure.single_thread()

import arms  # noqa: E402
import numpy as np  # noqa: E402

from robodyn_cli import InverseKinematics, load_scene_text  # noqa: E402

Array = Any
SOLVED = 1e-10  # m and rad
STARTS = 20  # of Pinocchio with restarts
STEPS = 100  # of Pinocchio from one start
HALF = np.pi / 2
# standard D-H parameters: alpha, a, d
PUMA = (
    (HALF, 0.0, -HALF, HALF, -HALF, 0.0),
    (0.0, 0.4318, 0.0203, 0, 0, 0),
    (0.67183, 0, 0.15005, 0.4318, 0, 0),
)
UR = ((HALF, 0, 0, HALF, -HALF, 0), (0, -0.425, -0.3922, 0, 0, 0), (0.1625, 0, 0, 0.1333, 0.0997, 0.0996))


def from_standard(name: str, table: tuple[tuple[float, ...], ...]) -> arms.Arm:
    """Return an arm by standard D-H parameters, in modified ones: alpha and a are those of the link before."""
    alpha, a, d = (np.array(x, dtype=float) for x in table)
    n = len(d)
    before = [np.concatenate([[0.0], x[:-1]]) for x in (alpha, a)]
    inertia = np.tile(0.01 * np.eye(3), (n, 1, 1))
    return arms.Arm(name, *before, d, np.ones(n), np.zeros((n, 3)), inertia, np.array([0.0, 0.0, -9.81]))


class Forward:
    """Pinocchio's forward kinematics of the last link."""

    def __init__(self, arm: arms.Arm) -> None:
        import pinocchio as pin

        self.pin, self.model = pin, arms.pinocchio_model(arm)
        self.data = self.model.createData()

    def at(self, q: Array) -> Any:
        self.pin.forwardKinematics(self.model, self.data, q)
        return self.data.oMi[self.model.njoints - 1]

    def errors(self, q: Array, poses: list[Any]) -> Array:
        """Return the larger of distance and angle to each pose."""
        found = []
        for row, pose in zip(q, poses):
            here = self.at(row)
            # an angle from the skew part: a trace has no digits below 1e-8
            R = here.rotation.T @ pose.rotation
            sine = 0.5 * np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
            angle = np.arctan2(sine, 0.5 * (np.trace(R) - 1.0))
            found.append(max(np.linalg.norm(here.translation - pose.translation), angle))
        return np.array(found)


def pinocchio_solver(forward: Forward, starts: int) -> Callable[[Any, Array], Array]:
    """Return Levenberg and Marquardt's method on Pinocchio's Jacobian in the frame, from one start or several."""
    pin, model, data = forward.pin, forward.model, forward.data
    last, rng = model.njoints - 1, np.random.default_rng(2)

    def solve(pose: Any, q0: Array) -> Array:
        q = q0
        for start in range(starts):
            q = q0 if start == 0 else rng.uniform(-np.pi, np.pi, model.nq)
            for _ in range(STEPS):
                e = pin.log6(forward.at(q).actInv(pose))
                if np.abs(e.vector).max() < 0.1 * SOLVED:
                    return q
                pin.computeJointJacobians(model, data, q)
                J = pin.Jlog6(pose.actInv(data.oMi[last])) @ pin.getJointJacobian(
                    model, data, last, pin.LOCAL
                )
                damping = 0.5 * float(e.vector @ e.vector) * 0.1 + 1e-12
                q = q - J.T @ np.linalg.solve(J @ J.T + damping * np.eye(6), -e.vector)
        return q

    return solve


def toolbox_solver(arm: arms.Arm, tolerance: float) -> Callable[[Any, Array], Array]:
    """Return the Robotics Toolbox's solver in C."""
    import roboticstoolbox as rtb

    links = [rtb.RevoluteMDH(a=a, alpha=alpha, d=d) for a, alpha, d in zip(arm.a, arm.alpha, arm.d)]
    ets = rtb.DHRobot(links).ets()

    def solve(pose: Any, q0: Array) -> Array:
        return ets.ik_LM(pose.homogeneous, q0=q0, tol=tolerance, joint_limits=False)[0]

    return solve


def one_by_one(solve: Callable[[Any, Array], Array], poses: list[Any], q0: Array) -> tuple[float, Array]:
    """Return microseconds a pose and the positions found."""
    start = time.process_time()
    found = [np.array(solve(pose, q0)) for pose in poses]
    return (time.process_time() - start) / len(poses) * 1e6, np.array(found)


def bench(report: measure.Report, arm: arms.Arm, poses: int, repeats: int) -> None:
    """Add a row for each solver to the report."""
    forward = Forward(arm)
    rng = np.random.default_rng(1)
    targets = [forward.at(q).copy() for q in rng.uniform(-np.pi, np.pi, (poses, arm.n))]
    p, R = (np.array([getattr(x, name) for x in targets]) for name in ("translation", "rotation"))
    q0 = 0.5 * np.ones(arm.n)
    scene, link = load_scene_text(arms.scene_text(arm)), f"link{arm.n}"

    def row(solver: str, time_us: float, q: Array) -> None:
        errors = forward.errors(q, targets)
        solved = errors <= SOLVED
        report.rows.append(
            {"arm": arm.name, "solver": solver, "us": time_us, "solved": float(solved.mean()),
             "error": float(errors[solved].max(initial=0.0))}
        )  # fmt: skip

    for method in ("auto", "damped"):
        solver = InverseKinematics(scene, link, method=method)
        if method == "auto" and solver.closed_form is None:
            continue
        solver.solve(p, R, near=q0)
        times = []
        for _ in range(repeats):
            start = time.process_time()
            found = solver.solve(p, R, near=q0)
            times.append((time.process_time() - start) / poses * 1e6)
        name = "robodyn, all branches" if method == "auto" else "robodyn, damped steps"
        measure.noted(name, times)
        row(name, statistics.median(times), found.q)
    for starts in (1, STARTS):
        name = "Pinocchio, 1 start" if starts == 1 else f"Pinocchio, {starts} starts"
        row(name, *one_by_one(pinocchio_solver(forward, starts), targets, q0))
    if not report.has("roboticstoolbox"):
        return
    for tolerance in (1e-6, 1e-20):
        with report.part(f"Robotics Toolbox, {arm.name}"):
            solve = toolbox_solver(arm, tolerance)
            row(f"Robotics Toolbox, {tolerance:.0e}", *one_by_one(solve, targets, q0))


def main() -> None:
    given = measure.command_line(__doc__).parse_args()
    poses, repeats = (100, 3) if given.quick else (1000, 15)
    measure.print_machine()
    print(f"{poses} random poses; solved: within {SOLVED:g} m and rad by Pinocchio's forward kinematics\n")
    with measure.reporting(given.json) as report:
        report.more |= {"poses": poses, "repeats": repeats}
        if not report.has("pinocchio"):
            return
        for arm in (from_standard("Puma 560", PUMA), from_standard("UR", UR), arms.seven_joint_arm()):
            with report.part(arm.name):
                bench(report, arm, poses, repeats)
        lines = [["arm", "solver", "us a pose", "solved", "largest error of these"]]
        lines += [
            [row["arm"], row["solver"], f"{row['us']:.2f}", f"{row['solved']:.1%}", f"{row['error']:.1e}"]
            for row in report.rows
        ]
        print(measure.table(lines, left=2))


if __name__ == "__main__":
    main()
