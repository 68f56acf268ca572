"""All combinations of a catalogue for one joint: how much of its limits each uses."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.drives.cycle import Duty, ShaftDuty, Use, motor_cycle, motor_limits, other_limits
from robodyn_cli.motors.drive import Catalogue, Drive, Train
from robodyn_cli.motors.electric import Curves, Electric, Motor, Supply
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


@record
class Candidates:
    """The combinations of M motors and G gears for a joint, in the order of the catalogue.

    motors, gears : names, None for no gear. masses, inertias, costs : (M, G) of all equal drives together, inertias as
    reflected on the joint. usable : (M, G) those that can run at all. curves : of the motors that can.
    """

    drive: Drive
    catalogue: Catalogue
    motors: tuple[str, ...]
    gears: tuple[str | None, ...]
    masses: Array
    inertias: Array
    costs: Array
    usable: NDArray[np.bool_]
    curves: tuple[Curves | None, ...]

    @staticmethod
    def of(drive: Drive, catalogue: Catalogue, unit: str) -> Candidates:
        """Return the combinations for a joint whose coordinate has this unit."""
        motors = tuple(catalogue.motors)
        gears: list[str | None] = [None] if unit == "rad" else []
        gears += [name for name, gear in catalogue.gears.items() if gear.drives == unit]
        trains = [[_train(drive, catalogue, m, g) for g in gears] for m in motors]
        masses, inertias, costs = (
            np.array([[float(getattr(train, key)) for train in row] for row in trains])
            for key in ("mass", "reflected", "cost")
        )
        usable = np.array([[_runs(row[0])] * len(gears) if row else [] for row in trains], dtype=bool)
        curves = tuple(row[0].curves if any(ok) else None for row, ok in zip(trains, usable))
        return Candidates(drive, catalogue, motors, tuple(gears), masses, inertias, costs, usable, curves)

    def train(self, k: int) -> Train:
        """Return the k-th combination, counted along the rows of motors."""
        motor, gear = divmod(k, len(self.gears))
        return _train(self.drive, self.catalogue, self.motors[motor], self.gears[gear])

    def uses(self, duty: Duty) -> dict[str, Array]:
        """Return how much of each limit each combination uses, (M, G) by name; nan where it has none.

        A combination that fails by its speed or by its gear is looked at no further, unless all fail.
        """
        trains = [self.train(k) for k in range(len(self.gears))]  # with the first motor
        fast = float(np.abs(duty.speed).max()) * np.array([float(train.turns) for train in trains])
        found = _Uses((len(self.motors), len(self.gears)))
        for k, train in enumerate(trains):
            found.keep((slice(None), k), other_limits(train, duty))
        tops = np.array([np.inf if curve is None else curve.driving.top_speed for curve in self.curves])
        found.table["speed"] = fast / tops[:, None]
        able = self.usable & (found.most <= 1.0)
        asked = _rows([ShaftDuty.by(train, duty) for train in trains])
        self._run_motors(found, able, asked, duty)
        if not np.any(self.usable & (found.most <= 1.0)):  # which comes nearest is told by all limits
            self._run_motors(found, self.usable & ~able, asked, duty)
        if "peak" in found.table:  # which is never less
            found.table["speed"][np.isfinite(found.table["peak"])] = np.nan
        return found.table

    def margins(self, uses: Mapping[str, Array]) -> Array:
        """Return the margin of each combination (M, G) by the uses of its limits, -inf where it cannot run."""
        return np.where(self.usable, 1.0 - stacked(uses).max(axis=0), -np.inf)

    def _run_motors(self, found: _Uses, which: NDArray[np.bool_], asked: ShaftDuty, duty: Duty) -> None:
        """Keep the uses of the motors' limits, of combinations ``which`` (M, G); ``asked`` : by each gear."""
        for k, (name, curve) in enumerate(zip(self.motors, self.curves)):
            rows = np.flatnonzero(which[k])
            if len(rows) == 0 or curve is None:
                continue
            motor, supply = self.catalogue.motors[name], Supply(self.drive.voltage, self.drive.ambient)
            cycle = motor_cycle(motor, supply, asked.only(rows), duty.samples)
            found.keep((k, rows), motor_limits(motor, supply, curve, cycle, duty.samples))


class _Uses:
    """Uses of limits of all combinations, (M, G) by name."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        self.table: dict[str, Array] = {}

    def keep(self, where: Any, uses: Mapping[str, Use]) -> None:
        """Keep the uses of some combinations."""
        for name, use in uses.items():
            self.table.setdefault(name, np.full(self.shape, np.nan))[where] = use.part

    @property
    def most(self) -> Array:
        """The largest use of each combination."""
        found: Array = stacked(self.table).max(axis=0)
        return found


def stacked(uses: Mapping[str, Array]) -> Array:
    """Return how much of each limit each combination uses (limits, M, G), 0 where it has no such limit."""
    return np.nan_to_num(np.stack(list(uses.values())), nan=0.0, posinf=np.inf)


def _train(drive: Drive, catalogue: Catalogue, motor: str, gear: str | None) -> Train:
    """Return a drive with other parts."""
    return Train.of(dataclasses.replace(drive, motor=motor, gear=gear), catalogue)


def _runs(train: Train) -> bool:
    """Tell whether a motor runs on what its drive says of the supply."""
    motor: Motor = train.motor
    if isinstance(motor, Electric):
        return motor.supply_problem(train.supply) is None
    warm = motor.thermal is None or train.supply.ambient < motor.thermal.max_temperature
    return warm and train.drive.voltage is None


def _rows(asked: Sequence[ShaftDuty]) -> ShaftDuty:
    """Return what several gears ask of a motor, a row each."""
    speed, acceleration, torque = (
        np.stack([getattr(x, key) for x in asked]) for key in ("speed", "acceleration", "torque")
    )
    return ShaftDuty(speed, acceleration, torque, np.array([[float(x.inertia)] for x in asked]))
