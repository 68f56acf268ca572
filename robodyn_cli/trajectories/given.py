"""Joint motion given by formulas in t, as a Fourier series, or by samples."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.expr.functions import cos, sin
from robodyn_cli.expr.graph import Expr
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, CsvFile, Formula, JointMap, ListOf, Number, Text, Vector, key
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import (
    Problems,
    SceneNames,
    joint_problems,
    led_joints,
    position_problems,
    time_problems,
)
from robodyn_cli.trajectories.course import Course, course_through, hermite_cubic
from robodyn_cli.trajectories.formulas import evaluated, texts
from robodyn_cli.trajectories.joint_space import (
    CourseTrajectory,
    JointSpaceTrajectory,
    attitude_places,
    the_shorter_way,
)
from robodyn_cli.trajectories.led import with_attitudes
from robodyn_cli.trajectories.way_points import monotone_rates


@record
class JointTrajectory(JointSpaceTrajectory):
    """q(t) of every moving joint as a formula; rates and accelerations are its exact derivatives.

    The attitude of a spherical or floating joint is three or four formulas: ``rpy``, ``rotation_vector`` or
    ``quaternion``, which need not have length 1.
    """

    type: str = key(Choice(("joint",)), doc="Kind of trajectory.")
    q: dict[str, Any] = key(
        JointMap(Formula(("t",))), unit="rad or m", doc="Position of each joint as a formula in t."
    )
    duration: float = key(Number(minimum=0.0, exclusive=True), unit="s", doc="Length of the motion.")

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        attitudes = {name.partition(".")[0]: name for name in self.q if name.partition(".")[0] in scene.quasi}
        names = [
            name for name in self.q if name not in scene.quasi and name.partition(".")[0] not in attitudes
        ]
        yield from joint_problems(names, scene.joints, ("q",), led_joints(names, scene))
        missing = [name for name in scene.quasi if name not in attitudes]
        if missing and not scene.some:
            yield ("q",), f"joint {missing[0]!r} is missing; needed here: {', '.join(scene.quasi)}"

    @property
    def joints(self) -> tuple[str, ...]:
        """The columns of q whose motion it gives."""
        return tuple(self.q)

    def expressions(self, t: Expr, env: Mapping[str, Any]) -> Mapping[str, Any]:
        return evaluated(self.q, env)

    def described(self, column: str) -> str:
        return texts(self.q, column)


def _series(label: str) -> Any:
    return key(
        ListOf(JointMap(Number(), coordinates="v")),
        default=(),
        unit="rad or m",
        doc=f"Amplitudes of {label}, k = 1, 2, ..., by joint; 0 where a joint is left out.",
    )


@record
class FourierTrajectory(JointSpaceTrajectory):
    """q = offset + sum_k sine_k sin(k w t) + cosine_k cos(k w t) with w = 2 pi / period (Swevers et al. 1997)."""

    type: str = key(Choice(("fourier",)), doc="Kind of trajectory.")
    offset: dict[str, float] = key(JointMap(Number()), unit="rad or m", doc="Mean position of each joint.")
    period: float = key(Number(minimum=0.0, exclusive=True), unit="s", doc="Period of the first harmonic.")
    duration: float = key(Number(minimum=0.0, exclusive=True), unit="s", doc="Length of the motion.")
    sine: tuple[dict[str, float], ...] = _series("sin(k w t)")
    cosine: tuple[dict[str, float], ...] = _series("cos(k w t)")

    knots = ()

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        yield from position_problems(self.offset, scene, ("offset",))
        for name in ("sine", "cosine"):
            for k, amplitudes in enumerate(getattr(self, name)):
                yield from joint_problems(tuple(amplitudes), scene.rates, (name, k), ())
                for joint in amplitudes:
                    if joint in scene.rates and joint not in self.offset:
                        yield (name, k, joint), self._unled(joint, scene)

    def _unled(self, joint: str, scene: SceneNames) -> str:
        if joint.partition(".")[0] in scene.quasi:
            return "an attitude is no sum of angles; it stays as `offset` says, or use type: joint with rpy formulas"
        return f"joint {joint!r} is missing in `offset`; allowed: {', '.join(self.offset)}"

    @property
    def joints(self) -> tuple[str, ...]:
        """The columns of q whose motion it gives."""
        return tuple(self.offset)

    def expressions(self, t: Expr, env: Mapping[str, Any]) -> Mapping[str, Any]:
        w = 2.0 * math.pi / self.period
        columns: dict[str, Any] = dict(self.offset)
        for series, wave in ((self.sine, sin), (self.cosine, cos)):
            for k, amplitudes in enumerate(series, start=1):
                for joint, amplitude in amplitudes.items():
                    columns[joint] = columns[joint] + amplitude * wave(k * w * t)
        return with_attitudes(columns)


# rows that an interpolation needs
LEAST = {"linear": 2, "monotone": 2, "pieces": 2, "hermite": 2, "cubic": 4, "quintic": 6}
OF_ROWS = ("pieces", "hermite")  # follow from their columns alone: none may take the place of another
RATE, ACCELERATION = "qd.", "qdd."  # before the name of a joint's column
UNIT = 1e-3  # tolerance of a quaternion's length 1: three digits


def power_column(joint: str, power: int) -> str:
    """Return the name of the column with a coefficient of a joint's polynomials."""
    return f"{joint}^{power}" if power else joint


