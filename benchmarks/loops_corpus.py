"""Mechanisms with closed loops from files of others: forward dynamics beside Pinocchio, error and time of each.

    python benchmarks/loops_corpus.py [FOLDER] [--reference FOLDER] [--quick] [--json FILE]

For each robot file below FOLDER (URDF, SDF and MJCF in any dialect of loops that robodyn reads): whether it loads, how
many coordinates and closure rows it has, seconds from the file to a closed pose, and the gap that the pose leaves. Then
accelerations under random torques at random closed states: both engines against the null space of the rows, solved with
Pinocchio's own M, h and Jacobians by steps of refinement, and microseconds a state on one thread. robodyn takes all
states in one call of ``Mechanism.forward_dynamics``; Pinocchio has no call for many states with constraints, so its
fastest way from Python is a loop over ``constraintDynamics``. The two take turns. A dash is what an engine does not do.
Without FOLDER: the robots of ``configs``.

With --reference, accelerations at the states in ``FOLDER/*.json`` too (name of the file: folder, underscore, robot).
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import measure

measure.single_thread()
sys.path.insert(0, str(measure.ROOT))

import numpy as np  # noqa: E402

from robodyn_cli import Mechanism, load_scene_text  # noqa: E402
from robodyn_cli.errors import CapabilityError, RobodynError  # noqa: E402
from robodyn_cli.over.crosscheck.engine import PeerEngine, directions, translate  # noqa: E402
from robodyn_cli.over.crosscheck.engines import InPinocchio  # noqa: E402
from robodyn_cli.ready.prepare import prepare  # noqa: E402
from robodyn_cli.solve.closure import Numbers, newton  # noqa: E402

KINDS = (".urdf", ".sdf", ".xml")
GRAVITY = (0.0, 0.0, -9.81)
DIFFERENT = 32  # states, of which batches are made
WALK = 0.2  # rad, or part of the size, from one state to the next
PROXIMAL = (1e-14, 1e-8, 50)  # accuracy, mu and rounds of Pinocchio's solver


def robots(folder: Path) -> dict[str, Path]:
    """Return the robot files below a folder, by folder and name."""
    files = [path for kind in KINDS for path in folder.rglob(f"*{kind}")]
    named = {}
    for path in sorted(files):
        own = path.parent if path.name != "robot.urdf" else path.parent.parent
        named[f"{own.name} {path.stem if path.name != 'robot.urdf' else path.parent.name}"] = path
    return named


class States:
    """Closed states of a mechanism with random rates and torques, one near the other."""

    def __init__(self, problem: Any, start: np.ndarray) -> None:
        rng, numbers = np.random.default_rng(1), Numbers(problem, problem.at_start)
        places, rates, q = [], [], start
        for _ in range(DIFFERENT):
            psi = numbers.psi(q) * numbers.lengths if numbers.rows else np.zeros((0, numbers.nv))
            _, s, Vt = np.linalg.svd(psi)
            free = Vt[int((s > 1e-7 * s.max(initial=0.0)).sum()) :].T
            motion = numbers.lengths * (free @ rng.normal(size=free.shape[1]))
            places.append(q)
            rates.append(motion)
            step = WALK * motion / max(1.0, float(np.abs(motion / numbers.lengths).max(initial=0.0)))
            there = numbers.manifold.integrate(q, step)
            closed, gap = newton(numbers, there, range(numbers.nv)) if numbers.rows else (there, 0.0)
            q = closed if gap < 1e-11 else start
        self.q, self.v = np.array(places), np.array(rates)
        self.tau = rng.normal(size=self.v.shape)

    def many(self, samples: int) -> list[np.ndarray]:
        """Return q, v and tau of so many states, column-ordered."""
        times = -(-samples // DIFFERENT)
        return [np.asfortranarray(np.tile(x, (times, 1))[:samples]) for x in (self.q, self.v, self.tau)]


def constraint_dynamics(pin: Any, peer: InPinocchio, loops: Any) -> Callable[..., np.ndarray]:
    """Return Pinocchio's forward dynamics of one state (its order of coordinates) with the closures as constraints.

    Raises
    ------
    CapabilityError : a closure is neither a point nor a pose.
    """
    models = pin.StdVec_RigidConstraintModel()
    for loop in loops:
        free = directions(loop).shape[1]
        if loop.element.type == "revolute" and free == 2:
            kind = pin.ContactType.CONTACT_3D  # in a planar mechanism the two other rows vanish
        else:
            kind = {0: pin.ContactType.CONTACT_3D, 3: pin.ContactType.CONTACT_6D}[free]
        places = [
            (peer.joint[frame.body], pin.SE3(np.array(frame.R, float), np.array(frame.p, float)))
            for frame in (loop.first, loop.second)
        ]
        models.append(pin.RigidConstraintModel(kind, peer.model, *places[0], *places[1], pin.LOCAL))
    datas = pin.StdVec_RigidConstraintData()
    datas.extend(model.createData() for model in models)
    pin.initConstraintDynamics(peer.model, peer.data, models, datas)
    settings = pin.ProximalSettings(*PROXIMAL)
    return lambda q, v, tau: pin.constraintDynamics(peer.model, peer.data, q, v, tau, models, datas, settings)


def row_of(report: measure.Report, name: str, path: Path, samples: int, repeats: int) -> dict[str, Any]:
    """Return the figures of one robot, or why it is refused."""
    row: dict[str, Any] = {"robot": name}
    text = json.dumps({"schema": 1, "command": "simulate", "gravity": GRAVITY, "robot": str(path),
                       "simulate": {"duration": 1.0}})  # fmt: skip
    start = time.process_time()
    try:
        scene = load_scene_text(text)
        setup = prepare(scene, neutral=True)
    except RobodynError as error:
        return row | {"refused": error.message.replace(str(path), path.name)}
    problem = setup.problem
    row |= {
        "coordinates": problem.model.nv,
        "rows": len(problem.constraints.rows),
        "closed_s": time.process_time() - start,
        "gap": setup.assembled.position_residual,
    }
    states = States(problem, setup.assembled.q)
    mechanism, (q, v, tau) = Mechanism(scene), states.many(samples)
    calls: dict[str, Callable[[], Any]] = {"robodyn": lambda: mechanism.forward_dynamics(q, v, tau)}
    answers = {"robodyn": calls["robodyn"]()[:DIFFERENT]}
    for _ in range(-(-250_000 // samples) if repeats > 3 else 0):  # until the code is compiled for good
        calls["robodyn"]()
    exact = None
    if report.has("pinocchio") and not scene.couplers:
        pin = importlib.import_module("pinocchio")
        translated = translate(scene, True)
        peer = InPinocchio(translated.model)
        plain = np.array([translated.plain(*x) for x in zip(states.q, states.v)])
        exact = reference(peer, translated.model.loops, states, states.tau + plain)
        try:
            one = constraint_dynamics(pin, peer, translated.model.loops)
        except (CapabilityError, KeyError):
            one = None
        if one is not None:
            given = [peer._to(*x) for x in zip(states.q, states.v, states.tau + plain)]

            def loop(f: Callable[..., Any] = one) -> None:
                for state in given:
                    f(*state)

            answers["pinocchio"] = np.array([peer.in_our_order(np.array(one(*x))) for x in given])
            calls["pinocchio"] = loop
    times = measure.alternate(calls, repeats)
    counts = {"robodyn": samples, "pinocchio": DIFFERENT}
    for engine, seconds in times.items():
        row[f"{engine}_us"] = 1e6 * measure.median(seconds) / counts[engine]
        if exact is not None:
            row[f"{engine}_error"] = float(np.abs(answers[engine] - exact).max() / np.abs(exact).max())
    if "pinocchio" in times:
        ratio = measure.median_ratio(times["pinocchio"], times["robodyn"])
        row["faster"] = ratio * samples / DIFFERENT
    return row


def reference(peer: PeerEngine, loops: Any, states: States, tau: np.ndarray) -> np.ndarray:
    """Return the accelerations (T, nv) that the engine's own M, h and Jacobians give, solved by the null space."""
    return np.array([peer.accelerations(*x, loops) for x in zip(states.q, states.v, tau)])


