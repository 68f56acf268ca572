"""A structure as texts and data: all that its runs take where there is no Python."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.commands import places
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.integration_methods import STIFF
from robodyn_cli.integrators.event_location.locate_event import PLACES
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, Status
from robodyn_cli.integrators.stepping.lanes import JOB
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.kernels.compiler import Target
from robodyn_cli.kernels.program import make_program
from robodyn_cli.kernels.wasm import WASM, WasmModule, write_wasm
from robodyn_cli.motion.self_check import is_judged_by_energy
from robodyn_cli.over.commands import locks
from robodyn_cli.over.live.code import (
    PASSED,
    StateEquations,
    equations_text,
    loop_texts,
    notes_text,
    numbers_text,
)
from robodyn_cli.over.live.inertia import inertia_equations
from robodyn_cli.over.live.judging import Judging, limits_of_closing
from robodyn_cli.over.live.rules import plain
from robodyn_cli.over.many.command import VERDICT
from robodyn_cli.over.many.groups import first_of
from robodyn_cli.over.many.integrate import RunBatch
from robodyn_cli.over.many.keys import NUMBER, OPTION, START, STRUCTURE, Key, key_unit, settings, value_of
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.over.many.simulate import MotionCommand
from robodyn_cli.over.many.start import ManyClosing
from robodyn_cli.over.many.structure import Structure
from robodyn_cli.record import record
from robodyn_cli.registry import Registry
from robodyn_cli.scene.load import Family
from robodyn_cli.spatial.algebra import Array

MOST_CORNERS = 6  # keys of whose ranges all corners are looked at; of more, the ends of each alone
SHOWN = 400  # stretches between samples that a picture takes, at most
STATE = ("t", "q", "v", "z")
# functions of the C library that a browser has under the same names
LIBRARY = frozenset(
    {"exp", "log", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "pow", "atan2", "sin", "cos"}
)


def motion_commands() -> dict[str, MotionCommand]:
    """Return the commands whose runs a page makes, by name."""
    batches: Registry[Any] = Registry("robodyn_cli", places("batch"), made=True)
    return {name: own for name, own in batches.items() if isinstance(own, MotionCommand)}


@record
class LiveKey:
    """A key with a range: what it is, and its value in the scene."""

    key: Key
    value: float
    low: float
    high: float


class LiveStructure:
    """The motion of a scene with some keys that vary within ranges, as code and data that need no Python.

    Parameters
    ----------
    ranges : lowest and highest value of keys, in SI units.

    Raises
    ------
    CapabilityError : what cannot leave, by name.
    SceneError : the scene has no such key, or does not allow values of the range.
    """

    where = "run in a page"  # what the scene is to do, as refusals say it
    in_page = True  # where times of events that are passed are told

    def __init__(self, family: Family, ranges: Mapping[str, tuple[float, float]]) -> None:
        self.family = family
        scene = family.own
        command = motion_commands().get(scene.command or "")
        if command is None:
            raise CapabilityError(
                f"a scene of {scene.command} cannot {self.where}; allowed: {', '.join(motion_commands())}"
            )
        mechanism = Mechanism(family, list(ranges))
        self.keys = [self._live_key(mechanism, key, ranges[key.name]) for key in mechanism.keys]
        self.command = command
        self.row = np.array([key.value for key in self.keys])
        self.structure = self._structure(mechanism)
        self.motion = self.structure.motion
        self.method = self.motion.choice.method
        if why := self.obstacle:
            raise CapabilityError(f"this scene cannot {self.where}: {why}")
        self.fleet = self.structure.fleet(self.method)
        self.system = self.fleet.system
        self.engine = self.fleet.engine
        self.batch = RunBatch.of(self.structure, self.row[None], None, None, 1)
        self.closing = self._closing()
        self.tables = Tables([*self.fleet.tables.programs, *(own.program for own in self.equations.values())])

    def _live_key(self, mechanism: Mechanism, key: Key, ends: tuple[float, float]) -> LiveKey:
        """Return a key with its range.

        Raises
        ------
        CapabilityError : it has no value, or one outside.
        """
        low, high = ends
        if key.scale != 1.0:
            raise CapabilityError(
                f"{key.name} has a unit or a sign in the scene; allowed: the key without '#'"
            )
        value = value_of(mechanism.family, key.name)
        if value is None:
            raise CapabilityError(f"{key.name} has no value in the scene; give it one by --set")
        if not low < high or not math.isfinite(low) or not math.isfinite(high):
            raise CapabilityError(f"{key.name}={low:g}:{high:g}; allowed: LOW:HIGH with LOW below HIGH")
        if not low <= value <= high:
            raise CapabilityError(
                f"{key.name}={low:g}:{high:g}; its value in the scene, {value:g}, has to lie within"
            )
        return LiveKey(key, value, low, high)

    def _structure(self, mechanism: Mechanism) -> Structure:
        """Return the structure that serves the scene and the corners of its ranges."""
        rows = np.array([self.row, *self._corners()])
        for error in mechanism.refusals(rows).values():
            raise error
        for key in self.keys:
            if key.value in key.key.special:
                raise CapabilityError(
                    f"{key.key.name} is {key.value:g} in this scene, where the equations are others than beside it; "
                    "give it another value by --set"
                )
        groups = list(mechanism.groups(self.command, rows))
        own, served = next(
            ((own, group) for own, group in groups if own is not None and 0 in group), (None, np.zeros(0))
        )
        if not isinstance(own, Structure):
            self.command.structure(self.family, mechanism.keys, self.row)  # which says why not
            why = "its equations cannot be built for many runs"
            if self.family.own.control is not None:
                why = "its controller follows from the keys by computations in Python"
            raise CapabilityError(f"this scene cannot {self.where}: {why}")
        if own.obstacle:
            raise CapabilityError(f"this scene cannot {self.where}: {own.obstacle}")
        left = sorted(set(range(len(rows))) - set(served.tolist()))
        if left:
            at = ", ".join(settings([key.key.name for key in self.keys], rows[left[0]]))
            raise CapabilityError(
                f"within these ranges the equations change: those at {at} are others; narrow them"
            )
        return own

    def _corners(self) -> list[Array]:
        """Return rows of values at the ends of the ranges."""
        ends = [(key.low, key.high) for key in self.keys]
        if len(ends) <= MOST_CORNERS:
            return [np.array(row) for row in itertools.product(*ends)]
        rows = []
        for k, both in enumerate(ends):
            for x in both:
                row = self.row.copy()
                row[k] = x
                rows.append(row)
        return rows

    @property
    def obstacle(self) -> str:
        """Why runs of this scene stay with the command; nothing if they can leave."""
        motion, scene = self.motion, self.motion.scene
        control = motion.problem.control
        sorts = [(key.key.name, key.key.sort) for key in self.keys]
        reasons = {f"{name} {SORTS[sort]}": True for name, sort in sorts if sort in SORTS}
        choice = motion.choice
        quasi = any(body.joint.quasi for body in motion.problem.model.bodies)
        reasons |= {
            VERDICT: bool(scene.drives) or scene.motorisation is not None,
            "no errors are estimated (simulate.error_estimate)": not scene.simulate.error_estimate,
            "the motion turns stiff, so that its method changes on the way": choice.may_change
            and choice.method == STIFF,
            "sensors are noisy, whose random numbers the command draws": control is not None
            and bool(control.channels),
            "latches close": motion.system.closings is not None or bool(scene.deploy.latches),
            "loops of joints with quaternions are closed in Python": quasi
            and bool(motion.problem.constraints.rows),
        }
        return first_of(reasons)

    def _closing(self) -> ManyClosing | None:
        """Return what closes the loops at the start for other values; None where they stay as they are."""
        motion = self.motion
        if not motion.problem.constraints.rows:
            return None
        initial = motion.scene.initial
        q, qd = dict(initial.q), dict(initial.qd)
        for key in self.keys:
            if key.key.sort == START:
                group, _, name = key.key.place.partition(".")
                (q if group == "q" else qd)[name] = key.value
        closing = ManyClosing(motion, self.batch.numbers, q, qd)
        if not closing.varies and not any(key.key.sort == START for key in self.keys):
            return None
        if len(closing.missing) == closing.nv:
            raise CapabilityError(
                f"this scene cannot {self.where}: no coordinate is given where its loops are closed"
            )
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
        from robodyn_cli.report.drawing.build import drawn_things

        problem = self.motion.problem
        entries = drawn_things(self.motion.scene, problem)[0].entries
        points = problem.model.points
        outputs = {kind: [x for entry in entries[kind] for x in entry] for kind in ("vertices", "axes")}
        outputs["points"] = [x for frame in points.values() for x in problem.world_point(frame)]
        unknown = {symbol.value[1] for part in outputs.values() for symbol in free_symbols(part)} - {"q", "v"}
        return {} if unknown else outputs

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
            numbers_text(structure.recipe, self._entries, places, structure.deciding, target),
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
        made = write_wasm(texts, exports)
        if others := sorted(set(made.imports) - LIBRARY - {PASSED}):
            raise CapabilityError(
                f"this scene cannot {self.where}: browsers have no function {', '.join(others)}"
            )
        return made

    @property
    def _entries(self) -> list[Any]:
        """The numbers of all tables, one after another."""
        return [x for p in self.tables.programs for x in (p.numbers or (0.0,))]

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
            "keys": [self._key_data(key) for key in self.keys],
            "q": _columns(model.q_names, model.q_units, self.system.q_places),
            "v": _columns(model.v_names, model.v_units, self.system.v_places),
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
            "events": [{"name": e.name, "kind": e.kind.name, "means": e.kind.value} for e in self.system.events],
            "passing": self.fleet.passing, "points": list(model.points),
            "numbers": plain(self.tables.numbers), "own": engine_numbers,
            "off": {draw: _steps_off(self.fleet.tables, draw) for draw in (1, 2)},
            "outputs": {name: own.program.sizes for name, own in self.equations.items()},
            "begun": self.system.size - self.system.further, "start": self._start(),
            **self.judging.data(),
        }  # fmt: skip

    def _key_data(self, key: LiveKey) -> dict[str, Any]:
        place: Any = None
        model = self.motion.problem.model
        if key.key.sort == START:
            group, _, name = key.key.place.partition(".")
            place = [group, (model.q_names if group == "q" else model.v_names).index(name)]
        return {
            "name": key.key.name, "unit": key_unit(self.family, key.key, model), "value": key.value,
            "low": key.low, "high": key.high, "special": list(key.key.special), "start": place,
        }  # fmt: skip

    def _start(self) -> dict[str, Any]:
        """Return where runs start: the scene's own start, what is given of others, and how loops are closed."""
        motion, model = self.motion, self.motion.problem.model
        own = {"q": motion.assembled.q.tolist(), "v": motion.assembled.v.tolist()}
        if not motion.problem.constraints.rows or self.closing is None:
            return {"own": own, "q": own["q"], "v": own["v"], "closing": None}
        initial, closing = motion.scene.initial, self.closing
        given_q = [initial.q.get(name, x) for name, x in zip(model.q_names, own["q"])]
        given_v = [initial.qd.get(name, 0.0) for name in model.v_names]
        parts = {
            "missing": closing.missing, "free": closing.free, "sizes": closing.sizes.tolist(),
            "lengths": closing.lengths.tolist(), **limits_of_closing(),
        }  # fmt: skip
        return {"own": own, "q": given_q, "v": given_v, "closing": parts}


SORTS = {STRUCTURE: "decides which equations there are", OPTION: "is an option of the run"}
COUNTS = ("ACCEPTED", "REJECTED", "MAX_STEPS", "NEXT_SAMPLE", "LAST_SAMPLE", "EVENT", "LOCATED")


def _columns(names: Sequence[str], units: Sequence[str], places: Sequence[int]) -> dict[str, Any]:
    return {"names": list(names), "units": list(units), "places": [int(k) for k in places]}


def _steps_off(tables: Tables, draw: int) -> list[int]:
    """Return by how many halves of a unit in the last place of 1 numbers are put off by rounding."""
    steps = (tables.off_by_rounding(draw) - 1.0) * 2.0**53
    return [int(x) for x in steps]
