"""Mechanisms with closed loops from files of others: forward dynamics beside other engines, error and time of each.

    python benchmarks/loops_corpus.py [FOLDER] [--reference FOLDER] [--motion] [--only PART] [--quick] [--json FILE]

For each robot file below FOLDER (URDF, SDF and MJCF in any dialect of loops that robodyn reads): whether it loads, how
many coordinates and closure rows it has, seconds from the file to a closed pose, and the gap that the pose leaves.
Without FOLDER: the robots of ``configs``.

Then accelerations under random torques at random closed states, some on a random walk from that pose, others from
random starts: errors are those against the null space of the rows, solved with Pinocchio's own M, h and Jacobians by
steps of refinement. ``part allowed``: our largest error beside max(1e-9, 1e-14 x condition), or beside what rounding
in the file leaves open. Times are microseconds a state on one thread, the engines in turn: robodyn takes all states in
one call of ``forward_dynamics``, the others go as fast as ``peers/forward_dynamics.py`` knows. Sticking friction and
rigid stops are left out. A dash is what an engine does not do.

--reference: also at the states in ``FOLDER/*.json`` (keys ``source``, ``state``, ``torque``, ``qdd``).
--motion: also 10 s from the closed pose under oblique gravity: how far the loops open, the change of the energy, the
error estimate, up to when the motion is meaningful, and seconds.
"""

from __future__ import annotations

import dataclasses
import json
import re
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import measure

measure.single_thread()
sys.path.insert(0, str(measure.ROOT))

import numpy as np  # noqa: E402
from peers.forward_dynamics import ALLOWED, DIGITS, PEERS, Given  # noqa: E402

from robodyn_cli import load_scene_text, simulate  # noqa: E402
from robodyn_cli.errors import RobodynError  # noqa: E402
from robodyn_cli.forces.friction import Friction  # noqa: E402
from robodyn_cli.ready.prepare import prepare  # noqa: E402
from robodyn_cli.solve.closing.nearest import ClosedPose  # noqa: E402
from robodyn_cli.solve.closure import Numbers, newton  # noqa: E402
from robodyn_cli.works.functions.constrained import MANY  # noqa: E402
from robodyn_cli.works.functions.model import ModelFunctions  # noqa: E402

KINDS = (".urdf", ".sdf", ".xml")
GRAVITY = (0.0, 0.0, -9.81)
OBLIQUE = (3.0, -6.0, -7.1)  # of motions, as planar mechanisms lie in any plane
DIFFERENT = 32  # states of the walk, of which batches are made
WALK = 0.2  # rad, or part of the size, from one state to the next
WILD = 32  # states from random starts, at most
TRIES = 48  # random starts
APART = 1e-3  # of the largest singular value: states from random starts at which a row is weaker are left out
ENGINES = {
    "robodyn": "robodyn",
    "pinocchio": "Pinocchio",
    "mujoco": "MuJoCo",
    "pydrake": "Drake",
    "exudyn": "Exudyn",
}
FREE_BASE = re.compile(
    r"<freejoint[^>]*/>|<joint[^>]*type=\"free\"[^>]*/>|<keyframe>.*?</keyframe>", re.DOTALL
)


def robots(folder: Path, only: str = "") -> dict[str, Path]:
    """Return the robot files below a folder, by folder and name."""
    files = [path for kind in KINDS for path in folder.rglob(f"*{kind}")]
    named = {}
    for path in sorted(files):
        own = path.parent if path.name != "robot.urdf" else path.parent.parent
        named[f"{own.name} {path.stem if path.name != 'robot.urdf' else path.parent.name}"] = path
    return {name: path for name, path in named.items() if only in name}


def scene_of(path: Path, gravity: Sequence[float], **simulated: Any) -> Any:
    """Return the scene of a robot's file, without sticking friction and rigid stops."""
    scene = load_scene_text(json.dumps({"schema": 1, "command": "simulate", "gravity": gravity, "robot": str(path),
                                        "simulate": simulated}))  # fmt: skip
    joints = (
        dataclasses.replace(joint, forces=tuple((kind, slippery(force)) for kind, force in joint.forces))
        for joint in scene.robot.joints
    )
    return dataclasses.replace(scene, robot=dataclasses.replace(scene.robot, joints=tuple(joints)))


def slippery(force: Any) -> Any:
    """Return a force in a joint, without Coulomb friction where that sticks."""
    sticks = isinstance(force, Friction) and force.set_valued
    return dataclasses.replace(force, coulomb=0.0, static=None) if sticks else force