FIGURES = (
    ("coordinates", "coordinates", "d"),
    ("rows", "rows", "d"),
    ("closed_s", "read and closed, s", ".2f"),
    ("gap", "gap, m or rad", ".0e"),
    ("robodyn_us", "robodyn us", ".2f"),
    ("pinocchio_us", "Pinocchio us", ".1f"),
    ("faster", "times faster", ".1f"),
    ("robodyn_error", "error", ".0e"),
    ("pinocchio_error", "Pinocchio's error", ".0e"),
)


def lines(rows: list[dict[str, Any]]) -> Iterator[list[str]]:
    yield ["robot", *(head for _, head, _ in FIGURES)]
    for row in rows:
        if "refused" not in row:
            yield [row["robot"], *(format(row[key], form) if key in row else "-" for key, _, form in FIGURES)]


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=measure.ROOT / "configs" / "robots",
                        help="folder with the robots' files, at any depth")  # fmt: skip
    options = parser.parse_args()
    samples, repeats = (256, 3) if options.quick else (2048, 11)
    measure.print_machine()
    print(f"{samples} states a call, one thread, medians of {repeats} alternating repeats\n")
    with measure.reporting(options.json) as report:
        report.more |= {"samples": samples, "repeats": repeats}
        for name, path in robots(options.folder).items():
            with report.part(name):
                report.rows.append(row_of(report, name, path, samples, repeats))
                print(f"{name} done", file=sys.stderr, flush=True)
        print(measure.table(list(lines(report.rows))))
        for row in report.rows:
            if "refused" in row:
                print(f"\n{row['robot']}: refused: {row['refused']}")
        ratios = [row["faster"] for row in report.rows if "faster" in row]
        if ratios:
            mean = float(np.exp(np.log(ratios).mean()))
            print(
                f"\nfaster than Pinocchio: {min(ratios):.1f} times at least, {mean:.1f} in the geometric mean"
            )


if __name__ == "__main__":
    main()
