"""A structure as texts and data: all that its runs take where there is no Python."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

from robodyn_cli.commands import places
from robodyn_cli.errors import CapabilityError
from robodyn_cli.integration_methods import STIFF
from robodyn_cli.integrators.event_location.locate_event import PLACES
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, Location, Status
from robodyn_cli.integrators.stepping.many import JOB
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.kernels.compiler import Target
from robodyn_cli.kernels.program import make_program
from robodyn_cli.kernels.wasm import WASM, WasmModule
from robodyn_cli.motion.self_check import is_judged_by_energy
from robodyn_cli.over.commands import locks
from robodyn_cli.over.live.closing import closing_data, closing_of
from robodyn_cli.over.live.code import (
    PASSED,
    StateEquations,
    equations_text,
    loop_texts,
    notes_text,
    numbers_text,
)
from robodyn_cli.over.live.inertia import inertia_equations
from robodyn_cli.over.live.judging import Judging
from robodyn_cli.over.live.keys import LiveScene, cannot, columns, entries_of
from robodyn_cli.over.live.picture import picture_of
from robodyn_cli.over.live.rules import plain
from robodyn_cli.over.many.command import VERDICT
from robodyn_cli.over.many.groups import first_of
from robodyn_cli.over.many.integrate import RunBatch
from robodyn_cli.over.many.keys import NUMBER, START
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.over.many.simulate import MotionCommand
from robodyn_cli.over.many.structure import Structure
from robodyn_cli.registry import Registry
from robodyn_cli.scene.load import Family
from robodyn_cli.solve.closing.together import ManyClosing

SHOWN = 400  # stretches between samples that a picture takes, at most
STATE = ("t", "q", "v", "z")


def motion_commands() -> dict[str, MotionCommand]:
    """Return the commands whose runs a page makes, by name."""
    batches: Registry[Any] = Registry("robodyn_cli", places("batch"), made=True)
    return {name: own for name, own in batches.items() if isinstance(own, MotionCommand)}


class LiveStructure(LiveScene):
    """The motion of a scene with some keys that vary within ranges, see ``LiveScene``."""

    in_page = True  # where times of events that are passed are told

    def __init__(self, family: Family, ranges: Mapping[str, tuple[float, float]]) -> None:
        super().__init__(family, ranges, motion_commands())
        self.structure = self._structure(self.mechanism)
        self.motion = self.structure.motion
        self.method = self.motion.choice.method
        if why := self.obstacle:
            raise CapabilityError(why, cannot(self.where))
        self.fleet = self.structure.fleet(self.method)
        self.system = self.fleet.system
        self.engine = self.fleet.engine
        self.batch = RunBatch.of(self.structure, self.row[None], None, None, 1)
        self.closing = self._closing()
        self.tables = Tables([*self.fleet.tables.programs, *(own.program for own in self.equations.values())])

    def _structure(self, mechanism: Mechanism) -> Structure:
        """Return the structure that serves the scene and the corners of its ranges."""
        return self._built(mechanism, Structure)

    @property
    def obstacle(self) -> str:
        """Why runs of this scene stay with the command; nothing if they can leave."""
        motion, scene = self.motion, self.motion.scene
        control = motion.problem.control
        choice = motion.choice
        quasi = any(body.joint.quasi for body in motion.problem.model.bodies)
        if why := self.command.beyond(motion):
            return why
        reasons = {
            VERDICT: bool(scene.drives) or scene.motorisation is not None,
            "no errors are estimated (simulate.error_estimate)": not scene.simulate.error_estimate,
            "the motion turns stiff, so that its method changes on the way": choice.may_change
            and choice.method == STIFF,
            "sensors are noisy, whose random numbers the command draws": control is not None
            and bool(control.channels),
            "errors follow from rounding that is measured on the way": self.in_page
            and motion.system.is_rounded,
            "latches close": motion.system.closings is not None or bool(scene.deploy.latches),
            "loops of joints with quaternions are closed in Python": quasi
            and bool(motion.problem.constraints.rows),
        }
        return first_of(reasons)

    def _closing(self) -> ManyClosing | None:
        """Return what closes the loops at the start for other values; None where they stay as they are."""
        starts = [key.key.place.partition(".")[::2] for key in self.keys if key.key.sort == START]
        closing = closing_of(self.motion, self.batch.numbers, starts)
        if closing is not None and self.motion.problem.constraints.rheonomic:
            raise CapabilityError(
                "a motion is prescribed, and keys have a part in it or in the loops", cannot(self.where)
            )
        if closing is not None and len(closing.missing) == closing.nv:
            raise CapabilityError("no coordinate is given where its loops are closed", cannot(self.where))
        return closing

    # -- equations ------------------------------------------------------------------------------------
    @cached_property
    def equations(self) -> dict[str, StateEquations]:
        """Equations of the state that a page evaluates beside its runs, by name."""
        from robodyn_cli.observe.observe import potential_energy

        motion = self.motion
        problem = motion.problem
        outputs: dict[str, Any] = {}
        if self.closing is not None:
            outputs["loops"] = self.closing.equations
        if is_judged_by_energy(motion):
            outputs["energies"] = {"kinetic": [problem.kinetic], "potential": [potential_energy(problem)]}
        if self.structure.begun is not None and problem.control is not None:
            outputs["begun"] = {"z": problem.control.begun}
        if bodies := inertia_equations(motion, self.structure.recipe):
            outputs["inertia"] = bodies
        if locks(self.command.name):
            outputs["psi"] = {"psi": problem.psi[problem.constraints.of_loops].ravel().tolist()}
        if motion.choice.may_change:
            outputs["jacobian"] = {"jacobian": motion.system.jacobian.J.ravel().tolist()}
        if picture := self._picture():
            outputs["picture"] = picture
        system = motion.system
        mechanism = {"q": list(system.q_places), "v": list(system.v_places)}
        end = system.nq + system.nv
        own = {"q": range(system.nq), "v": range(system.nq, end), "z": range(end, system.size)}
        return {
            name: StateEquations(make_program(of, STATE), own if name == "jacobian" else mechanism)
            for name, of in outputs.items()
        }

    def _picture(self) -> dict[str, list[Any]]:
        """Return where all is that a page draws: vertices and axes as the drawing numbers them, and named points."""
        return picture_of(self.motion.scene, self.motion.problem)

    def texts(self, target: Target) -> list[str]:
        """Return the code as IR.

        Raises
        ------
        CapabilityError : a number follows from a key in Python.
        """
        structure = self.structure
        places = [key.key.place for key in self.keys if key.key.sort == NUMBER]
        return [
            *loop_texts(self.system, methods[self.method], target),
            numbers_text(structure.recipe, entries_of(self.tables), places, structure.deciding, target),
            equations_text(self.equations, self.tables, target),
        ]

    @property
    def exports(self) -> list[str]:
        """Functions of the code that are called from outside."""
        return ["drive", "numbers", *self.equations, *(["trial_step"] if self.system.events else [])]

    def module(self) -> WasmModule:
        """Return the code.

        Raises
        ------
        CapabilityError : it needs functions that browsers do not have, or a number follows from a key in Python.
        """
        texts, exports = self.texts(WASM), self.exports
        if self.fleet.passing:
            texts, exports = [*texts, notes_text()], [*exports, "watch"]
        return self._module(texts, exports, (PASSED,))

    # -- data -----------------------------------------------------------------------------------------
    @cached_property
    def judging(self) -> Judging:
        """The rules of runs and of their errors.

        Raises
        ------
        CapabilityError : the run of the scene itself is left to the command.
        """
        return Judging(self, min(SHOWN, max(self.motion.scene.simulate.samples - 1, 1)))

    def data(self) -> dict[str, Any]:
        """Return what a page needs beside the code.

        Raises
        ------
        CapabilityError : the run of the scene itself is left to the command.
        """
        motion, model = self.motion, self.motion.problem.model
        duration = motion.scene.simulate.duration
        engine_numbers = len(self.fleet.tables.numbers)
        first, memory = self.engine.memory.block.ctypes.data, self.engine.memory
        names = PLACES[PLACES.index("tables") : PLACES.index("saved")]
        return {
            "title": motion.scene.title, "duration": duration, "locks": locks(self.command.name),
            "keys": [self._key_data(key, model) for key in self.keys],
            "q": columns(model.q_names, model.q_units, self.system.q_places),
            "v": columns(model.v_names, model.v_units, self.system.v_places),
            "size": self.system.size, "work": self.system.work_place, "state": plain(motion.start),
            "memory": {
                "block": memory.nbytes, "w": len(memory.w),
                "parts": dict(zip(("w", "n", "y", "dense"), (a - first for a in memory.addresses))),
                "fixed": {name: int(a.nbytes) for name, a in zip(names, self.engine.fixed)},
                "places": list(PLACES), "job": list(JOB), "parameters": plain(self.engine.p),
                "stretches": plain(self.fleet.stretches.ravel()), "updates": plain(self.engine.fixed[-1]),
            },
            "slots": {"time": DoubleSlot.T},
            "counts": {name: int(getattr(IntegerSlot, name)) for name in COUNTS},
            "status": {status.name: int(status) for status in Status},
            "location": {location.name: int(location) for location in Location},
            "events": [{"name": e.name, "kind": e.kind.name, "means": e.kind.value} for e in self.system.events],
            "passing": self.fleet.passing, "points": list(model.points),
            "numbers": plain(self.tables.numbers), "own": engine_numbers,
            "off": {draw: _steps_off(self.fleet.tables, draw) for draw in (1, 2)},
            "outputs": {name: own.program.sizes for name, own in self.equations.items()},
            "begun": self.system.size - self.system.further, "start": self._start(),
            **self.judging.data(),
        }  # fmt: skip

    def _start(self) -> dict[str, Any]:
        """Return where runs start: the scene's own start, what is given of others, and how loops are closed."""
        motion, model = self.motion, self.motion.problem.model
        own = {"q": motion.assembled.q.tolist(), "v": motion.assembled.v.tolist()}
        if not motion.problem.constraints.rows or self.closing is None:
            return {"own": own, "q": own["q"], "v": own["v"], "closing": None}
        initial, closing = motion.scene.initial, self.closing
        given_q = [initial.q.get(name, 0.0) for name in model.q_names]
        given_v = [initial.qd.get(name, 0.0) for name in model.v_names]
        return {"own": own, "q": given_q, "v": given_v, "closing": closing_data(closing)}


COUNTS = ("ACCEPTED", "REJECTED", "MAX_STEPS", "NEXT_SAMPLE", "LAST_SAMPLE", "EVENT", "LOCATED")


def _steps_off(tables: Tables, draw: int) -> list[int]:
    """Return by how many halves of a unit in the last place of 1 numbers are put off by rounding."""
    steps = (tables.off_by_rounding(draw) - 1.0) * 2.0**53
    return [int(x) for x in steps]
