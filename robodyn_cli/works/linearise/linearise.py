"""``linearise``: a scene as x-dot = A x + B u, y = C x + D u about a state, a balance, or along a motion; its poles and
modes, what its inputs reach and its outputs show, and all of it as datasets."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.control.lqr import reached
from robodyn_cli.equations.linear.poles import pole_errors, poles_of, without_rounding
from robodyn_cli.equations.linear.reduce import Linear, linearise_states
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.observe.evaluation import refuse_result
from robodyn_cli.observe.units import JointColumns, add_motion
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import mechanism_size
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Termination
from robodyn_cli.summaries.linear import LargestGrowth, LinearInstant, LinearSignal, LinearSummary, Mode
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.trajectories.motion import JointMotion
from robodyn_cli.works.linearise.nominal import (
    LinearOutputs,
    Nominal,
    Question,
    input_signals,
    nominal,
    state_signals,
)

PARALLEL = 1e-6  # so little may the motions of a mode at 0 differ: its position and its rate have a pole each
BLIND = 1e-8  # a mode this weakly reached or shown, relative, is not reached or shown at all
POINTS = 400  # of a frequency response
BEYOND = 10.0  # how far it goes beyond the slowest and the fastest pole


def poles_along(linear: Linear) -> tuple[Array, Array]:
    """Return the poles (T, 2n) of linear systems, from left to right, and their errors (T, 2n) [1/s]."""
    found = [poles_of(*each) for each in zip(linear.A, linear.rounding)]
    return np.array([poles for poles, _ in found]), np.array([errors for _, errors in found])


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
    for k in sorted(range(len(poles)), key=lambda k: (abs(poles[k]), poles[k].real)):
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
                1.0 / abs(s.real) if abs(s.real) > BLIND * size else None,
                _shape(motion, names), reached(A, B, s, BLIND), reached(A.T, C.T, s, BLIND),
            )
        )  # fmt: skip
    return modes


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


def frequencies_for(modes: Sequence[Mode]) -> Array:
    """Return angular frequencies (F,) [rad/s] that show what the modes do."""
    sizes = [math.tau * m.frequency for m in modes if m.frequency > 0.0] or [1.0]
    return np.geomspace(min(sizes) / BEYOND, max(sizes) * BEYOND, POINTS)


def response(A: Array, B: Array, C: Array, D: Array, frequencies: Array) -> Array:
    """Return C (j w E - A)^-1 B + D (F, outputs, inputs) at angular frequencies (F,) [rad/s]."""
    left = 1j * frequencies[:, None, None] * np.eye(len(A)) - A
    responses: Array = C @ np.linalg.solve(left, np.broadcast_to(B, (len(frequencies), *B.shape))) + D
    return responses


SWING = 0.25  # rad, or a part of the size of the mechanism: how far a drawn mode goes
CLOSING = 12  # steps that close the loops of a drawn mode

OF_ROW = "of the row"  # unit of an entry of a matrix, before that of its column


@record
class Systems:
    """x-dot = A x + B u, y = C x + D u at T states: C (T, outputs, 2n), D (T, outputs, inputs), and what y is."""

    given: Nominal
    linear: Linear
    C: Array
    D: Array
    outputs: list[LinearSignal]

    @property
    def along(self) -> bool:
        """Whether the states are those of a motion."""
        return self.given.about == "motion"


def add_matrices(result: Result, systems: Systems) -> None:
    """Store A to D and the poles, of one state or along a motion."""
    given, linear, along = systems.given, systems.linear, systems.along
    model = given.problem.model
    states, inputs = state_signals(model, given.places), input_signals(model, given.inputs)
    for name, matrix, rows, columns, signals in (
        ("A", linear.A, "state", "state", states), ("B", linear.B, "state", "input", inputs),
        ("C", systems.C, "output", "state", states), ("D", systems.D, "output", "input", inputs),
    ):  # fmt: skip
        if not signals:
            continue
        # two axes of a file may not have one name
        row = "of the row per s" if rows == "state" else OF_ROW
        across = f"{columns}_column" if rows == columns else columns
        result.add(
            f"linear/{name}", matrix if along else matrix[0], names=tuple(s.name for s in signals),
            units=f"{row}, over that of the column", column_units=tuple(f"{row}, per {s.unit}" for s in signals),
            dims=(*(("time",) if along else ()), rows, across),
        )  # fmt: skip
    poles, errors = poles_along(linear)
    for name, part in (("real", poles.real), ("imaginary", poles.imag), ("error", errors)):
        dims = ("time", "pole") if along else ("pole",)
        result.add(f"linear/poles_{name}", part if along else part[0], dims=dims)


def add_responses(result: Result, systems: Systems, samples: Sequence[int], modes: Sequence[Mode]) -> None:
    """Store the frequency responses at samples, over frequencies that show what ``modes`` do."""
    given, linear, along = systems.given, systems.linear, systems.along
    if not given.inputs or not samples:
        return
    w = frequencies_for(modes)
    responses = np.array([response(linear.A[k], linear.B[k], systems.C[k], systems.D[k], w) for k in samples])
    result.add("linear/frequency", w)
    if along:
        result.add("linear/instant", given.states.times[list(samples)])
    inputs = input_signals(given.problem.model, given.inputs)
    for name, part in (("real", responses.real), ("imaginary", responses.imag)):
        result.add(
            f"linear/response_{name}", part if along else part[0], names=tuple(s.name for s in inputs),
            units=f"{OF_ROW}, over that of the column", column_units=tuple(f"{OF_ROW}, per {s.unit}" for s in inputs),
            dims=(*(("instant",) if along else ()), "frequency", "output", "input"),
        )  # fmt: skip


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


REST = 1e-8  # an acceleration this small beside that of the freed weights counts as none
NEAR = 1e-9  # s beyond the ends of a motion that still count as the ends


@np.errstate(all="ignore")  # ``refuse_result`` names numbers that are not finite
def linearise(
    scene: Scene,
    *,
    about: str | Sequence[float] = "state",
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    progress: Progress = no_progress,
    watch: Stopwatch | None = None,
) -> Result:
    """Linearise a scene in minimal coordinates, exactly.

    Parameters
    ----------
    about : ``state``, the initial one; ``balance``, the one that ``statics`` finds from there; ``hold``, the initial
        pose at rest with constant torques of the inputs; ``motion``, all samples of the scene's ``simulate`` or
        ``inverse``; or times of that motion [s], at whose nearest samples modes and frequency responses are wanted too.
    inputs : coordinates whose torques are inputs; the actuated ones by default.
    outputs : coordinates, ``qd.NAME``, points and ``outputs.signals``; all coordinates by default.

    Returns
    -------
    A Result with ``linear/A`` to ``linear/D``, poles, and for a state or at instants modes and frequency responses.

    Raises
    ------
    SceneError : an unknown name. CapabilityError : a part without a linear model, or no freedom is left.
    NumericalError, GeometryError : there is no such state.
    """
    instants = () if isinstance(about, str) else tuple(about)
    kind = about if isinstance(about, str) else "motion"
    if kind not in ("state", "balance", "hold", "motion"):
        raise SceneError(f"about {about!r}; allowed: state, balance, hold, motion, times of the motion [s]")
    watch = watch or Stopwatch()
    given, measured = prepared(scene, Question(kind, tuple(inputs), tuple(outputs)), watch)
    samples = _samples_at(given.states.times, instants) if kind == "motion" else [0]
    with watch.stage("linearise"):
        linear = linearise_states(given.equations, given.states, given.inputs, given.places)
        C, D = measured.matrices(given.states, linear, given.inputs)
        modes = [modes_of(linear, k, C[k], given.problem.model.v_names) for k in samples]
    progress(0.0, 0.0)
    result = Result.of("linearise", scene)
    still = given.states
    add_motion(result, given.problem.model, still.times, JointMotion(still.q, still.v, linear.a))
    systems = Systems(given, linear, C, D, measured.signals)
    add_matrices(result, systems)
    add_responses(result, systems, samples, [mode for each in modes for mode in each])
    if not systems.along:
        add_poses(result, given, modes[0])
    result.summarise(_summary(result, systems, samples, modes), seconds=watch.report())
    refuse_result(result)
    return result


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
            raise SceneError(
                f"--instants: {instant:g} s is outside the motion; allowed: {times[0]:g} to {times[-1]:g} s"
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
    held = _holding(given)
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
        units=model.coordinate_units if one else ABSENT,
        holding_torques=held or ABSENT,
        largest_acceleration=acceleration if one else ABSENT,
        states=state_signals(model, given.places),
        inputs=input_signals(model, given.inputs),
        measured=outputs,
        stability=stability_of(modes[0]) if one else ABSENT,
        modes=modes[0] if one else ABSENT,
        growth=ABSENT if one else LargestGrowth(float(growth[k]), float(states.times[k])),
        instants=chosen or ABSENT,
        warnings=(_warnings(given, linear, modes[0], acceleration) if one else []) or ABSENT,
    )


def _holding(given: Nominal) -> dict[str, float]:
    """Return the constant torques that keep the pose, by coordinate: of inputs, or of joints that stay at a balance."""
    from robodyn_cli.works.equilibria import staying_places

    if given.about not in ("hold", "balance"):
        return {}
    places = given.inputs if given.about == "hold" else staying_places(given.problem)
    return {given.problem.model.v_names[k]: float(given.states.tau[0, k]) for k in places}


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