def column_power(name: str) -> tuple[str, int]:
    """Return the joint and the power of a column."""
    joint, sign, power = name.rpartition("^")
    return (joint, int(power)) if sign and power.isdecimal() else (name, 0)


@record
class TableTrajectory(CourseTrajectory):
    """Positions of all joints at increasing times, in rad or m; the duration is the last time.

    Between the rows runs the spline of degree k (5, 3 or 1) with not-a-knot ends, which reproduces
    polynomials up to degree k; it needs k + 1 rows. Linear: rates jump at the rows, and accelerations are 0
    between them. Monotone: cubics that do not overshoot, whose accelerations jump at the rows. Pieces: each row has the
    polynomial from its time t_k to the next row's, q = sum_i c_i (t - t_k)^i, with c_i in the column ``joint^i``.
    Hermite: the cubics with the rates of the columns ``qd.joint`` at the rows, or the quintics with the accelerations
    of ``qdd.joint`` too. The loader replaces ``file`` by the ``columns`` and ``rows`` that it contains.
    """

    type: str = key(Choice(("table",)), doc="Kind of trajectory.")
    file: str | None = key(
        CsvFile(),
        default=None,
        doc="CSV file: a header row `t, joint names`, then numbers; or HDF5: a result, or a dataset a column.",
    )
    columns: tuple[str, ...] = key(
        ListOf(Text(), minimum=2),
        default=(),
        doc="Column names: `t`, then the joints, or their coordinates as `slide.d`; of pieces `joint^1` and so on too, "
        "with rates `qd.joint` and `qdd.joint`. Default: `t` and all joints in their order, then their rates, then "
        "their accelerations, as many as a row has.",
    )
    rows: tuple[tuple[float, ...], ...] = key(
        ListOf(Vector(0), minimum=2), default=(), unit="s, rad or m", doc="Rows of numbers, times from 0."
    )
    interpolation: str | None = key(
        Choice(("quintic", "cubic", "monotone", "linear", "hermite", "pieces")),
        default=None,
        doc="Spline between the rows, or the rows' own polynomials; by default `quintic`, `pieces` where columns "
        "have powers, and `hermite` where there are rates.",
    )

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        if not self.columns or not self.rows:
            yield (), "a table needs 'file', or both 'columns' and 'rows'"
            return
        if self.columns[0] != "t":
            yield ("columns", 0), f"the first column must be 't' (value {self.columns[0]!r})"
        yield from self._column_problems(scene)
        for k, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                yield ("rows", k), f"has {len(row)} numbers; needed: {len(self.columns)}, one per column"
        if all(self.rows):
            places = [("rows", k, 0) for k in range(len(self.rows))]
            yield from time_problems([row[0] for row in self.rows], places)
        yield from self._attitude_problems()
        least = LEAST[self.spline]
        if len(self.rows) < least:
            fits = " or ".join(x for x, k in LEAST.items() if k <= len(self.rows) and x not in OF_ROWS)
            yield (
                ("rows",),
                f"has {len(self.rows)} rows; {self.spline} interpolation needs {least}, "
                f"with fewer rows use interpolation: {fits}",
            )

    def _column_problems(self, scene: SceneNames) -> Problems:
        for k, name in enumerate(self.columns):
            if name in self.columns[:k]:
                yield ("columns", k), f"column {name!r} appears twice"
            elif k and column_power(self._of(name))[0] not in scene.columns:
                yield ("columns", k), f"unknown joint {name!r}; allowed: {', '.join(scene.columns)}"
        yield from self._rate_problems(scene)
        if self._powers and self.spline != "pieces":
            yield (
                ("interpolation",),
                f"a column of powers ({self._powers[0]!r}) is of pieces; allowed: pieces",
            )
        if set(self.joints) <= set(scene.columns):
            led = {name.partition(".")[0] for name in self.joints}
            whole = [
                x for x in scene.columns if x in self.joints or x.partition(".")[0] in {*scene.quasi} & led
            ]
            needed = whole if scene.some else scene.columns
            yield from joint_problems(self.joints, scene.columns, ("columns",), needed)

    def _rate_problems(self, scene: SceneNames) -> Problems:
        """Report rates that are missing, that attitudes have, or that another interpolation would pass over."""
        rates = [name for name in self.columns if self._of(name) != name]
        if bool(rates) != (self.spline == "hermite"):
            found = (
                f"a column of rates ({rates[0]!r}) is of hermite"
                if rates
                else "hermite needs rates, as qd.joint"
            )
            yield ("interpolation",), f"{found}; allowed: {'hermite' if rates else 'columns of rates'}"
            return
        of_attitude = [joint for joint in self.joints if rates and joint.partition(".")[0] in scene.quasi]
        if of_attitude:
            yield (
                ("columns",),
                f"{of_attitude[0]!r} is of an attitude, whose rates are others; allowed: no rates",
            )
        accelerated = any(name.startswith(ACCELERATION) for name in rates)
        for sign in (RATE, ACCELERATION) if accelerated else (RATE,) if rates else ():
            for joint in self.joints:
                if f"{sign}{joint}" not in rates:
                    yield ("columns",), f"{sign}{joint} is missing; needed: that of every joint, or of none"

    def _of(self, name: str) -> str:
        """Return the column of a joint's position that a column of its rates belongs to; others as they are."""
        sign, _, joint = name.partition(".")
        return joint if f"{sign}." in (RATE, ACCELERATION) and joint in self.columns else name

    def _attitude_problems(self) -> Problems:
        for joint, places in attitude_places(self.joints).items() if all(map(len, self.rows)) else ():
            columns = [self.columns.index(self.joints[place]) for place in places]
            for k, row in enumerate(self.rows):
                length = math.hypot(*(row[column] for column in columns if column < len(row)))
                if abs(length - 1.0) > UNIT:
                    fault = f"the quaternion of joint {joint!r} has length {length:.6g}"
                    yield ("rows", k), f"{fault}; needed: length 1, to three digits"
                    break

    @property
    def joints(self) -> tuple[str, ...]:
        """The columns of q whose motion it gives."""
        return tuple(dict.fromkeys(column_power(self._of(name))[0] for name in self.columns[1:]))

    @property
    def spline(self) -> str:
        """How the rows are interpolated."""
        if self.interpolation is not None:
            return self.interpolation
        has_rates = any(self._of(name) != name for name in self.columns)
        return "pieces" if self._powers else "hermite" if has_rates else "quintic"

    @property
    def _powers(self) -> list[str]:
        return [name for name in self.columns if column_power(name)[1]]

    @property
    def duration(self) -> float:
        """Time of the last row [s]."""
        return self.rows[-1][0]

    def make_course(self) -> Course:
        data = np.array(self.rows, dtype=float)
        if self.spline == "pieces":
            return self._pieces(data)
        if self.spline == "hermite":
            return self._with_rates(data)
        t, q = data[:, 0], the_shorter_way(self.joints, data[:, 1:])
        if self.spline == "linear":
            return Course(t, [q[:-1], np.diff(q, axis=0) / np.diff(t)[:, None]])
        if self.spline == "monotone":
            return hermite_cubic(t, q, monotone_rates(t, q))
        return _spline(t, q, LEAST[self.spline] - 1)

    def _with_rates(self, data: Array) -> Course:
        """Return the cubics with the rows' rates, or the quintics with their accelerations too."""
        q, v, *a = (
            data[:, [self.columns.index(f"{sign}{joint}") for joint in self.joints]]
            for sign in ("", RATE, ACCELERATION)
            if f"{sign}{self.joints[0]}" in self.columns
        )
        return course_through(data[:, 0], q, v, (a[0], a[0])) if a else hermite_cubic(data[:, 0], q, v)

    def missed(self) -> float | None:
        """Return how far the interpolation of every second row misses the others (largest, any joint); None of tables
        with too few rows for it, and of pieces, which are what they are.
        """
        every = dataclasses.replace(self, rows=self.rows[::2])
        if self.spline == "pieces" or len(every.rows) < LEAST[self.spline]:
            return None
        left = np.array([row for row in self.rows[1::2] if row[0] <= every.duration], dtype=float)
        places = [self.columns.index(joint) for joint in self.joints]
        return float(np.abs(every.course(left[:, 0]) - left[:, places]).max(initial=0.0))

    def told(self) -> str:
        """Return how the rows are interpolated, and what that misses, in words."""
        missed = self.missed()
        how = f"{len(self.rows)} rows, interpolation {self.spline}"
        if missed is None:
            return how
        return f"{how}; made of every second row it misses the others by up to {missed:.2g} (rad or m)"

    def _pieces(self, data: Array) -> Course:
        """Return the rows' polynomials; the last row is where the motion ends."""
        where = [column_power(name) for name in self.columns[1:]]
        c = np.zeros((1 + max(power for _, power in where), len(data) - 1, len(self.joints)))
        for column, (joint, power) in enumerate(where, start=1):
            c[power, :, self.joints.index(joint)] = data[:-1, column]
        return Course(data[:, 0], c)


def _spline(t: Array, q: Array, degree: int) -> Course:
    """Return the spline with not-a-knot ends through ``q`` (N, n)."""
    from scipy.interpolate import make_interp_spline  # takes 0.4 s to import: only where a table is used

    spline = make_interp_spline(t, q, k=degree)
    knots = np.unique(spline.t)
    return Course(knots, [spline(knots[:-1], nu=i) / math.factorial(i) for i in range(degree + 1)])
