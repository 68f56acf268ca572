"""The figures of drives in the summary, and whether they bear their duty."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from robodyn_cli.drives.cycle import (
    CycleSamples,
    Duty,
    MotorCycle,
    ShaftDuty,
    Use,
    motor_cycle,
    motor_limits,
    other_limits,
    rise,
)
from robodyn_cli.model.model import TORQUE
from robodyn_cli.motors.drive import Train
from robodyn_cli.motors.electric import Curves
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.drives import (
    DriveErrors,
    DriveFigures,
    Electrical,
    Shaft,
    Side,
    UsedLimit,
    WindingTemperatures,
)
from robodyn_cli.summaries.facts import ABSENT, Absent

AnySide = TypeVar("AnySide", bound=Side)


def side_of(kind: type[AnySide], duty: Duty, torque: Array, speed: Array) -> AnySide:
    """Return the figures of a joint or of a motor's shaft from torques and speeds (T,) in a duty cycle."""
    samples, power = duty.samples, torque * speed
    size = np.abs(torque)
    return kind(
        peak_torque=float(size.max()),
        peak_torque_time=float(duty.times[int(np.argmax(size))]),
        rms_torque=float(samples.rms(torque)),
        mean_torque=float(samples.mean(size)),
        peak_speed=float(np.abs(speed).max()),
        driving_power=max(0.0, float(power.max())),
        braking_power=max(0.0, float(-power.min())),
        driving_energy=samples.positive(power),
        braking_energy=samples.positive(-power),
    )


def electrical_of(cycle: MotorCycle, samples: CycleSamples) -> Electrical | Absent:
    """Return the figures of a motor whose current is known."""
    power = cycle.electrical
    if power is None or cycle.current is None or cycle.copper is None or cycle.friction is None:
        return ABSENT
    return Electrical(
        peak_current=float(np.abs(cycle.current).max()),
        rms_current=float(samples.rms(cycle.current)),
        energy=samples.positive(power),
        regenerated=samples.positive(-power),
        copper_loss=samples.integral(cycle.copper),
        friction_loss=samples.integral(cycle.friction),
    )


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

    @property
    def gear_loss(self) -> float:
        """Energy that the gears lose in a cycle [J]."""
        asked = ShaftDuty.by(self.train, self.duty)
        into = asked.torque * asked.speed * self.train.drive.count
        lost = into - self.duty.load * self.duty.speed
        return self.duty.samples.integral(lost)

    def figures(self, unit: str) -> DriveFigures:
        """Return the figures; ``unit`` : of the joint's coordinate."""
        train, duty, cycle = self.train, self.duty, self.cycle
        decides, margin = self.decides, self.margin
        limits = {name: self._limit(use) for name, use in self.uses.items()}
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
            joint=side_of(Side, duty, duty.load, duty.speed),
            shaft=side_of(Shaft, duty, cycle.torque, cycle.speed),
            electrical=electrical_of(cycle, duty.samples),
            winding=self._winding(),
            gear_loss=self.gear_loss,
            inertia_ratio=self._inertia_ratio(),
            wind_up=self._wind_up(),
            errors=self._errors(),
            units={
                "torque": force,
                "speed": f"{unit}/s",
                "wind_up": unit,
                "ratio": "1" if unit == "rad" else "rad/m",
            },
        )

    def _limit(self, use: Use) -> UsedLimit:
        time = ABSENT if use.at is None else float(self.duty.times[int(use.at)])
        return UsedLimit(float(use.part), time)

    def _winding(self) -> WindingTemperatures | Absent:
        cycle, samples, thermal = self.cycle, self.duty.samples, self.train.motor.thermal
        if thermal is None or cycle.temperature is None or cycle.copper is None:
            return ABSENT
        first = self.train.supply.ambient + float(
            thermal.warming(cycle.copper, samples.step, periodic=False)[-1]
        )
        return WindingTemperatures(
            float(cycle.temperature.max()), float(samples.mean(cycle.temperature)), first
        )

    def _inertia_ratio(self) -> list[float] | Absent:
        """Return smallest and largest inertia of the mechanism over that of the drives."""
        if self.duty.inertia is None or not self.train.reflected > 0.0:
            return ABSENT
        ratio = self.duty.inertia / self.train.reflected
        return [float(ratio.min()), float(ratio.max())]

    def _wind_up(self) -> float | Absent:
        """Return the largest angle or way by which the gears give way under the load."""
        gear = self.train.gear
        if gear is None or gear.stiffness is None:
            return ABSENT
        return float(np.abs(self.duty.load).max()) / (gear.stiffness * self.train.drive.count)

    @property
    def decides(self) -> str:
        """The limit of which most is used."""
        return max(self.uses, key=lambda name: float(self.uses[name].part))

    @property
    def margin(self) -> float:
        """Part of it that is left."""
        return 1.0 - float(self.uses[self.decides].part)

    def _errors(self) -> DriveErrors | Absent:
        times = self.duty.times
        if len(times) % 2 == 0 or len(times) < 5:
            return ABSENT
        half = Evaluated.of(self.train, self.duty.thinned())
        own, others = self._numbers(), half._numbers()
        change: dict[str, Any] = {
            name: float(np.abs(np.subtract(x, others[name])).max()) for name, x in own.items()
        }
        size = np.abs(self.cycle.torque)
        between = {
            "margin": self.uses[self.decides].off,
            "peak_torque": rise(size, np.asarray(np.argmax(size))),
        }
        for name, more in between.items():
            change[name] = max(change[name], float(more))
        for name in ("rms_current", "winding"):
            change.setdefault(name, ABSENT)
        return DriveErrors(**change)

    def _numbers(self) -> dict[str, float | list[float]]:
        """Return the figures that have errors, by the names of these."""
        side = side_of(Shaft, self.duty, self.cycle.torque, self.cycle.speed)
        found: dict[str, float | list[float]] = {
            "margin": self.margin,
            "peak_torque": side.peak_torque,
            "rms_torque": side.rms_torque,
            "mean_torque": side.mean_torque,
        }
        energies = [side.driving_energy, side.braking_energy]
        electrical, winding = electrical_of(self.cycle, self.duty.samples), self._winding()
        if electrical is not ABSENT:
            found["rms_current"] = electrical.rms_current
            energies += [electrical.energy, electrical.regenerated]
        if winding is not ABSENT:
            found["winding"] = winding.peak
        return {**found, "energy": energies}
