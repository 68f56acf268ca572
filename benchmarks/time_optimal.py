"""Paths in the least time: errors of the duration, what the limits are passed by, and times, beside toppra.

    python benchmarks/time_optimal.py [--quick] [--random N] [--json FILE]

A mass has a closed form. For the arms the duration is compared with that of a grid of 12 800 intervals. ``stated`` is
the error that is printed beside the duration, both in parts of it; ``passed`` the largest part by which any limit is
passed at 41 times in every interval. Milliseconds are the least of several calls, limits evaluated, path and equations
built before. ``--random N`` does the same for N random arms of 2 to 7 joints and slides with full inertias, geared
rotors, friction, payloads, and random limits, each at the default tolerance.

toppra (``pip install toppra``) is compared where it is installed: torques by interpolation, the same inverse dynamics,
path and number of intervals. It takes torques as quadratic in the speed, so that arms with friction are left out there.

The last table has whole calls, from a scene that is read to its motion in time, once all is compiled: lines rounded
where they meet, for an arm and for mechanisms with loops.
"""

from __future__ import annotations

import dataclasses
import re
import sys
import time
from typing import Any

import measure

measure.single_thread()

import numpy as np  # noqa: E402

from robodyn_cli import load_scene, load_scene_text  # noqa: E402
from robodyn_cli.fastest.resolve import fastest_on, limited_path, special_points  # noqa: E402
from robodyn_cli.ready.doors import along  # noqa: E402
from robodyn_cli.torques.build import build_inverse  # noqa: E402

MASS = """
schema: 1
gravity: [{gravity}, 0, 0]
robot:
  joints: [{{name: slide, type: prismatic, axis: [1, 0, 0]}}]
  links: [{{name: mass, mass: 2, com: [0, 0, 0]}}]
trajectory: {{type: fastest, points: [{{q: {{slide: 0}}}}, {{q: {{slide: 1}}}}], effort: {{slide: 10}}}}
"""
ARM = """
trajectory:
  type: fastest
  points:
    - {q: {q1: 0, q2: 0.3, q3: 0, q4: 1.2, q5: 0, q6: 0.5, q7: 0}}
    - {q: {q1: 0.5, q2: 0.8, q3: -0.4, q4: 0.8, q5: 0.5, q6: 1.0, q7: 0.6}}
    - {q: {q1: 1.0, q2: 0.2, q3: 0.3, q4: 1.5, q5: -0.3, q6: 0.2, q7: 1.0}}
  effort: {q1: 120, q2: 150, q3: 60, q4: 60, q5: 20, q6: 15, q7: 8}
  speed: {q1: 2, q2: 2, q3: 2.5, q4: 2.5, q5: 3, q6: 3, q7: 3}
"""


