"""How far another engine is off at its own settings: its run beside our motion, and beside the exact equations at the
states that it comes through."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from robodyn_cli.algorithms.energy import gravity_energy, kinetic_energy, spring_energy
from robodyn_cli.equations.linear.residuals import evaluated
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.over.crosscheck.drake import OwnDrake
from robodyn_cli.over.crosscheck.engine import Translation, is_plain, mass_properties, translate
from robodyn_cli.over.crosscheck.own_engines import OwnMujoco, OwnRun
from robodyn_cli.ready.singularity import rank_tolerance
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Inertia, Scene
from robodyn_cli.solve.closure import rank
from robodyn_cli.solve.load_sharing import constrained
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.crosscheck import (
    ClosureGap,
    EnergyMade,
    OffFromExact,
    OffFromMotion,
    OwnSettingsSummary,
)
from robodyn_cli.summaries.facts import Termination
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.works.simulate import simulate

OWN_ENGINES: dict[str, Callable[[Translation, float | None], OwnRun]] = {
    "mujoco": OwnMujoco,
    "drake": OwnDrake,
}
MOST_STEPS = 100_000
LARGEST = 1e10  # [rad, m or per s]: beyond, MuJoCo itself calls a state unstable
CHUNK = 4_000_000  # numbers of a matrix that are held at once
LIGHT = 1e-6  # of the least mass and the least inertia: what links get that move without any
CHECKED = 16  # states at which accelerations are also computed from the engine's own M and h
EPS = float(np.finfo(float).eps)


def own_settings(
    scene: Scene,
    engine: str,
    step: float | None = None,
    progress: Progress = no_progress,
    watch: Stopwatch | None = None,
) -> Result:
    """Run a scene here and in another engine as its users run it, and tell how far that is off.

    Parameters
    ----------
    engine : ``mujoco`` or ``drake``. step : of the engine [s]; None for its default.

    Raises
    ------
    CapabilityError : the engine is not installed, or cannot have the mechanism. NumericalError : it gives no step.
    """
    watch = watch or Stopwatch()
    with watch.stage("equations"):
        scene, light = with_masses(scene, translate(scene, simulated=True).model)
        translated = translate(scene, simulated=True)
        other = OWN_ENGINES[engine](translated, step)
        count = _steps(scene, other.step)
    with watch.stage("integrate"):
        settings = dataclasses.replace(scene.simulate, duration=count * other.step, samples=count + 1)
        ours = simulate(dataclasses.replace(scene, simulate=settings))
    with watch.stage("engine"):
        run = _run(translated, other, ours["q"][0], ours["qd"][0], count, progress)
    with watch.stage("compare"):
        return _compared(translated, other, ours, run, watch, light)


def with_masses(scene: Scene, model: Model) -> tuple[Scene, list[str]]:
    """Return a scene in which no body moves without mass, as engines need it, and the links that got some: a small part
    of the least there is. Both answers are of this scene."""
    known = {body.name: mass_properties(body) for body in model.bodies}
    bare = {name: I.any() for name, (m, _, I) in known.items() if m == 0.0}
    heavy = [(m, float(np.linalg.eigvalsh(I).max())) for m, _, I in known.values() if m > 0.0]
    if not bare or not heavy:
        return scene, []
    m, moment = (LIGHT * min(x for x in column if x > 0.0) for column in zip(*heavy))
    inertia = Inertia(xx=moment, yy=moment, zz=moment, xy=0.0, xz=0.0, yz=0.0)
    links = tuple(
        dataclasses.replace(
            link, mass=m, com=(0.0, 0.0, 0.0), inertia=link.inertia if bare[link.name] else inertia
        )
        if link.name in bare
        else link
        for link in scene.robot.links
    )
    robot = dataclasses.replace(scene.robot, links=links)
    return dataclasses.replace(scene, robot=robot), [link.name for link in links if link.name in bare]


def _steps(scene: Scene, step: float) -> int:
    """Return how many steps of the engine lie in the duration.

    Raises
    ------
    CapabilityError : none, or too many.
    """
    duration = float(scene.simulate.duration)
    count = int(duration / step * (1.0 + 8.0 * EPS))
    if not 1 <= count <= MOST_STEPS:
        raise CapabilityError(
            f"simulate.duration {duration:g} s is {duration / step:.6g} steps of {step:g} s; "
            f"allowed: 1 to {MOST_STEPS} (--step)",
            (scene.path,),
            key="simulate.duration",
        )
    return count


@record
class OwnStates:
    """A run of an engine: q (T, nq) and v (T, nv), and of the step from each state the torques ``tau`` (T, nv) that it
    was handed, the accelerations ``a`` (T, nv) and the step of positions ``dq`` (T, nv).

    ended : why the run ended.
    """

    q: Array
    v: Array
    tau: Array
    a: Array
    dq: Array
    ended: str


def _run(
    translated: Translation, other: OwnRun, q: Array, v: Array, count: int, progress: Progress
) -> OwnStates:
    """Return the states after 0 to ``count`` steps; one more step gives the last its acceleration.

    Raises
    ------
    NumericalError : the first step already gives no state.
    """
    handed, manifold = translated.evaluator(smooth=True), Manifold(translated.model)
    states, torques, rates = [(q, v)], [], []
    other.start(q, v)
    ended = "end of the duration"
    for k in range(count + 1):
        given = {"t": [k * other.step], "q": q.tolist(), "v": v.tolist(), "p": []}
        tau = np.array(handed(given), dtype=float)
        try:
            q, v, a = other.advance(tau)
        except NumericalError as error:
            ended = error.message
            break
        if not np.abs([*q, *v, *a]).max() < LARGEST:
            ended = f"{other.name} blows up: a position, rate or acceleration is no number, or above {LARGEST:.0e}"
            break
        torques.append(tau)
        rates.append(a)
        states.append((q, v))
        progress(k * other.step, count * other.step)
    if not torques:
        raise NumericalError(f"in the first step of {other.step:g} s {ended}")
    Q, V = (np.array(x) for x in zip(*states))
    dq = np.array([manifold.difference(a, b) for a, b in zip(Q, Q[1:])])
    return OwnStates(Q[:-1], V[:-1], np.array(torques), np.array(rates), dq, ended)


# -- the exact equations ---------------------------------------------------------------------------------------
@record
class ExactValues:
    """What the equations give at states: accelerations (T, nv), energies (T,) [J] and eta (T, m).

    apart : largest difference of the accelerations from those by the engine's own M and h.
    """

    a: Array
    kinetic: Array
    potential: Array
    eta: Array
    apart: float


def _exact(translated: Translation, other: OwnRun, run: OwnStates, times: Array) -> ExactValues:
    """Return the exact equations at the states of a run; rows of loops keep the rank that they have at its start."""
    problem = Problem(translated.scene, model=translated.model)
    sprung = dataclasses.replace(
        problem.model,
        bodies=tuple(
            dataclasses.replace(body, forces=tuple(f for f in body.forces if is_plain(f)))
            for body in problem.model.bodies
        ),
    )
    nv = problem.model.nv
    outputs = {
        "M": problem.mass_matrix,
        "h": problem.bias,
        "f": problem.applied,
        "psi": problem.constraints.psi(nv),
        "gamma": problem.constraints.gamma,
        "eta": problem.constraints.eta,
        "kinetic": [kinetic_energy(problem.model, problem.q, problem.v)],
        "potential": [
            gravity_energy(problem.model, problem.q, problem.gravity) + spring_energy(sprung, problem.q)
        ],
    }
    parts, kept, apart = [], None, 0.0
    pieces = np.array_split(np.arange(len(times)), -(-len(times) * nv * nv // CHUNK))
    checked = set(np.linspace(0, len(times) - 1, CHECKED).astype(int).tolist())
    for piece in pieces:
        groups = {"t": times[piece, None], "q": run.q[piece], "v": run.v[piece]}
        if problem.at_start:
            groups["p"] = np.tile(problem.at_start, (len(piece), 1))
        values = evaluated(outputs, groups)
        if kept is None:
            kept = rank(values["psi"][0], rank_tolerance(problem, run.q[0], times[0]))
        psi, gamma = of_rank(values["psi"], values["gamma"], kept)
        a = _solved(values["M"], values["f"] - values["h"], psi, gamma)
        parts.append((a, values["kinetic"][:, 0], values["potential"][:, 0], values["eta"]))
        for k in checked & set(piece.tolist()):
            at = slice(k - piece[0], k - piece[0] + 1)
            M, h = other.inertia(run.q[k], run.v[k])
            theirs = _solved(M[None], values["f"][at] - h, psi[at], gamma[at])
            apart = max(apart, float(np.abs(theirs - a[at]).max()))
    a, kinetic, potential, eta = (np.concatenate(x) for x in zip(*parts))
    return ExactValues(a, kinetic, potential, eta, apart)


def of_rank(psi: Array, gamma: Array, rank: int) -> tuple[Array, Array]:
    """Return rows Psi (T, m, nv) and gamma (T, m) of a rank: the nearest ones.

    Rows that depend on each other where loops are closed no longer do where they are open, and ask for accelerations
    without bound.
    """
    if rank == psi.shape[1]:
        return psi, gamma
    U, s, Vt = np.linalg.svd(psi, full_matrices=False)
    U, s, Vt = U[:, :, :rank], s[:, :rank], Vt[:, :rank]
    return (U * s[:, None]) @ Vt, (U @ (np.swapaxes(U, 1, 2) @ gamma[..., None]))[..., 0]


def _solved(M: Array, force: Array, psi: Array, gamma: Array) -> Array:
    """Return v-dot (T, nv) of M v-dot = force + Psi^T lambda, Psi v-dot + gamma = 0."""
    if not psi.shape[1]:
        return np.linalg.solve(M, force[..., None])[..., 0]
    return constrained(M, psi, force[..., None], -gamma[..., None])[0][..., 0]


# -- what is told ----------------------------------------------------------------------------------------------
def _compared(
    translated: Translation, other: OwnRun, ours: Result, run: OwnStates, watch: Stopwatch, light: list[str]
) -> Result:
    model, count = translated.model, len(run.q)
    times = ours.time[:count]
    exact = _exact(translated, other, run, times)
    result = Result.of("crosscheck", translated.scene)
    result.add("time", times)
    result.add("crosscheck/q", run.q, names=model.q_names)
    result.add("crosscheck/qd", run.v, names=model.v_names)
    summary = OwnSettingsSummary(
        termination=Termination(run.ended, float(times[-1])),
        engine=other.name,
        version=other.version,
        settings=other.settings,
        step=other.step,
        steps=count - 1,
        closures=_gaps(result, translated, exact.eta, ours, count),
        accelerations=_accelerations(result, model.v_names, exact, run, ours, other.step),
        energy=_energy(result, translated, exact, run, ours, other.step),
        joints=_offsets(result, translated, run, ours),
        handed_over=list(translated.given),
        of_the_engine=list(translated.own),
        with_small_mass=light,
    )
    result.summarise(summary, seconds=watch.report())
    return result


def _gaps(result: Result, translated: Translation, eta: Array, ours: Result, count: int) -> list[ClosureGap]:
    """Store and return how far the closures are open: distances, angles, and what couplers are off by."""
    problem = Problem(translated.scene, model=translated.model)
    groups: dict[tuple[str, str], list[int]] = {}
    for k, row in enumerate(problem.constraints.rows):
        groups.setdefault((row.closure, row.unit), []).append(k)
    if not groups:
        return []
    there = {"t": ours.time[:, None], "q": ours["q"]}
    if problem.at_start:
        there["p"] = np.tile(problem.at_start, (len(ours.time), 1))
    own = evaluated({"eta": problem.constraints.eta}, there)["eta"][:count]
    theirs, here = (
        np.column_stack([np.linalg.norm(x[:, rows], axis=1) for rows in groups.values()]) for x in (eta, own)
    )
    names = tuple(f"{name} ({'distance' if unit == 'm' else 'angle'})" for name, unit in groups)
    units = tuple(unit for _, unit in groups)
    result.add("crosscheck/gap", theirs, names=names, column_units=units)
    result.add("crosscheck/gap_here", here, names=names, column_units=units)
    gaps = []
    for k, (name, unit) in enumerate(groups):
        at = int(np.argmax(theirs[:, k]))
        gaps.append(
            ClosureGap(
                name, unit, float(theirs[at, k]), float(result.time[at]), float(theirs[0, k]), float(theirs[-1, k]),
                float(here[:, k].max()),
            )
        )  # fmt: skip
    return gaps


def _share(x: float, whole: float) -> float | None:
    """Return a part of a whole; None of nothing."""
    return x / whole if whole > 0.0 else None


def _accelerations(
    result: Result, names: tuple[str, ...], exact: ExactValues, run: OwnStates, ours: Result, step: float
) -> OffFromExact:
    """Store and return by how much the engine's accelerations differ from the exact ones."""
    off = np.abs(run.a - exact.a)
    size, first = float(np.abs(ours["qdd"]).max()), float(np.abs(exact.a[0]).max())
    row, column = np.unravel_index(int(np.argmax(off)), off.shape)
    error = exact.apart + 4.0 * EPS * float(np.abs(run.v).max()) / step
    result.add("crosscheck/qdd", run.a, names=names)
    result.add("crosscheck/exact_qdd", exact.a, names=names)
    if size > 0.0:
        result.add("crosscheck/acceleration_error", off.max(axis=1) / size)
    return OffFromExact(
        float(off[0].max()), _share(float(off[0].max()), first), names[int(np.argmax(off[0]))],
        float(off[row, column]), _share(float(off[row, column]), size), names[column], float(result.time[row]),
        size, error,
    )  # fmt: skip


