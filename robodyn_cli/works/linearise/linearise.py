"""``linearise``: a scene as x-dot = A x + B u, y = C x + D u about a state, a balance, or along a motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.linear.reduce import Linear, linearise_states
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.observe.evaluation import refuse_result
from robodyn_cli.observe.units import add_motion
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Termination
from robodyn_cli.summaries.linear import LargestGrowth, LinearInstant, LinearSummary, Mode
from robodyn_cli.tools.progress import Progress, no_progress
from robodyn_cli.tools.stopwatch import Stopwatch
from robodyn_cli.trajectories.motion import JointMotion
from robodyn_cli.works.linearise.modes import modes_of, stability_of
from robodyn_cli.works.linearise.nominal import Nominal, Question, nominal
from robodyn_cli.works.linearise.signals import LinearOutputs, input_signals, state_signals
from robodyn_cli.works.linearise.stored import Systems, add_matrices, add_poses, add_responses

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
        holding_torques=held or ABSENT,
        largest_acceleration=acceleration if one else ABSENT,
        states=state_signals(model, given.places),
        inputs=input_signals(model, given.inputs),
        outputs=outputs,
        stability=stability_of(modes[0]) if one else ABSENT,
        modes=modes[0] if one else ABSENT,
        growth=ABSENT if one else LargestGrowth(float(growth[k]), float(states.times[k])),
        instants=chosen or ABSENT,
        warnings=(_warnings(given, linear, modes[0], acceleration) if one else []) or ABSENT,
    )


def _holding(given: Nominal) -> dict[str, float]:
    """Return the constant torques that keep the pose, by coordinate: of inputs, or of joints that stay at a balance."""
    from robodyn_cli.works.balance import staying_places

    if given.about not in ("hold", "balance"):
        return {}
    places = given.inputs if given.about == "hold" else staying_places(given.problem)
    return {given.problem.model.v_names[k]: float(given.states.tau[0, k]) for k in places}


def _warnings(given: Nominal, linear: Linear, modes: list[Mode], acceleration: float) -> list[str]:
    """Return what a reader of the linear system should know."""
    found = []
    speed = float(np.abs(given.states.v[0]).max(initial=0.0))
    size = float(np.abs(linear.A[0]).max(initial=0.0))
    if acceleration > REST * max(size, 1.0) or speed > 0.0:
        found.append(
            f"the state is no equilibrium (rates up to {speed:.3g}, accelerations up to {acceleration:.3g}): "
            "the system tells how neighbouring motions differ for a short time; see --at balance and --hold"
        )
    if not given.inputs:
        found.append("no joint is actuated, so there is no input; name some with --input")
    for blind, what in (
        ([m for m in modes if not m.reached], "the inputs do not reach (uncontrollable)"),
        ([m for m in modes if not m.shown], "the outputs do not show (unobservable)"),
    ):
        if blind and (given.inputs or "outputs" in what):
            poles = ", ".join(f"{complex(m.real, m.imaginary):.4g}" for m in blind)
            found.append(f"{what}: the modes with poles {poles} 1/s")
    return found