class Case:
    """A scene's path with its limits, ready to be timed."""

    def __init__(self, scene: Any) -> None:
        self.trajectory = scene.trajectory
        self.program = build_inverse(along(dataclasses.replace(scene, trajectory=scene.trajectory.way)))
        self.path = limited_path(self.trajectory, self.program)
        self.special = special_points(self.trajectory, self.program, self.path)

    def solve(self, intervals: int | None = None, tolerance: float = 1e-4) -> Any:
        """Return the motion on so many intervals, or on as many as a tolerance needs."""
        trajectory = dataclasses.replace(self.trajectory, intervals=intervals, tolerance=tolerance)
        return fastest_on(self.path, trajectory, self.special, self.program)

    def passed(self, law: Any) -> float:
        """Return the largest part by which a limit is passed between the grid points."""
        parts = np.linspace(1e-6, 1.0 - 1e-6, 41)
        t = (law.knots[:-1, None] + np.diff(law.knots)[:, None] * parts).ravel()
        s, v, u = law(t)[:, 0], law(t, 1)[:, 0], law(t, 2)[:, 0]
        way = self.path.motion(s)
        use = np.abs(self.path.torques_at(way, u, v * v)).max(axis=1, initial=0.0)
        speed = self.path.speed.slowness(way.qd) * v[:, None]
        bounds = self.path.acceleration
        qdd = way.qd[:, bounds.places] * u[:, None] + way.qdd[:, bounds.places] * (v * v)[:, None]
        quick = np.abs(bounds.parts(qdd))
        return float(max(use.max(), speed.max(initial=0.0), quick.max(initial=0.0)) - 1.0)

    def toppra(self, intervals: int) -> tuple[float, float]:
        """Return the duration by toppra, and milliseconds."""
        import toppra as ta
        from toppra import algorithm, constraint

        case, effort, speed = self, self.path.effort, self.path.speed
        bounds = np.full((self.program.problem.model.nv, 2), (-1e9, 1e9))
        bounds[effort.places] = np.column_stack([effort.low, effort.high])

        class Path(ta.interpolator.AbstractGeometricPath):
            path_interval = np.array([0.0, case.trajectory.way.duration])
            dof = len(bounds)

            def __call__(self, s: Any, order: int = 0) -> Any:
                found = case.path.motion(np.atleast_1d(np.asarray(s, dtype=float)))
                value = (found.q, found.qd, found.qdd)[order]
                return value[0] if np.ndim(s) == 0 else value

        def torques(q: Any, qd: Any, qdd: Any) -> Any:
            return case.path.torques(*(np.asfortranarray(x[None]) for x in (q, qd, qdd)))[0]

        scheme = constraint.DiscretizationType.Interpolation
        limits = [
            constraint.JointTorqueConstraint(torques, bounds, 0 * bounds[:, 0], discretization_scheme=scheme)
        ]
        if speed.places:
            fast = np.full(bounds.shape, (-1e9, 1e9))
            fast[speed.places] = np.column_stack([speed.low, speed.high])
            limits.append(constraint.JointVelocityConstraint(fast))
        grid = np.linspace(0.0, case.trajectory.way.duration, intervals + 1)
        start = time.perf_counter()
        solver = algorithm.TOPPRA(limits, Path(), gridpoints=grid, parametrizer="ParametrizeConstAccel")
        found = solver.compute_trajectory(0, 0)
        return float(found.duration), 1e3 * (time.perf_counter() - start)


PLATFORM = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a1, type: revolute, axis: [0, 0, 1], parent: base, link: cyl1}
    - {name: s1, type: prismatic, axis: [1, 0, 0], parent: cyl1, link: rod1}
    - {name: p1, type: revolute, axis: [0, 0, 1], parent: rod1, link: plate}
    - {name: a2, type: revolute, axis: [0, 0, 1], parent: base, link: cyl2, origin: {xyz: [1, 0, 0]}}
    - {name: s2, type: prismatic, axis: [1, 0, 0], parent: cyl2, link: rod2}
    - {name: a3, type: revolute, axis: [0, 0, 1], parent: base, link: cyl3, origin: {xyz: [0.45, 0.9, 0]}}
    - {name: s3, type: prismatic, axis: [1, 0, 0], parent: cyl3, link: rod3}
  links:
    - {name: cyl1, mass: 1, com: [0.1, 0, 0], inertia: {zz: 0.01}}
    - {name: rod1, mass: 0.5, com: [-0.1, 0, 0], inertia: {zz: 0.01}}
    - {name: plate, mass: 2, com: [0.1, 0.05, 0], inertia: {zz: 0.02}}
    - {name: cyl2, mass: 1, com: [0.1, 0, 0], inertia: {zz: 0.01}}
    - {name: rod2, mass: 0.5, com: [-0.1, 0, 0], inertia: {zz: 0.01}}
    - {name: cyl3, mass: 1, com: [0.1, 0, 0], inertia: {zz: 0.01}}
    - {name: rod3, mass: 0.5, com: [-0.1, 0, 0], inertia: {zz: 0.01}}
  points:
    c2: {link: plate, at: [0.2, 0, 0]}
    c3: {link: plate, at: [0.02, 0.2, 0]}
    mid: {link: plate, at: [0.1, 0.05, 0]}
loops:
  - {name: second, type: revolute, between: [c2, rod2.origin]}
  - {name: third, type: revolute, between: [c3, rod3.origin]}
