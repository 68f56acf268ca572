"""The motion of a scene as a unit of FMI: what can be set while it goes on, and what it puts out."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from robodyn_cli.errors import CapabilityError, of_option
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.kernels.program import make_program
from robodyn_cli.model.model import TORQUE
from robodyn_cli.model.places import with_free
from robodyn_cli.observe.control import SIGNALS, control_columns
from robodyn_cli.observe.observe import observed
from robodyn_cli.observe.reactions import REACTION_GROUPS, ReactionSamples
from robodyn_cli.over.fmu.set_points import SetPoints
from robodyn_cli.over.live.code import StateEquations
from robodyn_cli.over.live.keys import ends_of
from robodyn_cli.over.live.structure import STATE
from robodyn_cli.over.loop_c.structure import CStructure
from robodyn_cli.over.many.keys import NUMBER
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.over.many.simulate import MotionCommand
from robodyn_cli.over.many.structure import Structure
from robodyn_cli.record import record
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene, Signal
from robodyn_cli.spatial.algebra import Array

AXES = ("x", "y", "z")
ACCELERATIONS, MULTIPLIERS = "qdd", "lam"


@record
class FmuOutput:
    """One number that a unit puts out: its name, unit, and what it is."""

    name: str
    unit: str
    meaning: str


class FmuStructure(CStructure):
    """The motion of a scene with keys that are parameters, and inputs that other tools change between steps."""

    where = "leave as a unit of FMI"

    def __init__(
        self,
        family: Family,
        ranges: Mapping[str, tuple[float, float]],
        inputs: Sequence[str] = (),
        points: SetPoints | None = None,
    ) -> None:
        self.inputs, self.points = tuple(inputs), points
        super().__init__(family, ranges)

    @property
    def is_led(self) -> bool:
        return self.points is not None

    def shown(self, name: str) -> str:
        """Return what the variable of a key is called."""
        return name if self.points is None else self.points.names.get(name, name)

    def unit_of(self, name: str, unit: str) -> str:
        """Return the unit of a key, where this is what the scene says."""
        return unit if self.points is None else self.points.units.get(name, unit)

    @property
    def time_of_points(self) -> int:
        """The number of the key that says from when on rates of set points count; -1 without one."""
        names = [key.key.name for key in self.keys]
        return -1 if self.points is None else names.index(self.points.time)

    def _option(self, name: str) -> str:
        return "--input" if name in self.inputs else "--key"

    def _structure(self, mechanism: Mechanism) -> Structure:
        places = []
        for k, key in enumerate(self.keys):
            if key.key.name in self.inputs:
                if key.key.sort != NUMBER:
                    raise of_option(
                        f"--input {key.key.name}",
                        "allowed: numbers of the equations, as torques, forces, parameters",
                        CapabilityError,
                    )
                # an input of zero is a number as any other
                if key.value in key.key.special:
                    self.stays.append(k)
                self.keys[k] = dataclasses.replace(key, key=dataclasses.replace(key.key, special=()))
                places.append(key.key.place)
        if places:
            self.command = _with_free_numbers(self.command, places)
        return super()._structure(mechanism)

    def _corners(self) -> list[Array]:
        """Return rows of values at the ends of the ranges; those of inputs are no structure."""
        own = [
            k
            for k, key in enumerate(self.keys)
            if key.key.name not in self.inputs and math.isfinite(key.low + key.high)
        ]
        rows = []
        for k in own:
            for x in ends_of(self.keys[k]):
                row = self.row.copy()
                row[k] = x
                rows.append(row)
        return [*rows, *self._beside()]

    # -- outputs --------------------------------------------------------------------------------------
    @cached_property
    def observed(self) -> dict[str, list[Any]]:
        """The expressions that are put out beside the states, by name."""
        left = ("forces.", "eta", "psi", "latch_loads", "skeleton/", "frames/")
        outputs = {
            name: list(entries)
            for name, entries in observed(self.motion.problem).items()
            if not name.startswith(left)
        }
        return {name: entries for name, entries in outputs.items() if _known(entries)}

    @cached_property
    def reactions(self) -> ReactionSamples | None:
        """Loads in joints and closures, where the scene asks for them."""
        problem = self.motion.problem
        needed = {ACCELERATIONS, *([MULTIPLIERS] if problem.constraints.rows else [])}
        if not problem.scene.outputs.reactions or not needed <= self.observed.keys():
            return None
        return ReactionSamples(problem, problem.scene.simulate.samples)

    @cached_property
    def equations(self) -> dict[str, StateEquations]:
        """Equations of the state, those of outputs among them: behind the states stand time and what is put out."""
        system = self.motion.system
        places = {"q": list(system.q_places), "v": list(system.v_places), "t": [system.size]}
        places["z"] = list(range(system.size - system.further, system.size))
        more = {}
        if self.observed:
            more["outputs"] = StateEquations(make_program(dict(self.observed), STATE), places)
        if self.reactions is not None:
            at, first = {}, system.size + 1
            for name, entries in self.observed.items():
                at[name] = list(range(first, first + len(entries)))
                first += len(entries)
            loads = {**places, "a": at[ACCELERATIONS], "lam": at.get(MULTIPLIERS, [])}
            program = make_program(dict(self.reactions.function.outputs), REACTION_GROUPS)
            more["reactions"] = StateEquations(program, loads)
        return {**super().equations, **more}

    @property
    def outputs(self) -> list[FmuOutput]:
        """What is put out beside the states, in order."""
        found: list[FmuOutput] = []
        for name, entries in self.observed.items():
            found += self._named(name, len(entries))
        if self.reactions is not None:
            units = dict(zip(("fx", "fy", "fz", "mx", "my", "mz"), ["N"] * 3 + ["N m"] * 3))
            for path in self.reactions.function.outputs:
                own, words = self.reactions.names[path], self.reactions.meanings[path]
                found += [FmuOutput(f"{path.replace('/', '.')}.{x}", units[x], words) for x in own]
        return found

    def _named(self, name: str, count: int) -> list[FmuOutput]:
        problem = self.motion.problem
        model, scene = problem.model, problem.scene
        if name == ACCELERATIONS:
            units = [f"{unit}/s^2" for unit in model.v_units]
            return [FmuOutput(f"qdd.{x}", u, "acceleration") for x, u in zip(model.v_names, units)]
        if name == "tau":
            return [
                FmuOutput(f"tau.{x}", TORQUE[u], "actuator torque")
                for x, u in zip(model.v_names, model.v_units)
            ]
        if name == "energy":
            return [FmuOutput(f"energy.{x}", "J", f"{x} energy") for x in ("kinetic", "potential")]
        if name == MULTIPLIERS:
            return [
                FmuOutput(f"constraints.{row.name}", TORQUE[row.unit], "Lagrange multiplier of a constraint")
                for row in problem.constraints.rows
            ]
        path = name.replace(".", "/")
        if path in (columns := control_columns(problem)):
            own = columns[path]
            units = own.get("column_units") or [own["units"]] * count
            return [FmuOutput(f"{name}.{x}", u, own["long_name"]) for x, u in zip(own["names"], units)]
        if name == SIGNALS:
            return [
                FmuOutput(f"signals.{x}", s.unit if isinstance(s, Signal) else "1", "signal")
                for x, s in scene.outputs.signals.items()
            ]
        return [FmuOutput(f"{name.replace('/', '.')}.{x}", "m", "place in the world") for x in AXES[:count]]


def _known(entries: Sequence[Any]) -> bool:
    """Tell whether expressions depend on the state and time alone."""
    return {symbol.value[1] for symbol in free_symbols(entries)} <= {"t", "q", "v", "z"}


def _with_free_numbers(command: MotionCommand, places: Sequence[str]) -> MotionCommand:
    """Return the command with motions in which the numbers at some places are no structure whatever they are."""
    free = copy.copy(command)

    def build(scene: Scene) -> Any:
        return command.build(with_free(scene, places))

    free.build = build  # type: ignore[method-assign]
    return free
