"""``linearise``: a scene as x-dot = A x + B u, y = C x + D u about a state, a balance, or along a motion; its poles and
modes, what its inputs reach and its outputs show, and all of it as datasets."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from robodyn_cli.control.lqr import reached
from robodyn_cli.equations.linear.poles import pole_errors, without_rounding
from robodyn_cli.equations.linear.reduce import Linear, linearise_states
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError, of_option
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.observe.evaluation import refuse_result
from robodyn_cli.observe.units import JointColumns, add_motion
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import mechanism_size
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Termination
from robodyn_cli.summaries.linear import (
    LargestGrowth,
    LinearErrors,
    LinearInstant,
    LinearSummary,
    Mode,
)
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.trajectories.motion import JointMotion
from robodyn_cli.works.linearise.errors import errors_of_accelerations
from robodyn_cli.works.linearise.nominal import Nominal, Question, nominal
from robodyn_cli.works.linearise.sampled import ModelOptions, add_closed_loop, add_sampled, sampling_of
from robodyn_cli.works.linearise.signals import LinearOutputs, input_signals, state_signals
from robodyn_cli.works.linearise.systems import Systems, add_matrices, add_responses
from robodyn_cli.works.loops.loop import ControlLoop

if TYPE_CHECKING:
    from typing_extensions import Unpack

PARALLEL = 1e-6  # so little may the motions of a mode at 0 differ: its position and its rate have a pole each
ALIKE = 1e-9  # relative difference of sizes up to which poles count as equally fast
BLIND = 1e-8  # a mode this weakly reached or shown, relative, is not reached or shown at all


def slowest_first(poles: Array) -> list[int]:
    """Return the places of poles (n,) by their size; of equal ones, as s and -s, those that decay most come first."""
    sizes = np.abs(poles)
    order = np.argsort(sizes, kind="stable")
    sizes = sizes[order]
    group = np.cumsum(np.diff(sizes, prepend=sizes[:1]) > ALIKE * sizes)
    places: list[int] = order[np.lexsort((poles[order].real, group))].tolist()
    return places


def modes_of(linear: Linear, sample: int, C: Array, names: Sequence[str]) -> list[Mode]:
    """Return the modes of the system at a sample, slowest first; C (outputs, 2n), names : of all coordinates.

    A free motion, of position and rate, is one mode at 0, of multiplicity 2.
    """
    A, B, dq = linear.A[sample], linear.B[sample], linear.dq[sample]
    raw, vectors = np.linalg.eig(A)
    errors = pole_errors(A, linear.rounding[sample], raw)
    poles = without_rounding(raw, errors)
    modes: list[Mode] = []
    free: list[tuple[int, Array]] = []  # modes at 0 by their place among those found
    for k in slowest_first(poles):
        s, motion = complex(poles[k]), dq @ vectors[: dq.shape[1], k]
        if s.imag < 0.0:
            continue
        if not s:
            same = next((place for place, other in free if _parallel(motion, other)), None)
            if same is not None:
                modes[same] = dataclasses.replace(modes[same], multiplicity=modes[same].multiplicity + 1)
                continue
            free.append((len(modes), motion))
        size = abs(s)
        modes.append(
            Mode(
                s.real, s.imag, float(errors[k]), 1, size / math.tau, 0.0 - s.real / size if size else None,
                1.0 / abs(s.real) if abs(s.real) > BLIND * size else None, *_off_mode(s, float(errors[k])),
                _shape(motion, names), reached(A, B, s, BLIND), reached(A.T, C.T, s, BLIND),
            )
        )  # fmt: skip
    return modes


def _off_mode(s: complex, off: float) -> tuple[float, float | None, float | None]:
    """Return the errors of frequency, damping and time of a pole s that is off by ``off``."""
    size, real = abs(s), abs(s.real)
    turned = 2.0 * off / size if size > off else 2.0  # no direction changes by more than the chord
    damping = min(turned, 2.0) if size else None
    return off / math.tau, damping, off / (real * (real - off)) if real > off else None


def _parallel(a: Array, b: Array) -> bool:
    """Tell whether two motions are the same but for their size."""
    sizes = float(np.linalg.norm(a) * np.linalg.norm(b))
    return bool(abs(np.vdot(a, b)) >= (1.0 - PARALLEL) * sizes)


def _shape(motion: Array, names: Sequence[str]) -> dict[str, list[float]]:
    """Return amplitude and phase of each coordinate, relative to the largest."""
    if not len(motion):
        return {}
    k = int(np.argmax(np.abs(motion)))
    relative = motion / motion[k] if motion[k] else motion
    return {name: [float(abs(x)), float(np.angle(x))] for name, x in zip(names, relative)}


def stability_of(modes: Sequence[Mode]) -> str:
    """Return ``stable``, ``unstable``, or ``marginal``: some modes neither decay nor grow."""
    if any(m.real > 0.0 for m in modes):
        return "unstable"
    return "stable" if all(m.real < 0.0 for m in modes) else "marginal"


SWING = 0.25  # rad, or a part of the size of the mechanism: how far a drawn mode goes
CLOSING = 12  # steps that close the loops of a drawn mode


def add_poses(result: Result, given: Nominal, modes: Sequence[Mode]) -> None:
    """Store the poses on both sides of each mode."""
    if modes:
        model = given.problem.model
        columns = JointColumns(model.q_names, model.q_units, ("mode", "side", "position"))
        result.add("modes/q", np.array([_swung(given, mode) for mode in modes]), **columns.described())


def _swung(given: Nominal, mode: Mode) -> list[Array]:
    """Return the poses (nq,) on both sides of a mode, with the loops closed."""
    problem, q = given.problem, given.states.q[0]
    model = problem.model
    step = np.array([size * np.cos(phase) for size, phase in mode.shape.values()])
    room = np.array([SWING if unit == "rad" else SWING * mechanism_size(model) for unit in model.v_units])
    step *= 1.0 / max(float((np.abs(step) / room).max(initial=0.0)), 1e-300) if step.any() else 0.0
    manifold = Manifold(model)
    return [_closed(problem, manifold, manifold.integrate(q, side * step)) for side in (1.0, -1.0)]


def _closed(problem: Problem, manifold: Manifold, q: Array) -> Array:
    """Return q with the loops closed by steps of least norm, as far as they go."""
    for _ in range(CLOSING if problem.constraints.rows else 0):
        eta = problem.numbers(problem.constraints.eta, q)
        q = manifold.integrate(q, -np.linalg.pinv(problem.numbers(problem.psi, q), rcond=1e-6) @ eta)
    return q


ABOUT = ("state", "balance", "hold", "motion", "controller")
REST = 1e-8  # an acceleration this small beside that of the freed weights counts as none
NEAR = 1e-9  # s beyond the ends of a motion that still count as the ends


@np.errstate(all="ignore")  # ``refuse_result`` names numbers that are not finite
def linearise(
    scene: Scene,
    *,
    about: str | Sequence[float] | None = None,
    progress: Progress = no_progress,
    watch: Stopwatch | None = None,
    **of: Unpack[ModelOptions],
) -> Result:
    """Linearise a scene in minimal coordinates, exactly.

    Parameters
    ----------
    about : ``state``, the initial one; ``balance``, the one that ``statics`` finds from there; ``hold``, the initial
        pose at rest with constant torques of the inputs; ``controller``, the pose that the controller is to keep;
        ``motion``, all samples of the scene's ``simulate`` or ``inverse``; or times of that motion [s], at whose
        nearest samples modes and frequency responses are wanted too. By default ``controller`` where there is one,
        else ``state``.
    inputs : coordinates whose torques are inputs; the actuated ones by default.
    outputs : coordinates, ``qd.NAME``, points and ``outputs.signals``; all coordinates by default.
    period, delay : of the model that is sampled with a hold [s]; by default those of the controller.

    Returns
    -------
    A Result with ``linear/A`` to ``linear/D``, poles, and for a state or at instants modes and frequency responses;
    with a period ``discrete/A`` to ``discrete/D``; of a scene with a controller ``loop/A`` to ``loop/D``, and margins.

    Raises
    ------
    SceneError : an unknown name. CapabilityError : a part without a linear model, or no freedom is left.
    NumericalError, GeometryError : there is no such state.
    """
    kind, instants = _asked(scene, about)
    watch = watch or Stopwatch()
    given, measured = prepared(scene, Question(kind, *_names(of)), watch)
    samples = _samples_at(given.states.times, instants) if kind == "motion" else [0]
    with watch.stage("linearise"):
        linear = linearise_states(given.equations, given.states, given.inputs, given.places)
        C, D = measured.matrices(given.states, linear, given.inputs)
        modes = [modes_of(linear, k, C[k], given.problem.model.v_names) for k in samples]
        loop = _loop(scene, given)
    progress(0.0, 0.0)
    result = Result.of("linearise", scene)
    still = given.states
    add_motion(result, given.problem.model, still.times, JointMotion(still.q, still.v, linear.a))
    systems = Systems(given, linear, C, D, measured.signals)
    add_matrices(result, systems)
    add_responses(result, systems, samples, [mode for each in modes for mode in each])
    if not systems.along:
        add_poses(result, given, modes[0])
    discrete = add_sampled(result, systems, sampling_of(scene, of.get("period"), of.get("delay")))
    with watch.stage("margins"):
        records = [] if loop is None else [add_closed_loop(result, scene, given, loop)]
    summary = dataclasses.replace(_summary(result, systems, samples, modes), discrete=discrete or ABSENT)
    result.summarise(summary, *records, seconds=watch.report())
    refuse_result(result)
    return result


def _names(of: ModelOptions) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return tuple(of.get("inputs", ())), tuple(of.get("outputs", ()))


def _asked(scene: Scene, about: str | Sequence[float] | None) -> tuple[str, tuple[float, ...]]:
    """Return what is linearised about, and instants of the motion.

    Raises
    ------
    SceneError : there is nothing of this name.
    """
    about = about_of(scene) if about is None else about
    instants = () if isinstance(about, str) else tuple(about)
    kind = about if isinstance(about, str) else "motion"
    if kind not in ABOUT:
        raise SceneError(f"about {about!r}; allowed: {', '.join(ABOUT)}, times of the motion [s]")
    if kind == "controller" and scene.control is None:
        raise SceneError("about 'controller': the scene has none; allowed: state, balance, hold, motion")
    return kind, instants


def about_of(scene: Scene) -> str:
    """Return what a scene is linearised about unless something else is asked."""
    return "state" if scene.control is None else "controller"


def _loop(scene: Scene, given: Nominal) -> ControlLoop | None:
    """Return the loop of the controller; None without one that has a law, and along a motion."""
    if scene.control is None or given.about == "motion" or scene.control.type == "python":
        return None
    from robodyn_cli.works.loops.loop import loop_of

    return loop_of(integrable(scene), given.equations, given.states, given.places, given.about)


def prepared(scene: Scene, question: Question, watch: Stopwatch) -> tuple[Nominal, LinearOutputs]:
    """Return the states about which a scene is linearised, and what is measured there.

    Raises
    ------
    RobodynError : see ``linearise``.
    """
    given = nominal(scene, question, watch)
    if not given.places:
        raise CapabilityError(
            "nothing can move: the loops and prescribed joints leave no freedom to linearise"
        )
    return given, LinearOutputs(given.problem, given.torques, question.outputs)


def _samples_at(times: Array, instants: Sequence[float]) -> list[int]:
    """Return the samples (each once) that are nearest to instants of a motion.

    Raises
    ------
    SceneError : an instant before or after the motion.
    """
    for instant in instants:
        if not times[0] - NEAR <= instant <= times[-1] + NEAR:
            raise of_option(
                "--instants", f"{instant:g} s is outside the motion; allowed: {times[0]:g} to {times[-1]:g} s"
            )
    nearest = [int(np.argmin(np.abs(times - instant))) for instant in instants]
    return list(dict.fromkeys(nearest))


def _summary(
    result: Result, systems: Systems, samples: Sequence[int], modes: list[list[Mode]]
) -> LinearSummary:
    given, linear, outputs = systems.given, systems.linear, systems.outputs
    model, states = given.problem.model, given.states
    one = not systems.along
    growth = result["linear/poles_real"].max(axis=-1, keepdims=one)
    k = int(np.argmax(growth))
    acceleration = float(np.abs(linear.a[0][list(linear.places)]).max(initial=0.0))
    held, held_errors = _holding(given)
    off = (
        errors_of_accelerations(given.equations, states, given.off) if one and given.off is not None else None
    )
    chosen = [
        LinearInstant(float(states.times[k]), stability_of(each), each)
        for k, each in zip(samples, modes)
        if systems.along
    ]
    return LinearSummary(
        termination=Termination("linearised", float(states.times[-1])),
        samples=len(states),
        about=given.about,
        freedoms=len(given.places),
        configuration=dict(zip(model.q_names, states.q[0].tolist())) if one else ABSENT,
        rates=dict(zip(model.v_names, states.v[0].tolist())) if one else ABSENT,
        accelerations=dict(zip(model.v_names, linear.a[0].tolist())) if one else ABSENT,
        units=model.coordinate_units if one else ABSENT,
        holding_torques=held or ABSENT,
        holding_torques_error=held_errors or ABSENT,
        largest_acceleration=acceleration if one else ABSENT,
        largest_acceleration_error=(None if off is None else float(off[list(linear.places)].max()))
        if one
        else ABSENT,
        error_estimate=_errors(given, off) if one else ABSENT,
        states=state_signals(model, given.places),
        inputs=input_signals(model, given.inputs),
        measured=outputs,
        stability=stability_of(modes[0]) if one else ABSENT,
        modes=modes[0] if one else ABSENT,
        growth=ABSENT if one else _growth(result, k),
        instants=chosen or ABSENT,
        discrete=ABSENT,
        warnings=(_warnings(given, linear, modes[0], acceleration) if one else []) or ABSENT,
    )


def _errors(given: Nominal, a: Array | None) -> LinearErrors:
    """Return the errors of the state, and of accelerations a (nv,), by coordinate; None where they are not known."""
    model, off = given.problem.model, given.off
    q, v = (None, None) if off is None else (off.q, off.v)
    named = (model.q_names, q), (model.v_names, v), (model.v_names, a)
    return LinearErrors(
        *(dict.fromkeys(names) if x is None else dict(zip(names, x.tolist())) for names, x in named)
    )


def _growth(result: Result, sample: int) -> LargestGrowth:
    """Return the pole farthest to the right at a sample of a motion."""
    real = result["linear/poles_real"][sample]
    k = int(np.argmax(real))
    return LargestGrowth(
        float(real[k]), float(result["linear/poles_error"][sample][k]), float(result.time[sample])
    )


def _holding(given: Nominal) -> tuple[dict[str, float], dict[str, float | None]]:
    """Return the constant torques that keep the pose, by coordinate: of inputs, or of joints that stay at a balance;
    and their errors."""
    from robodyn_cli.works.equilibria import staying_places

    if given.about not in ("hold", "balance"):
        return {}, {}
    places = given.inputs if given.about == "hold" else staying_places(given.problem)
    names, off = given.problem.model.v_names, given.off
    torques = {names[k]: float(given.states.tau[0, k]) for k in places}
    return torques, {names[k]: None if off is None else float(off.tau[k]) for k in places}


def _warnings(given: Nominal, linear: Linear, modes: list[Mode], acceleration: float) -> list[str]:
    """Return what a reader of the linear system should know."""
    texts = []
    speed = float(np.abs(given.states.v[0]).max(initial=0.0))
    size = float(np.abs(linear.A[0]).max(initial=0.0))
    if acceleration > REST * max(size, 1.0) or speed > 0.0:
        texts.append(
            f"the state is no equilibrium (rates up to {speed:.3g}, accelerations up to {acceleration:.3g}): "
            "the system tells how neighbouring motions differ for a short time; see --at balance and --hold"
        )
    if not given.inputs:
        texts.append("no joint is actuated, so there is no input; name some with --input")
    for blind, lack in (
        ([m for m in modes if not m.reached], "the inputs do not reach (uncontrollable)"),
        ([m for m in modes if not m.shown], "the outputs do not show (unobservable)"),
    ):
        if blind and (given.inputs or "outputs" in lack):
            poles = ", ".join(f"{complex(m.real, m.imaginary):.4g}" for m in blind)
            texts.append(f"{lack}: the modes with poles {poles} 1/s")
    return texts