class States:
    """Closed states of a mechanism with random rates and torques: q (T, nq), v, tau (T, nv).

    The first ``DIFFERENT`` lie on a random walk, the others come from random starts.
    """

    def __init__(self, problem: Any, assembled: Any) -> None:
        self.rng, self.numbers = np.random.default_rng(1), Numbers(problem, problem.at_start)
        start, self.pose = assembled.q, assembled.closure or ClosedPose(assembled.q)
        manifold, lengths = self.numbers.manifold, self.numbers.lengths
        places, rates, q = [], [], start
        for _ in range(DIFFERENT):
            motion = self._rates(q)[0]
            places.append(q)
            rates.append(motion)
            step = WALK * motion / max(1.0, float(np.abs(motion / lengths).max(initial=0.0)))
            closed = self._closed(manifold.integrate(q, step))
            q = start if closed is None else closed
        rank = len(self._rates(start)[1])
        for _ in range(TRIES if self.numbers.rows else 0):
            step = np.pi * lengths * self.rng.uniform(-1.0, 1.0, size=self.numbers.nv)
            closed = self._closed(manifold.integrate(start, step))
            if closed is not None and len(places) < DIFFERENT + WILD:
                motion, s = self._rates(closed)
                if len(s) == rank and s[-1] > APART * s[0]:
                    places.append(closed)
                    rates.append(motion)
        self.q, self.v = np.array(places), np.array(rates)
        self.tau = self.rng.normal(size=self.v.shape)

    def _rates(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return random rates that keep the loops closed, and the singular values of their rows that count."""
        numbers = self.numbers
        psi = numbers.psi(q) * numbers.lengths if numbers.rows else np.zeros((0, numbers.nv))
        _, s, Vt = np.linalg.svd(psi)
        kept = s[s > self.pose.rank_tolerance * s.max(initial=0.0)]
        free = Vt[len(kept) :].T
        return numbers.lengths * (free @ self.rng.normal(size=free.shape[1])), kept

    def _closed(self, q: np.ndarray) -> np.ndarray | None:
        """Return the closed pose that Newton's method finds from q, None where it finds none."""
        if not self.numbers.rows:
            return q
        closed, gap = newton(self.numbers, q, range(self.numbers.nv), cut=self.pose.cut)
        return np.asarray(closed) if gap < self.pose.tolerance else None

    def many(self, samples: int) -> list[np.ndarray]:
        """Return q, v and tau of so many states of the walk, column-ordered."""
        times = -(-samples // DIFFERENT)
        walk = (x[:DIFFERENT] for x in (self.q, self.v, self.tau))
        return [np.asfortranarray(np.tile(x, (times, 1))[:samples]) for x in walk]


def row_of(report: measure.Report, name: str, path: Path, samples: int, repeats: int) -> dict[str, Any]:
    """Return the figures of one robot, or why it is refused."""
    row: dict[str, Any] = {"robot": name}
    start = time.process_time()
    try:
        scene = scene_of(path, GRAVITY, duration=1.0)
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
    states = States(problem, setup.assembled)
    mechanism, (q, v, tau) = ModelFunctions(scene), states.many(samples)
    calls: dict[str, Any] = {"robodyn": lambda: mechanism.forward_dynamics(q, v, tau)}
    counts = {"robodyn": samples}
    for _ in range(-(-250_000 // samples) if repeats > 3 else 0):  # until the code is compiled for good
        calls["robodyn"]()
    if report.has("pinocchio"):
        every = (states.q, states.v, states.tau)
        given = Given(scene, problem, *every)
        ours = error_of(mechanism, every, given.exact)
        row |= {
            "states": len(states.q),
            "condition": float(given.condition.max()),
            "robodyn_error": float(ours.max()),
            "part": float((ours / given.allowed).max()),
        }
        row |= beside(report, given, calls, counts, samples)
    times = measure.alternate(calls, repeats)
    for engine, seconds in times.items():
        row[f"{engine}_us"] = 1e6 * measure.median(seconds) / counts[engine]
    for engine in [engine for engine in times if engine != "robodyn"]:
        ratio = measure.median_ratio(times[engine], times["robodyn"])
        row[f"{engine}_faster"] = ratio * samples / counts[engine]
    if faster := [row[key] for key in row if key.endswith("_faster")]:
        row["faster"] = min(faster)
    return row


def beside(
    report: measure.Report, given: Given, calls: dict[str, Any], counts: dict[str, int], samples: int
) -> dict[str, float]:
    """Return the largest error of each other engine, and hand over what is to be timed of it."""
    out = {}
    for engine, make in PEERS.items():
        if not report.has(engine):
            continue
        try:
            peer = make(given, DIFFERENT, samples)
        except RobodynError as error:
            print(f"{ENGINES[engine]}: {error.message:.160}", file=sys.stderr)
            continue
        out[f"{engine}_error"] = float(peer.error.max())
        calls[engine], counts[engine] = peer.evaluate, peer.count
    return out


def error_of(mechanism: Any, states: Sequence[np.ndarray], exact: np.ndarray) -> np.ndarray:
    """Return the error of our accelerations at each state, of the largest one there; one by one and many at once."""
    one, many = (
        mechanism.forward_dynamics(*(np.tile(x, (times, 1)) for x in states))
        for times in (1, -(-MANY // len(exact)))
    )
    apart = np.maximum(np.abs(one - exact), np.abs(many[: len(exact)] - exact))
    return np.asarray(apart.max(axis=1) / np.maximum(np.abs(exact).max(axis=1), 1e-300))


# -- stated states -----------------------------------------------------------------------------------------------
def stated(folder: Path, file: Path) -> dict[str, Any] | None:
    """Return our error at the state that a reference states, None for a file that states none."""
    ref = json.loads(file.read_text(encoding="utf-8"))
    if not isinstance(ref, dict) or "state" not in ref:
        return None
    mjcf = "qpos" in ref["state"]
    own = Path(*Path(ref["source"].split()[-1]).parts[-2:])
    path = next(path for path in folder.rglob(own.name) if path.parent.name == own.parent.name)
    path = path / "robot.urdf" if path.is_dir() else path
    with tempfile.TemporaryDirectory() as place:
        if "free joint removed" in ref["base"]:
            text = FREE_BASE.sub("", path.read_text(encoding="utf-8"))
            path = Path(place) / path.name
            path.write_text(text, encoding="utf-8")
        mechanism = ModelFunctions(scene_of(path, ref["gravity"], duration=1.0))
        zeros = at_zero(path) if mjcf else {}
    names, rates = mechanism.q_names, mechanism.qd_names
    q = numbers(ref["state"]["qpos" if mjcf else "q"], names, zeros, 3 * (not mjcf))
    qd = numbers(ref["state"]["qvel" if mjcf else "qd"], rates)
    a = numbers(ref["qacc_hard" if mjcf else "qdd"], rates)
    given = {own_name(name): torque for name, torque in ref.get("torque", {}).items()}
    tau = np.array([given.get(name, 0.0) for name in rates])
    error = float(error_of(mechanism, (q[None], qd[None], tau[None]), a[None])[0])
    allowed = max(ALLOWED, DIGITS * ref.get("cond_reduced_mass", 0.0))
    return {"state of": file.stem, "error": error, "allowed": allowed, "part": error / allowed}


def at_zero(path: Path) -> dict[str, float]:
    """Return the values that coordinates of an MJCF have in the file's poses, from which ours count."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    joints = [model.joint(k) for k in range(model.njnt)]
    return {joint.name: float(joint.qpos0[0]) for joint in joints if len(joint.qpos0) == 1}


def numbers(
    values: dict[str, Any], names: Sequence[str], zeros: dict[str, float] | None = None, last: int = 0
) -> np.ndarray:
    """Return the values of coordinates by a file's names in our order.

    last : where w stands in quaternions.
    """
    out: dict[str, float] = {}
    for name, value in values.items():
        own = own_name(name)
        if isinstance(value, list):
            kinds = ("qw", "qx", "qy", "qz") if len(value) == 4 else ("wx", "wy", "wz")
            turned = (
                [value[last], *(x for k, x in enumerate(value) if k != last)] if len(value) == 4 else value
            )
            out |= {f"{own}.{kind}": x for kind, x in zip(kinds, turned)}
            continue
        if own not in names:  # a universal joint, as two revolute ones
            own = own[:-2] + (".theta2" if f"{own[:-2]}.theta1" in out else ".theta1")
        out[own] = value - (zeros or {}).get(name, 0.0)
    return np.array([out[name] for name in names])


def own_name(name: str) -> str:
    """Return what a name of a file becomes in a scene."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


# -- motions -----------------------------------------------------------------------------------------------------
def motion_of(path: Path, duration: float) -> dict[str, Any]:
    """Return how a motion from the closed pose keeps the loops closed, or why it ends early."""
    scene = scene_of(path, OBLIQUE, duration=duration, singular="pass")
    if not (scene.loops or scene.couplers):
        return {}
    start = time.process_time()
    try:
        summary = simulate(scene).summary
    except RobodynError as error:
        return {"stopped": error.message}
    estimate = summary["error_estimate"]
    return {
        "seconds": time.process_time() - start,
        "steps": summary["counters"]["steps"],
        "closure": summary["constraint_residual"]["position"],
        "rates": summary["constraint_residual"]["velocity"],
        "energy": summary["energy_drift_relative"],
        "state_error": estimate["state_max"],
        "until": estimate.get("meaningful_until", duration),
        "passed": len(summary.get("passed", ())),
    }


# -- tables ------------------------------------------------------------------------------------------------------
SIZES = (("coordinates", "coordinates", "d"), ("rows", "rows", "d"))
TIMES = (
    *SIZES,
    ("closed_s", "read and closed, s", ".2f"),
    *(
        (f"{engine}_us", f"{name} us", ".2f" if engine == "robodyn" else ".1f")
        for engine, name in ENGINES.items()
    ),
    ("faster", "times faster than the next", ".1f"),
)
ERRORS = (
    ("gap", "gap, m or rad", ".0e"),
    ("states", "states", "d"),
    ("condition", "condition", ".0e"),
    *((f"{engine}_error", name, ".0e") for engine, name in ENGINES.items()),
    ("part", "part allowed", ".1g"),
)
STATED = (("error", "error", ".0e"), ("allowed", "allowed", ".0e"), ("part", "part allowed", ".1g"))
MOTIONS = (
    ("closure", "loops open, m or rad", ".0e"),
    ("rates", "rates, m/s or rad/s", ".0e"),
    ("energy", "energy", ".0e"),
    ("state_error", "error estimate", ".0e"),
    ("until", "meaningful, s", ".3g"),
    ("steps", "steps", "d"),
    ("passed", "singular poses", "d"),
    ("seconds", "s", ".1f"),
)


def show(rows: list[dict[str, Any]], columns: Any, first: str = "robot") -> None:
    """Print the rows that have the first of the columns as a table."""
    kept = [row for row in rows if {first, columns[0][0]} <= row.keys()]
    cells = (
        [row[first], *(format(row[key], form) if key in row else "-" for key, _, form in columns)]
        for row in kept
    )
    print(measure.table([[first, *(head for _, head, _ in columns)], *cells]))


def show_all(rows: list[dict[str, Any]]) -> None:
    """Print the tables, and what is behind them."""
    show(rows, TIMES)
    for engine in list(ENGINES)[1:]:
        ratios = [row[f"{engine}_faster"] for row in rows if f"{engine}_faster" in row]
        if ratios:
            mean = float(np.exp(np.log(ratios).mean()))
            print(f"\nfaster than {ENGINES[engine]}: {min(ratios):.1f} times at least, {mean:.1f} in the geometric "
                  f"mean of {len(ratios)}")  # fmt: skip
    print("\nLargest errors, of the largest acceleration at a state:\n")
    show(rows, ERRORS)
    for why in ("refused", "stopped"):
        for row in rows:
            if why in row:
                print(f"\n{row['robot']}: {why}: {row[why]:.300}")
    if any("state of" in row for row in rows):
        print("\nAt the states of the references:\n")
        show(rows, STATED, "state of")
    if any("closure" in row for row in rows):
        print("\n10 s from the closed pose:\n")
        show(rows, MOTIONS)


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=measure.ROOT / "configs" / "robots",
                        help="folder with the robots' files, at any depth")  # fmt: skip
    parser.add_argument("--reference", type=Path, metavar="FOLDER", help="accelerations at states, *.json")
    parser.add_argument("--motion", action="store_true", help="simulate 10 s of each too")
    parser.add_argument("--only", default="", metavar="PART", help="robots with PART in their names")
    options = parser.parse_args()
    samples, repeats = (256, 3) if options.quick else (2048, 11)
    measure.print_machine()
    with measure.reporting(options.json) as report:
        report.more |= {"samples": samples, "repeats": repeats}
        print(f"{samples} states a call, one thread, medians of {repeats} alternating repeats\n")
        for name, path in robots(options.folder, options.only).items():
            with report.part(name):
                report.rows.append(row_of(report, name, path, samples, repeats))
                if options.motion and "refused" not in report.rows[-1]:
                    report.rows[-1] |= motion_of(path, 1.0 if options.quick else 10.0)
            print(f"{name} done", file=sys.stderr, flush=True)
        for file in sorted(options.reference.glob("*_*.json")) if options.reference else ():
            with report.part(file.stem):
                if row := stated(options.folder, file):
                    report.rows.append(row)
        show_all(report.rows)


if __name__ == "__main__":
    main()
