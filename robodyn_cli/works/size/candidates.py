"""All combinations of a catalogue for one joint, how much of its limits each uses, and how torques depend on the masses
and inertias of drives.

A torque of inverse dynamics is linear in the inertial data of the bodies (C. G. Atkeson, C. H. An and J. M. Hollerbach,
IJRR 5(3), 1986), and so are the torques that share a load. With the drives' masses m_j on their links and the inertias
I_j that they reflect on their joints,

    tau = tau_0 + sum_j m_j A_j + sum_j I_j B_j.

The equations are built once, with numbers for m_j and I_j; tables with one of them changed give A_j and B_j.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.drives.cycle import Duty, ShaftDuty, Use, motor_cycle, motor_limits, other_limits
from robodyn_cli.drives.report import following
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.many import ManyNumbers, Recipe
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.motors.drive import NOWHERE, Catalogue, Drive, Train
from robodyn_cli.motors.electric import Curves, Electric, Motor, Supply
from robodyn_cli.motors.gear import Belt
from robodyn_cli.motors.kinds import TorqueTable
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.extremes import largest_magnitude
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.torques.checks import breaks_of, settled
from robodyn_cli.torques.program import InverseProgram, Sampled
from robodyn_cli.works.inverse import evaluated, looked_at, planned_at, program_of

SPEED = "speed"  # limit of a motor that is not run, by its top speed

# a drive of 1 kg that reflects 1 kg m^2 or 1 kg
UNIT = Catalogue(
    motors={
        "unit": TorqueTable(
            type="envelope", peak=((0.0, 1.0), (1.0, 1.0)), continuous=((0.0, 1.0), (1.0, 1.0))
        )
    },
    gears={
        "rad": Belt(type="belt", motor_radius=1.0, joint_radius=1.0),
        "m": Belt(type="belt", motor_radius=1.0),
    },
)


@record
class DriveLoads:
    """What is linear in masses and inertias, for n drives: tau (T, nv) [N m or N], without drives, and by unit of each.

    none : (T, nv). by_mass, by_inertia : (n, T, nv), zero for a mass that is not carried or does not vary.
    """

    none: Array
    by_mass: Array
    by_inertia: Array

    def at(self, masses: Array, inertias: Array) -> Array:
        """Return tau (T, nv) for masses and inertias (n,)."""
        tau: Array = (
            self.none + np.tensordot(masses, self.by_mass, 1) + np.tensordot(inertias, self.by_inertia, 1)
        )
        return tau


@record
class Responses:
    """A motion, and the torques that drives of any mass and inertia need for it.

    joints : that are driven. times : (T,). qd, qdd : (T, nv). tau : of the motion. hold : at rest in its poses, None
    where loops leave it open. breaks : where torques jump, in steps from the first sample.
    """

    scene: Scene
    joints: tuple[str, ...]
    columns: tuple[int, ...]
    times: Array
    qd: Array
    qdd: Array
    tau: DriveLoads
    hold: DriveLoads | None
    breaks: tuple[float, ...]

    @staticmethod
    def of(scene: Scene, drives: dict[str, Drive]) -> Responses:
        """Return the responses of a scene whose joints have these drives, whatever their parts.

        Raises
        ------
        RobodynError : see ``inverse``. CapabilityError : the motion depends on the drives.
        """
        unit = with_unit_drives(scene, drives)
        program = program_of(unit)
        planned = looked_at(program, scene.inverse.samples, lambda times: planned_at(program, times))
        sampled = evaluated(program, planned)
        variants = _Variants.of(program, unit, tuple(drives))
        hold = variants.loads(program, sampled, still=True)
        R, names = None, program.problem.model.v_names
        if hold is not None:
            loops = sampled.loops
            psi = np.zeros((len(planned.times), 0, program.problem.model.nv)) if loops is None else loops.psi
            R = following(psi, [names.index(name) for name in program.problem.scene.drives])
        tau = variants.loads(program, sampled)
        assert tau is not None
        return Responses(
            scene, tuple(drives), tuple(names.index(name) for name in drives), planned.times,
            settled(sampled.motion.qd), sampled.motion.qdd, tau,
            None if R is None or hold is None else _projected(hold, R),
            tuple(breaks_of(program.problem, planned.times, sampled.motion)),
        )  # fmt: skip


def with_unit_drives(scene: Scene, drives: dict[str, Drive]) -> Scene:
    """Return the scene whose drives have a mass of 1 kg and reflect an inertia of one unit each.

    Raises
    ------
    CapabilityError : the motion depends on the drives.
    """
    if scene.trajectory is not None and scene.trajectory.least_time:
        raise CapabilityError(
            "the times of a path of type fastest follow from the torques, and these from the drives; give its "
            "result as a trajectory of type table, and size that"
        )
    units = {
        joint.name: joint_types[joint.type].v_units[0] for joint in scene.robot.joints if joint.name in drives
    }
    unit_drives = {}
    for name, drive in drives.items():
        own = None if drive.mass_on == NOWHERE else 1.0 if drive.mass is None else drive.mass
        unit_drives[name] = Drive(
            motor="unit", gear=units[name], count=drive.count, coupling_inertia=1.0, mass=own, mass_on=drive.mass_on,
            mass_at=drive.mass_at,
        )  # fmt: skip
    return dataclasses.replace(scene, drives=unit_drives, catalogue=UNIT)


def _projected(loads: DriveLoads, R: Array) -> DriveLoads:
    """Return the loads along the motions R (T, nv, nv) of single joints."""
    return DriveLoads(
        np.einsum("tik,ti->tk", R, loads.none),
        np.einsum("tik,nti->ntk", R, loads.by_mass),
        np.einsum("tik,nti->ntk", R, loads.by_inertia),
    )


@record
class _Variants:
    """A compiled program, and its tables of numbers: as it is, then with one mass doubled, then one inertia.

    masses, inertias : the drives' own in the first table, as all of a joint's drives have them; ``masses`` is 0 where
    there is none to vary.
    """

    kernel: SampleKernel
    outputs: tuple[str, ...]
    tables: Array
    masses: Array
    inertias: Array

    @staticmethod
    def of(program: InverseProgram, scene: Scene, joints: Sequence[str]) -> _Variants:
        outputs = dict(program.terms)
        if program.others.get("psi"):
            outputs["psi"] = program.others["psi"]
        kernel = SampleKernel({f"o{k}": list(x) for k, x in enumerate(outputs.values())}, MOTION_GROUPS)
        drives = [scene.drives[name] for name in joints]
        keys = ("mass", "coupling_inertia")
        own = {f"drives.{n}.{key}": getattr(d, key) for key in keys for n, d in zip(joints, drives)}
        own = {place: 0.0 if x is None else x for place, x in own.items()}
        rows = np.tile(np.array(list(own.values())), (1 + len(own), 1))
        rows[1:] += np.diag(rows[0])
        numbers = ManyNumbers(Recipe(list(own)), dict(zip(own, rows.T)), len(rows))
        count = np.array([drive.count for drive in drives], dtype=float)
        masses = count * [own[f"drives.{n}.mass"] for n in joints]
        tables = numbers.table(kernel.program.numbers or (0.0,))
        return _Variants(kernel, tuple(outputs), tables, masses, count)

    def loads(self, program: InverseProgram, sampled: Sampled, still: bool = False) -> DriveLoads | None:
        """Return torques of the motion, or with ``still`` what the joints bear at rest in its poses."""
        motion, samples = sampled.motion, len(sampled.times)
        at_rest = np.zeros_like(motion.qd)
        groups = {"t": sampled.times[:, None], "q": motion.q, "v": at_rest if still else motion.qd,
                  "a": at_rest if still else motion.qdd, "p": sampled.p}  # fmt: skip
        arrays = self.kernel.of_tables(self.tables, samples, groups)
        torques = []
        for k in range(len(self.tables)):
            parts = {n: arrays[f"o{i}"][k].T for i, n in enumerate(self.outputs)}
            psi = parts.pop("psi", np.zeros((samples, 0)))
            if still:
                tau = np.sum(list(parts.values()), axis=0)
            else:
                tau = program.shared(parts, psi, sampled, np.arange(samples))
            if tau is None:
                return None
            torques.append(tau)
        n = len(self.masses)
        by_mass, by_inertia = (np.array(x) - torques[0] for x in (torques[1 : n + 1], torques[n + 1 :]))
        by_mass /= np.where(self.masses > 0.0, self.masses, 1.0)[:, None, None]
        by_inertia /= self.inertias[:, None, None]
        none = DriveLoads(torques[0], by_mass, by_inertia).at(-self.masses, -self.inertias)
        return DriveLoads(none, by_mass, by_inertia)


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
        speed = float(largest_magnitude(duty.times, duty.speed[:, None], duty.breaks).value[0])
        fast = speed * np.array([float(train.turns) for train in trains])
        uses = _Uses((len(self.motors), len(self.gears)))
        for k, train in enumerate(trains):
            uses.keep((slice(None), k), other_limits(train, duty))
        tops = np.array([np.inf if curve is None else curve.driving.top_speed for curve in self.curves])
        uses.table[SPEED] = fast / tops[:, None]
        able = self.usable & (uses.most <= 1.0)
        shafts = _rows([ShaftDuty.by(train, duty) for train in trains])
        self._run_motors(uses, able, shafts, duty)
        if not np.any(self.usable & (uses.most <= 1.0)):  # which comes nearest is told by all limits
            self._run_motors(uses, self.usable & ~able, shafts, duty)
        if "peak" in uses.table:  # which is never less
            uses.table[SPEED][np.isfinite(uses.table["peak"])] = np.nan
        return uses.table

    def margins(self, uses: Mapping[str, Array]) -> Array:
        """Return the margin of each combination (M, G) by the uses of its limits, -inf where it cannot run."""
        return np.where(self.usable, 1.0 - stacked(uses).max(axis=0), -np.inf)

    def _run_motors(self, uses: _Uses, which: NDArray[np.bool_], shafts: ShaftDuty, duty: Duty) -> None:
        """Keep the uses of the motors' limits, of combinations ``which`` (M, G); ``shafts`` : by each gear."""
        for k, (name, curve) in enumerate(zip(self.motors, self.curves)):
            rows = np.flatnonzero(which[k])
            if len(rows) == 0 or curve is None:
                continue
            motor, supply = self.catalogue.motors[name], Supply(self.drive.voltage, self.drive.ambient)
            cycle = motor_cycle(motor, supply, shafts.only(rows), duty.samples)
            uses.keep((k, rows), motor_limits(motor, supply, curve, cycle, duty.samples))


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
        largest: Array = stacked(self.table).max(axis=0)
        return largest


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


def _rows(duties: Sequence[ShaftDuty]) -> ShaftDuty:
    """Return what several gears ask of a motor, a row each."""
    speed, acceleration, torque = (
        np.stack([getattr(x, key) for x in duties]) for key in ("speed", "acceleration", "torque")
    )
    return ShaftDuty(speed, acceleration, torque, np.array([[float(x.inertia)] for x in duties]))
