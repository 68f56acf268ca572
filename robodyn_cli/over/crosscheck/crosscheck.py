"""The scene's answer beside that of another engine, with the error of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError, NumericalError, of_option
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.over.commands import command_of, locks
from robodyn_cli.over.crosscheck.engine import PeerEngine, Translation, closures_of, translate
from robodyn_cli.over.crosscheck.own_settings import OWN_ENGINES
from robodyn_cli.ready.singularity import rank_tolerance
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.crosscheck import ComparedQuantity, CrosscheckReport
from robodyn_cli.summaries.facts import ABSENT, Absent
from robodyn_cli.tools.progress import Progress, no_progress
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate

ENGINES = ("pinocchio", "mujoco")
MARGIN = 10.0  # times the two errors together by which answers may differ
FLOOR = 1e-13  # of the largest value: rounding of the comparison itself
SMALL = 1e-9  # rad, m, their rates, N m or N: to allow no more tells something of answers of any size
RTOL = (1e-12, 1e-10)  # of the engine's integration, and of a second one that estimates its error
Compared = tuple[list[ComparedQuantity], float | Absent]  # and the last sample, if not all are compared


def crosscheck(
    scene: Scene, engine: str, command: str | None = None, progress: Progress = no_progress
) -> CrosscheckReport:
    """Run a scene here and in another engine, and compare.

    Parameters
    ----------
    engine : ``pinocchio`` or ``mujoco``. command : ``inverse`` or ``simulate``; by default the scene's, or what it
    gives the data for. progress : is told the time that the engine's motion has reached, and the last one.

    Raises
    ------
    CapabilityError : the engine is not installed, or cannot be asked what the scene says; nothing is compared for the
    scene's command.
    """
    command = command or compared_command(scene)
    moves, compare = COMPARED[command]
    translated = translate(scene, moves)
    other = _engine(engine)(translated.model)
    compared, until = compare(translated, other, progress)
    return CrosscheckReport(
        status=_status([one.agrees for one in compared]),
        title=scene.title or "scene",
        command=command,
        engine=other.name,
        version=other.version,
        compared=compared,
        handed_over=list(translated.given),
        by_own_formulas=list(translated.own),
        compared_until=until,
    )


def _status(agree: Sequence[bool | None]) -> str:
    if False in agree:
        return "differs"
    return "open" if None in agree else "ok"


def refuse_choice(engine: str, own: bool, command: str) -> None:
    """Refuse what is not compared in this way: with an engine's steps and closures (``own``), or by its equations.

    Raises
    ------
    SceneError
    """
    allowed = tuple(OWN_ENGINES) if own else ENGINES
    if engine not in allowed:
        way = "with" if own else "without"
        raise of_option(f"--with {engine}", f"not {way} --own-settings; allowed: {', '.join(allowed)}")
    if own and not COMPARED[command][0]:
        moving = " or ".join(f"--command {name}" for name, (moves, _) in COMPARED.items() if moves)
        raise of_option(
            "--own-settings", f"compares motions, and the command is {command!r}; allowed: {moving}"
        )


def compared_command(scene: Scene) -> str:
    """Return what is compared of a scene; a motion until a lock is a simulation.

    Raises
    ------
    CapabilityError
    """
    command = "simulate" if locks(scene.command) else command_of(scene)
    if command not in COMPARED:
        raise CapabilityError(
            f"crosscheck compares {' and '.join(COMPARED)}, and the scene's command is {command!r}; name "
            "one of them with --command",
            (scene.path,),
            key="command",
        )
    return command


def _engine(name: str) -> Callable[[Any], PeerEngine]:
    if name == "pinocchio":
        from robodyn_cli.over.crosscheck.engines import InPinocchio

        return InPinocchio
    from robodyn_cli.over.crosscheck.engines import InMujoco

    return InMujoco


def _torques(translated: Translation, other: PeerEngine, progress: Progress) -> Compared:
    """Compare the torques along the scene's trajectory.

    The engine's error is M (FD(ID(a)) - a): what its own two algorithms differ by.
    """
    result = inverse(translated.scene)
    handed = translated.evaluator(smooth=False)
    t, q, v, a = result["time"].ravel(), result["q"], result["qd"], result["qdd"]
    theirs, apart = np.empty_like(v), 0.0
    for k in range(len(t)):
        other.bring(q[k], v[k])
        rigid = other.torques(q[k], v[k], a[k])
        back = other.free_accelerations(q[k], v[k], rigid) - a[k]
        apart = max(apart, float(np.abs(other.mass_matrix() @ back).max()))
        given = {"t": [t[k]], "q": q[k].tolist(), "v": v[k].tolist(), "a": a[k].tolist(), "p": []}
        theirs[k] = rigid - translated.plain(q[k], v[k]) - np.array(handed(given), dtype=float)
    own = result.summary["error_estimate"].get("torque_rounding")
    if own is None:
        raise CapabilityError(
            "the torques have no error estimate, so there is nothing to compare a difference with"
        )
    names = translated.model.v_names
    size = float(np.abs(result["tau"]).max(initial=0.0))
    return [_compare("tau", names, (result["tau"], theirs), t, (float(own), apart), size)], ABSENT


def _motion(translated: Translation, other: PeerEngine, progress: Progress) -> Compared:
    """Compare the motion at the samples, before it passes a singular pose, where it may go on in more than one way.

    The engine's accelerations are integrated twice by an explicit pair of order 8; the error of its answer is the
    difference of the two. Both begin at the same state, so the size of the motion is how far it goes from there.
    """
    scene = translated.scene
    result = simulate(scene)
    ours, t = np.column_stack([result["q"], result["qd"]]), result["time"].ravel()
    passed = result.summary.get("passed") or [np.inf]
    same = t < passed[0]
    if same.sum() < 2:
        raise CapabilityError(
            f"the motion passes a singular pose at t = {passed[0]:.6g} s, before its second sample: there is "
            "nothing to compare"
        )
    ours, t, until = ours[same], t[same], ABSENT if same.all() else float(t[same][-1])
    fine, coarse = (_integrated(translated, other, t, ours[0], rtol, progress) for rtol in RTOL)
    nq, estimate = translated.model.nq, result.summary["error_estimate"] or {}
    compared = []
    for quantity, columns, names in (
        ("q", slice(0, nq), translated.model.q_names),
        ("qd", slice(nq, None), translated.model.v_names),
    ):
        own = estimate.get(f"{quantity}_max")
        if own is None:
            raise CapabilityError(
                "the motion has no error estimate (simulate.error_estimate), so there is nothing to compare with"
            )
        apart = float(np.abs(fine[:, columns] - coarse[:, columns]).max())
        pair = ours[:, columns], fine[:, columns]
        size = float(np.abs(pair[0] - pair[0][0]).max())
        compared.append(_compare(quantity, names, pair, t, (float(own), apart), size))
    return compared, until


def _integrated(
    translated: Translation, other: PeerEngine, times: Array, start: Array, rtol: float, progress: Progress
) -> Array:
    """Return states (T, nq + nv) at times (T,): q-dot = N(q) v, v-dot from the engine."""
    from scipy.integrate import solve_ivp

    model, rest = translated.model, translated.rest
    closed = (closures_of(model), translated.couplers, rank_tolerance(rest, start[: model.nq], times[0]))
    handed = translated.evaluator(smooth=True)
    manifold, reached = Manifold(model), float(times[0])

    def rate(t: float, x: Array) -> Array:
        nonlocal reached
        reached = max(reached, t)
        progress(t, float(times[-1]))
        q, v = x[: model.nq], x[model.nq :]
        given = {"t": [t], "q": q.tolist(), "v": v.tolist(), "p": []}
        tau = translated.plain(q, v) + np.array(handed(given), dtype=float)
        return np.concatenate([manifold.rate(q, v), other.accelerations((q, v, tau), *closed)])

    breaks = sorted({x for x in translated.rest.switching.breakpoints if times[0] < x < times[-1]})
    edges = [float(times[0]), *breaks, float(times[-1])]
    states, x = np.empty((len(times), len(start))), start
    for low, high in zip(edges, edges[1:]):
        inside = (times >= low) & (times <= high)
        # further evaluations make a step's polynomial, so it is asked for in steps with samples alone
        asked = np.union1d(times[inside], high)
        try:
            with np.errstate(all="ignore"):  # of a motion that diverges
                run = solve_ivp(
                    rate, (low, high), x, method="DOP853", rtol=rtol, atol=1e-2 * rtol, t_eval=asked
                )
        except np.linalg.LinAlgError as error:
            raise _stopped(reached, str(error)) from error
        if not run.success:
            raise _stopped(reached, run.message)
        states[inside] = run.y.T[np.searchsorted(asked, times[inside])]
        x = run.y[:, -1]
    return states


def _stopped(time: float, why: str) -> NumericalError:
    return NumericalError(f"the other engine's motion stops at t = {time:.6g} s: {why}")


def _compare(
    quantity: str,
    names: tuple[str, ...],
    answers: tuple[Array, Array],
    times: Array,
    errors: tuple[float, float],
    size: float,
) -> ComparedQuantity:
    """Return where answers (T, n) differ most, and whether that is allowed.

    size : of our answer; where more is allowed, an engine in which nothing moves or acts would agree too.
    """
    ours, theirs = answers
    gap = np.abs(ours - theirs)
    row, column = np.unravel_index(int(np.argmax(gap)), gap.shape)
    allowed = MARGIN * sum(errors) + FLOOR * float(np.abs(ours).max(initial=0.0))
    agrees = bool(gap[row, column] <= allowed)
    return ComparedQuantity(
        quantity, names[column], float(times[row]), float(ours[row, column]), float(theirs[row, column]),
        float(gap[row, column]), *errors, allowed, size, None if agrees and allowed >= max(size, SMALL) else agrees,
    )  # fmt: skip


# what is compared, and whether the engine integrates
COMPARED: dict[str, tuple[bool, Callable[[Translation, PeerEngine, Progress], Compared]]] = {
    "inverse": (False, _torques),
    "simulate": (True, _motion),
}
