"""From a motion and its torques to the datasets and figures of its drives, and whether they bear their duty."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
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
    peak_use,
    rise,
)
from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import torque_terms
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.model.model import MOTION_GROUPS, PARAMETER_GROUP, TORQUE, UNKNOWN_GROUP
from robodyn_cli.model.parts import trains
from robodyn_cli.motors.drive import Train
from robodyn_cli.motors.electric import Curves
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.observe.units import JointColumns, joint_columns
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.drives import (
    DriveErrors,
    DriveFigures,
    DriveKeys,
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


UNDERSIZED = "undersized"  # status of a run with a drive that does not bear its duty


def with_drives(records: list[Any], result: Result, scene: Scene, problem: Problem) -> list[Any]:
    """Return the records of a motion's summary, the first with ``warnings``, and one of its drives behind them; add
    their datasets to the result, and its status.

    A motion whose samples are not uniform has no figures of drives, and a warning instead.
    """
    summary, *others = records
    times = result.time
    if len(times) < 2 or float(np.ptp(np.diff(times))) > 1e-9 * float(times[-1]):
        uneven = "the samples are not uniform in time, so there are no figures of drives"
        return [_warned(summary, [uneven]), *others]
    q, qd, qdd, tau = (result[name] for name in ("q", "qd", "qdd", "tau"))
    moved = Moved(times, q, qd, qdd, tau, _breaks(result))
    drives = Drives.of(scene, problem, moved)
    drives.add_to(result)
    figures = drives.figures()
    if not all(one.passes for one in figures.values()):
        result.status = UNDERSIZED
    title = scene.catalogue.title or ABSENT
    return [_warned(summary, list(_doubts(drives, figures))), *others, DriveKeys(figures, title)]


def _doubts(drives: Drives, figures: dict[str, DriveFigures]) -> Iterator[str]:
    """Yield what is not known of drives well enough."""
    for name, one in drives.evaluated.items():
        if one.train.brake is not None and "brake" not in one.uses:
            why = "data, payloads or loops leave open what holds it at rest"
            yield f"the brake of joint {name!r} is not checked: {why}"
    for name, drive in figures.items():
        if drive.errors is not ABSENT and abs(drive.margin - drive.least_margin) <= drive.errors.margin:
            yield f"the margin of joint {name!r} is as near to what is asked for as its error; take more samples"


def _warned(summary: Any, more: list[str]) -> Any:
    """Return a record of a summary with more warnings."""
    own = [] if summary.warnings is ABSENT else summary.warnings
    return dataclasses.replace(summary, warnings=[*own, *more]) if more else summary


def _breaks(result: Result) -> tuple[float, ...]:
    """Return where the torques of a motion jump, in steps from the first sample: where payloads come and go."""
    if not result.events:
        return ()
    from robodyn_cli.torques.payloads import breaks

    return tuple(breaks(result.events, result.time))


@record
class Moved:
    """A motion at uniform times (T,): q (T, nq), and rates, accelerations and actuator torques (T, nv). breaks : where
    these jump, in steps from the first sample."""

    times: Array
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    breaks: tuple[float, ...] = ()


@record
class Drives:
    """The drives of a scene in a motion, by joint."""

    problem: Problem
    evaluated: dict[str, Evaluated]

    @staticmethod
    def of(scene: Scene, problem: Problem, moved: Moved) -> Drives:
        """Return the drives of a scene along a motion."""
        rest = Standstill.of(problem, moved)
        found = {}
        for name, train in trains(scene).items():
            k = problem.model.v_names.index(name)
            reflected = float(train.reflected)
            load = moved.tau[:, k] - reflected * moved.qdd[:, k]
            inertia = None if rest.inertia is None else rest.inertia[:, k] - reflected
            hold = None if rest.hold is None else rest.hold[:, k]
            duty = Duty(moved.times, moved.qd[:, k], moved.qdd[:, k], load, hold, inertia, moved.breaks)
            found[name] = Evaluated.of(train, duty)
        return Drives(problem, found)

    def figures(self) -> dict[str, DriveFigures]:
        """Return the figures by joint."""
        model = self.problem.model
        return {
            name: one.figures(model.v_units[model.v_names.index(name)])
            for name, one in self.evaluated.items()
        }

    def add_to(self, result: Result) -> None:
        """Add the datasets of the drives; what a motor does not have is left out."""
        names = tuple(self.evaluated)
        every = list(self.evaluated.values())
        tau = joint_columns(self.problem.model)["tau"]
        units = tuple(dict(zip(tau.names, tau.column_units))[name] for name in names)
        loads = JointColumns(names, units, ("time", "drive"))
        result.add("drives/load", np.column_stack([x.duty.load for x in every]), **loads.described())
        result.add("drives/speed", np.column_stack([x.cycle.speed for x in every]), names=names)
        result.add("drives/torque", np.column_stack([x.cycle.torque for x in every]), names=names)
        use = [peak_use(x.curves, x.cycle) for x in every]
        result.add("drives/use", np.column_stack(use), names=names)
        for path, key in (("current", "current"), ("winding_temperature", "temperature")):
            columns = {n: getattr(x.cycle, key) for n, x in self.evaluated.items()}
            columns = {n: x for n, x in columns.items() if x is not None}
            if columns:
                result.add(f"drives/{path}", np.column_stack(list(columns.values())), names=tuple(columns))
        for name, one in self.evaluated.items():
            for kind in ("driving", "braking", "continuous"):
                curve = getattr(one.curves, kind)
                if curve is not None:
                    result.add(f"envelopes/{kind}/{name}", np.column_stack([curve.speeds, curve.torques]))


@record
class Standstill:
    """What the joints feel of the mechanism, (T, nv): inertia at each joint [kg m^2 or kg], rotors included, and the
    torque that holds each pose [N m or N]. None where data, payloads or the number of drives leave it open."""

    inertia: Array | None
    hold: Array | None

    @staticmethod
    def of(problem: Problem, moved: Moved) -> Standstill:
        """Return them along a motion.

        With loops, the driven joints are the coordinates of the mechanism where they are as many as its degrees of
        freedom: the others follow by v = R v_driven, and inertia and torques are diag(R^T M R) and R^T g.
        """
        prescribed = problem.constraints.prescribed
        rows = [row.psi for k, row in enumerate(problem.constraints.rows) if k not in prescribed]
        M, terms = problem.mass_matrix, list(torque_terms(problem).values())
        hold: list[Any] = [sum((term[k] for term in terms[1:]), terms[0][k]) for k in range(problem.model.nv)]
        outputs: dict[str, list[Scalar]] = {"M": list(M.flat), "hold": hold}
        groups = {n: {symbol.value[1] for symbol in free_symbols(x)} for n, x in outputs.items()}
        outputs = {n: x for n, x in outputs.items() if not groups[n] & {UNKNOWN_GROUP, PARAMETER_GROUP}}
        outputs["psi"] = [x for row in rows for x in row]
        still = np.zeros_like(moved.qd)
        arrays = SampleFunction(outputs, MOTION_GROUPS, len(moved.times))(
            t=moved.times[:, None], q=moved.q, v=still, a=still, p=np.zeros((len(moved.times), 0))
        )
        nv = problem.model.nv
        R = following(problem, arrays["psi"].reshape(len(moved.times), len(rows), nv))
        if R is None:
            return Standstill(None, None)
        M_t = arrays["M"].reshape(-1, nv, nv) if "M" in arrays else None
        inertia = None if M_t is None else np.einsum("tik,tij,tjk->tk", R, M_t, R)
        return Standstill(inertia, np.einsum("tik,ti->tk", R, arrays["hold"]) if "hold" in arrays else None)


def following(problem: Problem, psi: Array) -> Array | None:
    """Return R (T, nv, nv), whose column k is the motion of all joints while joint k moves and the other driven ones
    rest; None where these motions are not unique."""
    samples, rows, nv = psi.shape
    if rows == 0:
        return np.broadcast_to(np.eye(nv), (samples, nv, nv))
    names = problem.model.v_names
    driven = [names.index(name) for name in problem.scene.drives]
    others = [k for k in range(nv) if k not in driven]
    if np.linalg.matrix_rank(psi[samples // 2]) != len(others):
        return None
    R = np.zeros((samples, nv, nv))
    R[:, driven, driven] = 1.0
    follow = -np.linalg.pinv(psi[:, :, others]) @ psi[:, :, driven]
    R[np.ix_(range(samples), others, driven)] = follow
    return R
