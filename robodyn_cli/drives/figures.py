"""The figures of drives in the summary, and whether they bear their duty."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.drives.cycle import (
    Duty,
    MotorCycle,
    ShaftDuty,
    Use,
    errors_of,
    motor_cycle,
    motor_limits,
    other_limits,
)
from robodyn_cli.drives.rivals import decided, limit_with_rivals, side_with_rivals
from robodyn_cli.model.model import TORQUE
from robodyn_cli.motors.drive import Train
from robodyn_cli.motors.electric import Curves
from robodyn_cli.record import record
from robodyn_cli.solve.extremes import (
    integral,
    largest,
    largest_magnitude,
    largest_of_each,
    positive_integral,
    root_mean_square,
)
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.drives import (
    DriveErrors,
    DriveFigures,
    Electrical,
    ElectricalErrors,
    Shaft,
    ShaftErrors,
    Side,
    SideErrors,
    UsedLimit,
    WindingTemperatures,
)
from robodyn_cli.summaries.facts import ABSENT, Absent


def sides_of(duty: Duty, cycle: MotorCycle) -> tuple[Side, Shaft]:
    """Return the figures of a joint and of its motors' shafts in a duty cycle."""
    torque = np.column_stack([duty.load, cycle.torque])
    speed = np.column_stack([duty.speed, cycle.speed])
    power = torque * speed
    both = [x for y in (torque, speed, power) for x in (y, -y)]
    most = largest_of_each(duty.times, both, duty.breaks)
    peak, fastest = most[0].or_larger(most[1]), most[2].or_larger(most[3])
    parts, off = positive_integral(duty.times, np.hstack(both[:2] + both[4:]), duty.breaks)
    (up, down, driving, braking), off = parts.reshape(4, -1), off.reshape(4, -1)
    rms, rms_off = root_mean_square(duty.times, torque, duty.breaks)
    duration = duty.times[-1] - duty.times[0]
    errors = {
        "peak_torque": peak.error,
        "peak_torque_time": peak.time_error,
        "rms_torque": rms_off,
        "mean_torque": (off[0] + off[1]) / duration,
        "peak_speed": fastest.error,
        "power": np.maximum(most[4].error, most[5].error),
        "energy": off[2:].max(axis=0),
    }
    figures = {
        "peak_torque": peak.value,
        "peak_torque_time": peak.time,
        "rms_torque": rms,
        "mean_torque": (up + down) / duration,
        "peak_speed": fastest.value,
        "driving_power": np.maximum(0.0, most[4].value),
        "braking_power": np.maximum(0.0, most[5].value),
        "driving_energy": driving,
        "braking_energy": braking,
    }
    (joint, shaft), (of_joint, of_shaft) = (
        [{name: float(x[k]) for name, x in side.items()} for k in (0, 1)] for side in (figures, errors)
    )
    return Side(**joint, errors=SideErrors(**of_joint)), Shaft(**shaft, errors=ShaftErrors(**of_shaft))


def electrical_of(cycle: MotorCycle, duty: Duty) -> Electrical | Absent:
    """Return the figures of a motor whose current is known."""
    power = cycle.electrical
    if power is None or cycle.current is None or cycle.copper is None or cycle.friction is None:
        return ABSENT
    t, current = duty.times, cycle.current[:, None]
    peak = largest_magnitude(t, current, duty.breaks)
    (rms,), (rms_off,) = root_mean_square(t, current, duty.breaks)
    parts = np.column_stack([power, -power, cycle.copper, cycle.friction])
    energies, off = positive_integral(t, parts, duty.breaks)
    errors = ElectricalErrors(float(peak.error[0]), float(rms_off), float(off.max()))
    drawn, returned, copper, friction = (float(x) for x in energies)
    return Electrical(float(peak.value[0]), float(rms), drawn, returned, copper, friction, errors)