actuated: [s1, s2, s3]
initial: {q: {a1: 0.5, s1: 0.5, p1: -0.5, a2: 2.6, s2: 0.5, a3: -1.5, s3: 0.5}}
"""
SCENES = measure.ROOT / "configs"
# scene, point, options, effort, where it starts, where its lines end
LINES = {
    "2R arm": (
        (SCENES / "trajectories" / "fastest_2r.yaml").read_text(encoding="utf-8"),
        "tip", "ik: {branch: elbow_up}, ", "{theta1: 250, theta2: 120}", "[1.4, 1.0, 0]",
        ((1.0, 1.2), (0.9, 1.4), (0.6, 1.5), (0.3, 1.4), (0.2, 1.1), (0.4, 0.9)),
    ),
    "five-bar": (
        (SCENES / "mechanisms" / "five_bar_circle.yaml").read_text(encoding="utf-8"),
        "tip", "", "{left: 30, right: 30}", "[0.15, 0.9, 0]",
        ((0.35, 1.0), (0.45, 0.8), (0.3, 0.7), (0.2, 0.8), (0.3, 0.95), (0.4, 0.9)),
    ),
    "3-RPR": (
        PLATFORM, "mid", "", "{s1: 60, s2: 60, s3: 60}", "[0.45, 0.3, 0], orientation: {rpy: [0, 0, 0]}",
        ((0.6, 0.35), (0.55, 0.45), (0.4, 0.4), (0.42, 0.32), (0.5, 0.3), (0.55, 0.4)),
    ),
}  # fmt: skip
BLEND = "blend: 0.03"
REFERENCE = 12_800  # intervals
TOPPRA = (("toppra_error", ".1e"), ("toppra_ms", ".1f"))


def compared(case: Case, reference: float, calls: int, **how: Any) -> dict[str, float]:
    """Return the figures of one case, solved as ``how`` says."""
    seconds = []
    for _ in range(calls):
        start = time.process_time()
        found = case.solve(**how)
        seconds.append(time.process_time() - start)
    measure.noted("solving", seconds)
    law = found.law
    return {
        "intervals": len(found.s) - 1,
        "duration": law.duration,
        "error": law.duration / reference - 1.0,
        "stated": found.error / law.duration,
        "passed": case.passed(law),
        "ms": 1e3 * min(seconds),
    }


def named(report: measure.Report, quick: bool) -> list[list[str]]:
    """Return the table of known cases, at several tolerances and beside toppra; add its rows to the report."""
    seven = measure.ROOT / "configs" / "seven_joint_arm.yaml"
    head = seven.read_text().split("trajectory:")[0]
    rigid = re.sub(r",?\s*friction: \{(?:[^{}]|\{[^{}]*\})*\}", "", head)
    top = np.sqrt(2.0 * 3.0 * 7.0 / 10.0)
    cases = [
        ("mass", load_scene_text(MASS.format(gravity=0), "mass.yaml"), 0.8944271909999159),
        ("mass, gravity", load_scene_text(MASS.format(gravity=-2), "mass.yaml"), top / 3.0 + top / 7.0),
        ("2R arm, circle", load_scene(measure.ROOT / "configs" / "trajectories" / "fastest_2r.yaml"), None),
        ("7-joint arm", load_scene_text(head + ARM, str(seven)), None),
        ("... no friction", load_scene_text(rigid + ARM, str(seven)), None),
    ]
    peer = report.has("toppra")
    rows = [["path", "tolerance", "intervals", "duration [s]", "error", "stated", "passed", "ms"]]
    rows[0] += ["toppra: error", "ms"] if peer else []
    for name, scene, exact in cases:
        case = Case(scene)
        reference = exact or case.solve(400 if quick else REFERENCE).law.duration
        for tolerance in (1e-3, 1e-4) if quick else (1e-3, 1e-4, 1e-5, 1e-6):
            row: dict[str, Any] = compared(case, reference, 2 if quick else 5, tolerance=tolerance)
            rows.append([name, f"{tolerance:.0e}", f"{row['intervals']:.0f}", f"{row['duration']:.10f}"])
            rows[-1] += [*(f"{row[key]:.1e}" for key in ("error", "stated", "passed")), f"{row['ms']:.1f}"]
            if peer and any(body.forces for body in case.program.problem.model.bodies):
                rows[-1] += ["", ""]
            elif peer:
                with report.part(f"toppra, {name}, {tolerance:.0e}"):
                    duration, ms = case.toppra(int(row["intervals"]))
                    row |= {"toppra_error": duration / reference - 1.0, "toppra_ms": ms}
                rows[-1] += [format(row[k], form) if k in row else "failed" for k, form in TOPPRA]
            report.rows.append({"path": name, "tolerance": tolerance, **row})
    return rows


def lines(robot: str, count: int) -> Any:
    """Return a scene along so many lines, rounded where they meet."""
    text, point, options, effort, start, ends = LINES[robot]
    given = ", ".join(f"{{type: line, to: [{x}, {y}, 0], {BLEND}}}" for x, y in ends[:count])
    given = given.removesuffix(f", {BLEND}}}") + "}"
    path = (
        f"{{type: path, point: {point}, law: quintic, speed: 1, {options}start: {{position: {start}}}, "
        f"segments: [{given}]}}"
    )
    own = f"trajectory: {{type: fastest, effort: {effort}, path: {path}}}\n"
    return load_scene_text(text.split("trajectory:")[0] + own, str(SCENES / "trajectories" / "lines.yaml"))


def whole(report: measure.Report, quick: bool) -> list[list[str]]:
    """Return the table of whole calls along one, three and six lines; add its rows to the report."""
    rows = [["robot", "lines", "intervals", "duration [s]", "stated", "ms"]]
    for robot in LINES:
        for count in (1, 3) if quick else (1, 3, 6):
            seconds: list[float] = []
            for _ in range(2 if quick else 6):
                scene = lines(robot, count)
                start = time.process_time()
                scaling = along(scene).trajectory.scaling
                seconds.append(time.process_time() - start)
            ms, duration = 1e3 * min(seconds), scaling.law.duration
            stated = scaling.error / duration
            rows.append([robot, f"{count}", f"{scaling.intervals}", f"{duration:.6f}", f"{stated:.1e}"])
            rows[-1].append(f"{ms:.0f}")
            row = {"path": f"{robot}, {count} lines", "intervals": scaling.intervals, "duration": duration}
            report.rows.append(row | {"stated": stated, "whole_ms": ms})
    return rows


def random(count: int, quick: bool) -> list[list[str]]:
    """Return the table of random paths: their largest and usual errors and times."""
    sys.path.insert(0, str(measure.ROOT))
    from tests.random_paths import random_path

    groups: dict[str, list[dict[str, float]]] = {"rigid": [], "with friction": []}
    for seed in range(count):
        case = Case(random_path(seed))
        reference = case.solve(1600 if quick else REFERENCE).law.duration
        found = compared(case, reference, 2 if quick else 5)
        groups["with friction" if case.program.problem.model.bodies[0].forces else "rigid"].append(found)
    rows = [
        ["random arms", "paths", "largest error", "stated / true", "passed", "intervals", "ms", "largest ms"]
    ]
    for name, members in groups.items():
        value = {key: np.array([row[key] for row in members]) for key in members[0]} if members else {}
        if not value:
            continue
        error = np.abs(value["error"])
        ratio = (value["stated"] / np.maximum(error, 1e-300))[error > 1e-7]
        rows.append(
            [name, f"{len(members)}", f"{error.max():.1e}", f"{ratio.min():.2g} to {ratio.max():.2g}"]
        )
        rows[-1] += [f"{value['passed'].max():.1e}", f"{np.median(value['intervals']):.0f}"]
        rows[-1] += [f"{np.median(value['ms']):.1f}", f"{value['ms'].max():.1f}"]
    return rows


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--random", type=int, default=0, metavar="N", help="random paths too")
    options = parser.parse_args()
    measure.print_machine()
    with measure.reporting(options.json) as report:
        with report.part("known paths"):
            print(measure.table(named(report, options.quick)), flush=True)
        if options.random:
            print("\n" + measure.table(random(options.random, options.quick)))
        with report.part("whole calls"):
            print("\n" + measure.table(whole(report, options.quick)), flush=True)


if __name__ == "__main__":
    main()
