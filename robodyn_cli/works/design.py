"""Kinematic design along a motion: poles, curvature, velocity ratios, pressure angles, dead points.

Chains of four links are in ``works.four_bars``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.given.motion import Planned, knot_places
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.observe.columns import chosen, extremes
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.observe.places import point_motion
from robodyn_cli.observe.plane import (
    EPSILON,
    NOTHING,
    LinkMotion,
    PairMotion,
    curvature,
    link_outputs,
    normal_of,
    pressure_angle,
    scales_of,
)
from robodyn_cli.record import record
from robodyn_cli.results.result import Result, make_variable
from robodyn_cli.scene.points import BASE
from robodyn_cli.solve.crossings import crossings, value_at
from robodyn_cli.solve.quadrature import spaced
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.design import DeadPointPassed, DesignFigures, DesignKeys, FourBarClass, Unbounded
from robodyn_cli.summaries.extremes import Extremes
from robodyn_cli.summaries.facts import ABSENT, Absent
from robodyn_cli.works.kinematic_figures import refuse_meeting

SLOW = 1e-3  # of the largest speed: a point that is slower than that comes to rest
KEY = "kinematics.design"
Times = list[tuple[float, float]]  # each with its error


@record
class DesignColumns:
    """A dataset of kinematic design at T samples, how far each sample may be off (T,), and where it is unbounded: times
    with their errors, None where it has no value at any time. described : arguments of ``Result.add``."""

    data: Array
    doubt: Array
    gaps: Times | None = dataclasses.field(default_factory=list)
    described: dict[str, Any] = dataclasses.field(default_factory=dict)


class Designed:
    """What ``kinematics.design`` asks for along a motion.

    Parameters
    ----------
    arrays : what ``outputs`` are along it (T, n); None: evaluated here.

    Raises
    ------
    CapabilityError : it has no meaning for the mechanism.
    """

    def __init__(self, problem: Problem, planned: Planned, arrays: Mapping[str, Array] | None = None) -> None:
        design = problem.scene.kinematics.design
        assert design is not None
        self.problem, self.planned, self.design = problem, planned, design
        self.scene, self.times, self.asked = problem.scene, planned.times, problem.scene.outputs.extremes
        names = [link.name for link in self.scene.robot.links]
        if arrays is None:
            function = SampleFunction(self.outputs(problem), MOTION_GROUPS, len(self.times))
            arrays = function.along(self.times, planned.motion)
        self.arrays = arrays
        links = {name: self._link(name) for name in names}
        self.links = {**links, BASE: self._link(BASE)}
        self.normal, self.scales = normal_of(links.values()), scales_of(links.values())
        self.columns: dict[str, DesignColumns] = {}
        for name, pair in design.poles.items():
            self.columns |= self._poles(name, pair)
        for name in design.curves:
            self.columns[f"curvatures/{name}"] = self._curvature(name)
        self.dead_points: dict[str, list[DeadPointPassed]] = {}
        for name, pair in design.ratios.items():
            self.columns[f"ratios/{name}"] = self._ratio(name, pair)
        for name, pair in design.pressure.items():
            self.columns[f"pressure_angles/{name}"] = self._pressure(name, pair)

    @staticmethod
    def outputs(problem: Problem) -> dict[str, list[Any]]:
        """Return the expressions that all of it follows from."""
        design, links = problem.scene.kinematics.design, [link.name for link in problem.scene.robot.links]
        names = () if design is None else dict.fromkeys(x for pair in design.pressure.values() for x in pair)
        places = {f"points/{name}": list(problem.world_point(problem.model.points[name])) for name in names}
        return {**link_outputs(problem, links), **point_motion(problem), **places}

    def _link(self, name: str) -> LinkMotion:
        return LinkMotion.of(self.arrays.get(f"links/{name}"), len(self.times))

    # -- pairs of links ------------------------------------------------------------------------------------
    def _poles(self, name: str, pair: tuple[str, ...]) -> dict[str, DesignColumns]:
        """Return the pole, the centrodes, the acceleration pole and the relative rate of two links."""
        moved = PairMotion.of(self.links[pair[0]], self.links[pair[1]], self.normal, self.scales)
        if not moved.is_flat:
            raise CapabilityError(
                f"links {pair[0]!r} and {pair[1]!r} do not move in one plane "
                "against each other, so they have no pole",
                (self.scene.path, f"{KEY}.poles.{name}"),
                key=f"{KEY}.poles.{name}",
            )
        pole, off = moved.pole()
        still = bool(np.isnan(pole).all())
        gaps = None if still else self._zeros(moved.W, moved.still, pole)
        rate = DesignColumns(moved.W, np.full(len(self.times), EPSILON * moved.scales[0]))
        far, far_off = moved.acceleration_pole()
        nowhere = bool(np.isnan(far).all())
        at_infinity = [(float(self.times[k]), 0.0) for k in np.flatnonzero(np.isnan(far[:, 0]))]
        return {
            f"poles/{name}": DesignColumns(pole, off, gaps),
            f"centrodes/fixed/{name}": DesignColumns(moved.second.seen(pole), off, gaps),
            f"centrodes/moving/{name}": DesignColumns(moved.first.seen(pole), off, gaps),
            f"acceleration_poles/{name}": DesignColumns(far, far_off, None if nowhere else at_infinity),
            f"relative_rates/{name}": rate,
        }

    def _zeros(self, rate: Array, nothing: float, values: Array) -> Times:
        """Return the times at which a rate (T,) passes zero, where values are not finite."""
        rests = np.abs(rate) <= nothing
        # where all is at rest, what begins to move has a value
        kept = ~rests | ~np.isfinite(values.reshape(len(values), -1)[:, 0])
        return crossings(self.times[kept], rate[kept], nothing) if np.count_nonzero(kept) > 1 else []

    def _ratio(self, name: str, pair: tuple[str, ...]) -> DesignColumns:
        """Return the rate of one joint, or link, over that of another; note dead points of joints."""
        names, motion = self.problem.model.v_names, self.planned.motion
        joints = set(pair) <= set(names)
        if joints:
            (v, a), (w, b) = ([x[:, names.index(one)] for x in (motion.qd, motion.qdd)] for one in pair)
            units = [self.problem.model.v_units[names.index(one)] for one in pair]
        else:
            (v, a), (w, b) = (self._turning(name, one) for one in pair)
            units = ["rad", "rad"]
        v_most, w_most = (float(np.abs(x).max()) for x in (v, w))
        rests = (np.abs(v) <= NOTHING * v_most) & (np.abs(w) <= NOTHING * w_most)
        over, under = np.where(rests, a, v), np.where(rests, b, w)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = over / under
            off = EPSILON * (np.where(rests, np.abs(a).max(), v_most) + np.abs(ratio) * (
                np.where(rests, np.abs(b).max(), w_most))) / np.abs(under)  # fmt: skip
        ratio[~np.isfinite(ratio) | (~rests & (np.abs(w) <= NOTHING * w_most))] = np.nan
        gaps = None if np.isnan(ratio).all() else self._zeros(w, NOTHING * w_most, ratio)
        if joints:
            self.dead_points[name] = self._dead_points(pair, np.where(rests, np.nan, v), NOTHING * v_most)
        unit = "1" if units[0] == units[1] else f"{units[0]}/{units[1]}"
        return DesignColumns(ratio, off, gaps, {"units": unit})

    def _turning(self, name: str, link: str) -> tuple[Array, Array]:
        """Return the rate at which a link turns about the normal (T,), and its derivative."""
        moved = self.links[link]
        w = moved.w @ self.normal
        if np.abs(moved.w - w[:, None] * self.normal).max() > 1e-8 * float(
            np.abs(moved.w).max(initial=1e-300)
        ):
            raise CapabilityError(
                f"link {link!r} does not turn about one axis; allowed: links of a motion in a plane, joints",
                (self.scene.path, f"{KEY}.ratios.{name}"),
                key=f"{KEY}.ratios.{name}",
            )
        return w, moved.wd @ self.normal

    def _dead_points(self, pair: tuple[str, ...], v: Array, nothing: float) -> list[DeadPointPassed]:
        """Return where the first of two joints is at rest, with a rate v (T,) that is nan where both are."""
        kept = ~np.isnan(v)
        if np.count_nonzero(kept) < 2 or not np.abs(v[kept]).max() > nothing:
            return []
        model, q, qd = self.problem.model, self.planned.motion.q, self.planned.motion.qd
        found = []
        for time, off in crossings(self.times[kept], v[kept], nothing):
            at, errors = [], []
            for one in pair:
                k, rate = model.v_names.index(one), model.v_names.index(one)
                value, error = value_at(self.times, q[:, k], time)
                at.append(value)
                errors.append(error + off * float(np.abs(np.interp(time, self.times, qd[:, rate]))) + EPSILON)
            found.append(DeadPointPassed(time, off, at[0], at[1], max(errors)))
        return found

    # -- points --------------------------------------------------------------------------------------------
    def _velocity(self, key: str, point: str) -> tuple[Array, Array]:
        """Return velocity and acceleration (T, 3) of a point in the plane."""
        v, a = (self.arrays[f"point_{kind}/{point}"] for kind in ("velocities", "accelerations"))
        most = float(np.abs(v).max())
        if most == 0.0:
            raise CapabilityError(f"point {point!r} does not move", (self.scene.path, key), key=key)
        if np.abs(v @ self.normal).max() > 1e-8 * most:
            raise CapabilityError(
                f"point {point!r} does not move in a plane across the axes of the joints",
                (self.scene.path, key),
                key=key,
            )
        return v, a

    def _curvature(self, point: str) -> DesignColumns:
        v, a = self._velocity(f"{KEY}.curves", point)
        k, off = curvature(v, a, self.normal)
        # it rests where its speed, which is least there, is nothing
        square, slope = (v * v).sum(axis=1), (v * a).sum(axis=1)
        least = SLOW**2 * float(square.max())
        turns = crossings(self.times, slope, NOTHING * float(np.abs(slope).max()))
        gaps = [(t, error) for t, error in turns if value_at(self.times, square, t)[0] <= least]
        return DesignColumns(k, off, gaps)

    def _pressure(self, name: str, pair: tuple[str, ...]) -> DesignColumns:
        key = f"{KEY}.pressure.{name}"
        v, a = self._velocity(key, pair[1])
        refuse_meeting(self.scene, self.arrays, pair, key)
        line = self.arrays[f"points/{pair[1]}"] - self.arrays[f"points/{pair[0]}"]
        return DesignColumns(*pressure_angle(line, v, a, self.normal))

    # -- what it becomes -----------------------------------------------------------------------------------
    def add_to(self, result: Result) -> None:
        """Add the datasets to a result."""
        for path, one in self.columns.items():
            result.add(path, one.data, **one.described)

    def extremes(self) -> dict[str, Extremes]:
        """Return the extremes of all columns that have them, by name."""
        breaks = spaced(knot_places(self.scene, self.times), len(self.times))
        found = {}
        for path, one in self.columns.items():
            if one.gaps != [] or path.startswith("centrodes/"):
                continue
            variable = make_variable(path, one.data, **one.described)
            values = one.data.reshape(len(self.times), -1)
            names = [f"{path}.{name}" for name in variable.names] or [path]
            # of poles that stay on a line, or in their place, coordinates that are constant are told if asked for
            moves = np.ptp(values, axis=0) > 2.0 * one.doubt.max()
            kept = [k for k, name in enumerate(names) if len(names) == 1 or moves[k] or name in self.asked]
            columns = [x for k in kept if (x := chosen({path: variable}, names[k])) is not None]
            for name, ends in extremes(self.times, values[:, kept], columns, breaks).items():
                found[name] = self._doubted(ends, one.doubt)
        return found

    def _doubted(self, x: Extremes, doubt: Array) -> Extremes:
        """Return extremes with errors for how far samples may be off."""
        at = {
            "smallest": float(np.interp(x.smallest_time, self.times, doubt)),
            "largest": float(np.interp(x.largest_time, self.times, doubt)),
            "final": float(doubt[-1]),
        }
        errors = {name: (getattr(x.errors, name) or 0.0) + off for name, off in at.items()}
        return dataclasses.replace(x, errors=dataclasses.replace(x.errors, **errors))

    @property
    def unbounded(self) -> dict[str, Unbounded]:
        """Datasets that have no finite value somewhere."""
        found = {}
        for path, one in self.columns.items():
            if one.gaps != [] and not path.startswith("centrodes/"):
                times, errors = [t for t, _ in one.gaps or ()], [e for _, e in one.gaps or ()]
                found[path] = Unbounded(times, max(errors, default=0.0), one.gaps is None)
        return found


def with_design(
    records: list[Any], result: Result, problem: Problem, motions: tuple[Planned, Planned]
) -> list[Any]:
    """Return the records of a summary with kinematic design; motions : at the samples, and where figures are looked at.

    Raises
    ------
    CapabilityError : see ``Designed``.
    """
    summary, *others = records
    design = problem.scene.kinematics.design
    if len(motions[0].times) < 2 or design is None:
        return records
    Designed(problem, motions[0]).add_to(result)
    looked = Designed(problem, motions[1])
    chains: dict[str, FourBarClass] | Absent = ABSENT
    if design.grashof:
        from robodyn_cli.works.four_bars import add_four_bars

        chains = add_four_bars(result, problem, motions[0], summary.joints)
    own = {} if summary.extremes is ABSENT else summary.extremes
    summary = dataclasses.replace(summary, extremes={**own, **looked.extremes()} or ABSENT)
    passed = {name: points for name, points in looked.dead_points.items() if points}
    return [summary, *others, DesignKeys(DesignFigures(chains, passed or ABSENT, looked.unbounded or ABSENT))]


def refuse_design(problem: Problem, planned: Planned) -> None:
    """Refuse what has no meaning for a mechanism.

    Raises
    ------
    CapabilityError
    """
    Designed(problem, planned)
    if problem.scene.kinematics.design is not None and problem.scene.kinematics.design.grashof:
        from robodyn_cli.works.four_bars import chains_of, poses_at_start

        chains_of(problem, poses_at_start(problem, planned))
