"""``linearise``: a scene as x-dot = A x + B u, y = C x + D u about a state, a balance, or along a motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.linear.reduce import Linear, linearise_states
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import ABSENT, Absent, Termination
from robodyn_cli.run.linear.modes import (
    Mode,
    frequencies_for,
    modes_of,
    response,
    stability_of,
)
from robodyn_cli.run.linear.nominal import Nominal, Question, nominal
from robodyn_cli.run.linear.signals import Outputs, Signal, input_signals, state_signals
from robodyn_cli.run.observation.finite import refuse_result
from robodyn_cli.run.observation.units import add_motion
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import mechanism_size
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.motion import JointMotion

REST = 1e-8  # an acceleration this small beside that of the freed weights counts as none
SWING = 0.25  # rad, or a part of the size of the mechanism: how far a drawn mode goes
CLOSING = 12  # steps that close the loops of a drawn mode


@record
class Growth:
    """The pole farthest to the right along a motion [1/s], and when [s]."""

    largest: float
    time: float


@record
class LinearSummary:
    """The summary of ``linearise`` (see docs/cli.md)."""

    termination: Termination
    samples: int
    about: str
    freedoms: int
    configuration: dict[str, float] | Absent
    rates: dict[str, float] | Absent
    holding_torques: dict[str, float] | Absent
    largest_acceleration: float | Absent
    states: list[Signal]
    inputs: list[Signal]
    outputs: list[Signal]
    stability: str | Absent
    modes: list[Mode] | Absent
    growth: Growth | Absent
    warnings: list[str] | Absent


@np.errstate(all="ignore")  # ``refuse_result`` names numbers that are not finite
def linearise(
    scene: Scene,
    *,
    about: str = "state",
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
        ``inverse``. inputs : coordinates whose torques are inputs; the actuated ones by default. outputs :
        coordinates, ``qd.NAME`` and points; all coordinates by default.

    Returns
    -------
    A Result with ``linear/A`` to ``linear/D``, poles, and for a state modes and frequency response.

    Raises
    ------
    SceneError : an unknown name. CapabilityError : a part without a linear model, or no freedom is left.
    NumericalError, GeometryError : there is no such state.
    """
    if about not in ("state", "balance", "hold", "motion"):
        raise SceneError(f"about {about!r}; allowed: state, balance, hold, motion")
    watch = watch or Stopwatch()
    given = nominal(scene, Question(about, tuple(inputs), tuple(outputs)), watch)
    if not given.places:
        raise CapabilityError(
            "nothing can move: the loops and prescribed joints leave no freedom to linearise"
        )
    measured = Outputs(given.problem, outputs)
    with watch.stage("linearise"):
        linear = linearise_states(given.equations, given.states, given.inputs, given.places)
        C = measured.matrices(given.states, linear)
    progress(0.0, 0.0)
    result = Result.of("linearise", scene)
    still = given.states
    add_motion(result, given.problem.model, still.times, JointMotion(still.q, still.v, linear.a))
    _add_matrices(result, given, linear, C, measured.signals)
    modes = _add_modes(result, given, linear, C) if about != "motion" else None
    result.summarise(_summary(given, linear, measured.signals, modes), seconds=watch.report())
    refuse_result(result)
    return result


def _add_matrices(
    result: Result, given: Nominal, linear: Linear, C: Array, outputs: Sequence[Signal]
) -> None:
    """Store A to D and the poles, of one state or along a motion."""
    model = given.problem.model
    states = [s.name for s in state_signals(model, given.places)]
    inputs = [s.name for s in input_signals(model, given.inputs)]
    D = np.zeros((len(C), len(outputs), len(inputs)))
    along = given.about == "motion"
    for name, matrix, rows, columns, names in (
        ("A", linear.A, "state", "state", states), ("B", linear.B, "state", "input", inputs),
        ("C", C, "output", "state", states), ("D", D, "output", "input", inputs),
    ):  # fmt: skip
        if not names:
            continue
        # two axes of a file may not have one name
        across = f"{columns}_column" if rows == columns else columns
        result.add(
            f"linear/{name}", matrix if along else matrix[0], units="SI", names=tuple(names),
            dims=(*(("time",) if along else ()), rows, across), long_name=f"{name} of the linear system",
        )  # fmt: skip
    poles = np.sort_complex(np.linalg.eigvals(linear.A))
    for name, part in (("real", poles.real), ("imaginary", poles.imag)):
        result.add(
            f"linear/poles_{name}", part if along else part[0], units="1/s",
            dims=(*(("time",) if along else ()), "pole"), long_name=f"{name} parts of the poles",
        )  # fmt: skip


def _add_modes(result: Result, given: Nominal, linear: Linear, C: Array) -> list[Mode]:
    """Store the frequency response and the poses of the modes; return the modes."""
    A, B = linear.A[0], linear.B[0]
    model = given.problem.model
    modes = modes_of(A, B, C[0], linear.dq[0], model.v_names)
    if given.inputs:
        w = frequencies_for(modes)
        found = response(A, B, C[0], np.zeros((len(C[0]), B.shape[1])), w)
        result.add("linear/frequency", w, units="rad/s", dims=("frequency",), long_name="angular frequency")
        inputs = tuple(model.v_names[k] for k in given.inputs)
        for name, part, unit in (("real", found.real, "SI"), ("imaginary", found.imag, "SI")):
            result.add(
                f"linear/response_{name}", part, units=unit, dims=("frequency", "output", "input"), names=inputs,
                long_name=f"{name} part of outputs over inputs",
            )  # fmt: skip
    if modes:
        result.add(
            "modes/q", np.array([_swung(given, mode) for mode in modes]), units="rad or m",
            dims=("mode", "side", "position"), names=model.q_names,
            long_name="poses in which a mode is drawn, loops closed",
        )  # fmt: skip
    return modes


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


def _summary(
    given: Nominal, linear: Linear, outputs: list[Signal], modes: list[Mode] | None
) -> LinearSummary:
    model, states = given.problem.model, given.states
    growth = np.linalg.eigvals(linear.A).real.max(axis=1)
    k = int(np.argmax(growth))
    one = modes is not None
    acceleration = float(np.abs(linear.a[0][list(linear.places)]).max(initial=0.0))
    held = {model.v_names[i]: float(states.tau[0, i]) for i in given.inputs}
    return LinearSummary(
        termination=Termination("linearised", float(states.times[-1])),
        samples=len(states),
        about=given.about,
        freedoms=len(given.places),
        configuration=dict(zip(model.q_names, states.q[0].tolist())) if one else ABSENT,
        rates=dict(zip(model.v_names, states.v[0].tolist())) if one else ABSENT,
        holding_torques=held if given.about == "hold" else ABSENT,
        largest_acceleration=acceleration if one else ABSENT,
        states=state_signals(model, given.places),
        inputs=input_signals(model, given.inputs),
        outputs=outputs,
        stability=ABSENT if modes is None else stability_of(modes),
        modes=ABSENT if modes is None else modes,
        growth=ABSENT if one else Growth(float(growth[k]), float(states.times[k])),
        warnings=_warnings(given, linear, modes, acceleration) or ABSENT,
    )


def _warnings(given: Nominal, linear: Linear, modes: list[Mode] | None, acceleration: float) -> list[str]:
    """Return what a reader of the linear system should know."""
    if modes is None:
        return []
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