@record
class Evaluated:
    """A drive in its cycle: its parts, duty, envelopes, samples, and how much of each limit it uses."""

    train: Train
    duty: Duty
    curves: Curves
    cycle: MotorCycle
    uses: Mapping[str, Use]

    @staticmethod
    def of(train: Train, duty: Duty) -> Evaluated:
        """Return a drive in its duty cycle."""
        curves = train.curves
        cycle = motor_cycle(train.motor, train.supply, ShaftDuty.by(train, duty), duty.samples)
        uses = motor_limits(train.motor, train.supply, curves, cycle, duty.samples) | other_limits(
            train, duty
        )
        return Evaluated(train, duty, curves, cycle, uses)

    @cached_property
    def half(self) -> Evaluated:
        """The drive by half as many samples."""
        return Evaluated.of(self.train, self.duty.thinned())

    def by_fewer(self, figure: Callable[[Evaluated], Any]) -> float:
        """Return the error of a figure, or of several: how far half of the samples puts it off, or half of how far
        these and a quarter are apart, which may agree by chance but not twice."""
        own, half, quarter = (np.asarray(figure(x), dtype=float) for x in (self, self.half, self.half.half))
        return float(np.max(np.maximum(np.abs(own - half), 0.5 * np.abs(half - quarter))))

    @property
    def lost(self) -> Array:
        """The power that the gears lose (T,) [W]."""
        asked = ShaftDuty.by(self.train, self.duty)
        into = asked.torque * asked.speed * self.train.drive.count
        lost: Array = into - self.duty.load * self.duty.speed
        return lost

    def figures(self, unit: str) -> DriveFigures:
        """Return the figures; ``unit`` : of the joint's coordinate."""
        train, duty, cycle = self.train, self.duty, self.cycle
        decides, margin = self.decides, self.margin
        limits = {name: self._limit(name, use) for name, use in self.uses.items()}
        (loss,), (loss_off,) = integral(duty.times, self.lost[:, None], duty.breaks)
        joint, shaft = sides_of(duty, cycle)
        ratio, ratio_off = self._inertia_ratio()
        wind_up, wind_up_off = self._wind_up(joint)
        errors = DriveErrors(
            limits[decides].use_error, limits[decides].time_error, float(loss_off), ratio_off, wind_up_off
        )
        force = TORQUE[unit]
        return DriveFigures(
            passes=bool(margin >= train.drive.margin),
            margin=margin,
            least_margin=train.drive.margin,
            decides=decides,
            time=limits[decides].time,
            motor=train.drive.motor,
            gear=train.drive.gear,
            brake=train.drive.brake,
            count=train.drive.count,
            ratio=float(train.turns),
            mass=float(train.mass),
            cost=float(train.cost),
            limits=limits,
            joint=joint,
            shaft=shaft,
            electrical=electrical_of(cycle, duty),
            winding=self._winding(),
            gear_loss=float(loss),
            inertia_ratio=ratio,
            wind_up=wind_up,
            errors=errors,
            units={
                "torque": force,
                "speed": f"{unit}/s",
                "wind_up": unit,
                "ratio": "1" if unit == "rad" else "rad/m",
            },
        )

    @cached_property
    def errors(self) -> Mapping[str, tuple[float, float]]:
        """The errors of how much of each limit is used, and of the times."""
        return errors_of(self.uses)

    def with_rivals(self, figures: DriveFigures) -> DriveFigures:
        """Return figures with errors of times that cover where else a torque or a use is as large, but for errors."""
        times = self.duty.times
        joint = side_with_rivals(figures.joint, times, self.duty.load)
        shaft = side_with_rivals(figures.shaft, times, self.cycle.torque)
        limits = {name: limit_with_rivals(limit, self.uses[name]) for name, limit in figures.limits.items()}
        errors = dataclasses.replace(figures.errors, time=decided(figures.decides, limits))
        return dataclasses.replace(figures, joint=joint, shaft=shaft, limits=limits, errors=errors)

    def use_error(self, name: str) -> float:
        """Return the error of the use of a limit; of one that no instant decides, or heat, by fewer samples."""
        use = self.uses[name]
        error = self.errors[name][0]
        if use.samples is None or name == "winding":
            error = max(error, self.by_fewer(lambda x: x.uses[name].part))
        return error

    def _limit(self, name: str, use: Use) -> UsedLimit:
        """Return the use of a limit."""
        error = self.use_error(name)
        if use.at is None:
            return UsedLimit(float(use.part), error, ABSENT, ABSENT)
        off = self.errors[name][1]
        if name == "winding":
            off = max(off, self.by_fewer(lambda x: x._time_of(name)))
        return UsedLimit(float(use.part), error, self._time_of(name), off)

    def _time_of(self, name: str) -> float:
        """Return when most of a limit is used [s]."""
        return float(np.float64(self.uses[name].at))

    @cached_property
    def _temperatures(self) -> tuple[float, float, float] | None:
        """Return peak, mean and the end of a first cycle [degC]; None where they are not known, or not steady."""
        cycle, samples, thermal = self.cycle, self.duty.samples, self.train.motor.thermal
        if thermal is None or cycle.temperature is None or cycle.copper is None or not cycle.settles:
            return None
        first = thermal.warming(cycle.copper, samples.times, periodic=False)[-1]
        peak = largest(self.duty.times, cycle.temperature[:, None]).value[0]
        return float(peak), float(samples.mean(cycle.temperature)), self.train.supply.ambient + float(first)

    def _winding(self) -> WindingTemperatures | Absent:
        own, fewer = self._temperatures, (self.half._temperatures, self.half.half._temperatures)
        if own is None or None in fewer:
            return ABSENT
        return WindingTemperatures(*own, error=self.by_fewer(lambda x: x._temperatures))

    def _inertia_ratio(self) -> tuple[list[float] | Absent, float | Absent]:
        """Return smallest and largest inertia of the mechanism over that of the drives, and their error."""
        if self.duty.inertia is None or not self.train.reflected > 0.0:
            return ABSENT, ABSENT
        ratio = self.duty.inertia / self.train.reflected
        ends = largest(self.duty.times, np.column_stack([-ratio, ratio]), self.duty.breaks)
        return [-float(ends.value[0]), float(ends.value[1])], float(ends.error.max())

    def _wind_up(self, joint: Side) -> tuple[float | Absent, float | Absent | None]:
        """Return the largest angle or way by which the gears give way under the load, and its error."""
        gear = self.train.gear
        if gear is None or gear.stiffness is None:
            return ABSENT, ABSENT
        stiffness = gear.stiffness * self.train.drive.count
        error = joint.errors.peak_torque
        return joint.peak_torque / stiffness, None if error is None else error / stiffness

    @property
    def decides(self) -> str:
        """The limit of which most is used."""
        return max(self.uses, key=lambda name: float(self.uses[name].part))

    @property
    def margin(self) -> float:
        """Part of it that is left."""
        return 1.0 - float(self.uses[self.decides].part)
