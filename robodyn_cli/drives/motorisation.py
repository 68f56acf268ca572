"""Margins of motorisation: the torque available over the factored resistance, in poses and along a motion.

For a driven joint k, with the motion R_k of all joints while it moves alone, sigma the sign of its rate, and tau_i the
torques (nv,) of each thing i that acts on the joints,

    A = sigma sum_drive R_k . tau_i,      W_i = max(0, -sigma R_k . tau_i),
    ratio = (A - sum_outside g_i W_i) / sum_i f_i W_i,

which has to be at least ``required``. What helps the motion, but does not drive it, counts for nothing. A joint with
an entry of ``drives`` is driven with what motors and gears can give at its rate, in place of what is asked of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.commands import COMMANDS
from robodyn_cli.drives.directions import SLOW, begun, directed, driven_joints
from robodyn_cli.drives.report import Accurate, Moved, following, given_by_drives, judge
from robodyn_cli.drives.rivals import ratios_with_rivals
from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import Exerted, exerted
from robodyn_cli.errors import CapabilityError, SceneError, unknown_data
from robodyn_cli.model.model import MOTION_GROUPS, unknown_among
from robodyn_cli.model.parts import trains
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.observe.units import JointColumns, joint_columns
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.schema.fields import DRIVE
from robodyn_cli.solve.crossings import crossing
from robodyn_cli.solve.extremes import Extreme, smallest
from robodyn_cli.solve.quadrature import gaps_between, spaced
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.apart import with_others
from robodyn_cli.summaries.drives import MotorisationFigures, MotorisationKeys, Ratio, RatioErrors
from robodyn_cli.summaries.facts import ABSENT, JOINT
from robodyn_cli.torques.checks import settled

EXACT = 1e-12  # part of the torques by which rounding and the closure of loops put them off
CONTROL, DRIVES = "control", "drives"  # what acts by no expression of the equations


def with_motorisation(
    records: list[Any],
    result: Result,
    problem: Problem,
    moved: Moved,
    looked: Moved | None = None,
    again: Accurate = None,
) -> list[Any]:
    """Return the records of a motion's summary with the margins of its driven joints behind them; add their datasets to
    the result, and its status.

    looked : the motion where figures are looked at, by default at the samples. again : those of more accurate
    integrations, and times the difference of figures is their error.
    """
    inertia = False if COMMANDS[result.command].streamed else "tau" in result or None
    margins = JointMargins.of(problem, moved, inertia)
    margins.add_to(result)
    own = margins if looked is None else JointMargins.of(problem, looked, inertia)
    figures = own.figures()
    if again is not None or (looked is not None and looked.sparse):
        runs, factor = again or ((), 0.0)
        others = [JointMargins.of(problem, other, inertia).figures() for other in runs]
        grown = with_others(figures, others, factor, ("motorisation", JOINT))
        figures = {name: _still_unknown(grown[name], one) for name, one in figures.items()}
    figures = own.with_rivals(figures)
    judge(result, all(one.met for one in figures.values()))
    return [*records, MotorisationKeys(figures)]


def _still_unknown(grown: Any, one: Any) -> Any:
    """Return a record with errors of ratios that grew, but for those that were not known: these stay so."""
    if one is ABSENT:
        return grown
    unknown = {"ratio": None} if one.errors.ratio is None else {}
    changed = dataclasses.replace(grown, errors=dataclasses.replace(grown.errors, **unknown))
    if not isinstance(one, MotorisationFigures):
        return changed
    parts = {
        kind: _still_unknown(getattr(changed, kind), getattr(one, kind)) for kind in ("static", "dynamic")
    }
    return dataclasses.replace(changed, **parts)


def acting(problem: Problem, inertia: bool | None) -> dict[str, Exerted]:
    """Return what acts on the joints of a scene, where a command can give margins of motorisation.

    Torques of drives and of the controller are told apart from motions alone: here they are 1 where they act.

    inertia : whether that of the motion counts, False where it follows from the torques, None where only poses count.

    Raises
    ------
    CapabilityError : it has gears with losses, or masses that come and go. SceneError : nothing drives, or data are
    missing.
    """
    scene = problem.scene
    for there, what in (
        (
            geared(problem.model),
            "losses of gears, which follow from the load; allowed: friction, and `drives`",
        ),
        (
            any(payload.changes for payload in scene.payloads),
            "payloads that come and go; allowed: carried ones",
        ),
    ):
        if there:
            raise CapabilityError(
                f"a margin knows no {what}", (scene.path, "motorisation"), key="motorisation"
            )
    every = exerted(problem, inertia=inertia is True)
    every = {name: one for name, one in every.items() if name.removeprefix("torques.") not in scene.drives}
    controlled = scene.control.joints if inertia is False and scene.control is not None else ()
    for name, joints in ((CONTROL, [x for x in controlled if x not in scene.drives]), (DRIVES, scene.drives)):
        if joints:
            every[name] = Exerted(DRIVE, [float(x in joints) for x in problem.model.v_names])
    if not any(one.role == DRIVE for one in every.values()):
        raise SceneError(
            "nothing drives; give `torques`, `drives`, or a force with `role: drive`",
            (scene.path, "motorisation"),
            key="motorisation",
        )
    missing = unknown_among([x for one in every.values() for x in one.torque])
    if missing:
        raise unknown_data(missing)
    return every


@record
class RatioSides:
    """Both sides of a ratio of driven joints (T, n), the torque available less what stands outside, and the factored
    resistance; size : of all that enters them. shares : factored resistance by what resists (T, n, k). along : torques
    (T, n, k) of that along the motion, which resist where they are negative."""

    available: Array
    resistance: Array
    size: Array
    shares: Array
    along: Array

    @property
    def slope(self) -> Array:
        """The angle whose tangent is the ratio, which has no poles; a right angle where nothing resists."""
        nothing = np.hypot(self.available, self.resistance) <= EXACT * self.size.max(axis=0)
        free: Array = np.where(nothing, 0.5 * np.pi, np.arctan2(self.available, self.resistance))
        return free


class ActingTorques:
    """What acts on the joints (see ``acting``), and Psi of the loops, as functions of samples.

    follows : whether the motion follows from the torques, and has accelerations that jump with them.
    """

    def __init__(self, problem: Problem, inertia: bool | None, samples: int) -> None:
        self.problem, self.inertia, self.every = problem, inertia, acting(problem, inertia)
        self.trains, self.follows = trains(problem.scene), inertia is False
        held = problem.constraints.prescribed
        rows = [row.psi for k, row in enumerate(problem.constraints.rows) if k not in held]
        outputs = {name: one.torque for name, one in self.every.items() if name not in (CONTROL, DRIVES)}
        outputs["psi"], self.rows = [x for row in rows for x in row], len(rows)
        self.function = SampleFunction(outputs, MOTION_GROUPS, samples)


@record
class JointMargins:
    """The sides of the ratios of driven joints, by place among the velocities, in poses and along a motion."""

    problem: Problem
    moved: Moved
    driven: tuple[int, ...]
    resisting: tuple[str, ...]
    sides: dict[str, RatioSides]
    acts: ActingTorques

    @staticmethod
    def of(problem: Problem, moved: Moved, inertia: bool | None) -> JointMargins:
        """Return those of a motion; inertia : whether its own counts, None where only poses do."""
        return JointMargins.along(ActingTorques(problem, inertia, len(moved.times)), moved)

    @staticmethod
    def along(acts: ActingTorques, moved: Moved) -> JointMargins:
        """Return those of a motion, with what acts in it."""
        problem, inertia, every, function = acts.problem, acts.inertia, acts.every, acts.function
        times, nv = moved.times, problem.model.nv
        v = directed(moved.qd)

        def call(v: Array, a: Array) -> dict[str, Array]:
            return function(t=times[:, None], q=moved.q, v=v, a=a, p=np.zeros((len(times), 0)))

        arrays = call(SLOW * v, 0.0 * moved.qdd)
        psi = arrays["psi"].reshape(len(times), acts.rows, nv)
        independent, driven = driven_joints(problem, every, psi[len(psi) // 2])
        R = following(psi, independent)
        if R is None:
            raise CapabilityError(
                "the loops lose rank in the motion", (problem.scene.path, "motorisation"), key="motorisation"
            )
        R = R[:, :, list(driven)]

        def sides(v: Array, a: Array) -> RatioSides:
            arrays = call(v, a)
            if CONTROL in every:
                names = [name for name in arrays if name.startswith("torques.")]
                beside = moved.tau - sum((arrays[name] for name in names), np.zeros_like(moved.tau))
                arrays[CONTROL] = np.array(every[CONTROL].torque, dtype=float) * beside
            if DRIVES in every:
                arrays[DRIVES] = given_by_drives(problem, acts.trains, v)
            torques = np.stack([arrays[name] for name in every], axis=2)
            return _sides(problem, list(every.values()), R, torques, v[:, list(driven)])

        v = begun(v, R, driven, arrays, every)
        kinds = {"static": sides(SLOW * v, 0.0 * moved.qdd)}
        if inertia is not None:
            kinds["dynamic"] = sides(v, moved.qdd)
        resisting = tuple(name for name, one in every.items() if one.role != DRIVE)
        return JointMargins(problem, moved, driven, resisting, kinds, acts)

    def figures(self) -> dict[str, MotorisationFigures]:
        """Return the figures by joint."""
        names, required = self.problem.model.v_names, self.problem.scene.motorisation.required
        found = {}
        for column, k in enumerate(self.driven):
            ratios, met = {}, True
            for kind in self.sides:
                ratios[kind], slope = self._least(kind, column, k)
                met = met and bool(slope >= np.arctan(required) - EXACT)
            least = min(ratios.values(), key=lambda x: np.inf if x.ratio is None else x.ratio)
            own = {f.name: getattr(least, f.name) for f in dataclasses.fields(Ratio)}
            static, dynamic = ratios["static"], ratios.get("dynamic", ABSENT)
            found[names[k]] = MotorisationFigures(
                **own, required=required, met=met, static=static, dynamic=dynamic
            )
        return found

    def with_rivals(self, figures: Mapping[str, MotorisationFigures]) -> dict[str, MotorisationFigures]:
        """Return figures with errors of places that cover where else ratios are as small, but for their errors."""
        found, model = {}, self.problem.model
        for column, k in enumerate(self.driven):
            name = model.v_names[k]
            q = self.moved.q[:, model.q_names.index(name)] if name in model.q_names else None
            slopes = {kind: sides.slope[:, column] for kind, sides in self.sides.items()}
            found[name] = ratios_with_rivals(figures[name], self.moved.times, slopes, q)
        return found

    @cached_property
    def breaks(self) -> dict[str, tuple[float, ...]]:
        """Where torques jump or bend by kind of ratio, in steps from the first sample: friction where any joint turns
        back, and along a motion what motors and gears can give at corners of their envelope too."""
        moved, names = self.moved, self.problem.model.v_names
        rates = settled(moved.qd)
        for v, a in zip(rates.T, moved.qdd.T):
            moved = dataclasses.replace(moved, breaks=moved.breaks_of(v, a))
        found = {"static": moved.breaks}
        for name, train in self.acts.trains.items():
            v, a = (x[:, names.index(name)] for x in (rates, moved.qdd))
            for corner in train.corners:
                breaks = moved.breaks_of(np.abs(v) - corner, np.sign(v) * a)
                moved = dataclasses.replace(moved, breaks=breaks)
        return {**found, "dynamic": moved.breaks}

    def _bends(self, kind: str, column: int) -> dict[float, float]:
        """Return where what resists a joint begins or ceases to, which bends the ratio: places in steps from the first
        sample, each with its error [s]."""
        times, sides = self.moved.times, self.sides[kind]
        least, jumps = EXACT * sides.size[:, column].max(), np.zeros(len(times), dtype=bool)
        jumps[np.array(self.breaks[kind], dtype=int)] = True  # it jumps there
        jumps[gaps_between(times)] = True
        found: dict[float, float] = {}
        for y in sides.along[:, column].T:
            sign = np.where(np.abs(y) <= least, 0.0, np.sign(y))
            passed = (sign[:-1] * sign[1:] < 0.0) & (np.diff(times) > 0.0) & ~jumps[:-1]
            n = np.flatnonzero(passed)
            part, off = crossing(times, y, n)
            found |= zip((n + part).tolist(), (off * (times[n + 1] - times[n])).tolist())
        return found

    def _least(self, kind: str, column: int, k: int) -> tuple[Ratio, float]:
        """Return the least ratio of a joint, and the angle whose tangent it is."""
        moved, sides, bends = self.moved, self.sides[kind], self._bends(kind, column)
        slope, breaks = sides.slope[:, column], spaced(bends, len(moved.times), self.breaks[kind])
        least: Extreme = smallest(moved.times, slope[:, None], breaks)
        value, error, time, time_error, at = (
            float(x[0]) for x in (least.value, least.error, least.time, least.time_error, least.at)
        )
        late = max((off for place, off in bends.items() if abs(place - at) < 1.0), default=0.0)
        if self.acts.follows and moved.times[-1] > moved.times[0]:
            late = max(late, self._turn_error(time))
        if late > 0.0:
            beside = [self._interval(time, k) for k in (-1, 1)]
            error += late * float(np.abs(np.diff(slope)[beside] / np.diff(moved.times)[beside]).max())
            time_error += late
        n = int(np.argmin(np.abs(moved.times - time)))
        shares = sides.shares[n, column]
        with np.errstate(divide="ignore", invalid="ignore"):
            rounding = EXACT * sides.size[n, column] / np.hypot(sides.available, sides.resistance)[n, column]
        error += float(rounding) if np.isfinite(rounding) else EXACT
        resists = -0.5 * np.pi < value < 0.5 * np.pi and float(shares.max(initial=0.0)) > 0.0
        ratio = float(np.tan(value)) if resists else None
        off: float | None = None
        if ratio is not None and value - error > -0.5 * np.pi:
            most = min(value + error, float(slope.min()) + EXACT)  # of samples, none is less than the least
            off = float(
                max(np.tan(most) - ratio if most < 0.5 * np.pi else 0.0, ratio - np.tan(value - error))
            )
        angle, angle_error = self._position(k, time, time_error)
        decides = self.resisting[int(np.argmax(shares))] if resists else None
        return Ratio(ratio, time, angle, decides, RatioErrors(off, time_error, angle_error)), value

    def _interval(self, time: float, further: int = 0) -> int:
        """Return the interval between samples with a time, or one further on; both sides of a jump have none."""
        times = self.moved.times
        smooth = np.diff(times) > 0.0
        smooth[gaps_between(times)] = False
        long = np.flatnonzero(smooth)
        n = int(np.searchsorted(times[long], time, side="right")) - 1 + further
        return int(long[np.clip(n, 0, len(long) - 1)])

    def _turn_error(self, time: float) -> float:
        """Return how far it is not known when a joint turns back [s], at a time: its acceleration jumps there, so it is
        between where the tangents of both sides have no rate."""
        times, v, a = self.moved.times, self.moved.qd, self.moved.qdd
        n = self._interval(time)
        h = float(times[n + 1] - times[n])
        turning = v[n] * v[n + 1] < 0.0
        if not turning.any():
            return 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            roots = np.stack([times[n] - v[n] / a[n], times[n + 1] - v[n + 1] / a[n + 1]])[:, turning]
        return float(np.nanmax(np.clip(np.abs(roots - time), 0.0, h)))

    def _position(self, k: int, time: float, time_error: float) -> tuple[Any, Any]:
        """Return the position of a joint at a time between samples, by a cubic, with its error."""
        moved, model = self.moved, self.problem.model
        if model.v_names[k] not in model.q_names:
            return ABSENT, ABSENT
        q, qd = moved.q[:, model.q_names.index(model.v_names[k])], moved.qd[:, k]
        if not moved.times[-1] > moved.times[0]:  # it ended where it began
            return float(q[0]), EXACT * abs(float(q[0]))
        n = self._interval(time)
        h = float(moved.times[n + 1] - moved.times[n])
        s = (time - float(moved.times[n])) / h
        straight = q[n] + s * (q[n + 1] - q[n])
        bent = (
            s
            * (1.0 - s)
            * ((1.0 - s) * (h * qd[n] - (q[n + 1] - q[n])) - s * (h * qd[n + 1] - (q[n + 1] - q[n])))
        )
        near = np.abs(moved.times - time) <= time_error + 1.5 * h
        off = min(float(np.abs(qd[near]).max()) * time_error, float(np.ptp(q))) + abs(float(bent))
        return float(straight + bent), off + EXACT * float(np.abs(q).max())

    def add_to(self, result: Result) -> None:
        """Add both sides of the ratios as datasets, where the samples of the result are those of the motion."""
        if len(result.time) != len(self.moved.times):
            return
        tau, names = joint_columns(self.problem.model)["tau"], self.problem.model.v_names
        units = dict(zip(tau.names, tau.column_units))
        driven = tuple(names[k] for k in self.driven)
        columns = JointColumns(driven, tuple(units[name] for name in driven), ("time", "motorised"))
        for kind, sides in self.sides.items():
            result.add(f"motorisation/{kind}_available", sides.available, **columns.described())
            result.add(f"motorisation/{kind}_resistance", sides.resistance, **columns.described())


def _sides(problem: Problem, every: Sequence[Exerted], R: Array, torques: Array, v: Array) -> RatioSides:
    """Return the sides of ratios from the torques (T, nv, k) of all that acts, R (T, nv, n) and rates (T, n)."""
    options = problem.scene.motorisation
    along = np.sign(v)[:, :, None] * np.einsum("tin,tik->tnk", R, torques)
    drives = np.array([one.role == DRIVE for one in every])
    roles = [one.role for one in every if one.role != DRIVE]
    outside = np.array([options.outside.get(role, 0.0) for role in roles])
    inside = np.array([0.0 if role in options.outside else options.factors.get(role, 1.0) for role in roles])
    resists = np.maximum(0.0, -along[:, :, ~drives])
    shares = inside * resists
    available = along[:, :, drives].sum(axis=2) - (outside * resists).sum(axis=2)
    size = np.abs(along[:, :, drives]).sum(axis=2) + ((inside + outside) * np.abs(along[:, :, ~drives])).sum(
        axis=2
    )
    return RatioSides(available, shares.sum(axis=2), size, shares, along[:, :, ~drives])
