"""The figures of an inverse run, and their errors."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Sequence
from functools import cached_property, lru_cache

import numpy as np

from robodyn_cli.algorithms.polynomials import derivative, real_roots, value
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.given.motion import Planned, knot_places
from robodyn_cli.model.model import TORQUE
from robodyn_cli.observe.rounding import largest_difference
from robodyn_cli.record import record
from robodyn_cli.solve.extremes import (
    Extreme,
    integral,
    largest,
    largest_magnitude,
    positive_integral,
    root_mean_square,
)
from robodyn_cli.solve.quadrature import integrate, spaced, summed
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Absent, LoopResidual
from robodyn_cli.summaries.inverse import InverseErrors, JointErrors, JointFigures
from robodyn_cli.torques.program import InverseProgram, Sampled
from robodyn_cli.trajectories.motion import JointMotion


@record
class Loaded:
    """Columns of joints at uniform times (T,), of one run or of many: torques and rates (T, n). breaks : where torques
    jump or bend, in steps from the first sample."""

    times: Array
    tau: Array
    qd: Array
    breaks: Sequence[float] = ()

    @staticmethod
    def of(problem: Problem, sampled: Sampled) -> Loaded:
        """Return the columns of a run."""
        motion = sampled.motion
        return Loaded(sampled.times, sampled.tau, motion.qd, breaks_of(problem, sampled.times, motion))

    @cached_property
    def power(self) -> Array:
        """Mechanical power (T, n) [W]."""
        return self.tau * self.qd

    @cached_property
    def most(self) -> Extreme:
        """The largest torques."""
        return largest(self.times, self.tau, self.breaks)

    @cached_property
    def least(self) -> Extreme:
        """The smallest torques, with their signs changed."""
        return largest(self.times, -self.tau, self.breaks)

    @cached_property
    def peak(self) -> Extreme:
        """The largest magnitudes of torques."""
        return self.most.or_larger(self.least)

    def largest(self, y: Array) -> tuple[Array, Array]:
        """Return the largest magnitudes (n,) of y (T, n), and their errors."""
        found = largest_magnitude(self.times, y, self.breaks)
        return found.value, found.error

    @cached_property
    def rms(self) -> tuple[Array, Array]:
        """The RMS torques (n,), and their errors."""
        return root_mean_square(self.times, self.tau, self.breaks)


AGREE = 1e-2  # of a step, by which two polynomials of a smooth rate put its root apart at most
APART = 1e-3  # of the mean time between samples, by which times that are told apart differ
LEFT = 1e-3  # of a step, up to which a polynomial of a rate that begins at rest may have roots that are none
LEAST = 1e-100  # of the largest rate: one of which only the sign counts
ROUNDED = 256 * np.finfo(float).eps  # of the fastest joint's rate, up to which rates may be rounding alone
STEPS = 2  # of Newton's method to when a joint turns back, from a place that polynomials tell


# figures (n,) that size an actuator, with their errors, by key below that of its joint in the summary
FIGURES: dict[str, Callable[[Loaded], tuple[Array, Array]]] = {
    "peak_torque": lambda x: (x.peak.value, x.peak.error),
    "peak_torque_time": lambda x: (x.peak.time, x.peak.time_error),
    "rms_torque": lambda x: x.rms,
    "torque_range.0": lambda x: (-x.least.value, x.least.error),
    "torque_range.1": lambda x: (x.most.value, x.most.error),
    "peak_speed": lambda x: x.largest(x.qd),
    "peak_power": lambda x: x.largest(x.power),
    "energy": lambda x: positive_integral(x.times, x.power, x.breaks),
    "energy_net": lambda x: integral(x.times, x.power, x.breaks),
}


def breaks_of(problem: Problem, times: Array, motion: JointMotion) -> list[float]:
    """Return where the torques of a motion jump or bend, in steps from the first sample.

    Payloads come and go, the trajectory has knots, and joints that lose energy turn back.
    """
    return _breaks(problem, times, [x for x, _ in _turns(times, motion, _losing(problem))])


def _losing(problem: Problem) -> set[int]:
    """Return the velocity coordinates on which something acts that loses energy."""
    return {place for place, _ in problem.losses(smooth=False)}


def _breaks(problem: Problem, times: Array, turns: Sequence[float]) -> list[float]:
    return spaced([*knot_places(problem.scene, times), *turns], len(times), jumps(problem, times))


def _turns(times: Array, motion: JointMotion, columns: set[int]) -> list[tuple[float, int]]:
    """Return where joints turn back, in steps from the first sample, each with its column."""
    qd = settled(motion.qd)
    return [(x, k) for k in sorted(columns) for x in turns_of(times, qd[:, k], motion.qdd[:, k])]


def settled(v: Array) -> Array:
    """Return rates (T, n) of which those that rounding alone may make are zero, so that it decides the sign of no loss;
    at the first and the last sample these, and zeros, have the sign of those beside them: losses there are those of
    the motion that begins or ends."""
    rounded = np.abs(v) <= ROUNDED * np.abs(v).max(initial=0.0)
    if not rounded.any():
        return v
    found, least = np.where(rounded, 0.0, v), LEAST * np.abs(v).max(initial=0.0)
    if len(v) > 1:
        for end, beside in ((0, 1), (-1, -2)):
            found[end] = np.where(rounded[end], least * np.sign(found[beside]), found[end])
    return found


def turning(problem: Problem) -> set[int]:
    """Return the velocity coordinates of joints that lose energy, or whose drives do: torques jump where they turn."""
    return _losing(problem) | {problem.model.v_names.index(name) for name in problem.scene.drives}


def crowded_turns(
    problem: Problem, times: Array, motion: JointMotion, at: Callable[[Array], JointMotion] | None = None
) -> list[float]:
    """Return when joints that lose energy, or whose drives do, turn back [s], where one does so near to a knot or to
    another that it is no break; else none.

    at : the motion at other times (T,), for steps of Newton's method; without it they are told less exactly.
    """
    found = _turns(times, motion, turning(problem))
    places, own = [x for x, _ in found], np.array([k for _, k in found], dtype=int)
    turns = _times_of(places, times)
    apart = APART * float(times[-1] - times[0]) / len(times)

    def away(breaks: Sequence[float]) -> Array:
        """Return how far turns are from breaks [s]."""
        distances: Array = np.abs(turns[:, None] - _times_of(breaks, times)).min(axis=1, initial=np.inf)
        return distances

    if not (away(_breaks(problem, times, places)) > apart).any():
        return []
    free = np.flatnonzero(away(_breaks(problem, times, ())) > apart)
    free = free[np.argsort(turns[free])]
    exact = turns[free]
    if at is None:
        return exact.tolist()
    rows = np.arange(1, 1 + len(free))
    for _ in range(STEPS):
        there = at(np.concatenate([times[:1], exact, times[-1:]]))
        step = there.qd[rows, own[free]] / there.qdd[rows, own[free]]
        exact = np.sort(exact - np.clip(step, -apart, apart))
    return exact[np.diff(exact, prepend=-np.inf) > apart].tolist()


def _times_of(places: Sequence[float], times: Array) -> Array:
    """Return the times [s] of places among samples at times (T,), in steps from the first."""
    found: Array = np.interp(places, np.arange(float(len(times))), times)
    return found


def turns_of(times: Array, v: Array, a: Array) -> list[float]:
    """Return where rates v (T,) change their sign, in steps from the first sample, by polynomials with their slopes
    a (T,): cubic ones, and through the samples beside these where that agrees, as it does of smooth rates."""
    sign = np.sign(v)
    rests = 1.0 + np.flatnonzero((sign[1:-1] == 0.0) & (sign[:-2] * sign[2:] < 0.0))
    n = np.flatnonzero(sign[:-1] * sign[1:] < 0.0)
    rise, step = v[n + 1] - v[n], times[n + 1] - times[n]
    low, high = step * a[n], step * a[n + 1]
    cubics = np.array([v[n], low, 3.0 * rise - 2.0 * low - high, low + high - 2.0 * rise])
    roots = real_roots(cubics, np.ones(len(n)))
    inside = roots < 1.0
    one, root = inside.sum(axis=0) == 1, roots.min(axis=0, initial=1.0)
    near = np.clip(n[:, None] + np.arange(-1, 3), 0, len(times) - 1)
    even = np.ptp(np.diff(times[near], axis=1), axis=1) < 1e-6 * step
    known = np.flatnonzero(one & (n > 0) & (n < len(times) - 2) & even)
    near, step = near[known].T, step[known]
    c = np.linalg.solve(_hermite(-1, 4), np.concatenate([v[near], step * a[near]]))[::-1]
    better = root[known]
    for _ in range(3):
        with np.errstate(divide="ignore", invalid="ignore"):
            better = better - value(c, better) / value(derivative(c), better)
    agrees = np.abs(better - root[known]) < AGREE
    roots[:, known[agrees]] = np.where(inside[:, known[agrees]], better[agrees], 1.0)
    begin, end = _behind_rest(times, v, a), _behind_rest(-times[::-1], v[::-1], -a[::-1])
    found: list[float] = np.sort(
        np.concatenate([rests, (n + roots)[inside], begin, len(times) - 1.0 - end])
    ).tolist()
    return found


def _behind_rest(times: Array, v: Array, a: Array) -> Array:
    """Return where rates (T,) that begin at rest turn back before the second sample, in steps: that sample and those
    behind it are on one side. By the polynomial of degree 5 through three samples, where it says more than rounding."""
    largest = np.abs(v).max(initial=0.0)
    if len(v) < 3 or abs(v[0]) > LEAST * largest or np.ptp(np.diff(times[:3])) > 1e-6 * (times[1] - times[0]):
        return np.zeros(0)
    slopes = (times[1] - times[0]) * a[:3]
    c = np.linalg.solve(_hermite(0, 3), np.concatenate([[0.0], v[1:3], slopes]))[::-1, None]
    roots = real_roots(c[1:], np.ones(1))[:, 0]
    turns = np.sort(roots[(roots > LEFT) & (roots < 1.0)])
    before = value(c, 0.5 * turns[:1])
    return turns if (np.abs(before) > ROUNDED * largest).all() else np.zeros(0)


@lru_cache(maxsize=2)
def _hermite(first: int, points: int) -> Array:
    """Return the matrix from a polynomial, highest power first, to its values and slopes at points one apart."""
    x, terms = first + np.arange(float(points)), 2 * points
    slopes = np.vander(x, terms - 1) * np.arange(terms - 1.0, 0.0, -1.0)
    return np.vstack([np.vander(x, terms), np.column_stack([slopes, np.zeros(points)])])


def breaks_of_joint(times: Array, v: Array, a: Array, breaks: Sequence[float]) -> tuple[float, ...]:
    """Return the breaks of a motion with those of one joint, (T,), whose gears and bearings lose otherwise where it
    turns back."""
    return tuple(spaced(turns_of(times, v, a), len(times), breaks))


def jumps(problem: Problem, times: Array) -> list[float]:
    """Return where the torques of a motion jump, in steps from the first sample: where payloads come and go."""
    if not problem.model.payloads:
        return []
    from robodyn_cli.torques.payloads import breaks, events_of

    return breaks(events_of(problem.scene, times), times)


def joint_figures(
    problem: Problem, sampled: Sampled, loaded: Loaded, wanted: Collection[str] = FIGURES
) -> dict[str, JointFigures]:
    """Return the figures that size the actuators, by velocity coordinate; in mechanisms with loops, of actuated joints
    only. Figures that are not wanted are nan.

    peak_torque : largest magnitude, and its time. rms_torque : root of the time average of tau^2. energy : integral of
    the positive mechanical power, which the actuator delivers if it cannot take back any; energy_net : integral of the
    power. Functions are of degree 5 between samples, and in pieces where torques jump (see ``extremes``,
    ``quadrature``).
    """
    model = problem.model
    nothing = np.full(model.nv, np.nan)
    columns = {name: f(loaded) if name in wanted else (nothing, nothing) for name, f in FIGURES.items()}
    figures: dict[str, JointFigures] = {}
    for k in range(model.nv) if sampled.loops is None else sampled.loops.driven:
        unit = model.v_units[k]
        own, off = ({name: float(x[part][k]) for name, x in columns.items()} for part in (0, 1))
        own_range, off_range = ([x.pop("torque_range.0"), x.pop("torque_range.1")] for x in (own, off))
        errors = JointErrors(
            torque_range=max(off_range), **{name: x for name, x in off.items() if name != "energy_net"}
        )
        units = {"torque": TORQUE[unit], "speed": f"{unit}/s", "power": "W", "energy": "J"}
        figures[model.v_names[k]] = JointFigures(**own, torque_range=own_range, errors=errors, units=units)
    return figures


def half_turns(problem: Problem, sampled: Sampled) -> list[str]:
    """Return a warning for each force between bodies whose angle jumps at half a turn along the motion."""
    jumps = problem.elements.half_turns
    change: dict[str, Array] = {}
    for k, (name, _) in enumerate(jumps):
        step = np.diff(sampled.arrays["half_turns"][:, k])
        change[name] = change.get(name, 0.0) + step * step
    jumped = {name: np.flatnonzero(square > np.pi**2) for name, square in change.items()}
    if not jumped:
        return []
    from robodyn_cli.forces.element import half_turn_warning

    return [half_turn_warning(name, sampled.times[at[0] + 1]) for name, at in jumped.items() if at.size]


def path_error(planned: Planned, sampled: Sampled) -> float | Absent:
    """Return the largest distance [m] of the led point from its target, in the coordinates of the target."""
    if planned.target is None:
        return ABSENT
    gap = sampled.arrays[f"points/{planned.point}"][:, : planned.target.shape[1]] - planned.target
    return float(np.sqrt(np.einsum("ti,ti->t", gap, gap).max()))


def attitude_error(problem: Problem, planned: Planned) -> float | Absent:
    """Return the largest angle [rad] by which the led frame is turned against its target."""
    if planned.axes is None or planned.point is None:
        return ABSENT
    from robodyn_cli.algorithms.kinematics import world_pose
    from robodyn_cli.observe.evaluation import SampleFunction
    from robodyn_cli.spatial.quaternion import logarithm

    frame, q = problem.model.place(planned.point), planned.motion.q
    axes = {"R": list(world_pose(problem.model, problem.pose, frame).R.flat)}
    actual = SampleFunction(axes, ("q",), len(q))(q=q)["R"].reshape(-1, 3, 3)
    turn = logarithm(planned.axes @ np.swapaxes(actual, 1, 2))
    return float(np.linalg.norm(turn, axis=1).max())


def error_estimate(
    program: InverseProgram,
    planned: Planned,
    sampled: Sampled,
    loaded: Loaded,
    numbers: ManyNumbers | None = None,
) -> InverseErrors:
    """Return the errors of an inverse run; numbers : those of a run with others than the program was built with.

    ik_residual, attitude_residual : see ``path_error`` and ``attitude_error``. round_trip, torque_rounding : see there.
    energy_balance : work of actuators and losses, less the change of kinetic and potential energy [J]; it is as
        large as the errors of rates, torques and quadrature together. Between samples from one to the other of which
        a payload is gripped or released it is not taken. energy_balance_relative : over the largest
        energy turned over.
    energy_quadrature, rms_quadrature : largest error, due to samples, of energies [J] and of RMS torques [N m or N].
    closure, virtual_work_residual : of the loops; the load that neither actuators nor loops bear [N m or N].
    """
    power = np.column_stack([sampled.power, sampled.arrays["dissipation"]])
    total = sampled.arrays["energy/kinetic"][:, 0] + sampled.arrays["energy/potential"][:, 0]
    balance = energy_balance(power, total, sampled.times, cuts(sampled.p))
    turned = max(float(np.ptp(total)), float(summed(integrate, sampled.times, np.abs(power)).max()), 1e-300)
    loops = sampled.loops
    return InverseErrors(
        ik_residual=path_error(planned, sampled) if loops is None else ABSENT,
        attitude_residual=attitude_error(program.problem, planned),
        torque_rounding=torque_rounding(program, sampled, numbers),
        round_trip=round_trip(program, sampled, numbers),
        energy_balance=balance,
        energy_balance_relative=balance / turned if balance else 0.0,
        energy_quadrature=float(integral(sampled.times, power, loaded.breaks)[1].max()),
        rms_quadrature=float(loaded.rms[1].max()),
        closure=ABSENT if loops is None else LoopResidual(**planned.residuals),
        virtual_work_residual=ABSENT if loops is None else loops.shared.residual,
    )


def energy_balance(power: Array, total: Array, times: Array, at: Sequence[int]) -> float:
    """Return the work of power (T, n) less the change of the energy (T,) [J], over the pieces between cuts."""
    ends = [0, *at, len(total)]
    pieces = [slice(a, b) for a, b in itertools.pairwise(ends) if b - a > 1]
    work = (summed(integrate, times[x], power[x]).sum() for x in pieces)
    return sum(float(done - (total[x][-1] - total[x][0])) for x, done in zip(pieces, work))


def cuts(p: Array) -> list[int]:
    """Return the samples whose parameters p (T, n) are not those of the sample before."""
    return [int(k) + 1 for k in np.flatnonzero(np.any(np.diff(p, axis=0), axis=1))]


def torque_rounding(
    program: InverseProgram, sampled: Sampled, numbers: ManyNumbers | None = None
) -> float | None:
    """Return how far rounding may have put the torque of any actuator off [N m or N], at a few samples.

    None where that cannot be told.
    """
    draws = program.torques_by_draw(sampled, numbers)
    if draws is None:
        return None
    return largest_difference(draws if numbers is None else draws[0])


def round_trip(program: InverseProgram, sampled: Sampled, numbers: ManyNumbers | None = None) -> float | None:
    """Return the relative difference between the accelerations of forward dynamics under the computed torques and
    those of the motion. Relative to the largest acceleration of the given and of a free motion. None where the mass
    matrix is singular.
    """
    accelerations = program.forward(sampled, numbers)
    if accelerations is None:
        return None
    qdd, (again, free) = sampled.motion.qdd, accelerations
    scale = max(float(np.abs(qdd).max()), float(np.abs(free).max()))
    residual = float(np.abs(again - qdd).max())
    if not np.isfinite(residual) or not np.isfinite(scale):
        return None
    return residual / scale if residual else 0.0