def _energy(
    result: Result, translated: Translation, exact: ExactValues, run: OwnStates, ours: Result, step: float
) -> EnergyMade:
    """Store and return the energy that is made (positive) or lost, less the work of torques and dampers.

    Torques are constant over a step, so their work is tau . dq; that of dampers is summed by the trapezoidal rule.
    """
    still, one = np.zeros(translated.model.nv), np.eye(translated.model.nv)
    at = run.q[0]
    damping = np.array(
        [translated.plain(at, still)[j] - translated.plain(at, one[j])[j] for j in range(len(one))]
    )
    work = np.concatenate([[0.0], np.cumsum((run.tau * run.dq).sum(axis=1))[:-1]])
    power = (damping * run.v**2).sum(axis=1)
    lost = _sums(power, step)
    change = exact.kinetic + exact.potential
    made = change - change[0] - work + lost
    every_other = np.abs(_sums(power[::2], 2.0 * step) - lost[::2]).max() / 3.0
    level = max(float(np.abs(x).max()) for x in (exact.kinetic, exact.potential, work, lost))
    error = float(every_other) + 4.0 * EPS * np.sqrt(len(made)) * level
    kinetic, k = float(ours["energy/kinetic"].max()), int(np.argmax(np.abs(made)))
    balance = ours["energy/total"]
    if "energy/work" in ours:
        balance = balance - ours["energy/work"]
    here = float(np.abs(balance - balance[0]).max())
    result.add("crosscheck/energy_made", made)
    if kinetic > 0.0:
        result.add("crosscheck/energy_error", np.abs(made) / kinetic)
    largest, final = float(made[k]), float(made[-1])
    return EnergyMade(
        largest, _share(abs(largest), kinetic), float(result.time[k]), final, kinetic, error, here
    )


def _sums(power: Array, step: float) -> Array:
    """Return the integral (T,) of samples since the first, by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * step * (power[1:] + power[:-1]))])


def _offsets(result: Result, translated: Translation, run: OwnStates, ours: Result) -> list[OffFromMotion]:
    """Store and return how far the joints are from our motion, turns and slides apart."""
    model, manifold = translated.model, Manifold(translated.model)
    off = np.array([manifold.difference(a, b) for a, b in zip(ours["q"], run.q)])
    result.add("q", ours["q"][: len(off)], names=model.q_names, column_units=model.q_units)
    result.add("crosscheck/offset", off, names=model.v_names, column_units=model.v_units)
    error = (ours.summary.get("error_estimate") or {}).get("q_max")
    found = []
    for unit in dict.fromkeys(model.v_units):
        columns = [k for k, one in enumerate(model.v_units) if one == unit]
        part = np.abs(off[:, columns])
        row, column = np.unravel_index(int(np.argmax(part)), part.shape)
        found.append(
            OffFromMotion(
                unit, float(part[row, column]), model.v_names[columns[column]], float(result.time[row]),
                float(part[-1].max()), error,
            )
        )  # fmt: skip
    return found
