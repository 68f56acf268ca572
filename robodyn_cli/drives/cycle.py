"""What a duty cycle asks of a motor and its gear, at all samples: torques, currents, losses, temperatures."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.motors.drive import Train
from robodyn_cli.motors.electric import Curves, Electric, Motor, Supply
from robodyn_cli.motors.gear import Transmission
from robodyn_cli.motors.kinds import StepperMotor
from robodyn_cli.record import record
from robodyn_cli.solve.extremes import largest_of_each, tops
from robodyn_cli.solve.quadrature import integrate, pieces, summed
from robodyn_cli.spatial.algebra import Array


@record
class CycleSamples:
    """Samples in time, and integrals of what they are of.

    times : of the samples (T,) [s]. breaks : where functions jump, in steps from the first sample (see ``quadrature``).
    """

    times: Array
    breaks: tuple[float, ...] = ()

    def mean(self, y: Array) -> Array:
        """Return the time averages (...,) of y (..., T)."""
        flat = y.reshape(-1, y.shape[-1]).T
        duration = self.times[-1] - self.times[0]
        means: Array = summed(integrate, self.times, flat, self.breaks).reshape(y.shape[:-1]) / duration
        return means

    def rms(self, y: Array) -> Array:
        """Return the roots of the time averages of y^2."""
        return np.sqrt(np.maximum(0.0, self.mean(y * y)))


@record
class Duty:
    """The motion of a joint and what its drives must bear, at T samples.

    speed, acceleration : (T,) of its coordinate [rad or m, per s and s^2]. load : (T,) torque or force that the gears
    give the mechanism [N m or N], that of rotors and gears left out. hold : (T,) what holds the pose at rest. inertia :
    (T,) of the mechanism at the joint, without the drive [kg m^2 or kg]. None where they are not known.
    """

    times: Array
    speed: Array
    acceleration: Array
    load: Array
    hold: Array | None = None
    inertia: Array | None = None
    breaks: tuple[float, ...] = ()

    @property
    def samples(self) -> CycleSamples:
        """Its samples."""
        return CycleSamples(self.times, self.breaks)

    def thinned(self) -> Duty:
        """Return half as many samples of each uniform stretch: every second one, or, of an even number, those that lie
        on straight lines."""
        parts = []
        for part in pieces(self.times):
            ends = self.times[part.first], self.times[part.first + part.samples - 1]
            parts.append(np.linspace(*ends, max((part.samples + 1) // 2, 2)).ravel())
        times = np.unique(np.concatenate(parts))
        arrays = {x: getattr(self, x) for x in ("speed", "acceleration", "load", "hold", "inertia")}
        half: dict[str, Any] = {
            name: None if x is None else np.interp(times, self.times, x) for name, x in arrays.items()
        }
        places = np.interp(times, self.times, np.arange(float(len(self.times))))
        breaks = np.interp(self.breaks, places, np.arange(float(len(times))))
        return dataclasses.replace(self, times=times, **half, breaks=tuple(breaks.tolist()))


@record
class ShaftDuty:
    """What is asked of one motor's shaft, (..., T): speed [rad/s], acceleration [rad/s^2], torque into the gear [N m].

    inertia : what turns with the rotor, (..., 1) or a number [kg m^2]; the rotor's own is the motor's.
    """

    speed: Array
    acceleration: Array
    torque: Array
    inertia: Any

    @staticmethod
    def by(train: Train, duty: Duty) -> ShaftDuty:
        """Return what a duty asks of each motor of a drive."""
        n, share = train.turns, duty.load / train.drive.count
        into = share if train.gear is None else train.gear.input_load(share, duty.speed)
        return ShaftDuty(
            n * duty.speed, n * duty.acceleration, into / n, train.inertia - train.motor.rotor_inertia
        )

    def only(self, rows: Any) -> ShaftDuty:
        """Return some rows of many."""
        return ShaftDuty(self.speed[rows], self.acceleration[rows], self.torque[rows], self.inertia[rows])


@record
class MotorCycle:
    """A motor under what is asked of it, (..., T).

    torque : at the shaft, the acceleration of its rotor included and the friction of its bearings not [N m].
    current [A], friction : losses of the bearings [W], of motors whose data say so. copper : losses of the winding [W]
    and temperature [degC] in the steady periodic state. None where they are not known. settles : whether there is such
    a state (...,).
    """

    speed: Array
    torque: Array
    current: Array | None = None
    friction: Array | None = None
    copper: Array | None = None
    temperature: Array | None = None
    settles: Any = True

    @property
    def power(self) -> Array:
        """Mechanical power at the shaft [W]."""
        return self.torque * self.speed

    @property
    def electrical(self) -> Array | None:
        """Power at the terminals [W]."""
        if self.friction is None or self.copper is None:
            return None
        total: Array = self.power + self.friction + self.copper
        return total


def motor_cycle(motor: Motor, supply: Supply, shaft: ShaftDuty, samples: CycleSamples) -> MotorCycle:
    """Return what a motor does in a cycle."""
    speed = shaft.speed
    torque = shaft.torque + (motor.rotor_inertia + shaft.inertia) * shaft.acceleration
    if isinstance(motor, Electric):
        current = motor.current(torque, speed)
        return _heated(
            motor, supply, motor.copper(current), samples,
            MotorCycle(speed, torque, current, motor.friction(speed) * speed),
        )  # fmt: skip
    if isinstance(motor, StepperMotor) and motor.losses is not None:
        return _heated(motor, supply, np.full_like(torque, motor.losses), samples, MotorCycle(speed, torque))
    return MotorCycle(speed, torque)


def _heated(
    motor: Motor, supply: Supply, cold: Array, samples: CycleSamples, cycle: MotorCycle
) -> MotorCycle:
    """Return the cycle with losses of the winding and temperatures.

    The resistance is that at the mean temperature in the steady state; where there is none, since losses grow faster
    than the heat leaves, at the largest temperature that is allowed.

    Parameters
    ----------
    cold : losses (..., T) with the resistance at 25 degC [W].
    """
    parts = (cycle.speed, cycle.torque, cycle.current, cycle.friction)
    thermal = motor.thermal
    if thermal is None:
        return MotorCycle(*parts, copper=cold)
    mean = thermal.steady_mean(samples.mean(cold), supply.ambient)
    settles = np.isfinite(mean)
    growth = thermal.growth(np.where(settles, mean, thermal.max_temperature))
    copper = cold * growth[..., None]
    warm = supply.ambient + thermal.warming(copper, samples.times, periodic=True)
    return MotorCycle(*parts, copper, warm, settles)


# -- limits ------------------------------------------------------------------------------------------------
ALIKE = 1e-3  # part of a use, within which another one counts as large


@record
class Use:
    """How much of a limit a cycle uses (...,), 1 : all of it; at : the time that decides [s], None for a mean;
    samples, used : samples and uses (T,) of one cycle, of which it is the largest."""

    part: Array
    at: Array | None = None
    samples: CycleSamples | None = None
    used: Array | None = None

    @staticmethod
    def most(part: Array, samples: CycleSamples) -> Use:
        """Return the largest use of samples (..., T): of one cycle between the samples too, see ``extremes``."""
        columns = part.reshape(-1, part.shape[-1]).T
        value, at = (x.reshape(part.shape[:-1]) for x in tops(samples.times, columns, samples.breaks))
        return Use(value, at) if part.ndim > 1 else Use(value, at, samples, part)

    def rivals(self, error: float = 0.0) -> float:
        """Return how far from its time another peak is about as large, but for an error: a motion that is integrated is
        known to some digits only, and either may be the largest."""
        assert self.samples is not None and self.used is not None and self.at is not None
        times, alike = self.samples.times, self.used >= self.part - max(ALIKE * self.part, 2.0 * error)
        peaks = np.split(np.arange(len(times)), np.flatnonzero(np.diff(alike.astype(int))) + 1)
        near = int(np.argmin(np.abs(times - self.at)))
        others = [x for x in peaks if alike[x[0]] and not x[0] - 1 <= near <= x[-1] + 1]
        apart = [float(np.abs(times[x] - self.at).max()) for x in others]
        return float(max(apart, default=0.0))


def errors_of(uses: Mapping[str, Use]) -> dict[str, tuple[float, float]]:
    """Return the errors of uses of one cycle and of their times, by name, zero of means; a search, which needs none,
    does not pay for them."""
    found = dict.fromkeys(uses, (0.0, 0.0))
    known = {
        name: (use, use.samples, use.used[:, None])
        for name, use in uses.items()
        if use.samples is not None and use.used is not None
    }
    if known:
        _, samples, _ = next(iter(known.values()))
        tops_of = largest_of_each(samples.times, [used for *_, used in known.values()], samples.breaks)
        for (name, (use, *_)), top in zip(known.items(), tops_of):
            part, at = abs(top.value[0] - use.part), abs(top.time[0] - use.at)
            found[name] = float(top.error[0] + part), float(top.time_error[0] + at + use.rivals())
    return found


def peak_use(curves: Curves, cycle: MotorCycle) -> Array:
    """Return how much of its envelope a motor uses, (..., T): while it brakes, of that for braking."""
    if curves.braking is curves.driving:
        return curves.driving.use(cycle.speed, cycle.torque)
    use, brakes = np.empty_like(cycle.torque), cycle.power < 0.0
    for curve, where in ((curves.driving, ~brakes), (curves.braking, brakes)):
        use[where] = curve.use(cycle.speed[where], cycle.torque[where])
    return use


def motor_limits(
    motor: Motor, supply: Supply, curves: Curves, cycle: MotorCycle, samples: CycleSamples
) -> dict[str, Use]:
    """Return how much of each of its limits a motor uses, by name.

    ``peak`` : of its envelope. ``continuous`` : of its rated current, or of its continuous envelope at the rms
    speed. ``winding`` : of the warming that its winding bears.
    """
    uses = {"peak": Use.most(peak_use(curves, cycle), samples)}
    thermal = motor.thermal
    if isinstance(motor, Electric) and motor.rated_current is not None:
        assert cycle.current is not None
        uses["continuous"] = Use(samples.rms(cycle.current) / motor.rated_current)
    elif curves.continuous is not None and thermal is None:
        uses["continuous"] = Use(curves.continuous.use(samples.rms(cycle.speed), samples.rms(cycle.torque)))
    if thermal is not None and cycle.temperature is not None:
        bears = thermal.max_temperature - supply.ambient
        part = (cycle.temperature - supply.ambient) / bears
        # the losses of a stepper are always the same
        uses["winding"] = Use(part.max(axis=-1)) if cycle.current is None else Use.most(part, samples)
    return uses


def gear_limits(
    gear: Transmission, load: Array, speed: Array, turns: Any, samples: CycleSamples
) -> dict[str, Use]:
    """Return how much of each of its limits a gear uses, by name.

    ``gear_peak`` : of its peak torque. ``gear_rated`` : of its rated torque by the mean

        L_m^3 = (integral of |qd| |L|^3) / (integral of |qd|)

    (the largest torque where nothing turns). ``gear_speed`` : of its largest speed. load, speed : (..., T) of one gear
    at the joint.
    """
    uses: dict[str, Use] = {}
    size, rate = np.abs(load), np.abs(speed)
    if gear.peak_torque is not None:
        uses["gear_peak"] = Use.most(size / gear.peak_torque, samples)
    if gear.rated_torque is not None:
        turned = samples.mean(rate)
        cube = samples.mean(rate * size**3)
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.cbrt(np.maximum(cube, 0.0) / turned)
        uses["gear_rated"] = Use(np.where(turned > 0.0, mean, size.max(axis=-1)) / gear.rated_torque)
    if gear.max_speed is not None:
        uses["gear_speed"] = Use.most(rate * turns / gear.max_speed, samples)
    return uses


def other_limits(train: Train, duty: Duty) -> dict[str, Use]:
    """Return how much of each limit of gear and brake is used, by name; ``brake`` : of the torque that it holds."""
    uses: dict[str, Use] = {}
    if train.gear is not None:
        share = duty.load / train.drive.count
        uses |= gear_limits(train.gear, share, duty.speed, train.turns, duty.samples)
    if train.brake is not None and duty.hold is not None:
        held = train.brake.holding_torque * train.turns * train.drive.count
        uses["brake"] = Use.most(np.abs(duty.hold) / held, duty.samples)
    return uses
